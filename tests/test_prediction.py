"""`predict` against Müller's table, and against what integration leaves of the constraints."""

from functools import cache

import numpy as np
import pytest
from cases import JOINTS_IN_CSPACES, LENGTH, PITCH, column, integrate, tilted
from scipy.spatial.transform import Rotation

import lierb
from lierb.errors import ArgumentError, PoseError

# SE(3): the joint's own group, or the smallest one that holds its motions (Müller, section 5). Of
# joints without a group it is here, with the rows that are kept, and whether SO(3)×R³ keeps the
# position of one at the body's origin: a slot in the body moves with the turn, and a row that is
# quadratic in the position is never kept.
COMPLETION = {
    "universal": ("SO(3)", 3, "d1 d2 d3", True),
    "hook": ("SO(3)", 3, "d1 d2 d3", True),
    "constant_velocity": ("SO(3)", 3, "d1 d2 d3", True),
    "pin_in_slot": ("SE(2)", 3, "d3 Omega1 Omega2", True),
    "pin_in_slot_body": ("SE(2)", 3, "Qtd3 Omega1 Omega2", False),
    "point_on_line": ("SE(3)", 6, "", True),
    "point_on_plane": ("SE(3)", 6, "", True),
    "point_on_sphere": ("SE(3)", 6, "", False),
    "fixed": ("{I}", 0, "d1 d2 d3 Omega1 Omega2 Omega3", True),
}
DIMENSIONS = {
    "R": 1, "SO(2)": 1, "H_p": 1, "R²": 2, "SO(2)×R": 2, "R³": 3, "SO(3)": 3, "SE(2)": 3,
    "H_p⋉R²": 3, "SO(2)⋉R³": 4, "SE(3)": 6,
}  # fmt: skip
# SO(3)×R³ keeps these too, wherever the joint is on the body (errata E17 and table 2).
KEPT_BY_BOTH = {
    "prismatic", "planar", "planar_translation", "translation", "helical_planar", "schoenflies",
    "fixed", "free",
}  # fmt: skip


def kept(prediction):
    return " ".join(
        name for name, e in zip(prediction.rows, prediction.rows_exact, strict=True) if e
    )


@pytest.mark.parametrize("name", list(lierb.joints.JOINTS))
def test_se3_keeps_the_joint_s_group_and_of_others_what_their_completion_keeps(name):
    problem, _ = tilted(name)
    found = lierb.predict(problem)["SE3"]
    entry = lierb.joints.JOINTS[name]
    every_row = " ".join(map(str, entry.rows))
    group, dimension, rows, _ = COMPLETION.get(
        name, (entry.subgroup, DIMENSIONS.get(entry.subgroup), every_row, True)
    )
    assert (found.group, found.dimension, kept(found)) == (group, dimension, rows)


@pytest.mark.parametrize("name", list(lierb.joints.JOINTS))
def test_so3xr3_keeps_what_the_errata_say(name):
    problem, _ = tilted(name)
    assert lierb.predict(problem)["SO3xR3"].position_exact == (name in KEPT_BY_BOTH)
    entry = lierb.joints.JOINTS[name]
    options = {"pitch": PITCH, "length": LENGTH}
    held = entry(axis=(1, 2, -1), **{o: options[o] for o in entry.options & options.keys()})
    at_origin = lierb.predict(lierb.Problem(problem.body, held))["SO3xR3"]
    assert at_origin.position_exact == (name not in COMPLETION or COMPLETION[name][3])


def test_spherical_needs_more_than_its_closed_configuration():
    """The closure at C₀ alone on SO(3)×R³ has dimension 5 instead of 6."""
    problem, _ = tilted("spherical")
    found = lierb.predict(problem)["SO3xR3"]
    assert (found.group, found.dimension) == ("SO(3)×R³", 6)
    assert found.rows_exact == (False,) * 3


def test_prediction_says_why():
    problem, _ = tilted("universal")
    found = lierb.predict(problem)
    assert str(found["SE3"]) == (
        "SE3: completion group K = SO(3); d1 d2 d3 constant on C₀K, so kept exactly; "
        "Q32 not constant there: drifts with the method's order"
    )
    assert found["SE3"].position_exact
    assert not found["SE3"].rotation_exact
    lines = str(found).splitlines()
    assert len(lines) == 3
    assert lines[1].startswith("SE3 ")
    assert "drifts" in lines[2]


def test_far_and_small_bodies_are_seen_as_sharply():
    """The rank does not depend on the unit of length."""
    for size in (1e-4, 1.0, 1e4):
        body = lierb.bodies.box((0.1 * size, 0.2 * size, 0.3 * size), mass=1.0)
        held = lierb.joints.pin_in_slot(body_point=(0.3 * size, -0.1 * size, 0.2 * size))
        found = lierb.predict(lierb.Problem(body, held))
        assert (found["SE3"].group, found["SO3xR3"].group) == ("SE(2)", "SO(2)×R²")


def test_batch_is_refused():
    held = lierb.joints.spherical(body_point=np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="one body at a time"):
        lierb.predict(lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), held))


@pytest.mark.parametrize("pose0", [np.eye(4)[None], np.tile(np.eye(4), (2, 1, 1))])
def test_several_poses_are_refused(pose0):
    with pytest.raises(ArgumentError, match="one pose"):
        lierb.predict(lierb.Problem(lierb.Body(1.0, (1, 1, 1)), lierb.joints.spherical()), pose0)


def test_pose_off_the_joint_is_refused():
    problem, _ = tilted("revolute")
    with pytest.raises(PoseError, match=r"problem\.close"):
        lierb.predict(problem, np.eye(4))


def test_pose_says_which_branch_is_meant():
    """A pin whose point starts away from the body's origin, by its slot, or at it."""
    held = lierb.joints.pin_in_slot_body(axis=(0, 0, 1))
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), held)
    moved = np.eye(4)
    moved[0, 3] = 0.5
    for pose0 in (None, moved):
        assert lierb.predict(problem, pose0)["SE3"].group == "SE(2)"


def test_body_off_its_centre_of_mass_is_for_se3_only():
    body = lierb.Body(1.0, (1.0, 1.0, 1.0), com=(0.1, 0.0, 0.0))
    assert list(lierb.predict(lierb.Problem(body, lierb.joints.spherical()))) == ["SE3"]


# ---- against the measured drift ------------------------------------------------------------------

COUNT = 12  # random frames of every joint, in two c-spaces; predictions are what costs
SPEED = {"constant_velocity": 2.0}  # it drifts so little; a rod, or what else has a length, so fast


@cache
def random_problems(name, count):
    """Frames of every body's own, a third of them at the body frame's origin; and predictions."""
    rng = np.random.default_rng([5, len(name)])
    entry = lierb.joints.JOINTS[name]
    frames = []
    for _ in range(2):
        matrices = np.tile(np.eye(4), (count, 1, 1))
        matrices[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
        matrices[:, :3, 3] = rng.normal(size=(count, 3)) * 0.2
        frames.append(matrices)
    frames[0][::3, :3, 3] = 0.0
    values = {"pitch": PITCH, "length": LENGTH}
    options = {o: values[o] for o in entry.options & values.keys()}
    body, _ = tilted(name)
    body = body.body
    speed = SPEED.get(name, 0.1 if "length" in options else 1.0)
    twists = rng.normal(size=(count, 6)) * speed * (5.0, 5.0, 5.0, 1.0, 1.0, 1.0)

    def problem(chosen):
        held = entry(body_frame=frames[0][chosen], ground_frame=frames[1][chosen], **options)
        return lierb.Problem(body, held, (1.0, -2.0, -3.0))

    whole = problem(slice(None))
    return whole, whole.project(twists), [lierb.predict(problem(i)) for i in range(count)]


def drift(problem, twists, cspace, dt):
    run = integrate(problem, twist0=twists, dt=dt, t_end=0.5, cspace=cspace)
    assert set(run.summary["status"].to_pylist()) == {"ok"}
    return {
        kind: column(run.summary, f"{kind}_error_max") for kind in ("position", "rotation")
    }, np.abs(column(run.summary, "position")).max(axis=1)


@pytest.mark.parametrize(("cspace", "name"), JOINTS_IN_CSPACES)
def test_prediction_agrees_with_the_measured_drift(name, cspace):
    problem, twists, found = random_problems(name, COUNT)
    coarse, reach = drift(problem, twists, cspace, 1e-2)
    fine, _ = drift(problem, twists, cspace, 5e-3)
    predicted = [p[cspace] for p in found]
    for kind in ("position", "rotation"):
        exact = np.array([getattr(p, f"{kind}_exact") for p in predicted])
        # rounding of 100 steps, and nothing else
        assert (fine[kind][exact] <= 1e-12 * (1.0 + reach[exact])).all()
        if not exact.all():
            # beyond rounding, about 1e-14, and less of it by the order of RK4: 16 times, in the
            # middle case
            assert (coarse[kind][~exact] > 1e-13).all()
            order = np.log2(coarse[kind][~exact] / fine[kind][~exact])
            assert np.median(order) == pytest.approx(4.0, abs=0.2)

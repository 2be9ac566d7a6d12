"""Units of length, mass and time change neither verdicts nor numbers.

Scales are powers of two, so that what is scaled is exactly the same problem: only what compares a
number with one that does not scale along can tell the difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import studies
from cases import BODY_FRAME, GRAVITY, GROUND_FRAME, LENGTH, PITCH, box, column, integrate

import lierb
from lierb.errors import PoseError, TwistError


def require_consistent(problem, twist, pose):
    if error := problem.violation(pose, twist):
        raise error


class Scale(NamedTuple):
    length: float
    mass: float
    time: float


ONE = Scale(1.0, 1.0, 1.0)
SCALES = [
    Scale(2.0**-30, 2.0**-40, 2.0**-20),  # 1e-9, 1e-12 and 1e-6
    Scale(2.0**20, 2.0**30, 2.0**10),  # 1e6, 1e9 and 1e3
    Scale(2.0**-30, 2.0**30, 2.0**10),
    Scale(2.0**20, 2.0**-40, 2.0**-20),
]
JOINTS = ("spherical", "revolute", "universal", "screw", "point_on_sphere")
CSPACES = ("SE3", "SO3xR3")
EVERY_JOINT = pytest.mark.parametrize("name", JOINTS)
EVERY_SCALE = pytest.mark.parametrize("scale", SCALES, ids=["small", "large", "slow", "quick"])
LIVELY = np.array((1.2, -0.7, 0.9, 0.4, 0.3, -1.0))


def moved(matrix: np.ndarray, scale: Scale) -> np.ndarray:
    """A frame or pose, its place in another unit of length."""
    result = np.array(matrix)
    result[..., :3, 3] *= scale.length
    return result


def spun(twist: np.ndarray, scale: Scale) -> np.ndarray:
    """A twist in other units."""
    return twist * np.repeat((1.0, scale.length), 3) / scale.time


def problem(name: str, scale: Scale = ONE, com=(0.0, 0.0, 0.0)) -> lierb.Problem:
    entry = lierb.joints.JOINTS[name]
    sizes = {"pitch": PITCH * scale.length, "length": LENGTH * scale.length}
    held = entry(
        ground_frame=moved(GROUND_FRAME, scale), body_frame=moved(BODY_FRAME, scale),
        **{key: value for key, value in sizes.items() if key in entry.options},
    )  # fmt: skip
    like = box(turned=True)
    body = lierb.Body(
        like.mass * scale.mass,
        like.inertia * scale.mass * scale.length**2,
        np.array(com) * scale.length,
    )
    return lierb.Problem(body, held, np.array(GRAVITY) * scale.length / scale.time**2)


def own_length(held: lierb.Problem) -> float:
    """Scale from its definition; the body's frame is at the centre of mass here."""
    spread = np.trace(np.diag(np.linalg.eigvalsh(held.body.inertia))) / (2 * held.body.mass)
    arm = np.linalg.norm(held.joint.body_frame[:3, 3])
    return max(np.sqrt(spread), arm, float(held.joint.pitch), float(held.joint.length))


# ---- starts ------------------------------------------------------------------------------------


def offset(held: lierb.Problem, by: float) -> np.ndarray:
    """The closed pose, its joint opened by a part of the problem's length, along e₃ of the ground.

    Every joint here holds that direction, the rod's as well.
    """
    pose = np.array(held.joint.closed_pose)
    pose[:3, 3] += by * own_length(held) * held.joint.ground_frame[:3, 2]
    return pose


def drifting(held: lierb.Problem, twist: np.ndarray, by: float) -> np.ndarray:
    """The twist, with the joint's point moving off by a part of the body's own speed."""
    speed = np.linalg.norm(twist[3:]) + own_length(held) * np.linalg.norm(twist[:3])
    off = held.joint.closed_pose[:3, :3].T @ held.joint.ground_frame[:3, 2] * by * speed
    return twist + np.concatenate((np.zeros(3), off))


@EVERY_JOINT
@pytest.mark.parametrize("scale", [ONE, *SCALES])
def test_starts_are_judged_in_the_problem_s_own_units(name, scale):
    held = problem(name, scale)
    twist = held.project(spun(LIVELY, scale))
    closed = held.joint.closed_pose

    def judge(pose, twist):
        require_consistent(held, twist[None], pose)

    # 1e-9 is allowed; rounding of frames half a metre away from a body of 0.15 m is 1e-5 of that
    judge(offset(held, 0.99e-9), held.project(twist, offset(held, 0.99e-9)))
    judge(closed, drifting(held, twist, 0.99e-9))
    with pytest.raises(PoseError, match="position error"):
        judge(offset(held, 1.01e-9), twist)
    with pytest.raises(TwistError, match="velocity"):
        judge(closed, drifting(held, twist, 1.01e-9))
    judge(closed, np.zeros(6))  # at rest, nothing is violated


@EVERY_SCALE
@pytest.mark.parametrize(("name", "cspace"), [("spherical", "SE3"), ("universal", "SO3xR3")])
def test_kernels_judge_starts_as_the_checks_do(name, cspace, scale):
    held = problem(name, scale)
    twist = held.project(spun(LIVELY, scale))
    options = {"dt": 1e-3 * scale.time, "t_end": 1e-3 * scale.time, "cspace": cspace}
    integrate(held, pose0=offset(held, 0.99e-9), twist0=twist, **options)
    integrate(held, twist0=drifting(held, twist, 0.99e-9), **options)
    for wrong in (1.01e-9, 0.9):
        with pytest.raises(PoseError, match="position error"):
            integrate(held, pose0=offset(held, wrong), twist0=twist, **options)
        with pytest.raises(TwistError, match="velocity"):
            integrate(held, twist0=drifting(held, twist, wrong), **options)


def test_turning_and_moving_are_not_added():
    """A box at 1e4 rad/s whose pivot moves at 9e-6 m/s, 6e-9 of the box's own speed."""
    held = problem("spherical")
    twist = held.joint.twist(omega=(1e4, 0.0, 0.0), point_velocity=(0.0, 0.0, 9e-6))
    with pytest.raises(TwistError, match=r"velocity 9e-06 m/s > 1\.\d+e-06 m/s"):
        require_consistent(held, twist[None], None)
    slide = lierb.Problem(box(), lierb.joints.prismatic(axis=(0, 0, 1)))
    # 1e-9 of 100 m/s over the box's 0.1 m
    with pytest.raises(TwistError, match="rotation rate 2e-06 rad/s"):
        require_consistent(slide, np.array([[0, 0, 2e-6, 0, 0, 100.0]]), None)


@EVERY_JOINT
def test_rounding_of_places_far_away_is_no_violation(name):
    """1e6 m from the origin doubles are 1e-10 m apart: a nanometre's tolerance is theirs."""
    near, far = problem(name), np.array((5e5, -7e5, 3e5))
    ground = np.array(near.joint.ground_frame)
    ground[:3, 3] += far
    entry = lierb.joints.JOINTS[name]
    options = {"pitch": near.joint.pitch, "length": near.joint.length}
    held = entry(
        ground_frame=ground, body_frame=BODY_FRAME,
        **{key: value for key, value in options.items() if key in entry.options},
    )  # fmt: skip
    there = lierb.Problem(near.body, held)
    rng = np.random.default_rng(1)
    for _ in range(20):
        pose = there.close(held.closed_pose @ lierb.lie.se3.exp(0.03 * rng.normal(size=6)))
        require_consistent(there, there.project(rng.normal(size=6), pose)[None], pose)
    opened = np.array(held.closed_pose)
    opened[:3, 3] += 1e-7 * ground[:3, 2]
    with pytest.raises(PoseError, match="position error 1e-07 m"):
        require_consistent(there, np.zeros((1, 6)), opened)


@pytest.mark.parametrize("name", ["revolute", "screw"])
def test_motor_that_starts_from_rest_is_met_by_a_body_at_rest(name):
    """sin π is 1.2e-16 in doubles: less than the motor's own acceleration makes up for at once."""
    still = problem(name)
    motor = lierb.forces.motor(speed=lambda t, p: 40.0 * np.sin(t + np.pi))
    driven = lierb.Problem(still.body, still.joint, still.gravity, [motor])
    require_consistent(driven, np.zeros((1, 6)), None)
    with pytest.raises(TwistError, match="rotation rate"):
        require_consistent(driven, 1e-9 * still.project(LIVELY)[None], None)


@lierb.constraint(length=LENGTH, anchor=(0.0, 0.0, 0.0))
def tether(R, r, params):
    line = r - params.anchor
    return (line @ line / params.length - params.length) / 2


@pytest.mark.parametrize(("scale", "far"), [*((scale, 0.0) for scale in SCALES), (ONE, 1e6)])
def test_constraints_of_the_user_s_own_are_judged_likewise(scale, far):
    like, anchor = problem("spherical", scale), np.full(3, far)
    ball = tether(length=LENGTH * scale.length, anchor=anchor)
    held = lierb.Problem(like.body, lierb.joints.free(), like.gravity, constraints=[ball])
    start = np.eye(4)
    start[:3, 3] = (0.2, 0.21, 0.19)
    pose = moved(start, scale)
    pose[:3, 3] += anchor
    pose = held.close(pose)
    assert np.linalg.norm(pose[:3, 3] - anchor) == pytest.approx(
        LENGTH * scale.length, rel=1e-12, abs=1e-15 * far
    )
    twist = held.project(spun(LIVELY, scale), pose)
    require_consistent(held, twist[None], pose)
    assert not lierb.predict(held, pose)["SE3"].position_exact
    pose[:3, 3] += 1e-7 * (pose[:3, 3] - anchor)
    with pytest.raises(PoseError, match="free joint with tether: position error"):
        require_consistent(held, twist[None], pose)


# ---- closing, projecting, predicting -----------------------------------------------------------


@EVERY_JOINT
@EVERY_SCALE
def test_closing_and_projecting_scale_along(name, scale):
    com = (0.01, -0.02, 0.01)
    here, there = problem(name, com=com), problem(name, scale, com)
    motion = 0.03 * np.array((0.5, -1.0, 0.8, 1.0, 0.7, -0.4))
    start = here.joint.closed_pose @ lierb.lie.se3.exp(motion)
    pose = here.close(start)
    found = moved(there.close(moved(start, scale)), Scale(1.0 / scale.length, 1.0, 1.0))
    # the same steps on the same digits; should a sum mix units one day, to Newton's tolerance
    np.testing.assert_allclose(found, pose, rtol=0, atol=1e-12)
    twist = here.project(LIVELY, pose)
    seen = there.project(spun(LIVELY, scale), moved(pose, scale))
    back = spun(seen, Scale(1.0 / scale.length, 1.0, 1.0 / scale.time))
    np.testing.assert_allclose(back, twist, rtol=0, atol=1e-12 * np.linalg.norm(twist))


def test_a_tiny_body_is_closed_to_its_own_size():
    """0.1 nm: a metre's 1e-13 would leave a thousandth of it."""
    scale = ONE._replace(length=1e-9)
    for name in JOINTS:
        held = problem(name, scale)
        pose = held.close(held.joint.closed_pose @ moved(lierb.lie.se3.exp([0.03] * 6), scale))
        D = np.linalg.inv(held.joint.ground_frame) @ pose @ held.joint.body_frame
        d = D[:3, 3] / scale.length
        off = np.linalg.norm(d) - LENGTH if name == "point_on_sphere" else d[:2]
        # Newton's 1e-13, and rounding of places half a metre from the origin in units of the scale
        assert np.abs(off).max() < 1e-12


def flipped(*signs: float) -> np.ndarray:
    return np.diag((*signs, 1.0))


@pytest.mark.parametrize(
    ("name", "turn"),
    [
        ("revolute", (1, -1, -1)),
        ("cylindrical", (-1, 1, -1)),
        ("planar", (1, -1, -1)),
        ("pin_in_slot", (-1, 1, -1)),
    ],
)
def test_a_joint_held_the_wrong_way_round_is_not_closed(name, turn):
    """Exactly half a turn off no row sees anything, and there is no shortest way back."""
    held = lierb.Problem(box(), lierb.joints.JOINTS[name]())
    wrong = flipped(*turn)
    with pytest.raises(PoseError, match="wrong way round"):
        held.close(wrong)
    with pytest.raises(PoseError, match=r"pose\[1\] holds the .* wrong way round"):
        held.close([np.eye(4), wrong])
    with pytest.raises(PoseError):
        require_consistent(held, np.zeros((1, 6)), wrong)
    with pytest.raises(PoseError):
        lierb.predict(held, wrong)
    # a little less than half a turn has a shortest way back
    nearly = wrong @ lierb.lie.se3.exp((1e-3, -2e-3, 0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(held.close(nearly)[2, :3], (0.0, 0.0, 1.0), rtol=0, atol=1e-13)


@pytest.mark.slow
@EVERY_JOINT
def test_predictions_do_not_depend_on_units(name):
    expected = str(lierb.predict(problem(name)))
    lengths = (1e-10, 1e-9, 1e-8, 1e-6, 1e6)
    for scale in [*SCALES, *(ONE._replace(length=length) for length in lengths)]:
        assert str(lierb.predict(problem(name, scale))) == expected


@pytest.mark.parametrize(("pitch", "length"), [(1e-6, 1.0), (0.07e-6, 1e-6)])
def test_a_fine_screw_is_a_screw(pitch, length):
    """A micrometre a radian on a box of 0.3 m, and a box of 0.3 µm on a screw of its own size."""
    like, scale = problem("spherical", ONE._replace(length=length)), Scale(length, 1.0, 1.0)
    frames = {"ground_frame": moved(GROUND_FRAME, scale), "body_frame": moved(BODY_FRAME, scale)}
    fine = lierb.predict(lierb.Problem(like.body, lierb.joints.screw(pitch=pitch, **frames)))
    assert (fine["SE3"].group, fine["SE3"].dimension) == ("H_p", 1)
    assert fine["SO3xR3"].group == "{(exp tê, ta)}×R²"


def test_predictions_far_from_the_origin_are_the_same():
    """Rounding of a distant position, 1e-10 m, is no part of the motion."""
    for name in JOINTS:
        near, ground = problem(name), np.array(GROUND_FRAME)
        ground[:3, 3] += (5e5, -7e5, 3e5)
        sizes = {"pitch": PITCH, "length": LENGTH}
        entry = lierb.joints.JOINTS[name]
        options = {key: value for key, value in sizes.items() if key in entry.options}
        held = entry(ground_frame=ground, body_frame=BODY_FRAME, **options)
        assert str(lierb.predict(lierb.Problem(near.body, held))) == str(lierb.predict(near))


# ---- what integration finds --------------------------------------------------------------------

RUNS = [
    ("spherical", "SO3xR3"), ("spherical", "SE3"), ("universal", "SO3xR3"),
    pytest.param("screw", "SO3xR3", marks=pytest.mark.slow),
]  # fmt: skip


def run(name: str, cspace: str, scale: Scale) -> dict[str, np.ndarray]:
    """A summary's numbers, scaled back."""
    held = problem(name, scale)
    result = integrate(
        held, twist0=held.project(spun(LIVELY, scale)), dt=1e-2 * scale.time,
        t_end=0.5 * scale.time, cspace=cspace,
    )  # fmt: skip
    length, mass, time = scale
    units = {
        "position_error_max": length, "rotation_error_max": 1.0,
        "velocity_error_max": length / time, "energy_drift_max": mass * length**2 / time**2,
        "position": length, "rotation": 1.0, "omega": 1.0 / time, "v": length / time,
    }  # fmt: skip
    assert result.summary["status"].to_pylist() == ["ok"]
    return {key: column(result.summary, key)[0] / unit for key, unit in units.items()}


@pytest.mark.parametrize(("name", "cspace"), RUNS)
def test_errors_and_states_scale_along(name, cspace):
    expected = run(name, cspace, ONE)
    for scale in SCALES:
        found = run(name, cspace, scale)
        for key, value in found.items():
            # the same steps on the same digits; should a sum mix units one day, rounding of fifty
            # steps of numbers of size 1 to 10
            np.testing.assert_allclose(value, expected[key], rtol=1e-9, atol=1e-12, err_msg=key)


# ---- what is said of results -------------------------------------------------------------------


def scaled_study(scale: Scale):
    """The study of `studies.TEXT`, in other units, with steps long enough for an order to show."""
    length, mass, time = scale
    tables = studies.tables()
    body, joint, sample = tables["body"], tables["joint"], tables["sample"]
    omega, masses, drag = (
        sample["initial"]["omega"], sample["body"]["mass"], sample["forces"]["drag"]["linear"],
    )  # fmt: skip
    scaled = (
        (body, "mass", mass), (body, "inertia", mass * length**2), (joint, "body_point", length),
        (tables["problem"], "gravity", length / time**2), (omega, "mean", 1.0 / time),
        (omega, "std", 1.0 / time), (masses, "low", mass), (masses, "high", mass),
        (drag, "low", mass / time), (drag, "high", mass / time),
        (tables["problem"]["forces"][0], "linear", mass / time),
    )  # fmt: skip
    for table, key, unit in scaled:
        table[key] = (np.array(table[key]) * unit).tolist()
    sample["n"] = 8
    tables["integrate"] |= {"dt": [2e-2 * time, 1e-2 * time, 5e-3 * time], "t_end": 0.5 * time}
    return studies.Study.of(tables)


@pytest.fixture(scope="module", params=[ONE, Scale(2.0**-20, 1.0, 1.0), *SCALES[:2]])
def results(request, tmp_path_factory):
    study = scaled_study(request.param)
    return request.param, study, lierb.run(study, tmp_path_factory.mktemp("study"))


def test_orders_show_whatever_the_units(results):
    from lierb.studies.findings.findings import findings, orders

    _, _, done = results
    found = findings(done)
    for each in found:
        seen = orders(found, each)
        if each.setting.cspace == "SE3":
            assert seen["position"] is None  # kept to rounding
        else:
            assert seen["position"].slope == pytest.approx(4.0, abs=0.2)
            assert not seen["position"].lower_bound
        assert seen["rotation"] is None  # a spherical joint has none
        assert seen["energy"].slope > 3.8  # an error, since the drag's work is counted


def test_sizes_are_those_of_the_motion(results):
    """A top of 0.155 m and 6 kg at 7 rad/s: ℓ and as much again from pivot to centre; m g ℓ = 9 J,
    to which kinetic energy, some J, and m g times the centre's height add."""
    from lierb.studies.findings.sizes import sizes_of

    scale, study, done = results
    for setting in study.settings:
        sizes = sizes_of(done, setting)
        assert 0.30 < sizes["position"] / scale.length < 0.32
        joule = scale.mass * (scale.length / scale.time) ** 2
        assert 9.0 < sizes["energy"] / joule < 27.0
        assert sizes["rotation"] == 1.0


@pytest.mark.long
def test_errors_of_small_bodies_are_drawn(results):
    """The drift on SO(3)×R³, 1e-7 of the top's length, where figures would draw none."""
    study_plots = pytest.importorskip("lierb.studies.pages.figures")
    from lierb.studies.findings.sizes import errors_seen, least_drawn

    scale, _, done = results
    assert list(errors_seen(done)) == ["position", "energy"]
    least = least_drawn(done)["position"]
    panel = study_plots.figure(done, "order").axes[0]
    # Of SE(3) all are zero, and no line is drawn; the line of the method's order has no markers.
    median, most, worst = [line.get_ydata() for line in panel.lines if line.get_marker() != "None"]
    drift = np.concatenate([median, most, worst])
    assert (drift > 1e6 * least).all()
    assert (drift < 1e-4 * scale.length).all()

"""`predict` of mechanisms: by hand, by normalisers of subgroups, and against the measured drift."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import LENGTH, PITCH, long_but, slow_but, tiered, tilted
from mechanisms import samples
from scipy.linalg import expm

import lierb
from lierb.errors import ArgumentError, PoseError
from lierb.kernels.mechanics.subgroup import slots_of

BENCH = Path(__file__).parents[1] / "bench"
sys.path.insert(0, str(BENCH))

import predictions as bench  # noqa: E402

CSPACES = ("reduced", "SE3", "SO3xR3")
BOX = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
Y = {"axis": (0.0, 1.0, 0.0)}


def pendulum(axis=(0.0, 1.0, 0.0), size=1.0, away=(0.0, 0.0, 0.0), com=(0.0, 0.0, 0.0)):
    """Two links; the second joint's axis, all lengths times `size`, on a point `away`."""
    inertia = BOX.inertia * size**2 + (np.dot(com, com) * np.eye(3) - np.outer(com, com))
    body = lierb.Body(1.0, inertia, com)
    end = np.array([0.0, 0.0, 0.25 * size])
    return lierb.Mechanism(
        [
            lierb.Link("upper", body, lierb.joints.revolute(end, away, **Y)),
            lierb.Link(
                "lower", body,
                lierb.joints.revolute(end, parent_point=-end, axis=axis), parent="upper",
            ),
        ]
    )  # fmt: skip


def four_bar(length, loop="revolute"):
    """A crank of 1 m, a coupler of 2 m and a rocker of 1 m, with pivots at a distance."""
    crank = lierb.Link("crank", BOX, lierb.joints.revolute((0, 0, 0.5), **Y))
    coupler = lierb.joints.revolute((0, 0, 1.0), parent_point=(0, 0, -0.5), **Y)
    rocker = lierb.Link("rocker", BOX, lierb.joints.revolute((0, 0, 0.5), (-length, 0, 0), **Y))
    pin = lierb.joints.JOINTS[loop](
        body_point=(0, 0, -0.5), parent_point=(0, 0, -1.0),
        **({} if loop == "spherical" else Y),
    )  # fmt: skip
    made = lierb.Mechanism(
        [crank, lierb.Link("coupler", BOX, coupler, "crank"), rocker],
        lierb.Loop("pin", pin, "rocker", "coupler"),
    )
    start = made.pose({"crank": 0.4, "coupler": np.pi / 2 - 0.4, "rocker": 0.4})
    return made, made.close(start)


def kept(prediction):
    return " ".join(
        name for name, e in zip(prediction.rows, prediction.rows_exact, strict=True) if e
    )


# ---- by hand -------------------------------------------------------------------------------------


def test_a_planar_double_pendulum_is_as_worked_out_by_hand():
    """docs/theory.md: the lower link's velocities, at all angles, are all of SE(2)'s."""
    found = lierb.predict(pendulum())
    groups = {c: [(p.group, p.dimension, kept(p)) for p in found[c].values()] for c in CSPACES}
    every = "d1 d2 d3 Omega1 Omega2"
    assert groups == {
        "reduced": [("SO(2)", 1, every), ("SO(2)", 1, every)],
        "SE3": [("SO(2)", 1, every), ("SO(2)×SE(2)", 4, "d3 Omega1 Omega2")],
        "SO3xR3": [
            ("SO(2)×R²", 3, "d3 Omega1 Omega2"),
            ("(SO(2)×R²)×(SO(2)×R²)", 6, "d3 Omega1 Omega2"),
        ],
    }
    assert [found[c].dimension for c in CSPACES] == [2, 4, 6]


def test_a_spatial_double_pendulum_keeps_nothing_of_its_inner_joint():
    found = lierb.predict(pendulum(axis=(1.0, 0.0, 0.0)))["SE3"]
    assert (found["lower"].group, found["lower"].dimension) == ("SO(2)×SE(3)", 7)
    assert kept(found["lower"]) == ""
    assert found["upper"].position_exact
    assert not found.position_exact


def test_a_planar_loop_keeps_its_rows_out_of_the_plane():
    made, pose = four_bar(1.8)
    found = lierb.predict(made, pose)
    assert kept(found["reduced"]["pin"]) == "d3 Omega1 Omega2"
    assert found["reduced"].rotation_exact
    assert [p.dimension for p in found["SE3"].values()] == [1, 4, 1, 4]
    across = lierb.predict(four_bar(1.8, "spherical")[0], pose)["reduced"]["pin"]
    assert kept(across) == "d2"  # in the links' axes, of which y is that of all pins


@pytest.mark.parametrize("update", slow_but(["local", "ambient"], "local"))
def test_a_parallelogram_is_kept_on_reduced_coordinates_alone(update):
    """Its angles move by (1, −1, 1): one subgroup of their product, on which all rows are kept.

    Angles about one axis are stepped alike in both updates.
    """
    made, pose = four_bar(2.0)
    found = lierb.predict(made, pose, update=update)
    assert found["reduced"]["pin"].position_exact
    assert (found["reduced"]["pin"].group, found["reduced"].dimension) == (
        "in SO(2)×SO(2)×SO(2)",
        1,
    )
    assert not found["SE3"]["pin"].position_exact
    assert not lierb.predict(*four_bar(1.8), update=update)["reduced"]["pin"].position_exact


def test_bodies_that_are_one_are_kept_together():
    """K is then {(g, D⁻¹gD)}, a subgroup of SE(3)², but none of SO(3)×R³ squared."""
    links = [
        lierb.Link("hull", BOX, lierb.joints.free()),
        lierb.Link("tank", BOX, lierb.joints.fixed(parent_point=(0.3, 0.1, 0.0)), "hull"),
    ]
    found = lierb.predict(lierb.Mechanism(links))
    assert (found["SE3"]["tank"].group, found["SE3"]["tank"].dimension) == ("in SE(3)×SE(3)", 6)
    assert found["SE3"].position_exact
    assert not found["SO3xR3"].position_exact
    assert found["SO3xR3"].rotation_exact


def test_reasons_are_told_joint_by_joint():
    made, pose = four_bar(1.8)
    found = lierb.predict(made, pose)
    assert str(found["SE3"]["coupler"]) == (
        "SE3: between moving bodies, coupler and crank; there K = SO(2)×SE(2); d3 Omega1 Omega2 "
        "constant on C₀K, so kept exactly; d1 d2 not constant there: drifts with the method's order"
    )
    assert "hangs on the ground" in found["SE3"]["crank"].reason
    assert "own coordinates, in SO(2)" in found["reduced"]["crank"].reason
    assert "closed by rows" in found["reduced"]["pin"].reason
    lines = str(found).splitlines()
    assert len(lines) == 1 + 4 * 3
    assert lines[0].startswith("joint    c-space  completion group")
    assert lines[-3].startswith("pin      reduced  SO(2)×SO(2)×SO(2)")
    assert len(str(found["SE3"]).splitlines()) == 5


# ---- one link, trees -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", slow_but(lierb.joints.JOINTS, "spherical", "universal", "screw"))
def test_one_link_is_a_body_on_its_joint(name):
    problem, _ = tilted(name)
    alone = lierb.predict(lierb.Mechanism(lierb.Link("body", problem.body, problem.joint)))
    for cspace, expected in lierb.predict(problem).items():
        found = alone[cspace]["body"]
        assert (found.group, found.rows_exact) == (expected.group, expected.rows_exact)


@pytest.mark.parametrize("shape", slow_but(samples.TREES, "chain", "branched"))
def test_reduced_coordinates_keep_every_joint_that_has_coordinates(shape):
    made, _ = samples.random_mechanism(np.random.default_rng(1), shape, n=1)
    found = lierb.predict(made.of_body(0), _first(samples.random_mechanism, shape))["reduced"]
    for link in made.links:
        if link.joint.subgroup or link.joint.factors or link.joint.name == "fixed":
            assert all(found[link.name].rows_exact)
        else:
            assert not all(found[link.name].rows_exact)


def _first(make, shape):
    _, sample = make(np.random.default_rng(1), shape, n=1)
    return {name: pose[0] for name, pose in samples.start_of(sample)["pose0"].items()}


SUBGROUPS = [n for n, e in lierb.joints.JOINTS.items() if e.subgroup]
ALIGNED = ("revolute", "prismatic", "planar", "translation")
PAIRS = [(a, b, True) for a in ALIGNED for b in ALIGNED] + [
    (a, SUBGROUPS[(k + 5) % len(SUBGROUPS)], False) for k, a in enumerate(SUBGROUPS)
]


def _algebra(joint):
    """Basis (k, 6) of a subgroup joint's algebra, in its own frame."""
    slots = slots_of(joint.rows)
    basis = np.eye(6)[[slot >= 0 for slot in slots]]
    basis[:, 5] += basis[:, 2] * joint.pitch * (slots[5] < -1)
    return basis


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second", "is_aligned"), PAIRS)
def test_se3_keeps_an_inner_joint_that_its_parent_s_motions_normalise(first, second, is_aligned):
    """{(g, D⁻¹gD h)} is a group if and only if g⁻¹Hg = H: an oracle without completion groups."""
    rng = np.random.default_rng(5)
    turns = [np.eye(3) if is_aligned else np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in "ab"]
    frames = []
    for turn in turns:
        frames.append(np.eye(4))
        frames[-1][:3, :3] = turn * np.linalg.det(turn)
        frames[-1][:3, 3] = rng.normal(size=3)
    options = {"pitch": PITCH, "length": LENGTH}
    joints = [
        lierb.joints.JOINTS[name](
            **frame, **{o: options[o] for o in lierb.joints.JOINTS[name].options & options.keys()}
        )
        for name, frame in (
            (first, {"body_frame": frames[0]}), (second, {"parent_frame": frames[1]}),
        )
    ]  # fmt: skip
    links = [lierb.Link("a", BOX, joints[0]), lierb.Link("b", BOX, joints[1], "a")]
    own, inner = map(_algebra, joints)
    seen = np.linalg.inv(frames[1]) @ frames[0]  # the first joint's frame, from the second's
    stays = True
    for weights in rng.normal(size=(4, len(own))):
        g = expm(_hat(weights @ own))
        g = seen @ g @ np.linalg.inv(seen)
        moved = np.array([_vee(g @ _hat(h) @ np.linalg.inv(g)) for h in inner]).reshape(-1, 6)
        rank = np.linalg.matrix_rank(np.vstack([inner, moved]), tol=1e-9)
        stays &= rank == len(inner)
    found = lierb.predict(lierb.Mechanism(links))["SE3"]["b"]
    assert all(found.rows_exact) == stays


def _hat(x):
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]]
    matrix[:3, 3] = x[3:]
    return matrix


def _vee(m):
    return np.array([m[2, 1], m[0, 2], m[1, 0], *m[:3, 3]])


# ---- units, places, what is refused --------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-6, 1e4])
def test_predictions_of_mechanisms_do_not_depend_on_the_unit_of_length(size):
    expected = str(lierb.predict(pendulum(axis=(1.0, 0.0, 0.0))))
    assert str(lierb.predict(pendulum(axis=(1.0, 0.0, 0.0), size=size))) == expected


def test_predictions_far_from_the_origin_are_the_same():
    expected = str(lierb.predict(pendulum()))
    assert str(lierb.predict(pendulum(away=(1e6, -1e6, 0.0)))) == expected


def test_so3xr3_wants_every_body_at_its_centre_of_mass():
    assert list(lierb.predict(pendulum(com=(0.0, 0.0, 0.1)))) == ["reduced", "SE3"]


def test_constraints_between_links_have_entries_of_their_own():
    @lierb.constraint(length=0.5)
    def rope(R, r, params):
        return (r @ r / params.length - params.length) / 2

    held = lierb.Mechanism(
        [lierb.Link("a", BOX, lierb.joints.free()), lierb.Link("b", BOX, lierb.joints.free())],
        constraints=rope().on("b", "a"),
    )
    found = lierb.predict(held, held.close(held.pose({"b": (0, 0, 0, 0.5, 0, 0)})))
    assert list(found["SE3"]) == ["a", "b", "rope"]
    assert found["SE3"]["rope"].rows_exact == (False,)
    assert found["reduced"]["a"].reason.endswith("there are no constraints")


def test_a_motor_s_speed_is_no_row_of_the_pose():
    driven = lierb.Mechanism(pendulum().links, forces=lierb.forces.motor(speed=1.0).on("lower"))
    assert str(lierb.predict(driven)) == str(lierb.predict(pendulum()))


def test_batches_of_mechanisms_are_refused():
    joint = lierb.joints.revolute(body_point=np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match=r"mechanism\.of_body\(0\)"):
        lierb.predict(lierb.Mechanism(lierb.Link("a", BOX, joint)))
    several = pendulum().pose({"upper": [0.0, 0.1]})
    with pytest.raises(ArgumentError, match="one pose of each link"):
        lierb.predict(pendulum(), several)


def test_an_open_joint_is_told_by_name():
    open_pose = pendulum().pose() | {"lower": np.eye(4)}
    with pytest.raises(PoseError, match=r"the joint of lower .* mechanism\.close"):
        lierb.predict(pendulum(), open_pose)


def test_a_loop_that_closes_up_to_rounding_moves_all_the_same():
    """Its pivot is 1e-10 m out of the plane: no configuration closes it further."""
    made, pose = four_bar(1.8)
    links = list(made.links)
    links[2] = lierb.Link("rocker", BOX, lierb.joints.revolute((0, 0, 0.5), (-1.8, 1e-10, 0), **Y))
    lifted = {**pose, "rocker": pose["rocker"].copy()}
    lifted["rocker"][1, 3] += 1e-10
    found = lierb.predict(lierb.Mechanism(links, made.loops), lifted)
    assert [p.dimension for p in found["SE3"].values()] == [1, 4, 1, 4]
    assert kept(found["reduced"]["pin"]) == "d3 Omega1 Omega2"


def test_a_structure_that_only_shakes_is_told():
    """A bar of two halves, stretched between two pivots: it gives way, but only infinitesimally."""
    left = lierb.Link("left", BOX, lierb.joints.revolute((0, 0, 0.25), **Y))
    middle = lierb.joints.revolute((0, 0, 0.25), parent_point=(0, 0, -0.25), **Y)
    right = lierb.Link("right", BOX, middle, "left")
    end = lierb.Loop("end", lierb.joints.revolute((0, 0, -0.25), (0.0, 0.0, -1.0), **Y), "right")
    stretched = lierb.Mechanism([left, right], end)
    with pytest.raises(PoseError, match="singular configuration"):
        lierb.predict(stretched, stretched.pose())


# ---- against the measured drift ------------------------------------------------------------------


@pytest.mark.slow
def test_the_worked_example_drifts_as_predicted():
    """docs/theory.md's numbers: RK4's fourth order, in what is said to drift, and nothing else."""
    made = pendulum()
    made = lierb.Mechanism(made.links, gravity=(0.0, 0.0, -9.81))
    pose0 = made.pose({"upper": np.pi / 2})
    errors = []
    for dt in (1e-2, 5e-3):
        run = lierb.integrate(
            made, pose0=pose0, twist0=made.twist(pose=pose0), dt=dt, t_end=1.0, cspace="SE3"
        )
        errors.append(run.summary["lower.position_error_max"][0].as_py())
        assert run.summary["upper.position_error_max"][0].as_py() < 1e-15
        assert run.summary["lower.rotation_error_max"][0].as_py() < 1e-15
    assert [f"{e:.1e}" for e in errors] == ["9.4e-06", "5.9e-07"]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def _stored():
    stored = max((BENCH / "results").glob("predictions-*.json"))
    return json.loads(stored.read_text(encoding="utf-8"))


def test_predictions_agree_with_the_stored_drift():
    stored = _stored()["mechanisms"]
    assert len(stored) >= 50
    assert set(stored) == set(bench.shapes())
    assert {name: wrong for name, x in stored.items() if (wrong := bench.disagreements(x))} == {}
    verdicts = [k["exact"] for x in stored.values() for c in x.values() for j in c.values()
                for k in j.values()]  # fmt: skip
    assert 0.3 < np.mean(verdicts) < 0.8  # both verdicts occur


def test_theory_shows_the_stored_drift_of_mechanisms():
    page = (BENCH.parent / "docs" / "theory.md").read_text(encoding="utf-8")
    page = " ".join(page[page.index("[bench/predictions.py]") :].split())
    mechanisms = _stored()["mechanisms"]
    told = [
        kind
        for found in mechanisms.values()
        for joints in found.values()
        for kinds in joints.values()
        for kind in kinds.values()
    ]
    exact = [kind for kind in told if kind["exact"]]
    drifting = [kind for kind in told if not kind["exact"]]
    assert f"measured {len(mechanisms)} mechanisms" in page
    assert f"Of {len(told)} errors" in page
    assert f"{len(exact)} were predicted to be exact" in page
    assert f"{len(drifting)} were predicted to drift" in page
    assert "stayed below 3.9e-15" in page
    assert max(kind["largest"] for kind in exact) < 3.9e-15
    assert "were 5.6e-12 or more" in page
    assert f"{min(kind['least'] for kind in drifting):.1e}" == "5.6e-12"
    assert "2^1.99 to 2^2.03" in page
    orders = [kind["order"] for kind in drifting]
    assert 1.99 < min(orders) <= max(orders) < 2.03


QUICK = ("revolute, revolute", "planar, prismatic", "cylindrical, hook; spherical", "four_bar")
LONG = ("branched", "star", "sliding", "loosely", "two_loops")  # each takes longer than the others
SLOW = [name for name in bench.shapes() if name not in LONG]


@pytest.mark.parametrize("name", tiered(bench.shapes(), QUICK, SLOW))
def test_predictions_are_the_stored_ones(name):
    stored = _stored()["mechanisms"][name]
    found = bench.predicted(name)
    assert found == {
        cspace: {
            joint: {kind: told["exact"] for kind, told in kinds.items()}
            for joint, kinds in joints.items()
        }
        for cspace, joints in stored.items()
    }


@pytest.mark.parametrize("cspace", long_but(CSPACES, "SE3"))
@pytest.mark.parametrize(
    "name",
    long_but(["revolute, universal; point_on_sphere", "planar, prismatic"], "planar, prismatic"),
)
def test_predictions_agree_with_the_measured_drift(name, cspace):
    errors = bench.measured(name, cspace)
    for joint, exact in bench.predicted(name)[cspace].items():
        for kind, is_exact in exact.items():
            assert bench.agrees(is_exact, errors[joint][kind]), (joint, kind)

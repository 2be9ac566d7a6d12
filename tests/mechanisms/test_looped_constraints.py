"""Loops, motors and constraints of trees in memory, beside the formulas of unrolled code on NumPy's
numbers, which solve for the response of the whole tree to each row; closed forms.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lierb
from lierb.compiler.entries import kernels_loaded
from lierb.errors import FailedTrajectoryWarning
from lierb.runs import lane_engine
from lierb.runs.options import Options
from lierb.runs.starts import ready
from mechanisms import samples
from mechanisms.benchmarks import a02
from mechanisms.shared import bits, stepped
from mechanisms.test_tree_loop import body, frame, part, start_of, tree_of

G0 = 9.81
DT, STEPS = 2e-3, 10
RECORDED = {"save_every": STEPS, "record": ("state", "energy", "multipliers", "reaction")}
# Rounding of ten steps and of the accelerations at their end, in each of two ways; λ of near
# singular rows amplifies it.
CLOSE, FORCES = {"rtol": 1e-12, "atol": 1e-12}, 1e-11


def looped(mechanism, start, **options):
    options = {"dt": DT, "t_end": DT * STEPS, "solver": "looped"} | options
    return lierb.integrate(mechanism, **start, **options)


class ByFormulas:
    """Ten steps of one trajectory by the formulas of unrolled code."""

    def __init__(self, mechanism, start, trajectory, method="RK4", stabilise=None):
        options = Options.of(
            mechanism, dt=DT, t_end=DT * STEPS, method=method, solver="unrolled",
            stabilise=stabilise,
        )  # fmt: skip
        run = ready(mechanism, options, **start)
        numbers = run.inputs.numbers(trajectory)
        system, constants, state = stepped(run, numbers, DT, STEPS)
        found = system.in_user_frames(constants, numbers, state)
        self.states = dict(zip(mechanism.names, (np.array(x, float) for x in found), strict=True))
        multipliers, wrenches = system.forces(constants, state, DT * STEPS)
        self.multipliers = np.array(multipliers, float)
        self.wrenches = np.array(wrenches, float)
        self.work = float(state.work)


def last_row(result, trajectory):
    history = result.history
    times, trajectories = (history[name].to_numpy() for name in ("t", "trajectory"))
    (row,) = np.flatnonzero((trajectories == trajectory) & (times == times.max()))
    return {name: history[name][int(row)].as_py() for name in history.column_names}


def agree(mechanism, start, **options):
    result = looped(mechanism, start, **RECORDED, **options)
    assert set(result.summary["status"].to_pylist()) == {"ok"}
    for trajectory in (0, len(result.summary) - 1):
        expected = ByFormulas(mechanism, start, trajectory, **options)
        row = last_row(result, trajectory)
        for name, numbers in expected.states.items():
            found = [np.ravel(row[f"{name}.{x}"]) for x in ("rotation", "position", "omega", "v")]
            np.testing.assert_allclose(np.concatenate(found), numbers, **CLOSE)
        largest = np.abs(expected.wrenches).max()
        reactions = [row[name] for name in row if name.endswith(".reaction")]
        np.testing.assert_allclose(reactions, expected.wrenches, atol=FORCES * largest, rtol=0)
        lambdas = [np.atleast_1d(row[name]) for name in row if name.endswith(".lambda")]
        np.testing.assert_allclose(
            np.concatenate(lambdas), expected.multipliers, atol=FORCES * largest, rtol=0
        )
        assert abs(row.get("work", 0.0) - expected.work) < 1e-12 * max(1.0, abs(expected.work))
    return result


def shape(name, seed=3, **options):
    mechanism, sample = samples.random_mechanism(np.random.default_rng(seed), name, **options)
    return mechanism, samples.start_of(sample)


def chain(links, count=5, forces=(), pins=1):
    """A chain of revolute links with points of the last ones on the ground, at rest."""
    rng, names, made = np.random.default_rng(links), [], []
    for i in range(links):
        joint = lierb.joints.revolute(body_frame=frame(rng), parent_frame=frame(rng))
        made.append(lierb.Link(f"link{i}", body(rng), joint, names[-1] if names else "ground"))
        names.append(f"link{i}")
    opened = lierb.Mechanism(made)
    pose0 = opened.pose({name: rng.uniform(-1.0, 1.0, (count, 1)) for name in names})
    loops = []
    for name in names[-pins:]:
        point = (0.1, -0.05, 0.2) + 0.01 * rng.normal(size=(count, 3))
        place = np.einsum("nij,nj->ni", pose0[name][:, :3, :3], point) + pose0[name][:, :3, 3]
        pin = lierb.joints.spherical(body_point=point, ground_point=place)
        loops.append(lierb.Loop(f"pin_{name}", pin, name))
    mechanism = lierb.Mechanism(made, loops, gravity=(0.4, -0.3, -9.81), forces=forces)
    return mechanism, {"pose0": pose0, "twist0": mechanism.twist({}, pose0)}


def windows(count):
    given = a02(count)
    return given.mechanism, given.start


# ---- the same motion and the same forces -------------------------------------------------------


# In the default tests usual loops have Baumgarte's terms, motors and constraints projection: each
# is a kernel of its own, and one without either shows nothing that these do not.
KEPT = lierb.baumgarte(5.0, 4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "stabilise",
    [KEPT, pytest.param(None, marks=pytest.mark.long)],
    ids=["Baumgarte", "drifting"],
)
@pytest.mark.parametrize(
    "case",
    [
        lambda: shape("four_bar"), lambda: shape("slider_crank"), lambda: shape("rssr"),
        lambda: chain(8), lambda: chain(9, pins=2), lambda: windows(3),
    ],
    ids=["redundant four-bar", "slider-crank", "rssr", "pinned", "pinned twice", "three windows"],
)  # fmt: skip
def test_loops_move_and_react_as_by_unrolled_formulas(case, stabilise):
    agree(*case(), stabilise=stabilise)


@pytest.mark.slow
def test_mechanisms_with_usual_loops_share_their_code():
    looped(*shape("four_bar"), **RECORDED, stabilise=KEPT)
    before = kernels_loaded()
    looped(*chain(8), **RECORDED, stabilise=KEPT)
    assert kernels_loaded() == before


@pytest.mark.long
@pytest.mark.parametrize("name", ["two_loops", pytest.param("many_loops", marks=pytest.mark.long)])
def test_other_joints_close_loops_as_by_unrolled_formulas(name):
    agree(*shape(name))


@lierb.constraint(radius=0.5)
def on_a_sphere(R, r, params):
    return (r @ r / params.radius - params.radius) / 2


def driven():
    """A four-bar with a motor at its crank and a spring in its loop's joint; a drag; and a body on
    a sphere about a point of the coupler.
    """
    rng = np.random.default_rng(5)
    given, start = shape("four_bar")
    mechanism = lierb.Mechanism(
        [*given.links, lierb.Link("bob", body(rng), lierb.joints.free())], given.loops,
        gravity=given.gravity,
        forces=[
            lierb.forces.motor(speed=lambda t, params: params.rate * (1.0 + t * t), rate=1.5)
            .on("link0"),
            lierb.forces.torsional_spring(stiffness=2.0, damping=0.1).on("loop0"),
            lierb.forces.drag(linear=0.2, angular=0.1).on("link2"),
        ],
        constraints=[on_a_sphere().on("bob", "link1")],
    )  # fmt: skip
    place = np.eye(4)
    place[:3, 3] = (0.3, 0.0, 0.4)
    pose0 = start["pose0"] | {"bob": start["pose0"]["link1"] @ place}
    twist0 = start["twist0"] | {"bob": rng.normal(size=(4, 6))}
    return mechanism, {"pose0": pose0, "twist0": mechanism.project(twist0, pose0)}


@pytest.mark.long
@pytest.mark.parametrize("stabilise", ["project", KEPT], ids=["projected", "Baumgarte"])
def test_motors_constraints_and_forces_in_loops_act_as_by_unrolled_formulas(stabilise):
    agree(*driven(), stabilise=stabilise)


# ---- the number of dependent rows --------------------------------------------------------------


@pytest.mark.long
def test_rows_that_contradict_each_other_end_a_trajectory():
    """Two motors drive the crank of a four-bar: at one speed they agree, then not."""
    given, start = shape("four_bar")
    speed = lambda t, params: params.rate * t
    motors = [lierb.forces.motor(speed=speed, rate=x).on("link0") for x in (1.0, [1.0, 1, 2, 1])]
    mechanism = lierb.Mechanism(given.links, given.loops, forces=motors)
    rest = start | {"twist0": {name: np.zeros(6) for name in mechanism.names}}
    with pytest.warns(FailedTrajectoryWarning):
        result = looped(mechanism, rest, **RECORDED)
    assert result.summary["status"].to_pylist() == ["ok", "ok", "singular", "ok"]


@pytest.mark.long
def test_windows_that_lie_down_have_another_rank():
    """Rows that depend on others for one moment are told apart from those that always do."""
    angle = np.array([0.5 * np.pi, 0.3])  # lying, and on the way
    mechanism, _ = windows(2)
    turned, names = [], mechanism.names
    for phi in angle:
        pose = {n: np.eye(4) for n in names}
        c, s = np.cos(phi), np.sin(phi)
        for n in names:
            i = int(n.removeprefix("crank").removeprefix("bar"))
            if n.startswith("crank"):
                pose[n][:2, :2], pose[n][:2, 3] = [[c, s], [-s, c]], (i + 0.5 * s, 0.5 * c)
            else:
                pose[n][:2, 3] = i - 0.5 + s, c
        turned.append(pose)
    pose0 = {n: np.stack([pose[n] for pose in turned]) for n in names}
    result = looped(mechanism, {"pose0": pose0, "twist0": mechanism.twist(None, pose0)})
    found = result.summary["status"].to_pylist()
    same = lierb.integrate(
        mechanism, pose0=pose0, twist0=mechanism.twist(None, pose0), dt=DT, t_end=DT * STEPS,
        solver="unrolled",
    )  # fmt: skip
    assert found == same.summary["status"].to_pylist()


# ---- projection, adaptive steps ----------------------------------------------------------------

TIGHT = {"dt": None, "rtol": 1e-9, "atol": 1e-9, "t_end": 0.2, "method": "Tsit5",
         "stabilise": "project"}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    "case",
    [pytest.param(lambda: shape("four_bar"), marks=pytest.mark.long), lambda: chain(9, pins=2)],
)
def test_projections_move_as_by_unrolled_formulas(case):
    agree(*case(), stabilise="project")


@pytest.mark.long
def test_adaptive_steps_keep_loops_closed_and_reach_the_motion_of_small_steps():
    mechanism, start = chain(8)
    found = looped(mechanism, start, **TIGHT)
    fine = looped(mechanism, start, dt=1e-4, t_end=0.2)
    assert max(found.summary["position_error_max"].to_pylist()) < 1e-13  # m, of rods of 0.3 m
    np.testing.assert_allclose(found["link7"].position, fine["link7"].position, atol=1e-8)


@pytest.mark.long
def test_bits_of_projected_adaptive_steps_depend_on_nothing_else(monkeypatch):
    mechanism, start = chain(8, count=11)
    found = looped(mechanism, start, **TIGHT)
    expected = bits(found)
    order = np.random.default_rng(2).permutation(11)

    def taken(which):
        links = [
            lierb.Loop(x.name, lierb.joints.spherical(
                body_frame=x.joint.body_frame[which], ground_frame=x.joint.ground_frame[which]
            ), x.body) for x in mechanism.loops
        ]  # fmt: skip
        other = lierb.Mechanism(mechanism.links, links, gravity=mechanism.gravity)
        return bits(looped(other, part(start, which), **TIGHT))

    np.testing.assert_array_equal(taken(order), expected[order])
    np.testing.assert_array_equal(taken([4]), expected[[4]])
    np.testing.assert_array_equal(bits(looped(mechanism, start, **TIGHT, threads=2)), expected)
    monkeypatch.setattr(lane_engine, "FIRST_ITERATIONS", 1)
    monkeypatch.setattr(lane_engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(bits(looped(mechanism, start, **TIGHT)), expected)


@pytest.mark.long
def test_a_run_goes_on_with_the_rank_of_its_start():
    mechanism, start = shape("four_bar")
    whole = looped(mechanism, start, t_end=0.04)
    first = looped(mechanism, start, t_end=0.02)
    rest = looped(mechanism, {}, t_end=0.04, **first.end)
    for name in mechanism.names:
        np.testing.assert_array_equal(rest[name].position, whole[name].position)


@pytest.mark.slow
def test_a_trajectory_that_fails_leaves_the_others_alone():
    mechanism, start = shape("four_bar")
    options = RECORDED | {"stabilise": KEPT}
    expected = bits(looped(mechanism, start, **options))
    for twists in start["twist0"].values():
        twists[2] *= 1e120
    with pytest.warns(FailedTrajectoryWarning):
        result = looped(mechanism, start, **options)
    fine = [0, 1, 3]
    assert result.summary["status"].to_pylist()[2] != "ok"
    np.testing.assert_array_equal(bits(result)[fine], expected[fine])


# ---- a closed form -----------------------------------------------------------------------------


@pytest.mark.long
def test_forty_windows_move_as_one_pendulum():
    """A02 of the IFToMM library (`benchmarks.a02`) with N = 40: 81 links, 40 loops, 20 s.

    In the motion with parallel cranks, N + 1 cranks have the energy (1/3) φ̇²/2 + g cos φ/2 each,
    and N bars, which only move along, φ̇²/2 + g cos φ: ((N+1)/3 + N) φ̈ = ((N+1)/2 + N) g sin φ.
    The windows lie down, where the rank falls, 20 times in 20 s; each time is passed within a step.
    """
    count, mechanism_start = 40, windows(40)
    inertia, moment = (count + 1) / 3 + count, (count + 1) / 2 + count
    result = looped(*mechanism_start, dt=2.5e-3, t_end=20.0, method="Tsit5", stabilise="project")
    rate = lambda t, y: (y[1], moment / inertia * G0 * np.sin(y[0]))
    y = solve_ivp(rate, (0.0, 20.0), (0.0, 1.0), method="DOP853", rtol=1e-13, atol=1e-13).y
    phi = y[0, -1]
    assert phi > 20 * np.pi
    for i in range(count + 1):
        place = i + 0.5 * np.sin(phi), 0.5 * np.cos(phi), 0.0
        # Measured: 6e-11 m. Rounding grows where the rank falls; see docs/decisions/trees.md.
        np.testing.assert_allclose(result[f"crank{i}"].position[0], place, rtol=0, atol=1e-9)


# ---- motion as given ---------------------------------------------------------------------------


@lierb.velocity_constraint
def blade(omega, v):
    return v[1] + 0.1 * omega[0]


@pytest.mark.long
def test_given_motions_and_constraints_on_velocities_act_as_in_unrolled_formulas():
    """The counted turns of the driven joint are its position, beyond one turn."""
    base = tree_of(("revolute", "spherical", "revolute", "revolute"), seed=3)
    motor = lierb.forces.motor(position=lambda t: 0.3 + 80.0 * t).on("link0")
    given = {"gravity": base.gravity, "forces": motor, "constraints": blade().on("link2")}
    mechanism = lierb.Mechanism(base.links, **given)
    start = start_of(mechanism)
    pose0 = mechanism.close(start["pose0"])
    start = {"pose0": pose0, "twist0": mechanism.project(start["twist0"], pose0)}
    agree(mechanism, start)
    counted = lierb.turns(start=0.3).on("link0")
    result = looped(lierb.Mechanism(base.links, **given, states=counted), start)
    turned = np.array(result.summary["turned"].to_pylist())
    np.testing.assert_allclose(turned, 0.3 + 80.0 * DT * STEPS, rtol=0, atol=1e-12)

"""A run that goes on where another one ended, and runs that start at another time than 0."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from cases import GRAVITY, RECORD, box, column, integrate, joint, tilted

import lierb
from lierb.errors import (
    ArgumentError,
    FailedTrajectoryWarning,
    PoseError,
    TimeGridError,
    TwistError,
)
from lierb.kernels.stepping.clock import TIDY_EVERY
from lierb.runs import continuation, engine

DT = 1e-2
STEPS = 100
STATE = ("rotation", "position", "omega", "v")
# Joint and options: a unit quaternion and momenta in principal axes; a screw, tidied in its
# own way, on a chart that carries on; the saddle point, with and without such a chart.
FORMS = [
    ("spherical", {}),
    pytest.param("screw", {"update": "global"}, marks=pytest.mark.slow),
    ("spherical", {"cspace": "SO3xR3"}),
    pytest.param("spherical", {"cspace": "SO3xR3", "update": "global"}, marks=pytest.mark.slow),
    pytest.param("cylindrical", {"update": "ambient"}, marks=pytest.mark.slow),
]


def bits(summary) -> np.ndarray:
    """Time and state of every trajectory, as integers."""
    rows = [column(summary, name).reshape(summary.num_rows, -1) for name in ("t", *STATE)]
    return np.concatenate(rows, axis=1).view(np.int64)


def lively(name: str):
    """Batch of slow bodies, fast ones, and ones too fast for small-angle steps."""
    problem, twist = tilted(name)
    return problem, np.outer((0.02, 1.0, 4.0), twist)


def run(problem, steps: int, **options) -> lierb.Result:
    """Run from a start to a number of steps counted from 0."""
    return integrate(problem, **({"dt": DT, "t_end": steps * DT} | options))


@pytest.mark.parametrize(("name", "options"), FORMS, ids=str)
def test_end_goes_on_to_the_bits_of_one_run(name, options):
    problem, twist0 = lively(name)
    whole = run(problem, STEPS, twist0=twist0, **options)
    for steps in (1, 17, TIDY_EVERY, 2 * TIDY_EVERY + 5):  # at any step, not those of tidying alone
        first = run(problem, steps, twist0=twist0, **options)
        second = run(problem, STEPS, **first.end, **options)
        np.testing.assert_array_equal(bits(second.summary), bits(whole.summary))
    # Turned to the user's frames and back, a state is not the same: the end has to remember more.
    plain = first.end | {name: np.array(first.end[name]) for name in ("pose0", "twist0")}
    unchecked = {"check": "off"} if "cspace" in options else {}  # it has drifted
    again = run(problem, STEPS, **plain, **options, **unchecked)
    assert (bits(again.summary) != bits(whole.summary)).any()


def test_end_goes_on_end_after_end():
    problem, twist0 = lively("spherical")
    whole = run(problem, STEPS, twist0=twist0)
    part = run(problem, 7, twist0=twist0)
    for steps in (8, 29, 30, 64, STEPS):
        part = run(problem, steps, **part.end)
    np.testing.assert_array_equal(bits(part.summary), bits(whole.summary))


def test_end_goes_on_in_any_chunks(monkeypatch):
    problem, twist0 = lively("spherical")
    twist0 = np.tile(twist0, (5, 1))
    whole = bits(run(problem, STEPS, twist0=twist0).summary)
    monkeypatch.setattr(engine, "CHUNK_BODIES", 4)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 3)
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    first = run(problem, 17, twist0=twist0)
    np.testing.assert_array_equal(bits(run(problem, STEPS, **first.end).summary), whole)


@lierb.wrench(ahead=0.0)
def gust(t, R, r, omega, v, params):
    """A force that knows the time, and that does work."""
    return (0.0, 0.0, 0.0), 3.0 * np.cos(7.0 * (t + params.ahead)) * R[0]


@pytest.mark.slow
@pytest.mark.parametrize("t0", [0.0, 0.1234567, -2.0])
def test_end_goes_on_with_its_clock(t0):
    plain, twist0 = lively("spherical")
    problem = lierb.Problem(plain.body, plain.joint, GRAVITY, gust())
    options = {"dt": DT, "save_every": 1, "record": (*RECORD, "energy")}
    whole = lierb.integrate(problem, twist0=twist0, t0=t0, t_end=t0 + STEPS * DT, **options)
    first = lierb.integrate(problem, twist0=twist0, t0=t0, t_end=t0 + 17 * DT, **options)
    second = lierb.integrate(problem, **first.end, t_end=t0 + STEPS * DT, **options)
    np.testing.assert_array_equal(bits(second.summary), bits(whole.summary))
    rows = whole.history.slice(17 * len(twist0))
    for name in ("t", *STATE, "energy"):
        np.testing.assert_array_equal(column(second.history, name), column(rows, name))
    # The second run's own: from its start on
    work = column(rows, "work").reshape(-1, len(twist0))
    np.testing.assert_allclose(
        column(second.history, "work").reshape(work.shape), work - work[0], atol=1e-13
    )
    assert second.history["energy_drift"][0].as_py() == 0.0


@pytest.mark.slow
def test_work_does_not_depend_on_calls_neighbours_or_history(monkeypatch):
    plain, twist0 = lively("spherical")
    problem = lierb.Problem(plain.body, plain.joint, GRAVITY, gust())

    def found(twists, **options):
        summary = run(problem, STEPS, twist0=twists, measure_every=10, **options).summary
        return [column(summary, name) for name in ("work_final", "energy_drift_max")]

    expected = found(twist0)
    assert (np.abs(expected[0]) > 1e-3).all()
    np.testing.assert_array_equal(found(twist0, save_every=7, record=(*RECORD, "energy")), expected)
    alone = [np.concatenate(pair) for pair in zip(*(found(t) for t in twist0), strict=True)]
    np.testing.assert_array_equal(alone, expected)
    monkeypatch.setattr(engine, "CHUNK_BODIES", 2)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 3)
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(found(twist0), expected)


@pytest.mark.slow
def test_start_time_is_that_of_forces():
    """A gust from 2 s on is one from 0 s on that is 2 s ahead, and not one that is not."""
    plain, twist0 = lively("spherical")
    omegas = {}
    for name, ahead, t0 in (("at 2", 0.0, 2.0), ("ahead", 2.0, 0.0), ("at 0", 0.0, 0.0)):
        problem = lierb.Problem(plain.body, plain.joint, GRAVITY, gust(ahead=ahead))
        result = integrate(problem, twist0=twist0, dt=DT, t0=t0, t_end=t0 + 0.5)
        np.testing.assert_array_equal(result.summary["t"], [t0 + 0.5] * len(twist0))
        omegas[name] = column(result.summary, "omega")
    # t is rounded otherwise: 1e-15 of some rad/s, over 50 steps
    np.testing.assert_allclose(omegas["at 2"], omegas["ahead"], atol=1e-11)
    assert np.abs(omegas["at 2"] - omegas["at 0"]).max() > 1e-3


def swaying(t):
    return 1.0 + math.sin(t)


@pytest.mark.slow
def test_start_time_is_that_of_a_motor_speed():
    held = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    motor = lierb.forces.motor(speed=swaying)
    problem = lierb.Problem(box(), held, forces=motor)
    twist0 = problem.project(np.zeros(6), t0=2.0)
    np.testing.assert_allclose(twist0[1], 1.0 + math.sin(2.0), rtol=1e-15)  # its own rounding
    options = {"twist0": twist0, "dt": DT}
    result = lierb.integrate(problem, t0=2.0, t_end=2.5, **options)
    speed = result.summary["omega"][0].as_py()[1]
    assert speed == pytest.approx(1.0 + math.sin(2.5), abs=1e-10)  # RK4's own at 1e-2
    with pytest.raises(TwistError, match=r"rotation rate 0\.909 .*motor: 0\.909"):  # sin 2
        lierb.integrate(problem, t_end=0.5, **options)


# ---- states, controllers and clocks of their own -----------------------------------------------


@lierb.states(turned=0.0)
def odometer(omega):
    return {"turned": omega[2]}


@lierb.controller(every=0.25, memory={"total": 0.0}, gain=0.01)
def brake(omega, params, memory, states):
    total = memory.total + omega[0] + 0.1 * lierb.noise.normal("gyro") + 0.01 * states.turned
    return {"torque": -params.gain * (omega + 0.05 * total)}, {"total": total}


@lierb.wrench
def braking(t, R, r, omega, v, controls):
    return controls.torque, (0.0, 0.0, 0.0)


def braked(**changed) -> tuple[lierb.Problem, np.ndarray]:
    plain, twist = tilted("spherical")
    twist0 = np.outer((0.02, 0.5, 1.0), twist)
    problem = lierb.Problem(
        plain.body, plain.joint, GRAVITY, braking(), states=odometer(), controllers=brake(**changed)
    )
    return problem, twist0


OWN = ("turned", "torque")
CLOCKS = [
    {"dt": 0.0625},  # ends at every tick of itself
    pytest.param({"dt": 0.1}, marks=pytest.mark.long),  # is cut short by ticks
    pytest.param({"rtol": 1e-4, "method": "BS32"}, marks=pytest.mark.long),
]


@pytest.mark.slow
@pytest.mark.parametrize("options", CLOCKS, ids=str)
def test_end_at_a_tick_goes_on_with_states_memory_and_clocks(options):
    problem, twist0 = braked()
    options = {"cspace": "reduced", "seed": 3} | options
    whole = lierb.integrate(problem, twist0=twist0, t_end=4.0, **options).summary
    part = lierb.integrate(problem, twist0=twist0, t_end=0.5, **options)
    steps = column(part.summary, "steps")
    for t_end in (3.0, 4.0):  # both have more steps than rounding is left for
        part = lierb.integrate(problem, **part.end, t_end=t_end, **options)
        steps = steps + column(part.summary, "steps")
    np.testing.assert_array_equal(bits(part.summary), bits(whole))
    for name in (*OWN, "dt_last"):
        np.testing.assert_array_equal(column(part.summary, name), column(whole, name))
    np.testing.assert_array_equal(steps, column(whole, "steps"))
    assert steps.max() > TIDY_EVERY


@pytest.mark.slow
def test_end_goes_on_with_other_gains():
    """Controllers keep their memory as long as its meaning is the same."""
    problem, twist0 = braked()
    options = {"cspace": "reduced", "dt": 0.0625}
    first = lierb.integrate(problem, twist0=twist0, t_end=0.5, **options)
    stronger, _ = braked(gain=0.02)
    further = lierb.integrate(stronger, **first.end, t_end=0.5625, **options).summary
    for name in OWN[1:]:  # held until the next tick
        np.testing.assert_array_equal(column(further, name), column(first.summary, name))
    assert (np.abs(column(further, "turned")) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        lambda end: {"twist0": 0.5 * end["twist0"]},
        lambda end: {"problem": braked(every=0.5)[0]},
        lambda end: {"cspace": "SO3xR3"},
    ],
    ids=["twist", "period", "cspace"],
)
def test_end_that_would_lose_states_is_refused(change):
    problem, twist0 = braked()
    options = {"problem": problem, "cspace": "reduced", "dt": 0.0625}
    end = lierb.integrate(**options, twist0=twist0, t_end=0.5).end
    with pytest.raises(ArgumentError, match="turned, torque beside the motion"):
        lierb.integrate(**(options | end | change(end)), t_end=1.0)


@pytest.mark.slow
def test_end_of_fixed_steps_goes_on_with_clocks_of_lanes():
    """Both kinds of clocks count the same steps."""
    problem, twist0 = lively("spherical")
    whole = run(problem, STEPS, twist0=twist0)
    first = run(problem, 17, twist0=twist0)
    second = run(problem, 2 * TIDY_EVERY, **first.end, max_steps=STEPS)
    third = run(problem, STEPS, **second.end)
    np.testing.assert_array_equal(bits(third.summary), bits(whole.summary))


# ---- what an end is taken for ------------------------------------------------------------------


def drifted() -> tuple[lierb.Problem, lierb.Result]:
    """A run on SO(3)×R³ that has left its joint by more than a start may."""
    problem, twist0 = lively("spherical")
    result = run(problem, STEPS, twist0=twist0, cspace="SO3xR3")
    assert max(result.summary["position_error_final"].to_pylist()) > 1e-5
    return problem, result


def test_end_that_has_drifted_is_accepted_where_it_goes_on():
    problem, result = drifted()
    further = run(problem, 2 * STEPS, **result.end, cspace="SO3xR3")
    assert further.summary["status"].to_pylist() == ["ok"] * 3


@pytest.mark.parametrize(
    "change",
    [
        lambda end: {"pose0": end["pose0"].copy()},
        lambda end: {"pose0": end["pose0"][:]},
        lambda end: {"pose0": 1.0 * end["pose0"]},
        lambda end: {"twist0": 0.5 * end["twist0"]},
        lambda end: {"t0": 0.0},
        lambda end: {"cspace": "SE3"},
    ],
    ids=["copy", "slice", "product", "twist", "time", "cspace"],
)
def test_what_is_made_of_a_drifted_end_is_a_start_like_any_other(change):
    problem, result = drifted()
    given = {**result.end, "cspace": "SO3xR3"} | change(result.end)
    with pytest.raises(PoseError, match="does not close the spherical joint"):
        run(problem, 2 * STEPS, **given)


def test_end_does_not_go_on_with_another_joint():
    problem, result = drifted()
    elsewhere = lierb.Problem(problem.body, joint("spherical", body_frame=np.eye(4)), GRAVITY)
    with pytest.raises(PoseError, match="does not close the spherical joint"):
        run(elsewhere, 2 * STEPS, **result.end, cspace="SO3xR3")


def test_end_goes_on_under_other_forces():
    """Gravity is switched off: what remembers the state is the body on its joint."""
    problem, result = drifted()
    weightless = lierb.Problem(
        lierb.Body(problem.body.mass, problem.body.inertia), joint("spherical")
    )
    further = run(weightless, 2 * STEPS, **result.end, cspace="SO3xR3")
    told = json.loads(further.summary.schema.metadata[b"lierb"])
    assert told["problem"]["continued"] is True
    assert told["options"]["t0"] == STEPS * DT
    plain = result.end | {"pose0": np.array(result.end["pose0"])}
    again = run(weightless, 2 * STEPS, **plain, cspace="SO3xR3", check="off")
    # the same motion but for the start's rounding, over 100 steps of up to 30 rad/s
    speeds = [column(r.summary, "omega") for r in (further, again)]
    np.testing.assert_allclose(*speeds, rtol=0, atol=1e-9)


@pytest.mark.parametrize("count", [2, 50])
def test_a_large_end_is_named_by_the_metadata_of_its_run(count):
    problem, twist0 = lively("spherical")
    first = run(problem, STEPS, twist0=np.repeat(twist0[:1], count, axis=0))
    before = first.summary.schema.metadata[b"lierb"]
    told = json.loads(run(problem, 2 * STEPS, **first.end).summary.schema.metadata[b"lierb"])
    start = {name: told["problem"][name] for name in ("pose0", "twist0")}
    assert told["problem"]["continued"] is True
    if count == 2:  # so few are written out
        assert start == {name: first.end[name].tolist() for name in start}
        return
    named = hashlib.sha256(before).hexdigest()
    shapes = {"pose0": [count, 4, 4], "twist0": [count, 6]}
    assert start == {name: {"shape": shapes[name], "end_of": named} for name in start}


def test_end_is_what_the_summary_says_and_is_read_only():
    problem, twist0 = lively("spherical")
    result = run(problem, STEPS, twist0=twist0)
    end, summary = result.end, result.summary
    assert list(end) == ["pose0", "twist0", "t0"]
    assert end["t0"] == STEPS * DT
    assert end["pose0"].shape == (3, 4, 4)
    np.testing.assert_array_equal(
        end["pose0"][:, :3, :3].reshape(3, 9), column(summary, "rotation")
    )
    np.testing.assert_array_equal(end["pose0"][:, :3, 3], column(summary, "position"))
    np.testing.assert_array_equal(end["pose0"][:, 3], [(0.0, 0.0, 0.0, 1.0)] * 3)
    np.testing.assert_array_equal(end["twist0"][:, :3], column(summary, "omega"))
    np.testing.assert_array_equal(end["twist0"][:, 3:], column(summary, "v"))
    for name in ("pose0", "twist0"):
        with pytest.raises(ValueError, match="read-only"):
            end[name][0, 0] = 0.0
    assert type(end["pose0"][0]) is np.ndarray
    assert type(end["pose0"] + 0.0) is np.ndarray


def test_a_pickled_result_has_no_end():
    problem, twist0 = lively("spherical")
    result = run(problem, STEPS, twist0=twist0)
    again = pickle.loads(pickle.dumps(result))
    assert again == result
    with pytest.raises(ArgumentError, match="only a result that integrate returned has an end"):
        again.end  # noqa: B018


def test_end_of_failed_trajectories_names_them():
    problem, twist0 = lively("spherical")
    twist0[1, :3] = 1e100
    with pytest.warns(FailedTrajectoryWarning):
        result = run(problem, 5, twist0=twist0, check="off")
    with pytest.raises(
        ArgumentError, match=r"end: 1 of 3 trajectories failed .*: 1 \(non_finite at 0\.01 s\)"
    ):
        result.end  # noqa: B018


# ---- t0 ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ({"t0": math.nan}, "t0=nan; expected a finite time in s"),
        ({"t0": "0"}, "t0='0'; expected a finite time in s"),
        ({"t0": 1.0}, "t_end=1.0; expected a time in s later than t0=1.0"),
        ({"t0": 0.5, "t_end": 0.25}, "t_end=0.25; expected a time in s later than t0=0.5"),
        (
            {"t0": 0.105},
            "t_end=1.0 s is no multiple of dt=0.01 s, counted from t0=0.105 s; the nearest are "
            "0.995 and 1.005; dt=0.00994444444 s fits, and so do adaptive steps, rtol=",
        ),
        ({"t0": -1e300}, "t0 is more than 9.0072e+15 steps of dt=0.01 s from 0 s"),
    ],
)
def test_start_time_is_checked(times, message):
    problem, twist0 = tilted("spherical")
    with pytest.raises(TimeGridError) as caught:
        lierb.integrate(problem, twist0=twist0, **({"dt": DT, "t_end": 1.0} | times))
    assert str(caught.value) == message


# ---- problems and mechanisms that are built again ----------------------------------------------


def built(mass=0.7, length=0.3, tie=0.1, gain=2.0, name="rod", motor=0.5):
    """A crank that a motor drives, and a rod that it pushes along a line, from nothing: bodies,
    joints, a loop, functions.
    """

    @lierb.wrench(gain=gain)
    def pull(t, R, r, omega, v, params):
        return (0.0, -params.gain * omega[1], 0.0), (0.0, 0.0, 0.0)

    def pin(body, parent):
        points = (body, 0.0, 0.0), (parent, 0.0, 0.0)
        return lierb.joints.revolute(*points, axis=(0.0, 1.0, 0.0))

    body = lierb.Body(mass, (0.02, 0.03, 0.01))
    slide = lierb.joints.point_on_line((0.5, 0.0, 0.0), (0.0, 0.0, tie), axis=(1.0, 0.0, 0.0))
    return lierb.Mechanism(
        [
            lierb.Link("crank", body, pin(0.0, 0.0)),
            lierb.Link(name, body, pin(-0.5, length), "crank"),
        ],
        lierb.Loop("tie", slide, name),
        (0.0, 0.0, -9.81),
        forces=[
            lierb.forces.motor(speed=lambda t: 2.0 + motor * np.sin(t)).on("crank"),
            pull().on(name),
        ],
    )


CHANGES = {
    "mass": 0.8, "length": 0.31, "tie": 0.11, "name": "bar", "motor": 0.6,
}  # fmt: skip


def test_built_again_with_equal_numbers_have_equal_joints():
    assert continuation._have_equal_joints(built(), built())
    assert continuation._have_equal_joints(built(), built(gain=3.0))  # other forces may act


@pytest.mark.parametrize("change", CHANGES)
def test_built_again_with_another_number_is_not_held_alike(change):
    other = built(**{change: CHANGES[change]})
    assert not continuation._have_equal_joints(built(), other)
    assert not continuation._have_equal_joints(other, built())


def tethered(length=0.6):
    """A body that a function of the user's holds, from nothing."""

    @lierb.constraint(length=length)
    def tether(R, r, params):
        return (r @ r / params.length - params.length) / 2

    body = lierb.Body(1.2, (0.01, 0.02, 0.025))
    return lierb.Problem(body, lierb.joints.free(), (0.0, 0.0, -9.81), constraints=tether())


def broken(make, pose0, twist0, is_rebuilt: bool) -> str:
    """A digest of the bits at the end of two runs, the second one of what is built again."""
    problem, options = make(), {"dt": DT}
    start = {"pose0": pose0(problem), "twist0": twist0(problem)}
    if is_rebuilt:
        start = lierb.integrate(problem, **start, **options, t_end=17 * DT).end
        problem = make()
    summary = lierb.integrate(problem, **start, **options, t_end=30 * DT).summary
    names = [n for n in summary.column_names if n.rpartition(".")[2] in STATE]
    assert len(names) >= len(STATE)
    content = b"".join(column(summary, name).tobytes() for name in names)
    return hashlib.sha256(content).hexdigest()


def driven(is_rebuilt: bool) -> str:
    def closed(made):
        return made.close(made.pose({"crank": -0.6, "rod": 0.7}))

    def moving(made):
        return made.project(made.twist({}, closed(made)), closed(made))

    return broken(built, closed, moving, is_rebuilt)


def hanging(is_rebuilt: bool) -> str:
    def apart(problem):
        pose = lierb.lie.se3.exp((0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
        pose[:3, 3] = 0.36, 0.0, -0.48
        return pose

    return broken(tethered, apart, lambda _: np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), is_rebuilt)


@pytest.mark.slow
@pytest.mark.parametrize("run_of", [pytest.param(driven, marks=pytest.mark.long), hanging])
def test_built_again_it_goes_on_to_the_bits_of_one_run(run_of):
    assert run_of(is_rebuilt=True) == run_of(is_rebuilt=False)


@pytest.mark.long
def test_built_in_another_process_it_goes_on_to_the_same_bits():
    code = "import test_restart; print(test_restart.driven(is_rebuilt=True))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    child = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert child.stdout.strip() == driven(is_rebuilt=False)

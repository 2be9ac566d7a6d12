"""Derivatives of runs that go on from the end of another: those of one uninterrupted run."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms.shared import double_pendulum
from mechanisms.test_looped_constraints import chain
from mechanisms.test_looped_elements import made
from mechanisms.test_tree_loop import start_of

import lierb
from derivatives.complex_steps import H
from derivatives.test_of_looped_code import STIFFNESS, arm, moving
from derivatives.test_through_controllers import (
    END,
    INERTIA,
    JOINT,
    NAMES,
    START,
    VALUES,
    exact,
    wheel,
)
from lierb.errors import ArgumentError

GRAVITY = (0.0, 0.0, -9.81)


@lierb.states(heat=0.1)
def friction(omega, states):
    return {"heat": 0.1 * omega[0] * omega[0] - states.heat}


def top(**elements) -> tuple[lierb.Problem, dict]:
    body = lierb.Body(6.075, (0.0126563, 0.0468281, 0.0569531))
    joint = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))
    drag = lierb.forces.drag(angular=0.01)
    problem = lierb.Problem(body, joint, GRAVITY, forces=drag, **elements)
    return problem, {"twist0": joint.twist(omega=[(6.28, 3.14, 0.63), (1.0, 2.0, 3.0)])}


MANY = ("omega0", "body.mass", "pose0", "joint.body_point", "drag.angular", "friction.heat")


def in_pieces(model, start, ends, names, **options):
    """Results of runs to these times, each from the end of the one before."""
    results = []
    for t_end in ends:
        results.append(
            lierb.integrate(model, **start, t_end=t_end, with_respect_to=names, **options)
        )
        start = results[-1].end
    return results


FEW = ("body.mass", "drag.angular", "friction.heat")


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(FEW, marks=pytest.mark.slow, id="three directions"),
        pytest.param(MANY, marks=pytest.mark.long, id="fifteen directions, six at a time"),
    ],
)
def test_pieces_of_a_run_have_the_derivatives_of_the_whole_to_the_bit(names):
    problem, start = top(states=friction())
    (whole,) = in_pieces(problem, start, [0.3], names, dt=1e-3)
    *_, last = in_pieces(problem, start, [0.1, 0.2, 0.3], names, dt=1e-3)
    tables = whole.sensitivities.summary, last.sensitivities.summary
    for name in tables[0].column_names:
        if not name.startswith("work"):  # counted from the start of a run
            assert tables[0][name].equals(tables[1][name]), name
    assert whole.summary["omega"].equals(last.summary["omega"])
    # only some of the parameters, in another order
    some = ("friction.heat", "body.mass")
    *_, last = in_pieces(problem, start, [0.1], names, dt=1e-3)
    last = lierb.integrate(problem, **last.end, t_end=0.3, dt=1e-3, with_respect_to=some)
    for name in some:
        np.testing.assert_array_equal(
            last.sensitivity("twist", name), whole.sensitivity("twist", name)
        )


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        {"dt": 1e-3, "method": "alpha2", "cspace": "SE3"},
        {"dt": 1e-3, "method": "BLieDF2", "cspace": "SO3xR3"},
        {"dt": 1e-3, "cspace": "reduced", "update": "ambient"},
        {"rtol": 1e-12, "method": "DOP853"},
        {"rtol": 1e-10, "method": "Rodas5P"},
    ],
    ids=["alpha2", "BLieDF2", "ambient", "adaptive", "Rodas5P"],
)
def test_pieces_have_the_derivatives_of_the_whole_by_all_kinds_of_methods(options):
    """An adaptive run whose pieces end elsewhere has other steps, of the same accuracy."""
    problem, start = top()
    names = ("omega0", "joint.body_point", "drag.angular")
    (whole,) = in_pieces(problem, start, [0.3], names, **options)
    *_, last = in_pieces(problem, start, [0.1, 0.3], names, **options)
    atol = 0.0 if "dt" in options else 1e-7
    for of in ("pose", "twist", "energy"):
        for name in names:
            found, right = (result.sensitivity(of, name) for result in (last, whole))
            np.testing.assert_allclose(found, right, rtol=atol, atol=atol)


@pytest.mark.long
@pytest.mark.parametrize("methods", [("alpha2", "RK4"), ("RK4", "alpha2"), ("BLieDF2", "RK4")])
def test_another_method_goes_on_with_the_derivatives(methods):
    """Methods that carry numbers begin with new ones, and leave theirs behind."""
    problem, start = top()
    names = ("omega0", "joint.body_point")
    options = {"dt": 5e-4, "cspace": "SE3", "with_respect_to": names}
    whole = lierb.integrate(problem, **start, t_end=0.2, **options)
    first, second = methods
    half = lierb.integrate(problem, **start, t_end=0.1, method=first, **options, solver="saddle")
    end = lierb.integrate(problem, **half.end, t_end=0.2, method=second, **options, solver="saddle")
    for name in names:
        right = whole.sensitivity("twist", name)
        off = np.abs(end.sensitivity("twist", name) - right).max()
        assert off < 1e-4 * np.abs(right).max()  # of order 2: (7 rad/s · 5e-4 s)²


@pytest.mark.long
@pytest.mark.parametrize("cspace", ["reduced", "SE3"])
def test_pieces_of_a_mechanisms_run_have_the_derivatives_of_the_whole(cspace):
    model = double_pendulum()
    start = {"pose0": model.pose({"upper": 1.0, "lower": 0.5})}
    start["twist0"] = model.twist({"upper": 0.3}, start["pose0"])
    names = ("lower.body.mass", "upper.omega0", "lower.joint.parent_point", "gravity")
    options = {"dt": 1e-3, "cspace": cspace}
    (whole,) = in_pieces(model, start, [0.3], names, **options)
    *_, last = in_pieces(model, start, [0.2, 0.3], names, **options)
    for name in names:
        np.testing.assert_array_equal(
            last.sensitivity("lower.twist", name), whole.sensitivity("lower.twist", name)
        )


@pytest.mark.slow
def test_ends_without_the_derivatives_that_a_run_needs_are_refused():
    problem, start = top(states=friction())
    run = {"dt": 1e-3}
    plain = lierb.integrate(problem, **start, t_end=0.1, **run).end
    with pytest.raises(ArgumentError, match="had none; give it the same parameters"):
        lierb.integrate(problem, **plain, t_end=0.2, with_respect_to="omega0", **run)
    (one,) = in_pieces(problem, start, [0.1], FEW, **run)
    with pytest.raises(ArgumentError, match="has none by gravity; name it there too"):
        lierb.integrate(problem, **one.end, t_end=0.2, with_respect_to="gravity", **run)
    with pytest.raises(ArgumentError, match="from which an adjoint does not go back"):
        lierb.gradient(problem, "energy", "body.mass", **one.end, t_end=0.2, **run)


def push_by(gains):
    @lierb.wrench(gains=gains)
    def push(t, R, r, omega, v, params):
        return (0.0, 0.0, params.gains[0]), (0.0, 0.0, 0.0)

    return push()


@pytest.mark.slow
def test_a_parameter_of_another_size_is_refused():
    body, gains = wheel().body, ((1.0, 2.0), (1.0, 2.0, 3.0))
    two, three = (lierb.Problem(body, JOINT, forces=push_by(each)) for each in gains)
    run = {"dt": 1e-3, "with_respect_to": "push.gains"}
    end = lierb.integrate(two, t_end=0.01, **run).end
    with pytest.raises(ArgumentError, match="gains has 3 numbers, and had 2 in the run that ended"):
        lierb.integrate(three, **end, t_end=0.02, **run)


# ---- controllers and looped code ---------------------------------------------------------------


def require_equal(whole, last, quantities, names, atol=0.0):
    for of in quantities:
        for name in names:
            found, right = (result.sensitivity(of, name) for result in (last, whole))
            scale = max(1.0, np.abs(right).max())
            np.testing.assert_allclose(found, right, rtol=0.0, atol=atol * scale, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [pytest.param({"rtol": 1e-12}, marks=pytest.mark.long), {"dt": 0.01}],
    ids=["adaptive", "fixed"],
)
def test_controllers_go_on_with_the_derivatives_of_outputs_and_memory(options):
    """From ends at a tick and between two, beside one run and the closed form."""
    names, quantities = [*NAMES.values()], ("twist", "pose", "torque")
    start = {"twist0": START["twist0"]}
    (whole,) = in_pieces(wheel(), start, [END], names, **options)
    _, half, last = in_pieces(wheel(), start, [0.2, 0.33, END], names, **options)
    atol = 0.0 if "dt" in options else 1e-12
    require_equal(whole, last, quantities, names, atol)
    values = VALUES | {"inertia": INERTIA, "speed": 1.0}
    for key, name in NAMES.items():
        moved = exact(**values | {key: values[key] + 1j * H}).imag / H
        which = 2 if key in ("speed", "inertia") else 0  # about e₃: the third direction
        found = [last.sensitivity(of, name)[0] for of in ("pose", "twist")]
        torque = last.sensitivity("torque", name)[0, which]
        # steps of constant torque are exact: rounding of 21 of them
        np.testing.assert_allclose(
            [*(x[2, which] for x in found), torque], moved, rtol=1e-9, atol=1e-12
        )
    some = ["servo.last", "servo.gain"]  # of 13 directions, six at a time: two, in another order
    (last,) = in_pieces(wheel(), half.end, [END], some, **options)
    require_equal(whole, last, quantities, some, atol)


@pytest.mark.long
@pytest.mark.parametrize("is_first", [True, False])
def test_controllers_of_one_of_two_runs_leave_the_derivatives_of_the_motion(is_first):
    """The second run is a linear map of angle and rate at its start, beside its own inertia."""
    plain = lierb.Problem(wheel().body, JOINT, forces=lierb.forces.drag(angular=0.01))
    first, second = (wheel(), plain) if is_first else (plain, wheel())
    run = {"dt": 0.01, "with_respect_to": ["omega0", "body.inertia"]}
    half = lierb.integrate(first, twist0=START["twist0"], t_end=0.2, **run)
    last = lierb.integrate(second, **half.end, t_end=0.43, **run)
    anew = half.end | {"pose0": half.end["pose0"].copy()}
    run["with_respect_to"] = ["pose0", "omega0", "body.inertia"]
    alone = lierb.integrate(second, **anew, t_end=0.43, **run)

    def by(result, name, of=("pose", "twist")):
        return np.array([result.sensitivity(x, name)[0, 2, 2] for x in of])

    by_start = np.column_stack([by(alone, "pose0"), by(alone, "omega0")])
    for name, own in (("omega0", 0.0), ("body.inertia", by(alone, "body.inertia"))):
        right = by_start @ by(half, name) + own
        np.testing.assert_allclose(by(last, name), right, rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_looped_code_goes_on_to_the_bit():
    """Beside one run, and differences of its values."""
    names = [STIFFNESS, "link4.body.mass", "link9.twist0", "gravity", "link3.joint.body_point"]
    quantities = ("link0.pose", "link9.twist", "energy")
    options = {"dt": 1e-3, "solver": "looped"}
    (whole,) = in_pieces(arm(), moving(arm()), [0.1], names, **options)
    *_, half, last = in_pieces(arm(), moving(arm()), [0.03, 0.05, 0.1], names, **options)
    require_equal(whole, last, quantities, names)
    some = ["link4.body.mass", STIFFNESS]
    (again,) = in_pieces(arm(), half.end, [0.1], some, **options)
    require_equal(whole, again, quantities, some)
    for name, middle, step in ((some[0], 0.7, 1e-4), (some[1], 20.0, 1e-3)):
        model = arm().with_({name: [middle - step, middle + step]})
        (ends,) = in_pieces(model, moving(arm()), [0.1], some, **options)
        rates = np.array(ends.summary["link9.omega"].to_pylist())
        found = last.sensitivity("link9.twist", name)[0, :3, 0]
        expected = (rates[1] - rates[0]) / (2.0 * step)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)  # of differences


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        {"dt": 1e-3},
        {"dt": 1e-3, "stabilise": "project"},
        {"dt": 1e-3, "stabilise": lierb.baumgarte(5.0, 4.0)},
        {"rtol": 1e-9, "method": "Tsit5", "stabilise": "project"},
    ],
    ids=["drifting", "projected", "baumgarte", "adaptive"],
)
def test_loops_go_on_in_looped_code(options):
    model, start = chain(6)
    names = ("gravity", "link2.body.mass", "link1.joint.body_point", "link0.twist0")
    (whole,) = in_pieces(model, start, [0.02], names, solver="looped", **options)
    *_, last = in_pieces(model, start, [0.01, 0.02], names, solver="looped", **options)
    atol = 0.0 if "dt" in options else 1e-10
    require_equal(whole, last, ("link5.twist", "link0.pose", "energy"), names, atol)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lierb.errors.DerivativeWarning")  # of stops with dampers
def test_states_and_controllers_go_on_in_looped_code():
    """Four trajectories, with stops, from ends between ticks, of four packs of directions."""
    model = made(events=[])
    names = (
        "link1.grows.spent", "link2.holds.last", "link1.grows.rate", "link1.omega0",
        "link0.joint_limit.stiffness", "gravity",
    )  # fmt: skip
    options = {"dt": 0.01, "solver": "looped"}
    (whole,) = in_pieces(model, start_of(model), [0.4], names, **options)
    *_, last = in_pieces(model, start_of(model), [0.13, 0.31, 0.4], names, **options)
    require_equal(whole, last, ("link2.twist", "spent", "where", "pull"), names)


@pytest.mark.long
@pytest.mark.parametrize("solvers", [("looped", "unrolled"), ("unrolled", "looped")])
def test_one_kind_of_code_goes_on_from_the_other(solvers):
    """Also from steps of one clock to a clock of each lane."""
    model = double_pendulum()
    start = {"pose0": model.pose({"upper": 1.0, "lower": 0.5})}
    start["twist0"] = model.twist({"upper": 0.3}, start["pose0"])
    names = ("lower.body.mass", "upper.omega0", "lower.joint.parent_point", "gravity")
    options = {"dt": 1e-3, "with_respect_to": names}
    first, second = solvers
    whole = lierb.integrate(model, **start, t_end=0.3, solver=second, **options)
    half = lierb.integrate(model, **start, t_end=0.1, solver=first, **options)
    for more in ({}, {"save_at": [0.3]}):
        last = lierb.integrate(model, **half.end, t_end=0.3, solver=second, **options, **more)
        for name in names:
            right = whole.sensitivity("lower.twist", name)
            found = last.sensitivity("lower.twist", name).reshape(right.shape)
            # the rounding of 300 steps in each of two ways
            np.testing.assert_allclose(found, right, rtol=1e-13, atol=1e-13)

"""Derivatives of runs that go on from the end of another: those of one uninterrupted run."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms.shared import double_pendulum
from mechanisms.test_looped_constraints import chain

import lierb
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


NAMES = ("omega0", "body.mass", "pose0", "joint.body_point", "drag.angular", "friction.heat")


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
        pytest.param(NAMES, marks=pytest.mark.long, id="fifteen directions, six at a time"),
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


@lierb.controller(every=0.05)
def brake(omega):
    return {"torque": -0.1 * omega[2]}


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


@pytest.mark.long
def test_looped_code_and_controllers_do_not_go_on_with_derivatives():
    looped, run = chain(8), {"dt": 1e-3}
    end = lierb.integrate(looped[0], **looped[1], dt=1e-3, t_end=0.01, solver="looped").end
    with pytest.raises(ArgumentError, match="looped code does not go on"):
        lierb.integrate(
            looped[0], **end, dt=1e-3, t_end=0.02, solver="looped", with_respect_to="gravity"
        )
    controlled, start = top(controllers=brake())
    end = lierb.integrate(controlled, **start, t_end=0.1, **run).end
    with pytest.raises(ArgumentError, match="brake, a controller, does not go on"):
        lierb.integrate(controlled, **end, t_end=0.2, with_respect_to="omega0", **run)

"""Projection onto the rows: what it may move, and how a run ends where it would move more."""

import numpy as np
import pytest
from cases import GRAVITY
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import FailedTrajectoryWarning

CRANK, COUPLER = 0.2, 0.5  # m
T_END = 0.45  # s: bars that start above the flat pose fall through it once
ANGLES, RATES = np.linspace(-2.8, -0.3, 24), np.linspace(-1.0, 1.0, 24)
FALL = float(np.linalg.norm(GRAVITY))


def parallelogram():
    """Two cranks and a coupler, whose branches meet where all bars lie flat."""
    hinge = {"axis": (0.0, 1.0, 0.0)}
    bars = {x: lierb.bodies.box((x, 0.02, 0.02), density=2700.0) for x in (CRANK, COUPLER)}

    def end(x):
        return (0.5 * x, 0.0, 0.0)

    left, right = (
        lierb.Link(n, bars[CRANK], lierb.joints.revolute(end(-CRANK), ground_point=at, **hinge))
        for n, at in (("left", (0.0, 0.0, 0.0)), ("right", (COUPLER, 0.0, 0.0)))
    )
    held = lierb.joints.revolute(end(-COUPLER), parent_point=end(CRANK), **hinge)
    pin = lierb.joints.revolute(end(COUPLER), parent_point=end(CRANK), **hinge)
    return lierb.Mechanism(
        [left, lierb.Link("coupler", bars[COUPLER], held, "left"), right],
        lierb.Loop("pin", pin, "coupler", "right"),
        (0.0, 0.0, -FALL),
    )


def pendulum_rates(made):
    """ω of the cranks at the end: the coupler does not turn, so both are one pendulum."""
    crank, coupler = (float(made.link(n).body.mass) for n in ("left", "coupler"))
    about_pin = made.link("left").body.inertia[1, 1] + crank * (0.5 * CRANK) ** 2
    inertia = 2.0 * about_pin + coupler * CRANK**2
    torque = FALL * CRANK * (crank + coupler)

    def falls(t, x):
        return x[1], torque / inertia * np.cos(x[0])  # a turn by x about e₂ lowers e₁ by sin x

    return np.array([
        solve_ivp(falls, (0.0, T_END), x, method="DOP853", rtol=1e-13, atol=1e-13).y[1, -1]
        for x in zip(ANGLES, RATES, strict=True)
    ])  # fmt: skip


def fallen(made, **options):
    """Status and ω of the cranks at the end."""
    pose0 = made.pose({"left": ANGLES, "coupler": -ANGLES, "right": ANGLES})
    twist0 = made.twist({"left": RATES, "coupler": -RATES, "right": RATES}, pose0)
    result = lierb.integrate(
        made, pose0=pose0, twist0=twist0, t_end=T_END, stabilise="project", **options
    )
    return np.array(result.summary["status"].to_pylist()), result["left"].omega[:, 1]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_projection_near_a_change_point_is_right_or_singular():
    made = parallelogram()
    expected = pendulum_rates(made)
    for rtol in (1e-6, 1e-8, 1e-9, 1e-11):
        status, rates = fallen(made, rtol=rtol, method="DP54")
        fine = status == "ok"
        assert set(status[~fine]) <= {"singular"}
        assert fine.any()
        # 100 steps, whose errors of rtol |ω| add up, at most 10 rad/s
        np.testing.assert_allclose(rates[fine], expected[fine], rtol=0, atol=1e3 * rtol)
        assert fine.all() or rtol < 1e-6


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_fixed_steps_near_a_change_point_are_right_or_singular():
    made = parallelogram()
    expected = pendulum_rates(made)
    errors = {}
    for dt in (0.05, 0.025, 2e-4, 5e-5):
        status, rates = fallen(made, dt=dt)
        fine = status == "ok"
        assert set(status[~fine]) <= {"singular"}
        assert fine.all() or dt < 1e-3  # a drift of a long step is no reason to end
        errors[dt] = np.abs(rates - expected)[fine].max()
    assert 8.0 < errors[0.05] / errors[0.025] < 64.0  # order 4
    # what is left where the singular value divides rounding by a step's way; 3e-3 without a bound
    assert max(errors[2e-4], errors[5e-5]) < 1e-6


@lierb.constraint(unit="1", ratio=-1.0, phase=0.0)
def meshing(R, r, params):
    """Gears, by angles that jump by 2π where arctan2 does."""
    first = np.arctan2(-r[1], r[0])
    c, s = np.cos(params.phase), np.sin(params.phase)
    between = np.arctan2(s * R[0, 0] + c * R[1, 0], c * R[0, 0] - s * R[1, 0]) - params.phase
    return between + (1.0 - params.ratio) * first


RATIO, PHASE = np.array([-1.0, -2.0, -0.5, 1.5, -3.0]), np.array([0.0, 0.0, 1.0, 0.0, 0.5])
JUMP = np.minimum(  # s at which the angle between the wheels, or that of the first one, is at π
    (np.pi - PHASE * np.sign(RATIO - 1.0)) / np.abs(RATIO - 1.0), np.pi
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "steps",
    [{"dt": 0.01, "method": "Euler"}, {"dt": 0.2, "method": "Euler"},
     pytest.param({"rtol": 1e-6, "method": "BS32"}, marks=pytest.mark.long)],
    ids=str,
)  # fmt: skip
def test_a_jump_of_a_constraint_ends_singular(steps):
    wheels = [lierb.bodies.cylinder(0.1, 0.02, mass=mass) for mass in (1.0, [1, 1, 1, 1e-4, 100])]
    axis = {"axis": (0.0, 0.0, 1.0)}
    made = lierb.Mechanism(
        [
            lierb.Link("first", wheels[0], lierb.joints.revolute(**axis)),
            lierb.Link(
                "second", wheels[1], lierb.joints.revolute(ground_point=(0.3, 0.0, 0.0), **axis)
            ),
        ],
        constraints=meshing(ratio=RATIO, phase=PHASE).on("second", "first"),
    )
    pose0 = made.pose({"first": 0.0, "second": 0.0})
    twist0 = made.twist({"first": 1.0, "second": RATIO}, pose0)
    with pytest.warns(FailedTrajectoryWarning, match="5 singular"):
        summary = lierb.integrate(
            made, pose0=pose0, twist0=twist0, t_end=4.0, stabilise="project", **steps
        ).summary
    assert set(summary["status"].to_pylist()) == {"singular"}
    # fixed steps end with the one that jumps, adaptive ones with the last one before
    late = summary["t"].to_numpy() - JUMP
    longest = steps.get("dt", 1e-6)
    assert (np.abs(late) <= longest).all()


@pytest.mark.slow
def test_adaptive_steps_end_where_rows_contradict_each_other():
    # as in tests/test_tables.py: a point that moves while the body turns needs two accelerations
    joint = lierb.joints.from_rows(["d1", "Qtd1"])
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), joint)
    with pytest.warns(FailedTrajectoryWarning, match="singular"):
        summary = lierb.integrate(
            problem,
            twist0=(0, 0, 1.0, 0, 1.0, 0),
            rtol=1e-6,
            t_end=1.0,
            check="off",
            method="BS32",
        ).summary
    assert summary["status"].to_pylist() == ["singular"]

"""Constraints on velocities: a sleigh, rolling bodies, and what is refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cases import column, integrate, tiered
from public_cases.shared import summed

import lierb
from lierb.errors import ForceError, TwistError

# ---- Chaplygin's sleigh ------------------------------------------------------------------------

MASS, INERTIA, ARM = 1.7, 0.2, 0.3  # kg, kg m² about the centre of mass, m from the blade


@lierb.velocity_constraint
def blade(v):
    """A blade along e₁ at the body frame's origin."""
    return v[1]


@cache
def sleigh() -> lierb.Problem:
    body = lierb.Body(MASS, (0.1, 0.15, INERTIA), (ARM, 0.0, 0.0), about="com")
    return lierb.Problem(body, lierb.joints.planar(), constraints=blade())


WHOLE = INERTIA + MASS * ARM**2  # kg m², about the blade


def solution(t, speed, turn):
    """u = V tanh τ and ω = (V/k) sech τ, τ = a V t/k² + τ₀, k² = (I + m a²)/m.

    Chaplygin (1911); Bloch, Nonholonomic Mechanics and Control, 1.7: u̇ = a ω²,
    ω̇ = −m a u ω/(I + m a²).
    """
    k = np.sqrt(WHOLE / MASS)
    V = np.hypot(speed, k * turn)
    phase = ARM * V * t / k**2 + np.arctanh(speed / V)
    return V * np.tanh(phase), V / k / np.cosh(phase)


SLEIGH_OPTIONS = {
    "SE3": {}, "ambient": {"update": "ambient"}, "Rosenbrock": {"method": "Rodas5P"},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("options", tiered(SLEIGH_OPTIONS, ["SE3"], []))
def test_chaplygins_sleigh_turns_until_it_glides_along_its_blade(options):
    """Right: the published solution, and the blade's force m (ẍ of the centre of mass)."""
    problem, t = sleigh(), np.linspace(0.0, 3.0, 13)
    start = np.array([(-1.0, 2.0), (0.5, -3.0)])
    twist0 = np.zeros((2, 6))
    twist0[:, 3], twist0[:, 2] = start.T
    result = integrate(
        problem, twist0=twist0, dt=2.5e-3, t_end=3.0, save_every=100, **SLEIGH_OPTIONS[options]
    )
    assert result.failed.size == 0
    for i, (speed, turn) in enumerate(start):
        u, w = solution(t, speed, abs(turn))
        w = np.sign(turn) * w
        # RK4 of 4 rad/s at 2.5 ms
        np.testing.assert_allclose(result.v[:, i, 0], u, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result.omega[:, i, 2], w, rtol=0, atol=1e-9)
        # force across the blade: m (u ω + a ω̇)
        force = MASS * (u * w - ARM * MASS * ARM * u * w / WHOLE)
        found = -column(result.history, "lambda").reshape(13, 2, 4)[:, i, 3]
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-8)
    # J is constant in these coordinates: J V = 0 is linear, and kept to rounding
    assert np.max(summed(result, "velocity_error_max")) < 1e-14
    assert np.max(summed(result, "energy_drift_max")) < 1e-9


def test_predictions_say_what_is_kept():
    """Right: J of the blade is constant on C₀K; that of a rolling ball's contact is not."""
    found = lierb.predict(sleigh())["SE3"]
    assert found.rows[-1] == "blade"
    assert found.rows_exact == (True,) * 4
    assert found.dimension == 3  # brackets of turning and gliding move it aside
    carried = lierb.Mechanism(
        lierb.Link("sleigh", sleigh().body, lierb.joints.planar()), constraints=blade()
    )
    predicted = lierb.predict(carried)
    assert predicted["reduced"]["blade"].rows_exact == (True,)
    assert predicted["reduced"].dimension == 3
    assert carried.freedoms() == (2, 0)


@pytest.mark.long
@pytest.mark.parametrize("stabilise", [None, "project", lierb.baumgarte(20.0, 0.0)], ids=str)
def test_a_mechanism_has_the_sleigh_as_well(stabilise):
    machine = lierb.Mechanism(
        lierb.Link("sleigh", sleigh().body, lierb.joints.planar()), constraints=blade()
    )
    twist0 = {"sleigh": (0.0, 0.0, 2.0, -1.0, 0.0, 0.0)}
    result = integrate(machine, twist0=twist0, dt=2.5e-3, t_end=3.0, stabilise=stabilise)
    u, w = solution(3.0, -1.0, 2.0)
    np.testing.assert_allclose(summed(result, "sleigh.v")[0, 0], u, rtol=0, atol=1e-9)
    np.testing.assert_allclose(summed(result, "sleigh.omega")[0, 2], w, rtol=0, atol=1e-9)


# ---- a ball on a turntable ---------------------------------------------------------------------

RADIUS, SPIN = 0.1, 3.0  # m, rad/s


@lierb.velocity_constraint(radius=RADIUS)
def rolling(R, omega, v, params):
    """Velocity of the lowest point of a ball, relative to the plane below it."""
    down = -params.radius * R[2]  # in body axes
    slip = R @ (v + np.cross(omega, down))
    return slip[0], slip[1]


def turntable(moments) -> lierb.Mechanism:
    table = lierb.Link("table", lierb.Body(3.0, (1.0, 1.0, 2.0)), lierb.joints.revolute())
    ball = lierb.Link(
        "ball", lierb.Body(0.5, np.array(moments)), lierb.joints.from_rows(["d3"]), "table"
    )
    return lierb.Mechanism(
        [table, ball],
        gravity=(0.0, 0.0, -9.81),
        forces=lierb.forces.motor(speed=SPIN).on("table"),
        constraints=rolling().on("ball", "table"),
    )


@pytest.mark.long
def test_a_ball_on_a_turntable_moves_in_circles():
    """Right: its centre has the angular velocity 2/7 of the table's (Earnshaw, 1844), and friction.

    With the inertia k m r², the rate is k/(1 + k) of the table's.
    """
    moment = 0.4 * 0.5 * RADIUS**2
    machine = turntable([moment] * 3)
    place, rate = np.array((0.5, 0.0, 0.0)), SPIN * 2.0 / 7.0
    pose0 = machine.pose()
    pose0["ball"][:3, 3] = place
    # at rest in the ground but for rolling on the table: ω × (−r e₃) = v of the table there
    across = SPIN * place[0] / RADIUS
    twist0 = {
        "table": (0.0, 0.0, SPIN, 0.0, 0.0, 0.0), "ball": (across, 0.0, 0.4, 0.0, 0.0, 0.0),
    }  # fmt: skip
    assert machine.violation(pose0, twist0) is None
    assert machine.freedoms(pose0) == (4, 0)  # turns of the ball and of the table
    t = np.linspace(0.0, 2.0, 11)
    result = integrate(
        machine, pose0=pose0, twist0=twist0, dt=1e-3, t_end=2.0, save_every=200, stabilise="project"
    )
    assert result.failed.size == 0
    found = result["ball"].position[:, 0, :2]  # ẍ = rate e₃ × ẋ, at rest
    np.testing.assert_allclose(found, np.tile(place[:2], (11, 1)), rtol=0, atol=1e-8)
    pushed = {**twist0, "ball": (across, 2.0, 0.4, 0.0, 0.0, 0.0)}
    pushed = machine.project(pushed, pose0)
    moving = pushed["ball"][3:5]
    result = integrate(
        machine, pose0=pose0, twist0=pushed, dt=1e-3, t_end=2.0, save_every=200, stabilise="project"
    )
    velocity = (moving[0] + 1j * moving[1]) * np.exp(1j * rate * t)
    path = 0.5 + (velocity - velocity[0]) / (1j * rate)
    found = result["ball"].position[:, 0]
    # RK4 of 15 rad/s at 1 ms
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], path, rtol=0, atol=1e-8)
    friction = -column(result.history, "ball.rolling.lambda")
    # in axes of the table, which turns
    right = 0.5 * 1j * rate * velocity * np.exp(-1j * SPIN * t)
    np.testing.assert_allclose(friction[:, 0] + 1j * friction[:, 1], right, rtol=0, atol=1e-7)


# ---- starts and refusals -----------------------------------------------------------------------


@pytest.mark.slow
def test_a_start_must_not_slip():
    problem = sleigh()
    with pytest.raises(TwistError, match=r"blade: 0\.5.*problem\.project"):
        integrate(problem, twist0=(0.0, 0.0, 1.0, 2.0, 0.5, 0.0), dt=0.1, t_end=1.0)
    found = problem.project((0.0, 0.0, 1.0, 2.0, 0.5, 0.0))
    # the nearest in kinetic energy: (I + m a²) ω + m a v fixed along the motions allowed
    assert found[4] == pytest.approx(0.0, abs=1e-15)
    assert found[2] == pytest.approx(1.0 + MASS * ARM * 0.5 / WHOLE, rel=1e-14)
    tilted = lierb.lie.se3.exp((0.3, -0.2, 0.5, 1.0, 2.0, 0.3))
    closed = problem.close(tilted)  # which the blade does not hold back
    assert abs(closed[2, 3]) < 1e-14


def _bad(function, **options):
    return lambda: lierb.velocity_constraint(**options)(function)()


REFUSED = {
    "square": (_bad(lambda omega: omega @ omega), ForceError, "is not linear in omega and v"),
    "moving": (_bad(lambda v: v[0] - 1.0), ForceError, "is -1 where omega and v are zero"),
    "of the body": (
        _bad(lambda body, v: v[0] * v[0] / body.mass),
        ForceError,
        "is not linear in omega and v",
    ),
    "time": (_bad(lambda t, v: v[0] * t), ForceError, r"expected any of \(R, r, omega, v, params"),
    "branch": (_bad(lambda v: v[0] if v[1] > 0.0 else v[1]), ForceError, "derivatives are needed"),
    "unit": (_bad(lambda v: v[0], unit="m"), lierb.errors.LierbError, "unit='m' is unknown"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_constraint_on_velocities_is_refused(what):
    make, error, told = REFUSED[what]
    with pytest.raises(error, match=told):
        make()


def test_the_body_and_parameters_are_seen():
    """Right: the centre of percussion, at (I + m a²)/(m a), of a point fixed across."""

    @lierb.velocity_constraint(unit="m/s", share=1.0)
    def percussion(omega, v, params, body):
        arm = body.com[0]
        reach = params.share * (body.inertia[2, 2] + body.mass * arm * arm) / (body.mass * arm)
        return v[1] + reach * omega[2]

    problem = lierb.Problem(
        sleigh().body, lierb.joints.planar(), constraints=percussion(share=[1.0, 2.0])
    )
    twists = problem.project(np.tile((0.0, 0.0, 1.0, 2.0, 0.5, 0.0), (2, 1)))
    reach = WHOLE / (MASS * ARM) * np.array([1.0, 2.0])
    np.testing.assert_allclose(twists[:, 4] + reach * twists[:, 2], 0.0, atol=1e-15)


def test_a_study_takes_it_from_a_file(tmp_path):
    (tmp_path / "skates.py").write_text(
        "import lierb\n\n\n@lierb.velocity_constraint(side=1.0)\n"
        "def skate(v, params):\n    return params.side * v[1]\n"
    )
    (tmp_path / "study.toml").write_text("""
[body]
mass = 1.0
inertia = [0.1, 0.1, 0.2]
[joint]
type = "planar"
[initial]
twist = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
[[problem.constraints]]
type = "python:skates.py:skate"
[sample]
n = 2
[sample.constraints.skate]
side = {distribution = "uniform", low = 1.0, high = 2.0}
[integrate]
dt = 0.01
t_end = 0.1
""")
    made = lierb.Study.load(tmp_path / "study.toml").batch(0, 2)
    assert made.problem.constraints[0].kind.function.name == "skate"

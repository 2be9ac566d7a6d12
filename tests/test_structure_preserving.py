"""Verlet, RATTLE and SHAKE on Lie groups, generalised α, BLieDF: orders, and what they keep."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import reference_numbers as ref
from cases import (
    GRAVITY,
    RECORD,
    SUBGROUP_JOINTS,
    box,
    column,
    final,
    in_python,
    integrate,
    long_but,
    slow_but,
    tilted,
    top,
)

import lierb
from lierb.errors import ArgumentError, FailedTrajectoryWarning
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    rotation_error_squared,
    smooth_residuals,
)
from lierb.kernels.mechanics.newton_euler import CSPACES
from lierb.kernels.stepping.generalised_alpha import Coefficients
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.descriptor import BodyDescriptor
from lierb.methods import METHODS
from lierb.results.failures import REMEDIES

WITH_CONSTRAINTS = ("RATTLie", "SHAKELie", "alpha3", "alpha2", "BLieDF1", "BLieDF2")
FORMS = [
    *itertools.product(("Verlet", "Verlet4"), ("SE3",)),
    *itertools.product(WITH_CONSTRAINTS, ("SE3", "SO3xR3")),
]
# Each form has a kernel of its own: an explicit and an implicit one run with the quick tests.
QUICK = [("Verlet", "SE3"), ("alpha2", "SO3xR3")]
SLOW = [
    ("RATTLie", "SO3xR3"), ("BLieDF2", "SO3xR3"), ("Verlet4", "SE3"), ("alpha3", "SE3"),
    ("BLieDF1", "SO3xR3"), ("SHAKELie", "SO3xR3"),
]  # fmt: skip
MARKS = [
    () if form in QUICK else pytest.mark.slow if form in SLOW else pytest.mark.long
    for form in FORMS
]
UNLIKE = ("spherical", "screw", "universal", "point_on_sphere", "fixed")  # in their rows
SYMPLECTIC = ("Verlet", "Verlet4", "RATTLie")
SHORTER = {"BLieDF1": 80, "BLieDF2": 8}  # times; then errors of fast turns have the order


def forms(*names: str) -> list:
    """The forms of these methods, or all; those outside QUICK are slow or long."""
    return [
        pytest.param(*form, marks=mark)
        for form, mark in zip(FORMS, MARKS, strict=True)
        if form[0] in names or not names
    ]


# ---- steps in plain Python --------------------------------------------------------------------


class Stepper:
    """A body on a joint, stepped on floats."""

    def __init__(self, problem, twist, name: str, cspace: str = "SE3", h: float = 0.02) -> None:
        method, self.h, self.t = METHODS[name], h, 0.0
        self.system, self.body, self.state, _ = in_python(
            problem, twist, lanes=1, cspace=cspace, update="local", multipliers=False,
            method=method.scheme(False, False),
            solver="subgroup" if method.limits is None else method.limits.solver,
        )  # fmt: skip
        self.method = method_of(self.system.plan)
        at = Interval(0.0, h, h)
        self.state = self.method.started(self.system, self.body, self.state, at)

    def step(self, state: Any = None, h: float | None = None) -> Any:
        """The state after a step; without a state, of this body, which moves on."""
        h = self.h if h is None else h
        before = self.state if state is None else state
        made = self.method.step(self.system, self.body, before, Interval(self.t, h, h))
        assert float(made.unsolved + 0.0) == 0.0
        if state is None:
            self.state, self.t = made.state, self.t + h
        return made.state

    def errors(self) -> np.ndarray:
        """Errors of position and rotation, and of their rates."""
        rows, motion = self.system.plan.rows, self.system.motion(self.body, self.state, self.t)
        x = self.system.plan.space.kinematics(self.body, *motion)
        squares = (
            position_error_squared(rows, x, self.body),
            rotation_error_squared(rows, x, self.body),
            *rate_errors_squared(rows, x, self.body, motion.velocity),
        )
        return np.sqrt([float(square + 0.0) for square in squares])


def box_top(gravity=GRAVITY):
    """The paper's box, held near a corner, and its twist."""
    held = lierb.joints.spherical(body_point=ref.BOX_POINT)
    return lierb.Problem(box(), held, gravity), held.twist(omega=ref.BOX_SPHERICAL_OMEGA_0)


# ---- order -------------------------------------------------------------------------------------


def floats(*vectors) -> list[np.ndarray]:
    """Vectors of a kernel's as arrays."""
    return [np.array(vector, dtype=float) for vector in vectors]


def slopes(errors) -> np.ndarray:
    """Orders between neighbouring steps of half the length."""
    errors = np.array(errors)
    return np.log2(errors[:-1] / errors[1:])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "cspace"), forms())
def test_heavy_top_has_the_order(name, cspace):
    """Pose, velocity and λ: the top turns by 150 rad in the run, at up to 0.15 rad in a step."""
    problem, twist0 = top()
    expected = ref.TOP_R_1, ref.TOP_OMEGA_1, ref.TOP_REACTION_1
    errors = []
    for dt in np.array((1e-3, 5e-4, 2.5e-4)) / SHORTER.get(name, 1):
        run = integrate(problem, twist0=twist0, dt=dt, t_end=1.0, method=name, cspace=cspace)
        assert run.summary["status"].to_pylist() == ["ok"]
        (*_, multipliers) = column(run.history, "lambda")
        # −λ, the force on the body in the ground's axes, as the frames of the joint are aligned
        ends = final(run, "position"), final(run, "omega"), -multipliers
        errors.append([np.abs(x - y).max() for x, y in zip(ends, expected, strict=True)])
    np.testing.assert_allclose(slopes(errors), METHODS[name].order, atol=0.15)


@pytest.mark.parametrize(("name", "cspace"), forms())
def test_torque_free_box_has_the_order(name, cspace):
    problem, twist0 = box_top(gravity=(0.0, 0.0, 0.0))
    errors = []
    for dt in np.array((0.01, 0.005, 0.0025)) / SHORTER.get(name, 1):
        run = integrate(problem, twist0=twist0, dt=dt, t_end=1.0, method=name, cspace=cspace)
        ends = final(run, "position"), final(run, "omega")
        expected = ref.BOX_SPHERICAL_R_1, ref.BOX_SPHERICAL_OMEGA_1
        errors.append([np.abs(x - y).max() for x, y in zip(ends, expected, strict=True)])
    np.testing.assert_allclose(slopes(errors), METHODS[name].order, atol=0.15)


DAMPED = {
    "Verlet": 2, "Verlet4": 3, "RATTLie": 2, "SHAKELie": 2, "alpha3": 2, "BLieDF1": 1, "BLieDF2": 2,
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", long_but(DAMPED, "Verlet"))
def test_forces_that_depend_on_velocity_and_time_have_the_order_documented(name):
    problem, twist0 = box_top()

    @lierb.wrench
    def shaken(t, R, r, omega, v):
        return (2.0 * np.sin(7.0 * t), 0.0, 0.0), (0.0, 0.0, 0.0)

    drag = lierb.forces.drag(linear=2.0, angular=0.3)
    problem = lierb.Problem(box(), problem.joint, GRAVITY, forces=[drag, shaken()])
    run = {"twist0": twist0, "t_end": 0.5}
    exact = integrate(problem, dt=1e-3, method="DOP853", **run)
    errors = []
    for dt in np.array((5e-3, 2.5e-3, 1.25e-3)) / SHORTER.get(name, 1):
        coarse = integrate(problem, dt=dt, method=name, **run)
        errors.append([
            np.abs(final(coarse, each) - final(exact, each)).max()
            for each in ("rotation", "omega", "work_final")
        ])  # fmt: skip
    assert (slopes(errors) > DAMPED[name] - 0.15).all()


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param("Verlet", marks=pytest.mark.long), "RATTLie"])
def test_output_between_steps_and_events_have_order_2(name):
    problem, twist0 = box_top()

    @lierb.event
    def level(t, R, r, omega, v):
        return r[2]

    run = {"twist0": twist0, "t_end": 1.0, "events": level(), "record": RECORD}
    run["save_at"] = (0.1, 0.1234567, 0.777)
    exact = lierb.integrate(problem, dt=1e-3, method="DOP853", **run)
    errors = []
    for dt in (0.01, 0.005, 0.0025):
        coarse = lierb.integrate(problem, dt=dt, method=name, **run)
        off = np.abs(coarse.rotation - exact.rotation).max(axis=(1, 2, 3))
        times = [np.array(each.events["t"].to_pylist()) for each in (coarse, exact)]
        errors.append([*off, np.abs(times[0] - times[1]).max()])
    np.testing.assert_allclose(slopes(errors), 2.0, atol=0.15)


@pytest.mark.slow
def test_heavy_top_reaches_the_motion_of_another_library():
    """Kynema-FMB's generalised α; errors of Verlet4 at this step are 4e-7, its own about 1e-7."""
    problem, twist0 = top()
    run = integrate(problem, twist0=twist0, dt=5e-4, t_end=1.0, method="Verlet4")
    moved = final(run, "position") - ref.TOP_CENTRE_OF_MASS
    np.testing.assert_allclose(moved, ref.TOP_KYNEMA_DISPLACEMENT_1, atol=3e-7)


# ---- constraints -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in SUBGROUP_JOINTS if n != "free"])
def test_verlet_keeps_every_subgroup_joint(name):
    body = Stepper(*tilted(name), "Verlet", h=0.05)
    for _ in range(5):
        body.step()
    assert (body.errors() < 1e-12).all()


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("name", slow_but(lierb.joints.JOINTS, *UNLIKE))
@pytest.mark.parametrize("method", WITH_CONSTRAINTS)
def test_methods_with_constraints_satisfy_every_joint(method, name, cspace):
    """RATTLie and α of index 2 satisfy those of the velocity too. Some joints make bodies fast."""
    h = 0.05 if name in SUBGROUP_JOINTS and cspace == "SE3" else 0.02
    body = Stepper(*tilted(name), method, cspace, h)
    for _ in range(5):
        body.step()
        errors = body.errors()
        assert (errors[:2] < 1e-12).all()
        if method in ("RATTLie", "alpha2"):
            assert (errors[2:] < 1e-11).all()  # rates, of up to 7 rad/s


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("method", WITH_CONSTRAINTS)
def test_steps_do_not_depend_on_the_unit_of_length(method, cspace):
    """Powers of two leave all digits alone where no sum mixes units: rounding of five steps."""
    ends = []
    for unit in (1.0, 2.0**-20, 2.0**7):
        size = box()
        body = lierb.Body(size.mass, size.inertia * unit**2)
        held = lierb.joints.spherical(body_point=np.multiply(unit, ref.BOX_POINT))
        problem = lierb.Problem(body, held, np.multiply(unit, GRAVITY))
        moving = Stepper(problem, held.twist(omega=ref.BOX_SPHERICAL_OMEGA_0), method, cspace)
        for _ in range(5):
            moving.step()
        (q, d), velocity = moving.system.motion(moving.body, moving.state, moving.t)[:2]
        lengths = np.divide([*floats(d, velocity[3:])], unit)
        ends.append(np.concatenate([*floats(q, velocity[:3]), *lengths]))
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-12)


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("name", lierb.joints.JOINTS)
def test_smooth_residuals_have_the_gradient_j(name, cspace):
    """Central differences of h along random twists, with errors of 1e-6²."""
    problem, twist = tilted(name)
    system, body, state, _ = in_python(
        problem, twist, lanes=1, cspace=cspace, solver="saddle", update="local", multipliers=False,
        method=METHODS["RATTLie"].scheme(False, False),
    )  # fmt: skip

    def values(x):
        moved = state._replace(chart=system.moved(state.chart, tuple(0.5 * x)))
        motion = system.motion(body, moved, 0.0)
        at = system.plan.space.kinematics(body, *motion)
        return np.array([float(h + 0.0) for h in smooth_residuals(system.plan.rows, at, body)])

    at = system.plan.space.kinematics(body, *system.motion(body, state, 0.0))
    rows = [[float(x + 0.0) for x in row.jacobian(at, body)] for row in system.plan.rows]
    assert np.abs(values(np.zeros(6))).max(initial=0.0) < 1e-13
    for direction in np.random.default_rng(3).normal(size=(3, 6)):
        slope = (values(1e-6 * direction) - values(-1e-6 * direction)) / 2e-6
        np.testing.assert_allclose(slope, np.reshape(rows, (-1, 6)) @ direction, atol=1e-9)


@lierb.constraint
def bowl(R, r):
    return r[2] - 0.5 * (r[0] ** 2 + 2.0 * r[1] ** 2), R[2, 0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "cspace"),
    [
        ("RATTLie", "SE3"),
        *(
            pytest.param(name, "SO3xR3", marks=pytest.mark.long)
            for name in ("alpha2", "SHAKELie", "BLieDF2")
        ),
    ],
)
def test_constraints_of_a_users_hold_and_have_the_order(name, cspace):
    """A bead in a bowl, with an axis kept horizontal; RK4 solves the saddle point."""
    bead = lierb.Problem(box(), lierb.joints.free(), GRAVITY, constraints=bowl())
    pose = np.eye(4)
    pose[:3, 3] = (0.3, 0.1, 0.05)
    pose = bead.close(pose)
    start = {"pose0": pose, "twist0": bead.project((0.3, 0.2, 2.0, 0.5, -0.3, 0.0), pose)}
    exact = integrate(bead, **start, dt=1e-3, t_end=1.0, method="RK4")
    errors = []
    for dt in (0.02, 0.01, 0.005):
        run = integrate(bead, **start, dt=dt, t_end=1.0, method=name, cspace=cspace)
        multipliers = [column(each.history, "lambda")[-1] for each in (run, exact)]
        off = [final(run, each) - final(exact, each) for each in ("position", "omega")]
        errors.append([np.abs(x).max() for x in (*off, multipliers[0] - multipliers[1])])
        x, y, z = final(run, "position")
        assert abs(z - 0.5 * (x**2 + 2.0 * y**2)) < 1e-14
        assert abs(final(run, "rotation").reshape(3, 3)[2, 0]) < 1e-14
    np.testing.assert_allclose(slopes(errors), 2.0, atol=0.15)


@pytest.mark.slow
def test_a_row_that_says_a_thing_twice_is_left_out():
    held = lierb.joints.spherical()

    @lierb.constraint
    def again(R, r):
        return r[2]

    run = {"twist0": held.twist(omega=(1.0, 0.0, 0.0)), "dt": 0.01, "t_end": 0.1}
    once, twice = (
        lierb.integrate(lierb.Problem(box(), held, constraints=more), method="RATTLie", **run)
        for more in ((), again())
    )
    np.testing.assert_allclose(twice.omega, once.omega, rtol=0, atol=1e-12)
    np.testing.assert_allclose(twice.rotation, once.rotation, rtol=0, atol=1e-12)


@pytest.mark.long
def test_convergence_compares_the_families():
    problem, twist0 = box_top()
    names = ("Verlet", "RATTLie", "SHAKELie", "alpha2", "BLieDF2", "BLieDF1")
    found = lierb.convergence(problem, names, (2e-3, 1e-3), twist0=twist0, t_end=0.5, repeats=1)
    for name in names:
        expected = pytest.approx(METHODS[name].order, abs=0.1)
        assert found.order(name, quantity="error.rotation") == expected
    counts = found.table["evaluations"].to_pylist()
    # the iterations of the last three evaluate forces
    assert counts == [500, 1000, 500, 1000, 250, 500, *[None] * 6]


@pytest.mark.parametrize("name", ["spherical", "planar", "schoenflies"])
def test_rattle_is_verlet_on_a_subgroup(name):
    """On SE(3) both are the same discrete Lagrangian system."""
    verlet, rattle = (Stepper(*tilted(name), method, h=0.05) for method in ("Verlet", "RATTLie"))
    for _ in range(5):
        verlet.step()
        rattle.step()
    poses = []
    for each in (verlet, rattle):  # in principal axes and in the joint's own
        _, _, _, numbers = in_python(
            *tilted(name), lanes=1, cspace="SE3", update="local", multipliers=False,
            solver=each.system.plan.solver, method=each.system.plan.method,
        )  # fmt: skip
        poses.append(np.concatenate(each.system.in_user_frames(each.body, numbers, each.state)))
    np.testing.assert_allclose(*poses, atol=1e-12)


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("name", ["spherical", "hook", "free"])
def test_shake_has_the_poses_of_rattle(name, cspace):
    """Its velocities differ by M⁻¹Jᵀ times a multiplier of h², by which rates of rows are wrong."""
    wrong = []
    for h in (0.02, 0.01):
        shake, rattle = (
            Stepper(*tilted(name), method, cspace, h) for method in ("SHAKELie", "RATTLie")
        )
        for _ in range(round(0.1 / h)):
            shake.step()
            rattle.step()
        for now, expected in zip(shake.state.chart, rattle.state.chart, strict=True):
            np.testing.assert_allclose(*floats(now, expected), atol=1e-12)
        form = BodyDescriptor(shake.system, shake.body)
        jacobian = np.reshape(form.constraints(shake.state.chart, 0.0).jacobian, (-1, 6)).astype(
            float
        )
        velocities = floats(shake.state.v_or_mu, rattle.state.v_or_mu)
        (momentum,) = floats(form.momentum(tuple(np.subtract(*velocities))))
        multipliers, *_ = np.linalg.lstsq(jacobian.T, momentum)
        np.testing.assert_allclose(jacobian.T @ multipliers, momentum, atol=1e-12)
        wrong.append(shake.errors()[2:].max())
    assert wrong == [0.0, 0.0] if name == "free" else slopes(wrong) == pytest.approx(2.0, abs=0.2)


def test_shake_has_central_differences_as_velocity():
    """On SO(3)×R³ those of the positions."""
    body = Stepper(*box_top(), "SHAKELie", "SO3xR3", h=0.02)
    places, velocities = [], []
    for _ in range(6):
        place, velocity = floats(body.state.chart[1], body.state.v_or_mu)
        places.append(place)
        velocities.append(velocity[3:])
        body.step()
    central = (np.array(places[2:]) - places[:-2]) / 0.04
    np.testing.assert_allclose(velocities[1:-1], central, atol=1e-12)


@pytest.mark.parametrize(("name", "weights"), [("BLieDF1", (-1, 1)), ("BLieDF2", (0.5, -2, 1.5))])
def test_bliedf_has_backward_differences_as_velocity(name, weights):
    """On SO(3)×R³ those of the positions; V̇ is that of the velocities."""
    body = Stepper(*box_top(), name, "SO3xR3", h=0.02)
    seen = []
    for _ in range(6):
        state = body.state
        seen.append(np.concatenate(floats(state.chart[1], state.v_or_mu, state.carried[:6])))
        body.step()
    for last in range(len(weights), 7):
        backward = np.dot(weights, seen[last - len(weights) : last]) / 0.02
        _, velocity, rate = np.split(seen[last - 1], (3, 9))
        np.testing.assert_allclose(velocity[3:], backward[:3], atol=1e-12)
        np.testing.assert_allclose(rate, backward[3:9], atol=1e-10)


# ---- structure ---------------------------------------------------------------------------------


def symplectic_form(mu: np.ndarray) -> np.ndarray:
    """Form of T*SO(3) in (ξ, δμ), δR = R ξ: δμ₂·ξ₁ − δμ₁·ξ₂ + μ·(ξ₁ × ξ₂)."""
    form = np.zeros((6, 6))
    form[:3, 3:], form[3:, :3] = np.eye(3), -np.eye(3)
    form[:3, :3] = np.array([[0, mu[2], -mu[1]], [-mu[2], 0, mu[0]], [mu[1], -mu[0], 0]])
    return form


@pytest.mark.parametrize(
    ("name", "is_symplectic"), [("Verlet", True), ("Verlet4", True), ("Heun", False)]
)
def test_step_is_symplectic(name, is_symplectic):
    """Jacobian A of a step, by central differences good to 1e-9: AᵀΩ₁A = Ω₀."""
    body = Stepper(*box_top(), name, h=0.05)

    def varied(x) -> Any:
        chart = body.system.moved(body.state.chart, (*0.5 * x[:3], 0.0, 0.0, 0.0))
        mu = tuple(a + b for a, b in zip(body.state.v_or_mu[:3], x[3:], strict=True))
        return body.step(body.state._replace(chart=chart, v_or_mu=(*mu, *body.state.v_or_mu[3:])))

    def numbers(state) -> tuple[np.ndarray, np.ndarray]:
        w, *v = state.chart[0]
        return np.array((w, *v), dtype=float), np.array(state.v_or_mu[:3], dtype=float)

    p, mu = numbers(varied(np.zeros(6)))
    columns = []
    for direction in 1e-5 * np.eye(6):
        (ahead, mu_ahead), (behind, mu_behind) = (
            numbers(varied(sign * direction)) for sign in (1.0, -1.0)
        )
        d = (ahead - behind) / 2e-5
        turned = 2.0 * (p[0] * d[1:] - d[0] * p[1:] - np.cross(p[1:], d[1:]))  # 2 p̄ ṗ
        columns.append(np.concatenate([turned, (mu_ahead - mu_behind) / 2e-5]))
    a = np.array(columns).T
    before = symplectic_form(np.array(body.state.v_or_mu[:3], dtype=float))
    off = np.abs(a.T @ symplectic_form(mu) @ a - before).max()
    assert (off < 1e-8) == is_symplectic
    assert is_symplectic or off > 1e-5


@pytest.mark.parametrize("name", SYMPLECTIC)
def test_step_back_returns(name):
    """The methods are symmetric."""
    body = Stepper(*box_top(), name, h=0.05)
    there = body.step(body.state)
    back = body.step(there, h=-0.05)
    for now, before in ((back.chart[0], body.state.chart[0]), (back.v_or_mu, body.state.v_or_mu)):
        np.testing.assert_allclose(*(np.array(x, dtype=float) for x in (now, before)), atol=1e-13)


@pytest.mark.parametrize(("name", "cspace"), forms("Verlet", "RATTLie", "SHAKELie"))
def test_momentum_is_kept(name, cspace):
    """Of a torque-free body all of it about the pivot; under gravity its vertical component."""
    run = {"dt": 0.02, "t_end": 4.0, "save_every": 10, "method": name, "cspace": cspace}
    for gravity, kept in (((0.0, 0.0, 0.0), slice(0, 3)), (GRAVITY, slice(2, 3))):
        problem, twist0 = box_top(gravity)
        momentum = integrate(problem, twist0=twist0, **run).momentum[:, 0, kept]
        # rounding of 200 steps, with an iteration that ends at some 1e-15
        np.testing.assert_allclose(momentum, momentum[:1].repeat(len(momentum), 0), atol=2e-13)


def energies(name: str, cspace: str, steps: int, every: int) -> np.ndarray:
    """|E − E₀| of 8 tops at saved steps of 5 ms, (rows, 8)."""
    problem, _ = box_top()
    rng = np.random.default_rng(0)
    omega = np.array(ref.BOX_SPHERICAL_OMEGA_0) + 0.5 * rng.normal(size=(8, 3))
    run = integrate(
        problem, twist0=problem.joint.twist(omega=omega), dt=5e-3, t_end=steps * 5e-3,
        save_every=every, measure_every=every, method=name, cspace=cspace,
    )  # fmt: skip
    assert set(run.summary["status"].to_pylist()) == {"ok"}
    return np.abs(column(run.history, "energy_drift").reshape(-1, 8))


@pytest.mark.parametrize(("name", "cspace"), forms("Verlet", "RATTLie", "SHAKELie"))
def test_energy_does_not_drift(name, cspace):
    drift = energies(name, cspace, 40_000, every=4)
    first, last = drift[: len(drift) // 10].max(), drift[len(drift) // 2 :].max()
    assert first < 0.01  # J
    assert last < 1.2 * first


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "cspace"), [f for f in FORMS if f[0] in (*SYMPLECTIC, "SHAKELie")]
)
def test_energy_does_not_drift_in_a_million_steps(name, cspace):
    drift = energies(name, cspace, 1_000_000, every=50)
    assert drift[len(drift) // 2 :].max() < 1.5 * drift[: len(drift) // 100].max()


# ---- trajectories and runs ---------------------------------------------------------------------


def twists(count: int) -> np.ndarray:
    """Slow to fast, so that lanes take different numbers of turns."""
    rng = np.random.default_rng(7)
    omega = rng.standard_normal((count, 3)) * 10.0 ** rng.uniform(-1.0, 1.2, (count, 1))
    return box_top()[0].joint.twist(omega=omega)


def bits(run, members=slice(None)) -> np.ndarray:
    """Every number of the history's states and λ of some members, as integers."""
    rows = [run.rotation, run.position, run.omega, run.v]
    rows.append(column(run.history, "lambda").reshape(len(run.t), -1, 3))
    flat = [row[:, members].reshape(len(run.t), -1) for row in rows]
    return np.concatenate(flat, axis=1).view(np.int64)


@pytest.mark.parametrize(("name", "cspace"), forms())
def test_bits_depend_on_the_trajectory_alone(name, cspace):
    problem, many = box_top()[0], twists(37)
    run = {"dt": 0.01, "t_end": 0.2, "save_every": 4, "method": name, "cspace": cspace}
    whole = integrate(problem, twist0=many, threads=2, **run)
    assert set(whole.summary["status"].to_pylist()) == {"ok"}
    np.testing.assert_array_equal(
        bits(integrate(problem, twist0=many, threads=1, **run)), bits(whole)
    )
    order = np.random.default_rng(1).permutation(37)[:20]
    np.testing.assert_array_equal(
        bits(integrate(problem, twist0=many[order], **run)), bits(whole, order)
    )
    iterations = whole.summary["iterations"].to_pylist()
    assert min(iterations) >= 20  # one a step at least
    for member in (0, 13, 36):
        alone = integrate(problem, twist0=many[member], **run)
        np.testing.assert_array_equal(bits(alone), bits(whole, [member]))
        assert alone.summary["iterations"].to_pylist() == [iterations[member]]


@pytest.mark.parametrize(("name", "cspace"), forms())
def test_end_goes_on_to_the_bits_of_one_run(name, cspace):
    problem, twist0 = box_top()[0], twists(5)
    run = {"dt": 0.01, "method": name, "cspace": cspace}
    whole = integrate(problem, twist0=twist0, t_end=0.4, save_every=40, **run)
    half = integrate(problem, twist0=twist0, t_end=0.2, save_every=20, **run)
    again = integrate(problem, **half.end, t_end=0.4, save_every=20, **run)
    np.testing.assert_array_equal(bits(again)[-1], bits(whole)[-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["alpha2", "BLieDF2"])
def test_multistep_methods_start_again_after_another_step_or_method(name):
    """They then start as from any other pose and twist, which conversion to user axes rounds."""
    problem, twist0 = box_top()
    run = {"cspace": "SO3xR3", "save_every": 20, "check": "off"}  # for rows of the velocity
    first = integrate(problem, twist0=twist0, dt=0.01, t_end=0.2, method=name, **run)
    end = first.end
    start = {"pose0": np.array(end["pose0"]), "twist0": end["twist0"], "t0": end["t0"]}
    for method, dt, is_same in (
        (name, 5e-3, True),
        ("RATTLie", 5e-3, True),
        (name, 1e-2, False),
    ):
        again, anew = (
            integrate(problem, **given, dt=dt, t_end=0.4, method=method, **run)
            for given in (end, start)
        )
        off = np.abs(again.omega[-1] - anew.omega[-1]).max()
        assert (off < 1e-11) == is_same
    other = integrate(problem, twist0=twist0, dt=0.01, t_end=0.2, method="RATTLie", **run).end
    integrate(problem, **other, dt=0.01, t_end=0.4, method=name, **run)


@pytest.mark.parametrize(
    ("name", "cspace"),
    [
        *QUICK,
        *(
            pytest.param(name, "SO3xR3", marks=pytest.mark.slow)
            for name in ("RATTLie", "BLieDF2", "SHAKELie")
        ),
    ],
)
def test_status_tells_that_an_iteration_has_not_converged(name, cspace):
    problem, many = box_top()[0], twists(3)
    many[1] *= 2e3
    run_of = {"dt": 0.01, "t_end": 0.2, "save_every": 4, "method": name, "cspace": cspace}
    with pytest.warns(FailedTrajectoryWarning, match="a smaller dt helps"):
        run = integrate(problem, twist0=many, **run_of)
    assert run.summary["status"].to_pylist() == ["ok", "no_convergence", "ok"]
    alone = integrate(problem, twist0=many[2], **run_of)
    np.testing.assert_array_equal(bits(run, [2]), bits(alone))
    assert "smaller dt" in REMEDIES["no_convergence"]


# ---- what is refused ---------------------------------------------------------------------------

REFUSED = [
    ("Verlet", "spherical", {"solver": "saddle"}, 'needs solver="subgroup", not solver="saddle"'),
    ("RATTLie", "spherical", {"solver": "subgroup"}, 'needs solver="saddle"'),
    ("Verlet", "spherical", {"cspace": "SO3xR3"}, 'needs cspace="SE3" or "reduced", not'),
    ("RATTLie", "spherical", {"cspace": "reduced"}, 'needs cspace="SE3" or "SO3xR3", not'),
    ("Verlet", "spherical", {"check": "off"}, 'Verlet needs check="raise", a start on the joint'),
    ("Verlet", "hook", {}, "proper subgroup of .*, not a hook joint; RATTLie"),
    ("Verlet", "free", {}, "not a free joint; RATTLie takes every joint"),
    ("alpha3", "spherical", {"update": "ambient"}, 'alpha3 needs update="local"'),
    ("alpha3", "spherical", {"save_at": [0.1]}, "alpha3 .* all its steps have one length"),
    ("alpha2", "spherical", {"max_steps": 5}, "alpha2 .* all its steps have one length"),
    ("SHAKELie", "spherical", {"save_at": [0.1]}, "SHAKELie .* all its steps have one length"),
    ("SHAKELie", "spherical", {"cspace": "reduced"}, 'SHAKELie needs cspace="SE3" or "SO3xR3"'),
    ("SHAKELie", "spherical", {"rtol": 1e-6}, "need a method with an embedded error"),
    ("BLieDF1", "spherical", {"save_at": [0.1]}, "BLieDF1 .* all its steps have one length"),
    ("BLieDF2", "spherical", {"max_steps": 5}, "BLieDF2 .* all its steps have one length"),
    ("BLieDF2", "spherical", {"update": "global"}, 'BLieDF2 needs update="local"'),
    ("BLieDF2", "spherical", {"solver": "subgroup"}, 'BLieDF2 needs solver="saddle"'),
    ("RATTLie", "spherical", {"rtol": 1e-6}, "need a method with an embedded error"),
]


@pytest.mark.parametrize(("method", "name", "options", "message"), REFUSED)
def test_options_that_a_method_cannot_take_are_refused(method, name, options, message):
    problem, twist0 = tilted(name)
    with pytest.raises(ArgumentError, match=message):
        lierb.integrate(problem, twist0=twist0, dt=0.01, t_end=0.2, method=method, **options)


def test_models_that_a_method_cannot_take_are_refused():
    problem, _ = tilted("spherical")

    @lierb.states(x=0.0)
    def heat(t):
        return {"x": t}

    @lierb.constraint
    def level(R, r):
        return r[2]

    run = {"dt": 0.01, "t_end": 0.2, "twist0": np.zeros(6)}
    with_state = lierb.Problem(problem.body, problem.joint, states=[heat()])
    with pytest.raises(ArgumentError, match="the motion alone, not the states of heat"):
        lierb.integrate(with_state, method="RATTLie", **run)
    held = lierb.Problem(problem.body, problem.joint, constraints=[level()])
    with pytest.raises(ArgumentError, match="no constraints beside the joint's, but level is one"):
        lierb.integrate(held, method="Verlet", **run)
    motor = lierb.forces.motor(speed=1.0)
    driven = lierb.Problem(problem.body, lierb.joints.revolute(), forces=motor)
    with pytest.raises(ArgumentError, match="of the pose, but motor is one of velocities"):
        lierb.integrate(driven, method="alpha2", **run)
    motor = lierb.forces.motor(position=0.1)
    driven = lierb.Problem(problem.body, lierb.joints.revolute(), forces=motor)
    with pytest.raises(ArgumentError, match="no constraints beside the joint's, but motor is one"):
        lierb.integrate(driven, method="Verlet", **run)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"rho": 1.5}, "from 0 to 1"), ({"rho": np.nan}, "finite"), ({"index": 1}, "3, or 2")],
)
def test_generalised_alpha_refuses(options, message):
    with pytest.raises(ArgumentError, match=message):
        lierb.methods.generalised_alpha(**options)


# ---- coefficients ------------------------------------------------------------------------------


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 1.0])
def test_alpha_damps_the_fastest_oscillation_by_rho(rho):
    """Spectral radius of a step for q̈ = −ω²q with hω → ∞, from Chung and Hulbert's equations."""
    c = Coefficients.of(rho)
    stiffness = 1e10  # (hω)²
    # (1 − α_m) a₁ + α_m a₀ = −(hω)² ((1 − α_f) q₁ + α_f q₀), of (q, hq̇, h²a)
    left = np.array([
        [1.0, 0.0, -c.beta],
        [0.0, 1.0, -c.gamma],
        [stiffness * (1.0 - c.alpha_f), 0.0, 1.0 - c.alpha_m],
    ])  # fmt: skip
    right = np.array([
        [1.0, 1.0, 0.5 - c.beta],
        [0.0, 1.0, 1.0 - c.gamma],
        [-stiffness * c.alpha_f, 0.0, -c.alpha_m],
    ])  # fmt: skip
    radius = np.abs(np.linalg.eigvals(np.linalg.solve(left, right))).max()
    assert radius == pytest.approx(rho, abs=2e-3)  # a triple eigenvalue, to the root of 1e-10

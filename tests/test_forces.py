"""Applied forces and motors against Newton's and Euler's equations in ground coordinates."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from cases import (
    BODY_FRAME,
    GRAVITY,
    GROUND_FRAME,
    RECORD,
    box,
    column,
    integrate,
    joint,
    rotation,
    tiered,
    tilted,
)
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ArgumentError, ForceError, TwistError, UnknownNameError

CSPACES = ("SE3", "SO3xR3")
EITHER = pytest.mark.parametrize("cspace", tiered(CSPACES, [], ["SE3"]))
BODIES = 3  # parameter sets in each test
T_END = 1.0


def swing(t, params):
    return params.peak * math.sin(3.0 * t)


@lierb.wrench(gain=0.0, centre=(0.0, 0.0, 0.0))
def odd_wrench(t, R, r, omega, v, params):
    """Every argument is used, in no way that is right by symmetry."""
    pull = -params.gain * (R.T @ (r - params.centre)) + 0.3 * params.gain * np.cos(2.0 * t) * v
    return params.gain * np.cross(omega, v), pull


def odd_reference(gain, centre):
    def function(t, R, r, omega, v):
        pull = -gain * (R.T @ (r - centre)) + 0.3 * gain * np.cos(2.0 * t) * v
        return gain * np.cross(omega, v), pull

    return oracle.wrench(function)


def drawn(name: str) -> dict[str, np.ndarray]:
    """Random parameters of one force, those of every body apart."""
    rng = np.random.default_rng(sum(map(ord, name)))

    def vectors(size):
        return rng.uniform(-size, size, (BODIES, 3))

    def numbers(low, high):
        return rng.uniform(low, high, BODIES)

    return {
        "thruster": lambda: {"torque": vectors(0.05), "force": vectors(2), "point": vectors(0.2)},
        "pull": lambda: {"torque": vectors(0.05), "force": vectors(5), "point": vectors(0.2)},
        "spring": lambda: {
            "body_point": vectors(0.2), "ground_point": vectors(0.5), "stiffness": numbers(5, 50),
            "damping": numbers(0, 2), "length": numbers(0, 0.5),
        },
        "torsional_spring": lambda: {
            # within half a turn of where the body swings: there the torque jumps
            "stiffness": numbers(0.1, 1), "damping": numbers(0, 0.1), "angle": numbers(-2.2, -1.4),
        },
        "drag": lambda: {
            "linear": numbers(0, 1), "quadratic": numbers(0, 1), "angular": numbers(0, 0.05),
            "point": vectors(0.2),
        },
        "motor": lambda: {"peak": numbers(-0.5, 0.5)},
        "function": lambda: {"gain": numbers(0.5, 5), "centre": vectors(0.5)},
    }[name]()  # fmt: skip


AXIAL = ("torsional_spring", "motor")
FORCES = {
    "thruster": lambda **p: lierb.forces.constant_wrench(frame="body", **p),
    "pull": lierb.forces.constant_wrench,
    "spring": lierb.forces.spring_damper,
    "torsional_spring": lierb.forces.torsional_spring,
    "drag": lierb.forces.drag,
    "motor": lambda **p: lierb.forces.motor(swing, **p),
    "function": odd_wrench,
}
REFERENCES = {
    "thruster": lambda **p: oracle.constant_wrench(frame="body", **p),
    "pull": oracle.constant_wrench,
    "spring": oracle.spring_damper,
    "torsional_spring": oracle.torsional_spring,
    "drag": oracle.drag,
    "motor": lambda peak: oracle.motor_torque(lambda t: peak * math.sin(3.0 * t)),
    "function": odd_reference,
}


def silent(name: str) -> dict[str, np.ndarray | float]:
    """Parameters with which a force is none: all forces then share one kernel."""
    return {key: np.zeros_like(value) for key, value in drawn(name).items()}


def case(held: str, acting: tuple[str, ...], quiet: tuple[str, ...] = ()):
    """A problem of several bodies with some forces, and others that are there but zero."""
    plain, twist0 = tilted(held)
    forces = [FORCES[name](**drawn(name)) for name in acting]
    forces += [FORCES[name](**silent(name)) for name in quiet]
    order = list(FORCES)
    placed = sorted(zip((*acting, *quiet), forces, strict=True), key=lambda x: order.index(x[0]))
    return lierb.Problem(plain.body, plain.joint, GRAVITY, [force for _, force in placed]), twist0


def expected(held: str, acting: tuple[str, ...], twist0, body: int) -> oracle.Trajectory:
    forces = [
        REFERENCES[name](**{key: value[body] for key, value in drawn(name).items()})
        for name in acting
    ]
    inertia = box(turned=True)
    return oracle.reference_trajectory(
        held, [0.0, T_END], mass=float(inertia.mass), inertia=inertia.inertia, twist0=twist0,
        ground_frame=GROUND_FRAME, body_frame=BODY_FRAME, gravity=GRAVITY, forces=forces,
    )  # fmt: skip


def run(problem, twist0, **options):
    """One record and one method throughout: all forces at once compile for long."""
    settings = {"dt": 2e-4, "t_end": T_END, "record": (*RECORD, "energy")} | options
    return integrate(problem, twist0=twist0, **settings)


def assert_moves_as(problem, twist0, held, acting, cspace):
    history = run(problem, twist0, cspace=cspace).history
    columns = {
        name: column(history, name).reshape(2, BODIES, -1)
        for name in (
            "rotation",
            "position",
            "omega",
            "v",
            "lambda",
            "reaction",
            "energy",
            "work",
        )
    }
    for body in range(BODIES):
        ref = expected(held, acting, twist0, body)
        for name, wanted in (
            ("rotation", ref.R[-1].ravel()), ("position", ref.r[-1]),
            ("omega", ref.omega[-1]), ("v", ref.v[-1]),
        ):  # fmt: skip
            # RK4's error at 2e-4 and rounding, which swings of 50 rad/s² amplify
            np.testing.assert_allclose(columns[name][-1, body], wanted, atol=1e-9, err_msg=name)
        size = np.abs(ref.reaction[-1]).max()
        np.testing.assert_allclose(columns["lambda"][-1, body], ref.multipliers[-1], atol=1e-8)
        np.testing.assert_allclose(
            columns["reaction"][-1, body], ref.reaction[-1], atol=1e-9 * (1 + size)
        )
        gained = columns["energy"][-1, body] - columns["energy"][0, body]
        np.testing.assert_allclose(gained, ref.energy[-1] - ref.energy[0], atol=1e-9)
        # nothing else changes E: what was gained is the work
        np.testing.assert_allclose(columns["work"][-1, body], gained, atol=1e-9)


@pytest.mark.parametrize("cspace", tiered(CSPACES, [], ["SE3"]))
@pytest.mark.parametrize("name", FORCES)
def test_force_moves_the_body_as_newton_and_euler_say(name, cspace):
    quiet = tuple(other for other in FORCES if other != name)
    problem, twist0 = case("revolute", (name,), quiet)
    assert_moves_as(problem, twist0, "revolute", (name,), cspace)


@pytest.mark.parametrize("cspace", tiered(CSPACES, [], ["SE3"]))
@pytest.mark.parametrize(
    ("held", "acting"),
    [
        ("revolute", tuple(FORCES)),
        # test_gain_reduced_and_saddle_agree_under_forces has a saddle point
        pytest.param(
            "universal",
            tuple(name for name in FORCES if name not in AXIAL),
            marks=pytest.mark.long,
        ),
    ],
)
def test_forces_add_up(held, acting, cspace):
    problem, twist0 = case(held, acting)
    assert_moves_as(problem, twist0, held, acting, cspace)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"solver": "saddle"}, {"cspace": "reduced"}])
def test_gain_reduced_and_saddle_agree_under_forces(options):
    problem, twist0 = case("revolute", tuple(FORCES))
    summaries = [run(problem, twist0, dt=1e-3, t_end=0.5, **o).summary for o in ({}, options)]
    for name in ("rotation", "position", "omega", "v"):
        # the same differential equation by the same method: rounding, over 500 steps
        np.testing.assert_allclose(
            column(summaries[0], name), column(summaries[1], name), atol=1e-11
        )


@pytest.mark.slow
def test_spring_off_the_centre_swings_harmonically():
    held = lierb.joints.prismatic(axis=(1.0, 2.0, 2.0))
    axis = np.array((1.0, 2.0, 2.0)) / 3.0
    spring = lierb.forces.spring_damper(
        (0.1, 0.0, 0.0), 0.5 * axis + (0.1, 0, 0), stiffness=[3.0, 8.0]
    )
    problem = lierb.Problem(lierb.Body(2.0, (1.0, 1.0, 1.0)), held, forces=spring)
    result = lierb.integrate(problem, twist0=held.twist(), dt=5e-4, t_end=1.0, cspace="reduced")
    place = 0.5 * (1.0 - np.cos(np.sqrt([1.5, 4.0])))  # x₀(1 − cos √(k/m) t) from rest
    # RK4 at 5e-4 of ω ≤ 2 rad/s: errors of (ωh)⁴/120
    position = column(result.summary, "position")
    np.testing.assert_allclose(position, np.outer(place, axis), atol=1e-13)
    assert max(result.summary["energy_drift_max"].to_pylist()) < 1e-13


# ---- motors ------------------------------------------------------------------------------------


def varying(t, params):
    return params.start + params.ramp * t * t + params.sway * math.sin(t)


def driven(body, held, start, drag=0.0, ramp=0.0, sway=0.0) -> lierb.Problem:
    """Run a motor of that speed, all from one kernel."""
    motor = lierb.forces.motor(speed=varying, start=start, ramp=ramp, sway=sway)
    return lierb.Problem(body, held, GRAVITY, [motor, lierb.forces.drag(linear=drag)])


def ramped(start) -> lierb.Problem:
    plain, _ = tilted("revolute")
    return driven(plain.body, plain.joint, start, drag=0.4, ramp=0.5)


@pytest.mark.parametrize("cspace", tiered(CSPACES, [], ["SE3"]))
def test_speed_motor_keeps_its_speed_and_tells_its_torque(cspace):
    start = np.array((1.0, -2.0))
    problem = ramped(start)
    twist0 = problem.project(np.zeros(6))
    result = run(problem, twist0, cspace=cspace)
    # w is a square, which methods of order 2 and more integrate exactly: rounding of 5000 steps
    assert max(result.summary["rotation_rate_error_max"].to_pylist()) < 1e-12
    for body, first in enumerate(start):
        ref = oracle.reference_trajectory(
            "revolute", [T_END], mass=float(problem.body.mass), inertia=problem.body.inertia,
            twist0=twist0[body], ground_frame=GROUND_FRAME, body_frame=BODY_FRAME, gravity=GRAVITY,
            forces=[oracle.drag(linear=0.4)],
            speed=(lambda t, w=first: w + 0.5 * t * t, lambda t: t),
        )  # fmt: skip
        history = result.history
        last = len(start) + body
        np.testing.assert_allclose(column(history, "position")[last], ref.r[-1], atol=1e-10)
        np.testing.assert_allclose(column(history, "lambda")[last], ref.multipliers[-1], atol=1e-9)
        np.testing.assert_allclose(column(history, "reaction")[last], ref.reaction[-1], atol=1e-9)


@pytest.mark.slow
def test_speed_motor_rejects_a_twist_of_another_speed():
    problem = ramped(1.0)
    with pytest.raises(TwistError, match=r"revolute joint with motor: rotation rate 1 .*motor: -1"):
        run(problem, np.zeros(6))


def test_speed_motor_has_no_place_in_the_reduced_space():
    with pytest.raises(ArgumentError, match='no constraints, but motor is one; use cspace="SE3"'):
        lierb.integrate(ramped(1.0), twist0=np.zeros(6), dt=1e-3, t_end=0.1, cspace="reduced")


# ---- work --------------------------------------------------------------------------------------

MASS, MOMENT = 2.0, 0.5  # kg; kg m² about every axis
SPEED, SPIN = 3.0, 4.0  # m/s along the body's e₁; rad/s about e₃
LOSSES = ("linear", "quadratic", "angular")


def lone_forces():
    """One free body for each force, on which that one acts alone, and the work that it does."""
    x, z = np.array((1.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0))
    strength = 0.7
    slow, still = math.exp(-2.0 * strength / MASS), math.exp(-2.0 * strength / MOMENT)
    braked = SPEED / (1.0 + strength * SPEED / MASS)  # v′ = −(q/m) v²
    pushed = strength * (SPEED + 0.5 * strength / MASS)
    turned = strength * (SPIN + 0.5 * strength / MOMENT)
    work = {
        "linear": 0.5 * MASS * SPEED**2 * (slow - 1.0),
        "quadratic": 0.5 * MASS * (braked**2 - SPEED**2),
        "angular": 0.5 * MOMENT * SPIN**2 * (still - 1.0),
        "thrust": pushed,
        "twist": turned,
        "ground torque": turned,
        "ground force": 0.0,  # of a potential
    }
    alone = np.eye(len(work)) * strength

    def of(name, direction=1.0):
        return np.multiply.outer(alone[list(work).index(name)], direction)

    forces = [
        lierb.forces.drag(**{name: of(name) for name in LOSSES}),
        lierb.forces.constant_wrench(of("twist", z), of("thrust", x), frame="body"),
        lierb.forces.constant_wrench(of("ground torque", z), of("ground force", x)),
    ]
    spins = np.array([name in ("angular", "twist", "ground torque") for name in work])
    twist0 = np.zeros((len(work), 6))
    twist0[spins, 2], twist0[~spins, 3] = SPIN, SPEED
    body = lierb.Body(MASS, (MOMENT,) * 3)
    return lierb.Problem(body, lierb.joints.free(), forces=forces), twist0, list(work.values())


@EITHER
def test_work_is_that_of_the_closed_form(cspace):
    problem, twist0, work = lone_forces()
    options = {"twist0": twist0, "cspace": cspace, "t_end": 1.0, "record": "energy"}
    result = lierb.integrate(problem, dt=1e-3, save_every=500, **options)
    # RK4 on rates up to 3 1/s: (3e-3)⁴/120 of 20 J, and rounding of 1000 steps
    np.testing.assert_allclose(result.summary["work_final"], work, rtol=0, atol=1e-11)
    assert max(result.summary["energy_drift_max"].to_pylist()) < 1e-11
    history = {n: column(result.history, n).reshape(3, -1) for n in ("energy", "work")}
    drift = column(result.history, "energy_drift").reshape(3, -1)
    gained = history["energy"] - history["energy"][0]
    np.testing.assert_array_equal(drift, gained - history["work"])
    np.testing.assert_array_equal(history["work"][-1], result.summary["work_final"])


@pytest.mark.slow
def test_energy_drift_falls_with_the_order_of_the_method():
    """All forces at once: their work, several J, is no drift."""
    problem, twist0 = case("revolute", tuple(FORCES))
    runs = [run(problem, twist0, dt=dt, cspace="reduced").summary for dt in (8e-3, 4e-3)]
    coarse, fine = (column(summary, "energy_drift_max") for summary in runs)
    assert np.abs(column(runs[0], "work_final")).min() > 0.1
    # Each halving of the step takes 2⁴ off, as far as terms of order 5 let it.
    np.testing.assert_array_less(8.0, coarse / fine)
    for body in range(BODIES):
        ref = expected("revolute", tuple(FORCES), twist0, body)
        gained = ref.energy[-1] - ref.energy[0]
        # RK4's own error at 4e-3, which the drift tells the size of
        assert abs(runs[1]["work_final"][body].as_py() - gained) < 20 * fine.max()


@lierb.wrench(stiffness=20.0, damping=0.0)
def strut(t, R, r, omega, v, params):
    """A spring and a damper in one wrench, of which the potential is the spring's alone."""
    return (0.0, 0.0, 0.0), -params.stiffness * R.T @ r - params.damping * v


@strut.potential
def stretched(R, r, params):
    return params.stiffness * (r @ r) / 2


@pytest.mark.slow
def test_work_of_a_function_is_what_its_potential_lacks():
    stiffness, damping, speed = 20.0, np.array((0.0, 1.5)), 3.0
    body, held = lierb.Body(MASS, (MOMENT,) * 3), lierb.joints.free()
    problem = lierb.Problem(body, held, forces=strut(damping=damping))
    turn = rotation(0.3, -0.8, 0.5)
    pose0 = np.block([[turn, np.zeros((3, 1))], [np.zeros(3), 1.0]])
    twist0 = (0.0, 0.0, 0.0, speed, 0.0, 0.0)
    summary = lierb.integrate(problem, twist0=twist0, pose0=pose0, dt=1e-3, t_end=1.0).summary
    decay = damping / (2.0 * MASS)
    pace = np.sqrt(stiffness / MASS - decay**2)
    place = speed / pace * np.exp(-decay) * np.sin(pace)
    rate = speed * np.exp(-decay) * (np.cos(pace) - decay / pace * np.sin(pace))
    energy = 0.5 * MASS * rate**2 + 0.5 * stiffness * place**2
    # RK4 on 3 rad/s: (3e-3)⁴/120 of 9 J a period, and rounding of 1000 steps
    work = column(summary, "work_final")
    np.testing.assert_allclose(work, energy - 0.5 * MASS * speed**2, rtol=0, atol=1e-11)
    assert abs(work[0]) < 1e-13  # no damping: rounding of power and potential, 1000 times
    assert max(summary["energy_drift_max"].to_pylist()) < 1e-11


def test_potential_has_to_be_differentiable():
    @lierb.wrench
    def push(t, R, r, omega, v, params):
        return (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)

    @push.potential
    def wall(R, r, params):
        return -r[0] if r[0] > 0.0 else 0.0

    with pytest.raises(ForceError, match=r"wall must run for many bodies at once.*lierb\.where"):
        push()


@EITHER
def test_work_of_a_speed_motor_is_that_of_a_driven_pendulum(cspace):
    """φ̇ = w(t) takes ½I(w² − w₀²) + m g ℓ (cos φ₀ − cos φ) from the motor."""
    held = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.4))
    start = np.array((1.0, -2.0))
    problem = driven(lierb.Body(MASS, (MOMENT,) * 3), held, start, sway=1.0)
    runs = [
        run(problem, problem.project(np.zeros(6)), dt=dt, t_end=2.0, cspace=cspace).summary
        for dt in (2e-2, 1e-2)
    ]
    angle, speed = start * 2.0 + 1.0 - math.cos(2.0), start + math.sin(2.0)
    kinetic = 0.5 * (MOMENT + MASS * 0.4**2) * (speed**2 - start**2)
    work = kinetic + MASS * 9.81 * 0.4 * (1.0 - np.cos(angle))
    # RK4's own: 3e-9 J of 16 J in fine steps, 16 times as much in coarse ones
    errors = [np.abs(column(summary, "work_final") - work).max() for summary in runs]
    drifts = [max(summary["energy_drift_max"].to_pylist()) for summary in runs]
    assert errors[1] < 1e-8
    assert errors[0] > 8.0 * errors[1]
    assert drifts[0] > 8.0 * drifts[1]
    assert drifts[1] < 1e-8


# ---- functions that see their body -------------------------------------------------------------

FIELD = np.array(GRAVITY)


@lierb.wrench
def weight(t, R, r, omega, v, params, body):
    """Gravity, at the centre of mass."""
    pull = body.mass * (R.T @ FIELD)
    return np.cross(body.com, pull), pull


@weight.potential
def height(R, r, params, body):
    return -body.mass * (FIELD @ (r + R @ body.com))


def unlike_bodies(count: int = 3) -> lierb.Body:
    """Boxes of several masses, each turned and off its origin."""
    rng = np.random.default_rng(5)
    masses, coms = rng.uniform(1, 3, count), rng.uniform(-0.2, 0.2, (count, 3))
    about_com = np.array([m * box(turned=True).inertia for m in masses])
    shift = [np.eye(3) * (c @ c) - np.outer(c, c) for c in coms]
    return lierb.Body(masses, about_com + masses[:, None, None] * np.array(shift), coms)


@pytest.mark.slow
def test_weight_of_a_function_is_gravity():
    bodies, held = unlike_bodies(), joint("spherical")
    twist0 = lierb.Problem(bodies, held).project(np.array((1.0, 2.0, 0.5, 0.0, 0.0, 0.0)))
    options = {"twist0": twist0, "dt": 2e-3, "t_end": 0.5, "method": "Euler"}
    found = lierb.integrate(lierb.Problem(bodies, held, forces=weight()), **options).summary
    built_in = lierb.integrate(lierb.Problem(bodies, held, GRAVITY), **options).summary
    for name in ("rotation", "position", "omega", "v"):
        # the same equations, formed in another order: rounding, over 250 steps
        np.testing.assert_allclose(column(found, name), column(built_in, name), atol=1e-11)
    drift = column(found, "energy_drift_max"), column(built_in, "energy_drift_max")
    np.testing.assert_allclose(*drift, atol=1e-11)


@EITHER
def test_inertia_is_about_the_centre_of_mass_and_in_body_axes(cspace):
    bodies = unlike_bodies()
    if cspace == "SO3xR3":
        bodies = lierb.Body(bodies.mass, bodies.inertia)
    frames = {"ground_frame": GROUND_FRAME, "body_frame": BODY_FRAME}
    # at rest but for its turning about the centre of mass: then that stays where it is
    omega = np.tile((3.0, -2.0, 1.0), (3, 1))
    twist0 = np.hstack([omega, -np.cross(omega, bodies.com)])

    def still(t, R, r, omega, v, body):  # no parameters, so no params
        return np.cross(omega, body.inertia @ omega), np.zeros(3)

    problem = lierb.Problem(bodies, lierb.joints.free(**frames), forces=lierb.wrench(still)())
    options = {"dt": 2e-3, "t_end": 0.25, "method": "Euler", "cspace": cspace}
    found = lierb.integrate(problem, twist0=twist0, **options).summary
    # ω and v are constant, whatever the method: rounding, over 125 steps
    np.testing.assert_allclose(column(found, "omega"), omega, atol=1e-12)


@pytest.mark.slow
def test_motors_see_their_body():
    def heavy(t, body, params):
        return params.gain * body.mass * math.sin(3.0 * t)

    plain, twist0 = tilted("revolute")
    bodies = unlike_bodies()
    bodies = lierb.Body(bodies.mass, bodies.inertia)
    gain = np.array((0.1, 0.2, 0.3))
    ends = []
    for seen, told in ((1.0, 0.0), (0.0, 1.0)):  # one of the motors is silent
        motors = [
            lierb.forces.motor(heavy, gain=seen * gain),
            lierb.forces.motor(swing, peak=told * gain * bodies.mass),
        ]
        problem = lierb.Problem(bodies, plain.joint, forces=motors)
        result = lierb.integrate(problem, twist0=twist0, dt=1e-3, t_end=0.25, method="Euler")
        ends.append(column(result.summary, "omega"))
    np.testing.assert_allclose(*ends, atol=1e-13)  # one rounding of the torque apart


@pytest.mark.slow
def test_constraints_see_their_body():
    def held_by_mass(R, r, params, body):
        end = r + R @ body.com
        return end @ end / (2.0 * body.mass) - body.mass / 2.0  # ‖end‖ = mass

    bodies = unlike_bodies()
    problem = lierb.Problem(
        bodies, lierb.joints.free(), GRAVITY, constraints=lierb.constraint(held_by_mass)()
    )
    poses = problem.close(np.array(GROUND_FRAME))
    ends = poses[:, :3, 3] + np.einsum("bij,bj->bi", poses[:, :3, :3], bodies.com)
    # CLOSED, of lierb.model.problem, over the slope
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), bodies.mass, atol=1e-12)
    twists = problem.project((1.0, 2.0, 0.5, 0.1, 0.2, 0.3), poses)
    summary = lierb.integrate(problem, twist0=twists, pose0=poses, dt=1e-3, t_end=0.1).summary
    # RK4's error: (ωh)⁴ of some 10 rad/s
    assert max(summary["position_error_max"].to_pylist()) < 1e-9
    assert max(summary["velocity_error_max"].to_pylist()) < 1e-7


@pytest.mark.parametrize(
    "function",
    [
        lambda t, R, r, omega, v, params, bodies: (r, r),
        lambda t, body: (0.0, 0.0),
        lambda R, r, omega, v: (r, r),
    ],
)
def test_form_is_told(function):
    with pytest.raises(
        ForceError, match=r"form \(t, R, r, omega, v, params\), and body, states or controls after"
    ):
        lierb.wrench(function)()


# ---- what the energy covers --------------------------------------------------------------------


@pytest.mark.slow
def test_energy_says_what_it_covers():
    problem, twist0 = case("revolute", tuple(FORCES))
    result = run(problem, twist0, dt=1e-3, t_end=1e-3, cspace="reduced")
    covers = result.summary.schema.field("energy_drift_max").metadata[b"covers"].decode()
    assert covers == (
        "kinetic energy; potential energy of gravity, constant_wrench, spring_damper, "
        "torsional_spring; less the work of constant_wrench, constant_wrench's torque, "
        "spring_damper's damping, torsional_spring's damping, drag, motor, odd_wrench"
    )


@pytest.mark.slow
def test_potential_of_a_function_counts_in_the_energy():
    problem = lierb.Problem(box(), lierb.joints.free(), GRAVITY, strut())
    twist0 = (1.0, 2.0, 3.0, 0.5, -0.3, 0.2)
    summary = lierb.integrate(problem, twist0=twist0, dt=1e-4, t_end=0.5).summary
    # RK4's error at 1e-4 is below rounding; energies are about 5 J
    assert summary["energy_drift_max"][0].as_py() < 1e-12
    covers = summary.schema.field("energy_drift_max").metadata[b"covers"].decode()
    assert covers == (
        "kinetic energy; potential energy of gravity, strut; "
        "less the work of strut beyond its potential"
    )


# ---- arguments ---------------------------------------------------------------------------------


@pytest.mark.parametrize("held", ["spherical", "universal", "free", "point_on_sphere"])
def test_axial_force_needs_a_joint_with_an_axis(held):
    with pytest.raises(
        ForceError, match=rf"torsional_spring acts about .* a {held} joint does not"
    ):
        lierb.Problem(box(), joint(held), forces=[lierb.forces.torsional_spring(stiffness=1.0)])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: lierb.forces.drag(linear=[0.1, -0.2]), ArgumentError, r"linear\[1\] is -0\.2"),
        (lambda: lierb.forces.drag(point=(1.0, 2.0)), ArgumentError, r"point has shape \(2,\)"),
        (lambda: lierb.forces.constant_wrench(frame="boddy"), UnknownNameError, "'body'"),
        (lambda: lierb.forces.motor(), ArgumentError, "torque= or speed="),
        (lambda: lierb.forces.motor(1.0, speed=2.0), ArgumentError, "torque= or speed="),
        (lambda: lierb.forces.motor(1.0, peak=2.0), ArgumentError, "peak: only a function"),
        (
            lambda: lierb.forces.spring_damper(stiffness=[1, 2], damping=[1, 2, 3]),
            ArgumentError,
            r"spring_damper\.stiffness has 2, spring_damper\.damping has 3",
        ),
    ],
)  # fmt: skip
def test_bad_parameter_is_named(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_problem_takes_forces_only():
    held = lierb.joints.free()
    with pytest.raises(ArgumentError, match=r"forces\[0\] is the function odd_wrench; call it"):
        lierb.Problem(box(), held, forces=odd_wrench)
    with pytest.raises(ArgumentError, match=r"forces\[1\] must be a force made by lierb, got 3"):
        lierb.Problem(box(), held, forces=[odd_wrench(), 3])
    with pytest.raises(ArgumentError, match=r"forces\[0\] must be a force made by lierb, got 3"):
        lierb.Mechanism(lierb.Link("held", box(), held), forces=[3])


def test_parameters_of_forces_set_the_number_of_bodies():
    held = lierb.joints.free()
    problem = lierb.Problem(box(), held, forces=[lierb.forces.drag(linear=[0.1, 0.2])])
    assert problem.batch_size() == 2
    with pytest.raises(ArgumentError, match=r"drag\.linear has 2, twist0 has 3"):
        lierb.integrate(problem, twist0=np.zeros((3, 6)), dt=1e-3, t_end=0.1)


# ---- friction, stops and slides of joints ------------------------------------------------------

COULOMB, SLOW, STIFF, START = 0.2, 0.5, 40.0, 3.0
ACTING = ("viscous", "coulomb", "stop", "stop_beyond_pi", "spring", "slide", "slide_stop", "motor")


@pytest.fixture(scope="module")
def joints_with_forces():
    """One cylindrical joint for each of ACTING, on which that force acts and no other.

    All turn at START rad/s, or slide at 0.3 m/s: the two are apart, for the axis is fixed.
    """
    held = joint("cylindrical")

    def only(**values):
        return np.array([values.get(name, 0.0) for name in ACTING])

    forces = [
        lierb.forces.joint_friction(
            viscous=only(viscous=0.05), coulomb=only(coulomb=COULOMB), speed=SLOW
        ),
        lierb.forces.joint_limit(
            lower=only(stop=-2.0, stop_beyond_pi=2.0),
            upper=only(stop=0.5, stop_beyond_pi=2 * np.pi - 2.0),
            stiffness=only(stop=STIFF, stop_beyond_pi=STIFF),
        ),
        lierb.forces.slide_spring(
            stiffness=only(spring=50.0), damping=only(spring=3.0), position=only(spring=0.2)
        ),
        lierb.forces.slide_friction(
            viscous=only(slide=2.0), coulomb=only(slide=1.0), speed=SLOW
        ),
        lierb.forces.slide_limit(
            lower=-0.1, upper=0.1, stiffness=only(slide_stop=500.0), damping=only(slide_stop=20.0)
        ),
        lierb.forces.motor(force=only(motor=1.5)),
    ]  # fmt: skip
    turning = np.isin(ACTING, ("viscous", "coulomb", "stop", "stop_beyond_pi"))
    rates = np.where(turning[:, None], (START, 0.0), (0.0, 0.3))
    places = np.where((np.array(ACTING) == "stop_beyond_pi")[:, None], (2.5, 0.0), (0.0, 0.0))
    problem = lierb.Problem(box(turned=True), held, forces=forces)
    result = integrate(
        problem, pose0=held.pose(places), twist0=held.twist(velocities=rates, coordinates=places),
        dt=2.5e-4, t_end=1.0, save_every=400, record=("state", "energy"), cspace="SE3",
    )  # fmt: skip
    axis = held.body_frame[:3, 2]
    arm = np.cross(axis, held.body_frame[:3, 3])  # the centre of mass is at the origin
    inertia = axis @ problem.body.inertia @ axis + float(problem.body.mass) * (arm @ arm)
    poses = np.zeros((*result.omega.shape[:2], 4, 4)) + np.eye(4)
    poses[..., :3, :3], poses[..., :3, 3] = result.rotation, result.position
    flat, shape = poses.reshape(-1, 4, 4), (*poses.shape[:2], 2)
    twists = np.concatenate([result.omega, result.v], axis=-1).reshape(-1, 6)
    places = held.coordinates(flat).reshape(shape).swapaxes(0, 1)
    rates = held.velocities(twists, flat).reshape(shape).swapaxes(0, 1)
    t = np.linspace(0.0, 1.0, 11)
    return {
        name: (t, places[i].T, rates[i].T, result.summary["energy_drift_max"][i].as_py())
        for i, name in enumerate(ACTING)
    } | {"inertia": inertia}


@pytest.mark.slow
@pytest.mark.parametrize("name", ACTING)
def test_joint_forces_keep_account_of_energy(joints_with_forces, name):
    *_, drift = joints_with_forces[name]
    assert drift < 1e-6  # of some joules; one step of 0.25 ms meets each stop


def test_viscous_joint_friction_slows_exponentially(joints_with_forces):
    t, _, (turning, _), _ = joints_with_forces["viscous"]
    inertia = joints_with_forces["inertia"]
    np.testing.assert_allclose(turning, START * np.exp(-0.05 / inertia * t), rtol=1e-10)


@pytest.mark.parametrize("name", ["coulomb", "slide"])
def test_coulomb_friction_slows_as_its_smooth_law_says(joints_with_forces, name):
    """dω √(ω² + s²)/ω = −k/I dt; of the slide with a viscous part, by DOP853."""
    t, _, rates, _ = joints_with_forces[name]
    inertia = joints_with_forces["inertia"]
    if name == "coulomb":
        root = np.sqrt(rates[0] ** 2 + SLOW**2)
        passed = root - SLOW * np.arcsinh(SLOW / rates[0])
        np.testing.assert_allclose(passed - passed[0], -COULOMB / inertia * t, rtol=0, atol=1e-9)
        return
    mass = float(box().mass)
    solution = solve_ivp(
        lambda _, u: -(2.0 * u + u / np.sqrt(u * u + SLOW**2)) / mass,
        (0.0, 1.0), [0.3], "DOP853", t, rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(rates[1], solution.y[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize(("name", "before"), [("stop", 0.5), ("stop_beyond_pi", 2 * np.pi - 4.5)])
def test_a_stop_sends_the_joint_back(joints_with_forces, name, before):
    """Free to the stop, half a period on its spring, back at the same speed, also beyond ±π."""
    t, (angle, _), (rate, _), _ = joints_with_forces[name]
    met = before / START
    pace = np.sqrt(STIFF / joints_with_forces["inertia"])
    left = met + np.pi / pace
    assert left < 1.0  # it comes back in this time
    since = np.clip(t - met, 0.0, np.pi / pace)
    start = {"stop": 0.0, "stop_beyond_pi": 2.5}[name]
    expected = start + START * np.minimum(t, met) + START / pace * np.sin(pace * since)
    expected -= START * np.maximum(t - left, 0.0)
    off = np.angle(np.exp(1j * (angle - expected)))
    # of the two steps that meet the stop and leave it: k ω dt² / I each, within them
    np.testing.assert_allclose(off, 0.0, atol=2e-5)
    assert rate[-1] == pytest.approx(-START, rel=1e-5)


def test_slide_spring_is_a_damped_oscillator(joints_with_forces):
    t, (_, place), _, _ = joints_with_forces["spring"]
    mass = float(box().mass)
    decay, pace = 1.5 / mass, np.sqrt(50.0 / mass - (1.5 / mass) ** 2)
    swing = -0.2 * np.cos(pace * t) + (0.3 - 0.2 * decay) / pace * np.sin(pace * t)
    np.testing.assert_allclose(place, 0.2 + np.exp(-decay * t) * swing, rtol=0, atol=1e-12)


def test_slide_stop_damps_while_it_is_met(joints_with_forces):
    """It meets the stop after 1/3 s, and leaves it slower by what the damper took."""
    t, (_, place), (_, rate), _ = joints_with_forces["slide_stop"]
    free = t < 0.3333
    np.testing.assert_allclose(place[free], 0.3 * t[free], rtol=0, atol=1e-14)
    mass = float(box().mass)
    decay, pace = 10.0 / mass, np.sqrt(500.0 / mass - (10.0 / mass) ** 2)
    # back at the stop after half a damped period, by when its speed fell by exp(−decay π/pace); the
    # damper sets in within a step, in which it takes 20 dt/m = 8e-4 of the speed
    assert rate[-1] == pytest.approx(-0.3 * np.exp(-decay * np.pi / pace), rel=5e-4)


def test_motor_force_accelerates_evenly(joints_with_forces):
    t, (_, place), _, _ = joints_with_forces["motor"]
    mass = float(box().mass)
    np.testing.assert_allclose(place, 0.3 * t + 0.75 / mass * t**2, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: lierb.forces.joint_friction(speed=0.0), ArgumentError, "speed is 0"),
        (lambda: lierb.forces.joint_friction(coulomb=-1.0), ArgumentError, "coulomb is -1"),
        (
            lambda: lierb.forces.joint_limit(lower=[0.0, 1.0], upper=0.5, stiffness=1.0),
            ArgumentError, r"lower\[1\] is 1.0, above upper, 0.5",
        ),
        (
            lambda: lierb.forces.joint_limit(lower=-4.0, upper=[2.0, 4.0], stiffness=1.0),
            ArgumentError, r"upper\[1\] is 4.0 rad, a turn or more above lower, -4.0",
        ),
        (
            lambda: lierb.Problem(
                box(), joint("revolute"), forces=lierb.forces.slide_spring(stiffness=1.0)
            ),
            ForceError, "slide_spring acts along .* a revolute joint does not",
        ),
        (
            lambda: lierb.Problem(  # it slides along e₁
                box(), lierb.joints.pin_in_slot_body(), forces=lierb.forces.motor(force=1.0)
            ),
            ForceError, "motor acts along .* a pin_in_slot_body joint does not",
        ),
        (lambda: lierb.forces.motor(1.0, force=1.0), ArgumentError, "or position= or force="),
    ],
)  # fmt: skip
def test_bad_joint_force_is_named(make, error, message):
    with pytest.raises(error, match=message):
        make()


# ---- which joints they act at ------------------------------------------------------------------

# What each joint of the catalogue does about and along its axis, by its definition.
TURNS = {
    "revolute", "cylindrical", "screw", "planar", "helical_planar", "schoenflies", "pin_in_slot",
    "pin_in_slot_body",
}  # fmt: skip
SLIDES = {
    "cylindrical", "screw", "prismatic", "translation", "helical_planar", "schoenflies",
}  # fmt: skip
ABOUT_THE_AXIS = {
    "torque": lambda: lierb.forces.motor(1.0),
    "torque of time": lambda: lierb.forces.motor(lambda t: math.sin(t)),
    "speed": lambda: lierb.forces.motor(speed=1.0, coordinate="turn"),
    "position of time": lambda: lierb.forces.motor(position=lambda t: t, coordinate="turn"),
    "spring": lambda: lierb.forces.torsional_spring(stiffness=1.0),
    "friction": lambda: lierb.forces.joint_friction(viscous=1.0),
    "limit": lambda: lierb.forces.joint_limit(lower=-1.0, upper=1.0, stiffness=10.0),
}
ALONG_THE_AXIS = {
    "force": lambda: lierb.forces.motor(force=1.0),
    "speed": lambda: lierb.forces.motor(speed=1.0, coordinate="slide"),
    "position of time": lambda: lierb.forces.motor(position=lambda t: t, coordinate="slide"),
    "spring": lambda: lierb.forces.slide_spring(stiffness=1.0),
    "friction": lambda: lierb.forces.slide_friction(viscous=1.0),
    "limit": lambda: lierb.forces.slide_limit(lower=-1.0, upper=1.0, stiffness=10.0),
}
EITHER = {
    "speed": lambda: lierb.forces.motor(speed=1.0),
    "position": lambda: lierb.forces.motor(position=lambda t: math.sin(t)),
}


@pytest.mark.parametrize("name", lierb.joints.JOINTS)
@pytest.mark.parametrize(
    ("elements", "fitting", "way"),
    [
        (ABOUT_THE_AXIS, TURNS, "about"),
        (ALONG_THE_AXIS, SLIDES, "along"),
        (EITHER, TURNS | SLIDES, "about"),
    ],
    ids=["about", "along", "either"],
)
def test_elements_at_a_joint_are_refused_where_they_cannot_act(name, elements, fitting, way):
    held = joint(name)
    for make in elements.values():
        element = make()
        makers = (
            lambda e=element: lierb.Problem(box(), held, forces=e),
            lambda e=element: lierb.Mechanism(
                [
                    lierb.Link("arm", box(), lierb.joints.revolute()),
                    lierb.Link("hand", box(), held, parent="arm"),
                ],
                forces=e.on("hand"),
            ),
        )
        for made, whose in zip(makers, (element.name, f"{element.name} on 'hand'"), strict=True):
            if name in fitting:
                made()
                continue
            with pytest.raises(ForceError, match=rf"{whose} acts {way} the .*{name} joint"):
                made()


@pytest.mark.parametrize("hold", ["Omega3", "Q12", "Q21", "Q11", "cv"])
def test_a_joint_made_of_rows_may_hold_its_axis(hold):
    """A screw that may not turn does not slide, and one that may not slide does not turn."""
    motors = lierb.forces.motor(speed=1.0, coordinate="turn"), lierb.forces.motor(force=1.0)
    held = lierb.joints.from_rows(["d1", "d2", "Omega1", "Omega2", hold])
    stuck = lierb.joints.from_rows(["d1", "d2", "screw", "Omega1", "Omega2", hold], pitch=0.1)
    flat = lierb.joints.from_rows(["d3", "screw", "Omega1", "Omega2"], pitch=0.1)
    lierb.Problem(box(), held, forces=motors[1])
    for each, motor in ((held, motors[0]), *((j, m) for j in (stuck, flat) for m in motors)):
        with pytest.raises(ForceError, match=r"joint does not (turn|slide)"):
            lierb.Problem(box(), each, forces=motor)

"""Fixed steps beyond the stability bound: published bounds, closed forms, SciPy's Radau."""

from __future__ import annotations

import re
from math import cos, sqrt

import numpy as np
import pytest
from cases import long_but
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import StiffStepWarning
from lierb.kernels.mechanics.newton_euler import Frames, Motion
from lierb.kernels.numbers.vec import IDENTITY, ZERO3
from lierb.methods import METHODS
from lierb.model.forces import FORCE_UNITS
from lierb.runs.options import Options
from lierb.runs.stiffness import stiff_steps
from lierb.studies.execution.foreseen import stiff_settings

# Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2: methods of p stages and order
# p have R(z) = 1 + z + … + z^p/p!. Where |R| = 1 on the negative real axis:
REAL = {
    "Euler": 2.0, "Midpoint": 2.0, "Heun": 2.0, "Ralston": 2.0, "SSP33": 2.5127453266183,
    "Kutta3": 2.5127453266183, "RK4": 2.7852935634053, "RK38": 2.7852935634053,
}  # fmt: skip
# … and on the imaginary one, which Euler's and Heun's methods do not have at all.
IMAGINARY = {"SSP33": sqrt(3.0), "Kutta3": sqrt(3.0), "RK4": sqrt(8.0), "RK38": sqrt(8.0)}
NEAR = 0.02  # beside a bound: in STEPS steps a mode that is so far beyond grows by more than 2
STEPS, DT = 100, 1e-2
MASS, INERTIA = 2.0, (0.3, 0.4, 0.5)
BODY = lierb.Body(MASS, INERTIA)
HINGE, SLIDE, FREE = lierb.joints.revolute(), lierb.joints.prismatic(), lierb.joints.free()
ABOUT, ALONG = INERTIA[2], MASS  # of a body that turns about, or slides along, e₃


def warned(problem, twist0, pose0=None, dt=DT, steps=STEPS, **options) -> str:
    """Text of the warning, or nothing; no kernel is compiled for it."""
    timing = Options.of(problem, dt=dt, t_end=dt * steps, cspace="SE3", **options).timing
    twist0 = twist0 if isinstance(twist0, dict) else np.asarray(twist0)
    each = twist0.values() if isinstance(twist0, dict) else (twist0,)
    count = problem.batch_size() or max(np.atleast_2d(twist).shape[0] for twist in each)
    return stiff_steps(problem, pose0, twist0, count, timing)


def stable_dt(message: str) -> float:
    return float(re.search(r"dt of at most (\S+) s", message)[1])


# ---- the method --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", lierb.TABLEAUS)
def test_amplification_is_that_of_the_tableau(name):
    tableau = lierb.TABLEAUS[name]
    s = tableau.stages
    a = np.array([[*row, *[0.0] * (s - len(row))] for row in tableau.A])
    rng = np.random.default_rng(1)
    z = rng.uniform(-3.0, 0.5, 20) + 1j * rng.uniform(-3.0, 3.0, 20)
    for each in z:
        expected = 1.0 + each * np.array(tableau.b) @ np.linalg.solve(np.eye(s) - each * a, [1] * s)
        # products of entries of A, which are up to 208
        assert abs(tableau.amplification(np.array(each)) - expected) < 1e-10 * (1 + abs(expected))


@pytest.mark.parametrize(("name", "bound"), REAL.items())
def test_amplification_is_one_at_published_real_bounds(name, bound):
    # the bounds have 14 digits
    assert abs(lierb.TABLEAUS[name].amplification(np.array(-bound + 0j))) == pytest.approx(
        1.0, abs=1e-12
    )


@pytest.mark.parametrize(("name", "bound"), IMAGINARY.items())
def test_amplification_is_one_at_published_imaginary_bounds(name, bound):
    assert abs(lierb.TABLEAUS[name].amplification(np.array(1j * bound))) == pytest.approx(
        1.0, abs=1e-12
    )


@pytest.mark.parametrize("name", REAL)
def test_viscous_friction_warns_beyond_each_methods_bound(name):
    twist0 = HINGE.twist(omega=(0.0, 0.0, 1.0))
    for share in (1.0 - NEAR, 1.0 + NEAR):
        viscous = share * REAL[name] * ABOUT / DT
        problem = lierb.Problem(BODY, HINGE, forces=lierb.forces.joint_friction(viscous=viscous))
        message = warned(problem, twist0, method=name)
        assert bool(message) is (share > 1.0)
    assert f"stability bound of {name} for joint_friction:" in message
    # two digits, rounded down, and a mode may still double in the run
    assert DT / (1.0 + NEAR) * 0.99 <= stable_dt(message) <= DT


@pytest.mark.parametrize("name", ["Verlet", "RATTLie", "SHAKELie"])
def test_variational_methods_are_stable_to_a_step_of_2_over_omega(name):
    growth = METHODS[name].amplification
    # below the bound both eigenvalues are on the unit circle; beyond, r² − (2 − x²) r + 1 = 0
    np.testing.assert_allclose(growth(1j * np.array([0.1, 1.0, 1.99])), 1.0, atol=1e-14)
    expected = np.abs(np.roots([1.0, 2.1**2 - 2.0, 1.0])).max()
    assert growth(np.array(2.1j)) == pytest.approx(expected, rel=1e-12)
    # of second order in the damping, too
    errors = [growth(h * (-0.1 + 1.0j)) - np.exp(-0.1 * h) for h in np.array([0.2, 0.1])]
    assert 6.0 < abs(errors[0] / errors[1]) < 10.0


@pytest.mark.parametrize("name", ["BLieDF1", "BLieDF2"])
def test_backward_differences_are_l_stable(name):
    weights = {"BLieDF1": (1.0, -1.0), "BLieDF2": (1.5, -2.0, 0.5)}[name]
    rng = np.random.default_rng(2)
    z = rng.uniform(-5.0, 1.0, 20) + 1j * rng.uniform(-5.0, 5.0, 20)
    growth = np.abs(METHODS[name].amplification(z))
    expected = [np.abs(np.roots((weights[0] - each, *weights[1:]))).max() for each in z]
    np.testing.assert_allclose(growth, expected, rtol=1e-12)
    assert (growth[z.real <= 0.0] <= 1.0).all()
    assert abs(METHODS[name].amplification(np.array(-1e12 + 0j))) < 1e-5  # 1/√|2z| with two steps


GROWTH = ["Verlet", "RATTLie", "SHAKELie", "BLieDF1", "BLieDF2"]


@pytest.mark.long
@pytest.mark.parametrize("name", long_but(GROWTH, "BLieDF2"))
def test_amplification_is_the_growth_of_a_damped_oscillation_in_a_run(name):
    """qₙ qₙ₊₂ − qₙ₊₁² of a pair of modes grows by |R|² in a step."""
    stiffness, damping = 30.0 * 30.0 * ALONG, 6.0 * ALONG
    spring = lierb.forces.slide_spring(stiffness=stiffness, damping=damping)
    problem = lierb.Problem(BODY, SLIDE, forces=[spring])
    run = lierb.integrate(
        problem, twist0=ALONG_E3, dt=0.02, t_end=1.0, method=name, save_every=1, record=["state"]
    )
    q = run.position[:, 0, 2]
    size = np.abs(q[20:-2] * q[22:] - q[21:-1] ** 2)
    root = 0.02 * (-3.0 + 1j * np.sqrt(30.0**2 - 3.0**2))  # of λ² + 6λ + 30² = 0
    expected = np.abs(METHODS[name].amplification(np.array(root)))
    np.testing.assert_allclose(np.sqrt(size[1:] / size[:-1]), expected, rtol=1e-6)


def test_verlet_warns_beyond_its_bound():
    spring = lierb.forces.torsional_spring(stiffness=1e4 * ABOUT)  # ω = 100 rad/s
    problem = lierb.Problem(BODY, HINGE, forces=[spring])
    twist0 = HINGE.twist(omega=(0.0, 0.0, 1.0))
    for method in ("Verlet", "SHAKELie"):
        message = warned(problem, twist0, dt=0.021, method=method)
        assert stable_dt(message) == pytest.approx(0.02, rel=0.01)
        assert not warned(problem, twist0, dt=0.0199, method=method)
    for method in ("alpha3", "BLieDF1", "BLieDF2"):  # unconditionally stable
        assert not warned(problem, twist0, dt=0.1, method=method)


# ---- every force -------------------------------------------------------------------------------

R, I = REAL["RK4"], IMAGINARY["RK4"]
SPEED = 0.3  # m/s, rad/s
ALONG_E3 = np.array((0.0, 0.0, 0.0, 0.0, 0.0, SPEED))
ABOUT_E3 = np.array((0.0, 0.0, SPEED, 0.0, 0.0, 0.0))
LIMITS = {"lower": -0.5, "upper": 0.5}
SLIDING = {"coulomb": 1.0}
damped = lambda inertia: R * inertia / DT  # damping at the bound
stiff = lambda inertia: inertia * (I / DT) ** 2
at_e3 = lambda about, along=0.0: np.array((0.0, 0.0, about, 0.0, 0.0, along))
# By name: each parameter, with its value at RK4's bound, the others, the joint, and the start.
AT_BOUND = [
    ("torsional_spring", "stiffness", stiff(ABOUT), {}, HINGE, ABOUT_E3),
    ("torsional_spring", "damping", damped(ABOUT), {}, HINGE, ABOUT_E3),
    ("slide_spring", "stiffness", stiff(ALONG), {}, SLIDE, ALONG_E3),
    ("slide_spring", "damping", damped(ALONG), {}, SLIDE, ALONG_E3),
    ("joint_friction", "viscous", damped(ABOUT), {}, HINGE, ABOUT_E3),
    ("joint_friction", "coulomb", damped(ABOUT) * 1e-4, {"speed": 1e-4}, HINGE, ABOUT_E3),
    ("slide_friction", "viscous", damped(ALONG), {}, SLIDE, ALONG_E3),
    ("slide_friction", "coulomb", damped(ALONG) * 1e-3, {}, SLIDE, ALONG_E3),
    ("joint_stiction", "stiffness", stiff(ABOUT), SLIDING, HINGE, ABOUT_E3),
    ("joint_stiction", "damping", damped(ABOUT), SLIDING | {"stiffness": 0.0}, HINGE, ABOUT_E3),
    ("joint_stiction", "viscous", damped(ABOUT), SLIDING | {"stiffness": 0.0}, HINGE, ABOUT_E3),
    ("slide_stiction", "stiffness", stiff(ALONG), SLIDING, SLIDE, ALONG_E3),
    ("slide_stiction", "damping", damped(ALONG), SLIDING | {"stiffness": 0.0}, SLIDE, ALONG_E3),
    ("slide_stiction", "viscous", damped(ALONG), SLIDING | {"stiffness": 0.0}, SLIDE, ALONG_E3),
    ("joint_limit", "stiffness", stiff(ABOUT), LIMITS, HINGE, ABOUT_E3),
    ("joint_limit", "damping", damped(ABOUT), {"stiffness": 0.0, **LIMITS}, HINGE, ABOUT_E3),
    ("slide_limit", "stiffness", stiff(ALONG), LIMITS, SLIDE, ALONG_E3),
    ("slide_limit", "damping", damped(ALONG), {"stiffness": 0.0, **LIMITS}, SLIDE, ALONG_E3),
    ("drag", "linear", damped(MASS), {}, SLIDE, ALONG_E3),
    ("drag", "linear", damped(MASS), {}, FREE, ALONG_E3),
    ("drag", "quadratic", damped(MASS) / (2.0 * SPEED), {}, SLIDE, ALONG_E3),
    ("drag", "angular", damped(min(INERTIA)), {}, FREE, ALONG_E3),
    ("spring_damper", "stiffness", stiff(MASS), {"ground_point": (0, 0, 1)}, FREE, ALONG_E3),
    ("spring_damper", "stiffness", stiff(MASS), {}, FREE, ALONG_E3),  # without length
    ("spring_damper", "damping", damped(MASS), {"ground_point": (0, 0, 1)}, FREE, ALONG_E3),
    ("spring_damper", "damping", damped(MASS), {}, SLIDE, ALONG_E3),
    ("bushing", "stiffness", at_e3(stiff(ABOUT), stiff(ALONG)), {}, FREE, ABOUT_E3),
    ("bushing", "stiffness", np.diag(at_e3(0.0, stiff(ALONG))), {}, SLIDE, ALONG_E3),
    ("bushing", "damping", at_e3(damped(ABOUT)), {"stiffness": np.zeros(6)}, HINGE, ABOUT_E3),
    ("bushing", "damping", at_e3(0.0, damped(ALONG)), {"stiffness": np.zeros(6)}, SLIDE, ALONG_E3),
]  # fmt: skip
STIFF = {"stiffness", "damping", "viscous", "coulomb", "linear", "quadratic", "angular"}


def test_every_stiffness_and_damping_of_the_catalogue_is_tried():
    tried = {(name, parameter) for name, parameter, *_ in AT_BOUND}
    known = {(name, x) for name, units in FORCE_UNITS.items() for x in units if x in STIFF}
    assert tried == known - {("joint_stiction", "coulomb"), ("slide_stiction", "coulomb")}  # limits


@pytest.mark.parametrize(("name", "parameter", "value", "others", "joint", "twist0"), AT_BOUND)
def test_every_force_warns_just_beyond_the_bound(name, parameter, value, others, joint, twist0):
    for share in (1.0 - NEAR, 1.0 + NEAR):
        given = {parameter: value * share**2 if parameter == "stiffness" else value * share}
        force = getattr(lierb.forces, name)(**others, **given)
        message = warned(lierb.Problem(BODY, joint, forces=force), twist0)
        assert (f"RK4 for {name}:" in message) is (share > 1.0)


def motion(omega=ZERO3, v=ZERO3, place=ZERO3) -> Motion:
    numbers = lambda given: tuple(map(float, given))
    return Motion(0.0, IDENTITY, numbers(place), numbers(omega), numbers(v))


def wrench_of(kind, placed, x) -> np.ndarray:
    torque, force = kind.wrench(placed, x)
    return np.array([float(number) for number in (*torque, *force)])


MOVING = ((0.3, -0.2, 0.5), (0.4, 0.1, -0.7), (0.2, 0.5, 0.9))
STILL = ((0.0,) * 3, (0.0,) * 3, (0.2, 0.5, 0.9))
POINTS = {"body_point": (0.1, -0.3, 0.2), "ground_point": (0.5, 0.4, -0.2)}
TANGENTS = [
    ("spring_damper", {**POINTS, "stiffness": 7.0, "damping": 3.0, "length": 0.4}, MOVING),
    ("torsional_spring", {"stiffness": 7.0, "damping": 3.0}, MOVING),
    ("slide_spring", {"stiffness": 7.0, "damping": 3.0}, MOVING),
    ("joint_friction", {"viscous": 3.0, "coulomb": 0.2, "speed": 0.1}, STILL),
    ("slide_friction", {"viscous": 3.0, "coulomb": 0.2, "speed": 0.1}, STILL),
    ("slide_limit", {"lower": -0.1, "upper": 0.3, "stiffness": 7.0, "damping": 3.0}, MOVING),
    ("drag", {"linear": 3.0, "quadratic": 2.0, "angular": 0.7, "point": (0.1, -0.3, 0.2)}, MOVING),
]  # fmt: skip


@pytest.mark.parametrize(("name", "given", "at"), TANGENTS)
def test_tangents_are_derivatives_of_the_wrench(name, given, at):
    """Derivatives by velocity in all directions; by position in three, which turn no force."""
    force = getattr(lierb.forces, name)(**given)
    items = {n: tuple(x) if np.ndim(x) else float(x) for n, x in force.parameters.items()}
    frames = Frames((IDENTITY, ZERO3), IDENTITY, ZERO3)
    placed = force.kind.placed(items, frames)
    tangents = force.kind.tangents(placed, motion(*at))
    rows = np.array([[float(x) for x in tangent.direction] for tangent in tangents])
    damping = rows.T @ np.diag([float(t.damping) for t in tangents]) @ rows
    stiffness = rows.T @ np.diag([float(t.stiffness) for t in tangents]) @ rows
    step = 1e-5  # central differences are off by its square, and by rounding over it
    for axis in range(6):
        twist = np.zeros(6)
        twist[axis] = step
        ends = []
        for sign in (1.0, -1.0):
            omega, v = np.array(at[0]) + sign * twist[:3], np.array(at[1]) + sign * twist[3:]
            ends.append(wrench_of(force.kind, placed, motion(omega, v, at[2])))
        np.testing.assert_allclose(damping[:, axis], (ends[1] - ends[0]) / (2 * step), atol=1e-7)
    for axis in range(3):
        ends = []
        for sign in (1.0, -1.0):
            place = np.array(at[2]) + sign * step * np.eye(3)[axis]
            ends.append(wrench_of(force.kind, placed, motion(place=place)))
        np.testing.assert_allclose(
            stiffness[:, 3 + axis], (ends[1] - ends[0]) / (2 * step), atol=1e-7
        )


# ---- motions -----------------------------------------------------------------------------------

COULOMB, SMOOTHED, START = 2.0, 1e-4, 8.0  # N m, rad/s, rad/s
SWINGING, ARM, HEAVY, FALL = 0.05, 0.15, 1.0, 9.81  # kg m², m, kg, m/s²
T_END = 1.0


@pytest.mark.slow
def test_friction_too_stiff_for_the_step_warns_and_the_step_it_names_is_right():
    """A pendulum that friction stops, and holds where it has stopped."""
    body = lierb.Body(HEAVY, (0.02, 0.045, SWINGING), com=(ARM, 0.0, 0.0))
    friction = lierb.forces.joint_friction(coulomb=COULOMB, speed=SMOOTHED)
    problem = lierb.Problem(body, HINGE, (0.0, -FALL, 0.0), friction)
    start = {"twist0": HINGE.twist(omega=(0.0, 0.0, START)), "t_end": T_END}
    with pytest.warns(StiffStepWarning, match=r"dt=0.01 s .* RK4 for joint_friction:") as seen:
        coarse = lierb.integrate(problem, dt=1e-2, **start)
    assert [each.filename for each in seen] == [__file__]

    def rates(t, y):
        smooth = COULOMB * y[1] / np.hypot(y[1], SMOOTHED)
        return y[1], -(HEAVY * FALL * ARM * cos(y[0]) + smooth) / SWINGING

    truth = solve_ivp(
        rates, (0.0, T_END), (0.0, START), method="Radau", rtol=1e-10, atol=1e-12
    ).y[0, -1]  # fmt: skip
    steps = np.ceil(T_END / stable_dt(str(seen[0].message)))
    fine = lierb.integrate(problem, dt=T_END / steps, **start)  # a warning would be an error here
    # the bound is of stability: near the end the time in which it stops is as long as a step
    assert angle_of(fine) == pytest.approx(truth, abs=SMOOTHED)
    assert abs(angle_of(coarse) - truth) > 0.03
    with pytest.warns(StiffStepWarning, match="RK4 for joint_friction"):  # each call says so
        lierb.integrate(problem, **coarse.end, dt=1e-2, t_end=2.0 * T_END)


def angle_of(result) -> float:
    return float(HINGE.coordinates(result.end["pose0"]).ravel()[0])


def test_adaptive_steps_do_not_warn():
    friction = lierb.forces.joint_friction(coulomb=COULOMB, speed=SMOOTHED)
    problem = lierb.Problem(BODY, HINGE, forces=friction)
    assert warned(problem, ABOUT_E3)
    assert not warned(problem, ABOUT_E3, rtol=1e-6)


def test_a_run_of_few_steps_does_not_warn_of_what_does_not_grow():
    """Euler's method makes any oscillation grow, by 1 + (ωh)²/2 a step."""
    spring = lierb.forces.torsional_spring(stiffness=ABOUT * 10.0**2)
    problem = lierb.Problem(BODY, HINGE, forces=spring)
    growth = sqrt(1.0 + (10.0 * DT) ** 2)
    doubled = int(np.ceil(np.log(2.0) / np.log(growth)))
    assert not warned(problem, ABOUT_E3, steps=doubled - 1, method="Euler")
    message = warned(problem, ABOUT_E3, steps=doubled + 1, method="Euler")
    assert "stability bound of Euler for torsional_spring:" in message
    assert not warned(problem, ABOUT_E3, steps=10**6)  # RK4's oscillations decay


def test_damping_of_another_force_counts():
    spring = lierb.forces.torsional_spring(stiffness=ABOUT * 10.0**2)
    friction = lierb.forces.joint_friction(viscous=ABOUT * 2.0)
    stop = lierb.forces.joint_limit(lower=-2.0, upper=2.0, stiffness=0.0, damping=ABOUT * 2.0)
    alone = {"steps": 10**4, "method": "Euler"}
    assert not warned(lierb.Problem(BODY, HINGE, forces=[spring, friction]), ABOUT_E3, **alone)
    # a stop damps in the stop alone
    assert warned(lierb.Problem(BODY, HINGE, forces=[spring, stop]), ABOUT_E3, **alone)


def test_rows_decide_what_a_force_moves():
    """A spring along a rod that slides across it has no stiffness; across it all of it."""
    across = {"ground_point": (1.0, 0.0, 0.0), "stiffness": 1.5 * stiff(MASS), "length": 1.0}
    spring = lierb.forces.spring_damper(**across)
    assert not warned(lierb.Problem(BODY, SLIDE, forces=spring), ALONG_E3)
    assert warned(lierb.Problem(BODY, FREE, forces=spring), ALONG_E3)
    turned = lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))
    assert warned(lierb.Problem(BODY, turned, forces=spring), (0.0, 0.0, 0.0, SPEED, 0.0, 0.0))


def test_the_pose_of_the_start_counts():
    spring = lierb.forces.spring_damper(
        ground_point=(1.0, 0.0, 0.0), stiffness=1.2 * stiff(MASS), length=1.0
    )
    problem = lierb.Problem(BODY, SLIDE, forces=spring)
    moved = SLIDE.pose([100.0])
    assert not warned(problem, ALONG_E3)
    assert warned(problem, ALONG_E3, moved)


# ---- mechanisms --------------------------------------------------------------------------------

LENGTH, ANGLE = 0.5, 0.7  # m, rad
ROD = lierb.bodies.box((0.05, 0.05, LENGTH), mass=1.0)
PIN = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, LENGTH / 2)}


def double_pendulum(*forces) -> lierb.Mechanism:
    upper = lierb.joints.revolute(**PIN)
    lower = lierb.joints.revolute(**PIN, parent_point=(0.0, 0.0, -LENGTH / 2))
    return lierb.Mechanism(
        [lierb.Link("upper", ROD, upper), lierb.Link("lower", ROD, lower, parent="upper")],
        forces=forces,
    )


def mass_matrix(angle: float) -> np.ndarray:
    """Mass matrix of two rods in relative angles, from the textbook."""
    inertia, half = ROD.inertia[1, 1], LENGTH / 2
    coupling = LENGTH * half * cos(angle)
    last = inertia + half**2
    return np.array(
        [
            [2 * inertia + 2 * half**2 + LENGTH**2 + 2 * coupling, last + coupling],
            [last + coupling, last],
        ]
    )


def still(mechanism: lierb.Mechanism) -> dict[str, np.ndarray]:
    return {name: np.zeros(6) for name in mechanism.names}


@pytest.mark.parametrize(("place", "which"), [("upper", 0), ("lower", 1)])
def test_friction_in_a_mechanism_warns_beyond_the_bound_of_its_mass_matrix(place, which):
    gain = np.linalg.inv(mass_matrix(ANGLE))[which, which]
    for share in (1.0 - NEAR, 1.0 + NEAR):
        friction = lierb.forces.joint_friction(viscous=share * R / (DT * gain)).on(place)
        mechanism = double_pendulum(friction)
        pose0 = mechanism.pose({"upper": 0.2, "lower": ANGLE})
        message = warned_of(mechanism, pose0)
        assert (f"joint_friction on '{place}':" in message) is (share > 1.0)


def test_springs_in_two_joints_oscillate_together():
    """The fastest mode of both is faster than with either joint held."""
    k = np.array((300.0, 200.0))
    fastest = sqrt(np.linalg.eigvals(np.linalg.solve(mass_matrix(ANGLE), np.diag(k))).real.max())
    for share in (1.0 - NEAR, 1.0 + NEAR):
        scaled = k * (share * I / (DT * fastest)) ** 2
        springs = [
            lierb.forces.torsional_spring(stiffness=stiffness).on(name)
            for name, stiffness in zip(("upper", "lower"), scaled, strict=True)
        ]
        mechanism = double_pendulum(*springs)
        pose0 = mechanism.pose({"upper": 0.2, "lower": ANGLE})
        assert bool(warned_of(mechanism, pose0)) is (share > 1.0)


def warned_of(mechanism: lierb.Mechanism, pose0, **options) -> str:
    """`warned` of a mechanism at rest."""
    return warned(mechanism, still(mechanism), pose0, **options)


def test_a_spring_between_two_links_acts_on_both():
    masses = np.array((1.0, 3.0))
    reduced = masses.prod() / masses.sum()
    for share in (1.0 - NEAR, 1.0 + NEAR):
        spring = lierb.forces.spring_damper(stiffness=stiff(reduced) * share**2, length=0.5)
        links = [
            lierb.Link(name, lierb.Body(mass, INERTIA), FREE)
            for name, mass in zip("ab", masses, strict=True)
        ]
        mechanism = lierb.Mechanism(links, forces=spring.on("a", "b"))
        pose0 = mechanism.pose({"a": SLIDE.pose([0.5])})
        message = warned_of(mechanism, pose0)
        assert ("spring_damper on 'a' and 'b':" in message) is (share > 1.0)


def test_a_loop_counts_with_the_inertia_of_all_that_it_moves():
    """A parallelogram of three rods, with redundant rows: I = 2T/ω² of the crank."""
    tip = {"axis": (0.0, 1.0, 0.0), "parent_point": (0.0, 0.0, -LENGTH / 2)}
    half = (LENGTH / 2, 0.0, 0.0)
    beside = lierb.joints.revolute(PIN["body_point"], (LENGTH, 0.0, 0.0), axis=PIN["axis"])
    beam = lierb.bodies.box((LENGTH, 0.05, 0.05), mass=1.0)
    links = [
        lierb.Link("crank", ROD, lierb.joints.revolute(**PIN)),
        lierb.Link("beam", beam, lierb.joints.revolute(np.negative(half), **tip), "crank"),
        lierb.Link("rocker", ROD, beside),
    ]
    loop = lierb.Loop("pin", lierb.joints.revolute(half, **tip), "beam", "rocker")
    pose0 = lierb.Mechanism(links).pose({"crank": ANGLE, "beam": -ANGLE, "rocker": ANGLE})
    # two rods that turn about their ends, and the beam, which moves as these do at their tips
    inertia = 2.0 * (ROD.inertia[1, 1] + LENGTH**2 / 4) + LENGTH**2
    for share in (1.0 - NEAR, 1.0 + NEAR):
        friction = lierb.forces.joint_friction(viscous=share * damped(inertia)).on("crank")
        mechanism = lierb.Mechanism(links, loop, forces=friction)
        assert mechanism.freedoms(pose0).redundant > 0
        message = warned_of(mechanism, pose0)
        assert ("joint_friction on 'crank':" in message) is (share > 1.0)


def test_a_mechanism_says_so_before_it_is_compiled():
    mechanism = double_pendulum(lierb.forces.joint_friction(coulomb=2.0, speed=1e-4).on("lower"))
    with pytest.raises(StiffStepWarning, match="joint_friction on 'lower'"):
        lierb.integrate(mechanism, twist0=still(mechanism), dt=1e-2, t_end=1.0)


# ---- batches -----------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 5000])
@pytest.mark.parametrize("what", ["coulomb", "speed", "mass", "both"])
def test_one_trajectory_of_a_batch_is_named(count, what):
    """The stiffest is where the quotient of two parameters is largest, and neither need be."""
    rng = np.random.default_rng(3)
    stiffest = count - 2
    coulomb, speed, heavy = (rng.uniform(1.0, 2.0, count) for _ in range(3))
    changed = {"coulomb": coulomb, "speed": speed, "mass": heavy}
    if what == "both":
        coulomb[stiffest], speed[stiffest] = 1.99, 0.51
    else:
        changed[what][stiffest] = 10.0 if what == "coulomb" else 0.1
    gains = coulomb / speed / heavy
    assert gains.argmax() == stiffest
    scaled = 1.1 * R * MASS / DT / gains[stiffest] * coulomb * 1e-3
    problem = lierb.Problem(
        lierb.Body(MASS * heavy, heavy[:, None, None] * np.diag(INERTIA)), SLIDE,
        forces=lierb.forces.slide_friction(coulomb=scaled, speed=speed * 1e-3),
    )  # fmt: skip
    assert f"slide_friction of trajectory {stiffest}:" in warned(problem, ALONG_E3)
    slower = 0.8 * scaled
    milder = lierb.forces.slide_friction(coulomb=slower, speed=speed * 1e-3)
    assert not warned(lierb.Problem(problem.body, SLIDE, forces=milder), ALONG_E3)


def test_functions_of_the_users_are_not_known():
    @lierb.wrench
    def stiff_spring(t, R, r, omega, v):
        return np.zeros(3), -1e9 * R.T @ r

    assert not warned(lierb.Problem(BODY, FREE, forces=stiff_spring()), ALONG_E3)


def test_a_study_without_stiff_forces_draws_no_bodies_for_the_warning(monkeypatch):
    study = lierb.Study.of({
        "body": {"mass": MASS, "inertia": [*INERTIA]},
        "joint": {"type": "spherical"},
        "problem": {"forces": [{"type": "constant_wrench", "force": [0.0, 0.0, 1.0]}]},
        "sample": {"n": 1000},
        "integrate": {"dt": DT, "t_end": STEPS * DT},
    })  # fmt: skip
    batch, counts = type(study).batch, []
    monkeypatch.setattr(
        type(study), "batch", lambda *given: (counts.append(given[2]), batch(*given))[1]
    )
    assert stiff_settings(study) == []
    assert counts == [1]

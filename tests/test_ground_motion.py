"""Grounds that move as given: beside equations by hand, and a carriage on driven slides."""

from __future__ import annotations

import numpy as np
import pytest
from cases import column, long_but, tiered
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ArgumentError, ForceError

MASS, ARM, INERTIA, G = 0.5, 0.2, 0.01, 9.81  # of a pendulum, about its centre of mass
AMPLITUDE, FREQUENCY, PUSH = 0.03, 15.0, 0.8  # m, rad/s, m/s²
END = 1.5  # s


@lierb.ground_motion(amplitude=AMPLITUDE, frequency=FREQUENCY, push=PUSH)
def shaken(t, params):
    rise = params.amplitude * np.sin(params.frequency * t)
    return 0.5 * params.push * t**2, 0.1 * t, rise


def pendulum(amplitude=AMPLITUDE, com=(0.0, 0.0, 0.0), **more) -> lierb.Problem:
    """A pendulum about y; its body frame is in the centre of mass, or beside it."""
    body = lierb.Body(MASS, (INERTIA, INERTIA, 0.5 * INERTIA), com, about="com")
    pin = lierb.joints.revolute(
        axis=(0.0, 1.0, 0.0), body_point=np.add(com, (0.0, 0.0, ARM)), ground_point=(1.0, 2.0, 3.0)
    )
    motion = shaken(amplitude=amplitude)
    return lierb.Problem(body, pin, gravity=(0.0, 0.0, -G), ground_motion=motion, **more)


def swing(amplitude: float, start: float) -> tuple[float, float]:
    """Angle and rate at the end: I θ̈ = −m a ((g + z̈) sin θ + ẍ cos θ), hanging at θ = 0."""
    inertia = INERTIA + MASS * ARM**2

    def rates(t, y):
        weight = G - amplitude * FREQUENCY**2 * np.sin(FREQUENCY * t)
        pull = weight * np.sin(y[0]) - PUSH * np.cos(y[0])
        return [y[1], -MASS * ARM * pull / inertia]

    solved = solve_ivp(rates, (0.0, END), [start, 0.0], "DOP853", rtol=1e-13, atol=1e-14)
    return float(solved.y[0, -1]), float(solved.y[1, -1])


RUNS = {
    "RK4": {"dt": 5e-4},
    "DOP853": {"rtol": 1e-11},
    "saddle": {"rtol": 1e-11, "solver": "saddle"},
    "SO3xR3": {"rtol": 1e-11, "cspace": "SO3xR3"},
    "ambient": {"dt": 5e-4, "update": "ambient"},
    "Rodas5P": {"rtol": 1e-10, "method": "Rodas5P"},
    "Verlet4": {"dt": 5e-4, "method": "Verlet4"},
    "RATTLie": {"dt": 2.5e-4, "method": "RATTLie"},
    "alpha3": {"dt": 2.5e-4, "method": "alpha3"},
}
ALLOWED = {"RK4": 1e-9, "ambient": 1e-9, "Verlet4": 1e-8, "RATTLie": 1e-5, "alpha3": 1e-5}


@pytest.mark.slow
@pytest.mark.parametrize("options", tiered(RUNS, ["RK4"], []))
def test_a_pendulum_swings_on_a_shaken_pivot(options):
    chosen, problem = RUNS[options], pendulum([0.0, AMPLITUDE])
    starts = problem.joint.pose([0.7])
    run = {"save_every": round(END / chosen["dt"])} if "dt" in chosen else {"save_at": [END]}
    result = lierb.integrate(problem, pose0=starts, t_end=END, record="state", **run, **chosen)
    expected = [swing(amplitude, 0.7) for amplitude in (0.0, AMPLITUDE)]
    R = result.rotation[-1]
    angle = np.arctan2(-R[:, 0, 2], R[:, 2, 2])  # joint.pose turns about +y
    rate = -result.omega[-1, :, 1]
    allowed = ALLOWED.get(options, 1e-8)  # of the methods' errors
    sign = np.sign(angle[0] * expected[0][0])
    np.testing.assert_allclose(sign * angle, [a for a, _ in expected], rtol=0, atol=allowed)
    np.testing.assert_allclose(
        sign * rate, [w for _, w in expected], rtol=0, atol=10.0 * FREQUENCY * allowed
    )
    work = 1e-3 if options == "Verlet4" else 100.0 * allowed  # its quadrature is of lower order
    assert np.max(column(result.summary, "energy_drift_max")) < work


# ---- mechanisms --------------------------------------------------------------------------------

SLIDES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
FUNCTIONS = (
    lambda t, params: 0.5 * params.push * t**2,
    lambda t, params: 0.1 * t,
    lambda t, params: params.amplitude * np.sin(params.frequency * t),
)


def links(count: int, parent: str) -> list[lierb.Link]:
    """A chain of rods about y and, every third one, about x."""
    made = []
    for i in range(count):
        axis = (1.0, 0.0, 0.0) if i % 3 == 2 else (0.0, 1.0, 0.0)
        pin = lierb.joints.revolute(
            axis=axis, body_point=(0.0, 0.0, 0.1), parent_point=(0.0, 0.0, -0.1 if i else 0.0)
        )
        rod = lierb.bodies.rod(0.2, 0.01, mass=0.3 - 0.02 * i)
        made.append(lierb.Link(f"link{i}", rod, pin, f"link{i - 1}" if i else parent))
    return made


def on_carriage(count: int, amplitude) -> lierb.Mechanism:
    """The chain on three driven slides: the motion of the ground as constraints."""
    box, parent, slides, motors = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0), "ground", [], []
    for axis, name, function in zip(SLIDES, "xyz", FUNCTIONS, strict=True):
        slides.append(lierb.Link(name, box, lierb.joints.prismatic(axis=axis), parent))
        own = {"x": {"push": PUSH}, "y": {"unused": 0.0}, "z": {"amplitude": amplitude}}[name]
        own |= {"frequency": FREQUENCY} if name == "z" else {}
        motors.append(lierb.forces.motor(position=function, **own).on(name))
        parent = name
    chain = [*slides, *links(count, "z")]
    return lierb.Mechanism(chain, gravity=(0.0, 0.0, -G), forces=motors)


def shaken_chain(count: int, amplitude, **more) -> lierb.Mechanism:
    return lierb.Mechanism(
        links(count, "ground"), gravity=(0.0, 0.0, -G),
        ground_motion=shaken(amplitude=amplitude), **more,
    )  # fmt: skip


def compared(count: int, solver: str) -> None:
    amplitudes = np.array([0.01, AMPLITUDE])
    run = {"rtol": 1e-11, "t_end": 0.5, "record": "state", "save_at": [0.5]}
    chain, carriage = shaken_chain(count, amplitudes), on_carriage(count, amplitudes)
    pose0 = chain.pose({"link0": 0.4, "link1": -0.2})
    relative = lierb.integrate(chain, pose0=pose0, solver=solver, **run)
    pose0 = carriage.pose({"link0": 0.4, "link1": -0.2})
    rates = {"y": 0.1, "z": FREQUENCY * amplitudes[:, None]}
    twist0 = carriage.twist(rates, pose0)
    absolute = lierb.integrate(carriage, pose0=pose0, twist0=twist0, **run)
    assert not relative.failed.size
    assert not absolute.failed.size
    moved = absolute["z"].position[-1]
    for i in range(count):
        own, other = relative[f"link{i}"], absolute[f"link{i}"]
        # errors of both runs, which a chain amplifies
        np.testing.assert_allclose(own.rotation[-1], other.rotation[-1], rtol=0, atol=1e-8)
        np.testing.assert_allclose(own.position[-1], other.position[-1] - moved, rtol=0, atol=1e-8)
    assert np.max(column(relative.summary, "energy_drift_max")) < 1e-9


@pytest.mark.slow
def test_a_mechanism_of_one_link_moves_as_its_problem():
    problem = pendulum(com=(0.1, 0.0, -0.05))
    mechanism = lierb.Mechanism(
        lierb.Link("rod", problem.body, problem.joint), gravity=problem.gravity,
        ground_motion=shaken(),
    )  # fmt: skip
    pose0, run = problem.joint.pose([0.7]), {"dt": 1e-3, "t_end": 0.5}
    one = lierb.integrate(problem, pose0=pose0, **run)
    link = lierb.integrate(mechanism, pose0={"rod": pose0}, **run)["rod"]
    np.testing.assert_allclose(link.position, one.position, rtol=0, atol=1e-9)  # two methods
    np.testing.assert_allclose(link.rotation, one.rotation, rtol=0, atol=1e-9)


@pytest.mark.long
def test_a_chain_moves_as_on_a_driven_carriage():
    compared(3, "unrolled")


@pytest.mark.long
def test_a_long_chain_moves_as_on_a_driven_carriage():
    compared(9, "looped")


@lierb.observable(unit="m/s²")
def felt_x(specific_force):
    return specific_force[0]


@lierb.observable(unit="m/s²")
def felt_z(specific_force):
    return specific_force[2]


@pytest.mark.slow
@pytest.mark.parametrize("kind", long_but(["problem", "mechanism"], "problem"))
def test_an_accelerometer_measures_the_acceleration_of_the_ground(kind):
    """On a slide across the shaking it measures s̈ − g along it, and nothing in free fall."""
    box = lierb.bodies.box((0.1, 0.2, 0.3), mass=2.0)
    motion, gravity = shaken(), (0.0, 0.0, -G)
    saved = {"dt": 1e-3, "t_end": 0.3, "save_every": 100}
    for joint, expected in (
        (lierb.joints.prismatic(axis=(0.0, 1.0, 0.0)), True), (lierb.joints.free(), False),
    ):  # fmt: skip
        if kind == "problem":
            model = lierb.Problem(
                box, joint, gravity, observables=(felt_x(), felt_z()), ground_motion=motion
            )
        else:
            model = lierb.Mechanism(
                lierb.Link("box", box, joint), gravity=gravity, observables=(felt_x(), felt_z()),
                ground_motion=motion,
            )  # fmt: skip
        result = lierb.integrate(model, **saved)
        t = column(result.history, "t")
        rise = -AMPLITUDE * FREQUENCY**2 * np.sin(FREQUENCY * t)
        right = {"felt_x": np.full_like(t, PUSH), "felt_z": G + rise}
        for name, along in right.items():
            found = column(result.history, name).reshape(-1)
            np.testing.assert_allclose(found, along * expected, atol=1e-12)


@pytest.mark.long
def test_derivatives_by_the_amplitude_are_those_of_the_equation():
    problem = pendulum()
    start = {"pose0": problem.joint.pose([0.7]), "t_end": END, "rtol": 1e-11}
    result = lierb.integrate(problem, **start, with_respect_to="shaken.amplitude")
    found = result.sensitivity("pose", "shaken.amplitude").reshape(-1)[1]
    h = 1e-4
    slopes = [(swing(AMPLITUDE + k * h, 0.7)[0] - swing(AMPLITUDE - k * h, 0.7)[0]) / (2 * k * h)
              for k in (1, 2)]  # fmt: skip
    right = (4.0 * slopes[0] - slopes[1]) / 3.0  # error h⁴
    assert abs(found) == pytest.approx(abs(right), rel=1e-6)


# ---- arguments ---------------------------------------------------------------------------------


def test_a_function_of_time_is_a_motion_too_and_numbers_change():
    body, pin = lierb.bodies.rod(0.2, 0.01, mass=0.1), lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    plain = lierb.Problem(body, pin, ground_motion=lambda t: (0.1 * t**2, 0.0, 0.0))
    assert len(plain.forces) == 1
    changed = pendulum().with_({"shaken.amplitude": [0.1, 0.2]})
    assert changed.batch_size() == 2
    chain = lierb.Mechanism(links(2, "ground")).with_(ground_motion=shaken())
    assert [force.at for force in chain.forces] == [("link0",), ("link1",)]


def test_what_does_not_fit_is_refused():
    rods = links(2, "ground")
    with pytest.raises(ForceError, match="moves the ground for link0 only; give ground_motion"):
        lierb.Mechanism(rods, forces=shaken().on("link0"))
    with pytest.raises(ArgumentError, match=r"on no link; give .* in a study, put it on each link"):
        lierb.Mechanism(rods, forces=shaken())
    with pytest.raises(ForceError, match="on two links"):
        lierb.Mechanism(rods, forces=shaken().on("link0", "link1"))
    water = lierb.forces.added_mass((0, 0, 0, 1.0, 1.0, 1.0)).on("link1")
    with pytest.raises(ForceError, match=r"added_mass adds inertia .* motor\(position=…\)"):
        lierb.Mechanism(rods, forces=water, ground_motion=shaken())
    with pytest.raises(ArgumentError, match=r"ground_motion=\(0.1, 0.0, 0.0\); expected a func"):
        lierb.Mechanism(rods, ground_motion=(0.1, 0.0, 0.0))
    with pytest.raises(ArgumentError, match=r"shaken; call it"):
        lierb.Mechanism(rods, ground_motion=shaken)
    with pytest.raises(ForceError, match="must return"):
        lierb.Mechanism(rods, ground_motion=lambda t: 0.1 * t)

"""Added mass and variable mass: Kirchhoff, Tsiolkovsky, and rigid bodies of equal inertia.

Cases c36 and c48 of tests/public_cases/README.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from cases import integrate
from scipy.integrate import solve_ivp

import lierb

GRAVITY = np.array([0.3, -0.2, -9.8])
COM = np.array([0.1, -0.05, 0.2])
INERTIA = np.array([[0.2, 0.02, 0.01], [0.02, 0.3, -0.03], [0.01, -0.03, 0.4]])
MASS = 3.0
TWIST = np.array([0.5, 1.0, -0.7, 0.3, 0.2, -0.4])
_B = np.random.default_rng(7).normal(size=(6, 6))
FLUID = 0.3 * _B @ _B.T


def skew(a):
    return np.cross(np.eye(3), a)


def spatial(mass, inertia, com):
    """Inertia (6, 6) of a rigid body about the body frame's origin, rotation first."""
    cross = skew(com)
    return np.block(
        [[inertia - mass * cross @ cross, mass * cross], [-mass * cross, mass * np.eye(3)]]
    )


def hull(*forces, com=COM, joint=None, gravity=GRAVITY):
    body = lierb.Body(MASS, INERTIA, com=com, about="com")
    link = lierb.Link("hull", body, joint or lierb.joints.free())
    return lierb.Mechanism([link], gravity=gravity, forces=forces)


def in_fluid(matrix, com):
    """Pose and twist of the hull after 1 s, by Kirchhoff's equations."""
    whole = spatial(MASS, INERTIA, com) + matrix

    def rates(t, y):
        turn, omega, v = y[:9].reshape(3, 3), y[12:15], y[15:]
        angular, linear = np.split(whole @ y[12:], 2)
        weight = MASS * turn.T @ GRAVITY
        torque = np.cross(com, weight) - np.cross(omega, angular) - np.cross(v, linear)
        force = weight - np.cross(omega, linear)
        moved = np.linalg.solve(whole, np.concatenate([torque, force]))
        return np.concatenate([(turn @ skew(omega)).ravel(), turn @ v, moved])

    start = np.concatenate([np.eye(3).ravel(), np.zeros(3), TWIST])
    return solve_ivp(rates, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "cspace", ["reduced", *(pytest.param(x, marks=pytest.mark.long) for x in ("SE3", "SO3xR3"))]
)
def test_c36_free_body_in_a_fluid_is_that_of_kirchhoff(cspace):
    """gazebo#2066, gz-sim#1462, uuv#96, WEC-Sim#1157: added mass diverges, or is a wrench late."""
    com = 0.0 * COM if cspace == "SO3xR3" else COM
    matrices = np.array([FLUID, np.diag(np.diag(FLUID))])
    mechanism = hull(lierb.forces.added_mass(matrices), com=com)
    result = integrate(mechanism, twist0={"hull": TWIST}, dt=2e-4, t_end=1.0, cspace=cspace)
    for i, matrix in enumerate(matrices):
        right = in_fluid(matrix, com)
        pose = result.end["pose0"]["hull"][i]
        # RK4 leaves 2e-11, the reference less than 1e-12
        assert np.abs(pose[:3, :3].ravel() - right[:9]).max() < 1e-10
        assert np.abs(pose[:3, 3] - right[9:12]).max() < 1e-10
        assert np.abs(result.end["twist0"]["hull"][i] - right[12:]).max() < 1e-10
        assert result.summary["energy_drift_max"][i].as_py() < 1e-10


def chain(heavy, forces=()):
    """Double pendulum on a slide with a motor, with a loop; `heavy` is added to both links."""
    links = []
    for name, parent, joint in (
        ("cart", None, lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))),
        (
            "upper",
            "cart",
            lierb.joints.universal(axis=(0.0, 1.0, 0.0), second_axis=(1.0, 0.0, 0.0)),
        ),
        ("lower", "upper", lierb.joints.revolute(ground_point=(0, 0, -1.0), axis=(0.0, 1.0, 0.0))),
    ):
        mass, com, inertia = 1.5, np.array([0.02, 0.01, -0.5]), np.diag([0.1, 0.12, 0.05])
        if heavy and name in heavy:
            more = spatial(mass, inertia, com) + spatial(*heavy[name])
            mass += heavy[name][0]
            com = np.array([more[2, 4], more[0, 5], more[1, 3]]) / mass
            body = lierb.Body(mass, more[:3, :3], com=com)
        else:
            body = lierb.Body(mass, inertia, com=com, about="com")
        links.append(lierb.Link(name, body, joint, parent=parent or "ground"))
    return lierb.Mechanism(links, gravity=GRAVITY, forces=forces)


MORE = {
    "upper": (0.7, np.diag([0.03, 0.02, 0.04]), np.array([0.1, -0.2, -0.3])),
    "lower": (0.4, np.diag([0.02, 0.05, 0.06]), np.array([-0.1, 0.05, -0.6])),
}


@lierb.variable_mass(mass=1.0, com=(0.0, 0.0, 0.0), inertia=np.eye(3))
def load(t, params):
    return params.mass, params.com, params.inertia


@pytest.mark.parametrize(
    ("kind", "cspace", "method"),
    [
        pytest.param("mass", "reduced", "RK4", marks=pytest.mark.long),
        pytest.param("fluid", "SE3", "RK4", marks=pytest.mark.long),
        pytest.param("mass", "reduced", "Rodas4", marks=pytest.mark.long),
        pytest.param("fluid", "reduced", "Rodas4", marks=pytest.mark.long),
    ],
)
def test_added_inertia_of_a_rigid_body_is_a_heavier_body(kind, cspace, method):
    """A rigid body as inertia of a link: the motion is that of one body with both inertias."""
    motors = [lierb.forces.motor(force=3.0).on("cart"), lierb.forces.motor(speed=2.0).on("lower")]
    if kind == "mass":
        added = [load(mass=m, com=c, inertia=j).on(name) for name, (m, j, c) in MORE.items()]
        held = []
    else:  # of a fluid, without weight
        added = [lierb.forces.added_mass(spatial(*MORE[name])).on(name) for name in MORE]
        held = [
            lierb.forces.constant_wrench(force=-m * GRAVITY, point=c).on(name)
            for name, (m, j, c) in MORE.items()
        ]
    start = {"cart": (0.3,), "upper": (0.5, -0.4), "lower": (2.0,)}
    results = []
    for mechanism in (chain({}, [*motors, *added]), chain(MORE, [*motors, *held])):
        pose = mechanism.pose({"upper": (0.3, 0.2), "lower": -0.7})
        results.append(
            integrate(
                mechanism, pose0=pose, twist0=mechanism.twist(start, pose), dt=2e-3, t_end=0.5,
                cspace=cspace, method=method, record=("multipliers", "reaction", "energy"),
                save_every=50,
            )
        )  # fmt: skip
    one, other = results
    for name in ("cart", "upper", "lower"):
        assert (
            np.abs(one.end["pose0"][name] - other.end["pose0"][name]).max() < 1e-12
        )  # rounding of 250 steps
        assert np.abs(one.end["twist0"][name] - other.end["twist0"][name]).max() < 1e-11
    for column in one.history.column_names:
        if "lambda" in column or "reaction" in column:
            pair = [np.array(r.history[column].to_pylist(), float) for r in results]
            # the fluid has no weight, and the counterweight acts on the links: the same reactions
            assert np.abs(pair[0] - pair[1]).max() < 1e-9 * max(1.0, np.abs(pair[0]).max())
    drift = np.array(one.history["energy_drift"].to_pylist(), float)
    assert np.abs(drift).max() < 1e-7  # of RK4; Rodas4 is of the same order


@lierb.variable_mass(mass=20.0, rate=2.0, burnout=8.0, discontinuities="burnout")
def propellant(t, params):
    left = params.mass - params.rate * lierb.clip(t, 0.0, params.burnout)
    return left, (0.0, 0.0, 0.0), left * np.diag((0.03, 0.03, 0.01))


@lierb.wrench(thrust=5000.0, burnout=8.0, discontinuities="burnout")
def jet(t, R, r, omega, v, params):
    on = lierb.where(t < params.burnout, 1.0, 0.0)
    return (0.0, 0.0, 0.0), (0.0, 0.0, on * params.thrust)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"dt": 0.01}, pytest.param({"rtol": 1e-12, "method": "DOP853"}, marks=pytest.mark.long)],
)
def test_c48_rocket_is_that_of_tsiolkovsky(options):
    """openrocket#309, RocketPy#363: Δv = u ln(m₀/m₁) − g t, of many rockets."""
    rate, exhaust, burnout = np.array([1.0, 2.0, 2.4]), 2500.0, 8.0
    forces = propellant(rate=rate), jet(thrust=rate * exhaust)
    rocket = hull(*forces, com=(0, 0, 0), gravity=(0.0, 0.0, -9.81))
    result = lierb.integrate(rocket, t_end=10.0, **options)
    speed = exhaust * np.log((MASS + 20.0) / (MASS + 20.0 - rate * burnout)) - 98.1
    assert np.abs(result.end["twist0"]["hull"][:, 5] / speed - 1.0).max() < 1e-11  # RK4: 800 steps


@lierb.variable_mass(start=2.0, rate=0.3)
def shrinking(t, params):
    left = params.start - params.rate * t
    return left, (0.0, 0.0, 0.0), left * np.diag((1.0, 1.0, 0.4))


@pytest.mark.slow
def test_spin_of_a_burning_body_has_a_closed_form():
    """A body of revolution: ω₃ is constant, ω₁ + iω₂ turns by ω₃ ∫ (J₃ − J₁)/J₁ dt."""
    body = lierb.Body(1.0, (0.5, 0.5, 0.8))
    link = lierb.Link("hull", body, lierb.joints.free())
    rocket = lierb.Mechanism([link], forces=[shrinking()])
    omega = np.array([0.3, 0.0, 2.0])
    result = integrate(rocket, twist0={"hull": (*omega, 0, 0, 0)}, dt=1e-2, t_end=3.0)
    # J₃ − J₁ = 0.3 − 0.6 m and J₁ = 0.5 + m, with m = 2 − 0.3 t
    first, last = 2.5, 2.5 - 0.9
    angle = 2.0 * (0.6 * np.log(first / last) / 0.3 - 0.6 * 3.0)
    right = np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 2.0])
    assert np.abs(result.end["twist0"]["hull"][0, :3] - right).max() < 1e-9  # RK4


@lierb.states(left=2.0)
def tank(t, states):
    return {"left": -0.3 + 0.0 * states.left}


@lierb.variable_mass
def by_state(states):
    return states.left, np.zeros(3), states.left * np.diag((1.0, 1.0, 0.4))


@pytest.mark.long
def test_mass_may_be_an_extra_state():
    body = lierb.Body(1.0, (0.5, 0.5, 0.8))
    link = lierb.Link("hull", body, lierb.joints.free())
    twist0 = {"hull": (0.3, 0.1, 2.0, 0, 0, 0)}
    one, other = (
        integrate(lierb.Mechanism([link], **acting), twist0=twist0, dt=1e-2, t_end=1.0)
        for acting in ({"forces": [shrinking()]}, {"forces": [by_state()], "states": [tank()]})
    )
    assert (
        np.abs(one.end["twist0"]["hull"] - other.end["twist0"]["hull"]).max() < 1e-14
    )  # rounding of the state


@pytest.mark.slow
def test_negative_mass_ends_a_trajectory():
    rocket = hull(shrinking(start=[0.15, 2.0]))
    named = r"the mass of shrinking is -0.0\d+ kg at t = 0\.\d+ s"
    with pytest.warns(lierb.errors.FailedTrajectoryWarning, match=named):
        result = integrate(rocket, dt=0.01, t_end=1.0)
    assert result.summary["status"].to_pylist() == ["non_finite", "ok"]


@pytest.mark.long
def test_derivatives_by_added_inertia_are_those_of_differences():
    options = {"twist0": {"hull": TWIST}, "dt": 1e-2, "t_end": 0.5}
    names = ["hull.added_mass.inertia", "hull.shrinking.rate"]
    acting = lierb.forces.added_mass(FLUID), shrinking()
    result = integrate(hull(*acting), with_respect_to=names, **options)
    step, change = 1e-5, np.outer(TWIST, TWIST)
    for name, weight, pair in (
        (names[0], change.ravel(), [FLUID + s * change for s in (step, -step)]),
        (names[1], np.ones(1), [0.3 + step, 0.3 - step]),
    ):
        exact = result.sensitivity("hull.twist", name)[-1, 0] @ weight
        changed = hull(*acting).with_({name: np.array(pair)})
        ends = integrate(changed, **options).end["twist0"]["hull"]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        # step² times a third derivative, and rounding over step
        assert np.abs(exact - difference).max() < 1e-7 * np.abs(exact).max()


@lierb.variable_mass
def unfit(R):
    return R[0, 0], np.zeros(3), np.eye(3)


@pytest.mark.parametrize(
    ("attempt", "error", "words"),
    [
        (lambda: lierb.forces.added_mass(-np.ones(6)), "ArgumentError", "negative eigenvalue"),
        (lambda: lierb.forces.added_mass(np.triu(FLUID)), "ArgumentError", "not symmetric"),
        (lambda: unfit(), "ForceError", r"any of \(t, params, body, states, controls\)"),
        (
            lambda: lierb.Problem(
                lierb.Body(MASS, INERTIA), lierb.joints.free(), forces=shrinking()
            ),
            "ForceError", "make a lierb.Mechanism",
        ),
        (
            lambda: chain({}, [shrinking().on("lower", "upper")]),
            "ForceError", "depends on accelerations",
        ),
        (
            lambda: lierb.integrate(hull(shrinking()), dt=0.1, t_end=0.2, solver="looped"),
            "ArgumentError", "does not support added inertia",
        ),
        (
            lambda: lierb.variable_mass(lambda t: (1.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))(),
            "ForceError", "must return 3×3,",
        ),
    ],
)  # fmt: skip
def test_refusals(attempt, error, words):
    with pytest.raises(getattr(lierb.errors, error), match=words):
        attempt()

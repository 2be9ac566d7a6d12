"""Derivatives of mechanisms: against complex steps of planar ones, and laws that hold for any."""

from __future__ import annotations

import numpy as np
import pytest
from cases import RECORD
from mechanisms import oracle, samples
from mechanisms.test_oracle import sample

import lierb
from derivatives import complex_steps as steps
from derivatives import planar

GRAVITY = (0.0, 0.0, -9.81)
AXIS = {"axis": (0.0, 1.0, 0.0)}
H = 1j * steps.H
TOLERANCE = 1e-10  # relative to the largest derivative: truncation of RK4, and of DOP853


def body_of(mass, moment, com) -> lierb.Body:
    """A flat body: its moment about e₂ is the sum of the others."""
    return lierb.Body(mass, (0.55 * moment, moment, 0.45 * moment + 1e-3), com)


UPPER = {"mass": 1.2, "moment": 0.15, "com": (0.02, 0.0, -0.03)}
LOWER = {"mass": 0.7, "moment": 0.11, "com": (-0.04, 0.0, -0.02)}
POINTS = {"upper": (0.01, 0.0, 0.25), "lower": (0.0, 0.0, 0.3), "elbow": (0.03, 0.0, -0.26)}
DOUBLE = (
    "upper.twist0", "lower.twist0", "upper.pose0", "upper.omega0", "gravity", "upper.body.mass",
    "lower.body.mass", "upper.body.com", "lower.body.com", "upper.body.inertia",
    "lower.body.inertia", "upper.joint.body_point", "lower.joint.body_point",
    "lower.joint.parent_point", "lower.torsional_spring.stiffness",
    "lower.torsional_spring.damping",
)  # fmt: skip


def double_pendulum() -> lierb.Mechanism:
    return lierb.Mechanism(
        [
            lierb.Link(
                "upper", body_of(**UPPER), lierb.joints.revolute(body_point=POINTS["upper"], **AXIS)
            ),
            lierb.Link(
                "lower", body_of(**LOWER),
                lierb.joints.revolute(
                    body_point=POINTS["lower"], parent_point=POINTS["elbow"], **AXIS
                ),
                "upper",
            ),
        ],
        gravity=GRAVITY,
        forces=lierb.forces.torsional_spring(stiffness=2.0, damping=0.05).on("lower"),
    )  # fmt: skip


def weights_of(result, names, seed=4) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    table = result.sensitivities
    return {
        n: rng.standard_normal(table.array("energy", n).shape[-1])
        * (0.1 if "inertia" in n else 1.0)
        for n in names
    }


def along(result, of, weights) -> np.ndarray:
    return sum(result.sensitivity(of, name) @ weight for name, weight in weights.items())[:, 0]


def flat(values) -> np.ndarray:
    return np.array(values)[[*planar.PLANE]]


def bar_of(name, numbers, first, second, weights) -> planar.Bar:
    """A bar with i h times the weights of its parameters."""
    zero = np.zeros(6)
    com = flat(numbers["com"]) + H * flat(weights.get(f"{name}.body.com", zero))
    mass = numbers["mass"] + H * weights.get(f"{name}.body.mass", zero)[0]
    moment = numbers["moment"] + H * weights.get(f"{name}.body.inertia", zero)[1]
    return planar.Bar(mass, moment, com, first, second)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"dt": 1e-4, "save_every": 3000}, marks=pytest.mark.slow),
        pytest.param({"rtol": 1e-12, "save_at": (0.0, 0.3)}, marks=pytest.mark.long),
        pytest.param(
            {"dt": 1e-4, "save_every": 3000, "cspace": "SE3", "stabilise": "project"},
            marks=pytest.mark.long,
        ),
        pytest.param({"dt": 1e-4, "save_every": 3000, "method": "Rodas4"}, marks=pytest.mark.long),
    ],
    ids=["reduced", "adaptive", "projected", "implicit"],
)
def test_derivatives_of_a_double_pendulum_are_those_of_complex_steps(options):
    pendulum = double_pendulum()
    pose0 = pendulum.pose({"upper": 0.9, "lower": 0.6})
    twist0 = pendulum.twist({"upper": 2.0, "lower": -5.0}, pose0)
    result = lierb.integrate(
        pendulum, pose0=pose0, twist0=twist0, t_end=0.3, record=RECORD, with_respect_to=DOUBLE,
        **options,
    )  # fmt: skip
    weights = weights_of(result, DOUBLE)
    change = {n: along(result, f"{n}.pose", weights) for n in ("upper", "lower")}
    rates = {n: along(result, f"{n}.twist", weights) for n in ("upper", "lower")}
    point = lambda name, joint: flat(POINTS[name]) + H * flat(weights[joint])
    elbow = point("elbow", "lower.joint.parent_point")
    upper = bar_of("upper", UPPER, point("upper", "upper.joint.body_point"), elbow, weights)
    own = point("lower", "lower.joint.body_point")
    lower = bar_of("lower", LOWER, own, own, weights)
    spring = [
        value + H * weights[f"lower.torsional_spring.{name}"][0]
        for name, value in (("stiffness", 2.0), ("damping", 0.05))
    ]
    angles, speeds, place = planar.double_pendulum(
        upper, lower, flat(GRAVITY) + H * flat(weights["gravity"]), spring,
        np.array((0.9, 1.5)) + H * np.array([change[n][0, 1] for n in change]),
        np.array((2.0, -3.0)) + H * np.array([rates[n][0, 1] for n in rates]), 0.3,
    )  # fmt: skip
    scale = np.abs(speeds.imag / steps.H).max()
    for i, name in enumerate(("upper", "lower")):
        assert abs(change[name][-1, 1] - angles[i].imag / steps.H) < TOLERANCE * scale
        assert abs(rates[name][-1, 1] - speeds[i].imag / steps.H) < TOLERANCE * scale
    moved = result["lower"].rotation[-1, 0] @ change["lower"][-1, 3:]
    assert np.abs(flat(moved) - place.imag / steps.H).max() < TOLERANCE * scale


BARS = {
    "crank": {"mass": 0.4, "moment": 0.004, "com": (0.01, 0.0, 0.0)},
    "coupler": {"mass": 0.8, "moment": 0.02, "com": (0.0, 0.0, 0.02)},
    "rocker": {"mass": 0.6, "moment": 0.015, "com": (0.02, 0.0, 0.01)},
}
LENGTHS = {"crank": 0.1, "coupler": 0.3, "rocker": 0.25}
FOUR = (
    "crank.twist0", "rocker.pose0", "gravity", "coupler.body.mass", "rocker.body.com",
    "crank.joint.body_point", "coupler.joint.parent_point", "pin.joint.body_point",
    "rocker.joint.ground_point", "rocker.drag.angular",
)  # fmt: skip


def four_bar() -> tuple[lierb.Mechanism, dict, dict]:
    ends = {n: ((-0.5 * x, 0.0, 0.0), (0.5 * x, 0.0, 0.0)) for n, x in LENGTHS.items()}
    links = {
        "crank": lierb.joints.revolute(ends["crank"][0], **AXIS),
        "coupler": lierb.joints.revolute(ends["coupler"][0], parent_point=ends["crank"][1], **AXIS),
        "rocker": lierb.joints.revolute(ends["rocker"][0], ground_point=(0.3, 0.0, 0.0), **AXIS),
    }
    pin = lierb.joints.revolute(ends["coupler"][1], parent_point=ends["rocker"][1], **AXIS)
    mechanism = lierb.Mechanism(
        [
            lierb.Link(n, body_of(**BARS[n]), joint, "crank" if n == "coupler" else "ground")
            for n, joint in links.items()
        ],
        lierb.Loop("pin", pin, "coupler", "rocker"),
        gravity=GRAVITY,
        forces=lierb.forces.drag(angular=0.01).on("rocker"),
    )
    pose0 = mechanism.close(mechanism.pose({"crank": -1.0, "coupler": 0.6, "rocker": -1.2}))
    twist0 = mechanism.project(mechanism.twist({"crank": 6.0}, pose0), pose0)
    return mechanism, pose0, twist0


@pytest.mark.long
@pytest.mark.parametrize(
    ("stabilise", "method"), [(None, "RK4"), ("project", "RK4"), ("project", "Rodas4")]
)
def test_derivatives_of_a_closed_loop_are_those_of_complex_steps(stabilise, method):
    mechanism, pose0, twist0 = four_bar()
    result = lierb.integrate(
        mechanism, pose0=pose0, twist0=twist0, dt=1e-4, t_end=0.2, save_every=2000, record="state",
        stabilise=stabilise, method=method, with_respect_to=FOUR,
    )  # fmt: skip
    weights = weights_of(result, FOUR)
    zero = np.zeros(3)
    point = lambda place, name: flat(place) + H * flat(weights.get(name, zero))
    end = lambda n, side: (side * 0.5 * LENGTHS[n], 0.0, 0.0)
    bars = [
        bar_of("crank", BARS["crank"], point(end("crank", -1), "crank.joint.body_point"),
               point(end("crank", 1), "coupler.joint.parent_point"), weights),
        bar_of("coupler", BARS["coupler"], point(end("coupler", -1), ""),
               point(end("coupler", 1), "pin.joint.body_point"), weights),
        bar_of("rocker", BARS["rocker"], point(end("rocker", -1), ""),
               point(end("rocker", 1), ""), weights),
    ]  # fmt: skip
    angles, places, rates, speeds = [], [], [], []
    for name in BARS:
        R, link = result[name].rotation[0, 0], result[name]
        change, rate = (along(result, f"{name}.{of}", weights)[0] for of in ("pose", "twist"))
        angles.append(np.arctan2(R[0, 2], R[0, 0]) + H * change[1])
        places.append(flat(link.position[0, 0]) + H * flat(R @ change[3:]))
        rates.append(link.omega[0, 0, 1] + H * rate[1])
        velocity = link.v[0, 0]
        turned = np.cross(change[:3], velocity)
        speeds.append(flat(R @ velocity) + H * flat(R @ (rate[3:] + turned)))
    found = planar.four_bar(
        bars, point(GRAVITY, "gravity"), 0.01 + H * weights["rocker.drag.angular"][0],
        np.array(angles), np.array(places),
        np.array(rates), np.array(speeds), 0.2,
    )  # fmt: skip
    scale = np.abs(found[1].imag / steps.H).max()
    for i, name in enumerate(BARS):
        change, rate = (along(result, f"{name}.{of}", weights)[-1] for of in ("pose", "twist"))
        # Without projection loops drift, by the fourth power of the step.
        assert abs(change[1] - found[0][i].imag / steps.H) < TOLERANCE * scale
        assert abs(rate[1] - found[1][i].imag / steps.H) < TOLERANCE * scale
        place = result[name].rotation[-1, 0] @ change[3:]
        assert np.abs(flat(place) - found[2][i].imag / steps.H).max() < TOLERANCE * scale


def twist_rates(system: oracle.System, state: np.ndarray) -> np.ndarray:
    """(links, 6), time derivatives of body-fixed twists, of the first of a batch."""
    back = np.swapaxes(oracle.matrix_of(state[0, :, 3:7]), -1, -2)
    in_body = lambda v: np.einsum("lij,lj->li", back, v)
    rate, com = system.rate(state)[0], system.com[0]
    omega, alpha = in_body(state[0, :, 10:]), in_body(rate[:, 10:])
    moving, force = in_body(state[0, :, 7:10]), in_body(rate[:, 7:10])
    v_rate = force - np.cross(omega, moving) - np.cross(alpha, com)
    return np.concatenate([alpha, v_rate], -1)


@pytest.mark.long
@pytest.mark.parametrize("shape", ["star", "branched", "four_bar", "slider_crank", "rssr"])
def test_the_derivative_along_the_flow_is_the_twist_of_every_link(shape):
    made = sample(shape, 1, centred=False, forces=True)
    names = [samples.link_name(i) for i in range(len(made.description.bodies))]
    starts = [f"{n}.{what}" for n in names for what in ("pose0", "twist0")]
    result = lierb.integrate(
        samples.mechanism_of(made.description), **samples.start_of(made), dt=1e-4, t_end=0.1,
        save_every=1000, record="state", with_respect_to=starts,
    )  # fmt: skip
    system = oracle.System(made.description)
    first = system.state(made.poses, made.twists)
    system.learn_rank(first)
    poses, twists = np.zeros((1, len(names), 4, 4)), np.zeros((1, len(names), 6))
    for i, name in enumerate(names):
        link = result[name]
        poses[0, i] = samples.frame(link.rotation[-1], link.position[-1])[0]
        twists[0, i] = np.concatenate([link.omega[-1, 0], link.v[-1, 0]])
    rates = twist_rates(system, first)
    weights = {f"{n}.pose0": made.twists[0, i] for i, n in enumerate(names)}
    weights |= {f"{n}.twist0": rates[i] for i, n in enumerate(names)}
    at_end = twist_rates(system, system.state(poses, twists))
    for i, name in enumerate(names):
        for of, wanted in (("pose", twists[0, i]), ("twist", at_end[i])):
            found = along(result, f"{name}.{of}", weights)[-1]
            # the oracle's starts are closed to 1e-14, its accelerations of 1e3 rounded
            assert np.abs(found - wanted).max() < 1e-9 * (1.0 + np.abs(at_end).max()), (name, of)


@pytest.mark.long
def test_directions_of_a_start_stay_on_joints_and_loops():
    mechanism, pose0, twist0 = four_bar()
    names = ("crank.pose0", "coupler.twist0", "pin.joint.body_point", "rocker.joint.ground_point")
    result = lierb.integrate(
        mechanism, pose0=pose0, twist0=twist0, dt=1e-3, t_end=2e-3, save_every=1, record="state",
        stabilise="project", with_respect_to=names,
    )  # fmt: skip

    def pinned(link, point, of_point, name):
        """Change of a point of a link in the ground frame, (times, 3, k)."""
        moved = result.sensitivity(f"{link}.pose", name)[:, 0]
        turn = np.cross(moved[:, :3], np.array(point)[None, :, None], axis=1)
        own = np.eye(3) if name == of_point else 0.0
        return np.einsum("tij,tjk->tik", result[link].rotation[:, 0], moved[:, 3:] + turn + own)

    for name in names:
        coupler = pinned("coupler", (0.15, 0.0, 0.0), "pin.joint.body_point", name)
        rocker = pinned("rocker", (0.125, 0.0, 0.0), "", name)
        assert np.abs((coupler - rocker)[:, ::2]).max() < 1e-12
        on_ground = pinned("rocker", (-0.125, 0.0, 0.0), "", name)
        moved = np.eye(3) if name == "rocker.joint.ground_point" else np.zeros((1, 1))
        assert np.abs((on_ground - moved)[:, ::2]).max() < 1e-12
    assert np.abs(result.sensitivity("crank.pose", "pin.joint.body_point")).max() > 0.1


@pytest.mark.long
def test_a_mechanism_of_a_batch_has_the_derivatives_that_it_has_alone():
    names = ("lower.twist0", "upper.pose0", "lower.joint.body_point", "lower.body.mass")
    hinges = {
        "upper": lierb.joints.revolute(body_point=POINTS["upper"], **AXIS),
        "lower": lierb.joints.revolute(
            body_point=[POINTS["lower"], (0.0, 0.0, 0.2)], parent_point=POINTS["elbow"], **AXIS
        ),
    }
    several = lierb.Mechanism(
        [
            lierb.Link("upper", body_of(**UPPER), hinges["upper"]),
            lierb.Link("lower", body_of(**LOWER), hinges["lower"], "upper"),
        ],
        gravity=GRAVITY,
    )
    poses = several.pose({"upper": [[0.9], [0.4]], "lower": [[0.6], [0.2]]})
    twists = several.twist({"upper": 2.0, "lower": -5.0}, poses)
    run = {"dt": 1e-3, "t_end": 0.1, "with_respect_to": names}
    together = lierb.integrate(several, pose0=poses, twist0=twists, **run)
    for i in range(2):
        alone = lierb.integrate(
            several.of_body(i), pose0={n: pose[i] for n, pose in poses.items()},
            twist0={n: twist[i] for n, twist in twists.items()}, **run,
        )  # fmt: skip
        for name in names:
            for of in ("upper.pose", "lower.twist", "energy"):
                found = together.sensitivity(of, name)[i]
                assert np.array_equal(found, alone.sensitivity(of, name)[0]), (of, name)


@lierb.velocity_constraint(reach=0.1)
def blade(omega, v, params):
    return v[1] + params.reach * omega[0]


def geared(ratio=-1.5, rate=0.7, reach=0.1) -> lierb.Mechanism:
    """Two geared links of a double pendulum, a driven one, and a sleigh."""
    joint = lierb.joints.revolute(body_point=POINTS["upper"], **AXIS)
    body = body_of(**UPPER)
    swings = lierb.forces.motor(position=lambda t, params: params.rate * np.sin(3.0 * t), rate=rate)
    return lierb.Mechanism(
        [
            lierb.Link("upper", body, joint), lierb.Link("lower", body, joint, "upper"),
            lierb.Link("driven", body, joint, "lower"),
            lierb.Link("sleigh", body, lierb.joints.free()),
        ],
        gravity=GRAVITY,
        forces=[lierb.forces.gear(ratio).on("upper", "lower"), swings.on("driven")],
        constraints=blade(reach=reach).on("sleigh"),
    )  # fmt: skip


@pytest.mark.long
def test_gears_given_motions_and_constraints_on_velocities_have_derivatives():
    """Right: central differences of 1e-5, whose truncation is 1e-10 of the third derivative."""
    mechanism = geared()
    pose0 = mechanism.pose({"lower": 0.3})
    twist0 = mechanism.project(
        mechanism.twist({"upper": 1.0, "lower": 0.5}, pose0) | {"sleigh": (1, 2, 3, 0.3, 0.1, 0.4)},
        pose0,
    )
    run = {"dt": 1e-3, "t_end": 0.3}
    turned = lambda h: pose0 | {"sleigh": lierb.lie.se3.exp((h, 0.0, 0.0, 0.0, 0.0, 0.0))}
    changes = {
        "upper.gear.ratio": lambda h: (geared(ratio=-1.5 + h), pose0),
        "driven.motor.rate": lambda h: (geared(rate=0.7 + h), pose0),
        "sleigh.blade.reach": lambda h: (geared(reach=0.1 + h), pose0),
        "sleigh.pose0": lambda h: (mechanism, turned(h)),
    }
    result = lierb.integrate(
        mechanism, pose0=pose0, twist0=twist0, with_respect_to=[*changes], **run
    )

    def velocities(change, h):
        changed, poses = changes[change](h)
        start = changed.project(twist0, poses)
        end = lierb.integrate(changed, pose0=poses, twist0=start, **run)
        return np.concatenate([x[0] for n in mechanism.names for x in (end[n].omega, end[n].v)])

    for name in changes:
        parts = [result.sensitivity(f"{n}.twist", name)[0, :, 0] for n in mechanism.names]
        found = np.concatenate(parts)
        expected = (velocities(name, 1e-5) - velocities(name, -1e-5)) / 2e-5
        assert np.abs(found).max() > 1e-3
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-8 * np.abs(expected).max())

"""Derivatives through forces, users' functions, extra states, observables and events."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
from cases import GRAVITY

import lierb
from derivatives import complex_steps as steps
from derivatives.test_of_joints import RUN, compare, problem_of

G = 9.81


def quiet(function, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lierb.errors.DerivativeWarning)
        return lierb.integrate(function, **options)


# ---- forces ------------------------------------------------------------------------------------


@lierb.wrench(stiffness=3.0, anchor=(0.2, 0.1, 1.0), drag=0.2)
def tether(t, R, r, omega, v, params, body):
    """A spring with a cubic law, drag, and a torque that depends on the mass and on time."""
    away = r - params.anchor
    pull = -params.stiffness * (1.0 + away @ away) * (R.T @ away) - params.drag * v
    return 0.01 * body.mass * np.sin(3.0 * t) * omega, pull


def forces_of(weights: dict):
    """The same forces for complex steps, with changed parameters."""
    h = 1j * steps.H
    stiffness = 3.0 + h * weights["tether.stiffness"][0]
    anchor = np.array((0.2, 0.1, 1.0)) + h * weights["tether.anchor"]
    drag = 0.2 + h * weights["tether.drag"][0]
    own = 40.0 + h * weights["spring_damper.stiffness"][0]
    point = np.array((0.1, 0.0, 0.2)) + h * weights["spring_damper.body_point"]
    mass = 6.075 + h * weights["body.mass"][0]

    def force(t, R, r, omega, v):
        away = r - anchor
        pull = -stiffness * (1.0 + away @ away) * (R.T @ away) - drag * v
        torque = 0.01 * mass * np.sin(3.0 * t) * omega
        line = R.T @ (r + R @ point - np.array((0.0, 0.0, 2.0)))
        length = np.sqrt(line @ line)
        rate = line @ (v + steps.cross(omega, point)) / length
        spring = -(own * (length - 0.5) + 0.3 * rate) * line / length
        return torque + steps.cross(point, spring), pull + spring

    return force


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("spherical", marks=pytest.mark.slow),
        pytest.param("universal", marks=pytest.mark.long),
    ],
)
def test_forces_and_users_functions_have_the_derivatives_of_complex_steps(name):
    spring = lierb.forces.spring_damper(
        body_point=(0.1, 0.0, 0.2), ground_point=(0.0, 0.0, 2.0), stiffness=40.0, damping=0.3,
        length=0.5,
    )  # fmt: skip
    problem, pose, twist = problem_of(name, forces=[tether(), spring])
    own = ("tether.stiffness", "tether.anchor", "tether.drag", "spring_damper.stiffness",
           "spring_damper.body_point")  # fmt: skip
    result = lierb.integrate(
        problem, pose0=pose, twist0=twist, **RUN,
        with_respect_to=("twist0", "pose0", "body.mass", *own),
    )  # fmt: skip

    def force(*motion_and_weights):
        *motion, weights = motion_and_weights
        return forces_of(weights)(*motion)

    compare(problem, name, pose, twist, result, force=force, scales={})


@pytest.mark.long
def test_work_of_forces_balances_the_energy_along_a_direction():
    drag = lierb.forces.drag(linear=0.5, angular=0.05)
    problem, pose, twist = problem_of("spherical", forces=drag)
    result = lierb.integrate(
        problem, pose0=pose, twist0=twist, **RUN, with_respect_to=("drag.linear", "twist0")
    )
    # more drag takes energy away, most of all from what moves fast
    assert result.sensitivity("energy", "drag.linear")[0, 0, 0] == 0.0
    assert result.sensitivity("energy", "drag.linear")[-1, 0, 0] < -1e-3
    for name in ("drag.linear", "twist0"):
        energy, work = (result.sensitivity(of, name)[:, 0] for of in ("energy", "work"))
        np.testing.assert_allclose(work, energy - energy[0], atol=1e-8)  # error of the steps


@pytest.mark.long
@pytest.mark.parametrize("solver", ["unrolled", "looped"])
def test_work_in_joints_balances_the_energy_along_a_direction(solver):
    box = lierb.bodies.box((0.1, 0.05, 0.4), mass=1.0)
    hinge = lierb.joints.revolute(axis=(0, 1, 0), body_point=(0, 0, 0.2), parent_point=(0, 0, -0.2))
    damper = lierb.forces.torsional_spring(stiffness=2.0, damping=0.1)
    arm = lierb.Mechanism(
        [lierb.Link("upper", box, hinge), lierb.Link("lower", box, hinge, "upper")],
        gravity=GRAVITY,
        forces=[damper.on("lower"), lierb.forces.motor(torque=0.7).on("upper")],
    )  # fmt: skip
    names = ("lower.torsional_spring.damping", "upper.motor.torque", "lower.body.mass")
    start = {"pose0": arm.pose({"lower": 0.5}), "twist0": arm.twist({"lower": 2.0})}
    result = lierb.integrate(
        arm, **start, dt=1e-3, t_end=0.5, save_every=250, solver=solver, with_respect_to=names
    )
    for name in names:
        energy, work = (result.sensitivity(of, name)[:, 0] for of in ("energy", "work"))
        np.testing.assert_allclose(work, energy - energy[0], atol=1e-8)  # error of the steps
        assert np.abs(work[-1]).max() > 1e-3


# ---- constraints -------------------------------------------------------------------------------


@lierb.constraint(height=0.1)
def in_a_plane(R, r, params):
    return r[2] + 0.1 * r[0] * r[0] - params.height


@pytest.mark.long
def test_a_users_constraint_moves_the_start_with_its_parameter():
    body = lierb.Body(1.0, (0.02, 0.03, 0.04))
    problem = lierb.Problem(body, lierb.joints.free(), GRAVITY, constraints=in_a_plane())
    pose = np.eye(4)
    pose[:3, 3] = 0.4, 0.2, 0.1 - 0.1 * 0.16
    twist = problem.project((0.3, 0.2, 0.1, 1.0, 0.5, 0.0), pose)
    result = lierb.integrate(
        problem, pose0=pose, twist0=twist, dt=1e-3, t_end=0.3, save_every=100, record="state",
        with_respect_to=("in_a_plane.height", "twist0", "pose0"),
    )  # fmt: skip
    for name, slope in (("in_a_plane.height", 1.0), ("twist0", 0.0), ("pose0", 0.0)):
        for row in range(len(result.t)):
            R, r = result.rotation[row, 0], result.position[row, 0]
            normal = np.array((0.2 * r[0], 0.0, 1.0))
            change = normal @ (R @ result.sensitivity("pose", name)[row, 0, 3:])
            assert np.abs(change - slope).max() < 1e-9


@pytest.mark.long
def test_a_motors_speed_moves_the_start():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    problem = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.2, 0.3)), hinge, GRAVITY, forces=lierb.forces.motor(speed=2.0)
    )
    result = lierb.integrate(
        problem, twist0=hinge.twist(velocities=2.0 * np.ones(1)), dt=1e-2, t_end=0.5,
        with_respect_to="motor.speed",
    )  # fmt: skip
    expected = np.array((0.0, 1.0, 0.0))
    assert np.abs(result.sensitivity("twist", "motor.speed")[0, :3, 0] - expected).max() < 1e-12
    assert (
        np.abs(result.sensitivity("pose", "motor.speed")[0, :3, 0] - 0.5 * expected).max() < 1e-12
    )


# ---- extra states, observables -----------------------------------------------------------------


@lierb.states(x=0.2, speed=0.3, unit={"x": "rad", "speed": "rad/s"}, params={"damping": 0.4})
def driven_pendulum(t, states, params):
    pull = np.cos(t) - params.damping * states.speed - np.sin(states.x)
    return {"x": states.speed, "speed": pull}


@lierb.observable(unit="m", arm=0.5)
def reach(r, R, params):
    return np.sqrt((r + R @ np.array((0.0, 0.0, params.arm))) @ r + 1.0)


@pytest.mark.slow
def test_extra_states_have_the_published_derivatives_of_heyoka():
    # heyoka.py, tutorial on variational equations: ẍ = cos t − 0.4 ẋ − sin x, at t = 3
    problem = lierb.Problem(
        lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free(), states=driven_pendulum()
    )
    names = ("driven_pendulum.x", "driven_pendulum.speed", "driven_pendulum.damping")
    result = lierb.integrate(problem, twist0=(0.0,) * 6, dt=1e-2, t_end=3.0, with_respect_to=names)
    found = [[result.sensitivity(of, name)[0, 0] for name in names[:2]] for of in ("x", "speed")]
    published = [[-0.425478, 0.41983649], [-0.19171818, -0.51871994]]
    assert np.abs(np.array(found) - published).max() < 1e-6
    metadata = result.sensitivities.summary.schema.field("x/driven_pendulum.speed").metadata
    assert (metadata[b"unit"], metadata[b"per"]) == (b"rad", b"rad/s")


@pytest.mark.long
def test_states_and_observables_follow_the_motion_and_their_parameters():
    @lierb.states(path=0.0, params={"gain": 2.0})
    def path_length(v, states, params):
        return {"path": params.gain * np.sqrt(v @ v + states.path)}

    body = lierb.Body(1.0, (1.0, 1.0, 1.0))
    problem = lierb.Problem(
        body, lierb.joints.free(), (0.0, 0.0, -G), states=path_length(), observables=reach()
    )
    names = ("twist0", "path_length.gain", "path_length.path", "gravity", "reach.arm")
    result = lierb.integrate(
        problem, twist0=(0.0, 0.0, 0.0, 3.0, 0.0, 1.0), rtol=1e-12, t_end=0.5, with_respect_to=names
    )
    from scipy.integrate import solve_ivp

    def complex_end(change):
        h = 1j * steps.H
        v0 = np.array((3.0, 0.0, 1.0)) + h * change[:3]
        g = np.array((0.0, 0.0, -G)) + h * change[3:6]
        gain, start = 2.0 + h * change[6], h * change[7]

        def rate(t, y):
            return [gain * np.sqrt((v0 + g * t) @ (v0 + g * t) + y[0])]

        run = solve_ivp(rate, (0.0, 0.5), [start + 0j], "DOP853", rtol=1e-13, atol=1e-14)
        r = v0 * 0.5 + g * 0.125
        arm = 0.5 + h * change[8]
        watched = np.sqrt((r + np.array((0.0, 0.0, 1.0)) * arm) @ r + 1.0)
        return run.y[0, -1].imag / steps.H, watched.imag / steps.H

    change = np.random.default_rng(3).standard_normal(9)
    weights = dict(zip(names, ([*np.zeros(3), *change[:3]], change[6:7], change[7:8], change[3:6],
                               change[8:]), strict=True))  # fmt: skip
    for of, wanted in zip(("path", "reach"), complex_end(change), strict=True):
        found = sum(result.sensitivity(of, n)[0] @ np.array(w) for n, w in weights.items())
        assert abs(found - wanted) < 1e-10 * abs(wanted)


# ---- switches ----------------------------------------------------------------------------------


@lierb.wrench(stiffness=100.0)
def one_sided(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (0.0, 0.0, lierb.where(r[2] < 0.0, -params.stiffness * r[2], 0.0))


@lierb.wrench(thrust=1.0, stop=0.2, discontinuities="stop")
def burn(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (lierb.where(t < params.stop, params.thrust, 0.0), 0.0, 0.0)


@lierb.wrench(level=0.5)
def untold(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (np.sign(params.level - t), 0.0, 0.0)


@lierb.wrench(stiffness=1.0)
def kinked(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), -params.stiffness * np.clip(r, -1.0, 1.0) * abs(r[0])


def free_body(**more) -> lierb.Problem:
    return lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free(), **more)


@pytest.mark.parametrize("force", [one_sided(), untold()], ids=["where", "of a parameter"])
def test_a_function_that_switches_is_named_in_a_warning(force):
    """Before the run, which needs no kernel here, where warnings are errors."""
    start = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, -1.0), "dt": 0.01, "t_end": 0.1}
    with pytest.raises(lierb.errors.DerivativeWarning, match=f"{force.name}: switches"):
        lierb.integrate(free_body(forces=force), **start, with_respect_to="twist0")


@pytest.mark.long
def test_a_function_that_switches_gives_no_warning_without_derivatives():
    lierb.integrate(free_body(forces=one_sided()), twist0=(0.0,) * 6, dt=0.01, t_end=0.1)


@pytest.mark.long
def test_continuous_functions_give_no_warning():
    problem = free_body(forces=kinked())
    result = lierb.integrate(
        problem, twist0=(0.0,) * 6, dt=0.01, t_end=0.5, with_respect_to="twist0"
    )
    assert np.all(np.isfinite(result.sensitivity("pose", "twist0")))


@pytest.mark.slow
def test_a_stop_with_a_damper_warns_and_one_without_does_not():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    stops = {"lower": -1.0, "upper": 1.0, "stiffness": 10.0}
    start = {"twist0": hinge.twist(velocities=[0.5]), "dt": 0.01, "t_end": 0.1}
    body = lierb.Body(1.0, (0.1, 0.2, 0.3))
    for damping in (0.0, 0.1):
        force = lierb.forces.joint_limit(**stops, damping=damping)
        problem = lierb.Problem(body, hinge, forces=force)
        with warnings.catch_warnings(record=True) as issued:
            warnings.simplefilter("always")
            lierb.integrate(problem, **start, with_respect_to="twist0")
        assert [re.match("joint_limit: ", str(w.message)) is not None for w in issued] == (
            [True] if damping else []
        )


@pytest.mark.slow
def test_a_declared_time_that_stays_has_exact_derivatives_across_it():
    """And no warning, though the function switches there."""
    result = lierb.integrate(
        free_body(forces=burn()), twist0=(0.0,) * 6, dt=0.01, t_end=0.5,
        with_respect_to="burn.thrust",
    )  # fmt: skip
    # 0.2 s of thrust, then 0.3 s of coasting
    assert abs(result.sensitivity("twist", "burn.thrust")[0, 3, 0] - 0.2) < 1e-14
    assert abs(result.sensitivity("pose", "burn.thrust")[0, 3, 0] - (0.02 + 0.2 * 0.3)) < 1e-14

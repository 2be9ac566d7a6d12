"""Motors of given position or speed: starts, rows, torques, predictions and studies."""

from __future__ import annotations

import re

import numpy as np
import pytest
from cases import column, integrate, tiered

import lierb
from lierb.errors import ArgumentError, PoseError, TwistError, UnknownNameError
from lierb.studies.description.units import unit_of

MASS, ARM, INERTIA = 2.0, 0.4, 0.3
SWING, FREQUENCY = 0.7, 3.0  # rad, rad/s
G = 9.81


def swung(t, params):
    return params.swing * np.sin(params.frequency * t) + params.rate * t


def driven(swing=SWING, frequency=FREQUENCY, rate=0.0) -> lierb.Mechanism:
    body = lierb.Body(MASS, (0.1, 0.2, INERTIA), (ARM, 0.0, 0.0), about="com")
    motor = lierb.forces.motor(position=swung, swing=swing, frequency=frequency, rate=rate)
    arm = lierb.Link("arm", body, lierb.joints.revolute())
    return lierb.Mechanism(arm, gravity=(0.0, -G, 0.0), forces=motor.on("arm"))


def angles(result) -> np.ndarray:
    R = result["arm"].rotation
    return np.arctan2(R[..., 1, 0], R[..., 0, 0])


OPTIONS = {
    "fixed": {"dt": 1e-3},
    "projected": {"dt": 1e-3, "stabilise": "project"},
    "Baumgarte": {"dt": 1e-3, "stabilise": lierb.baumgarte(50.0, 50.0)},
    "SE3": {"dt": 1e-3, "cspace": "SE3"},
    "ambient": {"dt": 1e-3, "update": "ambient"},
    "adaptive": {"rtol": 1e-10, "method": "DOP853"},
    "Rosenbrock": {"rtol": 1e-9, "method": "Rodas5P"},
}


SLOW = ["projected"]


@pytest.mark.slow
@pytest.mark.parametrize("options", tiered(OPTIONS, ["fixed"], SLOW))
def test_a_driven_arm_follows_its_function_with_the_torque_of_newton(options):
    """Right: φ = A sin ωt, torque (I + m a²) φ̈ + m g a cos φ."""
    machine, t = driven(np.array([SWING, 2.0])), np.linspace(0.0, 2.0, 11)
    twist0 = machine.project(machine.twist())
    chosen = OPTIONS[options]
    saved = {"save_at": t} if "rtol" in chosen else {"save_every": 200}
    result = lierb.integrate(
        machine, twist0=twist0, t_end=2.0, record=("state", "multipliers", "reaction"),
        **saved, **chosen,
    )  # fmt: skip
    assert result.failed.size == 0
    right = np.outer(np.sin(FREQUENCY * t), [SWING, 2.0])
    # rounding of 2000 steps; Baumgarte's rates are no part of the solution; of rtol, in 2 s
    allowed = {"fixed": 1e-12, "projected": 1e-14, "SE3": 1e-12, "ambient": 1e-12}
    np.testing.assert_allclose(angles(result), right, rtol=0, atol=allowed.get(options, 1e-9))
    torque = (INERTIA + MASS * ARM**2) * -(FREQUENCY**2) * right + MASS * G * ARM * np.cos(right)
    found = -column(result.history, "arm.motor.lambda").reshape(right.shape)
    # Baumgarte's terms turn the steps' error of 5e-10 rad into torque
    loose = 1e-5 if options == "Baumgarte" else 1e-8
    np.testing.assert_allclose(found, torque, rtol=0, atol=loose)
    reaction = column(result.history, "arm.reaction").reshape(*right.shape, 6)
    np.testing.assert_allclose(reaction[..., 2], torque, rtol=0, atol=loose)
    # the work of the motor, by the method's order
    assert np.max(column(result.summary, "energy_drift_max")) < 1e-7


@pytest.mark.slow
def test_angles_continue_over_whole_turns():
    """A motor of 20 rad/s in 2 s: six turns, compared with the pose up to whole turns."""
    machine = driven(swing=0.0, rate=[20.0, -3.0])
    twist0 = machine.project(machine.twist())
    result = integrate(machine, twist0=twist0, dt=1e-2, t_end=2.0, stabilise="project")
    assert result.failed.size == 0
    R = result["arm"].rotation[-1]
    turned = np.arctan2(R[:, 1, 0], R[:, 0, 0]) - np.array([40.0, -6.0])
    np.testing.assert_allclose(np.sin(turned / 2.0), 0.0, atol=1e-14)  # rounding of 40 rad
    assert np.max(column(result.summary, "rotation_error_max")) < 1e-14


@pytest.mark.parametrize("is_mechanism", [True, False])
def test_rest_by_default_is_named_with_a_call_that_helps(is_mechanism):
    rod, hinge = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0), lierb.joints.revolute()
    drive = lierb.forces.motor(speed=[2.0, 3.0])
    problem = lierb.Problem(rod, hinge, forces=drive)
    mechanism = lierb.Mechanism(lierb.Link("rod", rod, hinge), forces=drive)
    model = mechanism if is_mechanism else problem
    with pytest.raises(TwistError, match=r"^twist0\[0\] \(rest, by default\) violates") as caught:
        lierb.integrate(model, dt=0.1, t_end=0.2)
    call = re.search(r"twist0=(\w+\.project\(.*\)) is the nearest", str(caught.value))[1]
    pose0 = model.by_link("pose", mechanism.pose() if is_mechanism else np.eye(4))
    names = {"mechanism": mechanism, "problem": problem, "np": np}
    twist0 = eval(call, names, {"pose0": model.from_links(pose0)})
    (twist,) = model.by_link("twist", twist0).values()
    np.testing.assert_allclose(twist[:, :3], [(0.0, 0.0, 2.0), (0.0, 0.0, 3.0)], atol=1e-15)


def test_a_start_must_have_position_and_speed():
    machine = driven()
    still, moving = machine.twist(), machine.project(machine.twist())
    off = machine.pose({"arm": 0.1})
    close = r"mechanism\.close\(pose0\) closes it, and moves links by up to .* and 0\.1 rad"
    with pytest.raises(PoseError, match=rf"^pose0 does not close motor \(arm .*{close}"):
        lierb.integrate(machine, pose0=off, twist0=moving, dt=1e-3, t_end=1.0)
    with pytest.raises(
        TwistError, match=r"motor \(arm .* \(motor: -2\.1\).*project\(twist0, pose0\)"
    ):
        lierb.integrate(machine, twist0=still, dt=1e-3, t_end=1.0)
    with pytest.raises(PoseError, match=r"mechanism\.close\(pose0, t0=2\)"):
        lierb.integrate(machine, twist0=moving, dt=1e-3, t0=2.0, t_end=3.0)
    pose0 = machine.close(off, t0=2.0)
    twist0 = machine.project(still, pose0, t0=2.0)
    angle, rate = SWING * np.sin(6.0), SWING * FREQUENCY * np.cos(6.0)
    assert machine.coordinates(pose0)["arm"] == pytest.approx(angle, abs=1e-15)
    assert machine.velocities(twist0, pose0)["arm"] == pytest.approx(rate, abs=1e-15)
    assert machine.violation(pose0, twist0, 2.0) is None
    assert machine.freedoms() == (1, 0)  # motors are not counted


@pytest.mark.slow
def test_one_body_takes_a_position_as_well():
    """On a cylindrical joint `coordinate` says which. Right: m (g + z̈) of the slide."""
    held, motor = lierb.joints.cylindrical(), lierb.forces.motor
    lift = motor(position=lambda t: 0.1 * np.sin(4.0 * t), coordinate="slide")
    problem = lierb.Problem(lierb.Body(2.0, (0.1, 0.2, 0.3)), held, (0.0, 0.0, -G), lift)
    with pytest.raises(PoseError, match=r"problem\.close\(pose0, t0=1\)"):
        integrate(problem, twist0=np.zeros(6), dt=1e-3, t0=1.0, t_end=2.0)
    pose0 = problem.close(np.eye(4), t0=1.0)
    assert pose0[2, 3] == pytest.approx(0.1 * np.sin(4.0), abs=1e-15)
    twist0 = problem.project((0.0, 0.0, 5.0, 0.0, 0.0, 0.0), pose0, t0=1.0)
    result = integrate(
        problem, pose0=pose0, twist0=twist0, dt=1e-3, t0=1.0, t_end=2.0, save_every=1000
    )
    assert result.position[-1, 0, 2] == pytest.approx(0.1 * np.sin(8.0), abs=1e-12)
    assert result.omega[-1, 0, 2] == 5.0
    found = -column(result.history, "lambda")[-1, -1]
    assert found == pytest.approx(2.0 * (G - 1.6 * np.sin(8.0)), abs=1e-11)
    assert result.history.schema.field("lambda").metadata[b"unit"].decode().endswith("N")


@pytest.mark.parametrize("what", [pytest.param("problem", marks=pytest.mark.long), "mechanism"])
def test_a_position_that_is_no_number_is_named(what):
    body, held = lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.prismatic()
    motor = lierb.forces.motor(position=lambda t: 1.0 / t)
    problem = lierb.Problem(body, held, forces=motor)
    pose = np.eye(4)
    if what == "mechanism":
        problem = lierb.Mechanism(lierb.Link("cart", body, held), forces=motor)
        pose = problem.pose()
    told = r"^the position that motor prescribes is inf m at t0=0 s"
    with pytest.raises(PoseError, match=told):
        problem.close(pose)
    twist0 = problem.twist() if what == "mechanism" else np.zeros(6)
    with pytest.raises(PoseError, match=told):
        lierb.integrate(problem, pose0=pose, twist0=twist0, dt=0.1, t_end=1.0)
    problem.close(pose, t0=2.0)


def test_arguments_of_motors_are_checked():
    motor = lierb.forces.motor
    with pytest.raises(ArgumentError, match="coordinate='slide' is for speed= and position="):
        motor(1.0, coordinate="slide")
    with pytest.raises(UnknownNameError, match="coordinate='axis' is unknown"):
        motor(speed=1.0, coordinate="axis")
    with pytest.raises(lierb.errors.ForceError, match="its derivatives are needed as well"):
        motor(position=lambda t: 1.0 if t > 1.0 else 0.0)


def test_a_given_position_drifts_and_leaves_the_joints_as_they_are():
    """Right: the integral of a rate that depends on time has the method's error."""
    predicted = lierb.predict(driven())
    for joints in predicted.values():
        assert joints["arm"].rotation_exact
        assert joints["motor"].rows == ("motor",)
        assert joints["motor"].rows_exact == (False,)


def test_a_study_drives_joints_and_names_the_units():
    cart = lierb.Link("cart", lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.prismatic())
    wheel = lierb.Link(
        "wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.cylindrical(), "cart"
    )
    motors = [
        lierb.forces.motor(position=0.3).on("cart"),
        lierb.forces.motor(speed=2.0, coordinate="slide").on("wheel"),
    ]
    machine = lierb.Mechanism([cart, wheel], forces=motors)
    speeds = lierb.sampling.Uniform(1.0, 2.0)
    design = lierb.sampling.Design({"forces.motor_2.speed": speeds}, n=3)
    study = lierb.study_of(machine, design, dt=0.01, t_end=0.1)
    made = study.batch(0, 3)
    assert unit_of("forces.motor_2.speed", study, made.problem) == "m/s"
    assert unit_of("forces.motor.position", study, made.problem) == "m"
    assert [force.kind.coordinate for force in made.problem.forces] == ["slide", "slide"]
    rates = made.problem.velocities(made.twist0, made.pose0)
    np.testing.assert_allclose(rates["wheel"][:, 1], made.problem.forces[1].parameters["speed"])
    places = made.problem.coordinates(made.pose0)
    np.testing.assert_allclose(places["cart"][:, 0], 0.3)


def ramp(t, params):
    return params.height * lierb.clip(t, 0.0, 1.0)


def raised(problem: bool, height, stabilise=None) -> lierb.Result:
    """A slide whose motor stops at t = 1 s: the rate of its position jumps."""
    box, slide = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0), lierb.joints.prismatic()
    motor = lierb.forces.motor(position=ramp, height=height)
    run = {"dt": 1e-2, "t_end": 2.0, "discontinuities": [1.0], "stabilise": stabilise}
    if problem:
        made = lierb.Problem(box, slide, forces=motor)
        return lierb.integrate(made, twist0=made.project((0.0,) * 6), **run)
    made = lierb.Mechanism(lierb.Link("cage", box, slide), forces=motor.on("cage"))
    return lierb.integrate(made, twist0=made.project(made.twist()), **run)


@pytest.mark.slow
@pytest.mark.parametrize("problem", [True, False])
def test_a_position_whose_rate_jumps_is_warned_of(problem):
    message = r"up to 0\.3 m off .* in trajectory 2: .*impulse.*stabilise=\"project\""
    with pytest.warns(lierb.errors.InconsistentStateWarning, match=message):
        raised(problem, [0.1, 0.2, 0.3])


@pytest.mark.slow
def test_a_projected_position_follows_a_jump_of_its_rate():
    result = raised(False, [0.1, 0.3], "project")
    np.testing.assert_allclose(result["cage"].position[:, 2], [0.1, 0.3], atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "solver"),
    [
        ("DOP853", "unrolled"),
        pytest.param("Tsit5", "looped", marks=pytest.mark.long),
        pytest.param("Rodas4", "unrolled", marks=pytest.mark.long),
    ],
)
def test_the_work_of_a_driven_joint_at_a_stop_is_its_energy(method, solver):
    """φ = 5 t + sin 3t passes a stop at ±1 and the jump of a spring at ±π; no force changes it."""
    inertia, t_end = 0.05, 3.0
    elements = [
        lierb.forces.motor(position=lambda t: 5.0 * t + np.sin(3.0 * t)),
        lierb.forces.torsional_spring(stiffness=1.0),
        lierb.forces.joint_limit(lower=-1.0, upper=1.0, stiffness=10.0),
    ]
    wheel = lierb.Link("wheel", lierb.Body(1.0, inertia * np.eye(3)), lierb.joints.revolute())
    machine = lierb.Mechanism(wheel, forces=[each.on("wheel") for each in elements])
    twist0 = machine.project(machine.twist())
    result = lierb.integrate(
        machine, twist0=twist0, t_end=t_end, rtol=1e-8, method=method, solver=solver
    )
    turn = (5.0 * t_end + np.sin(3.0 * t_end) + np.pi) % (2.0 * np.pi) - np.pi
    kinetic = 0.5 * inertia * ((5.0 + 3.0 * np.cos(3.0 * t_end)) ** 2 - 8.0**2)
    right = kinetic + 0.5 * turn**2 + 5.0 * max(0.0, abs(turn) - 1.0) ** 2
    # some hundred steps of 1e-8 of the work so far; it was 7.9 J off
    assert abs(result.summary["work_final"][0].as_py() - right) < 1e-5

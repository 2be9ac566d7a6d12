"""Gears: ratios of joint rates against closed forms, SciPy, and KKT of MuJoCo's matrices."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from cases import column, integrate, tiered
from public_cases.shared import summed
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ArgumentError, ForceError, TwistError, UnknownNameError

G = 9.81
Z = (0.0, 0.0, 1.0)


def wheel(inertia, mass=1.0, com=(0.0, 0.0, 0.0)) -> lierb.Body:
    """A body with this moment about e₃ through its centre of mass."""
    return lierb.Body(mass, (0.7 * inertia, 0.8 * inertia, inertia), com, about="com")


def on(parent_point=(0.0, 0.0, 0.0), **options) -> lierb.joints.Joint:
    return lierb.joints.revolute(parent_point=parent_point, **options)


FIRST, SECOND, TORQUE = 0.3, 0.7, 0.4
RATIOS = np.array([-2.5, 0.4, 31.0 / 7.0])


@cache
def pair() -> lierb.Mechanism:
    """Two wheels, a motor on the first."""
    return lierb.Mechanism(
        [lierb.Link("a", wheel(FIRST), on()), lierb.Link("b", wheel(SECOND), on((1.0, 0.0, 0.0)))],
        forces=[
            lierb.forces.gear(RATIOS).on("a", "b"), lierb.forces.motor(TORQUE).on("a"),
        ],
    )  # fmt: skip


@pytest.mark.parametrize("cspace", tiered(["reduced", "SE3", "SO3xR3"], ["reduced"], []))
def test_two_wheels_turn_by_their_ratio(cspace):
    """Right: (I₁ n² + I₂) α₂ = n τ, and the torque I₂ α₂ on the second wheel."""
    machine = pair()
    twist0 = machine.project(machine.twist({"a": 1.0}))
    result = integrate(machine, twist0=twist0, dt=1e-2, t_end=3.0, save_every=300, cspace=cspace)
    assert result.failed.size == 0
    alpha = TORQUE * RATIOS / (FIRST * RATIOS**2 + SECOND)
    first, second = summed(result, "a.omega")[:, 2], summed(result, "b.omega")[:, 2]
    # rounding of 300 steps; the energy of the start is that of the nearest rates
    np.testing.assert_allclose(first, RATIOS * second, rtol=1e-12)
    np.testing.assert_allclose(second, twist0["b"][:, 2] + 3.0 * alpha, rtol=1e-12)
    last = slice(-3, None)
    multiplier = column(result.history, "a.gear.lambda")[last, 0]
    np.testing.assert_allclose(multiplier, TORQUE - FIRST * RATIOS * alpha, rtol=1e-12)
    torque = column(result.history, "b.reaction")[last, 2]
    np.testing.assert_allclose(torque, SECOND * alpha, rtol=1e-12)
    np.testing.assert_allclose(column(result.history, "a.reaction")[last, 2], -multiplier)
    assert np.max(summed(result, "energy_drift_max")) < 1e-12
    assert machine.of_body(0).freedoms() == (1, 0)


@pytest.mark.slow
def test_a_rack_falls_with_its_pinion():
    """Slide by turn, m/rad. Right: (m r² + I) φ̈ = −m g r."""
    radius, mass, inertia = 0.05, 3.0, 0.02
    rack = lierb.Link("rack", lierb.Body(mass, (0.1, 0.1, 0.1)), lierb.joints.prismatic(axis=Z))
    pinion = lierb.Link("pinion", lierb.Body(1.0, (inertia,) * 3), on(axis=(1.0, 0.0, 0.0)))
    gear = lierb.forces.gear(radius).on("rack", "pinion")
    machine = lierb.Mechanism([rack, pinion], gravity=(0.0, 0.0, -G), forces=gear)
    assert machine.forces[0].kind.unit_of("ratio") == "m/rad"
    result = integrate(machine, twist0=machine.twist(), dt=1e-2, t_end=1.0)
    rate = -mass * G * radius / (mass * radius**2 + inertia)
    np.testing.assert_allclose(summed(result, "rack.v")[0], (0, 0, radius * rate), atol=1e-13)
    place = summed(result, "rack.position")[0, 2]
    assert place == pytest.approx(0.5 * radius * rate, abs=1e-13)
    force = column(result.history, "rack.gear.lambda")[-1, 0]
    assert -force == pytest.approx(mass * (radius * rate + G), rel=1e-12)
    assert result.history.schema.field("rack.gear.lambda").metadata[b"unit"] == b"N"


SUN, PLANET, RING = 20.0, 16.0, 52.0  # teeth
PLANETARY = {"carrier": 0.08, "sun": 0.01, "planet": 0.004}


@pytest.mark.long
def test_a_planetary_gear_has_the_ratio_of_willis():
    """Ring on the ground, a torque on the sun. Right: ω_s = (1 + z_r/z_s) ω_c, and the energy."""
    arm, mass, torque = 0.09, 0.6, 0.5
    axes = [
        lierb.Link("carrier", wheel(PLANETARY["carrier"]), on()),
        lierb.Link("sun", wheel(PLANETARY["sun"]), on(), "carrier"),
        lierb.Link("planet", wheel(PLANETARY["planet"], mass), on((arm, 0, 0)), "carrier"),
    ]
    gear, push = lierb.forces.gear, lierb.forces.constant_wrench(torque=(0.0, 0.0, torque))
    machine = lierb.Mechanism(
        axes,
        forces=[
            gear(-SUN / PLANET).on("planet", "sun"),
            gear(-RING / PLANET).on("planet", "carrier"),
            push.on("sun"),
        ],
    )
    assert machine.freedoms() == (1, 0)
    up, spun = 1.0 + RING / SUN, 1.0 - RING / PLANET
    whole = PLANETARY["carrier"] + mass * arm**2
    whole += PLANETARY["sun"] * up**2 + PLANETARY["planet"] * spun**2
    rate = torque * up / whole
    result = integrate(machine, twist0=machine.twist(), dt=1e-2, t_end=2.0)
    assert result.failed.size == 0
    for name, ratio in (("carrier", 1.0), ("sun", up), ("planet", spun)):
        found = summed(result, f"{name}.omega")[0, 2]
        assert found == pytest.approx(2.0 * ratio * rate, rel=1e-12), name
    assert abs(summed(result, "energy_drift_max")[0]) < 1e-9  # of RK4, 70 rad


@pytest.mark.long
def test_a_differential_shares_torque():
    """Bevel gears, axes across each other. Right: two decoupled modes, of cage and spider."""
    side, cage, cross, across = 0.02, 0.05, 0.003, 0.006
    spider = lierb.Body(0.5, (cross, across, across))
    machine = lierb.Mechanism(
        [
            lierb.Link("cage", wheel(cage), on()),
            lierb.Link("spider", spider, on(axis=(1.0, 0.0, 0.0)), "cage"),
            lierb.Link("left", wheel(side), on(), "cage"),
            lierb.Link("right", wheel(side), on(), "cage"),
        ],
        forces=[
            lierb.forces.gear(1.0).on("left", "spider"),
            lierb.forces.gear(-1.0).on("right", "spider"),
            lierb.forces.constant_wrench(torque=(0.0, 0.0, 0.2)).on("left"),
        ],
    )
    result = integrate(machine, twist0=machine.twist(), dt=1e-2, t_end=1.0)
    assert result.failed.size == 0
    both, apart = 0.2 / (cage + across + 2.0 * side), 0.2 / (cross + 2.0 * side)
    expected = {"cage": both, "left": both + apart, "right": both - apart}
    for name, rate in expected.items():
        assert summed(result, f"{name}.omega")[0, 2] == pytest.approx(rate, rel=1e-12), name


# ---- an arm whose elbow is geared to its shoulder ----------------------------------------------

M1, M2, I1, I2, L1, C1, C2 = 2.0, 1.1, 0.05, 0.03, 0.6, 0.25, 0.2
ELBOW = -1.7  # of the elbow's angle by the shoulder's


@cache
def arm() -> lierb.Mechanism:
    links = [
        lierb.Link("upper", wheel(I1, M1, (C1, 0.0, 0.0)), on()),
        lierb.Link("fore", wheel(I2, M2, (C2, 0.0, 0.0)), on((L1, 0.0, 0.0)), "upper"),
    ]
    gear = lierb.forces.gear(ELBOW).on("fore", "upper")
    return lierb.Mechanism(links, gravity=(0.0, -G, 0.0), forces=gear)


def moved(t):
    """Angle of the shoulder, its rate, and the torque on the elbow, by SciPy from Lagrange."""
    k = 1.0 + ELBOW

    def bend(y):
        a, w = y
        whole = I1 + M1 * C1**2 + I2 * k * k
        whole += M2 * (L1**2 + (C2 * k) ** 2 + 2.0 * L1 * C2 * k * np.cos(ELBOW * a))
        slope = -2.0 * M2 * L1 * C2 * k * ELBOW * np.sin(ELBOW * a)
        pull = G * ((M1 * C1 + M2 * L1) * np.cos(a) + M2 * C2 * k * np.cos(k * a))
        return -(0.5 * slope * w * w + pull) / whole

    solution = solve_ivp(
        lambda _, y: [y[1], bend(y)], (0.0, t[-1]), [0.4, 1.5], "DOP853", t_eval=t,
        rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip
    a, w = solution
    e, f = np.exp(1j * a), np.exp(1j * k * a)
    turn = bend(solution)
    centre = L1 * e * (1j * turn - w * w) + C2 * f * (1j * k * turn - (k * w) ** 2) + 1j * G
    return a, w, I2 * k * turn + M2 * (np.conj(C2 * f) * centre).imag


OPTIONS = {
    "reduced": {},
    "SE3": {"cspace": "SE3"},
    "projected": {"stabilise": "project"},
    "Baumgarte on SE3": {"stabilise": lierb.baumgarte(20.0, 20.0), "cspace": "SE3"},
    "adaptive": {"rtol": 1e-10, "method": "DOP853"},
    "Rosenbrock": {"rtol": 1e-9, "method": "Rodas5P"},
}


SLOW = ["SE3"]


@pytest.mark.slow
@pytest.mark.parametrize("options", tiered(OPTIONS, ["reduced"], SLOW))
def test_a_geared_arm_moves_as_scipy_says(options):
    """The gear's two joints share a link. Right: one coordinate, by SciPy."""
    machine, chosen = arm(), {"dt": 1e-3} | OPTIONS[options]
    pose0 = machine.pose({"upper": 0.4, "fore": ELBOW * 0.4})
    twist0 = machine.twist({"upper": 1.5, "fore": ELBOW * 1.5}, pose0)
    t = np.linspace(0.0, 2.0, 11)
    saved = {"save_at": t} if "rtol" in chosen else {"save_every": 200}
    if "rtol" in chosen:
        del chosen["dt"]
    result = lierb.integrate(
        machine, pose0=pose0, twist0=twist0, t_end=2.0,
        record=("state", "multipliers", "reaction"), **saved, **chosen,
    )  # fmt: skip
    assert result.failed.size == 0
    angle, rate, torque = moved(t)
    # RK4's order at 1 ms; DOP853 at 1e-10
    np.testing.assert_allclose(result["upper"].omega[:, 0, 2], rate, rtol=0, atol=1e-8)
    R = result["fore"].rotation[:, 0]
    turned = np.arctan2(R[:, 1, 0], R[:, 0, 0]) - (1.0 + ELBOW) * angle
    np.testing.assert_allclose(np.sin(turned), 0.0, rtol=0, atol=1e-8)
    multiplier = column(result.history, "fore.gear.lambda").ravel()
    np.testing.assert_allclose(-multiplier, torque, rtol=0, atol=1e-7)
    np.testing.assert_allclose(column(result.history, "fore.reaction")[:, 2], torque, atol=1e-7)
    np.testing.assert_allclose(
        column(result.history, "upper.reaction")[:, 2], -ELBOW * torque, atol=1e-7
    )


def test_the_angles_keep_the_ratio_over_many_turns():
    """Right: linear in the coordinates, whose rounding is 1e-16 of each step's turn."""
    machine = pair()
    twist0 = machine.twist({"a": 300.0 * RATIOS, "b": 300.0})
    result = integrate(machine, twist0=twist0, dt=1e-2, t_end=20.0)
    turned = [summed(result, f"{name}.rotation").reshape(-1, 3, 3) for name in ("a", "b")]
    angles = [np.arctan2(R[:, 1, 0], R[:, 0, 0]) for R in turned]
    alpha = TORQUE * RATIOS / (FIRST * RATIOS**2 + SECOND)
    whole = 6000.0 + 200.0 * alpha  # 955 turns of the second wheel
    for angle, right in zip(angles, (RATIOS * whole, whole), strict=True):
        # rounding of 2000 steps in a speed of 1300 rad/s
        np.testing.assert_allclose(np.sin(0.5 * (angle - right)), 0.0, atol=1e-8)


def test_predictions_say_that_the_ratio_is_kept():
    """Right: J is constant in the coordinates of each c-space, and so J V = 0 is linear."""
    for cspace, joints in lierb.predict(pair().of_body(0)).items():
        assert joints["gear"].rows == ("gear",), cspace
        assert joints["gear"].rows_exact == (True,), cspace
        assert joints.dimension == 1
    tilted = lierb.joints.spherical(body_point=(0.0, 0.0, 0.1))
    top = lierb.Link("top", wheel(0.2), tilted)
    rotor = lierb.Link("rotor", wheel(0.2), on((0.1, 0, 0)), "top")
    other = lierb.Link("other", wheel(0.2), on(), "top")
    gear = lierb.forces.gear(2.0).on("rotor", "other")
    found = lierb.predict(lierb.Mechanism([top, rotor, other], forces=gear))
    assert found["reduced"]["gear"].rows_exact == (True,)
    assert found["reduced"].dimension == 4
    # the rotors' axes move, and drift off the top's with the method's order
    assert found["SE3"]["gear"].rows_exact == (False,)


# ---- starts ------------------------------------------------------------------------------------


def test_a_start_must_have_the_ratio_of_rates():
    machine = pair().of_body(0)
    told = r"^twist0 violates gear \(a and b\): rotation rate 1 rad/s .*\(gear: 1\).*project"
    with pytest.raises(TwistError, match=told):
        lierb.integrate(machine, twist0=machine.twist({"a": 1.0}), dt=0.1, t_end=1.0)
    rates = machine.velocities(machine.project(machine.twist({"a": 1.0})))
    # the nearest in kinetic energy: I₁ (w₁ − 1)² + I₂ w₂² with w₁ = n w₂
    n = RATIOS[0]
    assert rates["b"][0] == pytest.approx(FIRST * n / (FIRST * n * n + SECOND), rel=1e-14)


def five_bar() -> lierb.Mechanism:
    """Two cranks, geared to turn against each other, and two couplers that meet."""
    bar = wheel(0.01)
    pin = lambda point, parent: on((parent, 0.0, 0.0), body_point=(point, 0.0, 0.0))
    return lierb.Mechanism(
        [
            lierb.Link("left", bar, pin(-0.1, 0.0)),
            lierb.Link("right", bar, pin(-0.1, 0.4)),
            lierb.Link("first", bar, pin(-0.3, 0.1), "left"),
            lierb.Link("second", bar, pin(-0.3, 0.1), "right"),
        ],
        lierb.Loop("knee", pin(0.3, 0.3), "second", "first"),
        forces=lierb.forces.gear(-1.0).on("left", "right"),
    )


def test_closing_keeps_the_mesh():
    """Right: the sum of the cranks' angles is that before, and both couplers meet above them."""
    machine = five_bar()
    guess = machine.pose({"left": 1.9, "right": 1.0, "first": -0.7, "second": 1.0})
    pose0 = machine.close(guess)
    found = machine.coordinates(pose0)
    assert found["left"] + found["right"] == pytest.approx(2.9, abs=1e-12)
    assert abs(found["left"][0] - 1.9) > 1e-3
    assert machine.freedoms(pose0) == (1, 3)  # 3 of the planar loop's rows are redundant
    np.testing.assert_array_equal(machine.close(pose0)["first"], pose0["first"])


@pytest.mark.long
def test_a_loop_s_hinge_has_teeth_as_well():
    """A wheel that floats in a bearing, which is a loop, moves as one on a hinge of the tree."""
    floating = lierb.Mechanism(
        [
            lierb.Link("a", wheel(FIRST), lierb.joints.free()),
            lierb.Link("b", wheel(SECOND), on((1.0, 0.0, 0.0))),
        ],
        lierb.Loop("bearing", on(), "a"),
        forces=[
            lierb.forces.gear(-2.5).on("bearing", "b"),
            lierb.forces.motor(TORQUE).on("bearing"),
        ],
    )
    twist0 = floating.project({"a": (0, 0, 1.0, 0, 0, 0), "b": np.zeros(6)})
    result = integrate(floating, twist0=twist0, dt=1e-2, t_end=1.0)
    alpha = TORQUE * -2.5 / (FIRST * 2.5**2 + SECOND)
    found = summed(result, "b.omega")[0, 2]
    assert found == pytest.approx(twist0["b"][2] + alpha, rel=1e-11)
    assert summed(result, "a.omega")[0, 2] == pytest.approx(-2.5 * found, rel=1e-11)
    assert column(result.history, "bearing.reaction")[-1, 2] == pytest.approx(
        -TORQUE + FIRST * -2.5 * alpha, rel=1e-10
    )


# ---- errors ------------------------------------------------------------------------------------

BODY = lierb.Body(1.0, (0.1, 0.1, 0.1))
REFUSED = {
    "one joint": (
        lambda gear: gear.on("a"), ArgumentError, r"gear, is on a alone, .*\.on\('a', 'b'\)",
    ),
    "unknown": (lambda gear: gear.on("a", "c"), UnknownNameError, "forces\\[0\\], gear: on='c'"),
    "no axis": (
        lambda gear: gear.on("a", "ball"), ForceError, "gear on 'ball' acts about the joint axis",
    ),
    "no slide": (
        lambda gear: lierb.forces.gear(1.0, coordinates=("turn", "slide")).on("a", "b"),
        ForceError, "gear on 'b' acts along the joint axis, along which a revolute",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_gears_are_refused_where_there_are_no_two_axes(what):
    placed, error, told = REFUSED[what]
    links = [
        lierb.Link("a", BODY, on()), lierb.Link("b", BODY, on()),
        lierb.Link("ball", BODY, lierb.joints.spherical()),
    ]  # fmt: skip
    with pytest.raises(error, match=told):
        lierb.Mechanism(links, forces=placed(lierb.forces.gear(2.0)))


def test_a_single_body_has_no_gear():
    with pytest.raises(ForceError, match=r"forces\[0\], gear, couples two joints, and a Problem"):
        lierb.Problem(BODY, on(), forces=lierb.forces.gear(2.0))
    with pytest.raises(ArgumentError, match="expected one for each of two joints"):
        lierb.forces.gear(2.0, coordinates=("turn",))
    with pytest.raises(UnknownNameError, match="coordinates='spin' is unknown"):
        lierb.forces.gear(2.0, coordinates=("turn", "spin"))


def test_a_study_samples_a_ratio():
    machine = pair().of_body(0)
    design = lierb.sampling.Design({"forces.gear.ratio": lierb.sampling.Uniform(1.0, 2.0)}, n=3)
    made = lierb.study_of(machine, design, dt=0.01, t_end=0.1).batch(0, 3)
    gear = made.problem.forces[0]
    assert (gear.at, gear.kind.coordinates) == (("a", "b"), ("turn", "turn"))
    assert np.all(gear.parameters["ratio"] > 1.0)


# ---- files -------------------------------------------------------------------------------------

COUPLED = """<mujoco><option gravity="1 -9.81 2"/><worldbody>
  <body name="a"><joint name="a" axis="0 0 1"/>
    <inertial pos="0.2 0.1 0" mass="2" diaginertia="0.03 0.04 0.05"/>
    <body name="b" pos="0.5 0 0"><joint name="b" axis="0 -1 -1"/>
      <inertial pos="0.1 0 0.3" mass="1.2" diaginertia="0.02 0.02 0.002"/></body></body>
  <body name="c" pos="0 1 0"><joint name="c" type="slide" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="0.7" diaginertia="0.01 0.01 0.01"/></body>
  <body name="d" pos="0 2 0"><joint name="d" axis="0 1 0"/>
    <inertial pos="0.1 0 0.1" mass="0.7" diaginertia="0.01 0.01 0.01"/></body></worldbody>
  <equality><joint name="bevel" joint1="b" joint2="a" polycoef="0.3 -2 0 0 0"/>
    <joint name="rack" joint1="c" joint2="a" polycoef="0 0.1 0 0 0"/>
    <joint name="lock" joint1="d" polycoef="0.2 0 0 0 0"/>{more}</equality></mujoco>"""


def read(path, text):
    path.write_text(text)
    with pytest.warns(lierb.errors.LeftOutWarning) as caught:
        machine = lierb.Mechanism.from_mjcf(path)
    return machine, caught[0].message.left_out


@pytest.mark.slow
def test_equalities_of_joints_are_gears_that_accelerate_as_in_mujoco(tmp_path):
    """Right: KKT of MuJoCo's mass matrix and bias, with the rows of the file."""
    machine, left_out = read(tmp_path / "coupled.xml", COUPLED.format(more=""))
    assert left_out == ("bevel: its offset 0.3, which coordinates at the start have to have",)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "coupled.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, 0.3 - 2.0 * 0.4, 0.1 * 0.4, 0.2
    data.qvel[:] = 1.5 * np.array([1.0, -2.0, 0.1, 0.0])
    mujoco.mj_forward(model, data)
    M = np.zeros((4, 4))
    mujoco.mj_fullM(model, M, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, M)
    J = np.array([[2.0, 1.0, 0.0, 0.0], [-0.1, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    system = np.block([[M, J.T], [J, np.zeros((3, 3))]])
    right = np.linalg.solve(system, np.concatenate([-data.qfrc_bias, np.zeros(3)]))
    rates = dict(zip("abcd", data.qvel, strict=True))
    signs = {
        link.name: np.sign(link.joint.body_frame[:3, 2] @ model.joint(link.name).axis)
        for link in machine.links
    }
    pose0 = machine.pose({name: signs[name] * data.joint(name).qpos[0] for name in "abcd"})
    twist0 = machine.twist({name: signs[name] * rates[name] for name in "abcd"}, pose0)
    assert machine.violation(pose0, twist0) is None
    dt = 1e-3
    result = integrate(machine, pose0=pose0, twist0=twist0, dt=dt, t_end=dt, method="Euler")
    # Euler's step shows accelerations as they are
    for name in "ac":
        link = machine.link(name)
        axis = signs[name] * link.joint.body_frame[:3, 2]
        kind = "omega" if name == "a" else "v"
        after = summed(result, f"{name}.{kind}")[0] @ axis
        found = (after - rates[name]) / dt
        np.testing.assert_allclose(found, right[model.joint(name).id], rtol=0, atol=1e-9)
    multiplier = column(result.history, "b.gear.lambda")[0, 0]
    assert signs["b"] * multiplier == pytest.approx(right[4], rel=1e-9)
    assert column(result.history, "c.gear.lambda")[0, 0] * signs["c"] == pytest.approx(right[5])
    assert column(result.history, "d.motor.lambda")[0, 0] * signs["d"] == pytest.approx(right[6])


def test_equalities_that_are_no_gears_are_listed(tmp_path):
    more = """<joint name="cam" joint1="c" joint2="a" polycoef="0 0.1 0.5 0 0"/>"""
    _, left_out = read(tmp_path / "cam.xml", COUPLED.format(more=more))
    assert "cam: equality/joint with a polynomial beyond a₁" in left_out

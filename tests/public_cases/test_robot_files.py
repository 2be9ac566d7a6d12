"""Files of robots: what their bodies are together, and how they move."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from cases import integrate
from scipy.integrate import solve_ivp

import lierb
from public_cases.shared import read_urdf, summed, urdf_joint, urdf_link

mujoco = pytest.importorskip("mujoco")

G = 9.81  # m/s²


def read_mjcf(path, text: str) -> lierb.Mechanism:
    """The mechanism of an MJCF file with this text, whatever it leaves out."""
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lierb.errors.LeftOutWarning)
        return lierb.Mechanism.from_mjcf(path)


@pytest.mark.slow
def test_c07_a_free_root_without_mass_turns_as_its_child_does(tmp_path):
    """mujoco#3553, mujoco#3554, mujoco_warp#1669: all mass is on a welded child; it diverges.

    Right: Euler's equations, by SciPy; the child is turned, and off the root's frame.
    """
    machine = read_mjcf(tmp_path / "root.xml", """<mujoco><option gravity="0 0 0"/><worldbody>
      <body name="root"><freejoint/><body name="child" pos="0.3 -0.1 0.2" euler="20 -30 40">
        <inertial pos="0.05 0 0.1" mass="2" diaginertia="0.02 0.05 0.06"/></body></body>
      </worldbody></mujoco>""")  # fmt: skip
    assert machine.names == ("root",)
    body = machine.link("root").body
    inertia = body.inertia - body.mass * (body.com @ body.com * np.eye(3)
                                          - np.outer(body.com, body.com))  # fmt: skip
    np.testing.assert_allclose(np.linalg.eigvalsh(inertia), (0.02, 0.05, 0.06), rtol=1e-12)
    omega = np.array((0.5, 8.0, 1.0))
    # its centre of mass stands still at first, and so for ever
    twist0 = {"root": np.concatenate([omega, -np.cross(omega, body.com)])}
    result = integrate(machine, twist0=twist0, dt=1e-3, t_end=20.0)
    euler = lambda _, w: np.linalg.solve(inertia, np.cross(inertia @ w, w))
    right = solve_ivp(euler, (0.0, 20.0), omega, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    # RK4 at 1 ms and 8 rad/s: 20 · 8⁵ · 1e-12/120 of 8 rad/s
    np.testing.assert_allclose(summed(result, "root.omega")[0], right, rtol=0, atol=1e-6)
    R, r = summed(result, "root.rotation").reshape(3, 3), summed(result, "root.position")[0]
    np.testing.assert_allclose(R @ body.com + r, body.com, rtol=0, atol=1e-7)


def test_c20_links_of_files_may_be_point_masses(tmp_path):
    """drake#16992; icub_description: links with a mass and no inertia are refused.

    Right: SciPy, with the textbook's equations of a double pendulum of point masses.
    """
    first, second, length, under = 0.7, 1.3, 0.4, 0.6  # kg, kg, m, m
    bob = lambda name, mass, length: urdf_link(name, mass, (0, 0, 0), f"0 0 {-length}")
    hinge = '<axis xyz="0 -1 0"/><origin xyz="0 0 {}"/>'
    machine, left_out = read_urdf(
        tmp_path / "pendulum.urdf",
        f"""<robot name="pendulum"><link name="base"/>
      {bob("upper", first, length)}{bob("lower", second, under)}
      {urdf_joint("top", "continuous", "base", "upper", hinge.format(0))}
      {urdf_joint("knee", "continuous", "upper", "lower", hinge.format(-length))}</robot>""",
        gravity=(0.0, 0.0, -G),
    )
    assert left_out[0].endswith(": upper, lower")

    def rates(_, state):
        a, b, u, w = state  # angles to the vertical
        c, s = np.cos(a - b), np.sin(a - b)
        mass = [[(first + second) * length, second * under * c], [length * c, under]]
        load = [
            -second * under * w * w * s - (first + second) * G * np.sin(a),
            length * u * u * s - G * np.sin(b),
        ]
        return [u, w, *np.linalg.solve(mass, load)]

    start = (1.2, -0.5, 0.3, 0.8)
    right = solve_ivp(rates, (0.0, 1.0), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    angles = {"upper": start[0], "lower": start[1] - start[0]}
    pose0 = machine.pose(angles)
    twist0 = machine.twist({"upper": start[2], "lower": start[3] - start[2]}, pose0)
    result = integrate(machine, pose0=pose0, twist0=twist0, dt=1e-3, t_end=1.0)
    for name, angle, rate in zip(machine.names, right[:2], right[2:], strict=True):
        R = summed(result, f"{name}.rotation").reshape(3, 3)
        np.testing.assert_allclose(np.arctan2(-R[0, 2], R[0, 0]), angle, rtol=0, atol=1e-8)
        np.testing.assert_allclose(summed(result, f"{name}.omega")[0], (0, -rate, 0), atol=1e-7)


@pytest.mark.slow
def test_c26_a_mimicked_joint_moves_with_the_other(tmp_path):
    """mujoco#3527, pinocchio#1290, SAPIEN#68: mimics are dropped silently. Right: the file.

    The follower's axis is opposite to e₃ of its joint or not: rates are those of the file. Of two
    equal fingers, the one that turns twice as fast has four times the effect on the motor.
    """
    mimic = '<axis xyz="0 0 1"/><mimic joint="lead" multiplier="-2" offset="0.1"/>'
    machine, left_out = read_urdf(
        tmp_path / "gripper.urdf",
        f"""<robot name="gripper">
      <link name="palm"/>{urdf_link("left")}{urdf_link("right")}
      {urdf_joint("lead", "continuous", "palm", "left", '<axis xyz="0 0 1"/>')}
      {urdf_joint("follower", "continuous", "palm", "right", mimic)}</robot>""",
    )
    (line,) = left_out
    assert line.startswith("joint follower: mimic of lead: its offset 0.1, which coordinates")
    torque, inertia = 0.3, 0.04
    driven = lierb.Mechanism(
        machine.links, forces=[*machine.forces, lierb.forces.motor(torque).on("left")]
    )
    twist0 = driven.twist({"left": 1.0, "right": -2.0})
    result = integrate(driven, twist0=twist0, dt=0.01, t_end=1.0)
    speed = 1.0 + torque / (5.0 * inertia)
    np.testing.assert_allclose(summed(result, "left.omega")[0], (0.0, 0.0, speed), atol=1e-14)
    np.testing.assert_allclose(summed(result, "right.omega")[0], (0, 0, -2.0 * speed), atol=1e-13)


def chain(length: float, given: str) -> str:
    """Three capsules, each hanging from the end of the one before, about axes that alternate.

    given : "geoms", of water's density, or "inertials".
    """
    mass, inside = length**3 * 40.0, ""
    moments = " ".join(repr(x * mass * length**2) for x in (0.09, 0.085, 0.008))
    for axis in ("0 1 0", "1 0 0.2", "0 1 0"):
        weight = f"""<geom type="capsule" fromto="0 0 0 0 {0.2 * length!r} {-length!r}"
          size="{0.15 * length!r}"/>"""
        if given == "inertials":
            weight = f"""<inertial pos="0 {0.1 * length!r} {-0.5 * length!r}" mass="{mass!r}"
              diaginertia="{moments}"/>"""
        inside = f"""<body pos="0 {0.2 * length!r} {-length!r}"><joint axis="{axis}"/>{weight}
          {inside}</body>"""
    return f"""<mujoco><option gravity="0 0 -9.81"/><worldbody>{inside}</worldbody></mujoco>"""


@pytest.mark.parametrize(
    "given",
    [
        pytest.param("geoms", marks=pytest.mark.skipif(
            not hasattr(mujoco.MjSpec, "adopt_inertial"), reason="needs a later MuJoCo")),
        "inertials",
    ],
)  # fmt: skip
def test_c10b_a_worm_of_a_tenth_of_a_millimetre_moves_as_a_large_one(tmp_path, given):
    """newton#2211, mujoco#1086: moments of 1e-19 kg m² are below what MuJoCo's compiler takes.

    Right: dynamic similarity, of a chain 1000 times as long in √1000 times the time.
    """
    ends = []
    for length in (1e-4, 0.1):
        machine = read_mjcf(tmp_path / "worm.xml", chain(length, given))
        assert machine.link(machine.names[-1]).body.mass < 1e3 * length**3
        step = 2e-3 * np.sqrt(length / 9.81)
        pose0 = machine.pose(dict(zip(machine.names, (0.6, -0.4, 0.9), strict=True)))
        result = lierb.integrate(
            machine, pose0=pose0, dt=step, t_end=10_000 * step, solver="looped"
        )
        assert result.failed.size == 0
        ends.append([result[name].rotation[0] for name in machine.names])
        ends[-1] += [result[name].position[0] / length for name in machine.names]
    assert np.abs(ends[0][0] - pose0[machine.names[0]][:3, :3]).max() > 0.1  # it moves
    for small, large in zip(*ends, strict=True):
        # rounding of 10⁴ steps left 3e-14
        np.testing.assert_allclose(small, large, rtol=0, atol=1e-11)


HOPPER = """<mujoco><option gravity="0 0 -9.81" timestep="1e-4" integrator="RK4"/><worldbody>
  <body name="torso" pos="0 0 1.2">
    <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <joint type="hinge" axis="0 1 0"/>
    <inertial pos="0 0 0.1" mass="3.5" diaginertia="0.08 0.09 0.01"/>
    <body name="thigh" pos="0 0 -0.2"><joint axis="0 -1 0" damping="0.4" stiffness="3"/>
      <inertial pos="0.02 0 -0.2" mass="1.2" diaginertia="0.02 0.02 0.002"/>
      <body name="foot" pos="0 0 -0.45"><joint axis="0 -1 0" pos="0 0 0.02" damping="0.2"/>
        <inertial pos="0.06 0 0" mass="0.6" diaginertia="0.001 0.004 0.004"/></body></body></body>
  </worldbody></mujoco>"""


@pytest.mark.long
def test_c39_a_planar_hopper_flies_as_in_mujoco(tmp_path):
    """gymnasium and dm_control: roots of two slides and a hinge. Right: MuJoCo's RK4 at 0.1 ms."""
    machine = read_mjcf(tmp_path / "hopper.xml", HOPPER)
    assert machine.link("torso").joint.name == "planar"
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hopper.xml"))
    data = mujoco.MjData(model)
    data.qvel[:] = (0.8, 2.0, -3.0, 5.0, -4.0)
    mujoco.mj_forward(model, data)
    twist0 = {}
    for name in machine.names:  # in body axes, of the body's frame
        found = np.zeros(6)
        mujoco.mj_objectVelocity(
            model, data, mujoco.mjtObj.mjOBJ_XBODY, model.body(name).id, found, 1
        )
        twist0[name] = found
    result = integrate(machine, twist0=twist0, dt=1e-3, t_end=0.5)
    for _ in range(5000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    for name in machine.names:
        i = model.body(name).id
        R = summed(result, f"{name}.rotation").reshape(3, 3)
        # RK4 at 1 ms of 5 rad/s, and of dampers of 0.4/0.02 1/s
        np.testing.assert_allclose(R, data.xmat[i].reshape(3, 3), rtol=0, atol=1e-7)
        np.testing.assert_allclose(
            summed(result, f"{name}.position")[0], data.xpos[i], rtol=0, atol=1e-7
        )


# ---- c37, c52: URDF files of robots ------------------------------------------------------------


NONE, SMALL = (0.0, 0.0, 0.0), (1e-4, 1e-4, 1e-4)  # kg m²
NO_BODYS = (1e-5, 1e-5, 1.0)  # one is more than the two others together


def robot(root, foot, limit='lower="-1" upper="1"') -> str:
    """A leg; `root` and `foot`, which is welded to its shin, are moments of inertia."""
    return f"""<robot name="leg">
      {urdf_link("base", 2.0, root)}
      {urdf_link("thigh", 1.5, xyz="0 0.01 -0.1")}
      {urdf_link("shin", 0.7, (0.004, 0.005, 0.006), xyz="0.02 0 -0.15")}
      {urdf_link("foot", 0.1, foot)}
      {
        urdf_joint(
            "hip",
            "revolute",
            "base",
            "thigh",
            f'<axis xyz="0 1 0"/><limit {limit} effort="1" velocity="1"/>',
        )
    }
      {
        urdf_joint(
            "knee", "continuous", "thigh", "shin", '<origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/>'
        )
    }
      {urdf_joint("ankle", "fixed", "shin", "foot", '<origin xyz="0.03 0 -0.3"/>')}
    </robot>"""


@pytest.mark.parametrize(
    ("root", "foot", "merge_fixed"),
    [
        (NONE, NONE, True), (NO_BODYS, SMALL, True), (NO_BODYS, NONE, True),
        (NONE, NONE, False), (NO_BODYS, NONE, False),
    ],
)  # fmt: skip
def test_c37_inertias_of_root_and_welded_links_do_not_matter(tmp_path, root, foot, merge_fixed):
    """Gepetto/example-robot-data: 13 of 68 robots have such links. Right: the XML's own numbers.

    A welded link that is no body by itself is part of what it is welded to.
    """
    text = robot(root, foot)
    machine, _ = read_urdf(tmp_path / "leg.urdf", text, merge_fixed=merge_fixed)
    assert machine.names == ("thigh", "shin")
    shin = machine.link("shin").body
    # both together: parallel axes, by hand
    points = [(0.7, np.array((0.02, 0.0, -0.15))), (0.1, np.array((0.03, 0.0, -0.3)))]
    np.testing.assert_allclose(shin.mass, 0.8, rtol=1e-14)
    np.testing.assert_allclose(shin.com, sum(m * x for m, x in points) / 0.8, rtol=0, atol=1e-15)
    about = np.diag([0.004, 0.005, 0.006]) + np.diag(foot)
    about = about + sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in points)
    np.testing.assert_allclose(shin.inertia, about, rtol=0, atol=1e-15)


def test_c37_roots_mass_is_listed_as_left_out(tmp_path):
    """Gepetto/example-robot-data: the ground has no mass, and 37 files said nothing of theirs."""
    _, left_out = read_urdf(tmp_path / "leg.urdf", robot(SMALL, SMALL))
    assert any("base" in what and "mass" in what for what in left_out), left_out


@pytest.mark.parametrize("limit_stiffness", [None, 500.0])
def test_c52_a_locked_joint_is_locked_or_listed(tmp_path, limit_stiffness):
    """mujoco#3527, drake#11109. Limits 0 … 0 hold a joint: it is held, or listed as left out."""
    text = robot(SMALL, SMALL, 'lower="0" upper="0"')
    machine, left_out = read_urdf(tmp_path / "leg.urdf", text, limit_stiffness=limit_stiffness)
    is_held = machine.link("thigh").joint.name == "fixed" or machine.forces
    assert is_held or any("hip" in what and "limit" in what for what in left_out), left_out


@pytest.mark.parametrize("depth", [1, 6, 20])
def test_c52_the_link_at_fault_is_named(tmp_path, depth):
    """mujoco#3527, drake#11109: a message that names no link is none, however long the path."""
    folder = tmp_path
    for number in range(depth):
        folder = folder / f"a_folder_of_some_length_{number}"
    folder.mkdir(parents=True)
    bad = "left_front_lower_suspension_link_with_a_name_as_exporters_write_them"
    text = robot(SMALL, SMALL).replace("shin", bad)
    text = text.replace('ixx="0.004"', 'ixx="0.4"')  # more than the other two together
    with pytest.raises(lierb.errors.ArgumentError) as caught:
        read_urdf(folder / "leg.urdf", text)
    assert bad in str(caught.value)

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


def read_mjcf(path, text: str) -> lierb.Mechanism:
    """The mechanism of an MJCF file with this text, whatever it leaves out."""
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lierb.errors.LeftOutWarning)
        return lierb.Mechanism.from_mjcf(path)


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


def test_c26_a_mimicked_joint_is_listed_as_left_out(tmp_path):
    """mujoco#3527, pinocchio#1290, SAPIEN#68: mimics are dropped silently. Right: the file."""
    mimic = '<axis xyz="0 0 1"/><mimic joint="lead" multiplier="-2"/>'
    _, left_out = read_urdf(
        tmp_path / "gripper.urdf",
        f"""<robot name="gripper">
      <link name="palm"/>{urdf_link("left")}{urdf_link("right")}
      {urdf_joint("lead", "continuous", "palm", "left", '<axis xyz="0 0 1"/>')}
      {urdf_joint("follower", "continuous", "palm", "right", mimic)}</robot>""",
    )
    assert any("equality/joint" in what or "mimic" in what for what in left_out)


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


@pytest.mark.slow
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

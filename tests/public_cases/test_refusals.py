"""Refusals, with the cause that each message names, and the correct call beside it."""

from __future__ import annotations

import numpy as np
import pytest
from cases import integrate

import lierb
from public_cases.shared import read_urdf, summed, urdf_joint, urdf_link


def test_c20_a_point_mass_is_refused():
    """CodingTrain#533, drake#16992. A body that turns has an inertia, by definition.

    The message names the small sphere to take instead; test_rigid_bodies.py has its period. Links
    of files are such spheres: test_robot_files.py.
    """
    with pytest.raises(
        lierb.errors.InertiaError, match=r"0, 0, 0 kg m²; for a point mass .*sphere"
    ):
        lierb.Body(1.0, (0.0, 0.0, 0.0))


ARM = f"""<robot name="arm"><link name="base"/>{{bad}}{urdf_link("hand")}
  {urdf_joint("shoulder", "continuous", "base", "upper_arm", '<axis xyz="0 1 0"/>')}
  {urdf_joint("wrist", "continuous", "upper_arm", "hand", '<axis xyz="0 1 0"/>')}</robot>"""


@pytest.mark.parametrize("moments", [(0.02, 0.03, 0.06), (1.0, 1e-3, 1e-3)])
def test_c22_a_link_with_an_inertia_no_body_has_is_named(tmp_path, moments):
    """mujoco#375, example-robot-data#130, rm_models#6, icub-models#269, Genesis#2274.

    Right: the largest moment is at most the sum of the others, by definition.
    """
    text = ARM.format(bad=urdf_link("upper_arm", moments=moments))
    with pytest.raises(lierb.errors.ArgumentError, match="upper_arm"):
        read_urdf(tmp_path / "arm.urdf", text)
    # as the message says
    mended = text.replace(
        '<link name="base"/>',
        '<mujoco><compiler balanceinertia="true"/></mujoco><link name="base"/>',
    )
    machine, _ = read_urdf(tmp_path / "arm.urdf", mended)
    assert machine.names == ("upper_arm", "hand")


def test_c24_links_without_mass_that_turn_about_one_axis_are_refused(tmp_path):
    """Genesis#3185, drake#13903, pinocchio#60: massless links of a mobile base.

    Right: mechanics; nothing says how much each of two hinges on one axis turns. Slides across each
    other are regular (tests/test_model_files.py).
    """
    axis = '<axis xyz="1 0 0"/>'
    text = f"""<robot name="base"><link name="floor"/><link name="x_carriage"/>
      <link name="y_carriage"/>{urdf_link("chassis", 20.0)}
      {urdf_joint("x", "continuous", "floor", "x_carriage", axis)}
      {urdf_joint("y", "continuous", "x_carriage", "y_carriage", axis)}
      {urdf_joint("turn", "continuous", "y_carriage", "chassis", '<axis xyz="0 0 1"/>')}</robot>"""
    with pytest.raises(lierb.errors.ArgumentError, match=r"[xy]_carriage has no mass"):
        read_urdf(tmp_path / "base.urdf", text)


# ---- c27: more than a turn ---------------------------------------------------------------------


def test_c27_stops_a_turn_apart_are_refused():
    """PhysX#243, bullet3#42, mujoco#1077: limits beyond ±π. A pose does not tell turns apart."""
    for lower, upper in ((-4.0, 4.0), (0.0, 7.0), (-np.pi, np.pi)):
        with pytest.raises(lierb.errors.ArgumentError, match="a turn or more above lower"):
            lierb.forces.joint_limit(lower=lower, upper=upper, stiffness=10.0)


@lierb.states(turned=0.0, unit={"turned": "rad"})
def counter(omega):
    return {"turned": omega[2]}


@lierb.wrench(stiffness=0.05)
def mainspring(t, R, r, omega, v, params, states):
    return np.array([0.0, 0.0, -params.stiffness * states.turned]), np.zeros(3)


@pytest.mark.slow
def test_c27_a_counted_angle_winds_a_spring_by_many_turns():
    """PhysX#243, bullet3#42. Right: a cosine, of up to 16 turns; a state counts them."""
    held, start = lierb.joints.revolute(), np.array([1.0, 10.0, 100.0])
    problem = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.1, 0.2)), held, forces=mainspring(), states=counter(turned=start)
    )
    result = integrate(
        problem, pose0=held.pose(start[:, None]), twist0=np.zeros((3, 6)), dt=1e-3, t_end=10.0
    )
    angle = start * np.cos(np.sqrt(0.05 / 0.2) * 10.0)
    # RK4 of w dt = 5e-4, and rounding of 1e4 steps of up to 100 rad
    np.testing.assert_allclose(summed(result, "turned"), angle, rtol=1e-12)
    R = summed(result, "rotation").reshape(3, 3, 3)
    off = np.arctan2(R[:, 1, 0], R[:, 0, 0]) - angle
    np.testing.assert_allclose(np.sin(off / 2), 0.0, atol=1e-11)

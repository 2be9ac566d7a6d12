"""Wheels, the computer that drives them, and what attitude.toml records."""

import numpy as np

import lierb


@lierb.states(wheels=(0.0, 0.0, 0.0), unit={"wheels": "N m s"})
def reaction_wheels(controls):
    """Angular momentum of the wheels, N m s, in body axes."""
    return {"wheels": -controls.torque}


@lierb.controller(
    every=0.1, unit={"torque": "N m"},
    stiffness=0.6, damping=4.0, gyro=2e-4, most=0.05,
)  # fmt: skip
def computer(R, omega, params):
    """A PD law back to the ground's axes, the shorter way, ten times a second.

    gyro : its noise, rad/s, in each axis.   most : that the wheels give, N m.
    """
    turn = lierb.quaternion(R)[1:]
    measured = omega + params.gyro * lierb.noise.normal("gyro", 3)
    torque = -params.stiffness * turn - params.damping * measured
    return {"torque": np.clip(torque, -params.most, params.most)}


@lierb.wrench
def reaction(t, R, r, omega, v, params, states, controls):
    """Torque on the body: the command, and the turn of the wheels' momentum."""
    return controls.torque - np.cross(omega, states.wheels), np.zeros(3)


def angle_of(R):
    """Between the body's third axis and the ground's, rad."""
    return np.arctan2(np.hypot(R[0, 2], R[1, 2]), R[2, 2])


@lierb.observable(unit="rad")
def pointing_error(R):
    return angle_of(R)


@lierb.event(direction=-1, within=np.radians(1.0))
def pointed(R, params):
    """The axis comes within an angle, rad, of where it shall point."""
    return angle_of(R) - params.within


@lierb.event(direction=1, capacity=2.0)
def saturated(states, params):
    """The wheels have taken all that they can, N m s."""
    return states.wheels @ states.wheels - params.capacity**2

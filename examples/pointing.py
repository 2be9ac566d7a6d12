"""A controller, and how well it points: what pointing.toml names."""

import numpy as np

import lierb


@lierb.wrench(stiffness=0.3, damping=3.0, most=0.05)
def controller(t, R, r, omega, v, params):
    """Turn to the ground's axes, the shorter way, by a limited torque, N m."""
    turn = lierb.quaternion(R)[1:]
    torque = -params.stiffness * turn - params.damping * omega
    return np.clip(torque, -params.most, params.most), np.zeros(3)


@lierb.observable(unit="rad", axis=(0.0, 0.0, 1.0))
def pointing_error(R, params):
    """The angle between an axis of the body and the same one of the ground."""
    seen = R @ params.axis
    across = np.linalg.norm(np.cross(params.axis, seen))
    return np.arctan2(across, params.axis @ seen)

"""Complex-step derivatives of a body on a joint, without lierb: Newton's and Euler's equations
about the centre of mass in ground axes, with the rows of `oracle`, by SciPy's DOP853 on complex
numbers.

f(x + i h) = f(x) + i h f′(x) to rounding for h = 1e-30: no difference cancels.
"""

from __future__ import annotations

import numpy as np
from oracle import JOINT_ROWS, _row
from scipy.integrate import solve_ivp

H = 1e-30


def hat(a) -> np.ndarray:
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def cross(a, b) -> np.ndarray:
    return hat(a) @ b


def moved(pose, change) -> np.ndarray:
    """Pose C exp δ to first order in δ.   change : (6,), imaginary."""
    step = np.zeros((4, 4), complex)
    step[:3, :3], step[:3, 3] = hat(change[:3]), change[3:]
    return pose @ (np.eye(4) + step)


def end(
    joint, pose, twist, t_end, *, mass, inertia, com, gravity, ground_frame, body_frame,
    pitch=0.0, length=1.0, force=None,
):  # fmt: skip
    """Pose (4, 4) and twist (6,) of the body frame at the end, λ there, all complex.

    inertia : (3, 3) about the body frame's origin.   force : (t, R, r, ω, v) → torque and force in
    body axes, about the body frame's origin, with ω and v in body axes.
    """
    about_com = inertia - mass * (com @ com * np.eye(3) - np.outer(com, com))
    g = ground_frame[:3, :3].T
    names = JOINT_ROWS[joint].split()

    def solved(t, y):
        R, r, omega, rate = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:18]
        point = R @ (body_frame[:3, 3] - com)
        b = (R @ body_frame[:3, :3]).T
        s = r + point - ground_frame[:3, 3]
        turned = R @ about_com @ R.T
        total, torque = mass * gravity, -cross(omega, turned @ omega)
        if force is not None:
            v = R.T @ (rate - cross(omega, R @ com))
            own = force(t, R, r - R @ com, R.T @ omega, v)
            total = total + R @ own[1]
            torque = torque + R @ (own[0] - cross(com, own[1]))
        m = len(names)
        system, right = np.zeros((6 + m, 6 + m), complex), np.zeros(6 + m, complex)
        system[:3, :3], system[3:6, 3:6] = turned, mass * np.eye(3)
        right[:3], right[3:6] = torque, total
        for i, name in enumerate(names, start=6):
            system[i, :3], system[i, 3:6], right[i] = _row(
                name, s, rate + cross(omega, point), point, omega, g, b, pitch, length
            )
        system[:6, 6:] = system[6:, :6].T
        return np.linalg.solve(system, right)

    def rate(t, y):
        R = y[:9].reshape(3, 3)
        return np.concatenate([(hat(y[12:15]) @ R).ravel(), y[15:18], solved(t, y)[:6]])

    R = pose[:3, :3]
    v = R @ (twist[3:] + cross(twist[:3], com))
    y = np.concatenate([R.ravel(), pose[:3, 3] + R @ com, R @ twist[:3], v]).astype(complex)
    run = solve_ivp(rate, (0.0, t_end), y, "DOP853", rtol=1e-13, atol=1e-14)
    y, R = run.y[:, -1], run.y[:9, -1].reshape(3, 3)
    pose, omega = np.eye(4, dtype=complex), R.T @ y[12:15]
    pose[:3, :3], pose[:3, 3] = R, y[9:12] - R @ com
    twist = np.concatenate([omega, R.T @ y[15:18] - cross(omega, com)])
    return pose, twist, solved(t_end, y)[6:]


def derivatives(change):
    """Of `end`, along a change of its arguments: C⁻¹∂C (6,), ∂V (6,), ∂λ."""
    pose, twist, multipliers = change
    C, dC = pose.real, pose.imag / H
    spin = C[:3, :3].T @ dC[:3, :3]
    turning = 0.5 * (spin - spin.T)[(2, 0, 1), (1, 2, 0)]
    place = C[:3, :3].T @ dC[:3, 3]
    return np.concatenate([turning, place]), twist.imag / H, multipliers.imag / H

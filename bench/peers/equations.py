"""The equations of motion, written once for the peers, on components: floats, NumPy or JAX rows.

Reduced: quaternion (body → ground) and ω in the principal axes of the inertia about the pivot.
General: quaternion, place of the centre of mass, ω in body axes, velocity. The joint's force comes
anew in every stage from the saddle point M V̇ + Jᵀλ = f, J V̇ = η, on SO(3)×ℝ³: there J turns with
the body, so no compiler can take its solution out of the loop.
"""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final

J = top.pivot_inertia()
ANGLE = atan2(2 * J[0, 1], J[0, 0] - J[1, 1]) / 2  # the centre has z = 0: a turn about e₃
AXES = np.array([[cos(ANGLE), -sin(ANGLE), 0], [sin(ANGLE), cos(ANGLE), 0], [0, 0, 1]])
J1, J2, J3 = (float(j) for j in np.diag(AXES.T @ J @ AXES))
MASS, G = top.MASS, float(top.GRAVITY[2])
P1, P2, _ = (MASS * G * float(c) for c in AXES.T @ top.CENTRE)
# ω̇ᵢ = EULERᵢ ωⱼ ωₖ + PULLᵢ·(R's third row), from the moments J and P = m g c with P₃ = 0
EULER = ((J2 - J3) / J1, (J3 - J1) / J2, (J1 - J2) / J3)
PULL = (P2 / J1, -P1 / J2, P1 / J3, -P2 / J3)

I1, I2, I3 = (float(i) for i in top.INERTIA)
C = tuple(float(c) for c in top.CENTRE)


def turn_rates(w, x, y, z, p, q, r):
    """Time derivative of the quaternion."""
    p, q, r = 0.5 * p, 0.5 * q, 0.5 * r
    return (
        -x * p - y * q - z * r,
        w * p + y * r - z * q,
        w * q + z * p - x * r,
        w * r + x * q - y * p,
    )


def euler_rates(w, x, y, z, p, q, r):
    """Time derivative of ω about the pivot."""
    up1, up2 = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    up3 = w * w - x * x - y * y + z * z
    return (
        EULER[0] * (q * r) + PULL[0] * up3,
        EULER[1] * (r * p) + PULL[1] * up3,
        EULER[2] * (p * q) + PULL[2] * up2 + PULL[3] * up1,
    )


def reduced_rates(*state):
    return turn_rates(*state) + euler_rates(*state)


def reduced_start(omega0: np.ndarray) -> np.ndarray:
    """(7, n)."""
    state = np.zeros((7, len(omega0)))
    state[0], state[3] = cos(ANGLE / 2), sin(ANGLE / 2)
    state[4:] = (omega0 @ AXES).T
    return state


def reduced_final(state) -> Final:
    state = np.asarray(state)
    rows = np.array(matrix(*state[:4])) / (state[:4] ** 2).sum(axis=0)
    return Final(np.einsum("ijn,j->ni", rows, AXES.T @ top.CENTRE), state[4:].T @ AXES.T)


def matrix(w, x, y, z):
    """Rows of R."""
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    return (
        (ww + xx - yy - zz, 2.0 * (xy - wz), 2.0 * (xz + wy)),
        (2.0 * (xy + wz), ww - xx + yy - zz, 2.0 * (yz - wx)),
        (2.0 * (xz - wy), 2.0 * (yz + wx), ww - xx - yy + zz),
    )


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def general_rates(
    w, x, y, z, rx, ry, rz, p, q, r, vx, vy, vz, keep=lambda multipliers: multipliers
):
    """Schur complement S = J M⁻¹ Jᵀ written out, J = [A | I] with rows of A = R's rows × c.

    keep : marks what a compiler shall compute but once.
    """
    omega = (p, q, r)
    rows = matrix(w, x, y, z)
    a = [cross(row, C) for row in rows]
    b = [(ai[0] * (1 / I1), ai[1] * (1 / I2), ai[2] * (1 / I3)) for ai in a]
    free = ((I2 - I3) / I1 * (q * r), (I3 - I1) / I2 * (r * p), (I1 - I2) / I3 * (p * q))
    centripetal = cross(omega, cross(omega, C))
    e1, e2, e3 = (dot(ai, free) - dot(row, centripetal) for ai, row in zip(a, rows, strict=True))
    e3 = e3 + G
    s11, s22, s33 = (dot(a[i], b[i]) + 1 / MASS for i in range(3))
    s21, s31, s32 = dot(a[1], b[0]), dot(a[2], b[0]), dot(a[2], b[1])
    # cofactors: one division, where an LDLᵀ has five
    f11, f21, f31 = s22 * s33 - s32 * s32, s31 * s32 - s21 * s33, s21 * s32 - s22 * s31
    f22, f32, f33 = s11 * s33 - s31 * s31, s21 * s31 - s11 * s32, s11 * s22 - s21 * s21
    inverse = 1 / (s11 * f11 + s21 * f21 + s31 * f31)
    m1, m2, m3 = keep(
        (
            inverse * (f11 * e1 + f21 * e2 + f31 * e3),
            inverse * (f21 * e1 + f22 * e2 + f32 * e3),
            inverse * (f31 * e1 + f32 * e2 + f33 * e3),
        )
    )
    turn = turn_rates(w, x, y, z, p, q, r)
    alpha = tuple(free[i] - (b[0][i] * m1 + b[1][i] * m2 + b[2][i] * m3) for i in range(3))
    return (*turn, vx, vy, vz, *alpha, m1 * (-1 / MASS), m2 * (-1 / MASS), G - m3 * (1 / MASS))


def general_start(omega0: np.ndarray) -> np.ndarray:
    """(13, n), at R = I."""
    state = np.zeros((13, len(omega0)))
    state[0], state[4:7] = 1, top.CENTRE[:, None]
    state[7:10], state[10:] = omega0.T, np.cross(omega0, top.CENTRE).T
    return state


def general_final(state) -> Final:
    state = np.asarray(state)
    return Final(state[4:7].T, state[7:10].T)


def rk4_step(rates, state, h):
    """One step on a tuple of components; += avoids temporary arrays."""
    k1 = rates(*state)
    k2 = rates(*_axpy(h / 2, k1, state))
    k3 = rates(*_axpy(h / 2, k2, state))
    k4 = rates(*_axpy(h, k3, state))
    for weight, k in ((h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4)):
        state = _axpy(weight, k, state)
    return tuple(state)


def _axpy(s, x, y):
    """s x + y."""
    out = []
    for a, b in zip(x, y, strict=True):
        c = s * a
        c += b
        out.append(c)
    return out


FORMS = {
    "reduced": (reduced_rates, reduced_start, reduced_final),
    "general": (general_rates, general_start, general_final),
}

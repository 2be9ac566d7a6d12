"""Makes reference.npy: the first tops' ω₀, final centre of mass and final ω, to the last digit.

Independent of lierb: Euler's equations about the pivot on unit quaternions, in extended precision,
by Gragg's extrapolation (modified midpoint rule, rational in h²), steps halved until nothing moves.
`python -m peers.reference` from bench/.
"""

from __future__ import annotations

import numpy as np

from peers import heavy_top as top

COUNT = 512
REAL = np.longdouble


def rates(y: np.ndarray) -> np.ndarray:
    """Time derivative of (quaternion w x y z body → ground, ω), each a row of y."""
    w, x, y_, z, p, q, r = y
    inertia = top.pivot_inertia().astype(REAL)
    inverse = _inverse(inertia)
    g = REAL(-9.81)
    # third row of R: the ground's e3 in body axes
    up = (2 * (x * z - w * y_), 2 * (y_ * z + w * x), w * w - x * x - y_ * y_ + z * z)
    force = [REAL(top.MASS) * g * u for u in up]
    c = top.CENTRE.astype(REAL)
    momentum = [inertia[i, 0] * p + inertia[i, 1] * q + inertia[i, 2] * r for i in range(3)]
    torque = _sum(_cross(c, force), _cross(momentum, (p, q, r)))
    omega_rate = [sum(inverse[i, j] * torque[j] for j in range(3)) for i in range(3)]
    half = REAL(0.5)
    return np.array(
        [
            half * (-x * p - y_ * q - z * r),
            half * (w * p + y_ * r - z * q),
            half * (w * q + z * p - x * r),
            half * (w * r + x * q - y_ * p),
            *omega_rate,
        ]
    )


def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _sum(a, b):
    return [x + y for x, y in zip(a, b, strict=True)]


def _inverse(m: np.ndarray) -> np.ndarray:
    """Adjugate over determinant: numpy.linalg has no extended precision."""
    rows = [_cross(m[1], m[2]), _cross(m[2], m[0]), _cross(m[0], m[1])]
    determinant = sum(m[0, i] * rows[0][i] for i in range(3))
    return np.array(rows).T / determinant


def gragg_step(y: np.ndarray, h, orders: int = 10) -> np.ndarray:
    """One step of h by polynomial extrapolation over 2, 4, …, 2·orders substeps."""
    table: list[np.ndarray] = []
    for k in range(1, orders + 1):
        n = 2 * k
        s = h / n
        before, now = y, y + s * rates(y)
        for _ in range(n - 1):
            before, now = now, before + 2 * s * rates(now)
        row = [(now + before + s * rates(now)) / 2]
        for j in range(1, k):
            ratio = (REAL(k) / REAL(k - j)) ** 2
            row.append(row[-1] + (row[-1] - table[j - 1]) / (ratio - 1))
        table = row
    return table[-1]


def solve(omega0: np.ndarray, steps: int) -> np.ndarray:
    """(n, 6): final centre of mass, final ω."""
    y = np.zeros((7, len(omega0)), dtype=REAL)
    y[0] = 1
    y[4:] = omega0.T
    h = REAL(top.T_END) / steps
    for _ in range(steps):
        y = gragg_step(y, h)
        y[:4] /= np.sqrt((y[:4] ** 2).sum(axis=0))
    w, x, y_, z = y[:4]
    c = top.CENTRE.astype(REAL)[:, None] * np.ones_like(w)
    t = _cross((x, y_, z), c)
    u = _cross((x, y_, z), t)
    centre = [c[i] + 2 * (w * t[i] + u[i]) for i in range(3)]
    return np.array([*centre, *y[4:]]).T


if __name__ == "__main__":
    omega0 = top.samples(COUNT)
    coarse, fine = solve(omega0, 60), solve(omega0, 120)
    print("largest change on halving the step:", float(np.abs(fine - coarse).max()))
    np.save(top.REFERENCE, np.hstack([omega0, fine.astype(np.float64)]))

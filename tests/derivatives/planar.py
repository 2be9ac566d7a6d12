"""Planar mechanisms of bars that turn about e₂, in numbers of any kind: complex steps, or floats.

A bar's angle is that of its e₁, e₃ about e₂; points are (x, z) of the bar. Equations of Lagrange
for the double pendulum, and of Newton and Euler with multipliers for the four-bar.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

PLANE = (0, 2)  # of vectors of three numbers


def turned(angle, point) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] + s * point[1], c * point[1] - s * point[0]])


def slope(point) -> np.ndarray:
    """What `turned(angle, ·)` maps to its derivative by the angle."""
    return np.array([point[1], -point[0]])


class Bar(NamedTuple):
    """mass, moment about the origin, com, and points of joints, (x, z), of a bar."""

    mass: Any
    moment: Any
    com: np.ndarray
    first: np.ndarray  # on its parent's `second`, or on the ground
    second: np.ndarray


def about_com(bar: Bar):
    return bar.moment - bar.mass * (bar.com @ bar.com)


def integrated(rate, y, t_end):
    run = solve_ivp(
        lambda t, y: rate(y), (0.0, t_end), y.astype(complex), "DOP853", rtol=1e-13, atol=1e-14
    )
    return run.y[:, -1]


def double_pendulum(upper: Bar, lower: Bar, gravity, spring, angles, rates, t_end):
    """Angles, rates and the lower bar's origin at the end.

    spring : stiffness and damping between the bars, slack where they are aligned.
    """
    a1, d, a2 = upper.com - upper.first, upper.second - upper.first, lower.com - lower.first
    m1, m2 = upper.mass, lower.mass
    I1, I2 = about_com(upper) + m1 * (a1 @ a1), about_com(lower) + m2 * (a2 @ a2)

    def rate(y):
        t1, t2, w1, w2 = y
        arm, end = turned(t1, d), turned(t2, a2)
        arm_slope, end_slope = turned(t1, slope(d)), turned(t2, slope(a2))
        torque = -spring[0] * (t2 - t1) - spring[1] * (w2 - w1)
        matrix = np.array([[I1 + m2 * (d @ d), m2 * (arm @ end)], [m2 * (arm @ end), I2]])
        right = np.array([
            m1 * gravity @ turned(t1, slope(a1)) + m2 * gravity @ arm_slope
            + m2 * (arm_slope @ end) * w2 * w2 - torque,
            m2 * gravity @ end_slope + m2 * (end_slope @ arm) * w1 * w1 + torque,
        ])  # fmt: skip
        return np.array([w1, w2, *np.linalg.solve(matrix, right)])

    y = integrated(rate, np.array([*angles, *rates]), t_end)
    return y[:2], y[2:], turned(y[0], d) - turned(y[1], lower.first)


def four_bar(bars: list[Bar], gravity, drag, angles, places, rates, speeds, t_end):
    """Angles and rates of crank, coupler and rocker at the end.

    The first points of crank and rocker are on the ground, the coupler's on the crank's second; the
    coupler's second is on the rocker's.   drag : N m s, on the rocker.
    places, speeds : of the bars' origins, in ground axes.
    """
    joints = ((0, "first", None, None), (1, "first", 0, "second"), (2, "first", None, None),
              (1, "second", 2, "second"))  # fmt: skip

    def rate(y):
        angle, spin = y[6:9], y[15:18]
        system, right = np.zeros((17, 17), complex), np.zeros(17, complex)
        for i, bar in enumerate(bars):
            # of the origin and the angle: a(com) = ẍ + S a − w² a
            arm, bend = turned(angle[i], slope(bar.com)), turned(angle[i], bar.com)
            system[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = bar.mass * np.eye(2)
            system[2 * i : 2 * i + 2, 6 + i] = system[6 + i, 2 * i : 2 * i + 2] = bar.mass * arm
            system[6 + i, 6 + i] = bar.moment
            right[2 * i : 2 * i + 2] = bar.mass * gravity + bar.mass * bend * spin[i] ** 2
            right[6 + i] = bar.mass * arm @ gravity
        right[8] -= drag * spin[2]
        for k, (i, point, j, other) in enumerate(joints):
            rows = slice(9 + 2 * k, 11 + 2 * k)
            for link, name, sign in ((i, point, 1.0), (j, other, -1.0)):
                if link is not None:
                    own = getattr(bars[link], name)
                    system[rows, 2 * link : 2 * link + 2] = sign * np.eye(2)
                    system[rows, 6 + link] = sign * turned(angle[link], slope(own))
                    right[rows] += sign * turned(angle[link], own) * spin[link] ** 2
        system[:9, 9:] = system[9:, :9].T
        acceleration = np.linalg.solve(system, right)[:9]
        return np.concatenate([y[9:], acceleration])

    y = np.concatenate([np.ravel(places), angles, np.ravel(speeds), rates])
    y = integrated(rate, y, t_end)
    return y[6:9], y[15:18], y[:6].reshape(3, 2)

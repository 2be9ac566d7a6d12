"""Mechanisms that several test files integrate: kernels are compiled once."""

from __future__ import annotations

from functools import cache

import lierb

GRAVITY = (0.0, 0.0, -9.81)
TURNING = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}


@cache
def double_pendulum() -> lierb.Mechanism:
    """Two equal rods on revolute joints."""
    rod = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    lower = lierb.joints.revolute(**TURNING, parent_point=(0.0, 0.0, -0.25))
    return lierb.Mechanism(
        [
            lierb.Link("upper", rod, lierb.joints.revolute(**TURNING)),
            lierb.Link("lower", rod, lower, "upper"),
        ],
        gravity=GRAVITY,
    )

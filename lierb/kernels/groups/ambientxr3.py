"""An ambient update of SO(3)×R³ works with quaternions of any length, as in `ambient`.

Y has eight numbers, so that both groups have the same columns: u − 1, zero, and s/2 of the
displacement s.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups import ambient
from lierb.kernels.groups.quaternion import Chart, product
from lierb.kernels.numbers.vec import Vec, axpy
from lierb.kernels.numbers.zero import ZERO


def rate(y: Vec, v: Vec) -> Vec:
    """Return 2Ẏ = ((1 + Y) ω, ṙ).   v : (ω, ṙ)."""
    return (*product(ambient.turn_of(y), v[:3]), ZERO, *v[3:])


def fall(y: Vec, gravity: Vec) -> Vec:
    """Return gravity in body axes; by a rotation, so that a free body falls exactly."""
    return ambient.rotate_back(y, gravity, ambient.twice_inverse(y))


def place(c: Chart, y: Vec, twice: Any) -> Vec:
    """Return the position of the pose at Y."""
    return axpy(2.0, y[5:], c[1])


def compose(c: Chart, y: Vec) -> Chart:
    """Update of the chart at the end of a step."""
    p, _ = ambient.normalised(c[0], y[:4])
    return p, axpy(2.0, y[5:], c[1])

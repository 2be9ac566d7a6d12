"""Encode arrays of a scene as text: little-endian numbers in base64."""

from __future__ import annotations

import base64

import numpy as np

from lierb.support.arrays import Array

RUNAWAY = 1e30  # m; larger positions are not drawn, since float32 ends at 3e38


def encoded(array: Array, dtype: str = "<f4") -> str:
    """Return an array in single precision, or of another type, in base64."""
    with np.errstate(over="ignore"):  # a diverging body becomes infinite, and is not drawn
        return base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode()

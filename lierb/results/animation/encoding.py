"""Encode arrays of a scene as text: little-endian numbers in base64."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.support.arrays import Array

RUNAWAY = 1e30  # m; larger positions are not drawn, since float32 ends at 3e38


def encoded(array: Array) -> str:
    """Return an array in single precision, in base64."""
    with np.errstate(over="ignore"):  # a diverging body becomes infinite, and is not drawn
        return text_of(np.ascontiguousarray(array, "<f4"))


def text_of(array: NDArray[Any]) -> str:
    """Return the bytes of an array in base64."""
    return base64.b64encode(array.tobytes()).decode()

"""Scalar formulas on lane packs: the way in that `lierb.lie` has no need to offer."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from lierb.compiler.code import OPTIONS
from lierb.compiler.tags import Tag
from lierb.kernels.groups.coefficients import coefficients, half_angle_coefficients
from lierb.kernels.numbers.arithmetic import gather, scatter
from lierb.kernels.numbers.trigonometry import atan2, sincos
from lierb.kernels.numbers.vec import inverse_symmetric, principal_axes
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.kernels.tracing.trace import kernel

FORMULAS = {
    "coefficients": coefficients,
    "half_angle_coefficients": half_angle_coefficients,
    "sincos": sincos,
    "atan2": lambda y, x: (atan2(y, x),),
    "inverse_symmetric": lambda *m: inverse_symmetric(m),
    "principal_axes": lambda *m: sum(principal_axes(m), ()),
}


@dataclass(frozen=True)
class Formula(Tag):
    """FORMULAS[name], `operands` numbers to `results` numbers, on packs of `lanes` rows."""

    name: str
    operands: int
    results: int
    lanes: int


def block(tag: Formula, rows, out, first) -> None:
    operands = [gather(rows, 0, (first, c), tag.lanes) for c in range(tag.operands)]
    numbers = tuple(FORMULAS[tag.name](*operands))
    scatter(out, 0, [(first, c) for c in range(tag.results)], numbers, tag.lanes)


kernel(block)


@njit(**OPTIONS)
def apply(tag, rows, out, lanes):
    for first in range(0, out.shape[0], lanes):
        block(tag, rows, out, first)


def on_lanes(name: str, *columns, results: int, lanes: int = DEFAULT_LANES) -> np.ndarray:
    """FORMULAS[name](*columns) row by row, a pack at a time: one column for each result."""
    rows = np.stack(np.broadcast_arrays(*columns), axis=-1).astype(float)
    out = np.full((len(rows), results), np.nan)
    with np.errstate(all="ignore"):  # NumPy's scalars warn when the JIT is off
        apply(Formula(name, rows.shape[1], results, lanes), rows, out, lanes)
    return np.moveaxis(out, -1, 0)

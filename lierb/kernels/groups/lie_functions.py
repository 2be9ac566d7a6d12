"""Apply Lie-group functions to arrays, row by row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from lierb.compiler.code import cached
from lierb.compiler.tags import Tag
from lierb.kernels.groups import se3, so3, so3xr3
from lierb.kernels.numbers.arithmetic import gather, scatter
from lierb.kernels.tracing.trace import kernel

GROUPS: dict[str, ModuleType] = {"so3": so3, "se3": se3, "so3xr3": so3xr3}

# Operands and result of each function: "g" a group element, "x" a vector of the algebra.
SIGNATURES = {
    "exp": ("x", "g"), "log": ("g", "x"), "inverse": ("g", "g"), "compose": ("gg", "g"),
    "Ad": ("gx", "x"), "ad": ("xx", "x"), "dexp": ("xx", "x"), "dexpinv": ("xx", "x"),
}  # fmt: skip


@dataclass(frozen=True)
class LieFunction(Tag):
    """Tag of the function `name` of a group, on packs of `lanes` rows."""

    group: str
    name: str
    lanes: int

    @property
    def formula(self) -> Callable[..., Any]:
        return getattr(GROUPS[self.group], self.name)


def width(group: str, kind: str) -> int:
    """Return the number of components in a row: a vector, or a 3×3 or 4×4 matrix."""
    if kind == "x":
        return 3 if group == "so3" else 6
    return 9 if group == "so3" else 16


def apply_block(tag: LieFunction, a: Any, b: Any, out: Any, first: Any) -> None:
    kinds, result_kind = SIGNATURES[tag.name]
    operands = []
    for kind, array in zip(kinds, (a, b), strict=False):
        columns = range(width(tag.group, kind))
        row = tuple(gather(array, 0, (first, c), tag.lanes) for c in columns)
        operands.append(_unpacked(tag, kind, row))
    numbers = _packed(tag, result_kind, tag.formula(*operands))
    scatter(out, 0, [(first, c) for c in range(len(numbers))], numbers, tag.lanes)


def _unpacked(tag: LieFunction, kind: str, n: tuple[Any, ...]) -> Any:
    if kind == "x" or tag.group == "so3":
        return n
    return n[0:3] + n[4:7] + n[8:11], (n[3], n[7], n[11])


def _packed(tag: LieFunction, kind: str, result: Any) -> tuple[Any, ...]:
    if kind == "x" or tag.group == "so3":
        return tuple(result)
    r, p = result
    return (*r[0:3], p[0], *r[3:6], p[1], *r[6:9], p[2], 0.0, 0.0, 0.0, 1.0)


for _group in GROUPS.values():
    for _name in SIGNATURES:
        kernel(getattr(_group, _name), numbers_only=True)  # for users' @njit code
kernel(apply_block)


@cached()
def apply(tag, a, b, out, lanes):
    """Evaluate out[i] = f(a[i], b[i]); `b` is not read if f takes one operand."""
    for first in range(0, out.shape[0], lanes):
        apply_block(tag, a, b, out, first)

"""Stabilisation of loops: projection and Baumgarte's terms."""

from __future__ import annotations

from typing import Any

from lierb.kernels.mechanics.tree import TreeConstants
from lierb.kernels.numbers.arithmetic import sqrt
from lierb.kernels.numbers.vec import norm
from lierb.kernels.numbers.zero import ZERO

CLOSED = 1e-14  # rad, and in units of the mechanism's own length: where Newton's method may end
OPEN = 1e-2  # in the same: where two of its steps have not halved what is open, none will


def _length(body: TreeConstants) -> Any:
    """A length of the mechanism's own, m: the largest arm of a link."""
    heavy = next(c for c in body.nodes if c.rigid.mass is not ZERO)
    trace = heavy.inertia[0] + heavy.inertia[4] + heavy.inertia[8]
    total: Any = sqrt(trace / heavy.rigid.mass)
    for constants in body.nodes:
        total = total + norm(constants.com) + norm(constants.hang[1])
    return total

"""What a step makes a new one of."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO


class State(NamedTuple):
    chart: Any  # C₀, with a unit quaternion; of a mechanism, those of its nodes
    x: Vec  # X/2, as quaternions take it; structurally zero in a local update
    v_or_mu: Vec  # V; on a subgroup its momentum μ; of a mechanism all nodes', side by side
    work: Any = ZERO  # J, of what has no potential; structurally zero where nothing does any
    states: Vec = ()  # the user's own, side by side


class Stabilised(NamedTuple):
    """A state put back on its constraints; empty corrections where nothing stabilises it.

    singular : 1 where that fails.   x, v_or_mu : the corrections of the pose, X, and of V.
    """

    state: State
    singular: Any = ZERO
    x: Vec = ()
    v_or_mu: Vec = ()


OK, SINGULAR, NON_FINITE, RAISED, MAX_STEPS, DT_MIN, EVENT = range(7)

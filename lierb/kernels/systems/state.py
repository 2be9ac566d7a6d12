"""A system has a state and rates; a trajectory has a status."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO

Weights = tuple[Any, ...]  # one weight for each stage: floats, or numbers that depend on θ
Factors = tuple[Weights, ...]  # weights of a commutator-free method, one row for each exponential


class State(NamedTuple):
    """A state has pose, velocity, work and extra states.

    n = 6 for a body, 6 for each node of a mechanism.

    chart : C₀, a unit quaternion and a position (m); for a mechanism, a tuple with one per node.
    x : X/2 (n,), rad and m, with the pose C = C₀ exp X; in an ambient update Y within a step, with
        the pose C₀ (1 + Y)/‖1 + Y‖. Structurally zero between steps, except in a global update.
    v_or_mu : V (n,), rad/s and m/s; on a subgroup the momentum μ.
    work : work of all forces without potential, J; structurally zero if there are none.
    states : the user's extra states, concatenated.
    carried : numbers that the method passes on from step to step.
    """

    chart: Any
    x: Vec
    v_or_mu: Vec
    work: Any = ZERO
    states: Vec = ()
    carried: Vec = ()


class Rates(NamedTuple):
    """Hold the time derivatives of a state.

    x : Ẋ (n,), rad/s and m/s, or 2Ẏ.   v_or_mu : V̇ or μ̇ (n,).   power : derivative of the work, W.
    singular : 1 in a singular configuration.   states : derivatives of the extra states.
    """

    x: Vec
    v_or_mu: Vec
    power: Any
    singular: Any = ZERO
    states: Vec = ()


class Slopes(NamedTuple):
    """Rates of the stages of a step; each field has one entry for each stage.

    x : Ẋ or 2Ẏ, or V for a commutator-free method.
    """

    x: tuple[Vec, ...] = ()
    v_or_mu: tuple[Vec, ...] = ()
    work: tuple[Vec, ...] = ()
    states: tuple[Vec, ...] = ()

    def with_stage(self, rates: Rates) -> Slopes:
        """Append the rates of one stage."""
        stage = rates.x, rates.v_or_mu, (rates.power,), rates.states
        return Slopes(*((*slopes, rate) for slopes, rate in zip(self, stage, strict=True)))


class Units(NamedTuple):
    """Hold the factors of the weighted sums of slopes: h for slopes by the second.

    x : factor of Ẋ or 2Ẏ, halved as the state is X/2 or Y.   v_or_mu : of V̇ or μ̇.
    other : of other slopes.
    sums_first : True to multiply the sum of weighted slopes by the factor, which saves products if
        each lane has its own h. Otherwise each weight is multiplied by the factor; with one h for
        all lanes the product is a constant.
    """

    x: Any
    v_or_mu: Any
    other: Any
    sums_first: bool = False


class Stabilised(NamedTuple):
    """A state projected onto its constraints; corrections are empty without stabilisation.

    singular : 1 where projection fails.   x, v_or_mu : corrections of the pose, X, and of V.
    """

    state: State
    singular: Any = ZERO
    x: Vec = ()
    v_or_mu: Vec = ()


OK, SINGULAR, NON_FINITE, RAISED, NO_CONVERGENCE, MAX_STEPS, DT_MIN, EVENT = range(8)

"""Advance a block by a step, of the cheapest kind that its state allows."""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups.coefficients import TINY
from lierb.kernels.loops.record import Record, are_finite, with_all_parts, with_rank, with_turns
from lierb.kernels.numbers.arithmetic import (
    all_lanes,
    assumptions,
    branch,
    maximum,
    plain,
    real,
    where,
)
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.derivatives import on_values
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import NO_CONVERGENCE, NON_FINITE, OK, RAISED, SINGULAR, State
from lierb.kernels.systems.system_of import system_of, takes_small_angle_steps
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.trace import kernel


def begin(plan: AnyPlan, body: Any, state: State, record: Record, time: Any, h: Any) -> State:
    """Return the state with the numbers that the method carries, unless they are known."""
    if not state.carried:
        return state
    at, body = Interval(time, h, h), with_rank(plan, body, record)
    begun = method_of(plan).started(system_of(plan), body, state, at).carried
    pairs = zip(state.carried, begun, strict=True)
    return state._replace(carried=tuple(where(x == x, x, y) for x, y in pairs))


def advance(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """Make step number k, which starts at `time`.

    A trajectory that fails keeps its status and step, and its state is NaN from then on.
    """
    return _advanced(plan, body, state, record, k, time, h, ())


def advance_invariant(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """Make the same step as `advance`, bit for bit, with half the operations of a saddle point.

    It requires `is_invariant`.
    """
    invariant = system_of(plan).invariant
    if not invariant:
        return state, record  # never
    return _advanced(plan, body, state, record, k, time, h, invariant)


def _advanced(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    h: Any,
    invariant: tuple[int, ...],
) -> tuple[State, Record]:
    body = with_rank(plan, body, record)
    made = _stepped(plan, body, state, time, h, invariant)
    record = with_turns(record, made.turns, record.status == OK)
    moved, unsolved = with_all_parts(plan, made.state), made.unsolved
    seen, singular = values(made.state), values(made.singular)
    # One angle that is not finite makes all of Q so.
    turns, places = system_of(plan).turns_and_places(seen.chart)
    numbers = (*turns, *seen.v_or_mu, *seen.x, *places, seen.work)
    fine = are_finite(*numbers) & (singular <= 0.5)
    if not is_zero(unsolved):
        fine = fine & (unsolved <= 0.5)
    if plan.calls_functions:
        fine = fine & (calls.exception_flags(record.status) == calls.CLEAR)

    def failed() -> Any:
        now = where(fine, float(OK), float(NON_FINITE))
        if not is_zero(unsolved):
            now = where(unsolved > 0.5, float(NO_CONVERGENCE), now)
        now = where(singular > 0.5, float(SINGULAR), now)
        alive = record.status == OK
        if plan.calls_functions:
            known = calls.exception_flags(record.status)
            now = where(known > calls.SUPPRESSED, float(RAISED), now)  # its NaN is the singularity
            fails = where(
                (now > 0.0) | (record.status > 0.0), float(calls.SUPPRESSED), float(calls.CLEAR)
            )
            calls.set_exception_flags(maximum(known, fails))
        fresh = (now > 0.0) & alive
        return (
            system_of(plan).silenced(body, moved.v_or_mu, alive),
            where(fresh, now, record.status),
            where(fresh, real(k), record.failed_step),
        )

    v_or_mu, status, failed_step = branch(
        all_lanes(fine), lambda: (moved.v_or_mu, record.status, record.failed_step), failed
    )
    return (
        moved._replace(v_or_mu=v_or_mu),
        record._replace(status=status, failed_step=failed_step),
    )


def _stepped(
    plan: AnyPlan, body: Any, state: State, time: Any, h: Any, invariant: tuple[int, ...]
) -> Step:
    """Make a step with the invariant components of V as structural zeros."""
    before = state.v_or_mu
    moving = tuple(ZERO if i in invariant else v for i, v in enumerate(before))
    state = state._replace(v_or_mu=moving)
    made = method_of(plan).step(system_of(plan), body, state, Interval(time, h, h))
    pairs = zip(before, made.state.v_or_mu, strict=True)
    after = tuple(v if i in invariant else x for i, (v, x) in enumerate(pairs))
    return made._replace(state=made.state._replace(v_or_mu=after))


def has_invariant(plan: AnyPlan, h: Any) -> Any:
    """Return whether the plan's rows keep any component of V at zero."""
    return all_lanes(h == h if system_of(plan).invariant else h < h)


@on_values
def is_invariant(plan: AnyPlan, state: State, h: Any) -> Any:
    """Return whether the components of V that rows keep at zero are zero in all lanes.

    They then remain zero.
    """
    velocity = state.v_or_mu
    invariant = h == h
    for i in system_of(plan).invariant:
        invariant = invariant & (velocity[i] == 0.0)
    return all_lanes(invariant)


@on_values
def has_small_angles(plan: AnyPlan, body: Any, state: State, record: Record, h: Any) -> Any:
    """Return whether the next step's angles are likely to be tiny in all lanes."""
    if not takes_small_angle_steps(plan):
        return all_lanes(h < h)  # never
    small = record.dropped == 0.0
    for square in system_of(plan).angular_speeds_squared(body, state):
        small = small & (h * h * plain(square) <= 0.8 * TINY)
    return all_lanes(small)


def advance_small_angles(
    plan: AnyPlan, body: Any, state: State, time: Any, h: Any
) -> tuple[State, Any]:
    """Make a step without branches. Also return whether it equals that of `advance`.

    It requires `is_invariant`. A branch for each stage's angle would take a twentieth of the time
    of a spherical joint's step.
    """
    if not takes_small_angle_steps(plan):
        return state, all_lanes(h < h)  # never
    with assumptions(h) as conditions:
        made = _stepped(plan, body, state, time, h, system_of(plan).invariant)
    moved, singular = made.state, made.singular
    _, places = system_of(plan).turns_and_places(moved.chart)
    fine = are_finite(*moved.v_or_mu, *places, moved.work) & (singular <= 0.5)
    for condition in conditions:  # false for an angle that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: AnyPlan, body: Any, state: State) -> State:
    return with_all_parts(plan, state._replace(chart=system_of(plan).tidied(body, state.chart)))


for _formula in (
    begin, advance, advance_invariant, has_invariant, is_invariant, has_small_angles,
    advance_small_angles, tidy,
):  # fmt: skip
    kernel(_formula)

"""Advance a system by many steps, the cheapest kind of step that its state allows."""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups.coefficients import TINY
from lierb.kernels.loops.record import NAN, Record, are_finite, with_rank
from lierb.kernels.numbers.arithmetic import (
    all_lanes,
    assumptions,
    branch,
    maximum,
    plain,
    real,
    where,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.stepper import step
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import NON_FINITE, OK, RAISED, SINGULAR, State
from lierb.kernels.systems.system_of import formulation_of, system_of, takes_gentle_steps
from lierb.kernels.tracing import calls


def advance(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """Step number k, from `time` on.

    A body that fails keeps its status and step, and is NaN from then on.
    """
    return _advanced(plan, body, state, record, k, time, h, ())


def advance_still(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """The same, to the same bits, where `is_still`: half of a saddle point's operations."""
    still = formulation_of(plan).still
    if not still:
        return state, record  # never
    return _advanced(plan, body, state, record, k, time, h, still)


def _advanced(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    h: Any,
    still: tuple[int, ...],
) -> tuple[State, Record]:
    body = with_rank(plan, body, record)
    moved, singular = _stepped(plan, body, state, time, h, still)
    # An angle that is not finite spoils all of Q.
    turns, places = system_of(plan).told_by(moved.chart)
    numbers = (*turns, *moved.v_or_mu, *moved.x, *places, moved.work)
    fine = are_finite(*numbers) & (singular <= 0.5)
    if plan.calls_functions:
        fine = fine & (calls.marks(record.status) == calls.CLEAR)

    def marked() -> Any:
        now = where(singular > 0.5, float(SINGULAR), where(fine, float(OK), float(NON_FINITE)))
        alive = record.status == OK
        if plan.calls_functions:
            known = calls.marks(record.status)
            now = where(known > calls.SILENT, float(RAISED), now)  # which NaN has made singular
            fails = where(
                (now > 0.0) | (record.status > 0.0), float(calls.SILENT), float(calls.CLEAR)
            )
            calls.set_marks(maximum(known, fails))
        fresh = (now > 0.0) & alive
        return (
            # NaN from the next step on, and from there into the pose.
            tuple(x if is_zero(x) else where(alive, x, NAN) for x in moved.v_or_mu),
            where(fresh, now, record.status),
            where(fresh, real(k), record.failed_step),
        )

    v_or_mu, status, failed_step = branch(
        all_lanes(fine), lambda: (moved.v_or_mu, record.status, record.failed_step), marked
    )
    return (
        moved._replace(v_or_mu=v_or_mu),
        record._replace(status=status, failed_step=failed_step),
    )


def _stepped(
    plan: AnyPlan, body: Any, state: State, time: Any, h: Any, still: tuple[int, ...]
) -> tuple[State, Any]:
    """A step, with V's components that are `still` as structural zeros."""
    before = state.v_or_mu
    moving = tuple(ZERO if i in still else v for i, v in enumerate(before))
    moved, singular = step(plan, body, state._replace(v_or_mu=moving), time, h)
    pairs = zip(before, moved.v_or_mu, strict=True)
    after = tuple(v if i in still else x for i, (v, x) in enumerate(pairs))
    return moved._replace(v_or_mu=after), singular


def has_still(plan: AnyPlan, h: Any) -> Any:
    """Whether the plan's rows keep anything `still`."""
    return all_lanes(h == h if formulation_of(plan).still else h < h)


def is_still(plan: AnyPlan, state: State, h: Any) -> Any:
    """Whether what the plan's rows keep `still` is so, in all lanes; and so it stays."""
    velocity = state.v_or_mu
    still = h == h
    for i in formulation_of(plan).still:
        still = still & (velocity[i] == 0.0)
    return all_lanes(still)


def is_gentle(plan: AnyPlan, body: Any, state: State, record: Record, h: Any) -> Any:
    """Whether the next step's angles will be tiny in all lanes, as far as one can tell before."""
    if not takes_gentle_steps(plan):
        return all_lanes(h < h)  # never
    gentle = record.dropped == 0.0
    for square in system_of(plan).turning(body, state):
        gentle = gentle & (h * h * plain(square) <= 0.8 * TINY)
    return all_lanes(gentle)


def advance_gently(plan: AnyPlan, body: Any, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """A step without a branch, and whether it is the step that `advance` makes.

    For states that are `still`. A branch for each stage's angle takes a spherical joint's step a
    twentieth of its time.
    """
    if not takes_gentle_steps(plan):
        return state, all_lanes(h < h)  # never
    with assumptions(h) as conditions:
        moved, singular = _stepped(plan, body, state, time, h, formulation_of(plan).still)
    _, places = system_of(plan).told_by(moved.chart)
    fine = are_finite(*moved.v_or_mu, *places, moved.work) & (singular <= 0.5)
    for condition in conditions:  # which no angle meets that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: AnyPlan, body: Any, state: State) -> State:
    return state._replace(chart=formulation_of(plan).tidied(body, state.chart))

"""State of the event search of a thread's lanes, in a step or in a part of one."""

from __future__ import annotations

from typing import Any, NamedTuple

from numba.extending import register_jitable

from lierb.compiler.code import OPTIONS
from lierb.compiler.loops import histories_at, numbers_at
from lierb.kernels.loops import workspace as ws

# A call that LLVM does not inline copies a kilobyte of arrays.
in_watch = register_jitable(**OPTIONS, forceinline=True)
AT_THETA = ws.SAMPLES + 1  # index in `values`, behind all samples


class Search(NamedTuple):
    """Views of a workspace's arrays, θ being the fraction of the step.

    trajectory, selected, accepted : [lane].
    start, length : of the step, s.   theta : θ at which the next state is needed.
    cursor : number of intervals between samples that have been examined for crossings.
    event : index of the event whose root is searched.
    low, high, at_low, at_high : bracket of the root, θ and values.
    last : θ of the first terminal event, 2 for none.
    sides : [event][lane], sign of the value, effective at the start of the step; 0 on zero.
    values : [sample][event][lane]; sample 0 is the start of the step, SAMPLES its end, AT_THETA
        the last evaluation.
    dips, at_dips : [event][lane], θ and value of a local minimum of |value| between two samples;
        θ = 2 for none.
    roundings : [event][lane], effect of rounding on the value at a trajectory's start.
    directions, terminal : [event].
    shown : [column][lane], state.   derivatives : [column][lane]; empty for runs without any.
    rows : [index][column], rows of events; [0][0] is the count.
    """

    lanes: int
    watched: int
    trajectory: Any
    selected: Any
    accepted: Any
    start: Any
    length: Any
    theta: Any
    cursor: Any
    event: Any
    low: Any
    high: Any
    at_low: Any
    at_high: Any
    last: Any
    sides: Any
    values: Any
    dips: Any
    at_dips: Any
    roundings: Any
    directions: Any
    terminal: Any
    shown: Any
    derivatives: Any
    rows: Any


@in_watch
def search_of(job, own, lanes):
    """Return the state of the search in a workspace.   job, own : records of batch, workspace."""
    rows, dips, kinds = numbers_at(own.rows), histories_at(own.dips), numbers_at(job.kinds)
    return Search(
        lanes, own.watched, rows[ws.TRAJECTORY], rows[ws.SELECTED], rows[ws.ACCEPTED],
        rows[ws.START], rows[ws.LENGTH], rows[ws.THETA], rows[ws.CURSOR], rows[ws.EVENT_INDEX],
        rows[ws.LOW], rows[ws.HIGH], rows[ws.AT_LOW], rows[ws.AT_HIGH], rows[ws.LAST],
        numbers_at(own.sides), histories_at(own.values), dips[0], dips[1],
        numbers_at(own.roundings), kinds[0], kinds[1],
        numbers_at(own.shown), numbers_at(own.end_derivatives), numbers_at(own.events),
    )  # fmt: skip


@in_watch
def side_of(value):
    """Return the sign of a value; 0 for NaN."""
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0

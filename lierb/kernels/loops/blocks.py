"""Driver of blocks of L trajectories, from one step number to another.

Input numbers are read from the user's arrays, and results written into the memory of Arrow's
columns (`lierb.kernels.loops.job.JOB`). Between two calls `carried` stores everything of a
trajectory: dividing a run into calls changes no bit. At the end `ends` stores the state, from which
another run can continue, also without changing a bit.
"""

from __future__ import annotations

from lierb.compiler.code import cached
from lierb.compiler.loops import integers_at, numbers_at, part_of_loop
from lierb.kernels.loops.advance import (
    advance,
    advance_invariant,
    advance_small_angles,
    begin,
    has_invariant,
    has_small_angles,
    is_invariant,
    tidy,
)
from lierb.kernels.loops.ends import resumed_record, resumed_state, store_end
from lierb.kernels.loops.job import BODIES, RESUMED, TWISTS, UNSEEN
from lierb.kernels.loops.record import (
    initial_record,
    initial_state,
    load_body,
    load_carried,
    load_given,
    load_placed,
    observe,
    store_carried,
    with_exceptions,
    without_measures,
)
from lierb.kernels.loops.sharing import pack, take_share
from lierb.kernels.loops.states_in_memory import keep_errors
from lierb.kernels.loops.tables import (
    Place,
    store_derivatives,
    store_end_derivatives,
    store_row,
    store_start,
    store_state,
    store_summary,
    tables_at,
)
from lierb.kernels.stepping.clock import StepClock, ahead_of, seen_at, share_of, time_of


@part_of_loop
def _observe(plan, body, inputs, state, record, clock, k, column, tables, rows_per_link):
    """Measure and save a block at step k, if due."""
    measure, save, row = seen_at(clock, k)
    if measure or save:
        time, is_last = time_of(clock, k), k == clock.steps
        shown, seen = observe(plan, body, state, record, k, time, share_of(clock, k))
        if measure:
            keep_errors(plan, body, seen, 1.0)
        record = seen if measure else without_measures(plan, record, seen)
        if save:
            at = Place(row, tables.history.shape[1], column)
            store_row(plan, body, state, record, shown, tables, at, time)
            store_derivatives(plan, body, inputs, state, record, tables, at, time)
            if is_last:  # before the last step, the next step reports a failure
                record = with_exceptions(plan, record, k)
        if is_last or (save and rows_per_link > 1):
            at = Place(rows_per_link - 1 if is_last else row, rows_per_link, column)
            store_state(plan, body, inputs, state, record, tables, at)
    return record


@part_of_loop
def _advance_to(plan, body, state, record, clock, k, end, invariant):
    """Advance a block from step k to step `end`.   invariant : see `is_invariant`."""
    h = clock.dt
    if invariant and has_small_angles(plan, body, state, record, h):
        while k < end:
            moved, fine = advance_small_angles(plan, body, state, time_of(clock, k), h)
            if not fine:
                break
            state = moved
            k += 1
    if invariant and has_invariant(plan, h):
        while k < end:
            time = time_of(clock, k)
            k += 1
            state, record = advance_invariant(plan, body, state, record, k, time, h)
    while k < end:
        time = time_of(clock, k)
        k += 1
        state, record = advance(plan, body, state, record, k, time, h)
    return state, record, k


@cached()
def integrate_blocks(plan, inputs, counter, jobs):
    """Make the steps of one call, block by block, until no share of blocks is left.

    With begin = UNSEEN, starts are checked first. With begin = RESUMED, inputs contain the initial
    states.

    inputs : buffer into which the thread gathers a block's numbers.
    counter : [blocks taken by all threads, error that has ended a thread].
    """
    job, lanes = jobs[0], inputs.shape[1]
    # A copy, because LLVM assumes that stores may change values in memory.
    clock = StepClock(
        job.dt, job.steps, job.measure_every, job.save_every, job.origin, job.first_step
    )
    carried, summary, ends = numbers_at(job.carried), numbers_at(job.summary), numbers_at(job.ends)
    slopes = numbers_at(job.end_derivatives)
    table, memory = integers_at(job.table), numbers_at(job.memory)
    tables, blocks = tables_at(job), (job.stop - job.first + lanes - 1) // lanes
    stop, resumes = job.until, job.begin == RESUMED
    is_new, block, behind = True, 0, 0
    while True:
        if block == behind:
            block, behind = take_share(counter, blocks, job.inputs[1])
            if block >= behind:
                break
        first, k = block * lanes, max(job.begin, 0)
        column, fresh = job.first + first, k == 0
        pack(job, inputs, first, is_new)
        if is_new or job.differ == BODIES:  # numbers shared by all blocks are loaded once
            body = load_body(plan, inputs, table, memory)
        if is_new or job.differ != TWISTS:
            placed = load_placed(plan, body, inputs)
            given = load_given(plan, inputs, time_of(clock, 0))
        is_new = False
        block += 1
        if job.begin == UNSEEN:
            store_start(plan, given, inputs, summary, column, time_of(clock, 0))
        if stop == 0:
            continue
        if k > 0:
            state, record = load_carried(plan, body, carried, first)
        else:
            if resumes:
                state = resumed_state(plan, body, inputs)
            else:
                state = initial_state(plan, body, placed, inputs)
            record = initial_record(plan, body, state)
            if resumes:
                record = resumed_record(plan, body, inputs, record)
            state = begin(plan, body, state, record, time_of(clock, 0), clock.dt)
        invariant = is_invariant(plan, state, clock.dt)
        while True:
            if fresh:
                record = _observe(
                    plan, body, inputs, state, record, clock, k, column, tables, job.rows_per_link
                )
            if k >= stop:
                break
            # After the measurement, which includes the rounding.
            end, tidies = ahead_of(clock, k, stop)
            if tidies and (k > 0 or resumes):
                state = tidy(plan, body, state)
            state, record, k = _advance_to(plan, body, state, record, clock, k, end, invariant)
            fresh = True
        if stop < clock.steps:
            store_carried(plan, body, carried, first, state, record)
        else:
            store_summary(plan, body, record, summary, slopes, slopes.shape[0], column)
            store_end(plan, body, state, record, ends, column)
            store_end_derivatives(
                plan, body, inputs, state, record, slopes, column, time_of(clock, k)
            )

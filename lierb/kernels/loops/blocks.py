"""The compiled driver: blocks of L bodies, in parallel, from one step number to another.

Numbers are read where the user has them, and results written where Arrow's columns will be (`JOB`).
Between two calls everything about a trajectory lives in `carried`: cutting a run into calls changes
no bit. At the end the state itself goes to `ends`, for a run that goes on from there: it changes no
bit either.
"""

from __future__ import annotations

from numba import prange

from lierb.compiler.code import cached
from lierb.compiler.entries import call, raise_again, take_turns
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.kernels.loops.advance import (
    advance,
    advance_gently,
    advance_still,
    has_still,
    is_gentle,
    is_still,
    tidy,
)
from lierb.kernels.loops.job import BODIES, RESUMED, TWISTS, UNSEEN
from lierb.kernels.loops.record import (
    heard,
    initial_record,
    initial_state,
    load_body,
    load_given,
    load_placed,
    load_record,
    load_state,
    observe,
    resumed_record,
    resumed_state,
    store_carried,
    store_end,
    store_forces,
    store_measures,
    store_start,
    store_state,
    store_summary,
    with_rank,
    without_measures,
)
from lierb.kernels.stepping.clock import Clock, ahead_of, seen_at, share_of, time_of
from lierb.kernels.tracing.trace import kernel

SHARES = 8  # in which a thread takes what would be its part, the first of them


# ---- formulas on one block ---------------------------------------------------------------------


for _formula in (
    load_body, load_placed, load_given, initial_state, initial_record, resumed_state,
    resumed_record, load_state, load_record, store_carried, with_rank, advance, advance_still,
    has_still, is_still, is_gentle, advance_gently, tidy, observe, store_measures, store_state,
    store_forces, store_summary, store_start, store_end, heard, without_measures,
):  # fmt: skip
    kernel(_formula)


# ---- the loop over steps and the loop over blocks ------------------------------------------------


@shared
def pack(job, inputs, first, is_new):
    """A block's numbers from where the user has them; past the last trajectory, its own again.

    is_new : whether `inputs` lacks even what all trajectories share.
    """
    places, varying = integers_at(job.places), integers_at(job.varying)
    begin, last = job.first + first, job.stop - job.first - first - 1
    for i in range(inputs.shape[0] if is_new else varying.shape[1]):
        c = i if is_new else varying[0, i]
        stride = places[c, 1]
        address = places[c, 0] + stride * begin
        for lane in range(inputs.shape[1]):
            inputs[c, lane] = number_at(address)
            address += stride if lane < last else 0


@shared
def take_share(counter, count, threads):
    """The first of the next numbers below `count` for a thread, and the one behind the last.

    They become fewer and fewer, so that all threads end together on cores that are not equally
    fast. Neighbours go to one thread: two that write side by side wait for each other, in short
    runs for as long as the work takes.
    """
    size = max((count - counter[0]) // (SHARES * threads), 1)
    first = take_turns(counter, size)
    return first, min(first + size, count)


@cached()
def integrate_blocks(plan, inputs, counter, jobs):
    """A call's steps of block after block, share by share.

    With begin = UNSEEN starts are looked at first. With begin = RESUMED the states to start from
    are among the inputs.

    inputs : where the thread brings a block's numbers together.
    counter : [0, 0], of blocks that some thread has taken; of what has ended one, if anything.
    """
    job, lanes = jobs[0], inputs.shape[1]
    # Apart from the record: what a loop reads from memory might have been written there.
    clock = Clock(job.dt, job.steps, job.measure_every, job.save_every, job.origin, job.first_step)
    carried, summary, ends = numbers_at(job.carried), numbers_at(job.summary), numbers_at(job.ends)
    history, multipliers = histories_at(job.history), histories_at(job.multipliers)
    reactions, saved = histories_at(job.reactions), history.shape[1]
    states = (
        histories_at(job.rotation),
        histories_at(job.position),
        histories_at(job.omega),
        histories_at(job.v),
    )
    last, stop, resumes, h = clock.steps, job.end, job.begin == RESUMED, clock.dt
    blocks = (job.stop - job.first + lanes - 1) // lanes
    is_new, block, behind = True, 0, 0
    while True:
        if block == behind:
            block, behind = take_share(counter, blocks, job.inputs[1])
            if block >= behind:
                break
        first, k = block * lanes, max(job.begin, 0)
        column, fresh = job.first + first, k == 0
        pack(job, inputs, first, is_new)
        if is_new or job.differ == BODIES:  # what all share is found once
            body = load_body(plan, inputs)
        if is_new or job.differ != TWISTS:
            placed = load_placed(plan, body, inputs)
            given = load_given(plan, inputs, time_of(clock, 0))
        is_new = False
        block += 1
        if job.begin == UNSEEN:
            store_start(plan, given, inputs, summary, column, time_of(clock, 0))
        if stop == 0:
            continue
        if resumes:
            state = resumed_state(plan, body, inputs)
        elif k > 0:
            state = load_state(plan, body, carried, first)
        else:
            state = initial_state(plan, body, placed, inputs)
        if k > 0:
            record = load_record(plan, carried, first)
        else:
            record = initial_record(plan, body, state)
        if resumes:
            record = resumed_record(plan, inputs, record)
        still = is_still(plan, state, h)
        while True:
            time = time_of(clock, k)
            measure, save, row = seen_at(clock, k)
            if fresh and (measure or save):
                shown, seen = observe(plan, body, state, record, k, time, share_of(clock, k))
                record = seen if measure else without_measures(plan, record, seen)
                if save:
                    store_measures(plan, record, shown, history, row, column)
                    store_forces(
                        plan, body, state, record, multipliers, reactions, row, saved, column, time
                    )
                    if k == last:  # before, the next step fails
                        record = heard(plan, record, k)
                if k == last or (save and job.rows > 1):
                    row = job.rows - 1 if k == last else row
                    store_state(plan, body, inputs, state, record, states, row, job.rows, column)
            if k >= stop:
                break
            # After the measures: they see what rounding did.
            end, tidies = ahead_of(clock, k, stop)
            if tidies and (k > 0 or resumes):
                state = tidy(plan, body, state)
            if still and is_gentle(plan, body, state, record, h):
                while k < end:
                    moved, fine = advance_gently(plan, body, state, time_of(clock, k), h)
                    if not fine:
                        break
                    state = moved
                    k += 1
            if still and has_still(plan, h):
                while k < end:
                    time = time_of(clock, k)
                    k += 1
                    state, record = advance_still(plan, body, state, record, k, time, h)
            while k < end:
                time = time_of(clock, k)
                k += 1
                state, record = advance(plan, body, state, record, k, time, h)
            fresh = True
        if stop < last:
            store_carried(plan, carried, first, state, record)
        else:
            store_summary(plan, record, summary, column)
            store_end(plan, state, record, ends, column)


@cached(parallel=True)
def integrate_on_threads(integrate, counter, threads, jobs):
    """All blocks by `integrate`, an entry of integrate_blocks: one parallel loop for all plans."""
    for thread in prange(threads):
        inputs = histories_at(jobs[0].inputs)[thread]
        raised = call(integrate, inputs, counter, jobs)
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])

"""The compiled driver of lanes that have a clock each: adaptive steps, output at given times,
events, controllers.

A lane whose trajectory has ended takes the next one at once, so that trajectories of many steps
keep no other lane waiting. One iteration tries a step in every lane; what a lane's trajectory does
depends on its own numbers alone, and so do its bits.

Each thread has a desk: one time of L trajectories, in the same arrays as the results of the batch.
What a lane has to show is written there, by the formulas of `lierb.kernels.loops.blocks`, and
handed over to its place in the results. Between two calls all that the lanes carry lies there, too.
"""

from __future__ import annotations

import numba
from numba import prange

from lierb.compiler.code import OPTIONS, cached
from lierb.compiler.entries import call, raise_again
from lierb.compiler.loops import histories_at, numbers_at
from lierb.kernels.loops.blocks import pack, take_share
from lierb.kernels.loops.event_search import (
    BEGINNING,
    DIPPING,
    ENDING,
    GOING_ON,
    LOOKING,
    NARROWING,
    NOTING,
    NOTING_DIP,
    NOTING_EVENTS,
    SEARCHING,
    SHOWING,
    STARTING,
)
from lierb.kernels.loops.job import BODIES, RESUMED, TWISTS, UNSEEN
from lierb.kernels.loops.lane_steps import (
    any_of,
    as_ended,
    attempted,
    ended_between,
    ends_step,
    fate_now,
    goes_on,
    in_step,
    is_due_between,
    is_to_tidy,
    last_end,
    load_lanes,
    looked,
    looks_now,
    mark_due,
    mark_due_between,
    next_part,
    next_trial,
    own_start,
    parts_of,
    put_part,
    put_roundings,
    put_row,
    put_shown,
    put_values,
    renewed,
    restored,
    row_of,
    shown_between,
    silenced,
    slopes_between,
    sooner,
    started,
    state_between,
    store_lane_end,
    store_lane_summary,
    store_lanes,
    taken,
    ticked,
    tidied,
    time_between,
    to_tick,
    verdict_on,
    with_due,
    with_failures,
)
from lierb.kernels.loops.record import (
    heard,
    load_body,
    load_given,
    load_record,
    load_state,
    resumed_record,
    resumed_state,
    store_carried,
    store_end,
    store_forces,
    store_measures,
    store_start,
    store_summary,
    with_rank,
)
from lierb.kernels.loops.workspace import (
    ACTIVE,
    ANSWER,
    ASKED,
    FATE,
    HANDING_ENDS,
    HANDING_ROW,
    IS_NEW,
    LOOKS,
    MARK,
    TAKING,
    TASK,
    THETA,
    TURN,
    room_of_step,
)
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.extra_states import with_signals


@numba.njit(**OPTIONS, inline="always")  # compiled with its caller alone
def _store_row(plan, body, inputs, state, record, held, shown, desk, own, rows, time):
    """A row of the history on the desk.   rows : of the states, in the results."""
    store_measures(plan, record, shown, histories_at(own.history), 0, 0)
    multipliers, reactions = histories_at(own.multipliers), histories_at(own.reactions)
    store_forces(plan, body, state, record, multipliers, reactions, 0, 1, 0, time)
    if rows > 1:
        put_shown(plan, body, inputs, state, record, held, desk)


@numba.njit(**OPTIONS, inline="always")
def _store_ends(plan, body, inputs, state, record, clock, held, fate, span, desk, own):
    """Of all lanes, those included that go on."""
    record = heard(plan, record, clock.steps)
    put_shown(plan, body, inputs, state, record, held, desk)
    summary = numbers_at(own.summary)
    store_lane_summary(plan, state, held, clock, record, summary, own.own_summary)
    store_summary(plan, as_ended(record, clock, span, fate), summary, 0)
    store_end(plan, state, record, numbers_at(own.ends), 0)
    store_lane_end(plan, clock, held, numbers_at(own.ends))


@numba.njit(**OPTIONS, inline="always")
def _look_at_starts(plan, inputs, counter, job):
    """Whether trajectories start on their joints, block by block."""
    is_new, lanes = True, inputs.shape[1]
    summary, blocks = numbers_at(job.summary), (job.stop + lanes - 1) // lanes
    while True:
        first, end = take_share(counter, blocks, job.inputs[1])
        if first >= end:
            break
        for block in range(first, end):
            pack(job, inputs, block * lanes, is_new)
            if is_new or job.differ != TWISTS:
                given = load_given(plan, inputs, job.start)
            store_start(plan, given, inputs, summary, block * lanes, job.start)
            is_new = False


@cached()
def integrate_lanes(plan, inputs, counter, jobs):
    """Steps in all lanes of a thread, until none has a trajectory, or a call's turns are over.

    inputs : where the thread brings the lanes' numbers together.
    counter : [trajectories taken, what has ended a thread].   jobs : of the batch, of the desk.
    """
    job, own = jobs[0], jobs[1]
    if job.begin == UNSEEN:
        _look_at_starts(plan, inputs, counter, job)
        return
    lanes, turns, desk = inputs.shape[1], job.turns, numbers_at(own.desk)
    span = Span(job.start, job.end, job.origin, job.counted, job.every)
    limits = Tolerances(
        job.dt, job.rtol, job.rotation_atol, job.position_atol, job.omega_atol, job.v_atol,
        job.states_atol, job.dt_min, job.dt_max, job.max_steps, job.position_is_own, job.v_is_own,
    )  # fmt: skip
    carried, events, told = numbers_at(own.carried), numbers_at(own.events), numbers_at(own.told)
    jumps = numbers_at(job.jumps)
    room = events.shape[0] - room_of_step(lanes, own.watched) - 1
    is_new = own.begin == 0
    body = load_body(plan, inputs)
    state, record = load_state(plan, body, carried, 0), load_record(plan, carried, 0)
    clock, held = load_lanes(plan, desk)
    active, fate = row_of(plan, desk, ACTIVE), row_of(plan, desk, FATE)
    while True:
        if any_of(fate):
            if not is_new:
                put_row(plan, desk, FATE, fate)
                _store_ends(plan, body, inputs, state, record, clock, held, fate, span, desk, own)
                told[0, ASKED] = HANDING_ENDS
                call(job.serve, inputs, counter, jobs)
            told[0, ASKED], told[0, IS_NEW] = TAKING, 1.0 if is_new else 0.0
            call(job.serve, inputs, counter, jobs)
            active, fresh = row_of(plan, desk, ACTIVE), row_of(plan, desk, MARK)
            fate = row_of(plan, desk, FATE)
            if told[0, ANSWER] == 0.0:
                break
            if is_new or job.differ == BODIES:
                body = load_body(plan, inputs)
            marks = renewed(plan, fresh)
            if job.begin == RESUMED:
                state = taken(fresh, resumed_state(plan, body, inputs), state)
            else:
                state = taken(fresh, own_start(plan, body, inputs, desk), state)
            begun = started(plan, body, state, desk, span, limits)
            new, first = begun[0], (begun[1], begun[2])
            if job.begin == RESUMED:
                new = resumed_record(plan, inputs, new)
                first = goes_on(plan, begun[1], begun[2], limits, inputs)
            record = taken(fresh, new, record)
            clock, held = taken(fresh, first[0], clock), taken(fresh, first[1], held)
            is_new = False
            if own.watched > 0:
                at_end = own.values + LOOKS * own.watched
                put_values(plan, body, state, held, clock.t, desk, at_end)
                put_roundings(plan, body, state, held, clock.t, desk, at_end)
                told[0, ASKED] = STARTING
                call(job.watch, inputs, counter, jobs)
            restored(plan, marks, fresh)
        else:
            if turns == 0 or events[0, 0] > room:
                break
            turns -= 1
            stop = last_end(clock, span)
            for i in range(jumps.shape[1]):
                stop = sooner(clock, stop, jumps[0, i])
            trial = next_trial(plan, body, state, clock, held, stop, active)
            seen = with_signals(plan, body, state, held)
            ranked = with_rank(plan, seen, record)
            made = attempted(plan, ranked, state, clock, trial, limits)
            accepted, failed, clock = verdict_on(
                plan, body, state, made, clock, trial, limits, active
            )
            if any_of(failed):
                record, fate = with_failures(record, clock, failed, fate)
            moved = made.state
            if own.watched > 0 or is_due_between(plan, clock, accepted):
                marks = silenced(plan, accepted)
                slopes = slopes_between(plan, ranked, state, made, trial)
                part = parts_of(plan, seen, state, moved, trial, accepted)
                begins, task, turn = own.watched > 0, SHOWING, 0
                while True:
                    if task != SHOWING:
                        told[0, ASKED] = GOING_ON
                        call(job.watch, inputs, counter, jobs)
                        task, turn = int(told[0, TASK]), int(told[0, TURN])
                        if task == SHOWING:
                            part = next_part(part, fate)
                            begins = any_of(part.open)
                    if begins:
                        put_part(plan, desk, trial, part)
                        told[0, ASKED], begins = BEGINNING, False
                        call(job.watch, inputs, counter, jobs)
                        task, turn = LOOKING, LOOKS
                    elif task == SHOWING:
                        if not is_due_between(plan, clock, accepted):
                            break
                        mark_due_between(plan, desk, clock, trial, accepted)
                    theta = row_of(plan, desk, THETA)
                    if task != SHOWING:
                        theta = in_step(part, theta)
                    time = time_between(trial, theta)
                    is_end = task == LOOKING and turn == LOOKS
                    if is_end and ends_step(part):
                        there, time = moved, trial.end
                    else:
                        there = state_between(plan, ranked, state, slopes, trial, theta)
                        if is_end:
                            there = taken(part.is_last, moved, there)
                            time = taken(part.is_last, trial.end, time)
                    if task == LOOKING or task == DIPPING or task == SEARCHING:
                        # Of a look its own; of what is searched those behind all looks.
                        look = turn if task == LOOKING else LOOKS + 1
                        row = own.values + look * own.watched
                        put_values(plan, seen, there, held, time, desk, row)
                        if task != LOOKING:
                            told[0, ASKED] = NARROWING if task == SEARCHING else NOTING_DIP
                            call(job.watch, inputs, counter, jobs)
                    elif task == NOTING:
                        put_shown(plan, body, inputs, there, record, held, desk)
                        told[0, ASKED] = NOTING_EVENTS
                        call(job.watch, inputs, counter, jobs)
                    elif task == ENDING:
                        moved, clock, fate = ended_between(
                            plan, desk, there, moved, trial, part, clock, fate
                        )
                    else:
                        due = row_of(plan, desk, MARK)
                        others = silenced(plan, due)
                        at = with_signals(plan, body, there, held)
                        shown, record = shown_between(plan, at, there, held, record, clock)
                        _store_row(
                            plan, at, inputs, there, record, held, shown, desk, own, job.rows,
                            clock.due,
                        )  # fmt: skip
                        restored(plan, others, due)
                        told[0, ASKED] = HANDING_ROW
                        call(job.serve, inputs, counter, jobs)
                        clock = with_due(plan, desk, clock)
                restored(plan, marks, accepted)
            state = taken(accepted, moved, state)
            fresh = taken(failed, failed, accepted)
        ticks = to_tick(plan, body, clock, held, fresh, fate)
        if any_of(ticks):
            record, clock, held = ticked(
                plan, body, state, record, clock, held, ticks, desk, job.seed
            )
        fate = fate_now(clock, span, limits, record, fresh, fate)
        if looks_now(plan, clock, span, fresh, fate):
            seen = with_signals(plan, body, state, held)
            shown, record, clock = looked(plan, seen, state, held, record, clock, span, fresh, fate)
            fate = fate_now(clock, span, limits, record, fresh, fate)
            while mark_due(plan, desk, clock, fresh):  # some may be due within a rounding
                _store_row(
                    plan, seen, inputs, state, record, held, shown, desk, own, job.rows, clock.t
                )
                told[0, ASKED] = HANDING_ROW
                call(job.serve, inputs, counter, jobs)
                clock = with_due(plan, desk, clock)
        if is_to_tidy(clock, fresh, fate):
            state = tidied(plan, body, state, clock, fresh, fate)
    store_carried(plan, carried, 0, state, record)
    store_lanes(plan, desk, clock, held)
    put_row(plan, desk, FATE, fate)
    put_row(plan, desk, ACTIVE, active)


@cached(parallel=True)
def integrate_lanes_on_threads(integrate, counter, threads, jobs):
    """Each thread's lanes by `integrate`, an entry of integrate_lanes.

    jobs : [thread][of the batch, of its desk].
    """
    for thread in prange(threads):
        inputs = histories_at(jobs[thread, 0].inputs)[thread]
        raised = call(integrate, inputs, counter, jobs[thread])
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])

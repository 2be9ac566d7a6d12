"""Driver of lanes with separate clocks: adaptive steps, output times, events, controllers.

A lane whose trajectory ends takes the next one at once: no lane waits for a long trajectory.
One iteration tries a step in every lane. A trajectory depends only on its own numbers, to the bit.

A lane's results are written to the thread's workspace, by the formulas of
`lierb.kernels.loops.record`, and copied from there. Between two calls the workspace also holds the
state of all lanes.
"""

from __future__ import annotations

from lierb.compiler.code import cached
from lierb.compiler.entries import call
from lierb.compiler.loops import histories_at, integers_at, numbers_at, part_of_loop, shared
from lierb.kernels.loops import event_search as search
from lierb.kernels.loops import lane_between as inner
from lierb.kernels.loops import lane_state
from lierb.kernels.loops import lane_steps as steps
from lierb.kernels.loops import workspace as ws
from lierb.kernels.loops.ends import resumed_state, store_end
from lierb.kernels.loops.event_state import AT_THETA
from lierb.kernels.loops.job import BODIES, RESUMED, TWISTS, UNSEEN
from lierb.kernels.loops.lane_samples import take_samples, takes_samples
from lierb.kernels.loops.lane_state import any_of, put_row, row_of, select
from lierb.kernels.loops.record import load_body, load_given, with_exceptions, with_rank
from lierb.kernels.loops.sharing import pack, take_share
from lierb.kernels.loops.states_in_memory import (
    clear_errors,
    copy_next,
    exchange,
    restore_next,
    take_next,
)
from lierb.kernels.loops.tables import (
    Place,
    store_derivatives,
    store_end_derivatives,
    store_row,
    store_start,
    store_summary,
    tables_at,
)
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.extra_states import with_signals


@shared
def _request(entry, kind, inputs, counter, jobs):
    """Call a service."""
    numbers_at(jobs[1].request)[0, ws.KIND] = kind
    call(entry, inputs, counter, jobs)


@part_of_loop
def _check_starts(plan, inputs, counter, job):
    """Check block by block whether trajectories start on their joints."""
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


@part_of_loop
def _store_row(plan, body, inputs, state, lanes, row, own, is_saved, time):
    """Store a row of the history in the workspace.   is_saved : whether states are recorded."""
    at = Place(0, 1, 0)
    store_row(plan, body, state, lanes.record, row, tables_at(own), at, time)
    store_derivatives(plan, body, inputs, state, lanes.record, tables_at(own), at, time)
    if is_saved:
        lane_state.put_shown(plan, body, inputs, state, lanes, numbers_at(own.shown))


@part_of_loop
def _store_ends(plan, body, inputs, lanes, termination, span, own):
    """Store summary and end of all lanes, including those that have not terminated."""
    summary, ends = numbers_at(own.summary), numbers_at(own.ends)
    lanes = inner.with_record(lanes, with_exceptions(plan, lanes.record, lanes.clock.steps))
    lane_state.put_shown(plan, body, inputs, lanes.state, lanes, numbers_at(own.shown))
    lane_state.store_lane_summary(plan, lanes, summary, own.lane_column)
    ended, slopes = lane_state.as_ended(lanes, span, termination), numbers_at(own.end_derivatives)
    store_summary(plan, body, ended, summary, slopes, slopes.shape[0], 0)
    store_end(plan, body, lanes.state, lanes.record, ends, 0)
    lane_state.store_lane_end(plan, body, lanes, ends)
    seen = with_signals(plan, body, lanes.state, lanes.control)
    _store_derivatives(plan, seen, inputs, lanes.state, lanes, own, lanes.clock.t)


@part_of_loop
def _store_derivatives(plan, body, inputs, state, lanes, own, time):
    """Store the derivatives of a state at an event or at the end, in the workspace."""
    array = numbers_at(own.end_derivatives)
    store_end_derivatives(plan, body, inputs, state, lanes.record, array, 0, time)


@part_of_loop
def _start(plan, body, inputs, counter, jobs, lanes, fresh, span, limits):
    """Start the trajectories of fresh lanes."""
    job, own = jobs[0], jobs[1]
    rows, values = numbers_at(own.rows), histories_at(own.values)
    flags = lane_state.clear_exceptions(plan, fresh)
    if job.begin == RESUMED:
        state = select(fresh, resumed_state(plan, body, inputs), lanes.state)
    else:
        state = select(fresh, lane_state.own_start(plan, body, inputs, rows), lanes.state)
    take_next(plan, body, fresh)
    clear_errors(plan, body, fresh)
    begun = lane_state.started(plan, body, state, rows, span, limits)
    if job.begin == RESUMED:
        begun = lane_state.resumed(plan, body, begun, limits, inputs)
    lanes = select(fresh, begun, lanes)
    if own.watched > 0:
        ranked = with_rank(plan, body, lanes.record)
        inner.put_values(
            plan, ranked, lanes.state, lanes.control, lanes.clock.t, values, ws.SAMPLES
        )
        inner.put_roundings(plan, body, lanes, values, ws.SAMPLES, numbers_at(own.roundings))
        _request(job.watch, search.NOTE_STARTS, inputs, counter, jobs)
    lane_state.restore_exceptions(plan, flags, fresh)
    return lanes


@part_of_loop
def _save_between(plan, body, inputs, counter, jobs, lanes, there):
    """Save the rows that are due within a step."""
    job, own = jobs[0], jobs[1]
    rows = numbers_at(own.rows)
    due = row_of(plan, rows, ws.SELECTED)
    flags = lane_state.suppress_exceptions(plan, due)
    at = with_signals(plan, body, there, lanes.control)
    exchange(plan, body)
    row, record = inner.shown_between(plan, at, there, lanes)
    lanes = inner.with_record(lanes, record)
    is_saved = job.rows_per_link > 1
    _store_row(plan, at, inputs, there, lanes, row, own, is_saved, lanes.clock.due)
    exchange(plan, body)
    lane_state.restore_exceptions(plan, flags, due)
    _request(job.serve, ws.COPY_ROW, inputs, counter, jobs)
    return steps.with_due(plan, rows, lanes)


@part_of_loop
def _look_between(
    plan, body, seen, inputs, counter, jobs, lanes, made, trial, accepted, termination
):
    """Search events within a step, and save the rows that are due there.

    Return the state at the end of the step, the lanes and the termination codes.
    """
    job, own = jobs[0], jobs[1]
    rows, request = numbers_at(own.rows), numbers_at(own.request)
    values, state, moved = histories_at(own.values), lanes.state, made.state
    flags = lane_state.suppress_exceptions(plan, accepted)
    ranked = with_rank(plan, seen, lanes.record)
    everywhere = select(accepted, accepted, 1.0)
    copy_next(plan, body, everywhere)
    slopes = inner.slopes_between(plan, ranked, state, made, trial)
    part = inner.parts_of(plan, seen, state, moved, trial, accepted)
    begins, task, turn = own.watched > 0, search.SAVE, 0
    while True:
        if task != search.SAVE:
            _request(job.watch, search.NEXT_TASK, inputs, counter, jobs)
            task, turn = int(request[0, ws.TASK]), int(request[0, ws.TURN])
            if task == search.SAVE:
                part = inner.next_part(part, termination)
                begins = any_of(part.open)
        if begins:
            inner.put_part(plan, rows, trial, part)
            begins = False
            _request(job.watch, search.BEGIN, inputs, counter, jobs)
            task, turn = search.SAMPLE, ws.SAMPLES
        elif task == search.SAVE:
            if not inner.is_due_between(plan, lanes, accepted):
                break
            inner.select_due_between(plan, rows, lanes, trial, accepted)
        theta = row_of(plan, rows, ws.THETA)
        if task != search.SAVE:
            theta = inner.in_step(part, theta)
        time = inner.time_between(trial, theta)
        is_end = task == search.SAMPLE and turn == ws.SAMPLES
        if is_end and inner.ends_step(part):
            there, time = moved, trial.end
            restore_next(plan, body, everywhere)
        else:
            there = inner.state_between(plan, ranked, state, slopes, trial, theta)
            if is_end:
                there = select(part.is_last, moved, there)
                time = select(part.is_last, trial.end, time)
                restore_next(plan, body, part.is_last)
        if task == search.SAMPLE or task == search.DIP or task == search.ROOT:
            sample = turn if task == search.SAMPLE else AT_THETA
            exchange(plan, body)
            inner.put_values(plan, ranked, there, lanes.control, time, values, sample)
            exchange(plan, body)
            if task != search.SAMPLE:
                kind = search.NARROW if task == search.ROOT else search.NOTE_DIP
                _request(job.watch, kind, inputs, counter, jobs)
        elif task == search.NOTE:
            exchange(plan, body)
            lane_state.put_shown(plan, body, inputs, there, lanes, numbers_at(own.shown))
            at_event = with_signals(plan, body, there, lanes.control)
            _store_derivatives(plan, at_event, inputs, there, lanes, own, time)
            exchange(plan, body)
            _request(job.watch, search.NOTE_EVENTS, inputs, counter, jobs)
        elif task == search.END:
            moved, lanes, termination = inner.ended_between(
                plan, rows, there, moved, trial, part, lanes, termination
            )
            copy_next(plan, body, inner.ends_between(plan, rows))
        else:
            lanes = _save_between(plan, body, inputs, counter, jobs, lanes, there)
    if takes_samples(plan, accepted):
        lanes = take_samples(
            plan, seen, ranked, state, made.state, slopes, trial, accepted, lanes, own
        )
    restore_next(plan, body, everywhere)
    lane_state.restore_exceptions(plan, flags, accepted)
    return moved, lanes, termination


@part_of_loop
def _measure(plan, body, inputs, counter, jobs, lanes, span, fresh, termination):
    """Measure the lanes at the end of a step, and save the rows that are due there."""
    job, own = jobs[0], jobs[1]
    rows, is_saved = numbers_at(own.rows), job.rows_per_link > 1
    seen = with_signals(plan, body, lanes.state, lanes.control)
    row, lanes = steps.with_measures(plan, seen, lanes, span, fresh, termination)
    while steps.select_due(plan, rows, lanes, fresh):  # several may be due within a rounding
        _store_row(plan, seen, inputs, lanes.state, lanes, row, own, is_saved, lanes.clock.t)
        _request(job.serve, ws.COPY_ROW, inputs, counter, jobs)
        lanes = steps.with_due(plan, rows, lanes)
    return lanes


@cached()
def integrate_lanes(plan, inputs, counter, jobs):
    """Make steps in all lanes of a thread, until no trajectory is left, or for a call's iterations.

    inputs : buffer into which the thread gathers the lanes' numbers.
    counter : [trajectories taken, error that has ended a thread].
    jobs : records of the batch and of the workspace.
    """
    job, own = jobs[0], jobs[1]
    if job.begin == UNSEEN:
        _check_starts(plan, inputs, counter, job)
        return
    iterations, rows, request = job.until, numbers_at(own.rows), numbers_at(own.request)
    span = Span(job.start, job.end, job.origin, job.counted, job.every)
    limits = Tolerances(
        job.dt, job.rtol, job.rotation_atol, job.position_atol, job.omega_atol, job.v_atol,
        job.states_atol, job.dt_min, job.dt_max, job.max_steps, job.position_is_own, job.v_is_own,
    )  # fmt: skip
    carried, events, jumps = numbers_at(own.carried), numbers_at(own.events), numbers_at(job.jumps)
    step_times = numbers_at(job.step_times)
    room = events.shape[0] - ws.most_events(inputs.shape[1], own.watched) - 1
    is_new = own.begin == 0
    body = load_body(plan, inputs, integers_at(own.table), numbers_at(own.memory))
    lanes = lane_state.load_lanes(plan, body, carried)
    active, termination = row_of(plan, rows, ws.ACTIVE), row_of(plan, rows, ws.TERMINATION)
    while True:
        if any_of(termination):
            if not is_new:
                put_row(plan, rows, ws.TERMINATION, termination)
                _store_ends(plan, body, inputs, lanes, termination, span, own)
                _request(job.serve, ws.COPY_ENDS, inputs, counter, jobs)
            request[0, ws.IS_NEW] = 1.0 if is_new else 0.0
            _request(job.serve, ws.TAKE_NEXT, inputs, counter, jobs)
            active, fresh = row_of(plan, rows, ws.ACTIVE), row_of(plan, rows, ws.SELECTED)
            termination = row_of(plan, rows, ws.TERMINATION)
            if request[0, ws.ANY_ACTIVE] == 0.0:
                break
            if is_new or job.differ == BODIES:
                body = load_body(plan, inputs, integers_at(own.table), numbers_at(own.memory))
            lanes = _start(plan, body, inputs, counter, jobs, lanes, fresh, span, limits)
            is_new = False
        else:
            if iterations == 0 or events[0, 0] > room:
                break
            iterations -= 1
            stop = steps.last_end(lanes, span)
            for i in range(jumps.shape[1]):
                stop = steps.sooner(lanes, stop, jumps[0, i])
            trial = steps.next_trial(plan, body, lanes, stop, active)
            seen = with_signals(plan, body, lanes.state, lanes.control)
            made = steps.attempted(plan, seen, lanes, trial, limits)
            accepted, failed, lanes = steps.decided(plan, body, lanes, made, trial, limits, active)
            if any_of(failed):
                lanes, termination = steps.with_failures(lanes, failed, termination)
            moved = made.state
            looks = own.watched > 0 or takes_samples(plan, accepted)
            if looks or inner.is_due_between(plan, lanes, accepted):
                moved, lanes, termination = _look_between(
                    plan, body, seen, inputs, counter, jobs, lanes, made, trial, accepted,
                    termination,
                )  # fmt: skip
            take_next(plan, body, accepted)
            lanes = steps.moved_to(lanes, moved, accepted)
            if step_times.shape[0] > 0:
                put_row(plan, rows, ws.SELECTED, accepted)
                put_row(plan, rows, ws.STEPS, lanes.clock.steps)
                put_row(plan, rows, ws.ENDED_AT, lanes.clock.t)
                ws.note_steps(rows, step_times)
            fresh = select(failed, failed, accepted)
        ticks = steps.to_tick(plan, body, lanes, fresh, termination)
        if any_of(ticks):
            lanes = steps.ticked(plan, body, lanes, ticks, rows, job.seed)
        termination = steps.termination_now(lanes, span, limits, fresh, termination)
        if steps.measures_now(plan, lanes, span, fresh, termination):
            lanes = _measure(plan, body, inputs, counter, jobs, lanes, span, fresh, termination)
            termination = steps.termination_now(lanes, span, limits, fresh, termination)
        if steps.is_to_tidy(lanes, fresh, termination):
            lanes = steps.tidied(plan, body, lanes, fresh, termination)
    lane_state.store_lanes(plan, body, carried, lanes)
    put_row(plan, rows, ws.TERMINATION, termination)
    put_row(plan, rows, ws.ACTIVE, active)

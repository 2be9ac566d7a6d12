"""Zero crossings of events in a step: bracketed by samples, refined to rounding, and recorded.

The search is a state machine. `lierb.kernels.loops.lanes` evaluates the state at a separate θ for
each lane and calls `watch` for the next task; the search itself works lane by lane.
"""

from __future__ import annotations

from lierb.compiler.code import cached
from lierb.compiler.loops import numbers_at
from lierb.kernels.loops import workspace as ws
from lierb.kernels.loops.event_dips import find_dips, look_deeper, next_dip, note_dip
from lierb.kernels.loops.event_state import AT_THETA, in_watch, search_of, side_of
from lierb.kernels.loops.workspace import SAMPLES
from lierb.kernels.stepping.step_size import EPS

NOTE_STARTS, BEGIN, NEXT_TASK, NARROW, NOTE_DIP, NOTE_EVENTS = range(6)  # requests to `watch`
# Tasks, each at a state between the ends of a step: sample the events at equal distances; evaluate
# them at a dip; refine a root; note a crossing; end the trajectory; save a row of its history.
SAMPLE, DIP, ROOT, NOTE, END, SAVE = range(6)
MOST_ITERATIONS = 120  # of a root search; every third one bisects
# For an event that starts at zero, to rounding: fraction of its range in the first step, and θ up
# to which an event at rest changes by less than that.
AT_ZERO, EARLY = 1e-10, 2.0**-18
AT_END = 64.0 * EPS  # rounding of the time of a root, relative to the times of its step


@cached()
def watch(service, inputs, counter, jobs):
    """Serve a request of the event search; the arguments are those of `integrate_lanes`.

    NEXT_TASK sets TASK and TURN, the task's number.
    """
    job, own = jobs[0], jobs[1]
    request, search = numbers_at(own.request), search_of(job, own, inputs.shape[1])
    kind, turn = request[0, ws.KIND], int(request[0, ws.TURN])
    if kind == NOTE_STARTS:
        note_starts(search)
    elif kind == BEGIN:
        begin_search(search)
        request[0, ws.TASK], request[0, ws.TURN] = SAMPLE, 0.0
        request[0, ws.FIRST_EVENT] = search.rows[0, 0] + 1.0
    elif kind == NEXT_TASK:
        task = int(request[0, ws.TASK])
        starts = job.keeps_sides == 0 and task == SAMPLE and any_starts(search, job.start)
        if starts and turn + 1 == SAMPLES:
            for lane in range(search.lanes):
                search.theta[lane] = EARLY
            turn = AT_THETA
        else:
            if starts and turn > SAMPLES:
                start_at_zero(search, job.start)
            task, turn = next_task(search, request, task, turn)
        request[0, ws.TASK], request[0, ws.TURN] = task, turn
    elif kind == NARROW:
        narrow(search)
    elif kind == NOTE_DIP:
        note_dip(search, turn)
        request[0, ws.TRIES] += 1.0
    else:
        note_events(search)


@in_watch
def note_starts(search):
    """Set the sides of events at the start of the selected trajectories."""
    carry_values(search, search.selected)
    for lane in range(search.lanes):
        if search.selected[lane] > 0.0:
            for event in range(search.watched):
                search.sides[event, lane] = side_of(search.values[0, event, lane])


@in_watch
def any_starts(search, start):
    """Return whether a trajectory has taken its first step."""
    for lane in range(search.lanes):
        if search.accepted[lane] > 0.0 and search.start[lane] == start:
            return True
    return False


@in_watch
def start_at_zero(search, start):
    """Set the sides of events that are zero, to rounding, at the start of a trajectory.

    This is done once the first step has been sampled. Such an event is on neither side until it has
    left zero: a state recorded at a crossing is beyond zero by a rounding, and may bounce. A run
    that is continued without a change keeps its sides, bit for bit.

    An event that rests at zero and then leaves it has turned back within rounding, like a bouncing
    ball whose flights have become too short to be resolved. It is treated as coming from the other
    side, so that a terminal event ends the trajectory there.
    """
    for lane in range(search.lanes):
        if search.accepted[lane] == 0.0 or search.start[lane] != start:
            continue
        share = AT_ZERO + 4.0 * EPS * abs(start) / search.length[lane]
        for event in range(search.watched):
            value = search.values[0, event, lane]
            least, largest = value, value
            for i in range(1, SAMPLES + 1):
                sample = search.values[i, event, lane]
                least, largest = min(least, sample), max(largest, sample)
            rounding = max(share * (largest - least), search.roundings[event, lane])
            if abs(value) <= rounding:
                leaves, direction = side_of(search.values[1, event, lane]), search.directions[event]
                rests = abs(search.values[AT_THETA, event, lane] - value) <= rounding
                ends = search.terminal[event] > 0.0 and (
                    direction == leaves or (direction == 0.0 and leaves < 0.0)
                )
                search.sides[event, lane] = -leaves if rests and ends else 0.0


@in_watch
def begin_search(search):
    """Begin the search in a part of an accepted step; its end is sampled first."""
    for lane in range(search.lanes):
        search.cursor[lane] = 0.0
        search.last[lane] = 2.0
        search.theta[lane] = 1.0


@in_watch
def next_task(search, request, task, turn):
    """Return the next task and its number, and set the θ at which it needs the state."""
    if task == SAMPLE:
        if turn + 1 < SAMPLES:
            for lane in range(search.lanes):
                search.theta[lane] = (turn + 1) / SAMPLES
            return SAMPLE, turn + 1
        find_dips(search)
        task, turn = DIP, -1
    if task == DIP:
        if turn >= 0 and look_deeper(search, turn, request[0, ws.TRIES]):
            return DIP, turn
        request[0, ws.TRIES] = 0.0
        turn = next_dip(search, turn + 1)
        if turn < search.watched:
            return DIP, turn
        task = NOTE  # no crossing so far
    elif task == ROOT:
        if turn + 1 < MOST_ITERATIONS and next_thetas(search, turn + 1):
            return ROOT, turn + 1
        for lane in range(search.lanes):
            search.theta[lane] = search.high[lane] if search.selected[lane] > 0.0 else 0.0
        return NOTE, 0
    if task == NOTE:
        if next_crossings(search):
            next_thetas(search, 0)
            return ROOT, 0
        carry_values(search, search.accepted)
        if drop_later(search, int(request[0, ws.FIRST_EVENT])):
            for lane in range(search.lanes):
                search.theta[lane] = search.last[lane] if search.last[lane] <= 1.0 else 0.0
            return END, 0
    return SAVE, 0


@in_watch
def next_crossings(search):
    """Select the lanes that have a further crossing, and set its event and bracket.

    Return whether there is any. An event crosses zero when it reaches zero from either side: a
    value of exactly zero counts, and after it the event is on neither side. NaN is on no side and
    is no crossing.
    """
    exists, count = False, search.watched
    for lane in range(search.lanes):
        search.selected[lane] = 0.0
        if search.accepted[lane] == 0.0:
            continue
        cursor = int(search.cursor[lane])
        while cursor < 2 * SAMPLES * count and search.selected[lane] == 0.0:
            # From one sample to the next; or to a dip between them, and from the dip to the next.
            half, i, event = cursor % 2, cursor // 2 // count + 1, cursor // 2 % count
            cursor += 1
            low, high = (i - 1) / SAMPLES, i / SAMPLES
            before, value = search.values[i - 1, event, lane], search.values[i, event, lane]
            dip, at_dip = search.dips[event, lane], search.at_dips[event, lane]
            if low < dip < high:
                if half == 0:
                    high, value = dip, at_dip
                else:
                    low, before = dip, at_dip
            elif half == 0:
                continue
            side = search.sides[event, lane]
            if side * value < 0.0 or (side != 0.0 and value == 0.0):
                direction = search.directions[event]
                if direction == 0.0 or direction == -side:
                    exists = True
                    search.selected[lane] = 1.0
                    search.event[lane] = event
                    search.low[lane], search.high[lane] = low, high
                    # A controller's output may have made the value jump.
                    search.at_low[lane] = before if side * before > 0.0 else 0.0
                    search.at_high[lane] = value
                search.sides[event, lane] = side_of(value)
            elif side == 0.0 or value != value:
                search.sides[event, lane] = side_of(value)
        search.cursor[lane] = cursor
    return exists


@in_watch
def next_thetas(search, iteration):
    """Set θ inside each bracket. Return whether any bracket is still open.

    Every third time by bisection, otherwise by the secant, where the value at an end that has not
    moved twice is halved (Illinois).
    """
    any_open = False
    for lane in range(search.lanes):
        low, high = search.low[lane], search.high[lane]
        search.theta[lane] = high if search.selected[lane] > 0.0 else 0.0
        if search.selected[lane] == 0.0:
            continue
        length, latest = search.length[lane], abs(search.start[lane]) + search.length[lane]
        least = max(4.0 * EPS, 2.0 * EPS * latest / length if length > 0.0 else 1.0)
        if high - low <= least:
            continue
        any_open = True
        theta, slope = 0.5 * (low + high), search.at_high[lane] - search.at_low[lane]
        if iteration % 3 != 2 and slope != 0.0:
            secant = high - search.at_high[lane] * (high - low) / slope
            if low < secant < high:
                theta = min(max(secant, low + 0.5 * least), high - 0.5 * least)
        search.theta[lane] = theta
    return any_open


@in_watch
def narrow(search):
    """Narrow each bracket with the event's value at θ."""
    for lane in range(search.lanes):
        theta, low, high = search.theta[lane], search.low[lane], search.high[lane]
        if search.selected[lane] == 0.0 or theta >= high or theta <= low:
            continue
        value = search.values[AT_THETA, int(search.event[lane]), lane]
        if value != value:
            search.selected[lane] = 0.0
            continue
        before, after = search.at_low[lane], search.at_high[lane]
        side = side_of(value)  # no products of values: they may underflow
        beyond = side != side_of(before) if after == 0.0 else side == side_of(after)
        if side == 0.0 or beyond:
            search.high[lane], search.at_high[lane] = theta, value
            search.at_low[lane] = 0.5 * before
        else:
            search.low[lane], search.at_low[lane] = theta, value
            search.at_high[lane] = 0.5 * after


@in_watch
def note_events(search):
    """Append a row for each crossing, with state and derivatives there, from the workspace."""
    rows, behind = search.rows, ws.EVENT_COLUMNS + search.shown.shape[0]
    for lane in range(search.lanes):
        if search.selected[lane] == 0.0:
            continue
        index, event, theta = int(rows[0, 0]) + 1, int(search.event[lane]), search.high[lane]
        rows[0, 0] = index
        rows[index, 0], rows[index, 1] = search.trajectory[lane], event
        rows[index, 2] = search.start[lane] + theta * search.length[lane]
        for c in range(search.shown.shape[0]):
            rows[index, ws.EVENT_COLUMNS + c] = search.shown[c, lane]
        for c in range(search.derivatives.shape[0]):
            rows[index, behind + c] = search.derivatives[c, lane]
        if search.terminal[event] > 0.0:
            search.last[lane] = min(search.last[lane], theta)


@in_watch
def drop_later(search, first):
    """Drop the events of this step after the end of their trajectory.

    Roots are known to rounding: those that are not later by more are at the end.

    Return whether any trajectory ends.   first : index of the first event recorded in this step.
    """
    rows, any_ends = search.rows, False
    for lane in range(search.lanes):
        if search.last[lane] <= 1.0:
            any_ends = True
            end = search.start[lane] + search.last[lane] * search.length[lane]
            rounding = AT_END * (abs(search.start[lane]) + search.length[lane])
            for index in range(first, int(rows[0, 0]) + 1):
                if rows[index, 0] == search.trajectory[lane] and rows[index, 2] > end:
                    if rows[index, 2] - end > rounding:
                        rows[index, 0] = -1.0
                    else:
                        rows[index, 2] = end
    return any_ends


@in_watch
def carry_values(search, mask):
    """Copy the values at the end of a step to the start of the next, where the mask is 1."""
    for lane in range(search.lanes):
        if mask[lane] > 0.0:
            for event in range(search.watched):
                search.values[0, event, lane] = search.values[SAMPLES, event, lane]

"""Crossings of zero by events in a step: looked for, found to rounding, and noted on the desk."""

from __future__ import annotations

import numpy as np

from lierb.compiler.code import cached
from lierb.compiler.loops import numbers_at, shared
from lierb.kernels.loops.job import RESUMED
from lierb.kernels.loops.workspace import (
    AGAIN,
    ASKED,
    AT_HIGH,
    AT_LOW,
    CURSOR,
    EVENT_COLUMNS,
    FIRST,
    HIGH,
    LAST,
    LENGTH,
    LOOKS,
    LOW,
    MARK,
    START,
    TASK,
    THETA,
    TOOK,
    TRAJECTORY,
    TURN,
    WHICH,
)
from lierb.kernels.stepping.step_size import EPS

STARTING, BEGINNING, GOING_ON, NARROWING, NOTING_DIP, NOTING_EVENTS = range(6)  # of `watch`
SEARCHES = 120  # at most; every third one halves
AT_ZERO = 1e-10  # of an event's range in a first step: where it starts at zero, to rounding
EARLY = 2.0**-18  # θ: an event that rests has moved by less than AT_ZERO of its range until there
NEAR = 0.125  # of an event's range in a step: how near to zero it must come to be looked at there
FLAT = 0.05  # of that range, in a quarter: a slope that may be zero; and of a quarter, near a look
DEEPER = 0.25  # of a dip's value: by how much less a parabola must say that it is, to look again
TRUSTED, LOOKED = 8, 30  # looks at one dip: after which a parabola is trusted, and at most
# What the state between a step's ends is asked for: events' values, to look for crossings, first at
# equal distances, then where an event seems to come nearest to zero and to go back; and to find
# one; a crossing, to note it; the end of a trajectory; a row of its history.
LOOKING, DIPPING, SEARCHING, NOTING, ENDING, SHOWING = range(6)


@cached()
def watch(service, inputs, counter, jobs):
    """Serve the requests of event search, as `lierb.kernels.loops.workspace.serve` does.

    GOING_ON has the next request and its turn.
    """
    job, own = jobs[0], jobs[1]
    desk, told, lanes = numbers_at(own.desk), numbers_at(own.told), inputs.shape[1]
    kinds, events = numbers_at(job.kinds), numbers_at(own.events)
    asked, turn = told[0, ASKED], int(told[0, TURN])
    if asked == STARTING:
        note_starts(desk, own, lanes)
    elif asked == BEGINNING:
        begin_looks(desk, lanes)
        told[0, TASK], told[0, TURN], told[0, FIRST] = LOOKING, 0.0, events[0, 0] + 1.0
    elif asked == GOING_ON:
        first, task = int(told[0, FIRST]), int(told[0, TASK])
        starts = job.begin != RESUMED and task == LOOKING and any_starts(desk, job.start, lanes)
        if starts and turn + 1 == LOOKS:
            for lane in range(lanes):
                desk[THETA, lane] = EARLY
            turn = LOOKS + 1
        else:
            if starts and turn > LOOKS:
                start_at_zero(desk, own, kinds, job.start, lanes)
            task, turn = next_task(desk, own, kinds, events, told, first, task, turn, lanes)
        told[0, TASK], told[0, TURN] = task, turn
    elif asked == NARROWING:
        narrow(desk, own, lanes)
    elif asked == NOTING_DIP:
        note_dip(desk, own, turn, lanes)
        told[0, AGAIN] += 1.0
    else:
        note_events(desk, own, events, kinds, lanes)


@shared
def side_of(value):
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0


@shared
def searched_of(own):
    """The first row of the values that are searched for; see `desk_of`."""
    return own.values + (LOOKS + 1) * own.watched


@shared
def dips_of(own):
    """The first row of the dips: θ of each event's, then their values."""
    return searched_of(own) + own.watched


@shared
def roundings_of(own):
    """The first row of what rounding makes of events' values at their starts."""
    return dips_of(own) + 2 * own.watched


@shared
def note_starts(desk, own, lanes):
    """Of trajectories that have just started: on which side of zero each event is; 0 on it."""
    go_on(desk, own, MARK, lanes)
    for lane in range(lanes):
        if desk[MARK, lane] > 0.0:
            for event in range(own.watched):
                desk[own.sides + event, lane] = side_of(desk[own.values + event, lane])


@shared
def any_starts(desk, start, lanes):
    """Whether a trajectory has taken its first step."""
    for lane in range(lanes):
        if desk[TOOK, lane] > 0.0 and desk[START, lane] == start:
            return True
    return False


@shared
def start_at_zero(desk, own, kinds, start, lanes):
    """Set the sides of events that are zero, to rounding, at the start of a trajectory, after the
    looks at its first step. Such an event is on neither side until it has left zero: what has
    crossed is beyond zero by a rounding, and may bounce. A run that goes on as it was knows its
    sides to the bit.

    An event that rests at zero and then leaves it has turned back within rounding, as a ball does
    whose flights have become too short to be seen. It counts as coming from the other side, so
    that a terminal event ends the trajectory there.
    """
    searched, roundings = searched_of(own), roundings_of(own)
    for lane in range(lanes):
        if desk[TOOK, lane] == 0.0 or desk[START, lane] != start:
            continue
        share = AT_ZERO + 4.0 * EPS * abs(start) / desk[LENGTH, lane]
        for event in range(own.watched):
            value = desk[own.values + event, lane]
            least, largest = value, value
            for look in range(LOOKS):
                at_look = desk[own.values + (look + 1) * own.watched + event, lane]
                least, largest = min(least, at_look), max(largest, at_look)
            rounding = max(share * (largest - least), desk[roundings + event, lane])
            if abs(value) <= rounding:
                leaves = side_of(desk[own.values + own.watched + event, lane])
                rests = abs(desk[searched + event, lane] - value) <= rounding
                ends = kinds[1, event] > 0.0 and (
                    kinds[0, event] == leaves or (kinds[0, event] == 0.0 and leaves < 0.0)
                )
                desk[own.sides + event, lane] = -leaves if rests and ends else 0.0


@shared
def begin_looks(desk, lanes):
    """Before crossings are looked for in a part of an accepted step; its end is looked at first."""
    for lane in range(lanes):
        desk[CURSOR, lane] = 0.0
        desk[LAST, lane] = 2.0
        desk[THETA, lane] = 1.0


@shared
def next_task(desk, own, kinds, events, told, first, task, turn, lanes):
    """What is to be done next at a state between, and THETA, where that is; and the task's turn.

    first : place of the first event that is noted in this step.
    """
    if task == LOOKING:
        if turn + 1 < LOOKS:
            for lane in range(lanes):
                desk[THETA, lane] = (turn + 1) / LOOKS
            return LOOKING, turn + 1
        find_dips(desk, own, lanes)
        task, turn = DIPPING, -1
    if task == DIPPING:
        if turn >= 0 and look_deeper(desk, own, turn, told[0, AGAIN], lanes):
            return DIPPING, turn
        told[0, AGAIN] = 0.0
        turn = next_dip(desk, own, turn + 1, lanes)
        if turn < own.watched:
            return DIPPING, turn
        task = NOTING  # of nothing so far
    elif task == SEARCHING:
        if turn + 1 < SEARCHES and next_thetas(desk, lanes, turn + 1):
            return SEARCHING, turn + 1
        for lane in range(lanes):
            desk[THETA, lane] = desk[HIGH, lane] if desk[MARK, lane] > 0.0 else 0.0
        return NOTING, 0
    if task == NOTING:
        if next_crossings(desk, own, kinds, lanes):
            next_thetas(desk, lanes, 0)
            return SEARCHING, 0
        go_on(desk, own, TOOK, lanes)
        if drop_later(desk, events, first, lanes):
            for lane in range(lanes):
                desk[THETA, lane] = desk[LAST, lane] if desk[LAST, lane] <= 1.0 else 0.0
            return ENDING, 0
    return SHOWING, 0


@shared
def find_dips(desk, own, lanes):
    """Of each event the θ at which it seems to come nearest to zero and to go back, between two
    looks of one sign: the least of the cubic by values and slopes there, which are those of the
    quartic through all looks. 2 where there is none.
    """
    count, dips = own.watched, dips_of(own)
    for lane in range(lanes):
        for event in range(count):
            desk[dips + event, lane] = 2.0
            if desk[TOOK, lane] > 0.0:
                side = desk[own.sides + event, lane]
                starts = side == 0.0 or side != side_of(desk[own.values + event, lane])
                desk[dips + event, lane] = dip_of(desk, own.values + event, count, lane, starts)


@shared
def dip_of(desk, first, every, lane, starts):
    """starts : whether the event is zero at the step's start, to rounding: it may leave zero on one
    side and be on the other one at the first look.
    """
    a, b, c = desk[first, lane], desk[first + every, lane], desk[first + 2 * every, lane]
    d, e = desk[first + 3 * every, lane], desk[first + 4 * every, lane]
    values = (a, b, c, d, e)
    slopes = (  # of the quartic, by θ / 4
        (-25.0 * a + 48.0 * b - 36.0 * c + 16.0 * d - 3.0 * e) / 12.0,
        (-3.0 * a - 10.0 * b + 18.0 * c - 6.0 * d + e) / 12.0,
        (a - 8.0 * b + 8.0 * d - e) / 12.0,
        (3.0 * e + 10.0 * d - 18.0 * c + 6.0 * b - a) / 12.0,
        (25.0 * e - 48.0 * d + 36.0 * c - 16.0 * b + 3.0 * a) / 12.0,
    )
    extent = max(values) - min(values)
    found, nearest = 2.0, NEAR * extent
    for look in range(LOOKS):
        side = side_of(values[1 if starts and look == 0 else look])
        low, high = side * values[look], side * values[look + 1]
        falls, rises = side * slopes[look], side * slopes[look + 1]
        # A slope is known but roughly: where it is small, least may be on either side of a look.
        if high > 0.0 and falls < FLAT * extent and rises > -FLAT * extent:
            share, least = (0.0, low) if low < high else (1.0, high)
            if falls < 0.0 and rises > 0.0:
                bend = 3.0 * (low - high) + falls + rises
                root = np.sqrt(bend * bend - falls * rises)
                share = 1.0 - (rises + root - bend) / (rises - falls + 2.0 * root)
                least = low + share * (falls + share * (share * (falls + rises + 2.0 * (low - high))
                        + 3.0 * (high - low) - 2.0 * falls - rises))  # fmt: skip
            if least < nearest:
                found, nearest = (look + min(max(share, FLAT), 1.0 - FLAT)) / LOOKS, least
    return found


@shared
def next_dip(desk, own, event, lanes):
    """The next event, from this one on, that dips somewhere, and THETA; the count of events if none
    does. MARK says in which lanes, LOW, HIGH, AT_LOW and AT_HIGH between which looks.
    """
    count, dips = own.watched, dips_of(own)
    while event < count:
        found = False
        for lane in range(lanes):
            theta = desk[dips + event, lane]
            desk[MARK, lane], desk[THETA, lane] = 0.0, 0.0
            if theta < 1.0:
                low = int(theta * LOOKS)
                high = low + 1
                found, desk[MARK, lane], desk[THETA, lane] = True, 1.0, theta
                desk[LOW, lane], desk[HIGH, lane] = low / LOOKS, high / LOOKS
                desk[AT_LOW, lane] = desk[own.values + low * count + event, lane]
                desk[AT_HIGH, lane] = desk[own.values + high * count + event, lane]
        if found:
            break
        event += 1
    return event


@shared
def note_dip(desk, own, event, lanes):
    """Of this event, its value at THETA: at the dip, or where it may be deeper."""
    searched, dip = searched_of(own) + event, dips_of(own) + event
    at_dip = dip + own.watched
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        theta, value, best = desk[THETA, lane], desk[searched, lane], desk[dip, lane]
        side = side_of(desk[AT_HIGH, lane])
        if theta == best:
            desk[at_dip, lane] = value
            shift(desk, own, event, lane, side)
            continue
        beside, at_beside = theta, value
        if side * value < side * desk[at_dip, lane]:
            beside, at_beside = best, desk[at_dip, lane]
            desk[dip, lane], desk[at_dip, lane] = theta, value
        if beside < desk[dip, lane]:
            desk[LOW, lane], desk[AT_LOW, lane] = beside, at_beside
        else:
            desk[HIGH, lane], desk[AT_HIGH, lane] = beside, at_beside


@shared
def shift(desk, own, event, lane, side):
    """Have the look beside a dip that is deeper for the dip, between the dip and the next look."""
    dip, values = dips_of(own) + event, own.values + event
    low, high = int(desk[LOW, lane] * LOOKS), int(desk[HIGH, lane] * LOOKS)
    theta, value = desk[dip, lane], desk[dip + own.watched, lane]
    if side * desk[AT_HIGH, lane] < side * value and high < LOOKS:
        desk[dip, lane], desk[dip + own.watched, lane] = desk[HIGH, lane], desk[AT_HIGH, lane]
        desk[LOW, lane], desk[AT_LOW, lane] = theta, value
        desk[HIGH, lane] = (high + 1) / LOOKS
        desk[AT_HIGH, lane] = desk[values + (high + 1) * own.watched, lane]
    elif side * desk[AT_LOW, lane] < side * value and low > 0:
        desk[dip, lane], desk[dip + own.watched, lane] = desk[LOW, lane], desk[AT_LOW, lane]
        desk[HIGH, lane], desk[AT_HIGH, lane] = theta, value
        desk[LOW, lane] = (low - 1) / LOOKS
        desk[AT_LOW, lane] = desk[values + (low - 1) * own.watched, lane]


@shared
def look_deeper(desk, own, event, looked, lanes):
    """THETA where the parabola through a dip and what is known beside it is least, as long as it
    says, once it is to be trusted, that zero may be reached there. Whether any does.
    """
    dip, again = dips_of(own) + event, False
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        side, theta = side_of(desk[AT_HIGH, lane]), desk[dip, lane]
        value = side * desk[dip + own.watched, lane]
        before, after = desk[LOW, lane] - theta, desk[HIGH, lane] - theta
        falls = (side * desk[AT_LOW, lane] - value) / before
        rises = (side * desk[AT_HIGH, lane] - value) / after
        bend = (rises - falls) / (after - before)
        slope = falls - bend * before
        desk[MARK, lane], desk[THETA, lane] = 0.0, 0.0
        deep = slope * slope > 4.0 * DEEPER * bend * value or looked < TRUSTED
        if value > 0.0 and bend > 0.0 and deep and looked < LOOKED:
            least = theta - 0.5 * slope / bend
            if looked % 3.0 == 2.0:  # or one side stays as it is
                least = theta + 0.5 * (before if -before > after else after)
            if desk[LOW, lane] < least < desk[HIGH, lane] and least != theta:
                again, desk[MARK, lane], desk[THETA, lane] = True, 1.0, least
    return again


@shared
def next_crossings(desk, own, kinds, lanes):
    """The next crossing in each lane, as MARK, WHICH, LOW, HIGH, AT_LOW and AT_HIGH; whether there
    is any. Zero is crossed where it is reached from either side: a value of exactly zero counts,
    and from there on neither side is the one that was left. NaN is on no side, and crosses nothing.
    """
    found, count, dips = False, own.watched, dips_of(own)
    for lane in range(lanes):
        desk[MARK, lane] = 0.0
        if desk[TOOK, lane] == 0.0:
            continue
        cursor = int(desk[CURSOR, lane])
        while cursor < 2 * LOOKS * count and desk[MARK, lane] == 0.0:
            # From one look to the next; or to a dip between them, and from there on.
            half, look, event = cursor % 2, cursor // 2 // count + 1, cursor // 2 % count
            cursor += 1
            low, high = (look - 1) / LOOKS, look / LOOKS
            before = desk[own.values + (look - 1) * count + event, lane]
            value = desk[own.values + look * count + event, lane]
            dip, at_dip = desk[dips + event, lane], desk[dips + count + event, lane]
            if low < dip < high:
                if half == 0:
                    high, value = dip, at_dip
                else:
                    low, before = dip, at_dip
            elif half == 0:
                continue
            side = desk[own.sides + event, lane]
            if side * value < 0.0 or (side != 0.0 and value == 0.0):
                direction = kinds[0, event]
                if direction == 0.0 or direction == -side:
                    found = True
                    desk[MARK, lane] = 1.0
                    desk[WHICH, lane] = event
                    desk[LOW, lane], desk[HIGH, lane] = low, high
                    # What is held may have made it jump.
                    desk[AT_LOW, lane] = before if side * before > 0.0 else 0.0
                    desk[AT_HIGH, lane] = value
                desk[own.sides + event, lane] = side_of(value)
            elif side == 0.0 or value != value:
                desk[own.sides + event, lane] = side_of(value)
        desk[CURSOR, lane] = cursor
    return found


@shared
def next_thetas(desk, lanes, search):
    """Where the crossings are looked for next, between both ends: by the secant, each end's value
    halved once it has stayed twice (Illinois), and by halves every third time. Whether any is.
    """
    busy = False
    for lane in range(lanes):
        low, high = desk[LOW, lane], desk[HIGH, lane]
        desk[THETA, lane] = high if desk[MARK, lane] > 0.0 else 0.0
        if desk[MARK, lane] == 0.0:
            continue
        length, at = desk[LENGTH, lane], abs(desk[START, lane]) + desk[LENGTH, lane]
        least = max(4.0 * EPS, 2.0 * EPS * at / length if length > 0.0 else 1.0)
        if high - low <= least:
            continue
        busy = True
        theta, slope = 0.5 * (low + high), desk[AT_HIGH, lane] - desk[AT_LOW, lane]
        if search % 3 != 2 and slope != 0.0:
            secant = high - desk[AT_HIGH, lane] * (high - low) / slope
            if low < secant < high:
                theta = min(max(secant, low + 0.5 * least), high - 0.5 * least)
        desk[THETA, lane] = theta
    return busy


@shared
def narrow(desk, own, lanes):
    """With the events' values at THETA."""
    searched = searched_of(own)
    for lane in range(lanes):
        theta = desk[THETA, lane]
        if desk[MARK, lane] == 0.0 or theta >= desk[HIGH, lane] or theta <= desk[LOW, lane]:
            continue
        value = desk[searched + int(desk[WHICH, lane]), lane]
        if value != value:
            desk[MARK, lane] = 0.0
            continue
        before, after = desk[AT_LOW, lane], desk[AT_HIGH, lane]
        side = side_of(value)  # no products of values: they may be too small for one
        beyond = side != side_of(before) if after == 0.0 else side == side_of(after)
        is_after = side == 0.0 or beyond
        if is_after:
            desk[HIGH, lane], desk[AT_HIGH, lane] = theta, value
            desk[AT_LOW, lane] = 0.5 * before
        else:
            desk[LOW, lane], desk[AT_LOW, lane] = theta, value
            desk[AT_HIGH, lane] = 0.5 * after


@shared
def note_events(desk, own, events, kinds, lanes):
    """One row for each crossing that has been found, with the state there, which is on the desk."""
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        place, event, theta = int(events[0, 0]) + 1, int(desk[WHICH, lane]), desk[HIGH, lane]
        events[0, 0] = place
        events[place, 0], events[place, 1] = desk[TRAJECTORY, lane], event
        events[place, 2] = desk[START, lane] + theta * desk[LENGTH, lane]
        for c in range(events.shape[1] - EVENT_COLUMNS):
            events[place, EVENT_COLUMNS + c] = desk[own.shown + c, lane]
        if kinds[1, event] > 0.0:
            desk[LAST, lane] = min(desk[LAST, lane], theta)


@shared
def drop_later(desk, events, first, lanes):
    """Have nothing known of events of this step, from place `first` on, that come after their
    trajectory's end. Whether any ends.
    """
    ends = False
    for lane in range(lanes):
        if desk[LAST, lane] <= 1.0:
            ends = True
            last = desk[START, lane] + desk[LAST, lane] * desk[LENGTH, lane]
            for place in range(first, int(events[0, 0]) + 1):
                if events[place, 0] == desk[TRAJECTORY, lane] and events[place, 2] > last:
                    events[place, 0] = -1.0
    return ends


@shared
def go_on(desk, own, where, lanes):
    """The values at the end of a step are those at the start of the next, where a row says so."""
    for lane in range(lanes):
        if desk[where, lane] > 0.0:
            for event in range(own.watched):
                last = desk[own.values + LOOKS * own.watched + event, lane]
                desk[own.values + event, lane] = last

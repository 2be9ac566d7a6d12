"""Dips of events in a step: local minima of |value| between two samples of one sign.

If an event crosses zero and returns between two samples, no sample shows it. A dip is estimated by
the quartic through all samples, and refined by parabolas as long as it may reach zero.
"""

from __future__ import annotations

import numpy as np

from lierb.kernels.loops.event_state import AT_THETA, in_watch, side_of
from lierb.kernels.loops.workspace import SAMPLES

# Fractions of an event's range in a step: the largest |value| of a dip that is examined, and a
# slope, per quarter of the step, that may be zero. FLAT is also the least distance of a dip from a
# sample, in quarters.
NEAR, FLAT = 0.125, 0.05
DEEPER = 0.25  # fraction of a dip's value by which a parabola must be lower for another try
TRUSTED, MOST_TRIES = 8, 30  # tries at one dip: before a parabola is trusted, and in total


@in_watch
def find_dips(search):
    """Find each event's dip that is nearest to zero; see `dip_of`."""
    for lane in range(search.lanes):
        for event in range(search.watched):
            search.dips[event, lane] = 2.0
            if search.accepted[lane] > 0.0:
                side = search.sides[event, lane]
                starts = side == 0.0 or side != side_of(search.values[0, event, lane])
                search.dips[event, lane] = dip_of(search.values, event, lane, starts)


@in_watch
def dip_of(values, event, lane, starts):
    """Return θ of the deepest dip, the minimum of a cubic between two samples; 2 for none.

    The cubic has the values and slopes, at both samples, of the quartic through all samples.

    starts : True if the event is zero, to rounding, at the start of the step. It may then leave
        zero on one side and be on the other side at the first sample.
    """
    a, b, c = values[0, event, lane], values[1, event, lane], values[2, event, lane]
    d, e = values[3, event, lane], values[4, event, lane]
    samples = (a, b, c, d, e)
    slopes = (  # of the quartic, with respect to θ / 4
        (-25.0 * a + 48.0 * b - 36.0 * c + 16.0 * d - 3.0 * e) / 12.0,
        (-3.0 * a - 10.0 * b + 18.0 * c - 6.0 * d + e) / 12.0,
        (a - 8.0 * b + 8.0 * d - e) / 12.0,
        (3.0 * e + 10.0 * d - 18.0 * c + 6.0 * b - a) / 12.0,
        (25.0 * e - 48.0 * d + 36.0 * c - 16.0 * b + 3.0 * a) / 12.0,
    )
    extent = max(samples) - min(samples)
    theta, nearest = 2.0, NEAR * extent
    for i in range(SAMPLES):
        side = side_of(samples[1 if starts and i == 0 else i])
        low, high = side * samples[i], side * samples[i + 1]
        falls, rises = side * slopes[i], side * slopes[i + 1]
        # Slopes are estimates: if one is small, the minimum may be on either side of a sample.
        if high > 0.0 and falls < FLAT * extent and rises > -FLAT * extent:
            share, least = (0.0, low) if low < high else (1.0, high)
            if falls < 0.0 and rises > 0.0:
                bend = 3.0 * (low - high) + falls + rises
                root = np.sqrt(bend * bend - falls * rises)
                share = 1.0 - (rises + root - bend) / (rises - falls + 2.0 * root)
                least = low + share * (falls + share * (share * (falls + rises + 2.0 * (low - high))
                        + 3.0 * (high - low) - 2.0 * falls - rises))  # fmt: skip
            if least < nearest:
                theta, nearest = (i + min(max(share, FLAT), 1.0 - FLAT)) / SAMPLES, least
    return theta


@in_watch
def next_dip(search, event):
    """Return the first event, from `event` on, that has a dip in any lane, or the number of events.

    Set θ, the selected lanes, and the bracket, to the samples around the dip.
    """
    while event < search.watched:
        exists = False
        for lane in range(search.lanes):
            theta = search.dips[event, lane]
            search.selected[lane], search.theta[lane] = 0.0, 0.0
            if theta < 1.0:
                low = int(theta * SAMPLES)
                high = low + 1
                exists, search.selected[lane], search.theta[lane] = True, 1.0, theta
                search.low[lane], search.high[lane] = low / SAMPLES, high / SAMPLES
                search.at_low[lane] = search.values[low, event, lane]
                search.at_high[lane] = search.values[high, event, lane]
        if exists:
            break
        event += 1
    return event


@in_watch
def note_dip(search, event):
    """Update an event's dip and bracket with its value at θ."""
    for lane in range(search.lanes):
        if search.selected[lane] == 0.0:
            continue
        theta, value = search.theta[lane], search.values[AT_THETA, event, lane]
        best, side = search.dips[event, lane], side_of(search.at_high[lane])
        if theta == best:
            search.at_dips[event, lane] = value
            shift(search, event, lane, side)
            continue
        beside, at_beside = theta, value
        if side * value < side * search.at_dips[event, lane]:
            beside, at_beside = best, search.at_dips[event, lane]
            search.dips[event, lane], search.at_dips[event, lane] = theta, value
        if beside < search.dips[event, lane]:
            search.low[lane], search.at_low[lane] = beside, at_beside
        else:
            search.high[lane], search.at_high[lane] = beside, at_beside


@in_watch
def shift(search, event, lane, side):
    """Move a dip to a deeper adjacent sample, bracketed by the old dip and the next sample.

    side : sign of the event there.
    """
    low, high = int(search.low[lane] * SAMPLES), int(search.high[lane] * SAMPLES)
    theta, value = search.dips[event, lane], search.at_dips[event, lane]
    if side * search.at_high[lane] < side * value and high < SAMPLES:
        search.dips[event, lane] = search.high[lane]
        search.at_dips[event, lane] = search.at_high[lane]
        search.low[lane], search.at_low[lane] = theta, value
        search.high[lane] = (high + 1) / SAMPLES
        search.at_high[lane] = search.values[high + 1, event, lane]
    elif side * search.at_low[lane] < side * value and low > 0:
        search.dips[event, lane] = search.low[lane]
        search.at_dips[event, lane] = search.at_low[lane]
        search.high[lane], search.at_high[lane] = theta, value
        search.low[lane] = (low - 1) / SAMPLES
        search.at_low[lane] = search.values[low - 1, event, lane]


@in_watch
def look_deeper(search, event, tries):
    """Set θ to the minimum of the parabola through a dip and both ends of its bracket.

    Once the parabola is trusted, only lanes in which it may reach zero are selected. Return whether
    any lane is selected.
    """
    any_selected = False
    for lane in range(search.lanes):
        if search.selected[lane] == 0.0:
            continue
        side, theta = side_of(search.at_high[lane]), search.dips[event, lane]
        value = side * search.at_dips[event, lane]
        before, after = search.low[lane] - theta, search.high[lane] - theta
        falls = (side * search.at_low[lane] - value) / before
        rises = (side * search.at_high[lane] - value) / after
        bend = (rises - falls) / (after - before)
        slope = falls - bend * before
        search.selected[lane], search.theta[lane] = 0.0, 0.0
        deep = slope * slope > 4.0 * DEEPER * bend * value or tries < TRUSTED
        if value > 0.0 and bend > 0.0 and deep and tries < MOST_TRIES:
            least = theta - 0.5 * slope / bend
            if tries % 3.0 == 2.0:  # otherwise one end of the bracket might never move
                least = theta + 0.5 * (before if -before > after else after)
            if search.low[lane] < least < search.high[lane] and least != theta:
                any_selected, search.selected[lane], search.theta[lane] = True, 1.0, least
    return any_selected

"""A thread's desk: what the lanes of a driver have between them, and whose they are.

It is one time of L trajectories, in the same arrays as the results of the batch, but for states,
which are rows; what a lane has to show is written there by formulas, and handed over to its place
in the results. What is done lane by lane knows nothing of a plan: it is compiled once for all of
them, and called by its address.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import get_type_hints

import numpy as np

from lierb.compiler.code import cached
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.compiler.tags import Tag
from lierb.kernels.functions.function import size_of
from lierb.kernels.loops.blocks import take_share
from lierb.kernels.loops.job import ARRAYS
from lierb.kernels.stepping.lane_clock import LaneClock, Span
from lierb.kernels.stepping.step_size import MOST_PARTS, Tolerances
from lierb.kernels.systems.layout import POSE_AND_TWIST, Columns, Field
from lierb.kernels.systems.measures import SUMMARY
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import (
    controllers_of,
    events_of,
    memory_of,
    outputs_of,
    signals_width,
)
from lierb.kernels.systems.system_of import system_of

# Rows of a desk that loops over lanes read and write.
(
    TRAJECTORY,  # whose the lane is; −1 for nobody's
    NUMBER,  # of the trajectory, for noise
    MARK,  # 1 where something is to be done
    ACTIVE,  # 1 where a trajectory is on its way
    FATE,  # 0 where it goes on; where it has ended, its status and 1
    NEXT, DUE,  # row of the history, and when it is due, s
    START, LENGTH,  # of the step, s
    THETA,
    TOOK,  # 1 where the step has been accepted
    CURSOR,  # of the search for crossings: how many looks have been gone through
    WHICH,  # of the events
    LOW, HIGH, AT_LOW, AT_HIGH,  # of a crossing: θ and the event's value at both ends
    LAST,  # θ of the first terminal event in the step; 2 for none
    ROWS,
) = range(19)  # fmt: skip
# What a loop asks of a service, and is told by it.
ASKED, TASK, TURN, FIRST, AGAIN, IS_NEW, ANSWER, SHARE, SHARE_END, TOLD = range(10)
TAKING, HANDING_ENDS, HANDING_ROW = range(3)  # of `serve`
LOOKS = 4  # at events in a step, at equal distances, its end included
STARTS = SUMMARY.index("starts")  # which is known before
EVENT_COLUMNS = 3  # trajectory, event, t


OWN_ARRAYS = ("desk", "told", "save_at", "numbers", "events", "kinds", "jumps")
_SIZES = (
    "first", "stop", "begin", "turns", "differ", "rows", "watched", "sides", "values",
    "shown", "own_summary", "serve", "watch",
)  # fmt: skip
LANE_JOB = np.dtype(
    (
        np.record,
        [
            *((name, np.int64, (4,)) for name in (*ARRAYS, *OWN_ARRAYS)),
            *((name, np.int64) for name in _SIZES),
            ("seed", np.float64),
            *get_type_hints(Span).items(),
            *get_type_hints(Tolerances).items(),
        ],
    )
)
"""As `lierb.kernels.loops.job.JOB`, of the batch or of a desk.

desk : [row][lane], of `desk_of`.   told : of a desk, [1][TOLD].   numbers : [1][n].
save_at : [1][row of the history], s.   jumps : [1][time at which steps end], s.
events : of a desk, [place][EVENT_COLUMNS, state and signals]; place 0 has their count.
kinds : [direction, is terminal][event].
first, stop : trajectories.   turns : iterations in this call.   watched : number of events.
sides, values, shown : rows of a desk.   own_summary : column of LANE_SUMMARY in a summary.
serve, watch : entries of `serve` and of `lierb.kernels.loops.event_search.watch`.
"""


@shared
def room_of_step(lanes, watched):
    """The most events that the lanes can have in one step."""
    return lanes * watched * (LOOKS + 1) * MOST_PARTS


@lru_cache(64)
def desk_of(plan: AnyPlan) -> Columns:
    """The rows of a desk: what loops over lanes need; of each event its side, its values at the
    looks of a step, the first of them at its start, those of a search, θ and value of a dip, and
    what rounding makes of its value at the start;
    POSE_AND_TWIST of every link, states and outputs, of what is to be shown; then what lanes carry.
    """
    events = len(events_of(plan))
    shown = POSE_AND_TWIST.count * system_of(plan).links + signals_width(plan)
    return Columns(
        Field("rows", (ROWS,)),
        Field("sides", (events,)),
        Field("values", (LOOKS + 1, events)),
        Field("searched", (events,)),
        Field("dips", (2, events)),
        Field("roundings", (events,)),
        Field("shown", (shown,)),
        Field("clock", (len(LaneClock._fields),)),
        Field("controls", (size_of(outputs_of(plan)),)),
        Field("memory", (size_of(memory_of(plan)),)),
        Field("ticks", (len(controllers_of(plan)),)),
    )


@dataclass(frozen=True)
class Service(Tag):
    """Of all plans alike."""


SERVICE = Service()


@cached()
def serve(service, inputs, counter, jobs):
    """What is asked for: as of `lierb.kernels.loops.lanes.integrate_lanes`, of whose
    arguments the others are.
    """
    job, own = jobs[0], jobs[1]
    desk, told, lanes = numbers_at(own.desk), numbers_at(own.told), inputs.shape[1]
    asked = told[0, ASKED]
    if asked == TAKING:
        going = take_next(desk, told, job, inputs, counter, lanes)
        told[0, ANSWER] = 1.0 if going else 0.0
    elif asked == HANDING_ENDS:
        hand_over_ends(desk, own, job, lanes)
    else:
        hand_over_row(desk, own, job, lanes)


@shared
def hand_over_row(desk, own, job, lanes):
    """A row of the history, where MARK says, from the desk to its place; the next one is due."""
    history, shown = histories_at(job.history), histories_at(own.history)
    multipliers, own_multipliers = histories_at(job.multipliers), histories_at(own.multipliers)
    reactions, own_reactions = histories_at(job.reactions), histories_at(own.reactions)
    save_at = numbers_at(job.save_at)
    rows = save_at.shape[1]
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        column, row = int(desk[TRAJECTORY, lane]), int(desk[NEXT, lane])
        for c in range(shown.shape[0]):
            history[c, row, column] = shown[c, 0, lane]
        if own_multipliers.shape[0] > 0:
            for c in range(own_multipliers.shape[2]):
                multipliers[row, column, c] = own_multipliers[0, lane, c]
        for joint in range(own_reactions.shape[0]):
            for c in range(6):
                reactions[joint * rows + row, column, c] = own_reactions[joint, lane, c]
        if job.rows > 1:
            hand_over_state(desk, own, job, lane, column, row)
        desk[NEXT, lane] = row + 1
        desk[DUE, lane] = save_at[0, row + 1] if row + 1 < rows else np.inf


@shared
def hand_over_state(desk, own, job, lane, column, row):
    """Of all links."""
    states = (
        histories_at(job.rotation),
        histories_at(job.position),
        histories_at(job.omega),
        histories_at(job.v),
    )
    shown = own.shown
    for place in range(row, states[0].shape[0], job.rows):
        for array in states:
            for c in range(array.shape[2]):
                array[place, column, c] = desk[shown, lane]
                shown += 1


@shared
def hand_over_ends(desk, own, job, lanes):
    """What trajectories that have ended come to."""
    summary, own_summary = numbers_at(job.summary), numbers_at(own.summary)
    ends, own_ends = numbers_at(job.ends), numbers_at(own.ends)
    in_a_row = True
    for lane in range(lanes):
        column = int(desk[TRAJECTORY, lane])
        own_summary[STARTS, lane] = summary[STARTS, column]
        in_a_row = in_a_row and desk[FATE, lane] > 0.0 and column == desk[TRAJECTORY, 0] + lane
    if in_a_row:
        first = int(desk[TRAJECTORY, 0])
        copy_columns(own_summary, summary, first, lanes)
        copy_columns(own_ends, ends, first, lanes)
    for lane in range(lanes):
        if desk[FATE, lane] > 0.0:
            column = int(desk[TRAJECTORY, lane])
            if not in_a_row:
                copy_column(own_summary, summary, lane, column)
                copy_column(own_ends, ends, lane, column)
            hand_over_state(desk, own, job, lane, column, job.rows - 1)


@shared
def copy_column(shown, array, lane, column):
    for c in range(shown.shape[0]):
        array[c, column] = shown[c, lane]


@shared
def copy_columns(shown, array, first, lanes):
    """Of all lanes: many numbers at once.

    By an index from 0 on. Of one that may be negative, for all that LLVM knows, it makes a scatter.
    """
    for c in range(shown.shape[0]):
        place = array[c, first : first + lanes]
        for lane in range(lanes):
            place[lane] = shown[c, lane]


@shared
def take_next(desk, told, job, inputs, counter, lanes):
    """Lanes whose trajectory has ended take the next ones of the thread's share; MARK says which
    have one. Whether there is any on its way.
    """
    is_new = told[0, IS_NEW] > 0.0
    places, varying = integers_at(job.places), integers_at(job.varying)
    save_at, numbers = numbers_at(job.save_at), numbers_at(job.numbers)
    going = False
    for lane in range(lanes):
        desk[MARK, lane] = 0.0
        if desk[FATE, lane] > 0.0:
            desk[FATE, lane] = 0.0
            if told[0, SHARE] >= told[0, SHARE_END]:
                told[0, SHARE], told[0, SHARE_END] = take_share(counter, job.stop, job.inputs[1])
            taken = int(told[0, SHARE])
            told[0, SHARE] += 1.0
            is_one = taken < job.stop
            desk[MARK, lane] = 1.0 if is_one else 0.0
            desk[ACTIVE, lane] = desk[MARK, lane]
            if is_one or is_new:
                trajectory = min(taken, job.stop - 1)  # a lane without one has harmless numbers
                for i in range(inputs.shape[0] if is_new else varying.shape[1]):
                    c = i if is_new else varying[0, i]
                    inputs[c, lane] = number_at(places[c, 0] + places[c, 1] * trajectory)
                desk[TRAJECTORY, lane] = trajectory
                desk[NUMBER, lane] = numbers[0, trajectory]
                desk[NEXT, lane] = 0.0
                desk[DUE, lane] = save_at[0, 0] if save_at.shape[1] > 0 else np.inf
        going = going or desk[ACTIVE, lane] > 0.0
    return going

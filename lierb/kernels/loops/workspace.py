"""Per-thread workspace: state of the L lanes of a driver, and which trajectory each lane runs.

A workspace holds L trajectories at one time, in arrays laid out like the results of the batch. The
loops write a lane's results there, and the services below copy them to the trajectory's position in
the results. Services work lane by lane and do not depend on the plan: they are compiled once for
all plans and called by their address.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lierb.compiler.code import cached
from lierb.compiler.loops import integers_at, number_at, numbers_at, put_number_at, shared
from lierb.compiler.tags import Tag
from lierb.kernels.loops.sharing import take_share
from lierb.kernels.stepping.travel import MOST_PARTS
from lierb.kernels.systems.measures import SUMMARY

# Rows of a workspace, each with a number for every lane.
(
    TRAJECTORY,  # index of the trajectory
    NOISE_INDEX,  # index of the trajectory's noise
    SELECTED,  # 1 where a request concerns the lane
    ACTIVE,  # 1 where the lane runs a trajectory
    TERMINATION,  # termination code: 0 while the trajectory runs, then its status + 1
    NEXT_ROW, DUE,  # next row of the history, and its time, s
    # Event search, in a step or a part of one:
    ACCEPTED,  # 1 where events are searched
    START, LENGTH,  # of the step, s
    THETA,
    CURSOR,  # number of intervals between samples that have been examined
    EVENT_INDEX,
    LOW, HIGH, AT_LOW, AT_HIGH,  # bracket of a root: θ and the event's value at both ends
    LAST,  # θ of the first terminal event in the step; 2 for none
    STEPS, ENDED_AT,  # number of a step that is noted, and its end, s
    ROWS,
) = range(21)  # fmt: skip
# Words exchanged between a loop and the services.
KIND, TASK, TURN, FIRST_EVENT, TRIES, IS_NEW, ANY_ACTIVE, SHARE, SHARE_END, REQUEST = range(10)
TAKE_NEXT, COPY_ENDS, COPY_ROW = range(3)  # kinds of requests to `serve`
SAMPLES = 4  # number of samples of events in a step, equidistant, including its end
STARTS = SUMMARY.index("starts")  # known before a trajectory runs
EVENT_COLUMNS = 3  # trajectory, event, t
COPY = 8  # numbers of a copy, see `copy`


@shared
def most_events(lanes, watched):
    """Return the largest possible number of events of all lanes in one step."""
    return lanes * watched * (SAMPLES + 1) * MOST_PARTS


@dataclass(frozen=True)
class Service(Tag):
    """Tag of code that is the same for all plans."""


SERVICE = Service()


@cached()
def serve(service, inputs, counter, jobs):
    """Serve a request of `lierb.kernels.loops.lanes.integrate_lanes`, with its arguments."""
    job, own = jobs[0], jobs[1]
    rows, request, lanes = numbers_at(own.rows), numbers_at(own.request), inputs.shape[1]
    kind = request[0, KIND]
    if kind == TAKE_NEXT:
        active = take_next(rows, request, job, inputs, counter, lanes)
        request[0, ANY_ACTIVE] = 1.0 if active else 0.0
    elif kind == COPY_ENDS:
        copy_ends(rows, own, job, lanes)
    else:
        copy_row(rows, own, job, lanes)


@shared
def note_steps(rows, step_times):
    """Note the ends of steps of the selected lanes, as far as there is room."""
    for lane in range(rows.shape[1]):
        step = int(rows[STEPS, lane])
        if rows[SELECTED, lane] > 0.0 and step < step_times.shape[0]:
            step_times[step, int(rows[TRAJECTORY, lane])] = rows[ENDED_AT, lane]


@shared
def copy_row(rows, own, job, lanes):
    """Copy a row of the history of each selected lane to the results; update its next due time."""
    save_at, copies = numbers_at(job.save_at), integers_at(own.row_copies)
    count = save_at.shape[1]
    for lane in range(lanes):
        if rows[SELECTED, lane] > 0.0:
            row = int(rows[NEXT_ROW, lane])
            copy(copies, lane, int(rows[TRAJECTORY, lane]), row)
            rows[NEXT_ROW, lane] = row + 1
            rows[DUE, lane] = save_at[0, row + 1] if row + 1 < count else np.inf


@shared
def copy_ends(rows, own, job, lanes):
    """Copy the summary and the end of each trajectory that has terminated.

    Derivatives at later saved times become NaN; the other rows are NaN from the beginning.
    """
    copies, blanks = integers_at(own.end_copies), integers_at(own.blanks)
    saved = numbers_at(job.save_at).shape[1]
    for lane in range(lanes):
        if rows[TERMINATION, lane] > 0.0:
            trajectory = int(rows[TRAJECTORY, lane])
            copy(copies, lane, trajectory, 0)
            for row in range(int(rows[NEXT_ROW, lane]), saved):
                copy(blanks, 0, trajectory, row)


@shared
def copy(copies, lane, trajectory, row):
    """Copy numbers of a lane to a row of the results of its trajectory.

    copies : [copy][address of the numbers; bytes to the next number and to the next lane; address
        of their place; bytes to the next number, trajectory and row; count of the numbers].
    """
    for i in range(copies.shape[0]):
        source = copies[i, 0] + copies[i, 2] * lane
        place = copies[i, 3] + copies[i, 5] * trajectory + copies[i, 6] * row
        between, apart = copies[i, 1], copies[i, 4]
        for _ in range(copies[i, 7]):
            put_number_at(place, number_at(source))
            source += between
            place += apart


@shared
def take_next(rows, request, job, inputs, counter, lanes):
    """Assign the next trajectories of the thread's share to lanes that have terminated.

    Select the lanes that have a new trajectory. Return whether any lane is active.
    """
    is_new = request[0, IS_NEW] > 0.0
    addresses, varying = integers_at(job.addresses), integers_at(job.varying)
    save_at, noise_indices = numbers_at(job.save_at), numbers_at(job.noise_indices)
    any_active = False
    for lane in range(lanes):
        rows[SELECTED, lane] = 0.0
        if rows[TERMINATION, lane] > 0.0:
            rows[TERMINATION, lane] = 0.0
            if request[0, SHARE] >= request[0, SHARE_END]:
                request[0, SHARE], request[0, SHARE_END] = take_share(
                    counter, job.stop, job.inputs[1]
                )
            taken = int(request[0, SHARE])
            request[0, SHARE] += 1.0
            exists = taken < job.stop
            rows[SELECTED, lane] = 1.0 if exists else 0.0
            rows[ACTIVE, lane] = rows[SELECTED, lane]
            if exists or is_new:
                trajectory = min(taken, job.stop - 1)  # an idle lane computes with valid numbers
                for i in range(inputs.shape[0] if is_new else varying.shape[1]):
                    c = i if is_new else varying[0, i]
                    inputs[c, lane] = number_at(addresses[c, 0] + addresses[c, 1] * trajectory)
                rows[TRAJECTORY, lane] = trajectory
                rows[NOISE_INDEX, lane] = noise_indices[0, trajectory]
                rows[NEXT_ROW, lane] = 0.0
                rows[DUE, lane] = save_at[0, 0] if save_at.shape[1] > 0 else np.inf
        any_active = any_active or rows[ACTIVE, lane] > 0.0
    return any_active

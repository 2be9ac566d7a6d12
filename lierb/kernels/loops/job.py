"""Job record: the arguments of the compiled loops, of which only the address is passed on."""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from typing import get_type_hints

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.layout import POSE_AND_TWIST

# In place of step 0: check the start first; continue from a state.
UNSEEN, RESUMED = -1, -2
TWISTS, POSES, BODIES = range(3)  # what differs between trajectories; each includes those before

RESULTS = {
    "summary": "[SUMMARY, KEEPS of each observable, JOINT_KEPT of each joint, turns][trajectory]",
    "history": "[`history_measures`, observables, JOINT_ERRORS of each joint][time][trajectory]",
    **dict.fromkeys(
        (field.name for field in POSE_AND_TWIST.fields),
        "[link, time or the last one alone][trajectory][component]",
    ),
    "multipliers": "[time][trajectory][row of any joint]",
    "reactions": "[joint, time][trajectory][component]",
    "ends": "[`end_columns`, then their column, direction][trajectory]",
    "derivatives": "[time][trajectory][column, direction], of `derivative_columns`",
    "end_derivatives": "[row][trajectory], see `lierb.runs.output.Output`",
}
ARRAYS = {
    "addresses": "int64, [column of inputs][address for the first trajectory, bytes to the next]",
    "varying": "int64, [1][columns of inputs in which trajectories differ]",
    "inputs": "[thread][column][lane], where each thread gathers a block's numbers",
    "table": "int64, [1][`lierb.kernels.systems.tree_table`], for a looped plan",
    "memory": "[row][lane] of a thread, for a looped plan or `lierb.kernels.loops.adjoint`",
    "nodes": "[row][lane] of a thread, for a looped plan that is differentiated backwards",
    "step_times": "[step and end][trajectory or 1], s, of steps that are made again",
    "ended_by": "[which][trajectory], see `lierb.kernels.loops.remade_steps.Noted`",
    "gains": "[column of inputs, then the objective][trajectory]",
    "carried": "[column][trajectory of the chunk, padded to full blocks], between two calls",
    **RESULTS,
    # For lanes with separate clocks: arrays of the run,
    "save_at": "[1][row of the history], s",
    "noise_indices": "[1][trajectory]",
    "kinds": "[direction, is terminal][event]",
    "jumps": "[1][time at which steps end], s",
    # and arrays of a thread's workspace.
    "rows": "[row][lane], see `lierb.kernels.loops.workspace`",
    "request": "[1][REQUEST]",
    "shown": "[POSE_AND_TWIST of each link, extra states, outputs][lane]",
    "sides": "[event][lane], see `lierb.kernels.loops.event_search.Search`",
    "values": "[sample][event][lane]",
    "samples": "[row, see `lierb.kernels.loops.lane_samples`][observable][lane]",
    "dips": "[θ, value][event][lane]",
    "roundings": "[event][lane]",
    "row_copies": "int64, [copy][numbers of `lierb.kernels.loops.workspace.copy`], of a row",
    "end_copies": "likewise, of the end of a trajectory",
    "blanks": "likewise, of NaN to derivatives of rows that are not reached",
    "events": "[index][EVENT_COLUMNS, state and signals]; [0][0] is their count",
}
SIZES = {
    "first": "first trajectory of the chunk",
    "stop": "the trajectory after its last",
    "begin": "step at which a call begins; UNSEEN or RESUMED in place of 0",
    "until": "step at which a call ends (0: check the start alone), or number of iterations in it",
    "differ": "TWISTS, POSES or BODIES",
    "rows_per_link": "rows of the states of each link: all saved times, or the last one",
    "watched": "number of events",
    "keeps_sides": "1 if events begin on the sides of the run before",
    "lane_column": "column of LANE_SUMMARY in a summary",
    "kept_every": "number of steps between states that are kept",
    "state_rows": "rows of such a state in memory",
    "first_row": "of the first of them",
    "serve": "entry of `lierb.kernels.loops.workspace.serve`",
    "watch": "entry of `lierb.kernels.loops.event_search.watch`",
}
JOB = np.dtype(
    (
        np.record,
        [
            *((name, np.int64, (4,)) for name in ARRAYS),  # address and extents
            *((name, np.int64) for name in SIZES),
            *(
                get_type_hints(StepClock) | get_type_hints(Span) | get_type_hints(Tolerances)
            ).items(),
            ("seed", np.float64),
        ],
    )
)
"""Arrays (float64 and C-contiguous unless stated otherwise), sizes, clock, tolerances and seed."""

_ONES = ((1, 1, 1), (1, 1), (1,), ())  # extents of the axes that an array lacks
_CODES = {"i": "q", "f": "d", "V": "4q"}  # integers, floats, addresses with extents
_PACKED = Struct("=" + "".join(_CODES[JOB[name].kind] for name in JOB.names or ()))
_OFFSETS = {name: 4 * i for i, name in enumerate(ARRAYS)}  # in the content of a record
_OFFSETS |= {name: i for i, name in enumerate((JOB.names or ())[len(ARRAYS) :], 4 * len(ARRAYS))}
_EMPTY: list[float] = [0] * (3 * len(ARRAYS) + len(_OFFSETS))


def job_of(arrays: Mapping[str, NDArray], numbers: Mapping[str, float]) -> bytes:
    """Pack a record; what is missing is zero. The caller keeps the arrays alive."""
    content = _EMPTY.copy()
    for name, array in arrays.items():
        at, shape = _OFFSETS[name], array.shape
        address = array.__array_interface__["data"][0] if array.size else 0
        content[at : at + 4] = address, *shape, *_ONES[len(shape)]
    for name, number in numbers.items():
        content[_OFFSETS[name]] = number
    return _PACKED.pack(*content)


def jobs_of(*records: bytes, per_thread: int = 1) -> NDArray:
    """Return an array of records, [thread][record]."""
    return np.frombuffer(bytearray(b"".join(records)), JOB).reshape(-1, per_thread)

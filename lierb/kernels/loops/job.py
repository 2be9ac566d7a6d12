"""Job record: what the loops of a run are called with."""

from __future__ import annotations

from struct import Struct
from typing import get_type_hints

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.stepping.clock import Clock
from lierb.kernels.systems.layout import POSE_AND_TWIST

# In place of step 0: for a start that is to be looked at, and for one that goes on from a state.
UNSEEN, RESUMED = -1, -2
TWISTS, POSES, BODIES = range(3)  # each with those before it


ARRAYS = {
    "places": "int64, [column of inputs][address for the first trajectory, bytes to the next]",
    "varying": "int64, [1][columns of inputs in which trajectories differ]",
    "inputs": "[thread][column][lane], where each thread brings a block's numbers together",
    "carried": "[column][trajectory of the chunk, padded to full blocks], between two calls",
    "summary": "[SUMMARY, KEEPS of each observable, JOINT_KEPT of each joint][trajectory]",
    "history": "[`history_measures`, observables, JOINT_ERRORS of each joint][time][trajectory]",
    **dict.fromkeys(
        (field.name for field in POSE_AND_TWIST.fields),
        "[link, time or the last one alone][trajectory][component]",
    ),
    "multipliers": "[time][trajectory][row of any joint]",
    "reactions": "[joint, time][trajectory][component]",
    "ends": "[`end_columns`][trajectory]",
}
JOB = np.dtype(
    (
        np.record,
        [
            *((name, np.int64, (4,)) for name in ARRAYS),  # address and extents
            ("first", np.int64),  # trajectory of the chunk
            ("stop", np.int64),  # the one after its last
            ("begin", np.int64),  # step of this call
            ("end", np.int64),  # 0: to look at the start alone
            ("differ", np.int64),  # from trajectory to trajectory: TWISTS, POSES or BODIES
            ("rows", np.int64),  # of the states, for each link: all saved times, or the last one
            *get_type_hints(Clock).items(),
        ],
    )
)
"""What the loops over blocks and steps work on: arrays, float64 and C-contiguous but for one,
sizes, and the clock. In one record, of which nothing but its address goes through calls."""


_CODES = {"i": "q", "f": "d", "V": "4q"}  # of whole numbers, reals, and addresses with extents
_PACKED = Struct("=" + "".join(_CODES[JOB[name].kind] for name in JOB.names or ()))


def job_of(arrays: dict[str, NDArray], *sizes: int, clock: Clock) -> NDArray:
    """The record, as an array of one; whoever calls keeps the arrays.

    sizes : first, stop, begin, end, differ and rows.
    """
    numbers: list[int] = []
    for name in ARRAYS:
        array = arrays[name]
        extents = array.shape + (1,) * (3 - array.ndim)
        numbers += (array.__array_interface__["data"][0], *extents)
    content = _PACKED.pack(*numbers, *sizes, *clock)
    return np.frombuffer(bytearray(content), JOB)

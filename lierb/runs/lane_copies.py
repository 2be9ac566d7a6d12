"""Tables of copies: where the numbers of a thread's lanes go among the results of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.loops import workspace as ws
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.runs.output import Output
from lierb.support.arrays import Array

NANS = np.full((1, 1), np.nan)

# Numbers of a lane, [number][lane], and their place among the results, [number][trajectory][row].
Copy = tuple[Array, Array]


def copies(own: Mapping[str, NDArray], output: Output) -> dict[str, NDArray[np.int64]]:
    """Return the tables of `lierb.kernels.loops.workspace.copy`.   own : a thread's workspace."""
    rows = [*_rows(own, output)]
    if output.rows > 1:
        rows += [(numbers, place[..., :-1]) for numbers, place in _states(own, output)]
    ends = [(numbers, place[..., -1:]) for numbers, place in _states(own, output)]
    ends += _ends(own, output)
    derivatives = output.derivatives.transpose(2, 1, 0)
    blank = np.broadcast_to(NANS, (len(derivatives), 1)), derivatives
    return {"row_copies": _table(rows), "end_copies": _table(ends), "blanks": _table([blank])}


def _rows(own: Mapping[str, NDArray], output: Output) -> Iterator[Copy]:
    """Yield the copies of a row of the history, without states."""
    yield own["history"][:, 0], output.history.transpose(0, 2, 1)
    yield own["derivatives"][0].T, output.derivatives.transpose(2, 1, 0)
    saved = output.history.shape[1]
    for name, array in (("multipliers", output.multipliers), ("reactions", output.reactions)):
        for i, numbers in enumerate(own[name]):  # reactions: those of each joint
            yield numbers.T, array[i * saved : i * saved + saved].transpose(2, 1, 0)


def _states(own: Mapping[str, NDArray], output: Output) -> Iterator[Copy]:
    """Yield the copies of pose and twist of all links; the last row is the end."""
    first = 0
    for link in range(0, output.rows * output.links, output.rows):
        for field, array in zip(POSE_AND_TWIST.fields, output.states, strict=True):
            place = array[link : link + output.rows].transpose(2, 1, 0)
            yield own["shown"][first : first + field.width], place
            first += field.width


def _ends(own: Mapping[str, NDArray], output: Output) -> Iterator[Copy]:
    """Yield the copies at the end of a trajectory; the check of its start is known already."""
    before, after = slice(ws.STARTS), slice(ws.STARTS + 1, None)
    for part in (before, after):
        yield own["summary"][part], output.summary[part, :, None]
    yield own["ends"], output.ends[..., None]
    yield own["end_derivatives"], output.end_derivatives[..., None]


def _table(given: list[Copy]) -> NDArray[np.int64]:
    """Return a table, [copy][address and strides, see `lierb.kernels.loops.workspace`]."""
    table = [
        (numbers.ctypes.data, *numbers.strides, place.ctypes.data, *place.strides, len(numbers))
        for numbers, place in given
        if numbers.size and place.size
    ]
    return np.array(table, dtype=np.int64).reshape(-1, ws.COPY)

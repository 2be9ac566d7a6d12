"""Input numbers of a run, and their addresses by column of the driver's inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.loops.ends import end_columns
from lierb.kernels.loops.job import BODIES, POSES, TWISTS
from lierb.kernels.systems.layout import Columns, Field
from lierb.kernels.systems.plan import AnyPlan
from lierb.model.base import Model
from lierb.support.arrays import Array

ZEROS = np.zeros(1)  # memory that unused columns refer to

# [column][address of the first trajectory's number, bytes to the next]
Addresses = NDArray[np.int64]


class _Layout(NamedTuple):
    """Addresses of a problem's numbers.

    differ : True if some numbers differ between trajectories.
    arrays : the memory that `addresses` refers to.
    """

    addresses: Addresses
    differ: bool
    arrays: tuple[Array, ...]


_layouts: WeakKeyDictionary[Model, _Layout] = WeakKeyDictionary()


def _addresses_of(field: Field, array: Array) -> Addresses:
    """Return the addresses of a field's numbers in an array.

    The array has one item per trajectory, or one item for all.
    """
    ahead = array.ndim - len(field.shape)
    addresses = np.empty((field.width, 2), dtype=np.int64)
    addresses[:, 0] = _offsets(field, array.strides[ahead:])
    addresses[:, 0] += array.__array_interface__["data"][0]
    addresses[:, 1] = 0 if _is_shared(field, array) else array.strides[0]
    return addresses


def _is_shared(field: Field, array: Array) -> bool:
    """Return True if an array has one item for all trajectories."""
    return array.ndim == len(field.shape) or len(array) == 1


def _unused(count: int) -> Addresses:
    """Return the address of a zero for each of `count` unused columns."""
    return np.full((count, 2), (ZEROS.ctypes.data, 0), dtype=np.int64)


@lru_cache(64)
def _offsets(field: Field, strides: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the offsets of a field's numbers in an item, in bytes."""
    offsets = np.zeros((), dtype=np.int64)
    for size, stride in zip(field.shape, strides, strict=True):
        offsets = offsets[..., None] + stride * np.arange(size)
    return offsets.ravel()[list(field.entries)] if field.entries else offsets.ravel()


def _layout(model: Model, columns: Columns) -> _Layout:
    """Return the addresses of a model's numbers.

    They are cached: computing them takes a tenth of the time of a call for one body.
    """
    if model not in _layouts:
        arrays = model.inputs
        addresses = _unused(columns["state"].start)
        for field, part in columns:
            if field.name in arrays:
                addresses[part] = _addresses_of(field, arrays[field.name])
        _layouts[model] = _Layout(addresses, bool(addresses[:, 1].any()), tuple(arrays.values()))
    return _layouts[model]


@dataclass(frozen=True)
class Inputs:
    """Input numbers of all trajectories, in the user's memory.

    columns : columns that the plan's system reads.
    starts : poses, (4, 4) or (n, 4, 4), and twists, (6,) or (n, 6), by field.
    count : number of trajectories.
    time : start time, s.
    state : [`end_columns`][trajectory or 1] for a continued run, in place of pose and twist.
    seeds : derivatives of the moving fields, [direction][trajectory or 1][number], by field.
    """

    model: Model
    columns: Columns
    starts: dict[str, Array]
    count: int
    time: float = 0.0
    state: Array | None = None
    seeds: dict[str, Array] | None = None

    def repeated(self, seeds: Sequence[dict[str, Array]]) -> Inputs:
        """Return the inputs of all trajectories once for each of several seeds, in this order."""
        which = np.tile(np.arange(self.count), len(seeds))
        starts = {
            name: array if _is_shared(self.columns.field(name), array) else array[which]
            for name, array in self.starts.items()
        }
        state = self.state
        if state is not None and state.shape[1] > 1:
            state = state[:, which]
        together = {
            name: np.concatenate(
                [np.broadcast_to(own[name], (len(x), self.count, x.shape[2])) for own in seeds], 1
            )
            for name, x in seeds[0].items()
        }
        is_batch = (self.model.batch_size() or 1) > 1
        model = self.model.part(which) if is_batch else self.model
        return replace(
            self, model=model, starts=starts, count=len(which), state=state, seeds=together
        )

    @property
    def differ(self) -> int:
        """Kind of the inputs that differ between trajectories: TWISTS, POSES or BODIES."""
        own = {name for name, array in (self.seeds or {}).items() if array.shape[1] > 1}
        if _layout(self.model, self.columns).differ or own - self.starts.keys():
            return BODIES
        are_one = self.state is not None or all(
            _is_shared(self.columns.field(name), array)
            for name, array in self.starts.items()
            if name != "twist"
        )
        return TWISTS if are_one and own <= {"twist"} else POSES

    def addresses(self, plan: AnyPlan) -> Addresses:
        """Return the addresses of all columns.

        A continued run reads the state; any other run reads poses and twists.
        """
        columns, addresses = self.columns, _layout(self.model, self.columns).addresses.copy()
        if self.state is None:
            for name, array in self.starts.items():
                addresses[columns[name]] = _addresses_of(columns.field(name), array)
            return np.concatenate([addresses, *self._seeds()]) if self.seeds else addresses
        at = columns["state"].start
        of_state = _unused(columns.count - at)
        for row, column in zip(self.state, end_columns(plan), strict=True):
            of_state[column] = row.ctypes.data, row.strides[0] if len(row) > 1 else 0
        return np.concatenate([addresses, *self._seeds(), of_state])

    def _seeds(self) -> Iterator[Addresses]:
        """Yield the addresses of each field's seeds, [number, direction]."""
        for field, _ in self.columns if self.seeds else ():
            seeds = (self.seeds or {}).get(field.name)
            if seeds is not None:
                addresses = np.zeros((field.width, len(seeds), 2), dtype=np.int64)
                numbers, directions = np.ogrid[: field.width, : len(seeds)]
                per_direction, per_trajectory, per_number = seeds.strides
                addresses[..., 0] = seeds.ctypes.data + per_number * numbers
                addresses[..., 0] += per_direction * directions
                addresses[..., 1] = per_trajectory if seeds.shape[1] > 1 else 0
                yield addresses.reshape(-1, 2)

    def numbers(self, trajectory: int) -> list[np.float64]:
        """Return the numbers of one trajectory in the order of the columns, except the state."""
        arrays, numbers = self.model.inputs | self.starts, []
        for field, _ in self.columns:
            if field.name in arrays:
                array = arrays[field.name]
                which = 0 if _is_shared(field, array) else trajectory
                item = array.reshape(-1, *field.shape)[which].ravel()
                numbers += list(item if field.entries is None else item[list(field.entries)])
        return numbers

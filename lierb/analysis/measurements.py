"""Measured data of a fit: times, columns and weights, read from dictionaries, tables and frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.analysis.quantities import QUATERNION, Quantity, quantities_of, quantity_named
from lierb.errors import ArgumentError, brief, unknown_name
from lierb.kernels.groups import quaternion
from lierb.kernels.numbers.vec import dot
from lierb.kernels.systems.measures import MEASURES
from lierb.model.base import Model
from lierb.model.functions.column_names import COMPONENTS
from lierb.results.columns import as_array
from lierb.results.result import Result
from lierb.runs.parameters import Parameter
from lierb.support.arrays import Array, as_floats, assembled, components

TIMES, TRAJECTORY = "t", "trajectory"
NOT_MEASURED = {"step"} | {m.name for m in MEASURES if m.name != "energy"}  # of a history
UNIT = 1e-2  # largest difference of a quaternion's length from 1, that of rounded numbers
EXPECTED = 'a dictionary or a table with "t" and measured columns, or a list of them'


@dataclass(frozen=True)
class Measured:
    """Column of data.

    values : (times, n, *shape of the quantity), NaN where a sample is missing.
    sigma : standard deviations, (width,).
    """

    quantity: Quantity
    values: Array
    sigma: Array

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Return which samples are present, (times, n, width); components may lack alone."""
        width, lead = self.quantity.width, self.values.shape[:2]
        known: NDArray[np.bool_] = np.isfinite(self.values).reshape(*lead, -1)
        if width == prod(self.quantity.shape):
            return known
        whole: NDArray[np.bool_] = np.all(known, axis=-1, keepdims=True)
        return np.repeat(whole, width, axis=-1)

    @property
    def squares(self) -> Array:
        """Return the sum of the squares of each trajectory's values over sigma, (n,)."""
        values = self.values.reshape(*self.values.shape[:2], -1)
        is_vector = values.shape[-1] == self.quantity.width
        values = values / (self.sigma if is_vector else self.sigma.min())
        return np.asarray(np.nansum(values**2, axis=(0, 2)))

    def difference(self, result: Result) -> Array:
        """Return run minus data, (times, n, width); NaN without a sample."""
        return self.quantity.difference(self.values, self.quantity.values(result))

    def derivative(
        self, result: Result, p: Parameter, slope: Array | None, out: Array | None = None
    ) -> Array:
        """Return the derivatives of the difference over sigma by a parameter, (times, n, width, k).

        slope : `Quantity.slope` of the difference.   out : array for the derivatives, or None.
        """
        own = self.quantity.derivative(result, p)
        own = np.broadcast_to(own, (own.shape[0], self.values.shape[1], *own.shape[2:]))
        turned = own if slope is None else slope @ own
        return np.asarray(np.divide(turned, self.sigma[:, None], out=out))

    def part(self, trajectories: NDArray[np.int64]) -> Measured:
        """Return the samples of some trajectories."""
        quantity = self.quantity.of_trajectories(trajectories)
        return replace(self, quantity=quantity, values=self.values[:, trajectories])


@dataclass(frozen=True)
class Measurements:
    """All data of a fit.

    t : times, s, ascending.   count : number of trajectories.
    has_sigma : True if the noise has a given standard deviation.
    counts : number of trajectories in each table.
    """

    t: Array
    columns: tuple[Measured, ...]
    count: int
    has_sigma: bool
    counts: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Return the number of residuals."""
        return sum(int(column.present.sum()) for column in self.columns)

    def norms(self, count: int) -> Array:
        """Return the norms of the weighted data of experiments with `count` trajectories each."""
        squares = np.sum([column.squares for column in self.columns], axis=0)
        return np.asarray(np.sqrt(squares.reshape(-1, count).sum(axis=1)))

    def samples(self, count: int) -> NDArray[np.int64]:
        """Return the number of residuals of experiments with `count` trajectories each."""
        present = np.sum([column.present.sum((0, 2)) for column in self.columns], axis=0)
        return np.asarray(present.reshape(-1, count).sum(axis=1))

    def responses(self, count: int) -> Array:
        """Return the norms of the weighted data, or of noise with a given sigma if larger."""
        noise = self.has_sigma * np.sqrt(self.samples(count))
        return np.asarray(np.maximum(self.norms(count), noise))


def measurements(model: Model, data: Any, sigma: Any) -> Measurements:
    """Read and check the data of a fit.   sigma : standard deviations by column, or None."""
    several = data if isinstance(data, (list, tuple)) else [data]
    if not several:
        raise ArgumentError(f"data is empty; expected {EXPECTED}")
    labels = ["data"] if len(several) == 1 else [f"data[{i}]" for i in range(len(several))]
    components = _components(model)
    tables = [_columns(*each, components) for each in zip(labels, several, strict=True)]
    names = [name for name in tables[0] if name != TIMES]
    for i, table in enumerate(tables):
        if set(table) != {TIMES, *names}:
            raise ArgumentError(
                f"data[{i}] has the columns {', '.join(table)}; expected those of data[0], "
                f"{', '.join(tables[0])}; a missing sample is NaN"
            )
    if not names:
        raise ArgumentError(f"{labels[0]} has no measured column; expected {EXPECTED}")
    times = [_times(label, table[TIMES]) for label, table in zip(labels, tables, strict=True)]
    t = np.unique(np.concatenate(times))
    columns, lengths = [], []
    for name in names:
        quantity = quantity_named(model, "data: column", name)
        parts = [
            _placed(t, own, _values(name, table[name], len(own), quantity))
            for own, table in zip(times, tables, strict=True)
        ]
        lengths = [part.shape[1] for part in parts]
        values = np.concatenate(parts, axis=1)
        columns.append(Measured(quantity, values, _sigma(name, sigma, quantity)))
    for name in sigma or ():
        if name not in names:
            raise unknown_name("sigma", name, names)
    counts = {column.values.shape[1] for column in columns}
    if len(counts) > 1:
        listed = ", ".join(f"{c.quantity.name} has {c.values.shape[1]}" for c in columns)
        raise ArgumentError(f"data: columns differ in their number of trajectories: {listed}")
    return Measurements(t, tuple(columns), counts.pop(), sigma is not None, tuple(lengths))


def _columns(label: str, given: Any, components: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return the columns of a table as arrays; components such as omega_x are put together."""
    if isinstance(given, pa.Table):
        columns = {name: as_array(given[name]) for name in given.column_names}
    elif isinstance(given, Mapping):
        columns = dict(given)
    elif hasattr(given, "columns") and hasattr(given, "__getitem__"):
        columns = {str(name): np.asarray(given[name]) for name in given.columns}
    else:
        raise ArgumentError(f"{label} is {brief(given)}; expected {EXPECTED}")
    if TIMES not in columns:
        raise ArgumentError(
            f'{label} has no column "t", the times in s; its columns are '
            f"{', '.join(map(str, columns)) or 'none'}"
        )
    return _of_history(_joined(label, columns, components))


def _components(model: Model) -> dict[str, list[str]]:
    """Return the columns of vectors in data frames of `Result.to_pandas`, by quantity."""
    columns = {}
    for q in quantities_of(model):
        numbered = [str(i + 1) for i in range(q.width if q.shape else 0)]
        parts = COMPONENTS.get(q.name.rpartition(".")[2], numbered)
        columns[q.name] = [f"{q.name}_{part}" for part in parts]
    return columns


def _joined(
    label: str, columns: dict[str, Any], components: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Put components that have columns of their own together. Raises ArgumentError if some lack."""
    owners = {part: whole for whole, parts in components.items() for part in parts}
    joined: dict[str, Any] = {}
    for name, values in columns.items():
        whole = owners.get(name)
        if whole is None:
            joined[name] = values
            continue
        parts = components[whole]
        if missing := [part for part in parts if part not in columns]:
            raise ArgumentError(
                f"{label} has {name} without {', '.join(missing)}; expected all components of "
                f"{whole}, NaN where one is not measured"
            )
        joined[whole] = np.stack([np.asarray(columns[part]) for part in parts], -1)
    return joined


def _of_history(columns: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a history, time-major, with an axis of trajectories."""
    if TRAJECTORY not in columns:
        return columns
    numbers = np.asarray(columns.pop(TRAJECTORY))
    columns = {k: x for k, x in columns.items() if k.rpartition(".")[2] not in NOT_MEASURED}
    count = len(np.unique(numbers))
    if len(numbers) % count or np.any(numbers.reshape(-1, count) != np.unique(numbers)):
        raise ArgumentError(
            "data: the rows are not those of a history, all trajectories at each time; give a "
            "list with a table for each trajectory"
        )
    shaped = {k: np.asarray(x).reshape(-1, count, *np.shape(x)[1:]) for k, x in columns.items()}
    return shaped | {TIMES: shaped[TIMES][:, 0]}


def _times(label: str, given: Any) -> Array:
    times = as_floats(f"{label}: t", given)
    if times.ndim != 1 or not times.size:
        raise ArgumentError(f"{label}: t has shape {times.shape}; expected (m,), times in s")
    if not np.isfinite(times).all():
        at = int(np.flatnonzero(~np.isfinite(times))[0])
        raise ArgumentError(f"{label}: t[{at}] is {times[at]}; leave out samples without a time")
    if np.any(np.diff(times) <= 0.0):
        raise ArgumentError(
            f"{label}: t does not ascend; sort the samples, and give each time once"
        )
    return times


def _values(name: str, given: Any, times: int, quantity: Quantity) -> Array:
    """Return the samples of a column, (times, n, *shape)."""
    values = as_floats(f"data: {name}", given)
    is_quaternion = name.rpartition(".")[2] == QUATERNION
    shape = (4,) if is_quaternion else quantity.shape
    if shape == (3, 3) and values.shape[-1:] == (9,):
        values = values.reshape(*values.shape[:-1], 3, 3)
    if shape in ((), (1,)) and values.ndim in (1, 2):
        values = values.reshape(*values.shape, *shape)
    fits = values.shape[values.ndim - len(shape) :] == shape
    lead = values.shape[: values.ndim - len(shape)]
    if not fits or len(lead) not in (1, 2) or lead[0] != times:
        sizes = ", ".join(map(str, shape))
        raise ArgumentError(
            f"data: {name} has shape {values.shape}; expected ({times}, {sizes}), or "
            f"({times}, n, {sizes}) for n trajectories"
        )
    if np.isinf(values).any():
        raise ArgumentError(f"data: {name} has infinite numbers; a missing sample is NaN")
    values = values if len(lead) == 2 else values[:, None]
    if is_quaternion:
        values = _rotations(name, values)
    return _checked_group(name, values) if shape in ((3, 3), (4, 4)) else values


def _rotations(name: str, quaternions: Array) -> Array:
    """Return the rotation matrices of quaternions (w, x, y, z). Raises ArgumentError."""
    lengths = np.linalg.norm(quaternions, axis=-1)
    off = np.abs(lengths - 1.0)
    if np.any(off > UNIT):
        worst = lengths.ravel()[np.nanargmax(off)]
        raise ArgumentError(
            f"data: {name} has quaternions that are no rotations, one of length {worst:.4g}; "
            "expected (w, x, y, z) of length 1"
        )
    p = components(quaternions)
    with np.errstate(invalid="ignore", divide="ignore"):
        return assembled(quaternion.matrix(p, 2.0 / dot(p, p)), 3, 3)


def _checked_group(name: str, values: Array) -> Array:
    turned = values[..., :3, :3]
    known = np.isfinite(values).all((-2, -1))
    off = np.abs(turned[known].swapaxes(-1, -2) @ turned[known] - np.eye(3)).max(initial=0.0)
    if off > 1e-6 or np.any(np.linalg.det(turned[known]) < 0.0):
        raise ArgumentError(
            f"data: {name} has matrices that are no rotations, RᵀR is off by {off:.1g}"
        )
    if values.shape[-1] == 4 and np.any(values[known][:, 3] != (0.0, 0.0, 0.0, 1.0)):
        raise ArgumentError(
            f"data: {name} has matrices that are no poses; expected the last row (0, 0, 0, 1)"
        )
    return values


def _placed(t: Array, own: Array, values: Array) -> Array:
    """Return the samples at all times, NaN where there are none."""
    placed = np.full((len(t), *values.shape[1:]), np.nan)
    placed[np.searchsorted(t, own)] = values
    return placed


def _sigma(name: str, given: Any, quantity: Quantity) -> Array:
    if given is None:
        return np.ones(quantity.width)
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f"sigma={brief(given)}; expected a dictionary of standard deviations by column"
        )
    if name not in given:
        raise ArgumentError(
            f"sigma lacks {name}; expected the standard deviation of the noise of every column, "
            "or sigma=None for weights of 1"
        )
    sigma = as_floats(f"sigma[{name!r}]", given[name])
    fits = sigma.shape in ((), (quantity.width,))
    if not (fits and np.all((sigma > 0.0) & (sigma < np.inf))):
        raise ArgumentError(
            f"sigma[{name!r}]={brief(given[name])}; expected a positive number, or "
            f"{quantity.width} of them, {quantity.unit}"
        )
    return np.broadcast_to(sigma, quantity.width)

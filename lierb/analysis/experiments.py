"""Data and starts of experiments: groups of equally many trajectories, which follow each other."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.measurements import TIMES, Measurements, measurements
from lierb.analysis.quantities import QUATERNION, quantity_named
from lierb.errors import ArgumentError, LierbError
from lierb.model.base import Model
from lierb.runs.variations import Varied
from lierb.support.arrays import Array, items_at
from lierb.support.representations import counted


def measured_experiments(model: Model, data: Any, sigma: Any) -> tuple[Measurements, int]:
    """Read the data of experiments; return them with the number of trajectories of each."""
    if not isinstance(data, (list, tuple)):
        flat, count = _flattened(model, data)
        return measurements(model, flat, sigma), count
    groups = [each if isinstance(each, (list, tuple)) else [each] for each in data]
    given = measurements(model, [table for group in groups for table in group], sigma)
    by_table = iter(given.counts)
    counts = [sum(islice(by_table, len(group))) for group in groups]
    for i, count in enumerate(counts):
        if count != counts[0]:
            raise ArgumentError(
                f"data[{i}] has {counted(count, 'trajectory', 'trajectories')} and data[0] "
                f"{counts[0]}; expected equally "
                "many in all experiments; missing samples are NaN"
            )
    return given, counts[0]


def _flattened(model: Model, data: Any) -> tuple[Any, int]:
    """Join the axes of experiments and trajectories of columns (times, n, m, …)."""
    if not isinstance(data, Mapping):
        return data, 1
    columns, counts = {}, {}
    for name, values in data.items():
        array = values
        if name != TIMES and hasattr(values, "ndim"):
            item = _item_axes(model, name, values)
            if values.ndim - item == 3:
                counts[name] = values.shape[2]
                array = values.reshape(values.shape[0], -1, *values.shape[3:])
        columns[name] = array
    if len({*counts.values()}) > 1:
        listed = ", ".join(f"{name} has {count}" for name, count in counts.items())
        raise ArgumentError(
            f"data: columns differ in their number of trajectories by experiment: {listed}"
        )
    return columns, next(iter(counts.values()), 1)


def _item_axes(model: Model, name: Any, values: Any) -> int:
    """Return the number of axes of one sample."""
    try:
        shape = quantity_named(model, "data: column", name).shape
    except LierbError:
        return int(values.ndim)  # `measurements` reports the name
    is_flat = name.rpartition(".")[2] == QUATERNION or (shape == (3, 3) and values.shape[-1] == 9)
    if shape == (1,) and values.shape[-1] != 1:
        return 0
    return 1 if is_flat else len(shape)


def flat_start(given: Any, item_axes: int) -> Any:
    """Join the axes of experiments and trajectories of a start (n, m, …)."""
    if isinstance(given, Mapping):
        return {k: flat_start(each, item_axes) for k, each in given.items()}
    if isinstance(given, (list, tuple, np.ndarray)) and np.ndim(given) == item_axes + 2:
        array = np.asarray(given)
        return array.reshape(-1, *array.shape[2:])
    return given


def of_experiments(base: Varied, experiments: int, count: int) -> Varied:
    """Return model and start of all trajectories.   count : trajectories of an experiment."""
    own, whole = base.batch_size, experiments * count
    if own not in (1, count, whole):
        several = f", {count} for all experiments" if count > 1 else ""
        raise ArgumentError(
            f"data has {counted(experiments, 'experiment')} of "
            f"{counted(count, 'trajectory', 'trajectories')}, and the problem with its start "
            f"{own}; expected one for all{several}, or {whole}"
        )
    if own == count == experiments > 1:
        raise ArgumentError(
            f"the problem with its start has {own} numbers, one for each experiment or one for "
            f"each of its trajectories; give {whole}, experiment by experiment"
        )
    tiled = np.arange(whole) % own
    size = base.model.batch_size() or 1
    model = base.model if size in (1, whole) else base.model.part(tiled)
    return Varied(
        model,
        {k: _taken(x, tiled, 2) for k, x in base.poses.items()},
        {k: _taken(x, tiled, 1) for k, x in base.twists.items()},
    )


def _taken(array: Array, which: NDArray[np.int64], axes: int) -> Array:
    items = items_at(array, which, axes)
    return np.broadcast_to(items, (len(which), *array.shape[-axes:])).copy()

"""Provenance of a table: model, options, method, versions and machine, as JSON."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable
from functools import cache, lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from weakref import WeakKeyDictionary

import llvmlite.binding as llvm
import numba
import numpy as np

from lierb.compiler.threads import begun
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.model.base import Model
from lierb.model.functions.elements import Element
from lierb.runs.starts import Ready
from lierb.support.arrays import Array, slices

LISTED = 64  # most numbers of an array written out; larger ones are described by shape and digest
LARGE = 1 << 16  # size of a start whose digest takes longer than starting a thread

OWN = ("unit", "direction", "terminal", "units")  # of observables, events, states, controllers
Start = Array | dict[str, Array]  # for a mechanism: by link


@cache
def package_version() -> str:
    try:
        return version("lierb")
    except PackageNotFoundError:
        return "unknown"


@cache
def machine() -> dict[str, Any]:
    return {
        "lierb": package_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "cpu": llvm.get_host_cpu_name(),
        "platform": platform.platform(),
    }


def provenance(ready: Ready) -> Callable[[], str]:
    """Return a function that returns the metadata of a run, a JSON object.

    The digests of a large start are computed in a separate thread during the run.
    """
    described = partial(_described_run, ready)
    if ready.before is None and _count_of(ready.twist0) + _count_of(ready.pose0) >= LARGE:
        return begun(described)
    text = described()
    return lambda: text


def _count_of(start: Start | None) -> int:
    """Return the number of scalars in a start."""
    if start is None:
        return 0
    return sum(map(_count_of, start.values())) if isinstance(start, dict) else start.size


def _described_run(ready: Ready) -> str:
    model, options = ready.model, ready.options
    before = None if ready.before is None else ready.before.provenance
    if model not in _models:
        _models[model] = json.dumps(model.description, default=_described)
    start = {
        "twist0": _described_start(ready.twist0, before),
        "pose0": None if ready.pose0 is None else _described_start(ready.pose0, before),
    }
    if before is not None:
        start["continued"] = True
    own = options.timing.metadata()
    if ready.trajectories is not None and model.controllers:
        own["trajectories"] = ready.trajectories
    given = _described_options(*options.metadata(model).items())
    return _merged(
        _described_plan(ready.plan),
        f'{{"options": {_merged(given, json.dumps(own, default=_described))}}}',
        f'{{"problem": {_merged(_models[model], json.dumps(start))}}}',
    )


def _merged(*objects: str) -> str:
    """Return one JSON object with the members of several."""
    return "{" + ", ".join(text[1:-1] for text in objects if text != "{}") + "}"


@lru_cache(64)
def _described_options(*options: tuple[str, Any]) -> str:
    return json.dumps(dict(options))


@cache
def _described_plan(plan: AnyPlan) -> str:
    own = {
        "units": "SI: kg, m, s, rad, N, N m, J", "lanes": DEFAULT_LANES, "block": plan.lanes,
        "tableau": plan.method.described,
    }  # fmt: skip
    return json.dumps(machine() | own)


# JSON of each model, cached: its arrays cannot change, and digests of large arrays are slow.
_models: WeakKeyDictionary[Model, str] = WeakKeyDictionary()


def _described_start(given: Start, before: str | None) -> Any:
    if isinstance(given, dict):
        return {name: _described_start(array, before) for name, array in given.items()}
    if before is None or given.size <= LISTED:
        return described_array(given)
    digest = hashlib.sha256(before.encode())  # of kilobytes, not megabytes
    return {"shape": list(given.shape), "end_of": digest.hexdigest()}


def _described(value: Any) -> Any:
    """Convert an array or an element of a model's description for JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return described_array(np.asarray(value))
    assert isinstance(value, Element)
    parameters = {name: described_array(array) for name, array in value.parameters.items()}
    placed = {"on": list(value.at)} if value.at else {}
    own = {name: getattr(value, name) for name in OWN if hasattr(value, name)}
    if "units" in own:
        own["units"] = dict(own["units"])
    return {"name": value.name, "kind": repr(value.kind), **placed, **parameters, **own}


def described_array(array: Array) -> Any:
    """Return the numbers of an array; for a large array, its shape and a digest."""
    if array.size <= LISTED:
        return array.tolist()
    digest = hashlib.sha256()
    for part in slices(array):  # the array may be one body's, broadcast
        digest.update(np.ascontiguousarray(part).data)
    return {"shape": list(array.shape), "sha256": digest.hexdigest()}

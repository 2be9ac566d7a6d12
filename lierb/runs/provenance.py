"""Where a table came from: the whole problem, the method, versions, the machine."""

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
from lierb.model.functions.elements import Element
from lierb.model.mechanism.links import Loop
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.tree import BODY, JOINT
from lierb.model.problem import Problem
from lierb.support.arrays import Array, slices

LISTED = 64  # numbers of an array that are written out; a larger one is named by shape and digest
LARGE = 1 << 16  # numbers of a start whose digest takes longer than to start a thread for it

Start = Array | dict[str, Array]  # of a mechanism by link


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


def provenance(
    problem: Problem | Mechanism, *, twist0: Start, pose0: Start | None, **more: Any
) -> Callable[[], str]:
    """What gives the text of `_described`, once it is asked for: the digests of a large start are
    made in a thread of their own, beside the run.
    """
    described = partial(_described, problem, twist0=twist0, pose0=pose0, **more)
    if more["before"] is None and _count_of(twist0) + _count_of(pose0) >= LARGE:
        return begun(described)
    text = described()
    return lambda: text


def _count_of(start: Start | None) -> int:
    """Numbers of it."""
    if start is None:
        return 0
    return sum(map(_count_of, start.values())) if isinstance(start, dict) else start.size


def _described(
    problem: Problem | Mechanism,
    *,
    twist0: Start,
    pose0: Start | None,
    before: str | None,
    plan: AnyPlan,
    options: dict[str, Any],
    more: dict[str, Any],
) -> str:
    """A JSON object.

    options : hashable.   more : such that are not, or differ from run to run.
    before : of the run for whose end twist0 and pose0 stand, to rounding, if they do.
    """
    if problem not in _problems:
        _problems[problem] = json.dumps(_described_problem(problem))
    start = {
        "twist0": _described_start(twist0, before),
        "pose0": None if pose0 is None else _described_start(pose0, before),
    }
    if before is not None:
        start["continued"] = True
    whole_problem = _merged(_problems[problem], json.dumps(start))
    return _merged(
        _described_plan(plan),
        f'{{"options": {_merged(_described_options(*options.items()), json.dumps(more))}}}',
        f'{{"problem": {whole_problem}}}',
    )  # fmt: skip


def _merged(*objects: str) -> str:
    """One JSON object with the members of these."""
    return "{" + ", ".join(text[1:-1] for text in objects if text != "{}") + "}"


@lru_cache(64)
def _described_options(*options: tuple[str, Any]) -> str:
    return json.dumps(dict(options))


@cache
def _described_plan(plan: AnyPlan) -> str:
    return json.dumps(
        {
            **machine(),
            "units": "SI: kg, m, s, rad, N, N m, J",
            "lanes": DEFAULT_LANES,
            "block": plan.lanes,
            "tableau": _described_tableau(plan),
        }
    )


def _described_tableau(plan: AnyPlan) -> dict[str, Any]:
    """What of a `ButcherTableau` the run has used."""
    found: dict[str, Any] = {"A": plan.stages, "b": plan.weights}
    if plan.exponentials:
        found["exponentials"] = plan.exponentials
    if plan.embedded is not None:
        found |= {"error": plan.embedded.weights, "error_order": plan.embedded.order}
    if plan.extension is not None:
        found |= {"dense": plan.extension.weights, "dense_A": plan.extension.stages}
    return found


# As JSON: a problem's arrays cannot change, and digests of large ones take a while.
_problems: WeakKeyDictionary[Problem | Mechanism, str] = WeakKeyDictionary()


def _described_start(given: Start, before: str | None) -> Any:
    if isinstance(given, dict):
        return {name: _described_start(array, before) for name, array in given.items()}
    if before is None or given.size <= LISTED:
        return described_array(given)
    digest = hashlib.sha256(before.encode())  # of kilobytes, not megabytes
    return {"shape": list(given.shape), "end_of": digest.hexdigest()}


def _described_problem(problem: Problem | Mechanism) -> dict[str, Any]:
    if isinstance(problem, Mechanism):
        return _described_mechanism(problem)
    return {
        **{name: described_array(array) for name, array in problem.quantities.items()},
        "joint": problem.joint.name,
        "rows": [str(row) for row in problem.rows],
        "forces": [_described_element(force) for force in problem.forces],
        "constraints": [_described_element(added) for added in problem.constraints],
        "observables": [
            _described_element(each) | {"unit": each.unit} for each in problem.observables
        ],
        **_described_signals(problem),
    }


def _described_mechanism(mechanism: Mechanism) -> dict[str, Any]:
    held = {}
    for each in mechanism.links_and_loops:
        is_loop = isinstance(each, Loop)
        numbers = {} if is_loop else {name: getattr(each.body, name) for name in BODY}
        numbers |= {name: getattr(each.joint, name) for name in JOINT}
        held[each.name] = {
            "kind": "loop" if is_loop else "link",
            "parent": each.parent,
            **({"body": each.body} if is_loop else {}),
            "joint": each.joint.name,
            "rows": [str(row) for row in each.joint.rows],
            **{name: described_array(array) for name, array in numbers.items()},
        }
    return {
        "mechanism": held,
        "gravity": described_array(mechanism.gravity),
        "forces": [_described_element(force) for force in mechanism.forces],
        "constraints": [_described_element(added) for added in mechanism.constraints],
        "observables": [
            _described_element(each) | {"unit": each.unit} for each in mechanism.observables
        ],
        **_described_signals(mechanism),
        "rows": [f"{each.name}.{row}" for each in mechanism.connections for row in each.rows],
    }


def _described_signals(problem: Problem | Mechanism) -> dict[str, Any]:
    """Events, extra states and controllers, where there are any."""
    found: dict[str, Any] = {}
    if problem.events:
        found["events"] = [
            _described_element(e) | {"direction": e.direction, "terminal": e.terminal}
            for e in problem.events
        ]
    for label in ("states", "controllers"):
        if elements := getattr(problem, label):
            found[label] = [_described_element(e) | {"units": dict(e.units)} for e in elements]
    return found


def _described_element(element: Element) -> dict[str, Any]:
    parameters = {name: described_array(array) for name, array in element.parameters.items()}
    placed = {"on": list(element.at)} if element.at else {}
    return {"name": element.name, "kind": repr(element.kind), **placed, **parameters}


def described_array(array: Array) -> Any:
    """Its numbers, or of many the shape and a digest."""
    if array.size <= LISTED:
        return array.tolist()
    digest = hashlib.sha256()
    for part in slices(array):  # which may be one body's, broadcast
        digest.update(np.ascontiguousarray(part).data)
    return {"shape": list(array.shape), "sha256": digest.hexdigest()}

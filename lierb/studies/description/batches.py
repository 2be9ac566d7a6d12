"""Draw, make and start the bodies of a study, a range of them at a time."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.errors import LierbError, PoseError, StudyError, TwistError
from lierb.kernels.mechanics.passive_elements import INITIAL
from lierb.model.mechanism.links import Link, Loop
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.sampling import Design
from lierb.studies.description.messages import at
from lierb.studies.description.sections.sampling import SHAPES
from lierb.studies.description.starting import (
    AUTO,
    counted_from_coordinates,
    started,
    started_mechanism,
)
from lierb.studies.description.study_file import ELEMENTS
from lierb.studies.description.study_tables import NOTHING, StudyTables
from lierb.support.arrays import SLICE, Array

Draws = dict[str, dict[str, Array]]  # draws by section and key
Elements = dict[str, Any]  # lists of elements by list of the problem
COORDINATES = ("coordinates", "velocities")  # a number, or a list of any length, by the joint
MOST_CHECKED = 10**6  # most bodies made before a study runs: at most some seconds
NOT_FINITE = "expected finite numbers"  # about a number of the file; draws are finite


@dataclass(frozen=True)
class Batch:
    """Some bodies of a study, ready for `lierb.integrate`.

    twist0 : (n, 6), of a mechanism by link.
    pose0 : (n, 4, 4), of a mechanism by link; None for the closed joint.
    draws : of each sampled quantity, by its path.
    seed, trajectories : seed of the study, and numbers of the bodies in it, (n,); the noise of
        controllers depends on them.
    """

    problem: Problem | Mechanism
    twist0: Any
    pose0: Any
    draws: dict[str, Array]
    seed: int
    trajectories: NDArray[np.int_]

    @property
    def start(self) -> dict[str, Any]:
        """Return the keywords of `lierb.integrate` for these bodies: start, and noise if any."""
        start = {"pose0": self.pose0, "twist0": self.twist0}
        if self.problem.controllers:
            start |= {"seed": self.seed, "trajectories": self.trajectories}
        return start

    @property
    def first(self) -> Batch:
        """Return the first body alone; its pose and twist have no axis of bodies."""
        draws = {path: values[:1] for path, values in self.draws.items()}
        return Batch(
            self.problem.of_body(0), _first_of(self.twist0), _first_of(self.pose0), draws,
            self.seed, self.trajectories[:1],
        )  # fmt: skip


def _first_of(arrays: Any) -> Any:
    if isinstance(arrays, dict):
        return {name: array[0] for name, array in arrays.items()}
    return None if arrays is None else arrays[0]


def batch_of(study: StudyTables, first: int, count: int, design: Design | None = None) -> Batch:
    """Make and start the bodies first, …, first + count − 1; see `lierb.Study.batch`."""
    with _drawn(design or study.design, first, count) as draws:
        return batch_at(study, draws, first, count)


def check_draws(study: StudyTables) -> None:
    """Make the first MOST_CHECKED bodies of a study before it runs, which takes little time.

    Raises StudyError for the first one that cannot be made, such as one of a negative mass.
    """
    design = study.design
    bodies = min(len(design), MOST_CHECKED)
    for first in range(0, bodies, SLICE):
        count = min(SLICE, bodies - first)
        with _drawn(design, first, count) as draws:
            problem, initial = _made(study, draws, first)
            if not isinstance(problem, Mechanism):  # whose loops take long to close
                _started(study, problem, initial, first, count)


@contextmanager
def _drawn(design: Design, first: int, count: int) -> Iterator[dict[str, Array]]:
    """Draw bodies; name the trajectory in errors about a number, `body: mass[6] is …`."""
    draws = design.draw(first, count)
    draws.pop(NOTHING, None)
    try:
        yield draws
    except StudyError as error:
        raise StudyError(_of_trajectory(str(error), draws, first, count)) from None


def batch_at(study: StudyTables, draws: dict[str, Array], first: int, count: int) -> Batch:
    """Make and start bodies with these draws.   first : number of the first."""
    problem, initial = _made(study, draws, first)
    twist0, pose0 = _started(study, problem, initial, first, count)
    numbers = np.arange(first, first + count)
    return Batch(problem, twist0, pose0, draws, study.sample.seed, numbers)


def _made(
    study: StudyTables, draws: dict[str, Array], first: int
) -> tuple[Problem | Mechanism, dict[str, Any]]:
    """Make bodies with these draws; return them, and the tables `initial`, of links by name.

    first : number of the first.
    """
    own: Draws = {}
    for path, values in draws.items():
        section, _, key = path.rpartition(".")
        _check_shape(path, section, key, values.shape[1:])
        is_single = key in COORDINATES and values.ndim == 1
        own.setdefault(section, {})[key] = values[:, None] if is_single else values
    elements = _elements(study, own)
    make = _mechanism if study.problem.links else _one_body
    made = make(study, own, elements, first)
    if own:
        table, _, _ = next(iter(own)).partition(".")
        names = [each.label for each in getattr(study.problem, table)]
        raise StudyError(
            f"sample.{next(iter(own))}: there is no such {table.removesuffix('s')}; known: {names}"
        )
    return made


def _elements(study: StudyTables, own: Draws) -> Elements:
    """Make forces, constraints and the like of the problem; their draws are taken out of `own`."""
    elements: Elements = {table: [] for table in ELEMENTS}
    for table, section in study.problem.elements():
        with at(f"problem.{table}"):
            drawn = own.pop(f"{table}.{section.label}", {})
            element = section.make(drawn, study._code)
        elements[table].append(element)
        _require_one(f"problem.{table}.{section.label}", element, drawn)
        for key, values in drawn.items():
            shapes = element.kind.shapes
            shape = shapes[key] if key in shapes else shapes[f"{INITIAL}{key}"]
            _require_shape(f"{table}.{section.label}.{key}", values.shape[1:], shape)
    return elements


def _one_body(
    study: StudyTables, own: Draws, elements: Elements, first: int
) -> tuple[Problem, dict[str, Any]]:
    assert study.body is not None
    assert study.joint is not None
    with at("body"):
        body = study.body.make(own.pop("body", {}))
    with at("joint"):
        joint = study.joint.make(own.pop("joint", {}))
    initial = study.initial.given() | own.pop("initial", {})
    with at("initial"):
        elements["states"] = counted_from_coordinates(
            elements["states"], {"": joint}, {"": initial}, first
        )
    with at("problem"):
        problem = Problem(body, joint, _gravity(study, own), **elements)
    return problem, initial


def _gravity(study: StudyTables, own: Draws) -> Any:
    return own.pop("problem", {}).get("gravity", study.problem.gravity)


def _mechanism(
    study: StudyTables, own: Draws, elements: Elements, first: int
) -> tuple[Mechanism, dict[str, Any]]:
    links, loops, initial = [], [], {}
    for each in study.problem.links:
        with at(f"problem.links.{each.name}.body"):
            body = each.body.make(own.pop(f"{each.name}.body", {}))
        with at(f"problem.links.{each.name}.joint"):
            joint = each.joint.make(own.pop(f"{each.name}.joint", {}))
        with at("problem"):
            links.append(Link(each.name, body, joint, each.parent))
        initial[each.name] = each.initial.given() | own.pop(f"{each.name}.initial", {})
    for loop in study.problem.loops:
        with at(f"problem.loops.{loop.name}.joint"):
            joint = loop.joint.make(own.pop(f"{loop.name}.joint", {}))
        with at("problem"):
            loops.append(Loop(loop.name, joint, loop.body, loop.parent))
    with at("initial"), of_links(initial):
        joints = {link.name: link.joint for link in links}
        elements["states"] = counted_from_coordinates(elements["states"], joints, initial, first)
    with at("problem"):
        return Mechanism(links, loops, _gravity(study, own), **elements), initial


def _started(
    study: StudyTables,
    problem: Problem | Mechanism,
    initial: dict[str, Any],
    first: int,
    count: int,
) -> tuple[Any, Any]:
    """Return twists and poses of bodies; of a mechanism by link.   first : number of the first."""
    if isinstance(problem, Mechanism):
        return _started_mechanism(study, problem, initial, first, count)
    with at("initial"):
        twist0, pose0 = started(problem, initial, study.integrate.t0)
    return np.broadcast_to(twist0, (count, 6)), pose0


def _started_mechanism(
    study: StudyTables, mechanism: Mechanism, initial: dict[str, Any], first: int, count: int
) -> tuple[dict[str, Array], dict[str, Array]]:
    close, hold = study.initial.close or AUTO, study.initial.hold or []
    with at("initial"), of_links(mechanism.names):
        try:
            return started_mechanism(mechanism, initial, close, hold, count, study.integrate.t0)
        except (PoseError, TwistError) as error:  # which number the bodies of this batch from 0
            numbered = re.sub(
                r"^(?:pose|twist)\b(?:\[(\d+)\])?",
                lambda match: f"trajectory {first + int(match[1] or 0)}",
                str(error),
            )
            raise type(error)(numbered) from None


# ---- messages ----------------------------------------------------------------------------------


def _of_trajectory(message: str, draws: Mapping[str, Array], first: int, count: int) -> str:
    index = r"\[(\d+)\]" if count > 1 else "()"  # numbers of a single body have none
    # Indices within quotation marks are those of a function's source.
    parts = re.match(rf'([\w.]+): ([^"]*?)(\w+){index}(.*)', message, re.DOTALL)
    is_of_all = message.endswith(NOT_FINITE) or " has shape " in message
    if parts is None or parts[3] in ELEMENTS or is_of_all:
        return message
    table, before, name, body, after = parts.groups()
    owner = re.sub(r"^problem\.((links|loops)\.)?", "", table)
    paths = [p for p in draws if p.startswith(f"{owner}.") and p.endswith(f".{name}")]
    if count == 1 and not paths:
        return message
    key = f"sample.{paths[0]}" if len(paths) == 1 else table
    return (
        f"{key}: trajectory {first + int(body or 0)}: {before}{name}{after}; "
        "choose distributions without such draws, such as truncated_normal"
    )


@contextmanager
def of_links(names: Collection[str]) -> Iterator[None]:
    """Convert errors about the start of a link, `crank.coordinates …`, to name its table."""
    try:
        yield
    except LierbError as error:
        about = re.match(r"(.+?)(?:\.(\w+))?[: ]+(.*)", str(error), re.DOTALL)
        if about is None or about[1] not in names:
            raise
        key = ".".join(filter(None, (f"problem.links.{about[1]}.initial", about[2])))
        raise StudyError(f"{key}: {about[3]}") from None


# ---- shapes ------------------------------------------------------------------------------------


def _check_shape(path: str, section: str, key: str, shape: tuple[int, ...]) -> None:
    """Raise StudyError for a draw of another shape than its key takes.

    Otherwise bodies might be taken for components. Shapes of elements are checked in `_elements`.
    """
    first, _, _ = section.partition(".")
    is_free = key in COORDINATES
    if first in ELEMENTS or (key == "inertia" and shape == (3, 3)) or (is_free and shape == ()):
        return
    _require_shape(path, shape, SHAPES.get(key, (3,)), free=is_free)


def _require_shape(
    path: str, shape: tuple[int, ...], expected: tuple[int, ...], free: bool = False
) -> None:
    fits = len(shape) == 1 if free else shape == expected
    if not fits:
        what = "a list of numbers" if free or expected == (3,) else f"shape {expected}"
        what = "one number" if expected == () else what
        raise StudyError(f"sample.{path}: a draw has shape {shape}; expected {what}")


def _require_one(label: str, element: Any, drawn: Mapping[str, Array]) -> None:
    """Raise StudyError for parameters that differ from body to body and are not drawn.

    Their assignment to bodies would depend on how a study is cut into parts.
    """
    for name, array in element.parameters.items():
        key, shape = name.removeprefix(INITIAL), element.kind.shapes[name]
        if key not in drawn and array.ndim > len(shape):
            what = f"a list of {prod(shape)} numbers" if shape else "one number"
            raise StudyError(
                f"{label}.{key} has shape {array.shape}; expected {what} for all "
                "bodies; numbers that differ from body to body need a distribution in [sample]"
            )

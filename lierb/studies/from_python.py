"""A study of a problem and a design that were made in Python: the tables that a file would have.

So everything that studies can do, they can do with it: the folder of the results says it all.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lierb import forces
from lierb.arrays import Array
from lierb.errors import ArgumentError, StudyError, told, unknown_name
from lierb.joints import JOINTS
from lierb.kernels.functions.function import Function
from lierb.kernels.mechanics.rows import parameters_of
from lierb.model import Problem
from lierb.sampling import Design
from lierb.studies.code import PREFIX, source_of
from lierb.studies.study import (
    ELEMENTS,
    NOTHING,
    InitialSection,
    IntegrateSection,
    OutputSection,
    Study,
)
from lierb.user_elements import Element

INTEGRATE, OUTPUT = tuple(IntegrateSection.model_fields), tuple(OutputSection.model_fields)
OF_JOINT = ("pitch", "length")  # what may be drawn of a joint that is made


def study_of(
    problem: Problem,
    design: Design,
    *,
    name: str = "study",
    initial: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Study:
    """The study of a problem whose numbers a design draws.

    design : its quantities are named as in a study's file, without `sample.`: "initial.omega",
        "body.mass", "forces.drag.linear", "observables.pointing_error.axis".
    initial : how all bodies start, but for what is drawn: omega, twist, coordinates, … as the table
        [initial] has them.
    settings : keys of [integrate], such as dt and t_end, and of [output]: part, compression.

    The functions with `@lierb.wrench` and the like must be at the top of a file, from which they
    can be loaded again. Raises StudyError for what no file can say.

    >>> import lierb
    >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    >>> ball = lierb.joints.spherical(body_point=(0.0, 0.0, 0.15))
    >>> spins = lierb.sampling.Direction(length=2.0)
    >>> design = lierb.sampling.Design({"initial.omega": spins}, n=1000)
    >>> study = lierb.study_of(lierb.Problem(box, ball), design, dt=1e-3, t_end=1.0)
    >>> print(study)  # doctest: +ELLIPSIS
    lierb.Study 'study': 1000 bodies on a spherical joint
    ...
    """
    if not isinstance(problem, Problem):
        raise ArgumentError(f"problem={told(problem)}; expected a lierb.Problem")
    if not isinstance(design, Design):
        raise ArgumentError(f"design={told(design)}; expected a lierb.sampling.Design")
    problem.require_unchanged()
    for key in settings:
        if key not in (*INTEGRATE, *OUTPUT):
            raise unknown_name("setting", key, (*INTEGRATE, *OUTPUT, "name", "initial"))
    for key in initial or {}:
        if key not in InitialSection.model_fields:
            raise unknown_name("initial", key, InitialSection.model_fields)
    code: dict[str, str] = {}
    tables: dict[str, Any] = {
        "name": name,
        "body": _body(problem, design),
        "joint": _joint(problem),
        "problem": {"gravity": _one("gravity", problem.gravity, 1)},
        "initial": dict(initial or {}),
        "sample": _sample(design),
        "integrate": {key: value for key, value in settings.items() if key in INTEGRATE},
        "output": {key: value for key, value in settings.items() if key in OUTPUT},
    }
    for table in ELEMENTS:
        elements = [_element(each, code) for each in getattr(problem, table)]
        tables["problem"][table] = _labelled(elements)
    study = Study.of(tables, code=code)
    _require_same(problem, study)
    return study


def _one(label: str, array: Array, item_axes: int = 0) -> Any:
    """The numbers of one body, of which all have the same."""
    if array.ndim > item_axes and len(array) > 1:
        raise StudyError(
            f"{label} has numbers of its own for {len(array)} bodies; in a study, what differs "
            "from body to body is drawn: name it among the quantities, as a distribution or "
            "lierb.sampling.Values"
        )
    return array.reshape(array.shape[array.ndim - item_axes :]).tolist()


def _body(problem: Problem, design: Design) -> dict[str, Any]:
    body = problem.body
    tables = {"mass": _one("mass", body.mass), "com": _one("com", body.com, 1)}
    if "body.second_moments" not in design.quantities:
        tables["inertia"] = _one("inertia", body.inertia, 2)
    return tables


def _joint(problem: Problem) -> dict[str, Any]:
    joint = problem.joint
    tables: dict[str, Any] = {
        "type": joint.name if joint.name in JOINTS else "from_rows",
        "ground_frame": _one("ground_frame", joint.ground_frame, 2),
        "body_frame": _one("body_frame", joint.body_frame, 2),
    }
    if tables["type"] == "from_rows":
        tables["rows"] = [str(row) for row in joint.rows]
    for name in parameters_of(joint.rows):
        tables[name] = _one(name, getattr(joint, name))
    return tables


def _sample(design: Design) -> dict[str, Any]:
    """The design, under the names that its quantities have in a file."""
    names = [name for name in design.quantities if name != NOTHING]
    if design.method != "random" and names != sorted(names):
        raise StudyError(
            f"the quantities of a {design.method} design are taken in the order of their names in "
            f"a study: give them so, {', '.join(sorted(names))}"
        )
    tables: dict[str, Any] = {"n": design.n, "seed": design.seed, "method": design.method}
    for name in names:
        section, _, key = name.rpartition(".")
        kind, _, label = section.partition(".")
        if kind == "joint" and key not in OF_JOINT:
            raise StudyError(
                f"{name}: a joint that is made has its frames; of it {' and '.join(OF_JOINT)} can "
                "be drawn. A study's file can draw points and axes: lierb.Study.of"
            )
        place = tables.setdefault(kind, {})
        if kind in ELEMENTS and label:
            place = place.setdefault(label, {})
        elif kind not in ("body", "joint", "problem", "initial") or label or not key:
            raise StudyError(
                f"{told(name)} is no quantity of a problem; expected names such as body.mass, "
                "initial.omega or forces.drag.linear"
            )
        place[key] = design.quantities[name]
    return tables


def _element(element: Element, code: dict[str, str]) -> dict[str, Any]:
    shapes = element.kind.shapes
    parameters = {
        name: _one(f"{element.name}.{name}", array, len(shapes[name]))
        for name, array in element.parameters.items()
    }
    if element.made_by is None:
        if any(isinstance(f, Function) for f in element.kind.functions):
            raise StudyError(
                f"{element.name} is made of a function of time, which no file can name; write it "
                "with @lierb.wrench in a file"
            )
        if isinstance(element.kind, forces.BodyWrench):
            parameters["frame"] = "body"
        return {"type": element.name, **parameters}
    file, text, name = source_of(element.made_by)
    if code.setdefault(file, text) != text:
        raise StudyError(f"two different files are called {file}; rename one of them")
    for taken in ("type", "name"):
        if taken in parameters:
            raise StudyError(f"{name}: its parameter {taken} needs another name in a study")
    table = {"type": f"{PREFIX}{file}:{name}", **parameters}
    return table if element.name == name else table | {"name": element.name}


def _labelled(elements: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """With names where several would have the same one: drag, drag_2, …"""
    seen: dict[str, int] = {}
    for element in elements:
        label = element.get("name") or element["type"].rpartition(":")[2]
        seen[label.lower()] = seen.get(label.lower(), 0) + 1
        if seen[label.lower()] > 1:
            element["name"] = f"{label}_{seen[label.lower()]}"
    return elements


def _require_same(problem: Problem, study: Study) -> None:
    """Raise StudyError where the files make other functions than those that the problem has."""
    made = study.batch(0, 1).problem
    for given, found in zip(problem.elements, made.elements, strict=True):
        if given.kind != found.kind and given.made_by is not None:
            raise StudyError(
                f"{given.name} is another function in its file than the one that the problem has: "
                "the file was edited since it was imported, or what the function refers to was set "
                "elsewhere; import it anew, or make that a parameter"
            )

"""Convert a problem and a design made in Python to the tables of a study's file.

Such a study has all features of a study from a file; its result folder describes it completely.
Numbers that are the defaults of `lierb.Body`, joints and `lierb.forces` are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from inspect import signature
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, LierbError, StudyError, brief, require_name
from lierb.kernels.functions.function import Function
from lierb.kernels.mechanics.passive_elements import INITIAL, TurnCounter
from lierb.kernels.mechanics.rows import parameters_of
from lierb.kernels.systems.plan import Stabilisation
from lierb.model import forces
from lierb.model.bodies.body import Body
from lierb.model.functions.elements import Element
from lierb.model.joints.joint import Joint
from lierb.model.joints.joint_type import JOINTS
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.numbers import labelled
from lierb.model.problem import Problem
from lierb.sampling import Design
from lierb.studies.description.changes import label_of
from lierb.studies.description.code import PREFIX, source_of
from lierb.studies.description.sections.bodies import POINTS
from lierb.studies.description.sections.running import IntegrateSection, OutputSection
from lierb.studies.description.sections.sampling import KEYS, KEYS_OF_LINK, OF_LINK, OF_MECHANISM
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import ELEMENTS
from lierb.studies.description.study_tables import NOTHING
from lierb.support.arrays import Array

INTEGRATE, OUTPUT = tuple(IntegrateSection.model_fields), tuple(OutputSection.model_fields)
NAMELESS = "study"  # name of a study without one
OF_JOINT = ("pitch", "length", *POINTS)  # sampled quantities of a joint made in Python


def study_of(
    problem: Problem | Mechanism,
    design: Design,
    *,
    name: str = NAMELESS,
    initial: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Study:
    """Make a study from a problem and a design that samples its numbers.

    Functions decorated with `@lierb.wrench` and the like must be at the top level of a file, so
    that they can be loaded again from there.

    Parameters
    ----------
    problem : Problem or Mechanism
        The problem.
    design : Design
        Quantities, named as in a study's file without `sample.`: "initial.omega", "body.mass",
        "forces.drag.linear", "observables.pointing_error.axis". Names of a mechanism's links and
        loops come first: "crank.body.mass", "rod.joint.body_point", "crank.initial.velocities".
    name : str, optional
        Name of the study.
    initial : dict, optional
        Start of all bodies, except for sampled quantities: omega, twist, coordinates, … as in the
        table [initial]. For a mechanism by link: {"crank": {"coordinates": 0.3}}. Open joints are
        then closed, to the nearest poses and twists; {"hold": ["crank"]} beside the links keeps the
        given coordinates and velocities of some, {"close": "never"} closes nothing.
    **settings : object
        Keys of [integrate], such as dt, rtol, save_at and t_end, and of [output]: part,
        compression.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    StudyError
        A file cannot describe the problem.

    Examples
    --------
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
    if not isinstance(problem, (Problem, Mechanism)):
        raise ArgumentError(
            f"problem={brief(problem)}; expected a lierb.Problem or a lierb.Mechanism"
        )
    if not isinstance(design, Design):
        raise ArgumentError(f"design={brief(design)}; expected a lierb.sampling.Design")
    if not (initial is None or isinstance(initial, Mapping)):
        raise ArgumentError(f"initial={brief(initial)}; expected a dictionary")
    problem.require_unchanged()
    for key in settings:
        require_name("setting", key, (*INTEGRATE, *OUTPUT, "name", "initial"))
    if isinstance(settings.get("stabilise"), Stabilisation):
        settings["stabilise"] = _stabilise(settings["stabilise"])
    code: dict[str, str] = {}
    elements = {
        table: _labelled([_element(each, code) for each in getattr(problem, table)])
        for table in ELEMENTS
    }
    tables: dict[str, Any] = {
        "name": name,
        "problem": {"gravity": _one("gravity", problem.gravity, 1), **elements},
        "sample": _sample(design, problem, _names_in_study(problem, elements)),
        "integrate": {key: value for key, value in settings.items() if key in INTEGRATE},
        "output": {key: value for key, value in settings.items() if key in OUTPUT},
    }
    if isinstance(problem, Mechanism):
        of_links, tables["initial"] = _starts(problem, initial or {})
        tables["problem"] |= _links_and_loops(problem, design, of_links)
    else:
        for key in initial or {}:
            require_name("initial", key, KEYS["initial"])
        tables["initial"] = dict(initial or {})
        tables["body"] = _body("", problem.body, design)
        tables["joint"] = _joint("", problem.joint, design)
    study = Study.of(tables, code=code)
    _require_same(problem, study)
    return study


def _stabilise(kept: Stabilisation) -> Any:
    rates = {"alpha": kept.alpha, "beta": kept.beta}
    return {"none": None, "baumgarte": rates}.get(kept.kind, kept.kind)


def _starts(
    mechanism: Mechanism, initial: Mapping[str, Any]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return the table `initial` of each link, and that of the study."""
    of_links, rest = {}, {}
    for key, value in initial.items():
        if key in OF_MECHANISM and not isinstance(value, Mapping):
            rest[key] = value
            continue
        require_name("initial", key, (*mechanism.names, *OF_MECHANISM))
        if not isinstance(value, Mapping):
            raise ArgumentError(
                f"initial[{key!r}]={brief(value)}; expected a dictionary, such as "
                "{'coordinates': 0.3, 'velocities': 1.0}"
            )
        for inner in value:
            require_name(f"initial[{key!r}]", inner, KEYS_OF_LINK["initial"])
        of_links[key] = dict(value)
    return of_links, rest


def _links_and_loops(
    mechanism: Mechanism, design: Design, initial: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """Return the tables of the links and the loops."""
    links = [
        {
            "name": link.name, "parent": link.parent,
            "body": _body(f"{link.name}.", link.body, design),
            "joint": _joint(f"{link.name}.", link.joint, design),
            "initial": initial.get(link.name, {}),
        }
        for link in mechanism.links
    ]  # fmt: skip
    loops = [
        {
            "name": loop.name, "body": loop.body, "parent": loop.parent,
            "joint": _joint(f"{loop.name}.", loop.joint, design),
        }
        for loop in mechanism.loops
    ]  # fmt: skip
    return {"links": links, "loops": loops}


def _one(label: str, array: Array, item_axes: int = 0) -> Any:
    """Return the numbers of one body. Raises StudyError if the bodies differ."""
    if array.ndim > item_axes and len(array) > 1:
        raise StudyError(
            f"{label} has numbers of its own for {len(array)} bodies; in a study, what differs "
            "from body to body is drawn: name it among the quantities, as a distribution or "
            "lierb.sampling.Values"
        )
    return array.reshape(array.shape[array.ndim - item_axes :]).tolist()


def _body(prefix: str, body: Body, design: Design) -> dict[str, Any]:
    """Return the table of a body.   prefix : prefix of the names of its quantities."""
    tables = {"mass": _one(f"{prefix}mass", body.mass)}
    com = _one(f"{prefix}com", body.com, 1)
    if any(com):
        tables["com"] = com
    if f"{prefix}body.second_moments" not in design.quantities:
        given, about = body.as_given()
        inertia = np.array(_one(f"{prefix}inertia", given, 2))
        moments = inertia.diagonal()
        is_principal = np.array_equal(inertia, np.diag(moments))
        tables["inertia"] = (moments if is_principal else inertia).tolist()
        if about == "com":
            tables["about"] = about
    return tables


def _joint(prefix: str, joint: Joint, design: Design) -> dict[str, Any]:
    tables: dict[str, Any] = {"type": joint.name if _is_in_catalogue(joint) else "from_rows"}
    on_body = np.array(_one(f"{prefix}body_frame", joint.body_frame, 2))
    on_ground = np.array(_one(f"{prefix}ground_frame", joint.ground_frame, 2))
    tables |= _frames(prefix, joint, on_body, on_ground, design)
    if tables["type"] == "from_rows":
        tables["rows"] = [str(row) for row in joint.rows]
    for name in parameters_of(joint.rows):
        tables[name] = _one(f"{prefix}{name}", getattr(joint, name))
    return tables


def _is_in_catalogue(joint: Joint) -> bool:
    """Return False for the joint of a user's rows, whatever its name."""
    return joint.name in JOINTS and joint.rows == JOINTS[joint.name].rows


def _frames(
    prefix: str, joint: Joint, on_body: Array, on_ground: Array, design: Design
) -> dict[str, Any]:
    """Return points and an axis that make a joint's frames to the bit, or else the frames.

    Of a joint with points that are drawn, the frames.
    """
    drawn = [point for point in POINTS if f"{prefix}joint.{point}" in design.quantities]
    if _is_in_catalogue(joint) and not drawn:
        points = {"body_point": on_body[:3, 3], "ground_point": on_ground[:3, 3]}
        chosen = {name: point.tolist() for name, point in points.items() if point.any()}
        sizes = {name: getattr(joint, name) for name in parameters_of(joint.rows)}
        for more in ({}, {"axis": on_body[:3, 2].tolist()}):
            with suppress(LierbError):  # of a joint that takes no axis
                made = JOINTS[joint.name](**chosen, **more, **sizes)
                same = ((made.body_frame, on_body), (made.ground_frame, on_ground))
                if all(np.array_equal(np.squeeze(a), b) for a, b in same):
                    return chosen | more
    frames = {}
    parallel = on_body.copy()
    parallel[:3, 3] = 0.0
    if not np.array_equal(on_body, np.eye(4)):
        frames["body_frame"] = on_body.tolist()
    # Beside body points that are drawn, a parallel frame would be made for each of them.
    if "body_point" in drawn or not np.array_equal(on_ground, parallel):
        frames["ground_frame"] = on_ground.tolist()
    return frames


def _sample(
    design: Design, problem: Problem | Mechanism, elements: Mapping[str, str]
) -> dict[str, Any]:
    """Return the table of the design; quantities are named as in a file.

    elements : names of the elements in the study, by those in `with_` and derivatives.
    """
    names = [name for name in design.quantities if name != NOTHING]
    if design.method != "random" and names != sorted(names):
        raise StudyError(
            f"the quantities of a {design.method} design are taken in the order of their names in "
            f"a study: give them so, {', '.join(sorted(names))}"
        )
    tables: dict[str, Any] = {"n": design.n, "seed": design.seed, "method": design.method}
    for name in names:
        *section, key = name.split(".")
        if not _is_section(section, problem):
            raise StudyError(_no_quantity(name, problem, elements))
        if section[-1] == "joint" and section[0] not in ELEMENTS and key not in OF_JOINT:
            raise StudyError(
                f"{name}: a joint that is made has its frames; of it {', '.join(OF_JOINT)} can be "
                "drawn. A study's file can draw axes as well: lierb.Study.of"
            )
        place = tables
        for part in section:
            place = place.setdefault(part, {})
        place[key] = design.quantities[name]
    return tables


def _is_section(section: list[str], problem: Problem | Mechanism) -> bool:
    """Return True if quantities of a section of the file can be sampled."""
    if len(section) == 2 and section[0] in ELEMENTS:
        return True
    if isinstance(problem, Problem):
        return section in (["body"], ["joint"], ["problem"], ["initial"])
    if len(section) != 2:
        return section == ["problem"]
    loops = [loop.name for loop in problem.loops]
    first, last = section
    return (first in problem.names and last in OF_LINK) or (first in loops and last == "joint")


def _no_quantity(name: str, problem: Problem | Mechanism, elements: Mapping[str, str]) -> str:
    owner, _, key = name.rpartition(".")
    if owner in elements:
        return f"{name}: a study names it {elements[owner]}.{key}, by the list of its element"
    if isinstance(problem, Problem):
        what, expected = "problem", "body.mass, initial.omega or forces.drag.linear"
    else:
        what, first = "mechanism", problem.names[0]
        expected = f"{first}.body.mass, {first}.initial.velocities or forces.drag.linear"
    listed = ", ".join(f"{own} ({label})" for label, own in elements.items())
    known = f"; its elements, and their names in with_, are {listed}" if elements else ""
    return f"{brief(name)} is no quantity of a {what}; expected names such as {expected}{known}"


def _names_in_study(
    problem: Problem | Mechanism, elements: Mapping[str, list[dict[str, Any]]]
) -> dict[str, str]:
    """Return the names of the elements in a study, `forces.drag_2`, by those in the problem."""
    names = [f"{table}.{label_of(each)}" for table, own in elements.items() for each in own]
    told: dict[str, str] = {}
    for (_, label, _), name in zip(labelled(problem), names, strict=True):
        told.setdefault(label, name)  # the first part of a motion of the ground
    return told


def _element(element: Element, code: dict[str, str]) -> dict[str, Any]:
    shapes = element.kind.shapes
    parameters = {
        name.removeprefix(INITIAL): _one(f"{element.name}.{name}", array, len(shapes[name]))
        for name, array in element.parameters.items()
    }
    placed = {"on": list(element.at)} if element.at else {}
    if isinstance(element.kind, TurnCounter):
        return {"type": "turns", "name": element.name, **parameters, **placed}
    if element.made_by is None:
        if any(isinstance(f, Function) for f in element.kind.functions):
            raise StudyError(
                f"{element.name} is made of a function of time, which a study file cannot name; "
                "write it with @lierb.wrench in a Python file"
            )
        assert isinstance(element.kind, forces.BuiltIn)
        kind = name = element.name
        known = signature(getattr(forces, name)).parameters
        defaults = {key: parameter.default for key, parameter in known.items()}
        parameters |= element.kind.options
    else:
        file, text, name = source_of(element.made_by)
        if code.setdefault(file, text) != text:
            raise StudyError(f"two different files are called {file}; rename one of them")
        kind, defaults = f"{PREFIX}{file}:{name}", dict(element.made_by.defaults)
    chosen = {
        key: value
        for key, value in parameters.items()
        if key not in defaults or not np.array_equal(value, defaults[key])
    }
    for taken in ("type", "name", "on"):
        if taken in chosen:
            raise StudyError(f"{name}: its parameter {taken} needs another name in a study")
    table = {"type": kind, **chosen, **placed}
    return table if element.name == name else table | {"name": element.name}


def _labelled(elements: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Name elements whose labels are equal: drag, drag_2, …"""
    seen: dict[str, int] = {}
    for element in elements:
        label = label_of(element)
        seen[label.lower()] = seen.get(label.lower(), 0) + 1
        if seen[label.lower()] > 1:
            element["name"] = f"{label}_{seen[label.lower()]}"
    return elements


def _require_same(problem: Problem | Mechanism, study: Study) -> None:
    """Raise StudyError if a function in a file differs from the one in the problem."""
    made = study.batch(0, 1).problem
    for given, again in zip(problem.elements, made.elements, strict=True):
        if given.kind != again.kind and given.made_by is not None:
            raise StudyError(
                f"{given.name} is another function in its file than in the problem: "
                "the file was edited since it was imported, or a value that the function uses "
                "was set elsewhere; import it anew, or make the value a parameter"
            )

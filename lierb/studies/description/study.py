"""Studies: a Monte Carlo run described by a TOML file, or by the same as Python objects.

    [body]         mass, inertia, com; or solid = "box" … with its size and density
    [joint]        type and frames, as `lierb.joints` takes them
    [problem]      gravity, forces, constraints, observables, events, states, controllers; for a
                   mechanism also links and loops
    [initial]      omega, point_velocity, twist, velocities; coordinates, rotation, place
    [sample]       n, seed, method; and for each sampled quantity a table [sample.SECTION.KEY]
    [integrate]    cspace, method, dt or rtol: one value or several, run as a product; t_end, …
    [output]       bodies in a part, compression

A file is checked as a whole before anything runs; what is wrong is named with its line and key.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import ConfigDict, PrivateAttr, ValidationError, model_validator

from lierb.errors import LierbError, PoseError, StudyError
from lierb.kernels.mechanics.elements import INITIAL
from lierb.model.mechanism.links import Link, Loop
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs import start_checks as checks
from lierb.runs.mechanism_checks import violation
from lierb.runs.options import check_options
from lierb.runs.starts import baumgarte
from lierb.runs.timing import ADAPTIVE_METHOD, MOST_SEED, has_jumps
from lierb.sampling import Design
from lierb.studies.description.changes import applied, index_of, path_of
from lierb.studies.description.code import Code, named, read_code, sha256_of_text
from lierb.studies.description.messages import Given, at, at_key, located, messages
from lierb.studies.description.sections import (
    RESERVED,
    SECTION,
    SHAPES,
    Baumgarte,
    BodySection,
    InitialSection,
    IntegrateSection,
    JointSection,
    OutputSection,
    ProblemSection,
    SampleSection,
    Section,
)
from lierb.studies.description.sources import LONGEST_STUDY, path_given
from lierb.studies.description.starting import AUTO, started, started_mechanism
from lierb.studies.description.stopping import Rule, rule_of
from lierb.studies.description.study_file import (
    ELEMENTS,
    TOO_LARGE,
    plain,
    plain_changes,
    read,
    tables_in,
)
from lierb.support.arrays import Array
from lierb.support.shown import FAILED, Lines, Shown, counted

TABLES = ("summary", "history", "events")
NEW_KEYS = ("rtol", "atol", "dt_min", "dt_max", "max_steps", "save_at", "discontinuities")
NOTHING = "nothing"  # a design draws something
HELD = ("links", "loops")  # what has a joint
PREVIEW = 8  # bodies that are made when a study is checked
MOST_SETTINGS = 1000  # each is looked at when a study is checked
Draws = dict[str, dict[str, Array]]  # by section and key


@dataclass(frozen=True)
class Setting:
    """One of the runs that a study's lists multiply out to."""

    cspace: str
    method: str
    dt: float | None  # of adaptive steps the first, None to have it chosen
    rtol: float | None = None  # None of fixed steps

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> Setting:
        """That of a row of a study's table."""
        return cls(row["cspace"], row["method"], row.get("dt"), row.get("rtol"))

    @property
    def column(self) -> str:
        """What tables tell steps by."""
        return "dt" if self.rtol is None else "rtol"

    @property
    def step(self) -> float:
        """dt, s, or rtol: the number in that column."""
        found = self.dt if self.rtol is None else self.rtol
        assert found is not None
        return found

    @property
    def step_told(self) -> str:
        return f"dt = {self.dt:g} s" if self.rtol is None else f"rtol = {self.rtol:g}"

    @property
    def label(self) -> str:
        return f"{self.cspace}, {self.method}, {self.step_told}"


@dataclass(frozen=True)
class Batch:
    """Some bodies of a study, ready for `lierb.integrate`."""

    problem: Problem | Mechanism
    twist0: Any  # (n, 6), of a mechanism by link
    pose0: Any  # (n, 4, 4), of a mechanism by link; None for the closed joint
    draws: dict[str, Array]

    @property
    def first(self) -> tuple[Any, Any]:
        """The first body alone, and its pose."""
        poses = self.pose0
        if isinstance(poses, dict):
            return self.problem.of_body(0), {name: pose[0] for name, pose in poses.items()}
        return self.problem.of_body(0), None if poses is None else poses[0]


class Study(Shown, Section):
    """A study, checked when it is made by `of` or `load`.

    Raises
    ------
    StudyError
        The study is wrong; the message names the key. It is a ValueError.

    Examples
    --------
    >>> import lierb
    >>> study = lierb.Study.of({
    ...     "body": {"solid": "box", "size": [0.1, 0.2, 0.3], "mass": 1.0},
    ...     "joint": {"type": "revolute", "axis": [0, 1, 0]},
    ...     "sample": {"n": 100, "initial": {"omega": {
    ...         "distribution": "normal", "mean": [0, 3, 0], "std": 0.1,
    ...     }}},
    ...     "integrate": {"dt": 1e-3, "t_end": 1.0},
    ... })
    >>> study.batch(0, 100).twist0.shape
    (100, 6)
    """

    model_config = SECTION | ConfigDict(
        json_schema_extra={
            "description": "A study of lierb.",
            "anyOf": [
                {"required": ["body", "joint"]},
                {"required": ["problem"], "properties": {"problem": {"required": ["links"]}}},
            ],
        }
    )

    name: str = "study"
    body: BodySection | None = None
    joint: JointSection | None = None
    problem: ProblemSection = ProblemSection()
    initial: InitialSection = InitialSection()
    sample: SampleSection = SampleSection(n=1)
    integrate: IntegrateSection
    output: OutputSection = OutputSection()
    _code: dict[str, str] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(
        cls,
        tables: dict[str, Any],
        source: str = "study",
        text: str = "",
        changes: Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
        code: Code | None = None,
    ) -> Study:
        """Make a study from the tables of its file.

        Parameters
        ----------
        tables : dict
            Tables of the file, see the page on the study file.
        source : str, optional
            Name of the file, for messages.
        text : str, optional
            Text of the file, for messages.
        changes : dict, optional
            Changes of the tables, by dotted keys: {"sample.n": 1000}.
        folder : path, optional
            Folder of the Python files that the study names. They are executed here.
        code : Code, optional
            Texts of these files, by name, in place of the folder.

        Returns
        -------
        Study
            The study.

        Raises
        ------
        StudyError
            The study is wrong; the message names the key.
        """
        given = Given(source, text, {})
        try:
            given = Given(source, text, plain_changes(changes or {}))
            tables = applied(plain(tables), given.changes)
            study = cls.model_validate(tables)
            files = study.files
            study = study.with_code(
                read_code(path_given(folder), files) if folder is not None else code or {}
            )
            study.check()
            study.require_effect(given.changes)
        except ValidationError as error:
            raise StudyError(messages(error, cls, tables, given)) from None
        except StudyError as error:
            raise StudyError(located(str(error), given)) from None
        return study

    @model_validator(mode="before")
    @classmethod
    def _as_in_a_file(cls, given: Any) -> Any:
        """What a study is made of can be written, however it was made."""
        return given if isinstance(given, Study) else _with_defaults(plain(given))

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Study:
        """Read a study from its TOML file.

        Parameters
        ----------
        path : path
            The file.
        changes : dict, optional
            Changes of its tables, by dotted keys: {"sample.n": 1000}.

        Returns
        -------
        Study
            The study.

        Raises
        ------
        StudyError
            The study is wrong; the message names line and key.
        ArgumentError
            The path is no path.
        OSError
            The file does not exist.
        """
        path = path_given(path)
        text = read(path)
        tables = {"name": path.stem} | tables_in(text, path.name)
        return cls.of(tables, path.name, text, changes, path.parent)

    def check(self) -> None:
        """Make the first bodies, and look at every setting, as a run will."""
        if len(self.to_toml().encode()) > LONGEST_STUDY:
            raise StudyError(f"study: is {TOO_LARGE}")
        self._check_kind()
        self._check_settings()
        with at("sample"):
            design = self.design
            batch = self.batch(0, min(PREVIEW, len(design)), design)
        if self.sample.stop_when is not None:
            rule_of(self.sample.stop_when, batch.problem, self.has_lane_clocks)
        for table in ELEMENTS:
            labels = [each.label.lower() for each in getattr(self.problem, table)]  # as SQL has it
            if len(set(labels)) < len(labels):
                raise StudyError(
                    f"problem.{table}: two have the same name; give each a name of its own"
                )
        with at("initial"), np.errstate(all="ignore"):
            self._check_start(batch)
        for setting in self.settings:
            with at_key("integrate", (*NEW_KEYS, "save_every")):
                check_options(batch.problem, **self.options(setting))
        if self.problem.controllers and self.sample.seed >= MOST_SEED:
            raise StudyError(
                f"sample.seed: is {self.sample.seed}; expected less than 2**53 with controllers, "
                "whose noise is drawn by it"
            )

    def _check_kind(self) -> None:
        """Whether it is of one body, or of a mechanism."""
        links = [each.name for each in self.problem.held()]
        self.sample.require_names(links)
        for loop in self.problem.loops:
            for section in {*(self.sample.model_extra or {}).get(loop.name, {})} - {"joint"}:
                raise StudyError(f"sample.{loop.name}.{section}: a loop has a joint, and no more")
        if self.problem.links:
            for name in links:
                if name.lower() in RESERVED:
                    raise StudyError(
                        f"problem: a link or loop is named {name}, as a table of [sample] is; "
                        "rename it"
                    )
            for key in ("body", "joint"):
                if getattr(self, key) is not None or getattr(self.sample, key):
                    raise StudyError(f"{key}: is of one body; of a mechanism each link has its own")
            for key in self.initial.given().keys() - {"close"}:
                raise StudyError(
                    f"initial.{key}: is of one body; of a mechanism each link has its own start, "
                    "[problem.links.initial]"
                )
            for key in self.sample.initial:
                raise StudyError(
                    f"sample.initial.{key}: is of one body; draw that of a link, "
                    f"sample.{links[0]}.initial.{key}"
                )
            return
        for key in ("body", "joint"):
            if getattr(self, key) is None:
                raise StudyError(f"{key}: is missing")
        if self.problem.loops:
            raise StudyError(
                "problem.loops: are of a mechanism, which has links: [[problem.links]]"
            )
        if self.initial.close is not None:
            raise StudyError("initial.close: is of a mechanism, whose loops are closed")

    def _check_start(self, batch: Batch) -> None:
        problem, t0 = batch.problem, self.integrate.t0
        if isinstance(problem, Problem):
            checks.require_consistent(problem, batch.twist0, batch.pose0, t0)
        elif error := violation(problem, batch.pose0, batch.twist0, t0):
            raise error

    def _check_settings(self) -> None:
        run = self.integrate
        if not (run.dt or run.is_adaptive):
            raise StudyError("integrate.dt: is missing; without rtol it is the step, s")
        if run.is_adaptive and len(run.dt) > 1:
            raise StudyError(
                f"integrate.dt: has {len(run.dt)} values; with rtol it is the first step, one of "
                "them or none: give several rtol, or leave rtol and atol out"
            )
        for key in ("cspace", "method", "dt", "rtol"):
            listed = getattr(run, key)
            if len(set(listed)) < len(listed):
                twice = next(each for n, each in enumerate(listed) if each in listed[:n])
                raise StudyError(f"integrate.{key}: {twice!r} is given twice; once will do")
        count = prod(len(each) for each in (run.cspace, run.method, run.steps))
        if count > MOST_SETTINGS:
            step = "rtol" if run.is_adaptive else "dt"
            raise StudyError(
                f"integrate: cspace, method and {step} make {count} settings; expected at most "
                f"{MOST_SETTINGS}: several studies, each in a folder of its own"
            )

    def require_effect(self, changes: Mapping[str, Any]) -> None:
        """Raises StudyError for a change of what every body draws for itself."""
        drawn = self.sample.quantities()
        for key in changes:
            path = path_of(key)
            if len(path) == 4 and path[0] == "problem" and path[1] in ELEMENTS:
                elements = getattr(self.problem, path[1])
                tables = [each.model_dump() for each in elements]
                each = elements[index_of(tables, path[2], f"problem.{path[1]}")]
                path = path[1], each.label, path[3]
            if len(path) == 5 and path[0] == "problem" and path[1] in HELD:
                held = getattr(self.problem, path[1])
                tables = [each.model_dump() for each in held]
                each = held[index_of(tables, path[2], f"problem.{path[1]}")]
                path = each.name, *path[3:]
            if ".".join(path) in drawn:
                raise StudyError(
                    f"{key}: has no effect, since each body draws its own; change "
                    f"sample.{'.'.join(path)}"
                )

    def _shown(self) -> tuple[str, Lines]:
        run = self.integrate
        *some, last = self.table_names
        tables = f"{', '.join(some)} and {last}" if some else last
        rows = [
            ("settings", settings_told(run)),
            ("times", f"{run.t0:g} … {run.t_end:g} s"),
            ("tables", f"{tables}, in parts of at most {counted(self.output.part, *BODIES)}"),
        ]
        try:
            count, quantities = counted(len(self.design), *BODIES), self.sample.quantities()
        except LierbError as error:  # made without `of`, and not checked
            return f"lierb.Study {self.name!r}", [*rows, (FAILED, str(error))]
        drawn = "\n".join(f"{path}: {value!r}" for path, value in quantities.items())
        rows.insert(0, ("sampled", drawn or "nothing"))
        if self.problem.links:
            several = self.kind.replace("mechanism", "mechanisms", 1)
            of_all = self.kind if len(self.design) == 1 else several
            return f"lierb.Study {self.name!r}: {len(self.design)} {of_all}", rows
        return f"lierb.Study {self.name!r}: {count} on a {self.kind}", rows

    @property
    def kind(self) -> str:
        """What each of its bodies is on: `spherical joint`, `mechanism of 3 links and 1 loop`."""
        if self.joint is not None:
            return f"{self.joint.type} joint"
        parts = [counted(len(self.problem.links), "link")]
        if self.problem.loops:
            parts.append(counted(len(self.problem.loops), "loop"))
        return f"mechanism of {' and '.join(parts)}"

    __str__ = Shown.__repr__

    @property
    def design(self) -> Design:
        """Design of the table [sample]."""
        quantities = self.sample.quantities() or {NOTHING: 0.0}
        return Design(quantities, n=self.sample.n, seed=self.sample.seed, method=self.sample.method)

    @property
    def settings(self) -> list[Setting]:
        """Settings that are run, a list of the product of its c-spaces, methods and steps."""
        run = self.integrate
        each = product(run.cspace, run.method, run.steps)
        return [Setting(cspace, method, *step) for cspace, method, step in each]

    @property
    def has_lane_clocks(self) -> bool:
        """Whether each trajectory has steps of its own."""
        run, has = self.integrate, self.problem
        given = (run.save_at, run.max_steps, run.discontinuities)
        is_timed = run.is_adaptive or any(x is not None for x in given)
        if is_timed or has.events or has.states or has.controllers:
            return True
        return bool(self.files) and has_jumps(self.batch(0, 1).problem)

    def options(self, setting: Setting) -> dict[str, Any]:
        """What `lierb.integrate` is called with, beside the batch."""
        run = self.integrate
        kept = run.stabilise
        return {
            "stabilise": baumgarte(**kept.model_dump()) if isinstance(kept, Baumgarte) else kept,
            "cspace": setting.cspace, "method": setting.method, "dt": setting.dt,
            "t_end": run.t_end, "t0": run.t0, "update": run.update, "solver": run.solver,
            "save_every": run.save_every, "save_at": run.times, "measure_every": run.measure_every,
            "record": tuple(run.record), "rtol": setting.rtol, "atol": run.atol,
            "dt_min": run.dt_min, "dt_max": run.dt_max, "max_steps": run.max_steps,
            "discontinuities": run.discontinuities,
        }  # fmt: skip

    @property
    def table_names(self) -> tuple[str, ...]:
        """The tables that it leaves."""
        return tables_of_study(self.model_dump())

    @property
    def files(self) -> tuple[str, ...]:
        """The Python files that it names."""
        there = (named(element.type) for _, element in self.problem.elements())
        return tuple(sorted({each.file for each in there if each}))

    @property
    def code(self) -> Code:
        """Their texts, by name."""
        return {file: self._code[file] for file in self.files if file in self._code}

    @property
    def stopping_rule(self) -> Rule | None:
        """With how many bodies it ends before its time."""
        text = self.sample.stop_when
        if text is None:
            return None
        return rule_of(text, self.batch(0, 1).problem, self.has_lane_clocks)

    def with_code(self, code: Code) -> Study:
        """The study with these texts of its Python files."""
        made = self.model_copy()
        made._code = dict(code)
        return made

    def fingerprints(self) -> dict[str, str]:
        """Of the functions in its files, by the names of what they make: what they compute."""
        problem = self.batch(0, 1).problem
        made = {table: getattr(problem, table) for table in ELEMENTS}
        return {
            f"{table}.{section.label}": " ".join(f.fingerprint for f in element.kind.functions)
            for table, elements in made.items()
            for section, element in zip(getattr(self.problem, table), elements, strict=True)
            if named(section.type)
        }

    def batch(self, first: int, count: int, design: Design | None = None) -> Batch:
        """Make and start the bodies first, first + 1, …, first + count − 1.

        Parameters
        ----------
        first : int
            Number of the first body.
        count : int
            Number of bodies.
        design : Design, optional
            The study's `design`, which would be made again otherwise.

        Returns
        -------
        Batch
            `problem`, `pose0` and `twist0` of these bodies, for `lierb.integrate`.
        """
        draws = (design or self.design).draw(first, count)
        draws.pop(NOTHING, None)
        own: Draws = {}
        for path, values in draws.items():
            section, _, key = path.rpartition(".")
            self._check_shape(path, section, key, values.shape[1:])
            own.setdefault(section, {})[key] = values
        made = self._elements(own)
        ready: tuple[Problem | Mechanism, Any, Any]
        if self.problem.links:
            ready = self._mechanism(own, made, first, count)
        else:
            ready = self._one_body(own, made, count)
        if own:
            table, _, _ = next(iter(own)).partition(".")
            names = [each.label for each in getattr(self.problem, table)]
            raise StudyError(
                f"sample.{next(iter(own))}: there is no such {table.removesuffix('s')}; known: "
                f"{names}"
            )
        problem, twist0, pose0 = ready
        return Batch(problem, twist0, pose0, draws)

    def _elements(self, own: Draws) -> dict[str, list[Any]]:
        """Forces, constraints and observables, with what their bodies draw of them."""
        made: dict[str, list[Any]] = {table: [] for table in ELEMENTS}
        for table, element in self.problem.elements():
            with at(f"problem.{table}"):
                drawn = own.pop(f"{table}.{element.label}", {})
                made[table].append(element.make(drawn, self._code))
            _require_one(f"problem.{table}.{element.label}", made[table][-1], drawn)
            for key, values in drawn.items():
                shapes = made[table][-1].kind.shapes
                shape = shapes[key] if key in shapes else shapes[f"{INITIAL}{key}"]
                _require_shape(f"{table}.{element.label}.{key}", values.shape[1:], shape)
        return made

    def _one_body(
        self, own: Draws, made: dict[str, list[Any]], count: int
    ) -> tuple[Problem, Array, Array | None]:
        assert self.body is not None
        assert self.joint is not None
        with at("body"):
            body = self.body.make(own.pop("body", {}))
        with at("joint"):
            joint = self.joint.make(own.pop("joint", {}))
        with at("problem"):
            gravity = own.pop("problem", {}).get("gravity", self.problem.gravity)
            problem = Problem(body, joint, gravity, **made)
        with at("initial"):
            initial = self.initial.given() | own.pop("initial", {})
            twist0, pose0 = started(problem, initial, self.integrate.t0)
        if twist0.ndim == 1:
            twist0 = np.broadcast_to(twist0, (count, 6))
        return problem, twist0, pose0

    def _mechanism(
        self, own: Draws, made: dict[str, list[Any]], first: int, count: int
    ) -> tuple[Mechanism, dict[str, Array], dict[str, Array]]:
        links, loops, initial = [], [], {}
        for each in self.problem.links:
            with at(f"problem.links.{each.name}.body"):
                body = each.body.make(own.pop(f"{each.name}.body", {}))
            with at(f"problem.links.{each.name}.joint"):
                joint = each.joint.make(own.pop(f"{each.name}.joint", {}))
            with at("problem"):
                links.append(Link(each.name, body, joint, each.parent))
            initial[each.name] = each.initial.given() | own.pop(f"{each.name}.initial", {})
        for loop in self.problem.loops:
            with at(f"problem.loops.{loop.name}.joint"):
                joint = loop.joint.make(own.pop(f"{loop.name}.joint", {}))
            with at("problem"):
                loops.append(Loop(loop.name, joint, loop.body, loop.parent))
        with at("problem"):
            gravity = own.pop("problem", {}).get("gravity", self.problem.gravity)
            mechanism = Mechanism(links, loops, gravity, **made)
        close, t0 = self.initial.close or AUTO, self.integrate.t0
        with at("initial"):
            try:
                twists, poses = started_mechanism(mechanism, initial, close, count, t0)
            except PoseError as error:  # of a number in this part
                numbered = re.sub(
                    r"^pose\b(?:\[(\d+)\])?",
                    lambda found: f"trajectory {first + int(found[1] or 0)}",
                    str(error),
                )
                raise PoseError(numbered) from None
        return mechanism, twists, poses

    def changed(self, changes: Mapping[str, Any]) -> Study:
        """Return the study with changes of its tables.

        Parameters
        ----------
        changes : dict
            Changes by dotted keys: {"sample.n": 1000}.

        Returns
        -------
        Study
            The changed study.

        Raises
        ------
        StudyError
            The changed study is wrong.
        """
        return Study.of(self._tables(), changes=changes, code=self._code) if changes else self

    def to_toml(self) -> str:
        """Write the text of a file of the same study.

        Returns
        -------
        str
            TOML.
        """
        return tomli_w.dumps(self._tables())

    def _tables(self) -> dict[str, Any]:
        tables = self.model_dump(exclude_none=True, exclude_defaults=True)
        if self.problem.links:  # whose default is another one
            tables["integrate"]["cspace"] = self.integrate.cspace
        return tables

    def _check_shape(self, path: str, section: str, key: str, shape: tuple[int, ...]) -> None:
        """Whether a draw is what its key takes: else bodies might be taken for components."""
        first, _, of_link = section.partition(".")
        if first in ELEMENTS or (key == "inertia" and shape == (3, 3)):
            return
        is_free = key in ("coordinates", "velocities")
        if of_link and is_free and shape == ():  # of a joint that has one
            return
        _require_shape(path, shape, SHAPES.get(key, (3,)), free=is_free)

    def digest(self) -> str:
        """Compute a checksum of everything that the results depend on.

        Returns
        -------
        str
            Hexadecimal digits.
        """
        tables = self.model_dump(exclude={"name"})
        for table, keys in _news(tables):
            for key in keys:
                if table[key] in (None, [], {}):  # studies without have the digest they had
                    del table[key]
        if self.sample.stop_when is None:
            del tables["sample"]["stop_when"]
        if self.code:
            tables["code"] = self.code_digests
        return sha256_of_text(json.dumps(tables, sort_keys=True))

    @property
    def code_digests(self) -> dict[str, str]:
        """SHA-256 of its Python files."""
        return {file: sha256_of_text(text) for file, text in self.code.items()}


def _news(tables: dict[str, Any]) -> Iterator[tuple[dict[str, Any], tuple[str, ...]]]:
    """Keys that studies have not had at first, with the table that each is in."""
    for section in ("problem", "sample"):
        yield tables[section], ELEMENTS[1:]
    yield tables["problem"], HELD
    yield tables["initial"], ("close",)
    yield tables["integrate"], ("stabilise", *NEW_KEYS)
    for key in ("body", "joint"):
        if tables[key] is None:
            yield tables, (key,)
    for table in ELEMENTS:
        for element in tables["problem"].get(table, []):
            yield element, ("on",)
    if tables.get("joint"):
        yield tables["joint"], ("parent_point", "parent_frame")


def _with_defaults(tables: Any) -> Any:
    """A mechanism is integrated on its joints' subgroups where no c-space is given; adaptive steps
    are DOP853's where no method is.
    """
    match tables:
        case {"problem": {"links": [*_]}, "integrate": {**run}} if "cspace" not in run:
            tables = tables | {"integrate": run | {"cspace": ["reduced"]}}
    match tables:
        case {"integrate": {**run}} if "method" not in run and {"rtol", "atol"} & run.keys():
            tables = tables | {"integrate": run | {"method": [ADAPTIVE_METHOD]}}
    return tables


BODIES = ("body", "bodies")


def settings_told(run: IntegrateSection) -> str:
    """The settings as the product that they are."""
    steps = ", ".join(f"{dt if rtol is None else rtol:g}" for dt, rtol in run.steps)
    told = f"rtol = {steps}" if run.is_adaptive else f"dt = {steps} s"
    return f"{', '.join(run.cspace)} × {', '.join(run.method)} × {told}"


def tables_of_study(study: Mapping[str, Any]) -> tuple[str, ...]:
    """The tables that it leaves, of its own tables as `model_dump` has them."""
    run = study["integrate"]
    saves = run["save_every"] is not None or run.get("save_at") is not None
    is_there = (True, saves, bool(study.get("problem", {}).get("events")))
    return tuple(name for name, there in zip(TABLES, is_there, strict=True) if there)


def _require_one(label: str, element: Any, drawn: Mapping[str, Array]) -> None:
    """Raise StudyError for numbers of each body's own that are not drawn: which bodies have them is
    not to depend on how a study is cut into parts.
    """
    for name, array in element.parameters.items():
        key, shape = name.removeprefix(INITIAL), element.kind.shapes[name]
        if key not in drawn and array.ndim > len(shape):
            what = f"a list of {prod(shape)} numbers" if shape else "one number"
            raise StudyError(
                f"{label}.{key} has shape {array.shape}; expected {what}, of all bodies; what "
                "differs from body to body is a distribution in [sample]"
            )


def _require_shape(
    path: str, shape: tuple[int, ...], expected: tuple[int, ...], free: bool = False
) -> None:
    fits = len(shape) == 1 if free else shape == expected
    if not fits:
        what = "a list of numbers" if free or expected == (3,) else f"shape {expected}"
        what = "one number" if expected == () else what
        raise StudyError(f"sample.{path}: a draw has shape {shape}; expected {what}")


def tables_of(study: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Every setting by its path, to compare two studies."""

    def walk(path: str, value: Any) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield from walk(f"{path}.{key}" if path else key, inner)
        else:
            yield path, value

    return walk("", study)

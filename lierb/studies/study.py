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

import inspect
import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    PrivateAttr,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from lierb import api, bodies, forces, joints
from lierb.arrays import Array, as_floats
from lierb.errors import ArgumentError, LierbError, PoseError, StudyError, unknown_name
from lierb.joints import Joint
from lierb.kernels.mechanics.elements import INITIAL
from lierb.links import GROUND, Link, Loop
from lierb.mechanism import Mechanism
from lierb.mechanism_checks import violation
from lierb.model import Body, Problem
from lierb.runs import checks
from lierb.runs.mechanisms import baumgarte
from lierb.runs.timing import ADAPTIVE_METHOD, MOST_SEED, RTOL
from lierb.sampling import Design, inertia_of
from lierb.sampling.distributions import DISTRIBUTIONS, as_distribution
from lierb.shown import FAILED, Lines, Shown, counted
from lierb.studies.changes import applied, index_of, path_of, written
from lierb.studies.code import (
    EXPECTED,
    PATTERN,
    Code,
    function_of,
    named,
    read_code,
    sha256_of_text,
)
from lierb.studies.sources import LONGEST_STUDY, path_given
from lierb.studies.starting import AUTO, started, started_mechanism
from lierb.studies.stopping import Rule, rule_of
from lierb.studies.study_file import (
    LARGEST,
    TOO_LARGE,
    line_of,
    plain,
    plain_changes,
    read,
    shortened,
    tables_in,
)
from lierb.studies.times import SaveAt, saved_times

TABLES = ("summary", "history", "events")
NEW_KEYS = ("rtol", "atol", "dt_min", "dt_max", "max_steps", "save_at")
NOTHING = "nothing"  # a design draws something
ELEMENTS = ("forces", "constraints", "observables", "events", "states", "controllers")
HELD = ("links", "loops")  # what has a joint
OF_LINK = ("body", "joint", "initial")  # what can be drawn of a link; of a loop its joint
MOST_LINKS = 1000
PREVIEW = 8  # bodies that are made when a study is checked
MOST_SETTINGS = 1000  # each is looked at when a study is checked
MOST_FORCES = 100  # all are in one kernel
MOST_TOLD = 10  # of the things that are wrong
POINTS = {  # of a joint, and the frames whose origins they are
    "body_point": "body_frame",
    "ground_point": "ground_frame",
    "parent_point": "ground_frame",
}
Draws = dict[str, dict[str, Array]]  # by section and key
Numbers = float | list[float] | list[list[float]]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _as_whole(value: Any) -> Any:
    """1e6 is a whole number; one that no file could hold, written out, is none."""
    if isinstance(value, float) and value.is_integer() and abs(value) <= LARGEST:
        return int(value)
    return value


Whole = BeforeValidator(_as_whole)
Count = Annotated[PositiveInt, Whole]
Frame = list[list[float]]
# text is no number, and neither is inf or NaN
SECTION = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Section(BaseModel):
    """A table of the file."""

    model_config = SECTION

    def given(self) -> dict[str, Any]:
        """What is set in it."""
        return {k: v for k, v in self.model_dump().items() if v is not None}


class BodySection(Section):
    """Mass properties, or a homogeneous solid of `lierb.bodies`."""

    solid: Literal["box", "cylinder", "rod", "sphere"] | None = None
    mass: float | None = None
    inertia: Numbers | None = None
    second_moments: Vector | None = None
    com: Vector | None = None
    size: Vector | None = None
    radius: float | None = None
    length: float | None = None
    density: float | None = None

    def make(self, sampled: dict[str, Array]) -> Body:
        values = self.given() | sampled
        if "inertia" in sampled and sampled["inertia"].ndim == 2:  # principal moments
            values["inertia"] = sampled["inertia"][:, :, None] * np.eye(3)
        if "second_moments" in values:
            if "inertia" in values:
                raise ArgumentError("give inertia or second_moments, not both")
            values["inertia"] = inertia_of(values.pop("second_moments"))
        if sampled and "inertia" in values:
            given = as_floats("inertia", values["inertia"])
            # a matrix is that of all, also where there are three
            values["inertia"] = given[None] if given.shape == (3, 3) else given
        solid = values.pop("solid", None)
        made: Body = _called("body", Body if solid is None else getattr(bodies, solid), values)
        return made


class JointSection(Section):
    """A joint of the catalogue, or `type = "from_rows"` with its rows."""

    type: str
    rows: list[str] | None = None
    body_point: Vector | None = None
    ground_point: Vector | None = None
    axis: Vector | None = None
    slot: Vector | None = None
    second_axis: Vector | None = None
    pitch: float | None = None
    length: float | None = None
    body_frame: Frame | None = None
    ground_frame: Frame | None = None
    parent_point: Vector | None = None
    parent_frame: Frame | None = None

    def make(self, sampled: dict[str, Array]) -> Joint:
        values = self.given() | sampled
        for point, frame in POINTS.items():
            if point in sampled and frame in values:  # the frame, moved to where the point is
                values[frame] = _moved(values[frame], values.pop(point))
        name = values.pop("type")
        if name not in joints.JOINTS and name != "from_rows":
            raise unknown_name("type", name, (*joints.JOINTS, "from_rows"))
        make = joints.from_rows if name == "from_rows" else joints.JOINTS[name]
        made: Joint = _called("joint", make, values)
        return made


def _moved(frame: Any, places: Array) -> Array:
    frames = np.tile(np.asarray(frame, dtype=float), (len(places), 1, 1))
    frames[:, :3, 3] = places
    return frames


def _type_of_force(given: str) -> str:
    if given in forces.FORCE_UNITS or named(given):
        return given
    known = ", ".join(map(repr, forces.FORCE_UNITS))
    raise PydanticCustomError("type_of_force", f"input should be {known} or {EXPECTED}")


def _type_of_function(given: str) -> str:
    if named(given):
        return given
    raise PydanticCustomError("type_of_function", f"input should be {EXPECTED}")


OF_FUNCTION = {"type": "string", "pattern": PATTERN}
OF_FORCE = {"anyOf": [{"enum": [*forces.FORCE_UNITS], "type": "string"}, OF_FUNCTION]}


def _one_or_several(kind: str) -> tuple[Any, Any]:
    """Validator and schema of a list for which one value will do."""
    one = {"type": kind}
    return BeforeValidator(_as_list), WithJsonSchema(
        {"anyOf": [one, {"type": "array", "items": one}]}
    )


Names = Annotated[list[str], *_one_or_several("string")]
Several = Annotated[list[float], *_one_or_several("number")]


class ElementSection(BaseModel):
    """What a problem has in a list; with its parameters, and a `name` if there are several.

    on : of a mechanism, the link where it acts, or the two, or whose joint it acts about.
    """

    model_config = SECTION | ConfigDict(extra="allow")

    table: ClassVar[str]
    type: Annotated[str, AfterValidator(_type_of_function), WithJsonSchema(OF_FUNCTION)]
    name: str | None = None
    on: Annotated[Names, Field(min_length=1, max_length=2)] | None = None

    @property
    def label(self) -> str:
        return self.name or self.type.rpartition(":")[2]

    def make(self, sampled: dict[str, Array], code: Code) -> Any:
        """What it describes, by a function of lierb's or of the study's files."""
        values = dict(self.model_extra or {}) | sampled
        if named(self.type):
            made = function_of(self.table, self.type, code)(**values)
        else:
            made = _called(f"{self.table}.{self.label}", getattr(forces, self.type), values)
        return made.on(*self.on) if self.on else made


class ForceSection(ElementSection):
    """A force of `lierb.forces`, or a function with `@lierb.wrench` in a file beside the study."""

    table = "forces"
    type: Annotated[str, AfterValidator(_type_of_force), WithJsonSchema(OF_FORCE)]


class ConstraintSection(ElementSection):
    """A function with `@lierb.constraint` in a file beside the study."""

    table = "constraints"


class ObservableSection(ElementSection):
    """A function with `@lierb.observable` in a file beside the study; `name` is its column's."""

    table = "observables"

    def make(self, sampled: dict[str, Array], code: Code) -> Any:
        made = super().make(sampled, code)
        return made.named(self.name) if self.name else made


class EventSection(ElementSection):
    """A function with `@lierb.event` in a file beside the study; `name` is its in the tables."""

    table = "events"

    def make(self, sampled: dict[str, Array], code: Code) -> Any:
        made = super().make(sampled, code)
        return made.named(self.name) if self.name else made


class StatesSection(ElementSection):
    """A function with `@lierb.states` in a file beside the study; with initial values."""

    table = "states"


class ControllerSection(ElementSection):
    """A function with `@lierb.controller` in a file beside the study; with `every` and the like."""

    table = "controllers"


class LinkStart(Section):
    """How a link starts. Its pose: coordinates, or rotation and place, or pose; its velocities.

    coordinates : of its joint; velocities : their rates. A number where there is one.
    rotation, place : its joint frame seen from that of its parent, 3×3, and m.
    pose : in the ground frame, 4×4.   omega, twist : in its own axes.
    """

    coordinates: float | list[float] | None = None
    rotation: list[Vector] | None = None
    place: Vector | None = None
    pose: Frame | None = None
    velocities: float | list[float] | None = None
    omega: Vector | None = None
    twist: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None


class LinkSection(Section):
    """A link of a mechanism: its body, its joint on what it hangs on, and its start."""

    name: str
    parent: str = GROUND
    body: BodySection
    joint: JointSection
    initial: LinkStart = LinkStart()


class LoopSection(Section):
    """A joint beside those of the links, between two of them or one and the ground."""

    name: str
    body: str
    parent: str = GROUND
    joint: JointSection


class ProblemSection(Section):
    gravity: Vector = [0.0, 0.0, 0.0]
    links: Annotated[list[LinkSection], Field(max_length=MOST_LINKS)] = []
    loops: Annotated[list[LoopSection], Field(max_length=MOST_LINKS)] = []
    forces: Annotated[list[ForceSection], Field(max_length=MOST_FORCES)] = []
    constraints: Annotated[list[ConstraintSection], Field(max_length=MOST_FORCES)] = []
    observables: Annotated[list[ObservableSection], Field(max_length=MOST_FORCES)] = []
    events: Annotated[list[EventSection], Field(max_length=MOST_FORCES)] = []
    states: Annotated[list[StatesSection], Field(max_length=MOST_FORCES)] = []
    controllers: Annotated[list[ControllerSection], Field(max_length=MOST_FORCES)] = []

    def elements(self) -> Iterator[tuple[str, ElementSection]]:
        """Each with the name of its list."""
        for table in ELEMENTS:
            for element in getattr(self, table):
                yield table, element

    def held(self) -> Iterator[LinkSection | LoopSection]:
        """The links, and after them the loops."""
        yield from self.links
        yield from self.loops


class InitialSection(Section):
    """The start. Velocities: omega and point_velocity, or twist, or velocities. Pose: see below.

    coordinates : of the joint, in the order of `Joint.coordinate_names`; velocities : their rates.
    rotation, place : the body's joint frame seen from the ground's, 3×3, and m.

    Of a mechanism only `close`: "auto" closes what is open, to the nearest pose and twist by the
    masses; "never" leaves it. How each link starts its own table says, [problem.links.initial].
    """

    close: Literal["auto", "never"] | None = None
    omega: Vector | None = None
    point_velocity: Vector | None = None
    twist: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    velocities: list[float] | None = None
    coordinates: list[float] | None = None
    rotation: list[Vector] | None = None
    place: Vector | None = None


class SampleSection(BaseModel):
    """How many bodies, and what each draws; quantities are [sample.SECTION.KEY] tables.

    Of a mechanism's links and loops they are [sample.NAME.SECTION.KEY], as sample.rod.body.mass.

    stop_when : with how many of them the study ends before its time; see `lierb.studies.stopping`.
    """

    model_config = SECTION | ConfigDict(
        extra="allow",
        json_schema_extra={
            "additionalProperties": {
                "type": "object",
                "properties": {name: {"type": "object"} for name in OF_LINK},
                "additionalProperties": False,
            }
        },
    )

    n: Count | None = None
    seed: Annotated[NonNegativeInt, Whole] = 0
    method: Literal["random", "sobol", "saltelli", "grid"] = "random"
    stop_when: str | None = None
    body: dict[str, Any] = {}
    joint: dict[str, Any] = {}
    problem: dict[str, Any] = {}
    forces: dict[str, dict[str, Any]] = {}
    constraints: dict[str, dict[str, Any]] = {}
    observables: dict[str, dict[str, Any]] = {}
    events: dict[str, dict[str, Any]] = {}
    states: dict[str, dict[str, Any]] = {}
    controllers: dict[str, dict[str, Any]] = {}
    initial: dict[str, Any] = {}

    def quantities(self) -> dict[str, Any]:
        """Distributions by their path, such as `initial.omega` or `forces.drag.linear`."""
        tables = {name: getattr(self, name) for name in ("body", "joint", "problem", "initial")}
        tables |= dict(self._of_held())
        for kind in ELEMENTS:
            tables |= {f"{kind}.{name}": table for name, table in getattr(self, kind).items()}
        found = {}
        for section, table in tables.items():
            known = _known_keys(section)
            for key, value in table.items():
                path = f"sample.{section}.{key}"
                if path in found or (known is not None and key not in known):
                    raise StudyError(f"{path}: unknown key{_suggestion(key, list(known or ()))}")
                found[f"{section}.{key}"] = _distribution(path, value)
        return dict(sorted(found.items()))  # tables have no order, points of a sequence do

    def _of_held(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Tables of links and loops by their path, such as `rod.body`."""
        for name, tables in (self.model_extra or {}).items():
            if not isinstance(tables, dict):
                raise StudyError(f"sample.{name}: unknown key{_suggestion(name, _sampled())}")
            for section, table in tables.items():
                if section not in OF_LINK or not isinstance(table, dict):
                    raise StudyError(
                        f"sample.{name}.{section}: unknown key{_suggestion(section, [*OF_LINK])}"
                    )
                yield f"{name}.{section}", table

    def require_names(self, names: Collection[str]) -> None:
        """Raise StudyError for tables of what is no link and no loop of the study's."""
        for name in self.model_extra or {}:
            if name not in names:
                raise StudyError(
                    f"sample.{name}: unknown key{_suggestion(name, [*names, *_sampled()])}"
                )


def _sampled() -> list[str]:
    return [*SampleSection.model_fields]


def _known_keys(section: str) -> Collection[str] | None:
    """What can be sampled there; None of what an element has, which it knows itself."""
    first, _, last = section.partition(".")
    if first in ELEMENTS:
        return None
    return KEYS_OF_LINK[last] if last else KEYS[first]


class Baumgarte(Section):
    """Rates of Baumgarte's stabilisation, 1/s."""

    alpha: float
    beta: float


class IntegrateSection(Section):
    """As `lierb.integrate` takes it; cspace, method, dt and rtol may be lists, run as a product.

    With rtol or atol steps are adaptive, and dt is the first of them.
    """

    model_config = SECTION | ConfigDict(
        json_schema_extra={"anyOf": [{"required": [key]} for key in ("dt", "rtol", "atol")]}
    )

    t_end: float
    t0: float = 0.0
    dt: Several = []
    rtol: Several = []
    atol: float | dict[str, float] | None = None
    dt_min: float | None = None
    dt_max: float | None = None
    max_steps: Count | None = None
    cspace: Names = Field(default=["SE3"], min_length=1)
    method: Names = Field(default=["RK4"], min_length=1)
    update: str = "local"
    solver: str = "auto"
    stabilise: Literal["project"] | Baumgarte | None = None
    save_every: Count | None = None
    save_at: SaveAt | None = None
    measure_every: Count = 1
    record: list[str] = []

    @property
    def is_adaptive(self) -> bool:
        return bool(self.rtol) or self.atol is not None

    @property
    def saves(self) -> bool:
        """Whether there is a history."""
        return self.save_every is not None or self.save_at is not None

    @property
    def times(self) -> Array | None:
        """Of the rows of the history, s; None where they are not chosen by time."""
        return None if self.save_at is None else saved_times(self.save_at, self.t0, self.t_end)

    @property
    def steps(self) -> list[tuple[float | None, float | None]]:
        """Each dt, or of adaptive steps each rtol with the first step."""
        if not self.is_adaptive:
            return [(dt, None) for dt in self.dt]
        first = self.dt[0] if self.dt else None
        return [(first, rtol) for rtol in self.rtol or [RTOL]]


class OutputSection(Section):
    part: Count = 16384  # bodies
    compression: Literal["none", "snappy", "zstd"] = "snappy"


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
    """A study, checked when it is made; see the module for its tables.

    Raises StudyError (a ValueError) that names what is wrong.

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
        """A study from the tables of its file; `source` and `text` are for messages.

        changes : of the tables, by dotted keys (see `lierb.studies.changes`): {"sample.n": 1000}.
        folder : where the Python files are that it names; or code : their texts, by name. Whatever
            these files do is done here.
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
            raise StudyError(_messages(error, tables, given)) from None
        except StudyError as error:
            raise StudyError(_located(str(error), given)) from None
        return study

    @model_validator(mode="before")
    @classmethod
    def _as_in_a_file(cls, given: Any) -> Any:
        """What a study is made of can be written, however it was made."""
        return given if isinstance(given, Study) else _with_defaults(plain(given))

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Study:
        """A study from its TOML file, with changes by dotted keys: {"sample.n": 1000}.

        Raises StudyError, ArgumentError for what is no path, OSError where there is no file.
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
        with _at("sample"):
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
        with _at("initial"), np.errstate(all="ignore"):
            self._check_start(batch)
        for setting in self.settings:
            with _at_key("integrate", (*NEW_KEYS, "save_every")):
                api.check_options(batch.problem, **self.options(setting))
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
        quantities = self.sample.quantities() or {NOTHING: 0.0}
        return Design(quantities, n=self.sample.n, seed=self.sample.seed, method=self.sample.method)

    @property
    def settings(self) -> list[Setting]:
        run = self.integrate
        each = product(run.cspace, run.method, run.steps)
        return [Setting(cspace, method, *step) for cspace, method, step in each]

    @property
    def has_lane_clocks(self) -> bool:
        """Whether each trajectory has steps of its own."""
        run, has = self.integrate, self.problem
        own_time = has.events or has.states or has.controllers
        is_timed = run.is_adaptive or run.save_at is not None or run.max_steps is not None
        return bool(own_time) or is_timed

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
        """Bodies first … first + count, made and started."""
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
            with _at(f"problem.{table}"):
                drawn = own.pop(f"{table}.{element.label}", {})
                made[table].append(element.make(drawn, self._code))
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
        with _at("body"):
            body = self.body.make(own.pop("body", {}))
        with _at("joint"):
            joint = self.joint.make(own.pop("joint", {}))
        with _at("problem"):
            gravity = own.pop("problem", {}).get("gravity", self.problem.gravity)
            problem = Problem(body, joint, gravity, **made)
        with _at("initial"):
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
            with _at(f"problem.links.{each.name}.body"):
                body = each.body.make(own.pop(f"{each.name}.body", {}))
            with _at(f"problem.links.{each.name}.joint"):
                joint = each.joint.make(own.pop(f"{each.name}.joint", {}))
            with _at("problem"):
                links.append(Link(each.name, body, joint, each.parent))
            initial[each.name] = each.initial.given() | own.pop(f"{each.name}.initial", {})
        for loop in self.problem.loops:
            with _at(f"problem.loops.{loop.name}.joint"):
                joint = loop.joint.make(own.pop(f"{loop.name}.joint", {}))
            with _at("problem"):
                loops.append(Loop(loop.name, joint, loop.body, loop.parent))
        with _at("problem"):
            gravity = own.pop("problem", {}).get("gravity", self.problem.gravity)
            mechanism = Mechanism(links, loops, gravity, **made)
        close, t0 = self.initial.close or AUTO, self.integrate.t0
        with _at("initial"):
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
        """The study with changes by dotted keys."""
        return Study.of(self._tables(), changes=changes, code=self._code) if changes else self

    def to_toml(self) -> str:
        """The text of a file that says the same."""
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
        """Of everything that the results depend on."""
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


NOT_DRAWN = ("type", "rows", "body_frame", "ground_frame", "parent_frame")
NUMBERS = ("mass", "radius", "length", "density", "pitch")
SHAPES: dict[str, tuple[int, ...]] = dict.fromkeys(NUMBERS, ()) | {
    "twist": (6,),
    "rotation": (3, 3),
    "pose": (4, 4),
}
KEYS: dict[str, tuple[str, ...]] = {
    "problem": ("gravity",),
    "initial": tuple(k for k in InitialSection.model_fields if k != "close"),
    "body": tuple(k for k in BodySection.model_fields if k != "solid"),
    "joint": tuple(k for k in JointSection.model_fields if k not in NOT_DRAWN),
}
KEYS_OF_LINK = KEYS | {"initial": tuple(LinkStart.model_fields)}
# A link's columns are named after it, and so are its tables in [sample].
RESERVED = frozenset({"sample", *SampleSection.model_fields})


def _require_shape(
    path: str, shape: tuple[int, ...], expected: tuple[int, ...], free: bool = False
) -> None:
    fits = len(shape) == 1 if free else shape == expected
    if not fits:
        what = "a list of numbers" if free or expected == (3,) else f"shape {expected}"
        what = "one number" if expected == () else what
        raise StudyError(f"sample.{path}: a draw has shape {shape}; expected {what}")


# ---- distributions -----------------------------------------------------------------------------


def _distribution(key: str, value: Any) -> Any:
    """A distribution from its table; numbers and lists are constants."""
    if not isinstance(value, dict):
        with _at(key):
            as_distribution("it", value)
        return value
    options = dict(value)
    name = options.pop("distribution", None)
    if not isinstance(name, str):
        raise StudyError(f'{key}: needs distribution = "…", one of {", ".join(DISTRIBUTIONS)}')
    if name not in DISTRIBUTIONS:
        raise StudyError(f"{key}.distribution: {unknown_name('it', name, DISTRIBUTIONS)}")
    if isinstance(options.get("length"), dict):
        options["length"] = _distribution(f"{key}.length", options["length"])
    with _at(key):
        return _called(key, DISTRIBUTIONS[name], options)


# ---- messages ----------------------------------------------------------------------------------


class _at:
    """Errors in the block are those of a table of the file."""

    def __init__(self, table: str) -> None:
        self.table = table

    def __enter__(self) -> None:
        return None

    def __exit__(self, _kind: Any, error: Any, _traceback: Any) -> None:
        if isinstance(error, LierbError) and not isinstance(error, StudyError):
            raise StudyError(f"{self.table}: {error}") from None


class _at_key(_at):
    """The same, and of the key that they begin with, if it is one of `keys`."""

    def __init__(self, table: str, keys: Collection[str]) -> None:
        super().__init__(table)
        self.keys = keys

    def __exit__(self, kind: Any, error: Any, traceback: Any) -> None:
        first = re.match(r"\w+", str(error))
        if first and first[0] in self.keys:
            self.table = f"{self.table}.{first[0]}"
        super().__exit__(kind, error, traceback)


def _called(table: str, function: Any, values: dict[str, Any]) -> Any:
    """function(**values), where a key that it does not take is named."""
    signature = inspect.signature(function)
    known = [n for n, p in signature.parameters.items() if p.kind is not p.VAR_KEYWORD]
    for name in values:
        if name not in known:
            raise StudyError(f"{table}.{name}: unknown key{_suggestion(name, known)}")
    try:
        signature.bind(**values)
    except TypeError as error:
        raise StudyError(f"{table}: {error}") from None
    return function(**values)


def _suggestion(name: str, known: list[str]) -> str:
    near = get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"


@dataclass(frozen=True)
class Given:
    """What a study is made from: a file's name and text, and changes of what it says."""

    source: str
    text: str
    changes: Mapping[str, Any]

    def place(self, path: tuple[Any, ...]) -> str:
        """Where a key was given: the file's line, and what of its table was changed."""
        keys = [path_of(key) for key in self.changes]
        if path and path[0] in ELEMENTS:  # its parameters are in a table of [[problem.forces]]
            path = ("problem", path[0], *path[2:])
        names = tuple(map(str, path))
        line = None if any(names[: len(key)] == key for key in keys) else line_of(self.text, path)
        place = f"{self.source}:{line}" if line else self.source
        near = [each for key, each in zip(keys, written(self.changes)) if key[:1] == names[:1]]
        return f"{place} with {', '.join(near)}" if near else place


WORDS = {  # Python's in pydantic's messages, and those of a file
    r"a valid dictionary( or instance of \w+)?": "a table",
    r"a valid string": "text",
    r"a valid list": "a list",
}


def _messages(errors: ValidationError, tables: dict[str, Any], given: Given) -> str:
    """The first of pydantic's errors, each in a line."""
    found = iter(errors.errors(include_url=False, include_context=False))
    lines = dict.fromkeys(_message(e, tables, given) for e in islice(found, MOST_TOLD))
    if rest := sum(1 for _ in found):
        return "\n".join((*lines, f"{given.source}: and {rest} more"))
    return "\n".join(lines)


def _message(error: Any, tables: dict[str, Any], given: Given) -> str:
    """One of pydantic's errors as a line: where, key, what, got."""
    path = tuple(error["loc"])
    while path and not _leads_somewhere(path, tables) and error["type"] != "missing":
        path = path[:-1]  # pydantic adds the names of the alternatives that it tried
    key = ".".join(map(str, path))
    what = error["msg"][0].lower() + error["msg"][1:]
    for python, toml in WORDS.items():
        what = re.sub(python, toml, what)
    if error["type"] == "extra_forbidden":
        what = "unknown key" + _suggestion(str(path[-1]), _fields_at(path[:-1]))
    elif error["type"] == "missing":
        what = "is missing"
    elif not isinstance(error["input"], dict):
        what += f", got {shortened(repr(error['input']))}"
    return f"{given.place(path)}: {key}: {what}"


def _leads_somewhere(path: tuple[Any, ...], tables: Any) -> bool:
    for part in path:
        try:
            tables = tables[part]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def _fields_at(path: tuple[Any, ...]) -> list[str]:
    model: Any = Study
    for part in path:
        if isinstance(part, int):  # of a list
            continue
        field = model.model_fields.get(part)
        model = _model_in(field.annotation) if field else Section
        if model is None:
            return []
    return list(model.model_fields)


def _model_in(annotation: Any) -> Any:
    """The table that a field is, or that the items of its list are."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)


def _located(message: str, given: Given) -> str:
    """`table.key: what` with the line before it."""
    key = message.partition(":")[0]
    return f"{given.place(tuple(key.split('.')))}: {shortened(message)}"


def tables_of(study: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Every setting by its path, to compare two studies."""

    def walk(path: str, value: Any) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield from walk(f"{path}.{key}" if path else key, inner)
        else:
            yield path, value

    return walk("", study)

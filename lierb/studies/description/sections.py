"""The tables of a study's file, as pydantic models: they check types and keys, and make of them
what a problem is made of.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    WithJsonSchema,
)
from pydantic_core import PydanticCustomError

from lierb.errors import ArgumentError, StudyError, unknown_name
from lierb.model import forces, joints
from lierb.model.bodies import solids as bodies
from lierb.model.bodies.body import Body
from lierb.model.joints.joint import Joint
from lierb.model.mechanism.links import GROUND
from lierb.runs.timing import RTOL
from lierb.sampling import inertia_of
from lierb.sampling.distributions import DISTRIBUTIONS, as_distribution
from lierb.studies.description.code import EXPECTED, PATTERN, Code, function_of, named
from lierb.studies.description.messages import at, called, suggestion
from lierb.studies.description.study_file import ELEMENTS, LARGEST
from lierb.studies.description.times import SaveAt, saved_times
from lierb.support.arrays import Array, as_floats

OF_LINK = ("body", "joint", "initial")  # what can be drawn of a link; of a loop its joint
MOST_LINKS = 1000
MOST_FORCES = 100  # all are in one kernel
POINTS = {  # of a joint, and the frames whose origins they are
    "body_point": "body_frame",
    "ground_point": "ground_frame",
    "parent_point": "ground_frame",
}
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
        made: Body = called("body", Body if solid is None else getattr(bodies, solid), values)
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
        made: Joint = called("joint", make, values)
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
        given = dict(self.model_extra or {})
        where = f"{self.table}.{self.label}"
        for name, value in given.items():
            if name in sampled and isinstance(value, dict):
                raise StudyError(
                    f"problem.{where}.{name} is a table, and sample.{where}.{name} is where its "
                    "distribution stands; leave one of them out"
                )
        values = given | sampled
        if named(self.type):
            made = function_of(self.table, self.type, code)(**values)
        else:
            made = called(where, getattr(forces, self.type), values)
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
    """Start of a link: pose by `coordinates`, `rotation` and `place`, or `pose`; its velocities.

    `coordinates` and `velocities` are those of its joint and their rates; a number where there is
    one. `rotation`, 3×3, and `place`, m, are its joint frame in that of its parent. `pose`, 4×4, is
    in the ground frame. `omega` and `twist` are in its own axes.
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
    """Start: velocities by `omega` and `point_velocity`, `twist` or `velocities`; pose as below.

    `coordinates` are those of the joint, in the order of `Joint.coordinate_names`, and `velocities`
    their rates. `rotation`, 3×3, and `place`, m, are the body's joint frame in the ground's.

    For a mechanism there is only `close`: "auto" closes what is open, to the nearest pose and twist
    by the masses; "never" leaves it. Each link's own table, [problem.links.initial], has its start.
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
    """Number of bodies, and the quantities that are drawn for each, as [sample.SECTION.KEY] tables.

    Those of a mechanism's links and loops are [sample.NAME.SECTION.KEY], as sample.rod.body.mass.
    `stop_when` is the rule by which a study ends early; see `lierb.studies.description.stopping`.
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
                    raise StudyError(f"{path}: unknown key{suggestion(key, list(known or ()))}")
                found[f"{section}.{key}"] = distribution_of(path, value)
        return dict(sorted(found.items()))  # tables have no order, points of a sequence do

    def _of_held(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Tables of links and loops by their path, such as `rod.body`."""
        for name, tables in (self.model_extra or {}).items():
            if not isinstance(tables, dict):
                raise StudyError(f"sample.{name}: unknown key{suggestion(name, _sampled())}")
            for section, table in tables.items():
                if section not in OF_LINK or not isinstance(table, dict):
                    raise StudyError(
                        f"sample.{name}.{section}: unknown key{suggestion(section, [*OF_LINK])}"
                    )
                yield f"{name}.{section}", table

    def require_names(self, names: Collection[str]) -> None:
        """Raise StudyError for tables of what is no link and no loop of the study's."""
        for name in self.model_extra or {}:
            if name not in names:
                raise StudyError(
                    f"sample.{name}: unknown key{suggestion(name, [*names, *_sampled()])}"
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
    discontinuities: list[float] | None = Field(default=None, min_length=1)
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


def distribution_of(key: str, value: Any) -> Any:
    """A distribution from its table; numbers and lists are constants."""
    if not isinstance(value, dict):
        with at(key):
            as_distribution("it", value)
        return value
    options = dict(value)
    name = options.pop("distribution", None)
    if not isinstance(name, str):
        raise StudyError(f'{key}: needs distribution = "…", one of {", ".join(DISTRIBUTIONS)}')
    if name not in DISTRIBUTIONS:
        raise StudyError(f"{key}.distribution: {unknown_name('it', name, DISTRIBUTIONS)}")
    if isinstance(options.get("length"), dict):
        options["length"] = distribution_of(f"{key}.length", options["length"])
    with at(key):
        return called(key, DISTRIBUTIONS[name], options)

"""Studies: a Monte Carlo run described by a TOML file, or by the same as Python objects.

    [body]         mass, inertia, com; or solid = "box" … with its size and density
    [joint]        type and frames, as `lierb.joints` takes them
    [problem]      gravity, forces, constraints, observables
    [initial]      omega, point_velocity, twist, velocities; coordinates, rotation, place
    [sample]       n, seed, method; and for each sampled quantity a table [sample.SECTION.KEY]
    [integrate]    cspace, method, dt: one value or several, run as a product; t_end, record, …
    [output]       bodies in a part, compression

A file is checked as a whole before anything runs; what is wrong is named with its line and key.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

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
from lierb.arrays import (
    Array,
    Pose,
    as_floats,
    as_numbers,
    as_rotations,
    components,
    pose_components,
    pose_matrix,
)
from lierb.errors import ArgumentError, LierbError, StudyError, unknown_name
from lierb.joints import Joint
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.model import Body, Problem
from lierb.runs import checks
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

NOTHING = "nothing"  # a design draws something
ELEMENTS = ("forces", "constraints", "observables")
PREVIEW = 8  # bodies that are made when a study is checked
MOST_SETTINGS = 1000  # each is looked at when a study is checked
MOST_FORCES = 100  # all are in one kernel
MOST_TOLD = 10  # of the things that are wrong
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

    def make(self, sampled: dict[str, Array]) -> Joint:
        values = self.given() | sampled
        name = values.pop("type")
        if name not in joints.JOINTS and name != "from_rows":
            raise unknown_name("type", name, (*joints.JOINTS, "from_rows"))
        make = joints.from_rows if name == "from_rows" else joints.JOINTS[name]
        made: Joint = _called("joint", make, values)
        return made


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


class ElementSection(BaseModel):
    """What a problem has in a list; with its parameters, and a `name` if there are several."""

    model_config = SECTION | ConfigDict(extra="allow")

    table: ClassVar[str]
    type: Annotated[str, AfterValidator(_type_of_function), WithJsonSchema(OF_FUNCTION)]
    name: str | None = None

    @property
    def label(self) -> str:
        return self.name or self.type.rpartition(":")[2]

    def make(self, sampled: dict[str, Array], code: Code) -> Any:
        """What it describes, by a function of lierb's or of the study's files."""
        values = dict(self.model_extra or {}) | sampled
        if named(self.type):
            return function_of(self.table, self.type, code)(**values)
        return _called(f"{self.table}.{self.label}", getattr(forces, self.type), values)


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


class ProblemSection(Section):
    gravity: Vector = [0.0, 0.0, 0.0]
    forces: Annotated[list[ForceSection], Field(max_length=MOST_FORCES)] = []
    constraints: Annotated[list[ConstraintSection], Field(max_length=MOST_FORCES)] = []
    observables: Annotated[list[ObservableSection], Field(max_length=MOST_FORCES)] = []

    def elements(self) -> Iterator[tuple[str, ElementSection]]:
        """Each with the name of its list."""
        for table in ELEMENTS:
            for element in getattr(self, table):
                yield table, element


class InitialSection(Section):
    """The start. Velocities: omega and point_velocity, or twist, or velocities. Pose: see below.

    coordinates : of the joint, in the order of `Joint.coordinate_names`; velocities : their rates.
    rotation, place : the body's joint frame seen from the ground's, 3×3, and m.
    """

    omega: Vector | None = None
    point_velocity: Vector | None = None
    twist: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    velocities: list[float] | None = None
    coordinates: list[float] | None = None
    rotation: list[Vector] | None = None
    place: Vector | None = None


class SampleSection(BaseModel):
    """How many bodies, and what each draws; quantities are [sample.SECTION.KEY] tables.

    stop_when : with how many of them the study ends before its time; see `lierb.studies.stopping`.
    """

    model_config = SECTION

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
    initial: dict[str, Any] = {}

    def quantities(self) -> dict[str, Any]:
        """Distributions by their path, such as `initial.omega` or `forces.drag.linear`."""
        tables = {name: getattr(self, name) for name in ("body", "joint", "problem", "initial")}
        for kind in ELEMENTS:
            tables |= {f"{kind}.{name}": table for name, table in getattr(self, kind).items()}
        found = {}
        for section, table in tables.items():
            known = KEYS.get(section)
            for key, value in table.items():
                path = f"sample.{section}.{key}"
                if path in found or (known is not None and key not in known):
                    raise StudyError(f"{path}: unknown key{_suggestion(key, list(known or ()))}")
                found[f"{section}.{key}"] = _distribution(path, value)
        return dict(sorted(found.items()))  # tables have no order, points of a sequence do


def _one_or_several(kind: str) -> tuple[Any, Any]:
    """Validator and schema of a list for which one value will do."""
    one = {"type": kind}
    return BeforeValidator(_as_list), WithJsonSchema(
        {"anyOf": [one, {"type": "array", "items": one}]}
    )


Names = Annotated[list[str], *_one_or_several("string")]
Seconds = Annotated[list[float], *_one_or_several("number")]


class IntegrateSection(Section):
    """As `lierb.integrate` takes it; cspace, method and dt may be lists, run as a product."""

    t_end: float
    t0: float = 0.0
    dt: Seconds = Field(min_length=1)
    cspace: Names = Field(default=["SE3"], min_length=1)
    method: Names = Field(default=["RK4"], min_length=1)
    update: str = "local"
    solver: str = "auto"
    save_every: Count | None = None
    measure_every: Count = 1
    record: list[str] = []


class OutputSection(Section):
    part: Count = 16384  # bodies
    compression: Literal["none", "snappy", "zstd"] = "snappy"


@dataclass(frozen=True)
class Setting:
    """One of the runs that a study's lists multiply out to."""

    cspace: str
    method: str
    dt: float

    @property
    def label(self) -> str:
        return f"{self.cspace}, {self.method}, dt = {self.dt:g} s"


@dataclass(frozen=True)
class Batch:
    """Some bodies of a study, ready for `lierb.integrate`."""

    problem: Problem
    twist0: Array
    pose0: Array | None
    draws: dict[str, Array]


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

    model_config = SECTION | ConfigDict(json_schema_extra={"description": "A study of lierb."})

    name: str = "study"
    body: BodySection
    joint: JointSection
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
        return given if isinstance(given, Study) else plain(given)

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
        self._check_settings()
        with _at("sample"):
            design = self.design
            batch = self.batch(0, min(PREVIEW, len(design)), design)
        if self.sample.stop_when is not None:
            rule_of(self.sample.stop_when, batch.problem)
        for table in ELEMENTS:
            labels = [each.label.lower() for each in getattr(self.problem, table)]  # as SQL has it
            if len(set(labels)) < len(labels):
                raise StudyError(
                    f"problem.{table}: two have the same name; give each a name of its own"
                )
        with _at("initial"), np.errstate(all="ignore"):
            checks.require_consistent(batch.problem, batch.twist0, batch.pose0, self.integrate.t0)
        for setting in self.settings:
            with _at("integrate"):
                api.check_options(batch.problem, **self.options(setting))

    def _check_settings(self) -> None:
        run = self.integrate
        for key in ("cspace", "method", "dt"):
            listed = getattr(run, key)
            if len(set(listed)) < len(listed):
                twice = next(each for n, each in enumerate(listed) if each in listed[:n])
                raise StudyError(f"integrate.{key}: {twice!r} is given twice; once will do")
        count = prod(len(each) for each in (run.cspace, run.method, run.dt))
        if count > MOST_SETTINGS:
            raise StudyError(
                f"integrate: cspace, method and dt make {count} settings; expected at most "
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
            if ".".join(path) in drawn:
                raise StudyError(
                    f"{key}: has no effect, since each body draws its own; change "
                    f"sample.{'.'.join(path)}"
                )

    def _shown(self) -> tuple[str, Lines]:
        run = self.integrate
        tables = "summary and history" if run.save_every else "summary"
        rows = [
            ("settings", settings_told(run.cspace, run.method, run.dt)),
            ("times", f"{run.t0:g} … {run.t_end:g} s"),
            ("tables", f"{tables}, in parts of at most {counted(self.output.part, *BODIES)}"),
        ]
        try:
            count, quantities = counted(len(self.design), *BODIES), self.sample.quantities()
        except LierbError as error:  # made without `of`, and not checked
            return f"lierb.Study {self.name!r}", [*rows, (FAILED, str(error))]
        drawn = "\n".join(f"{path}: {value!r}" for path, value in quantities.items())
        rows.insert(0, ("sampled", drawn or "nothing"))
        return f"lierb.Study {self.name!r}: {count} on a {self.joint.type} joint", rows

    __str__ = Shown.__repr__

    @property
    def design(self) -> Design:
        quantities = self.sample.quantities() or {NOTHING: 0.0}
        return Design(quantities, n=self.sample.n, seed=self.sample.seed, method=self.sample.method)

    @property
    def settings(self) -> list[Setting]:
        run = self.integrate
        return [Setting(*each) for each in product(run.cspace, run.method, run.dt)]

    def options(self, setting: Setting) -> dict[str, Any]:
        """What `lierb.integrate` is called with, beside the batch."""
        run = self.integrate
        return {
            "cspace": setting.cspace, "method": setting.method, "dt": setting.dt,
            "t_end": run.t_end, "t0": run.t0, "update": run.update, "solver": run.solver,
            "save_every": run.save_every, "measure_every": run.measure_every,
            "record": tuple(run.record),
        }  # fmt: skip

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
        return None if text is None else rule_of(text, self.batch(0, 1).problem)

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
        own: dict[str, dict[str, Array]] = {}
        for path, values in draws.items():
            section, _, key = path.rpartition(".")
            self._check_shape(path, section, key, values.shape[1:])
            own.setdefault(section, {})[key] = values
        with _at("body"):
            body = self.body.make(own.pop("body", {}))
        with _at("joint"):
            joint = self.joint.make(own.pop("joint", {}))
        made: dict[str, list[Any]] = {table: [] for table in ELEMENTS}
        for table, element in self.problem.elements():
            with _at(f"problem.{table}"):
                drawn = own.pop(f"{table}.{element.label}", {})
                made[table].append(element.make(drawn, self._code))
            for key, values in drawn.items():
                shape = made[table][-1].kind.shapes[key]
                _require_shape(f"{table}.{element.label}.{key}", values.shape[1:], shape)
        with _at("problem"):
            gravity = own.pop("problem", {}).get("gravity", self.problem.gravity)
            problem = Problem(body, joint, gravity, **made)
        with _at("initial"):
            initial = self.initial.given() | own.pop("initial", {})
            twist0, pose0 = _started(problem, initial, self.integrate.t0)
        if own:
            table, _, _ = next(iter(own)).partition(".")
            names = [each.label for each in getattr(self.problem, table)]
            raise StudyError(
                f"sample.{next(iter(own))}: there is no such {table.removesuffix('s')}; known: "
                f"{names}"
            )
        if twist0.ndim == 1:
            twist0 = np.broadcast_to(twist0, (count, 6))
        return Batch(problem, twist0, pose0, draws)

    def changed(self, changes: Mapping[str, Any]) -> Study:
        """The study with changes by dotted keys."""
        return Study.of(self._tables(), changes=changes, code=self._code) if changes else self

    def to_toml(self) -> str:
        """The text of a file that says the same."""
        return tomli_w.dumps(self._tables())

    def _tables(self) -> dict[str, Any]:
        return self.model_dump(exclude_none=True, exclude_defaults=True)

    def _check_shape(self, path: str, section: str, key: str, shape: tuple[int, ...]) -> None:
        """Whether a draw is what its key takes: else bodies might be taken for components."""
        if section == "body" and key == "inertia" and shape == (3, 3):
            return
        if section.partition(".")[0] not in ELEMENTS:
            _require_shape(
                path, shape, SHAPES.get(key, (3,)), free=key in ("coordinates", "velocities")
            )

    def digest(self) -> str:
        """Of everything that the results depend on."""
        tables = self.model_dump(exclude={"name"})
        # Studies without have the digest that they had.
        for section in ("problem", "sample"):
            for table in ("constraints", "observables"):
                if not tables[section][table]:
                    del tables[section][table]
        if self.sample.stop_when is None:
            del tables["sample"]["stop_when"]
        if self.code:
            tables["code"] = self.code_digests
        return sha256_of_text(json.dumps(tables, sort_keys=True))

    @property
    def code_digests(self) -> dict[str, str]:
        """SHA-256 of its Python files."""
        return {file: sha256_of_text(text) for file, text in self.code.items()}


BODIES = ("body", "bodies")


def settings_told(cspaces: list[str], methods: list[str], dts: list[float]) -> str:
    """The settings as the product that they are."""
    lists = [", ".join(each) for each in (cspaces, methods, [f"{dt:g}" for dt in dts])]
    return f"{lists[0]} × {lists[1]} × dt = {lists[2]} s"


NUMBERS = ("mass", "radius", "length", "density", "pitch")
SHAPES: dict[str, tuple[int, ...]] = dict.fromkeys(NUMBERS, ()) | {
    "twist": (6,),
    "rotation": (3, 3),
}
KEYS = {
    "problem": ("gravity",),
    "initial": tuple(InitialSection.model_fields),
    "body": tuple(k for k in BodySection.model_fields if k != "solid"),
    "joint": tuple(k for k in JointSection.model_fields if k not in ("type", "rows")),
}


def _require_shape(
    path: str, shape: tuple[int, ...], expected: tuple[int, ...], free: bool = False
) -> None:
    fits = len(shape) == 1 if free else shape == expected
    if not fits:
        what = "a list of numbers" if free or expected == (3,) else f"shape {expected}"
        what = "one number" if expected == () else what
        raise StudyError(f"sample.{path}: a draw has shape {shape}; expected {what}")


def _started(problem: Problem, initial: dict[str, Any], t0: float) -> tuple[Array, Array | None]:
    """Twists and poses that satisfy the joint."""
    joint = problem.joint
    pose = _placed(joint, initial)
    kinds = [k for k in ("omega", "twist", "velocities") if k in initial]
    if len(kinds) > 1 or ("point_velocity" in initial and kinds not in ([], ["omega"])):
        raise ArgumentError("give omega and point_velocity, or twist, or velocities")
    if "velocities" in initial:
        where = {"pose": pose}
        if "coordinates" in initial:
            where = {"coordinates": initial["coordinates"]}
        return joint.twist(velocities=initial["velocities"], **where), pose
    if "twist" in initial:
        return problem.project(initial["twist"], pose, t0=t0), pose
    turning = {k: initial[k] for k in ("omega", "point_velocity") if k in initial}
    twist = joint.twist(pose=pose, **turning)
    about_a_point = holds_a_point(problem.rows) and len(problem.rows) == 3
    allowed = not problem.rows or (about_a_point and "point_velocity" not in turning)
    return twist if allowed else problem.project(twist, pose, t0=t0), pose


def _placed(joint: Joint, initial: dict[str, Any]) -> Array | None:
    """The poses that coordinates, or rotation and place, give; None for the closed joint."""
    placed = [k for k in ("rotation", "place") if k in initial]
    if "coordinates" in initial:
        if placed:
            raise ArgumentError(f"give coordinates or {placed[0]}, not both")
        return joint.pose(coordinates=initial["coordinates"])
    if not placed:
        return None
    turn = as_rotations("rotation", initial.get("rotation", np.eye(3)))
    place = as_numbers("place", initial.get("place", (0.0, 0.0, 0.0)), (3,))
    ground, body = (pose_components(f) for f in (joint.ground_frame, joint.body_frame))
    relative: Pose = components(turn, 2), components(place)
    return pose_matrix(se3.compose(se3.compose(ground, relative), se3.inverse(body)))


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
        field = model.model_fields.get(part) if isinstance(part, str) else None
        model = field.annotation if field else Section
        if not (inspect.isclass(model) and issubclass(model, BaseModel)):
            return []
    return list(model.model_fields)


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

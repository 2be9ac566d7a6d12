"""Table of the problem: links, loops, forces and the other elements."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema
from pydantic_core import PydanticCustomError

from lierb.errors import StudyError
from lierb.model import forces
from lierb.model.functions.turns import turns
from lierb.studies.description.code import EXPECTED, PATTERN, Code, function_of, named
from lierb.studies.description.messages import called
from lierb.studies.description.sections.bodies import LinkSection, LoopSection
from lierb.studies.description.sections.fields import SECTION, Names, Section, Vector
from lierb.studies.description.study_file import ELEMENTS

MOST_LINKS = 1000
MOST_FORCES = 100  # all forces are compiled into one kernel


TURNS = turns.__name__  # type of states that count turns
BUILT_IN = {name: getattr(forces, name) for name in forces.FORCE_UNITS} | {TURNS: turns}


def _type_of(*known: str) -> tuple[Any, Any]:
    """Return validator and schema of a type: one of the known ones, or a function in a file."""

    def check(given: str) -> str:
        if given in known or named(given):
            return given
        expected = f"{', '.join(map(repr, known))} or {EXPECTED}" if known else EXPECTED
        raise PydanticCustomError("type_of_element", "input should be {it}", {"it": expected})

    schema: dict[str, Any] = {"type": "string", "pattern": PATTERN}
    if known:
        schema = {"anyOf": [{"enum": [*known], "type": "string"}, schema]}
    return AfterValidator(check), WithJsonSchema(schema)


class ElementSection(BaseModel):
    """Element of a list in [problem], with its parameters; `name` distinguishes equal types.

    on : in a mechanism, the link or two links on which the element acts, or the link of its joint.
    """

    model_config = SECTION | ConfigDict(extra="allow")

    table: ClassVar[str]
    type: Annotated[str, *_type_of()]
    name: str | None = None
    on: Annotated[Names, Field(min_length=1, max_length=2)] | None = None

    @property
    def label(self) -> str:
        return self.name or self.type.rpartition(":")[2]

    def make(self, sampled: dict[str, Any], code: Code) -> Any:
        """Make the element, by a function of lierb or of the study's files."""
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
            made = called(where, BUILT_IN[self.type], values)
        return made.on(*self.on) if self.on else made


class ColumnSection(ElementSection):
    """Element whose `name` is its name in the results."""

    def make(self, sampled: dict[str, Any], code: Code) -> Any:
        element = super().make(sampled, code)
        return element.named(self.name) if self.name else element


class ForceSection(ElementSection):
    """Force of `lierb.forces`, or a function in a file beside the study.

    The function has `@lierb.wrench`, `@lierb.variable_mass` or `@lierb.ground_motion` before it.
    """

    table = "forces"
    type: Annotated[str, *_type_of(*forces.FORCE_UNITS)]


class ConstraintSection(ElementSection):
    """Function with `@lierb.constraint` or `@lierb.velocity_constraint` beside the study."""

    table = "constraints"


class ObservableSection(ColumnSection):
    """Function with `@lierb.observable` in a file beside the study; `name` names its column."""

    table = "observables"


class EventSection(ColumnSection):
    """Function with `@lierb.event` in a file beside the study; `name` is used in the tables."""

    table = "events"


class StatesSection(ElementSection):
    """Function with `@lierb.states` in a file beside the study, and initial values.

    With `type = "turns"`, the angle of a joint that counts turns, from the joint's
    `initial.coordinates` or, without them, from `start`; `name` is that of its column.
    """

    table = "states"
    type: Annotated[str, *_type_of(TURNS)]

    def make(self, sampled: dict[str, Any], code: Code) -> Any:
        is_named = self.type == TURNS and self.name
        return super().make(sampled | ({"name": self.name} if is_named else {}), code)


class ControllerSection(ElementSection):
    """Function with `@lierb.controller` in a file beside the study, with `every` and the like."""

    table = "controllers"


class ProblemSection(Section):
    """Gravity, m/s², and the lists of links, loops, forces and other elements."""

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
        """Yield each force and other element, with the name of its list."""
        for table in ELEMENTS:
            for element in getattr(self, table):
                yield table, element

    def links_and_loops(self) -> Iterator[LinkSection | LoopSection]:
        """Yield the links, then the loops."""
        yield from self.links
        yield from self.loops

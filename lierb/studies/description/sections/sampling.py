"""Table of the sampled quantities and their distributions."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, NonNegativeInt

from lierb.errors import StudyError, unknown_name
from lierb.sampling.distributions import DISTRIBUTIONS, as_distribution
from lierb.studies.description.messages import at, called, suggestion
from lierb.studies.description.sections.bodies import (
    BodySection,
    InitialSection,
    JointSection,
    LinkStart,
)
from lierb.studies.description.sections.fields import SECTION, Count, Whole
from lierb.studies.description.study_file import ELEMENTS

OF_LINK = ("body", "joint", "initial")  # sampled tables of a link; of a loop only "joint"


class SampleSection(BaseModel):
    """Number of bodies, and tables [sample.SECTION.KEY] of the sampled quantities.

    Quantities of a mechanism's links and loops have tables [sample.NAME.SECTION.KEY], such as
    [sample.rod.body.mass].
    stop_when : rule that ends a study early; see `lierb.studies.description.stopping`.
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
        """Return the distributions by path, such as `initial.omega` or `forces.drag.linear`."""
        tables = {name: getattr(self, name) for name in ("body", "joint", "problem", "initial")}
        tables |= dict(self._of_links())
        for kind in ELEMENTS:
            tables |= {f"{kind}.{name}": table for name, table in getattr(self, kind).items()}
        distributions = {}
        for section, table in tables.items():
            known = _known_keys(section)
            for key, value in table.items():
                path = f"sample.{section}.{key}"
                if known is not None and key not in known:
                    raise StudyError(f"{path}: unknown key{suggestion(key, [*known])}")
                distributions[f"{section}.{key}"] = distribution_of(path, value)
        return dict(sorted(distributions.items()))  # tables have no order

    def _of_links(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the tables of links and loops by path, such as `rod.body`."""
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
        """Raise StudyError for tables named otherwise than the links and loops."""
        for name in self.model_extra or {}:
            if name not in names:
                raise StudyError(
                    f"sample.{name}: unknown key{suggestion(name, [*names, *_sampled()])}"
                )


def _sampled() -> list[str]:
    return [*SampleSection.model_fields]


def _known_keys(section: str) -> Collection[str] | None:
    """Keys of a section that can be sampled; None for an element, which validates its own keys."""
    first, _, last = section.partition(".")
    if first in ELEMENTS:
        return None
    return KEYS_OF_LINK[last] if last else KEYS[first]


NOT_DRAWN = ("type", "rows", "body_frame", "ground_frame", "parent_frame")
NUMBERS = ("mass", "radius", "length", "density", "pitch")
SHAPES: dict[str, tuple[int, ...]] = dict.fromkeys(NUMBERS, ()) | {
    "twist": (6,),
    "rotation": (3, 3),
    "pose": (4, 4),
}
OF_MECHANISM = ("close", "hold")  # keys of [initial], which are no numbers
KEYS: dict[str, tuple[str, ...]] = {
    "problem": ("gravity",),
    "initial": tuple(k for k in InitialSection.model_fields if k not in OF_MECHANISM),
    "body": tuple(k for k in BodySection.model_fields if k not in ("solid", "about")),
    "joint": tuple(k for k in JointSection.model_fields if k not in NOT_DRAWN),
}
KEYS_OF_LINK = KEYS | {"initial": tuple(LinkStart.model_fields)}
# Names that a link must not have, since its columns and its tables in [sample] have its name.
RESERVED = frozenset({"sample", *SampleSection.model_fields})


def distribution_of(key: str, value: Any) -> Any:
    """Make a distribution from its table; numbers and lists become constants."""
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

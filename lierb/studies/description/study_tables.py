"""Tables of a study's file as one model, and properties that do not require the bodies."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from itertools import product
from typing import Any, Self

from pydantic import ConfigDict, PrivateAttr, model_validator

from lierb.errors import ArgumentError
from lierb.runs.time_options import ADAPTIVE_METHOD
from lierb.sampling import Design
from lierb.studies.description.code import Code, named, sha256_of_text
from lierb.studies.description.sections.bodies import BodySection, InitialSection, JointSection
from lierb.studies.description.sections.elements import ProblemSection
from lierb.studies.description.sections.fields import SECTION, Section
from lierb.studies.description.sections.running import IntegrateSection, OutputSection
from lierb.studies.description.sections.sampling import SampleSection
from lierb.studies.description.settings import Setting
from lierb.studies.description.study_file import ELEMENTS, plain
from lierb.studies.description.toml import toml_of
from lierb.support.representations import counted_links

TABLES = ("summary", "history", "events")
NEW_KEYS = ("rtol", "atol", "dt_min", "dt_max", "max_steps", "save_at", "discontinuities")
NOTHING = "nothing"  # quantity in the design of a study without sampled quantities
LINKS_AND_LOOPS = ("links", "loops")  # lists of the problem whose items have a joint


class StudyTables(Section):
    """Tables of a study's file."""

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

    @model_validator(mode="before")
    @classmethod
    def _as_in_a_file(cls, tables: Any) -> Any:
        """Convert the tables to values that a file can hold, and add dependent defaults."""
        return tables if isinstance(tables, StudyTables) else _with_defaults(plain(tables))

    @property
    def kind(self) -> str:
        """Return the kind of problem: `spherical joint`, or `mechanism of 3 links and 1 loop`."""
        if self.joint is not None:
            return f"{self.joint.type} joint"
        links, loops = self.problem.links, self.problem.loops
        return f"mechanism of {counted_links(len(links), len(loops))}"

    @property
    def design(self) -> Design:
        """Return the design of the table [sample]."""
        quantities = self.sample.quantities() or {NOTHING: 0.0}
        return Design(quantities, n=self.sample.n, seed=self.sample.seed, method=self.sample.method)

    @property
    def settings(self) -> list[Setting]:
        """Return the product of the c-spaces, methods and steps of the study."""
        run = self.integrate
        each = product(run.cspace, run.method, run.steps)
        return [Setting(cspace, method, *step) for cspace, method, step in each]

    @property
    def table_names(self) -> tuple[str, ...]:
        """Return the names of the result tables."""
        return tables_of_study(self.model_dump())

    # ---- Python files ----------------------------------------------------------------------------

    @property
    def files(self) -> tuple[str, ...]:
        """Return the names of the Python files to which the study refers."""
        references = (named(element.type) for _, element in self.problem.elements())
        return tuple(sorted({each.file for each in references if each}))

    @property
    def code(self) -> Code:
        """Texts of the Python files, by name."""
        return {file: self._code[file] for file in self.files if file in self._code}

    @property
    def code_digests(self) -> dict[str, str]:
        """SHA-256 of the Python files, by name."""
        return {file: sha256_of_text(text) for file, text in self.code.items()}

    def with_code(self, code: Code) -> Self:
        """Return the study with other texts of its Python files."""
        study = self.model_copy()
        study._code = dict(code)
        return study

    # ---- text ------------------------------------------------------------------------------------

    def to_toml(self) -> str:
        """Write the study as the text of its file.

        Returns
        -------
        str
            TOML.
        """
        return toml_of(self._tables())

    def _tables(self) -> dict[str, Any]:
        tables = self.model_dump(exclude_none=True, exclude_defaults=True)
        run = tables["integrate"]
        for key, default in _dependent(bool(self.problem.links), self.integrate.is_adaptive):
            run.pop(key, None)
            if (own := getattr(self.integrate, key)) != default:
                run[key] = own
        return tables

    def digest(self) -> str:
        """Compute a checksum of everything on which the results depend.

        Returns
        -------
        str
            Hexadecimal digits.
        """
        tables = self.model_dump(exclude={"name"})
        for table, keys in _later_keys(tables):
            for key in keys:
                if table[key] in (None, [], {}):
                    del table[key]
        if self.code:
            tables["code"] = self.code_digests
        return sha256_of_text(json.dumps(tables, sort_keys=True))


def _later_keys(tables: dict[str, Any]) -> Iterator[tuple[dict[str, Any], tuple[str, ...]]]:
    """Yield tables with keys of later versions, which change the digest only if set."""
    yield tables["problem"], (*ELEMENTS[1:], *LINKS_AND_LOOPS)
    yield tables["sample"], (*ELEMENTS[1:], "stop_when")
    yield tables["initial"], ("close", "hold")
    yield tables["integrate"], ("stabilise", "sensitivities", *NEW_KEYS)
    yield tables, ("body", "joint")
    for table in ELEMENTS:
        for element in tables["problem"].get(table, []):
            yield element, ("on",)
    if tables.get("joint"):
        yield tables["joint"], ("parent_point", "parent_frame")
    for each in (tables, *tables["problem"].get("links", [])):
        if each.get("body"):
            yield each["body"], ("about",)


def _with_defaults(tables: dict[str, Any]) -> dict[str, Any]:
    """Add the c-space of a mechanism, "reduced", and the method of adaptive steps."""
    run, problem = tables.get("integrate"), tables.get("problem")
    if not isinstance(run, dict):
        return tables
    has_links = isinstance(problem, dict) and bool(problem.get("links"))
    defaults = dict(_dependent(has_links, bool({"rtol", "atol"} & run.keys())))
    return tables | {"integrate": defaults | run}


def _dependent(has_links: bool, is_adaptive: bool) -> tuple[tuple[str, list[str]], ...]:
    """Return the defaults of [integrate] that depend on other keys."""
    return (
        ("cspace", ["reduced" if has_links else "SE3"]),
        ("method", [ADAPTIVE_METHOD if is_adaptive else "RK4"]),
    )


def require_table(label: str, name: object, known: Collection[str]) -> None:
    """Raise ArgumentError for a table that a study does not have.   known : its tables."""
    if name not in known:
        raise ArgumentError(
            f'{label}={name!r}; expected "summary", "history" with save_every or save_at, or '
            '"events" of a problem with events'
        )


def tables_of_study(study: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a study's result tables.   study : the study's `model_dump`."""
    run = study["integrate"]
    saves = run["save_every"] is not None or run.get("save_at") is not None
    is_there = (True, saves, bool(study.get("problem", {}).get("events")))
    return tuple(name for name, there in zip(TABLES, is_there, strict=True) if there)

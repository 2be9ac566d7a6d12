"""Check a study's tables where more than one key is concerned."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

from lierb.errors import StudyError
from lierb.runs.time_options import MOST_SEED
from lierb.sampling import Design
from lierb.studies.description.changes import index_of, path_of
from lierb.studies.description.sections.running import IntegrateSection
from lierb.studies.description.sections.sampling import OF_MECHANISM, RESERVED
from lierb.studies.description.starting import NEVER
from lierb.studies.description.study_file import ELEMENTS
from lierb.studies.description.study_tables import LINKS_AND_LOOPS, StudyTables

MOST_SETTINGS = 1000  # each is checked before a study runs


def check_kind(study: StudyTables) -> None:
    """Raise StudyError for tables of one body in a study of a mechanism, and the reverse."""
    study.sample.require_names([each.name for each in study.problem.links_and_loops()])
    for loop in study.problem.loops:
        for section in {*(study.sample.model_extra or {}).get(loop.name, {})} - {"joint"}:
            raise StudyError(f"sample.{loop.name}.{section}: a loop has a joint, and no more")
    if study.problem.links:
        _check_mechanism(study)
        return
    for key in ("body", "joint"):
        if getattr(study, key) is None:
            raise StudyError(f"{key}: is missing")
    if study.problem.loops:
        raise StudyError("problem.loops: are of a mechanism, which has links: [[problem.links]]")
    for key in study.initial.given().keys() & {*OF_MECHANISM}:
        raise StudyError(f"initial.{key}: is of a mechanism, whose loops are closed")


def _check_mechanism(study: StudyTables) -> None:
    names = [each.name for each in study.problem.links_and_loops()]
    for name in names:
        if name.lower() in RESERVED:
            raise StudyError(
                f"problem: a link or loop is named {name}, as a table of [sample] is; rename it"
            )
    for key in ("body", "joint"):
        if getattr(study, key) is not None or getattr(study.sample, key):
            raise StudyError(f"{key}: is of one body; of a mechanism each link has its own")
    if study.initial.hold and study.initial.close == NEVER:
        raise StudyError(
            'initial.hold: is of starts that are closed; leave out close = "never", or hold'
        )
    for key in study.initial.given().keys() - {*OF_MECHANISM}:
        raise StudyError(
            f"initial.{key}: is of one body; of a mechanism each link has its own start, "
            "[problem.links.initial]"
        )
    for key in study.sample.initial:
        raise StudyError(
            f"sample.initial.{key}: is of one body; draw that of a link, "
            f"sample.{names[0]}.initial.{key}"
        )


def check_labels(study: StudyTables) -> None:
    """Raise StudyError for forces and the like whose names are equal to SQL, which ignores case."""
    for table in ELEMENTS:
        labels = [each.label.lower() for each in getattr(study.problem, table)]
        if len(set(labels)) < len(labels):
            raise StudyError(
                f"problem.{table}: two have the same name; give each a name of its own"
            )


def check_stopping(design: Design) -> None:
    """Raise StudyError for a design without confidence intervals, which no rule can bound."""
    if design.method == "grid":
        raise StudyError(
            f"sample.stop_when: a grid has no confidence intervals, since its {design.n} bodies "
            'are chosen, not drawn; leave stop_when out, or take method = "random" or "sobol"'
        )


def check_seed(study: StudyTables) -> None:
    """Raise StudyError for a seed that a controller's noise cannot use."""
    if study.problem.controllers and study.sample.seed >= MOST_SEED:
        raise StudyError(
            f"sample.seed: is {study.sample.seed}; expected less than 2**53 with controllers, "
            "whose noise is drawn by it"
        )


def check_settings(run: IntegrateSection) -> None:
    """Raise StudyError for lists in [integrate] that make no, doubled or too many settings."""
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


def require_effect(study: StudyTables, changes: Mapping[str, Any]) -> None:
    """Raise StudyError for a change of a quantity that every body draws."""
    drawn = study.sample.quantities()
    for key in changes:
        path = ".".join(_sampled_path(study, path_of(key)))
        if path in drawn:
            raise StudyError(
                f"{key}: has no effect, since each body draws its own; change sample.{path}"
            )


def _sampled_path(study: StudyTables, path: tuple[str, ...]) -> tuple[str, ...]:
    """Path of a key in [sample], where elements and links are identified by their names."""
    table = path[1] if len(path) > 2 and path[0] == "problem" else ""
    if len(path) != (4 if table in ELEMENTS else 5 if table in LINKS_AND_LOOPS else 0):
        return path
    items = getattr(study.problem, table)
    tables = [each.model_dump() for each in items]
    item = items[index_of(tables, path[2], f"problem.{table}")]
    return (table, item.label, path[3]) if table in ELEMENTS else (item.name, *path[3:])

"""Inputs by which a study differentiates its trajectories, by the names in its file."""

from __future__ import annotations

from collections.abc import Iterator

from lierb.errors import UnknownNameError, unknown_name
from lierb.model.base import Model
from lierb.model.numbers import owners
from lierb.runs.derivatives import require_differentiable
from lierb.runs.options import Options
from lierb.runs.parameters import Parameter, chosen_parameters, parameters_by_name
from lierb.runs.starts import ready
from lierb.studies.description.batches import Batch
from lierb.studies.description.study_tables import StudyTables

KEY = "sensitivities"


def parameters_of(study: StudyTables, model: Model) -> dict[str, Parameter]:
    """Return the parameters of the run by the names in `sensitivities`.

    Numbers of elements have the names of the file, such as `forces.bearing.damping`; all others
    have those of `with_respect_to` in `lierb.integrate`.

    Raises LierbError for a name that is no input, or a time.
    """
    given, labels = study.integrate.sensitivities, dict(_labels(study, model))
    names = {name: _renamed(name, labels) for name in given}
    for name, own in names.items():
        try:
            chosen_parameters(model, own, KEY)
        except UnknownNameError:
            raise unknown_name(KEY, name, names_of(study, model)) from None
    chosen = chosen_parameters(model, [names[name] for name in given], KEY)
    return dict(zip(given, chosen, strict=True))


def names_of(study: StudyTables, model: Model) -> dict[str, str]:
    """Return the names of all parameters, by their names in the study."""
    in_study = {label: name for name, label in reversed([*_labels(study, model)])}
    return {_renamed(name, in_study): name for name in parameters_by_name(model)}


def check_derivatives(study: StudyTables, batch: Batch, options: Options) -> None:
    """Raise LierbError for inputs by which the trajectories cannot be differentiated."""
    if study.integrate.sensitivities:
        parameters = parameters_of(study, batch.problem)
        prepared = ready(batch.problem, options, batch.pose0, batch.twist0)
        require_differentiable(prepared, tuple(parameters.values()), KEY)


def _labels(study: StudyTables, model: Model) -> Iterator[tuple[str, str]]:
    """Yield the name of each element in the study, and in the model."""
    for (table, section), label in zip(study.problem.elements(), owners(model), strict=True):
        yield f"{table}.{section.label}", label


def _renamed(name: str, labels: dict[str, str]) -> str:
    """Return a name with the label of its element replaced."""
    label, dot, key = name.rpartition(".")
    return f"{labels.get(label, label)}{dot}{key}"

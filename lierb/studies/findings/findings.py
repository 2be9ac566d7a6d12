"""Evaluate a study, setting by setting: error quantiles, failures, observed orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from pydantic import ValidationError

from lierb.analysis.convergence import Order, observed_order
from lierb.analysis.magnitudes import kinds_of
from lierb.errors import StudyError
from lierb.results.failures import has_failed
from lierb.studies.description.quantiles import PROBABILITIES, quantile_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.columns import ok_columns, rows_of
from lierb.studies.findings.linear_theory import LinearTheory, linear_theory
from lierb.studies.findings.occurrences import Occurred, occurrences
from lierb.studies.findings.sizes import sizes_of
from lierb.studies.findings.statistics import (
    Sensitivity,
    Spread,
    observed_columns,
    sensitivities,
    spreads,
)
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

ERRORS = {
    "position": "position_error_max",
    "rotation": "rotation_error_max",
    "energy": "energy_drift_max",
}
LABELS = {"position": "position, m", "rotation": "rotation", "energy": "energy, J"}
QUANTILES = (0.5, 0.95)  # of a setting's errors, beside the largest one
NEGLIGIBLE = 1e-18  # largest error that counts as zero, relative to the problem's scale


@dataclass(frozen=True)
class SettingErrors:
    """Hold the errors of the bodies in one setting of a study.

    bodies : number of finished bodies.   failed : number of those whose status is not ok.
    quantiles : of each of ERRORS, at QUANTILES, and the largest, over the bodies that are ok; NaN
        if there are none, or if the joint has no rows of that error.
    sizes : scale of each of ERRORS; see `lierb.studies.findings.sizes`.
    """

    setting: Setting
    bodies: int
    failed: int
    quantiles: dict[str, Array]
    sizes: dict[str, float]


def study_of(dataset: Results) -> Study:
    """Return the study of a folder's results."""
    try:
        return Study.model_validate(dataset.manifest["study"]).with_code(dataset.code())
    except ValidationError as error:
        raise StudyError(f"{dataset.folder} is of another version of lierb: {error}") from None


def findings(dataset: Results) -> list[SettingErrors]:
    """Evaluate the finished parts, setting by setting."""
    study = study_of(dataset)
    kinds = (*kinds_of(study.batch(0, 1).problem), "energy")
    return [_found(dataset, study, setting, kinds) for setting in study.settings]


def _found(
    dataset: Results, study: Study, setting: Setting, kinds: tuple[str, ...]
) -> SettingErrors:
    names = ["status", *ERRORS.values()]
    rows: pa.Table = dataset.table().to_table(columns=names, filter=rows_of(setting))
    ok = ~has_failed(rows)
    quantiles = {}
    for kind, name in ERRORS.items():
        values = np.sort(rows[name].to_numpy()[ok]) if kind in kinds else np.empty(0)
        largest = values[-1] if len(values) else np.nan
        quantiles[kind] = np.array([*(quantile_of(values, p).value for p in QUANTILES), largest])
    sizes = sizes_of(dataset, study, setting)
    return SettingErrors(setting, len(ok), int((~ok).sum()), quantiles, sizes)


def quantities(dataset: Results, probabilities: Sequence[float] = PROBABILITIES) -> list[Spread]:
    """Return quantiles, with intervals, of the errors that are not zero and of all observables.

    probabilities : of the quantiles; 0.5 is the median.
    """
    study = study_of(dataset)
    units = {kind: label.partition(", ")[2] or "1" for kind, label in LABELS.items()}
    columns = {name: units[kind] for kind, name in errors_seen(dataset, study).items()}
    columns |= observed_columns(dataset, study)
    return list(spreads(dataset, study, columns, probabilities))


def crossings(dataset: Results, probabilities: Sequence[float] = PROBABILITIES) -> list[Occurred]:
    """Return number and quantiles of the first time of each event; [] without events."""
    return list(occurrences(dataset, study_of(dataset), probabilities))


def indices(dataset: Results) -> list[Sensitivity]:
    """Return Sobol's indices of the observables, or else of the errors; [] for other designs."""
    study = study_of(dataset)
    columns = list(observed_columns(dataset, study)) or [*errors_seen(dataset, study).values()]
    return list(sensitivities(dataset, study, columns))


def linear_theories(
    dataset: Results, probabilities: Sequence[float] = PROBABILITIES
) -> list[LinearTheory]:
    """Return the linear theory of a study's outputs; [] without `sensitivities`."""
    return list(linear_theory(dataset, study_of(dataset), probabilities))


def orders(findings: list[SettingErrors], of: SettingErrors) -> dict[str, Order | None]:
    """Return the observed orders of the medians over all dt of a c-space and method."""
    same = [
        f for f in findings
        if (f.setting.cspace, f.setting.method) == (of.setting.cspace, of.setting.method)
    ]  # fmt: skip
    dts = [f.setting.dt for f in same if f.setting.dt is not None]
    if len(set(dts)) < 2 or len(dts) < len(same):
        return dict.fromkeys(ERRORS)
    return {
        kind: observed_order(
            dts, [f.quantiles[kind][0] for f in same], [f.sizes[kind] for f in same]
        )
        for kind in ERRORS
    }


# ---- errors ------------------------------------------------------------------------------------


def errors_seen(dataset: Results, study: Study) -> dict[str, str]:
    """Return the errors that are not negligible, and their columns."""
    seen = set()
    for setting in study.settings:
        columns = ok_columns(dataset, setting, list(ERRORS.values()))
        for kind, size in sizes_of(dataset, study, setting).items():
            if columns[ERRORS[kind]].max(initial=0.0) > NEGLIGIBLE * size:
                seen.add(kind)
    return {kind: name for kind, name in ERRORS.items() if kind in (seen or {"energy"})}


def least_drawn(dataset: Results, study: Study) -> dict[str, float]:
    """Return the least error of each kind that a logarithmic axis shows."""
    sizes = [sizes_of(dataset, study, setting) for setting in study.settings]
    return {kind: NEGLIGIBLE * (min(s[kind] for s in sizes) or 1.0) for kind in ERRORS}

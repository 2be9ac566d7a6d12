"""Evaluate a study, setting by setting: error quantiles, failures, observed orders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from lierb.analysis.convergence import Order, observed_order
from lierb.analysis.magnitudes import kinds_of
from lierb.results.failures import has_failed
from lierb.studies.description.quantiles import quantile_of
from lierb.studies.description.settings import Setting
from lierb.studies.findings.columns import rows_of
from lierb.studies.findings.sizes import ERRORS, sizes_of
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

LABELS = {"position": "position, m", "rotation": "rotation", "energy": "energy, J"}
QUANTILES = (0.5, 0.95)  # of a setting's errors, beside the largest one


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


def findings(dataset: Results) -> list[SettingErrors]:
    """Evaluate the finished parts, setting by setting."""
    kinds = (*kinds_of(dataset.study.batch(0, 1).problem), "energy")
    return [_found(dataset, setting, kinds) for setting in dataset.study.settings]


def _found(dataset: Results, setting: Setting, kinds: tuple[str, ...]) -> SettingErrors:
    names = ["status", *ERRORS.values()]
    rows: pa.Table = dataset.table().to_table(columns=names, filter=rows_of(setting))
    ok = ~has_failed(rows)
    quantiles = {}
    for kind, name in ERRORS.items():
        values = np.sort(rows[name].to_numpy()[ok]) if kind in kinds else np.empty(0)
        largest = values[-1] if len(values) else np.nan
        quantiles[kind] = np.array([*(quantile_of(values, p).value for p in QUANTILES), largest])
    sizes = sizes_of(dataset, setting)
    return SettingErrors(setting, len(ok), int((~ok).sum()), quantiles, sizes)


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

"""Compute characteristic lengths and energies of a study, to tell rounding from error."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.analysis.magnitudes import DRIFTS, magnitudes
from lierb.results.columns import as_array
from lierb.studies.description.settings import Setting
from lierb.studies.findings.columns import ok_columns, rows_of
from lierb.studies.storage.results import IS_SUCCESS, Results
from lierb.support.arrays import components, pose_matrix

BODIES = 64  # number of bodies: the median's order of magnitude is enough
STATE = {"rotation": 9, "position": 3, "omega": 3, "v": 3}
ERRORS = {kind: f"{name}_max" for kind, name in DRIFTS.items()}
NEGLIGIBLE = 1e-18  # largest error that counts as zero, relative to the problem's scale


def errors_seen(dataset: Results) -> dict[str, str]:
    """Return the errors that are not negligible, and their columns."""
    seen = set()
    for setting in dataset.study.settings:
        columns = ok_columns(dataset, setting, list(ERRORS.values()))
        for kind, size in sizes_of(dataset, setting).items():
            if columns[ERRORS[kind]].max(initial=0.0) > NEGLIGIBLE * size:
                seen.add(kind)
    return {kind: name for kind, name in ERRORS.items() if kind in (seen or {"energy"})}


def least_drawn(dataset: Results) -> dict[str, float]:
    """Return the least error of each kind that a logarithmic axis shows."""
    sizes = [sizes_of(dataset, setting) for setting in dataset.study.settings]
    return {kind: NEGLIGIBLE * (min(s[kind] for s in sizes) or 1.0) for kind in ERRORS}


def sizes_of(dataset: Results, setting: Setting) -> dict[str, float]:
    """Return the scales of a setting's errors: position, m; rotation, 1; energy, J.

    Medians over the first bodies, of the larger value of start and end. Position: the problem's
    characteristic length and the distance from the ground's origin. Energy: the kinetic energy, the
    magnitudes of all potential energies, and m g times the characteristic length; of a mechanism
    those of its links, and of gravity.
    """
    study = dataset.study
    prefixes = {link.name: f"{link.name}." for link in study.problem.links} or {"": ""}
    columns = ["trajectory", *(f"{p}{name}" for p in prefixes.values() for name in STATE)]
    chosen = rows_of(setting) & IS_SUCCESS
    rows = dataset.table().head(BODIES, columns=columns, filter=chosen)
    ended = as_array(rows["trajectory"])
    first = int(ended.min()) if rows.num_rows else 0
    count = min(BODIES, len(study.design) - first)
    batch = study.batch(first, count)
    lengths, energies = magnitudes(batch.problem, batch.pose0, batch.twist0)
    if rows.num_rows:
        seen = ended < first + count
        poses: dict[str, Any] = {}
        twists: dict[str, Any] = {}
        for link, prefix in prefixes.items():
            state = {name: np.full((count, width), np.nan) for name, width in STATE.items()}
            for name, values in state.items():
                values[ended[seen] - first] = as_array(rows[f"{prefix}{name}"])[seen]
            place = components(state["rotation"]), components(state["position"])
            poses[link], twists[link] = pose_matrix(place), np.hstack((state["omega"], state["v"]))
        end = (poses, twists) if study.problem.links else (poses[""], twists[""])
        ends = magnitudes(batch.problem, *end)
        lengths, energies = np.fmax(lengths, ends[0]), np.fmax(energies, ends[1])
    return {
        "position": float(np.median(lengths)),
        "rotation": 1.0,
        "energy": float(np.median(energies)),
    }

"""Select the rows and columns of a study's tables that findings and figures read."""

from __future__ import annotations

import numpy as np
import pyarrow.compute as pc

from lierb.results.columns import as_array, unit_of
from lierb.studies.description.settings import Setting
from lierb.studies.storage.results import IS_SUCCESS, Results
from lierb.support.arrays import Array


def rows_of(setting: Setting) -> pc.Expression:
    """Return the filter for the rows of a setting."""
    return (
        (pc.field("cspace") == setting.cspace)
        & (pc.field("method") == setting.method)
        & (pc.field(setting.column) == setting.step)
    )


def ok_columns(dataset: Results, setting: Setting, names: list[str]) -> dict[str, Array]:
    """Read columns of the bodies that are ok in a setting; lists as (n, k)."""
    table = dataset.table().to_table(columns=names, filter=rows_of(setting) & IS_SUCCESS)
    return {name: as_array(table[name]) for name in names}


def drawn_columns(dataset: Results) -> dict[str, str]:
    """Return the names of the columns of sampled quantities, and their units."""
    fields = [field for field in dataset.table().schema if field.name.startswith("sample.")]
    return {field.name: unit_of(field) or "1" for field in fields}


def some_rows(rows: int, most: int) -> Array:
    """Return indices of at most so many rows, at random: Sobol points are periodic."""
    chosen = np.random.default_rng(0).permutation(rows)[:most]
    return np.sort(chosen)

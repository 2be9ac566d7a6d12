"""Columns of the tables that figures show, and their labels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import pyarrow as pa

from lierb.results.columns import unit_of
from lierb.studies.findings.sizes import ERRORS, least_drawn
from lierb.studies.storage.results import Results
from lierb.support.representations import with_unit

AXES = {
    "position": "position error [m]",
    "rotation": "rotation error",
    "energy": "energy drift [J]",
}
KNOWN = {  # columns that other figures have, or that are no results
    "trajectory", "status", "cspace", "method", "dt", "rtol", "step", "t", "dt_last",
    "rotation", "position", "omega", "v", "lambda", "reaction",
}  # fmt: skip


def other_columns(schema: pa.Schema, known: set[str]) -> list[pa.Field]:
    """Return columns of numbers, neither sampled nor known, also of a mechanism's joints."""
    return [
        field for field in schema
        if field.name.rpartition(".")[2] not in known
        and not field.name.startswith("sample.")
        and pa.types.is_floating(field.type)
    ]  # fmt: skip


def axis_label(field: pa.Field) -> str:
    return with_unit(field.name.replace("_", " "), unit_of(field))


class Ordinate(NamedTuple):
    """Axis of a figure for a column of the summary.

    label : the quantity and its unit.   title : of the axis.
    least : largest error that counts as zero, on a logarithmic axis; None on a linear axis.
    """

    column: str
    label: str
    title: str
    least: float | None


def ordinates(dataset: Results, columns: Iterable[str]) -> list[Ordinate]:
    """Return the axes of different columns of the summary; those of errors are logarithmic."""
    schema, least = dataset.table().schema, least_drawn(dataset)
    kinds = {column: kind for kind, column in ERRORS.items()}
    axes = []
    for column in dict.fromkeys(columns):
        if kind := kinds.get(column):
            axes.append(Ordinate(column, AXES[kind], f"largest {AXES[kind]}", least[kind]))
        else:
            label = axis_label(schema.field(column))
            axes.append(Ordinate(column, label, label, None))
    return axes

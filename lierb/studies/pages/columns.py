"""Columns of the tables that figures show, and their labels."""

from __future__ import annotations

import pyarrow as pa

from lierb.studies.findings.columns import field_unit

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
    unit, title = field_unit(field), field.name.replace("_", " ")
    return f"{title} [{unit}]" if unit not in ("", "1") else title

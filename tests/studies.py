"""A small study, and what its results are compared by."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pyarrow as pa

from lierb.studies.dataset import Dataset
from lierb.studies.description.study import Study
from lierb.studies.storage.store import Store

TEXT = """\
[body]
mass = 6.075
inertia = [0.0126563, 0.0468281, 0.0569531]

[joint]
type = "spherical"
body_point = [-0.15, 0.0375, 0.0]

[problem]
gravity = [0.0, 0.0, -9.81]

[[problem.forces]]
type = "drag"
linear = 0.1

[sample]
n = 50
seed = 3

[sample.initial.omega]
distribution = "normal"
mean = [6.28, 3.14, 0.63]
std = 0.5

[sample.body.mass]
distribution = "uniform"
low = 5.0
high = 7.0

[sample.forces.drag.linear]
distribution = "uniform"
low = 0.0
high = 0.2

[integrate]
cspace = ["SE3", "SO3xR3"]
dt = [1e-3, 2e-3]
t_end = 0.05

[output]
part = 8
"""
PARTS = 2 * 2 * 7
BLANK = "data:image/svg+xml;base64,PHN2Zz48L3N2Zz4="  # a figure of a page


def tables() -> dict:
    """Tables of TEXT."""
    return tomllib.loads(TEXT)


def study(**changes) -> Study:
    """The study of TEXT with some tables changed: `sample={"seed": 4}`."""
    changed = tables()
    for name, values in changes.items():
        changed[name] = changed.get(name, {}) | values
    return Study.of(changed)


def sorted_rows(folder, name="summary") -> list[dict]:
    """A table's rows, by setting and body."""
    found = Dataset(folder)
    found.read()
    rows = found.table(name).to_table().to_pylist()
    return sorted(rows, key=lambda row: (row["cspace"], row["dt"], row["trajectory"]))


def bits(folder, name="summary") -> dict:
    """Every column of a table, sorted by setting, body and step or time, as bytes."""
    found = Dataset(folder)
    found.read()
    table = found.table(name).to_table()
    for column in ("cspace", "method", "status", "event"):
        if column in table.column_names:
            text = table[column].cast(pa.string())
            table = table.set_column(table.column_names.index(column), column, text)
    order = ("cspace", "dt", "rtol", "trajectory", "step", "t")
    keys = [key for key in order if key in table.column_names]
    table = table.sort_by([(key, "ascending") for key in keys]).combine_chunks()
    return {column: _bytes(table[column].combine_chunks()) for column in table.column_names}


def _bytes(column: pa.Array) -> bytes | list:
    if pa.types.is_string(column.type):
        return column.to_pylist()
    if pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return column.to_numpy(zero_copy_only=False).tobytes()


def hashes(folder) -> dict:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def start(tmp_path, *options, text=TEXT) -> subprocess.Popen:
    """`lierb run` on a study of that text, in a session of its own as in a terminal."""
    file = tmp_path / "study.toml"
    file.write_text(text)
    return subprocess.Popen(
        [sys.executable, "-m", "lierb", "run", str(file), "--out", str(tmp_path / "out"), *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def start_long(tmp_path, *options) -> subprocess.Popen:
    """A run of many seconds, its first part finished."""
    text = TEXT.replace("n = 50", "n = 40_000").replace("part = 8", "part = 128")
    process = start(tmp_path, *options, text=text.replace("t_end = 0.05", "t_end = 1.0"))
    while not (tmp_path / "out" / "summary").exists() and process.poll() is None:
        time.sleep(0.1)
    return process


def errors_when_stopped(process, out) -> str:
    """Output of an interrupted run whose finished parts are whole."""
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    stopped = Store(out)
    stopped.read()
    assert stopped.parts
    assert stopped.drop_damaged() == []
    return errors

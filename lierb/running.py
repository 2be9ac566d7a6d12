"""Running a study: part by part into a folder, or as a stream of record batches."""

from __future__ import annotations

import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lierb.api import integrate
from lierb.arrays import Array
from lierb.dataset import Dataset
from lierb.errors import ArgumentError, StudyError, StudyWarning
from lierb.provenance import machine
from lierb.sampling import Design
from lierb.study import Batch, Setting, Study, tables_of

Progress = Callable[[int, int], None]
HISTORY_BYTES = 64e6  # of a part's history, at most
HISTORY_ROW_BYTES = 100  # about, without what `record` adds
STATE_BYTES = 144


@dataclass(frozen=True)
class Part:
    """Some bodies in one setting of a study."""

    name: str
    setting: Setting
    first: int
    count: int


def parts_of(study: Study) -> list[Part]:
    """All parts, setting by setting."""
    bodies, size = len(study.design), part_size(study)
    return [
        Part(f"{s:02d}-{first:010d}", setting, first, min(size, bodies - first))
        for s, setting in enumerate(study.settings)
        for first in range(0, bodies, size)
    ]


def part_size(study: Study) -> int:
    """Bodies in a part: as the study says, fewer if their history would not fit the memory."""
    run = study.integrate
    if run.save_every is None:
        return study.output.part
    row = HISTORY_ROW_BYTES + STATE_BYTES * ("state" in run.record)
    rows = run.t_end / min(run.dt) / run.save_every + 2
    return max(1, min(study.output.part, int(HISTORY_BYTES / row / rows)))


def run(
    study: Study | str | Path,
    out: str | Path,
    *,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Run a study into a folder, part by part; memory does not grow with the study.

    study : a Study, or the path of its TOML file.   out : a folder; made if need be.
    resume : go on where an earlier run of the same study stopped: finished parts are kept, those
        that are missing or damaged are done (again). The results are the same, bit for bit.
    threads : as in `lierb.integrate`.
    progress : a function of (body-steps done, body-steps in all).

    Raises StudyError for a study that is wrong, for a folder that has results already (without
    `resume`), those of another study, or another run that writes to it. After Ctrl-C the part
    under way is finished first; a second Ctrl-C loses it.
    """
    given, text = _loaded(study)
    dataset = Dataset(out)
    with dataset.locked():
        _opened(dataset, given, text, resume)
        parts = parts_of(given)
        steps = {part.name: part.count * _steps(given, part.setting) for part in parts}
        left = [part for part in parts if part.name not in dataset.parts]
        done, total = sum(steps[name] for name in dataset.parts), sum(steps.values())
        design = given.design
        with _interruptible() as stopping:
            for part in left:
                if stopping.is_set():
                    raise KeyboardInterrupt
                before = done

                def told(now: int, _all: int, before: int = before) -> None:
                    if progress is not None:
                        progress(before + now, total)

                tables = _tables(given, part, design, threads, told)
                dataset.add(part.name, tables, given.output.compression)
                done += steps[part.name]
                told(steps[part.name], 0)
    return dataset


def integrate_batches(
    study: Study | str | Path, table: str = "summary", *, threads: int | None = None
) -> pa.RecordBatchReader:
    """A study's results as a stream, for those who want no files.

    table : "summary", or "errors" if the study has `save_every`.
    Returns a pyarrow.RecordBatchReader; each batch is integrated when it is asked for.
    """
    given, _ = _loaded(study)
    if table not in ("summary", "errors") or (table == "errors" and not given.integrate.save_every):
        raise ArgumentError(f'table={table!r}; expected "summary", or "errors" with save_every')
    design = given.design
    made = (_tables(given, part, design, threads, None)[table] for part in parts_of(given))
    first = next(made)

    def batches() -> Iterator[pa.RecordBatch]:
        yield from first.to_batches()
        for each in made:
            yield from each.to_batches()

    return pa.RecordBatchReader.from_batches(first.schema, batches())


def compile_for(study: Study | str | Path) -> list[tuple[Setting, float]]:
    """Compile what a study needs, setting by setting; the seconds that each took."""
    given, _ = _loaded(study)
    batch = given.batch(0, 1)
    took = []
    for setting in given.settings:
        options = given.options(setting) | {"t_end": setting.dt}
        began = time.perf_counter()
        integrate(batch.problem, twist0=batch.twist0, pose0=batch.pose0, progress=False, **options)
        took.append((setting, time.perf_counter() - began))
    return took


def replay(
    study: Study | str | Path, body: int, *, save_every: int = 1, threads: int | None = None
) -> list[tuple[Setting, dict[str, pa.Table]]]:
    """One body of a study alone, with everything recorded, in each of the study's settings.

    Its row of the summary is that of the study, bit for bit.
    """
    given, _ = _loaded(study)
    bodies = len(given.design)
    if not 0 <= body < bodies:
        raise StudyError(f"body {body} is not in the study; it has bodies 0 … {bodies - 1}")
    fixed = replace_integrate(given, save_every)
    return [
        (setting, _tables(fixed, Part("", setting, body, 1), given.design, threads, None))
        for setting in fixed.settings
    ]


def replace_integrate(study: Study, save_every: int) -> Study:
    """The study with the whole history recorded."""
    record = ["state", "energy", "multipliers", "reaction"]
    changed = study.integrate.model_copy(update={"save_every": save_every, "record": record})
    return study.model_copy(update={"integrate": changed})


def _loaded(study: Study | str | Path) -> tuple[Study, str]:
    """The study, and the text of its file."""
    if isinstance(study, Study):
        return study, study.to_toml()
    return Study.load(study), Path(study).read_text(encoding="utf-8")


def _opened(dataset: Dataset, study: Study, text: str, resume: bool) -> None:
    if dataset.exists():
        dataset.read()
    if not dataset.parts:
        dataset.begin(study.digest(), study.model_dump(), text, len(parts_of(study)))
        return
    if dataset.manifest["digest"] != study.digest():
        raise StudyError(
            f"{dataset.folder} has the results of another study: {_differences(dataset, study)}"
        )
    if not resume:
        raise StudyError(
            f"{dataset.folder} has results of this study already; --resume (resume=True) does what "
            "is missing, or choose another folder"
        )
    if dataset.manifest["machine"] != machine():
        warnings.warn(
            f"{dataset.folder} was begun with other versions or on another machine; what is done "
            "now may differ from its parts in the last bits",
            StudyWarning,
            stacklevel=3,
        )
    dataset.drop_damaged()


def _differences(dataset: Dataset, study: Study) -> str:
    there, here = dict(tables_of(dataset.manifest["study"])), dict(tables_of(study.model_dump()))
    keys = [key for key in there | here if there.get(key) != here.get(key)]
    return ", ".join(f"{k} = {there.get(k)} there, {here.get(k)} here" for k in keys[:5])


def _steps(study: Study, setting: Setting) -> int:
    return round(study.integrate.t_end / setting.dt)


def _tables(
    study: Study, part: Part, design: Design, threads: int | None, progress: Progress | None
) -> dict[str, pa.Table]:
    """A part's tables, its bodies by their numbers in the study."""
    batch = study.batch(part.first, part.count, design)
    result = integrate(
        batch.problem, twist0=batch.twist0, pose0=batch.pose0, threads=threads,
        progress=progress or False, **study.options(part.setting),
    )  # fmt: skip
    tables = {"summary": _labelled(result.summary, part, batch)}
    if result.errors is not None:
        tables["errors"] = _labelled(result.errors, part, None)
    return tables


def _labelled(table: pa.Table, part: Part, batch: Batch | None) -> pa.Table:
    """With its setting before, and what was sampled behind."""
    rows = table.num_rows
    bodies = pa.array(table["body"].to_numpy() + part.first)
    table = table.set_column(0, table.schema.field("body"), bodies)
    setting = part.setting
    dt = pa.array(np.full(rows, setting.dt))
    table = table.add_column(0, pa.field("dt", dt.type, metadata={"unit": "s"}), dt)
    table = table.add_column(0, "method", _repeated(setting.method, rows))
    table = table.add_column(0, "cspace", _repeated(setting.cspace, rows))
    for name, values in (batch.draws if batch else {}).items():
        table = table.append_column(f"sample.{name}", _column(values))
    return table


def _repeated(value: str, rows: int) -> pa.Array:
    return pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), [value])


def _column(values: Array) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    if values.ndim == 1:
        return flat
    return pa.FixedSizeListArray.from_arrays(flat, int(np.prod(values.shape[1:])))


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second one interrupts."""
    stopping = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stopping
        return
    before = signal.getsignal(signal.SIGINT)

    def stop(number: int, frame: Any) -> None:
        stopping.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    try:
        yield stopping
    finally:
        signal.signal(signal.SIGINT, before)

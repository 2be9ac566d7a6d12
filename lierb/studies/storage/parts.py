"""Divide a study into parts: ranges of bodies in one setting, each with its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from lierb.api import integrate_model
from lierb.results.columns import as_array, numbers, repeated, vectors
from lierb.results.result import Result
from lierb.results.sensitivities import SEPARATOR
from lierb.results.tables import event_row_bytes, history_row_bytes
from lierb.runs.derivatives import derivative_bytes
from lierb.runs.lane_engine import SHARES
from lierb.runs.starts import ready
from lierb.sampling import Design
from lierb.studies.description.batches import Batch
from lierb.studies.description.differentiated import parameters_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.description.units import unit_of
from lierb.support.collected_warnings import warnings_collected

Progress = Callable[[int, int], None]
HISTORY_BYTES = 64e6  # most bytes of a part's history and derivatives
HISTORY_ROW_BYTES = 100  # bytes of a row, about, without the columns of `record`
STATE_BYTES = 144  # bytes of a body's state
JOINT_BYTES = 32  # bytes of a joint's errors
# Estimates for the parts of fixed-step studies; unchanged, so that old studies can be resumed.
# Rows of trajectories with their own clocks or derivatives are counted to the byte.
LABEL_BYTES = 16  # bytes of a row's cspace, method and dt
EVENTS_FORESEEN = 10  # assumed crossings of each event in a trajectory


@dataclass(frozen=True)
class Part:
    """A part is a range of bodies in one setting of a study."""

    name: str
    setting: Setting
    first: int
    count: int

    def work(self, study: Study) -> int:
        """Return the work in body-steps, or in shares of trajectories with steps of their own."""
        if study.has_lane_clocks:
            return self.count * SHARES
        run = study.integrate
        return self.count * round((run.t_end - run.t0) / self.setting.step)

    def tables(
        self, study: Study, design: Design, threads: int | None, progress: Progress | None = None
    ) -> dict[str, pa.Table]:
        """Integrate the bodies; return `summary`, and `history` and `events` if there are any."""
        batch, result = self.run(study, design, threads, progress)
        summary = _with_draws(self._labelled(result.summary), study, batch)
        tables = {"summary": _with_derivatives(summary, result)}
        if result.history is not None:
            tables["history"] = self._labelled(result.history)
        if result.events is not None:
            tables["events"] = self._labelled(result.events)
        return tables

    def run(
        self,
        study: Study,
        design: Design,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> tuple[Batch, Result]:
        """Integrate the bodies; return them and the result, which numbers them from 0."""
        batch = study.batch(self.first, self.count, design)
        start = batch.start
        pose0, twist0 = start.pop("pose0"), start.pop("twist0")
        options = study.options(self.setting, batch.problem, **start)
        parameters = parameters_of(study, batch.problem)
        with warnings_collected():
            result = integrate_model(
                batch.problem,
                options,
                pose0,
                twist0,
                with_respect_to=[p.name for p in parameters.values()],
                threads=threads,
                progress=progress or False,
            )
        if result.sensitivities is not None:
            result = replace(result, sensitivities=result.sensitivities.named([*parameters]))
        return batch, result

    def _labelled(self, table: pa.Table) -> pa.Table:
        """Number the trajectories as in the study, and insert columns of the setting."""
        rows = table.num_rows
        own = numbers(as_array(table["trajectory"]) + self.first)
        table = table.set_column(0, table.schema.field("trajectory"), own)
        step, unit = numbers(np.full(rows, self.setting.step)), {"dt": "s", "rtol": "1"}
        metadata = {"unit": unit[self.setting.column]}
        table = table.add_column(
            0, pa.field(self.setting.column, step.type, metadata=metadata), step
        )
        table = table.add_column(0, "method", repeated(self.setting.method, rows))
        return table.add_column(0, "cspace", repeated(self.setting.cspace, rows))


class Parts:
    """All parts of a study, setting by setting; each is made when it is reached.

    Names sort as the parts do: numbers are as wide as the study's largest.
    """

    def __init__(self, study: Study) -> None:
        self._study, self._settings = study, study.settings
        self._bodies, self._size = len(study.design), part_size(study)
        self.total = -(-self._bodies // self._size) * len(self._settings)
        self._widths = (
            max(2, len(str(len(self._settings) - 1))), max(10, len(str(self._bodies - 1))),
        )  # fmt: skip

    def __iter__(self) -> Iterator[Part]:
        return (
            self._part(setting, first)
            for setting in range(len(self._settings))
            for first in range(0, self._bodies, self._size)
        )

    def named(self, name: str) -> Part | None:
        """Return the part of that name, or None."""
        setting, _, first = name.partition("-")
        if not (setting.isdecimal() and first.isdecimal()):
            return None
        s, b = int(setting), int(first)
        if s >= len(self._settings) or b >= self._bodies or b % self._size:
            return None
        part = self._part(s, b)
        return part if part.name == name else None

    @property
    def trajectories(self) -> int:
        return self._bodies * len(self._settings)

    def work(self, names: Iterable[str] | None = None) -> int:
        """Return the work of the parts of these names, by default of all; see `Part.work`."""
        if names is None:
            counted = [Part("", setting, 0, self._bodies) for setting in self._settings]
        else:
            counted = [part for part in map(self.named, names) if part is not None]
        return sum(part.work(self._study) for part in counted)

    def _part(self, setting: int, first: int) -> Part:
        name = f"{setting:0{self._widths[0]}d}-{first:0{self._widths[1]}d}"
        count = min(self._size, self._bodies - first)
        return Part(name, self._settings[setting], first, count)


def part_size(study: Study) -> int:
    """Return the number of bodies in a part: the study's, or fewer if the memory is short."""
    run = study.integrate
    if study.has_lane_clocks or run.sensitivities:
        return max(1, min(study.output.part, int(HISTORY_BYTES / max(1, bytes_of_body(study)))))
    if run.save_every is None:
        return study.output.part
    links, joints = max(1, len(study.problem.links)), len([*study.problem.links_and_loops()])
    row = HISTORY_ROW_BYTES + JOINT_BYTES * joints + STATE_BYTES * links * ("state" in run.record)
    rows = (run.t_end - run.t0) / min(run.dt) / run.save_every + 2
    return max(1, min(study.output.part, int(HISTORY_BYTES / row / rows)))


def bytes_of_body(study: Study) -> int:
    """Return the bytes of a trajectory's `history` and `events`, and of its derivatives."""
    run, problem = study.integrate, study.batch(0, 1).problem
    each = (LABEL_BYTES + event_row_bytes(problem)) * EVENTS_FORESEEN * len(problem.events)
    each += saved_rows(study) * (LABEL_BYTES + history_row_bytes(problem, run.record))
    return each + bytes_of_derivatives(study)


def bytes_of_derivatives(study: Study) -> int:
    """Return the bytes of a trajectory's derivatives, in the setting with most of them."""
    batch = study.batch(0, 1)
    parameters = tuple(parameters_of(study, batch.problem).values())
    options = [study.options(each, batch.problem) for each in study.settings if parameters]
    runs = (ready(batch.problem, each, batch.pose0, batch.twist0) for each in options)
    return max((derivative_bytes(each, parameters) for each in runs), default=0)


def saved_rows(study: Study) -> int:
    """Return the number of a trajectory's rows in the history, in the setting with most of them."""
    run = study.integrate
    if run.times is not None:
        return len(run.times)
    if run.save_every is None:
        return 0
    return max(-(-round((run.t_end - run.t0) / dt) // run.save_every) for dt in run.dt) + 1


def _with_draws(table: pa.Table, study: Study, batch: Batch) -> pa.Table:
    """Append columns of the sampled quantities, with their units."""
    for name, values in batch.draws.items():
        flat = values.reshape(len(values), -1)
        column = numbers(flat) if values.ndim == 1 else vectors(flat)
        unit = unit_of(name, study, batch.problem)
        metadata = {"unit": unit} if unit else None
        table = table.append_column(
            pa.field(f"sample.{name}", column.type, metadata=metadata), column
        )
    return table


def _with_derivatives(table: pa.Table, result: Result) -> pa.Table:
    """Append the derivatives at the end of each trajectory, such as `pose/body.mass`."""
    if result.sensitivities is None:
        return table
    derivatives = result.sensitivities.summary
    for field in derivatives.schema:
        if SEPARATOR in field.name:
            table = table.append_column(field, derivatives[field.name])
    return table

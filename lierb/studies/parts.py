"""A study's parts: which bodies in which setting, and the tables that come of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import pyarrow as pa

from lierb.api import integrate
from lierb.arrays import Array
from lierb.runs.columns import as_array, numbers, repeated, vectors
from lierb.runs.failures import told_elsewhere
from lierb.sampling import Design
from lierb.studies.study import Batch, Setting, Study
from lierb.studies.units import unit_of

Progress = Callable[[int, int], None]
HISTORY_BYTES = 64e6  # of a part's history, at most
HISTORY_ROW_BYTES = 100  # about, without what `record` adds
STATE_BYTES = 144  # of a body
JOINT_BYTES = 32  # of the errors of each joint of a mechanism


@dataclass(frozen=True)
class Part:
    """Some bodies in one setting of a study."""

    name: str
    setting: Setting
    first: int
    count: int

    def body_steps(self, study: Study) -> int:
        run = study.integrate
        return self.count * round((run.t_end - run.t0) / self.setting.dt)

    def tables(
        self, study: Study, design: Design, threads: int | None, progress: Progress | None = None
    ) -> dict[str, pa.Table]:
        """What its bodies do: `summary`, and `history` if there is a history."""
        batch = study.batch(self.first, self.count, design)
        with told_elsewhere():
            result = integrate(
                batch.problem, twist0=batch.twist0, pose0=batch.pose0, threads=threads,
                progress=progress or False, **study.options(self.setting),
            )  # fmt: skip
        tables = {"summary": _with_draws(self._labelled(result.summary), study, batch)}
        if result.history is not None:
            tables["history"] = self._labelled(result.history)
        return tables

    def _labelled(self, table: pa.Table) -> pa.Table:
        """With the trajectories' numbers in the study, and the setting before."""
        rows = table.num_rows
        own = numbers(as_array(table["trajectory"]) + self.first)
        table = table.set_column(0, table.schema.field("trajectory"), own)
        dt = numbers(np.full(rows, self.setting.dt))
        table = table.add_column(0, pa.field("dt", dt.type, metadata={"unit": "s"}), dt)
        table = table.add_column(0, "method", repeated(self.setting.method, rows))
        return table.add_column(0, "cspace", repeated(self.setting.cspace, rows))


class Parts(Sequence[Part]):
    """All parts of a study, setting by setting, each made when it is asked for.

    Names sort as the parts do: numbers are as wide as the study's largest.
    """

    def __init__(self, study: Study) -> None:
        self._study, self._settings = study, study.settings
        self._bodies, self._size = len(study.design), part_size(study)
        self._each = -(-self._bodies // self._size)  # of a setting
        self.total = self._each * len(self._settings)  # may be more than `len` can say
        self._widths = (
            max(2, len(str(len(self._settings) - 1))), max(10, len(str(self._bodies - 1))),
        )  # fmt: skip

    def __len__(self) -> int:
        return self.total

    def __iter__(self) -> Iterator[Part]:
        return (
            self._part(setting, first)
            for setting in range(len(self._settings))
            for first in range(0, self._bodies, self._size)
        )

    @overload
    def __getitem__(self, number: int) -> Part: ...
    @overload
    def __getitem__(self, number: slice) -> list[Part]: ...
    def __getitem__(self, number: int | slice) -> Part | list[Part]:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(self.total))]
        if not -self.total <= number < self.total:
            raise IndexError(f"part {number} of {self.total}")
        setting, n = divmod(number % self.total, self._each)
        return self._part(setting, n * self._size)

    def named(self, name: str) -> Part | None:
        """The part of that name, if there is one."""
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

    def body_steps(self, names: Iterable[str] | None = None) -> int:
        """Of the parts of these names, of all if None."""
        if names is None:
            counted = [Part("", setting, 0, self._bodies) for setting in self._settings]
        else:
            counted = [part for part in map(self.named, names) if part is not None]
        return sum(part.body_steps(self._study) for part in counted)

    def _part(self, setting: int, first: int) -> Part:
        name = f"{setting:0{self._widths[0]}d}-{first:0{self._widths[1]}d}"
        count = min(self._size, self._bodies - first)
        return Part(name, self._settings[setting], first, count)


def parts_of(study: Study) -> Parts:
    """All parts, setting by setting."""
    return Parts(study)


def part_size(study: Study) -> int:
    """Bodies in a part: as the study says, fewer if their history would not fit the memory."""
    run = study.integrate
    if run.save_every is None:
        return study.output.part
    links, joints = max(1, len(study.problem.links)), len([*study.problem.held()])
    row = HISTORY_ROW_BYTES + JOINT_BYTES * joints + STATE_BYTES * links * ("state" in run.record)
    rows = (run.t_end - run.t0) / min(run.dt) / run.save_every + 2
    return max(1, min(study.output.part, int(HISTORY_BYTES / row / rows)))


def _with_draws(table: pa.Table, study: Study, batch: Batch) -> pa.Table:
    """With what its bodies drew behind, in its units."""
    for name, values in batch.draws.items():
        column = _column(np.ascontiguousarray(values))
        unit = unit_of(name, study, batch.problem)
        told = {"unit": unit} if unit else None
        table = table.append_column(pa.field(f"sample.{name}", column.type, metadata=told), column)
    return table


def _column(values: Array) -> pa.Array:
    """Numbers, or flat lists of a body's numbers."""
    return numbers(values) if values.ndim == 1 else vectors(values.reshape(len(values), -1))

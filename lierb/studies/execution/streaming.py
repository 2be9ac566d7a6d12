"""Stream the results of a study as record batches, without files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pyarrow as pa

from lierb.results.failures import Failures, warn_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.stopping import Bodies
from lierb.studies.description.study import Study
from lierb.studies.description.study_tables import require_table
from lierb.studies.execution.foreseen import warn_before
from lierb.studies.execution.opening import loaded
from lierb.studies.execution.replaying import REPLAY
from lierb.studies.storage.parts import Parts


def integrate_batches(
    study: Study | str | Path, table: str = "summary", *, threads: int | None = None
) -> pa.RecordBatchReader:
    """Stream a study's results, without files.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its TOML file.
    table : {"summary", "history", "events"}, optional
        Table to stream: "history" if the study has `save_every` or `save_at`, "events" if its
        problem has events.
    threads : int, optional
        Number of threads, as in `lierb.integrate`.

    Returns
    -------
    pyarrow.RecordBatchReader
        Reader; each batch is integrated when it is read.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed. The warning comes at the end.
    StiffStepWarning
        Fixed steps are too long for a force of `lierb.forces`, as in `lierb.integrate`.

    Examples
    --------
    >>> import lierb
    >>> study = lierb.Study.of({
    ...     "body": {"mass": 6.075, "inertia": [0.0126563, 0.0468281, 0.0569531]},
    ...     "joint": {"type": "spherical", "body_point": [-0.15, 0.0375, 0.0]},
    ...     "initial": {"omega": [6.28, 3.14, 0.63]},
    ...     "sample": {"n": 5},
    ...     "integrate": {"dt": 1e-3, "t_end": 0.1},
    ... })
    >>> sum(batch.num_rows for batch in lierb.integrate_batches(study))
    5
    """
    given, _ = loaded(study)
    warn_before(given, stacklevel=3)
    require_table("table", table, given.table_names)
    design, parts, rule = given.design, Parts(given), given.stopping_rule

    def made() -> Iterator[pa.Table]:
        seen: Failures | None = None
        bodies: dict[Setting, Bodies] = {}
        for part in parts:
            if rule is not None:
                known = bodies.setdefault(part.setting, Bodies(rule, design))
                if known.count and rule.holds(known):
                    continue
            tables = part.tables(given, design, threads)
            if failures := Failures.of(tables["summary"]):
                own = replace(failures, setting=part.setting.label)
                seen = Failures.joined([seen, own] if seen else [own], parts.trajectories)
            if rule is not None:
                known.add(tables["summary"])
            yield tables[table]
        warn_of(seen, REPLAY, stacklevel=4)

    tables = made()
    first = next(tables)
    batches = (batch for each in chain([first], tables) for batch in each.to_batches())
    return pa.RecordBatchReader.from_batches(first.schema, batches)

"""Studies: Monte Carlo runs described by a TOML file or by equivalent Python dictionaries.

    [body]         mass, inertia, com; or solid = "box" … with its size and density
    [joint]        type and frames, as `lierb.joints` takes them
    [problem]      gravity, forces, constraints, observables, events, states, controllers; for a
                   mechanism also links and loops
    [initial]      omega, point_velocity, twist, velocities; coordinates, rotation, place
    [sample]       n, seed, method; and for each sampled quantity a table [sample.SECTION.KEY]
    [integrate]    cspace, method, dt or rtol: one value or several, run as a product; t_end, …
    [output]       bodies in a part, compression

A file is validated as a whole before the run; messages name the line and key of an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from lierb.errors import LierbError, StudyError
from lierb.kernels.systems.plan import Stabilisation
from lierb.model.base import Model
from lierb.model.formulation import baumgarte
from lierb.runs.options import Options
from lierb.sampling import Design
from lierb.studies.description import checks, differentiated
from lierb.studies.description.batches import Batch, batch_of
from lierb.studies.description.changes import applied
from lierb.studies.description.code import Code, named, read_code
from lierb.studies.description.messages import Given, at, located, messages
from lierb.studies.description.sections.running import Baumgarte
from lierb.studies.description.settings import Setting, settings_label
from lierb.studies.description.sources import LONGEST_STUDY, name_of, path_given
from lierb.studies.description.stopping import Rule, rule_of
from lierb.studies.description.study_file import (
    ELEMENTS,
    TOO_LARGE,
    plain,
    plain_changes,
    read,
    tables_in,
)
from lierb.studies.description.study_tables import NEW_KEYS, StudyTables
from lierb.support.representations import FAILED, Lines, Represented, counted

PREVIEW = 8  # number of bodies made to check a study
BODIES = ("body", "bodies")


class Study(Represented, StudyTables):
    """Study, validated by `of` or `load`.

    Raises
    ------
    StudyError
        The study is invalid; the message names the key. It is a ValueError.

    Examples
    --------
    >>> import lierb
    >>> study = lierb.Study.of({
    ...     "body": {"solid": "box", "size": [0.1, 0.2, 0.3], "mass": 1.0},
    ...     "joint": {"type": "revolute", "axis": [0, 1, 0]},
    ...     "sample": {"n": 100, "initial": {"omega": {
    ...         "distribution": "normal", "mean": [0, 3, 0], "std": 0.1,
    ...     }}},
    ...     "integrate": {"dt": 1e-3, "t_end": 1.0},
    ... })
    >>> study.batch(0, 100).twist0.shape
    (100, 6)
    """

    @classmethod
    def of(
        cls,
        tables: dict[str, Any],
        source: str = "study",
        text: str = "",
        changes: Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
        code: Code | None = None,
    ) -> Study:
        """Make a study from the tables of its file.

        Parameters
        ----------
        tables : dict
            Tables of the file; see the page on the study file.
        source : str, optional
            Name of the file, for messages.
        text : str, optional
            Text of the file, for messages.
        changes : dict, optional
            Changes of the tables, by dotted keys: {"sample.n": 1000}.
        folder : path, optional
            Folder of the Python files to which the study refers. `of` executes them.
        code : Code, optional
            Texts of these files, by name, in place of the folder.

        Returns
        -------
        Study
            The study.

        Raises
        ------
        StudyError
            The study is wrong; the message names the key.
        """
        given = Given(source, text, {})
        try:
            given = Given(source, text, plain_changes(changes or {}))
            tables = applied(plain(tables), given.changes)
            study = cls.model_validate(tables)
            files = study.files
            study = study.with_code(
                read_code(path_given(folder), files) if folder is not None else code or {}
            )
            study.check()
            checks.require_effect(study, given.changes)
        except ValidationError as error:
            raise StudyError(messages(error, cls, tables, given)) from None
        except StudyError as error:
            raise StudyError(located(str(error), given)) from None
        return study

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Study:
        """Read a study from its TOML file.

        Parameters
        ----------
        path : path
            The file.
        changes : dict, optional
            Changes of its tables, by dotted keys: {"sample.n": 1000}.

        Returns
        -------
        Study
            The study.

        Raises
        ------
        StudyError
            The study is wrong; the message names line and key.
        ArgumentError
            `path` cannot be converted to a path.
        OSError
            The file does not exist.
        """
        path = path_given(path)
        text = read(path)
        tables = {"name": name_of(path)} | tables_in(text, path.name)
        return cls.of(tables, path.name, text, changes, path.parent)

    def check(self) -> None:
        """Make the first bodies, and validate every setting.

        Raises StudyError.
        """
        if len(self.to_toml().encode()) > LONGEST_STUDY:
            raise StudyError(f"study: is {TOO_LARGE}")
        checks.check_kind(self)
        checks.check_settings(self.integrate)
        with at("sample"):
            design = self.design
            batch = self.batch(0, min(PREVIEW, len(design)), design)
        if self.sample.stop_when is not None:
            rule_of(self.sample.stop_when, batch.problem, self.has_lane_clocks)
            checks.check_stopping(design)
        checks.check_labels(self)
        with at("initial"), np.errstate(all="ignore"):
            if error := batch.problem.violation(batch.pose0, batch.twist0, self.integrate.t0):
                raise error
        for setting in self.settings:
            with at("integrate", (*NEW_KEYS, "save_every", differentiated.KEY)):
                options = self.options(setting, batch.problem)
                differentiated.check_derivatives(self, batch, options)
        checks.check_seed(self)

    def _representation(self) -> tuple[str, Lines]:
        run = self.integrate
        *some, last = self.table_names
        tables = f"{', '.join(some)} and {last}" if some else last
        rows = [
            ("settings", settings_label(run)),
            ("times", f"{run.t0:g} … {run.t_end:g} s"),
            ("tables", f"{tables}, in parts of at most {counted(self.output.part, *BODIES)}"),
        ]
        try:
            count, quantities = counted(len(self.design), *BODIES), self.sample.quantities()
        except LierbError as error:  # for a study made without `of`
            return f"lierb.Study {self.name!r}", [*rows, (FAILED, str(error))]
        drawn = "\n".join(f"{path}: {value!r}" for path, value in quantities.items())
        rows.insert(0, ("sampled", drawn or "nothing"))
        if self.problem.links:
            several = self.kind.replace("mechanism", "mechanisms", 1)
            of_all = self.kind if len(self.design) == 1 else several
            return f"lierb.Study {self.name!r}: {len(self.design)} {of_all}", rows
        return f"lierb.Study {self.name!r}: {count} on a {self.kind}", rows

    __str__ = Represented.__repr__

    @property
    def has_lane_clocks(self) -> bool:
        """True if each trajectory has its own steps."""
        run, has = self.integrate, self.problem
        given = (run.save_at, run.max_steps, run.discontinuities)
        is_timed = run.is_adaptive or any(x is not None for x in given)
        if is_timed or has.events or has.states or has.controllers:
            return True
        return bool(self.files) and self.batch(0, 1).problem.has_jumps

    @property
    def stabilise(self) -> str | Stabilisation | None:
        """Return the argument of `lierb.integrate`."""
        own = self.integrate.stabilise
        return baumgarte(**own.model_dump()) if isinstance(own, Baumgarte) else own

    def keywords(self, setting: Setting) -> dict[str, Any]:
        """Return the keywords of `lierb.integrate` in a setting, beside those of the bodies."""
        run = self.integrate
        return {
            "stabilise": self.stabilise, "cspace": setting.cspace, "method": setting.method,
            "dt": setting.dt, "t_end": run.t_end, "t0": run.t0, "update": run.update,
            "solver": run.solver, "save_every": run.save_every, "save_at": run.times,
            "measure_every": run.measure_every,
            "record": tuple(run.record), "rtol": setting.rtol, "atol": run.atol,
            "dt_min": run.dt_min, "dt_max": run.dt_max, "max_steps": run.max_steps,
            "discontinuities": run.discontinuities,
        }  # fmt: skip

    def options(self, setting: Setting, model: Model, **own: Any) -> Options:
        """Return the options of a run. Raises the errors of `lierb.integrate`.

        own : keywords of `lierb.integrate` that replace those of the study.
        """
        return Options.of(model, **self.keywords(setting) | own)

    @property
    def stopping_rule(self) -> Rule | None:
        """Rule that ends the study early; None if all bodies are run."""
        text = self.sample.stop_when
        if text is None:
            return None
        return rule_of(text, self.batch(0, 1).problem, self.has_lane_clocks)

    def fingerprints(self) -> dict[str, str]:
        """Return fingerprints of the functions in the study's files, by list and label."""
        problem = self.batch(0, 1).problem
        made = {table: getattr(problem, table) for table in ELEMENTS}
        return {
            f"{table}.{section.label}": " ".join(f.fingerprint for f in element.kind.functions)
            for table, elements in made.items()
            for section, element in zip(getattr(self.problem, table), elements, strict=True)
            if named(section.type)
        }

    def batch(self, first: int, count: int, design: Design | None = None) -> Batch:
        """Make and start the bodies first, first + 1, …, first + count − 1.

        Parameters
        ----------
        first : int
            Number of the first body.
        count : int
            Number of bodies.
        design : Design, optional
            The study's `design`. Default: it is made anew.

        Returns
        -------
        Batch
            `problem` of these bodies, and `start`, the keywords of `lierb.integrate` for them:
            pose0, twist0, and with controllers seed and trajectories, on which noise depends.
        """
        return batch_of(self, first, count, design)

    def changed(self, changes: Mapping[str, Any]) -> Study:
        """Return the study with changes of its tables.

        Parameters
        ----------
        changes : dict
            Changes by dotted keys: {"sample.n": 1000}.

        Returns
        -------
        Study
            The changed study.

        Raises
        ------
        StudyError
            The changed study is wrong.
        """
        return Study.of(self._tables(), changes=changes, code=self._code) if changes else self

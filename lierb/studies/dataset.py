"""Results of a study on the disk: Parquet parts, entered in a manifest after they are synced.

    DIR/study.toml            the study as it was run
    DIR/FILE.py               each Python file of the study, as it was run
    DIR/manifest.json         digest of the study, versions, every finished part with its checksums
    DIR/summary/part-*.parquet, DIR/history/part-*.parquet, DIR/events/part-*.parquet
    DIR/.lock

A file is written under another name, synced, renamed, and then entered, so that a process may die
at any moment. Files outside the manifest are ignored. Since other readers open every Parquet file
in a table's folder, a run neither begins nor ends if there are Parquet files of another origin:

    manifest             Parquet that it does not enter    a run of study S
    none                 none                              begins
    of S                 parts of S, by their names        removes them and does them again
    of T, no part done   none                              begins
    of T, parts done     -                                 is refused
    any                  any other                         is refused

A study.toml that describes another study, as after an edit, is refused as well. A missing
study.toml is written again. Other files in the folder are not touched.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.result import Result
from lierb.studies.description.differentiated import parameters_of
from lierb.studies.description.sections.running import IntegrateSection
from lierb.studies.description.settings import Setting, settings_label
from lierb.studies.description.study_tables import tables_of_study
from lierb.studies.storage.parts import Part
from lierb.studies.storage.replaying import only_setting, require_trajectory, with_history
from lierb.studies.storage.results import Results
from lierb.support.extras import require
from lierb.support.representations import FAILED, Lines, Represented

if TYPE_CHECKING:
    from matplotlib.figure import Figure

START = ("pose0", "twist0", "t0", "discontinuities", "seed", "trajectories")


@dataclass(frozen=True, repr=False)
class Replay(Represented):
    """Trajectory of a study that was integrated again, as `Dataset.replay` returns it.

    `lierb.integrate(replay.problem, **replay.options)` repeats the run, bit for bit and with its
    noise; `lierb.integrate(replay.problem, **replay.options | {"rtol": 1e-9})` runs it with other
    options. `replay.start` has the start, t0, times of jumps, and seed and number of the noise, for
    another method: `lierb.integrate(replay.problem, **replay.start, method=…, dt=…, t_end=…)`.

    Attributes
    ----------
    problem : Problem or Mechanism
        The trajectory's own, with its sampled numbers.
    pose0 : (4, 4) array or dict
        Initial pose; of a mechanism by link. None for the closed joint, `problem.joint.pose()`.
    twist0 : (6,) array or dict
        Initial twist (omega, v) in body axes, rad/s and m/s; of a mechanism by link.
    result : lierb.Result
        Result of one trajectory, with its whole history: state, energy, multipliers, reactions.
    setting : Setting
        `cspace`, `method`, and `dt` or `rtol`.
    trajectory : int
        Number of the trajectory in the study.
    seed : int
        Seed of the study.
    options : dict
        Keywords of `lierb.integrate` that give `result`: the start, the seed and number of the
        trajectory if there is noise, and all options of the study that are set.
    """

    problem: Problem | Mechanism
    pose0: Any
    twist0: Any
    result: Result
    setting: Setting
    trajectory: int
    seed: int
    options: dict[str, Any]

    @property
    def start(self) -> dict[str, Any]:
        """Return the options that do not depend on the method and its steps."""
        return {key: value for key, value in self.options.items() if key in START}

    def _representation(self) -> tuple[str, Lines]:
        title = (
            f"lierb.studies.dataset.Replay of trajectory {self.trajectory}, {self.setting.label}"
        )
        return title, [
            ("problem", repr(self.problem).partition("\n")[0]),
            ("options", ", ".join(self.options)),
            ("result", repr(self.result).partition("\n")[0]),
        ]


class Dataset(Results):
    """Folder with one study's results.

    Its methods raise StudyError for results that differ from their entry in the manifest, and
    StudyFileError, which is also an OSError, for files that cannot be read or written.

    Parameters
    ----------
    folder : path
        The folder.

    Raises
    ------
    StudyError
        The folder has no results of a study.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        super().__init__(folder)
        self.read()

    @classmethod
    def of(cls, results: Results) -> Self:
        """Make a dataset from results that have been read."""
        dataset = cls.__new__(cls)
        Results.__init__(dataset, results.folder)
        dataset.manifest, dataset._whole = results.manifest, results._whole
        return dataset

    def plot(self, name: str | None = None) -> Figure:
        """Draw a figure of the study's results, finished or not; needs `lierb[plot]`.

        `lierb plot FOLDER` writes all of them.

        Parameters
        ----------
        name : str, optional
            "distribution": errors over the bodies. "time": errors over time. "recorded": other
            columns of the history, such as energy and observables. "events": first times of each.
            "quantities": other columns of the summary. "order": errors over dt. "parameters":
            errors over sampled quantities. Default: "time" if there is a history, else
            "distribution".

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        UnknownNameError
            The study has no such figure.
        MissingExtraError
            Matplotlib is not installed.
        """
        require("plot")
        from lierb.studies.pages.figures import figure

        self._read_once()
        return figure(self, name)

    def replay(
        self,
        trajectory: int,
        *,
        cspace: str | None = None,
        method: str | None = None,
        dt: float | None = None,
        rtol: float | None = None,
        save_every: int = 1,
        threads: int | None = None,
    ) -> Replay:
        """Integrate one trajectory of the study again, with everything recorded.

        Its row of the summary, and its events, are those of the study, bit for bit, on the same
        kind of CPU with the same versions; the column `trajectory` is 0, the number in this run.

        Parameters
        ----------
        trajectory : int
            Number of the trajectory, as in the tables.
        cspace : str, optional
            C-space of the setting; needed, as are the next three, if the study has several.
        method : str, optional
            Method of the setting.
        dt : float, optional
            Step of the setting, s.
        rtol : float, optional
            Relative tolerance of the setting.
        save_every : int, optional
            Number of steps between rows of the history. With adaptive steps its times are 1001
            equidistant ones and those of the study.
        threads : int, optional
            As in `lierb.integrate`.

        Returns
        -------
        Replay
            The problem, its start and its result.

        Raises
        ------
        StudyError
            The study has no such trajectory.
        ArgumentError
            No setting, or more than one, has these values.
        MemoryLimitError
            The history is larger than the free memory; a larger `save_every` helps.

        Examples
        --------
        >>> import tempfile
        >>> import lierb
        >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
        >>> ball = lierb.joints.spherical(body_point=(0.0, 0.0, 0.15))
        >>> spins = lierb.sampling.Direction(length=2.0)
        >>> design = lierb.sampling.Design({"initial.omega": spins}, n=100)
        >>> with tempfile.TemporaryDirectory() as out:
        ...     dataset = lierb.run(lierb.Problem(box, ball), design, out, dt=1e-2, t_end=0.1)
        ...     replay = dataset.replay(17)
        >>> replay.result.omega.shape, replay.twist0.shape
        ((11, 1, 3), (6,))
        >>> again = lierb.integrate(replay.problem, **replay.options)
        >>> again.summary.equals(replay.result.summary)
        True
        """
        study = self.study
        number = require_trajectory(study, trajectory)
        given = {"cspace": cspace, "method": method, "dt": dt, "rtol": rtol}
        setting = only_setting(study, given)
        recorded = with_history(study, save_every)
        batch, result = Part("", setting, number, 1).run(recorded, study.design, threads)
        first = batch.first
        options = first.start | recorded.keywords(setting)
        if wanted := parameters_of(study, first.problem):
            options["with_respect_to"] = [p.name for p in wanted.values()]
        options = {key: value for key, value in options.items() if value is not None}
        return Replay(
            first.problem, first.pose0, first.twist0, result, setting, number, first.seed, options
        )

    def _representation(self) -> tuple[str, Lines]:
        if not self.manifest:
            return f"lierb.studies.dataset.Dataset of {self.folder}", []
        study, done, total = self.manifest["study"], len(self.parts), self.manifest["asked"]
        lines = [
            ("settings", settings_label(IntegrateSection.model_construct(**study["integrate"]))),
            ("trajectories", str(self.trajectories)),
            ("parts", f"{done} of {total}{self.rest('resume=True does the rest')}"),
        ]
        if failed := sum(sum(entry.get("failed", {}).values()) for _, entry in self._summaries()):
            lines.append((FAILED, f"{failed} of {self.trajectories}; failures() says more"))
        if moved := self.manifest.get("moved"):
            lines.append(("start", moved))
        tables = tables_of_study(study)
        lines.append(("tables", ", ".join(f'.table("{name}")' for name in tables)))
        return f"lierb.studies.dataset.Dataset of {self.folder}: study {study['name']!r}", lines

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

from typing import TYPE_CHECKING, Self

from lierb.studies.description.sections.running import IntegrateSection
from lierb.studies.description.settings import settings_label
from lierb.studies.description.study_tables import tables_of_study
from lierb.studies.storage.results import Results
from lierb.support.extras import require
from lierb.support.representations import FAILED, Lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

    @classmethod
    def of(cls, results: Results) -> Self:
        """Make a dataset from results that have been read."""
        dataset = cls(results.folder)
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

    def _representation(self) -> tuple[str, Lines]:
        if not self.manifest:
            return f"lierb.Dataset of {self.folder}, not read", []
        study, done, total = self.manifest["study"], len(self.parts), self.manifest["asked"]
        lines = [
            ("settings", settings_label(IntegrateSection.model_construct(**study["integrate"]))),
            ("trajectories", str(self.trajectories)),
            ("parts", f"{done} of {total}{self.rest('resume=True does the rest')}"),
        ]
        if failed := sum(sum(entry.get("failed", {}).values()) for _, entry in self._summaries()):
            lines.append((FAILED, f"{failed} of {self.trajectories}; failures() says more"))
        tables = tables_of_study(study)
        lines.append(("tables", ", ".join(f'.table("{name}")' for name in tables)))
        return f"lierb.Dataset of {self.folder}: study {study['name']!r}", lines

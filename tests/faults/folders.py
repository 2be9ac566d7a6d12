"""Small studies, their folders, and files in them that are not lierb's."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from click.testing import CliRunner
from studies import TEXT, hashes

from faults.crash import in_child
from lierb.cli import cli
from lierb.studies.description.study import Study
from lierb.studies.storage.manifest import read_manifest

FEW = {
    "n = 50": "n = 4",
    "part = 8": "part = 2",
    "dt = [1e-3, 2e-3]": 'dt = 5e-3\nmethod = "Euler"',  # the least to compile
}
ONE = FEW | {'["SE3", "SO3xR3"]': '"SO3xR3"'}
# What is other than in the text of `studies`.
STUDIES = {
    "summary": ONE,
    "sobol": ONE | {"n = 50": 'n = 8\nmethod = "sobol"'},
    "history": FEW | {"t_end = 0.05": "t_end = 0.05\nsave_every = 5"},
}

# Beside a run's own files, with names as near to theirs as may be.
DECOYS = (
    "thesis/chapter.unfinished",
    "thesis/summary/part-00-0000000000.parquet",
    ".x.12345678.unfinished",
    ".notes.txt.unfinished",
    "drafts.unfinished/letter.txt",
    "sub/manifest.json",
    "sub/summary/.part-00-0000000000.parquet.1a2b3c4d.unfinished",
    "notes.txt",
)
LONG_AGO = 10**18  # ns


@dataclass(frozen=True)
class Ended:
    """End of a command: its exit status, its output, and an exception if there was one."""

    status: int
    output: str
    raised: str

    @property
    def is_clear(self) -> bool:
        """It came to its end, or said in its own words why not."""
        return not self.raised and "Traceback" not in self.output

    def required_clear(self) -> Ended:
        assert self.is_clear, f"{self.raised}\n{self.output}"
        return self


def command(*arguments: Any) -> Ended:
    """`lierb …` in this process."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    own = result.exception is None or isinstance(result.exception, SystemExit)
    return Ended(result.exit_code, result.output, "" if own else repr(result.exception))


class Space:
    """A folder for one kind of fault: study files, whole runs of them, and a run at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "out"
        self.wholes: dict[str, dict[str, str]] = {}
        for name, changes in STUDIES.items():
            text = TEXT
            for old, new in changes.items():
                assert old in text, old
                text = text.replace(old, new)
            self.file(name).parent.mkdir(parents=True)
            self.file(name).write_text(text)
            Study.load(self.file(name)).batch(0, 1)  # imports, once for all children

    def file(self, study: str) -> Path:
        return self.folder / study / "study.toml"

    def arguments(self, study: str) -> tuple[Any, ...]:
        return "run", self.file(study), "--out", self.out, "--threads", 1, "--resume"

    def run(self, study: str) -> Ended:
        """Run in this process, which is a child."""
        return command(*self.arguments(study))

    def whole(self, study: str) -> Path:
        """The folder of a run without faults."""
        kept = self.folder / "wholes" / study
        if not kept.exists():
            self.clear(decoys=())
            ended = in_child(lambda: self.run(study)).required_clear()
            assert ended.status == 0, ended.output
            shutil.copytree(self.out, kept)
            self.wholes[study] = own_hashes(kept)
        return kept

    def clear(self, state: Path | None = None, decoys: tuple[str, ...] = DECOYS) -> None:
        """`out` anew, as in another folder or empty, beside what is not lierb's."""
        with suppress(FileNotFoundError):
            shutil.rmtree(self.out)
        if state is not None:
            shutil.copytree(state, self.out, ignore=shutil.ignore_patterns(".lock"))
        for name in decoys:
            decoy = self.out / name
            decoy.parent.mkdir(parents=True, exist_ok=True)
            decoy.write_text(name)
            os.utime(decoy, ns=(LONG_AGO, LONG_AGO))

    def require_decoys(self) -> None:
        for name in DECOYS:
            decoy = self.out / name
            assert decoy.exists(), f"{name} was deleted"
            assert decoy.read_text() == name, f"{name} was written to"
            assert decoy.stat().st_mtime_ns == LONG_AGO, f"{name} was touched"

    def require_whole(self, study: str, passed_over: str | tuple[()] = ()) -> None:
        """Every file of the run is that of one without faults, and there is no other."""
        self.whole(study)
        found, expected = own_hashes(self.out), self.wholes[study]
        found = {name: digest for name, digest in found.items() if not name.endswith(passed_over)}
        different = sorted(
            n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n)
        )
        if "study.toml" in different and self._says_the_same(study):
            different.remove("study.toml")
        if different == ["manifest.json"]:
            different = self._differences_of_manifests(study)
        assert not different, f"other bytes than without the fault: {different}"

    def _says_the_same(self, study: str) -> bool:
        """Return whether study.toml is the same study in another form, without comments, say."""
        files = (folder / "study.toml" for folder in (self.out, self.whole(study)))
        found, expected = (Study.load(file).digest() for file in files)
        return found == expected

    def _differences_of_manifests(self, study: str) -> list[str]:
        """But for what a run is free to keep: what it was begun with, and on."""
        found, expected = (
            read_manifest(folder / "manifest.json") for folder in (self.out, self.whole(study))
        )
        keys = (found.keys() | expected.keys()) - {"machine", "set", "text", "checksum"}
        return [f"manifest.json: {k}" for k in sorted(keys) if found.get(k) != expected.get(k)]

    def require_readers_rows(self, study: str) -> None:
        """pandas reads the rows of the study from the folder, those and no others."""
        import pandas

        keys = ["cspace", "dt", "trajectory"]
        found, expected = (
            pandas.read_parquet(folder / "summary").sort_values(keys, ignore_index=True)
            for folder in (self.out, self.folder / "wholes" / study)
        )
        pandas.testing.assert_frame_equal(found, expected, check_exact=True)


def own_hashes(folder: Path) -> dict[str, str]:
    """Hashes of lierb's files."""
    return {name: digest for name, digest in hashes(folder).items() if name not in DECOYS}

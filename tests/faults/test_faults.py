"""The fault campaign, in short; whole with -m faults, or `python -m faults` (docs/faults.md)."""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
from functools import partial
from pathlib import Path

import numba
import pytest

from faults import campaign
from faults.campaign import KINDS, Count, Kind
from faults.crash import ENDS, REFUSALS, Alone, Points, in_child, killed_in_child, points_of
from faults.damage import damaged, edited
from lierb.studies.storage.store import Store

pytestmark = [
    pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled without JIT"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system"),
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),  # its children write files only
]
TESTS = Path(__file__).parents[1]
FOLDERS = ("study", "study disk", "manifests", "parts")
PROCESSES = ("interrupts", "cache", "cache disk", "cache files")


def run(out: Path, *arguments: object) -> dict[str, dict]:
    """Counts of `python -m faults`, kind by kind."""
    done = subprocess.run(
        [sys.executable, "-m", "faults", *map(str, arguments), "--out", str(out)],
        cwd=TESTS, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(TESTS.parent)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(out.with_suffix(".json").read_text())["kinds"]


# ---- in short ----------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ENDS)
def test_file_of_a_dataset_is_the_old_or_the_new_one_at_each_crash_point(end, tmp_path):
    dataset, file = Store(tmp_path), tmp_path / "study.toml"
    old, new = b"old" * 1000, b"new" * 2000
    write = partial(dataset.write, file.name, new)
    found = []
    for at in range(len(points_of(write, tmp_path))):
        file.write_bytes(old)

        def die(at: int = at) -> None:
            Points(tmp_path, at, ENDS[end])
            write()

        assert killed_in_child(die)
        found.append(file.read_bytes())
    assert set(found) == {old, new}
    assert found == sorted(found, key=lambda content: content == new)  # old until it is new


def test_file_of_a_dataset_is_the_old_one_on_a_full_disk(tmp_path):
    dataset, file = Store(tmp_path), tmp_path / "study.toml"
    file.write_bytes(b"old")

    def fill() -> None:
        Points(tmp_path, 0, REFUSALS["ENOSPC"])
        with pytest.raises(OSError, match="No space left"):
            dataset.write(file.name, b"new")

    in_child(fill)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {file.name: b"old"}


def test_damage_is_damage():
    content = json.dumps({"a": [1, {"b": None}], "c": "text"}).encode()
    for seed in range(200):
        how, other = damaged(content, random.Random(seed))
        assert other != content, how
        json.loads(edited(content.decode(), random.Random(seed))[1])


class Numbers(Alone):
    """Trials of which every third one shows a violation."""

    full = 10

    def __init__(self, folder: Path) -> None:
        pass

    def trial(self, number: int, rng: random.Random) -> str:
        assert number % 3, f"{rng.random()}"
        return "well"


def test_violations_are_counted_and_can_be_repeated(tmp_path):
    def count(only: int | None) -> Count:
        counted, options = Count(), argparse.Namespace(share=1.0, seed=5, only=only)
        campaign.run("numbers", Kind("", Numbers), tmp_path, options, float("inf"), counted)
        return counted

    whole, alone = count(None), count(6)
    assert (whole.tried, whole.outcomes["well"], len(whole.violations)) == (10, 6, 4)
    assert alone.violations == whole.violations[2:3]
    assert "--seed 5 --only 6" in alone.violations[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(FOLDERS, marks=pytest.mark.long, id="folders"),
        pytest.param(PROCESSES, marks=pytest.mark.long, id="processes"),
        pytest.param(("interrupts", "cache files"), id="of two kinds"),
    ],
)
def test_some_trials_of_each_kind_show_no_violation(kinds, tmp_path):
    counts = run(tmp_path / "figures", *kinds, "--share", 0.001)
    assert {*counts} == {*kinds}


# ---- the whole of it ---------------------------------------------------------------------------


@pytest.mark.faults
@pytest.mark.parametrize("kind", KINDS)
def test_whole_campaign_shows_no_violation(kind, tmp_path):
    assert run(tmp_path / "figures", kind)[kind]["violations"] == 0

"""The benchmarks' own machinery: peers meet the reference, reports say what was measured."""

from __future__ import annotations

import importlib
import json
import re
import sys
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).parent.parent / "bench"
sys.path.insert(0, str(BENCH))

from peers import heavy_top, reference, report  # noqa: E402
from peers.__main__ import NOT_PEERS  # noqa: E402
from tolerances import tops  # noqa: E402
from tolerances import worker as tolerances_worker  # noqa: E402
from updates import table as table_of_updates  # noqa: E402
from work_precision import tables as work_precision_tables  # noqa: E402

STORED = sorted((BENCH / "results").glob("peers-*.json"))


def test_reference_is_that_of_the_samples():
    stored = np.load(heavy_top.REFERENCE)
    np.testing.assert_array_equal(stored[:, :3], heavy_top.samples(len(stored)))


def test_reference_is_reproduced():
    """Half the order would still show: 120 steps of order 20 leave 1e-14 of truncation at most."""
    stored = np.load(heavy_top.REFERENCE)[:4]
    np.testing.assert_allclose(reference.solve(stored[:, :3], 90), stored[:, 3:], atol=1e-13)


# (peer, form, error allowed: RK4 at 1e-3 s reaches 8e-10 m on the worst of the first 64 tops)
QUICK = [
    pytest.param("lierb", "gain", 2e-9, marks=pytest.mark.slow),
    pytest.param("lierb", "saddle-tilted", 2e-9, marks=pytest.mark.slow),
    ("numpy_batch", "reduced", 2e-9),
    ("numpy_batch", "general", 5e-9),
]


@pytest.mark.long
@pytest.mark.parametrize(("peer", "form", "allowed"), QUICK)
def test_a_peer_meets_the_reference(peer, form, allowed):
    module = importlib.import_module(f"peers.{peer}")
    assert not module.available()
    final = module.run(form, heavy_top.samples(64), heavy_top.DT, threads=1)()
    assert heavy_top.error(final) < allowed
    truth = np.load(heavy_top.REFERENCE)[:64]
    np.testing.assert_allclose(final.omega, truth[:, 6:], atol=50 * allowed)  # ω changes at 50 /s


def test_every_peer_has_what_a_peer_needs():
    peers = [path for path in BENCH.glob("peers/*.py") if path.stem not in NOT_PEERS]
    for path in peers:
        text = path.read_text(encoding="utf-8")
        for need in ("FORMS", "def available() -> str:", "def config() ->", "def run("):
            assert f"\n{need}" in text, path.name
    assert len(peers) >= 12


@pytest.mark.skipif(not STORED, reason="no run is stored")
def test_the_readme_shows_the_last_stored_run():
    run = json.loads(STORED[-1].read_text(encoding="utf-8"))
    readme = (BENCH / "README.md").read_text(encoding="utf-8")
    figure = STORED[-1].with_suffix(".png")
    assert figure.exists()
    assert len(report.markdown(run).splitlines()) > 40
    assert report.embedded(readme, run, f"results/{figure.name}") == readme


def test_tables_have_no_place_in_a_page_without_marks():
    with pytest.raises(ValueError, match="are missing"):
        report.embedded("# A page\n", {}, "figure.png")


# ---- tools at the same error -------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("batch", tops.BATCHES)
def test_reference_at_all_speeds_is_met_by_short_steps(batch):
    """The fastest top turns by 310 rad, 0.06 rad a step: what is left is rounding."""
    module = importlib.import_module("peers.lierb")
    found = module.run("reduced-dop853", tops.samples(batch), 2e-4, threads=1)()
    off = tops.errors(batch, found)
    assert off.largest < 1e-12
    assert off.median < 1e-14


def test_speeds_are_of_all_sizes():
    speeds = np.linalg.norm(tops.samples("lognormal"), axis=1)
    assert np.std(np.log(speeds)) == pytest.approx(tops.SIGMA, rel=0.1)
    assert speeds.max() / speeds.min() > 100


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [1e-6, 1e-9])
def test_a_tool_is_tuned_to_the_error_that_is_wanted(wanted):
    """A method of order 8 is tuned to the longest step that is accurate enough."""
    module = importlib.import_module("peers.lierb")
    omega0 = tops.samples("one")
    solved = lambda dt: module.run("reduced-dop853", omega0, dt, 1)()
    dt, off = tolerances_worker.tuned(solved, "one", wanted, is_fixed=True, order=8)
    assert tolerances_worker.CLOSE * wanted < off.largest <= wanted
    assert tops.errors("one", solved(1.25 * dt)).largest > wanted


def _readme_row(label: str) -> list[str]:
    """The cells of a table's row, numbers without their units."""
    text = (BENCH / "README.md").read_text(encoding="utf-8")
    line = next(x for x in text.splitlines() if x.startswith(f"| {label} |"))
    return [cell.split()[0] for cell in line.strip("|").split("|")[1:]]


OWN = {
    "start of a process to its first result, kernel on the disk": (
        "first_result[warm]", 1,
    ),
    "start of a process to its first result, kernel compiled": ("first_result[cold]", 1),
    "one call with one body and ten steps": ("one_body_ten_steps[None]", 1e-3),
    "memory beside inputs and outputs, 10⁴ bodies": ("growth[10000-False]", "growth_MB"),
    "memory beside inputs and outputs, 4·10⁵ bodies": ("growth[400000-False]", "growth_MB"),
}  # fmt: skip


@pytest.mark.parametrize(("label", "entry"), OWN.items())
def test_the_readme_shows_the_stored_runs_of_lierb_alone(label, entry):
    name, unit = entry
    runs = ("2026-11-22T195542-icelake-server-L8", "2026-11-23T024553-znver4-L8")
    for run, shown in zip(runs, _readme_row(label), strict=True):
        stored = json.loads((BENCH / f"results/{run}.json").read_text(encoding="utf-8"))
        found = stored["benchmarks"][name]
        value = found[unit] if isinstance(unit, str) else found["seconds"] / unit
        digits = len(shown.partition(".")[2])
        assert f"{value:.{digits}f}" == shown, run


def test_the_front_page_shows_the_stored_run():
    """Its rows are rows of the tables of the last run, without some columns."""
    run = json.loads(STORED[-1].read_text(encoding="utf-8"))
    tables = [line.split(" | ") for line in report.markdown(run).splitlines()]
    page = (BENCH.parent / "README.md").read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(page) if "body-steps" in line) + 2
    shown = [
        line.split(" | ") for line in takewhile(lambda line: line.startswith("| "), page[first:])
    ]
    assert len(shown) == 6
    for label, speed, error in shown:
        (row,) = (row for row in tables if row[0] == label)
        assert (speed, error.removesuffix(" |")) == (row[1], row[4])


# ---------------------------------------------------------------- docs/theory.md

LABELS = {"H_p⋉R²": "helical_planar", "pin-in-slot": "pin_in_slot"}
LEFT_BY_ROUNDING = 2e-14  # m: what the page says is left where it only says "kept"


def _theory_rows(head: str) -> list[list[str]]:
    """The rows of the table of docs/theory.md whose first line begins with `head`."""
    text = (BENCH.parent / "docs" / "theory.md").read_text(encoding="utf-8")
    lines = text[text.index(head) :].splitlines()[2:]
    table = lines[: next(i for i, line in enumerate(lines) if not line.startswith("|"))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def _drift() -> dict:
    stored = max((BENCH / "results").glob("drift-*.json"))
    return json.loads(stored.read_text(encoding="utf-8"))


def _as_shown(cell: str, values: list[float]) -> bool:
    """Check that a cell has these numbers, to the digits that are shown."""
    shown = re.findall(r"[0-9.]+(?:e-?[0-9]+)?", cell.removeprefix("kept:"))
    digits = [len(x.partition("e")[0].partition(".")[2]) for x in shown]
    found = [float(f"{x:.{n}e}") for x, n in zip(values, digits)]
    return len(shown) == 2 and found == [float(x) for x in shown]


def test_theory_shows_the_stored_drift():
    stored = _drift()
    rows = _theory_rows("| joint | SE(3) | SO(3)×R³ |")
    assert len(rows) == 8
    for label, *cells in rows:
        name = LABELS.get(label, label)
        for key, cell in zip(("SE3", "SO3xR3", "origin"), cells, strict=True):
            values = stored["drift"][name][f"{key} position"]
            if cell == "kept":
                assert max(values) < LEFT_BY_ROUNDING, (label, key)
            elif key == "SE3" and cell.startswith("kept"):
                assert _as_shown(cell, stored["frames"][name]["position"]), (label, cell)
            else:
                assert cell == "–" or _as_shown(cell, values), (label, key, cell, values)


def test_theory_shows_the_stored_rounding():
    stored = _drift()["rounding"]
    rows = _theory_rows("| joint | SE(3), `solver")
    assert len(rows) == 5
    for name, *cells in rows:
        for key, cell in zip(("saddle", "auto"), cells, strict=True):
            assert _as_shown(cell, stored[name][key]), (name, key, cell)
    assert (
        max(max(run[f"{key} RᵀR"]) for run in stored.values() for key in ("saddle", "auto")) < 4e-15
    )


# ---------------------------------------------------------------- docs/howto/choosing.md


def test_choosing_shows_the_stored_work_and_precision():
    stored = max((BENCH / "results").glob("choosing-*.json"))
    shown = work_precision_tables(json.loads(stored.read_text(encoding="utf-8")))
    docs = BENCH.parent / "docs"
    pages = dict.fromkeys(shown, docs / "howto" / "choosing.md") | {"kept": docs / "theory.md"}
    assert len(shown) == 5
    for name, table in shown.items():
        page = pages[name].read_text(encoding="utf-8")
        assert table in page, name
        assert stored.name in page
    assert stored.with_suffix(".png").name in pages["methods"].read_text(encoding="utf-8")


def test_choosing_shows_the_stored_comparison_of_updates():
    stored = max((BENCH / "results").glob("updates-*.json"))
    page = (BENCH.parent / "docs" / "howto" / "choosing.md").read_text(encoding="utf-8")
    assert table_of_updates(json.loads(stored.read_text(encoding="utf-8"))) in page
    assert stored.name in page

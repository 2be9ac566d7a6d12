"""The benchmarks' own machinery: peers meet the reference, reports say what was measured."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).parent.parent / "bench"
sys.path.insert(0, str(BENCH))

from peers import heavy_top, reference, report  # noqa: E402
from peers.__main__ import NOT_PEERS  # noqa: E402

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
    ("lierb", "gain", 2e-9),
    pytest.param("lierb", "saddle-tilted", 2e-9, marks=pytest.mark.slow),
    ("numpy_batch", "reduced", 2e-9),
    ("numpy_batch", "general", 5e-9),
]


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
    readme = (BENCH.parent / "README.md").read_text(encoding="utf-8")
    tables = [line for line in report.markdown(run).splitlines() if line.startswith("| ")]
    assert len(tables) > 20
    missing = [line for line in tables if line not in readme]
    assert not missing

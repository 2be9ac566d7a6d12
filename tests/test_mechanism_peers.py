"""The benchmarks of mechanisms: their reference, and C++ and MuJoCo where they can run."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("scipy")

BENCH = Path(__file__).parent.parent / "bench"
sys.path.insert(0, str(BENCH))

from linkages import cases, report  # noqa: E402
from linkages.__main__ import NOT_PEERS, better  # noqa: E402
from measuring import keep  # noqa: E402

STORED = sorted((BENCH / "results").glob("mechanisms-*.json"))
RK4 = 1e-9  # m: what it leaves of two links at 1 ms


def test_the_reference_is_reproduced():
    """Twice the tolerance of DOP853, 1e-12, and some growth over a second."""
    found = cases.solved("chain2", count=1)
    np.testing.assert_allclose(found, cases.reference("chain2")[:1], atol=1e-10)


def test_the_reference_keeps_its_energy():
    """A quantity that the solver does not know: ½vᵀMv − Σ mg·r, by the mass matrix at both ends."""
    tree = cases.tree_of("chain3", 2)
    energy = lambda q, v: (
        0.5 * np.einsum("ni,nij,nj->n", v, cases.equations(tree, q, v)[0], v)
        + cases.potential(tree, q)
    )
    h, q, v = 1e-3, tree.q0, tree.v0
    rates = lambda q, v: (v, cases.accelerations(tree, q, v))
    before = energy(q, v)
    for _ in range(20):
        a = rates(q, v)
        b = rates(q + h / 2 * a[0], v + h / 2 * a[1])
        c = rates(q + h / 2 * b[0], v + h / 2 * b[1])
        d = rates(q + h * c[0], v + h * c[1])
        q, v = (x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
                for x, k1, k2, k3, k4 in zip((q, v), a, b, c, d, strict=True))  # fmt: skip
    np.testing.assert_allclose(energy(q, v), before, rtol=1e-10)


def test_the_four_bar_is_closed():
    tree = cases.tree_of("fourbar", 5)
    frames = cases.places(tree, tree.q0)
    ends = [
        frames[k][:, :3, 3] + np.einsum("nij,nj->ni", frames[k][:, :3, :3], point)
        for k, point in zip((1, 2), np.moveaxis(tree.loop, 1, 0), strict=True)
    ]
    np.testing.assert_allclose(*ends, atol=1e-14)


def test_samples_do_not_depend_on_their_number():
    for name in cases.MECHANISMS:
        few, many = cases.tree_of(name, 2), cases.tree_of(name, 5)
        for field in ("frames", "mass", "com", "inertia", "bodies", "q0", "v0"):
            np.testing.assert_array_equal(getattr(few, field), getattr(many, field)[:2])


def test_lierb_starts_where_the_others_do():
    own = importlib.import_module("linkages.lierb")
    for name in cases.MECHANISMS:
        tree = cases.tree_of(name, 3)
        mechanism = own.mechanism_of(tree)
        pose = mechanism.pose({f"link{k}": tree.q0[:, k] for k in range(len(tree.parents))})
        found = np.stack([pose[link][:, :3, 3] for link in mechanism.names], axis=1)
        np.testing.assert_allclose(found, cases.positions(tree, tree.q0), atol=1e-14)


@pytest.mark.parametrize(
    ("peer", "form", "allowed"),
    [
        ("mujoco_batch", "chain2", RK4),
        ("mujoco_batch", "fourbar", 1e-5),
        pytest.param("cpp", "chain2-bodies", RK4, marks=pytest.mark.long),
        pytest.param("cpp", "chain2-series", RK4, marks=pytest.mark.slow),
    ],
)
def test_a_peer_meets_the_reference(peer, form, allowed):
    module = importlib.import_module(f"linkages.{peer}")
    if reason := module.available():
        pytest.skip(reason)
    mechanism = module.FORMS[form].mechanism
    found = module.run(form, cases.tree_of(mechanism, cases.CHECKED))()
    assert len(found) == cases.CHECKED
    assert cases.error(mechanism, found) < allowed


def test_every_peer_has_what_a_peer_needs():
    peers = [path for path in BENCH.glob("linkages/*.py") if path.stem not in NOT_PEERS]
    for path in peers:
        module = importlib.import_module(f"linkages.{path.stem}")
        assert {form.mechanism for form in module.FORMS.values()} <= {*cases.MECHANISMS}
        assert all(callable(getattr(module, name)) for name in ("available", "config", "run"))
    assert len(peers) >= 7


ENTRY = {"label": "L", "mechanism": "chain2", "allowed_m": 1e-7, "count": 1000, "wall_s": 3.0,
         "cpu_s": 2.0, "cold_s": 1.0, "error_m": 1e-9, "config": {}}  # fmt: skip


def test_another_motion_has_no_time():
    ours = ENTRY | {"cpu_s": 0.1}
    run = {
        "time": "2026-01-01T000000",
        "machine": {"cpu": "cpu", "lanes": 8},
        "before": {"clock_ghz": 3.0, "peak_gflops": 90.0},
        "after": {"clock_ghz": 3.0, "peak_gflops": 90.0},
        "unavailable": {},
        "entries": {"a/x": ENTRY, "b/x": ENTRY | {"error_m": 1e-3}, "lierb/x": ours},
    }
    text = report.markdown(run)
    assert "| L | 0.5 | 1.0 | 1e-09 | 20.0 × |" in text
    assert "- L (2 revolute links): off by 1e-03 m, where 1e-07 is allowed" in text
    assert text.count("| L |") == 2


def test_of_several_runs_the_best_counts_and_the_largest_error():
    entries = {}
    for found in (
        {"failed": "no"},
        ENTRY,
        ENTRY | {"cpu_s": 1.0, "error_m": 1e-8},
        {"failed": "no"},
    ):
        keep(entries, "a/x", dict(found), better)
    assert (entries["a/x"]["cpu_s"], entries["a/x"]["error_m"]) == (1.0, 1e-8)


@pytest.mark.skipif(not STORED, reason="no run is stored")
def test_the_readme_shows_the_last_stored_run():
    run = json.loads(STORED[-1].read_text(encoding="utf-8"))
    readme = (BENCH / "README.md").read_text(encoding="utf-8")
    assert report.embedded(readme, run) == readme

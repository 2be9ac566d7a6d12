"""Shared by the benchmarks: what a run's speed is called."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))  # cases.py


@pytest.fixture
def body_steps(benchmark):
    """Benchmark a run of so many body-steps on one thread; its rate goes to the stored JSON."""

    def measure(run, count: int) -> None:
        run()  # compiles
        benchmark.pedantic(run, rounds=5, iterations=1)
        rate = count / benchmark.stats.stats.min / 1e6
        benchmark.extra_info["million_body_steps_per_s_and_core"] = round(rate, 2)
        print(f"\n{benchmark.name}: {rate:.1f} M body-steps/s per core")

    return measure

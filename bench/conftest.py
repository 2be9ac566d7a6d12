"""Shared by the benchmarks: what a run's speed is called, and what it is measured against."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import lierb

sys.path.insert(0, str(Path(__file__).parent))  # calibration.py
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))  # cases.py

from calibration import clock_ghz, peak_gflops


def pytest_benchmark_update_machine_info(config, machine_info) -> None:
    machine_info["lierb"] = lierb.info()
    machine_info["clock_ghz"] = round(clock_ghz(), 3)
    machine_info["peak_gflops"] = round(peak_gflops(0.3), 2)


@pytest.fixture
def rate(benchmark):
    """Benchmark a run of so many items on one thread: M items/s, and the core's peak beside it."""

    def measure(run: Callable[[], object], count: int, unit: str = "body-steps") -> None:
        run()  # compiles
        before = peak_gflops()
        benchmark.pedantic(run, rounds=5, iterations=1)
        found = count / benchmark.stats.stats.min / 1e6
        benchmark.extra_info["peak_gflops"] = round(max(before, peak_gflops()), 2)
        benchmark.extra_info["rate"] = round(found, 3)
        benchmark.extra_info["unit"] = f"M {unit}/s"

    return measure


@pytest.fixture
def ratio(benchmark):
    """Benchmark a run against another in turns; the ratio of their best times is what counts."""

    def measure(
        run: Callable[[], object], other: Callable[[], object], unit: str, rounds: int = 7
    ) -> None:
        run()
        others: list[float] = []

        def before():
            began = time.perf_counter()
            other()
            others.append(time.perf_counter() - began)

        before()
        benchmark.pedantic(run, setup=before, rounds=rounds, iterations=1)
        benchmark.extra_info["ratio"] = round(min(others[1:]) / benchmark.stats.stats.min, 3)
        benchmark.extra_info["unit"] = unit

    return measure

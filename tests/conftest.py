"""Ctrl-C and the fault campaign; which tests pytest-xdist runs in one process."""

from __future__ import annotations

import gc
import re
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

# pytest keeps files with rewritten asserts, half of the time of a collection, as it keeps kernels.
sys.dont_write_bytecode = False

# Files whose tests share kernels or fixtures; each of the others is on its own.
TOGETHER = {
    "paper": ("paper", "cli", "docs"),
    "top": ("tables", "determinism", "tableaus", "concurrency", "bench", "installation"),
    "pictures": ("animation", "history_plots"),
    "results": ("result", "progress", "shown", "hostile", "memory"),
    "studies": ("cluster", "study", "dataset", "statistics"),
    "clocks": ("bits", "tolerances"),
    "groups": ("lie", "lie_arrays", "log", "number_types"),
    "derivatives": (
        "of_joints", "of_runs", "of_mechanisms", "event_times", "through_functions", "names", "fit",
        "fits", "fit_of_loops",
    ),
}  # fmt: skip
BY_JOINT = ("accuracy", "exactness", "multipliers", "prediction", "solvers")
# What takes longest begins first, so that all processes end at the same time.
LONGEST = (
    "studies", "top", "cache", "paper", "forces", "report", "functions", "groups", "results",
    "spherical", "every_formula", "observables",
)  # fmt: skip


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """One worker for the tests that share kernels: two would compile them at the same time."""
    from xdist.scheduler import LoadScopeScheduling

    from lierb.model.joints.joint_type import JOINTS

    class ByKernels(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = _file(nodeid)
            if file in BY_JOINT:
                parts = re.split(r"[][-]", nodeid)
                return next((part for part in parts if part in JOINTS), "spherical")
            return next((name for name, files in TOGETHER.items() if file in files), file)

        def _assign_work_unit(self, node: Any) -> None:
            ranks = {name: rank for rank, name in enumerate(LONGEST)}
            first = min(self.workqueue, key=lambda scope: ranks.get(_file(scope), len(ranks)))
            self.workqueue.move_to_end(first, last=False)
            super()._assign_work_unit(node)

    return ByKernels(config, log)


def _file(nodeid: str) -> str:
    """accuracy, of tests/test_accuracy.py::test_any."""
    return Path(nodeid.partition("::")[0]).stem.removeprefix("test_")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Modules and tests stay to the end: nothing looks for garbage among them, again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Long tests run only if selected by name: -m faults, -m long."""
    for mark in ("faults", "long"):
        if mark not in config.getoption("markexpr"):
            whole = [item for item in items if item.get_closest_marker(mark)]
            items[:] = [item for item in items if item not in whole]
            config.hook.pytest_deselected(items=whole)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Enable SIGINT, in child processes too: a shell's background jobs start ignoring it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def papers_kernels() -> Iterator[None]:
    """Let `lierb.analysis.paper` record as `cases.integrate` does: they share kernels.

    What is recorded changes no bit (test_determinism.py).
    """
    from cases import RECORD

    import lierb.analysis.paper

    def recording(*given: Any, **options: Any) -> lierb.Result:
        found = lierb.integrate(*given, **options | {"record": RECORD})
        return lierb.Result(found.summary, found.history.drop_columns(["lambda", "reaction"]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lierb.analysis.paper, "integrate", recording)
        yield


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages on studies with blank figures, for tests of the rest: drawing takes most of the time.

    test_report.py draws those of ordinary and hard cases.
    """
    from studies import BLANK

    monkeypatch.setattr("lierb.studies.pages.report.data_url", lambda figure: BLANK)

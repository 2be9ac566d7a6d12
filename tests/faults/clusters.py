"""A Dask worker dies at a crash point of the part that it writes, or the run that gives parts out.

What must hold: the run goes on with other workers, or the next one does what is missing, to the
bytes of a run in one process.
"""

from __future__ import annotations

import random
from functools import partial
from pathlib import Path
from typing import Any

import lierb
from faults.crash import ENDS, Child, Points, in_child, killed_in_child, points_of, told_with
from faults.folders import Space
from lierb.studies.execution.cluster import client_of, local_client

STUDY = "history"
WORKERS = 2
SECONDS = 60
OF_WORKER = 12  # points that a worker passes at least: four calls for a file, of two or more parts


class ClusterKills:
    """Runs of one study on a cluster of processes, whose workers come again when they die."""

    full = 50

    def __init__(self, folder: Path) -> None:
        self.space = Space(folder)
        self.space.whole(STUDY)
        self.host = Child(_host)
        self.address = self.host.ask()
        self.space.clear(decoys=())
        self.of_run = points_of(self._run, self.space.out)

    def end(self) -> None:
        self.host.end()

    def _start_anew(self) -> None:
        """Another cluster: after a few deaths no worker may come back to the old one."""
        self.host.end()
        self.host = Child(_host)
        self.address = self.host.ask()

    def _run(self) -> None:
        """Run in a child process."""
        with client_of(self.address) as client:
            client.wait_for_workers(WORKERS, timeout=SECONDS)
            lierb.run(self.space.file(STUDY), self.space.out, client=client)

    def trial(self, number: int, rng: random.Random) -> str:
        who = ("worker", "run")[number % 2]
        at = rng.randrange(OF_WORKER if who == "worker" else len(self.of_run))
        end = rng.choice([*ENDS])
        self.space.clear()
        if number:
            self._start_anew()
        with told_with(f"{who} {end} at point {at}"):
            in_child(partial(self._arm, at if who == "worker" else None, end))
            if who == "worker":
                in_child(self._run)
            else:
                is_dead = killed_in_child(partial(self._dying, at, end))
                self.space.require_decoys()
                ended = in_child(partial(self.space.run, STUDY)).required_clear()
                assert ended.status == 0, ended.output
            self.space.require_decoys()
            # a worker that its run has left behind may write its part aside at any time
            self.space.require_whole(STUDY, passed_over=".unfinished")
        return f"{who} died" if who == "worker" or is_dead else "not reached"

    def _dying(self, at: int, end: str) -> None:
        Points(self.space.out, at, ENDS[end])
        self._run()

    def _arm(self, at: int | None, end: str) -> None:
        with client_of(self.address) as client:
            client.wait_for_workers(WORKERS, timeout=SECONDS)
            client.run(arm, self.space.out, at, end)


_held: list[Any] = []  # what ends with its process


def _host(_: Any) -> str:
    """Start the cluster; its scheduler's address."""
    context = local_client(WORKERS)
    client = context.__enter__()
    _held.append(context)
    return str(client.scheduler.address)


_armed: list[Points] = []


def arm(folder: Path, at: int | None, end: str) -> None:
    """Let the worker die at this point, counted from here."""
    if not _armed:
        _armed.append(Points(folder))
    (points,) = _armed
    points.passed.clear()
    points.at, points.fault = at, ENDS[end]

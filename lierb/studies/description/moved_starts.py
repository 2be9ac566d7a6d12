"""Describe how far closing the loops of a mechanism moves the given starts of a study."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lierb.analysis.quantities import WRAPPED
from lierb.model.mechanism.holding import SLIDES
from lierb.model.mechanism.mechanism import Mechanism
from lierb.studies.description.study import Study
from lierb.support.representations import apart, counted

BODIES = 64  # the first bodies are compared: the largest change is of their order
LEAST = 1e-9  # least change that is reported, relative to the given number or to 1


class _Change(NamedTuple):
    """Number of a joint that was given, and that of the start."""

    name: str
    unit: str
    given: float
    start: float
    size: float


def moved_start(study: Study) -> str:
    """Return a sentence about the largest change of a given coordinate, and of a given rate.

    "" if there is none, and with `hold`, by which a study chooses what is kept.
    """
    if not study.problem.links or study.initial.hold:
        return ""
    count = min(BODIES, len(study.design))
    largest: dict[bool, _Change] = {}  # of a coordinate, and of a rate
    for change in sorted(_changes(study, count), key=lambda change: change.size):
        largest[change.unit.endswith("/s")] = change
    words = []
    for _, change in sorted(largest.items()):
        given, start = apart([change.given, change.start])
        words.append(f"{change.name} from {given} to {start} {change.unit}")
    if not words:
        return ""
    return (
        f"Closing the loops moved starts: {', '.join(words)} (the largest changes of "
        f"{counted(count, 'body', 'bodies')}); hold in [initial] keeps those of links that it names"
    )


def _changes(study: Study, count: int) -> Iterator[_Change]:
    """Yield the largest change of each given coordinate and rate over the first bodies."""
    batch = study.batch(0, count)
    mechanism = batch.problem
    assert isinstance(mechanism, Mechanism)
    starts = {
        "coordinates": mechanism.coordinates(batch.pose0),
        "velocities": mechanism.velocities(batch.twist0, batch.pose0),
    }
    for key, by_link in starts.items():
        for link in study.problem.links:
            drawn = batch.draws.get(f"{link.name}.initial.{key}")
            given = getattr(link.initial, key) if drawn is None else drawn
            if given is None:
                continue
            names = mechanism.link(link.name).joint.coordinate_names
            start = by_link[link.name]
            asked = np.broadcast_to(np.reshape(given, (-1, len(names))), start.shape)
            for i, name in enumerate(names):
                off = np.abs(start[:, i] - asked[:, i])
                if key == "coordinates" and name in WRAPPED:
                    off = np.abs(off - 2.0 * np.pi * np.rint(off / (2.0 * np.pi)))
                unit = ("m" if name[0] in SLIDES else "rad") + "/s" * (key == "velocities")
                body = int(off.argmax())
                before, after = float(asked[body, i]), float(start[body, i])
                if off[body] > LEAST * max(1.0, abs(before)):
                    label = f"{link.name}.{key}" + f".{name}" * (len(names) > 1)
                    yield _Change(label, unit, before, after, float(off[body]))

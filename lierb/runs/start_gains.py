"""Gains of an objective by the joints of a tree, with which its start moves.

Where a joint of a tree moves on its bodies, the links are carried along, and no row is violated:
directions need no projection. So the gains of all joints follow from those of poses and twists, by
a tape of `lierb.runs.start_directions.carried`.
"""

from __future__ import annotations

from collections.abc import Mapping

from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.vec import Vec
from lierb.runs.parameters import Parameter
from lierb.runs.start_directions import Frames, Start, carried
from lierb.support.arrays import Array

FRAMES = ("ground_frame", "body_frame")


def carries(start: Start, p: Parameter) -> bool:
    """Return whether a parameter moves joints of a tree, and nothing else of the start."""
    is_tree = not (start.with_rows or start.mechanism.loops)
    return is_tree and p.moves_start and all(name.endswith(FRAMES) for name in p.seeds(start))


class _RecordedFrames(Frames):
    """Joints whose frames are inputs of a tape."""

    def __init__(self, start: Start) -> None:
        super().__init__(start, {})
        self.tape, self.fields = Tape(), list[str]()

    def _numbers(self, field: str, numbers: Vec) -> Vec:
        if not field.endswith(FRAMES):
            return numbers
        self.fields += [field] * len(numbers)
        return tuple(self.tape.opened(numbers))


def gains_through_start(start: Start, gains: Mapping[str, Array]) -> dict[str, list[Array]]:
    """Return the gains by the numbers of all joints' frames, by field, through the start.

    gains : by the numbers of poses and twists, by field, [number][trajectory].
    """
    frames = _RecordedFrames(start)
    poses, twists = carried(start.mechanism, frames.parameters, start.placed, start.moving)
    results = [
        pair
        for i, prefix in enumerate(start.model.fields)
        for name, numbers in (("pose", sum(poses[i], ())), ("twist", twists[i]))
        for pair in zip(numbers, gains[f"{prefix}{name}"], strict=True)
    ]
    found: dict[str, list[Array]] = {}
    for field, gain in zip(frames.fields, frames.tape.gains(results), strict=True):
        found.setdefault(field, []).append(gain)
    return found

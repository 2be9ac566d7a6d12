"""Animations of trajectories are one HTML file or a notebook cell, without a network.

`scene` converts a result to plain data; `page` inserts these into `player.html` with `player.js`.
"""

from lierb.results.animation.page import Animation, animate
from lierb.results.animation.shapes import Shape, box, cylinder, equivalent, mesh

__all__ = ["Animation", "Shape", "animate", "box", "cylinder", "equivalent", "mesh"]


def __dir__() -> list[str]:
    return list(__all__)

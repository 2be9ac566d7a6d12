"""Connections of links: ends, frames and rows of joints and elements."""

from __future__ import annotations

from typing import NamedTuple

from lierb.kernels.mechanics.rows import Rows
from lierb.model.joints.joint import Joint

NOWHERE = -1  # index of the ground


class Connection(NamedTuple):
    """Joint or element between two links.

    name : name of the link or loop with the joint, or of the element.
    body, parent : indices of the links; NOWHERE is the ground.
    joint : joint with the two frames; None for an element between the body frames.
    rows : rows of the joint or the element.
    elements : index of the element; empty for a joint.
    second : index of the second joint whose coordinate the rows couple; NOWHERE for others.
    """

    name: str
    body: int
    parent: int
    joint: Joint | None
    rows: Rows = ()
    elements: tuple[int, ...] = ()
    second: int = NOWHERE

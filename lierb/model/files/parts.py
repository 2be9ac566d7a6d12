"""Parts of a mechanism read from a file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from lierb.model.bodies.body import Body
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import Joint
from lierb.support.arrays import Array

GROUND = "ground"


class Placed(NamedTuple):
    """A body of the file is placed as part of a link.

    pose : (4, 4), in the link's body frame.
    """

    link: str
    pose: Array


@dataclass
class Parts:
    """Arguments of a `lierb.Mechanism`, and a list of the elements of the file that it lacks."""

    gravity: Array
    links: list[tuple[str, Body, Joint, str]] = field(default_factory=list)
    loops: list[tuple[str, Joint, str, str]] = field(default_factory=list)
    forces: list[Force] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def free_name(self, given: str, default: str) -> str:
        """Return an unused identifier for a name of the file; list the name if it differs."""
        taken = {GROUND, *(x[0].lower() for x in (*self.links, *self.loops))}
        name = re.sub(r"\W", "_", given, flags=re.ASCII) or default
        name = name if name.isidentifier() else f"_{name}"
        unique, number = name, 2
        while unique.lower() in taken:  # columns are named after links, and SQL ignores case
            unique, number = f"{name}_{number}", number + 1
        if unique != given and given:
            self.left_out.append(f"the name {given!r}: it is {unique}")
        return unique

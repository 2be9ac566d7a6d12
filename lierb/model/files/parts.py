"""Parts of a mechanism read from a file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lierb.model.bodies.body import Body, moved_inertia
from lierb.model.functions.states import ExtraStates
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
    """Arguments of a `lierb.Mechanism`, and a list of the elements of the file that it lacks.

    names : names in the file of bodies and loops, which they keep if they are identifiers.
    link_of_joint : by MuJoCo's index of the joint.
    light : names of links without mass or inertia.
    sites : by name, those of the file and bodies that are part of a link.
    """

    gravity: Array
    names: list[str]
    links: list[tuple[str, Body, Joint, str]] = field(default_factory=list)
    loops: list[tuple[str, Joint, str, str]] = field(default_factory=list)
    forces: list[Force] = field(default_factory=list)
    states: list[ExtraStates] = field(default_factory=list)
    link_of_joint: dict[int, str] = field(default_factory=dict)
    light: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    sites: dict[str, Placed] = field(default_factory=dict)

    def free_name(self, given: str, default: str) -> str:
        """Return an unused identifier for a name of the file; list the name if it differs.

        A name that has to be made differs from all identifiers of the file, used or not.
        """
        used = {GROUND, *(x[0].lower() for x in (*self.links, *self.loops))}
        of_file = {name.lower() for name in self.names}
        name = re.sub(r"\W", "_", given, flags=re.ASCII) or default
        name = name if name.isidentifier() else f"_{name}"
        unique, number = name, 2
        # columns are named after links, and SQL ignores case
        while unique.lower() in used or (unique != given and unique.lower() in of_file):
            unique, number = f"{name}_{number}", number + 1
        if unique != given and given:
            self.left_out.append(f"the name {given!r}: it is {unique}")
        return unique

    def move_frames(self) -> None:
        """Move the body frames to the centres of mass; their axes stay."""
        centres = {GROUND: np.zeros(3), **{name: body.com for name, body, _, _ in self.links}}

        def moved(joint: Joint, body: str, parent: str) -> Joint:
            on_body, on_parent = joint.body_frame.copy(), joint.ground_frame.copy()
            on_body[:3, 3] -= centres[body]
            on_parent[:3, 3] -= centres[parent]
            return replace(joint, body_frame=on_body, ground_frame=on_parent)

        def about_centre(body: Body) -> Body:
            return Body(body.mass, moved_inertia(body.mass, body.inertia, body.com, -1.0))

        self.links = [
            (name, about_centre(body), moved(joint, name, parent), parent)
            for name, body, joint, parent in self.links
        ]
        self.loops = [
            (name, moved(joint, body, parent), body, parent)
            for name, joint, body, parent in self.loops
        ]
        for link, pose in self.sites.values():
            pose[:3, 3] -= centres[link]

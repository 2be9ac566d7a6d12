"""Tables of bodies, joints, links and loops, and of their starts."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from lierb.errors import ArgumentError, require_name
from lierb.model import joints
from lierb.model.bodies import solids
from lierb.model.bodies.body import Body
from lierb.model.joints.joint import Joint
from lierb.model.mechanism.links import GROUND
from lierb.sampling import inertia_of
from lierb.studies.description.messages import called
from lierb.studies.description.sections.fields import Frame, Names, Numbers, Section, Twist, Vector
from lierb.support.arrays import Array, as_floats

POINTS = {  # points of a joint: the origins of these frames
    "body_point": "body_frame",
    "ground_point": "ground_frame",
    "parent_point": "ground_frame",
}


class BodySection(Section):
    """Mass properties, or a homogeneous solid of `lierb.bodies`."""

    solid: Literal["box", "cylinder", "rod", "sphere"] | None = None
    mass: float | None = None
    inertia: Numbers | None = None
    second_moments: Vector | None = None
    com: Vector | None = None
    about: Literal["origin", "com"] | None = None
    size: Vector | None = None
    radius: float | None = None
    length: float | None = None
    density: float | None = None

    def make(self, sampled: dict[str, Array]) -> Body:
        """Make the body; a batch of bodies if quantities are sampled."""
        values = self.given() | sampled
        if "inertia" in sampled and sampled["inertia"].ndim == 2:  # principal moments
            values["inertia"] = sampled["inertia"][:, :, None] * np.eye(3)
        if "second_moments" in values:
            if "inertia" in values:
                raise ArgumentError("give inertia or second_moments, not both")
            values["inertia"] = inertia_of(values.pop("second_moments"))
        if sampled and "inertia" in values:
            given = as_floats("inertia", values["inertia"])
            # one matrix for all bodies, even for a batch of three
            values["inertia"] = given[None] if given.shape == (3, 3) else given
        solid = values.pop("solid", None)
        made: Body = called("body", Body if solid is None else getattr(solids, solid), values)
        return made


class JointSection(Section):
    """Joint of the catalogue, or `type = "from_rows"` with its rows."""

    type: str
    rows: list[str] | None = None
    body_point: Vector | None = None
    ground_point: Vector | None = None
    axis: Vector | None = None
    slot: Vector | None = None
    second_axis: Vector | None = None
    pitch: float | None = None
    length: float | None = None
    body_frame: Frame | None = None
    ground_frame: Frame | None = None
    parent_point: Vector | None = None
    parent_frame: Frame | None = None

    def make(self, sampled: dict[str, Array]) -> Joint:
        """Make the joint; a batch of joints if quantities are sampled."""
        values = self.given() | sampled
        for point, frame in POINTS.items():
            if point in sampled and frame in values:  # move the frame's origin there
                values[frame] = _with_origins(values[frame], values.pop(point))
        name = values.pop("type")
        known: dict[str, Any] = {**joints.JOINTS, "from_rows": joints.from_rows}
        require_name("type", name, known)
        made: Joint = called("joint", known[name], values)
        return made


def _with_origins(frame: Any, places: Array) -> Array:
    frames = np.tile(np.asarray(frame, dtype=float), (len(places), 1, 1))
    frames[:, :3, 3] = places
    return frames


class LinkStart(Section):
    """Start of a link: its pose by `coordinates`, `rotation` and `place`, or `pose`; its velocity.

    coordinates, velocities : joint coordinates and their rates; a number for a single coordinate.
    rotation, place : 3×3, and m; joint frame of the link relative to that of its parent.
    pose : 4×4, in the ground frame.   omega, twist : in the link's axes.
    """

    coordinates: float | list[float] | None = None
    rotation: list[Vector] | None = None
    place: Vector | None = None
    pose: Frame | None = None
    velocities: float | list[float] | None = None
    omega: Vector | None = None
    twist: Twist | None = None


class LinkSection(Section):
    """Link of a mechanism: its body, the joint to its parent, and its start."""

    name: str
    parent: str = GROUND
    body: BodySection
    joint: JointSection
    initial: LinkStart = LinkStart()


class LoopSection(Section):
    """Joint that closes a loop between two links, or between a link and the ground."""

    name: str
    body: str
    parent: str = GROUND
    joint: JointSection


class InitialSection(Section):
    """Start: velocity by `omega` and `point_velocity`, `twist` or `velocities`; pose as below.

    coordinates, velocities : joint coordinates, in the order of `Joint.coordinate_names`, and their
        rates; a number for a single coordinate.
    rotation, place : 3×3, and m; joint frame of the body relative to that of the ground.
    close : for a mechanism, which has no other key here but `hold`. "auto" moves poses and twists
        that violate constraints to the nearest consistent ones in the mass metric; "never" leaves
        them. Each link's start is in its own table [problem.links.initial].
    hold : of a mechanism, the links whose given coordinates and velocities closing keeps.
    """

    close: Literal["auto", "never"] | None = None
    hold: Names | None = None
    omega: Vector | None = None
    point_velocity: Vector | None = None
    twist: Twist | None = None
    velocities: float | list[float] | None = None
    coordinates: float | list[float] | None = None
    rotation: list[Vector] | None = None
    place: Vector | None = None

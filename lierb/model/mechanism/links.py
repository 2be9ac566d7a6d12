"""Links and loops of a mechanism, and connections between links."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from lierb.errors import ArgumentError, brief
from lierb.model.acting import require
from lierb.model.bodies.body import Body
from lierb.model.functions.decorated import MOST_NAME
from lierb.model.joints.joint import Joint
from lierb.support.arrays import Array
from lierb.support.representations import Lines, Represented

GROUND = "ground"
ByLink = Mapping[str, Any]  # values by name of the link: poses, twists, coordinates or rates
Hold = ByLink | str | Iterable[str]  # numbers of joints, or links whose joints keep theirs


@dataclass(frozen=True, eq=False, repr=False)
class Link(Represented):
    """Body of a mechanism, and its joint to another link or to the ground.

    Parameters
    ----------
    name : str
        Name of the link and prefix of its columns in the results: letters, digits and _.
    body : Body
        The body or the batch of bodies.
    joint : Joint
        Joint to the parent. Its `parent_point` or `parent_frame`, another name for `ground_point`
        or `ground_frame`, is in the body frame of the parent.
    parent : str, optional
        Name of another link, or "ground".

    Raises
    ------
    ArgumentError
        The name is no identifier, or the body or joint is of another kind.

    Examples
    --------
    >>> import lierb
    >>> lierb.Link("crank", lierb.bodies.box((0.1, 0.02, 0.02), mass=0.3), lierb.joints.revolute())
    lierb.Link crank: revolute joint to ground
      mass     0.3 kg
      inertia  (2e-05, 0.00026, 0.00026) kg m², principal
    """

    name: str
    body: Body
    joint: Joint
    parent: str = GROUND

    def __post_init__(self) -> None:
        _require_name("a link", self.name)
        require(f"the body of link {self.name}", self.body, Body, "a lierb.Body")
        _require_held("link", self.name, self.joint, self.parent)

    def _representation(self) -> tuple[str, Lines]:
        title = f"lierb.Link {self.name}: {self.joint.name} joint to {self.parent}"
        return title, self.body._representation()[1]


class Site(NamedTuple):
    """Named frame of a link, such as that of a tool or a sensor; it has no effect on the motion.

    Attributes
    ----------
    link : str
        Name of the link, or "ground".
    pose : ndarray, shape (4, 4)
        The frame in the link's body frame.
    """

    link: str
    pose: Array

    @property
    def point(self) -> Array:
        """Origin in the link's body frame, m, of shape (3,)."""
        return self.pose[:3, 3]


@dataclass(frozen=True, eq=False, repr=False)
class Loop(Represented):
    """Joint that closes a loop, in addition to the joints of the links.

    Parameters
    ----------
    name : str
        Name of the loop and prefix of its columns in the results: letters, digits and _.
    joint : Joint
        Joint between the two links.
    body : str
        Name of the link that `body_point` belongs to.
    parent : str, optional
        Name of the link that `parent_point` belongs to, or "ground".

    Examples
    --------
    >>> import lierb
    >>> lierb.Loop("pin", lierb.joints.spherical(), body="rod")
    <lierb.Loop pin: spherical joint of rod to ground>
    """

    name: str
    joint: Joint
    body: str
    parent: str = GROUND

    def __post_init__(self) -> None:
        _require_name("a loop", self.name)
        if not isinstance(self.body, str):
            raise ArgumentError(
                f"loop {self.name}: body={brief(self.body)}; expected a link's name"
            )
        _require_held("loop", self.name, self.joint, self.parent)
        if self.body == self.parent:
            raise ArgumentError(
                f"loop {self.name} is between {self.body} and itself; expected two bodies"
            )

    def _representation(self) -> tuple[str, Lines]:
        title = f"lierb.Loop {self.name}: {self.joint.name} joint of {self.body} to {self.parent}"
        return title, ()


def _require_name(what: str, name: Any) -> None:
    if not (isinstance(name, str) and name.isidentifier() and len(name) <= MOST_NAME):
        raise ArgumentError(
            f"{what} is named {brief(name)}; expected letters, digits and _, at most {MOST_NAME} "
            "of them, since columns are named after it"
        )
    if name == GROUND:
        raise ArgumentError(f'{what} is named "{GROUND}", the name of the fixed frame; rename it')


def _require_held(what: str, name: str, joint: Any, parent: Any) -> None:
    require(
        f"the joint of {what} {name}", joint, Joint, "a joint from lierb.joints, as revolute(…)"
    )
    if not isinstance(parent, str):
        raise ArgumentError(
            f'{what} {name}: parent={brief(parent)}; expected the name of a link, or "{GROUND}"'
        )

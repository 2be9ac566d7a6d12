"""Coordinates of a mechanism's joints: poses and twists of its links, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lierb.kernels.groups import se3
from lierb.kernels.numbers.vec import ZERO6, Vec, add
from lierb.model.joints.coordinates import is_pose, is_rigid, motions_of, numbers_of, relative_of
from lierb.model.mechanism.links import NOWHERE
from lierb.model.mechanism.tree import Tree
from lierb.support.arrays import (
    Array,
    Pose,
    as_numbers,
    as_poses,
    assembled,
    components,
    finite,
    pose_components,
    pose_matrix,
)

_quiet = np.errstate(all="ignore")  # what overflows is found in the result


class Placed(Tree):
    """Tree whose links are placed, and move, by the coordinates of their joints."""

    @_quiet
    def pose(self, coordinates: Mapping[str, Any] | None = None) -> dict[str, Array]:
        """Compute the poses of all links from the coordinates of their joints; loops may stay open.

        `close` then closes the loops.

        Parameters
        ----------
        coordinates : dict, optional
            Coordinates of each link's joint, as `lierb.joints.Joint.pose` takes them: (k,) or (n,
            k), a number or (n,) where there is one, or a rotation. Coordinates left out are 0. Any
            link may be given its pose in the ground frame instead, (4, 4) or (n, 4, 4). A link
            whose joint has no coordinates, such as point_on_line, and that is left out has
            coinciding joint frames.

        Returns
        -------
        dict of ndarray, shape (4, 4) or (n, 4, 4)
            Pose of each link.

        Examples
        --------
        >>> import lierb
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
        >>> lierb.Mechanism([wheel]).pose({"wheel": [0.0, 0.1, 0.2]})["wheel"].shape
        (3, 4, 4)
        """
        given = self.by_link("coordinates", coordinates, is_whole=False)
        found: dict[int, Pose] = {}
        sizes = {}
        for i in self.order:
            link, joint = self.links[i], self.links[i].joint
            argument = f"coordinates[{link.name!r}]"
            place = given.get(link.name)
            if place is not None and is_pose(argument, place, joint):
                whole = as_poses(argument, place)
                sizes[argument] = whole, 2
                self.batch_size(**sizes)
                found[i] = pose_components(whole)
                continue
            relative, size = relative_of(argument, place, joint)
            sizes |= size
            self.batch_size(**sizes)
            ground, body = pose_components(joint.ground_frame), pose_components(joint.body_frame)
            local = se3.compose(se3.compose(ground, relative), se3.inverse(body))
            parent = self.parents[i]
            found[i] = local if parent == NOWHERE else se3.compose(found[parent], local)
        self.batch_size(**sizes)
        return self._poses_of(found)

    def _poses_of(self, found: dict[int, Pose]) -> dict[str, Array]:
        return _alike({n: pose_matrix(found[i]) for i, n in enumerate(self.names)}, "pose", 2)

    @_quiet
    def coordinates(self, pose: Mapping[str, Any]) -> dict[str, Array]:
        """Compute the coordinates of the joints, as `lierb.joints.Joint.coordinates` does.

        Parameters
        ----------
        pose : dict
            Poses of all links; that they close the joints is not checked.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Coordinates of each link's joint. A joint without coordinates has the link's pose in the
            ground frame instead, as `pose` takes it; the link of a fixed joint is left out.
        """
        poses = self.poses("pose", pose)
        found = {}
        for i, link in enumerate(self.links):
            if motions := motions_of(link.joint):
                numbers = motions.coordinates(self.relative(self.joints[i], poses))
                found[link.name] = finite(f"a coordinate of {link.name}", assembled(numbers))
            elif not is_rigid(link.joint):
                found[link.name] = pose_matrix(poses[i])
        return found

    @_quiet
    def twist(
        self, velocities: Mapping[str, Any] | None = None, pose: Mapping[str, Any] | None = None
    ) -> dict[str, Array]:
        """Compute the twists of all links from the rates of their joints' coordinates.

        `project` then satisfies the loops.

        Parameters
        ----------
        velocities : dict, optional
            Rates of each link's joint, rad/s and m/s, (k,) or (n, k), or a number or (n,) where
            there is one. Rates left out are 0. A link whose joint has no coordinates may be given
            its body-fixed twist, (6,) or (n, 6); left out, it moves with its parent.
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.

        Returns
        -------
        dict of ndarray, shape (6,) or (n, 6)
            Body-fixed twist (ω, v) of each link, rad/s and m/s.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(body_point=(0.5, 0.0, 0.0))
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), hinge)
        >>> lierb.Mechanism([wheel]).twist({"wheel": 2.0})["wheel"].tolist()
        [0.0, 0.0, 2.0, 0.0, -1.0, 0.0]
        """
        poses = self.poses("pose", self.pose() if pose is None else pose)
        given = self.by_link("velocities", velocities, is_whole=False)
        found: dict[int, Vec] = {}
        sizes: dict[str, Any] = {f"pose[{n!r}]": poses[i][1][0] for i, n in enumerate(self.names)}
        for i in self.order:
            link, at = self.links[i], self.joints[i]
            argument, motions = f"velocities[{link.name!r}]", motions_of(self.links[i].joint)
            relative: Vec = ZERO6
            if motions:
                rates = numbers_of(argument, given.get(link.name, 0.0), motions.names)
                sizes[argument] = rates, 1
                self.batch_size(**sizes)  # before they meet
                relative = motions.twist(components(rates), self.relative(at, poses))
            elif link.name in given:
                whole = as_numbers(argument, given[link.name], (6,))
                sizes[argument] = whole, 1
                self.batch_size(**sizes)
                found[i] = components(whole)
                continue
            frame = pose_components(link.joint.body_frame)
            if at.parent != NOWHERE:
                relative = add(relative, self.carried(at, poses, found))
            found[i] = se3.Ad(frame, relative)
        self.batch_size(**sizes)
        return _alike({n: assembled(found[i]) for i, n in enumerate(self.names)}, "twist", 1)

    @_quiet
    def velocities(
        self, twist: Mapping[str, Any], pose: Mapping[str, Any] | None = None
    ) -> dict[str, Array]:
        """Compute the rates of the joints' coordinates, in the order of `coordinate_names`.

        Parameters
        ----------
        twist : dict
            Body-fixed twists of all links; that they satisfy the joints is not checked.
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Rates of each link's joint, rad/s and m/s. A joint without coordinates has the link's
            twist instead, as `twist` takes it; the link of a fixed joint is left out.
        """
        poses = self.poses("pose", self.pose() if pose is None else pose)
        twists = self.twists("twist", twist)
        sizes: dict[str, Any] = {f"pose[{n!r}]": poses[i][1][0] for i, n in enumerate(self.names)}
        self.batch_size(
            **sizes, **{f"twist[{n!r}]": v[0] for n, v in zip(self.names, twists, strict=True)}
        )
        found = {}
        for i, link in enumerate(self.links):
            at = self.joints[i]
            if motions := motions_of(link.joint):
                moving = self.relative_twist(at, poses, twists)
                rates = motions.rates(moving, self.relative(at, poses))
                found[link.name] = finite(f"a rate of {link.name}", assembled(rates))
            elif not is_rigid(link.joint):
                found[link.name] = assembled(twists[i])
        return found


def _alike(found: dict[str, Array], what: str, item_axes: int) -> dict[str, Array]:
    """Of all links, each for every member of the batch where it is of one's."""
    for name, array in found.items():
        finite(f"the {what} of {name}", array)
    sizes = [len(array) for array in found.values() if array.ndim > item_axes]
    if not sizes:
        return found
    return {
        name: array
        if array.ndim > item_axes and len(array) == max(sizes)
        else np.broadcast_to(array, (max(sizes), *array.shape[-item_axes:])).copy()
        for name, array in found.items()
    }

"""Kinematics of a mechanism: motions of its links and joints, and coordinates of the joints.

A joint acts between a frame B on its body and a frame G on its parent, another link or the ground:
D = G⁻¹ C_parent⁻¹ C B. Its rows act on D⁻¹Ḋ = Ad(B⁻¹) V − Ad(D⁻¹G⁻¹) V_parent.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, brief, unknown_name
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Parameters
from lierb.kernels.numbers.vec import ZERO6, Vec, add, sub
from lierb.model.connections import NOWHERE, Connection
from lierb.model.joints.coordinates import is_pose, is_rigid, motions_of, relative_of
from lierb.model.joints.joint import Joint, Sizes
from lierb.model.joints.motions import as_coordinates
from lierb.model.mechanism.links import ByLink
from lierb.model.mechanism.tree import Tree
from lierb.model.numbers import numbers_of, parameters_of
from lierb.support.arrays import (
    Array,
    Pose,
    as_poses,
    as_twists,
    assembled,
    components,
    finite,
    pose_components,
    pose_matrix,
)

_quiet = np.errstate(all="ignore")  # overflow is detected in the result


class TreeKinematics(Tree):
    """Tree of links with maps between joint coordinates and poses, and between rates and twists."""

    # ---- connections -----------------------------------------------------------------------------

    def parameters(self, at: Connection) -> Parameters:
        """Return the parameters of a connection's body and frames; gravity is in ground axes."""
        key = at.body, id(at.joint)
        if key not in self._parameters:
            own = parameters_of(self.links[at.body].body, at.joint, self.gravity)
            self._parameters[key] = own, at.joint
        return self._parameters[key][0]

    @cached_property
    def _parameters(self) -> dict[tuple[int, int], tuple[Parameters, Joint | None]]:
        """Parameters by index of the body and id of the joint; the joint, which keeps its id."""
        return {}

    def constants(self, at: Connection) -> BodyConstants:
        """Return the constants of a connection's body, with the elements that act there."""
        elements = [self.elements[i] for i in at.elements]
        given = tuple(element.kind for element in elements)
        return kinds.body_with(SE3, self.parameters(at), given, numbers_of(elements))

    def relative(self, at: Connection, poses: list[Pose], p: Parameters | None = None) -> Pose:
        """Relative pose D = G⁻¹ C_parent⁻¹ C B of a connection.   p : other parameters for it."""
        p = p or self.parameters(at)
        ground = p.ground if at.parent == NOWHERE else se3.compose(poses[at.parent], p.ground)
        return se3.compose(se3.compose(se3.inverse(ground), poses[at.body]), p.body)

    def carried(
        self, at: Connection, relative: Pose, twists: Any, p: Parameters | None = None
    ) -> Vec:
        """Twist Ad(D⁻¹G⁻¹) V_parent of the body's joint frame if the joint were rigid.

        relative : D.   p : as for `relative`.
        """
        in_parent = se3.compose((p or self.parameters(at)).ground, relative)
        return se3.Ad(se3.inverse(in_parent), twists[at.parent])

    def relative_twist(
        self, at: Connection, relative: Pose, twists: Any, p: Parameters | None = None
    ) -> Vec:
        """Relative twist D⁻¹Ḋ = Ad(B⁻¹) V − Ad(D⁻¹G⁻¹) V_parent of a connection.

        relative : D.   p : as for `relative`.
        """
        own = se3.Ad(se3.inverse((p or self.parameters(at)).body), twists[at.body])
        return own if at.parent == NOWHERE else sub(own, self.carried(at, relative, twists, p))

    # ---- arguments by link -----------------------------------------------------------------------

    def pose_arrays(self, argument: str, given: Any) -> list[Array]:
        """Check poses of all links; return them in order, (4, 4) or (n, 4, 4)."""
        given = self.by_link(argument, given)
        poses = {f"{argument}[{n!r}]": given[n] for n in self.names}
        poses = {label: as_poses(label, pose) for label, pose in poses.items()}
        self.batch_size(**{label: (pose, 2) for label, pose in poses.items()})
        return [*poses.values()]

    def twist_arrays(self, argument: str, given: Any) -> list[Array]:
        """Check twists of all links; return them in order, (6,) or (n, 6)."""
        given = self.by_link(argument, given)
        twists = {f"{argument}[{n!r}]": given[n] for n in self.names}
        twists = {label: as_twists(label, twist) for label, twist in twists.items()}
        self.batch_size(**{label: (twist, 1) for label, twist in twists.items()})
        return [*twists.values()]

    def poses(self, argument: str, given: Any) -> list[Pose]:
        """Check poses of all links; return them in order, one array per component."""
        return [pose_components(pose) for pose in self.pose_arrays(argument, given)]

    def twists(self, argument: str, given: Any) -> list[Vec]:
        """Check twists of all links; return them in order, one array per component."""
        return [components(twist) for twist in self.twist_arrays(argument, given)]

    def by_link(self, argument: str, given: Any, is_whole: bool = True) -> dict[str, Any]:
        """Check a dictionary by link.   is_whole : True if every link must have an entry."""
        if given is None and not is_whole:
            return {}
        if not isinstance(given, Mapping):
            entry = f"{{{self.names[0]!r}: …}}"
            maker = next((each for each in ("pose", "twist") if each in argument), "")
            what = {"pose": "coordinates", "twist": "rates of coordinates"}.get(maker)
            hint = f"; mechanism.{maker}({entry}) makes it of the joints' {what}" if maker else ""
            raise ArgumentError(
                f"{argument}={brief(given)}; expected a dictionary of what each link has, as "
                f"{entry}{hint}"
            )
        for name in given:
            if name not in self.names:
                raise unknown_name(argument, name, self.names)
        lacking = [name for name in self.names if name not in given]
        if is_whole and lacking:
            raise ArgumentError(
                f"{argument} lacks {', '.join(lacking)}; expected an entry for every link"
            )
        return dict(given)

    # ---- coordinates of joints -------------------------------------------------------------------

    @_quiet
    def pose(self, coordinates: ByLink | None = None) -> dict[str, Array]:
        """Compute the poses of all links from joint coordinates.

        Loops may remain open; `close` closes them. Poses have no whole turns: those of a joint that
        counts them, by `lierb.turns`, are given by `with_({"drum.turned.start": 15.0})`.

        Parameters
        ----------
        coordinates : dict, optional
            Coordinates of each link's joint, as for `lierb.joints.Joint.pose`: (k,) or (n, k); a
            number or (n,) for a single coordinate; or a rotation. A link's pose in the ground
            frame, (4, 4) or (n, 4, 4), can replace them. Default: 0 for each missing link; if its
            joint has no coordinates, as point_on_line, the joint frames coincide.

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
        poses: dict[int, Pose] = {}
        sizes: Sizes = {}
        for i in self.order:
            link, joint = self.links[i], self.links[i].joint
            argument = f"coordinates[{link.name!r}]"
            place = given.get(link.name)
            if place is not None and is_pose(argument, place, joint):
                whole = as_poses(argument, place)
                sizes[argument] = whole, 2
                self.batch_size(**sizes)
                poses[i] = pose_components(whole)
                continue
            relative, size = relative_of(argument, place, joint)
            sizes |= size
            self.batch_size(**sizes)
            local, parent = joint.pose_of(relative), self.parents[i]
            poses[i] = local if parent == NOWHERE else se3.compose(poses[parent], local)
        return _alike({n: pose_matrix(poses[i]) for i, n in enumerate(self.names)}, "pose", 2)

    @_quiet
    def coordinates(self, pose: ByLink) -> dict[str, Array]:
        """Compute the coordinates of the joints, as `lierb.joints.Joint.coordinates` does.

        Parameters
        ----------
        pose : dict
            Poses of all links. It is not checked whether they close the joints.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Coordinates of each link's joint. For a joint without coordinates, the pose of the link
            in the ground frame, as an argument of `pose`. Links of fixed joints are omitted.
        """
        poses = self.poses("pose", pose)
        coordinates = {}
        for i, link in enumerate(self.links):
            if motions := motions_of(link.joint):
                numbers = motions.coordinates(self.relative(self.joints[i], poses))
                coordinates[link.name] = finite(f"a coordinate of {link.name}", assembled(numbers))
            elif not is_rigid(link.joint):
                coordinates[link.name] = pose_matrix(poses[i])
        return coordinates

    @_quiet
    def twist(
        self, velocities: ByLink | None = None, pose: ByLink | None = None
    ) -> dict[str, Array]:
        """Compute the twists of all links from the rates of joint coordinates.

        Twists may violate the loops; `project` makes them satisfy all loops.

        Parameters
        ----------
        velocities : dict, optional
            Rates of each link's joint, rad/s and m/s: (k,) or (n, k), or a number or (n,) for a
            single coordinate. Those of a ball or free joint are dξ/dt of its rotation vector ξ, not
            ω; `Joint.velocities` converts a twist (ω, v) to them. For a link whose joint has no
            coordinates, its body-fixed twist, (6,) or (n, 6). Default: 0 for each missing link;
            without coordinates, it moves with its parent.
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
        twists: dict[int, Vec] = {}
        sizes: dict[str, Any] = {f"pose[{n!r}]": poses[i][1][0] for i, n in enumerate(self.names)}
        for i in self.order:
            link, at = self.links[i], self.joints[i]
            argument, motions = f"velocities[{link.name!r}]", motions_of(self.links[i].joint)
            relative: Vec = ZERO6
            if motions:
                number = given.get(link.name, 0.0)
                rates = as_coordinates(argument, number, motions.names)
                sizes[argument] = rates, 1
                self.batch_size(**sizes)
                relative = motions.twist(components(rates), self.relative(at, poses))
            elif link.name in given:
                whole = as_twists(argument, given[link.name])
                sizes[argument] = whole, 1
                self.batch_size(**sizes)
                twists[i] = components(whole)
                continue
            frame = pose_components(link.joint.body_frame)
            if at.parent != NOWHERE:
                relative = add(relative, self.carried(at, self.relative(at, poses), twists))
            twists[i] = se3.Ad(frame, relative)
        return _alike({n: assembled(twists[i]) for i, n in enumerate(self.names)}, "twist", 1)

    @_quiet
    def velocities(self, twist: ByLink, pose: ByLink | None = None) -> dict[str, Array]:
        """Compute the rates of the joints' coordinates, in the order of `coordinate_names`.

        Parameters
        ----------
        twist : dict
            Body-fixed twists of all links. They are not checked against the joints.
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Rates of each link's joint, rad/s and m/s. For a joint without coordinates, the twist of
            the link, as an argument of `twist`. Links of fixed joints are omitted.
        """
        poses = self.poses("pose", self.pose() if pose is None else pose)
        twists = self.twists("twist", twist)
        self.batch_size(
            **{f"pose[{n!r}]": d[0] for n, (_, d) in zip(self.names, poses, strict=True)},
            **{f"twist[{n!r}]": v[0] for n, v in zip(self.names, twists, strict=True)},
        )
        velocities = {}
        for i, (link, at) in enumerate(zip(self.links, self.joints, strict=False)):
            if motions := motions_of(link.joint):
                relative = self.relative(at, poses)
                rates = motions.rates(self.relative_twist(at, relative, twists), relative)
                velocities[link.name] = finite(f"a rate of {link.name}", assembled(rates))
            elif not is_rigid(link.joint):
                velocities[link.name] = assembled(twists[i])
        return velocities


def _alike(arrays: dict[str, Array], what: str, item_axes: int) -> dict[str, Array]:
    """Check that the links' arrays are finite; broadcast them to one batch if any is batched."""
    for name, array in arrays.items():
        finite(f"the {what} of {name}", array)
    sizes = [len(array) for array in arrays.values() if array.ndim > item_axes]
    if not sizes:
        return arrays
    return {
        name: array
        if array.ndim > item_axes and len(array) == max(sizes)
        else np.broadcast_to(array, (max(sizes), *array.shape[-item_axes:])).copy()
        for name, array in arrays.items()
    }

"""A joint has constraint rows between two frames, and coordinates of the allowed motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, two_readings
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.newton_euler import closed_pose
from lierb.kernels.mechanics.rows import JointRow, parameters_of
from lierb.kernels.mechanics.subgroup import slots_of
from lierb.kernels.numbers.vec import ZERO3, add, cross, mat_t_vec
from lierb.model.joints.motions import (
    TURNS,
    Factor,
    Motions,
    ProductMotions,
    SubgroupMotions,
    as_coordinates,
)
from lierb.support.arrays import (
    Array,
    Pose,
    Which,
    as_floats,
    as_numbers,
    as_poses,
    as_rotations,
    as_twists,
    assembled,
    batch_size,
    components,
    finite,
    items_at,
    pose_components,
    pose_matrix,
)
from lierb.support.representations import Lines, Represented, quantity

_quiet = np.errstate(all="ignore")  # overflow is detected in the result
Sizes = dict[str, tuple[Array, int]]  # arguments for `batch_size`: arrays and axes of an item
JOINT = {"ground_frame": 2, "body_frame": 2, "pitch": 0, "length": 0}  # axes of an item, by array
FIXED = "fixed"  # name of the joint without motions
MOST_ROWS = 12  # twice the freedoms of a body: a joint may be stated twice, in two ways


@dataclass(frozen=True, eq=False, repr=False)
class Joint(Represented):
    """A joint connects the body to the ground; the entries of `lierb.joints` make it.

    Attributes
    ----------
    name : str
        Name of the entry of the catalogue.
    rows : tuple of JointRow
        Constraint rows, in the order of λ.
    ground_frame : ndarray, shape (4, 4) or (n, 4, 4)
        Joint frame in the ground frame.
    body_frame : ndarray, shape (4, 4) or (n, 4, 4)
        Joint frame in the body frame.
    pitch : ndarray, shape () or (n,)
        Pitch, m/rad; 0 if the joint has none.
    length : ndarray, shape () or (n,)
        Length of a rod, m; 0 if the joint has none.
    subgroup : str or None
        Motion group of the joint as a subgroup of SE(3), if it is one.
    factors : tuple of Factor
        Factors of its motions, if they are a product D = F₁(a) F₂(b) of two instead of a group.
    summary : str
        Description in one line; empty for a joint made from rows.
    """

    name: str
    rows: tuple[JointRow, ...]
    ground_frame: Array
    body_frame: Array
    pitch: Array
    length: Array
    subgroup: str | None = None
    factors: tuple[Factor, ...] = ()
    summary: str = ""

    def of(self, which: Which) -> Joint:
        """Return the joint of one body of the batch, or of part of the batch.

        Parameters
        ----------
        which : int, slice or array of int
            Index of the body, or the part.

        Returns
        -------
        Joint
            The joint.
        """
        arrays: Any = {k: items_at(getattr(self, k), which, n) for k, n in JOINT.items()}
        return replace(self, **arrays)

    def _representation(self) -> tuple[str, Lines]:
        title = f"{self.name} joint{self.summary and f': {self.summary}'}"
        rows = [("rows", " ".join(map(str, self.rows)) or "none")]
        if self.subgroup:
            rows.append(("motions", f"{self.subgroup}, a subgroup of SE(3)"))
        rows.append(("on the body", _shown_frame(self.body_frame)))
        rows.append(("on the ground", _shown_frame(self.ground_frame)))
        for parameter, unit in parameters_of(self.rows).items():
            rows.append((parameter, quantity(getattr(self, parameter), unit)))
        return title, rows

    @property
    def error_kinds(self) -> tuple[str, ...]:
        """Return the kinds of constraint errors of the joint, "position", "rotation" or both."""
        return tuple(sorted({row.error_kind for row in self.rows}))

    @cached_property
    def closed_pose(self) -> Array:
        """Return the pose C = G B⁻¹ in which the two joint frames coincide, (4, 4) or (n, 4, 4).

        For a rod they do not coincide: the body's joint frame is at length·e₃ in the ground's.
        """
        ground, body = pose_components(self.ground_frame), pose_components(self.body_frame)
        with np.errstate(all="ignore"):
            pose = pose_matrix(closed_pose(ground, body, self.length))
        finite("the closed pose", pose).setflags(write=False)  # cached
        return pose

    @_quiet
    def twist(
        self,
        omega: ArrayLike | None = None,
        point_velocity: ArrayLike | None = None,
        pose: Any = None,
        *,
        velocities: ArrayLike | None = None,
        coordinates: ArrayLike | None = None,
    ) -> Array:
        """Compute a body-fixed twist (ω, v) from ω and a point's velocity, or from rates.

        Parameters
        ----------
        omega : array_like, shape (3,) or (n, 3), optional
            Angular velocity in the body frame, rad/s. Default: 0.
        point_velocity : array_like, shape (3,) or (n, 3), optional
            Velocity of the joint's body point in the ground frame, m/s. Default: 0.
        pose : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Pose of the body. Default: the closed joint.
        velocities : array_like, shape (k,) or (n, k), optional
            Rates of the joint's coordinates, rad/s and m/s, instead of `omega` and
            `point_velocity`; a single one may be a number or (n,). Those of a rotation vector ξ are
            dξ/dt, not ω.
        coordinates : array_like, shape (k,) or (n, k), optional
            Coordinates of the joint, instead of `pose`.

        Returns
        -------
        ndarray, shape (6,) or (n, 6)
            Twist, rad/s and m/s. From ω and a point's velocity, v = p×ω + Rᵀ·point_velocity; this
            twist need not satisfy the joint. From rates, the twist satisfies it; `velocities` is
            the inverse.

        Raises
        ------
        ArgumentError
            Arguments exclude each other, or have the wrong shape.

        Examples
        --------
        >>> import lierb
        >>> import numpy as np
        >>> lierb.joints.spherical(body_point=(1.0, 0.0, 0.0)).twist(omega=(0.0, 0.0, 2.0)).tolist()
        [0.0, 0.0, 2.0, 0.0, -2.0, 0.0]
        >>> plane = lierb.joints.planar()
        >>> plane.twist(velocities=(0.0, 1.0, 0.0), coordinates=(np.pi, 0.0, 0.0)).round(9).tolist()
        [0.0, 0.0, 0.0, -1.0, -0.0, 0.0]
        """
        if pose is not None and coordinates is not None:
            raise ArgumentError("give pose or coordinates, not both")
        if velocities is not None:
            for name, given in (("omega", omega), ("point_velocity", point_velocity)):
                if given is not None:
                    raise ArgumentError(f"give velocities or {name}, not both")
            return self._twist_of_rates(velocities, pose, coordinates)
        turning = as_numbers("omega", (0.0, 0.0, 0.0) if omega is None else omega, (3,))
        moving = as_numbers(
            "point_velocity", (0.0, 0.0, 0.0) if point_velocity is None else point_velocity, (3,)
        )
        placed = self._placed(pose) if coordinates is None else self.pose(coordinates=coordinates)
        batch_size(
            omega=(turning, 1),
            point_velocity=(moving, 1),
            pose=(placed, 2),
            body_frame=(self.body_frame, 2),
        )
        w, velocity = components(turning), components(moving)
        rotation, _ = pose_components(placed)
        _, point = pose_components(self.body_frame)
        return finite(
            "the twist", assembled(w + add(cross(point, w), mat_t_vec(rotation, velocity)))
        )

    def _twist_of_rates(self, velocities: ArrayLike, pose: Any, coordinates: Any) -> Array:
        motions, names = self.motions, self.coordinate_names
        rates = as_coordinates("velocities", velocities, names)
        frames = self._frames
        if coordinates is None:
            placed = self._placed(pose)
            batch_size(velocities=(rates, 1), pose=(placed, 2), pitch=(self.pitch, 0), **frames)
            relative = motions.twist(components(rates), self._relative(placed))
        else:
            given = as_coordinates("coordinates", coordinates, names)
            batch_size(velocities=(rates, 1), coordinates=(given, 1), pitch=self.pitch, **frames)
            relative = motions.twist_at(components(rates), components(given))
        return finite("the twist", assembled(se3.Ad(pose_components(self.body_frame), relative)))

    @_quiet
    def velocities(self, twist: ArrayLike, pose: Any = None) -> Array:
        """Compute the rates of the joint's coordinates, in the order of `coordinate_names`.

        `twist(velocities=…, pose=…)` is the inverse.

        Parameters
        ----------
        twist : array_like, shape (6,) or (n, 6)
            Body-fixed twist (ω, v), rad/s and m/s. It is not checked against the joint.
        pose : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Pose of the body. Default: the closed joint.

        Returns
        -------
        ndarray, shape (k,) or (n, k)
            Rates, rad/s and m/s.

        Raises
        ------
        ArgumentError
            The joint has no coordinates: its motions are neither a group nor a product.

        Examples
        --------
        >>> import lierb
        >>> import numpy as np
        >>> plane = lierb.joints.planar()
        >>> turned = plane.pose((np.pi, 0.0, 0.0))
        >>> plane.velocities((0.0, 0.0, 0.0, 1.0, 0.0, 0.0), turned).round(9).tolist()
        [0.0, -1.0, 0.0]
        """
        motions, moving = self.motions, as_twists("twist", twist)
        placed = self._placed(pose)
        batch_size(twist=(moving, 1), pose=(placed, 2), body_frame=(self.body_frame, 2))
        in_body = se3.inverse(pose_components(self.body_frame))
        rates = motions.rates(se3.Ad(in_body, components(moving)), self._relative(placed))
        return finite("the rate of a coordinate", assembled(rates))

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Return the names of coordinates of motion groups and products; () for a fixed joint.

        `phi`: angle about e₃, rad; `xi1` … `xi3`: rotation vector, rad, in the ground's joint
        frame; `d1` … `d3`: position of the body's joint frame in the ground's, m. A universal joint
        has `alpha`, the angle about e₃ of the ground, and `beta`, the angle about e₂ of the body; a
        hook joint has the angles about e₂ and e₃. A pin in a slot has `d1` and `phi`; with the slot
        on the body, `phi` and `s`, the position of the body's joint frame along its own e₁.
        """
        return () if self.name == FIXED else self.motions.names

    @_quiet
    def coordinates(self, pose: Any) -> Array:
        """Compute the joint's coordinates at a pose, in the order of `coordinate_names`.

        Angles are in [−π, π], except for a screw with a pitch: its slide determines whole turns.

        Parameters
        ----------
        pose : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4)
            Pose of the body. It is not checked whether it closes the joint.

        Returns
        -------
        ndarray, shape (k,) or (n, k)
            Coordinates, rad and m.

        Raises
        ------
        ArgumentError
            The joint has no coordinates: its motions are neither a group nor a product.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
        >>> hinge.coordinates(hinge.pose([0.5])).tolist()
        [0.5]
        """
        relative = self._relative(as_poses("pose", pose))
        return finite("a coordinate", assembled(self.motions.coordinates(relative)))

    @_quiet
    def pose(
        self, place: Any = None, /, *, coordinates: ArrayLike | None = None, rotation: Any = None
    ) -> Array:
        """Compute the pose for coordinates, or for a rotation.

        Parameters
        ----------
        place : array_like or Rotation, optional
            Coordinates or rotation; a single coordinate may be a number or (n,). An ambiguous shape
            is refused: (3, 3) is a matrix, or the rotation vectors of three bodies.
        coordinates : array_like, shape (k,) or (n, k), optional
            Coordinates, rad and m; see `coordinate_names`. A single one may be a number or (n,).
        rotation : array_like or Rotation, shape (3, 3) or (n, 3, 3), optional
            Orientation of the body's joint frame in the ground's, for a joint that turns about a
            point.

        Returns
        -------
        ndarray, shape (4, 4) or (n, 4, 4)
            Pose of the body.

        Raises
        ------
        ArgumentError
            The joint has no coordinates: its motions are neither a group nor a product.
        PoseError
            A matrix is not a rotation.

        Examples
        --------
        >>> import lierb
        >>> ball = lierb.joints.spherical(body_point=(0.0, 0.0, -1.0))
        >>> turned = ball.pose(rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        >>> ball.coordinates(turned).round(3).tolist(), turned[:3, 3].tolist()
        ([1.571, 0.0, 0.0], [0.0, -1.0, 0.0])
        """
        if sum(given is not None for given in (place, coordinates, rotation)) != 1:
            raise ArgumentError("give coordinates, or a rotation: one of the two")
        if place is not None:
            coordinates, rotation = self._either(place)
        if rotation is not None:
            relative, size = self.turned("rotation", rotation)
        else:
            relative, size = self.at_coordinates("coordinates", coordinates)
        batch_size(**size, **self._frames, pitch=self.pitch)
        return finite("the pose", pose_matrix(self.pose_of(relative)))

    def pose_of(self, relative: Pose) -> Pose:
        """Return the pose G D B⁻¹ of the body in the ground or parent, for a relative pose D."""
        ground, body = pose_components(self.ground_frame), pose_components(self.body_frame)
        return se3.compose(se3.compose(ground, relative), se3.inverse(body))

    def at_coordinates(self, argument: str, given: Any) -> tuple[Pose, Sizes]:
        """Return D for coordinates, and the argument for `batch_size`."""
        numbers = as_coordinates(argument, given, self.motions.names)
        return self.motions.pose(components(numbers)), {argument: (numbers, 1)}

    def turned(self, argument: str, given: Any) -> tuple[Pose, Sizes]:
        """Return D for a rotation, and the argument for `batch_size`."""
        if (names := self.motions.names) != TURNS:
            raise ArgumentError(
                f"{argument}: a {self.name} joint takes no rotation: its coordinates are "
                f"{', '.join(names)}; give those"
            )
        turns = as_rotations(argument, given)
        return (components(turns, 2), ZERO3), {argument: (turns, 2)}

    def _either(self, place: Any) -> tuple[Any, Any]:
        """Return `place` as (coordinates, None) or (None, rotation)."""
        if hasattr(place, "as_matrix"):
            return None, place
        given = as_floats("coordinates", place)
        if given.shape == (3, 3) and self.coordinate_names == TURNS:
            raise two_readings(
                "coordinates", given.shape, a_rotation_matrix="rotation=R",
                three_rotation_vectors="coordinates=xi",
            )  # fmt: skip
        return (None, given) if given.ndim == 3 else (given, None)

    @property
    def _frames(self) -> Sizes:
        """Return the arguments for `batch_size`."""
        return {"ground_frame": (self.ground_frame, 2), "body_frame": (self.body_frame, 2)}

    def _placed(self, pose: Any) -> Array:
        return self.closed_pose if pose is None else as_poses("pose", pose)

    def _relative(self, placed: Array) -> Pose:
        """Return the relative pose D = G⁻¹CB of the two joint frames."""
        batch_size(pose=(placed, 2), **self._frames)
        ground, body = pose_components(self.ground_frame), pose_components(self.body_frame)
        return se3.compose(se3.compose(se3.inverse(ground), pose_components(placed)), body)

    @cached_property
    def motions(self) -> Motions:
        """Coordinates of the relative pose D; raises ArgumentError if the joint has none."""
        if self.subgroup:
            return SubgroupMotions(slots_of(self.rows), self.pitch)
        if self.factors:
            return ProductMotions(self.factors)
        why = "body is fixed" if self.name == FIXED else "motions are no group and no product"
        raise ArgumentError(f"a {self.name} joint has no coordinates: its {why}")


def _shown_frame(frame: Array) -> str:
    origin, e1, e3 = frame[..., :3, 3], frame[..., :3, 0], frame[..., :3, 2]
    parts = quantity(origin, "m", 1), f"e₁ {quantity(e1, '', 1)}", f"e₃ {quantity(e3, '', 1)}"
    return ", ".join(parts) if frame.size == 16 else quantity(frame, item_axes=2)

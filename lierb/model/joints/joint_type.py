"""A joint type is a catalogue entry that makes joints from points and axes, or from frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.errors.synonyms import JOINT_ARGUMENTS
from lierb.kernels.mechanics.rows import JointRow, parameters_of
from lierb.model.joints.frames import body_frame_of, ground_frame_of
from lierb.model.joints.joint import Joint
from lierb.model.joints.motions import Factor
from lierb.support.arrays import as_numbers, as_positive, batch_size
from lierb.support.keywords import explains_keywords


@dataclass(frozen=True)
class JointType:
    """Entry of the catalogue; a call makes the joint.

    Attributes
    ----------
    name : str
        Name of the entry.
    rows : tuple of JointRow
        Constraint rows, in the order of λ.
    summary : str
        Description in one line.
    subgroup : str or None
        Motion group of the joint as a subgroup of SE(3), if it is one.
    options : frozenset of str
        Further arguments of the entry: "pitch", "length", "slot", "second_axis".
    factors : tuple of Factor
        Factors of its motions, if they are a product D = F₁(a) F₂(b) of two instead of a group.
    """

    name: str
    rows: tuple[JointRow, ...]
    summary: str
    subgroup: str | None = None
    options: frozenset[str] = frozenset()
    factors: tuple[Factor, ...] = ()

    @explains_keywords(JOINT_ARGUMENTS, "a joint of lierb.joints")
    def __call__(
        self,
        body_point: ArrayLike | None = None,
        ground_point: ArrayLike | None = None,
        *,
        axis: ArrayLike | None = None,
        slot: ArrayLike | None = None,
        second_axis: ArrayLike | None = None,
        pitch: ArrayLike | None = None,
        length: ArrayLike | None = None,
        body_frame: Any = None,
        ground_frame: Any = None,
        parent_point: ArrayLike | None = None,
        parent_frame: Any = None,
    ) -> Joint:
        """Make the joint, with frames from points and axes, or from 4×4 matrices.

        All arguments may be batched. By default the ground's joint frame is parallel to the body's:
        the joint is closed at R = I.

        Parameters
        ----------
        body_point : array_like, shape (3,) or (n, 3), optional
            Point of the joint in the body frame, m. Default: its origin.
        ground_point : array_like, shape (3,) or (n, 3), optional
            Point of the joint in the ground frame, m. Default: its origin.
        axis : array_like, shape (3,) or (n, 3), optional
            Direction of the joint axis e₃ in the body frame. Default: (0, 0, 1).
        slot : array_like, shape (3,) or (n, 3), optional
            Direction of the slot e₁ at R = I, in the body frame (pin_in_slot only).
        second_axis : array_like, shape (3,) or (n, 3), optional
            Direction of e₂ in the body frame (universal and hook only).
        pitch : float or array_like, shape (n,), optional
            Pitch, m/rad (screw and helical_planar only).
        length : float or array_like, shape (n,), optional
            Length, m, positive (point_on_sphere only).
        body_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Joint frame in the body frame, in place of point and axes; a Rotation is about the
            origin.
        ground_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Joint frame in the ground frame, in place of the point.
        parent_point : array_like, shape (3,) or (n, 3), optional
            Another name of `ground_point`, for a joint between two links of a `lierb.Mechanism`: in
            the body frame of the parent.
        parent_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Another name of `ground_frame`, likewise.

        Returns
        -------
        Joint
            The joint or the batch of joints.

        Raises
        ------
        ArgumentError
            The entry does not take an argument, or its shape or value is wrong.
        PoseError
            A frame is not a rigid motion.

        Examples
        --------
        >>> import lierb
        >>> lierb.joints.screw(body_point=(0.1, 0.0, 0.0), pitch=0.02).coordinate_names
        ('phi',)
        """
        given = {"pitch": pitch, "length": length, "slot": slot, "second_axis": second_axis}
        for option, value in given.items():
            if value is not None and option not in self.options:
                raise ArgumentError(f"a {self.name} joint takes no {option}")
        for parameter, unit in parameters_of(self.rows).items():
            if given[parameter] is None:
                raise ArgumentError(f"a {self.name} joint needs {parameter}=, in {unit}")
        body = body_frame_of(body_frame, body_point, axis, slot, second_axis)
        ground = ground_frame_of(ground_frame, ground_point, parent_frame, parent_point, body)
        no_length = as_numbers("length", 0.0, ())
        rod = no_length if length is None else as_positive("length", length, "m")
        slide = as_numbers("pitch", 0.0 if pitch is None else pitch, ())
        batch_size(body_frame=(body, 2), ground_frame=(ground, 2), pitch=slide, length=rod)
        for frame in (body, ground):
            frame.setflags(write=False)
        return Joint(
            self.name, self.rows, ground, body, slide, rod, self.subgroup, self.factors,
            self.summary,
        )  # fmt: skip

    def __repr__(self) -> str:
        return f"<lierb.joints.{self.name}: {self.summary}>"


JOINTS: dict[str, JointType] = {}

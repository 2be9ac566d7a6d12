"""The joint catalogue, as data: each joint is a list of primitive rows, acting between two frames.

Rows are those of `lierb.kernels.constraints`, in the order in which λ has them, and act on
D = G⁻¹CB = (Q, d), with G the joint frame in the ground and B in the body: `d1` d_i = 0, `Qtd1`
(Qᵀd)_i = 0, `Q32` Q_ij = 0, `Omega1` Ω_k = 0, `screw` d₃ − pitch·φ = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.arrays import (
    Array,
    as_numbers,
    as_poses,
    assembled,
    batch_size,
    components,
    pose_components,
    pose_matrix,
)
from lierb.errors import ArgumentError, body_label, unknown_name
from lierb.kernels import se3
from lierb.kernels.constraints import Row
from lierb.kernels.vec import Vec, add, cross, dot, mat_t_vec, norm, scale, sub

PERPENDICULAR_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between the ground and the body; made by the entries of this module.

    ground_frame : (4, 4) or (n, 4, 4), the joint frame seen from the ground.
    body_frame : (4, 4) or (n, 4, 4), the joint frame seen from the body.
    pitch : () or (n,), m/rad; 0 where the joint has none.
    subgroup : the joint's motions as a subgroup of SE(3), if they are one.
    """

    name: str
    rows: tuple[Row, ...]
    ground_frame: Array
    body_frame: Array
    pitch: Array
    subgroup: str | None = None

    def __repr__(self) -> str:
        return f"<{self.name} joint: {' '.join(map(str, self.rows)) or 'no rows'}>"

    @cached_property
    def closed_pose(self) -> Array:
        """C = G B⁻¹, (4, 4) or (n, 4, 4): the pose in which the two joint frames coincide."""
        ground, body = pose_components(self.ground_frame), pose_components(self.body_frame)
        pose = pose_matrix(se3.compose(ground, se3.inverse(body)))
        pose.setflags(write=False)  # shared by all who ask
        return pose

    def twist(
        self,
        omega: ArrayLike = (0.0, 0.0, 0.0),
        point_velocity: ArrayLike = (0.0, 0.0, 0.0),
        pose: Any = None,
    ) -> Array:
        """Body-fixed twist (ω, v) from ω and the velocity of the joint's body point.

        omega : (3,) or (n, 3), rad/s, in the body frame.
        point_velocity : (3,) or (n, 3), m/s, in the ground frame.
        pose : 4×4, (n, 4, 4) or SciPy; the closed joint if not given.
        Returns (6,) or (n, 6) with v = p×ω + Rᵀ·point_velocity; not made to satisfy the joint.

        >>> import lierb
        >>> lierb.joints.spherical(body_point=(1.0, 0.0, 0.0)).twist(omega=(0.0, 0.0, 2.0)).tolist()
        [0.0, 0.0, 2.0, 0.0, -2.0, 0.0]
        """
        turning = as_numbers("omega", omega, (3,))
        moving = as_numbers("point_velocity", point_velocity, (3,))
        placed = self.closed_pose if pose is None else as_poses("pose", pose)
        batch_size(
            omega=(turning, 1),
            point_velocity=(moving, 1),
            pose=(placed, 2),
            body_frame=(self.body_frame, 2),
        )
        w, velocity = components(turning), components(moving)
        rotation, _ = pose_components(placed)
        _, point = pose_components(self.body_frame)
        return assembled(w + add(cross(point, w), mat_t_vec(rotation, velocity)))


@dataclass(frozen=True)
class JointType:
    """An entry of the catalogue; calling it makes the joint.

    subgroup: the motion group of the joint as a subgroup of SE(3), if it is one.
    options: what else the entry takes ("pitch", "slot", "second_axis").
    """

    name: str
    rows: tuple[Row, ...]
    summary: str
    subgroup: str | None = None
    options: frozenset[str] = frozenset()

    def __call__(
        self,
        body_point: ArrayLike | None = None,
        ground_point: ArrayLike | None = None,
        *,
        axis: ArrayLike | None = None,
        slot: ArrayLike | None = None,
        second_axis: ArrayLike | None = None,
        pitch: ArrayLike | None = None,
        body_frame: Any = None,
        ground_frame: Any = None,
    ) -> Joint:
        """The joint, its frames given by points and axes, or as 4×4 matrices. All may be batched.

        body_point : (3,) or (n, 3), m, in the body frame. Default: its origin.
        ground_point : (3,) or (n, 3), m, in the ground frame. Default: its origin.
        axis : (3,) or (n, 3), the body direction of the joint axis e₃. Default: (0, 0, 1).
        slot : (3,), body direction of the slot e₁ at R = I (pin_in_slot only).
        second_axis : (3,), body direction of e₂ (universal only).
        pitch : number or (n,), m/rad (screw only).
        body_frame, ground_frame : (4, 4) or (n, 4, 4), instead of points and axes.

        Without ground_frame the ground's joint frame is turned like the body's: the joint closes at
        R = I. Raises ArgumentError, or PoseError for a frame that is no rigid motion.
        """
        given = {"pitch": pitch, "slot": slot, "second_axis": second_axis}
        for option, value in given.items():
            if value is not None and option not in self.options:
                raise ArgumentError(f"a {self.name} joint takes no {option}")
        if pitch is None and "pitch" in self.options:
            raise ArgumentError(f"a {self.name} joint needs pitch=, in m/rad")
        body = _body_frame(body_frame, body_point, axis, slot, second_axis)
        ground = _ground_frame(ground_frame, ground_point, body)
        lead = as_numbers("pitch", 0.0 if pitch is None else pitch, ())
        batch_size(body_frame=(body, 2), ground_frame=(ground, 2), pitch=lead)
        for frames in (body, ground):
            frames.setflags(write=False)  # what was checked stays so
        return Joint(self.name, self.rows, ground, body, lead, self.subgroup)

    def __repr__(self) -> str:
        return f"<lierb.joints.{self.name}: {self.summary}>"


# ---- frames ------------------------------------------------------------------------------------


def _body_frame(
    frame: Any,
    point: ArrayLike | None,
    axis: ArrayLike | None,
    slot: ArrayLike | None,
    second_axis: ArrayLike | None,
) -> Array:
    if frame is not None:
        directions = {"body_point": point, "axis": axis, "slot": slot, "second_axis": second_axis}
        for name, value in directions.items():
            if value is not None:
                raise ArgumentError(f"give body_frame or {name}, not both")
        return as_poses("body_frame", frame)
    if slot is not None and second_axis is not None:
        raise ArgumentError("give slot (e₁) or second_axis (e₂), not both")
    given = {
        "body_point": (0.0, 0.0, 0.0) if point is None else point,
        "axis": (0.0, 0.0, 1.0) if axis is None else axis,
        "slot": slot,
        "second_axis": second_axis,
    }
    vectors = {n: as_numbers(n, value, (3,)) for n, value in given.items() if value is not None}
    batch_size(**{name: (vector, 1) for name, vector in vectors.items()})
    origin, e3 = vectors["body_point"], _direction("axis", vectors["axis"])
    if slot is not None:
        e1 = _perpendicular("slot", slot, e3)
    elif second_axis is not None:
        e1 = cross(_perpendicular("second_axis", second_axis, e3), e3)
    else:
        e1 = _any_perpendicular(e3)
    return _frame(e1, e3, components(origin))


def _ground_frame(frame: Any, point: ArrayLike | None, body_frame: Array) -> Array:
    if frame is not None:
        if point is not None:
            raise ArgumentError("give ground_frame or ground_point, not both")
        return as_poses("ground_frame", frame)
    origin = as_numbers("ground_point", (0.0, 0.0, 0.0) if point is None else point, (3,))
    batch_size(body_frame=(body_frame, 2), ground_point=(origin, 1))
    return pose_matrix((pose_components(body_frame)[0], components(origin)))


def _frame(e1: Vec, e3: Vec, origin: Vec) -> Array:
    e2 = cross(e3, e1)
    rotation = (e1[0], e2[0], e3[0], e1[1], e2[1], e3[1], e1[2], e2[2], e3[2])
    return pose_matrix((rotation, origin))


def _direction(argument: str, value: ArrayLike) -> Vec:
    array = as_numbers(argument, value, (3,))
    largest = np.abs(array).max(axis=-1)
    zero = np.flatnonzero(largest == 0.0)
    if zero.size:
        label = body_label(argument, int(zero[0]), largest.size)
        raise ArgumentError(f"{label} is the zero vector; expected a direction")
    exponent = np.frexp(largest)[1]  # a power of two: exact, and no square overflows
    return _unit(components(np.ldexp(array, -exponent[..., None])))


def _perpendicular(argument: str, value: ArrayLike, e3: Vec) -> Vec:
    e = _direction(argument, value)
    slant = dot(e, e3)
    cosines = np.atleast_1d(np.abs(slant))
    bad = np.flatnonzero(cosines > PERPENDICULAR_TOLERANCE)
    if bad.size:
        label = body_label(argument, int(bad[0]), cosines.size)
        raise ArgumentError(
            f"{label} is not perpendicular to axis: the cosine is {cosines[bad[0]]:.3g}"
        )
    return _unit(sub(e, scale(slant, e3)))


def _any_perpendicular(e3: Vec) -> Vec:
    """The part ⊥ e₃ of the first coordinate axis whose |cos| with e₃ is below 0.9, normalised."""
    x_fits = np.abs(e3[0]) < 0.9  # else e₃ is near x, and y fits
    chosen = (np.where(x_fits, 1.0, 0.0), np.where(x_fits, 0.0, 1.0), np.zeros_like(e3[2]))
    return _unit(sub(chosen, scale(dot(chosen, e3), e3)))


def _unit(v: Vec) -> Vec:
    return scale(1.0 / norm(v), v)


# ---- the catalogue -----------------------------------------------------------------------------

JOINTS: dict[str, JointType] = {}


def _entry(
    name: str, rows: str, summary: str, subgroup: str | None = None, options: tuple[str, ...] = ()
) -> JointType:
    parsed = tuple(Row.parse(row) for row in rows.split())
    JOINTS[name] = JointType(name, parsed, summary, subgroup, frozenset(options))
    return JOINTS[name]


spherical = _entry("spherical", "d1 d2 d3", "turns about a point", "SO(3)")
revolute = _entry("revolute", "d1 d2 d3 Omega1 Omega2", "turns about an axis", "SO(2)")
cylindrical = _entry(
    "cylindrical", "d1 d2 Omega1 Omega2", "turns about an axis and slides along it", "SO(2)×R"
)
prismatic = _entry("prismatic", "d1 d2 Omega1 Omega2 Omega3", "slides along an axis", "R")
screw = _entry(
    "screw", "d1 d2 screw Omega1 Omega2", "turns and slides in proportion", "H_p", ("pitch",)
)
planar = _entry("planar", "d3 Omega1 Omega2", "moves in a plane and turns in it", "SE(2)")
universal = _entry(
    "universal",
    "d1 d2 d3 Q32",
    "Hooke's joint: e₃ on the ground stays perpendicular to e₂ on the body",
    options=("second_axis",),
)
pin_in_slot = _entry(
    "pin_in_slot",
    "d2 d3 Omega1 Omega2",
    "turns about e₃ while its point slides along e₁ of the ground",
    options=("slot",),
)
free = _entry("free", "", "no constraint", "SE(3)")


def from_rows(
    rows: Sequence[str | Row],
    body_point: ArrayLike | None = None,
    ground_point: ArrayLike | None = None,
    *,
    axis: ArrayLike | None = None,
    slot: ArrayLike | None = None,
    second_axis: ArrayLike | None = None,
    pitch: ArrayLike | None = None,
    body_frame: Any = None,
    ground_frame: Any = None,
    name: str = "from_rows",
) -> Joint:
    """A joint from primitive rows: `d1`, `Qtd1`, `Q32`, `Omega1` or `screw` (axes 1 to 3).

    `Omega` rows come in twos or threes: one alone is a condition on velocity that fixes no
    orientation. A `screw` row needs pitch=, and Omega1 and Omega2. Frames as for every joint.
    Raises UnknownNameError for another row, ArgumentError for a row given twice, more than six
    rows, or rows that make no joint.

    >>> import lierb
    >>> lierb.joints.from_rows(["d3", "Omega1", "Omega3"], body_point=(0.1, 0.0, 0.0))
    <from_rows joint: d3 Omega1 Omega3>
    """
    if isinstance(rows, str) or not isinstance(rows, Iterable):
        raise ArgumentError(f"rows={rows!r}; expected a list of row names")
    rows = list(rows)
    parsed = tuple(_row(row) for row in rows)
    kinds = {(row.kind, row.i) for row in parsed}
    if ("screw", 2) in kinds and not {("Omega", 0), ("Omega", 1)} <= kinds:
        raise ArgumentError(
            f"rows={rows} has a screw row whose axis may tilt; add Omega1 and Omega2"
        )
    if len(set(parsed)) < len(parsed):
        raise ArgumentError(f"rows={list(rows)} names a row twice")
    if len(parsed) > 6:
        raise ArgumentError(
            f"rows={list(rows)} are {len(parsed)} rows; a rigid body has 6 freedoms"
        )
    if sum(row.kind == "Omega" for row in parsed) == 1:
        raise ArgumentError(
            f"rows={list(rows)} has one Omega row alone; expected two, three or none"
        )
    options = {"slot", "second_axis"} | (
        {"pitch"} if any(r.kind == "screw" for r in parsed) else set()
    )
    made = JointType(name, parsed, "built from rows", None, frozenset(options))
    return made(
        body_point,
        ground_point,
        axis=axis,
        slot=slot,
        second_axis=second_axis,
        pitch=pitch,
        body_frame=body_frame,
        ground_frame=ground_frame,
    )


_ROW_NAMES = [f"{kind}{i}" for kind in ("d", "Qtd", "Omega") for i in "123"]
_ROW_NAMES += [f"Q{i}{j}" for i in "123" for j in "123"] + ["screw"]


def _row(name: str | Row) -> Row:
    try:
        return Row.parse(str(name) if isinstance(name, Row) else name.replace("Ω", "Omega"))
    except (ValueError, AttributeError, TypeError):
        raise unknown_name("row", name, _ROW_NAMES) from None


__all__ = ["JOINTS", "Joint", "JointType", "from_rows", *JOINTS]

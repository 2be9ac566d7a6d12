"""Define the entries of the joint catalogue, and make joints from rows by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, items_of, unknown_name
from lierb.kernels.mechanics.rows import JOINT_ROWS, JointRow, Row, parameters_of
from lierb.model.joints.joint import MOST_ROWS, Joint
from lierb.model.joints.joint_type import JOINTS, JointType
from lierb.model.joints.motions import Factor


def _entry(
    name: str,
    rows: str,
    summary: str,
    subgroup: str | None = None,
    options: tuple[str, ...] = (),
    factors: tuple[Factor, ...] = (),
) -> JointType:
    parsed = tuple(JOINT_ROWS[row] for row in rows.split())
    taken = frozenset((*options, *parameters_of(parsed)))
    JOINTS[name] = JointType(name, parsed, summary, subgroup, taken, factors)
    return JOINTS[name]


spherical = _entry("spherical", "d1 d2 d3", "turns about a point", "SO(3)")
revolute = _entry("revolute", "d1 d2 d3 Omega1 Omega2", "turns about an axis", "SO(2)")
cylindrical = _entry(
    "cylindrical", "d1 d2 Omega1 Omega2", "turns about an axis and slides along it", "SO(2)×R"
)
prismatic = _entry("prismatic", "d1 d2 Omega1 Omega2 Omega3", "slides along an axis", "R")
screw = _entry("screw", "d1 d2 screw Omega1 Omega2", "turns and slides in proportion", "H_p")
planar = _entry("planar", "d3 Omega1 Omega2", "moves in a plane and turns in it", "SE(2)")
universal = _entry(
    "universal",
    "d1 d2 d3 Q32",
    "Hooke's joint: e₃ on the ground stays perpendicular to e₂ on the body",
    options=("second_axis",),
    factors=(Factor("alpha", "turn", 2), Factor("beta", "turn", 1)),
)
hook = _entry(
    "hook",
    "d1 d2 d3 Q23",
    "Hooke's joint as Müller prints it: e₂ on the ground stays perpendicular to e₃ on the body",
    options=("second_axis",),
    factors=(Factor("alpha", "turn", 1), Factor("beta", "turn", 2)),
)
fixed = _entry("fixed", "d1 d2 d3 Omega1 Omega2 Omega3", "does not move")
planar_translation = _entry(
    "planar_translation", "d3 Omega1 Omega2 Omega3", "moves in a plane, does not turn", "R²"
)
translation = _entry("translation", "Omega1 Omega2 Omega3", "moves, does not turn", "R³")
helical_planar = _entry(
    "helical_planar",
    "screw Omega1 Omega2",
    "moves in a plane, turns in it and rises in proportion",
    "H_p⋉R²",
)
schoenflies = _entry(
    "schoenflies", "Omega1 Omega2", "moves freely, turns about one direction", "SO(2)⋉R³"
)
pin_in_slot = _entry(
    "pin_in_slot",
    "d2 d3 Omega1 Omega2",
    "turns about e₃ while its point slides along e₁ of the ground",
    options=("slot",),
    factors=(Factor("d1", "slide", 0), Factor("phi", "turn", 2)),
)
pin_in_slot_body = _entry(
    "pin_in_slot_body",
    "Qtd2 Qtd3 Omega1 Omega2",
    "turns about e₃ while its slot, along e₁ of the body, slides on the ground's point",
    options=("slot",),
    factors=(Factor("phi", "turn", 2), Factor("s", "slide", 0)),
)
point_on_line = _entry("point_on_line", "d1 d2", "keeps a point on a line along e₃ of the ground")
point_on_plane = _entry("point_on_plane", "d3", "keeps a point in a plane normal to e₃")
point_on_sphere = _entry(
    "point_on_sphere", "rod", "a massless rod with a ball at each end holds a point at a distance"
)
constant_velocity = _entry(
    "constant_velocity",
    "d1 d2 d3 cv",
    "bends about any axis normal to e₃, shafts along e₃ turn equally fast",
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
    length: ArrayLike | None = None,
    body_frame: Any = None,
    ground_frame: Any = None,
    parent_point: ArrayLike | None = None,
    parent_frame: Any = None,
    name: str = "from_rows",
) -> Joint:
    """Make a joint from rows: `d1`, `Qtd1`, `Q32`, `Omega1` (axes 1 to 3), `screw`, `rod` or `cv`.

    A single `Omega` row is refused, since it is a condition on velocity that fixes no orientation.
    A `screw` row needs `pitch`, Omega1 and Omega2. A `rod` row needs `length`, and can be combined
    with Omega, Q and cv rows only.

    Rows may be redundant. Duplicates are used once. If rows depend on each other at the body's
    pose, the solver drops the last ones, and their multipliers are 0 (`reaction` is the common
    wrench of all rows). If the joint drifts, as on SO(3)×R³, dependent rows eventually contradict
    each other, and the body is marked `singular`.

    Parameters
    ----------
    rows : sequence of str
        Names of the rows.
    body_point : array_like, shape (3,) or (n, 3), optional
        Point of the joint in the body frame, m. Default: its origin.
    ground_point : array_like, shape (3,) or (n, 3), optional
        Point of the joint in the ground frame, m. Default: its origin.
    axis : array_like, shape (3,) or (n, 3), optional
        Direction of the joint axis e₃ in the body frame. Default: (0, 0, 1).
    slot : array_like, shape (3,) or (n, 3), optional
        Direction of e₁ at R = I, in the body frame.
    second_axis : array_like, shape (3,) or (n, 3), optional
        Direction of e₂ in the body frame.
    pitch : float or array_like, shape (n,), optional
        Pitch of the `screw` row, m/rad.
    length : float or array_like, shape (n,), optional
        Length of the `rod` row, m, positive.
    body_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
        Joint frame in the body frame, in place of point and axes; a Rotation is about the origin.
    ground_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
        Joint frame in the ground frame, in place of the point.
    parent_point : array_like, shape (3,) or (n, 3), optional
        Another name of `ground_point`, for a joint between two links of a `lierb.Mechanism`: in the
        body frame of the parent.
    parent_frame : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
        Another name of `ground_frame`, likewise.
    name : str, optional
        Name of the joint.

    Returns
    -------
    Joint
        The joint or the batch of joints.

    Raises
    ------
    UnknownNameError
        A row does not exist.
    ArgumentError
        There are more than twelve rows, or they cannot be combined to a joint.

    Examples
    --------
    >>> import lierb
    >>> lierb.joints.from_rows(["d3", "Omega1", "Omega3"], body_point=(0.1, 0.0, 0.0))
    from_rows joint
      rows           d3 Omega1 Omega3
      on the body    (0.1, 0, 0) m, e₁ (1, 0, 0), e₃ (0, 0, 1)
      on the ground  (0, 0, 0) m, e₁ (1, 0, 0), e₃ (0, 0, 1)
    """
    if isinstance(rows, str):
        raise ArgumentError(f"rows={brief(rows)}; expected a list of row names")
    rows = items_of("rows", rows, "a list of row names")
    if not isinstance(name, str):
        raise ArgumentError(f"name={brief(name)}; expected a text")
    parsed = tuple(dict.fromkeys(_row(row) for row in rows))
    if len(parsed) > MOST_ROWS:
        raise ArgumentError(
            f"rows={brief(rows)} are {len(parsed)} rows; expected {MOST_ROWS} at most"
        )
    for objection in filter(None, (row.objection(parsed) for row in parsed)):
        raise ArgumentError(f"rows={brief(rows)} {objection}")
    options = frozenset({"slot", "second_axis", *parameters_of(parsed)})
    return JointType(name, parsed, "", None, options)(
        body_point, ground_point, axis=axis, slot=slot, second_axis=second_axis, pitch=pitch,
        length=length, body_frame=body_frame, ground_frame=ground_frame,
        parent_point=parent_point, parent_frame=parent_frame,
    )  # fmt: skip


def _row(name: str | Row) -> JointRow:
    try:
        return JOINT_ROWS[str(name) if isinstance(name, Row) else name.replace("Ω", "Omega")]
    except Exception:  # a user's object may raise any
        raise unknown_name("row", name, JOINT_ROWS) from None

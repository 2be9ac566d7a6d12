"""Formulas of one node of a tree whose nodes are in memory: the passes of articulated bodies.

All axes are the ground's, and a node's origin is its joint's point. Nothing is turned on its way
from node to node: an inertia is moved by r, from the parent's origin to the node's, and each rigid
body is turned instead. Accelerations are those of points, so that no absolute velocity appears:

    (α, a) = (α′, a′ + α′ × r) + b + S ν̇,
    b = (ω′ × ω_rel, ω′ × (ω′ × r + 2 w) + R (ω_rel × v_rel)),   w = R v_rel.

The outward pass `place` computes their part without ν̇, gravity as an acceleration of the ground
included. The inward pass `gather` computes articulated inertias (Featherstone, Rigid Body Dynamics
Algorithms, 2008, ch. 7). The outward pass `accelerate` computes ν̇.

The code of a node is specialised on its *kind*, the slots of its joint's motions. Arguments in
memory are rows of a node, of its parent, or of a child: see `lierb.kernels.tracing.memory.Rows`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion, se3, turns
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import constraints, subgroup
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import FIXED, PITCHED, Rows, Screw
from lierb.kernels.mechanics.spatial import (
    Articulated,
    Pose,
    Rigid,
    conjugated,
    twist_at,
    wrench_from,
)
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.mechanics.tree import HERE, Ends, NodeConstants, combined, free_directions
from lierb.kernels.numbers.arithmetic import flatten, fma, maximum, sqrt, where
from lierb.kernels.numbers.vec import (
    IDENTITY,
    UNIT,
    ZERO3,
    Vec,
    add,
    column,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    neg,
    norm,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

MOST = 6  # freedoms of a node

# Rows of a node's constants: H, mass, first moment, inertia about the joint's point, pitch;
HANG, POINT, MASS, MOMENT, INERTIA, PITCH, CONSTANTS = 0, 9, 12, 13, 16, 22, 23
# and those for measures and the user's frames: centre of mass, inertia about it, the node's frame.
COM, CENTRAL, FRAME, DETAILS = 0, 3, 9, 21
# Rows of a node's motion: R, ω, r, (α, a) without ν̇, (α, a) by ν̇ alone, origin, its velocity;
TURN, OMEGA, ARM, START, BY_RATES, PLACE, SPEED, PULLS = 0, 9, 12, 15, 21, 27, 30, 33
# from PULLS on (SᵀIS)⁻¹Uᵀ of each freedom about the parent's origin, ν̇ by loads alone, (SᵀIS)⁻¹.
MOTION = (PULLS + 6 * MOST + MOST + MOST * MOST) | 1  # odd: nodes are in different cache sets
# Rows of an articulated inertia, and of the wrench that acts on it.
PASSED_WRENCH, PASSED = 21, 27


class Kind(NamedTuple):
    """Kind of a node, on which the code of its passes is specialised."""

    slots: Slots

    @property
    def freedoms(self) -> int:
        return sum(slot >= 0 for slot in self.slots)

    @property
    def is_free(self) -> bool:
        return min(self.slots) >= 0

    @property
    def charts(self) -> Any:
        """Module with the formulas of the joint's group."""
        return charts_of_slots(self.slots)

    @property
    def chart_rows(self) -> list[int]:
        """Indices of the numbers of (p, d) that are in memory; others are constants."""
        named = subgroup.on_subgroup(self.slots, (("0", "1", "2", "3"), ("4", "5", "6")))
        return [int(x) for x in flatten(named) if isinstance(x, str)]

    def pitch(self, constants: Any) -> Any:
        return constants[PITCH] if PITCHED in self.slots else ZERO

    def load_chart(self, rows: Any) -> Chart:
        numbers: list[Any] = [ZERO] * 7
        for row, place in enumerate(self.chart_rows):
            numbers[place] = rows[row]
        return subgroup.on_subgroup(self.slots, (tuple(numbers[:4]), tuple(numbers[4:])))

    def store_chart(self, rows: Any, chart: Chart) -> tuple[Any, ...]:
        """Store a chart; return the numbers that are in memory."""
        numbers = (*chart[0], *chart[1])
        stored = tuple(numbers[i] for i in self.chart_rows)
        rows.put(0, *stored)
        return stored

    def lifted(self, rows: Any, pitch: Any) -> Vec:
        """V_rel or X/2, (6,), from one row for each freedom."""
        return subgroup.lifted(self.slots, rows[0 : self.freedoms], pitch)

    def is_whole(self, part: int) -> bool:
        """Return whether all turns (part 0), or all slides (part 1), are free."""
        return min(self.slots[3 * part : 3 * part + 3]) >= 0

    def free(self, turn: Any, pitch: Any) -> list[Vec]:
        """S in the ground's axes, the ground's own unit vectors if all turns or slides are free."""
        indices = [i for i in range(6) if self.slots[i] >= 0]
        columns = []
        for i, s in zip(indices, free_directions(self.slots, pitch), strict=True):
            if self.is_whole(i // 3):
                columns.append(UNIT[i] + ZERO3 if i < 3 else ZERO3 + UNIT[i - 3])
            else:
                columns.append(mat_vec(turn, s[:3]) + mat_vec(turn, s[3:]))
        return columns


ALONE, MASSLESS, SECOND = range(3)  # roles: the only node of its joint, or the one of two


class JointKind(NamedTuple):
    """Kind of a joint, on which the code of starts and measures is specialised.

    rows : rows of the joint; none for a massless node, the first of the two of a joint.
    first : slots of the massless node before, if the joint has two nodes.
    """

    kind: Kind
    rows: Rows
    first: Slots | None = None

    @property
    def role(self) -> int:
        if self.first is not None:
            return SECOND
        return ALONE if self.rows or self.kind.is_free else MASSLESS


def charts_of_slots(slots: Slots) -> Any:
    """Module with the formulas of a subgroup's charts: `turns` for a turn about one axis."""
    is_turn = sum(slot != FIXED for slot in slots) == 1 and max(slots[:3]) >= 0
    return turns if is_turn else quaternion


def tidied(slots: Slots, chart: Chart, pitch: Any) -> Chart:
    """Renormalise the quaternion; project the pose of a screw joint onto its subgroup."""
    p, d = chart
    p = quaternion.normalised(p)
    if PITCHED in slots:
        at = Kinematics(quaternion.matrix(p), d, ZERO3, ZERO3, ZERO3, ZERO3, True)
        off = Screw().value(at, Ends(HERE, HERE, pitch))
        d = (d[0], d[1], d[2] - off)
    return p, d


# ---- constants -----------------------------------------------------------------------------------


def store_constants(n: NodeConstants, constants: Any, details: Any) -> None:
    rigid, lower = n.rigid, _lower(n.rigid.inertia)
    constants.put(HANG, *n.hang[0], *n.hang[1], rigid.mass, *rigid.moment, *lower, n.pitch)
    details.put(COM, *n.com, *_lower(n.inertia), *n.frame[0], *n.frame[1])


def hang_of(constants: Any) -> Pose:
    """H, the joint's frame on the parent."""
    return constants[HANG : HANG + 9], constants[POINT : POINT + 3]


def frame_of(details: Any) -> Pose:
    """A node's frame in the user's body frame."""
    return details[FRAME : FRAME + 9], details[FRAME + 9 : FRAME + 12]


def set_ground(gravity: Vec, motion: Any, details: Any) -> None:
    """Store the motion of the ground, which accelerates against gravity, and its frame."""
    motion.put(TURN, *IDENTITY, *ZERO3, *ZERO3, *ZERO3, *neg(gravity))
    motion.put(BY_RATES, *ZERO3, *ZERO3, *ZERO3, *ZERO3)
    details.put(FRAME, *IDENTITY, *ZERO3)


def com_and_inertia(details: Any) -> tuple[Vec, Vec]:
    """Centre of mass, and inertia about it."""
    return details[COM : COM + 3], _symmetric(details[CENTRAL : CENTRAL + 6])


# ---- passes --------------------------------------------------------------------------------------


def place(kind: Kind, constants: Any, chart: Any, x: Any, v: Any, above: Any, here: Any) -> Vec:
    """Outward: axes, ω, r, (α, a) without ν̇. Return Ẋ, one number for each freedom.

    x, v : rows of X/2 and V_rel.
    """
    pitch, group = kind.pitch(constants), kind.charts
    hang = hang_of(constants)
    moving, half = kind.lifted(v, pitch), kind.lifted(x, pitch)
    before, outer = above[TURN : TURN + 9], above[OMEGA : OMEGA + 3]
    alpha, a = above[START : START + 3], above[START + 3 : START + 6]

    angles = quaternion.angle_coefficients(half)
    chart_now = group.compose_exp(kind.load_chart(chart), half, angles)
    turn, arm = se3.compose(se3.compose((before, ZERO3), hang), group.pose(chart_now))
    spin, slide = moving[:3], moving[3:]
    own, along = mat_vec(turn, spin), mat_vec(turn, slide)
    omega = add(outer, own)
    swing = cross_add(outer, arm, scale(2.0, along))
    bent = add(a, mat_vec(turn, cross(spin, slide)))
    start = cross_add(outer, own, alpha) + cross_add(outer, swing, cross_add(alpha, arm, bent))
    here.put(TURN, *turn, *omega, *arm, *start)
    rate = group.dexpinv(neg(half), moving, angles)
    return subgroup.coordinates(kind.slots, rate)


def place_origin(kind: Kind, constants: Any, v: Any, above: Any, here: Any) -> None:
    """Outward, after `place`: the place and the velocity of a node's origin."""
    outer, arm = above[OMEGA : OMEGA + 3], here[ARM : ARM + 3]
    slide = kind.lifted(v, kind.pitch(constants))[3:]
    along = mat_vec(here[TURN : TURN + 9], slide)
    origin, speed = above[PLACE : PLACE + 3], above[SPEED : SPEED + 3]
    here.put(PLACE, *add(origin, arm), *cross_add(outer, arm, add(speed, along)))


def gather(
    kind: Kind, constants: Any, child: Any, here: Any, load: Vec | None
) -> tuple[Articulated, Vec, Vec]:
    """Inward: articulated inertia and wrench that a node passes on, about its origin; and r.

    child : what its children pass on, about the node's origin; zero without children.
    load : wrench on the node about its origin, or None.
    """
    turn, arm = here[TURN : TURN + 9], here[ARM : ARM + 3]
    omega, start = here[OMEGA : OMEGA + 3], here[START : START + 6]
    below = child[0:PASSED]
    # The rigid body is turned here, where the next node's numbers have to be waited for.
    rigid = _turned(constants, turn)
    hanging = Articulated(_symmetric(below[:6]), below[6:15], _symmetric(below[15:21]))
    total = rigid.from_frame(HERE).and_also(hanging)
    lacking = sub(below[PASSED_WRENCH:], rigid.needed(start, omega))
    if load is not None:
        lacking = add(lacking, load)
    free = kind.free(turn, kind.pitch(constants))
    columns = [total.momentum(s) for s in free]
    count = len(columns)
    gains = subgroup.inverse([[dot(s, u) for u in columns] for s in free])
    pushes = tuple(dot(s, lacking) for s in free)
    rows = [gains[count * k : count * k + count] for k in range(count)]
    forced = tuple(dot(gain, pushes) for gain in rows)
    eased = [combined(gain, columns) for gain in rows]
    pulls = [wrench_from((IDENTITY, arm), g) for g in eased]
    here.put(PULLS, *(x for pull in pulls for x in pull), *forced, *gains)
    for u, g in zip(columns, eased, strict=True):
        total = total.less(u, g)
    return total, sub(lacking, combined(forced, columns)), arm


def pass_on(passed: Any, total: Articulated, lacking: Vec, arm: Vec) -> None:
    """Store an articulated inertia and its wrench about the parent's origin."""
    moved = _shifted(total, arm)
    inertia = _lower(moved.angular) + moved.mixed + _lower(moved.linear)
    passed.put(0, *inertia, *wrench_from((IDENTITY, arm), lacking))


def accelerate(kind: Kind, constants: Any, above: Any, here: Any) -> Vec:
    """Outward: (α, a) by ν̇. Return V̇_rel, one number for each freedom.

    A node waits for its parent: sums are split so that the parent's numbers are used last.
    """
    turn, arm = here[TURN : TURN + 9], here[ARM : ARM + 3]
    before = above[BY_RATES : BY_RATES + 6]
    free = kind.free(turn, kind.pitch(constants))
    count = len(free)
    pulls = [here[PULLS + 6 * k : PULLS + 6 * k + 6] for k in range(count)]
    forced = here[PULLS + 6 * count : PULLS + 7 * count]
    carried = twist_at((IDENTITY, arm), before)
    rate = tuple(
        (f - dot(pull[:3], before[:3])) - dot(pull[3:], before[3:])
        for f, pull in zip(forced, pulls, strict=True)
    )
    here.put(BY_RATES, *combined(rate, free, carried))
    if kind.is_whole(0):
        rate = mat_t_vec(turn, rate[:3]) + rate[3:]
    if kind.is_whole(1):
        rate = rate[:-3] + mat_t_vec(turn, rate[-3:])
    return rate


def transmitted(constants: Any, here: Any, load: Vec | None) -> Vec:
    """Wrench that a node's body needs for its motion besides `load`, about the node's origin."""
    starting, changing = here[START : START + 6], here[BY_RATES : BY_RATES + 6]
    rigid = _turned(constants, here[TURN : TURN + 9])
    needed = rigid.needed(add(starting, changing), here[OMEGA : OMEGA + 3])
    return needed if load is None else sub(needed, load)


def inertias_of(constants: Any) -> Vec:
    """Diagonal of the inertia about a node's origin, and its mass."""
    return tuple(constants[row] for row in (INERTIA, INERTIA + 2, INERTIA + 5, MASS))


def easy_of(constants: Any, least: Vec = (0.0,) * 4) -> Vec:
    """Reciprocals of `inertias_of`, or 0.   least : numbers below these count as these."""
    pairs = zip(inertias_of(constants), least, strict=True)
    return tuple(where(x > 0.0, 1.0 / where(x > 0.0, maximum(x, y), 1.0), 0.0) for x, y in pairs)


def action_of(constants: Any, here: Any, slide: Vec) -> Any:
    """‖ω‖ √(2 T) of a node's body, T its energy at ω and a velocity of its origin, in its axes."""
    omega = mat_t_vec(here[TURN : TURN + 9], here[OMEGA : OMEGA + 3])
    inertia = _symmetric(constants[INERTIA : INERTIA + 6])
    rigid = Rigid(constants[MASS], constants[MOMENT : MOMENT + 3], inertia)
    twist = omega + slide
    return norm(omega) * sqrt(dot(rigid.momentum(twist), twist))


def _turned(constants: Any, turn: Vec) -> Rigid:
    """A node's body in the ground's axes, about the node's origin."""
    moment = mat_vec(turn, constants[MOMENT : MOMENT + 3])
    inertia = conjugated(turn, _symmetric(constants[INERTIA : INERTIA + 6]))
    return Rigid(constants[MASS], moment, inertia)


def passed_wrench(wrench: Vec, here: Any) -> Vec:
    """A wrench about the origin of the node's parent."""
    return wrench_from((IDENTITY, here[ARM : ARM + 3]), wrench)


def in_node_axes(wrench: Vec, here: Any) -> Vec:
    turn = here[TURN : TURN + 9]
    return mat_t_vec(turn, wrench[:3]) + mat_t_vec(turn, wrench[3:])


def moved(kind: Kind, constants: Any, chart: Any, x: Any) -> Chart:
    """C₀ exp X.   chart, x : rows of C₀ and of X/2."""
    half = kind.lifted(x, kind.pitch(constants))
    return kind.charts.compose_exp(kind.load_chart(chart), half)


# ---- measures ------------------------------------------------------------------------------------


def energy(constants: Any, details: Any, here: Any, gravity: Vec) -> Any:
    """Kinetic energy, and potential energy of gravity, J."""
    turn, omega, mass = here[TURN : TURN + 9], here[OMEGA : OMEGA + 3], constants[MASS]
    arm = mat_vec(turn, details[COM : COM + 3])
    moving = cross_add(omega, arm, here[SPEED : SPEED + 3])
    spin = mat_t_vec(turn, omega)
    turning = dot(spin, mat_vec(_symmetric(details[CENTRAL : CENTRAL + 6]), spin))
    kinetic = 0.5 * fma(mass, dot(moving, moving), turning)
    return fma(-mass, dot(gravity, add(here[PLACE : PLACE + 3], arm)), kinetic)


def on_joint(kind: Kind, constants: Any, chart: Any, v: Any) -> tuple[Pose, Vec]:
    """D of a node and V_rel.   chart, v : rows of its chart and velocity."""
    return kind.charts.pose(kind.load_chart(chart)), kind.lifted(v, kind.pitch(constants))


def kinematics(d: Pose, moving: Vec) -> Kinematics:
    """Kinematics of a joint for its rows, from D and V_rel."""
    return Kinematics(*d, moving[:3], ZERO3, moving[3:], ZERO3, True)


def errors_squared(rows: Rows, d: Pose, moving: Vec, pitch: Any) -> tuple[Any, ...]:
    """Squares of `measures.JOINT_ERRORS` of a joint, from D and V_rel of its motion."""
    at = kinematics(d, moving), Ends(HERE, HERE, pitch)
    return constraints.errors_squared(rows, *at, constraints.rate_errors(rows, *at, moving))


def in_user_frame(details: Any, here: Any) -> Vec:
    """R (9,) row by row, r (3,), ω (3,), v (3,) of a link, in the user's frames."""
    frame, turn = frame_of(details), here[TURN : TURN + 9]
    pose = se3.compose((turn, here[PLACE : PLACE + 3]), se3.inverse(frame))
    spin, moving = (mat_t_vec(turn, here[at : at + 3]) for at in (OMEGA, SPEED))
    return pose[0] + pose[1] + se3.Ad(frame, spin + moving)


# ---- matrices ------------------------------------------------------------------------------------


def _symmetric(numbers: Vec) -> Vec:
    xx, xy, yy, xz, yz, zz = numbers
    return (xx, xy, xz, xy, yy, yz, xz, yz, zz)


def _lower(m: Vec) -> Vec:
    return (m[0], m[3], m[4], m[6], m[7], m[8])


def _shifted(inertia: Articulated, p: Vec) -> Articulated:
    """Return inertia.from_frame((IDENTITY, p)) with every product fused, 42 instead of 63."""
    linear, mixed = inertia.linear, inertia.mixed
    columns = [cross_add(p, column(linear, j), column(mixed, j)) for j in range(3)]
    moved = tuple(columns[j][i] for i in range(3) for j in range(3))
    lower: dict[tuple[int, int], Any] = {}
    for i in range(3):
        for j in range(i + 1):
            (k, m), (n, o) = (((x + 1) % 3, (x + 2) % 3) for x in (i, j))
            lever = fma(
                p[k], mixed[3 * j + m], fma(-p[m], mixed[3 * j + k], inertia.angular[3 * i + j])
            )
            lower[i, j] = fma(p[n], moved[3 * i + o], fma(-p[o], moved[3 * i + n], lever))
    angular = tuple(lower[max(i, j), min(i, j)] for i in range(3) for j in range(3))
    return Articulated(angular, moved, linear)

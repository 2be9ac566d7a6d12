"""What acts on a body beside gravity and its joint: applied forces, and further constraints.

Each kind of element is a tag with formulas. `placed` takes its parameters from the user's frames to
joint axes, once a run. A force has its `wrench`, evaluated in every stage, its `energy`, where it
has a potential, and its `power`, where it does work beyond that; a constraint has rows, which the
saddle point solves for with the joint's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import BODY, Function
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Frames,
    Kinematics,
    Motion,
    Parameters,
    Pose,
    SO3xR3,
    frames_of,
    inertia_about_com,
)
from lierb.kernels.numbers.arithmetic import PI, fma, plain, rint, sqrt, where
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import (
    UNIT,
    ZERO3,
    ZERO6,
    Mat,
    Vec,
    add,
    cross,
    cross_add,
    dot,
    mat_mat,
    mat_mat_t,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
    norm,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

Wrench = tuple[Vec, Vec]  # torque and force, in body axes, about the joint's point
Shape = tuple[int, ...]


class Element:
    """What all kinds have; by itself, one that does nothing.

    shapes: of the parameters, by name.   needs_axis: whether it acts about e₃ of the joint, which
    must then be the body's and the ground's at once.   rows: how many constraints it adds.
    does_work: whether it can change E = T + U, U being the `energy` of all elements.
    """

    shapes: ClassVar[dict[str, Shape]]
    needs_axis: ClassVar[bool] = False
    is_conservative: ClassVar[bool] = False  # but for its damping, or its torque
    is_users: ClassVar[bool] = False  # whether what it does is known to the user alone
    does_work: ClassVar[bool] = True
    is_translational: ClassVar[bool] = True
    is_holonomic: ClassVar[bool] = True  # of rows: whether they are of the pose
    fixed_axis: ClassVar[int | None] = None  # of a row that says the turning about a body axis
    rows: int = 0

    @property
    def functions(self) -> tuple[Function, ...]:
        """Those of the user's that it is made of."""
        found = (getattr(self, name, None) for name in ("function", "potential"))
        return tuple(f for f in found if isinstance(f, Function))

    @property
    def sees_body(self) -> bool:
        """Whether one of them asks for mass, inertia and centre of mass."""
        return any(f.sees_body for f in self.functions)

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3

    def energy(self, placed: Any, x: Motion) -> Any:
        return ZERO

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """What its wrench adds to E = T + U, W: all its power, where it has no potential."""
        torque, force = wrench
        return dot(torque, x.omega) + dot(force, x.v)


@dataclass(frozen=True)
class BodyWrench(Element):
    """Constant in body axes: a thruster."""

    shapes: ClassVar = {"torque": (3,), "force": (3,), "point": (3,)}

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        force = frames.body_direction(given["force"])
        torque = frames.body_direction(given["torque"])
        return cross_add(frames.body_point(given["point"]), force, torque), force

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force = placed
        return torque, force


@dataclass(frozen=True)
class GroundWrench(Element):
    """Constant in ground axes; the force has a potential, the torque has none."""

    shapes: ClassVar = BodyWrench.shapes
    is_conservative: ClassVar = True

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return (
            frames.ground_direction(given["torque"]),
            frames.ground_direction(given["force"]),
            frames.body_point(given["point"]),
            -dot(given["force"], frames.ground[1]),
        )

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force, point, _ = placed
        pull = mat_t_vec(x.q, force)
        return cross_add(point, pull, mat_t_vec(x.q, torque)), pull

    def energy(self, placed: Any, x: Motion) -> Any:
        _, force, point, at_origin = placed
        return at_origin - dot(force, x.place_of(point))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return dot(mat_t_vec(x.q, placed[0]), x.omega)


@dataclass(frozen=True)
class SpringDamper(Element):
    """Along the line from a point of the ground to a point of the body."""

    shapes: ClassVar = {
        "body_point": (3,), "ground_point": (3,), "stiffness": (), "damping": (), "length": (),
    }  # fmt: skip
    is_conservative: ClassVar = True

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return (
            frames.body_point(given["body_point"]),
            frames.ground_point(given["ground_point"]),
            given["stiffness"],
            given["damping"],
            given["length"],
        )

    def _line(self, placed: Any, x: Motion) -> tuple[Vec, Any, Any]:
        """From anchor to point in body axes, 1/ℓ and ℓ̇."""
        point, anchor = placed[:2]
        line = mat_t_vec(x.q, sub(x.place_of(point), anchor))
        inverse = _inverse_norm(line)
        return line, inverse, dot(line, x.velocity_of(point)) * inverse

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        point, _, stiffness, damping, length = placed
        line, inverse, rate = self._line(placed, x)
        # k (ℓ − ℓ₀)/ℓ + c ℓ̇/ℓ: no direction is needed where ℓ = 0
        tension = fma(inverse, fma(damping, rate, -(stiffness * length)), stiffness)
        force = scale(-tension, line)
        return cross(point, force), force

    def energy(self, placed: Any, x: Motion) -> Any:
        point, anchor, stiffness, _, length = placed
        stretch = norm(sub(x.place_of(point), anchor)) - length
        return 0.5 * stiffness * (stretch * stretch)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        _, _, rate = self._line(placed, x)
        return -placed[3] * (rate * rate)


@dataclass(frozen=True)
class TorsionalSpring(Element):
    """About the joint axis, back to a turn that is at most half a turn away."""

    shapes: ClassVar = {"stiffness": (), "damping": (), "angle": ()}
    needs_axis: ClassVar = True
    is_conservative: ClassVar = True

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        stiffness, damping, angle = placed
        torque = -fma(stiffness, _turn(x, angle), damping * x.omega[2])
        return (ZERO, ZERO, torque), ZERO3

    def energy(self, placed: Any, x: Motion) -> Any:
        stiffness, _, angle = placed
        turn = _turn(x, angle)
        return 0.5 * stiffness * (turn * turn)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return -placed[1] * (x.omega[2] * x.omega[2])


@dataclass(frozen=True)
class Drag(Element):
    """Against the velocity of a body point, linear and quadratic, and against the turning."""

    shapes: ClassVar = {"linear": (), "quadratic": (), "angular": (), "point": (3,)}

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        point = frames.body_point(given["point"])
        return given["linear"], given["quadratic"], given["angular"], point

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        linear, quadratic, angular, point = placed
        moving = x.velocity_of(point)
        force = scale(-fma(quadratic, norm(moving), linear), moving)
        return cross_add(point, force, scale(-angular, x.omega)), force


@dataclass(frozen=True)
class Motor(Element):
    """A torque about the joint axis: constant, or a function of time."""

    function: Function | None
    needs_axis: ClassVar = True

    @property
    def shapes(self) -> dict[str, Shape]:  # type: ignore[override]
        return {"torque": ()} if self.function is None else dict(self.function.shapes)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque = placed[0] if self.function is None else self.function(placed, x.time)
        return (ZERO, ZERO, torque), ZERO3


@dataclass(frozen=True)
class UserWrench(Element):
    """A function of the user's, of (t, R, r, ω, v) in the user's own frames."""

    function: Function
    potential: Function | None = None
    is_users: ClassVar = True

    @property
    def shapes(self) -> dict[str, Shape]:  # type: ignore[override]
        return dict(self.function.shapes)

    @property
    def is_conservative(self) -> bool:  # type: ignore[override]
        return self.potential is not None

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        frame, parameters = UserFrame(*placed[0]), placed[1]
        r, place = frame.pose(x.q, x.place)
        omega, v = frame.twist(x.omega, x.v)
        return frame.to_joint_axes(*self.function(parameters, x.time, r, place, omega, v))

    def energy(self, placed: Any, x: Motion) -> Any:
        if self.potential is None:
            return ZERO
        return self.potential(placed[1], *UserFrame(*placed[0]).pose(x.q, x.place))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """Of the wrench, and dU/dt, exactly: nothing where the potential is of the whole wrench."""
        total = super().power(placed, x, wrench)
        if self.potential is None:
            return total
        frame = UserFrame(*placed[0])
        (r, place), (omega, v) = frame.pose(x.q, x.place), frame.twist(x.omega, x.v)
        turning = sum((cross(row(r, i), omega) for i in range(3)), start=())  # Ṙ = R ω̂
        found = self.potential(placed[1], _moving(r, turning), _moving(place, mat_vec(r, v)))
        return total + found.parts[0] if isinstance(found, UserNumber) else total


class UserFrame(NamedTuple):
    """The way back from joint axes, for functions of the user's."""

    ground: Pose
    axes: Mat  # the joint's, seen from the user's body frame
    origin: Vec  # of the user's body frame, in body axes and from the joint's point

    @classmethod
    def of(cls, frames: Frames) -> UserFrame:
        return cls(frames.ground, frames.axes, frames.body_point(ZERO3))

    def pose(self, q: Mat, place: Vec) -> Pose:
        """(R, r) of a pose in joint axes."""
        ground, ground_origin = self.ground
        r = mat_mat(ground, mat_mat_t(q, self.axes))
        return r, add(ground_origin, mat_vec(ground, mat_vec_add(q, self.origin, place)))

    def twist(self, omega: Vec, v: Vec) -> tuple[Vec, Vec]:
        moving = cross_add(omega, self.origin, v)
        return mat_vec(self.axes, omega), mat_vec(self.axes, moving)

    def to_joint_axes(self, torque: Vec, force: Vec) -> Wrench:
        pull = mat_t_vec(self.axes, force)
        return cross_add(self.origin, pull, mat_t_vec(self.axes, torque)), pull


# ---- constraints -------------------------------------------------------------------------------


@dataclass(frozen=True)
class SpeedMotor(Element):
    """The turn about the joint axis at a given rate, rad/s: Ω₃ = w(t)."""

    function: Function | None
    needs_axis: ClassVar = True
    is_translational: ClassVar = False
    is_holonomic: ClassVar = False
    fixed_axis: ClassVar = 2
    rows: int = 1

    @property
    def shapes(self) -> dict[str, Shape]:  # type: ignore[override]
        return {"speed": ()} if self.function is None else dict(self.function.shapes)

    def row_name(self, i: int) -> str:
        return "motor"

    def jacobian(self, placed: Any, x: Kinematics, i: int) -> Vec:
        return UNIT[2] + ZERO3

    def acceleration(self, placed: Any, x: Kinematics, i: int) -> Any:
        """ẇ, exactly."""
        if self.function is None:
            return ZERO
        rate = self.function(placed, UserNumber(plain(x.time), (1.0,)))
        return rate.parts[0] if isinstance(rate, UserNumber) else ZERO

    def rate(self, placed: Any, x: Kinematics) -> Any:
        return placed[0] if self.function is None else self.function(placed, x.time)

    def value(self, placed: Any, x: Kinematics, i: int) -> Any:
        return ZERO  # of no pose is it known whether it is on time


@dataclass(frozen=True)
class UserConstraint(Element):
    """A function h(R, r) of the user's that shall stay zero; J and η by running it on duals."""

    does_work: ClassVar = False
    function: Function
    rows: int
    is_translational: bool  # type: ignore[misc]

    @property
    def shapes(self) -> dict[str, Shape]:  # type: ignore[override]
        return dict(self.function.shapes)

    def row_name(self, i: int) -> str:
        return self.function.name + (str(i + 1) if self.rows > 1 else "")

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def value(self, placed: Any, x: Kinematics, i: int) -> Any:
        frame = UserFrame(*placed[0])
        found = self.function(placed[1], *frame.pose(x.q, x.d))[i]
        return found.value if isinstance(found, UserNumber) else found

    def rate(self, placed: Any, x: Kinematics) -> Any:
        return ZERO

    def jacobian(self, placed: Any, x: Kinematics, i: int) -> Vec:
        """Along the six unit twists: Ṙ = R ω̂ and ṙ = R v, in the user's body axes."""
        frame = UserFrame(*placed[0])
        r, place = frame.pose(x.q, x.d)
        entries = []
        for axis in range(3):
            a, b, c = row(r, axis)
            for entry, turning in ((a, (ZERO, -c, b)), (b, (c, ZERO, -a)), (c, (-b, a, ZERO))):
                entries.append(UserNumber(entry, turning + ZERO3))
        places = [UserNumber(place[axis], ZERO3 + row(r, axis)) for axis in range(3)]
        found = self.function(placed[1], tuple(entries), tuple(places))[i]
        slope = found.parts if isinstance(found, UserNumber) else ZERO6
        torque, force = frame.to_joint_axes(slope[:3], slope[3:])
        return cross_add(x.arm, force, torque) + x.translation(mat_vec(x.q, force), force)

    def acceleration(self, placed: Any, x: Kinematics, i: int) -> Any:
        """−ḧ along the motion with V̇ = 0, where R̈ = R ω̂²."""
        frame = UserFrame(*placed[0])
        r, place = frame.pose(x.q, x.d)
        omega, v = frame.twist(x.omega, x.point_rate)
        swing = cross(x.omega, cross(x.omega, frame.origin))
        entries = []
        for axis in range(3):
            along = row(r, axis)
            rate = cross(along, omega)  # (aᵀ ω̂)ᵀ = a×ω
            entries += [_second(*xs) for xs in zip(along, rate, cross(rate, omega), strict=True)]
        bend = mat_vec(r, mat_vec(frame.axes, add(x.point_bias, swing)))
        places = [_second(*xs) for xs in zip(place, mat_vec(r, v), bend, strict=True)]
        found = self.function(placed[1], tuple(entries), tuple(places))[i]
        slope = found.parts[0] if isinstance(found, UserNumber) else ZERO
        return -slope.parts[0] if isinstance(slope, UserNumber) and slope.parts else ZERO


def _moving(values: Vec, rates: Vec) -> Vec:
    """Numbers with their first derivatives."""
    return tuple(UserNumber(plain(x), (rate,)) for x, rate in zip(values, rates, strict=True))


def _second(value: Any, rate: Any, bend: Any) -> UserNumber:
    """A number with its first and second derivative."""
    return UserNumber(UserNumber(plain(value), (rate,)), (UserNumber(plain(rate), (bend,)),))


# ---- formulas ----------------------------------------------------------------------------------


def _turn(x: Motion, angle: Any) -> Any:
    """How far the body is turned about e₃ from that angle, in [−π, π]."""
    turn = atan2(x.q[3], x.q[0]) - angle
    return fma(-2.0 * PI, rint(turn * (0.5 / PI)), turn)


def _inverse_norm(a: Vec) -> Any:
    """1/‖a‖; 0 for the zero vector."""
    square = dot(a, a)
    some = square > 0.0
    return where(some, 1.0, 0.0) / sqrt(where(some, square, 1.0))


# ---- all elements of a body -------------------------------------------------------------------


def parameter_count(elements: tuple[Element, ...]) -> int:
    """Numbers that the parameters of all elements take."""
    return sum(math.prod(shape) for element in elements for shape in element.shapes.values())


def all_placed(
    elements: tuple[Element, ...], numbers: list[Any], frames: Frames, parameters: Parameters
) -> tuple[Any, ...]:
    """Every element's parameters, from the numbers of their input columns.

    After them, where it sees the body, what `lierb.kernels.functions.function.BODY` names.
    """
    rest = iter(numbers)
    placed = []
    for element in elements:
        given = {
            name: tuple(islice(rest, math.prod(shape))) if shape else next(rest)
            for name, shape in element.shapes.items()
        }
        if element.sees_body:
            seen = parameters.mass, inertia_about_com(parameters), parameters.com
            given |= {f"body.{name}": x for (name, _), x in zip(BODY, seen, strict=True)}
        placed.append(element.placed(given, frames))
    return tuple(placed)


def body_with(
    space: type[SE3] | type[SO3xR3],
    parameters: Parameters,
    elements: tuple[Element, ...],
    numbers: list[Any],
) -> BodyConstants:
    """The body in that c-space, with its elements made of `numbers`, as in `all_placed`."""
    placed = all_placed(elements, numbers, frames_of(parameters), parameters)
    return space.body(parameters)._replace(elements=placed)


class Applied(NamedTuple):
    """All applied forces together, but gravity."""

    wrench: Vec  # torque and force
    power: Any  # W, what they add to E


def applied_to(body: BodyConstants, elements: tuple[Element, ...], x: Motion) -> Applied:
    """Both at once: a function of the user's is called once."""
    total, power = ZERO6, ZERO
    for element, placed in zip(elements, body.elements, strict=True):
        wrench = element.wrench(placed, x)
        total = add(total, wrench[0] + wrench[1])
        power = power + element.power(placed, x, wrench)
    return Applied(total, power)


def potential_energy(elements: tuple[Element, ...], body: BodyConstants, x: Motion) -> Any:
    """Of all applied forces that have one."""
    total: Any = ZERO
    for element, placed in zip(elements, body.elements, strict=True):
        total = total + element.energy(placed, x)
    return total

"""What acts on a body beside gravity and its joint: applied forces, and further constraints.

Each kind of element is a tag with formulas: those of `lierb.forces`, and functions of the user's
here. `placed` takes its parameters from the user's frames to joint axes, once a run. A force has
its `wrench`, evaluated in every stage, its `energy`, where it has a potential, and its `power`,
where it does work beyond that; a constraint has rows, which the saddle point solves for with the
joint's own. What only watches the motion, or has states and outputs of its own, is passive: it acts
by what forces see of its `Signals`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import BODY, Function, Shapes
from lierb.kernels.functions.signals import Noise
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
from lierb.kernels.mechanics.rows import AddedRow, HeldBody
from lierb.kernels.mechanics.scale import ROUNDING
from lierb.kernels.numbers.arithmetic import PI, absolute, flatten, fma, plain, where
from lierb.kernels.numbers.vec import (
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
)
from lierb.kernels.numbers.zero import ZERO

# What a function of the pose does is unknown. An eighth of a turn is 0.2 rad between stages of
# DOP853 and 0.45 rad between those of Tsit5; events are looked at four times in it.
TURN = 0.25 * PI
SHARE = 0.25  # of the distance from the frame's origin, beside the body's own size
BEFORE = 1.0 - 1e-12  # of the way to a kink, and there the step ends

Wrench = tuple[Vec, Vec]  # torque and force, in body axes, about the joint's point
Shape = tuple[int, ...]


class Tangent(NamedTuple):
    """Wrench of an element along one direction, to first order: −(stiffness δq + damping q̇).

    direction : torque and force in body axes, r; q̇ = r·(ω, v), and the wrench acts along r.
    is_lasting : whether it acts throughout a motion, or in a part of it alone, such as a stop.
    """

    direction: Vec
    stiffness: Any = 0.0
    damping: Any = 0.0
    is_lasting: bool = True


class Element:
    """What all kinds have; by itself, one that does nothing.

    needs_axis: whether it acts about or along e₃ of the joint, which must then be the body's and
    the ground's at once.   needs_slide: whether along it.   rows: how many constraints it adds.
    does_work: whether it can change E = T + U, U being the `energy` of all elements.
    is_passive: whether it does nothing to the motion by itself.   bounds_steps: whether adaptive
    steps are to keep the bounds of `travel`.
    """

    needs_axis: ClassVar[bool] = False
    needs_slide: ClassVar[bool] = False
    is_conservative: ClassVar[bool] = False  # but for what is `working`
    is_users: ClassVar[bool] = False  # whether what it does is known to the user alone
    does_work: ClassVar[bool] = True
    is_passive: ClassVar[bool] = False
    working: ClassVar[tuple[str, ...]] = ()  # parameters that do work beside its potential
    bounds_steps: ClassVar[bool] = False
    discontinuities: tuple[str, ...] = ()  # parameters that are times at which it may jump, s
    rows: int = 0

    @property
    def functions(self) -> tuple[Function, ...]:
        """Those of the user's that it is made of."""
        found = (getattr(self, name, None) for name in ("function", "potential"))
        return tuple(f for f in found if isinstance(f, Function))

    @property
    def shapes(self) -> dict[str, Shape]:
        """Of the parameters, by name; those of a user's function are its own."""
        return dict(self.functions[0].shapes)

    @property
    def sees_body(self) -> bool:
        """Whether one of them asks for mass, inertia and centre of mass."""
        return any(f.sees_body for f in self.functions)

    def row(self, place: int, i: int) -> AddedRow:
        """Its constraint number i, where it is the problem's element number `place`."""
        raise NotImplementedError

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        """The stiffness and damping of its wrench at a motion, or where these are largest.

        Fixed steps are compared with them. A function of the user's has none that are known.
        """
        return ()

    def energy(self, placed: Any, x: Motion) -> Any:
        return ZERO

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """What its wrench adds to E = T + U, W: all its power, where it has no potential."""
        torque, force = wrench
        return dot(torque, x.omega) + dot(force, x.v)

    def travel(self, placed: Any, start: Motion, end: Motion, size: Any) -> tuple[Bound, ...]:
        """Bounds on an adaptive step: how fast the pose moves at `end`, and how far it may go.

        The error estimate of a step sees only what its stages meet. Where the element acts in a
        part of the way alone, these bounds keep a step from passing over that part. Those here are
        for a function of the pose of which nothing is known: a part of a turn, and a way that is
        short beside the distance from the frame's origin.

        start, end : motions at both ends of the step.   size : the body's radius of gyration, m.
        """
        way = fma(SHARE, norm(start.place), size)
        return Bound(norm(end.omega), TURN), Bound(norm(end.v), way)

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        """Times at which it may jump, s."""
        return ()


class Bound(NamedTuple):
    """A step of length h is to keep h · rate ≤ distance.   rate : ≥ 0.   distance : > 0."""

    rate: Any
    distance: Any


def travel_to_kink(place: Any, rate: Any, kinks: tuple[Any, ...]) -> Bound:
    """Bound up to the next place ahead at which a force has a kink.

    place, rate : of the coordinate, counted from the middle of the kinks.
    kinks : places in ascending order, on the way up; on the way down they are at minus these. The
        last one is beyond any place.

    A step ends just before a kink, so that all its stages are on one side.
    """
    ahead = where(rate >= 0.0, place, -place)
    *near, last = kinks
    distance: Any = last - ahead
    for kink in reversed(near):
        distance = where(kink > ahead, kink - ahead, distance)
    return Bound(absolute(rate), BEFORE * distance)


@dataclass(frozen=True)
class UserWrench(Element):
    """A function of the user's, of (t, R, r, ω, v) in the user's own frames."""

    function: Function
    potential: Function | None = None
    discontinuities: tuple[str, ...] = ()
    is_users: ClassVar = True
    bounds_steps: ClassVar = True

    @property
    def is_conservative(self) -> bool:  # type: ignore[override]
        return self.potential is not None

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        frame, parameters = UserFrame(*placed[0]), placed[1]
        r, place = frame.pose(x.q, x.place)
        omega, v = frame.twist(x.omega, x.v)
        found = self.function(parameters, x.time, r, place, omega, v, signals=x.signals)
        return frame.to_joint_axes(*found)

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

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        given = dict(zip(self.shapes, placed[1], strict=False))  # `body`'s come after them
        return tuple(flatten(tuple(given[name] for name in self.discontinuities)))


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
class UserConstraint(Element):
    """A function h(R, r) of the user's that shall stay zero."""

    does_work: ClassVar = False
    function: Function
    rows: int = 1
    is_translational: bool = True

    def row(self, place: int, i: int) -> AddedRow:
        return UserRow(self, place, i)

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())


class UserRow(AddedRow):
    """One of its numbers; J and η by running it on duals."""

    @property
    def is_translational(self) -> bool:  # type: ignore[override]
        return bool(self.element.is_translational)

    def __str__(self) -> str:
        return self.element.function.name + (str(self.i + 1) if self.element.rows > 1 else "")

    def _of(self, body: HeldBody, r: Any, place: Any) -> Any:
        return self.element.function(self.placed(body)[1], r, place)[self.i]

    def value(self, x: Kinematics, body: HeldBody) -> Any:
        found = self._of(body, *UserFrame(*self.placed(body)[0]).pose(x.q, x.d))
        return found.value if isinstance(found, UserNumber) else found

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        """Along the six unit twists: Ṙ = R ω̂ and ṙ = R v, in the user's body axes."""
        frame = UserFrame(*self.placed(body)[0])
        r, place = frame.pose(x.q, x.d)
        entries = []
        for axis in range(3):
            a, b, c = row(r, axis)
            for entry, turning in ((a, (ZERO, -c, b)), (b, (c, ZERO, -a)), (c, (-b, a, ZERO))):
                entries.append(UserNumber(entry, turning + ZERO3))
        places = [UserNumber(place[axis], ZERO3 + row(r, axis)) for axis in range(3)]
        found = self._of(body, tuple(entries), tuple(places))
        slope = found.parts if isinstance(found, UserNumber) else ZERO6
        torque, force = frame.to_joint_axes(slope[:3], slope[3:])
        return cross_add(x.arm, force, torque) + x.translation(mat_vec(x.q, force), force)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        """−ḧ along the motion with V̇ = 0, where R̈ = R ω̂²."""
        frame = UserFrame(*self.placed(body)[0])
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
        found = self._of(body, tuple(entries), tuple(places))
        slope = found.parts[0] if isinstance(found, UserNumber) else ZERO
        return -slope.parts[0] if isinstance(slope, UserNumber) and slope.parts else ZERO


def _moving(values: Vec, rates: Vec) -> Vec:
    """Numbers with their first derivatives."""
    return tuple(UserNumber(plain(x), (rate,)) for x, rate in zip(values, rates, strict=True))


def _second(value: Any, rate: Any, bend: Any) -> UserNumber:
    """A number with its first and second derivative."""
    return UserNumber(UserNumber(plain(value), (rate,)), (UserNumber(plain(rate), (bend,)),))


# ---- what does nothing to the motion -----------------------------------------------------------


class Passive(Element):
    """A function of the user's that is asked about a motion, and does nothing to it."""

    does_work: ClassVar = False
    is_passive: ClassVar = True
    function: Function

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return ZERO

    def arguments(self, placed: Any, x: Motion) -> tuple[Any, ...]:
        """t, R, r, omega and v, as the function sees them."""
        frame = UserFrame(*placed[0])
        return x.time, *frame.pose(x.q, x.place), *frame.twist(x.omega, x.v)

    def asked(self, placed: Any, x: Motion, noise: Noise | None = None) -> Any:
        """What the function gives."""
        arguments = self.arguments(placed, x)
        return self.function(placed[1], *arguments, signals=x.signals, noise=noise)


@dataclass(frozen=True)
class UserObservable(Passive):
    """A number that the user wants to know of a motion."""

    function: Function

    def value(self, placed: Any, x: Motion) -> Any:
        return self.asked(placed, x)


@dataclass(frozen=True)
class UserEvent(Passive):
    """A number that is zero when something happens."""

    function: Function

    def value(self, placed: Any, x: Motion) -> Any:
        return self.asked(placed, x)

    def value_nearby(self, placed: Any, x: Motion) -> Any:
        """The value where each number of the motion is off by some roundings of its vector."""
        moved = map(_nudged, self.arguments(placed, x))
        return self.function(placed[1], *moved, signals=x.signals)


def _nudged(given: Any) -> Any:
    """A number or a vector, off by ROUNDING of the sum of its magnitudes: up and down in turn, so
    that differences do not cancel.
    """
    if not isinstance(given, tuple):
        return _nudged((given,))[0]
    size = ROUNDING * sum((absolute(plain(x)) for x in given), 0.0)
    return tuple(plain(x) - size if i % 2 else plain(x) + size for i, x in enumerate(given))


INITIAL = "initial."  # before the names of initial values among the parameters


class _Starting(Passive):
    """With numbers of its own that have initial values, which are parameters."""

    @property
    def own(self) -> Shapes:
        """Of what has initial values, by name."""
        raise NotImplementedError

    @property
    def shapes(self) -> dict[str, Shape]:
        initial = {f"{INITIAL}{name}": shape for name, shape in self.own}
        return super().shapes | initial

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """The frame, the function's parameters, and the initial values side by side."""
        initial = flatten(tuple(given[f"{INITIAL}{name}"] for name, _ in self.own))
        rest = tuple(x for name, x in given.items() if not name.startswith(INITIAL))
        return UserFrame.of(frames), rest, tuple(initial)

    def initial(self, placed: Any) -> Vec:
        """Initial values, side by side."""
        found: Vec = placed[2]
        return found


@dataclass(frozen=True)
class UserStates(_Starting):
    """States beside the body's, by their derivatives."""

    bounds_steps: ClassVar = True
    function: Function
    states: Shapes

    @property
    def own(self) -> Shapes:
        return self.states

    def rates(self, placed: Any, x: Motion) -> Vec:
        """All derivatives, side by side."""
        found: Vec = self.asked(placed, x)
        return found


@dataclass(frozen=True)
class UserController(_Starting):
    """What is called at the multiples of a period, and whose outputs are held until the next one.

    outputs : by name; known once it is bound to a problem.   memory : by name.
    """

    function: Function
    memory: Shapes = ()
    outputs: Shapes = ()

    @property
    def own(self) -> Shapes:
        return self.memory

    @property
    def shapes(self) -> dict[str, Shape]:
        return {"every": (), **super().shapes}

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """As of `_Starting`, and the period."""
        rest = {name: x for name, x in given.items() if name != "every"}
        return *super().placed(rest, frames), given["every"]

    def every(self, placed: Any) -> Any:
        """The period, s."""
        return placed[3]

    def called(self, placed: Any, x: Motion, noise: Noise) -> tuple[Vec, Vec]:
        """Outputs and memory, each side by side.   x.signals.memory : its own alone."""
        found = self.asked(placed, x, noise)
        return found if self.memory else (found, ())


# ---- all elements of a body -------------------------------------------------------------------


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
    x = x._replace(signals=body.signals)
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

"""Elements: applied forces, further constraints, and users' functions of the motion.

Each kind of element is a tag class with formulas. This module has those of users' functions;
`lierb.forces` has the others. `placed` transforms the parameters from the user's frames to joint
axes, once per run. A force has a `wrench`, evaluated in every stage; an `energy`, if it has a
potential; and a `power`, if it does further work. A constraint has rows, which the saddle point
solves together with the joint's rows.
Observables, events, states and controllers are passive: they act on the motion through forces that
use their `Signals`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import BODY, Function
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Frames,
    Motion,
    Parameters,
    Pose,
    SO3xR3,
    frames_of,
    inertia_about_com,
)
from lierb.kernels.mechanics.rows import AddedRow, Rows
from lierb.kernels.mechanics.scale import ROUNDING
from lierb.kernels.numbers.arithmetic import (
    PI,
    absolute,
    flatten,
    fma,
    plain,
    rint,
    sqrt,
    where,
)
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import atan2
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

# Largest rotation in a step where a force is an unknown function of the pose. 1/8 of a turn is
# 0.2 rad between stages of DOP853 and 0.45 rad between those of Tsit5; events are evaluated four
# times in it.
TURN = 0.25 * PI
SHARE = 0.25  # fraction of the distance from the frame's origin, added to the body's size
BEFORE = 1.0 - 1e-12  # part of the distance to a kink at which a step ends

Wrench = tuple[Vec, Vec]  # torque and force, in body axes, about the joint's point
Shape = tuple[int, ...]


class Tangent(NamedTuple):
    """Wrench of an element along one direction, to first order: −(stiffness δq + damping q̇).

    direction : torque and force in body axes, r; q̇ = r·(ω, v), and the wrench acts along r.
    is_lasting : True if the element always acts; False if, like a stop, it acts at times only.
    """

    direction: Vec
    stiffness: Any = 0.0
    damping: Any = 0.0
    is_lasting: bool = True


class Element:
    """Base class of all elements, without any effect.

    needs_axis : True if it acts about or along e₃ of the joint, which must then be an axis of
    the body and of the ground.   needs_slide : True if it acts along e₃.   joints : number of
    joints at whose axes it acts, if it needs one.   rows : number of constraints.
    does_work : True if it can change E = T + U, U the `energy` of all elements.   is_passive : True
    if it has no effect on the motion by itself.   bounds_steps : True if adaptive steps respect the
    bounds of `travel`.   jumping : parameters that, unless zero, make the wrench jump at a place.
    adds_inertia : True if it is inertia on a link; see `lierb.kernels.mechanics.added_inertia`.
    """

    needs_axis: ClassVar[bool] = False
    needs_slide: ClassVar[bool] = False
    joints: ClassVar[int] = 1
    is_conservative: ClassVar[bool] = False  # but for the parameters in `working`
    is_users: ClassVar[bool] = False  # True for a user's function
    does_work: ClassVar[bool] = True
    is_passive: ClassVar[bool] = False
    adds_inertia: ClassVar[bool] = False
    working: ClassVar[tuple[str, ...]] = ()  # parameters of forces without potential
    bounds_steps: ClassVar[bool] = False
    jumping: ClassVar[tuple[str, ...]] = ()
    discontinuities: tuple[str, ...] = ()  # parameters that are times of possible jumps, s
    rows: int = 0

    @property
    def is_listed(self) -> bool:
        """Return whether looped code has it one by one: passive elements, and extra states."""
        return self.is_passive or isinstance(self, AddedStates)

    def require_fit(self, parameters: Mapping[str, Any]) -> None:
        """Raise ArgumentError for parameters, arrays by name, that no such element can have."""

    @property
    def depends_on_velocity(self) -> bool:
        """Return False if the wrench is a function of pose and time alone, for all parameters."""
        return self.is_users or not self.is_conservative or bool(self.working)

    @property
    def feels(self) -> bool:
        """Return whether a function of the element takes accelerations."""
        return False

    @property
    def functions(self) -> tuple[Function, ...]:
        """User's functions of the element."""
        members = (getattr(self, name, None) for name in ("function", "potential"))
        return tuple(f for f in members if isinstance(f, Function))

    @property
    def shapes(self) -> dict[str, Shape]:
        """Shapes of the parameters, by name."""
        return dict(self.functions[0].shapes)

    @property
    def takes_body(self) -> bool:
        """Return whether a function takes mass, inertia and centre of mass."""
        return any(f.takes_body for f in self.functions)

    def row(self, place: int, i: int) -> AddedRow:
        """Row of constraint i; `place` is the element's index in the problem."""
        raise NotImplementedError

    def on_joint(self, rows: Rows, joint: int = 0) -> Element:
        """Return the element with a joint of these rows as the one with this number."""
        return self

    def slides_at(self, joint: int) -> bool:
        """Return whether it acts along e₃ of the joint with this number."""
        return self.needs_slide

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        """Stiffness and damping of the wrench at a motion, or their largest values.

        The length of fixed steps is checked against them. They are unknown for a user's function.
        """
        return ()

    def energy(self, placed: Any, x: Motion) -> Any:
        return ZERO

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """Power, W, by which the wrench changes E = T + U; without a potential, its total power."""
        torque, force = wrench
        return dot(torque, x.omega) + dot(force, x.v)

    def travel(
        self, placed: Any, start: Motion, end: Motion, h: Any, size: Any
    ) -> tuple[Bound, ...]:
        """Bounds on an adaptive step: rates of the pose at `end`, and largest displacements.

        The error estimate of a step depends on its stages alone. If an element acts in a small
        region, the bounds keep a step from passing over that region. The default is for an unknown
        function of the pose: a fraction of a turn, and a displacement that is short relative to
        the distance from the frame's origin.

        start, end : motions at both ends of a step, of length h, s; equal before it is tried.
        size : the body's radius of gyration, m.
        """
        way = fma(SHARE, norm(start.place), size)
        return Bound(norm(end.omega), TURN), Bound(norm(end.v), way)

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        """Times at which the element may jump, s."""
        return ()


class Bound(NamedTuple):
    """Bound h · rate ≤ distance on the length h of a step; rate ≥ 0, distance > 0."""

    rate: Number
    distance: Number


def travel_to_kink(place: Any, start: Any, end: Any, h: Any, kinks: tuple[Any, ...]) -> Bound:
    """Bound that ends a step just before the next kink of a force.

    All stages of the step are then on one side of the kink. Its time is that of a motion whose
    rate changes uniformly from start to end of a step.

    place : coordinate at the start, relative to the middle of the kinks.
    start, end : its rate at both ends of a step of length h, s.
    kinks : coordinates ahead in the positive direction, ascending; their negatives are those in the
        other one. The last one is greater than any coordinate.
    """
    *near, last = kinks

    def distance_to_kink(ahead: Any) -> Any:
        distance: Any = last - ahead
        for kink in reversed(near):
            distance = where(kink > ahead, kink - ahead, distance)
        return distance

    forward = where(start == 0.0, end, start) >= 0.0
    ahead, speed = where(forward, place, -place), absolute(start)
    gain = where(forward, end - start, start - end) / where(h > 0.0, h, 1.0)
    # The distance d is passed in τ, d = speed τ + gain τ²/2; the mean speed until then is d/τ.
    distance, behind = distance_to_kink(ahead), distance_to_kink(-ahead)
    square = fma(2.0 * gain, distance, speed * speed)
    reaches = square >= 0.0  # else it turns back before
    root = sqrt(where(reaches, square, fma(-2.0 * gain, behind, speed * speed)))
    back = root + speed
    mean = where(reaches, 0.5 * back, -gain * behind / where(back > 0.0, back, 1.0))
    return Bound(mean, BEFORE * where(reaches, distance, behind))


@dataclass(frozen=True)
class UserWrench(Element):
    """User's wrench, a function of (t, R, r, ω, v) in the user's frames."""

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
        wrench = self.function(parameters, x.time, r, place, omega, v, signals=x.signals)
        return frame.to_joint_axes(*wrench)

    def energy(self, placed: Any, x: Motion) -> Any:
        if self.potential is None:
            return ZERO
        return self.potential(placed[1], *UserFrame(*placed[0]).pose(x.q, x.place))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """Power of the wrench plus dU/dt; zero if the wrench derives from the potential U."""
        total = super().power(placed, x, wrench)
        if self.potential is None:
            return total
        frame = UserFrame(*placed[0])
        (r, place), (omega, v) = frame.pose(x.q, x.place), frame.twist(x.omega, x.v)
        turning = sum((cross(row(r, i), omega) for i in range(3)), start=())  # Ṙ = R ω̂
        energy = self.potential(placed[1], moving(r, turning), moving(place, mat_vec(r, v)))
        return total + energy.parts[0] if isinstance(energy, UserNumber) else total

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        return times_of_jumps(self, placed[1])


def times_of_jumps(element: Element, parameters: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the parameters of a user's function that are times of possible jumps, s."""
    given = dict(zip(element.shapes, parameters, strict=False))  # `body` parameters come last
    return tuple(flatten(tuple(given[name] for name in element.discontinuities)))


class UserFrame(NamedTuple):
    """Transformation from joint axes back to the user's frames."""

    ground: Pose
    axes: Mat  # the joint's axes in the user's body frame
    origin: Vec  # origin of the user's body frame from the joint's point, in body axes

    @classmethod
    def of(cls, frames: Frames) -> UserFrame:
        return cls(frames.ground, frames.axes, frames.body_point(ZERO3))

    def pose(self, q: Mat, place: Vec) -> Pose:
        """Return (R, r) of a pose in joint axes."""
        ground, ground_origin = self.ground
        r = mat_mat(ground, mat_mat_t(q, self.axes))
        return r, add(ground_origin, mat_vec(ground, mat_vec_add(q, self.origin, place)))

    def twist(self, omega: Vec, v: Vec) -> tuple[Vec, Vec]:
        moving = cross_add(omega, self.origin, v)
        return mat_vec(self.axes, omega), mat_vec(self.axes, moving)

    def felt(self, x: Motion) -> tuple[Vec, Vec]:
        """Return ω̇ and the specific force at the user's origin, in the user's body axes."""
        turning, point = x.felt[:3], x.felt[3:]
        swing = cross(x.omega, cross(x.omega, self.origin))
        moving = cross_add(turning, self.origin, add(point, swing))
        return mat_vec(self.axes, turning), mat_vec(self.axes, moving)

    def to_joint_axes(self, torque: Vec, force: Vec) -> Wrench:
        pull = mat_t_vec(self.axes, force)
        return cross_add(self.origin, pull, mat_t_vec(self.axes, torque)), pull


def moving(values: Vec, rates: Vec) -> Vec:
    """Numbers with their first derivatives."""
    return tuple(UserNumber(plain(x), (rate,)) for x, rate in zip(values, rates, strict=True))


def second(value: Any, rate: Any, bend: Any) -> UserNumber:
    """A number with its first and second derivative."""
    return UserNumber(UserNumber(plain(value), (rate,)), (UserNumber(plain(rate), (bend,)),))


def slope_of(number: Any) -> Any:
    """Return the derivative of a number with one derivative, or of a constant."""
    return number.parts[0] if isinstance(number, UserNumber) and number.parts else ZERO


def constant_in_time(numbers: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return numbers without the derivatives of `second`; they keep those by parameters."""
    return tuple(
        constant_in_time(x) if isinstance(x, tuple)
        else UserNumber(UserNumber(x)) if isinstance(x, Dual)
        else x
        for x in numbers
    )  # fmt: skip


# ---- passive elements --------------------------------------------------------------------------


FELT = ("alpha", "specific_force")  # arguments of functions that depend on accelerations


class Passive(Element):
    """User's function of a motion, without effect on it."""

    does_work: ClassVar = False
    is_passive: ClassVar = True
    function: Function

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return ZERO

    @property
    def feels(self) -> bool:
        return any(FELT[0] in dict(f.arguments) for f in self.functions)

    def arguments(self, placed: Any, x: Motion) -> tuple[Any, ...]:
        """Arguments t, R, r, omega and v of the function, and FELT, in the user's frames."""
        frame = UserFrame(*placed[0])
        motion = x.time, *frame.pose(x.q, x.place), *frame.twist(x.omega, x.v)
        return (*motion, *frame.felt(x)) if self.feels else motion

    def evaluate(self, placed: Any, x: Motion, noise: Noise | None = None) -> Any:
        """Evaluate the function at a motion."""
        arguments = self.arguments(placed, x)
        return self.function(placed[1], *arguments, signals=x.signals, noise=noise)


@dataclass(frozen=True)
class UserObservable(Passive):
    """User's observable, a number computed from a motion."""

    function: Function

    def value(self, placed: Any, x: Motion) -> Any:
        return self.evaluate(placed, x)


@dataclass(frozen=True)
class UserEvent(Passive):
    """User's event: a zero crossing of its function."""

    function: Function

    def value(self, placed: Any, x: Motion) -> Any:
        return self.evaluate(placed, x)

    def value_nearby(self, placed: Any, x: Motion) -> Any:
        """Value at a motion whose numbers are each off by some roundings of its vector."""
        moved = map(_nudged, self.arguments(placed, x))
        return self.function(placed[1], *moved, signals=x.signals)


def _nudged(given: Any) -> Any:
    """Move a number or vector by ROUNDING of the sum of its magnitudes.

    Components move up and down alternately, so that the changes do not cancel in differences.
    """
    if not isinstance(given, tuple):
        return _nudged((given,))[0]
    size = ROUNDING * sum((absolute(plain(x)) for x in given), 0.0)
    return tuple(plain(x) - size if i % 2 else plain(x) + size for i, x in enumerate(given))


EVERY = "every"  # parameter of a controller: its period, s
INITIAL = "initial."  # prefix of the names of initial values among the parameters


class _Starting(Passive):
    """Passive element with variables, whose initial values are parameters."""

    @property
    def own(self) -> Shapes:
        """Shapes of the variables, by name."""
        raise NotImplementedError

    @property
    def shapes(self) -> dict[str, Shape]:
        initial = {f"{INITIAL}{name}": shape for name, shape in self.own}
        return super().shapes | initial

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """Return the frame, the function's parameters, and the flattened initial values."""
        initial = flatten(tuple(given[f"{INITIAL}{name}"] for name, _ in self.own))
        rest = tuple(x for name, x in given.items() if not name.startswith(INITIAL))
        return UserFrame.of(frames), rest, tuple(initial)

    def initial(self, placed: Any) -> Vec:
        """Initial values, flattened."""
        values: Vec = placed[2]
        return values


class AddedStates(Element):
    """Element with extra states, integrated from their derivatives.

    depends_on_pose : True if the initial values depend on the pose at the start.
    states : shapes by name.   state_unit : their unit.
    """

    depends_on_pose: ClassVar = False
    state_unit: ClassVar = "1"
    states: Shapes

    def at_start(self, placed: Any, x: Motion | None) -> Vec:
        """Initial values.   x : motion at the start, if they depend on the pose."""
        raise NotImplementedError

    def rates(self, placed: Any, x: Motion) -> Vec:
        """Derivatives of all states, flattened."""
        raise NotImplementedError


class PassiveStates(AddedStates, _Starting):
    """Extra states without an effect of their own."""

    @property
    def own(self) -> Shapes:
        return self.states

    def at_start(self, placed: Any, x: Motion | None) -> Vec:
        return self.initial(placed)


@dataclass(frozen=True)
class TurnCounter(PassiveStates):
    """Angle of a joint's axis without end: the integral of its rate."""

    depends_on_pose: ClassVar = True
    needs_axis: ClassVar = True
    states: Shapes

    @property
    def shapes(self) -> dict[str, Shape]:
        return {"start": ()}

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), (), (given["start"],)

    def at_start(self, placed: Any, x: Motion | None) -> Vec:
        """Angle of the pose, with the whole turns of the initial value."""
        assert x is not None
        (start,) = self.initial(placed)
        return (counted_turn(x.q, start),)

    def rates(self, placed: Any, x: Motion) -> Vec:
        return (x.omega[2],)


def counted_turn(q: Mat, near: Any) -> Any:
    """Angle about e₃, with the whole turns that bring it nearest to another angle, rad."""
    turn = atan2(q[3], q[0])
    return fma(2.0 * PI, rint((near - turn) * (0.5 / PI)), turn)


@dataclass(frozen=True)
class UserStates(PassiveStates):
    """User's extra states."""

    bounds_steps: ClassVar = True
    function: Function
    states: Shapes

    def rates(self, placed: Any, x: Motion) -> Vec:
        """Derivatives of all states, flattened."""
        rates: Vec = self.evaluate(placed, x)
        return rates


@dataclass(frozen=True)
class UserController(_Starting):
    """User's controller, called once per period; outputs are constant in between.

    outputs : shapes by name, set when it is bound to a problem.   memory : shapes by name.
    """

    function: Function
    memory: Shapes = ()
    outputs: Shapes = ()

    @property
    def own(self) -> Shapes:
        return self.memory

    @property
    def shapes(self) -> dict[str, Shape]:
        return {EVERY: (), **super().shapes}

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """Return the frame, the parameters, the initial values, and the period."""
        rest = {name: x for name, x in given.items() if name != EVERY}
        return *super().placed(rest, frames), given[EVERY]

    def every(self, placed: Any) -> Any:
        """Period, s."""
        return placed[3]

    def called(self, placed: Any, x: Motion, noise: Noise) -> tuple[Vec, Vec]:
        """Outputs and memory, each flattened.   x.signals.memory : memory of this controller."""
        result = self.evaluate(placed, x, noise)
        return result if self.memory else (result, ())


# ---- all elements of a body -------------------------------------------------------------------


def all_placed(
    elements: tuple[Element, ...], numbers: list[Any], frames: Frames, parameters: Parameters
) -> tuple[Any, ...]:
    """Parameters of every element in joint axes, from the numbers of their input columns.

    For an element that takes the body, they include the body parameters named in
    `lierb.kernels.functions.function.BODY`.
    """
    rest = iter(numbers)
    placed = []
    for element in elements:
        given = {
            name: tuple(islice(rest, math.prod(shape))) if shape else next(rest)
            for name, shape in element.shapes.items()
        }
        if element.takes_body:
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
    """Constants of the body in a c-space, with its elements' parameters from `numbers`."""
    placed = all_placed(elements, numbers, frames_of(parameters), parameters)
    return space.body(parameters)._replace(elements=placed)


class Applied(NamedTuple):
    """Sum of all applied forces except gravity."""

    wrench: Vec  # torque and force
    power: Number  # W, by which they change E


def applied_to(body: BodyConstants, elements: tuple[Element, ...], x: Motion) -> Applied:
    """Sum wrench and power of all elements; a user's function is called once for both."""
    total, power = ZERO6, ZERO
    x = x._replace(signals=body.signals)
    for element, placed in zip(elements, body.elements, strict=True):
        wrench = element.wrench(placed, x)
        total = add(total, wrench[0] + wrench[1])
        power = power + element.power(placed, x, wrench)
    return Applied(total, power)


def potential_energy(elements: tuple[Element, ...], body: BodyConstants, x: Motion) -> Any:
    """Sum of the potential energies of all applied forces."""
    total: Any = ZERO
    for element, placed in zip(elements, body.elements, strict=True):
        total = total + element.energy(placed, x)
    return total

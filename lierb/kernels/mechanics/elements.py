"""Elements: applied forces, further constraints, and users' functions of the motion.

Each kind of element is a tag class with formulas: those of users' functions are in
`lierb.kernels.mechanics.user_wrench`, `user_rows` and `passive_elements`, the others in
`lierb.forces`. `placed` transforms the parameters from the user's frames to joint axes, once per
run. A force has a `wrench`, evaluated in every stage; an `energy`, if it has a potential; and a
`power`, if it does further work. A constraint has rows, which the saddle point solves together
with the joint's rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import islice
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import BODY, Function
from lierb.kernels.mechanics.kinks import Bound
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Frames,
    Motion,
    Parameters,
    SO3xR3,
    Wrench,
    frames_of,
    inertia_about_com,
)
from lierb.kernels.mechanics.rows import AddedRow, Rows
from lierb.kernels.numbers.arithmetic import PI, fma
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import ZERO3, ZERO6, Vec, add, dot, norm
from lierb.kernels.numbers.zero import ZERO

# Largest rotation in a step where a force is an unknown function of the pose. 1/8 of a turn is
# 0.2 rad between stages of DOP853 and 0.45 rad between those of Tsit5; events are evaluated four
# times in it.
TURN = 0.25 * PI
SHARE = 0.25  # fraction of the distance from the frame's origin, added to the body's size
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
    has_states : True if it has extra states.
    """

    needs_axis: ClassVar[bool] = False
    needs_slide: ClassVar[bool] = False
    joints: ClassVar[int] = 1
    is_conservative: ClassVar[bool] = False  # but for the parameters in `working`
    is_users: ClassVar[bool] = False  # True for a user's function
    does_work: ClassVar[bool] = True
    is_passive: ClassVar[bool] = False
    adds_inertia: ClassVar[bool] = False
    has_states: ClassVar[bool] = False
    working: ClassVar[tuple[str, ...]] = ()  # parameters of forces without potential
    bounds_steps: ClassVar[bool] = False
    jumping: ClassVar[tuple[str, ...]] = ()
    discontinuities: tuple[str, ...] = ()  # parameters that are times of possible jumps, s
    rows: int = 0

    @property
    def is_listed(self) -> bool:
        """Return whether looped code has it one by one: passive elements, and extra states."""
        return self.is_passive or self.has_states

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


def body_with(
    space: type[SE3] | type[SO3xR3],
    parameters: Parameters,
    elements: tuple[Element, ...],
    numbers: list[Any],
) -> BodyConstants:
    """Constants of the body in a c-space, with its elements' parameters from `numbers`.

    For an element that takes the body, they include the body parameters named in
    `lierb.kernels.functions.function.BODY`.
    """
    rest, frames = iter(numbers), frames_of(parameters)
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
    return space.body(parameters)._replace(elements=tuple(placed))


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
    pairs = zip(elements, body.elements, strict=True)
    return sum((element.energy(placed, x) for element, placed in pairs), start=ZERO)

"""Observables, events, extra states and controllers, which act on the motion through forces alone.

A force takes them from its `Signals`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise
from lierb.kernels.mechanics.elements import Element, Shape
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Wrench
from lierb.kernels.mechanics.scale import ROUNDING
from lierb.kernels.mechanics.user_frames import UserFrame
from lierb.kernels.numbers.arithmetic import PI, absolute, flatten, fma, plain, rint
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import Mat, Vec
from lierb.kernels.numbers.zero import ZERO

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
        return placed[2]


class AddedStates(Element):
    """Element with extra states, integrated from their derivatives.

    depends_on_pose : True if the initial values depend on the pose at the start.
    states : shapes by name.   state_unit : their unit.
    """

    has_states: ClassVar = True
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
        return self.evaluate(placed, x)


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

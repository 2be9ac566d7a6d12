"""Forces about or along the axis of a joint."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, ClassVar, Self

from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.kinks import Bound, Travelled, travel_to_kink
from lierb.kernels.mechanics.newton_euler import Motion, Wrench
from lierb.kernels.mechanics.passive_elements import counted_turn
from lierb.kernels.numbers.arithmetic import PI, fma, rint
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import ZERO3
from lierb.kernels.numbers.zero import ZERO
from lierb.model.forces.built_in import BuiltIn, Parameter
from lierb.model.functions.named_values import require_attribute

UNKNOWN = -1  # index of a state before the force is part of a model


@dataclass(frozen=True)
class AtJoint(BuiltIn, is_abstract=True):
    """Force about the joint axis e₃, a function of the angle and its rate.

    turns : name of the state that counts whole turns, or "".   index : place of the number of the
    state that it reads among those of all extra states.
    """

    turns: str = ""
    index: int = UNKNOWN
    needs_axis: ClassVar = True
    whole_turn: ClassVar = 2.0 * PI

    @property
    def options(self) -> dict[str, Any]:
        return {"turns": self.turns} if self.turns else {}

    @classmethod
    def counting(cls, turns: str | None) -> Self:
        """Return the force that takes its turns from a state of that name, if there is a name."""
        if turns is not None:
            require_attribute("a counted angle", turns)
        return cls(turns or "")

    def rate(self, x: Motion) -> Any:
        return x.omega[2]

    def place(self, x: Motion, middle: Any) -> Any:
        """Angle relative to `middle`, or, for a slide, coordinate along the axis.

        The turns are those of the counted angle, which is off by less than half a turn; the rest is
        that of the pose.
        """
        if self.turns:
            return counted_turn(x.q, x.signals.states[self.index]) - middle
        turn = atan2(x.q[3], x.q[0]) - middle
        return fma(-2.0 * PI, rint(turn * (0.5 / PI)), turn)  # in [−π, π]

    def to_kink(
        self, start: Motion, end: Motion, h: Any, middle: Any, kinks: tuple[Any, ...], size: Any
    ) -> Bound:
        """Return the bound of `travel_to_kink`.

        end : `start` before a step is tried.   kinks : relative to `middle`, ascending.
        size : usual size of a slide, m.
        """
        unit = PI if isfinite(self.whole_turn) else size
        place, rate, tried = self.place(start, middle), self.rate(start), None
        if end is not start:
            change, later = self.place(end, middle) - place, self.rate(end)
            if isfinite(self.whole_turn):  # the turn that is nearest to that by the mean rate
                lacking = fma(0.5 * h, rate + later, -change)
                change = fma(self.whole_turn, rint(lacking * (1.0 / self.whole_turn)), change)
            tried = Travelled(change, later)
        return travel_to_kink(place, rate, tried, h, kinks, unit)

    def pushed(self, size: Any) -> Wrench:
        return (ZERO, ZERO, size), ZERO3

    def tangent(self, stiffness: Any, damping: Any, is_lasting: bool = True) -> Tangent:
        torque, force = self.pushed(1.0)
        return Tangent(torque + force, stiffness, damping, is_lasting)


class AlongJoint(AtJoint, is_abstract=True):
    """Force along the joint axis e₃, a function of the coordinate d₃ and its rate."""

    needs_slide: ClassVar = True
    whole_turn: ClassVar = inf

    def rate(self, x: Motion) -> Any:
        return x.v[2]

    def place(self, x: Motion, middle: Any) -> Any:
        return x.place[2] - middle

    def pushed(self, size: Any) -> Wrench:
        return ZERO3, (ZERO, ZERO, size)


def sliding(parameters: dict[str, Parameter]) -> dict[str, Parameter]:
    """Return parameters of a force about the axis with the units of a force along it."""
    return {
        name: each._replace(unit=each.unit.replace("N m", "N").replace("rad", "m"))
        for name, each in parameters.items()
    }

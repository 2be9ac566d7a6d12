"""A state has independent numbers in the chart of a step, with the Jacobian of their rates."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.dual import Dual, lifted, parts_of, value_of, values
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.state import Rates, State
from lierb.kernels.systems.system import AnySystem


class Jacobian(NamedTuple):
    """The Jacobian has the derivatives of the rates: ∂ẏᵢ/∂yⱼ row by row, and ∂ẏᵢ/∂t."""

    rows: list[list[Any]]
    late: Vec


class Unknowns:
    """The unknowns are a state's independent numbers y: X, then V or μ, extra states and work.

    Numbers that are structurally zero, or follow from others by a joint's pitch, are left out, and
    so are components of V that rows keep at zero.
    """

    def __init__(self, system: AnySystem, state: State) -> None:
        self.system, self.state = system, state
        self.places = system.free
        self.speeds = tuple(i for i in system.free if not is_zero(state.v_or_mu[i]))
        self.works = not is_zero(state.work)

    def __len__(self) -> int:
        return len(self.places) + len(self.speeds) + len(self.state.states) + self.works

    def of(self, rates: Rates) -> Vec:
        """Return ẏ of the rates of a state."""
        return (
            *(rates.x[i] for i in self.places),
            *(rates.v_or_mu[i] for i in self.speeds),
            *rates.states,
            *((rates.power,) * self.works),
        )

    def rates(self, body: Any, y: Vec) -> Rates:
        """Return the rates of a state with these ẏ."""
        ahead, behind = len(self.places), len(self.places) + len(self.speeds)
        last = behind + len(self.state.states)
        x, v = [[ZERO] * len(self.state.v_or_mu) for _ in range(2)]
        for i, number in zip(self.places, y[:ahead], strict=True):
            x[i] = number
        for i, number in zip(self.speeds, y[ahead:behind], strict=True):
            v[i] = number
        power = y[last] if self.works else ZERO
        speeds = self.system.completed(body, tuple(v))
        return Rates(tuple(x), speeds, power, states=y[behind:last])

    def jacobian(self, body: Any, gravity: Any, time: Any) -> tuple[Rates, Jacobian]:
        """Return the rates at the state, with their values alone, and their derivatives.

        Numbers with derivatives along other directions are `lifted`, and so are the results. Rates
        do not depend on the work.   gravity, time : as for `System.stage_rates`.
        """
        state, count = self.state, len(self) - self.works
        unit = iter(range(count))

        def varied(value: Any, slope: float) -> Dual:
            direction = next(unit)
            units = (slope if i == direction else ZERO for i in range(count + 1))
            return Dual(value_of(value), tuple(units))

        half: list[Any] = [ZERO] * len(state.v_or_mu)  # a state holds X/2
        for i in self.places:
            half[i] = varied(ZERO, 0.5)
        speeds = [varied(v, 1.0) if i in self.speeds else v for i, v in enumerate(state.v_or_mu)]
        states = tuple(varied(number, 1.0) for number in state.states)
        moved = state._replace(
            x=self.system.in_algebra(body, tuple(half)),
            v_or_mu=self.system.completed(body, tuple(speeds)),
            states=states,
        )
        now = Dual(value_of(time), (*(ZERO,) * count, 1.0))
        rates = self.system.stage_rates(body, moved, gravity, now)
        parts = [lifted(parts_of(rate)) or (ZERO,) * (count + 1) for rate in self.of(rates)]
        jacobian = Jacobian(
            [[*part[:count], *((ZERO,) * self.works)] for part in parts],
            tuple(part[count] for part in parts),
        )
        return lifted(values(rates)), jacobian

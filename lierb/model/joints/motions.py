"""Motions of joints with coordinates are maps from coordinates to D and from rates to D⁻¹Ḋ.

Coordinates of a subgroup of SE(3) are a rotation vector or one angle, and positions. The motions of
other joints are a product of two with one freedom each, such as the two turns of a universal joint.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics.rows import JOINT_ROWS, PITCHED, Rows
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import ZERO3, Vec, add, dot, mat_t_vec, mat_vec, neg, row
from lierb.kernels.numbers.zero import ZERO
from lierb.support.arrays import QUATERNION, Array, Pose, as_floats, as_numbers

TURNS = ("xi1", "xi2", "xi3")  # names of the components of a rotation vector


class Factor(NamedTuple):
    """A factor is a motion with one freedom, about or along an axis of the joint frame.

    name : name of the coordinate.   kind : "turn" or "slide".   axis : 0, 1 or 2.
    """

    name: str
    kind: str
    axis: int

    @property
    def slot(self) -> int:
        """Return the index of its rate in the twist (ω, v)."""
        return self.axis if self.kind == "turn" else 3 + self.axis

    @property
    def rows(self) -> Rows:
        """Return the rows of the joint that has this motion only."""
        positions = [f"d{i + 1}" for i in range(3) if self.kind == "turn" or i != self.axis]
        turns = [f"Omega{i + 1}" for i in range(3) if self.kind == "slide" or i != self.axis]
        return tuple(JOINT_ROWS[name] for name in (*positions, *turns))

    def motion(self, number: Any) -> Pose:
        """Return the factor F at a coordinate."""
        along = tuple(number if i == self.axis else ZERO for i in range(3))
        return (so3.exp(along), ZERO3) if self.kind == "turn" else (so3.identity, along)

    def twist(self, rate: Any) -> Vec:
        """Return the twist F⁻¹Ḟ for a rate."""
        return tuple(rate if i == self.slot else ZERO for i in range(6))


class SubgroupMotions:
    """Motions D in a subgroup H of SE(3) have a rotation vector or one angle, and positions."""

    def __init__(self, slots: Slots, pitch: Array) -> None:
        self.slots, self.pitch = slots, pitch

    @property
    def names(self) -> tuple[str, ...]:
        slots = self.slots
        turning = TURNS if slots[0] >= 0 else ("phi",) if slots[2] >= 0 else ()
        return turning + tuple(f"d{i + 1}" for i in range(3) if slots[3 + i] >= 0)

    def pose(self, numbers: Vec) -> Pose:
        """Return the relative pose D of coordinates."""
        turning, position = self._lifted(numbers)
        return so3.exp(turning), position

    def coordinates(self, relative: Pose) -> Vec:
        """Return the coordinates of a relative pose D in H."""
        q, d = relative
        turning: Vec = ()
        if self.slots[0] >= 0:
            turning = so3.log(q)
        elif self.slots[2] >= 0:
            turning = (self._turn(atan2(q[3], q[0]), d[2]),)
        return turning + tuple(d[i] for i in range(3) if self.slots[3 + i] >= 0)

    def twist_at(self, rates: Vec, numbers: Vec) -> Vec:
        """Return the twist D⁻¹Ḋ for rates at coordinates, whose rotation vector may exceed π."""
        xi, _ = self._lifted(numbers)
        return self._twist(rates, xi, so3.exp(xi))

    def twist(self, rates: Vec, relative: Pose) -> Vec:
        """Return the twist D⁻¹Ḋ of rates at D."""
        q, _ = relative
        return self._twist(rates, so3.log(q), q)

    def _twist(self, rates: Vec, xi: Vec, q: Vec) -> Vec:
        turning, sliding = self._lifted(rates)
        if self.slots[0] >= 0:
            turning = so3.dexp(neg(xi), turning)
        return turning + mat_t_vec(q, sliding)

    def rates(self, twist: Vec, relative: Pose) -> Vec:
        """Return the rates of the coordinates, from D⁻¹Ḋ."""
        q, _ = relative
        rates: Vec = ()
        if self.slots[0] >= 0:
            rates = so3.dexpinv(neg(so3.log(q)), twist[:3])
        elif self.slots[2] >= 0:
            rates = (twist[2],)
        drift = mat_vec(q, twist[3:])
        return rates + tuple(drift[i] for i in range(3) if self.slots[3 + i] >= 0)

    def _lifted(self, numbers: Vec) -> tuple[Vec, Vec]:
        """Return rotation vector and position for coordinates; for rates, the rates of both."""
        turning = tuple(numbers[slot] if slot >= 0 else ZERO for slot in self.slots[:3])
        position = tuple(
            numbers[slot] if slot >= 0 else self.pitch * turning[2] if slot == PITCHED else ZERO
            for slot in self.slots[3:]
        )
        return turning, position

    def _turn(self, angle: Any, slide: Any) -> Any:
        """Angle about e₃; for a screw, including the whole turns that its slide determines."""
        if self.slots[5] != PITCHED:
            return angle
        turned = slide / np.where(self.pitch == 0.0, 1.0, self.pitch)
        whole = 2.0 * np.pi * np.rint((turned - angle) / (2.0 * np.pi))
        return angle + np.where(self.pitch == 0.0, 0.0, whole)


class ProductMotions:
    """Motions D = F₁(a) F₂(b) of two factors with different axes, at least one of them a turn.

    a is computed from D in the ground's axes, b from D in the body's.
    """

    def __init__(self, factors: tuple[Factor, ...]) -> None:
        self.factors = self.first, self.last = factors

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(factor.name for factor in self.factors)

    def pose(self, numbers: Vec) -> Pose:
        """Return the relative pose D of coordinates."""
        a, b = numbers
        return se3.compose(self.first.motion(a), self.last.motion(b))

    def coordinates(self, relative: Pose) -> Vec:
        """Return the coordinates (a, b) of D."""
        q, d = relative
        if self.first.kind == "slide":
            a = d[self.first.axis]
        else:  # Qe_j = F₁e_j
            i, j, k, sign = self._axes(self.first, self.last)
            a = atan2(sign * q[3 * k + j], q[4 * j])
        if self.last.kind == "slide":
            b = mat_t_vec(q, d)[self.last.axis]
        else:  # Qᵀe_i = F₂ᵀe_i
            j, i, k, sign = self._axes(self.last, self.first)
            b = atan2(-(sign * q[3 * i + k]), q[4 * i])
        return a, b

    @staticmethod
    def _axes(turning: Factor, other: Factor) -> tuple[int, int, int, float]:
        """Axis of the turn, of the other factor, and the third; their sign, 1 if right-handed."""
        i = turning.axis
        j = other.axis if other.kind == "turn" else (i + 1) % 3
        return i, j, 3 - i - j, 1.0 if j == (i + 1) % 3 else -1.0

    def twist_at(self, rates: Vec, numbers: Vec) -> Vec:
        """Return the twist D⁻¹Ḋ = Ad(F₂⁻¹) (ȧ e₁) + ḃ e₂ for rates at coordinates."""
        back = se3.inverse(self.last.motion(numbers[1]))
        return add(se3.Ad(back, self.first.twist(rates[0])), self.last.twist(rates[1]))

    def twist(self, rates: Vec, relative: Pose) -> Vec:
        """Return the twist D⁻¹Ḋ of rates at D."""
        return self.twist_at(rates, self.coordinates(relative))

    def rates(self, twist: Vec, relative: Pose) -> Vec:
        """Return the rates ȧ and ḃ, from D⁻¹Ḋ."""
        q, _ = relative
        parts = {"turn": twist[:3], "slide": twist[3:]}
        first = dot(row(q, self.first.axis), parts[self.first.kind])
        return first, parts[self.last.kind][self.last.axis]


Motions = SubgroupMotions | ProductMotions


def as_coordinates(argument: str, given: Any, names: tuple[str, ...]) -> Array:
    """Convert to coordinates, (k,) or (n, k); a single one may be given as a number or (n,)."""
    array, k = as_floats(argument, given), len(names)
    if array.ndim == 0 and (k == 1 or not array):
        array = np.full(k, array)
    elif array.ndim == 1 and k == 1 and len(array) != 1:
        array = array[:, None]
    if array.ndim not in (1, 2) or array.shape[-1] != k:
        expected = "a number, (n,) or (n, 1)" if k == 1 else f"({k},) or (n, {k})"
        raise ArgumentError(
            f"{argument} has shape {np.shape(given)}; expected {expected}, of {', '.join(names)}"
            f"{_hint(array, names)}"
        )
    return as_numbers(argument, array, (k,))


def _hint(array: Array, names: tuple[str, ...]) -> str:
    """End of the message about coordinates that may be a quaternion."""
    is_quaternion = array.shape[-1:] == (len(names) + 1,) and names[:3] == TURNS
    return f"; they may have a quaternion, {QUATERNION}" if is_quaternion else ""

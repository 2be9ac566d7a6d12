"""The motions of joints that have coordinates: what coordinates say of D, and their rates of D⁻¹Ḋ.

Those of a subgroup of SE(3) have rotation vectors or one angle, and places; others are a product of
motions of one freedom each, as a universal joint's two turns.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics.rows import JOINT_ROWS, PITCHED, Rows
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import (
    ZERO3,
    Vec,
    add,
    dot,
    mat_t_vec,
    mat_vec,
    neg,
    row,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.support.arrays import Array, Pose

TURNS = ("xi1", "xi2", "xi3")  # coordinates of a rotation


class Factor(NamedTuple):
    """A motion of one freedom about or along an axis of the joint frame.

    name : of its coordinate.   kind : "turn" or "slide".   axis : 0, 1 or 2.
    """

    name: str
    kind: str
    axis: int

    @property
    def slot(self) -> int:
        """Which of the six components of (ω, v) its rate is."""
        return self.axis if self.kind == "turn" else 3 + self.axis

    @property
    def rows(self) -> Rows:
        """Of the joint that has this motion and no other."""
        places = [f"d{i + 1}" for i in range(3) if self.kind == "turn" or i != self.axis]
        turns = [f"Omega{i + 1}" for i in range(3) if self.kind == "slide" or i != self.axis]
        return tuple(JOINT_ROWS[name] for name in (*places, *turns))

    def motion(self, number: Any) -> Pose:
        """F of a coordinate."""
        along = tuple(number if i == self.axis else ZERO for i in range(3))
        return (so3.exp(along), ZERO3) if self.kind == "turn" else (so3.identity, along)

    def twist(self, rate: Any) -> Vec:
        """F⁻¹Ḟ."""
        return tuple(rate if i == self.slot else ZERO for i in range(6))


class SubgroupMotions:
    """D in a subgroup H of SE(3): its rotation by a rotation vector or one angle, and its place."""

    def __init__(self, slots: Slots, pitch: Array) -> None:
        self.slots, self.pitch = slots, pitch

    @property
    def names(self) -> tuple[str, ...]:
        slots = self.slots
        turning = TURNS if slots[0] >= 0 else ("phi",) if slots[2] >= 0 else ()
        return turning + tuple(f"d{i + 1}" for i in range(3) if slots[3 + i] >= 0)

    def pose(self, numbers: Vec) -> Pose:
        """D."""
        turning, places = self._lifted(numbers)
        return so3.exp(turning), places

    def coordinates(self, relative: Pose) -> Vec:
        """Of a D that is in H."""
        q, d = relative
        turning: Vec = ()
        if self.slots[0] >= 0:
            turning = so3.log(q)
        elif self.slots[2] >= 0:
            turning = (self._turn(atan2(q[3], q[0]), d[2]),)
        return turning + tuple(d[i] for i in range(3) if self.slots[3 + i] >= 0)

    def twist_at(self, rates: Vec, numbers: Vec) -> Vec:
        """D⁻¹Ḋ at these coordinates: a rotation vector beyond π has other rates than D's own."""
        xi, _ = self._lifted(numbers)
        return self._twist(rates, xi, so3.exp(xi))

    def twist(self, rates: Vec, relative: Pose) -> Vec:
        """D⁻¹Ḋ."""
        q, _ = relative
        return self._twist(rates, so3.log(q), q)

    def _twist(self, rates: Vec, xi: Vec, q: Vec) -> Vec:
        turning, sliding = self._lifted(rates)
        if self.slots[0] >= 0:
            turning = so3.dexp(neg(xi), turning)
        return turning + mat_t_vec(q, sliding)

    def rates(self, twist: Vec, relative: Pose) -> Vec:
        """Of the coordinates, from D⁻¹Ḋ."""
        q, _ = relative
        rates: Vec = ()
        if self.slots[0] >= 0:
            rates = so3.dexpinv(neg(so3.log(q)), twist[:3])
        elif self.slots[2] >= 0:
            rates = (twist[2],)
        drift = mat_vec(q, twist[3:])
        return rates + tuple(drift[i] for i in range(3) if self.slots[3 + i] >= 0)

    def _lifted(self, given: Vec) -> tuple[Vec, Vec]:
        """Coordinates, or their rates, as a rotation and a place, or theirs: what is bound is 0."""
        turning = tuple(given[slot] if slot >= 0 else ZERO for slot in self.slots[:3])
        places = tuple(
            given[slot] if slot >= 0 else self.pitch * turning[2] if slot == PITCHED else ZERO
            for slot in self.slots[3:]
        )
        return turning, places

    def _turn(self, angle: Any, slide: Any) -> Any:
        """The angle of a turn; of a screw with the whole turns that fit its slide."""
        if self.slots[5] != PITCHED:
            return angle
        turned = slide / np.where(self.pitch == 0.0, 1.0, self.pitch)
        whole = 2.0 * np.pi * np.rint((turned - angle) / (2.0 * np.pi))
        return angle + np.where(self.pitch == 0.0, 0.0, whole)


class ProductMotions:
    """D = F₁(a) F₂(b), of two factors, of which one turns and no two are about one axis.

    The first one is read off D in the ground's axes, the last one in the body's.
    """

    def __init__(self, factors: tuple[Factor, ...]) -> None:
        self.factors = self.first, self.last = factors

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(factor.name for factor in self.factors)

    def pose(self, numbers: Vec) -> Pose:
        """D."""
        a, b = numbers
        return se3.compose(self.first.motion(a), self.last.motion(b))

    def coordinates(self, relative: Pose) -> Vec:
        """Of a D that is such a product."""
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
        """The axis of a turn, that of the other factor or any other, the third one, and whether
        they are right-handed."""
        i = turning.axis
        j = other.axis if other.kind == "turn" else (i + 1) % 3
        return i, j, 3 - i - j, 1.0 if j == (i + 1) % 3 else -1.0

    def twist_at(self, rates: Vec, numbers: Vec) -> Vec:
        """D⁻¹Ḋ = Ad(F₂⁻¹) (ȧ e₁) + ḃ e₂ at these coordinates."""
        back = se3.inverse(self.last.motion(numbers[1]))
        return add(se3.Ad(back, self.first.twist(rates[0])), self.last.twist(rates[1]))

    def twist(self, rates: Vec, relative: Pose) -> Vec:
        """D⁻¹Ḋ."""
        return self.twist_at(rates, self.coordinates(relative))

    def rates(self, twist: Vec, relative: Pose) -> Vec:
        """ȧ and ḃ, from D⁻¹Ḋ."""
        q, _ = relative
        seen = {"turn": twist[:3], "slide": twist[3:]}
        first = dot(row(q, self.first.axis), seen[self.first.kind])
        return first, seen[self.last.kind][self.last.axis]


Motions = SubgroupMotions | ProductMotions

"""Solve the index-1 saddle point.

It is  [[M, Jᵀ], [J, 0]] (V̇, λ) = (ad_Vᵀ M V + W, η)  (Müller, eq. index1).

It is solved at the joint's point P, in body axes, for the angular acceleration α and the
acceleration a = Qᵀd̈ of P. There each `d` or `Omega` row, and a motor's speed, prescribes one
component of a or α, and the body moves in the null space of these rows. Their λ are components of
the residual f − M V̇. The other rows are solved by a Schur complement on that null space.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.kernels.mechanics.newton_euler import BodyConstants, kinetic_energy
from lierb.kernels.mechanics.rows import Row, Rows
from lierb.kernels.mechanics.support import Load, Support
from lierb.kernels.numbers.arithmetic import (
    absolute,
    any_lanes,
    branch,
    fma,
    maximum,
    sqrt,
    taken_for_granted,
    where,
)
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import (
    ZERO3,
    Mat,
    Vec,
    axpy,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    norm,
)
from lierb.kernels.numbers.zero import ZERO, is_zero

# A row depends on the rows before it if its pivot is less than this fraction of the row's own
# mobility. Without the test, Cholesky, LDLᵀ and LU return garbage. Rounding leaves about 1e-15.
PIVOT_TOLERANCE = 1e-12
# Mobilities are those of a row's own bodies. A body that is lighter than this part of what hangs
# on it moves with that: files put bodies without mass between the joints of a hip.
LIGHTEST = 1e-8
# The right-hand side of such a row must be equally small, or the rows contradict each other.
CONSISTENCY_TOLERANCE = 1e-6
# If pose and velocity violate the rows by δ, the tolerances are δ and √δ, if larger than these.
# A tolerance below the root of rounding might be exceeded by a pivot that is zero.
OPEN_PIVOT, ROUNDED_PIVOT = 10.0, 1e-7


class Solution(NamedTuple):
    """Hold the solution of the saddle point."""

    turning: Vec  # α
    moving: Vec  # a
    multipliers: Vec  # λ, in the order of the rows
    wrench: Vec  # −Jᵀλ about P
    singular: Number  # 1 where rows contradict each other, else 0
    dropped: Number  # number of dependent rows


def solve(
    body: BodyConstants,
    q: Mat,
    rows: Rows,
    jacobian: Callable[[Row], Vec],
    eta: Vec,
    load: Load,
    velocity: Vec | None = None,
    turning: Vec | None = None,
) -> Solution:
    """Solve the saddle point of the mass matrix and rows  (Müller, eq. index1).

    A step of a body that turns about a point freely evaluates α by Euler's equations,
    `newton_euler.spinning`; a step on a subgroup joint evaluates `subgroup.momentum_rate`, which
    has the same solution.

    jacobian : row of J at P, in body axes.   eta : η of the rows at α = 0, a = 0.
    velocity : (ω, velocity of P), which scales the contradiction of dropped rows.
    turning : α without the rows of the Schur complement, if it is known.
    """
    eta_of = dict(zip(rows, eta, strict=True))
    held, fixed, others = kinds_of(rows)
    support = Support(body, q, tuple(held), tuple(fixed))
    moves = tuple(eta_of[held[i]] for i in held)
    if support.is_point:
        moves = mat_t_vec(q, tuple(eta_of[held[i]] for i in range(3)))
    turns = tuple(eta_of[fixed[i]] if i in fixed else ZERO for i in range(3))

    if turning is None:
        turning = support.turning(load, turns, moves)
    moving = support.moving(load, turning, moves)
    total, multipliers = load, {}
    singular: Number = ZERO
    dropped: Number = ZERO
    arms = [jacobian(r) for r in others]
    if others:
        excess = [
            dot(arm, turning + moving) - eta_of[r] for r, arm in zip(others, arms, strict=True)
        ]
        scales = _Scales(body, support, load, velocity)
        sizes, responses, singular, dropped = _complement(support, scales, arms, excess)
        for r, size, (each, turned, moved) in zip(others, sizes, responses, strict=True):
            turning, moving = axpy(-size, turned, turning), axpy(-size, moved, moving)
            total = Load(*(axpy(-size, x, y) for x, y in zip(each, total, strict=True)))
            multipliers[r] = size
    holding = support.holding(total, turning, moves)
    torques = support.torques(total, turning, holding)
    forces = mat_vec(q, holding) if support.is_point else holding
    for size, i in zip(forces, range(3) if support.is_point else held, strict=True):
        multipliers[held[i]] = -size
    for i, r in fixed.items():
        multipliers[r] = -torques[i]
    wrench = torques + support.force(holding)
    for r, arm in zip(others, arms, strict=True):
        wrench = axpy(-multipliers[r], arm, wrench)
    in_order = tuple(multipliers[r] for r in rows)
    return Solution(turning, moving, in_order, wrench, singular, dropped)


def _complement(
    support: Support, scales: _Scales, arms: list[Vec], excess: list[Number]
) -> tuple[Vec, list[tuple[Load, Vec, Vec]], Number, Number]:
    """Return multipliers of rows by the Schur complement on the null space.

    arms : their rows of J.   Also returns each row's load with its α and a, and `singular` and
    `dropped`.
    """
    still = (ZERO,) * len(support.directions)
    loads = [Load(cross_add(arm[3:], support.centre, arm[:3]), arm[3:], arm[:3]) for arm in arms]
    responses = [(each, *support.response(each, ZERO3, still)) for each in loads]
    answers = [turned + moved for _, turned, moved in responses]
    schur = [[dot(arm, answers[j]) for j in range(i + 1)] for i, arm in enumerate(arms)]
    sizes = [scales.of(arm) for arm in arms]
    multipliers, singular, dropped = multipliers_of(
        schur, excess, sizes, lambda i: scales.acceleration(arms[i])
    )
    return multipliers, responses, singular, dropped


def has_others(rows: Rows) -> bool:
    """Return whether any row prescribes neither a component of a nor one of α."""
    return bool(kinds_of(rows)[2])


def kinds_of(rows: Rows) -> tuple[dict[int, Row], dict[int, Row], list[Row]]:
    """Sort rows into those that prescribe a or α along an axis, by axis, and all others.

    An axis has one such row; with `Omega3`, a motor is among the others.
    """
    held: dict[int, Row] = {}
    fixed: dict[int, Row] = {}
    others: list[Row] = []
    for r in rows:
        if r.held_axis is not None and r.held_axis not in held:
            held[r.held_axis] = r
        elif r.fixed_axis is not None and r.fixed_axis not in fixed:
            fixed[r.fixed_axis] = r
        else:
            others.append(r)
    return held, fixed, others


class _Scales:
    """Measure rows and loads in the metric of the inertia about P, its diagonal only."""

    def __init__(
        self, body: BodyConstants, support: Support, load: Load, velocity: Vec | None
    ) -> None:
        c, theta = support.centre, body.inertia
        square = dot(c, c)
        about_point = tuple(fma(body.mass, square - c[i] * c[i], theta[4 * i]) for i in range(3))
        self.mobility = (*(1.0 / x for x in about_point), *(1.0 / body.mass,) * 3)
        self.body, self.support, self.load, self.velocity = body, support, load, velocity

    def of(self, wrench: Vec) -> Number:
        """Return the square of the size of a row or of a wrench."""
        total: Number = ZERO
        for x, easy in zip(wrench, self.mobility, strict=True):
            total = fma(x * x, easy, total)
        return total

    def acceleration(self, arm: Vec) -> Number:
        """Return the bound on the acceleration that load and motion can cause along a row."""
        body, c, load = self.body, self.support.centre, self.load
        forced = sqrt(self.of(cross_add(c, load.force, load.torque) + load.force))
        moved: Number = ZERO
        if self.velocity is not None:
            omega = self.velocity[:3]
            com_velocity = cross_add(omega, c, self.velocity[3:])
            moved = norm(omega) * sqrt(2.0 * kinetic_energy(body, omega, com_velocity))
        return sqrt(self.of(arm)) * (forced + moved)


def multipliers_of(
    schur: list[list[Any]],
    excess: list[Any],
    mobilities: list[Any],
    bound: Callable[[int], Any],
    initial_count: Any = ZERO,
    violation: Callable[[], Any] | None = None,
) -> tuple[tuple[Any, ...], Any, Any]:
    """Solve S λ = J V̇ − η. Return λ, 1 where rows contradict each other, and the number of
    dependent rows, NaN where S is NaN.

    schur : lower triangle of S.   excess : J V̇ − η.
    mobilities : diagonal of S if each row were the only one.
    bound : bound on the acceleration along row i that load and motion can cause.
    initial_count : number of dependent rows at the start.
    violation : δ, violation of the rows by pose and velocity, relative to the mechanism's length
    and speed.

    If the rows are violated, a dependent row has a pivot of δ²/p and a right-hand side of δ/√p, p
    the least pivot that is kept. With a tolerance of δ the first is within δ, the second within √δ.
    """
    first = Elimination(schur, excess, mobilities, PIVOT_TOLERANCE)

    def checked() -> tuple[tuple[Any, ...], Any, Any]:
        contradicts = first.contradicts(bound, CONSISTENCY_TOLERANCE)
        solution = tuple(first.multipliers), contradicts, first.count
        is_open = (initial_count - first.count > 0.5) | (contradicts > 0.5)

        def repeated() -> tuple[tuple[Any, ...], Any, Any]:
            assert violation is not None
            off = maximum(OPEN_PIVOT * violation(), PIVOT_TOLERANCE)
            second = Elimination(schur, excess, mobilities, maximum(off, ROUNDED_PIVOT))
            contradicts = second.contradicts(bound, sqrt(off))
            return where(is_open, (tuple(second.multipliers), contradicts, second.count), solution)

        if violation is None or is_zero(initial_count):
            return solution
        return branch(any_lanes(is_open), repeated, lambda: solution, likely=False)

    multipliers = tuple(first.multipliers)
    if taken_for_granted(first.count <= 0.5):
        return multipliers, ZERO, first.count
    some = first.count if is_zero(initial_count) else maximum(first.count, initial_count)
    independent = multipliers, 0.0, first.count
    return branch(any_lanes(some > 0.5), checked, lambda: independent, likely=False)


class Elimination:
    """Factor S = L D Lᵀ and solve λ = S⁻¹ excess.

    Rows whose pivots in D are within the tolerance are left out.

    Arguments are those of `multipliers_of`.   dropped : 1 for a row that is left out, else 0.
    count : number of rows that are left out.
    """

    def __init__(
        self, schur: list[list[Any]], excess: list[Any], mobilities: list[Any], tolerance: Any
    ) -> None:
        m = len(schur)
        self.lower: list[list[Any]] = []  # L
        self.dropped: list[Any] = []
        self.y: list[Any] = []  # L⁻¹ excess
        scaled: list[list[Any]] = []  # L D
        pivots_inverse: list[Any] = []
        for i in range(m):
            li: list[Any] = []
            si: list[Any] = []
            for j in range(i):
                si.append(less(schur[i][j], li, scaled[j]))
                li.append(si[j] * pivots_inverse[j])
            pivot = less(schur[i][i], li, si)
            self.y.append(less(excess[i], li, self.y))
            # False for NaN, whose row is kept.
            is_dependent = pivot <= tolerance * (schur[i][i] + mobilities[i])
            pivots_inverse.append(where(is_dependent, 0.0, 1.0) / where(is_dependent, 1.0, pivot))
            self.dropped.append(where(is_dependent, 1.0, 0.0 * pivot))
            self.lower.append(li)
            scaled.append(si)
        self.multipliers: list[Any] = [self.y[i] * pivots_inverse[i] for i in range(m)]
        for i in reversed(range(m)):
            for j in range(i):
                self.multipliers[j] = fma(
                    -self.lower[i][j], self.multipliers[i], self.multipliers[j]
                )
        self.count = sum(self.dropped, start=ZERO)

    def contradicts(self, bound: Callable[[int], Any], tolerance: Any) -> Any:
        """Return 1 where a row that is left out contradicts the others, else 0."""
        result: Any = 0.0
        for i, mark in enumerate(self.dropped):
            size = bound(i)
            for lij, yj in zip(self.lower[i], self.y, strict=False):
                size = size + absolute(lij * yj)
            is_contradiction = (mark > 0.5) & (absolute(self.y[i]) > tolerance * size)
            result = where(is_contradiction, 1.0, result)
        return result


def is_other_rank(dropped: Any, before: Any) -> Any:
    """Return whether the number of dependent rows differs from that at the start; false for NaN."""
    return absolute(dropped - before) > 0.5


def less(x: Number, left: list[Number], right: list[Number]) -> Number:
    """Return x − left·right."""
    for a, b in zip(left, right, strict=False):
        x = fma(-a, b, x)
    return x

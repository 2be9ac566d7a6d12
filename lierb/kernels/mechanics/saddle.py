"""The index-1 saddle point  [[M, Jᵀ], [J, 0]] (V̇, λ) = (ad_Vᵀ M V + W, η)  (Müller, eq. index1).

It is solved at the joint's point P, in body axes, for the angular acceleration α and the
acceleration a = Qᵀd̈ of P. There `d` and `Omega` rows, and a motor's speed, prescribe a component of
a or α each, and the body moves in the null space of these rows. Their λ are the components of
f − M V̇ that are missing. Other rows have a Schur complement on that null space.

With c from P to the centre of mass, P held along unit vectors n_h and w_h = c × n_h, the inertia
of a turn is

    K = Θ + m Σ w_h w_hᵀ,   adj K = adj Θ + m Σ ŵ_h Θ ŵ_hᵀ + m² γ c cᵀ,
    det K = det Θ + m Σ w_hᵀ (adj Θ) w_h + m² γ cᵀΘ c,   γ = Σ_{h<k} (c·(n_h × n_k))².

Every term is a sum of nonnegative numbers, so that a small body on a long arm keeps its digits;
about the centre of mass, a Schur complement loses digits like m c²/Θ. The product of c with the
moment of a force at P is zero. It is left out, since the third term of adj K would multiply its
rounding by c²/Θ.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.mechanics.newton_euler import BodyConstants, kinetic_energy
from lierb.kernels.mechanics.rows import Rows
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
    UNIT,
    ZERO3,
    Mat,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    norm,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO, is_zero

# A row whose pivot is this part of its mobility alone depends on the rows before it. Cholesky, LDLᵀ
# and LU without that test return garbage there. Rounding leaves about 1e-15.
PIVOT_TOLERANCE = 1e-12
# The right-hand side of such a row must be as small, or the rows contradict each other.
CONSISTENCY_TOLERANCE = 1e-6
# Where pose and velocity are off the rows by δ, both tolerances are this δ and its root, if larger.
# With a tolerance below the root of rounding, a pivot that is zero may be more than that.
OPEN_PIVOT, ROUNDED_PIVOT = 10.0, 1e-7


class Load(NamedTuple):
    """A wrench in body axes about the centre of mass, and its torque about P.

    `about_point` may leave out terms that are zero, such as c × c.
    """

    torque: Vec
    force: Vec
    about_point: Vec


class Solution(NamedTuple):
    """Solution of the saddle point."""

    turning: Vec  # α
    moving: Vec  # a
    multipliers: Vec  # λ, in the order of the rows
    wrench: Vec  # −Jᵀλ about P
    singular: Number  # 1 where rows contradict each other, else 0
    dropped: Number  # number of rows that depend on others


class Support:
    """A body whose point P is held along some directions, and its turns about some axes.

    held : indices of the ground axes along which P is held.   fixed : body axes about which α is
    prescribed: none, two or all.
    """

    def __init__(
        self, body: BodyConstants, q: Mat, held: tuple[int, ...], fixed: tuple[int, ...]
    ) -> None:
        self.body = body
        self.fixed = fixed
        self.is_point = len(held) == 3  # all directions: body axes serve as well
        self.directions = UNIT if self.is_point else tuple(row(q, i) for i in held)
        self.centre = sub(body.com, body.arm)
        self.levers = tuple(cross(self.centre, n) for n in self.directions)

    def response(self, load: Load, turns: Vec, moves: Vec) -> tuple[Vec, Vec]:
        """Return α and a under a load.

        turns : α about the `fixed` axes.   moves : a along the directions.
        """
        turning = self.turning(load, turns, moves)
        return turning, self.moving(load, turning, moves)

    def holding(self, load: Load, turning: Vec, moves: Vec) -> Vec:
        """Forces that hold P, along the directions."""
        return tuple(
            fma(self.body.mass, dot(turning, w) + move, -dot(n, load.force))
            for n, w, move in zip(self.directions, self.levers, moves, strict=True)
        )

    def torques(self, load: Load, turning: Vec, holding: Vec) -> Vec:
        """Torques about the fixed body axes; structurally zero about the others."""
        missing = sub(mat_vec(self.body.inertia, turning), load.torque)
        for w, force in zip(self.levers, holding, strict=True):
            missing = axpy(force, w, missing)
        return tuple(x if i in self.fixed else ZERO for i, x in enumerate(missing))

    def force(self, holding: Vec) -> Vec:
        """Sum of the forces that hold P, as a vector."""
        total = ZERO3
        for n, size in zip(self.directions, holding, strict=True):
            total = add(total, scale(size, n))
        return total

    def turning(self, load: Load, turns: Vec, moves: Vec) -> Vec:
        """Return α under a load."""
        mass = self.body.mass
        if len(self.fixed) == 3:
            return turns
        if self.is_point:
            pushes: Vec = ()
            torque = cross_add(scale(mass, moves), self.centre, load.about_point)
        else:
            pushes = tuple(
                fma(-mass, move, dot(n, load.force))
                for n, move in zip(self.directions, moves, strict=True)
            )
            torque = load.torque
            for push, w in zip(pushes, self.levers, strict=True):
                torque = axpy(push, w, torque)
        if self.fixed:
            return self._about_one_axis(torque, turns)
        return self._about_all(load, torque, pushes)

    def _about_one_axis(self, torque: Vec, turns: Vec) -> Vec:
        (axis,) = {0, 1, 2} - set(self.fixed)
        rest = torque[axis]
        for other in self.fixed:
            rest = fma(-self._inertia(axis, other), turns[other], rest)
        alpha = rest * (1.0 / self._inertia(axis, axis))
        return tuple(alpha if i == axis else turns[i] for i in range(3))

    def _inertia(self, i: int, j: int) -> Any:
        """Return K_ij."""
        sides: Any = ZERO
        for w in self.levers:
            sides = fma(w[i], w[j], sides)
        return fma(self.body.mass, sides, self.body.inertia[3 * i + j])

    def _about_all(self, load: Load, torque: Vec, pushes: Vec) -> Vec:
        """Return K⁻¹ torque, where torque = load.torque + Σ push w."""
        theta, c, mass = self.body.inertia, self.centre, self.body.mass
        along = dot(c, load.torque)  # c·w is zero
        if not self.levers:
            return mat_vec(self.body.inertia_inverse, torque)
        if self.is_point:  # constant: LLVM makes these once a block
            spread, slender = self._point_inverse
            return axpy(slender * along, c, mat_vec(spread, torque))
        adjugate = adjugate_symmetric(theta)
        turning = mat_vec(adjugate, torque)  # times det K
        size = dot(row(theta, 0), row(adjugate, 0))
        for i, w in enumerate(self.levers):
            crossed = cross(load.torque, w)
            for j, push in enumerate(pushes):
                if i != j:  # w × w is zero
                    crossed = axpy(push, cross(self.levers[j], w), crossed)
            turning = axpy(mass, cross(w, mat_vec(theta, crossed)), turning)
            size = fma(mass, dot(w, mat_vec(adjugate, w)), size)
        if len(self.levers) == 2:
            height = mass * dot(c, cross(*self.directions))
            gamma = height * height
            turning = axpy(gamma * along, c, turning)
            size = fma(gamma, dot(c, mat_vec(theta, c)), size)
        return scale(1.0 / size, turning)

    @cached_property
    def _point_inverse(self) -> tuple[Mat, Any]:
        """Return S and κ of K⁻¹ = S + κ c cᵀ, for P held in all directions.

        S = (adj Θ + m((cᵀΘc) I − Θc cᵀ − c(Θc)ᵀ))/det K,   κ = m(m c² + tr Θ)/det K.
        """
        theta, c, mass = self.body.inertia, self.centre, self.body.mass
        y = mat_vec(theta, c)
        s, square, trace = dot(c, y), dot(c, c), theta[0] + theta[4] + theta[8]
        adjugate = adjugate_symmetric(theta)
        apart = square * (adjugate[0] + adjugate[4] + adjugate[8]) - dot(c, mat_vec(adjugate, c))
        heavy = mass * square
        size = dot(row(theta, 0), row(adjugate, 0)) + mass * fma(heavy, s, apart)
        inverse = 1.0 / size
        spread = tuple(
            inverse
            * fma(
                mass,
                (s if i == j else ZERO) - fma(y[i], c[j], c[i] * y[j]),
                adjugate[3 * i + j],
            )
            for i in range(3)
            for j in range(3)
        )
        return spread, inverse * (mass * (heavy + trace))

    def moving(self, load: Load, turning: Vec, moves: Vec) -> Vec:
        """Return a under a load, given α."""
        if self.is_point:
            return moves
        falling = axpy(1.0 / self.body.mass, load.force, cross(self.centre, turning))
        if len(self.directions) < 2:
            for n, move in zip(self.directions, moves, strict=True):
                falling = axpy(move - dot(n, falling), n, falling)
            return falling
        free = cross(*self.directions)
        moving = scale(dot(free, falling), free)
        for n, move in zip(self.directions, moves, strict=True):
            moving = axpy(move, n, moving)
        return moving


def adjugate_symmetric(m: Mat) -> Mat:
    """Return det(m) m⁻¹."""
    x, y, z = row(m, 0), row(m, 1), row(m, 2)
    return cross(y, z) + cross(z, x) + cross(x, y)


def solve(
    body: BodyConstants,
    q: Mat,
    rows: Rows,
    jacobian: Callable[[Any], Vec],
    eta: tuple[Any, ...],
    load: Load,
    velocity: Vec | None = None,
    turning: Vec | None = None,
) -> Solution:
    """Solve the saddle point of some rows  (Müller, eq. index1).

    A step of a body that turns about a point freely evaluates α by Euler's equations,
    `newton_euler.spinning`; a step on a subgroup joint evaluates `subgroup.momentum_rate`, which
    has the same solution.

    jacobian : row of J at P, in body axes.   eta : η of the rows at α = 0, a = 0.
    velocity : (ω, velocity of P), which scales the contradiction of dropped rows.
    turning : α without the rows beside the null space, where it is known.
    """
    asked = dict(zip(rows, eta, strict=True))
    held, fixed, others = kinds_of(rows)
    support = Support(body, q, tuple(held), tuple(fixed))
    moves = tuple(asked[held[i]] for i in held)
    if support.is_point:
        moves = mat_t_vec(q, tuple(asked[held[i]] for i in range(3)))
    turns = tuple(asked[fixed[i]] if i in fixed else ZERO for i in range(3))

    if turning is None:
        turning = support.turning(load, turns, moves)
    moving = support.moving(load, turning, moves)
    total, found = load, {}
    singular: Any = ZERO
    dropped: Any = ZERO
    arms = [jacobian(r) for r in others]
    if others:
        still = (ZERO,) * len(moves)
        loads = [
            Load(cross_add(arm[3:], support.centre, arm[:3]), arm[3:], arm[:3]) for arm in arms
        ]
        responses = [support.response(each, ZERO3, still) for each in loads]
        excess = [
            dot(arm, turning + moving) - asked[r] for r, arm in zip(others, arms, strict=True)
        ]
        scales = _Scales(body, support, load, velocity)
        answers = [turned + shifted for turned, shifted in responses]
        schur = [[dot(arm, answers[j]) for j in range(i + 1)] for i, arm in enumerate(arms)]
        sizes = [scales.of(arm) for arm in arms]
        multipliers, singular, dropped = multipliers_of(
            schur, excess, sizes, lambda i: scales.acceleration(arms[i])
        )
        for r, size, each, (turned, moved) in zip(
            others, multipliers, loads, responses, strict=True
        ):
            turning, moving = axpy(-size, turned, turning), axpy(-size, moved, moving)
            total = Load(*(axpy(-size, x, y) for x, y in zip(each, total, strict=True)))
            found[r] = size
    holding = support.holding(total, turning, moves)
    torques = support.torques(total, turning, holding)
    forces = mat_vec(q, holding) if support.is_point else holding
    for size, i in zip(forces, range(3) if support.is_point else held, strict=True):
        found[held[i]] = -size
    for i, r in fixed.items():
        found[r] = -torques[i]
    wrench = torques + support.force(holding)
    for r, arm in zip(others, arms, strict=True):
        wrench = axpy(-found[r], arm, wrench)
    return Solution(turning, moving, tuple(found[r] for r in rows), wrench, singular, dropped)


def has_others(rows: Rows) -> bool:
    """Return whether some row prescribes neither a component of a nor one of α."""
    return bool(kinds_of(rows)[2])


def kinds_of(rows: Rows) -> tuple[dict[int, Any], dict[int, Any], list[Any]]:
    """Sort rows into those that prescribe a or α along an axis, by axis, and all others.

    An axis has one such row: a motor beside `Omega3` is one of the others.
    """
    held: dict[int, Any] = {}
    fixed: dict[int, Any] = {}
    others = []
    for r in rows:
        if r.held_axis is not None and r.held_axis not in held:
            held[r.held_axis] = r
        elif r.fixed_axis is not None and r.fixed_axis not in fixed:
            fixed[r.fixed_axis] = r
        else:
            others.append(r)
    return held, fixed, others


class _Scales:
    """Sizes of rows and loads in the metric of the inertia about P that each axis has alone."""

    def __init__(
        self, body: BodyConstants, support: Support, load: Load, velocity: Vec | None
    ) -> None:
        c, theta = support.centre, body.inertia
        square = dot(c, c)
        about_point = tuple(fma(body.mass, square - c[i] * c[i], theta[4 * i]) for i in range(3))
        self.mobility = (*(1.0 / x for x in about_point), *(1.0 / body.mass,) * 3)
        self.body, self.support, self.load, self.velocity = body, support, load, velocity

    def of(self, wrench: Vec) -> Any:
        """Square of the size of a row or of a wrench."""
        total: Any = ZERO
        for x, easy in zip(wrench, self.mobility, strict=True):
            total = fma(x * x, easy, total)
        return total

    def acceleration(self, arm: Vec) -> Any:
        """Bound on the acceleration of a row by load and motion."""
        body, c, load = self.body, self.support.centre, self.load
        forced = sqrt(self.of(cross_add(c, load.force, load.torque) + load.force))
        moved: Any = ZERO
        if self.velocity is not None:
            omega = self.velocity[:3]
            com_velocity = cross_add(omega, c, self.velocity[3:])
            moved = norm(omega) * sqrt(2.0 * kinetic_energy(body, omega, com_velocity))
        return sqrt(self.of(arm)) * (forced + moved)


def multipliers_of(
    schur: list[list[Any]],
    excess: list[Any],
    sizes: list[Any],
    brought: Callable[[int], Any],
    before: Any = ZERO,
    openness: Callable[[], Any] | None = None,
) -> tuple[tuple[Any, ...], Any, Any]:
    """λ of S λ = J V̇ − η; whether rows contradict each other; how many depend on others, NaN where
    S is NaN.

    schur : the lower triangle of S.   excess : J V̇ − η.   sizes : of S's diagonal, were each row
    alone.   brought : the acceleration of row i that load and motion could bring about.
    before : how many rows depended on others at the start.   openness : δ, how far pose and
    velocity are off the rows, in units of the mechanism's own length and speed.

    Off the rows, what depends on others has a pivot of δ² over the least one that is kept, and a
    right-hand side of δ over its root. With a tolerance of δ the first is within it, and the second
    within its root.
    """
    first = _Elimination(schur, excess, sizes, PIVOT_TOLERANCE)

    def chosen() -> tuple[tuple[Any, ...], Any, Any]:
        contradicts = first.contradicts(brought, CONSISTENCY_TOLERANCE)
        found = tuple(first.multipliers), contradicts, first.count
        is_open = (before - first.count > 0.5) | (contradicts > 0.5)

        def again() -> tuple[tuple[Any, ...], Any, Any]:
            assert openness is not None
            off = maximum(OPEN_PIVOT * openness(), PIVOT_TOLERANCE)
            second = _Elimination(schur, excess, sizes, maximum(off, ROUNDED_PIVOT))
            contradicts = second.contradicts(brought, sqrt(off))
            return where(is_open, (tuple(second.multipliers), contradicts, second.count), found)

        if openness is None or is_zero(before):
            return found
        return branch(any_lanes(is_open), again, lambda: found, likely=False)

    multipliers = tuple(first.multipliers)
    if taken_for_granted(first.count <= 0.5):
        return multipliers, ZERO, first.count
    some = first.count if is_zero(before) else maximum(first.count, before)
    independent = multipliers, 0.0, first.count
    found: tuple[tuple[Any, ...], Any, Any] = branch(
        any_lanes(some > 0.5), chosen, lambda: independent, likely=False
    )
    return found


class _Elimination:
    """S = L D Lᵀ and λ = S⁻¹ excess, without rows whose pivots in D are within the tolerance.

    Arguments as of `multipliers_of`.   count : of rows that are left out.
    """

    def __init__(
        self, schur: list[list[Any]], excess: list[Any], sizes: list[Any], tolerance: Any
    ) -> None:
        m = len(schur)
        self.lower: list[list[Any]] = []  # L
        self.dropped: list[Any] = []  # 1 for a row that is left out, else 0
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
            goes = pivot <= tolerance * (schur[i][i] + sizes[i])  # false for NaN, which stays
            pivots_inverse.append(where(goes, 0.0, 1.0) / where(goes, 1.0, pivot))
            self.dropped.append(where(goes, 1.0, 0.0 * pivot))
            self.lower.append(li)
            scaled.append(si)
        self.multipliers: list[Any] = [self.y[i] * pivots_inverse[i] for i in range(m)]
        for i in reversed(range(m)):
            for j in range(i):
                self.multipliers[j] = fma(
                    -self.lower[i][j], self.multipliers[i], self.multipliers[j]
                )
        self.count = sum(self.dropped, start=ZERO)

    def contradicts(self, brought: Callable[[int], Any], tolerance: Any) -> Any:
        """1 where a row that is left out contradicts the others, else 0."""
        found: Any = 0.0
        for i, mark in enumerate(self.dropped):
            size = brought(i)
            for lij, yj in zip(self.lower[i], self.y, strict=False):
                size = size + absolute(lij * yj)
            contradicts = (mark > 0.5) & (absolute(self.y[i]) > tolerance * size)
            found = where(contradicts, 1.0, found)
        return found


def is_other_rank(dropped: Any, before: Any) -> Any:
    """Whether another number of rows depend on others than at the start; not where that is NaN."""
    return absolute(dropped - before) > 0.5


def less(x: Any, left: list[Any], right: list[Any]) -> Any:
    """Return x − left·right."""
    for a, b in zip(left, right, strict=False):
        x = fma(-a, b, x)
    return x

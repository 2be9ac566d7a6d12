"""Compute the motion of a body under a load, its joint point P held along some directions.

Let c be the vector from P to the centre of mass, n_h the unit vectors along which P is held, and
w_h = c × n_h. The inertia of a rotation is

    K = Θ + m Σ w_h w_hᵀ,   adj K = adj Θ + m Σ ŵ_h Θ ŵ_hᵀ + m² γ c cᵀ,
    det K = det Θ + m Σ w_hᵀ (adj Θ) w_h + m² γ cᵀΘ c,   γ = Σ_{h<k} (c·(n_h × n_k))².

Every term is a sum of nonnegative numbers, so that no digits cancel for a small body on a long arm.
A Schur complement about the centre of mass would lose digits like m c²/Θ. The product of c with the
moment of a force at P is zero and is omitted: the third term of adj K would multiply its rounding
by c²/Θ.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.numbers.arithmetic import fma
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
    mat_vec,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO


class Load(NamedTuple):
    """A load is a wrench in body axes about the centre of mass, and its torque about P.

    `about_point` may leave out terms that are zero, such as c × c.
    """

    torque: Vec
    force: Vec
    about_point: Vec


class Support:
    """A body's point P is held along some directions, and its rotation about some axes.

    held : indices of the ground axes along which P is held.   fixed : body axes about which α is
    prescribed: none, two or all.
    """

    def __init__(
        self, body: BodyConstants, q: Mat, held: tuple[int, ...], fixed: tuple[int, ...]
    ) -> None:
        self.body = body
        self.fixed = fixed
        self.is_point = len(held) == 3  # all directions: body axes can be used as well
        self.directions = UNIT if self.is_point else tuple(row(q, i) for i in held)
        self.centre = sub(body.com, body.arm)
        self.levers = tuple(cross(self.centre, n) for n in self.directions)

    def response(self, load: Load, turns: Vec, moves: Vec) -> tuple[Vec, Vec]:
        """Return α and a under a load.

        turns : α about the `fixed` axes.   moves : a along the directions of P.
        """
        turning = self.turning(load, turns, moves)
        return turning, self.moving(load, turning, moves)

    def holding(self, load: Load, turning: Vec, moves: Vec) -> Vec:
        """Return the forces that hold P, one along each direction."""
        return tuple(
            fma(self.body.mass, dot(turning, w) + move, -dot(n, load.force))
            for n, w, move in zip(self.directions, self.levers, moves, strict=True)
        )

    def torques(self, load: Load, turning: Vec, holding: Vec) -> Vec:
        """Return the torques about the fixed body axes; structural zeros about the others."""
        missing = sub(mat_vec(self.body.inertia, turning), load.torque)
        for w, force in zip(self.levers, holding, strict=True):
            missing = axpy(force, w, missing)
        return tuple(x if i in self.fixed else ZERO for i, x in enumerate(missing))

    def force(self, holding: Vec) -> Vec:
        """Return the sum of the forces that hold P, as a vector."""
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

    def _inertia(self, i: int, j: int) -> Number:
        """Return K_ij."""
        sides: Number = ZERO
        for w in self.levers:
            sides = fma(w[i], w[j], sides)
        return fma(self.body.mass, sides, self.body.inertia[3 * i + j])

    def _about_all(self, load: Load, torque: Vec, pushes: Vec) -> Vec:
        """Return K⁻¹ torque, where torque = load.torque + Σ push w."""
        theta, c, mass = self.body.inertia, self.centre, self.body.mass
        along = dot(c, load.torque)  # c·w is zero
        if not self.levers:
            return mat_vec(self.body.inertia_inverse, torque)
        if self.is_point:  # constant: LLVM computes these once per block
            spread, slender = self._point_inverse
            return axpy(slender * along, c, mat_vec(spread, torque))
        adjugate = adjugate_symmetric(theta)
        turning = mat_vec(adjugate, torque)  # α times det K
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

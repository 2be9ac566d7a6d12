"""The index-1 saddle point  [[M, Jᵀ], [J, 0]] (V̇, λ) = (ad_Vᵀ M V + W, η)  (Müller, eq. index1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.arithmetic import absolute, any_lanes, branch, fma, sqrt, where
from lierb.kernels.newton_euler import Body, kinetic_energy, row_response
from lierb.kernels.vec import Vec, axpy, cross_add, dot, norm
from lierb.kernels.zero import ZERO

# A row whose pivot has shrunk to this part of its diagonal depends on the rows before it: plain
# Cholesky, LDLᵀ and LU all return garbage there. Rounding leaves about 1e-15.
PIVOT_TOLERANCE = 1e-12
# Its right-hand side must have shrunk likewise, or the rows contradict each other.
CONSISTENCY_TOLERANCE = 1e-6


def solve(
    body: Body, rows: list[Vec], eta: list[Any], free: Vec, velocity: Vec | None = None
) -> tuple[Vec, tuple[Any, ...], Any]:
    """V̇, λ and a mask of singular bodies, from J, η and the free acceleration M⁻¹(ad_Vᵀ M V + W).

    velocity : V, for the scale on which a dropped row's contradiction is judged.

    Schur complement S = J M⁻¹ Jᵀ, factored as L D Lᵀ: no square roots, and no row units.
    """
    m = len(rows)
    responses = [row_response(body, row) for row in rows]
    schur = [[dot(rows[i], responses[j]) for j in range(i + 1)] for i in range(m)]
    rhs = [dot(rows[i], free) - eta[i] for i in range(m)]
    lower: list[list[Any]] = []  # L
    scaled: list[list[Any]] = []  # L D
    pivots_inverse: list[Any] = []
    dropped: list[Any] = []
    y: list[Any] = []  # L⁻¹ rhs
    for i in range(m):
        li: list[Any] = []
        si: list[Any] = []
        for j in range(i):
            si.append(_reduced(schur[i][j], li, scaled[j]))
            li.append(si[j] * pivots_inverse[j])
        pivot = _reduced(schur[i][i], li, si)
        y.append(_reduced(rhs[i], li, y))
        kept = pivot > PIVOT_TOLERANCE * schur[i][i]
        pivots_inverse.append(where(kept, 1.0, 0.0) / where(kept, pivot, 1.0))
        dropped.append(pivot <= PIVOT_TOLERANCE * schur[i][i])
        lower.append(li)
        scaled.append(si)
    multipliers: list[Any] = [y[i] * pivots_inverse[i] for i in range(m)]
    for i in reversed(range(m)):
        for j in range(i):
            multipliers[j] = fma(-lower[i][j], multipliers[i], multipliers[j])
    acceleration = free
    for multiplier, response in zip(multipliers, responses, strict=True):
        acceleration = axpy(-multiplier, response, acceleration)

    def motion(i: int) -> Any:
        """The acceleration of row i that the motion itself can bring about, ‖ω‖ √(S_ii VᵀMV)."""
        if velocity is None:
            return ZERO
        omega = velocity[:3]
        com_velocity = cross_add(omega, body.com, velocity[3:])
        energy = 2.0 * kinetic_energy(body, omega, com_velocity)
        return sqrt(schur[i][i] * energy) * norm(omega)

    return acceleration, tuple(multipliers), _contradicts(dropped, rhs, lower, y, motion)


def _reduced(x: Any, left: list[Any], right: list[Any]) -> Any:
    """x − left·right."""
    for a, b in zip(left, right, strict=False):
        x = fma(-a, b, x)
    return x


def _contradicts(
    dropped: list[Any],
    rhs: list[Any],
    lower: list[list[Any]],
    y: list[Any],
    motion: Callable[[int], Any],
) -> Any:
    """1 where a dropped row asks for what the rows before it exclude, 0 elsewhere."""
    if not rhs:
        return ZERO
    some = dropped[0]
    for mask in dropped[1:]:
        some = some | mask

    def look() -> Any:
        found: Any = 0.0
        for i, mask in enumerate(dropped):
            size = absolute(rhs[i]) + motion(i)
            for lij, yj in zip(lower[i], y, strict=False):
                size = size + absolute(lij * yj)
            found = where(mask & (absolute(y[i]) > CONSISTENCY_TOLERANCE * size), 1.0, found)
        return found

    return branch(any_lanes(some), look, lambda: 0.0, likely=False)

"""If a joint's motions are a subgroup H of SE(3), velocities are coordinates of its algebra.

The momentum μ = NᵀMV is integrated. A Runge–Kutta method takes the same steps in μ as in V, its
linear image; a stage computes V = N(NᵀMN)⁻¹μ but not M V.

In joint axes the algebra of every such joint is spanned by unit vectors, for a screw with one
combination of two. *Slots* represent V = N ν, one for each of the six components of V: the index of
its coordinate in ν; PITCHED if the pitch determines it; FIXED if it is structurally zero. With
these zeros in V the general SE(3) formulas reduce to those of H, so that no H needs its own code.
"""

from __future__ import annotations

import itertools

from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.mechanics.rows import FIXED, PITCHED, Rows
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import Vec, add, dot, units
from lierb.kernels.numbers.zero import ZERO

Slots = tuple[int, ...]


def slots_of(rows: Rows) -> Slots:
    """Return the slots of (ω, v): index of each component's coordinate, or FIXED or PITCHED."""
    bound = dict(r.slot for r in rows if r.slot)
    free = itertools.count()
    return tuple(bound[i] if i in bound else next(free) for i in range(6))


def is_commutative(slots: Slots) -> bool:
    """Return whether all motions of H commute: it does not turn, or about and along one axis."""
    turns, slides = slots[:3], slots[3:]
    if turns == (FIXED,) * 3:
        return True
    return turns[:2] == (FIXED, FIXED) and slides[:2] == (FIXED, FIXED)


def lifted(slots: Slots, nu: Vec, pitch: Number) -> Vec:
    """Return V = N ν, with structural zeros."""
    components: list[Number] = [nu[slot] if slot >= 0 else ZERO for slot in slots]
    if PITCHED in slots:
        components[5] = pitch * components[2]
    return tuple(components)


def coordinates(slots: Slots, velocity: Vec) -> Vec:
    """Return the coordinates ν of V = N ν."""
    return tuple(v for slot, v in zip(slots, velocity, strict=True) if slot >= 0)


def in_subalgebra(slots: Slots, velocity: Vec, pitch: Number) -> Vec:
    """Project V, in the algebra up to rounding, onto the algebra, with its structural zeros."""
    return lifted(slots, coordinates(slots, velocity), pitch)


def projected(slots: Slots, wrench: Vec, pitch: Number) -> Vec:
    """Return Nᵀ f as a wrench: each number in its coordinate's slot, and structural zeros.

    On the algebra the result is the same covector as f. A second projection changes nothing.
    """
    parts = [x if slot >= 0 else ZERO for slot, x in zip(slots, wrench, strict=True)]
    if PITCHED in slots:
        parts[2] = fma(pitch, wrench[5], wrench[2])
    return tuple(parts)


def reduced_inertia(slots: Slots, body: BodyConstants) -> list[list[Number]]:
    """Return Nᵀ M N, from the momenta M N e_j."""
    velocities = (lifted(slots, unit, body.pitch) for unit in units(max(slots) + 1))
    columns = (coordinates(slots, momentum_of(slots, body, v)) for v in velocities)
    return [list(row) for row in zip(*columns, strict=True)]


def inverse(matrix: list[list[Number]]) -> Vec:
    """Invert a symmetric positive definite matrix, row by row, by Gauss–Jordan elimination.

    The result is symmetric to the last bit, so that half of it is stored.
    """
    n = len(matrix)
    rows = [list(row) + [1.0 if i == j else ZERO for j in range(n)] for i, row in enumerate(matrix)]
    for i in range(n):
        scale = 1.0 / rows[i][i]
        rows[i] = [scale * x for x in rows[i]]
        for k in range(n):
            if k != i:
                factor = rows[k][i]
                rows[k] = [fma(-factor, x, y) for x, y in zip(rows[i], rows[k], strict=True)]
    return tuple(rows[min(i, j)][n + max(i, j)] for i in range(n) for j in range(n))


def momentum_of(slots: Slots, body: BodyConstants, velocity: Vec) -> Vec:
    """Return μ = Nᵀ M V in the form of `projected`."""
    return projected(slots, body.momentum(velocity), body.pitch)


def velocity_of(slots: Slots, body: BodyConstants, momentum: Vec) -> Vec:
    """Return V = N (NᵀMN)⁻¹ μ."""
    parts = coordinates(slots, momentum)
    n = len(parts)
    nu = tuple(dot(body.gain[n * i : n * i + n], parts) for i in range(n))
    return lifted(slots, nu, body.pitch)


def momentum_rate(
    slots: Slots, body: BodyConstants, fall: Vec, applied: Vec, velocity: Vec, momentum: Vec
) -> Vec:
    """Return μ̇ = Nᵀ (ad_Vᵀ μ + W), Euler–Poincaré's equation on H  (Müller, eqs. 1 and 3a).

    This is Nᵀ times `BodyConstants.wrench`. With the constant inverse of NᵀMN, it gives the
    solution of `saddle.solve`. μ can replace M V, since their difference does no work on H's
    algebra, which contains V, N w and so [V, N w].

    fall : gravity in body axes.   applied : wrench of all other forces.
    """
    wrench = add(body.wrench(fall, velocity, momentum), applied)
    return projected(slots, wrench, body.pitch)


def on_subgroup(slots: Slots, chart: Chart) -> Chart:
    """Project a pose onto H; its components off H become structural zeros and ones."""
    p, d = chart
    if slots[:3] == (FIXED, FIXED, FIXED):
        p = (1.0, ZERO, ZERO, ZERO)
    return (
        (p[0], *(x if slot != FIXED else ZERO for x, slot in zip(p[1:], slots[:3], strict=True))),
        tuple(x if slot != FIXED else ZERO for x, slot in zip(d, slots[3:], strict=True)),
    )

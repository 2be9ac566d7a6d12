"""3-vectors and 3×3 matrices are tuples: (x, y, z) and the nine entries row by row.

Two chained cross products take 2.7 ns on tuples, 117 ns on small arrays.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.numbers.arithmetic import absolute, fma, sqrt, where
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.zero import ZERO

Vec = tuple[Any, ...]  # up to six numbers
Mat = tuple[Any, ...]  # nine numbers, row by row

ZERO3: Vec = (ZERO, ZERO, ZERO)
ZERO6: Vec = ZERO3 + ZERO3
ZERO9: Mat = ZERO6 + ZERO3
UNIT: tuple[Vec, ...] = ((1.0, ZERO, ZERO), (ZERO, 1.0, ZERO), (ZERO, ZERO, 1.0))
IDENTITY: Mat = UNIT[0] + UNIT[1] + UNIT[2]
JACOBI_SWEEPS = 4  # off-diagonal entries fall to 3e-25, to 1e-6 after three


def units(n: int) -> tuple[Vec, ...]:
    """Return the columns of the identity."""
    return tuple(tuple(1.0 if i == j else ZERO for i in range(n)) for j in range(n))


def add(a: Vec, b: Vec) -> Vec:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def sub(a: Vec, b: Vec) -> Vec:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def neg(a: Vec) -> Vec:
    return tuple(-x for x in a)


def scale(s: Number, a: Vec) -> Vec:
    return tuple(s * x for x in a)


def axpy(s: Number, a: Vec, b: Vec) -> Vec:
    """Return s a + b."""
    return tuple(fma(s, x, y) for x, y in zip(a, b, strict=True))


def dot(a: Vec, b: Vec) -> Any:
    total = a[-1] * b[-1]
    for x, y in zip(a[-2::-1], b[-2::-1], strict=True):
        total = fma(x, y, total)
    return total


def norm(a: Vec) -> Any:
    return sqrt(dot(a, a))


def cross(a: Vec, b: Vec) -> Vec:
    return (
        fma(a[1], b[2], -(a[2] * b[1])),
        fma(a[2], b[0], -(a[0] * b[2])),
        fma(a[0], b[1], -(a[1] * b[0])),
    )


def cross_add(a: Vec, b: Vec, c: Vec) -> Vec:
    """Return a × b + c."""
    return (
        fma(a[1], b[2], fma(-a[2], b[1], c[0])),
        fma(a[2], b[0], fma(-a[0], b[2], c[1])),
        fma(a[0], b[1], fma(-a[1], b[0], c[2])),
    )


def diagonal(entries: Vec) -> Mat:
    x, y, z = entries
    return (x, ZERO, ZERO, ZERO, y, ZERO, ZERO, ZERO, z)


def skew(a: Vec) -> Mat:
    """Return â, the matrix with â b = a × b."""
    x, y, z = a
    return (ZERO, -z, y, z, ZERO, -x, -y, x, ZERO)


def axial(m: Mat) -> Vec:
    """Return the vector a of the skew part â of a matrix."""
    return tuple(0.5 * (m[3 * k + j] - m[3 * j + k]) for j, k in ((1, 2), (2, 0), (0, 1)))


def row(m: Mat, i: int) -> Vec:
    return m[3 * i : 3 * i + 3]


def column(m: Mat, j: int) -> Vec:
    return m[j::3]


def transpose(m: Mat) -> Mat:
    return m[0::3] + m[1::3] + m[2::3]


def mat_vec(m: Mat, a: Vec) -> Vec:
    return tuple(dot(row(m, i), a) for i in range(3))


def mat_vec_add(m: Mat, a: Vec, c: Vec) -> Vec:
    """Return m a + c."""
    x, y, z = a
    return tuple(
        fma(m[3 * i], x, fma(m[3 * i + 1], y, fma(m[3 * i + 2], z, c[i]))) for i in range(3)
    )


def mat_t_vec(m: Mat, a: Vec) -> Vec:
    """Return mᵀ a."""
    return tuple(dot(column(m, j), a) for j in range(3))


def mat_mat(m: Mat, n: Mat) -> Mat:
    return tuple(dot(row(m, i), column(n, j)) for i in range(3) for j in range(3))


def mat_t_mat(m: Mat, n: Mat) -> Mat:
    """Return mᵀ n."""
    return tuple(dot(column(m, i), column(n, j)) for i in range(3) for j in range(3))


def mat_mat_t(m: Mat, n: Mat) -> Mat:
    """Return m nᵀ."""
    return tuple(dot(row(m, i), row(n, j)) for i in range(3) for j in range(3))


def inverse_symmetric(m: Mat) -> Mat:
    """Invert a symmetric positive definite matrix by LDLᵀ, in which no cofactors cancel.

    The inverse of a diagonal or graded matrix is accurate even if its principal values differ by
    many orders. For a tilted matrix the condition number multiplies the error, as in any method.
    """
    d0 = m[0]
    l10, l20 = m[3] / d0, m[6] / d0
    d1 = fma(-l10, m[3], m[4])
    e = fma(-l20, m[3], m[7])
    l21 = e / d1
    d2 = fma(-l21, e, fma(-l20, m[6], m[8]))
    # columns of L⁻¹: (1, −l10, k20), (0, 1, −l21), (0, 0, 1)
    k20 = fma(l10, l21, -l20)
    i0, i1, i2 = 1.0 / d0, 1.0 / d1, 1.0 / d2
    b, c = -(l10 * i1), k20 * i2
    xx = fma(k20, c, fma(-l10, b, i0))
    xy = fma(-l21, c, b)
    yy = fma(l21 * l21, i2, i1)
    yz = -(l21 * i2)
    return (xx, xy, c, xy, yy, yz, c, yz, i2)


def principal_axes(m: Mat, shift: Vec = ZERO3) -> tuple[Vec, Mat]:
    """Return the eigenvalues of a symmetric m + diag(shift), minus the shift, and eigenvectors.

    The eigenvectors are the columns of a rotation, in the order of the eigenvalues. Jacobi
    rotations are limited to 45°, so that the axes of a diagonal matrix stay in order. Entries of m
    that are small compared with the shift keep their digits.
    """
    a = [list(row(m, i)) for i in range(3)]
    axes = [list(row(IDENTITY, i)) for i in range(3)]
    for p, q in JACOBI_SWEEPS * ((0, 1), (0, 2), (1, 2)):
        aside = a[p][q]
        apart = (shift[q] - shift[p]) + (a[q][q] - a[p][p])
        twice = 2.0 * aside  # apart/twice = cot(2 × angle)
        size = absolute(apart) + sqrt(fma(apart, apart, twice * twice))
        t = twice / where(size > 0.0, size, 1.0)
        t = where(apart < 0.0, -t, t)
        c = 1.0 / sqrt(fma(t, t, 1.0))
        s = t * c
        a[p][p], a[q][q] = fma(-t, aside, a[p][p]), fma(t, aside, a[q][q])
        a[p][q] = a[q][p] = 0.0
        r = 3 - p - q
        a[r][p], a[r][q] = _turned(c, s, a[r][p], a[r][q])
        a[p][r], a[q][r] = a[r][p], a[r][q]
        for line in axes:
            line[p], line[q] = _turned(c, s, line[p], line[q])
    return (a[0][0], a[1][1], a[2][2]), tuple(x for line in axes for x in line)


def axes_along(a: Vec) -> Mat:
    """Return a rotation whose first column is along a nonzero vector."""
    u = scale(1.0 / norm(a), a)
    flat = absolute(u[0]) < 0.9  # otherwise u is near e₁, and e₂ is used
    aside = where(flat, 1.0, 0.0), where(flat, 0.0, 1.0), 0.0
    v = axpy(-dot(u, aside), u, aside)
    v = scale(1.0 / norm(v), v)
    w = cross(u, v)
    return tuple(x for line in zip(u, v, w, strict=True) for x in line)


def _turned(c: Number, s: Number, x: Number, y: Number) -> tuple[Number, Number]:
    return fma(c, x, -(s * y)), fma(s, x, c * y)

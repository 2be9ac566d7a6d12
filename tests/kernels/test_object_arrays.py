"""NumPy on traced numbers: what a function of the user's computes is what NumPy does."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

import lierb
from lierb.kernels.functions import numpy_functions
from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.object_arrays import UntraceableError, has_traced, numbers
from lierb.kernels.functions.user_number import UserNumber, raw
from lierb.kernels.tracing.trace import trial

RNG = np.random.default_rng(1)
GIVEN = {"t": 0.7, "R": RNG.normal(size=(3, 3)), "r": RNG.normal(size=3), "v": RNG.normal(size=3)}
FIVE = np.diag(np.arange(1.0, 6.0))

LIKE_NUMPY = """
r.sum() ; R.sum() ; R.sum(axis=0) ; r.mean() ; R.mean() ; r.std() ; np.var(r) ; R.real @ r + r.imag ; np.prod(R) ; R.max() ; r.min()
np.max(R, axis=1) ; np.min(r) ; np.ptp(r) ; np.average(r, weights=[1.0, 2.0, 3.0]) ; np.cumsum(r) ; np.diff(r)
r.dot(v) ; np.dot(R, r) ; np.inner(r, v) ; np.vdot(r, v) ; np.outer(r, v) ; np.tensordot(R, r, 1) ; np.kron(r, v)
np.cross(r, v) ; np.cross([t, 1.0, 2.0], [1.0, 2.0, 3.0]) ; np.cross(R, r, axisc=0) ; np.cross(R, R @ R, axis=0)
np.einsum("ij,jk,k->i", R, R, r) ; R @ r @ R ; np.linalg.multi_dot([R, R, r])
np.linalg.norm(r) ; np.linalg.norm(R) ; np.linalg.norm(R, axis=1) ; np.linalg.norm(r, 1) ; np.linalg.norm(r, np.inf)
np.linalg.inv(R) ; np.linalg.det(R) ; np.linalg.det(R[:2, :2]) ; np.linalg.solve(R, r) ; np.linalg.solve(R, R.T)
np.linalg.inv(FIVE)[4, 4] * t ; np.linalg.inv(np.array(FIVE)) * t ; np.linalg.matrix_power(R, 3) ; np.trace(R)
np.diag(R) ; np.diag(r) ; np.tril(R) ; np.triu(R) ; np.stack([r, v], axis=1) ; np.concatenate([r, v]) ; np.hstack((r, t))
np.vstack([r, v]) ; np.column_stack([r, v]) ; np.append(r, t) ; np.r_[r, t] ; np.roll(r, 1) ; np.flip(r) ; np.tile(r, 2)
np.repeat(r, 2) ; np.reshape(R, 9) ; R.T ; R[:, 0] ; r[::-1] ; np.atleast_2d(r) ; np.take(r, 1) ; np.broadcast_to(t, (3,))
np.array([[t, 1.0], [2.0, t]]) ; np.zeros(3) + r ; np.ones((3, 3)) @ r ; np.full(3, t) ; np.full_like(r, t) ; np.eye(3) * t
np.asarray(r, dtype=float) ; r.astype(float) ; r.copy() ; np.linspace(0.0, t, 3) ; np.arange(3) * t ; np.float64(t)
np.clip(r, -0.5, 0.5) ; r.clip(-0.5, 0.5) ; np.clip(r, None, v) ; np.where(r > 0.0, r, v) ; np.where(t > 0.0, 1.0, r)
np.select([r > 1.0, r > 0.0], [r, v], -1.0) ; np.piecewise(r, [r < 0.0], [-1.0, lambda x: x * x]) ; np.heaviside(r, 0.5)
np.maximum(r, v) ; np.minimum(r, [0.0, 1.0, 2.0]) ; np.maximum.reduce(r) ; np.sign(r) ; np.copysign(r, v) ; abs(R)
np.interp(r, [0.0, 1.0], [0.0, 2.0]) ; np.interp(t, [0.0, 1.0], [0.0, 2.0], left=9.0) ; lierb.table(r, [0.0, 1.0], [0.0, 2.0])
np.floor(R) ; np.ceil(R) ; np.trunc(R) ; np.rint(R) ; np.round(R, 2) ; np.fix(R) ; r % 0.3 ; r // 0.3 ; np.mod(r, v)
np.fmod(r, v) ; divmod(t, 0.3)[1] ; np.divmod(r, 0.3)[0] ; np.modf(t)[0] ; -(-t // 1) ; round(t, 1) ; math.fmod(t, 0.3)
(r > 0.0) * r ; (r > 0.0).sum() ; np.sum(r > 0.0) ; (r > 0.0).any() * t ; np.all(r > -9.0) * t ; ((0.0 < r) & (r < 1.0)) * 1.0
np.logical_or(r > 0.0, v > 0.0) * 1.0 ; np.logical_not(r > 0.0) * 1.0 ; (r != v) * 1.0 ; np.isnan(r) * 1.0
np.isclose(r, v) * 1.0 ; np.nan_to_num(r) ; np.sin(R) ; np.exp(-r @ r) ; np.hypot(r, v) ; np.arctan2(r, v) ; np.sinc(r)
np.isclose(r * np.inf, abs(r) * np.inf) * 1.0 ; np.isclose(r * np.nan, v, equal_nan=True) * 1.0 ; np.isclose(r * np.nan, v * np.nan, equal_nan=True) * 1.0
np.isclose(r, np.inf) * 1.0 ; np.nan_to_num(r * np.inf, posinf=5.0, neginf=-7.0) ; np.nan_to_num(r * np.inf) ; np.nan_to_num(r * np.nan, nan=2.0)
np.linspace(t, 2.0, 1) ; np.linalg.norm(R, keepdims=True) ; np.linalg.norm(r, keepdims=True)
np.degrees(r) ; np.logaddexp(r, v) ; np.power(abs(r), 2.5) ; 2.0**t ; t**-2 ; np.square(r) ; np.cbrt(abs(r)) ; math.erf(t)
np.polyval([1.0, 2.0, 3.0], t) ; np.trapezoid(r) ; np.gradient(r) ; np.convolve(r, v) ; np.add.reduce(r)
np.subtract.outer(r, v) ; np.apply_along_axis(np.sum, 0, R) ; max(r) ; min(t, 0.1) ; sum(r) ; float(t) ; math.floor(t)
""".replace("\n", ";")  # noqa: E501
EXPRESSIONS = [e.strip() for e in LIKE_NUMPY.split(";") if e.strip()]


def of_expression(expression):
    names = {"np": np, "math": math, "lierb": lierb, "FIVE": FIVE}
    exec(f"def f({', '.join(GIVEN)}): return {expression}", names)
    return names["f"]


def as_traced(values):
    """The arguments made of a sequence of numbers."""
    rest = iter(values)
    made = [[UserNumber(next(rest)) for _ in range(np.size(x))] for x in GIVEN.values()]
    return [
        numbers(members).reshape(np.shape(x)) if np.ndim(x) else members[0]
        for members, x in zip(made, GIVEN.values(), strict=True)
    ]


MEMBERS = [float(x) for given in GIVEN.values() for x in np.ravel(given)]


@pytest.mark.filterwarnings("ignore:numpy.fix is deprecated")  # from NumPy 2.5 on
@pytest.mark.filterwarnings("ignore:invalid value")  # of ∞ − ∞, in plain Python
@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_result_is_numpys(expression):
    wanted = of_expression(expression)(**GIVEN)
    found = traceable(of_expression(expression))(*as_traced(MEMBERS))
    assert np.shape(found) == np.shape(wanted)
    plain = [raw(x) for x in np.ravel(np.asarray(found, dtype=object))]
    # sums in another order, powers as products: a few roundings
    np.testing.assert_allclose(plain, np.ravel(wanted).astype(float), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_lanes_go_through(expression):
    def formula(*members):
        found = traceable(of_expression(expression))(*as_traced(members))
        return tuple(raw(x) for x in np.ravel(np.asarray(found, dtype=object)))

    assert trial(formula, len(MEMBERS))[1]


NOT_LIKE_NUMPY = {
    "np.sort(r)": "np.sort does not",
    "np.linalg.svd(R)": "np.linalg.svd does not",
    "np.median(r)": "does not take",
    "r[r > 0.0]": "an index or a mask",
    "np.where(r > 0.0)": r"write np\.where\(condition, a, b\)",
    "np.linalg.inv(np.eye(5) * t)": "at most 4×4",
    "np.spacing(r)": "np.spacing does not",
}


@pytest.mark.parametrize("expression", NOT_LIKE_NUMPY)
def test_what_cannot_be_traced_is_named(expression):
    with pytest.raises(UntraceableError, match=NOT_LIKE_NUMPY[expression]):
        traceable(of_expression(expression))(*as_traced(MEMBERS))


def test_writing_into_arrays():
    def filled(t, R, r, v):
        out, like, grown = np.zeros(3), np.zeros_like(r), r + 0.0
        out[1:] = r[:2]
        out[0] = t
        like[:] = v
        grown += out * like
        grown[2] -= t
        return grown

    found = traceable(filled)(*as_traced(MEMBERS))
    assert has_traced(found)
    np.testing.assert_allclose([raw(x) for x in found], filled(**GIVEN), rtol=1e-15)


@pytest.mark.parametrize("x", [0.0, 1e-12, 1e-8, 1e-3, 0.1, 0.159, 0.16, 0.5, 3.0])
def test_sinc_has_its_derivatives_near_zero(x):
    """sin πx/πx = Σ (−1)ᵏ (πx)²ᵏ/(2k+1)!, term by term in 50 digits."""
    number = UserNumber(UserNumber(x, (1.0,)), (UserNumber(1.0, (0.0,)),))
    found = numpy_functions._sinc(number)
    with mpmath.workdps(50):
        pi, factorial = mpmath.pi, mpmath.factorial
        series = {2 * k: (-1) ** k * pi ** (2 * k) / factorial(2 * k + 1) for k in range(40)}
        value = sum(c * mpmath.mpf(x) ** n for n, c in series.items())
        first = sum(c * n * mpmath.mpf(x) ** (n - 1) for n, c in series.items() if n)
        second = sum(c * n * (n - 1) * mpmath.mpf(x) ** (n - 2) for n, c in series.items() if n)
        assert abs(found.value.value - value) < 1e-15
        assert abs(found.value.parts[0] - first) < 2e-15
        assert abs(found.parts[0].parts[0] - second) < 2e-14  # differences beyond the series

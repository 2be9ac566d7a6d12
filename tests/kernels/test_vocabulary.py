"""Vocabulary of users' functions: on plain arrays of any batch shape, and where they are
traced or compiled by Numba, on special values, against NumPy.
"""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lierb
from kernels.packs import FORMULAS, on_lanes
from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.elementwise import BY_NAME
from lierb.kernels.functions.function import COMPILED
from lierb.kernels.functions.object_arrays import numbers
from lierb.kernels.functions.user_number import Condition, UserNumber
from lierb.kernels.numbers.dual import Dual

VECTORS = np.random.default_rng(3).uniform(-1.7, 1.7, (2, 5, 3))  # ‖ξ‖ < π
MATRICES = lierb.lie.so3.exp(VECTORS)


def test_log_inverts_exp():
    assert lierb.log(MATRICES).shape == (2, 5, 3)
    # the largest angle is 2.9 rad: a few roundings
    np.testing.assert_allclose(lierb.log(MATRICES), VECTORS, atol=1e-14)


def test_quaternion_is_scipys():
    quaternions = lierb.quaternion(MATRICES)
    turned = Rotation.from_matrix(MATRICES.reshape(-1, 3, 3))
    wanted = turned.as_quat(canonical=True, scalar_first=True).reshape(2, 5, 4)
    # a few roundings, here and in SciPy's matrices
    np.testing.assert_allclose(quaternions, wanted, atol=4e-15)
    np.testing.assert_allclose(lierb.quaternion(turned).reshape(2, 5, 4), wanted, atol=4e-15)
    assert (quaternions[..., 0] >= 0.0).all()


def test_half_turns_have_one_quaternion_and_one_vector():
    for axis in np.eye(3):
        turn = 2.0 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_array_equal(np.abs(lierb.quaternion(turn)), [0.0, *axis])
        np.testing.assert_allclose(np.abs(lierb.log(turn)), np.pi * axis, rtol=1e-15)


def test_table_and_clip_are_numpys():
    x, (xs, ys) = VECTORS, (np.array([-1.0, 0.0, 0.25, 1.0]), np.array([2.0, -1.0, 3.0, 0.5]))
    np.testing.assert_array_equal(lierb.table(x, xs, ys), np.interp(x, xs, ys))
    np.testing.assert_array_equal(lierb.table(x, tuple(xs), list(ys)), np.interp(x, xs, ys))
    vectors = np.stack([ys, -2.0 * ys], axis=1)
    both = np.stack([np.interp(x, xs, ys), np.interp(x, xs, -2.0 * ys)], axis=-1)
    np.testing.assert_array_equal(lierb.table(x, xs, vectors), both)
    np.testing.assert_array_equal(lierb.table(x[0], xs, vectors), both[0])
    np.testing.assert_array_equal(lierb.clip(x, -0.5, 0.5), np.clip(x, -0.5, 0.5))
    np.testing.assert_array_equal(lierb.where(x > 0.0, x, -x), np.abs(x))
    np.testing.assert_array_equal(lierb.where(x > 0.0, 1.0, -1.0), np.sign(x))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lierb.table(0.5, (0.0, 0.0), (1.0, 2.0)), "xs must increase"),
        (
            lambda: lierb.table(0.5, (0.0, 1.0), (1.0,)),
            r"shapes \(2,\) and \(1,\); expected \(n,\)",
        ),
        (lambda: lierb.log(np.eye(4)), r"R has shape \(4, 4\); expected \(…, 3, 3\)"),
    ],
)
def test_wrong_arguments_are_told(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_wrong_table_is_told_with_its_line():
    @lierb.wrench
    def push(t, R, r, omega, v, params):
        return lierb.table(t, (0.0, 0.0), (1.0, 2.0)) * r, r

    message = r'push cannot be compiled: line \d+, "return lierb\.table.*": a table.s xs must'
    with pytest.raises(lierb.errors.ForceError, match=message):
        push()


# ---- special values ----------------------------------------------------------------------------

INF, NAN, SUBNORMAL, LARGEST = math.inf, math.nan, 5e-324, 1.7976931348623157e308
SPECIAL = np.array([
    0.0, SUBNORMAL, 2.2e-308, 1e-300, 1e-160, 1e-16, 1e-8, math.nextafter(0.5, 0.0), 0.5,
    1.0 - 2.0**-53, 1.0, 1.0 + 2.0**-52, 1.5, 2.5, 3.0, math.pi, 7.0, 20.0, 710.0, 746.0, 1e5, 2e5,
    1e10, 2.0**52 + 0.5, 2.0**53, 1e22, 1e154, 1e300, LARGEST, INF,
])  # fmt: skip
SPECIAL = np.concatenate([SPECIAL, -SPECIAL, [NAN]])
PAIRS = np.array(list(itertools.product(SPECIAL, repeat=2))).T

ONE = {
    **{name: eval(f"lambda x: np.{name}(x)", {"np": np}) for name in (
        "sin", "cos", "tan", "exp", "expm1", "exp2", "log", "log1p", "log10", "log2", "sqrt",
        "cbrt", "square", "reciprocal", "sinh", "cosh", "tanh", "arcsin", "arccos", "arctan",
        "arcsinh", "arccosh", "arctanh", "absolute", "sign", "floor", "ceil", "trunc", "rint",
        "radians", "degrees", "isnan", "isfinite", "isinf", "signbit", "sinc", "nan_to_num",
    )},
    "fraction": lambda x: np.modf(x)[0], "whole": lambda x: np.modf(x)[1],
    "heaviside": lambda x: np.heaviside(x, 0.5), "clip": lambda x: np.clip(x, -1.0, 1.0),
    "square root": lambda x: x**0.5, "its inverse": lambda x: x**-0.5, "cube": lambda x: x**3,
    "to zero": lambda x: x**0, "of two": lambda x: 2.0**x, "over zero": lambda x: x // 0.0,
    "over -zero": lambda x: x // -0.0, "over infinity": lambda x: x // math.inf,
    "of -5": lambda x: -5.0 // x, "rest of 5": lambda x: 5.0 % x, "rest": lambda x: x % -3.0,
    "rest of infinity": lambda x: x % -math.inf, "table": lambda x: lierb.table(x, (0, 3), (1, -2)),
    "of three": lambda x: math.hypot(x, x, 1.0),
}  # fmt: skip
TWO = {
    **{name: eval(f"lambda x, y: np.{name}(x, y)", {"np": np}) for name in (
        "arctan2", "hypot", "fmax", "fmin", "copysign", "remainder", "fmod", "floor_divide",
        "logaddexp", "greater", "logical_and",
    )},
    "atan2": lambda x, y: math.atan2(x, y), "power": lambda x, y: x**y,
    "quotient": lambda x, y: x // y, "rest": lambda x, y: x % y,
    "both": lambda x, y: np.divmod(x, y)[0], "other": lambda x, y: np.divmod(x, y)[1],
}  # fmt: skip
# Numba has no such function, and the error says so.
UNKNOWN_TO_NUMBA = {"fraction", "whole", "heaviside", "clip", "of three"}
ROUNDINGS = 8 * 2.0**-53  # of C's library, NumPy's own code and lierb's, each within 1.5 ulp
CANCELLING = {"logaddexp": ROUNDINGS}  # a sum of numbers about 1 that may be smaller itself
# NumPy gives no sign to the sign of a zero, Numba does.
UNSIGNED = {"sign"}


def assert_numpys(name, found, function, *columns):
    with np.errstate(all="ignore"):
        wanted = np.array([float(function(*map(np.float64, row))) for row in zip(*columns)])
    is_number = np.isfinite(wanted)
    np.testing.assert_array_equal(found[~is_number], wanted[~is_number], err_msg=name)
    off = np.abs(found[is_number] - wanted[is_number])
    # a subnormal number has an absolute rounding
    most = np.maximum(ROUNDINGS * np.abs(wanted[is_number]), 2 * SUBNORMAL)
    most += CANCELLING.get(name, 0.0)
    assert (off <= most).all(), (name, [column[is_number][off > most] for column in columns])
    zero = wanted == 0.0
    if name not in UNSIGNED:
        np.testing.assert_array_equal(np.signbit(found[zero]), np.signbit(wanted[zero]), name)


def traced(functions):
    """A formula that gives what each of the functions gives."""

    def number(result):
        result = result.item() if isinstance(result, np.ndarray) else result
        result = result.number() if isinstance(result, Condition) else result
        return result.value if isinstance(result, UserNumber) else result

    copies = [traceable(function) for function in functions.values()]
    return lambda *xs: tuple(number(copy(*map(UserNumber, xs))) for copy in copies)


@pytest.mark.parametrize(("functions", "columns"), [(ONE, (SPECIAL,)), (TWO, tuple(PAIRS))])
def test_traced_functions_are_numpys_on_special_values(functions, columns):
    name = f"vocabulary of {len(columns)}"
    FORMULAS[name] = traced(functions)
    found = on_lanes(name, *columns, results=len(functions))
    for (each, function), one in zip(functions.items(), found, strict=True):
        assert_numpys(each, one, function, *columns)


@pytest.mark.slow
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="NumPy's own run with the JIT off")
@pytest.mark.parametrize(("functions", "columns"), [(ONE, (SPECIAL,)), (TWO, tuple(PAIRS))])
def test_functions_of_one_body_are_numpys_on_special_values(functions, columns):
    known = {
        k: numba.njit(f, **COMPILED) for k, f in functions.items() if k not in UNKNOWN_TO_NUMBA
    }
    for name, function in known.items():
        found = np.array([float(function(*row)) for row in zip(*columns)])
        assert_numpys(name, found, functions[name], *columns)


@pytest.mark.parametrize("size", [1e-250, 1e-3, 1.0, 1e3, 1e250])
def test_hypot_and_arctan2_have_their_derivatives(size):
    """d hypot = (x dx + y dy)/r; d arctan2 = (x dy − y dx)/r², where r² has a value."""
    x, y = 3.0 * size, -4.0 * size
    one, other = UserNumber(x, (1.0, 0.0)), UserNumber(y, (0.0, 1.0))
    found = BY_NAME["hypot"](one, other)
    assert found.value == pytest.approx(5.0 * size, rel=4e-16)
    assert found.parts == pytest.approx((0.6, -0.8), rel=4e-16)
    if 1e-150 < size < 1e150:
        turned = BY_NAME["arctan2"](other, one)
        assert turned.value == pytest.approx(math.atan2(y, x), rel=4e-16)
        assert turned.parts == pytest.approx((0.16 / size, 0.12 / size), rel=4e-16)


def test_fraction_has_its_slope_where_it_is_zero():
    found = BY_NAME["modf"](UserNumber(-3.0, (1.0,)))[0]
    assert isinstance(found, Dual)
    assert (found.value, found.parts) == (0.0, (1.0,))
    assert math.copysign(1.0, found.value) == -1.0


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.4, 2.0, 3.1])
@pytest.mark.parametrize("wrapped", [UserNumber, lambda x: UserNumber(x.value, x.parts)])
def test_log_and_quaternion_of_runs_with_derivatives_are_differentiated(angle, wrapped):
    """In a run, a user's number has a dual number as its value; in a row, parts of its own."""
    axis, spin = np.array((0.6, 0.0, -0.8)), np.array((0.3, -0.5, 0.2))
    R = lierb.lie.so3.exp(angle * axis)
    rate = R @ np.cross(np.eye(3), -spin).T
    pairs = zip(R.ravel(), rate.ravel(), strict=True)
    moving = numbers([wrapped(Dual(x, (dx,))) for x, dx in pairs]).reshape(3, 3)
    rates = lierb.lie.so3.dexpinv(-angle * axis, spin)  # Ṙ = R ω̂ with ω = dexp_{−ξ} ξ̇
    found = [_parts(x) for x in lierb.log(moving)]
    np.testing.assert_allclose(found, rates, rtol=1e-12, atol=1e-13)
    w, *v = lierb.quaternion(R)
    wanted = (-0.5 * np.dot(v, spin), *(0.5 * (w * spin + np.cross(v, spin))))
    found = [_parts(x) for x in lierb.quaternion(moving)]
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-13)


def _parts(x):
    """The derivative of a user's number, at whichever level it is."""
    (part,) = x.parts or x.value.parts
    return float(part)

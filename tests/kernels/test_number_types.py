"""Equal bits on any number of lanes, beside any neighbours, and in users' @njit code."""

import os
import pickle
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from cases import slow_but
from numba import config, njit

import lierb
from kernels.packs import on_lanes
from kernels.samples import GROUPS, dim, twists, unpacked
from lierb.kernels.groups import se3, so3, so3xr3
from lierb.kernels.groups.lie_functions import SIGNATURES, LieFunction, apply, width
from lierb.kernels.numbers.arithmetic import apart, flatten, fma, rounded_as_numpy, sqrt
from lierb.kernels.numbers.dual import Dual, raw
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.kernels.tracing.trace import kernel, trial

ROOT = Path(__file__).parents[2]
LANES = (1, 2, 4, 8)
# Operations on packs are the same in every group: one of them goes through all numbers of lanes.
LANES_OF = {"so3": LANES, "se3": (1, DEFAULT_LANES), "so3xr3": (1, DEFAULT_LANES)}

needs_jit = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="the JIT is off")
every_group = pytest.mark.parametrize("group", slow_but(GROUPS, "so3"))
every_function = pytest.mark.parametrize("name", SIGNATURES)

# Angles of every branch, in an order that puts them side by side in packs of 2, 4 and 8, and packs
# of 2, 4 and 8 small ones and medium ones: 0.1, 0.75 and π are the cut-overs. 37 is no multiple of
# any number of lanes.
THETA = np.array(
    [1e-9, 0.75, 5.0, 0.0, np.pi, 6.2, 0.0999999, 3.0, 0.1, 0.1000001, 3.1415, 3.1416, 1e-12, 6.0]
    + [0.01] * 8
    + [0.3] * 8
    + [2.0, 1e-4, 4.0, 1e-3, 0.05, 0.09, 1e-6]
)


@cache
def rows(group, name):
    """The two arrays that `apply` reads; the second is the first for functions of one argument."""
    kinds, _ = SIGNATURES[name]
    columns = []
    for seed, kind in enumerate(kinds):
        X = twists(THETA, dim(group), seed)
        array = X if kind == "x" else getattr(lierb.lie, group).exp(X)
        columns.append(np.ascontiguousarray(array.reshape(len(X), -1)))
    return columns[0], columns[-1]


def applied(group, name, lanes, a, b):
    out = np.full((len(a), width(group, SIGNATURES[name][1])), 7.0)
    with np.errstate(all="ignore"):  # NumPy's scalars warn when the JIT is off
        apply(LieFunction(group, name, lanes), a, b, out, lanes)
    return out


def same_bits(a, b):
    return np.array_equal(a.view(np.int64), b.view(np.int64))


@pytest.mark.long
@needs_jit
@every_group
@every_function
def test_lie_functions_same_bits_on_every_number_of_lanes(group, name):
    a, b = rows(group, name)
    scalar = applied(group, name, 1, a, b)
    assert np.isfinite(scalar).all()
    for lanes in LANES_OF[group][1:]:
        assert same_bits(applied(group, name, lanes, a, b), scalar)


@pytest.mark.slow
@needs_jit
@every_group
@every_function
def test_lie_functions_same_bits_beside_any_neighbours(group, name):
    a, b = rows(group, name)
    scalar = applied(group, name, 1, a, b)
    rng = np.random.default_rng(5)
    for lanes in LANES_OF[group]:
        for n in (len(a), 13, 3, 1):
            order = rng.permutation(len(a))[:n]
            assert same_bits(applied(group, name, lanes, a[order], b[order]), scalar[order])


@pytest.mark.slow
@needs_jit
@every_group
@every_function
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_lie_functions_leave_the_neighbours_of_a_bad_row_alone(group, name, bad):
    a, b = rows(group, name)
    clean = applied(group, name, 1, a, b)
    spoilt = a.copy()
    spoilt[5::6, :3] = bad
    good = np.isfinite(spoilt).all(axis=1)
    for lanes in LANES_OF[group]:
        found = applied(group, name, lanes, spoilt, b)
        assert same_bits(found[good], clean[good])
        assert not np.isfinite(found[~good]).all(axis=1).any()


@needs_jit
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("n", [0, 1, 3, 9])
def test_apply_writes_no_row_too_many(lanes, n):
    a, b = rows("so3", "exp")
    whole = np.full((16, 9), 7.0)
    apply(LieFunction("so3", "exp", lanes), a[:n], b[:n], whole[:n], lanes)
    assert same_bits(whole[:n], applied("so3", "exp", 1, a[:n], b[:n]))
    assert np.all(whole[n:] == 7.0)


SCALARS = {
    "coefficients": (7, THETA**2),
    "sincos": (2, np.concatenate([THETA, -1000.0 * THETA])),
    "atan2": (1, np.sin(7.0 * THETA), np.cos(11.0 * THETA)),
    "inverse_symmetric": (
        9,
        *(np.eye(3).ravel() + 0.3 * np.cos(np.outer(THETA, [0, 1, 2, 1, 3, 4, 2, 4, 5]))).T,
    ),
}


@pytest.mark.slow
@needs_jit
@pytest.mark.parametrize("name", SCALARS)
def test_scalar_formulas_same_bits_on_every_number_of_lanes(name):
    results, *columns = SCALARS[name]
    scalar = on_lanes(name, *columns, results=results, lanes=1)
    order = np.random.default_rng(6).permutation(len(columns[0]))
    for lanes in LANES[1:]:
        assert same_bits(on_lanes(name, *columns, results=results, lanes=lanes), scalar)
        permuted = on_lanes(name, *(c[order] for c in columns), results=results, lanes=lanes)
        assert same_bits(permuted, scalar[:, order].copy())


# ---------------------------------------------------------------- in the user's own code


@needs_jit
@every_group
@every_function
def test_formulas_give_the_same_bits_in_users_njit_code(group, name):
    formula = getattr(GROUPS[group], name)
    kinds, result_kind = SIGNATURES[name]

    @njit
    def users_own(*operands):
        return formula(*operands)

    operands = [x.reshape(-1, *shape(group, kind)) for x, kind in zip(rows(group, name), kinds)]
    expected = getattr(getattr(lierb.lie, group), name)(*operands)
    expected = np.array([flatten(numbers(group, result_kind, x)) for x in expected])
    for i in range(len(expected)):
        found = users_own(*(numbers(group, kind, x[i]) for x, kind in zip(operands, kinds)))
        assert same_bits(np.array(flatten(found)), expected[i])


def shape(group, kind):
    size = 3 if group == "so3" else 4
    return (dim(group),) if kind == "x" else (size, size)


def numbers(group, kind, array):
    def floats(members):
        return tuple(map(floats, members)) if isinstance(members, tuple) else float(members)

    return floats(unpacked(group, kind, array))


@needs_jit
def test_formulas_compose_in_users_njit_code():
    @njit
    def users_own(x, y):
        bracket = so3xr3.ad(x, y)  # its translation is zero by structure, and a number for the user
        return bracket[0] + bracket[5], so3xr3.dexp(x, bracket)

    lie = lierb.lie.so3xr3
    x, y = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), (0.5, -1.0, 2.0, 7.0, 8.0, 9.0)
    first, image = users_own(x, y)
    assert first == lie.ad(x, y)[0]
    assert image == tuple(lie.dexp(x, lie.ad(x, y)).tolist())


@needs_jit
def test_formulas_take_integers_for_numbers_in_users_njit_code():
    @njit
    def users_own(z):
        return se3.exp((0, 0, z, 1, 2, 3))

    C = lierb.lie.se3.exp([0.0, 0.0, 2.0, 1.0, 2.0, 3.0])
    for two in (2, 2.0, np.float32(2.0)):
        assert users_own(two) == numbers("se3", "g", C)


# ---------------------------------------------------------------- with the JIT off


@needs_jit
@pytest.mark.long
def test_sweeps_hold_with_the_jit_off(tmp_path):
    """The accuracy tests of the compiled way, run in plain Python: two roundings for each fma."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    files = [
        f"tests/kernels/test_{name}.py" for name in ("coefficients", "lie", "log", "repeat", "vec")
    ]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files]
    run = subprocess.run(
        [*command, "-k", "lanes and (sweep or inverse_symmetric) or test_repeat"],
        cwd=ROOT, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-1000:]
    assert " passed" in run.stdout
    assert " failed" not in run.stdout


# ---------------------------------------------------------------- from formula to formula


class Pair(NamedTuple):
    first: object
    second: object


def squared(x):
    return Pair(Dual(x, (1.0, ZERO)) * x, (x, 2.0))


def second_square(pair, y):
    """Input of the second formula, from the first one."""
    kinds = type(pair) is Pair and type(pair.first) is Dual
    found = pair.first * y + pair.second[0]
    return (found.value, found.parts[0], 1.0 if kinds and found.parts[1] is ZERO else 0.0)


kernel(squared)
kernel(second_square, numbers_only=True)


@needs_jit
def test_named_tuples_and_duals_keep_their_class_between_formulas():
    @njit
    def both(x, y):
        return second_square(squared(x), y)

    assert both(3.0, 5.0) == (48.0, 15.0, 1.0)


def long_one(x, y):
    return fma(x, y, 1.0 / y), sqrt(x) + y


rarely_needed = apart(2)(long_one)


def here_and_there(x, y):
    """Equal numbers with and without a call, and others that round differently."""
    product, root = rarely_needed(x, y)
    with rounded_as_numpy(x):
        rounded = rarely_needed(x, y)[0]
    return (product, root, *rarely_needed(root, y), rounded), (
        *long_one(x, y), *long_one(root, y), x * y + 1.0 / y,
    )  # fmt: skip


kernel(here_and_there)


@needs_jit
def test_what_is_kept_apart_is_emitted_once_and_gives_the_same_bits():
    _, code = trial(here_and_there, 2)
    assert len(re.findall(r"call .*long_one.2.rounded_once", code)) == 2
    assert len(re.findall(r"define .*long_one.2.rounded_once", code)) == 1
    called, inlined = njit(lambda x, y: here_and_there(x, y))(0.7, 0.3)
    assert called == inlined


@pytest.mark.parametrize("x", [0.7, np.array([0.7, 2.0]), Dual(0.7, (1.0, 2.0))])
def test_without_a_trace_what_is_kept_apart_is_a_formula(x):
    called, inlined = here_and_there(x, 0.3)
    assert np.array_equal(np.array([*map(raw, called)]), np.array([*map(raw, inlined)]))
    assert all(
        a.parts == b.parts for a, b in zip(called, inlined, strict=True) if isinstance(a, Dual)
    )


def test_structural_zero_is_the_number_zero():
    assert ZERO == 0.0
    assert ZERO == 0.0
    assert ZERO != 1.0
    assert hash(ZERO) == hash(0.0)
    assert pickle.loads(pickle.dumps(ZERO)) is ZERO


def test_log_has_its_derivative_at_the_identity():
    rates = (0.3, -0.7, 0.2)
    turning = tuple(Dual(0.0, (x,)) for x in rates)
    found = so3.log(so3.exp(turning))
    assert [x.value for x in found] == [0.0, 0.0, 0.0]
    assert [x.parts[0] for x in found] == pytest.approx(rates, rel=1e-15)

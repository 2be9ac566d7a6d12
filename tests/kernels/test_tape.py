"""A tape's gains are the transposed Jacobian times a vector, which dual numbers give row by row."""

from __future__ import annotations

import numpy as np
import pytest

from lierb.kernels.groups import se3
from lierb.kernels.numbers.arithmetic import absolute, maximum, minimum, sqrt, where
from lierb.kernels.numbers.dual import Dual, parts_of, value_of
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.trigonometry import atan2, sincos
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.taped import with_loop


def products(x):
    return x[0] * x[1] / x[2] - 2.0 * x[3], ZERO * x[0] + x[1] * x[1], -x[2] + 0.5, 3.0 / x[3]


def choices(x):
    larger = where(x[0] > x[1], x[0] * x[2], x[1])
    return larger, maximum(x[2], x[3]), minimum(x[0], 0.25), absolute(x[1] - x[0])


def transcendental(x):
    sine, cosine = sincos(x[0] * x[1])
    return sine * x[2], cosine, atan2(x[3], x[2]), sqrt(x[0] * x[0] + x[1] * x[1])


def solution(x):
    rows = [[x[0] + 3.0, x[1], ZERO], [x[2], 4.0, x[3]], [ZERO, x[0], 5.0 + x[1]]]
    return Factored(rows).solve((x[0], 1.0 - x[2], x[3]))


def exponential(x):
    rotation, position = se3.exp((x[0], x[1], ZERO, x[2], ZERO, x[3]))
    return (*rotation, *position)


FORMULAS = (products, choices, transcendental, solution, exponential)


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("is_batch", [False, True], ids=["floats", "arrays"])
def test_gains_are_the_transposed_jacobian(formula, is_batch):
    rng = np.random.default_rng(3)
    size = (4, 5) if is_batch else (4,)
    at = [*(rng.uniform(0.2, 1.5, size))] if is_batch else rng.uniform(0.2, 1.5, size).tolist()
    tape = Tape()
    results = formula(tape.opened(at))
    weights = rng.standard_normal(len(results))
    gains = tape.gains(zip(results, weights, strict=True))
    for i, gain in enumerate(gains):
        units = [Dual(x, (1.0 if i == j else 0.0,)) for j, x in enumerate(at)]
        along = [(parts_of(y) or (0.0,))[0] for y in formula(units)]
        expected = sum(w * (0.0 if p is ZERO else p) for w, p in zip(weights, along, strict=True))
        assert np.allclose(0.0 if gain is ZERO else gain, expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("formula", FORMULAS)
def test_derivatives_in_a_loop_have_the_bits_of_parts(formula):
    rng = np.random.default_rng(3)
    at, parts = rng.uniform(0.2, 1.5, 4).tolist(), rng.standard_normal((4, 5)).tolist()
    given = tuple(Dual(x, tuple(along)) for x, along in zip(at, parts, strict=True))
    pairs = zip(formula(given), with_loop(formula, given), strict=True)
    for expected, found in pairs:
        assert value_of(found) == value_of(expected)
        assert [*parts_of(found)] == [x if x is not ZERO else 0.0 for x in parts_of(expected)]


def test_an_input_without_effect_has_a_structural_zero_as_gain():
    tape = Tape()
    x, y = tape.opened((1.0, 2.0))
    gains = tape.gains([(x * 3.0, 2.0), (ZERO * y, 1.0), (4.0, 1.0)])
    assert gains == [6.0, 0.0]
    assert gains[1] is ZERO

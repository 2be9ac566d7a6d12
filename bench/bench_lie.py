"""Lie-group functions over arrays, on one thread."""

from __future__ import annotations

import numpy as np
import pytest

import lierb

ROWS = 100_000


@pytest.mark.parametrize("group", ["so3", "se3"])
@pytest.mark.parametrize("function", ["exp", "log", "dexp", "dexpinv", "compose"])
def test_lie(group, function, rate):
    on = getattr(lierb.lie, group)
    rng = np.random.default_rng(1)
    X, Y = rng.uniform(-1.5, 1.5, (2, ROWS, on.dim))
    operands = {"exp": (X,), "log": (on.exp(X),), "compose": (on.exp(X), on.exp(Y))}
    given = operands.get(function, (X, Y))
    rate(lambda: getattr(on, function)(*given), ROWS, "rows")

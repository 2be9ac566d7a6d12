"""Newton's iteration on floats; `test_repeat` has lanes that stop at their own turns."""

from __future__ import annotations

import numpy as np

from lierb.kernels.numbers.newton import newton, simplified_newton


def test_newton_solves_and_reports():
    def square(x):
        return (x[0] * x[0] - 2.0, x[1] - x[0])

    for solved in (
        newton(square, (1.0, 0.0), 1.0),
        simplified_newton(square, (1.3, 0.0), lambda change: abs(change[0]), 1.0),
    ):
        np.testing.assert_allclose(solved.unknowns, np.sqrt(2.0), atol=1e-14)
        assert solved.unsolved == 0.0


def test_newton_reports_what_it_cannot_solve():
    def nowhere(x):
        return (x[0] * x[0] + 1.0,)

    assert newton(nowhere, (0.7,), 1.0).unsolved == 1.0
    assert simplified_newton(nowhere, (0.7,), lambda change: abs(change[0]), 1.0).unsolved == 1.0
    # equations that are not finite are another failure
    assert newton(nowhere, (np.nan,), 1.0).unsolved == 0.0

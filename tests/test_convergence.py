"""Observed orders and verdicts on errors whose behaviour is known."""

import math

import pytest

from lierb.analysis.convergence import ROUNDING_FLOOR, fitted_order, observed_order, verdict
from lierb.errors import ArgumentError

DTS = (1e-2, 1e-3, 1e-4)
HALVED = (0.4, 0.2, 0.1, 0.05)


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_observed_order_finds_the_exponent(order):
    dts = (0.4, 0.2, 0.1)
    fit = observed_order(dts, [0.3 * dt**order for dt in dts])
    assert fit.slope == pytest.approx(order, abs=1e-12)
    assert not fit.lower_bound


def test_observed_order_takes_the_steps_in_any_order():
    errors = [5.0 * dt**4 for dt in DTS]
    there = observed_order(DTS, errors)
    back = observed_order(DTS[::-1], errors[::-1])
    assert there.slope == pytest.approx(back.slope, abs=1e-12)


def test_observed_order_leaves_out_errors_at_rounding():
    fit = observed_order(DTS, [1e-4, 1e-8, 0.99 * ROUNDING_FLOOR])
    assert fit.slope == pytest.approx(4.0, abs=1e-12)


def test_observed_order_looks_at_the_finest_steps():
    # A universal joint under gravity: dt = 1e-2 does not resolve its motion.
    assert str(observed_order(DTS, [0.33, 1.4e-5, 1.4e-9])) == "4.00"


def test_observed_order_is_a_bound_when_one_error_is_above_rounding():
    fit = observed_order(DTS, [5.1e-8, 5.1e-12, 6.7e-13])
    assert fit.lower_bound
    assert str(fit) == ">=4.00"


def test_observed_order_is_none_at_rounding():
    assert observed_order(DTS, [3e-15, 0.0, 1e-13]) is None


def test_rounding_scales_with_the_size_of_the_motion():
    errors = [3e-9, 2e-9, 1e-9]
    assert observed_order(DTS, errors) is not None
    assert observed_order(DTS, errors, size=490.0) is None


# Angles between orientations that have nothing to do with each other: rad, at most π, 2.2 in the
# mean, and 99 % of them above 0.5.
SATURATED = ([2.1, 2.0, 2.4], [2.4, 1.2, 0.6], [3.1, 1e-3, 2.4], [2.4, 1e-15, 0.0])


@pytest.mark.parametrize("errors", SATURATED)
@pytest.mark.parametrize("size", [1.0, 7.5e3, 1e-9])
@pytest.mark.parametrize("of", [observed_order, fitted_order])
def test_order_is_none_of_saturated_errors(errors, size, of):
    fit = of(DTS, [size * error for error in errors], size=size)
    assert math.isnan(fit.slope)
    assert (str(fit), fit.steps) == ("–", ())


@pytest.mark.parametrize("of", [observed_order, fitted_order])
def test_order_leaves_out_saturated_errors(of):
    errors = [2.4, 1.9, 1.6e-3, 1e-4]
    fit = of(HALVED, errors)
    assert fit.slope == pytest.approx(4.0, abs=1e-12)
    assert fit.steps == (0.1, 0.05)
    assert math.isnan(of(HALVED[:3], errors[:3]).slope)  # one usable error has no slope


@pytest.mark.parametrize("errors", [[0.38, 0.3801, 0.3802], [2e-5, 1.9e-5, 2.1e-5]])
def test_errors_that_do_not_fall_have_no_order(errors):
    fit = observed_order(DTS, errors)
    assert math.isnan(fit.slope)
    assert (str(fit), fit.steps) == ("–", DTS[1:])
    assert verdict(errors, fit) == "violated"


@pytest.mark.parametrize("errors", [[1e-3], [0.0, 1e-13, 1e-3]])
def test_observed_order_of_the_finest_error_alone_is_unknown(errors):
    assert math.isnan(observed_order(DTS[: len(errors)], errors).slope)
    assert verdict(errors, observed_order(DTS[: len(errors)], errors)) == "violated"


# ---- through several ---------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_fitted_order_takes_all_in_the_asymptotic_range(order):
    # of C hᵖ (1 + a h): the slopes differ by less than 5 % from a h = 0.1 on
    errors = [0.3 * dt**order * (1.0 + 0.1 * order * dt) for dt in HALVED]
    fit = fitted_order(HALVED, errors)
    assert fit.slope == pytest.approx(order, rel=0.02)
    assert fit.steps == HALVED
    assert fit.is_asymptotic


def test_fitted_order_leaves_out_steps_that_do_not_resolve_the_motion():
    fit = fitted_order(HALVED, [0.9, 2e-3, 1.25e-4, 7.8125e-6])
    assert fit.slope == pytest.approx(4.0, abs=1e-12)
    assert fit.steps == (0.2, 0.1, 0.05)


def test_fitted_order_of_two_is_observed_and_not_asymptotic():
    errors = [0.9, 0.1, 1.6e-3, 1e-4]
    fit = fitted_order(HALVED, errors)
    assert fit.slope == pytest.approx(observed_order(HALVED, errors).slope, abs=1e-12)
    assert fit.steps == (0.1, 0.05)
    assert not fit.is_asymptotic


def test_fitted_order_believes_what_is_above_the_floor_of_its_own_row():
    errors = [1e-4, 6.25e-6, 1.6e-6, 1.5e-6]  # beside a reference that is off by 1.5e-6
    fit = fitted_order(HALVED, errors, floor=[1e-6, 1e-6, 1.5e-5, 1.5e-5])
    assert fit.slope == pytest.approx(4.0, abs=1e-12)
    assert fit.steps == (0.4, 0.2)
    assert fitted_order(HALVED, errors, floor=[1e-3] * 4) is None
    with pytest.raises(ArgumentError, match="floor has shape"):
        fitted_order(HALVED, errors, floor=[1e-3] * 3)


def test_fitted_order_is_a_bound_where_observed_order_is():
    fit = fitted_order(DTS, [5.1e-8, 5.1e-12, 6.7e-13])
    assert str(fit) == ">=4.00"
    assert not fit.is_asymptotic


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([1e-15, 2e-15, 0.0], "exact"),
        ([1e-4, 1e-8, 1e-12], "order 4"),
        ([1e-4, 1e-6, 1e-8], "order 2"),
        ([1e-4, 4e-8, 1.6e-11], "drifts"),
        ([0.45, 0.45, 0.45], "violated"),
        ([1e-3, 1e-2, 1e-1], "violated"),
        ([math.nan, 1e-8, 1e-12], "failed"),
        ([math.inf, 1e-8, 1e-12], "failed"),
    ],
)
def test_verdict(errors, expected):
    assert verdict(errors, observed_order(DTS, errors)) == expected

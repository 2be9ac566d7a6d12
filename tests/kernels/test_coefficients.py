"""The coefficient functions of θ² against mpmath, on every number type."""

from functools import cache

import numpy as np
import oracle
import pytest
from oracle import mp

from kernels.packs import on_lanes
from kernels.samples import CUTOVERS, NUMBER_TYPES, angles, near_two_pi
from lierb.kernels.groups import coefficients as module
from lierb.kernels.groups.coefficients import (
    Coefficients,
    HalfAngleCoefficients,
    coefficients,
    half_angle_coefficients,
)

NAMES = Coefficients._fields

every_number = pytest.mark.parametrize("number_type", NUMBER_TYPES)
every_name = pytest.mark.parametrize("name", NAMES)


@cache
def sample():
    """θ² as float64, and θ and every coefficient at exactly that θ²."""
    theta = np.concatenate([angles(random=400, logarithmic=200), near_two_pi()])
    z = theta**2
    exact_theta = [mp.sqrt(x) for x in z.tolist()]
    values = [oracle.coefficients(t) for t in exact_theta]
    exact = Coefficients(*(np.array([v[name] for v in values]) for name in NAMES))
    return z, np.array(exact_theta, dtype=float), exact


def evaluate(number_type, z):
    """One row for each coefficient, computed with one of NUMBER_TYPES."""
    if number_type == "lanes":
        return on_lanes("coefficients", z, results=len(NAMES))
    if number_type == "arrays":
        return np.array(coefficients(z))
    return np.array([coefficients(x) for x in z.tolist()]).T


@cache
def computed(number_type):
    return Coefficients(*evaluate(number_type, sample()[0]))


def errors(number_type, name):
    """Relative; for sinc, which is 0 at π and enters beside entries of size 1, absolute."""
    exact = getattr(sample()[2], name)
    error = abs(getattr(computed(number_type), name) - exact)
    return error if name == "sinc" else error / abs(exact)


def assert_below(error, bound, theta):
    worst = np.argmax(error / bound)
    assert error[worst] <= np.broadcast_to(bound, error.shape)[worst], f"at θ = {theta[worst]!r}"


@every_number
@every_name
def test_coefficients_sweep_to_pi(number_type, name):
    _, theta, _ = sample()
    below = theta <= np.pi
    # Horner's last steps and at most two operations: a few half ulps of 1.1e-16
    assert_below(errors(number_type, name)[below], 1e-15, theta[below])


@every_number
@every_name
def test_coefficients_sweep_beyond_pi(number_type, name):
    _, theta, _ = sample()
    above = theta > np.pi
    # The closed forms subtract numbers of like size just above π (c1 loses a factor of 8). Towards
    # 2π a vanishes and c0, c1 have poles: the rounding of θ/2 before sin counts 1/(2π − θ) times.
    bound = np.maximum(3e-15, 2e-15 / (2.0 * np.pi - theta[above]))
    assert_below(errors(number_type, name)[above], bound, theta[above])


@every_number
@every_name
@pytest.mark.parametrize("cutover", CUTOVERS)
def test_coefficients_have_no_step_at_the_cutovers(number_type, name, cutover):
    _, theta, exact = sample()
    near = abs(theta / cutover - 1.0) < 1e-14
    assert np.any(theta[near] < cutover)
    assert np.any(theta[near] > cutover)
    values = getattr(computed(number_type), name)[near]
    # one function, not two that nearly meet: the spread is that of the exact values and 3e-15 more
    spread, allowed = np.ptp(values), np.ptp(getattr(exact, name)[near])
    assert spread <= allowed + 3e-15 * max(abs(values).max(), 1.0 if name == "sinc" else 0.0)


@every_number
def test_coefficients_at_zero_are_the_limits(number_type):
    limits = [1.0, 1 / 2, 1 / 6, -1 / 12, -1 / 60, 1 / 12, 1 / 360]
    assert evaluate(number_type, np.zeros(1))[:, 0].tolist() == limits


# Each as a multiple of a coefficient of θ = 2φ, and what it never comes without, as (factor, power)
# of φ: exp ξ and dexp⁻¹ are relative to 1, the displacement to η = 2ν.
HALF = {
    "sinc2": (2, "sinc", 1, 1), "a4": (4, "a", 0.5, 1), "b8": (8, "b", 0.5, 2),
    "c04": (4, "c0", 1, 2), "c116": (16, "c1", 0.5, 3),
}  # fmt: skip


def half_angles(number_type, z):
    if number_type == "lanes":
        found = on_lanes("half_angle_coefficients", z, results=len(HalfAngleCoefficients._fields))
    elif number_type == "arrays":
        found = half_angle_coefficients(z)
    else:
        found = np.array([half_angle_coefficients(x) for x in z.tolist()]).T
    return HalfAngleCoefficients(*found)


@cache
def exact_half_angles():
    """φ², and all functions of it."""
    theta = [np.geomspace(1e-9, module.TINY**0.5, 200), angles(), near_two_pi()]
    z = (np.concatenate(theta) / 2) ** 2
    rows = []
    for phi in map(mp.sqrt, z.tolist()):
        doubled = oracle.coefficients(2 * phi)
        rows.append(
            [-2 * mp.sin(phi / 2) ** 2, mp.sin(phi) / phi]
            + [factor * doubled[name] for factor, name, *_ in HALF.values()]
        )
    return z, HalfAngleCoefficients(*np.array(rows, dtype=float).T)


@every_number
@pytest.mark.parametrize("name", HalfAngleCoefficients._fields)
def test_half_angle_coefficients_sweep(number_type, name):
    z, exact = exact_half_angles()
    theta = 2.0 * np.sqrt(z)
    error = abs(getattr(half_angles(number_type, z), name) - getattr(exact, name))
    tiny = z <= 0.25 * module.TINY
    factor, power = HALF[name][2:] if name in HALF else (1, name == "sinc")
    effect = factor * error * (theta / 2) ** power
    assert effect[tiny].max() <= 2.0**-54
    # as in the sweeps above: 4z is exact
    if "sinc" not in name:
        error /= abs(getattr(exact, name))
    bound = np.where(theta <= np.pi, 1e-15, np.maximum(3e-15, 2e-15 / (2.0 * np.pi - theta)))
    assert_below(error[~tiny], ((2 if name == "sinc2" else 1) * bound)[~tiny], theta[~tiny])


@every_number
def test_half_angle_coefficients_of_a_nan_are_nan(number_type):
    found = np.array(half_angles(number_type, np.array([np.nan, 1e-6, 1.0, 12.0])))
    assert np.isnan(found[:, 0]).all()
    assert np.isfinite(found[:, 1:]).all()


def test_coefficients_cut_over_where_the_tests_are_dense():
    assert pytest.approx(CUTOVERS, rel=1e-15) == [
        module.SMALL**0.5,
        module.MEDIUM**0.5,
        module.SERIES**0.5,
    ]


@every_number
def test_coefficients_of_a_nan_are_nan(number_type):
    found = evaluate(number_type, np.array([np.nan, 1e-6, 1.0, 12.0]))
    assert np.isnan(found[:, 0]).all()
    assert np.isfinite(found[:, 1:]).all()

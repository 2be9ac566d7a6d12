"""Draws: their laws, and that each depends on the seed and the body's number alone.

Seeds are fixed, so that a test passes always or never. Of a right program, each test of a law fails
for one seed in 10⁴ (LEVEL), and for none of those here.
"""

from __future__ import annotations

import doctest
import itertools
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from hashlib import blake2b

import mpmath
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

import lierb
from lierb import sampling
from lierb.errors import ArgumentError, LierbError, MissingExtraError, UnknownNameError
from lierb.sampling import (
    Constant,
    Design,
    Direction,
    Distribution,
    LogNormal,
    Normal,
    Rotation,
    TruncatedNormal,
    Uniform,
    Values,
    distributions,
    inertia_of,
    sobol,
    streams,
)
from lierb.support.arrays import SLICE

LEVEL = 1e-4
LIMIT = stats.norm.isf(LEVEL / 2.0)  # of a normal of mean 0 and std 1
N = 50_000
LEAST, MOST = 2.0**-53, 1.0 - 2.0**-53  # the uniforms nearest to 0 and 1

COVARIANCE = np.array([[4.0, 1.8, -0.5], [1.8, 1.0, 0.2], [-0.5, 0.2, 2.0]])
ANY = {
    "constant": Constant((1.0, 2.0)),
    "uniform": Uniform(-1.0, 3.0),
    "uniform vector": Uniform((0.0, 1.0), (2.0, 1.5)),
    "normal": Normal(5.0, 0.3),
    "normal vector": Normal((1.0, -2.0, 0.0), (0.5, 2.0, 1e-3)),
    "correlated": Normal((1.0, 2.0, 3.0), covariance=COVARIANCE),
    "truncated": TruncatedNormal(1.0, 2.0, -0.5, 4.0),
    "tails": TruncatedNormal(0.0, 1.0, (8.0, -np.inf, -1.0), (np.inf, -8.0, 30.0)),
    "lognormal": LogNormal((2.0, 3.0), (0.1, 1.5)),
    "direction": Direction(),
    "direction, length": Direction(LogNormal(3.0, 0.2)),
    "rotation": Rotation(),
    "values": Values([3.0, 1.0, 2.0]),
    "matrices": Values(np.arange(45.0).reshape(5, 3, 3)),
}  # fmt: skip
WITH_CHANCE = [name for name in ANY if name != "constant"]


def drawn(distribution: Distribution, n: int = N, seed: int = 0, method: str = "random"):
    return Design({"x": distribution}, n, seed, method).draw()["x"]


def assert_law(numbers, law) -> None:
    assert stats.kstest(numbers, law.cdf if hasattr(law, "cdf") else law).pvalue > LEVEL


# ---- the laws ------------------------------------------------------------------------------------

LAWS = {
    "uniform": (Uniform(-1.0, 3.0), [stats.uniform(-1.0, 4.0)]),
    "uniform vector": (
        Uniform((0.0, 1.0), (2.0, 1.5)), [stats.uniform(0.0, 2.0), stats.uniform(1.0, 0.5)],
    ),
    "normal": (Normal(5.0, 0.3), [stats.norm(5.0, 0.3)]),
    "normal vector": (
        Normal((1.0, -2.0, 0.0), (0.5, 2.0, 1e-3)),
        [stats.norm(1.0, 0.5), stats.norm(-2.0, 2.0), stats.norm(0.0, 1e-3)],
    ),
    "one mean for all": (Normal(2.0, (1.0, 3.0)), [stats.norm(2.0, 1.0), stats.norm(2.0, 3.0)]),
    "correlated": (
        Normal((1.0, 2.0, 3.0), covariance=COVARIANCE),
        [stats.norm(i + 1.0, np.sqrt(COVARIANCE[i, i])) for i in range(3)],
    ),
    "truncated": (TruncatedNormal(1.0, 2.0, -0.5, 4.0), [stats.truncnorm(-0.75, 1.5, 1.0, 2.0)]),
    "one bound": (TruncatedNormal(1.0, 2.0, low=0.0), [stats.truncnorm(-0.5, np.inf, 1.0, 2.0)]),
    "no bounds": (TruncatedNormal(1.0, 2.0), [stats.norm(1.0, 2.0)]),
    "tails": (
        TruncatedNormal(0.0, 1.0, (8.0, -np.inf), (np.inf, -8.0)),
        [stats.truncnorm(8.0, np.inf), stats.truncnorm(-np.inf, -8.0)],
    ),
    "lognormal": (
        LogNormal((2.0, 3.0), (0.1, 0.7)), [stats.lognorm(0.1, 0, 2.0), stats.lognorm(0.7, 0, 3.0)],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("distribution", "laws"), LAWS.values(), ids=LAWS)
def test_draws_follow_the_law_of_scipy(distribution, laws):
    columns = drawn(distribution).reshape(N, -1).T
    for numbers, law in zip(columns, laws, strict=True):
        assert_law(numbers, law)
        z = (numbers - law.mean()) / law.std()
        assert abs(z.mean()) < LIMIT / np.sqrt(N)
        # variance of z²: the fourth moment, less one
        assert abs((z**2).mean() - 1.0) < LIMIT * np.sqrt(((z**2 - 1.0) ** 2).mean() / N)


@pytest.mark.parametrize(("distribution", "laws"), LAWS.values(), ids=LAWS)
def test_draw_is_the_quantile_of_each_uniform(distribution, laws):
    u = np.random.default_rng(1).uniform(size=(200, distribution.dimension))
    found = distribution.draw(u).reshape(200, -1)
    if isinstance(distribution, Normal) and distribution.covariance is not None:
        z = stats.norm.ppf(u)
        expected = (1.0, 2.0, 3.0) + z @ np.linalg.cholesky(COVARIANCE).T
    else:
        expected = np.stack([law.ppf(u[:, i]) for i, law in enumerate(laws)], axis=-1)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("distribution", "laws"), LAWS.values(), ids=LAWS)
def test_moments_are_those_of_the_law(distribution, laws):
    """To 1e-9: SciPy's variance of a tail is that accurate, the quadrature a hundred times more."""
    mean, covariance = distribution.moments
    np.testing.assert_allclose(mean, [law.mean() for law in laws], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(covariance.diagonal(), [law.var() for law in laws], rtol=1e-9)
    is_correlated = getattr(distribution, "covariance", None) is not None
    expected = COVARIANCE if is_correlated else np.diag(covariance.diagonal())
    np.testing.assert_array_equal(covariance, expected)


def test_moments_of_a_narrow_truncated_normal_are_those_of_the_uniform():
    """Relative difference 1e-18 of a width of 1e-9 std; 1e-14 for rounding of 200 terms."""
    _, variance = TruncatedNormal(0.0, 1.0, 0.0, 1e-9).moments
    assert variance[0, 0] == pytest.approx(1e-18 / 12.0, rel=1e-13)


@pytest.mark.parametrize(
    "distribution",
    [Direction(Uniform(1.0, 3.0)), Rotation(), Values([[1.0, 2.0], [3.0, 5.0], [4.0, 0.0]])],
    ids=["direction", "rotation", "values"],
)
def test_moments_are_those_of_draws(distribution):
    mean, covariance = distribution.moments
    off = drawn(distribution).reshape(N, -1) - mean
    assert (np.abs(off.mean(axis=0)) < LIMIT * off.std(axis=0) / np.sqrt(N)).all()
    products = off[:, :, None] * off[:, None, :]
    error = np.abs(products.mean(axis=0) - covariance)
    assert (error < LIMIT * products.std(axis=0) / np.sqrt(N)).all()


def test_components_are_independent_or_correlated_as_asked():
    x = drawn(ANY["correlated"]) - (1.0, 2.0, 3.0)
    products = x[:, :, None] * x[:, None, :]
    off = products.mean(axis=0) - COVARIANCE
    assert (np.abs(off) < LIMIT * products.std(axis=0) / np.sqrt(N)).all()
    free = np.corrcoef(drawn(ANY["normal vector"]).T)
    assert (np.abs(free - np.eye(3)) < LIMIT / np.sqrt(N)).all()


@pytest.mark.parametrize(
    "covariance",
    [
        np.diag([1.0, 0.0, 4.0]),
        np.outer((1.0, 2.0, -1.0), (1.0, 2.0, -1.0)),
        [[1.0, 1.0, 0.3], [1.0, 1.0, 0.3], [0.3, 0.3, 2.0]],
        np.zeros((3, 3)),
        [[1.0, 1.0 - 1e-15, 0.0], [1.0 - 1e-15, 1.0, 3e-8], [0.0, 3e-8, 1.0]],
    ],
    ids=["no variance", "rank 1", "twins", "none", "nearly"],
)
def test_semi_definite_covariances_are_reproduced(covariance):
    normal = Normal(0.0, covariance=covariance)
    # images of the unit vectors z, which are the columns of L
    factor = np.array([normal.draw([stats.norm.cdf(row)])[0] for row in np.eye(3)]).T
    # covariances of what is left of a variance below 1e-14 are lost: up to the root of that
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=2e-7)


def test_no_spread_makes_constants():
    u = np.random.default_rng(2).uniform(size=(50, 2))
    np.testing.assert_array_equal(Normal((1.0, 2.0), (0.0, 0.0)).draw(u), [(1.0, 2.0)] * 50)
    np.testing.assert_array_equal(Uniform((1.0, 2.0), (1.0, 2.0)).draw(u), [(1.0, 2.0)] * 50)
    np.testing.assert_array_equal(LogNormal((1.0, 2.0), 0.0).draw(u), [(1.0, 2.0)] * 50)


@pytest.mark.parametrize("name", WITH_CHANCE)
def test_extreme_uniforms_give_finite_draws(name):
    """Every corner of the cube of uniforms, those next to 0 and 1 with it."""
    distribution = ANY[name]
    corners = list(itertools.product((LEAST, 0.5, MOST), repeat=distribution.dimension))
    draws = distribution.draw(corners)
    assert np.isfinite(draws).all()
    if isinstance(distribution, (Uniform, TruncatedNormal)):
        assert (draws >= distribution.low).all()
        assert (draws <= distribution.high).all()


def test_uniform_never_passes_a_bound_by_rounding():
    rng = np.random.default_rng(3)
    low = rng.normal(size=1000)
    high = low + 10.0 ** rng.uniform(-16, 3, size=1000)
    draws = Uniform(low, high).draw([[MOST] * 1000, [LEAST] * 1000])
    assert ((low <= draws) & (draws <= high)).all()


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (8.0, np.inf), (8.0, 8.5), (-np.inf, -8.0), (30.0, np.inf), (40.0, 41.0), (1e3, np.inf),
        (-1e6, -1e6 + 1.0), (-1.0, np.inf), (-2.0, 3.0), (-40.0, 50.0), (-1e-9, 1e-9),
        (3.0, 3.0 + 1e-9), (-np.inf, np.inf),
    ],
)  # fmt: skip
def test_truncated_normal_is_exact_to_rounding_in_the_tails(low, high):
    """Error of each draw, by the distribution function with 60 digits."""
    u = [LEAST, 1e-12, 1e-3, 0.2, 0.5, 0.7, 0.999, 1.0 - 1e-12, MOST]
    found = TruncatedNormal(0.0, 1.0, low, high).draw(np.transpose([u]))
    with mpmath.workdps(60):
        side = -1 if low + high > 0 else 1  # the tail in which no digits are lost
        cdf = lambda x: mpmath.erfc(-side * mpmath.mpf(x) / mpmath.sqrt(2)) / 2
        at_low, at_high = cdf(low), cdf(high)
        for given, x in zip(u, found):
            left = (1 - mpmath.mpf(given)) * at_low + given * at_high - cdf(float(x))
            off = side * left / mpmath.npdf(float(x))
            # a few ulp of x; near 0, of the uniform
            assert abs(off) < 8 * 2.0**-53 * max(1.0, abs(x)), (given, x)


UNIFORMS = [LEAST, 1e-12, 1e-3, 0.2, 0.5, 0.7, 0.999, 1.0 - 1e-12, MOST]
EPS = 2.0**-53


@pytest.mark.parametrize("exponent", [-9, -3, -1, 0, 1, 3, 6, 12, 30, 100, 200, 300])
@pytest.mark.parametrize("place", [-1e3, -3.0, 0.0, 1e-9, 0.25, 0.9, 1.0, 50.0])
def test_truncated_normal_is_accurate_for_any_ratio_of_std_and_width(exponent, place):
    """Bounds 3 and 3.5, a mean `place` widths from 3; the law's integrals by mpmath."""
    low, high, std = 3.0, 3.5, 0.5 * 10.0**exponent
    mean = low + 0.5 * place
    draws = TruncatedNormal(mean, std, low, high).draw(np.transpose([UNIFORMS]))
    # differences of Φ over a width of 10^−exponent, or in a tail of 10^(−(a²/2)/2.3)
    with mpmath.workdps(60 + 2 * abs(exponent)):
        at_low, at_high = (mpmath.mpf(x - mean) / std for x in (low, high))
        side = -1 if at_low + at_high > 0 else 1  # the tail in which no digits are lost
        cdf = lambda z: mpmath.erfc(-side * z / mpmath.sqrt(2)) / 2
        mass = cdf(at_high) - cdf(at_low)
        # the law's own length: its width, a standard deviation, or how fast a tail falls
        spread = min(high - low, std / (1.0 + max(float(at_low), -float(at_high), 0.0)))
        for u, x in zip(UNIFORMS, draws):
            z = (mpmath.mpf(float(x)) - mean) / std
            off = (u * mass - (cdf(z) - cdf(at_low))) / mpmath.npdf(z) * std
            # a few ulp of x, and of the law's length where density is 1/e² of its largest
            assert abs(off) < 16 * EPS * (x + spread), (u, x)


@pytest.mark.parametrize("ratio", [1e-300, 1e-200, 1e-100, 1e-30])
def test_truncated_normal_far_out_is_normal_or_exponential(ratio):
    """Limits of a small std: normal inside, −log(1 − u) std²/distance beyond a bound."""
    std, u = ratio, np.array(UNIFORMS)
    inside = TruncatedNormal(0.0, std, -1.0, 1.0).draw(u[:, None])
    np.testing.assert_allclose(inside, std * stats.norm.ppf(u), rtol=2e-15, atol=EPS * std)
    # Subnormal numbers have an absolute rounding. The next term is (std/distance)², at most 1e-30.
    beyond = TruncatedNormal(-2.0 * std**0.5, std, 0.0, 1.0).draw(u[:, None])
    wanted = 0.5 * std**1.5 * -np.log1p(-u)
    np.testing.assert_allclose(
        beyond, wanted, rtol=1e-14, atol=max(4 * EPS * 0.5 * std**1.5, 5e-324)
    )
    mirrored = TruncatedNormal(2.0 * std**0.5, std, -1.0, 0.0).draw(1.0 - u[:, None])
    kept = 1.0 - (1.0 - u) == u  # uniforms that have a mirror image
    np.testing.assert_allclose(-mirrored[kept], beyond[kept], rtol=1e-14, atol=5e-324)
    assert np.array_equal(
        TruncatedNormal(-9.0, std, 3.0, 5.0).draw(u[:, None]), np.full_like(u, 3.0)
    )


@pytest.mark.parametrize("widths", [1e12, 1e100, 1e300])
def test_truncated_normal_has_as_many_values_as_uniforms(widths):
    u = np.random.default_rng(5).uniform(size=20_000)
    draws = TruncatedNormal(0.3, widths, 0.0, 1.0).draw(u[:, None])
    assert len(np.unique(draws)) == len(np.unique(u))
    np.testing.assert_allclose(draws, u, rtol=1e-11)  # the law's own difference is below 1e-24


@pytest.mark.parametrize(
    ("median", "sigma"), [(1e-300, 160.0), (1e300, 0.0), (1.0, 80.0), (1e-300, 1e-300), (3.0, 1e-8)]
)
def test_log_normal_is_accurate_for_any_size(median, sigma):
    draws = LogNormal(median, sigma).draw(np.transpose([UNIFORMS]))
    for u, x in zip(UNIFORMS, draws):
        exponent = sigma * stats.norm.ppf(u)
        wanted = mpmath.mpf(median) * mpmath.exp(exponent)
        # rounding of the exponent itself is relative to the number; below 2^-1022 there are fewer
        # digits. SciPy's quantile is its own input here.
        assert abs(x - wanted) <= 4 * EPS * (1.0 + abs(exponent)) * wanted + 5e-324, (u, x)


@pytest.mark.parametrize("size", [1e-300, 1e-12, 1.0, 1e12, 1e300])
def test_uniform_and_normal_scale_with_their_width(size):
    u = np.array(UNIFORMS)
    np.testing.assert_allclose(Uniform(0.0, size).draw(u[:, None]), size * u, rtol=2 * EPS)
    wide = Uniform(-size, size).draw(u[:, None])
    np.testing.assert_allclose(wide, 2.0 * size * (u - 0.5), rtol=0.0, atol=2 * EPS * size)
    with mpmath.workdps(60):
        z = [float(mpmath.sqrt(2) * mpmath.erfinv(2 * mpmath.mpf(x) - 1)) for x in UNIFORMS]
    # 4 ulp: Cephes' ndtri claims 2e-16 in most of its range
    np.testing.assert_allclose(
        Normal(0.0, size).draw(u[:, None]), np.multiply(size, z), rtol=8 * EPS
    )


# ---- directions and rotations --------------------------------------------------------------------


def test_directions_are_isotropic():
    v = drawn(Direction(2.5))
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 2.5, rtol=4e-16)
    for i in range(3):
        assert_law(v[:, i] / 2.5, stats.uniform(-1.0, 2.0))
        assert_law(np.arctan2(v[:, i - 1], v[:, i - 2]), stats.uniform(-np.pi, 2.0 * np.pi))
    oblique = v @ np.array([0.48, 0.6, 0.64])
    assert_law(oblique / 2.5, stats.uniform(-1.0, 2.0))
    assert stats.ks_2samp(oblique, -v @ np.array([0.48, -0.64, 0.6])).pvalue > LEVEL


def test_directions_have_as_many_antipodes():
    v = drawn(Direction())
    octants = (v > 0.0) @ np.array([4, 2, 1])
    counts = np.bincount(octants, minlength=8)
    assert stats.chisquare(counts).pvalue > LEVEL
    difference = counts[:4] - counts[:3:-1]  # of opposite octants
    assert (np.abs(difference) < LIMIT * np.sqrt(N / 4.0)).all()


def test_lengths_follow_their_law_whatever_the_direction():
    v = drawn(Direction(LogNormal(3.0, 0.2)))
    lengths = np.linalg.norm(v, axis=1)
    assert_law(lengths, stats.lognorm(0.2, 0.0, 3.0))
    assert_law(v[:, 2] / lengths, stats.uniform(-1.0, 2.0))
    assert abs(np.corrcoef(lengths, v[:, 2])[0, 1]) < LIMIT / np.sqrt(N)


FIXED = {
    "as drawn": np.eye(3),
    "turned": lierb.lie.so3.exp((0.3, -1.1, 2.0)),
    "half a turn": np.diag([-1.0, 1.0, -1.0]),
}


def test_rotations_are_orthogonal_to_rounding():
    r = drawn(Rotation())
    gram = np.einsum("nki,nkj->nij", r, r)
    assert np.abs(gram - np.eye(3)).max() <= 1.0e-15
    np.testing.assert_allclose(np.linalg.det(r), 1.0, rtol=2e-15)


def test_rotations_at_extreme_uniforms_are_rotations():
    r = Rotation().draw(list(itertools.product((LEAST, 0.5, MOST), repeat=3)))
    np.testing.assert_allclose(r.transpose(0, 2, 1) @ r, [np.eye(3)] * 27, atol=1e-15)


@pytest.mark.parametrize("fixed", FIXED.values(), ids=FIXED)
@pytest.mark.parametrize("side", ["left", "right"])
def test_rotations_are_haar(fixed, side):
    """The law is the same after any rotation: of the angle, the axis and every entry."""
    r = drawn(Rotation())
    r = fixed @ r if side == "left" else r @ fixed
    angle = np.arccos(np.clip((np.trace(r, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert_law(angle, lambda x: (x - np.sin(x)) / np.pi)  # density (1 − cos θ)/π
    axis = np.stack((r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]))
    axis /= np.linalg.norm(axis, axis=0)
    for i in range(3):
        assert_law(axis[i], stats.uniform(-1.0, 2.0))
        assert_law(np.arctan2(axis[i - 1], axis[i - 2]), stats.uniform(-np.pi, 2.0 * np.pi))
        for j in range(3):
            assert_law(r[:, i, j], stats.uniform(-1.0, 2.0))
    assert abs(np.corrcoef(angle, axis[2])[0, 1]) < LIMIT / np.sqrt(N)


def test_rotations_have_the_moments_of_haar():
    """Mean 0, and ⟨R_ij R_kl⟩ = δ_ik δ_jl / 3."""
    flat = drawn(Rotation()).reshape(N, 9)
    assert (np.abs(flat.mean(axis=0)) < LIMIT * np.sqrt(1.0 / 3.0 / N)).all()
    products = flat[:, :, None] * flat[:, None, :]
    off = products.mean(axis=0) - np.eye(9) / 3.0
    assert (np.abs(off) < LIMIT * products.std(axis=0) / np.sqrt(N)).all()


def test_values_are_equally_likely():
    counts = np.bincount(drawn(Values([3.0, 1.0, 2.0, 7.0])).astype(int), minlength=8)
    assert counts[[0, 4, 5, 6]].sum() == 0
    assert stats.chisquare(counts[[1, 2, 3, 7]]).pvalue > LEVEL


@pytest.mark.parametrize("k", [1, 2, 3, 7, 10, 1023, 1024, 1025, 99_991])
def test_no_uniform_is_beyond_the_last_value(k):
    assert Values(np.arange(k)).draw([[LEAST], [MOST]]).tolist() == [0.0, k - 1.0]


# ---- a draw depends on the seed and the body's number alone --------------------------------------

CHUNKED = 1200


@pytest.fixture(scope="module", params=["random", "sobol"])
def design(request):
    return Design(ANY, CHUNKED, seed=2**64 - 1, method=request.param)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_bits_do_not_depend_on_the_chunks(design, size):
    whole = design.draw()
    parts = [design.draw(i, min(size, CHUNKED - i)) for i in range(0, CHUNKED, size)]
    for name, values in whole.items():
        assert values.shape == (CHUNKED, *ANY[name].shape)
        np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values)


def test_bits_do_not_depend_on_order_or_threads(design):
    whole = design.draw()
    fresh = pickle.loads(pickle.dumps(design))
    firsts = list(range(0, CHUNKED, 100))[::-1]
    with ThreadPoolExecutor(4) as pool:
        parts = dict(zip(firsts, pool.map(lambda first: fresh.draw(first, 100), firsts)))
    for first, part in parts.items():
        for name, values in part.items():
            np.testing.assert_array_equal(values, whole[name][first : first + 100])


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_bits_do_not_depend_on_slices(method):
    design = Design(ANY, 2 * SLICE, method=method)
    across = design.draw(SLICE - 5, 10)
    for name, values in design.draw(0, SLICE + 5).items():
        np.testing.assert_array_equal(values[-10:], across[name])


@pytest.mark.parametrize("name", WITH_CHANCE)
def test_bits_do_not_depend_on_the_layout_of_the_uniforms(name):
    distribution = ANY[name]
    d = distribution.dimension
    n = 9_999  # of logarithms of numbers in reverse, NumPy rounds one in 300 otherwise
    u = np.random.default_rng(4).uniform(size=(n, d))
    expected = distribution.draw(u)
    spaced = np.zeros((n, 3 * d))
    spaced[:, ::3] = u
    shifted = np.zeros(8 * u.size + 1, dtype=np.uint8)[1:].view(np.float64).reshape(u.shape)
    shifted[:] = u
    for given in (u.copy("F"), u[::-1].copy()[::-1], spaced[:, ::3], shifted, u.tolist()):
        np.testing.assert_array_equal(distribution.draw(given), expected)
    alone = [distribution.draw(row[None])[0] for row in u[:500]]
    np.testing.assert_array_equal(alone, expected[:500])


def test_random_draws_do_not_depend_on_other_quantities_or_n():
    alone = Design({"x": ANY["normal vector"]}, 100, seed=3).draw()["x"]
    among = Design({"y": 1.0, "w": Rotation(), "x": ANY["normal vector"]}, 10**15, seed=3)
    np.testing.assert_array_equal(among.draw(0, 100)["x"], alone)


def test_sobol_draws_do_not_depend_on_n():
    few, many = (Design(ANY, n, seed=3, method="sobol") for n in (100, 3_000_000))
    for name, values in few.draw().items():
        np.testing.assert_array_equal(many.draw(0, 100)[name], values)


def test_draws_belong_to_a_seed_and_a_name():
    names = {"x": Uniform(0.0, 1.0), "y": Uniform(0.0, 1.0)}
    streams = [
        column[lag : N - 1 + lag]
        for seed in (0, 1, 2**63)
        for column in Design(names, N, seed).draw().values()
        for lag in (0, 1)
    ]
    off = np.corrcoef(streams) - np.eye(len(streams))
    assert (np.abs(off) < LIMIT / np.sqrt(N)).all()


def philox(counter: int, key: int) -> list[int]:
    """Four words by Philox4x64-10, after Salmon et al., section 3.3 and their table 2."""
    word = 2**64
    c = [counter >> 64 * i & word - 1 for i in range(4)]
    k = [key & word - 1, key >> 64]
    for _ in range(10):
        high0, low0 = divmod(0xD2E7470EE14C6C93 * c[0], word)
        high1, low1 = divmod(0xCA5A826395121157 * c[2], word)
        c = [high1 ^ c[1] ^ k[0], low1, high0 ^ c[3] ^ k[1], low0]
        k = [(k[0] + 0x9E3779B97F4A7C15) % word, (k[1] + 0xBB67AE8584CAA73B) % word]
    return c


def test_words_are_those_of_philox():
    """A body's uniforms follow from two published algorithms, and are the same for ever."""
    digest = blake2b(b"omega0", digest_size=16, key=(2024).to_bytes(8, "little")).digest()
    key = int.from_bytes(digest, "little")
    body = 10**12 + 1
    start = 3 * body  # word 0 of this body; NumPy's first counter is 1
    stream = [w for c in (start // 4, start // 4 + 1) for w in philox(c + 1, key)]
    expected = stream[start % 4 : start % 4 + 3]
    assert streams.words(2024, "omega0", body, 1, 3).tolist() == [expected]
    assert expected[0] == 0x87BF06A139C14AE


@pytest.mark.parametrize("each", [1, 2, 3, 4, 5, 8])
def test_words_are_a_slice_of_one_stream(each):
    whole = streams.words(5, "x", 0, 61, each)
    for first in range(0, 60, 7):
        np.testing.assert_array_equal(streams.words(5, "x", first, 5, each), whole[first:][:5])


def test_uniforms_are_inside_the_interval():
    ends = streams.uniforms_of(np.array([0, 2**51, 2**52 - 1], dtype=np.uint64))
    assert ends.tolist() == [LEAST, 0.5 + LEAST, MOST]
    np.testing.assert_array_equal(1.0 - (1.0 - ends), ends)


# ---- Sobol points --------------------------------------------------------------------------------

CUBE = {"x": Uniform(0.0, 1.0), "v": Uniform(np.zeros(4), 1.0)}


def cube(n: int, seed: int, method: str):
    return np.column_stack(list(Design(CUBE, n, seed, method).draw().values()))


def test_the_last_sobol_point_takes_no_walk():
    """SciPy would be half a minute on its way; its table is that of its points."""
    design = Design(CUBE, 2**32, 7, "sobol")
    directions = design._sobol._directions[1]
    assert directions.shape == (32, design.dimension)
    last = design.draw(2**32 - 2)
    part = design.draw(2**32 - 3, 3)
    for name, values in last.items():
        np.testing.assert_array_equal(values, part[name][1:])
    assert Design(CUBE, 10**9, 7, "sobol").draw(10**9 - 1)


def test_sobol_points_are_walked_to_where_scipy_has_no_such_table(monkeypatch):
    n = 2 ** (sobol.WALKED_BITS + 3)
    own = Design(CUBE, n, 7, "sobol").draw(n - 5)
    monkeypatch.setattr(sobol, "WALKED_BITS", 64)
    walked = Design(CUBE, n, 7, "sobol").draw(n - 5)
    for name, values in own.items():
        np.testing.assert_array_equal(walked[name], values)


@pytest.mark.parametrize("method", ["random", "grid"])
def test_bodies_far_out_are_drawn_alone(method):
    levels = {str(k): Values(range(1000)) for k in range(6)}
    quantities = levels if method == "grid" else {"m": Uniform(0.0, 1.0)}
    design = Design(quantities, None if method == "grid" else 10**18, method=method)
    assert len(design) == 10**18
    far = design.draw(10**18 - 2, 2)
    for name, values in far.items():
        np.testing.assert_array_equal(values[1:], design.draw(10**18 - 1)[name])


@pytest.mark.parametrize("n", [64, 1000, 1023, 1500])
def test_sobol_points_have_less_discrepancy_than_random_ones(n):
    for seed in range(3):
        spread = [qmc.discrepancy(cube(n, seed, method)) for method in ("sobol", "random")]
        assert spread[0] < 0.3 * spread[1]


def test_sobol_points_are_those_of_scipy():
    engine = qmc.Sobol(5, bits=32, rng=np.random.default_rng(11))
    np.testing.assert_array_equal(
        np.floor(cube(4096, 11, "sobol") * 2.0**32), engine.random(4096) * 2.0**32
    )


@pytest.mark.parametrize("first", [0, 512, 3 * 2**20])
def test_sobol_points_fill_every_interval_once(first):
    design = Design(CUBE, 2**22, 5, "sobol")
    points = np.column_stack(list(design.draw(first, 512).values()))
    for column in points.T:
        assert sorted(np.floor(column * 512)) == list(range(512))


def test_sobol_means_converge_faster_than_random_ones():
    def error(method):
        x = cube(4096, 6, method)
        return abs(np.prod(2.0 * x, axis=1).mean() - 1.0)

    assert error("sobol") < 0.1 * error("random")


def test_two_seeds_scramble_differently():
    first, second = (cube(1000, seed, "sobol") for seed in (0, 1))
    assert not np.isin(first, second).any()


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_design_of_constants_draws_them(method):
    draws = Design({"g": (0.0, 0.0, -9.81), "m": 2.0}, 5, method=method).draw(1, 3)
    np.testing.assert_array_equal(draws["g"], [(0.0, 0.0, -9.81)] * 3)
    np.testing.assert_array_equal(draws["m"], [2.0] * 3)


# ---- grids ---------------------------------------------------------------------------------------


def test_grid_has_every_combination_once():
    levels = {"a": [1.0, 2.0], "b": [(0.0, 1.0), (5.0, 6.0), (7.0, 7.0)], "c": [9.0, 8.0, 7.0, 6.0]}
    named = {name: Values(entries) for name, entries in levels.items()}
    design = Design(
        {"a": named["a"], "m": np.eye(3), "b": named["b"], "c": named["c"]}, method="grid"
    )
    draws = design.draw()
    assert len(design) == 24
    rows = zip(draws["a"].tolist(), map(tuple, draws["b"].tolist()), draws["c"].tolist())
    assert list(rows) == list(itertools.product(*levels.values()))
    np.testing.assert_array_equal(draws["m"], [np.eye(3)] * 24)
    for size in (1, 5):
        parts = [design.draw(i, min(size, 24 - i)) for i in range(0, 24, size)]
        for name, values in draws.items():
            np.testing.assert_array_equal(np.concatenate([p[name] for p in parts]), values)


def test_grid_may_be_huge():
    digits = {f"x{i}": Values(range(10)) for i in range(15)}
    last = Design(digits, 10**15, method="grid").draw(123_456_789_012_345, 1)
    assert [int(last[f"x{i}"][0]) for i in range(15)] == [int(c) for c in "123456789012345"]


# ---- the rest ------------------------------------------------------------------------------------


def test_repr_makes_the_same_distribution_again():
    for distribution in ANY.values():
        again = eval(repr(distribution), vars(sampling) | {"inf": np.inf})
        u = np.full((1, distribution.dimension), 0.3)
        np.testing.assert_array_equal(again.draw(u), distribution.draw(u))


def test_parameters_are_copies_that_cannot_be_changed():
    mean = np.zeros(3)
    normal = Normal(mean, 1.0)
    mean[0] = 5.0
    assert normal.mean[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        normal.mean[0] = 1.0


def test_draws_are_the_callers_to_change():
    for values in Design(ANY, 3).draw().values():
        assert values.flags.writeable
        assert values.flags.c_contiguous


def test_inertia_of_second_moments_is_that_of_six_points():
    mass, moments = 3.0, np.array([0.2, 1.5, 0.01])
    on_axes = np.diag(np.sqrt(3.0 * moments / mass))
    points = (*on_axes, *-on_axes)
    expected = sum(mass / 6.0 * (p @ p * np.eye(3) - np.outer(p, p)) for p in points)
    np.testing.assert_allclose(inertia_of(moments), expected, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("n", [1, 3, 1000])
def test_every_drawn_inertia_is_a_bodys(n):
    moments = drawn(LogNormal(np.full(3, 0.01), 3.0), n)
    inertia = inertia_of(moments)
    assert inertia.shape == (n, 3, 3)
    assert lierb.Body(1.0, inertia).inertia.shape == (n, 3, 3)


def test_design_feeds_the_integrator_chunk_by_chunk():
    """Three bodies of a thousand, drawn and checked as a problem."""
    design = Design(
        {
            "mass": LogNormal(6.0, 0.1),
            "second_moments": LogNormal((0.04, 0.01, 0.01), 0.2),
            "omega": Direction(Uniform(5.0, 9.0)),
        },
        n=1000,
    )
    part = design.draw(997)
    joint = lierb.joints.spherical((-0.15, 0.0, 0.0))
    body = lierb.Body(part["mass"], inertia_of(part["second_moments"]))
    assert lierb.Problem(body, joint).batch_size() == 3
    assert joint.twist(part["omega"]).shape == (3, 6)


BLOCKED = """
import sys
sys.modules["scipy"] = None
import numpy as np, lierb
from lierb.sampling import *
print(Design({"u": Uniform(0.0, 1.0), "r": Rotation(), "d": Direction()}, 3).draw()["r"].shape)
for design in (Design({"z": Normal(0.0, 1.0)}, 1), Design({"u": Uniform(0, 1)}, 1, 0, "sobol")):
    try:
        design.draw()
    except lierb.errors.MissingExtraError as error:
        print(error)
"""


@pytest.mark.slow
def test_scipy_is_needed_by_few_and_asked_for():
    run = subprocess.run(
        [sys.executable, "-c", BLOCKED], capture_output=True, text=True, check=True
    )
    shape, *told = run.stdout.splitlines()
    assert shape == "(3, 3, 3)"
    assert len(told) == 2
    assert all("scipy, which is not installed: " in line for line in told)


def test_import_leaves_scipy_alone():
    code = "import lierb.sampling, sys; print({'scipy.special', 'scipy.stats'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"


def test_missing_scipy_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    for name in ("normal", "truncated", "lognormal"):
        with pytest.raises(MissingExtraError, match="needs scipy, which is not installed"):
            drawn(ANY[name], 1)


@pytest.mark.parametrize("module", [sampling, distributions])
def test_examples_run(module):
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0


class Broken:
    def as_matrix(self):
        raise RuntimeError("no")


U = Uniform(0.0, 1.0)
BAD = {
    "words": (lambda: Uniform("low", 1.0), "low must be numbers, got 'low'"),
    "complex": (lambda: Normal(1j, 1.0), "mean must be numbers"),
    "ragged": (lambda: Values([(1.0,), (1.0, 2.0)]), "values must be numbers"),
    "a matrix of means": (lambda: Normal(np.eye(2), 1.0), r"mean has shape \(2, 2\); .* \(d,\)"),
    "none": (lambda: Uniform((), 1.0), r"low has shape \(0,\); expected a number or \(d,\)"),
    "nan": (lambda: Normal(0.0, (1.0, np.nan)), r"std\[1\] is nan; expected finite"),
    "inf": (lambda: Uniform(0.0, np.inf), "high is inf; expected finite"),
    "lengths": (
        lambda: Uniform((0.0, 0.0), (1.0, 1.0, 1.0)), "differ in .* low has 2, high has 3",
    ),
    "upside down": (
        lambda: Uniform((0.0, 2.0), 1.0), r"low\[1\] is 2.0 and high\[1\] is 1.0; .*low ≤ high",
    ),
    "negative std": (lambda: Normal(0.0, -1.0), "std is -1.0; expected zero or a positive"),
    "no spread": (lambda: Normal(0.0), "give std or covariance="),
    "two spreads": (lambda: Normal(0.0, 1.0, covariance=np.eye(2)), "one of the two"),
    "oblong covariance": (
        lambda: Normal(0.0, covariance=np.ones((2, 3))), r"covariance has shape \(2, 3\)",
    ),
    "flat covariance": (lambda: Normal(0.0, covariance=(1.0, 2.0)), r"expected \(d, d\)"),
    "skew covariance": (
        lambda: Normal(0.0, covariance=[[1.0, 0.2], [0.1, 1.0]]), "not symmetric: .* by 0.1",
    ),
    "indefinite covariance": (
        lambda: Normal(0.0, covariance=[[1.0, 2.0], [2.0, 1.0]]), "semi-definite: .* is -1",
    ),
    "negative variance": (
        lambda: Normal(0.0, covariance=np.diag([1.0, -1e-3])), "semi-definite: .* is -0.001",
    ),
    "covariance without variance": (
        lambda: Normal(0.0, covariance=[[0.0, 1.0], [1.0, 1.0]]), "semi-definite",
    ),
    "covariance of others": (
        lambda: Normal((0.0, 0.0), covariance=np.eye(3)), "mean has 2, covariance has 3",
    ),
    "truncated without spread": (lambda: TruncatedNormal(0.0, 0.0), "std is 0.0; expected a pos"),
    "truncated to nothing": (
        lambda: TruncatedNormal(0.0, 1.0, 1.0, 1.0), "low is 1.0 and high is 1.0; .* low < high",
    ),
    "bound nan": (lambda: TruncatedNormal(0.0, 1.0, np.nan), "low is nan; expected a number or ±"),
    "median": (lambda: LogNormal((1.0, 0.0), 1.0), r"median\[1\] is 0.0; expected a positive"),
    "sigma": (lambda: LogNormal(1.0, -0.1), "sigma is -0.1; expected zero or a positive"),
    "length": (lambda: Direction(-1.0), "length is -1.0; expected zero or a positive number"),
    "lengths of a direction": (lambda: Direction((1.0, 2.0)), r"length has shape \(2,\)"),
    "length in words": (lambda: Direction("long"), "length must be numbers"),
    "one value": (lambda: Values(1.0), "values is 1.0; expected a list"),
    "no values": (lambda: Values([]), r"values has shape \(0,\); expected k numbers"),
    "constant": (lambda: Constant(np.ones((2, 2, 2))), r"value has shape \(2, 2, 2\)"),
    "u of another shape": (lambda: U.draw([0.5]), r"u has shape \(1,\); Uniform takes \(n, 1\)"),
    "too many u": (lambda: Rotation().draw([[0.5] * 4]), r"Rotation takes \(n, 3\)"),
    "u of 1": (lambda: U.draw([[0.5], [1.0]]), r"u\[1, 0\] is 1.0; expected numbers in \(0, 1\)"),
    "u of nan": (lambda: U.draw([[np.nan]]), r"u\[0, 0\] is nan"),
    "matrix that raises": (lambda: Constant(Broken()), r"whose as_matrix\(\) raised RuntimeError"),
    "n of many digits": (lambda: Design({"m": U}, 10**5000), "n=a int; expected a whole number"),
    "n of time": (lambda: Design({"m": U}, np.timedelta64(3, "s")), "n=a timedelta64; expec"),
    "n of words": (lambda: Design({"m": U}, "3"), "n='3'; expected a whole number"),
    "no names": (lambda: Design([U], 5), "quantities must name what is drawn"),
    "no quantities": (lambda: Design({}, 5), "quantities must name"),
    "unnamed": (lambda: Design({3: U}, 5), "quantities has the key 3; expected names"),
    "empty name": (lambda: Design({"": U}, 5), "quantities has the key ''"),
    "quantity in words": (lambda: Design({"m": "two"}, 5), r"quantities\['m'\] must be numbers"),
    "no n": (lambda: Design({"m": U}), "method='random' needs n"),
    "n of 0": (lambda: Design({"m": U}, 0), "n=0; expected a whole number from 1"),
    "n of a half": (lambda: Design({"m": U}, 2.5), "n=2.5; expected a whole number"),
    "n that is true": (lambda: Design({"m": U}, True), "n=True; expected a whole number"),
    "n too large": (
        lambda: Design({"m": U}, 2**32 + 1, 0, "sobol"),
        r'n=4294967297: a Sobol sequence has 2³² = 4294967296 points; .*method="random"',
    ),
    "grid too large": (
        lambda: Design({str(n): Values(range(1000)) for n in range(7)}, method="grid"),
        "n=1000000000000000000000; expected a whole number",
    ),
    "too large": (lambda: Uniform(-1e308, 1e308), "low is -1e\\+308; expected numbers up"),
    "overflow": (lambda: LogNormal((1.0, 2.0), (0.1, 1e3)), r"sigma\[1\] is 1000.0; expected less"),
    "wide covariance": (
        lambda: Normal(0.0, covariance=[[1e-320, 1e300], [1e300, 1e300]]), "semi-definite",
    ),
    "long date": (lambda: Uniform(np.datetime64("2020"), 1.0), "low must be numbers"),
    "text of a number": (lambda: Values(["1.5"]), "values must be numbers"),
    "flag": (lambda: Uniform(0.0, True), "high must be numbers"),
    "masked": (lambda: Values(np.ma.array([1.0, 2.0], mask=[0, 1])), "values has masked entries"),
    "huge": (lambda: Normal(10**400, 1.0), "mean is .*beyond the largest float64"),
    "huge u": (lambda: U.draw([[10**5000]]), "u is .*beyond the largest float64"),
    "masked u": (lambda: U.draw(np.ma.array([[0.5]], mask=[[1]])), "u has masked entries"),
    "text in an array": (lambda: Values(np.array(["1.5"], object)), "values must be numbers"),
    "bytes": (lambda: LogNormal(b"1.5", 0.1), "median must be numbers"),
    "complex u": (lambda: U.draw([[0.5j]]), "u must be numbers"),
    "text for u": (lambda: U.draw("x"), "u must be numbers, got 'x'"),
    "bytes for u": (lambda: U.draw(b"0.5"), "u must be numbers"),
    "date for u": (lambda: U.draw(np.datetime64("2020")), "u must be numbers"),
    "ragged u": (lambda: U.draw([[0.5], [0.5, 0.5]]), "u must be numbers"),
    "objects for u": (lambda: U.draw(np.array([[len]])), "u must be numbers"),
    "nothing for u": (lambda: U.draw(None), r"u (must be numbers|has shape \(\))"),
    "negative seed": (lambda: Design({"m": U}, 5, -1), "seed=-1; expected .* from 0 to 184467"),
    "long seed": (lambda: Design({"m": U}, 5, 2**64), "seed=18446744073709551616; expected"),
    "chance in a grid": (
        lambda: Design({"m": U}, method="grid"),
        r"quantities\['m'\] is Uniform\(low=0.0, high=1.0\); a grid takes Values",
    ),
    "n of a grid": (
        lambda: Design({"a": Values([1, 2]), "b": Values([1, 2, 3])}, 5, method="grid"),
        "n=5, but 2 × 3 make a grid of 6 bodies; leave n out",
    ),
    "first": (lambda: Design({"m": U}, 5).draw(5), "first=5; expected a whole number from 0 to 4"),
    "count": (lambda: Design({"m": U}, 5).draw(3, 3), "count=3; .* from 1 to 2"),
    "no count": (lambda: Design({"m": U}, 5).draw(3, 0), "count=0; .* from 1 to 2"),
    "dimensions": (
        lambda: Design({"m": Uniform(np.zeros(21_202), 1.0)}, 2, 0, "sobol").draw(),
        "take 21202 uniforms; Sobol has 21201",
    ),
    "moments": (lambda: inertia_of((1.0, 0.0, 1.0)), "second_moments is .* kg m²; expected pos"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "told"), BAD.values(), ids=BAD)
def test_bad_argument_is_refused(call, told):
    with pytest.raises(ArgumentError, match=told):
        call()


def test_unknown_method_is_refused():
    with pytest.raises(UnknownNameError, match=r"method=array\(\[0., 0.\]\) is unknown"):
        Design({"m": U}, 5, method=np.zeros(2))
    with pytest.raises(UnknownNameError, match=r"method='sobel' is unknown.*'sobol'") as caught:
        Design({"m": U}, 5, method="sobel")
    assert isinstance(caught.value, LierbError)

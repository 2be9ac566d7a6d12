"""lierb.noise: Random123's known answers, SciPy's normal distribution, the same bits everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special, stats

import lierb
from kernels.packs import FORMULAS, on_lanes
from lierb.errors import ArgumentError
from lierb.kernels.functions.noise import (
    BLOCK_BITS,
    MOST,
    digest,
    drawing,
    logarithm,
    normal_of,
    normals,
    philox,
    uniform,
)
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.signals import Noise
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.kernels.tracing.words import LOW

COUNT = 5  # three blocks, the last one half used
FORMULAS["normals"] = lambda *noise: normals(Noise(*noise), "gyro", COUNT)
FORMULAS["normals_of_seed_7"] = lambda *noise: normals(Noise(7.0, *noise), "gyro", COUNT)

# kat_vectors of Random123 1.14: philox4x32, 10 rounds
KNOWN = (
    ("00000000 00000000 00000000 00000000", "00000000 00000000",
     "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff",
     "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0",
     "d16cfe09 94fdcceb 5001e420 24126ea1"),
)  # fmt: skip


def words(text: str) -> tuple[int, ...]:
    return tuple(int(word, 16) for word in text.split())


def places():
    """Seeds, trajectories and ticks: small, beyond 32 bits, negative ticks; no whole packs."""
    seeds = np.array([0, 1, 7, 2**32 + 5, 2**53 - 1, 3, 3])
    trajectories = np.array([0, 2, 2**31, 2**32, 2**40 + 3, 2**53 - 1, 5])
    ticks = np.array([0, 1, 2**33 + 1, 2**31, -1, -(2**35), 12])
    return seeds.astype(float), trajectories.astype(float), ticks.astype(float)


@pytest.mark.parametrize(("counter", "key", "found"), KNOWN)
def test_philox_gives_the_known_answers(counter, key, found):
    assert philox(words(counter), words(key)) == words(found)


@pytest.mark.parametrize("lanes", sorted({1, DEFAULT_LANES}))
def test_normals_have_the_same_bits_on_every_number_type(lanes):
    by_array = np.array(normals(Noise(*places()), "gyro", COUNT))
    by_float = np.array([normals(Noise(*place), "gyro", COUNT) for place in zip(*places())]).T
    by_lanes = on_lanes("normals", *places(), results=COUNT, lanes=lanes)
    assert np.array_equal(by_array, by_float)
    assert np.array_equal(by_array, by_lanes)


def test_normals_take_one_seed_for_a_pack():
    _, trajectories, ticks = places()
    found = on_lanes("normals_of_seed_7", trajectories, ticks, results=COUNT)
    expected = normals(Noise(7.0, trajectories, ticks), "gyro", COUNT)
    assert np.array_equal(found, expected)


def test_normals_depend_on_every_part_of_their_place():
    seeds, trajectories, ticks = places()
    rows = np.array(normals(Noise(seeds, trajectories, ticks), "gyro", COUNT)).ravel()
    more = [
        normals(Noise(11.0, 12.0, 13.0), "gyro", 1),
        normals(Noise(11.0, 12.0, 13.0), "gyrq", 1),
        normals(Noise(11.0 + 2**40, 12.0, 13.0), "gyro", 1),
        normals(Noise(11.0, 12.0 + 2**40, 13.0), "gyro", 1),
        normals(Noise(11.0, 12.0, 13.0 + 2**40), "gyro", 1),
    ]
    found = [*rows, *(x for (x,) in more)]
    assert len({*found}) == len(found)


def test_components_do_not_depend_on_how_many_are_drawn():
    place = Noise(1.0, 2.0, 3.0)
    most = normals(place, "gyro", MOST)
    assert len({*most}) == MOST  # the counter has room for all of them
    assert MOST // 2 == 2**BLOCK_BITS
    assert normals(place, "gyro", 3) == most[:3]


def test_digest_of_a_name_is_what_it_was():
    """Or the noise of stored studies would be another one."""
    assert digest("gyro") == (0xCE2A39FD, 0x5C9E79EB)


def test_uniform_is_exact_and_open():
    assert uniform(0, 0) == 2.0**-53
    assert uniform(LOW, LOW) == 1.0 - 2.0**-53
    assert uniform(1 << 6, 3 << 6) == (2.0**26 + 3.5) * 2.0**-52


def test_normal_of_is_the_inverse_of_the_distribution():
    rng = np.random.default_rng(3)
    small = 2.0 ** -rng.uniform(1.0, 53.0, 20_000)
    p = np.concatenate([rng.random(20_000), small, 1.0 - small[small > 2.0**-52]])
    p = np.concatenate([p, 0.5 + np.array([-0.425, 0.425, -0.4250001]), [2.0**-53, 1 - 2.0**-53]])
    expected = special.ndtri(p)
    # AS 241 states 1e-16, before rounding; SciPy's has rounding of its own
    np.testing.assert_allclose(normal_of(p), expected, rtol=4e-15, atol=1e-16)
    assert np.array_equal(normal_of(1.0 - p[p > 0.25]), -normal_of(1.0 - (1.0 - p[p > 0.25])))


def test_logarithm_is_to_an_ulp():
    x = 1.4 * 2.0 ** -np.random.default_rng(4).uniform(0.0, 60.0, 50_000)
    error = np.abs(logarithm(x) - np.log(x)) / np.spacing(np.abs(np.log(x)))
    assert error.max() <= 1.0  # fdlibm states < 1; NumPy's own has half of one


def test_sample_is_standard_normal_and_independent():
    samples = lierb.noise.sample(1, np.arange(2000), "gyro", np.arange(20)[:, None], 3)
    assert samples.shape == (20, 2000, 3)
    assert stats.kstest(samples.ravel(), "norm").pvalue > 1e-3  # a fixed seed: no test by chance
    assert abs(samples.mean()) < 4.0 / np.sqrt(samples.size)
    assert abs(samples.var() - 1.0) < 4.0 * np.sqrt(2.0 / samples.size)
    for other in (samples[1:], samples[:, 1:], samples[..., 1:]):  # neighbours in each direction
        same = samples[tuple(slice(n) for n in other.shape)]
        r = np.mean(same * other)
        assert abs(r) < 4.0 / np.sqrt(other.size)


def test_sample_is_what_kernels_draw():
    trajectories = np.arange(4.0)
    samples = lierb.noise.sample(5, trajectories, "gyro", 9, 2)
    expected = normals(Noise(np.full(4, 5.0), trajectories, np.full(4, 9.0)), "gyro", 2)
    assert np.array_equal(samples, np.transpose(expected))
    alone = lierb.noise.sample(5, 2, "gyro", 9)
    assert alone.shape == ()
    assert alone == samples[2, 0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seed": -1}, "seed=-1; expected whole numbers, 0 to"),
        ({"seed": 0.5}, "seed=0.5"),
        ({"seed": [1, 2]}, "seed has shape"),
        ({"trajectory": 2**53 + 1}, "trajectory="),
        ({"seed": 2**53 + 1}, "seed="),
        ({"tick": float("nan")}, "tick=nan"),
        ({"name": ""}, "name=''"),
        ({"size": 0}, "size=0"),
        ({"size": True}, "size=True"),
        ({"size": (2,)}, "size="),
        ({"trajectory": [1, 2], "tick": [1, 2, 3]}, "that broadcast"),
    ],
)
def test_sample_tells_what_is_wrong(given, message):
    arguments = {"seed": 0, "trajectory": 0, "name": "gyro", "tick": 0}
    with pytest.raises(ArgumentError, match=message.replace("(", r"\(")):
        lierb.noise.sample(**(arguments | given))


def test_normal_is_for_controllers():
    with pytest.raises(UnfitFunctionError, match="outside of a controller"):
        lierb.noise.normal("gyro", 3)


@pytest.mark.parametrize("arguments", [("a", 0), ("a", 1.5), ("a", True), ("a", MOST + 1), (3, 1)])
def test_normal_refuses_what_is_no_draw(arguments):
    with drawing(Noise(0.0, 0.0, 0.0)), pytest.raises(UnfitFunctionError):
        lierb.noise.normal(*arguments)


def test_one_name_is_drawn_once():
    with drawing(Noise(0.0, 0.0, 0.0)):
        lierb.noise.normal("gyro")
        lierb.noise.normal("sun", 2)
        with pytest.raises(UnfitFunctionError, match="'gyro' twice"):
            lierb.noise.normal("gyro")

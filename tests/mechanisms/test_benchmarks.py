"""The benchmarks' data and references: what is published, what is conserved, what agrees."""

import functools
import json

import mpmath
import numpy as np
import pytest

from mechanisms import oracle
from mechanisms.benchmarks import A03_PUBLISHED, BENCHMARKS, Benchmark
from mechanisms.make_reference import PATH, off
from mechanisms.minimal import REAL, Jet, solved, turned
from mechanisms.samples import description_of
from mechanisms.test_oracle import EXTENDED

# of the library's own counting: an assembly closes, and moves with this many freedoms
FREEDOMS = {"A01": 1, "A03": 1, "A04": 1, "slider_crank": 1, "rssr": 2,
            "spherical_double_pendulum": 6} | {f"A02_{N}": 1 for N in range(1, 9)}  # fmt: skip


@functools.cache
def benchmark(name: str) -> Benchmark:
    return BENCHMARKS[name]()


def kept(name: str) -> dict:
    return json.loads(PATH.read_text())[name]


def numbers(name: str, t: str) -> np.ndarray:
    found = kept(name)
    return np.array([REAL(v) for v in found["y"][found["times"].index(t)]], REAL)


def stacked(given: Benchmark, what: str) -> np.ndarray:
    return np.stack([given.start[what][x.name] for x in given.mechanism.links])[None]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_start_closes_every_joint_and_moves_along_it(name):
    given = benchmark(name)
    system = oracle.System(description_of(given.mechanism))
    state = system.state(stacked(given, "pose0"), stacked(given, "twist0"))
    rows, _ = system.conditions(system._placed(state))
    assert np.max(np.abs(rows.value)) < 1e-14
    assert np.max(np.abs(rows.rate)) < 1e-13
    assert oracle.mobility(system.given, stacked(given, "pose0"))[0] == FREEDOMS[name]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_links_start_where_the_mechanism_does(name):
    given = benchmark(name)
    for link, s in zip(given.mechanism.links, given.links(given.y0), strict=True):
        pose, twist = given.start["pose0"][link.name], given.start["twist0"][link.name]
        np.testing.assert_allclose(pose[:3, :3], s.R.astype(float), atol=1e-15)
        np.testing.assert_allclose(pose[:3, 3], s.x.astype(float), atol=1e-15)
        np.testing.assert_allclose(pose[:3, :3] @ twist[3:], s.v.astype(float), atol=1e-14)


@pytest.mark.parametrize("name", BENCHMARKS)
def test_independent_solutions_agree(name):
    # as measured when reference.json was made. In maximal coordinates, of 53 bits, A03's
    # accelerations of 1e6 rad/s² round to 1e-12 of its state in a step; those of the others do not
    loosest = dict.fromkeys(("maximal coordinates", "elliptic functions"), 5e-12)
    if name == "A03":
        loosest = {"maximal coordinates": 5e-10, "test set, PSIDE": 1e-7}  # of q̇; see below
    found = kept(name)["agreement"]
    assert "maximal coordinates" in found
    for way, by_time in found.items():
        for t, value in by_time.items():
            assert value < loosest[way], (way, t)


@pytest.mark.slow
@EXTENDED
@pytest.mark.parametrize("name", ["A01", "A02_1", "A04", "slider_crank", "rssr",
                                  "spherical_double_pendulum"])  # fmt: skip
def test_reference_is_what_minimal_coordinates_give(name):
    given, t = benchmark(name), kept(name)["times"][0]
    y, error = given.solve(["0", t])
    assert error < 1e-17
    assert off(given.links(y[-1]), given.links(numbers(name, t))) < 1e-16


@pytest.mark.parametrize("name", [n for n in BENCHMARKS if n != "A03"])
def test_reference_has_the_energy_of_the_start(name):
    given = benchmark(name)
    system = oracle.System(description_of(given.mechanism))
    energies = []
    for y in (given.y0, *(numbers(name, t) for t in kept(name)["times"])):
        total = REAL(0)
        g = system.gravity[0].astype(REAL)
        for i, s in enumerate(given.links(y)):
            m, w = REAL(system.mass[0, i]), s.R.T @ s.w
            if given.mechanism.links[i].name in given.free_axis:
                w[2] = 0  # its spin is none; the frame of minimal coordinates has one of its own
            total += m * (s.v @ s.v / 2 - g @ s.x) + w @ system.inertia[0, i].astype(REAL) @ w / 2
        energies.append(total)
    scale = max(1.0, *(abs(float(e)) for e in energies))
    assert max(abs(float(e - energies[0])) for e in energies) < 1e-14 * scale


def a03_balance(y: np.ndarray):
    """Energy of A03 less the work of its motor, of angles and rates, J."""
    given = benchmark("A03")
    description = description_of(given.mechanism)
    system, total = oracle.System(description), -REAL("0.033") * y[0]
    links = given.links(y)
    for i, s in enumerate(links):
        m, w = REAL(system.mass[0, i]), s.R.T @ s.w
        total += m * (s.v @ s.v) / 2 + w @ system.inertia[0, i].astype(REAL) @ w / 2
    spring = next(f for f in description.forces if isinstance(f, oracle.Spring))
    tip = links[spring.body].x + links[spring.body].R @ spring.point[0].astype(REAL)
    line = tip - spring.anchor[0].astype(REAL)
    stretch = np.sqrt(line @ line) - REAL(spring.length[0])
    return total + REAL(spring.stiffness[0]) * stretch**2 / 2


def test_a03_is_the_published_solution_of_the_test_set():
    found, published = numbers("A03", "0.03"), np.array(A03_PUBLISHED)
    # 1e-9 rad and 1e-7 rad/s where the crank has turned by 16 rad and at 1140 rad/s: the digits
    # that the test set has, as its balance of energy shows
    np.testing.assert_allclose(found[:7].astype(float), published[:7], rtol=3e-10)
    np.testing.assert_allclose(found[7:].astype(float), published[7:], rtol=1e-7)
    start = a03_balance(benchmark("A03").y0)
    assert abs(float(a03_balance(found) - start)) < 1e-14
    assert 1e-10 < abs(float(a03_balance(published.astype(REAL)) - start)) < 3e-10


def test_a04_has_the_moments_of_a_square_bar():
    link = benchmark("A04").mechanism.links[0]
    np.testing.assert_allclose(
        np.sort(np.diag(link.body.inertia)), [0.02 / 12, 1.01 / 12, 1.01 / 12], rtol=1e-15
    )


# ---- the tools of minimal coordinates ----------------------------------------------------------


@EXTENDED
def test_solved_has_extended_precision():
    rng = np.random.default_rng(0)
    A, x = rng.normal(size=(7, 7)).astype(REAL), rng.normal(size=7).astype(REAL)
    A[0, 0] = 0  # a pivot that must be exchanged
    assert np.max(np.abs(solved(A, A @ x) - x)) < 1e-16


@EXTENDED
def test_jets_are_taylor_series():
    # of a rotated vector's norm and inverse, against mpmath's derivatives
    def by_jet(p):
        angle = Jet(p, REAL(1), REAL(0))
        v = turned(1, angle * angle) @ Jet.constant([1, 2, 3])
        w = v.cross(Jet.constant([0, 1, 1]))
        return w.dot(w).sqrt().inverse() * angle.sin()

    def by_mpmath(p):
        c, s = mpmath.cos(p * p), mpmath.sin(p * p)
        v = (c + 3 * s, mpmath.mpf(2), -s + 3 * c)
        w = (v[1] - v[2], -v[0], v[0])
        return mpmath.sin(p) / mpmath.sqrt(sum(x * x for x in w))

    p = REAL("0.7")
    found = by_jet(p)
    with mpmath.workdps(40):
        at = mpmath.mpf("0.7")
        for k, value in enumerate(found):
            wanted = mpmath.diff(by_mpmath, at, k)
            assert abs(mpmath.mpf(np.format_float_positional(value, unique=True)) - wanted) < 1e-17

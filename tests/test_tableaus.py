"""Tableaus check themselves, have the order that they claim, and a user's runs like a named one."""

import math
from collections import Counter
from fractions import Fraction
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest

import lierb
from lierb.errors import ArgumentError, LierbError, UnknownNameError
from lierb.tableaus import TABLEAUS, ButcherTableau, tableau_of

EVERY = pytest.mark.parametrize("tableau", TABLEAUS.values(), ids=TABLEAUS)

# The coefficients of DOP853 have 16 digits and sizes up to 43, and a condition adds products of
# them: 1e-14 is some fifty roundings (1e-15 measured); a wrong digit anywhere shows above it.
CONDITION_TOLERANCE = 1e-14


# ---------------------------------------------------------------- rooted trees

# A tree is the sorted tuple of its root's subtrees; () is the single node. The condition of a tree
# τ is Φ(τ) = 1/γ(τ), Φ its elementary weight, γ its density (Hairer, Nørsett, Wanner, II.2).


def _partitions(total, largest):
    if total == 0:
        yield ()
    for first in range(min(total, largest), 0, -1):
        for rest in _partitions(total - first, first):
            yield (first, *rest)


@cache
def trees(nodes):
    found = set()
    for sizes in _partitions(nodes - 1, nodes - 1):
        forests = [()]
        for size, count in Counter(sizes).items():
            forests = [
                (*forest, *more)
                for forest in forests
                for more in combinations_with_replacement(trees(size), count)
            ]
        found.update(tuple(sorted(forest)) for forest in forests)
    return sorted(found)


def nodes_of(tree):
    return 1 + sum(map(nodes_of, tree))


def density(tree):
    return nodes_of(tree) * math.prod(map(density, tree))


def square(tableau):
    """A as an (s, s) array."""
    s = len(tableau.b)
    return np.array([[*row, *[0.0] * (s - len(row))] for row in tableau.A])


def elementary_weight(tree, A, b):
    def stage_values(subtree):
        values = np.ones(len(b))
        for child in subtree:
            values = values * (A @ stage_values(child))
        return values

    return math.fsum(b * stage_values(tree))


def worst_condition(tableau, order):
    A, b = square(tableau), np.array(tableau.b)
    return max(abs(elementary_weight(t, A, b) - 1 / density(t)) for t in trees(order))


def test_trees_are_as_many_as_known():
    # OEIS A000081: without this count a wrong generator would prove an order by leaving trees out.
    assert [len(trees(n)) for n in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]


# ---------------------------------------------------------------- the catalogue


@EVERY
def test_tableau_satisfies_the_conditions_of_its_order(tableau):
    for order in range(1, tableau.order + 1):
        assert worst_condition(tableau, order) <= CONDITION_TOLERANCE


@EVERY
def test_tableau_claims_its_full_order(tableau):
    # DOP853 misses a condition of order 9 by 2.7e-5, the others one of their next by 8e-3 or more.
    assert worst_condition(tableau, tableau.order + 1) > 1e-6


# Σ bᵢ gᵢ for the eight trees with up to four nodes, as a textbook lists them.
TEXTBOOK = {
    "b": (lambda A, b, c: b.sum(), Fraction(1)),
    "b c": (lambda A, b, c: b @ c, Fraction(1, 2)),
    "b c²": (lambda A, b, c: b @ c**2, Fraction(1, 3)),
    "b A c": (lambda A, b, c: b @ (A @ c), Fraction(1, 6)),
    "b c³": (lambda A, b, c: b @ c**3, Fraction(1, 4)),
    "b c A c": (lambda A, b, c: b @ (c * (A @ c)), Fraction(1, 8)),
    "b A c²": (lambda A, b, c: b @ (A @ c**2), Fraction(1, 12)),
    "b A A c": (lambda A, b, c: b @ (A @ (A @ c)), Fraction(1, 24)),
}


@pytest.mark.parametrize("name", ["RK4", "RK38", "DOP853"])
@pytest.mark.parametrize("condition", TEXTBOOK)
def test_fourth_order_tableau_satisfies_the_textbook_condition(name, condition):
    tableau = TABLEAUS[name]
    left, right = TEXTBOOK[condition]
    got = left(square(tableau), np.array(tableau.b), np.array(tableau.c))
    assert got == pytest.approx(float(right), abs=CONDITION_TOLERANCE)


@EVERY
def test_tableau_nodes_are_the_row_sums(tableau):
    sums = [math.fsum(row) for row in tableau.A]
    # 2e-14: sums of up to ten numbers of size 43, rounded in another order
    np.testing.assert_allclose(tableau.c, sums, rtol=0, atol=2e-14)
    assert tableau.c[0] == 0.0


def test_dop853_has_the_coefficients_of_scipy():
    published = pytest.importorskip("scipy.integrate._ivp.dop853_coefficients")
    tableau = TABLEAUS["DOP853"]
    s = tableau.stages
    # 1e-15 relative: both are decimal prints of the same numbers
    np.testing.assert_allclose(square(tableau), published.A[:s, :s], rtol=1e-15, atol=0)
    np.testing.assert_allclose(tableau.b, published.B, rtol=1e-15, atol=0)
    # 2e-14: ours are the row sums, of up to ten numbers of size 43
    np.testing.assert_allclose(tableau.c, published.C[:s], rtol=0, atol=2e-14)


def _solve(tableau, rate, y, t_end, steps):
    """y′ = rate(y) in a Runge–Kutta loop of the test's own."""
    A, h = square(tableau), t_end / steps
    for _ in range(steps):
        k = []
        for row in A:
            k.append(rate(y + h * sum(a * known for a, known in zip(row, k, strict=False))))
        y += h * math.fsum(w * known for w, known in zip(tableau.b, k, strict=True))
    return y


@EVERY
def test_tableau_shows_its_order_on_a_scalar_equation(tableau):
    if tableau.order == 8:  # y = tan t: hard enough that 24 steps still err by 6e-12
        problem, exact, steps = (lambda y: 1 + y * y, 0.0, 1.2), math.tan(1.2), 12
    else:  # y′ = sin y: the leading error of none of the methods passes through 0 at these steps
        exact = 2 * math.atan(math.tan(0.5) * math.exp(2.0))
        problem, steps = (math.sin, 1.0, 2.0), 16
    coarse, fine = (abs(_solve(tableau, *problem, n) - exact) for n in (steps, 2 * steps))
    # ±0.15: the next term of the error is still felt; a wrong order would be off by 1
    assert math.log2(coarse / fine) == pytest.approx(tableau.order, abs=0.15)


# ---------------------------------------------------------------- checks of a user's tableau


def test_tableau_accepts_full_and_triangular_rows():
    full = ButcherTableau([[0, 0], [1, 0]], [0.5, 0.5], [0, 1])
    assert full.A == ButcherTableau([[], [1]], [0.5, 0.5]).A == ((), (1.0,))
    assert full.c == (0.0, 1.0)


def test_tableau_accepts_arrays():
    made = ButcherTableau(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([0.5, 0.5]))
    assert made.stages == 2
    assert hash(made) == hash(ButcherTableau([[], [1]], [0.5, 0.5]))


BAD_TABLEAUS = {
    "implicit": ({"A": [[0.5]], "b": [1]}, "row 0 of A"),
    "above the diagonal": ({"A": [[0, 1], [1, 0]], "b": [0.5, 0.5]}, "row 0 of A"),
    "row too short": ({"A": [[], []], "b": [0.5, 0.5]}, "row 1 of A"),
    "rows and weights differ": ({"A": [[]], "b": [0.5, 0.5]}, "weights b"),
    "weights add up to 0.9": ({"A": [[], [1]], "b": [0.5, 0.4]}, "weights b"),
    "no stage": ({"A": [], "b": []}, "weights b"),
    "nodes are not row sums": ({"A": [[], [1]], "b": [0.5, 0.5], "c": [0, 0.5]}, r"c\[1\]"),
    "too few nodes": ({"A": [[], [1]], "b": [0.5, 0.5], "c": [0]}, "c"),
    "NaN in A": ({"A": [[], [math.nan]], "b": [0.5, 0.5]}, "A"),
    "NaN in b": ({"A": [[], [1]], "b": [math.nan, 0.5]}, "b"),
    "infinite A": ({"A": [[], [math.inf]], "b": [0.5, 0.5]}, "A"),
    "text in A": ({"A": [[], ["one"]], "b": [0.5, 0.5]}, "A"),
    "A is a number": ({"A": 5, "b": [0.5, 0.5]}, "A"),
    "b is a number": ({"A": [[]], "b": 1.0}, "b"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD_TABLEAUS.values(), ids=BAD_TABLEAUS)
def test_tableau_rejects(arguments, named):
    with pytest.raises(ArgumentError, match=rf"\b{named}"):
        ButcherTableau(**arguments)


def test_tableau_of_returns_a_users_tableau_itself():
    mine = ButcherTableau([[]], [1])
    assert tableau_of(mine) is mine


@pytest.mark.parametrize("method", ["rk4", "RK-4", "dop853", "DOPRI853"])
def test_tableau_of_suggests_the_nearest_name(method):
    with pytest.raises(UnknownNameError, match=r"Did you mean '(RK4|DOP853)'"):
        tableau_of(method)


@pytest.mark.parametrize(
    "method",
    [None, 4, ["RK4"], {"RK4"}, np.array(["RK4", "RK38"])],
    ids=["None", "number", "list", "set", "array"],
)
def test_tableau_of_rejects_what_is_no_name(method):
    with pytest.raises(LierbError, match="method"):
        tableau_of(method)


# ---------------------------------------------------------------- in a run


@pytest.fixture(scope="module")
def top():
    body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
    return lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)))


def run(problem, method):
    twist0 = problem.joint.twist(omega=(2 * np.pi, np.pi, 0.2 * np.pi))
    return lierb.integrate(problem, twist0=twist0, dt=1e-2, t_end=0.3, method=method).summary


def test_integrate_gives_a_users_rk4_the_bits_of_the_named_one(top):
    mine = ButcherTableau(
        [[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]],
        [1 / 6, 1 / 3, 1 / 3, 1 / 6],
        [0, 0.5, 0.5, 1],
        name="mine",
    )
    assert run(top, mine).equals(run(top, "RK4"))  # data only: the metadata names the method


@pytest.mark.slow
def test_integrate_uses_the_users_coefficients(top):
    # Ralston's third-order method; its order on a body is measured elsewhere
    ralston = ButcherTableau([[], [1 / 2], [0, 3 / 4]], [2 / 9, 1 / 3, 4 / 9], order=3)
    assert worst_condition(ralston, 3) <= CONDITION_TOLERANCE
    turned = np.array(run(top, ralston)["rotation"].to_pylist()[0])
    close = np.array(run(top, "RK4")["rotation"].to_pylist()[0])
    # (|ω| dt)³ ≈ 4e-4 a step, over 30 steps of a third-order method: about 1e-5, never 0
    assert 1e-9 < np.abs(turned - close).max() < 1e-3

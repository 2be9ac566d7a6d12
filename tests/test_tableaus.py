"""Tableaus check themselves, and a user's runs like a named one."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lierb
from lierb.errors import ArgumentError, LierbError, UnknownNameError
from lierb.methods import METHODS, TABLEAUS, ButcherTableau, method_named
from lierb.methods.method import StagedMethod

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
    "order is a text": ({"A": [[]], "b": [1], "order": "1"}, "order='1'"),
    "more order than stages": ({"A": [[]], "b": [1], "order": 2}, "order=2; expected"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD_TABLEAUS.values(), ids=BAD_TABLEAUS)
def test_tableau_rejects(arguments, named):
    with pytest.raises(ArgumentError, match=rf"\b{named}"):
        ButcherTableau(**arguments)


# A pair of orders 2 and 1 with a continuous extension that takes a stage at half the step.
PAIR = {
    "A": [[], [1]], "b": [0.5, 0.5], "order": 2, "error": [[-0.5, 0.5]], "error_order": 1,
    "dense": [[1, -1.5, 1], [0, -0.5, 1], [0, 2, -2]], "dense_A": [[0.25, 0.25]], "dense_order": 2,
}  # fmt: skip
HEUN = {"A": [[], [1]], "b": [0.5, 0.5]}
PUSHED = [[], [[1]], [[0.5, 0], [0, 0.5]]]  # Heun's weights, each an exponential of its own


def test_pair_keeps_what_it_is_given():
    made = ButcherTableau(**PAIR)
    assert made.error == ((-0.5, 0.5),)
    assert made.dense == ((1.0, -1.5, 1.0), (0.0, -0.5, 1.0), (0.0, 2.0, -2.0))
    assert made.dense_A == ((0.25, 0.25),)
    assert (made.error_order, made.dense_order) == (1, 2)
    assert hash(made) == hash(ButcherTableau(**PAIR))


def test_tableau_without_them_has_no_pair_nor_output_nor_exponentials():
    made = ButcherTableau(**HEUN)
    assert made.error is made.error_order is made.dense is made.dense_order is None
    assert made.exponentials is None
    assert made.dense_A == ()


def test_rows_of_dense_may_be_short():
    made = ButcherTableau([[], [1]], [0.5, 0.5], dense=[[1, -0.5], [0, 0.5]])
    same = ButcherTableau([[], [1]], [0.5, 0.5], dense=[[1, -0.5, 0], [0, 0.5]])
    assert made.dense == ((1.0, -0.5), (0.0, 0.5))
    assert same.dense == ((1.0, -0.5, 0.0), (0.0, 0.5, 0.0))


def test_exponentials_are_lower_rows():
    full = ButcherTableau(**HEUN, exponentials=[[], [[1, 0]], [[0.5, 0], [0, 0.5]]])
    assert full.exponentials == ((), ((1.0,),), ((0.5, 0.0), (0.0, 0.5)))
    assert full == ButcherTableau(**HEUN, exponentials=PUSHED)


@pytest.mark.parametrize("tableau", TABLEAUS.values(), ids=TABLEAUS)
def test_method_named_the_catalogue_is_made_again_from_its_own_numbers(tableau):
    assert replace(tableau) == tableau


@pytest.mark.parametrize("name", TABLEAUS)
def test_fsal_methods_are_those_known_as_such(name):
    assert TABLEAUS[name].is_fsal == (name in {"BS32", "DP54", "Tsit5", "Verner65"})


BAD_PAIRS = {
    "error adds up to 0.1": ({"error": [[-0.4, 0.5]]}, "row 0 of error adds up to 0.0999"),
    "error is a row": ({"error": [-0.5, 0.5]}, "row 0 of error"),
    "error is zero": ({"error": [[0, 0]]}, "row 0 of error has zeros alone"),
    "error is short": ({"error": [[0]]}, "row 0 of error has 1 numbers; expected 2"),
    "error has no row": ({"error": []}, "error has 0 rows"),
    "error has three rows": ({"error": [[-0.5, 0.5]] * 3}, "error has 3 rows"),
    "error overflows": ({"error": [[1e308, 1e308]]}, "row 0 of error adds up to inf"),
    "error is NaN": ({"error": [[math.nan, 0.5]]}, "row 0 of error"),
    "error without order": ({"error_order": None}, "error is given without error_order"),
    "more order than stages": ({"error_order": 3}, "error_order=3; expected a whole number"),
    "order of many digits": ({"dense_order": 10**5000}, "dense_order="),
    "order of no error": ({"error": None}, "error_order=1 is given without error"),
    "order is no number": ({"error_order": "one"}, "error_order='one'"),
    "order is half": ({"error_order": 1.5}, "error_order=1.5"),
    "order is none at all": ({"error_order": 0}, "error_order=0"),
    "dense is short": ({"dense": [[1, -0.5], [0, 0.5]]}, "dense has 2 rows; expected 3"),
    "dense ends elsewhere": (
        {"dense": [[1, -1.5, 1.1], [0, -0.5, 1], [0, 2, -2]]}, r"row 0 of dense .* not to b\[0\]",
    ),
    "dense ends with another stage": (
        {"dense": [[1, -1.5, 1], [0, -0.5, 1], [0, 2, -1]]}, "row 2 of dense adds up to 1.0",
    ),
    "dense starts elsewhere": (
        {"dense": [[0.5, -1, 1], [0.5, -1, 1], [0, 2, -2]]}, "row 0 of dense starts with 0.5",
    ),
    "dense does not add up to θ": (
        {"dense": [[1, -1, 0.5], [0, -0.5, 1], [0, 2, -2]]}, "what dense has of θ\\^2",
    ),
    "dense is empty": ({"dense": [[], [], []]}, "row 0 of dense starts with 0.0"),
    "dense is a number": ({"dense": 1.0}, "dense"),
    "stages of no dense": ({"dense": None, "dense_order": None}, "dense_A is given without dense"),
    "order of no dense": ({"dense": None, "dense_A": ()}, "dense_order=2 is given without dense"),
    "dense order is no number": ({"dense_order": True}, "dense_order=True"),
    "stage is implicit": ({"dense_A": [[0.25, 0.25, 0.1]]}, "row 0 of dense_A"),
    "stage is short": ({"dense_A": [[0.5]]}, "row 0 of dense_A"),
    "too many stages": ({"dense_A": [[0.0] * 64] * 63}, "A and dense_A have 65 rows"),
    "exponentials and dense": ({"exponentials": PUSHED}, "exponentials and dense"),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "named"), BAD_PAIRS.values(), ids=BAD_PAIRS)
def test_pair_rejects(changes, named):
    with pytest.raises(ArgumentError, match=named):
        ButcherTableau(**PAIR | changes)


BAD_EXPONENTIALS = {
    "no end": (PUSHED[:2], "exponentials has 2 entries; expected 3"),
    "stage differs from A": ([[], [[0.9]], PUSHED[2]], r"exponentials\[1\] .* not to A\[1\]\[0\]"),
    "end differs from b": ([[], [[1]], [[0.5, 0.4]]], r"column 1 of exponentials\[2\] .* b\[1\]"),
    "no exponential": ([[], [], PUSHED[2]], r"column 0 of exponentials\[1\] adds up to 0"),
    "implicit": ([[], [[1, 0.1]], PUSHED[2]], r"row 0 of exponentials\[1\]"),
    "short": ([[], [[1]], [[0.5], [0, 0.5]]], r"row 0 of exponentials\[2\]"),
    "not nested": ([[], [1], [0.5, 0.5]], r"row 0 of exponentials\[1\]"),
    "infinite": ([[], [[math.inf]], PUSHED[2]], r"row 0 of exponentials\[1\]"),
    "number": (1.0, "exponentials"),
}  # fmt: skip


@pytest.mark.parametrize(("given", "named"), BAD_EXPONENTIALS.values(), ids=BAD_EXPONENTIALS)
def test_exponentials_are_rejected(given, named):
    with pytest.raises(ArgumentError, match=named):
        ButcherTableau(**HEUN, exponentials=given)


def test_method_named_returns_a_users_tableau_itself():
    mine = ButcherTableau([[]], [1])
    assert method_named(mine) is mine


@pytest.mark.parametrize("method", ["rk4", "RK-4", "dop853", "DOPRI853"])
def test_method_named_suggests_the_nearest_name(method):
    with pytest.raises(UnknownNameError, match=r"(Did you mean|take) '(RK4|DOP853)'"):
        method_named(method)


@pytest.mark.parametrize(
    "method",
    [None, 4, ["RK4"], {"RK4"}, np.array(["RK4", "RK38"])],
    ids=["None", "number", "list", "set", "array"],
)
def test_method_named_rejects_what_is_no_name(method):
    with pytest.raises(LierbError, match="method"):
        method_named(method)


# ---------------------------------------------------------------- the page


def page_row(name):
    """Row of a method on the page of methods."""
    t = METHODS[name]
    if not isinstance(t, StagedMethod):
        return f"| {name} | {t.order} | … | {t.source} |"
    stages = f"{t.stages}, FSAL" if isinstance(t, ButcherTableau) and t.is_fsal else f"{t.stages}"
    output = "–" if t.dense is None else f"{t.dense_order}"
    if t.dense_A:
        further = len(t.dense_A) - (t.dense_A[0] == t.b)  # f at the end is the next step's first
        output += f", {further} stages more"
    return f"| {name} | {t.order} | {stages} | {t.error_order or '–'} | {output} | {t.source} |"


def test_page_of_methods_lists_what_the_entries_say():
    page = Path(__file__).parents[1] / "docs" / "reference" / "methods.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if re.match(r"\| \w+ \| \d", line)]
    for row, name in zip(rows, METHODS, strict=True):
        expected = page_row(name)
        begin, end = expected.split("…") if "…" in expected else (expected, "")
        assert row.startswith(begin)
        assert row.endswith(end)


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
    turned = np.array(run(top, ralston)["rotation"].to_pylist()[0])
    close = np.array(run(top, "RK4")["rotation"].to_pylist()[0])
    # (|ω| dt)³ ≈ 4e-4 a step, over 30 steps of a third-order method: about 1e-5, never 0
    assert 1e-9 < np.abs(turned - close).max() < 1e-3

"""Butcher tableaus of explicit Runge–Kutta methods, as data that checks itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lierb.arrays import are_finite, as_floats
from lierb.errors import ArgumentError, items_of, require_name, told

# Coefficients are printed with 15 to 20 digits; their sums are that good.
_TOLERANCE = 1e-13
MOST_STAGES = 64  # a step is compiled stage by stage; methods of order 14 have 35


def _numbers(argument: str, given: Any) -> tuple[float, ...]:
    numbers = as_floats(argument, given)
    if numbers.ndim != 1:
        raise ArgumentError(f"{argument} is {told(given)}; expected a row of numbers")
    if numbers.size > MOST_STAGES:
        raise ArgumentError(
            f"{argument} has {numbers.size} numbers; expected {MOST_STAGES} at most"
        )
    if not are_finite(numbers):
        raise ArgumentError(f"{argument} is {told(given)}; expected finite numbers")
    return tuple(numbers.tolist())


@dataclass(frozen=True)
class ButcherTableau:
    """An explicit Runge–Kutta method: k_i = f(t + c_i h, y + h Σ_j A_ij k_j), y ← y + h Σ b_i k_i.

    A : (s, s) or its strictly lower triangle, rows of 0, 1, …, s−1 numbers.   b : (s,).
    c : (s,), optional; must be the row sums of A.   name, order, source: for people.

    Raises ArgumentError unless A is strictly lower triangular, Σ_j A_ij = c_i and Σ b_i = 1.

    >>> import lierb
    >>> lierb.ButcherTableau(A=[[], [2 / 3]], b=[1 / 4, 3 / 4], name="Ralston", order=2).stages
    2
    """

    A: Sequence[Sequence[float]]
    b: Sequence[float]
    c: Sequence[float] | None = None
    name: str = "user's"
    order: int | None = None
    source: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        b = _numbers("b", self.b)
        if not isinstance(self.name, str):
            raise ArgumentError(f"name={told(self.name)}; expected a text")
        given = items_of("A", self.A, "rows of numbers")
        rows = [_numbers(f"row {i} of A", row) for i, row in enumerate(given)]
        if len(rows) != len(b):
            raise ArgumentError(f"the tableau has {len(rows)} rows of A for {len(b)} weights b")
        for i, row in enumerate(rows):
            if len(row) < i or any(x != 0.0 for x in row[i:]):
                raise ArgumentError(
                    f"row {i} of A is {told(row)}; an explicit method has {i} numbers there, "
                    "and zeros after them"
                )
        lower = tuple(row[:i] for i, row in enumerate(rows))
        sums = tuple(float(sum(row)) for row in lower)
        c = sums if self.c is None else _numbers("c", self.c)
        if len(c) != len(b):
            raise ArgumentError(f"the tableau has {len(c)} nodes c for {len(b)} weights b")
        for i, (total, node) in enumerate(zip(sums, c, strict=True)):
            if abs(total - node) > _TOLERANCE:
                raise ArgumentError(f"row {i} of A adds up to {total!r}, but c[{i}] = {node!r}")
        if abs(sum(b) - 1.0) > _TOLERANCE:
            raise ArgumentError(f"the weights b add up to {sum(b)!r}, not to 1")
        object.__setattr__(self, "A", lower)
        object.__setattr__(self, "b", b)
        object.__setattr__(self, "c", c)

    @property
    def stages(self) -> int:
        return len(self.b)


_DOP853_A = (
    (),
    (0.05260015195876773,),
    (0.0197250569845379, 0.0591751709536137),
    (0.02958758547680685, 0, 0.08876275643042054),
    (0.2413651341592667, 0, -0.8845494793282861, 0.924834003261792),
    (0.037037037037037035, 0, 0, 0.17082860872947386, 0.12546768756682242),
    (0.037109375, 0, 0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
    (
        0.03709200011850479,
        0,
        0,
        0.17038392571223998,
        0.10726203044637328,
        -0.015319437748624402,
        0.008273789163814023,
    ),
    (
        0.6241109587160757,
        0,
        0,
        -3.3608926294469414,
        -0.868219346841726,
        27.59209969944671,
        20.154067550477894,
        -43.48988418106996,
    ),
    (
        0.47766253643826434,
        0,
        0,
        -2.4881146199716677,
        -0.590290826836843,
        21.230051448181193,
        15.279233632882423,
        -33.28821096898486,
        -0.020331201708508627,
    ),
    (
        -0.9371424300859873,
        0,
        0,
        5.186372428844064,
        1.0914373489967295,
        -8.149787010746927,
        -18.52006565999696,
        22.739487099350505,
        2.4936055526796523,
        -3.0467644718982196,
    ),
    (
        2.273310147516538,
        0,
        0,
        -10.53449546673725,
        -2.0008720582248625,
        -17.9589318631188,
        27.94888452941996,
        -2.8589982771350235,
        -8.87285693353063,
        12.360567175794303,
        0.6433927460157636,
    ),
)
_DOP853_B = (
    0.054293734116568765,
    0,
    0,
    0,
    0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
)

TABLEAUS: dict[str, ButcherTableau] = {
    tableau.name: tableau
    for tableau in (
        ButcherTableau([[]], [1], name="Euler", order=1),
        ButcherTableau([[], [1]], [1 / 2, 1 / 2], name="Heun", order=2),
        ButcherTableau(
            [[], [1 / 2], [0, 1 / 2], [0, 0, 1]],
            [1 / 6, 1 / 3, 1 / 3, 1 / 6],
            name="RK4",
            order=4,
            source="Kutta, Z. Math. Phys. 46 (1901)",
        ),
        ButcherTableau(
            [[], [1 / 3], [-1 / 3, 1], [1, -1, 1]],
            [1 / 8, 3 / 8, 3 / 8, 1 / 8],
            name="RK38",
            order=4,
            source="Kutta, Z. Math. Phys. 46 (1901), the 3/8 rule",
        ),
        ButcherTableau(
            _DOP853_A,
            _DOP853_B,
            name="DOP853",
            order=8,
            source="Dormand and Prince; Hairer, Nørsett, Wanner, Solving ODEs I, II.5 (dop853.f)",
        ),
    )
}


def tableau_of(method: str | ButcherTableau) -> ButcherTableau:
    """The tableau of a method's name, or the given one."""
    if isinstance(method, ButcherTableau):
        return method
    require_name("method", method, TABLEAUS)
    return TABLEAUS[method]

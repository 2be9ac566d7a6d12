"""The protocols of numbers: who fits them, and what the operators give."""

import numpy as np
import pytest
from llvmlite import ir

from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.numbers import number
from lierb.kernels.numbers.arithmetic import Plain, absolute, floor, fma, rint, sqrt
from lierb.kernels.numbers.dual import Dual, raw
from lierb.kernels.numbers.number import Mask, Number, Operations
from lierb.kernels.numbers.zero import ZERO, Zero
from lierb.kernels.tracing.lanes import DOUBLE, Lane, Trace


def lane(size=2.25):
    function = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "f")
    return Lane(Trace(ir.IRBuilder(function.append_basic_block())), DOUBLE(size))


NUMBERS = {
    "float": 2.25, "scalar": np.float64(2.25), "array": np.array([2.25, 4.0]), "Lane": lane(),
    "Dual": Dual(2.25, (1.0,)), "UserNumber": UserNumber(2.25, (1.0,)), "ZERO": ZERO,
}  # fmt: skip
every_number = pytest.mark.parametrize("x", NUMBERS.values(), ids=NUMBERS)


@every_number
def test_number_fits_the_protocol(x):
    assert isinstance(x, Number)


@every_number
def test_operations_give_numbers_and_comparisons_masks(x):
    results = [-x, x + 1.5, 1.5 + x, x - 1.5, 1.5 - x, x * 1.5, 1.5 * x, x / 1.5]
    results += [fma(x, 1.5, 0.5), sqrt(x), absolute(x), rint(x), floor(x)]
    if x is not ZERO:
        results.append(1.5 / x)
    assert all(isinstance(result, Number) for result in results)
    assert all(isinstance(mask, Mask) for mask in (x < 3, x <= 3, x > 3, x >= 3))


@pytest.mark.parametrize("kind", [Plain, Lane, Dual, UserNumber, Zero])
def test_class_fits_the_protocol(kind):
    assert isinstance(kind, Operations)


def test_the_page_lists_all_classes_by_their_rank():
    for kind in (Plain, Lane, Dual, UserNumber, Zero):
        name = "UserNumber" if kind is UserNumber else kind.__name__
        (line,) = (x for x in number.__doc__.splitlines() if f"`{name}`" in x and x[0] == "|")
        assert int(line.split("|")[-2]) == kind.rank


@every_number
def test_a_formula_has_the_value_that_it_has_on_floats(x):
    def formula(x):
        return fma(x, x, 0.1) / (x - 0.3) + sqrt(1.7 * x)

    if x is not ZERO and not isinstance(x, Lane):
        found = np.atleast_1d(raw(formula(x)))[0]
        assert found == pytest.approx(formula(2.25), rel=4 * 2.0**-53)  # users' numbers fuse sums


def test_nothing_is_divided_by_a_structural_zero():
    for x in NUMBERS.values():
        if x is not ZERO:
            with pytest.raises(ZeroDivisionError, match="structural zero"):
                x / ZERO

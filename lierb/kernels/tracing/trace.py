"""Trace formulas in @njit code: Numba compiles their instructions, not their Python.

A formula is plain Python on numbers. `kernel(formula)` lets @njit code call it: the formula runs on
traced numbers (`lanes.Lane`), once for the type of its result and once for its instructions. Hence
loops over rows and stages, tuples and structural zeros cost nothing at run time, and Numba does not
infer types in a formula.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.extending import lower_builtin, models, register_model

from lierb.compiler.internals import AbstractTemplate, infer_global, signature, tracing_context
from lierb.compiler.tags import TagType
from lierb.kernels.numbers.arithmetic import alike, flatten
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.tracing.arrays import ArrayRef, Index
from lierb.kernels.tracing.lanes import DOUBLE, Lane, Predicate, Trace

ITEMS = (types.float64, types.int64)  # of arrays that formulas take


class LaneType(types.Type):
    """This is the Numba type of a pack of `lanes` doubles."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Lane<{lanes}>")


@register_model(LaneType)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: LaneType) -> None:
        super().__init__(manager, fe_type, ir.VectorType(DOUBLE, fe_type.lanes))


class ConstantType(types.Type):
    """The Numba type of a number that is constant in the trace, such as `ZERO`, has no data."""

    def __init__(self, number: Any) -> None:
        self.number = number
        super().__init__(name=f"Constant<{number!r}>")


register_model(ConstantType)(models.OpaqueModel)


def kernel(formula: Callable[..., Any], numbers_only: bool = False) -> Callable[..., Any]:
    """Let @njit code call `formula`, a function of numbers, tuples, arrays, indices and tags.

    numbers_only : True to convert integer arguments to numbers, and to return constants and
    structural zeros as plain numbers, for callers of any kind. Otherwise integers are indices, and
    constants remain constants for the next formula.
    """
    seen: dict[tuple[types.Type, ...], types.Type] = {}

    def evaluated(*operands: Any) -> Any:
        result = formula(*operands)
        return _as_numbers(operands, result) if numbers_only else result

    class Template(AbstractTemplate):
        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            args = tuple(_floating(a) if numbers_only else types.unliteral(a) for a in args)
            if args not in seen:
                seen[args] = _type_of_trace(_traced_alone(evaluated, args)[0])
            return signature(seen[args], *args)

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        # Spilled packs must not cross cache lines: LLVM aligns the stack to 16 bytes only, unless
        # an attribute is set before registers are allocated.
        builder.function.attributes.alignstack = 64
        builder.function.attributes.add("nounwind")  # llvmlite prints alignstack only with another
        trace = Trace(builder, context)
        traced = [_to_trace(context, trace, t, v) for t, v in zip(sig.args, values, strict=True)]
        return _from_trace(context, builder, sig.return_type, evaluated(*traced))

    infer_global(formula)(Template)
    lower_builtin(formula, types.VarArg(types.Any))(lower)
    return formula


def _floating(ty: types.Type) -> types.Type:
    """Replace integers by float64, also inside tuples; Numba then converts the arguments."""
    if isinstance(ty, types.BaseTuple):
        members = [_floating(t) for t in ty]
        return ty if members == list(ty) else types.Tuple(members)
    return types.float64 if isinstance(ty, types.Integer) else types.unliteral(ty)


def _as_numbers(operands: Any, result: Any) -> Any:
    """Return `result` with constants as traced numbers."""
    if isinstance(result, tuple):
        return alike(result, (_as_numbers(operands, x) for x in result))
    if isinstance(result, Lane):
        return result
    like = next(x for x in flatten(operands) if isinstance(x, Lane))
    return like.constant(0.0 if is_zero(result) else result)


def _traced_alone(formula: Callable[..., Any], args: tuple[types.Type, ...]) -> tuple[Any, Any]:
    """Return formula(*args), and the LLVM function with its trace."""
    context = tracing_context()
    function = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "trace")
    trace = Trace(ir.IRBuilder(function.append_basic_block()))
    values = [ir.Constant(context.get_value_type(t), ir.Undefined) for t in args]
    traced = [_to_trace(context, trace, t, v) for t, v in zip(args, values, strict=True)]
    return formula(*traced), function


def trial(formula: Callable[..., Any], count: int) -> tuple[Any, str]:
    """Trace a formula on `count` packs; return its result, and its LLVM code as text."""
    operands = (LaneType(2),) * count
    result, function = _traced_alone(formula, operands)
    numbers = (x.value.get_reference() if isinstance(x, Lane) else repr(x) for x in flatten(result))
    return result, f"{function.module}\n{' '.join(numbers)}"


def _to_trace(context: Any, trace: Trace, ty: types.Type, value: Any) -> Any:
    builder = trace.builder
    if isinstance(ty, TagType):
        return ty.tag
    if isinstance(ty, ConstantType):
        return ty.number
    if isinstance(ty, types.BaseTuple):
        members = [
            _to_trace(context, trace, t, builder.extract_value(value, i)) for i, t in enumerate(ty)
        ]
        is_named = isinstance(ty, types.BaseNamedTuple)
        return ty.instance_class(*members) if is_named else tuple(members)
    if isinstance(ty, types.Integer):
        return Index(trace, context.cast(builder, value, ty, types.intp))
    if isinstance(ty, types.Float):
        return Lane(trace, context.cast(builder, value, ty, types.float64))
    if isinstance(ty, LaneType):
        return Lane(trace, value)
    if isinstance(ty, types.Array) and ty.layout == "C" and ty.dtype in ITEMS:
        return ArrayRef(trace, context, ty, value)
    raise numba.errors.TypingError(
        f"lierb's formulas take numbers, tuples of numbers and arrays, not {ty}"
    )


def _members(result: Any) -> tuple[Any, ...]:
    """Return the members of a tuple or a dual number, which is a named tuple in compiled code."""
    return result if isinstance(result, tuple) else (result.value, result.parts)


def _type_of_trace(result: Any) -> types.Type:
    if result is None:
        return types.none
    if isinstance(result, (tuple, Dual)):
        kinds = [_type_of_trace(x) for x in _members(result)]
        is_named = hasattr(result, "_fields")
        return types.NamedTuple(kinds, type(result)) if is_named else types.Tuple(kinds)
    if isinstance(result, Predicate):
        return types.boolean
    if isinstance(result, Index):
        return types.intp
    if not isinstance(result, Lane):
        return ConstantType(result if is_zero(result) else float(result))
    return LaneType(result.lanes) if result.lanes > 1 else types.float64


def _from_trace(context: Any, builder: ir.IRBuilder, ty: types.Type, result: Any) -> Any:
    if result is None or isinstance(ty, ConstantType):
        return context.get_dummy_value()
    if isinstance(ty, types.BaseTuple):
        pairs = zip(ty, _members(result), strict=True)
        members = [_from_trace(context, builder, t, x) for t, x in pairs]
        return context.make_tuple(builder, ty, members)
    return result.value

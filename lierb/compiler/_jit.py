"""The one place with Numba options: formulas in @njit code, tags, and compiling.

A formula is plain Python on numbers. `kernel(formula)` lets @njit code call it: Numba asks for the
result's type, and then for its instructions, and both times the formula runs once on traced numbers
(`lanes.Lane`). Loops over rows and stages, tuples and structural zeros thus cost nothing at run
time, and Numba's type inference never sees the inside of a formula.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.callconv import RETCODE_USEREXC, Status, excinfo_ptr_t
from numba.core.compiler_lock import global_compiler_lock
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import (
    NativeValue,
    intrinsic,
    lower_builtin,
    models,
    overload,
    register_model,
    typeof_impl,
    unbox,
)

from lierb.compiler.disk_cache import DiskCache, source_stamp
from lierb.kernels.numbers.arithmetic import alike, flatten
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.lanes import (
    BIT,
    ArrayRef,
    Index,
    Lane,
    LaneType,
    Predicate,
    Trace,
)
from lierb.kernels.numbers.zero import is_zero

# error_model: 1/0 is inf, as in NumPy, without a branch. No fastmath: see lanes.py. Given to every
# function, because the options of its first caller leak into a helper that has none.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


class ConstantType(types.Type):
    """Numba type of a number that the trace knows, `ZERO` above all: no data at run time."""

    def __init__(self, number: Any) -> None:
        self.number = number
        super().__init__(name=f"Constant<{number!r}>")


register_model(ConstantType)(models.OpaqueModel)


# ---- tags: values whose Numba type says everything ---------------------------------------------


class Tag:
    """A hashable description that compiled code is specialised on.

    Its `repr` and the stamp of the package's sources make up the name of its Numba type, and so the
    key of the disk cache: an edited source, another number of lanes or another tableau can never
    find each other's machine code. (Module globals, by contrast, are not in Numba's key.)
    """


class TagType(types.Type):
    """The type of a tag: a name, which is all of it that goes to the disk.

    A tag may hold functions of the user's, whose modules no other process need have.
    """

    def __init__(self, tag: Tag) -> None:
        digest = hashlib.sha256(repr(tag).encode()).hexdigest()[:16]
        super().__init__(name=f"{type(tag).__name__}<{source_stamp()},{digest}>")
        _tags.setdefault(self.name, tag)

    @property
    def tag(self) -> Tag:
        return _tags[self.name]


_tags: dict[str, Tag] = {}  # of this process, by their types' names


register_model(TagType)(models.OpaqueModel)
INT64 = ir.IntType(64)


@dataclass(frozen=True)
class Sources(Tag):
    """The tag of code that depends on nothing but the sources."""


@cache
def _tag_type(tag: Tag) -> TagType:
    return TagType(tag)


@typeof_impl.register(Tag)
def _typeof_tag(tag: Tag, context: Any) -> TagType:
    return _tag_type(tag)


@unbox(TagType)
def _unbox_tag(ty: TagType, obj: Any, context: Any) -> NativeValue:
    return NativeValue(context.context.get_dummy_value())


# ---- compiling ---------------------------------------------------------------------------------


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: njit with OPTIONS and the disk cache, for a function that is no closure."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**OPTIONS, **options)(function)
        if hasattr(dispatcher, "_cache"):  # no: the JIT is off
            dispatcher._cache = DiskCache(function)
        return dispatcher

    return decorate


_ready: dict[tuple[Any, Tag], Callable[..., Any]] = {}
_compiling = threading.RLock()  # compiling may need something compiled


def compiled(dispatcher: Any, tag: Tag, *args: Any) -> Callable[..., Any]:
    """The code of `dispatcher` for (tag, *args): compiled, or from the disk cache, once a process.

    A function of such arguments, and of no others: it spares Numba's look at each one's type.
    """
    key = dispatcher, tag
    if key not in _ready:
        if not hasattr(dispatcher, "compile"):  # the JIT is off
            return dispatcher
        operands = tuple(map(numba.typeof, (tag, *args)))
        undisturbed(_compile, key, operands)
    return _ready[key]


def _compile(key: tuple[Any, Tag], operands: tuple[types.Type, ...]) -> None:
    with _compiling:
        if key not in _ready:
            _ready[key] = key[0].compile(operands)


def undisturbed(work: Callable[..., None], *args: Any) -> None:
    """work(*args) to its end, even where Ctrl-C ends the wait for it.

    Handlers of signals run in the main thread, between any two of its instructions: one that raises
    amidst Numba's work leaves its registries half made, and every later call failing. Hence the
    work is done in a thread of its own; what comes next finds it done, or waits for it.
    """
    if threading.current_thread() is not threading.main_thread():
        work(*args)
        return
    pool = ThreadPoolExecutor(1, "lierb")
    try:
        pool.submit(copy_context().run, work, *args).result()
    finally:
        pool.shutdown(wait=False)


def is_ready(dispatcher: Any, tag: Tag) -> bool:
    """Whether `compiled` has nothing to do any more."""
    return (dispatcher, tag) in _ready


def is_compiling() -> bool:
    """Whether another thread compiles, lierb or anybody: in a forked child, one that it lacks."""
    for lock in (_compiling, global_compiler_lock._lock):
        if not lock.acquire(blocking=False):
            return True
        lock.release()
    return False


_entries: dict[tuple[Any, Tag], Any] = {}
_callable: set[tuple[types.Type, ...]] = set()  # arguments, behind the tag, of code with an entry


def entry_of(dispatcher: Any, tag: Tag, *args: Any) -> Any:
    """What `call` takes to run dispatcher(tag, *args): the address of its code.

    Code called by its address is compiled once; what calls it is compiled once for all tags. A
    caller that Numba links it to would optimise and translate all of it again, and so would each of
    a parallel loop's wrappers: five times in all.
    """
    if (dispatcher, tag) not in _entries:
        if not hasattr(dispatcher, "compile"):  # the JIT is off
            return partial(dispatcher, tag)
        undisturbed(_enter, (dispatcher, tag), tuple(map(numba.typeof, (tag, *args))))
    return _entries[dispatcher, tag]


def _enter(key: tuple[Any, Tag], operands: tuple[types.Type, ...]) -> None:
    with _compiling:
        if key in _entries:
            return
        _compile(key, operands)
        result = key[0].overloads[operands]
        _callable.add(operands[1:])
        _entries[key] = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        _release(result.library)


def kernels_loaded() -> int:
    """How many are in this process's memory."""
    return len(_entries)


def _release(library: Any) -> None:
    """Let go of the LLVM code behind machine code that nothing will be linked with any more.

    3 of the 7 MB that a kernel takes once it is compiled, 1.1 of 1.3 where it came from the disk.
    What is left of the former is lost in LLVM's passes, and with the process.
    """
    library._codegen._engine._ee.remove_module(library._final_module)
    library._final_module = library._shared_module = library._compiled_object = None


def call(entry: Any, *args: Any) -> int:
    """Run the code at an entry, for @njit code; the types are those that it was compiled for.

    Returns 0, or for `raise_again` what was raised: in a parallel loop's thread nobody hears it.
    """
    entry(*args)
    return 0


@overload(call)
def _call(entry, *args):  # no annotations: Numba compares signatures
    return lambda entry, *args: _call_entry(entry, args)


@intrinsic
def _call_entry(context: Any, entry: Any, args: Any) -> Any:
    if tuple(args) not in _callable:
        raise numba.errors.TypingError(f"no code was compiled for {tuple(args)}")
    operands = (types.voidptr, *args)  # the tag's value, which is nothing, goes first

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        convention = context.call_conv
        pointer = convention.get_function_type(types.none, operands).as_pointer()
        code = builder.inttoptr(values[0], pointer)
        tag = context.get_constant_null(types.voidptr)
        members = cgutils.unpack_tuple(builder, values[1])
        status, _ = convention.call_function(builder, code, types.none, operands, [tag, *members])
        raised = builder.ptrtoint(status.excinfoptr, INT64)
        return builder.select(status.is_error, raised, INT64(0))

    return types.int64(entry, args), generate


def raise_again(raised: int) -> None:
    """Raise what `call` has returned, unless it is 0, in compiled code."""


@overload(raise_again)
def _raise_again(raised):  # no annotations: Numba compares signatures
    return lambda raised: _propagate(raised)


@intrinsic
def _propagate(context: Any, raised: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        is_error = builder.icmp_unsigned("!=", values[0], INT64(0))
        with cgutils.if_unlikely(builder, is_error):
            status = Status(
                code=RETCODE_USEREXC, is_ok=BIT(0), is_none=BIT(0), is_error=BIT(1),
                is_stop_iteration=BIT(0), is_python_exc=BIT(0), is_user_exc=BIT(1),
                excinfoptr=builder.inttoptr(values[0], excinfo_ptr_t),
            )  # fmt: skip
            context.call_conv.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.none(raised), generate


# ---- formulas in @njit code --------------------------------------------------------------------


def kernel(formula: Callable[..., Any], numbers_only: bool = False) -> Callable[..., Any]:
    """Let @njit code call `formula`, a function of numbers, tuples, arrays, indices and tags.

    numbers_only: take integers as numbers, and give constants and structural zeros back as plain
    numbers, which any code can use; otherwise integers are indices, and constants stay constants on
    their way to the next formula.
    """
    seen: dict[tuple[types.Type, ...], types.Type] = {}

    def evaluated(*operands: Any) -> Any:
        result = formula(*operands)
        return _as_numbers(operands, result) if numbers_only else result

    class Template(AbstractTemplate):
        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            args = tuple(_floating(a) if numbers_only else types.unliteral(a) for a in args)
            if args not in seen:
                seen[args] = _result_type(evaluated, args)
            return signature(seen[args], *args)

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        # Otherwise packs that leave the registers lie across cache lines: LLVM aligns the stack to
        # 16 bytes only, unless told so before it knows what it will spill.
        builder.function.attributes.alignstack = 64
        builder.function.attributes.add("nounwind")  # llvmlite prints no alignstack on its own
        trace = Trace(builder, context)
        traced = [_to_trace(context, trace, t, v) for t, v in zip(sig.args, values, strict=True)]
        return _from_trace(context, builder, sig.return_type, evaluated(*traced))

    infer_global(formula)(Template)
    lower_builtin(formula, types.VarArg(types.Any))(lower)
    return formula


def take_turn(counter: Any) -> Any:
    """The number in `counter`, an int64 array, then raised by one: no two threads get the same."""
    number = counter[0]
    counter[0] = number + 1
    return number


@intrinsic
def _atomic_increment(context: Any, counter: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        array = context.make_array(counter)(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, ir.Constant(INT64, 1), "monotonic")

    return types.int64(counter), generate


@overload(take_turn)
def _take_turn(counter):  # no annotations: Numba compares signatures
    return lambda counter: _atomic_increment(counter)


def _floating(ty: types.Type) -> types.Type:
    """float64 for integers, also inside tuples: Numba then converts the arguments."""
    if isinstance(ty, types.BaseTuple):
        members = [_floating(t) for t in ty]
        return ty if members == list(ty) else types.Tuple(members)
    return types.float64 if isinstance(ty, types.Integer) else types.unliteral(ty)


def _as_numbers(operands: Any, result: Any) -> Any:
    """`result` with every constant as a traced number."""
    if isinstance(result, tuple):
        return alike(result, (_as_numbers(operands, x) for x in result))
    if isinstance(result, Lane):
        return result
    like = next(x for x in flatten(operands) if isinstance(x, Lane))
    return like.constant(0.0 if is_zero(result) else result)


def _result_type(formula: Callable[..., Any], args: tuple[types.Type, ...]) -> types.Type:
    """Type of formula(*args), found by a trace into a function that is thrown away."""
    return _type_of_trace(_traced_alone(formula, args)[0])


def _traced_alone(formula: Callable[..., Any], args: tuple[types.Type, ...]) -> tuple[Any, Any]:
    """formula(*args), and the function of its own that it was traced into."""
    from numba.core.registry import cpu_target

    context = cpu_target.target_context
    function = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "trace")
    trace = Trace(ir.IRBuilder(function.append_basic_block()))
    values = [ir.Constant(context.get_value_type(t), ir.Undefined) for t in args]
    traced = [_to_trace(context, trace, t, v) for t, v in zip(args, values, strict=True)]
    return formula(*traced), function


def trial(formula: Callable[..., Any], count: int) -> tuple[Any, str]:
    """What a formula of `count` packs returns, and all that it does, as text."""
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
    if isinstance(ty, types.Array) and ty.layout == "C" and ty.dtype == types.float64:
        return ArrayRef(trace, context, ty, value)
    raise numba.errors.TypingError(
        f"lierb's formulas take numbers, tuples of numbers and arrays, not {ty}"
    )


def _members(result: Any) -> tuple[Any, ...]:
    """Of a tuple; of a dual number, which goes from formula to formula as a named tuple does."""
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

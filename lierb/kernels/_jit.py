"""The one place with Numba options: formulas in @njit code, tags, and compiling.

A formula is plain Python on numbers. `kernel(formula)` lets @njit code call it: Numba asks for the
result's type, and then for its instructions, and both times the formula runs once on traced numbers
(`lanes.Lane`). Loops over rows and stages, tuples and structural zeros thus cost nothing at run
time, and Numba's type inference never sees the inside of a formula.
"""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar

import numba
import numpy as np
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
from numba.np.arrayobj import populate_array

from lierb.kernels.arithmetic import flatten
from lierb.kernels.disk_cache import DiskCache, source_stamp
from lierb.kernels.lanes import (
    BIT,
    DOUBLE,
    INT32,
    ArrayRef,
    Index,
    Lane,
    LaneType,
    Predicate,
    branch_on,
    select,
)
from lierb.kernels.zero import is_zero

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
        traced = [_to_trace(context, builder, t, v) for t, v in zip(sig.args, values, strict=True)]
        token = _lowering.set(context)
        try:
            return _from_trace(context, builder, sig.return_type, evaluated(*traced))
        finally:
            _lowering.reset(token)

    infer_global(formula)(Template)
    lower_builtin(formula, types.VarArg(types.Any))(lower)
    return formula


# The context that code is being emitted for; None during a trace that is thrown away.
_lowering: ContextVar[Any] = ContextVar("lowering", default=None)


def call_compiled(
    dispatcher: Any, samples: list[Any], numbers: list[Any], count: int
) -> list[Lane]:
    """`count` numbers from an @njit function that returns so many, called lane by lane.

    samples : arguments like those that it takes: numbers, arrays, tuples of such.
    numbers : all their members, one after the other.

    NaN where it raises, and where it is not called any more: see `Marks`.
    """
    lanes = [x for x in numbers if isinstance(x, Lane)]
    builder, width = lanes[0].builder, max(x.lanes for x in lanes)
    context = _lowering.get()
    if context is None:
        pack = ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE
        return [Lane(builder, ir.Constant(pack, ir.Undefined))] * count
    types_of = tuple(numba.typeof(sample) for sample in samples)
    dispatcher.compile(types_of)
    result = dispatcher.overloads[types_of]
    context.add_linking_libs((result.library,))

    marks = Marks.of(builder, width)
    code = _Lanes(context, result, types_of, samples, len(numbers), count, width)
    traced = (x if isinstance(x, Lane) else lanes[0].constant(float(x)) for x in numbers)
    packs = [x.widened(width).value for x in traced]

    def all_called() -> list[Lane]:
        inward, outward = code.memory(builder)
        code.put(builder, packs, inward)
        code.call_each(builder, inward, outward, marks)
        return code.taken(builder, outward)

    def some_called() -> list[Lane]:
        inward, outward = code.memory(builder)
        code.put(builder, packs, inward)
        builder.call(code.apart(builder.module, marks.lanes), [inward, outward, marks.memory])
        return code.taken(builder, outward)

    found = branch_on(marks.are_clear, all_called, some_called, likely=True)
    fine = marks.pack == float(CLEAR)
    return [select(fine, x, math.nan) for x in found]


class _Lanes:
    """The code that calls a compiled function lane by lane.

    inputs, count : numbers that go in and come out.   width : lanes of these.
    """

    def __init__(
        self,
        context: Any,
        compiled: Any,
        types_of: tuple[types.Type, ...],
        samples: list[Any],
        inputs: int,
        count: int,
        width: int,
    ) -> None:
        self.context, self.compiled = context, compiled
        self.types_of, self.samples = types_of, samples
        self.inputs, self.count, self.width = inputs, count, width

    def _packs(self, count: int) -> ir.Type:
        return ir.ArrayType(ir.ArrayType(DOUBLE, self.width), count)

    def memory(self, builder: ir.IRBuilder) -> tuple[ir.Value, ir.Value]:
        """For what goes in and comes out, a pack for each number."""
        inward = cgutils.alloca_once(builder, self._packs(self.inputs))
        return inward, cgutils.alloca_once(builder, self._packs(self.count))

    def _whole(self, builder: ir.IRBuilder, buffer: ir.Value, n: int) -> ir.Value:
        pack = ir.VectorType(DOUBLE, self.width) if self.width > 1 else DOUBLE
        return builder.bitcast(_place(builder, buffer, n, 0), pack.as_pointer())

    def put(self, builder: ir.IRBuilder, packs: list[ir.Value], inward: ir.Value) -> None:
        for n, value in enumerate(packs):
            builder.store(value, self._whole(builder, inward, n), align=8)

    def taken(self, builder: ir.IRBuilder, outward: ir.Value) -> list[Lane]:
        places = (self._whole(builder, outward, n) for n in range(self.count))
        return [Lane(builder, builder.load(place, align=8)) for place in places]

    def call_each(
        self,
        builder: ir.IRBuilder,
        inward: ir.Value,
        outward: ir.Value,
        marks: Marks,
        only_clear: bool = False,
    ) -> None:
        """Call it for each lane, or for those that are CLEAR only."""
        one = cgutils.alloca_once(builder, ir.ArrayType(DOUBLE, self.inputs))
        with cgutils.for_range(builder, ir.Constant(INT64, self.width)) as loop:
            lane = loop.index if self.width == marks.lanes else None
            is_called = marks.is_clear(lane) if only_clear else BIT(1)
            with builder.if_then(is_called):
                for n in range(self.inputs):
                    number = builder.load(_place(builder, inward, n, loop.index))
                    builder.store(number, _place(builder, one, n))
                cells = (_place(builder, one, n) for n in range(self.inputs))
                arguments = [
                    _argument(self.context, builder, ty, sample, cells)
                    for ty, sample in zip(self.types_of, self.samples, strict=True)
                ]
                status, found = self.context.call_internal_no_propagate(
                    builder, self.compiled.fndesc, self.compiled.signature, arguments
                )
                with cgutils.if_unlikely(builder, status.is_error):
                    address = builder.ptrtoint(status.excinfoptr, INT64)
                    known = builder.select(status.is_user_exc, address, INT64(STOPPED))
                    marks.put(lane, builder.uitofp(known, DOUBLE))
                for n in range(self.count):
                    number = builder.extract_value(found, n)
                    builder.store(number, _place(builder, outward, n, loop.index))

    def apart(self, module: ir.Module, lanes: int) -> ir.Function:
        """A function (inward, outward, marks) that calls it for the lanes that are CLEAR.

        Conditions for each lane keep LLVM from computing several at once: a cheap function would
        take 1.4 times as long, and in a loop of their own, beside the other one, 1.1 times.
        """
        name = f"{self.compiled.fndesc.mangled_name}.{self.width}.{lanes}.clear"
        if name in module.globals:
            found: ir.Function = module.globals[name]
            return found
        marked = ir.ArrayType(DOUBLE, lanes)
        kinds = (self._packs(self.inputs), self._packs(self.count), marked)
        kind = ir.FunctionType(ir.VoidType(), [ty.as_pointer() for ty in kinds])
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        function.attributes.add("noinline")
        builder = ir.IRBuilder(function.append_basic_block())
        inward, outward, memory = function.args
        self.call_each(builder, inward, outward, Marks(builder, lanes, memory), only_clear=True)
        builder.ret_void()
        return function


def _place(builder: ir.IRBuilder, buffer: ir.Value, *index: Any) -> ir.Value:
    steps = (i if isinstance(i, ir.Value) else ir.Constant(INT32, i) for i in (0, *index))
    return builder.gep(buffer, list(steps))


# ---- what functions raise ----------------------------------------------------------------------

CLEAR, SILENT, HEARD, STOPPED = 0, 1, 2, 3  # marks; all beyond are addresses of exceptions


class Marks:
    """Memory of the code that is being emitted, with a number for each lane of a block.

    CLEAR where functions are called; SILENT where they are not, as for a body that has failed. What
    one raises is the number from then on: the address of an exception, or STOPPED, StopIteration
    having none; HEARD once that is known outside. Numba's own way out, a status that each caller
    hands on, would end the other lanes with it.

    An address is exact as a double: it has at most 52 bits on the systems that there are.
    """

    def __init__(self, builder: ir.IRBuilder, lanes: int, memory: ir.Value) -> None:
        self.builder, self.lanes, self.memory = builder, lanes, memory

    @classmethod
    def of(cls, builder: ir.IRBuilder, lanes: int) -> Marks:
        """Those of the function that is being emitted; whoever asks first says how many lanes."""
        function = builder.function
        if not hasattr(function, "lierb_marks"):
            memory = cgutils.alloca_once(builder, ir.ArrayType(DOUBLE, lanes))  # and cleared
            function.lierb_marks = cls(builder, lanes, memory)
        found: Marks = function.lierb_marks
        found.builder = builder
        return found

    @property
    def whole(self) -> ir.Value:
        """A pointer to all of them, as a pack."""
        pack = ir.VectorType(DOUBLE, self.lanes) if self.lanes > 1 else DOUBLE
        return self.builder.bitcast(self.memory, pack.as_pointer())

    @property
    def pack(self) -> Lane:
        return Lane(self.builder, self.builder.load(self.whole, align=8))

    @property
    def are_clear(self) -> Predicate:
        """Whether all of them are CLEAR."""
        return (self.pack == float(CLEAR)).reduced("and")

    def is_clear(self, lane: ir.Value | None) -> ir.Value:
        """Whether a lane's mark is CLEAR; without a lane, whether any is."""
        if lane is None:
            return (self.pack == float(CLEAR)).reduced("or").value
        mark = self.builder.load(_place(self.builder, self.memory, lane))
        return self.builder.fcmp_ordered("==", mark, DOUBLE(CLEAR))

    def put(self, lane: ir.Value | None, mark: ir.Value) -> None:
        """Mark a lane; without a lane, all that are CLEAR."""
        if lane is not None:
            self.builder.store(mark, _place(self.builder, self.memory, lane))
            return
        before = self.pack
        after = select(before == float(CLEAR), Lane(self.builder, mark), before)
        self.builder.store(after.value, self.whole, align=8)


class _Python:
    """The same with the JIT off, where one body is integrated after the other."""

    mark = float(CLEAR)
    exceptions: ClassVar[dict[int, Exception]] = {}


def call_in_python(function: Callable[..., Any], arguments: Any, count: int) -> Any:
    """As `call_compiled`, for a function of one body's plain numbers."""
    if _Python.mark != CLEAR:
        return (math.nan,) * count
    try:
        return function(arguments)
    except Exception as error:
        _Python.mark = float(id(error))
        _Python.exceptions[id(error)] = error
        return (math.nan,) * count


def marks(like: Any) -> Any:
    """The marks of a block, in formulas.   like : a pack of the block's."""
    return Marks.of(like.builder, like.lanes).pack if isinstance(like, Lane) else _Python.mark


def set_marks(numbers: Any) -> None:
    """Write the marks of a block."""
    if isinstance(numbers, Lane):
        known = Marks.of(numbers.builder, numbers.lanes)
        numbers.builder.store(numbers.value, known.whole, align=8)
    else:
        _Python.mark = float(numbers)


def exception_of(mark: int) -> Exception:
    """The exception that a mark is of. To be called once for each address: it frees its memory.

    Arrays among its arguments that lie in memory of the function's caller are gone with that: they
    are replaced by words.
    """
    if mark == STOPPED:
        return StopIteration()
    if mark in _Python.exceptions:
        return _Python.exceptions.pop(mark)
    try:
        _raise(mark)
    except Exception as error:
        error.args = tuple(map(_lasting, error.args))
        return error
    raise AssertionError(f"no exception at {mark:#x}")


def _lasting(argument: Any) -> Any:
    if isinstance(argument, (tuple, list)):
        return tuple(map(_lasting, argument))
    if isinstance(argument, np.ndarray) and argument.base is None and not argument.flags.owndata:
        return f"an array of shape {argument.shape}"
    return argument


@numba.njit(**OPTIONS)
def _raise(address):  # no annotations: Numba compares signatures
    raise_again(address)


def _argument(
    context: Any, builder: ir.IRBuilder, ty: types.Type, sample: Any, cells: Iterator[ir.Value]
) -> ir.Value:
    """A value of that type, its members taken from `cells`: pointers, one after the other."""
    if isinstance(ty, types.Array):
        pointers = [next(cells) for _ in range(sample.size)]
        array = context.make_array(ty)(context, builder)
        sizes = [context.get_constant(types.intp, n) for n in (*sample.shape, *sample.strides)]
        populate_array(
            array, data=pointers[0], shape=sizes[: ty.ndim], strides=sizes[ty.ndim :],
            itemsize=context.get_constant(types.intp, sample.itemsize), meminfo=None,
        )  # fmt: skip
        return array._getvalue()
    if isinstance(ty, types.BaseTuple):
        members = [
            _argument(context, builder, t, x, cells) for t, x in zip(ty, sample, strict=True)
        ]
        return context.make_tuple(builder, ty, members)
    return builder.load(next(cells))


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
        return types.Tuple([_floating(t) for t in ty])
    return types.float64 if isinstance(ty, types.Integer) else types.unliteral(ty)


def _as_numbers(operands: Any, result: Any) -> Any:
    """`result` with every constant as a traced number."""
    if isinstance(result, tuple):
        return tuple(_as_numbers(operands, x) for x in result)
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
    builder = ir.IRBuilder(function.append_basic_block())
    values = [ir.Constant(context.get_value_type(t), ir.Undefined) for t in args]
    traced = [_to_trace(context, builder, t, v) for t, v in zip(args, values, strict=True)]
    return formula(*traced), function


def trial(formula: Callable[..., Any], count: int) -> tuple[Any, str]:
    """What a formula of `count` packs returns, and all that it does, as text."""
    operands = (LaneType(2),) * count
    result, function = _traced_alone(formula, operands)
    numbers = (x.value.get_reference() if isinstance(x, Lane) else repr(x) for x in flatten(result))
    return result, f"{function.module}\n{' '.join(numbers)}"


def _to_trace(context: Any, builder: ir.IRBuilder, ty: types.Type, value: Any) -> Any:
    if isinstance(ty, TagType):
        return ty.tag
    if isinstance(ty, ConstantType):
        return ty.number
    if isinstance(ty, types.BaseTuple):
        members = [builder.extract_value(value, i) for i in range(len(ty))]
        return tuple(_to_trace(context, builder, t, v) for t, v in zip(ty, members, strict=True))
    if isinstance(ty, types.Integer):
        return Index(builder, context.cast(builder, value, ty, types.intp))
    if isinstance(ty, types.Float):
        return Lane(builder, context.cast(builder, value, ty, types.float64))
    if isinstance(ty, LaneType):
        return Lane(builder, value)
    if isinstance(ty, types.Array) and ty.layout == "C" and ty.dtype == types.float64:
        return ArrayRef(context, builder, ty, value)
    raise numba.errors.TypingError(
        f"lierb's formulas take numbers, tuples of numbers and arrays, not {ty}"
    )


def _type_of_trace(result: Any) -> types.Type:
    if result is None:
        return types.none
    if isinstance(result, tuple):
        return types.Tuple([_type_of_trace(x) for x in result])
    if isinstance(result, Predicate):
        return types.boolean
    if not isinstance(result, Lane):
        return ConstantType(result if is_zero(result) else float(result))
    return LaneType(result.lanes) if result.lanes > 1 else types.float64


def _from_trace(context: Any, builder: ir.IRBuilder, ty: types.Type, result: Any) -> Any:
    if result is None or isinstance(ty, ConstantType):
        return context.get_dummy_value()
    if isinstance(result, tuple):
        members = [_from_trace(context, builder, t, x) for t, x in zip(ty, result, strict=True)]
        return context.make_tuple(builder, ty, members)
    return result.value

"""The one place with Numba options: formulas in @njit code, tags, and the disk cache.

A formula is plain Python on numbers. `kernel(formula)` lets @njit code call it: Numba asks for the
result's type, and then for its instructions, and both times the formula runs once on traced numbers
(`lanes.Lane`). Loops over rows and stages, tuples and structural zeros thus cost nothing at run
time, and Numba's type inference never sees the inside of a formula.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import llvmlite
import numba
from filelock import FileLock
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.callconv import RETCODE_USEREXC, Status, excinfo_ptr_t
from numba.core.runtime import rtsys
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
from lierb.kernels.lanes import BIT, DOUBLE, INT32, ArrayRef, Index, Lane, LaneType, Predicate
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


@cache
def source_stamp() -> str:
    """Digest of every source that compiled code depends on, and of the compilers."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


source_stamp()  # now: later, a file may differ from what this process has imported


# ---- the disk cache ----------------------------------------------------------------------------


class Unknown:
    """What stands in an index for an object that is not plain data."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __setstate__(self, _: Any) -> None: ...


class PlainUnpickler(pickle.Unpickler):
    """Reads text, numbers and their collections; imports nothing and calls nothing."""

    def find_class(self, module: str, name: str) -> type[Unknown]:
        return Unknown


class CacheFiles(IndexDataCacheFile):
    """Numba's index and data files, of which a damaged or foreign one is as good as none.

    The index is text: key → data file. A data file begins with the digest of the rest, and names
    the key that it is of; only then is it unpickled.
    """

    def save(self, key: str, data: Any) -> None:
        super().save(key, (key, data))

    def load(self, key: str) -> Any:
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None

    def _load_index(self) -> dict[str, str]:
        try:
            stream = io.BytesIO(Path(self._index_path).read_bytes())
            version = PlainUnpickler(stream).load()
            stamp, entries = PlainUnpickler(stream).load()
            known = (version, stamp) == (self._version, self._source_stamp)
            plain = {k: v for k, v in entries.items() if isinstance(k, str) and isinstance(v, str)}
        except Exception:  # there is no telling what unpickling nonsense raises
            return {}
        return plain if known else {}

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(content).digest() + content)

    def _load_data(self, name: str) -> Any:
        stored = Path(self._data_path(name)).read_bytes()
        digest, content = stored[:DIGEST_SIZE], stored[DIGEST_SIZE:]
        return pickle.loads(content) if hashlib.sha256(content).digest() == digest else None


DIGEST_SIZE = hashlib.sha256().digest_size


class QuickCache(FunctionCache):
    """Numba's cache of a function, which loads machine code without what only a compiler needs.

    Numba imports all its overloads first, and with them scipy.linalg where SciPy is installed: two
    thirds of the time to a process's first result.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = CacheFiles(
            self.cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)  # arrays count references
        try:
            return self._load_overload(sig, target_context)
        except Exception:  # what cannot be loaded is compiled, and saved in its place
            return None

    def _index_key(self, sig: Any, codegen: Any) -> str:
        """Numba's key as text: it holds types, and these whatever they are made of."""
        return hashlib.sha256(repr(super()._index_key(sig, codegen)).encode()).hexdigest()


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: njit with OPTIONS and the disk cache."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(cache=True, **OPTIONS, **options)(function)
        if hasattr(dispatcher, "_cache"):  # no: the JIT is off
            dispatcher._cache = QuickCache(function)
        return dispatcher

    return decorate


_ready: dict[tuple[Any, Tag], Callable[..., Any]] = {}
_compiling = threading.Lock()


def compiled(dispatcher: Any, tag: Tag, *args: Any) -> Callable[..., Any]:
    """The code of `dispatcher` for (tag, *args): compiled, or from the disk cache, once a process.

    A function of such arguments, and of no others: it spares Numba's look at each one's type.

    Numba's cache index has neither lock nor check on load: two processes that write it at once can
    pair one's entry with the other's code. Hence a file lock around whatever may load or save.
    """
    key = dispatcher, tag
    if key not in _ready:
        if not hasattr(dispatcher, "compile"):  # the JIT is off
            return dispatcher
        with _compiling:
            if key not in _ready:
                with _cache_lock(dispatcher):
                    _ready[key] = dispatcher.compile(tuple(map(numba.typeof, (tag, *args))))
    return _ready[key]


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
        compiled(dispatcher, tag, *args)
        operands = tuple(map(numba.typeof, (tag, *args)))
        result = dispatcher.overloads[operands]
        _callable.add(operands[1:])
        address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        _entries[dispatcher, tag] = address
    return _entries[dispatcher, tag]


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


@contextmanager
def _cache_lock(dispatcher: Any) -> Iterator[None]:
    folder = Path(dispatcher.stats.cache_path)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / "lierb.lock"):
        _prune(folder, dispatcher.py_func)
        yield


def _prune(folder: Path, function: Callable[..., Any]) -> None:
    """Delete code that other versions of the sources left behind: no tag can ask for it again."""
    mark = folder / f"{_stem(function)}.stamp"
    if mark.exists() and mark.read_bytes() == source_stamp().encode():
        return
    for entry in folder.glob(f"{_stem(function)}-*.nb[ic]"):
        entry.unlink(missing_ok=True)
    mark.write_bytes(source_stamp().encode())


def cached_kernels(dispatcher: Any) -> list[Path]:
    """The files of machine code that the disk cache holds for this version of the sources."""
    folder, stem = Path(dispatcher.stats.cache_path), _stem(dispatcher.py_func)
    mark = folder / f"{stem}.stamp"
    if not mark.exists() or mark.read_bytes() != source_stamp().encode():
        return []
    return sorted(folder.glob(f"{stem}-*.nbc"))


def _stem(function: Callable[..., Any]) -> str:
    """How the names of its files in the cache begin."""
    return f"{function.__module__.rsplit('.', 1)[-1]}.{function.__qualname__}"


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
    """
    lanes = [x for x in numbers if isinstance(x, Lane)]
    builder, width = lanes[0].builder, max(x.lanes for x in lanes)
    pack = ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE
    context = _lowering.get()
    if context is None:
        return [Lane(builder, ir.Constant(pack, ir.Undefined))] * count
    types_of = tuple(numba.typeof(sample) for sample in samples)
    dispatcher.compile(types_of)
    result = dispatcher.overloads[types_of]
    context.add_linking_libs((result.library,))

    def memory(*extents: int) -> ir.Value:
        ty: ir.Type = DOUBLE
        for extent in reversed(extents):
            ty = ir.ArrayType(ty, extent)
        return cgutils.alloca_once(builder, ty)

    def place(buffer: ir.Value, *index: Any) -> ir.Value:
        steps = (i if isinstance(i, ir.Value) else ir.Constant(INT32, i) for i in (0, *index))
        return builder.gep(buffer, list(steps))

    def whole(buffer: ir.Value, n: int) -> ir.Value:
        return builder.bitcast(place(buffer, n, 0), pack.as_pointer())

    inward, one, outward = memory(len(numbers), width), memory(len(numbers)), memory(count, width)
    for n, number in enumerate(numbers):
        traced = number if isinstance(number, Lane) else lanes[0].constant(float(number))
        builder.store(traced.widened(width).value, whole(inward, n), align=8)
    with cgutils.for_range(builder, ir.Constant(INT64, width)) as loop:
        for n in range(len(numbers)):
            builder.store(builder.load(place(inward, n, loop.index)), place(one, n))
        cells = (place(one, n) for n in range(len(numbers)))
        arguments = [
            _argument(context, builder, ty, sample, cells)
            for ty, sample in zip(types_of, samples, strict=True)
        ]
        found = context.call_internal(builder, result.fndesc, result.signature, arguments)
        for n in range(count):
            builder.store(builder.extract_value(found, n), place(outward, n, loop.index))
    return [Lane(builder, builder.load(whole(outward, n), align=8)) for n in range(count)]


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

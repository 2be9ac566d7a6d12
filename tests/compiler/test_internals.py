"""Private parts of Numba on which lierb relies: a test of each fails if the part changes."""

from __future__ import annotations

import ast
import ctypes
import operator
import re
import threading
from dataclasses import dataclass
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from llvmlite import ir
from numba import float64, int64, types
from numba.extending import intrinsic, models, overload, register_model

import lierb
from lierb.compiler import internals
from lierb.compiler.code import OPTIONS
from lierb.compiler.entries import call, entry_of, raise_again
from lierb.compiler.internals import ALLOCATES_NOTHING, INT64, cgutils
from lierb.compiler.tags import Tag, TagType
from lierb.kernels.tracing.trace import kernel

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="nothing is compiled with the JIT off"
)

ROOT = Path(lierb.__file__).parent
SOURCES = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}
PUBLIC = {"numba", "numba.extending", "numba.types", "llvmlite", "llvmlite.ir", "llvmlite.binding"}
RELIED_ON = set()


def relies_on(*names):
    RELIED_ON.update(names)
    return lambda test: test


def imports(tree):
    """(module, name) of each name that a module imports from another."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)


def test_every_private_part_has_a_test():
    tree = ast.parse(SOURCES["compiler/internals.py"].read_text())
    imported = {
        name for module, name in imports(tree) if module.startswith("numba.") and name != "cgutils"
    }
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    used = {
        f"cgutils.{node.attr}"
        for path in SOURCES.values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "cgutils"
    }
    assert imported | functions | used | {"ALLOCATES_NOTHING", "COMPILER_LOCK"} == RELIED_ON


def test_no_other_module_imports_a_private_part():
    warnings_of = {
        (source, module, name)
        for source, path in SOURCES.items()
        for module, name in imports(ast.parse(path.read_text()))
        if module.split(".")[0] in ("numba", "llvmlite")
        and (module not in PUBLIC or name in ("core", "np", "misc"))
    }
    assert {source for source, *_ in warnings_of} == {"compiler/internals.py"}, warnings_of


# ---------------------------------------------------------------- translating once


@dataclass(frozen=True)
class Slope(Tag):
    factor: float


def sloping(tag, x):
    return tag.factor * x


kernel(sloping)


@numba.njit(**OPTIONS, inline="always")
def added(tag, total, x):
    if x > 1.0:
        total = total + sloping(tag, x)
    return total


@numba.njit(**OPTIONS, pipeline_class=internals.compiler_that_translates_once(TagType))
def sloping_sum(tag, numbers):
    total, count = 0.0, 0
    while count < numbers.shape[0]:
        total = added(tag, total, numbers[count])
        count += 1
    return total


def passes_of(result):
    return {name.partition("_")[2] for name in result.metadata["pipeline_times"]["nopython"]}


@relies_on("PassManager", "FixupArgs", "build_definitions", "compiler_that_translates_once")
def test_a_function_is_translated_once_for_all_tags():
    doubles, halves = np.array((1.0, 2.0, 3.0)), np.array((1.0, 2.0, 3.0), np.float32)
    passes = []
    for factor, numbers in ((1.0, doubles), (2.0, doubles), (4.0, doubles), (8.0, halves)):
        assert sloping_sum(Slope(factor), numbers) == 5.0 * factor
        operands = tuple(map(numba.typeof, (Slope(factor), numbers)))
        passes.append(passes_of(sloping_sum.overloads[operands]))
    translated = [{"translate_bytecode", "inline_inlinables"} <= names for names in passes]
    assert translated == [True, False, False, True]  # again for numbers of another type
    assert ["lierb_copying" in names for names in passes] == [False, True, True, False]


# ---------------------------------------------------------------- replacing Python's own


@relies_on("CompilerBase", "DefaultPassBuilder", "FunctionPass", "register_pass")
@relies_on("NopythonTypeInference", "TypingError", "ir", "compiler_that_replaces")
@relies_on("_assignments", "_replace", "_is_of_integers")
def test_a_compiler_replaces_operators_and_calls_that_give_integers():
    def stand_in(*_):
        raise NotImplementedError

    @overload(stand_in)
    def typed(a, b):
        if isinstance(a, types.Integer) and isinstance(b, types.Integer):
            return lambda a, b: 1000
        return None

    def sized(_):
        raise NotImplementedError

    @overload(sized)
    def typed_size(a):
        return lambda a: 2000

    functions = {
        (operator.add, 2): stand_in, (operator.iadd, 2): stand_in, (pow, 2): stand_in,
        (operator.neg, 1): sized, (abs, 1): sized, (types.int32, 1): sized,
    }  # fmt: skip
    options = {"pipeline_class": internals.compiler_that_replaces(functions)}

    def in_place(a, b):
        a += b
        return a

    for function in (lambda a, b: a + b, in_place, lambda a, b: pow(a, b)):
        replaced = numba.njit(function, **options)
        assert replaced(2, 3) == 1000
        assert replaced(2.0, 3.0) == function(2.0, 3.0)
    for function in (lambda a: -a, lambda a: abs(a), lambda a: np.int32(a)):
        assert numba.njit(function, **options)(3) == 2000
    assert numba.njit(lambda a: -a, **options)(3.5) == -3.5
    assert numba.njit(lambda a: a + 1, **options)(np.zeros(2)).tolist() == [1.0, 1.0]


# ---------------------------------------------------------------- emitting code


def computed(emit, *given):
    """Result of compiled code that `emit(context, builder, values)` has emitted."""

    @intrinsic
    def emitted(context, values):
        def generate(context, builder, sig, values):
            return emit(context, builder, cgutils.unpack_tuple(builder, values[0]))

        return float64(values), generate

    return numba.njit(lambda *values: emitted(values))(*given)


@relies_on("cgutils.alloca_once")
def test_alloca_once_zeroes_what_it_allocates():
    # twice, so that the second finds what the first has left on the stack
    def emit(context, builder, values):
        memory = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), 8))
        place = builder.gep(memory, [INT64(0), INT64(5)])
        number = builder.load(place)
        builder.store(values[0], place)
        return number

    assert [computed(emit, 7.0) for _ in range(2)] == [0.0, 0.0]


@relies_on("cgutils.for_range", "cgutils.unpack_tuple")
def test_for_range_counts_from_zero_up():
    def emit(context, builder, values):
        memory = cgutils.alloca_once(builder, ir.DoubleType())
        with cgutils.for_range(builder, values[1]) as loop:
            doubled = builder.fadd(builder.load(memory), builder.load(memory))
            index = builder.sitofp(loop.index, ir.DoubleType())
            builder.store(builder.fadd(doubled, index), memory)
        return builder.fadd(builder.load(memory), values[0])

    assert computed(emit, 0.5, 4) == ((0 * 2 + 1) * 2 + 2) * 2 + 3 + 0.5


@relies_on("cgutils.get_or_insert_function")
def test_get_or_insert_function_declares_a_function_once():
    module, kind = ir.Module(), ir.FunctionType(ir.DoubleType(), [ir.DoubleType()])
    first, second = (cgutils.get_or_insert_function(module, kind, "llvm.sqrt.f64") for _ in "ab")
    assert first is second


@relies_on("cgutils.global_constant", "populate_array")
def test_populate_array_makes_an_array_of_foreign_memory():
    row = types.Array(float64, 1, "C", readonly=True)

    @intrinsic
    def made(context):
        def generate(context, builder, sig, values):
            pair = ir.Constant(ir.ArrayType(ir.DoubleType(), 2), [3.0, 4.5])
            memory = cgutils.global_constant(builder.module, "pair", pair)
            pointer = builder.gep(memory, [INT64(0), INT64(0)])
            array = context.make_array(row)(context, builder)
            internals.populate_array(
                array, data=pointer, shape=[INT64(2)], strides=[INT64(8)], itemsize=INT64(8),
                meminfo=None,
            )  # fmt: skip
            return array._getvalue()

        return row(), generate

    assert numba.njit(lambda: made().sum())() == 7.5


class _NothingType(types.Type):
    def __init__(self):
        super().__init__(name="Nothing")


register_model(_NothingType)(models.OpaqueModel)


@relies_on("cpu_target", "tracing_context")
def test_tracing_context_knows_values_without_a_function():
    context = internals.tracing_context()
    assert context.get_value_type(float64) == ir.DoubleType()
    assert context.get_value_type(_NothingType()) == ir.IntType(8).as_pointer()
    builder = ir.IRBuilder(
        ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "trace").append_basic_block()
    )
    pair = types.UniTuple(float64, 2)
    made = context.make_tuple(builder, pair, [ir.DoubleType()(1.0), ir.DoubleType()(2.0)])
    assert made.type == context.get_value_type(pair)
    assert context.cast(builder, INT64(3), int64, types.intp).type == INT64
    assert context.get_dummy_value() is not None


def _line(x, pair):
    return pair[1] + 2.0 * x, x


kernel(_line)


@relies_on("AbstractTemplate", "infer_global", "signature")
def test_templates_make_a_python_function_known_to_compiled_code():
    assert numba.njit(lambda x: _line(x, (x, 1.0)))(3.0) == (7.0, 3.0)


# ---------------------------------------------------------------- compiling


@numba.njit(**OPTIONS)
def _halved(x):
    return 0.5 * x


def _sum_of_halves(values):
    total = 0.0
    for x in values:
        total += _halved(x)
    return total


@relies_on("JITCodeLibrary", "compile_leanly")
def test_code_compiled_leanly_is_optimised_as_a_whole_and_by_no_function(monkeypatch):
    codegen, passes = internals.tracing_context().codegen(), []

    def tell(manager):
        make = getattr(codegen, manager)
        monkeypatch.setattr(codegen, manager, lambda **o: passes.append(manager) or make(**o))

    tell("_function_pass_manager")
    tell("_module_pass_manager")

    def passed(compiles):
        dispatcher = numba.njit(_sum_of_halves, **OPTIONS)
        del passes[:]
        compiles(dispatcher, (float64[::1],))
        assert dispatcher(np.arange(5.0)) == 5.0
        (code,) = dispatcher.inspect_llvm().values()
        body, *_ = re.findall(r"^define[^\n]*{$(.*?)^}", code, re.M | re.S)
        return set(passes), re.findall(r"alloca|call .*halved", body)

    def fails(dispatcher, operands):
        with pytest.raises(numba.TypingError):
            internals.compile_leanly(numba.njit(lambda x: x.nothing), (float64,))
        dispatcher.compile(operands)

    _halved(1.0)
    both = {"_function_pass_manager", "_module_pass_manager"}
    assert passed(internals.compile_leanly) == ({"_module_pass_manager"}, [])
    assert passed(lambda dispatcher, operands: dispatcher.compile(operands)) == (both, [])
    assert passed(fails) == (both, [])


# ---------------------------------------------------------------- calls


@numba.njit(**OPTIONS)
def _inverted(tag, x, out):
    if x == 0.0:
        raise ZeroDivisionError("no inverse of", 0)
    out[0] = 1.0 / x


@dataclass(frozen=True)
class Anything(Tag):
    """Tag that the code does not use."""


@numba.njit(**OPTIONS)
def _call(entry, x, out):
    raise_again(call(entry, x, out))


@relies_on(
    "address_of", "call_address", "raise_address", "release", "Status", "RETCODE_USEREXC",
    "excinfo_ptr_t",
)  # fmt: skip
def test_code_is_called_by_its_address_after_its_module_is_released():
    out = np.zeros(1)
    entry = entry_of(_inverted, Anything(), 4.0, out)
    (result,) = _inverted.overloads.values()
    assert entry == internals.address_of(result)
    assert result.library._final_module is None
    _call(entry, 4.0, out)
    assert out[0] == 0.25
    with pytest.raises(ZeroDivisionError) as told:
        _call(entry, 0.0, out)
    assert told.value.args == ("no inverse of", 0)


@relies_on("link", "call_linked")
def test_linked_code_is_called_and_says_whether_it_raised():
    @numba.njit(**OPTIONS)
    def root(x):
        if x < 0.0:
            raise ValueError("negative")
        return np.sqrt(x)

    root.compile((float64,))
    (result,) = root.overloads.values()

    def emit(context, builder, values):
        internals.link(context, result)
        status, number = internals.call_linked(context, builder, result, values)
        known = builder.icmp_unsigned("!=", builder.ptrtoint(status.excinfoptr, INT64), INT64(0))
        raised = builder.and_(builder.and_(status.is_error, status.is_user_exc), known)
        return builder.select(raised, ir.DoubleType()(-1.0), number)

    assert [computed(emit, x) for x in (9.0, -9.0)] == [3.0, -1.0]


# ---------------------------------------------------------------- the disk cache


class Spy(internals.NullCache):
    def __init__(self):
        self.asked, self.given = [], []

    def load_overload(self, sig, target_context):
        self.asked.append((sig, target_context))

    def save_overload(self, sig, data):
        self.given.append(data)


@relies_on("NullCache", "set_cache", "cache_of")
def test_dispatcher_asks_its_cache_and_gives_it_what_it_has_compiled():
    dispatcher, spy = numba.njit(lambda x: 2.0 * x), Spy()
    internals.set_cache(dispatcher, spy)
    assert internals.cache_of(dispatcher) is spy
    assert dispatcher(3.0) == 6.0
    ((sig, context),) = spy.asked
    assert sig == (float64,)
    assert context is internals.tracing_context()
    assert spy.given == list(dispatcher.overloads.values())
    assert spy.given[0].codegen is not None


@relies_on("as_bytes", "from_bytes", "CompileResult", "dumps", "rtsys")
def test_compile_result_comes_back_from_its_bytes():
    dispatcher = numba.njit(lambda x: np.full(2, x).sum(), **OPTIONS)
    dispatcher.compile((float64,))
    (result,) = dispatcher.overloads.values()
    back = internals.from_bytes(internals.as_bytes(result), internals.tracing_context())
    assert back.signature == result.signature
    assert back.entry_point(2.5) == 5.0


def test_code_that_holds_an_address_has_no_bytes():
    callback = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(lambda x: x)
    dispatcher = numba.njit(lambda x: callback(x))
    dispatcher.compile((float64,))
    (result,) = dispatcher.overloads.values()
    assert internals.as_bytes(result) is None


@relies_on("machine_of")
def test_machine_of_names_the_cpu_and_its_features():
    triple, cpu, features = internals.machine_of(internals.tracing_context().codegen())
    assert triple == llvm.get_process_triple()
    assert cpu
    assert "," in features or not features


@relies_on("InTreeCacheLocator", "UserProvidedCacheLocator", "UserWideCacheLocator")
def test_locators_choose_folders(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    beside, provided, users = (
        Path(locator(computed, __file__).get_cache_path())
        for locator in (
            internals.InTreeCacheLocator,
            internals.UserProvidedCacheLocator,
            internals.UserWideCacheLocator,
        )
    )
    assert beside == Path(__file__).parent / "__pycache__"
    assert provided.parent == tmp_path
    assert users.is_absolute()
    assert users not in (beside, provided)


# ---------------------------------------------------------------- compiling


def _look(acquired=[]):  # noqa: B006
    """Return whether another thread can compile now."""

    def look():
        acquired.append(internals.COMPILER_LOCK.acquire(blocking=False))
        if acquired[-1]:
            internals.COMPILER_LOCK.release()

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    return acquired


def _looking(x):
    _look()
    return x


kernel(_looking)


@relies_on("ALLOCATES_NOTHING")
def test_code_that_counts_no_references_reads_arrays_and_makes_none():
    @numba.njit(**ALLOCATES_NOTHING)
    def second(array):
        row = array[1]
        return row[0]

    assert second(np.arange(6.0).reshape(3, 2)) == 2.0
    with pytest.raises(numba.TypingError, match="NRT required"):
        numba.njit(lambda count: np.zeros(count), **ALLOCATES_NOTHING)(3)


@relies_on("COMPILER_LOCK", "global_compiler_lock")
def test_compiler_lock_is_held_by_the_thread_that_compiles():
    _look()
    numba.njit(lambda x: _looking(x))(1.0)  # traced twice, for its type and its instructions
    assert _look() == [True, False, False, True]


@relies_on("names_in", "runs_python")
def test_names_in_tells_what_compiled_code_names_and_where():
    @numba.njit
    def inner(x):
        return x

    @numba.njit
    def outer(x):
        return np.sqrt(x) + inner(x)

    outer(4.0)
    (result,) = outer.overloads.values()
    assert not internals.runs_python(result)
    names = list(internals.names_in(result))
    line = outer.py_func.__code__.co_firstlineno + 2
    assert [at for value, _, at in names if value is np.sqrt] == [line]
    assert any(value is np for value, *_ in names)
    assert any(getattr(ty, "dispatcher", None) is inner for _, ty, _ in names)


def test_runs_python_sees_objmode():
    @numba.njit
    def printed(x):
        with numba.objmode():
            repr(x)
        return x

    printed(1.0)
    assert all(map(internals.runs_python, printed.overloads.values()))

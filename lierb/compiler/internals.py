"""Wrap the undocumented parts of Numba on which lierb relies; no other module imports any of them.

tests/compiler/test_internals.py has a test for each imported name and each function: if a release
of Numba changes one, its test fails. The releases that pass determine the bounds of numba in
pyproject.toml. Other modules import the documented parts (`numba`, `numba.extending`,
`llvmlite.ir`, `llvmlite.binding`) directly.
"""

from __future__ import annotations

import io
import pickle
from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core import ir as numba_ir
from numba.core.caching import (
    InTreeCacheLocator,
    NullCache,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.core.callconv import RETCODE_USEREXC, Status, excinfo_ptr_t
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.errors import TypingError
from numba.core.ir_utils import build_definitions
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.core.untyped_passes import FixupArgs
from numba.np.arrayobj import populate_array

__all__ = [
    "AbstractTemplate", "InTreeCacheLocator", "NullCache", "UserProvidedCacheLocator",
    "UserWideCacheLocator", "cgutils", "infer_global", "populate_array", "signature",
]  # fmt: skip

BIT = ir.IntType(1)
INT64 = ir.IntType(64)
COMPILER_LOCK = global_compiler_lock._lock  # held by the compiling thread
# Option of njit that disables reference counting. Numba would unpack every value of a formula to
# search it for arrays, a tenth of the time to a kernel.
ALLOCATES_NOTHING = {"_nrt": False}


def tracing_context() -> Any:
    """Return Numba's target context, for the layout of values outside of a compilation."""
    return cpu_target.target_context


# ---- compilation, addresses and memory of code --------------------------------------------------


class _LeanLibrary(JITCodeLibrary):
    """A lean library of code skips the optimisation of single functions."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


def compile_leanly(dispatcher: Any, operands: tuple[types.Type, ...]) -> Any:
    """Run dispatcher.compile(operands) in two thirds of LLVM's time.

    Numba lets LLVM optimise each function alone, and then the module with all callees. The first
    optimisation gains nothing for a single long function, and is skipped.
    """
    codegen = cpu_target.target_context.codegen()
    with global_compiler_lock:
        libraries, codegen._library_class = codegen._library_class, _LeanLibrary
        try:
            return dispatcher.compile(operands)
        finally:
            codegen._library_class = libraries


def address_of(result: Any) -> int:
    """Return the address of a compile result's code, which uses Numba's calling convention."""
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


def release(library: Any) -> None:
    """Free the LLVM code of a library that no other code will be linked with.

    This frees 3 of a compiled kernel's 7 MB, and 1.1 of 1.3 MB for a kernel loaded from the disk.
    LLVM's passes keep the rest of the 7 MB until the process ends.
    """
    library._codegen._engine._ee.remove_module(library._final_module)
    library._final_module = library._shared_module = library._compiled_object = None


# ---- translation of Python, once for each function -----------------------------------------------


class _Writer(pickle.Pickler):
    """Pickle Numba's intermediate code without copies of constants, functions and places.

    shared : these objects, by the numbers that stand for them.
    """

    COPIED = (list, dict, tuple, set, defaultdict, str, int, float, bool, type(None))
    SHARED = (numba_ir.Loc, type(numba_ir.UNDEFINED))  # of immutable objects, and of a singleton

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self.shared: list[Any] = []
        self._numbers: dict[int, int] = {}

    def persistent_id(self, obj: Any) -> int | None:
        kind = type(obj)
        is_code = kind.__module__ == numba_ir.__name__ and kind not in self.SHARED
        if is_code or kind in self.COPIED:
            return None
        if id(obj) not in self._numbers:
            self._numbers[id(obj)] = len(self.shared)
            self.shared.append(obj)
        return self._numbers[id(obj)]


class _Reader(pickle.Unpickler):
    def __init__(self, content: bytes, shared: Sequence[Any]) -> None:
        super().__init__(io.BytesIO(content))
        self._shared = shared

    def persistent_load(self, pid: int) -> Any:
        return self._shared[pid]


def compiler_that_translates_once(tags: type[types.Type]) -> type[CompilerBase]:
    """Return the pipeline class for njit that translates and inlines Python code once.

    Numba translates bytecode and inlines callees again for each list of argument types, in a tenth
    of the time to a kernel. The result does not depend on arguments of type `tags`: it is stored in
    memory, and copied for a compilation with other tags. Functions must not be generators.
    """
    stored: dict[Hashable, tuple[bytes, list[Any], tuple[Any, ...]]] = {}

    def key_of(state: Any) -> Hashable:
        others = tuple(ty for ty in state.args if not isinstance(ty, tags))
        return state.func_id.func, len(state.args), others

    @register_pass(mutates_CFG=False, analysis_only=True)
    class Storing(FunctionPass):
        _name = "lierb_storing"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            code, writer = state.func_ir, _Writer(file := io.BytesIO())
            writer.dump(code.blocks)
            others = code.loc, code.arg_count, code.arg_names
            stored[key_of(state)] = file.getvalue(), writer.shared, others
            return False

    @register_pass(mutates_CFG=True, analysis_only=False)
    class Copying(FunctionPass):
        _name = "lierb_copying"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            content, shared, (loc, arg_count, arg_names) = stored[key_of(state)]
            blocks = _Reader(content, shared).load()
            state.func_ir = numba_ir.FunctionIR(
                blocks, False, state.func_id, loc, build_definitions(blocks), arg_count, arg_names
            )
            return True

    class Compiler(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            state, passes, of = self.state, PassManager("nopython"), DefaultPassBuilder
            if key_of(state) in stored:
                passes.add_pass(Copying, "copy translated code")
                passes.add_pass(FixupArgs, "fix up args")
            else:
                passes.passes.extend(of.define_untyped_pipeline(state).passes)
                passes.add_pass(Storing, "store translated code")
            passes.passes.extend(of.define_typed_pipeline(state).passes)
            passes.passes.extend(of.define_nopython_lowering_pipeline(state).passes)
            passes.finalize()
            return [passes]

    return Compiler


# ---- compiled code on the disk -----------------------------------------------------------------


def set_cache(dispatcher: Any, cache: NullCache) -> None:
    """Set the cache from which a dispatcher loads code and to which it saves code."""
    dispatcher._cache = cache


def cache_of(dispatcher: Any) -> Any:
    return dispatcher._cache


def machine_of(codegen: Any) -> tuple[Any, ...]:
    """Return the CPU that code is compiled for, and its enabled features."""
    return tuple(codegen.magic_tuple())


def as_bytes(result: Any) -> bytes | None:
    """Serialise a compile result; return None if the code is valid in this process only."""
    if any(not lifted.can_cache for lifted in result.lifted) or result.library.has_dynamic_globals:
        return None
    return bytes(dumps(result._reduce()))


def from_bytes(content: bytes, context: Any) -> Any:
    """Restore a compile result from `as_bytes`; other bytes may raise any exception.

    The function skips Numba's import of all overloads, which only compilation needs. That import
    includes scipy.linalg where SciPy is installed, and takes two thirds of the time to a first
    result.
    """
    rtsys.initialize(context)  # loaded code may count references to arrays
    return CompileResult._rebuild(context, *pickle.loads(content))


# ---- replacement of operators and calls ----------------------------------------------------------


def compiler_that_replaces(functions: Mapping[Any, Any]) -> type[CompilerBase]:
    """Return a pipeline for njit that replaces integer-valued operators and calls, and ufuncs.

    functions : replacement by (operator, function or type, number of operands). A replacement is
        a function with overloads, used where an overload accepts the operands' types.
    """

    @register_pass(mutates_CFG=False, analysis_only=False)
    class Replacing(FunctionPass):
        _name = "lierb_replacing"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            replaced = [_replace(state, functions, step) for step in _assignments(state.func_ir)]
            return any(replaced)

    class Compiler(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(Replacing, NopythonTypeInference)
            passes.finalize()
            return [passes]

    return Compiler


def _assignments(code: Any) -> Iterator[Any]:
    for block in code.blocks.values():
        for step in block.body:
            if isinstance(step, numba_ir.Assign) and isinstance(step.value, numba_ir.Expr):
                yield step


def _replace(state: Any, functions: Mapping[Any, Any], step: Any) -> bool:
    """Replace the expression of an assignment; return whether a replacement exists."""
    old = step.value
    if old.op in ("binop", "inplace_binop"):
        called, operands = old.fn, [old.lhs, old.rhs]
    elif old.op == "unary":
        called, operands = old.fn, [old.value]
    elif old.op == "call" and not (old.kws or old.vararg):
        ty = state.typemap[old.func.name]
        called, operands = getattr(ty, "instance_type", getattr(ty, "typing_key", None)), old.args
    else:
        return False
    kinds = tuple(types.unliteral(state.typemap[operand.name]) for operand in operands)
    key = called, len(operands)
    function = functions.get(key) if isinstance(called, Hashable) else None
    # A failed search for an overload is slow, and most operators act on floats: skip these.
    is_worth_it = isinstance(called, np.ufunc) or _is_of_integers(state.calltypes[old].return_type)
    if function is None or not is_worth_it:
        return False
    context = state.typingctx
    try:
        signature = context.resolve_function_type(context.resolve_value_type(function), kinds, {})
    except TypingError:
        return False
    if len(operands) == 1:
        new = numba_ir.Expr("unary", step.loc, fn=function, value=operands[0])
    else:
        static = dict.fromkeys(("static_lhs", "static_rhs"), numba_ir.UNDEFINED)
        lhs, rhs = operands
        new = numba_ir.Expr("binop", step.loc, fn=function, lhs=lhs, rhs=rhs, **static)
    step.value, state.calltypes[new] = new, signature
    return True


def _is_of_integers(ty: types.Type) -> bool:
    return isinstance(getattr(ty, "dtype", ty), types.Integer)


# ---- calls in emitted code ---------------------------------------------------------------------


def call_address(
    context: Any, builder: ir.IRBuilder, address: ir.Value, operands: Sequence[Any], values: Any
) -> ir.Value:
    """Emit a call of code at an address; return 0, or the address of the raised exception."""
    pointer = context.call_conv.get_function_type(types.none, operands).as_pointer()
    code = builder.inttoptr(address, pointer)
    status, _ = context.call_conv.call_function(builder, code, types.none, operands, values)
    raised = builder.ptrtoint(status.excinfoptr, INT64)
    return builder.select(status.is_error, raised, INT64(0))


def raise_address(context: Any, builder: ir.IRBuilder, address: ir.Value) -> None:
    """Emit a raise of the exception at an address."""
    status = Status(
        code=RETCODE_USEREXC, is_ok=BIT(0), is_none=BIT(0), is_error=BIT(1),
        is_stop_iteration=BIT(0), is_python_exc=BIT(0), is_user_exc=BIT(1),
        excinfoptr=builder.inttoptr(address, excinfo_ptr_t),
    )  # fmt: skip
    context.call_conv.return_status_propagate(builder, status)


def link(context: Any, result: Any) -> None:
    """Link the code of a compile result to the emitted code, for `call_linked`."""
    context.add_linking_libs((result.library,))


def call_linked(context: Any, builder: ir.IRBuilder, result: Any, arguments: Any) -> Any:
    """Emit a call of linked code; return (status, result)."""
    return context.call_internal_no_propagate(builder, result.fndesc, result.signature, arguments)


# ---- names in compiled code --------------------------------------------------------------------


def runs_python(result: Any) -> bool:
    """Return whether compiled code runs Python code (objmode)."""
    return bool(getattr(result, "lifted", ()))


def names_in(result: Any) -> Iterator[tuple[Any, types.Type, int | None]]:
    """Yield (function or module, type, line) for each variable of compiled code.

    The first is None for a variable of another type. A result loaded from the disk yields nothing.
    """
    annotation = result.type_annotation
    lines: dict[str | None, int] = {}
    for block in getattr(annotation, "blocks", {}).values():
        for step in block.body:  # instruction of Numba's intermediate code
            target = getattr(step, "target", None)
            lines.setdefault(getattr(target, "name", None), step.loc.line)
    for variable, ty in getattr(annotation, "typemap", {}).items():
        value = getattr(ty, "typing_key", None) or getattr(ty, "pymod", None)
        yield value, ty, lines.get(variable)

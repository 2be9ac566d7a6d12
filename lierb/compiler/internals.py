"""Undocumented parts of Numba on which lierb relies; no other module imports any of them.

tests/compiler/test_internals.py has a test for each name that is imported here and each function:
a release of Numba that changes one fails there, by its name. The releases that pass bound numba in
pyproject.toml. What is documented (`numba`, `numba.extending`, `llvmlite.ir`, `llvmlite.binding`)
is imported where it is used.
"""

from __future__ import annotations

import pickle
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
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.np.arrayobj import populate_array

__all__ = [
    "AbstractTemplate", "InTreeCacheLocator", "NullCache", "UserProvidedCacheLocator",
    "UserWideCacheLocator", "cgutils", "infer_global", "populate_array", "signature",
]  # fmt: skip

BIT = ir.IntType(1)
INT64 = ir.IntType(64)
COMPILER_LOCK = global_compiler_lock._lock  # held by whatever thread compiles
# An option of njit: no references are counted. Of each value of a formula, Numba takes all numbers
# out to look for arrays among them, which is a tenth of the time to a kernel.
ALLOCATES_NOTHING = {"_nrt": False}


def tracing_context() -> Any:
    """Context that lays out values as Numba does, without a function being compiled."""
    return cpu_target.target_context


# ---- compiled code: how it is made, where it lies, what it can do without -----------------------


class _LeanLibrary(JITCodeLibrary):
    """Code that is not optimised function by function before all of it is, together."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


def compile_leanly(dispatcher: Any, operands: tuple[types.Type, ...]) -> Any:
    """dispatcher.compile(operands), in two thirds of LLVM's time.

    Numba has LLVM optimise each function by itself, and then the module with all that it calls. For
    one long function the former finds nothing that the latter would not.
    """
    codegen = cpu_target.target_context.codegen()
    with global_compiler_lock:
        libraries, codegen._library_class = codegen._library_class, _LeanLibrary
        try:
            return dispatcher.compile(operands)
        finally:
            codegen._library_class = libraries


def address_of(result: Any) -> int:
    """Address of a compile result's code; arguments and results by Numba's convention."""
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


def release(library: Any) -> None:
    """Let go of the LLVM code behind machine code that nothing will be linked with any more.

    3 of the 7 MB that a kernel takes once it is compiled, 1.1 of 1.3 where it came from the disk.
    What is left of the former is lost in LLVM's passes, and with the process.
    """
    library._codegen._engine._ee.remove_module(library._final_module)
    library._final_module = library._shared_module = library._compiled_object = None


# ---- compiled code on the disk -----------------------------------------------------------------


def set_cache(dispatcher: Any, cache: NullCache) -> None:
    """Have a dispatcher ask this for code before it compiles, and give it what it has compiled."""
    dispatcher._cache = cache


def cache_of(dispatcher: Any) -> Any:
    return dispatcher._cache


def machine_of(codegen: Any) -> tuple[Any, ...]:
    """The kind of processor that code is made for, and what is used of it."""
    return tuple(codegen.magic_tuple())


def as_bytes(result: Any) -> bytes | None:
    """A compile result, for another process; None for what is good for this one only."""
    if any(not lifted.can_cache for lifted in result.lifted) or result.library.has_dynamic_globals:
        return None
    return bytes(dumps(result._reduce()))


def from_bytes(content: bytes, context: Any) -> Any:
    """The compile result again; whatever reading nonsense raises, for anything else.

    Without what only a compiler needs: Numba would import all its overloads first, and with them
    scipy.linalg where SciPy is installed, two thirds of the time to a first result.
    """
    rtsys.initialize(context)  # arrays count references
    return CompileResult._rebuild(context, *pickle.loads(content))


# ---- other functions in the place of Python's own ------------------------------------------------


def compiler_that_replaces(functions: Mapping[Any, Any]) -> type[CompilerBase]:
    """Pipeline class for njit that replaces operators and calls with integer results, and ufuncs.

    functions : by operator, function, or type that is called, and by the number of operands, a
        function with overloads, which replaces it where one of them takes their types.
    """

    @register_pass(mutates_CFG=False, analysis_only=False)
    class Replacing(FunctionPass):
        _name = "lierb_replacing"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            found = [_replace(state, functions, step) for step in _assignments(state.func_ir)]
            return any(found)

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
    """Replace what an assignment computes; whether it is."""
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
    # Typing again what has no overload takes a while: most operators are those of floats.
    is_worth_it = isinstance(called, np.ufunc) or _is_of_integers(state.calltypes[old].return_type)
    if function is None or not is_worth_it:
        return False
    context = state.typingctx
    try:
        found = context.resolve_function_type(context.resolve_value_type(function), kinds, {})
    except TypingError:
        return False
    if len(operands) == 1:
        new = numba_ir.Expr("unary", step.loc, fn=function, value=operands[0])
    else:
        static = dict.fromkeys(("static_lhs", "static_rhs"), numba_ir.UNDEFINED)
        lhs, rhs = operands
        new = numba_ir.Expr("binop", step.loc, fn=function, lhs=lhs, rhs=rhs, **static)
    step.value, state.calltypes[new] = new, found
    return True


def _is_of_integers(ty: types.Type) -> bool:
    return isinstance(getattr(ty, "dtype", ty), types.Integer)


# ---- calls from code that is being emitted -----------------------------------------------------


def call_address(
    context: Any, builder: ir.IRBuilder, address: ir.Value, operands: Sequence[Any], values: Any
) -> ir.Value:
    """Call code that returns nothing; 0, or the address of the exception that it has raised."""
    pointer = context.call_conv.get_function_type(types.none, operands).as_pointer()
    code = builder.inttoptr(address, pointer)
    status, _ = context.call_conv.call_function(builder, code, types.none, operands, values)
    raised = builder.ptrtoint(status.excinfoptr, INT64)
    return builder.select(status.is_error, raised, INT64(0))


def raise_address(context: Any, builder: ir.IRBuilder, address: ir.Value) -> None:
    """Leave the function that is being emitted with the exception at an address."""
    status = Status(
        code=RETCODE_USEREXC, is_ok=BIT(0), is_none=BIT(0), is_error=BIT(1),
        is_stop_iteration=BIT(0), is_python_exc=BIT(0), is_user_exc=BIT(1),
        excinfoptr=builder.inttoptr(address, excinfo_ptr_t),
    )  # fmt: skip
    context.call_conv.return_status_propagate(builder, status)


def link(context: Any, result: Any) -> None:
    """Have the code that is being emitted call that of a compile result."""
    context.add_linking_libs((result.library,))


def call_linked(context: Any, builder: ir.IRBuilder, result: Any, arguments: Any) -> Any:
    """(is_error, is_user_exc and excinfoptr of a status, what it returns) of such a call."""
    return context.call_internal_no_propagate(builder, result.fndesc, result.signature, arguments)


# ---- what compiled code names ------------------------------------------------------------------


def runs_python(result: Any) -> bool:
    """Return whether compiled code runs Python code of its own (objmode)."""
    return bool(getattr(result, "lifted", ()))


def names_in(result: Any) -> Iterator[tuple[Any, types.Type, int | None]]:
    """Referents of the variables of compiled code: (function or module, type, line) each.

    The first is None for what is neither; a result that came from the disk knows of none.
    """
    annotation = result.type_annotation
    lines: dict[str | None, int] = {}
    for block in getattr(annotation, "blocks", {}).values():
        for step in block.body:  # of Numba's intermediate code
            target = getattr(step, "target", None)
            lines.setdefault(getattr(target, "name", None), step.loc.line)
    for variable, ty in getattr(annotation, "typemap", {}).items():
        value = getattr(ty, "typing_key", None) or getattr(ty, "pymod", None)
        yield value, ty, lines.get(variable)

"""Call compiled code by its address, from @njit code that was compiled earlier."""

from __future__ import annotations

from functools import partial
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from lierb.compiler.code import compiling, kinds_of, run_uninterrupted
from lierb.compiler.internals import (
    INT64,
    address_of,
    call_address,
    cgutils,
    compile_leanly,
    raise_address,
    release,
)
from lierb.compiler.tags import Tag

_plain: list[partial[Any]] = []  # functions with the JIT off; an entry is an index, plus 1
_entries: dict[tuple[Any, ...], int] = {}  # entries by the kinds of the arguments
_addresses: dict[tuple[Any, ...], int] = {}  # addresses by the types of the arguments
_callable: set[tuple[types.Type, ...]] = set()  # argument types of entries, without the tag


def entry_of(dispatcher: Any, tag: Tag, *args: Any) -> Any:
    """Return the address of the compiled code of dispatcher(tag, *args), for `call`.

    Code that is called by its address is compiled once, and its caller once for all tags. If Numba
    linked the code to its caller, LLVM would optimise and translate it again for the caller and for
    each wrapper of a parallel loop: five times in all.
    """
    if not hasattr(dispatcher, "compile"):  # the JIT is off
        known = dispatcher, tag
        if known not in _entries:
            _plain.append(partial(dispatcher, tag))
            _entries[known] = len(_plain)
        return _entries[known]
    key = kinds_of(dispatcher, tag, *args)
    if key not in _entries:
        run_uninterrupted(_enter, key, tuple(map(numba.typeof, (tag, *args))))
    return _entries[key]


def _enter(key: tuple[Any, ...], operands: tuple[types.Type, ...]) -> None:
    dispatcher, code = key[0], (key[0], operands)
    with compiling:
        if code not in _addresses:
            compile_leanly(dispatcher, operands)
            result = dispatcher.overloads[operands]
            _callable.add(operands[1:])
            _addresses[code] = address_of(result)
            release(result.library)
        _entries[key] = _addresses[code]


def kernels_loaded() -> int:
    """Return the number of kernels in this process's memory."""
    return len(_addresses)


def call(entry: Any, *args: Any) -> int:
    """Run the code at an address from `entry_of`, in @njit code.

    The arguments must have the types that the code was compiled for. Returns 0, or the address of
    the exception that the code has raised, for `raise_again`: Numba loses an exception that is
    raised in a thread of a parallel loop.
    """
    _plain[int(entry) - 1](*args)
    return 0


@overload(call)
def _call(entry, *args):  # no annotations: Numba compares signatures
    return lambda entry, *args: _call_entry(entry, args)


@intrinsic
def _call_entry(context: Any, entry: Any, args: Any) -> Any:
    if tuple(args) not in _callable:
        raise numba.errors.TypingError(f"no code was compiled for {tuple(args)}")
    operands = (types.voidptr, *args)  # the tag is the first argument, a null pointer

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        tag = context.get_constant_null(types.voidptr)
        members = cgutils.unpack_tuple(builder, values[1])
        return call_address(context, builder, values[0], operands, [tag, *members])

    return types.int64(entry, args), generate


def raise_again(raised: int) -> None:
    """Raise the exception at an address that `call` has returned; do nothing for 0."""


@overload(raise_again)
def _raise_again(raised):  # no annotations: Numba compares signatures
    return lambda raised: _propagate(raised)


@intrinsic
def _propagate(context: Any, raised: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        is_error = builder.icmp_unsigned("!=", values[0], INT64(0))
        with builder.if_then(is_error, likely=False):
            raise_address(context, builder, values[0])
        return context.get_dummy_value()

    return types.none(raised), generate


def take_turns(counter: Any, count: Any) -> Any:
    """Return the int64 in `counter` and add `count` to it, atomically in compiled code."""
    number = counter[0]
    counter[0] = number + count
    return number


@intrinsic
def _atomic_add(context: Any, counter: Any, count: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        array = context.make_array(counter)(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, args[1], "monotonic")

    return types.int64(counter, types.int64), generate


@overload(take_turns)
def _take_turns(counter, count):  # no annotations: Numba compares signatures
    return lambda counter, count: _atomic_add(counter, count)

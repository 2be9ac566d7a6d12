"""Compiled code called by its address, by @njit code that was compiled before it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from lierb.compiler.code import compiling, kinds_of, undisturbed
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

_plain: list[partial[Any]] = []  # with the JIT off: entry − 1 is a place here
_entries: dict[tuple[Any, ...], int] = {}  # by kinds of arguments
_addresses: dict[tuple[Any, ...], int] = {}  # the same, by their types
_callable: set[tuple[types.Type, ...]] = set()  # arguments, behind the tag, of code with an entry


def entry_of(dispatcher: Any, tag: Tag, *args: Any) -> Any:
    """Address of the compiled code of dispatcher(tag, *args), for `call`.

    Code called by its address is compiled once; what calls it is compiled once for all tags. A
    caller that Numba links it to would optimise and translate all of it again, and so would each of
    a parallel loop's wrappers: five times in all.
    """
    if not hasattr(dispatcher, "compile"):  # the JIT is off
        known = dispatcher, tag
        if known not in _entries:
            _plain.append(partial(dispatcher, tag))
            _entries[known] = len(_plain)
        return _entries[known]
    key = kinds_of(dispatcher, tag, *args)
    if key not in _entries:
        undisturbed(_enter, key, tuple(map(numba.typeof, (tag, *args))))
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
    """Number of kernels in this process's memory."""
    return len(_addresses)


def call(entry: Any, *args: Any) -> int:
    """Run the code at an entry, for @njit code; the types are those that it was compiled for.

    Returns 0, or for `raise_again` what was raised: in a parallel loop's thread nobody hears it.
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
    operands = (types.voidptr, *args)  # the tag's value, which is nothing, goes first

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> Any:
        tag = context.get_constant_null(types.voidptr)
        members = cgutils.unpack_tuple(builder, values[1])
        return call_address(context, builder, values[0], operands, [tag, *members])

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
        with builder.if_then(is_error, likely=False):
            raise_address(context, builder, values[0])
        return context.get_dummy_value()

    return types.none(raised), generate


def take_turns(counter: Any, count: Any) -> Any:
    """The number in `counter`, an int64 array, which is then raised by so many, for one thread."""
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

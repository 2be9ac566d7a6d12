"""Check that users' functions return numbers and vectors of the expected shapes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from lierb.kernels.functions.object_arrays import has_traced, numbers
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.shapes import ANY, Shape
from lierb.kernels.functions.user_number import Condition, UserNumber


def as_result(name: str, value: Any, shape: Shape) -> Any:
    """Check a returned value; return its number or the numbers of its vector."""
    if not shape:
        return _number(name, value)
    members = np.asarray(numbers(value) if has_traced(value) else value, dtype=object)
    if shape in (ANY, (1,)):  # a number may be a vector of one
        members = np.atleast_1d(members)
    if members.shape != shape and not (shape == ANY and members.ndim == 1):
        expected = f"{shape[0]} components" if len(shape) == 1 else "×".join(map(str, shape))
        raise UnfitFunctionError(f"{name} must return {expected}, not {brief(value)}")
    return tuple(_number(name, x) for x in members.flat)


def _number(name: str, x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.ndim == 0:
        x = x.item()
    if isinstance(x, Condition):
        x = x.number()
    if isinstance(x, UserNumber):
        return x if x.parts else x.value
    if isinstance(x, (int, float, np.integer, np.floating, np.bool_)):
        return float(x)
    raise UnfitFunctionError(f"{name} must return numbers, not {brief(x)}")


def brief(x: Any) -> str:
    """Describe a value in a few words."""
    if has_traced(x) or isinstance(x, np.ndarray):
        return f"an array of shape {np.shape(x)}" if isinstance(x, np.ndarray) else f"a {_kind(x)}"
    try:
        text = repr(x)
    except UnfitFunctionError:  # nested values contain traced numbers
        return f"a {_kind(x)}"
    return text if len(text) < 60 and "object at" not in text else f"a {type(x).__name__}"


def dictionary_of(names: Iterable[Any]) -> str:
    """Describe a dictionary by its names."""
    return f"a dictionary of {', '.join(map(str, names)) or 'nothing'}"


def _kind(x: Any) -> str:
    return f"{type(x).__name__} of {len(x)}" if isinstance(x, (tuple, list)) else type(x).__name__


def as_array(x: Any) -> Any:
    return numbers(x) if has_traced(x) and isinstance(x, (tuple, list)) else x

"""Decorated functions: a user's function with defaults of its parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import update_wrapper
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, told, unknown_name
from lierb.kernels.functions.shapes import Shape
from lierb.support.arrays import as_floats


class Decorated:
    """A function and its parameters' defaults; called with parameters, it is an element.

    own : names of what it is called with that is no parameter.
    """

    own: tuple[str, ...] = ()

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        self.function, self.defaults = function, defaults
        update_wrapper(self, function)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        name, kind = self.function.__name__, type(self).__name__.lower()
        return f"<{kind} {name}: {', '.join(self.defaults) or 'no parameters'}>"

    def _shapes(self, given: dict[str, ArrayLike]) -> dict[str, Shape]:
        """Of the parameters for one body: as in the defaults, or numbers.

        In an order that does not depend on who gives them: it is part of the kernel's name.
        """
        takes_any = not self.defaults and (
            not self.own or "params" in inspect.signature(self.function).parameters
        )
        for name in given:
            if not takes_any and name not in self.defaults:
                raise unknown_name("parameter", name, (*self.own, *self.defaults))
        shapes: dict[str, Shape] = {} if self.defaults else dict.fromkeys(sorted(given), ())
        return shapes | {n: as_floats(n, given).shape for n, given in self.defaults.items()}


def column_name(argument: str, name: Any) -> str:
    """A name that a column may have. Raises ArgumentError."""
    if not (isinstance(name, str) and name.isidentifier() and len(name) <= MOST_NAME):
        raise ArgumentError(
            f"{argument} is {told(name)}; expected letters, digits and _, at most {MOST_NAME} of "
            "them, for a column's name"
        )
    return name


MOST_NAME, MOST_UNIT = 100, 40  # characters


def require_unit(argument: str, unit: Any) -> str:
    """A unit. Raises ArgumentError for what is none."""
    if not (isinstance(unit, str) and unit.isprintable() and 0 < len(unit) <= MOST_UNIT):
        raise ArgumentError(
            f'{argument}={told(unit)}; expected the unit as text, such as "rad", or "1"'
        )
    return unit


def decorated(kind: type[Decorated], function: Any, defaults: dict[str, Any]) -> Any:
    if function is None:
        return lambda given: decorated(kind, given, defaults)
    if not inspect.isfunction(function):
        raise ForceError(f"expected a function to decorate, got {told(function)}")
    return kind(function, defaults)


def reject_functions(argument: str, given: Any) -> None:
    """Raise for a decorated function that was not called with its parameters."""
    if isinstance(given, Decorated):
        name = given.function.__name__
        raise ArgumentError(
            f"{argument} is the function {name}; call it, with its parameters if it has any: "
            f"{name}(…)"
        )

"""Decorated functions are users' functions with defaults for their parameters."""

from __future__ import annotations

import inspect
from functools import update_wrapper
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, brief, unknown_name
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.support.arrays import as_floats

MOST_NAME, MOST_UNIT = 100, 40  # largest numbers of characters


class Decorated:
    """User's function with defaults for its parameters; a call with parameters makes an element.

    own : keywords of the call that are not parameters.
    """

    own: tuple[str, ...] = ()

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        self.function, self.defaults = function, defaults
        update_wrapper(self, function)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        name, kind = self.function.__name__, type(self).__name__.lower()
        return f"<{kind} {name}: {', '.join(self.defaults) or 'no parameters'}>"

    def _shapes(self, parameters: dict[str, ArrayLike]) -> dict[str, Shape]:
        """Return the shapes of the parameters for one body: those of the defaults, or numbers.

        Their order, which is part of the kernel's name, does not depend on the order in the call.
        """
        takes_any = not self.defaults and (
            not self.own or "params" in inspect.signature(self.function).parameters
        )
        for name in parameters:
            if not takes_any and name not in self.defaults:
                raise unknown_name(
                    f"{self.function.__name__}: parameter", name, (*self.own, *self.defaults)
                )
        shapes: dict[str, Shape] = {} if self.defaults else dict.fromkeys(sorted(parameters), ())
        return shapes | {name: as_floats(name, x).shape for name, x in self.defaults.items()}


def decorated(kind: type[Decorated], function: Any, defaults: dict[str, Any]) -> Any:
    """Decorate a function; without one, return the decorator."""
    if function is None:
        return lambda function: kind(require_function(function), defaults)
    return kind(require_function(function), defaults)


def require_function(function: Any) -> UserFunction:
    """Return the function; raise ForceError for another object."""
    if not inspect.isfunction(function):
        raise ForceError(f"expected a function to decorate, got {brief(function)}")
    return function


def reject_functions(argument: str, element: Any) -> None:
    """Raise ArgumentError for a decorated function that was not called to make an element."""
    if isinstance(element, Decorated):
        name = element.function.__name__
        raise ArgumentError(
            f"{argument} is the function {name}; call it, with its parameters if it has any: "
            f"{name}(…)"
        )


def column_name(argument: str, name: Any) -> str:
    """Return the name; raise ArgumentError unless it is valid for a column."""
    if not (isinstance(name, str) and name.isidentifier() and len(name) <= MOST_NAME):
        raise ArgumentError(
            f"{argument} is {brief(name)}; expected letters, digits and _, at most {MOST_NAME} of "
            f"them, for a column's name{'; define the function by def' * (name == '<lambda>')}"
        )
    return name


def require_unit(argument: str, unit: Any) -> str:
    """Return the unit; raise ArgumentError unless it is the text of a unit."""
    if not (isinstance(unit, str) and unit.isprintable() and 0 < len(unit) <= MOST_UNIT):
        raise ArgumentError(
            f'{argument}={brief(unit)}; expected the unit as text, such as "rad", or "1"'
        )
    return unit

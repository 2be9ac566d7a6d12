"""What a problem has along its time: events, states beside the bodies', sampled controllers.

All are functions of the user's, as `lierb.wrench` is. Functions of a problem see all of its states
and of its controllers' outputs by their names; so they are tried when the problem is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from keyword import iskeyword
from typing import Any

from lierb.errors import ArgumentError, told, unknown_name
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.decorated import column_name, require_unit
from lierb.model.functions.elements import Element
from lierb.support.arrays import as_floats


def python_of(element: Element) -> Callable[..., Any]:
    assert element.made_by is not None
    return element.made_by.function


def require_attribute(what: str, name: Any) -> str:
    """A name that a column, and an attribute, may have."""
    column_name(f"{what}'s name", name)
    if iskeyword(name) or name.startswith("_"):
        raise ArgumentError(f"{what} is named {name}, which no attribute can be; give another name")
    return str(name)


def initial_values(what: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Values by name, as given. Raises ArgumentError for what is no number or vector."""
    for name, value in given.items():
        require_attribute(what, name)
        shape = as_floats(name, value).shape
        if len(shape) > 1 or math.prod(shape) == 0:
            raise ArgumentError(
                f"{name} has shape {shape}; expected the initial value of one body, a number or a "
                "vector"
            )
    return dict(given)


def shapes_of(given: Mapping[str, Any]) -> Shapes:
    return tuple((name, as_floats(name, value).shape) for name, value in given.items())


def checked_units(given: Any, names: Iterable[str] | None) -> dict[str, str]:
    """Checked; names : those that there are, if that is known."""
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f'unit={told(given)}; expected units by name, such as {{"wheel": "N m s"}}'
        )
    for name, unit in given.items():
        if names is not None and name not in names:
            raise unknown_name("unit of", name, names)
        require_unit(f"unit[{told(name)}]", unit)
    return dict(given)


def parameter_defaults(given: Any, others: Iterable[str]) -> dict[str, Any]:
    """Defaults of parameters, none of which is named as something else."""
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f'params={told(given)}; expected defaults by name, such as {{"tau": 0.5}}'
        )
    for name in given:
        if name in others:
            raise ArgumentError(f"two are named {name}: a parameter and an initial value")
    return dict(given)


def initial_and_parameters(
    given: dict[str, Any], names: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Initial values, and parameters."""
    initial = {name: value for name, value in given.items() if name in names}
    return initial, {name: value for name, value in given.items() if name not in names}


def prefixed(initial: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{kinds.INITIAL}{name}": value for name, value in initial.items()}

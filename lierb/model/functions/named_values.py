"""Extra states and outputs of controllers are elements with named values.

Other functions of a problem read these values by name. Functions are therefore tried when the
problem is made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from keyword import iskeyword
from typing import Any, Self

from lierb.errors import ArgumentError, brief, unknown_name
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.mechanics.passive_elements import INITIAL
from lierb.model.functions.decorated import column_name, require_unit
from lierb.model.functions.elements import Element, seeing
from lierb.model.functions.tracing import runnable
from lierb.support.arrays import as_floats


@dataclass(frozen=True, eq=False, repr=False)
class NamedValues(Element):
    """An element's named values are columns of results.

    units : unit of each value, by name; "1" by default.
    """

    kind: Any
    units: Mapping[str, str] = field(default_factory=dict)

    def unit_of_column(self, name: str) -> str:
        return self.units.get(name, "1")

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        if self.made_by is None:  # lierb's own
            return self
        function = seeing(self.kind.function, states, controls)
        return self.of_kind(function=runnable(function, self.made_by.function, self.because))


def require_attribute(what: str, name: Any) -> None:
    """Raise ArgumentError unless the name is valid for a column and an attribute."""
    column_name(f"{what}'s name", name)
    if iskeyword(name) or name.startswith("_"):
        raise ArgumentError(f"{what} is named {name}, which no attribute can be; give another name")


def shapes_of(what: str, initial: Mapping[str, Any]) -> Shapes:
    """Shapes of initial values; raises ArgumentError unless they are numbers and vectors."""
    shapes = []
    for name, value in initial.items():
        require_attribute(what, name)
        shape = as_floats(name, value).shape
        shapes.append((name, shape))
        if len(shape) > 1 or math.prod(shape) == 0:
            raise ArgumentError(
                f"{name} has shape {shape}; expected the initial value of one body, a number or a "
                "vector"
            )
    return tuple(shapes)


def mapping_of(argument: str, values: Any, expected: str) -> dict[str, Any]:
    """Copy a mapping by name; raises ArgumentError for another object."""
    if not isinstance(values, Mapping):
        raise ArgumentError(f"{argument}={brief(values)}; expected {expected}")
    return dict(values)


def checked_units(units: Any, names: Iterable[str] | None) -> dict[str, str]:
    """Check units by name.

    names : names of the values; None if they are not yet known.
    """
    checked = mapping_of("unit", units, 'units by name, such as {"wheel": "N m s"}')
    for name, unit in checked.items():
        if names is not None and name not in names:
            raise unknown_name("unit of", name, names)
        require_unit(f"unit[{brief(name)}]", unit)
    return checked


def parameter_defaults(defaults: Any, initial: Iterable[str]) -> dict[str, Any]:
    """Check defaults of parameters; their names must differ from those of initial values."""
    checked = mapping_of("params", defaults, 'defaults by name, such as {"tau": 0.5}')
    for name in checked:
        if name in initial:
            raise ArgumentError(f"two arguments are named {name}: a parameter and an initial value")
    return checked


def values_of(
    arguments: Mapping[str, Any], initial: Mapping[str, Any], defaults: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split a call's arguments into initial values and parameters.

    Returns the parameters, and all values of the element, including defaults, by prefixed names.
    """
    parameters = {name: value for name, value in arguments.items() if name not in initial}
    starts = {f"{INITIAL}{name}": arguments.get(name, x) for name, x in initial.items()}
    return parameters, {**defaults, **parameters, **starts}

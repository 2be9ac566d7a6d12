"""What a problem has beside its body, joint and gravity: forces and constraints, with parameters.

Some are functions of the user's: `@lierb.wrench` makes a force of one, `@lierb.constraint` a
constraint. They are written for one body and compiled for many at once.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import update_wrapper
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from lierb.arrays import Array, as_numbers, batch_size
from lierb.errors import ArgumentError, ForceError, ScalarFunctionWarning, unknown_name
from lierb.kernels import elements as kinds
from lierb.kernels.fingerprint import UnfitFunctionError, fingerprint
from lierb.kernels.functions import (
    ANY,
    Function,
    Shape,
    compilable,
    compile_alone,
    traceable,
    trial,
)


@dataclass(frozen=True, eq=False)
class Element:
    """A force or a constraint.

    parameters : by name, each in its own shape, or with an axis for the bodies before it.
    """

    name: str
    kind: kinds.Element
    parameters: dict[str, Array]

    @classmethod
    def of(cls, name: str, kind: kinds.Element, **given: ArrayLike) -> Self:
        parameters = {
            parameter: as_numbers(parameter, given[parameter], shape)
            for parameter, shape in kind.shapes.items()
        }
        element = cls(name, kind, parameters)
        batch_size(**element.batched())
        return element

    def __repr__(self) -> str:
        return f"<{self.name}: {', '.join(self.parameters) or 'no parameters'}>"

    def batched(self) -> dict[str, tuple[Array, int]]:
        """The parameters as `batch_size` takes them."""
        return {
            f"{self.name}.{name}": (array, len(self.kind.shapes[name]))
            for name, array in self.parameters.items()
        }


class Force(Element):
    """A force on the body; made by the functions of `lierb.forces` and by `lierb.wrench`."""


class Constraint(Element):
    """Rows beside the joint's own; made by `lierb.constraint`."""


# ---- functions of the user's -------------------------------------------------------------------

ARGUMENTS: dict[str, Shape] = {"t": (), "R": (3, 3), "r": (3,), "omega": (3,), "v": (3,)}
POSE = ("R", "r")
WRENCH: tuple[Shape, ...] = ((3,), (3,))


class _Decorated:
    """A function and its parameters' defaults; called with parameters, it is an element."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, ArrayLike]) -> None:
        self.function, self.defaults = function, defaults
        update_wrapper(self, function)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        name, kind = self.function.__name__, type(self).__name__.lower()
        return f"<{kind} {name}: {', '.join(self.defaults) or 'no parameters'}>"

    def _shapes(self, given: dict[str, ArrayLike]) -> dict[str, Shape]:
        """Of the parameters for one body: as in the defaults, or numbers."""
        for name in given:
            if self.defaults and name not in self.defaults:
                raise unknown_name("parameter", name, self.defaults)
        shapes: dict[str, Shape] = dict.fromkeys(given, ())
        return shapes | {name: np.shape(default) for name, default in self.defaults.items()}


class Wrench(_Decorated):
    """What `lierb.wrench` makes of a function."""

    _potential: Callable[..., Any] | None = None

    def __call__(self, **parameters: ArrayLike) -> Force:
        """The force with these parameters; each is one for all bodies or one for each."""
        shapes = self._shapes(parameters)
        function = user_function(self.function, tuple(ARGUMENTS), shapes, WRENCH)
        potential = self._potential and user_function(
            self._potential, POSE, shapes, ((),), differentiated=True
        )
        kind = kinds.UserWrench(function, potential)
        return Force.of(self.function.__name__, kind, **self.defaults | parameters)

    def potential(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Decorator of the wrench's potential, (R, r, params) → J, to count in the energy.

        It may be that of a part of the wrench: what the rest does counts as work. For that it is
        differentiated, and so must run on dual numbers, as a constraint does.
        """
        if not inspect.isfunction(function):
            raise ForceError(f"expected a function to decorate, got {function!r}")
        self._potential = function
        return function


class ConstraintFunction(_Decorated):
    """What `lierb.constraint` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        unit = defaults.pop("unit", "m")
        if unit not in ("m", "1"):
            raise unknown_name("unit", unit, ("m", "1"))
        super().__init__(function, defaults)
        self.is_translational = unit == "m"

    def __call__(self, **parameters: ArrayLike) -> Constraint:
        """The constraint with these parameters; each is one for all bodies or one for each."""
        shapes = self._shapes(parameters)
        function = user_function(self.function, POSE, shapes, (ANY,), differentiated=True)
        rows = trial(function)
        function = replace(function, results=((rows,),))
        kind = kinds.UserConstraint(function, rows, self.is_translational)
        return Constraint.of(function.name, kind, **self.defaults | parameters)


@overload
def wrench(function: Callable[..., Any], /) -> Wrench: ...
@overload
def wrench(**defaults: ArrayLike) -> Callable[[Callable[..., Any]], Wrench]: ...
def wrench(function: Callable[..., Any] | None = None, /, **defaults: ArrayLike) -> Any:
    """Make a function a force: `@lierb.wrench`, or `@lierb.wrench(name=default, …)`.

    The function is called with (t, R, r, omega, v, params) and returns (torque, force): t in s, R
    3×3 and r the pose in the ground frame, ω and v the body-fixed twist, all as arrays of numbers;
    torque (N m) and force (N) are in body axes, about the body frame's origin.

    Called with its parameters, what results is a force for `Problem(forces=…)`. The defaults say
    which parameters there are and what shape they have for one body; without defaults all are
    numbers. In the function they are `params.name`.

    The function is written for one body and compiled for many at once: operators, `math`, NumPy's
    elementary functions and `@`, and `lierb.where(condition, a, b)` in place of `if`. One that
    branches on a number all the same runs body by body, far more slowly; a warning says so once.
    A kernel is compiled again when the function, or anything that it refers to, has changed.

    Raises ForceError for a function of another form, or one that cannot be compiled at all.

    >>> import lierb
    >>> @lierb.wrench(stiffness=10.0, anchor=(0.0, 0.0, 1.0))
    ... def tether(t, R, r, omega, v, params):
    ...     return (0.0, 0.0, 0.0), -params.stiffness * R.T @ (r - params.anchor)
    >>> tether(stiffness=[5.0, 10.0, 20.0])
    <tether: stiffness, anchor>
    """
    return _decorated(Wrench, function, defaults)


@overload
def constraint(function: Callable[..., Any], /) -> ConstraintFunction: ...
@overload
def constraint(
    *, unit: str = "m", **defaults: ArrayLike
) -> Callable[[Callable[..., Any]], ConstraintFunction]: ...
def constraint(function: Callable[..., Any] | None = None, /, **defaults: Any) -> Any:
    """Make a function a constraint: `@lierb.constraint`, or with defaults as `lierb.wrench`.

    The function is called with (R, r, params) and returns h, one number or several, which shall
    stay zero; each becomes a row beside the joint's. Its Jacobian and acceleration term come from
    the same function, run on dual numbers: they are exact. It cannot branch on numbers but with
    `lierb.where`.

    unit : of h, "m" or "1": whether it counts as position or as rotation error. Default "m".

    Raises ForceError as `lierb.wrench` does.

    >>> import lierb
    >>> @lierb.constraint(length=0.5)
    ... def rod(R, r, params):
    ...     return (r @ r / params.length - params.length) / 2
    >>> rod(length=[0.4, 0.5])
    <rod: length>
    """
    return _decorated(ConstraintFunction, function, defaults)


def _decorated(kind: type[_Decorated], function: Any, defaults: dict[str, Any]) -> Any:
    if function is None:
        return lambda given: _decorated(kind, given, defaults)
    if not inspect.isfunction(function):
        raise ForceError(f"expected a function to decorate, got {function!r}")
    return kind(function, defaults)


_warned: set[str] = set()  # fingerprints of functions that run body by body


def user_function(
    function: Callable[..., Any],
    arguments: tuple[str, ...],
    shapes: dict[str, Shape],
    results: tuple[Shape, ...],
    differentiated: bool = False,
) -> Function:
    """The function as kernels take it: traced if it can be, else compiled by Numba.

    differentiated : whether its derivatives are needed too, which only a traced one has.
    """
    name = getattr(function, "__name__", "function")
    form = f"({', '.join((*arguments, 'params'))})"
    try:
        inspect.signature(function).bind(*arguments, "params")
    except TypeError:
        raise ForceError(
            f"{name} takes {inspect.signature(function)}; expected the form {form}"
        ) from None
    try:
        mark = fingerprint(function)
    except UnfitFunctionError as error:
        raise ForceError(f"{name} cannot be compiled: {error}") from None
    given = tuple(ARGUMENTS[argument] for argument in arguments)
    fields = (name, mark, given, tuple(shapes.items()), results)
    traced = Function(*fields, True, traceable(function))
    try:
        trial(traced)
    except UnfitFunctionError as error:
        raise ForceError(str(error)) from None
    except Exception as error:  # whatever a function of the user's may raise
        reason = _sentence(error)
    else:
        return traced
    if differentiated:
        raise ForceError(
            f"{name} must run on dual numbers, because its derivatives are needed as well: {reason}"
        )
    compiled = Function(*fields, False, compilable(function))
    try:
        compile_alone(compiled)
    except Exception as error:
        raise ForceError(
            f"{name} runs neither for many bodies at once ({reason}) nor, compiled by Numba, for "
            f"one at a time ({_sentence(error)})"
        ) from None
    if mark not in _warned:
        _warned.add(mark)
        warnings.warn(
            f"{name} runs body by body, far more slowly than for many at once: {reason}",
            ScalarFunctionWarning,
            stacklevel=3,
        )
    return compiled


def _sentence(error: Exception) -> str:
    """The line of its message that says most."""
    lines = [line.strip(" -") for line in str(error).splitlines()]
    telling = [line for line in lines if line and not line.startswith("Failed in")]
    return telling[0] if telling else type(error).__name__


def reject_functions(argument: str, given: Any) -> None:
    """Raise for a decorated function that was not called with its parameters."""
    if isinstance(given, _Decorated):
        name = given.function.__name__
        raise ArgumentError(
            f"{argument} is the function {name}; call it, with its parameters if it has any: "
            f"{name}(…)"
        )

"""What a problem has beside its body, joint and gravity: forces, constraints and observables.

Some are functions of the user's: `@lierb.wrench` makes a force of one, `@lierb.constraint` a
constraint, `@lierb.observable` an observable. They are written for one body and compiled for many
at once.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial, update_wrapper
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, require_name, told, unknown_name
from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.fingerprint import Reference
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import ANY, Shape, Shapes
from lierb.kernels.functions.trials import trial
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.tracing import (
    ARGUMENTS,
    DERIVATIVES,
    SIGNALS,
    form_of,
    form_of_any,
    runnable,
    user_function,
)
from lierb.support.arrays import Array, Which, as_floats, as_numbers, batch_size, taken


@dataclass(frozen=True, eq=False)
class Element:
    """A force, a constraint or an observable.

    Attributes
    ----------
    name : str
        Name of the function that made it.
    parameters : dict of ndarray
        Parameters by name, each in its own shape, or with an axis for the bodies before it.
    made_by : callable or None
        The user's function, as it was decorated.
    at : tuple of str
        Place in a mechanism: a link, two links, or the joint about whose axis it acts.
    """

    name: str
    kind: kinds.Element
    parameters: dict[str, Array]
    made_by: Decorated | None = None
    at: tuple[str, ...] = ()
    words: ClassVar[tuple[str, str]] = "an element", "elements"  # for one of its kind, for many

    @classmethod
    def of(cls, name: str, kind: kinds.Element, /, **given: ArrayLike) -> Self:
        parameters = {
            parameter: as_numbers(parameter.removeprefix(kinds.INITIAL), given[parameter], shape)
            for parameter, shape in kind.shapes.items()
        }
        element = cls(name, kind, parameters)
        batch_size(**element.batched())
        return element

    def __repr__(self) -> str:
        where = f", on {' and '.join(self.at)}" if self.at else ""
        return f"<{self.name}: {', '.join(self.parameters) or 'no parameters'}{where}>"

    def on(self, link: str, other: str | None = None) -> Self:
        """Place the element on a link of a `lierb.Mechanism`, or between two links.

        Parameters
        ----------
        link : str
            Name of the link. For an element that acts about a joint axis, the name of the link or
            loop whose joint it is.
        other : str, optional
            Link in place of the ground: the element's points and directions of the ground, R and r
            are in its body frame, and it receives the reaction of a force.

        Returns
        -------
        Element
            The element in that place.

        Examples
        --------
        >>> import lierb
        >>> spring = lierb.forces.spring_damper(stiffness=10.0)
        >>> spring.on("rod", "crank")
        <spring_damper: body_point, ground_point, stiffness, damping, length, on rod and crank>
        """
        at = (link,) if other is None else (link, other)
        for name in at:
            if not isinstance(name, str):
                raise ArgumentError(f"on({told(name)}); expected the name of a link, as text")
        if link == other:
            raise ArgumentError(f"on({link!r}, {other!r}); expected two different links")
        return replace(self, at=at)

    def of_body(self, which: Which) -> Self:
        """That of one body of the batch, or of a part of it."""
        shapes = self.kind.shapes
        given = {n: taken(a, which, len(shapes[n])) for n, a in self.parameters.items()}
        return replace(self, parameters=given)

    def batched(self) -> dict[str, tuple[Array, int]]:
        """The parameters as `batch_size` takes them."""
        return {
            f"{self.name}.{name}": (array, len(self.kind.shapes[name]))
            for name, array in self.parameters.items()
        }

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """What functions of the user's in it referred to when it was made."""
        return tuple(r for function in self.kind.functions for r in function.references)

    def require_unchanged(self) -> None:
        """Raise ForceError if something that its function has been made with is another by now."""
        for reference in self.references:
            if reference.has_changed():
                raise ForceError(
                    f"{reference.name} has changed since {self.name} was made with it; make the "
                    f"{self.words[0].partition(' ')[2]} anew, or make {reference.name} a parameter"
                )

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        """The same in a problem with these extra states and outputs of controllers.

        Raises ForceError where its function sees others.
        """
        function = getattr(self.kind, "function", None)
        if self.made_by is None or not (isinstance(function, Function) and function.sees_others):
            return self
        seen = seeing(function, states, controls)
        if not function.is_traced:
            if seen == function:
                return self
            seen = replace(seen, is_traced=True, python=traceable(self.made_by.function))
        seen = runnable(seen, self.made_by.function)
        return self.of_kind(function=seen)

    def of_kind(self, **changed: Any) -> Self:
        """The same with other fields of its kind."""
        kind: Any = self.kind
        return replace(self, kind=replace(kind, **changed))


def seeing(function: Function, states: Shapes, controls: Shapes) -> Function:
    """The function, with what it sees of a problem."""
    return replace(
        function,
        states=states if "states" in function.form else (),
        controls=controls if "controls" in function.form else (),
    )


class Force(Element):
    """A force on the body; made by the functions of `lierb.forces` and by `lierb.wrench`."""

    words: ClassVar = "a force", "forces"


class Constraint(Element):
    """Rows beside the joint's own; made by `lierb.constraint`."""

    words: ClassVar = "a constraint", "constraints"


@dataclass(frozen=True, eq=False, repr=False)
class Observable(Element):
    """A number that is recorded along the motion; made by `lierb.observable`.

    Attributes
    ----------
    name : str
        Name of its column in a history.
    parameters : dict of ndarray
        Parameters by name, each in its own shape, or with an axis for the bodies before it.
    made_by : callable or None
        The user's function, as it was decorated.
    at : tuple of str
        Place in a mechanism: a link or two.
    unit : str
        Unit of its numbers.
    """

    unit: str = "1"
    words: ClassVar = "an observable", "observables"

    def named(self, name: str) -> Self:
        """Rename the observable: a problem may have one function several times.

        Parameters
        ----------
        name : str
            Name of its columns.

        Returns
        -------
        Observable
            The observable of that name.

        Examples
        --------
        >>> import lierb
        >>> @lierb.observable(unit="m", height=0.0)
        ... def above(r, params):
        ...     return r[2] - params.height
        >>> above(height=2.0).named("above_the_roof")
        <above_the_roof: height>
        """
        return replace(self, name=column_name("name", name))


# ---- functions of the user's -------------------------------------------------------------------

POSE = ("R", "r")
WRENCH: tuple[Shape, ...] = ((3,), (3,))


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


class Wrench(Decorated):
    """What `lierb.wrench` makes of a function."""

    _potential: Callable[..., Any] | None = None

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        given = defaults.pop("discontinuities", ())
        names = (given,) if isinstance(given, str) else tuple(given)
        for name in names:
            if name not in defaults:
                raise unknown_name("discontinuities", name, defaults)
        super().__init__(function, defaults)
        self.discontinuities = names

    def __call__(self, **parameters: ArrayLike) -> Force:
        """The force with these parameters; each is one for all bodies or one for each."""
        shapes = self._shapes(parameters)
        form = partial(form_of, tuple(ARGUMENTS), others=("body", *SIGNALS))
        function = user_function(self.function, tuple(ARGUMENTS), shapes, WRENCH, form=form)
        potential = self._potential and user_function(
            self._potential, POSE, shapes, ((),), because=DERIVATIVES
        )
        kind = kinds.UserWrench(function, potential, self.discontinuities)
        made = Force.of(self.function.__name__, kind, **self.defaults | parameters)
        return replace(made, made_by=self)

    def potential(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Decorator of the wrench's potential, (R, r, params) → J, to count in the energy.

        It may be that of a part of the wrench: what the rest does counts as work. For that it is
        differentiated, and so must run for many bodies at once, as a constraint does.
        """
        if not inspect.isfunction(function):
            raise ForceError(f"expected a function to decorate, got {told(function)}")
        self._potential = function
        return function


class ConstraintFunction(Decorated):
    """What `lierb.constraint` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        unit = defaults.pop("unit", "m")
        require_name("unit", unit, ("m", "1"))
        super().__init__(function, defaults)
        self.is_translational = unit == "m"

    def __call__(self, **parameters: ArrayLike) -> Constraint:
        """The constraint with these parameters; each is one for all bodies or one for each."""
        shapes = self._shapes(parameters)
        function = user_function(self.function, POSE, shapes, (ANY,), because=DERIVATIVES)
        rows = trial(function)
        function = replace(function, results=((rows,),))
        kind = kinds.UserConstraint(function, rows, self.is_translational)
        made = Constraint.of(function.name, kind, **self.defaults | parameters)
        return replace(made, made_by=self)


class ObservableFunction(Decorated):
    """What `lierb.observable` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        unit = require_unit("unit", defaults.pop("unit", "1"))
        super().__init__(function, defaults)
        self.unit = unit

    def __call__(self, **parameters: ArrayLike) -> Observable:
        """The observable with these parameters; each is one for all bodies or one for each."""
        name = column_name("the observable's name", self.function.__name__)
        shapes = self._shapes(parameters)
        form = partial(form_of_any, SIGNALS)
        function = user_function(self.function, tuple(ARGUMENTS), shapes, ((),), form=form)
        kind = kinds.UserObservable(function)
        made = Observable.of(name, kind, **self.defaults | parameters)
        return replace(made, unit=self.unit, made_by=self)


@overload
def wrench(function: Callable[..., Any], /) -> Wrench: ...
@overload
def wrench(
    *, discontinuities: str | Iterable[str] = (), **defaults: ArrayLike
) -> Callable[[Callable[..., Any]], Wrench]: ...
def wrench(function: Callable[..., Any] | None = None, /, **defaults: Any) -> Any:
    """Make a function a force: `@lierb.wrench`, or `@lierb.wrench(name=default, …)`.

    The function is called with (t, R, r, omega, v, params) and returns (torque, force): t in s, R
    3×3 and r the pose in the ground frame, ω and v the body-fixed twist, all as arrays of numbers;
    torque (N m) and force (N) are in body axes, about the body frame's origin.

    An argument named `body`, after `params`, has the body: `body.mass`, `body.inertia` (3×3, about
    the centre of mass, in body axes) and `body.com`. `params` may be left out where there are none.
    Arguments named `states` and `controls` have the problem's extra states (`lierb.states`) and the
    last outputs of its controllers (`lierb.controller`), each by its name.

    The function is written for one body and compiled for many at once: operators, `math`, NumPy,
    and `lierb.where(condition, a, b)` in place of `if`. A function that branches on a number runs
    body by body, 10 to 60 times slower; a warning says so once. It must be a function of its
    arguments: other objects that it refers to are compiled as they were when the force was made,
    and a force whose objects have changed cannot be used any more.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    discontinuities : str or iterable of str, optional
        Names of parameters that are times, s, at which the function jumps or has a kink, such as
        those at which a thruster is switched. Steps end there, as at the times of the argument of
        that name of `lierb.integrate`.
    **defaults : array_like
        Default of each parameter, whose shape is that for one body. In the function they are
        `params.name`. Without defaults all parameters are numbers.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes a force for `Problem(forces=…)`.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.

    Examples
    --------
    >>> import lierb
    >>> @lierb.wrench(stiffness=10.0, anchor=(0.0, 0.0, 1.0))
    ... def tether(t, R, r, omega, v, params):
    ...     return (0.0, 0.0, 0.0), -params.stiffness * R.T @ (r - params.anchor)
    >>> tether(stiffness=[5.0, 10.0, 20.0])
    <tether: stiffness, anchor>
    """
    return decorated(Wrench, function, defaults)


@overload
def constraint(function: Callable[..., Any], /) -> ConstraintFunction: ...
@overload
def constraint(
    *, unit: str = "m", **defaults: ArrayLike
) -> Callable[[Callable[..., Any]], ConstraintFunction]: ...
def constraint(function: Callable[..., Any] | None = None, /, **defaults: Any) -> Any:
    """Make a function a constraint: `@lierb.constraint`, or with defaults as `lierb.wrench`.

    The function is called with (R, r, params), and `body` as in `lierb.wrench`, and returns h, one
    number or several, which must stay zero; each becomes a row beside the joint's. Its Jacobian
    and acceleration term come from the same function, differentiated exactly. It cannot branch on
    numbers except by `lierb.where`.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    unit : {"m", "1"}, optional
        Unit of h: position error or rotation error.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes a constraint for
        `Problem(constraints=…)`.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.

    Examples
    --------
    >>> import lierb
    >>> @lierb.constraint(length=0.5)
    ... def rod(R, r, params):
    ...     return (r @ r / params.length - params.length) / 2
    >>> rod(length=[0.4, 0.5])
    <rod: length>
    """
    return decorated(ConstraintFunction, function, defaults)


@overload
def observable(function: Callable[..., Any], /) -> ObservableFunction: ...
@overload
def observable(
    *, unit: str = "1", **defaults: ArrayLike
) -> Callable[[Callable[..., Any]], ObservableFunction]: ...
def observable(function: Callable[..., Any] | None = None, /, **defaults: Any) -> Any:
    """Make a function an observable: `@lierb.observable(unit="rad")`, with defaults as in `wrench`.

    The function takes any of t, R, r, omega, v, params, body, states and controls, by these names
    and in any order, each as in `lierb.wrench`, and returns one number. It is evaluated where
    measures are taken (`measure_every`, `save_every`), and does not change the motion. Adaptive
    steps are long: for a fine mean give `dt_max`, or integrate the number as a state
    (`lierb.states`).

    `history` has its values in a column of its name. `summary` has, under that name and over the
    measured times, `…_min` and `…_max`, `…_mean`, the mean over time by the trapezoidal rule, and
    `…_final`. After a failure the extremes are those up to it, and the others NaN. A value that is
    NaN makes the extremes and the mean NaN, and is no failure.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    unit : str, optional
        Unit of the number, for the columns' metadata.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes an observable for
        `Problem(observables=…)`.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.
    ArgumentError
        Columns of that name exist already.

    Examples
    --------
    >>> import lierb
    >>> import numpy as np
    >>> @lierb.observable(unit="rad", axis=(0.0, 0.0, 1.0))
    ... def pointing_error(R, params):
    ...     return np.arccos(lierb.clip(R[2] @ params.axis, -1.0, 1.0))
    >>> pointing_error()
    <pointing_error: axis>
    """
    return decorated(ObservableFunction, function, defaults)


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

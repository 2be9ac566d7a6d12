"""`lierb.observable` makes observables from users' functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.mechanics.passive_elements import UserObservable
from lierb.model.functions.decorated import Decorated, column_name, decorated, require_unit
from lierb.model.functions.elements import Element
from lierb.model.functions.tracing import number_of_motion


@dataclass(frozen=True, eq=False, repr=False)
class Observable(Element):
    """An observable is a number recorded along the motion, made by `lierb.observable`.

    Attributes
    ----------
    name : str
        Name of its column in a history.
    parameters : dict of ndarray
        Parameters by name, each with its shape for one body, or with a leading axis for bodies.
    made_by : callable or None
        Decorated user's function.
    at : tuple of str
        Place in a mechanism: one or two links.
    unit : str
        Unit of the observable.
    """

    unit: str = "1"
    words: ClassVar = "an observable", "observables"

    def named(self, name: str) -> Self:
        """Rename the observable, so that a problem can use one function several times.

        Parameters
        ----------
        name : str
            Name of its columns.

        Returns
        -------
        Observable
            The observable with that name.

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


class ObservableFunction(Decorated):
    """A function decorated by `lierb.observable` returns a number recorded along the motion."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        unit = require_unit("unit", defaults.pop("unit", "1"))
        super().__init__(function, defaults)
        self.unit = unit

    def __call__(self, **parameters: ArrayLike) -> Observable:
        """Make the observable with these parameters, one value for all bodies or one for each."""
        name = column_name("the observable's name", self.function.__name__)
        function = number_of_motion(self.function, self._shapes(parameters))
        kind, values = UserObservable(function), self.defaults | parameters
        return Observable.of(name, kind, values, unit=self.unit, made_by=self)


@overload
def observable(function: UserFunction, /) -> ObservableFunction: ...
@overload
def observable(
    *, unit: str = "1", **defaults: ArrayLike
) -> Callable[[UserFunction], ObservableFunction]: ...
def observable(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make an observable from a function: `@lierb.observable(unit="rad")`.

    Defaults of parameters are as in `lierb.wrench`.

    The function takes any of t, R, r, omega, v, params, body, states, controls, alpha and
    specific_force, by these names and in any order, and returns one number. It is evaluated at the
    times of measurement (`measure_every`, `save_every`), with adaptive steps within them too, and
    does not change the motion.

    Arguments are as in `lierb.wrench`. `alpha` is the angular acceleration, rad/s², and
    `specific_force` the acceleration of the body frame's origin less gravity, m/s²: both relative
    to the ground and in body axes. At a point p of the body an accelerometer reads
    specific_force + alpha × p + omega × (omega × p). In a mechanism such a function is on one link.

    `history` has the values in a column with the observable's name. `summary` has statistics over
    the run: `…_min`, `…_max`, `…_mean`, the mean over time, and `…_final`. With fixed steps they
    are of the measured times, the mean by the trapezoidal rule; with adaptive steps means are by
    Gauss-Lobatto quadrature and extremes by parabolas. After a failure the extremes are those
    before it, and the others NaN. A value that is NaN makes the extremes and the mean NaN, but is
    not a failure.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
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
        The function's arguments are wrong, or it cannot be compiled.
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

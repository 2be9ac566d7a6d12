"""`lierb.constraint` makes constraints from users' functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, overload

from numpy.typing import ArrayLike

from lierb.errors import require_name
from lierb.kernels.functions.shapes import ANY, UserFunction
from lierb.kernels.functions.trials import trial
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.decorated import Decorated, decorated
from lierb.model.functions.elements import Element
from lierb.model.functions.tracing import DERIVATIVES, POSE, user_function


class Constraint(Element):
    """Constraint rows made by `lierb.constraint` are in addition to those of the joint."""

    words: ClassVar = "a constraint", "constraints"


class ConstraintFunction(Decorated):
    """A function decorated by `lierb.constraint` returns residuals of constraint rows."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        unit = defaults.pop("unit", "m")
        require_name("unit", unit, ("m", "1"))
        super().__init__(function, defaults)
        self.is_translational = unit == "m"

    def __call__(self, **parameters: ArrayLike) -> Constraint:
        """Make the constraint with these parameters, one value for all bodies or one for each."""
        shapes = self._shapes(parameters)
        function = user_function(self.function, POSE, shapes, (ANY,), because=DERIVATIVES)
        rows = trial(function)
        function = replace(function, results=((rows,),))
        kind = kinds.UserConstraint(function, rows, self.is_translational)
        return Constraint.of(function.name, kind, self.defaults | parameters, made_by=self)


@overload
def constraint(function: UserFunction, /) -> ConstraintFunction: ...
@overload
def constraint(
    *, unit: str = "m", **defaults: ArrayLike
) -> Callable[[UserFunction], ConstraintFunction]: ...
def constraint(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make a constraint from a function: `@lierb.constraint`, or with defaults as `lierb.wrench`.

    The function is called with (R, r, params), and `body` as in `lierb.wrench`. It returns h, one
    number or several, which must remain zero; each is a further row, in addition to the joint's.
    Jacobian and acceleration term are computed from the function by exact differentiation. It
    cannot branch on numbers except by `lierb.where`.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
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
        The function's arguments are wrong, or it cannot be compiled.

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

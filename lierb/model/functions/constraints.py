"""`lierb.constraint` and `lierb.velocity_constraint` make constraints from users' functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, overload

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ForceError, require_name
from lierb.kernels.functions.function import BODY, Function
from lierb.kernels.functions.shapes import ANY, Shape, UserFunction
from lierb.kernels.functions.trials import trial
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics import user_rows as kinds
from lierb.kernels.numbers.arithmetic import plain
from lierb.model.functions.decorated import Decorated, decorated
from lierb.model.functions.elements import Element
from lierb.model.functions.tracing import DERIVATIVES, POSE, VELOCITY, form_of_any, user_function
from lierb.support.arrays import Array


class Constraint(Element):
    """Constraint rows are in addition to those of the joint.

    They are made by `lierb.constraint` and `lierb.velocity_constraint`.
    """

    words: ClassVar = "a constraint", "constraints"


class ConstraintFunction(Decorated):
    """A function decorated by `lierb.constraint` returns residuals of constraint rows.

    units : units of residuals that are errors of position, and of rotation.
    """

    units: ClassVar = ("m", "1")

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        unit = defaults.pop("unit", self.units[0])
        require_name("unit", unit, self.units)
        super().__init__(function, defaults)
        self.is_translational = unit == self.units[0]

    def __call__(self, **parameters: ArrayLike) -> Constraint:
        """Make the constraint with these parameters, one value for all bodies or one for each."""
        function = self._function(self._shapes(parameters))
        rows = trial(function)
        function = replace(function, results=((rows,),))
        return self._made(function, rows, self.defaults | parameters)

    def _function(self, shapes: dict[str, Shape]) -> Function:
        return user_function(self.function, POSE, shapes, (ANY,), because=DERIVATIVES)

    def _made(self, function: Function, rows: int, values: dict[str, Any]) -> Constraint:
        kind = kinds.UserConstraint(function, rows, self.is_translational)
        return Constraint.of(function.name, kind, values, made_by=self)


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


class VelocityConstraintFunction(ConstraintFunction):
    """Function decorated by `lierb.velocity_constraint`: rates that must remain zero."""

    units: ClassVar = ("m/s", "rad/s")

    def _function(self, shapes: dict[str, Shape]) -> Function:
        arguments = (*POSE, *VELOCITY)
        form = partial(form_of_any, (), arguments=arguments)
        return user_function(self.function, arguments, shapes, (ANY,), DERIVATIVES, form)

    def _made(self, function: Function, rows: int, values: dict[str, Any]) -> Constraint:
        kind = kinds.UserVelocityConstraint(function, rows, self.is_translational)
        made = Constraint.of(function.name, kind, values, made_by=self)
        _require_linear(made)
        return made


SAMPLES = 20  # poses and pairs of twists at which a function is tried


def _require_linear(constraint: Constraint) -> None:
    """Raise ForceError if rates are not linear in ω and v, or not zero at rest."""
    kind, random = constraint.kind, np.random.default_rng(1)
    given = [
        array[0] if array.ndim > len(kind.shapes[name]) else array
        for name, array in constraint.parameters.items()
    ]
    if kind.takes_body:  # linear for any body, or for none
        given += [random.normal(size=shape) for _, shape in BODY]
    own = tuple(_as_tuple(x) for x in given)

    def rates(pose: Any, twist: Array) -> Array:
        found = kind.functions[0](own, *pose, _as_tuple(twist[:3]), _as_tuple(twist[3:]))
        return np.array([plain(x.value if isinstance(x, UserNumber) else x) for x in found])

    for _ in range(SAMPLES):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        pose = _as_tuple(turn.ravel()), _as_tuple(random.normal(size=3))
        a, b = random.normal(size=(2, 6))
        with np.errstate(all="ignore"):
            rest, both = rates(pose, np.zeros(6)), rates(pose, 2.0 * a - b)
            apart = 2.0 * rates(pose, a) - rates(pose, b)
        allowed = 1e-9 * (np.abs(apart) + np.abs(both) + np.abs(rates(pose, a)))
        if np.any(np.abs(rest) > allowed):
            raise ForceError(
                f"{constraint.name} is {rest[np.argmax(np.abs(rest))]:.3g} where omega and v are "
                "zero; expected a rate that is zero at rest. What moves, such as a belt, can be a "
                "link with a motor, and the constraint on both links"
            )
        if np.any(np.abs(both - apart) > allowed):
            raise ForceError(
                f"{constraint.name} is not linear in omega and v; expected the rate of something, "
                "such as a component of the velocity of a point"
            )


def _as_tuple(array: Array) -> Any:
    """Numbers of a parameter as a kernel has them: a number, or a flat tuple."""
    return tuple(map(float, array.ravel())) if array.ndim else float(array)


@overload
def velocity_constraint(function: UserFunction, /) -> VelocityConstraintFunction: ...
@overload
def velocity_constraint(
    *, unit: str = "m/s", **defaults: ArrayLike
) -> Callable[[UserFunction], VelocityConstraintFunction]: ...
def velocity_constraint(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make a constraint on velocities from a function: rolling, a skate, a differential.

    The function takes any of R, r, omega, v, params and body, by these names and in any order, each
    as in `lierb.wrench`. It returns one number or several that are linear in omega and v and must
    remain zero. They may be no derivative of a function of the pose (non-holonomic). Jacobian and
    acceleration term are computed from the function by exact differentiation. It cannot branch on
    numbers except by `lierb.where`.

    The constraint acts by forces that do no work, −Jᵀλ. The start must satisfy it:
    `Problem.project` and `Mechanism.project` make it so; `close` does not depend on it.
    `Mechanism.freedoms` counts it, and `lierb.predict` says whether it is kept exactly.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    unit : {"m/s", "rad/s"}, optional
        Unit of the numbers: then λ is a force, N, or a torque, N m.
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
        The function's arguments are wrong, it cannot be compiled, or it is not linear in omega and
        v.

    Examples
    --------
    A sleigh on a blade along e₁ of its body frame:

    >>> import lierb
    >>> @lierb.velocity_constraint
    ... def blade(v):
    ...     return v[1]
    >>> body = lierb.Body(1.0, (0.1, 0.1, 0.2), com=(0.3, 0.0, 0.0), about="com")
    >>> sleigh = lierb.Problem(body, lierb.joints.planar(), constraints=blade())
    >>> sleigh.project((0.0, 0.0, 1.0, 2.0, 0.5, 0.0)).round(9).tolist()
    [0.0, 0.0, 1.517241379, 2.0, 0.0, 0.0]
    """
    return decorated(VelocityConstraintFunction, function, defaults)

"""`lierb.wrench` makes wrenches, which are forces, from users' functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, ClassVar, overload

from numpy.typing import ArrayLike

from lierb.errors import unknown_name
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.mechanics.user_wrench import UserWrench
from lierb.model.functions.decorated import Decorated, decorated, require_function
from lierb.model.functions.elements import Element
from lierb.model.functions.tracing import DERIVATIVES, MOTION, POSE, SIGNALS, form_of, user_function


class Force(Element):
    """A force on the body is made by `lierb.forces` or by `lierb.wrench`."""

    words: ClassVar = "a force", "forces"


WRENCH: tuple[Shape, ...] = ((3,), (3,))


class JumpingFunction(Decorated):
    """Decorated function with parameters that are times of possible jumps."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        names = defaults.pop("discontinuities", ())
        self.discontinuities = (names,) if isinstance(names, str) else tuple(names)
        for name in self.discontinuities:
            if name not in defaults:
                raise unknown_name("discontinuities", name, defaults)
        super().__init__(function, defaults)


class Wrench(JumpingFunction):
    """A function decorated by `lierb.wrench` returns torque and force on a body."""

    _potential: UserFunction | None = None

    def __call__(self, **parameters: ArrayLike) -> Force:
        """Make the force with these parameters, one value for all bodies or one for each."""
        shapes = self._shapes(parameters)
        form = partial(form_of, MOTION, others=("body", *SIGNALS))
        function = user_function(self.function, MOTION, shapes, WRENCH, form=form)
        potential = self._potential and user_function(
            self._potential, POSE, shapes, ((),), because=DERIVATIVES
        )
        kind = UserWrench(function, potential, self.discontinuities)
        values = self.defaults | parameters
        return Force.of(self.function.__name__, kind, values, made_by=self)

    def potential(self, function: UserFunction) -> UserFunction:
        """Decorate the wrench's potential, (R, r, params) → J, which is included in the energy.

        It may be the potential of a part of the wrench; the power of the rest is included in the
        work. The potential is differentiated, and so cannot branch on numbers, like a constraint.
        """
        self._potential = require_function(function)
        return function


@overload
def wrench(function: UserFunction, /) -> Wrench: ...
@overload
def wrench(
    *, discontinuities: str | Iterable[str] = (), **defaults: ArrayLike
) -> Callable[[UserFunction], Wrench]: ...
def wrench(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make a force from a function: `@lierb.wrench`, or `@lierb.wrench(name=default, …)`.

    The function is called with (t, R, r, omega, v, params) and returns (torque, force): t in s, R
    3×3 and r the pose in the ground frame, ω and v the body-fixed twist, all as arrays of numbers;
    torque (N m) and force (N) are in body axes, about the body frame's origin.

    An argument named `body`, after `params`, is the body: `body.mass`, `body.inertia` (3×3, about
    the centre of mass, in body axes) and `body.com`. `params` may be omitted if there are none.
    Arguments named `states` and `controls` are the problem's extra states (`lierb.states`) and the
    last outputs of its controllers (`lierb.controller`), as attributes.

    The function is written for one body and compiled for many at once. It may use operators,
    `math`, NumPy, and `lierb.where(condition, a, b)` instead of `if`. A function that branches on a
    number runs body by body, 10 to 60 times slower, with one warning. The result must depend on
    the arguments alone: other objects that it refers to are compiled as they were when the force
    was made, and a force whose objects have changed raises an error.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    discontinuities : str or iterable of str, optional
        Names of parameters that are times, s, at which the function jumps or has a kink, such as
        the switching times of a thruster. Steps end there, as for the argument `discontinuities`
        of `lierb.integrate`.
    **defaults : array_like
        Default of each parameter, which determines its shape for one body. In the function they are
        `params.name`. Without defaults all parameters are numbers.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes a force for `Problem(forces=…)`.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be compiled.

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

"""`lierb.variable_mass` makes bodies of variable mass from users' functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, ClassVar, overload

from numpy.typing import ArrayLike

from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.mechanics.added_inertia import VariableMass
from lierb.model.functions.decorated import decorated
from lierb.model.functions.tracing import SIGNALS, form_of_any, user_function
from lierb.model.functions.wrenches import Force, JumpingFunction

MASS: tuple[Shape, ...] = ((), (3,), (3, 3))  # mass, centre of mass, inertia


class VariableBody(Force):
    """Force of a body of variable mass on a link."""

    because: ClassVar = "the equations of motion are solved with it"


class VariableMassFunction(JumpingFunction):
    """Function decorated by `lierb.variable_mass`: mass, centre of mass and inertia."""

    def __call__(self, **parameters: ArrayLike) -> VariableBody:
        """Make the body with these parameters, one value for all or one for each."""
        form = partial(form_of_any, SIGNALS, arguments=("t",))
        shapes, because = self._shapes(parameters), VariableBody.because
        function = user_function(self.function, ("t",), shapes, MASS, because, form)
        kind = VariableMass(function, self.discontinuities)
        return VariableBody.of(function.name, kind, self.defaults | parameters, made_by=self)


@overload
def variable_mass(function: UserFunction, /) -> VariableMassFunction: ...
@overload
def variable_mass(
    *, discontinuities: str | Iterable[str] = (), **defaults: ArrayLike
) -> Callable[[UserFunction], VariableMassFunction]: ...
def variable_mass(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make a body of variable mass on a link from a function: propellant, ballast, payload.

    The function takes any of t, params, body, states and controls, by these names and in any order,
    each as in `lierb.wrench`. It returns (mass, com, inertia) of a rigid body that moves with the
    link, in addition to the link's own body: kg, zero or more; (3,) m, in the link's body frame;
    3×3 kg m², about this centre of mass. Gravity acts on it. A negative mass ends the trajectory
    as "non_finite".

    Mass leaves or joins at the velocity of the body there, without a force. The thrust of a jet is
    a force of its own, −ṁ u for the exhaust velocity u. Neither is a change of the inertia a torque
    −İ ω: what leaves takes its angular momentum along.

    It is for a link of a `lierb.Mechanism`. The energy and momentum of a result are those of the
    link's own body; the work includes that of the wrench between the two.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    discontinuities : str or iterable of str, optional
        Names of parameters that are times, s, at which the mass jumps or has a kink, such as
        burnout. Steps end there, as for the argument `discontinuities` of `lierb.integrate`.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes a force for `Mechanism(forces=…)`.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be compiled.

    References
    ----------
    Tsiolkovsky's equation: with a thrust −ṁ u along the axis, Δv = u ln(m₀/m₁).

    Examples
    --------
    >>> import lierb
    >>> import numpy as np
    >>> @lierb.variable_mass(mass=20.0, rate=2.0, burnout=8.0, discontinuities="burnout")
    ... def propellant(t, params):
    ...     left = params.mass - params.rate * lierb.clip(t, 0.0, params.burnout)
    ...     return left, (0.0, 0.0, -0.5), left * np.diag((0.03, 0.03, 0.01))
    >>> propellant(mass=[20.0, 22.0]).on("rocket")
    <propellant: mass, rate, burnout, on rocket>
    """
    return decorated(VariableMassFunction, function, defaults)

"""Friction in joints that holds: LuGre's model, with a bristle as an extra state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.kernels.functions.elementary import exp
from lierb.kernels.functions.shapes import Shape, Shapes
from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.newton_euler import Motion, Wrench
from lierb.kernels.mechanics.passive_elements import AddedStates
from lierb.kernels.numbers.arithmetic import absolute, fma
from lierb.kernels.numbers.vec import Vec
from lierb.model.forces.built_in import Parameter
from lierb.model.forces.joint_axes import AlongJoint, AtJoint, sliding
from lierb.model.functions.named_values import require_attribute
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import Array, as_positive, first_bad

__all__ = ["joint_stiction", "slide_stiction"]

BRISTLE = "bristle"


@dataclass(frozen=True)
class JointStiction(AtJoint, AddedStates):
    """LuGre friction about the joint axis; its state is the deflection of the bristle.

    has_static : False if friction at rest is that of sliding, and no parameter.
    """

    has_static: bool = True
    states: Shapes = ((BRISTLE, ()),)
    name: ClassVar = "joint_stiction"
    state_unit: ClassVar = "rad"
    parameters: ClassVar = {
        "coulomb": Parameter("N m", is_signed=False),
        "static": Parameter("N m", is_signed=False),
        "stribeck": Parameter("rad/s", is_signed=False),
        "stiffness": Parameter("N m/rad", is_signed=False),
        "damping": Parameter("N m s/rad", is_signed=False),
        "viscous": Parameter("N m s/rad", is_signed=False),
        "start": Parameter("rad"),
    }

    @property
    def shapes(self) -> dict[str, Shape]:
        own = super().shapes
        return own if self.has_static else {k: x for k, x in own.items() if k != "static"}

    @property
    def options(self) -> dict[str, Any]:
        name = self.states[0][0]
        return {} if name == BRISTLE else {"state": name}

    def require_fit(self, parameters: Mapping[str, Array]) -> None:
        super().require_fit(parameters)
        for name in ("coulomb", "stribeck"):
            as_positive(name, parameters[name], self.parameters[name].unit)
        if not self.has_static:
            return
        coulomb, static = np.broadcast_arrays(parameters["coulomb"], parameters["static"])
        for body, label in first_bad("static", static < coulomb):
            raise ArgumentError(
                f"{label} is {static.flat[body]}, less than coulomb, {coulomb.flat[body]}; "
                "friction at rest is at least that of sliding"
            )

    def at_start(self, placed: Any, x: Motion | None) -> Vec:
        return (placed[-1],)

    def rates(self, placed: Any, x: Motion) -> Vec:
        """Rate of the deflection z: ż = u − |u| stiffness z/g(u), u the rate of the joint."""
        limit, rate, stiffness = placed[0], self.rate(x), placed[-4]
        if self.has_static:
            coulomb, static, stribeck, *_ = placed
            slow = rate / stribeck
            limit = fma(static - coulomb, exp(-(slow * slow)), coulomb)
        return (rate - absolute(rate) * (stiffness * x.signals.states[self.index] / limit),)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        *_, stiffness, damping, viscous, _ = placed
        (slip,) = self.rates(placed, x)
        held = fma(stiffness, x.signals.states[self.index], damping * slip)
        return self.pushed(-fma(viscous, self.rate(x), held))

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        *_, stiffness, damping, viscous, _ = placed
        return (self.tangent(stiffness, damping + viscous),)


class SlideStiction(AlongJoint, JointStiction):
    """LuGre friction along the joint axis."""

    name = "slide_stiction"
    state_unit: ClassVar = "m"
    parameters: ClassVar = sliding(JointStiction.parameters)


def joint_stiction(
    *,
    coulomb: ArrayLike,
    stiffness: ArrayLike,
    static: ArrayLike | None = None,
    stribeck: ArrayLike = 1e-2,
    damping: ArrayLike = 0.0,
    viscous: ArrayLike = 0.0,
    start: ArrayLike = 0.0,
    state: str = BRISTLE,
) -> Force:
    """Apply friction with sticking to a joint that turns: LuGre's model.

    A bristle between the surfaces has the deflection z, an extra state:

    ::

        ż = ω − abs(ω) stiffness z/g(ω),   g(ω) = coulomb + (static − coulomb) exp(−(ω/stribeck)²)
        torque = −(stiffness z + damping ż + viscous ω)   about the joint axis

    A torque below `static` deflects the bristle, like a spring, and the joint sticks. Above it the
    joint breaks away and slides. With `joint_friction`, which has no state, a joint that should
    stick creeps.

    Without `damping` a joint of inertia I that sticks oscillates at √(stiffness/I); critical
    damping is 2√(stiffness · I). Sliding is stiff, at the rate stiffness abs(ω)/g:
    take a Rosenbrock method, such as `method="Rodas4"`, with `rtol`. Under a load that oscillates
    below `static`, the model drifts a little in every period.

    Parameters
    ----------
    coulomb : float or array_like, shape (n,)
        Torque of sliding friction, N m, positive.
    stiffness : float or array_like, shape (n,)
        Stiffness of the bristle, N m/rad.
    static : float or array_like, shape (n,), optional
        Largest torque at rest, N m, at least `coulomb`. Default: `coulomb`, also where that is
        varied.
    stribeck : float or array_like, shape (n,), optional
        Rate over which friction falls from `static` to `coulomb`, rad/s, positive.
    damping : float or array_like, shape (n,), optional
        Damping of the bristle, N m s/rad.
    viscous : float or array_like, shape (n,), optional
        Coefficient of viscous friction, N m s/rad.
    start : float or array_like, shape (n,), optional
        Deflection at the start, rad. A joint under a constant load is at rest with the deflection
        load/stiffness.
    state : str, optional
        Name of the deflection, a column of `history` and `summary`, which users' functions read as
        `states.bristle`. Each stiction of a mechanism needs a name of its own.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        A parameter is negative, `coulomb` or `stribeck` zero, or `static` less than `coulomb`.

    References
    ----------
    .. [1] C. Canudas de Wit, H. Olsson, K. J. Åström, P. Lischinsky, A new model for control of
       systems with friction, IEEE Transactions on Automatic Control 40 (1995) 419–425.

    Examples
    --------
    A wheel of 0.01 kg m² sticks under 0.9 of the torque at which it would turn:

    >>> import lierb
    >>> import numpy as np
    >>> brake = lierb.forces.joint_stiction(coulomb=1.0, stiffness=1e4, damping=20.0)
    >>> load = lierb.forces.constant_wrench(torque=(0.0, 0.0, 0.9))
    >>> wheel = lierb.Problem(
    ...     lierb.Body(1.0, (0.01, 0.01, 0.01)), lierb.joints.revolute(), forces=[brake, load]
    ... )
    >>> result = lierb.integrate(wheel, t_end=10.0, rtol=1e-6, method="Rodas4")
    >>> np.round(result.summary["bristle"].to_numpy() * 1e4, 6).tolist()  # N m
    [0.9]
    """
    return _stiction(
        JointStiction, state, coulomb=coulomb, static=static, stribeck=stribeck,
        stiffness=stiffness, damping=damping, viscous=viscous, start=start,
    )  # fmt: skip


def slide_stiction(
    *,
    coulomb: ArrayLike,
    stiffness: ArrayLike,
    static: ArrayLike | None = None,
    stribeck: ArrayLike = 1e-3,
    damping: ArrayLike = 0.0,
    viscous: ArrayLike = 0.0,
    start: ArrayLike = 0.0,
    state: str = BRISTLE,
) -> Force:
    """Apply friction with sticking to a joint that slides; see `joint_stiction`.

    Parameters
    ----------
    coulomb : float or array_like, shape (n,)
        Sliding friction, N, positive.
    stiffness : float or array_like, shape (n,)
        Stiffness of the bristle, N/m.
    static : float or array_like, shape (n,), optional
        Largest force at rest, N, at least `coulomb`. Default: `coulomb`, also where that is
        varied.
    stribeck : float or array_like, shape (n,), optional
        Rate over which friction falls from `static` to `coulomb`, m/s, positive.
    damping : float or array_like, shape (n,), optional
        Damping of the bristle, N s/m.
    viscous : float or array_like, shape (n,), optional
        Coefficient of viscous friction, N s/m.
    start : float or array_like, shape (n,), optional
        Deflection at the start, m.
    state : str, optional
        Name of the deflection, a column of `history` and `summary`.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        A parameter is negative, `coulomb` or `stribeck` zero, or `static` less than `coulomb`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_stiction(coulomb=2.0, static=3.0, stiffness=1e5, damping=100.0)
    <slide_stiction: coulomb, static, stribeck, stiffness, damping, viscous, start>
    """
    return _stiction(
        SlideStiction, state, coulomb=coulomb, static=static, stribeck=stribeck,
        stiffness=stiffness, damping=damping, viscous=viscous, start=start,
    )  # fmt: skip


def _stiction(
    kind: type[JointStiction], state: str, *, static: ArrayLike | None, **values: ArrayLike
) -> Force:
    require_attribute("a bristle", state)
    if static is not None:
        values["static"] = static
    return kind(has_static=static is not None, states=((state, ()),)).force(**values)

"""`lierb.ground_motion` makes the motion of a ground from a user's function."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, overload

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, brief
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.mechanics import ground_motion as kinds
from lierb.model.functions.decorated import decorated, reject_functions
from lierb.model.functions.tracing import DERIVATIVES, user_function
from lierb.model.functions.wrenches import Force, JumpingFunction

DISPLACEMENT: tuple[Shape, ...] = ((3,),)


class MovingGround(Force):
    """Force of inertia on a link, in the frame of a ground that moves."""

    words: ClassVar = "a motion of the ground", "motions of the ground"


class GroundMotion(JumpingFunction):
    """Function decorated by `lierb.ground_motion`: the displacement of the ground."""

    def __call__(self, **parameters: ArrayLike) -> MovingGround:
        """Make the motion with these parameters, one value for all bodies or one for each."""
        shapes = self._shapes(parameters)
        function = user_function(self.function, ("t",), shapes, DISPLACEMENT, DERIVATIVES)
        kind = kinds.GroundMotion(function, self.discontinuities)
        return MovingGround.of(function.name, kind, self.defaults | parameters, made_by=self)


@overload
def ground_motion(function: UserFunction, /) -> GroundMotion: ...
@overload
def ground_motion(
    *, discontinuities: str | Iterable[str] = (), **defaults: ArrayLike
) -> Callable[[UserFunction], GroundMotion]: ...
def ground_motion(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Let the ground move as given: a pivot that is shaken, a crane, an earthquake.

    The function is called with (t, params) or (t) and returns the displacement of the ground, (3,)
    m, in its axes, which do not turn. Its second derivative by time is exact. The result is the
    argument `ground_motion` of `lierb.Problem` and `lierb.Mechanism`.

    All positions, velocities, accelerations and energies are then relative to the moving ground,
    as an observer on it sees them: joints are kept as on a ground at rest, and a start at rest is
    at rest relative to the ground. A body has the further force −m s̈ at its centre of mass, for
    the displacement s. The work includes that of this force. Air and fluid move with the ground;
    specific forces are those of an accelerometer, which measures s̈ too.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    discontinuities : str or iterable of str, optional
        Names of parameters that are times, s, at which the acceleration of the ground jumps. Steps
        end there, as for the argument `discontinuities` of `lierb.integrate`. A jump of the
        velocity itself is a shock, which the motion does not have.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes the motion.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be differentiated.

    References
    ----------
    Landau and Lifshitz, Mechanics, § 39, for a frame that does not turn.

    Examples
    --------
    A pendulum stands upright on a pivot that vibrates by 5 mm at 500 rad/s (Kapitza):

    >>> import lierb, math
    >>> @lierb.ground_motion(amplitude=5e-3, omega=500.0)
    ... def vibration(t, params):
    ...     return 0.0, 0.0, params.amplitude * math.sin(params.omega * t)
    >>> pin = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, -0.1))
    >>> rod = lierb.bodies.rod(0.2, 0.01, mass=0.1)
    >>> pendulum = lierb.Problem(
    ...     rod, pin, gravity=(0.0, 0.0, -9.81), ground_motion=vibration(amplitude=[0.0, 5e-3])
    ... )
    >>> result = lierb.integrate(pendulum, pose0=pin.pose([0.1]), dt=1e-4, t_end=0.5)
    >>> (result.position[:, 2] > 0.05).tolist()  # still upright?
    [False, True]
    """
    return decorated(GroundMotion, function, defaults)


def moving_ground(given: Any) -> MovingGround | None:
    """Return the motion of an argument `ground_motion`. Raises ArgumentError."""
    if given is None or isinstance(given, MovingGround):
        return given
    reject_functions("ground_motion", given)
    if not inspect.isfunction(given):
        raise ArgumentError(
            f"ground_motion={brief(given)}; expected a function of t that returns the displacement "
            "of the ground, or what a function decorated by lierb.ground_motion returns"
        )
    return GroundMotion(given, {})()


def for_all_links(motion: MovingGround) -> str:
    """Return the remedy for a motion that is not on all links."""
    return (
        f"give ground_motion={motion.name}(…) to the model, which moves the ground for all links; "
        "in a study, put it on each link, under names of their own"
    )


def require_one_ground(model: Any) -> None:
    """Raise ForceError unless the ground moves for all links, and no force forbids that."""
    moving = [force for force in model.forces if isinstance(force, MovingGround)]
    if not moving:
        return
    links = [force.at[0] if force.at else "" for force in moving]
    if any(links.count(link) != links.count(links[0]) for link in model.link_names):
        raise ForceError(
            f"{moving[0].name} moves the ground for {', '.join(sorted({*links}))} only; "
            f"{for_all_links(moving[0])}"
        )
    of_first, *of_others = (
        [x for x in moving if x.at == at] for at in {x.at: None for x in moving}
    )
    for own in of_others:
        for force, first in zip(own, of_first, strict=True):
            _require_same(force, first)
    for force in model.forces:
        if force.kind.adds_inertia:
            raise ForceError(
                f"{force.name} adds inertia to a link, on which a ground_motion does not act; "
                "move the ground by a link on a slide with motor(position=…)"
            )


def _require_same(force: MovingGround, first: MovingGround) -> None:
    """Raise ForceError for parts of a motion, on two links, that differ."""
    if force.kind != first.kind:
        raise ForceError(
            f"the ground moves for {force.at[0]} by {force.name} where it moves for {first.at[0]} "
            f"by {first.name}; give the motions of all links in the same order"
        )
    for name, array in force.parameters.items():
        if not np.array_equal(array, first.parameters[name]):
            raise ForceError(
                f"{name} of {force.name} differs for {force.at[0]} and {first.at[0]}; the ground "
                "has the same motion for all links"
            )

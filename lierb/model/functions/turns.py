"""Angles of joints that count whole turns: `lierb.turns`."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.model.functions.named_values import require_attribute
from lierb.model.functions.states import ExtraStates


def turns(name: str = "turned", *, start: ArrayLike = 0.0) -> ExtraStates:
    """Count the turns of a joint: its angle about e₃ without end, as an extra state.

    A pose determines an angle up to whole turns. This state is the integral of the joint's rate,
    made by the same method as the motion. It is a column of `history` and `summary`, in rad;
    wrenches, observables, events, controllers and other states read it as `states.turned`; and
    `lierb.forces.torsional_spring(…, turns="turned")` and `joint_limit` on the same joint take
    their turns from it and the rest of the angle from the pose. A run that is continued from
    `result.end` goes on counting.

    Parameters
    ----------
    name : str, optional
        Name of the state and of its column; needed if several joints are counted.
    start : float or array_like, shape (n,), optional
        Angle at the start, rad, up to less than half a turn: the state starts at the angle of the
        pose that is nearest to it. In a study the state starts at the joint's
        `initial.coordinates`, if they are given.

    Returns
    -------
    ExtraStates
        Element for `Problem(states=…)`; in a mechanism placed by `.on(link)`. The joint must keep
        the axis e₃ and turn about it, such as revolute, cylindrical and screw.

    Raises
    ------
    ArgumentError
        The name cannot be a column's.

    Examples
    --------
    A mainspring that is wound by ten turns:

    >>> import lierb
    >>> import numpy as np
    >>> barrel = lierb.Problem(
    ...     lierb.Body(0.1, (1e-5, 1e-5, 2e-5)),
    ...     lierb.joints.revolute(),
    ...     forces=lierb.forces.torsional_spring(stiffness=1e-3, damping=1e-3, turns="turned"),
    ...     states=lierb.turns(start=20.0 * np.pi),
    ... )
    >>> result = lierb.integrate(barrel, twist0=np.zeros(6), dt=1e-2, t_end=1.0)
    >>> np.round(result.summary["turned"].to_numpy() / (2.0 * np.pi), 2).tolist()  # of ten turns
    [3.68]
    """
    require_attribute("a counted angle", name)
    kind = TurnCounter(((name, ()),))
    return ExtraStates.of(name, kind, {"start": start}, units={name: "rad"})

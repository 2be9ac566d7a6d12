"""`lierb.gear` couples two joints by their links' names."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from lierb.model.forces.gears import gear as gear_of_ratio
from lierb.model.functions.wrenches import Force


def gear(
    first: str, second: str, ratio: ArrayLike, *, coordinates: Sequence[str | None] | None = None
) -> Force:
    """Couple two joints of a mechanism: toothed wheels, a belt, or a rack and its pinion.

    `lierb.gear(first, second, ratio)` is short for
    `lierb.forces.gear(ratio, coordinates=…).on(first, second)`, which describes the coupling.

    Parameters
    ----------
    first : str
        Link whose joint is coupled.
    second : str
        Link of the other joint.
    ratio : float or array_like, shape (n,)
        Rate of the first joint's coordinate by that of the second one's: 1, m/rad or rad/m.
        Negative for wheels that touch outside; a belt's is positive; that of a rack by its pinion
        is the pinion's radius, m/rad.
    coordinates : sequence of 2, optional
        Coordinate of each joint, "turn" or "slide", as in `lierb.forces.gear`.

    Returns
    -------
    Force
        Element for `Mechanism(forces=…)`.

    Raises
    ------
    ArgumentError
        `coordinates` are not two.
    UnknownNameError
        A coordinate is unknown.

    Examples
    --------
    A rack moves 0.05 m for each radian of its pinion:

    >>> import lierb
    >>> wheel = lierb.bodies.cylinder(0.05, 0.02, mass=1.0)
    >>> machine = lierb.Mechanism(
    ...     [
    ...         lierb.Link("pinion", wheel, lierb.joints.revolute()),
    ...         lierb.Link("rack", wheel, lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))),
    ...     ],
    ...     forces=lierb.gear("rack", "pinion", 0.05),
    ... )
    >>> twist0 = machine.project(machine.twist({"rack": 0.1, "pinion": 2.0}))
    >>> machine.velocities(twist0)["rack"].round(9).tolist()
    [0.1]
    """
    return gear_of_ratio(ratio, coordinates=coordinates).on(first, second)

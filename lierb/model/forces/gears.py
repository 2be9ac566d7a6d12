"""Gears: coupled coordinates of two joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, require_name
from lierb.kernels.mechanics.axis_rows import AxisRow
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import AddedRow, HeldBody, Rows
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import Vec, scale
from lierb.model.forces.built_in import BuiltIn, Parameter
from lierb.model.forces.motors import COORDINATES, own_coordinate
from lierb.model.functions.wrenches import Force

__all__ = ["gear"]

Coordinates = tuple[str | None, str | None]


@dataclass(frozen=True)
class Gear(BuiltIn):
    """Ratio of the rates of two joints' coordinates: a constraint row on both joints.

    coordinates : "turn", "slide" or None, of each joint; see `motors.Prescribed`.
    """

    coordinates: Coordinates = (None, None)
    rows: int = 1
    name = "gear"
    parameters: ClassVar = {"ratio": Parameter("1")}
    needs_axis: ClassVar = True
    joints: ClassVar = 2
    does_work: ClassVar = False

    @property
    def options(self) -> dict[str, Any]:
        return {"coordinates": [*self.coordinates]}

    def slides_at(self, joint: int) -> bool:
        return self.coordinates[joint] == "slide"

    def on_joint(self, rows: Rows, joint: int = 0) -> Gear:
        chosen = [*self.coordinates]
        chosen[joint] = chosen[joint] or own_coordinate(rows)
        return replace(self, coordinates=(chosen[0], chosen[1]))

    def unit_of(self, name: str) -> str:
        units = {(True, False): "m/rad", (False, True): "rad/m"}
        return units.get((self.slides_at(0), self.slides_at(1)), "1")

    def row(self, place: int, i: int) -> AddedRow:
        return GearRow(self, place, i)


class GearRow(AxisRow):
    """Constraint row q̇ − ratio q̇₂ = 0: its part at the first joint.

    The row is linear in the joints' rates. Whole turns do not matter, and the angles at the start
    are the mesh.
    """

    is_holonomic = False
    joint: ClassVar = 0

    def __str__(self) -> str:
        return "gear"

    @property
    def is_translational(self) -> bool:  # type: ignore[override]
        return bool(self.element.slides_at(self.joint))

    @property
    def second(self) -> AxisRow:  # type: ignore[override]
        return SecondRow(self.element, self.place, self.i)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        return self.bend(x, body)


class SecondRow(GearRow):
    """Part of a gear's row at the second joint."""

    joint: ClassVar = 1
    second = None  # type: ignore[assignment]

    def _factor(self, body: HeldBody) -> Any:
        return -self.placed(body)[0]

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return scale(self._factor(body), super().jacobian(x, body))

    def bend(self, x: Kinematics, body: HeldBody) -> Any:
        return self._factor(body) * super().bend(x, body)

    def moved(self, x: Kinematics, before: Kinematics, body: HeldBody) -> Any:
        return self._factor(body) * super().moved(x, before, body)


def gear(ratio: ArrayLike, *, coordinates: Sequence[str | None] | None = None) -> Force:
    """Couple the coordinates of two joints of a mechanism, such as those of two toothed wheels.

    `gear(ratio).on(first, second)` makes the rate of the first joint's coordinate `ratio` times
    that of the second one's. The coordinates are those of `Mechanism.coordinates`, relative to each
    joint's parent: two outer wheels on one carrier have a negative ratio. The coupling is ideal: it
    transmits −λ to the first joint and ratio·λ to the second one, each between its link and the
    parent, and does no work. The rates at the start must have this ratio: `Mechanism.project` finds
    such rates. The teeth mesh at the coordinates of the start: `Mechanism.close` keeps the mesh.

    Parameters
    ----------
    ratio : float or array_like, shape (n,)
        Rate of the first coordinate by that of the second one, 1, m/rad, or rad/m: the radius of
        the pinion for a rack and its pinion.
    coordinates : sequence of 2, optional
        Coordinate of each joint, "turn" or "slide". Default: the turn about its axis e₃, or, if the
        joint does not turn, the slide along it.

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
    >>> import lierb
    >>> wheel = lierb.bodies.cylinder(0.1, 0.02, mass=1.0)
    >>> machine = lierb.Mechanism(
    ...     [
    ...         lierb.Link("pinion", wheel, lierb.joints.revolute()),
    ...         lierb.Link("wheel", wheel, lierb.joints.revolute((0, 0, 0), (0.3, 0, 0))),
    ...     ],
    ...     forces=lierb.forces.gear(-3.0).on("pinion", "wheel"),
    ... )
    >>> machine.freedoms()
    Mobility(freedoms=1, redundant=0)
    >>> twist0 = machine.project(machine.twist({"pinion": 3.0, "wheel": -1.0}))
    >>> machine.velocities(twist0)["wheel"].round(9).tolist()
    [-1.0]
    """
    pair = (None, None) if coordinates is None else tuple(coordinates)
    if len(pair) != 2:
        raise ArgumentError(
            f"coordinates={brief(coordinates)}; expected one for each of two joints"
        )
    for each in pair:
        if each is not None:
            require_name("coordinates", each, COORDINATES)
    return Gear((pair[0], pair[1])).force(ratio=ratio)

"""Base class of the forces in `lierb.forces`: parameters, units and frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, body_label
from lierb.kernels.functions.shapes import Shape
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames
from lierb.kernels.numbers.arithmetic import sqrt, where
from lierb.kernels.numbers.vec import Vec, cross, dot
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import Array, first_bad

ORIGIN = (0.0, 0.0, 0.0)
SIZE = 6  # of a matrix on twists: three axes of rotation, then of translation
SYMMETRIC = 1e-12  # relative to the largest entry: rounding of a matrix that was turned


class Parameter(NamedTuple):
    """Parameter of a force.

    unit : unit, as text.   shape : shape for one body.   is_signed : True if it may be negative.
    to_joint_axes : function that transforms it to joint axes.
    """

    unit: str
    shape: Shape = ()
    is_signed: bool = True
    to_joint_axes: Callable[[Frames, Any], Any] = lambda frames, value: value


BODY_POINT = Parameter("m", (3,), to_joint_axes=Frames.body_point)
GROUND_POINT = Parameter("m", (3,), to_joint_axes=Frames.ground_point)
UNITS: dict[str, dict[str, str]] = {}  # units of parameters, by force


@dataclass(frozen=True)
class BuiltIn(Element):
    """Base class of the forces in `lierb.forces`.

    name : name of the function that makes the force, and of its type in a study.
    """

    name: ClassVar[str]
    parameters: ClassVar[dict[str, Parameter]]

    def __init_subclass__(cls, is_abstract: bool = False) -> None:
        if is_abstract:
            return
        units = UNITS.setdefault(cls.name, {})
        units |= {name: parameter.unit for name, parameter in cls.parameters.items()}

    @property
    def shapes(self) -> dict[str, Shape]:
        own = {name: parameter.shape for name, parameter in self.parameters.items()}
        return super().shapes if self.functions else own

    @property
    def options(self) -> dict[str, Any]:
        """Arguments other than parameters of the function that makes the force."""
        return {}

    def unit_of(self, name: str) -> str:
        """Return the unit of a parameter, or "" for one of a user's function."""
        return self.parameters[name].unit if name in self.parameters else ""

    def force(self, /, **values: ArrayLike) -> Force:
        """Make the force with these parameters."""
        return Force.of(self.name, self, values)

    def require_fit(self, parameters: Mapping[str, Array]) -> None:
        own = self.parameters
        for name in (x for x in self.shapes if x in own and not own[x].is_signed):
            array = parameters[name]
            for body, label in first_bad(name, array < 0.0):
                number = array.flat[body]
                raise ArgumentError(f"{label} is {number}; expected zero or a positive number")

    def placed(self, values: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        own = self.parameters
        return tuple(
            own[name].to_joint_axes(frames, x) if name in own else x for name, x in values.items()
        )


def inverse_norm(a: Vec) -> Any:
    """Compute 1/‖a‖, and 0 for the zero vector."""
    square = dot(a, a)
    some = square > 0.0
    return where(some, 1.0, 0.0) / sqrt(where(some, square, 1.0))


def unit_force_at(point: Vec, direction: Vec) -> Vec:
    """Torque and force of a unit force at a point."""
    return cross(point, direction) + direction


# ---- matrices on twists ------------------------------------------------------------------------


def is_six_by_six(array: Array) -> bool:
    return bool(array.shape[-2:] == (SIZE, SIZE))


def as_six_by_six(array: Array) -> Array:
    """Return a diagonal matrix of numbers by axis; a matrix itself."""
    is_by_axis = array.shape[-1:] == (SIZE,) and not is_six_by_six(array)
    return array[..., None] * np.eye(SIZE) if is_by_axis else array


def require_semidefinite(name: str, array: Array, is_matrix: bool) -> None:
    """Raise ArgumentError for negative numbers by axis, or negative or asymmetric matrices."""
    items = array.reshape(-1, *array.shape[-1 - is_matrix :])
    for body, item in enumerate(items):
        label = body_label(name, body, len(items))
        size = np.abs(item).max()
        if not is_matrix:
            if (item < 0.0).any():
                raise ArgumentError(f"{label} is {item.tolist()}; expected no negative number")
        elif np.abs(item - item.T).max() > SYMMETRIC * size:
            raise ArgumentError(
                f"{label} is not symmetric; a shape that ends with (6, 6) is a matrix, so that six "
                "bodies with numbers by axis need matrices too"
            )
        elif np.linalg.eigvalsh(item).min() < -SYMMETRIC * size:
            raise ArgumentError(f"{label} has a negative eigenvalue; expected none")

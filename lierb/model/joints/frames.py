"""Make joint frames from a point and directions, or from 4×4 matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.kernels.numbers.vec import Vec, cross, dot, norm, scale, sub
from lierb.support.arrays import (
    Array,
    as_numbers,
    as_poses,
    batch_size,
    components,
    first_bad,
    pose_components,
    pose_matrix,
)

PERPENDICULAR_TOLERANCE = 1e-9  # cosine of the angle between two perpendicular directions


def body_frame_of(
    frame: Any,
    point: ArrayLike | None,
    axis: ArrayLike | None,
    slot: ArrayLike | None,
    second_axis: ArrayLike | None,
) -> Array:
    """Return the joint frame on the body: `frame`, or the point with e₃ along the axis."""
    options = {"body_point": point, "axis": axis, "slot": slot, "second_axis": second_axis}
    given: dict[str, Any] = {name: x for name, x in options.items() if x is not None}
    if frame is not None:
        for name in given:
            raise ArgumentError(f"give body_frame or {name}, not both")
        return as_poses("body_frame", frame)
    if slot is not None and second_axis is not None:
        raise ArgumentError("give slot (e₁) or second_axis (e₂), not both")
    given = {"body_point": (0.0, 0.0, 0.0), "axis": (0.0, 0.0, 1.0)} | given
    vectors = {name: as_numbers(name, value, (3,)) for name, value in given.items()}
    batch_size(**{name: (vector, 1) for name, vector in vectors.items()})
    e3 = _direction("axis", vectors["axis"])
    if slot is not None:
        e1 = _perpendicular("slot", slot, e3)
    elif second_axis is not None:
        e1 = cross(_perpendicular("second_axis", second_axis, e3), e3)
    else:
        e1 = _any_perpendicular(e3)
    e2 = cross(e3, e1)
    rotation = (e1[0], e2[0], e3[0], e1[1], e2[1], e3[1], e1[2], e2[2], e3[2])
    return pose_matrix((rotation, components(vectors["body_point"])))


def ground_frame_of(
    frame: Any,
    point: ArrayLike | None,
    parent_frame: Any,
    parent_point: ArrayLike | None,
    body_frame: Array,
) -> Array:
    """Return the joint frame on the ground or parent; by default parallel to the body's."""
    point = _one_of("point", point, parent_point)
    frame = _one_of("frame", frame, parent_frame)
    if frame is not None:
        if point is not None:
            raise ArgumentError("give ground_frame or ground_point, not both")
        return as_poses("ground_frame", frame)
    origin = as_numbers("ground_point", (0.0, 0.0, 0.0) if point is None else point, (3,))
    batch_size(body_frame=(body_frame, 2), ground_point=(origin, 1))
    return pose_matrix((pose_components(body_frame)[0], components(origin)))


def _one_of(what: str, ground: Any, parent: Any) -> Any:
    if ground is not None and parent is not None:
        raise ArgumentError(f"give ground_{what} or parent_{what}: they are the same")
    return parent if ground is None else ground


def _direction(argument: str, value: ArrayLike) -> Vec:
    """Return the unit vector along `value`."""
    array = as_numbers(argument, value, (3,))
    largest = np.abs(array).max(axis=-1)
    for _, label in first_bad(argument, largest == 0.0):
        raise ArgumentError(f"{label} is the zero vector; expected a direction")
    exponent = np.frexp(largest)[1]  # scaling by a power of two is exact, and no square overflows
    return _unit(components(np.ldexp(array, -exponent[..., None])))


def _perpendicular(argument: str, value: ArrayLike, e3: Vec) -> Vec:
    """Unit vector along `value`; raises unless it is perpendicular to e₃."""
    e = _direction(argument, value)
    slant = dot(e, e3)
    cosines = np.atleast_1d(np.abs(slant))
    for body, label in first_bad(argument, cosines > PERPENDICULAR_TOLERANCE):
        raise ArgumentError(
            f"{label} is not perpendicular to axis: the cosine is {cosines[body]:.3g}"
        )
    return _unit(sub(e, scale(slant, e3)))


def _any_perpendicular(e3: Vec) -> Vec:
    """Return a unit vector ⊥ e₃: the part of x normal to e₃, or of y if e₃ is near x.

    Near means |cos| ≥ 0.9.
    """
    x_fits = np.abs(e3[0]) < 0.9
    chosen = (np.where(x_fits, 1.0, 0.0), np.where(x_fits, 0.0, 1.0), np.zeros_like(e3[2]))
    return _unit(sub(chosen, scale(dot(chosen, e3), e3)))


def _unit(v: Vec) -> Vec:
    return scale(1.0 / norm(v), v)

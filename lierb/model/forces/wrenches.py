"""Constant wrenches, and drag."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.errors import require_name
from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Wrench
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import UNIT, ZERO3, cross_add, dot, mat_t_vec, norm, scale
from lierb.model.forces.built_in import (
    BODY_POINT,
    ORIGIN,
    BuiltIn,
    Parameter,
    inverse_norm,
    unit_force_at,
)
from lierb.model.functions.wrenches import Force

__all__ = ["constant_wrench", "drag"]


class BodyWrench(BuiltIn):
    """Wrench that is constant in body axes, such as that of a thruster."""

    name = "constant_wrench"
    parameters: ClassVar = {
        "torque": Parameter("N m", (3,)), "force": Parameter("N", (3,)), "point": BODY_POINT,
    }  # fmt: skip

    @property
    def options(self) -> dict[str, Any]:
        return {"frame": "body"}

    def placed(self, values: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        force = frames.body_direction(values["force"])
        torque = frames.body_direction(values["torque"])
        return cross_add(frames.body_point(values["point"]), force, torque), force

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force = placed
        return torque, force


class GroundWrench(BuiltIn):
    """Wrench that is constant in ground axes; the force has a potential, the torque has none."""

    name = BodyWrench.name
    parameters: ClassVar = BodyWrench.parameters
    is_conservative: ClassVar = True
    working: ClassVar = ("torque",)

    def placed(self, values: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return (
            frames.ground_direction(values["torque"]),
            frames.ground_direction(values["force"]),
            frames.body_point(values["point"]),
            -dot(values["force"], frames.ground[1]),
        )

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force, point, _ = placed
        pull = mat_t_vec(x.q, force)
        return cross_add(point, pull, mat_t_vec(x.q, torque)), pull

    def energy(self, placed: Any, x: Motion) -> Any:
        _, force, point, at_origin = placed
        return at_origin - dot(force, x.place_of(point))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return dot(mat_t_vec(x.q, placed[0]), x.omega)


def constant_wrench(
    torque: ArrayLike = ORIGIN,
    force: ArrayLike = ORIGIN,
    *,
    point: ArrayLike = ORIGIN,
    frame: str = "ground",
) -> Force:
    """Apply a constant torque, and a constant force at a point of the body.

    A force that is constant in ground axes has a potential, −force·x, included in the energy. The
    work includes the power of a torque, and of a force in body axes.

    Parameters
    ----------
    torque : array_like, shape (3,) or (n, 3), optional
        Torque, N m, in the axes of `frame`.
    force : array_like, shape (3,) or (n, 3), optional
        Force, N, in the axes of `frame`.
    point : array_like, shape (3,) or (n, 3), optional
        Point of the body where the force acts, m, in the body frame.
    frame : {"ground", "body"}, optional
        Axes of torque and force; "body" for a thruster.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        An argument has the wrong shape, or is not finite.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.constant_wrench(force=(0.0, 0.0, 2.0), frame="body")
    <constant_wrench: torque, force, point>
    """
    require_name("frame", frame, ("ground", "body"))
    kind = BodyWrench() if frame == "body" else GroundWrench()
    return kind.force(torque=torque, force=force, point=point)


class Drag(BuiltIn):
    """Drag, linear and quadratic in the velocity of a body point, and linear in ω."""

    name = "drag"
    parameters: ClassVar = {
        "linear": Parameter("N s/m", is_signed=False),
        "quadratic": Parameter("N s²/m²", is_signed=False),
        "angular": Parameter("N m s", is_signed=False),
        "point": BODY_POINT,
    }

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        linear, quadratic, angular, point = placed
        moving = x.velocity_of(point)
        force = scale(-fma(quadratic, norm(moving), linear), moving)
        return cross_add(point, force, scale(-angular, x.omega)), force

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        linear, quadratic, angular, point = placed
        moving = x.velocity_of(point)
        more = quadratic * norm(moving)  # q‖u‖ across u, and 2q‖u‖ along u
        ahead = scale(inverse_norm(moving), moving)
        return (
            Tangent(unit_force_at(point, ahead), damping=more),
            *(Tangent(unit_force_at(point, axis), damping=linear + more) for axis in UNIT),
            *(Tangent(axis + ZERO3, damping=angular) for axis in UNIT),
        )


def drag(
    linear: ArrayLike = 0.0,
    quadratic: ArrayLike = 0.0,
    *,
    angular: ArrayLike = 0.0,
    point: ArrayLike = ORIGIN,
) -> Force:
    """Apply the drag of a medium at rest: −(linear + quadratic·‖u‖)·u at a point of velocity u.

    Parameters
    ----------
    linear : float or array_like, shape (n,), optional
        Coefficient of linear drag, N s/m.
    quadratic : float or array_like, shape (n,), optional
        Coefficient of quadratic drag, N s²/m².
    angular : float or array_like, shape (n,), optional
        Coefficient of a torque −angular·ω, N m s.
    point : array_like, shape (3,) or (n, 3), optional
        Point of the body where the drag acts, m, in the body frame.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        A coefficient is negative, or an argument has the wrong shape.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.drag(linear=0.1, quadratic=[0.0, 0.02])
    <drag: linear, quadratic, angular, point>
    """
    return Drag().force(linear=linear, quadratic=quadratic, angular=angular, point=point)

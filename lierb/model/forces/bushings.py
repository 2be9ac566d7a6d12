"""Bushings: springs and dampers in all six directions between a body and the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.kernels.groups import so3
from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Wrench
from lierb.kernels.numbers.arithmetic import absolute
from lierb.kernels.numbers.vec import (
    UNIT,
    Vec,
    add,
    cross_add,
    dot,
    mat_mat,
    mat_t_mat,
    mat_t_vec,
    mat_vec,
    neg,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.model.forces.built_in import (
    BODY_POINT,
    GROUND_POINT,
    ORIGIN,
    SIZE,
    BuiltIn,
    Parameter,
    as_six_by_six,
    is_six_by_six,
    require_semidefinite,
    unit_force_at,
)
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import Array, as_floats, check_rotations

__all__ = ["bushing"]

PARALLEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_FRAMES = {
    "body_point": BODY_POINT,
    "ground_point": GROUND_POINT,
    "axes": Parameter("dimensionless", (3, 3)),
    "rotation": Parameter("dimensionless", (3, 3)),
}
STIFFNESS, DAMPING = "N m/rad and N/m", "N m s/rad and N s/m"


class Bushing(BuiltIn):
    """Bushing with a stiffness and a damping for each axis."""

    name = "bushing"
    parameters: ClassVar = {
        **_FRAMES,
        "stiffness": Parameter(STIFFNESS, (SIZE,)),
        "damping": Parameter(DAMPING, (SIZE,)),
    }  # fmt: skip
    is_conservative: ClassVar = True
    working: ClassVar = ("damping",)

    def require_fit(self, parameters: Mapping[str, Array]) -> None:
        for name in ("stiffness", "damping"):
            require_semidefinite(name, parameters[name], len(self.shapes[name]) == 2)
        for name in ("axes", "rotation"):
            check_rotations(name, parameters[name])

    def placed(self, values: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """Points, the bushing's axes in ground and body, stiffness and damping."""
        axes, rotation = values["axes"], values["rotation"]
        return (
            frames.body_point(values["body_point"]),
            frames.ground_point(values["ground_point"]),
            mat_t_mat(frames.ground[0], axes),
            mat_t_mat(frames.axes, mat_t_mat(rotation, axes)),
            values["stiffness"],
            values["damping"],
        )

    @staticmethod
    def product(matrix: Vec, q: Vec) -> Vec:
        """Return K q, of stiffnesses by axis."""
        return tuple(k * x for k, x in zip(matrix, q, strict=True))

    @staticmethod
    def bounds(matrix: Vec) -> Vec:
        """Return a diagonal D such that qᵀK q ≤ qᵀD q."""
        return matrix

    def _deflection(self, placed: Any, x: Motion) -> Vec:
        """Rotation vector and displacement, in the bushing's axes."""
        point, anchor, ground, body, *_ = placed
        turned = mat_mat(mat_t_mat(ground, x.q), body)
        return so3.log(turned) + mat_t_vec(ground, sub(x.place_of(point), anchor))

    def _rate(self, placed: Any, x: Motion, deflection: Vec) -> Vec:
        point, _, ground, body, *_ = placed
        turning = so3.dexpinv(neg(deflection[:3]), mat_t_vec(body, x.omega))
        return turning + mat_t_vec(ground, mat_vec(x.q, x.velocity_of(point)))

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        point, _, ground, body, stiffness, damping = placed
        q = self._deflection(placed, x)
        rate = self._rate(placed, x, q)
        pull = neg(add(self.product(stiffness, q), self.product(damping, rate)))
        force = mat_t_vec(x.q, mat_vec(ground, pull[3:]))
        torque = mat_vec(body, so3.dexpinv(q[:3], pull[:3]))  # (dexp⁻¹_{−φ})ᵀ
        return cross_add(point, force, torque), force

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        point, _, ground, body, stiffness, damping = placed
        turn = self._deflection(placed, x)[:3]
        turning = [mat_vec(body, so3.dexpinv(turn, axis)) + ORIGIN for axis in UNIT]
        moving = [unit_force_at(point, mat_t_vec(x.q, mat_vec(ground, axis))) for axis in UNIT]
        gains = zip(self.bounds(stiffness), self.bounds(damping), strict=True)
        return tuple(
            Tangent(direction, k, c)
            for direction, (k, c) in zip((*turning, *moving), gains, strict=True)
        )

    def energy(self, placed: Any, x: Motion) -> Any:
        q = self._deflection(placed, x)
        return 0.5 * dot(q, self.product(placed[4], q))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        rate = self._rate(placed, x, self._deflection(placed, x))
        return -dot(rate, self.product(placed[5], rate))


class CoupledBushing(Bushing):
    """Bushing with a matrix of stiffness and one of damping."""

    parameters: ClassVar = {
        **_FRAMES, "stiffness": Parameter(STIFFNESS, (SIZE, SIZE)),
        "damping": Parameter(DAMPING, (SIZE, SIZE)),
    }  # fmt: skip

    @staticmethod
    def product(matrix: Vec, q: Vec) -> Vec:
        """Return K q, of a matrix row by row."""
        return tuple(dot(matrix[i : i + SIZE], q) for i in range(0, SIZE * SIZE, SIZE))

    @staticmethod
    def bounds(matrix: Vec) -> Vec:
        """Return a diagonal D such that qᵀK q ≤ qᵀD q: row sums of magnitudes (Gershgorin)."""
        rows = (matrix[i : i + SIZE] for i in range(0, SIZE * SIZE, SIZE))
        return tuple(sum(map(absolute, row), ZERO) for row in rows)


def bushing(
    body_point: ArrayLike = ORIGIN,
    ground_point: ArrayLike = ORIGIN,
    *,
    stiffness: ArrayLike,
    damping: ArrayLike = (0.0,) * SIZE,
    axes: ArrayLike = PARALLEL,
    rotation: ArrayLike = PARALLEL,
) -> Force:
    """Apply springs and dampers about and along three axes, between the body and the ground.

    The deflection is q = (φ, e): φ is the rotation vector of the body relative to `rotation`, and e
    the displacement of `body_point` from `ground_point`, both in `axes`. The generalised force is
    −(K q + C q̇). The springs have the exact potential ½ qᵀK q for any angle up to half a turn,
    where φ jumps. The energy includes ½ qᵀK q, the work the dampers' power −q̇ᵀC q̇.

    Parameters
    ----------
    body_point : array_like, shape (3,) or (n, 3), optional
        Point of the body, m, in the body frame.
    ground_point : array_like, shape (3,) or (n, 3), optional
        Point of the ground, m, in the ground frame.
    stiffness : array_like, shape (6,), (n, 6), (6, 6) or (n, 6, 6)
        Stiffness K about three axes, then along them, N m/rad and N/m, or a symmetric matrix
        without negative eigenvalues.
    damping : array_like, shape (6,), (n, 6), (6, 6) or (n, 6, 6), optional
        Damping C about three axes, then along them, N m s/rad and N s/m, or such a matrix.
    axes : array_like, shape (3, 3) or (n, 3, 3), optional
        Rotation matrix whose columns are the bushing's axes in the ground frame, dimensionless.
    rotation : array_like, shape (3, 3) or (n, 3, 3), optional
        Rotation R of the body in the ground frame at which the bushing is slack, dimensionless.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        A stiffness or damping is negative, or a matrix is not symmetric or has a negative
        eigenvalue.
    PoseError
        `axes` or `rotation` is no rotation matrix.

    Examples
    --------
    >>> import lierb
    >>> rubber = lierb.forces.bushing(stiffness=(50, 50, 5, 1e5, 1e5, 4e4), damping=[0.1] * 6)
    >>> sorted(rubber.parameters)
    ['axes', 'body_point', 'damping', 'ground_point', 'rotation', 'stiffness']
    """
    given = {"stiffness": stiffness, "damping": damping}
    gains = {name: as_floats(name, gain) for name, gain in given.items()}
    coupled = any(map(is_six_by_six, gains.values()))
    if coupled:
        gains = {name: as_six_by_six(gain) for name, gain in gains.items()}
    kind = CoupledBushing() if coupled else Bushing()
    return kind.force(
        body_point=body_point, ground_point=ground_point, axes=axes, rotation=rotation, **gains
    )

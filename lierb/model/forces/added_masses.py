"""Added mass: inertia of the fluid that a body moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.kernels.mechanics.added_inertia import Added, AddedInertia, body_frame
from lierb.kernels.mechanics.newton_euler import Frames, Motion
from lierb.kernels.mechanics.spatial import Articulated
from lierb.kernels.numbers.vec import ZERO3, add, cross, sub
from lierb.model.forces.built_in import (
    SIZE,
    BuiltIn,
    Parameter,
    as_six_by_six,
    require_semidefinite,
)
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import Array, as_floats

__all__ = ["added_mass"]


class AddedMass(BuiltIn, AddedInertia):
    """Inertia of a fluid that is at rest far from the body."""

    name = "added_mass"
    parameters: ClassVar = {"inertia": Parameter("kg m², kg m and kg", (SIZE, SIZE))}

    def require_fit(self, parameters: Mapping[str, Array]) -> None:
        require_semidefinite("inertia", parameters["inertia"], is_matrix=True)

    def placed(self, values: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        rows = [values["inertia"][i : i + SIZE] for i in range(0, SIZE * SIZE, SIZE)]
        angular, mixed, linear = (
            tuple(x for each in block for x in each)
            for block in (
                [each[:3] for each in rows[:3]],
                [each[3:] for each in rows[:3]],
                [each[3:] for each in rows[3:]],
            )
        )
        return tuple(Articulated(angular, mixed, linear).from_frame(body_frame(frames)))

    def added(self, placed: Any, x: Motion) -> Added:
        """Kirchhoff's equations, with V̇ = (ω̇, a − ω × v).

        A V̇ + (ω × h + v × p, ω × p) = wrench,  (h, p) = A V
        """
        inertia = Articulated(*placed)
        momentum = inertia.momentum(x.omega + x.v)
        h, p = momentum[:3], momentum[3:]
        carried = add(cross(x.omega, h), cross(x.v, p)) + cross(x.omega, p)
        turned = inertia.momentum(ZERO3 + cross(x.omega, x.v))
        return Added(inertia, sub(turned, carried))


def added_mass(inertia: ArrayLike) -> Force:
    """Add the inertia of an ideal fluid around a body: Kirchhoff's equations.

    The fluid is unbounded and at rest far from the body. The wrench on the body is
    −(A V̇ + (ω × h + v × p, ω × p)) with (h, p) = A V, for the twist V = (ω, v) of the body frame.
    The fluid has no weight: buoyancy and drag are separate forces. The energy and momentum of a
    result are those of the bodies; the work includes that of the fluid.

    It acts on a link of a `lierb.Mechanism`, and is included in the mass matrix.

    Parameters
    ----------
    inertia : array_like, shape (6,), (n, 6), (6, 6) or (n, 6, 6)
        Added-mass matrix A or its diagonal, kg m², kg m and kg. It is about the origin of the body
        frame, in its axes, symmetric, and without negative eigenvalues. Rotation is first, as in a
        twist; naval texts have translation first.

    Returns
    -------
    Force
        Element for `Mechanism(forces=…)`.

    Raises
    ------
    ArgumentError
        A matrix is not symmetric or has a negative eigenvalue.

    References
    ----------
    Lamb, Hydrodynamics (1932), § 124.

    Examples
    --------
    A sphere of radius 0.1 m in water moves half of the mass of the water that it displaces:

    >>> import lierb
    >>> half = 0.5 * 1000.0 * 4 / 3 * 3.14159265 * 0.1**3
    >>> lierb.forces.added_mass((0, 0, 0, half, half, half)).on("hull")
    <added_mass: inertia, on hull>
    """
    return AddedMass().force(inertia=as_six_by_six(as_floats("inertia", inertia)))

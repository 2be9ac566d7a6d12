"""These functions make bodies of homogeneous solids."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief
from lierb.model.bodies.body import Body
from lierb.support.arrays import Array, as_floats, as_positive, assembled, batch_size
from lierb.support.extras import require

_quiet = np.errstate(all="ignore")  # `Body` raises for a mass or an inertia that overflows


@_quiet
def box(
    size: ArrayLike, *, mass: ArrayLike | None = None, density: ArrayLike | None = None
) -> Body:
    """Make a cuboid.

    Parameters
    ----------
    size : array_like, shape (3,) or (n, 3)
        Lengths of the edges along e₁, e₂, e₃, m.
    mass : float or array_like, shape (n,), optional
        Mass, kg.
    density : float or array_like, shape (n,), optional
        Density, kg/m³, in place of `mass`.

    Returns
    -------
    Body
        The body or the batch of bodies.

    Raises
    ------
    ArgumentError
        A length, mass or density is not positive.

    Examples
    --------
    >>> import lierb
    >>> lierb.bodies.box((0.1, 0.2, 0.3), density=1000.0).mass.round(9)
    np.float64(6.0)
    """
    edges = as_positive("size", size, "m", 3)
    a, b, c = edges[..., 0], edges[..., 1], edges[..., 2]
    masses = _mass(mass, density, a * b * c)
    squares = (b * b + c * c, c * c + a * a, a * a + b * b)
    return Body(masses, _diagonal(*(masses / 12.0 * s for s in squares)))


@_quiet
def cylinder(
    radius: ArrayLike,
    length: ArrayLike,
    *,
    mass: ArrayLike | None = None,
    density: ArrayLike | None = None,
) -> Body:
    """Make a circular cylinder about e₃.

    Parameters
    ----------
    radius : float or array_like, shape (n,)
        Radius, m.
    length : float or array_like, shape (n,)
        Length along e₃, m.
    mass : float or array_like, shape (n,), optional
        Mass, kg.
    density : float or array_like, shape (n,), optional
        Density, kg/m³, in place of `mass`.

    Returns
    -------
    Body
        The body or the batch of bodies.

    Raises
    ------
    ArgumentError
        A length, mass or density is not positive.

    Examples
    --------
    >>> import lierb
    >>> lierb.bodies.cylinder(0.1, 0.3, mass=2.0).inertia.diagonal().round(6).tolist()
    [0.02, 0.02, 0.01]
    """
    r, h = as_positive("radius", radius, "m"), as_positive("length", length, "m")
    batch_size(radius=r, length=h)
    masses = _mass(mass, density, np.pi * r * r * h)
    across = masses / 12.0 * (3.0 * r * r + h * h)
    return Body(masses, _diagonal(across, across, 0.5 * masses * r * r))


def rod(
    length: ArrayLike,
    radius: ArrayLike,
    *,
    mass: ArrayLike | None = None,
    density: ArrayLike | None = None,
) -> Body:
    """Make a slender cylinder along e₃. Its radius determines the inertia about its axis.

    Parameters
    ----------
    length : float or array_like, shape (n,)
        Length along e₃, m.
    radius : float or array_like, shape (n,)
        Radius, m.
    mass : float or array_like, shape (n,), optional
        Mass, kg.
    density : float or array_like, shape (n,), optional
        Density, kg/m³, in place of `mass`.

    Returns
    -------
    Body
        The body or the batch of bodies.

    Raises
    ------
    ArgumentError
        A length, mass or density is not positive.

    Examples
    --------
    >>> import lierb
    >>> lierb.bodies.rod(0.6, 0.01, mass=0.5).inertia.diagonal().round(6).tolist()
    [0.015012, 0.015012, 2.5e-05]
    """
    return cylinder(radius, length, mass=mass, density=density)


@_quiet
def sphere(
    radius: ArrayLike, *, mass: ArrayLike | None = None, density: ArrayLike | None = None
) -> Body:
    """Make a ball.

    Parameters
    ----------
    radius : float or array_like, shape (n,)
        Radius, m.
    mass : float or array_like, shape (n,), optional
        Mass, kg.
    density : float or array_like, shape (n,), optional
        Density, kg/m³, in place of `mass`.

    Returns
    -------
    Body
        The body or the batch of bodies.

    Raises
    ------
    ArgumentError
        A length, mass or density is not positive.

    Examples
    --------
    >>> import lierb
    >>> lierb.bodies.sphere([0.1, 0.2], density=1000.0).mass.round(3).tolist()
    [4.189, 33.51]
    """
    r = as_positive("radius", radius, "m")
    masses = _mass(mass, density, 4.0 / 3.0 * np.pi * r**3)
    return Body(masses, _diagonal(*(0.4 * masses * r * r,) * 3))


@_quiet
def from_mesh(mesh: Any, *, mass: float | None = None, density: float | None = None) -> Body:
    """Make the homogeneous solid that a closed surface encloses, in the frame of the mesh.

    The body's `com` is that of the mesh. SO(3)×R³ requires it at the origin: move the mesh first,
    by `mesh.apply_translation(-mesh.center_mass)`. Requires trimesh (the extra `lierb[mesh]`).

    Parameters
    ----------
    mesh : trimesh.Trimesh or path
        The surface, or a file that trimesh loads; lengths in m.
    mass : float, optional
        Mass, kg.
    density : float, optional
        Density, kg/m³, in place of `mass`.

    Returns
    -------
    Body
        The body.

    Raises
    ------
    ArgumentError
        The surface encloses no volume.
    MissingExtraError
        trimesh is not installed.
    """
    require("mesh")
    import trimesh

    if isinstance(mesh, (str, PathLike)):
        mesh = _loaded(mesh, trimesh.load_mesh)
    if not isinstance(mesh, trimesh.Trimesh):
        raise ArgumentError(f"mesh must be a trimesh.Trimesh or a path, got {brief(mesh)}")
    if not mesh.is_volume:
        raise ArgumentError(
            "mesh encloses no volume: it must be watertight, with faces that wind outward "
            "(mesh.fill_holes() and mesh.fix_normals() may mend it)"
        )
    solid = mesh.mass_properties
    total = _mass(mass, density, as_floats("volume", solid.volume))
    if total.ndim:
        raise ArgumentError(f"a mesh is one body; got masses of shape {total.shape}")
    centre = as_floats("center_mass", solid.center_mass)
    about_com = as_floats("inertia", solid.inertia) * (total / float(solid.mass))
    return Body(total, about_com, centre, about="com")


def _loaded(path: Any, load: Callable[[Any], Any]) -> Any:
    try:
        return load(path)
    except Exception as error:  # the reader of each format raises different errors
        raise ArgumentError(
            f"mesh={brief(path)} cannot be loaded: {type(error).__name__}: {brief(str(error))}"
        ) from error


def _diagonal(*moments: Array) -> Array:
    """Inertia matrices, since principal moments of three bodies would be read as one matrix."""
    return assembled(moments)[..., None] * np.eye(3)


def _mass(mass: ArrayLike | None, density: ArrayLike | None, volume: Array) -> Array:
    if (mass is None) == (density is None):
        raise ArgumentError("give mass= or density=, one of the two")
    name, unit = ("mass", "kg") if density is None else ("density", "kg/m³")
    given = as_positive(name, density if mass is None else mass, unit)  # type: ignore[arg-type]
    batch_size(**{name: given}, dimensions=volume)
    return given * volume if mass is None else np.broadcast_arrays(given, volume)[0]

"""The shape of a body is the user's, or the box or cylinder of equal mass and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief
from lierb.model.bodies.body import Body
from lierb.support.arrays import Array, as_floats, as_poses

SIDES = 24  # side faces of the prism that represents a cylinder
THINNEST = 0.02  # least thickness drawn, relative to the longest edge
SYMMETRIC = 1e-6  # two principal moments that differ by less, relative to the largest, are equal
NORMALS = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))  # (axis, sign) of a box's faces


@dataclass(frozen=True)
class Shape:
    """A shape is a surface of flat faces in the body's axes.

    Attributes
    ----------
    vertices : ndarray, shape (k, 3)
        Vertices, m.
    faces : tuple of tuples of int
        Indices of the vertices of each face, anticlockwise seen from outside.
    marked : tuple of int
        Faces of another tint, by which a turn is seen.
    """

    vertices: Array
    faces: tuple[tuple[int, ...], ...]
    marked: tuple[int, ...] = ()

    @property
    def size(self) -> float:
        """Return the longest edge of the box around the shape, m."""
        return float(np.ptp(self.vertices, axis=0).max())

    def placed(self, pose: Any) -> Shape:
        """Move the shape: its own frame is put at a pose in the body's.

        Parameters
        ----------
        pose : array_like, Rotation or RigidTransform, shape (4, 4)
            Pose of the shape's frame in the body frame.

        Returns
        -------
        Shape
            The moved shape.
        """
        matrix = as_poses("pose", pose)
        if matrix.shape != (4, 4):
            raise ArgumentError(f"pose has shape {matrix.shape}; expected (4, 4)")
        return _moved(self, matrix[:3, :3], matrix[:3, 3])


def box(size: ArrayLike) -> Shape:
    """Make a cuboid about the body frame's origin.

    Parameters
    ----------
    size : array_like, shape (3,)
        Lengths of the edges along e₁, e₂, e₃, m.

    Returns
    -------
    Shape
        The shape.

    Examples
    --------
    >>> import lierb
    >>> lierb.animation.box((0.1, 0.2, 0.3)).vertices.max(axis=0).tolist()
    [0.05, 0.1, 0.15]
    """
    edges = _positive("size", size, 3)
    corners = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    faces = []
    for axis, sign in NORMALS:
        face = [n for n in range(8) if corners[n, axis] == sign]
        a, b, c, d = face if sign * (-1) ** axis > 0 else (face[0], face[2], face[1], face[3])
        faces.append((a, c, d, b))
    return Shape(0.5 * edges * corners, tuple(faces), marked=(0,))


def cylinder(radius: float, length: float) -> Shape:
    """Make a circular cylinder about e₃, its middle at the body frame's origin.

    Parameters
    ----------
    radius : float
        Radius, m.
    length : float
        Length, m.

    Returns
    -------
    Shape
        The shape.
    """
    (r,), (h,) = _positive("radius", radius, 1), _positive("length", length, 1)
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    rim = np.column_stack([r * np.cos(angles), r * np.sin(angles), np.zeros(SIDES)])
    half = np.array([0.0, 0.0, 0.5 * h])
    sides = [(i, (i + 1) % SIDES, SIDES + (i + 1) % SIDES, SIDES + i) for i in range(SIDES)]
    lids = [tuple(range(SIDES - 1, -1, -1)), tuple(range(SIDES, 2 * SIDES))]
    return Shape(np.vstack([rim - half, rim + half]), (*sides, *lids), marked=(0, 1))


def mesh(vertices: ArrayLike, faces: Sequence[Sequence[int]]) -> Shape:
    """Make a shape from a closed surface, such as `mesh(m.vertices, m.faces)` of a `trimesh` m.

    Faces are drawn from the farthest to the nearest.

    Parameters
    ----------
    vertices : array_like, shape (k, 3)
        Vertices in the body's axes, m.
    faces : sequence of sequences of int
        Three or more vertex indices for each face, anticlockwise as seen from outside.

    Returns
    -------
    Shape
        The shape.
    """
    points = as_floats("vertices", vertices)
    if points.ndim != 2 or points.shape[-1] != 3 or not np.isfinite(points).all():
        raise ArgumentError(f"vertices has shape {points.shape}; expected finite numbers, (k, 3)")
    known = [tuple(int(i) for i in face) for face in faces]
    for face in known:
        if len(face) < 3 or not all(0 <= i < len(points) for i in face):
            raise ArgumentError(
                f"faces has {brief(face)}; expected three or more of the indices 0 … "
                f"{len(points) - 1}"
            )
    return Shape(points, tuple(known))


# ---- of equal inertia --------------------------------------------------------------------------


def equivalent(body: Body) -> Shape:
    """Make the homogeneous solid of the body's mass and inertia, at its centre of mass.

    It is a cylinder if exactly two principal moments are equal, otherwise a box. If all three are
    equal it is a cube, which makes rotation visible. A body without extent along an axis, such as a
    plate or an ideal rod, is drawn with a thickness of 2 % of its longest edge.

    Parameters
    ----------
    body : Body
        One body, not a batch.

    Returns
    -------
    Shape
        The shape.
    """
    moments, axes = principal(body)
    mass, centre = float(body.mass), np.asarray(body.com)
    axis = _symmetry_axis(moments)
    if axis is None:
        return _moved(box(_drawable(box_edges(mass, moments))), axes, centre)
    radius, length = cylinder_of(mass, moments[axis], moments[(axis + 1) % 3])
    radius, length = _drawable(np.array([2 * radius, length])) * (0.5, 1.0)
    turned = np.roll(axes, 2 - axis, axis=1)  # the axis of symmetry becomes e₃
    return _moved(cylinder(radius, length), turned, centre)


def box_edges(mass: float, moments: Array) -> Array:
    """Return the edges of the homogeneous box of these moments, kg m²: a₁² = 6 (I₂ + I₃ − I₁)/m."""
    squares = 6.0 * (moments.sum() - 2.0 * moments) / mass
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))  # a plate's square may round below 0


def cylinder_of(mass: float, along: float, across: float) -> tuple[float, float]:
    """Return radius and length of the homogeneous cylinder: I₃ = m r²/2, I₁ = m (3 r² + h²)/12."""
    radius = np.sqrt(2.0 * along / mass)
    length = np.sqrt(max(12.0 * across / mass - 3.0 * radius**2, 0.0))
    return float(radius), float(length)


def principal(body: Body) -> tuple[Array, Array]:
    """Return the principal moments about the centre of mass, kg m², and their axes, right-handed.

    For a diagonal inertia these are the body's axes, in their order.
    """
    com = np.asarray(body.com)
    about = body.inertia - body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    if np.abs(about - np.diag(np.diag(about))).max() <= 1e-12 * np.abs(about).max():
        return np.diag(about).copy(), np.eye(3)
    moments, axes = np.linalg.eigh(about)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def _symmetry_axis(moments: Array) -> int | None:
    """Return the axis whose moment differs while the other two are equal; None without one."""
    near = SYMMETRIC * moments.max()
    alike = [abs(moments[(i + 1) % 3] - moments[(i + 2) % 3]) <= near for i in range(3)]
    return alike.index(True) if sum(alike) == 1 else None


def _drawable(edges: Array) -> Array:
    return np.asarray(np.maximum(edges, THINNEST * edges.max()))


def _moved(shape: Shape, rotation: Array, place: Array) -> Shape:
    return Shape(shape.vertices @ rotation.T + place, shape.faces, shape.marked)


def _positive(name: str, given: ArrayLike, count: int) -> Array:
    numbers = np.atleast_1d(as_floats(name, given))
    if numbers.shape != (count,) or not (np.isfinite(numbers) & (numbers > 0.0)).all():
        raise ArgumentError(f"{name}={brief(given)}; expected {count} positive length(s), m")
    return numbers

"""A rigid body has mass, centre of mass and inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import InertiaError, require_name, two_readings
from lierb.errors.synonyms import BODY_ARGUMENTS
from lierb.kernels.mechanics.newton_euler import unit_inertia
from lierb.support.arrays import (
    Array,
    Which,
    as_floats,
    as_numbers,
    assembled,
    batch_size,
    components,
    first_bad,
    items_at,
)
from lierb.support.keywords import explains_keywords
from lierb.support.representations import Lines, Represented, quantity

SYMMETRY_TOLERANCE = 1e-12  # relative to the largest entry
TRIANGLE_TOLERANCE = 1e-12  # relative to the largest principal moment
ROUNDING = 1e-15  # of m c² in an inertia about the origin, relative
POINTS = ("origin", "com")  # points to which an inertia may refer
SIX = (
    "; give the matrix [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]: six numbers are xx, xy, xz, "
    'yy, yz, zz in URDF and xx, yy, zz, xy, xz, yz in MJCF, where they go with about="com"'
)
MOMENTS_OF_EACH = "inertia[:, :, None] * np.eye(3)"


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Body(Represented):
    """A `Body` is one rigid body, or a batch of them.

    Parameters
    ----------
    mass : float or array_like, shape (n,)
        Mass, kg.
    inertia : array_like, shape (3,), (n, 3), (3, 3) or (n, 3, 3)
        Principal moments or inertia matrices, kg m², in the axes of the body frame.
        A shape (3, 3) is one matrix, and is refused if mass or com are those of three bodies.
    com : array_like, shape (3,) or (n, 3), optional
        Centre of mass in the body frame, m. Default: its origin.
    about : {"origin", "com"}, optional
        Point to which `inertia` refers: the origin of the body frame, or the centre of mass, as in
        data sheets, URDF and MJCF. The attribute `inertia` is about the origin in both cases.

    Raises
    ------
    InertiaError
        No rigid body can have this mass or inertia.
    ArgumentError
        An array has a wrong shape.
    UnknownNameError
        `about` is none of the two.

    Examples
    --------
    >>> import lierb
    >>> lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531)).inertia.shape
    (3, 3)
    >>> arm = lierb.Body(2.0, (0.1, 0.1, 0.02), com=(0.0, 0.0, 0.5), about="com")
    >>> arm.inertia.diagonal().tolist()  # Steiner: 0.1 + 2 · 0.5²
    [0.6, 0.6, 0.02]
    """

    mass: Array
    inertia: Array
    com: Array
    _given: tuple[Array, str]  # inertia as it was given, and `about`

    @explains_keywords(BODY_ARGUMENTS, "lierb.Body")
    def __init__(
        self,
        mass: ArrayLike,
        inertia: ArrayLike,
        com: ArrayLike | None = None,
        *,
        about: str = "origin",
    ) -> None:
        require_name("about", about, POINTS)
        masses = as_numbers("mass", mass, ())
        is_six = as_floats("inertia", inertia).shape[-1:] == (6,)
        moments = as_numbers("inertia", inertia, (3,), (3, 3), hint=SIX * is_six)
        centre = as_numbers("com", (0.0, 0.0, 0.0) if com is None else com, (3,))
        if moments.shape == (3, 3) and batch_size(mass=masses, com=(centre, 1)) == 3:
            raise two_readings(
                "inertia", moments.shape, one_matrix_for_all="inertia[None]",
                principal_moments_of_each=MOMENTS_OF_EACH,
            )  # fmt: skip
        if not (moments.ndim >= 2 and moments.shape[-2:] == (3, 3)):
            moments = moments[..., :, None] * np.eye(3)
        batch_size(mass=masses, inertia=(moments, 2), com=(centre, 1))
        for body, label in first_bad("mass", masses <= 0.0):
            raise InertiaError(f"{label} is {masses.flat[body]} kg; expected a positive mass")
        moments = _checked_symmetric(moments)
        given = moments, about
        if about == "com":
            moments = moved_inertia(masses, moments, centre, 1.0)
        _check_physical(masses, moments, centre, about)
        _check_gyration(masses, moments)
        moments.setflags(write=False)
        numbers = {"mass": masses, "inertia": moments, "com": centre, "_given": given}
        for name, value in numbers.items():
            object.__setattr__(self, name, value)

    def of(self, which: Which) -> Body:
        """Return one body of the batch, or part of the batch."""
        given, about = self._given
        inertia = items_at(given, which, 2)
        if inertia.ndim == 2 and not isinstance(which, int):
            inertia = inertia[None]  # without it, a part of three bodies would be ambiguous
        com = items_at(self.com, which, 1)
        return Body(items_at(self.mass, which), inertia, com, about=about)

    def as_given(self) -> tuple[Array, str]:
        """Return the inertia as it was given, (3, 3) or (n, 3, 3), and the point `about`."""
        return self._given

    def _representation(self) -> tuple[str, Lines]:
        count = batch_size(mass=self.mass, inertia=(self.inertia, 2), com=(self.com, 1)) or 1
        rows = [("mass", quantity(self.mass, "kg")), ("inertia", _shown_inertia(self.inertia))]
        if np.any(self.com != 0.0):
            rows.append(("com", quantity(self.com, "m", 1)))
        return f"lierb.Body{f': {count} of them' if count > 1 else ''}", rows


def _shown_inertia(moments: Array) -> str:
    if moments.size > 9 or np.any(moments.reshape(3, 3) != np.diag(np.diag(moments.reshape(3, 3)))):
        return quantity(moments, "kg m²", 2)
    return f"{quantity(np.diag(moments.reshape(3, 3)), item_axes=1)} kg m², principal"


def _checked_symmetric(moments: Array) -> Array:
    flat = moments.reshape(-1, 3, 3)
    size = np.abs(flat).max(axis=(1, 2))
    skew = np.abs(flat - flat.transpose(0, 2, 1)).max(axis=(1, 2))
    for body, label in first_bad("inertia", skew > SYMMETRY_TOLERANCE * size):
        raise InertiaError(
            f"{label} is not symmetric: entries differ by {skew[body]:.3g} kg m²; "
            "give (I + I.T) / 2. A shape (3, 3) is read as one matrix, not as three bodies: "
            f"give {MOMENTS_OF_EACH} for the principal moments of three"
        )
    half = 0.5 * flat  # before summing, since the sum of two large numbers may overflow
    return (half + half.transpose(0, 2, 1)).reshape(moments.shape)


@np.errstate(all="ignore")
def moved_inertia(masses: Array, moments: Array, centre: Array, sign: float) -> Array:
    """Return the inertia about the origin, sign 1, or the centre of mass, −1.

    Raises InertiaError if it overflows.
    """
    shift = unit_inertia(components(centre))
    parts = zip(components(moments, 2), shift, strict=True)
    moved = assembled(tuple(i + sign * (masses * s) for i, s in parts), 3, 3)
    for _, label in first_bad("inertia", ~np.isfinite(moved.reshape(-1, 9)).all(axis=1)):
        raise InertiaError(
            f"{label} has no inertia about the {'origin' if sign > 0.0 else 'centre of mass'}: "
            "mass times the square of com is beyond all numbers; give smaller numbers, or choose "
            "larger units"
        )
    return moved


@np.errstate(over="ignore")
def _check_physical(masses: Array, moments: Array, centre: Array, about: str) -> None:
    """Raise InertiaError unless a body with this inertia about the origin can exist."""
    about_com = moved_inertia(masses, moments, centre, -1.0)
    rounding = ROUNDING * (masses * np.sum(centre * centre, axis=-1))
    if objection := _objection(about_com, rounding):
        hint = ""
        if about == "origin" and np.any(centre != 0.0) and not _objection(moments, 0.0):
            hint = '; for an inertia about the centre of mass, as in data sheets, give about="com"'
        raise InertiaError(objection + hint)


def _objection(about_com: Array, rounding: Array | float) -> str:
    """Message unless the inertia is positive definite with moments A + B ≥ C, or ""."""
    flat = about_com.reshape(-1, 3, 3)
    principal = np.linalg.eigvalsh(flat)
    for body, label in first_bad("inertia", principal[:, 0] <= 0.0):
        message = (
            f"{label} is not positive definite: its principal moments about the centre of mass "
            f"are {_listed(principal[body])} kg m²"
        )
        if not np.any(flat[body]):
            message += "; for a point mass take lierb.bodies.sphere with a small radius"
        return message
    excess = principal[:, 2] - principal[:, 0] - principal[:, 1]
    allowed = TRIANGLE_TOLERANCE * principal[:, 2] + rounding
    for body, label in first_bad("inertia", excess > allowed):
        return (
            f"{label} belongs to no rigid body: the largest of the principal moments "
            f"{_listed(principal[body])} kg m² about the centre of mass exceeds the sum of the two "
            "others"
        )
    return ""


def _listed(numbers: Array) -> str:
    return ", ".join(f"{x:.6g}" for x in numbers)


@np.errstate(over="ignore")
def _check_gyration(masses: Array, moments: Array) -> None:
    """Raise InertiaError if tr Θ/m, the square of the unit of length, overflows."""
    traces = np.trace(moments, axis1=-2, axis2=-1)
    for body, label in first_bad("mass", ~np.isfinite(traces / masses)):
        mass, trace = (x.flat[body] for x in np.broadcast_arrays(masses, traces))
        raise InertiaError(
            f"{label} is {mass} kg beside an inertia of trace {trace} kg m²: the radius of "
            "gyration is beyond all numbers; give those of one body, or choose other units"
        )

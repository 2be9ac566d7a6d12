"""The methods here keep structure: variational ones, generalised α and BLieDF with constraints."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, brief
from lierb.kernels.systems.scheme import (
    AlphaScheme,
    BLieDFScheme,
    RattleScheme,
    Scheme,
    ShakeScheme,
    VerletScheme,
)
from lierb.methods.method import Limits, Method
from lierb.support.arrays import as_number, is_whole

RHO = 0.9  # ρ∞ of the methods of the catalogue

ON_SUBGROUPS = Limits(
    systems="one body on a joint whose motions are a subgroup of SE(3)",
    solver="subgroup",
    cspaces=("SE3", "reduced"),
    takes_constraints=False,
    cuts_steps=True,
)

WITH_CONSTRAINTS = Limits(
    systems="one body on a joint, and mechanisms on absolute c-spaces",
    solver="saddle",
    cspaces=("SE3", "SO3xR3"),
    takes_constraints=True,
    cuts_steps=True,
)
OF_ONE_LENGTH = WITH_CONSTRAINTS._replace(cuts_steps=False)


@dataclass(frozen=True)
class StructurePreserving(Method):
    """A structure-preserving method has one set of coefficients, whatever a run needs.

    Attributes
    ----------
    name : str
        Name of the method.
    order : int
        Order of the method.
    source : str
        Publication.
    """

    name: str
    order: int
    source: str

    updates = ("local",)

    @property
    @abstractmethod
    def coefficients(self) -> Scheme:
        """Return the coefficients for the kernels."""

    def scheme(self, is_adaptive: bool, interpolates: bool) -> Scheme:
        return self.coefficients


@dataclass(frozen=True)
class Verlet(StructurePreserving):
    """Verlet's variational method steps a body on the subgroup of its joint.

    Substeps follow each other: with lengths (1,) times the step the method has order 2, with
    Suzuki's five lengths order 4, or 3 where forces depend on velocities.

    Attributes
    ----------
    shares : tuple of float
        Lengths of the substeps, as fractions of the step.
    """

    shares: tuple[float, ...]

    limits = ON_SUBGROUPS

    @property
    def evaluations(self) -> float:
        return 2 * len(self.shares)

    def amplification(self, z: Any) -> Any:
        return oscillator_growth(z, self.shares)

    @cached_property
    def coefficients(self) -> VerletScheme:
        return VerletScheme(shares=self.shares)


def oscillator_growth(z: Any, shares: tuple[float, ...]) -> Any:
    """Return the growth of the oscillator with modes e^(λt) and e^(λ̄t) in a step of Verlet's.

    It is the spectral radius of the step's matrix.   z : hλ.
    """
    stiffness, damping = np.abs(z) ** 2, -2.0 * np.real(z)
    columns = []
    for q, v in (
        (1.0 + 0.0 * stiffness, 0.0 * stiffness),
        (0.0 * stiffness, 1.0 + 0.0 * stiffness),
    ):
        for share in shares:
            v = v - 0.5 * share * (stiffness * q + damping * v)
            q = q + share * v
            predicted = v - 0.5 * share * (stiffness * q + damping * v)
            v = v - 0.5 * share * (stiffness * q + damping * predicted)
        columns.append((q, v))
    (a, c), (b, d) = columns
    trace, determinant = np.abs(a + d), a * d - b * c
    discriminant = 0.25 * trace**2 - determinant
    apart = 0.5 * trace + np.sqrt(np.maximum(discriminant, 0.0))
    return np.where(discriminant < 0.0, np.sqrt(np.abs(determinant)), apart)


class Rattle(StructurePreserving):
    """RATTLE steps a body on its c-space, with the joint's rows as constraints."""

    limits = WITH_CONSTRAINTS
    evaluations = 2.0
    coefficients = RattleScheme()

    def amplification(self, z: Any) -> Any:
        return oscillator_growth(z, (1.0,))


class Shake(StructurePreserving):
    """SHAKE steps a body on its c-space, with the joint's rows as constraints of the position."""

    limits = OF_ONE_LENGTH
    evaluations = 1.0
    coefficients = ShakeScheme()

    def amplification(self, z: Any) -> Any:
        """Return the growth of the oscillator with modes e^(λt) and e^(λ̄t) in a step.

        The damping acts at the velocity (3 uₙ₋₁ − uₙ₋₂)/2 of the increments u before.
        """
        stiffness, damping = np.abs(z) ** 2, -2.0 * np.real(z)
        none, one = 0.0 * stiffness, 1.0 + 0.0 * stiffness
        # (q, u, u before) after a step; u adds to q
        u = [-stiffness, 1.0 - 1.5 * damping, 0.5 * damping]
        rows = [[one - stiffness, u[1], u[2]], u, [none, one, none]]
        matrices = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
        return np.abs(np.linalg.eigvals(matrices)).max(axis=-1)


class BLieDF(StructurePreserving):
    """A backward differentiation formula of index 3 steps a body on its c-space.

    Its order, 1 or 2, is the number of its steps.
    """

    needs_derivatives = True
    limits = OF_ONE_LENGTH

    def amplification(self, z: Any) -> Any:
        """Return the largest root of the formula for ẏ = λy.   z : hλ, complex array."""
        if self.order == 1:
            return 1.0 / (1.0 - z)
        root = np.sqrt(1.0 + 2.0 * np.asarray(z, complex))  # (3/2 − z) r² − 2 r + 1/2 = 0
        return np.maximum(np.abs(2.0 + root), np.abs(2.0 - root)) / np.abs(3.0 - 2.0 * z)

    @cached_property
    def coefficients(self) -> BLieDFScheme:
        return BLieDFScheme(order=self.order)


@dataclass(frozen=True)
class GeneralisedAlpha(StructurePreserving):
    """A generalised α method steps a body on its c-space; `generalised_alpha` makes one.

    Attributes
    ----------
    name : str
        Name of the method.
    order : int
        Order of the method.
    source : str
        Publication.
    rho : float
        ρ∞, factor by which a step changes infinitely fast oscillations.
    index : int
        3, or 2 for the stabilised form.
    """

    rho: float
    index: int

    needs_derivatives = True
    limits = OF_ONE_LENGTH

    def amplification(self, z: Any) -> Any:
        """Return 1, a bound: the method is unconditionally stable."""
        return np.ones(np.shape(z))

    @cached_property
    def coefficients(self) -> AlphaScheme:
        return AlphaScheme(rho=self.rho, index=self.index)


def generalised_alpha(*, rho: float = RHO, index: int = 3) -> GeneralisedAlpha:
    """Make a generalised α method of index 3, or of stabilised index 2.

    Index 3 satisfies the constraints of the position, at each step; the stabilised index 2 those
    of the velocity as well, by further multipliers. Both take all joints, on SE(3) and SO(3)×R³.

    Parameters
    ----------
    rho : float, optional
        ρ∞ from 0 to 1, the factor by which a step changes infinitely fast oscillations: 1 damps
        nothing, 0 damps them at once.
    index : {3, 2}, optional
        Index of the equations.

    Returns
    -------
    GeneralisedAlpha
        Value of the argument `method` of `lierb.integrate`.

    Raises
    ------
    ArgumentError
        rho is not from 0 to 1, or index is neither 3 nor 2.

    References
    ----------
    Brüls, Cardona and Arnold, Mech. Mach. Theory 48 (2012); Arnold, Brüls and Cardona, Numerische
    Mathematik 129 (2015).

    Examples
    --------
    >>> import lierb
    >>> lierb.methods.generalised_alpha(rho=0.5, index=2).name
    'alpha2(rho=0.5)'
    """
    damping = float(as_number("rho", rho))
    if not 0.0 <= damping <= 1.0:
        raise ArgumentError(f"rho={brief(rho)}; expected a number from 0 to 1")
    if not (is_whole(index) and index in (2, 3)):
        raise ArgumentError(f"index={brief(index)}; expected 3, or 2 for the stabilised form")
    own = "" if damping == RHO else f"(rho={damping:g})"
    return GeneralisedAlpha(f"alpha{index}{own}", 2, _ALPHA, damping, int(index))


_ALPHA = (
    "Brüls, Cardona and Arnold, Mech. Mach. Theory 48 (2012); "
    "Arnold, Brüls and Cardona, Numerische Mathematik 129 (2015)"
)
_P = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
_BLIEDF = "Wieloch and Arnold, J. Comput. Appl. Math. 387 (2021)"
_RATTLIE = "Hante and Arnold, J. Comput. Appl. Math. 387 (2021)"
_RYCKAERT = "Ryckaert, Ciccotti and Berendsen, J. Comput. Phys. 23 (1977)"
_MARSDEN = "Marsden, Pekarsky and Shkoller, Nonlinearity 12 (1999)"
_SUZUKI = "Suzuki, Phys. Lett. A 146 (1990)"

METHODS = (
    Verlet("Verlet", 2, _MARSDEN, (1.0,)),
    Verlet("Verlet4", 4, f"{_MARSDEN}; {_SUZUKI}", (_P, _P, 1.0 - 4.0 * _P, _P, _P)),
    Rattle("RATTLie", 2, _RATTLIE),
    Shake("SHAKELie", 2, f"{_RYCKAERT}; {_RATTLIE}"),
    generalised_alpha(index=3),
    generalised_alpha(index=2),
    BLieDF("BLieDF1", 1, _BLIEDF),
    BLieDF("BLieDF2", 2, _BLIEDF),
)

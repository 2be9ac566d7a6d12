"""Options that select the equations: configuration space, solver, stabilisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError, brief, require_name
from lierb.kernels.mechanics.newton_euler import CSPACES
from lierb.kernels.systems.plan import Stabilisation
from lierb.model.bodies.body import Body
from lierb.model.joints.joint import Joint
from lierb.model.joints.joint_type import JOINTS
from lierb.support.arrays import as_number

CSpace = str | Mapping[str, str]
CSPACE_NAMES = (*CSPACES, "reduced")
TREE_SOLVERS = ("looped", "unrolled")  # of a mechanism


class Formulation(NamedTuple):
    """Validated options that select the equations.

    cspaces : configuration space of each link.   solver : "saddle" or "subgroup" for a single body,
    "auto" for a mechanism.   stabilisation : None for a single body.
    """

    cspaces: tuple[str, ...]
    solver: str
    stabilisation: Stabilisation | None


def described_cspace(given: CSpace) -> str:
    """Return the text for a c-space in metadata."""
    return given if isinstance(given, str) else ", ".join(f"{k}: {v}" for k, v in given.items())


def solver_of(
    joint: Joint, constraints: Sequence[str], cspace: str, check: str, solver: str
) -> str:
    """Return "saddle" or "subgroup", the solver for the accelerations of a single body.

    constraints : names of the elements that have rows.
    """
    is_proper = joint.subgroup is not None and bool(joint.rows)
    has_subgroup = cspace == "reduced" or (cspace == "SE3" and check == "raise")
    if has_subgroup and is_proper and not constraints and solver == "auto":
        return "subgroup"
    if cspace != "reduced" and solver != "subgroup":
        return "saddle"
    label = 'cspace="reduced"' if cspace == "reduced" else 'solver="subgroup"'
    if solver == "saddle":
        raise ArgumentError(f"{label} has no saddle point to solve; leave solver out")
    if constraints:
        other = 'cspace="SE3"' if cspace == "reduced" else 'solver="saddle"'
        raise ArgumentError(f"{label} has no constraints, but {constraints[0]} is one; use {other}")
    if not is_proper:
        proper = ", ".join(n for n, j in JOINTS.items() if j.subgroup and j.rows)
        raise ArgumentError(
            f"{label} needs a joint whose motions are a proper subgroup of SE(3) ({proper}), not a "
            f"{joint.name} joint"
        )
    if not has_subgroup:
        raise ArgumentError(
            f'{label} needs cspace="SE3" or "reduced" and check="raise", got cspace="{cspace}" and '
            f'check="{check}"; leave solver out'
        )
    return "subgroup"


def formulation_of_body(
    body: Body,
    joint: Joint,
    constraints: Sequence[str],
    cspace: Any,
    check: str,
    solver: str,
    stabilise: Any,
) -> Formulation:
    """Validate the options that select the equations of a single body. Raises ArgumentError.

    constraints : names of the elements that have rows.
    """
    if stabilise is not None:
        raise ArgumentError(
            f"stabilise={brief(stabilise)} is for a lierb.Mechanism; a Problem with one link is "
            "lierb.Mechanism([lierb.Link(name, body, joint)])"
        )
    if solver in TREE_SOLVERS:
        raise ArgumentError(f'solver="{solver}" is for a lierb.Mechanism; leave solver out')
    if not isinstance(cspace, str):
        raise ArgumentError(f"cspace={brief(cspace)}; expected one name for one body")
    require_name("cspace", cspace, CSPACE_NAMES)
    if cspace == "SO3xR3" and np.any(body.com != 0.0):
        raise ArgumentError(
            'cspace="SO3xR3" needs the body frame at the centre of mass (com = 0): elsewhere its '
            'equations do not decouple; move the frame, or use cspace="SE3"'
        )
    return Formulation((cspace,), solver_of(joint, constraints, cspace, check, solver), None)


# ---- stabilisation -----------------------------------------------------------------------------


def baumgarte(alpha: float, beta: float) -> Stabilisation:
    """Baumgarte's stabilisation, for `lierb.integrate(…, stabilise=…)`.

    The constraints obey ḧ + 2α ḣ + β² h = 0 instead of ḧ = 0, so that errors decay like e^(−αt) if
    β = α.

    Parameters
    ----------
    alpha : float
        Rate α, 1/s. Steps of RK4 are unstable for α = β above 2.8/dt.
    beta : float
        Rate β, 1/s.

    Returns
    -------
    Stabilisation
        Value of the argument `stabilise`.

    References
    ----------
    J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972) 1–16.

    Examples
    --------
    >>> import lierb
    >>> lierb.baumgarte(10.0, 10.0)
    Stabilisation(kind='baumgarte', alpha=10.0, beta=10.0)
    """
    rates = {}
    for name, given in (("alpha", alpha), ("beta", beta)):
        rates[name] = float(as_number(name, given))
        if rates[name] < 0.0:
            raise ArgumentError(f"{name}={brief(given)}; expected zero or a positive number, 1/s")
    return Stabilisation("baumgarte", **rates)


def stabilisation_of(given: Any) -> Stabilisation:
    """Validate the argument `stabilise`. Raises ArgumentError."""
    if given is None:
        return Stabilisation()
    if isinstance(given, Stabilisation):
        return given
    if isinstance(given, str) and given == "project":
        return Stabilisation("project")
    raise ArgumentError(
        f'stabilise={brief(given)}; expected None, "project" or lierb.baumgarte(alpha, beta)'
    )


def described_stabilisation(given: Stabilisation) -> str | None:
    """Return the text for a stabilisation in metadata."""
    rates = f"({given.alpha!r}, {given.beta!r})" if given.kind == "baumgarte" else ""
    return None if given.kind == "none" else f"{given.kind}{rates}"

"""Checks raise unless a method can integrate a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lierb.errors import ArgumentError, brief
from lierb.kernels.mechanics.elements import AddedStates, UserStates
from lierb.methods import Method
from lierb.methods.method import Limits
from lierb.model.base import Model
from lierb.model.formulation import Formulation
from lierb.model.problem import Problem
from lierb.runs.timing import Timing


def check_method(timing: Timing, model: Model, update: str) -> None:
    """Raise ArgumentError for a method that cannot integrate the model with these options."""
    method = timing.method
    if update not in method.updates:
        known = " or ".join(f'"{each}"' for each in method.updates)
        raise ArgumentError(f'method {method.name} needs update={known}, not update="{update}"')
    if method.needs_derivatives:
        _require_derivatives(method, model)
    if method.limits is not None:
        _check_limits(method, method.limits, model, timing)


def formulation_for(
    method: Method, model: Model, cspace: Any, solver: str, **options: Any
) -> Formulation:
    """Return the formulation; some methods determine its solver. Raises ArgumentError."""
    limits = method.limits
    if limits is None:
        return model.formulation(cspace=cspace, solver=solver, **options)
    own = limits.solver if isinstance(model, Problem) else "unrolled"
    if solver not in ("auto", own):
        raise ArgumentError(
            f'method {method.name} needs solver="{own}", not solver="{solver}"; leave solver out'
        )
    for name in cspace.values() if isinstance(cspace, Mapping) else (cspace,):
        if name not in limits.cspaces:
            known = " or ".join(f'"{each}"' for each in limits.cspaces)
            raise ArgumentError(
                f"method {method.name} needs cspace={known}, not cspace={brief(name)}"
            )
    if not isinstance(model, Problem) and options["stabilise"] is not None:
        raise ArgumentError(
            f"method {method.name} solves for the rows, which need no stabilise=; leave it out"
        )
    try:
        return model.formulation(cspace=cspace, solver=own, **options)
    except ArgumentError as error:
        raise ArgumentError(f"method {method.name} is for {limits.systems}: {error}") from None


def _require_derivatives(method: Method, model: Model) -> None:
    for element in model.kinds:
        for function in element.functions:
            moves = not element.is_passive or isinstance(element, UserStates)
            if moves and not function.is_traced:
                raise ArgumentError(
                    f"method {method.name} needs derivatives of {function.name}, which is called "
                    "body by body; write it so that it is compiled, or take an explicit method"
                )


def _check_limits(method: Method, limits: Limits, model: Model, timing: Timing) -> None:
    name = f"method {method.name}"
    if not (isinstance(model, Problem) or limits.takes_constraints):
        raise ArgumentError(
            f"{name} is for {limits.systems}, a lierb.Problem; for a mechanism take RATTLie, an "
            "explicit method or a Rosenbrock method"
        )
    if (
        isinstance(model, Problem)
        and limits.solver == "subgroup"
        and not (model.joint.subgroup and model.joint.rows)
    ):
        raise ArgumentError(
            f"{name} needs a joint whose motions are a proper subgroup of SE(3), not a "
            f"{model.joint.name} joint; RATTLie takes every joint"
        )
    for element in model.elements:
        if isinstance(element.kind, AddedStates):
            raise ArgumentError(
                f"{name} integrates the motion alone, not the states of {element.name}; take an "
                "explicit method or a Rosenbrock method"
            )
        if element.kind.adds_inertia:
            raise ArgumentError(
                f"{name} has a constant mass matrix, to which {element.name} would add; take an "
                "explicit method or a Rosenbrock method"
            )
    for row in (row for _, rows in model.rows_by_name for row in rows):
        if row.depends_on_time or not row.is_holonomic:
            what = "prescribes a motion" if row.depends_on_time else "is one of velocities"
            raise ArgumentError(
                f"{name} is for constraints of the pose, but {row} {what}; take an explicit method "
                "or a Rosenbrock method"
            )
        if not (row.is_of_joint or limits.takes_constraints):
            raise ArgumentError(
                f"{name} has no constraints beside the joint's, but {row} is one; take RATTLie"
            )
    if timing.is_of_lanes and not limits.cuts_steps:
        raise ArgumentError(
            f"{name} carries numbers from step to step, so that all its steps have one "
            "length: it takes save_every=, but no events, controllers, save_at=, "
            "discontinuities= and max_steps="
        )

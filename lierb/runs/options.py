"""Options of a run, validated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, items_of, require_name
from lierb.kernels.mechanics.passive_elements import AddedStates, UserStates
from lierb.kernels.systems.formulations import FORMULATIONS
from lierb.kernels.systems.plan import UPDATES, Stabilisation
from lierb.methods import Method
from lierb.methods.method import Limits
from lierb.model.base import Model
from lierb.model.formulation import (
    CSPACE_NAMES,
    TREE_SOLVERS,
    CSpace,
    Formulation,
    described_cspace,
    described_stabilisation,
)
from lierb.model.problem import Problem
from lierb.runs.time_options import check_periods, checked_seed, timing_of
from lierb.runs.timing import Timing

RECORDS = ("state", "energy", "multipliers", "reaction")
CHOICES = {
    "cspace": CSPACE_NAMES,
    "update": UPDATES,
    "check": ("raise", "warn", "off"),
    "solver": ("auto", *FORMULATIONS, *TREE_SOLVERS),
}


@dataclass(frozen=True)
class Options:
    """Options of `lierb.integrate` for one model: equations, time grid and recorded columns.

    cspace : as written in metadata.   trajectories : validated once the batch size is known.
    """

    formulation: Formulation
    cspace: str
    update: str
    timing: Timing
    record: tuple[str, ...]
    check: str
    seed: int
    trajectories: ArrayLike | None
    statistics: bool

    @classmethod
    def of(
        cls,
        model: Model,
        *,
        cspace: CSpace | None = None,
        update: str = "local",
        record: Iterable[str] = (),
        check: str = "raise",
        solver: str = "auto",
        stabilise: str | Stabilisation | None = None,
        seed: int = 0,
        trajectories: ArrayLike | None = None,
        statistics: bool = True,
        **time: Any,
    ) -> Options:
        """Validate keywords of `lierb.integrate`. Raises its errors.

        statistics : False for a run that needs no statistics of observables.
        time : keywords of `lierb.runs.time_options.timing_of`.
        """
        check_names(update=update, check=check, solver=solver)
        saves = any(time.get(name) is not None for name in ("save_every", "save_at"))
        recorded = _checked_record(record, saves)
        timing = timing_of(has_own_time=model.has_own_time, **time)
        _check_method(timing, model, update)
        check_periods(model.controllers, timing)
        space = model.default_cspace if cspace is None else cspace
        formulation = _formulation_for(
            timing.method, model, space, solver, update=update, check=check, stabilise=stabilise
        )
        return cls(
            formulation, described_cspace(space), update, timing, recorded, check,
            checked_seed(seed), trajectories, statistics,
        )  # fmt: skip

    @property
    def on_violation(self) -> str:
        """Treatment of a start that violates the joint; "raise" on the reduced c-space."""
        return "raise" if self.cspace == "reduced" else self.check

    def plan_fields(self, model: Model) -> dict[str, Any]:
        """Return the fields of the plan that do not depend on the joints."""
        return {
            "update": self.update,
            **self.timing.plan_fields(
                bool(model.events), model.has_jumps, self.statistics and bool(model.observables)
            ),
            "multipliers": "multipliers" in self.record,
            "reaction": "reaction" in self.record,
            "elements": model.kinds,
        }

    def metadata(self, model: Model) -> dict[str, Any]:
        """Return the options for the metadata; all values are hashable."""
        timing = self.timing
        options = {
            "dt": timing.dt or None, "t_end": timing.t_end, "t0": timing.t0,
            "method": timing.method.name, "cspace": self.cspace, "update": self.update,
            "save_every": timing.save_every or None, "measure_every": timing.measure_every,
            "record": self.record, "check": self.check, "solver": self.formulation.solver,
        }  # fmt: skip
        if model.controllers:
            options["seed"] = self.seed
        if self.formulation.stabilisation is not None:
            options["stabilise"] = described_stabilisation(self.formulation.stabilisation)
        return options


def check_names(**given: str) -> None:
    """Raise UnknownNameError for a value that is not one of its argument's choices."""
    for argument, got in given.items():
        require_name(argument, got, CHOICES[argument])


def _checked_record(record: Iterable[str], saves: bool) -> tuple[str, ...]:
    expected = f"names out of {', '.join(RECORDS)}"
    names = (record,) if isinstance(record, str) else items_of("record", record, expected)
    for name in names:
        require_name("record", name, RECORDS)
    if names and not saves:
        raise ArgumentError(
            f"record={brief(names)} adds columns to the history; give save_every= or save_at= as "
            "well"
        )
    return tuple(name for name in RECORDS if name in names)


# ---- limits of methods -------------------------------------------------------------------------


def _check_method(timing: Timing, model: Model, update: str) -> None:
    """Raise ArgumentError for a method that cannot integrate the model with these options."""
    method = timing.method
    if update not in method.updates:
        known = " or ".join(f'"{each}"' for each in method.updates)
        raise ArgumentError(f'method {method.name} needs update={known}, not update="{update}"')
    if method.needs_derivatives:
        _require_derivatives(method, model)
    if method.limits is not None:
        _check_limits(method, method.limits, model, timing)


def _formulation_for(
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
    if own == "subgroup" and options["check"] != "raise":
        raise ArgumentError(
            f'method {method.name} needs check="raise", a start on the joint, not '
            f"check={brief(options['check'])}"
        )
    return model.formulation(cspace=cspace, solver=own, **options)


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
        if not row.is_holonomic:
            with_position = "take RATTLie and " * (not limits.takes_constraints)
            hint = f"{with_position}give the motor's position, or " if row.depends_on_time else ""
            raise ArgumentError(
                f"{name} is for constraints of the pose, but {row} is one of velocities; "
                f"{hint}take an explicit method or a Rosenbrock method"
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

"""Options of a run, validated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, items_of, require_name
from lierb.kernels.systems.formulations import FORMULATIONS
from lierb.kernels.systems.plan import UPDATES, Stabilisation
from lierb.model.base import Model
from lierb.model.formulation import (
    CSPACE_NAMES,
    TREE_SOLVERS,
    CSpace,
    Formulation,
    described_cspace,
    described_stabilisation,
)
from lierb.runs.method_limits import check_method, formulation_for
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
        **time: Any,
    ) -> Options:
        """Validate keywords of `lierb.integrate`. Raises its errors.

        time : keywords of `lierb.runs.time_options.timing_of`.
        """
        check_names(update=update, check=check, solver=solver)
        saves = any(time.get(name) is not None for name in ("save_every", "save_at"))
        recorded = _checked_record(record, saves)
        timing = timing_of(has_own_time=model.has_own_time, **time)
        check_method(timing, model, update)
        check_periods(model.controllers, timing)
        space = model.default_cspace if cspace is None else cspace
        formulation = formulation_for(
            timing.method, model, space, solver, update=update, check=check, stabilise=stabilise
        )
        return cls(
            formulation, described_cspace(space), update, timing, recorded, check,
            checked_seed(seed), trajectories,
        )  # fmt: skip

    @property
    def on_violation(self) -> str:
        """Treatment of a start that violates the joint; "raise" on the reduced c-space."""
        return "raise" if self.cspace == "reduced" else self.check

    def plan_fields(self, model: Model) -> dict[str, Any]:
        """Return the fields of the plan that do not depend on the joints."""
        return {
            "update": self.update,
            **self.timing.plan_fields(bool(model.events), model.has_jumps),
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

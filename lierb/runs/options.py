"""Options of a run, validated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, items_of, require_name
from lierb.kernels.mechanics.newton_euler import CSPACES
from lierb.kernels.systems.formulations import FORMULATIONS
from lierb.kernels.systems.plan import Stabilisation
from lierb.methods import ButcherTableau
from lierb.model.joints.joint_type import JOINTS
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs import start_checks as checks
from lierb.runs.plans import cspaces_of
from lierb.runs.starts import check_mechanism_options
from lierb.runs.timing import Timing, check_periods, has_own_time, timing_of

CSPACE_NAMES = (*CSPACES, "reduced")
UPDATES = ("local", "global")
SOLVER_NAMES = ("auto", *FORMULATIONS)
RECORDS = ("state", "energy", "multipliers", "reaction")
ADAPTIVE = ("rtol", "atol", "dt_min", "dt_max", "max_steps")
CHECKS = ("raise", "warn", "off")


def check_options(
    problem: Problem | Mechanism,
    *,
    t_end: float,
    cspace: str | Mapping[str, str],
    update: str,
    record: Iterable[str],
    save_every: int | None,
    measure_every: int,
    dt: float | None = None,
    method: str | ButcherTableau | None = None,
    check: str = "raise",
    solver: str = "auto",
    t0: float = 0.0,
    stabilise: str | Stabilisation | None = None,
    save_at: ArrayLike | None = None,
    discontinuities: ArrayLike | None = None,
    **adaptive: Any,
) -> tuple[tuple[str, ...], Timing, str]:
    """Raise what `integrate` would; columns to record, when the run is, and what finds V̇.

    adaptive : rtol, atol, dt_min, dt_max, max_steps.
    """
    check_names(update=update, check=check, solver=solver)
    recorded = _checked_record(record, save_every is not None or save_at is not None)
    timing = timing_of(
        dt=dt, t_end=t_end, t0=t0, method=method, update=update, save_every=save_every,
        measure_every=measure_every, save_at=save_at, discontinuities=discontinuities,
        has_own_time=has_own_time(problem),
        **dict.fromkeys(ADAPTIVE) | adaptive,
    )  # fmt: skip
    check_periods(problem.controllers, timing)
    if isinstance(problem, Mechanism):
        cspaces_of(problem, cspace)
        check_mechanism_options(problem, update, solver, stabilise)
        return recorded, timing, "auto"
    if stabilise is not None:
        raise ArgumentError(
            f"stabilise={brief(stabilise)} is for a lierb.Mechanism; a Problem with one link is "
            "lierb.Mechanism([lierb.Link(name, body, joint)])"
        )
    if not isinstance(cspace, str):
        raise ArgumentError(f"cspace={brief(cspace)}; expected one name for one body")
    check_names(cspace=cspace)
    if cspace == "SO3xR3":
        checks.require_central_com(problem)
    return recorded, timing, _solver(problem, cspace, check, solver)


CHOICES = {"cspace": CSPACE_NAMES, "update": UPDATES, "check": CHECKS, "solver": SOLVER_NAMES}


def check_names(**given: str) -> None:
    """Raise UnknownNameError for a value that its argument does not have."""
    for argument, got in given.items():
        require_name(argument, got, CHOICES[argument])


def _solver(problem: Problem, cspace: str, check: str, solver: str) -> str:
    """What finds accelerations, "saddle" or "subgroup"."""
    joint = problem.joint
    added = [element.name for element in problem.elements if element.kind.rows]
    is_proper = joint.subgroup is not None and bool(joint.rows)
    has_subgroup = cspace == "reduced" or (cspace == "SE3" and check == "raise")
    if has_subgroup and is_proper and not added and solver == "auto":
        return "subgroup"
    if cspace != "reduced" and solver != "subgroup":
        return "saddle"
    asked = 'cspace="reduced"' if cspace == "reduced" else 'solver="subgroup"'
    if solver == "saddle":
        raise ArgumentError(f"{asked} has no saddle point to solve; leave solver out")
    if added:
        other = 'cspace="SE3"' if cspace == "reduced" else 'solver="saddle"'
        raise ArgumentError(f"{asked} has no constraints, but {added[0]} is one; use {other}")
    if not is_proper:
        kept = ", ".join(n for n, j in JOINTS.items() if j.subgroup and j.rows)
        raise ArgumentError(
            f"{asked} needs a joint whose motions are a proper subgroup of SE(3) ({kept}), not a "
            f"{joint.name} joint"
        )
    if not has_subgroup:
        raise ArgumentError(
            f'{asked} needs cspace="SE3" or "reduced" and check="raise", got cspace="{cspace}" and '
            f'check="{check}"; leave solver out'
        )
    return "subgroup"


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

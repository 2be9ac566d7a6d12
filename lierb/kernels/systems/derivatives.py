"""Derivatives along directions of the inputs, carried by dual numbers through a run.

A plan names the fields of the inputs that have derivatives (`AnyPlan.moving`). Their numbers become
`Dual` with parts along a few directions. These parts are further inputs, the seeds; everything
computed from them is then differentiated. Formulas that only examine a state (measures, step-size
control, events) get the values, whose bits are those of a run without derivatives. Without moving
fields no formula here emits any code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from itertools import islice
from typing import Any

from lierb.kernels.numbers.arithmetic import alike, flatten
from lierb.kernels.numbers.dual import Dual, parts_of, value_of, values
from lierb.kernels.numbers.vec import Vec, axial, mat_t_mat, mat_t_vec
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.layout import END, Columns, Field
from lierb.kernels.systems.observables import observables_of
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of, signals_width
from lierb.kernels.systems.state import Slopes, State, Units


def on_values(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a formula that takes a plan, to be evaluated without derivatives."""

    @wraps(formula)
    def evaluated(plan: AnyPlan, *operands: Any, **options: Any) -> Any:
        if plan.moving:
            operands = tuple(map(values, operands))
        return formula(plan, *operands, **options)

    return evaluated


# ---- from and to memory ------------------------------------------------------------------------


def seeded(plan: AnyPlan, columns: Columns, numbers: list[Any]) -> list[Any]:
    """Return the inputs, as dual numbers where they have derivatives.

    numbers : inputs, then their seeds.
    """
    if not plan.moving or plan.is_looped:  # a looped plan reads them itself
        return numbers
    own, seeds = numbers[: columns["seeds"].start], iter(numbers[columns["seeds"]])
    for field, part in columns:
        moves = field.name in plan.moving and field.name not in END
        for c in range(part.start, part.stop) if moves else ():
            own[c] = Dual(own[c], tuple(islice(seeds, plan.directions)))
    return own


def seeds_of_end(plan: AnyPlan, columns: Columns, name: str) -> range:
    """Return the columns of the seeds of one of END, the last seeds; empty if it does not move."""
    if name not in plan.moving:
        return range(0)
    part, behind = columns[name], columns["state"].start
    return range(*(behind - plan.directions * (columns.count - c) for c in (part.start, part.stop)))


def completed(plan: AnyPlan, numbers: Any) -> Any:
    """Give every number of nested tuples all parts, so that a state has one type throughout.

    Structural zeros have no derivative, and remain.
    """
    if not plan.moving:
        return numbers
    if isinstance(numbers, tuple):
        return alike(numbers, (completed(plan, x) for x in numbers))
    value = value_of(numbers)
    if is_zero(value) or isinstance(value, float):
        return value
    zero = 0.0 * value
    parts = parts_of(numbers) or (ZERO,) * plan.directions
    return Dual(value, tuple(zero if is_zero(p) or isinstance(p, float) else p for p in parts))


def with_parts(plan: AnyPlan, numbers: Sequence[Any], parts: Sequence[Any]) -> Sequence[Any]:
    """Return numbers as dual numbers.   parts : their derivatives, [number][direction]."""
    if not plan.moving:
        return numbers
    rest = iter(parts)
    return tuple(Dual(x, tuple(islice(rest, plan.directions))) for x in numbers)


def parts_side_by_side(numbers: Any, directions: int) -> list[Any]:
    """Return the derivatives of nested tuples of numbers, [number][direction]."""
    return [p for x in flatten(numbers) for p in parts_of(x) or (ZERO,) * directions]


# ---- results -----------------------------------------------------------------------------------


@lru_cache(64)
def derivative_columns(plan: AnyPlan, links: int, joints: int) -> Columns:
    """Return the columns of the differentiated quantities of a state.

    Of each link C⁻¹∂C and the change of its twist; extra states and outputs of controllers, energy,
    work; observables; λ and reactions if they are recorded; values of events.
    """
    return Columns(
        Field("links", (12 * links,)),
        Field("signals", (signals_width(plan),)),
        Field("energy"),
        Field("work", (int(plan.does_work),)),
        Field("observables", (len(observables_of(plan)),)),
        Field("multipliers", (plan.multipliers * len(plan.rows),)),
        Field("reactions", (plan.reaction * 6 * max(joints, 1),)),
        Field("events", (len(events_of(plan)),)),
    )


def differentiated(
    plan: AnyPlan, system: Any, body: Any, inputs: list[Any], state: State, time: Any
) -> list[Any]:
    """Return the derivatives of `derivative_columns`, [column][direction].

    time : s, a number or a dual number.
    """
    seen = system.motion(body, state, time)
    directions = max(len(parts_of(x)) for x in flatten(state))
    links = [moved_in_body(link, directions) for link in system.in_user_frames(body, inputs, state)]
    energy = system.measured(body, state, seen, time).values["energy"]
    forces: tuple[Any, Any] = ((), ())
    if plan.multipliers or plan.reaction:
        forces = system.forces(body, state, time)
    rest = (
        state.states, body.signals.controls, energy, (state.work,) * plan.does_work,
        system.observed(body, seen, time),
        forces[0] if plan.multipliers else (), tuple(forces[1]) if plan.reaction else (),
        system.events(body, seen, time) if events_of(plan) else (),
    )  # fmt: skip
    return flatten(tuple(links)) + parts_side_by_side(rest, directions)


def moved_in_body(link: Vec, directions: int) -> tuple[Any, ...]:
    """Return C⁻¹∂C, angular then linear, and ∂ω, ∂v, [number][direction].   link : R, r, ω, v."""
    turn = values(link[:9])
    along = []
    for j in range(directions):
        moved = tuple(parts_of(x)[j] if parts_of(x) else ZERO for x in link)
        axis = axial(mat_t_mat(turn, moved[:9]))
        along.append((*axis, *mat_t_vec(turn, moved[9:12]), *moved[12:18]))
    return tuple(x for of_number in zip(*along, strict=True) for x in of_number)


def in_time(system: Any, body: Any, state: State, time: Any, directions: int = 1) -> State:
    """Make an explicit Euler step of length 0 + ε: the first part is the time derivative.

    body, state : without derivatives.   directions : number of parts; others are zero.
    """
    slopes = euler_slopes(system, body, state, time)
    h = Dual(0.0 * time, (1.0, *(0.0,) * (directions - 1)))
    return euler_step(system, body, state, slopes, h)


def euler_slopes(system: Any, body: Any, state: State, time: Any) -> Slopes:
    """Return the slopes of an explicit Euler step."""
    still = system.combine(body, state, (), Slopes(), Units(0.0, 0.0, 0.0))
    rates = system.stage_rates(body, still, system.chart_gravity(body, state.chart), time)
    return Slopes().with_stage(rates)


def euler_step(system: Any, body: Any, state: State, slopes: Slopes, h: Any) -> State:
    moved: State = system.combine(body, state, (1.0,), slopes, Units(0.5 * h, h, h))
    return system.move(body, moved)

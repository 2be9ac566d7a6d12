"""Runs with derivatives: checks, runs of a few directions each, and what they give together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError
from lierb.kernels.loops.ends import end_columns
from lierb.kernels.mechanics.passive_elements import EVERY
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.layout import END, FEW_DIRECTIONS, MANY_DIRECTIONS, Columns
from lierb.kernels.systems.observables import DIFFERENTIATED, KEEPS
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.state import DT_MIN, EVENT, MAX_STEPS, OK
from lierb.kernels.systems.system_of import plan_with_derivatives
from lierb.model.base import Model
from lierb.model.numbers import qualified
from lierb.runs import engine
from lierb.runs.continuation import EndDerivatives
from lierb.runs.inputs import Inputs
from lierb.runs.lane_engine import LaneTime
from lierb.runs.output import Output, derivatives_of, kept_derivatives
from lierb.runs.parameters import Parameter, all_directions, fields_of, slices_of
from lierb.runs.start_directions import Start
from lierb.runs.starts import Ready
from lierb.support.arrays import Array
from lierb.support.memory import require_memory
from lierb.support.progress import Progress

TICK = 8.0 * np.finfo(float).eps  # relative distance of a time from a tick, by rounding
AT_END = 1e-9  # distance of an extreme at the end from the final value, relative to the range
FEW = 0.5  # trajectories for each lane, up to which all directions run in one batch
COPIES = (
    3  # of all derivatives in memory, at most: of the runs, with idle directions, and of tables
)


class Derivatives(NamedTuple):
    """Derivatives of a run along all directions of its parameters.

    columns : differentiated quantities, `lierb.kernels.systems.derivatives.derivative_columns`.
    parts : of the history, [time][trajectory][column][direction], of a few directions each; the
    last one may have more than there are.
    ends : at the end of each trajectory, [column][direction][trajectory].
    times : of the end times, s, [direction][trajectory]; zero but for ends by events.
    statistics : of DIFFERENTIATED of each observable, [observable, statistic][direction]
        [trajectory].
    events : at the events, [column][direction][event].   event_times : of their times, s,
        [direction][event].
    state : of the state of the kernels at the end.
    """

    parameters: tuple[Parameter, ...]
    columns: Columns
    parts: tuple[Array, ...]
    ends: Array
    times: Array
    statistics: Array
    events: Array
    event_times: Array
    state: EndDerivatives

    def rows_of(self, columns: slice, directions: slice) -> Array:
        """Return derivatives of the history, [time][trajectory][column][direction]."""
        abreast = self.parts[0].shape[3]
        first, last = directions.start // abreast, (directions.stop - 1) // abreast
        parts = [part[:, :, columns] for part in self.parts[first : last + 1]]
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=3)
        before = first * abreast
        return np.asarray(joined[..., directions.start - before : directions.stop - before])


def require_differentiable(
    ready: Ready, parameters: tuple[Parameter, ...], argument: str = "with_respect_to"
) -> None:
    """Raise ArgumentError for a run that has no derivatives, MemoryLimitError for one too large.

    argument : of the parameters, for messages.
    """
    reasons = obstacles(ready), _unfit_end(ready, parameters), unfit_names(ready, parameters)
    for obstacle in chain(*reasons):
        raise ArgumentError(f"{argument}: {obstacle}")
    size = derivative_bytes(ready, parameters) * ready.inputs.count
    remedy = "take fewer parameters or trajectories at a time, or save less often"
    require_memory(size, "the derivatives", remedy)


def derivative_bytes(ready: Ready, parameters: tuple[Parameter, ...]) -> int:
    """Return the bytes of a trajectory's derivatives in memory, at the saved times and the end."""
    plan, columns = ready.plan, derivatives_of(ready.plan).count
    at_end = columns + kept_derivatives(plan) + len(end_columns(plan))
    numbers = columns * ready.times.saved_rows + at_end
    return COPIES * 8 * numbers * sum(p.size for p in parameters)


def obstacles(ready: Ready) -> Iterator[str]:
    """Yield the reasons why a run has no derivatives, with what is to be done."""
    plan = ready.plan
    names = {f.name for e in plan.elements for f in e.functions if not f.is_traced}
    if names:
        yield (
            f"{', '.join(sorted(names))} runs body by body, without derivatives; write it so that "
            "it runs for many bodies at once, with lierb.where(condition, a, b) in place of if"
        )


def _unfit_end(ready: Ready, parameters: tuple[Parameter, ...]) -> Iterator[str]:
    """Yield the reasons why a run does not go on with derivatives from the end of another."""
    if ready.before is None:
        return
    before, known = "the run that ended in result.end", ready.before.derivatives
    anew = "begin with a copy of its poses, pose0=pose0.copy(), and apply the chain rule"
    if known is None:
        yield f"{before} had none; give it the same parameters, or {anew}"
        return
    for p in parameters:
        part = known.directions.get(p.name)
        if part is None:
            yield f"{before} has none by {p.name}; name it there too, or {anew}"
        elif part.stop - part.start != p.size:
            was = part.stop - part.start
            yield f"{p.name} has {p.size} numbers, and had {was} in {before}; give it as many"
        elif known.move_end(p.name) and not ready.before.has_forces_of(ready.model):
            yield (
                f"{before} ended at an event, whose time depends on {p.name}, and forces are other "
                f"ones from then on; the effect of this time is not known here; {anew}, with "
                'sensitivity("t") of that run'
            )


def unfit_names(ready: Ready, parameters: tuple[Parameter, ...]) -> Iterator[str]:
    """Yield what is wrong with names of parameters, or of columns beside them."""
    model = ready.model
    columns = (*(each.name for each in model.signals), *(each.name for each in model.observables))
    for name in columns:
        if name in ("pose", "twist"):
            yield f"{name} is a quantity of the run; name your column otherwise"
    for name in fixed_names(ready) & {p.name for p in parameters}:
        yield (
            f'{name} cannot change on cspace="SO3xR3", where the body frame is at the centre '
            'of mass; take cspace="SE3"'
        )


def fixed_names(ready: Ready) -> set[str]:
    """Return the names of parameters that cannot change in a run."""
    links = zip(ready.model.link_names, ready.options.formulation.cspaces, strict=True)
    return {qualified(link, "body.com") for link, space in links if space == "SO3xR3"}


def integrate_with_derivatives(
    ready: Ready,
    parameters: tuple[Parameter, ...],
    with_state: bool,
    threads: int | None,
    progress: Progress,
    check: engine.StartCheck | None,
) -> tuple[Output, Derivatives]:
    """Run all trajectories once for every few directions; arguments of `engine.integrate`.

    The values of all these runs are the same, to the bit, as those of a run without derivatives.
    """
    plan = ready.plan
    start, inputs = start_and_inputs(ready)
    names = [field.name for field, _ in inputs.columns]
    moving = fields_of(parameters, names)
    if plan.is_in_memory:  # its code looks them up by column
        moving = tuple(names[: names.index("state")])
    with np.errstate(all="ignore"):  # of starts that violate their joints, which are refused later
        directions = all_directions(parameters, start)
    if ready.before is not None:
        moving = (*(n for n in moving if plan.is_in_memory or n not in inputs.starts), *END)
        directions = _going_on(ready, parameters, directions)
    abreast = _abreast(len(directions), plan.is_in_memory)
    differentiated = plan_with_derivatives(plan, moving, abreast)
    starts = range(0, len(directions), abreast)
    seeds = (_seeds(inputs.columns, moving, directions[i : i + abreast], abreast) for i in starts)
    call = with_state, threads
    outputs: list[Output] = []
    if len(starts) > 1 and inputs.count <= FEW * plan.lanes:
        whole = inputs.repeated([*seeds])
        outputs += _in_one_batch(
            differentiated, whole, inputs.count, ready.times, call, progress, check
        )
    else:
        for number, own in enumerate(seeds):
            output = engine.integrate(
                differentiated, replace(inputs, seeds=own), ready.times, *call,
                _part_of(progress, number, len(starts)), check,
            )  # fmt: skip
            check = None
            outputs.append(output)
    derivatives = _together(ready, differentiated, parameters, outputs)
    return replace(
        outputs[0], plan=plan, ends=outputs[0].ends[: len(end_columns(plan))]
    ), derivatives


def _in_one_batch(
    plan: AnyPlan,
    inputs: Inputs,
    count: int,
    times: StepClock | LaneTime,
    call: tuple[bool, int | None],
    progress: Progress,
    check: engine.StartCheck | None,
) -> list[Output]:
    """Run `count` trajectories along all directions together; alone they would leave lanes idle.

    inputs : `Inputs.repeated`.   call : with_state and threads of `engine.integrate`.
    """
    copies = inputs.count // count
    repeated = times
    if isinstance(times, LaneTime):
        repeated = replace(times, numbers=np.tile(times.numbers, copies))

    def checked(flags: Array, first: int) -> bool:
        assert check is not None
        return first >= count or check(flags[: count - first], first)

    given = None if check is None else checked
    output = engine.integrate(plan, inputs, repeated, *call, progress, given)
    return [output.part(slice(i * count, i * count + count), times) for i in range(copies)]


def _going_on(
    ready: Ready, parameters: tuple[Parameter, ...], directions: list[dict[str, Array]]
) -> list[dict[str, Array]]:
    """Return directions with the derivatives of the state that a run continues from."""
    assert ready.before is not None
    plan, columns = ready.plan, ready.inputs.columns
    names = (p.name for p in parameters)
    parts = ready.before.parts_of(ready.model, plan, ready.options.timing.dt, names)
    behind = columns["state"].start
    ends = np.zeros((*parts.shape[1:], columns.count - behind))
    ends[:, :, end_columns(plan)] = np.moveaxis(parts, 0, 2)
    own = {name: slice(columns[name].start - behind, columns[name].stop - behind) for name in END}
    return [
        each | {name: end[:, part] for name, part in own.items()}
        for each, end in zip(directions, ends, strict=True)
    ]


def _abreast(directions: int, is_looped: bool) -> int:
    """Return the number of directions of one run: each number has a kernel of its own.

    A run along one direction takes half as long as one along three.
    """
    if directions == 1:
        return 1
    return FEW_DIRECTIONS if directions <= FEW_DIRECTIONS or is_looped else MANY_DIRECTIONS


def _part_of(progress: Progress, number: int, runs: int) -> Progress:
    """Return the progress of one of several equal runs: a function is called with that of all."""
    if not callable(progress):
        return progress
    return lambda done, total: progress(number * total + done, runs * total)


def start_and_inputs(ready: Ready) -> tuple[Start, Inputs]:
    """Return the start whose numbers change, and the inputs.

    The closed pose of a joint is an array in these inputs, which can change.
    """
    model, inputs = ready.model, ready.inputs
    if ready.pose0 is None:
        (at,) = model.joints  # a mechanism has poses
        assert at.joint is not None
        inputs = replace(inputs, starts=inputs.starts | {"pose": at.joint.closed_pose})
    poses, twists = (
        {prefix: inputs.starts[f"{prefix}{field}"] for prefix in model.fields}
        for field in ("pose", "twist")
    )
    return Start(model, poses, twists, inputs.time), inputs


def _seeds(
    columns: Columns, moving: Sequence[str], directions: list[dict[str, Array]], abreast: int
) -> dict[str, Array]:
    """Return the seeds of a run, [direction][trajectory or 1][number] by field."""
    seeds = {}
    for name in moving:
        field = columns.field(name)
        given = [each.get(name) for each in directions]
        count = max((len(x) for x in given if x is not None), default=1)
        seeds[name] = np.zeros((abreast, count, field.width))
        for array, own in zip(seeds[name], given, strict=False):
            if own is not None:
                array[:] = own
    return seeds


# ---- results -----------------------------------------------------------------------------------


def _together(
    ready: Ready, plan: AnyPlan, parameters: tuple[Parameter, ...], outputs: list[Output]
) -> Derivatives:
    """Join the derivatives of all runs.   outputs : with equal values, along other directions."""
    columns, count = derivatives_of(plan), sum(p.size for p in parameters)
    n, saved = ready.inputs.count, ready.times.saved_rows
    shape = columns.count, plan.directions
    whole = columns.count * plan.directions

    def joined(arrays: list[Array]) -> Array:
        together = [each[:whole].reshape(*shape, each.shape[-1]) for each in arrays]
        return np.asarray(np.concatenate(together, axis=1)[:, :count])

    of_rows = [each.derivatives.reshape(saved, n, *shape) for each in outputs]
    ends = joined([each.end_derivatives for each in outputs])
    times, statistics = np.zeros((count, n)), _of_statistics(outputs)[:, :count]
    events, event_times = np.zeros((columns.count, count, 0)), np.zeros((count, 0))
    first = columns["events"].start
    if events_of(plan):
        pairs = np.array([*ending_events(ready, outputs[0])], dtype=int).reshape(-1, 2)
        at, which = pairs.T
        in_time = slice(whole, whole + columns.count)
        slopes = outputs[0].end_derivatives[in_time, at]
        is_fixed = at_ticks(ready.model, at, which, outputs[0].t[at])
        found = _at_events(ends[:, :, at], slopes, first + which, is_fixed)
        ends[:, :, at], times[:, at] = found
        _move_ends(statistics, outputs[0], ends[columns["observables"]], times, at)
        rows: Any = outputs[0].events
        of_events: list[Any] = [each.event_derivatives for each in outputs]
        at, which = rows[:, :2].astype(int).T
        is_fixed = at_ticks(ready.model, at, which, rows[:, 2])
        slopes = of_events[0][in_time]
        events, event_times = _at_events(joined(of_events), slopes, first + which, is_fixed)
    stored = len(end_columns(plan))
    own = [each.ends[stored:].reshape(stored, plan.directions, n) for each in outputs]
    parts = np.concatenate(own, axis=1)[:, :count]
    state = EndDerivatives(slices_of(parameters), parts, times)
    return Derivatives(
        parameters, columns, tuple(of_rows), ends, times, statistics, events, event_times, state
    )


def _of_statistics(outputs: list[Output]) -> Array:
    """Return the derivatives of observables' statistics, [observable, statistic][direction][…].

    Those of a failed trajectory are NaN.
    """
    plan, ok = outputs[0].plan, np.isin(outputs[0].status, (OK, MAX_STEPS, DT_MIN, EVENT))
    count = kept_derivatives(plan) * plan.directions
    rows = [each.end_derivatives[len(each.end_derivatives) - count :] for each in outputs]
    parts = [each.reshape(-1, plan.directions, len(ok)) for each in rows]
    return np.where(ok, np.concatenate(parts, axis=1), np.nan)


def _move_ends(
    statistics: Array, output: Output, ends: Array, times: Array, at: NDArray[np.int64]
) -> None:
    """Add the changes of end times to the derivatives of statistics.

    An extreme at the end is the final value. The mean m over the time T changes by (g − m) ∂T/T for
    a final value g.

    ends, times : derivatives of observables and end times.   at : trajectories ended by events.
    """
    kept = output.observed[: len(KEEPS) * len(ends), at].reshape(len(ends), len(KEEPS), len(at))
    assert isinstance(output.clock, LaneTime)  # as all runs with events
    lasted = output.t[at] - output.clock.span.start
    for own, (least, largest, mean, final), end in zip(
        statistics.reshape(len(ends), len(DIFFERENTIATED), *times.shape),
        kept,
        ends[:, :, at],
        strict=True,
    ):
        for statistic, extreme in enumerate((least, largest)):
            is_end = np.abs(extreme - final) <= AT_END * (largest - least)
            own[statistic][:, at] = np.where(is_end, end, own[statistic][:, at])
        own[2][:, at] += (final - mean) / np.where(lasted > 0.0, lasted, 1.0) * times[:, at]


def _at_events(
    derivatives: Array, in_time: Array, values: NDArray[np.int64], is_fixed: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return derivatives at events, whose times change, and those of the times.

    ∂t = −∂g/ġ by the implicit function theorem for an event g, and ∂x + ẋ ∂t for all quantities.

    derivatives : at fixed times, [column][direction][event].
    in_time : time derivatives, [column][event].   values : column of each event's g.
    is_fixed : True for events whose times do not change.
    """
    at = np.arange(len(values))
    with np.errstate(divide="ignore", invalid="ignore"):  # an event that only touches zero
        times = -derivatives[values, :, at].T / in_time[values, at]
    times[:, is_fixed] = 0.0
    with np.errstate(invalid="ignore"):
        return derivatives + in_time[:, None] * times, times


def at_ticks(
    model: Model, trajectories: NDArray[np.int64], events: NDArray[np.int64], times: Array
) -> NDArray[np.bool_]:
    """Return whether events read outputs of controllers, and are at ticks, where these jump."""
    reads = np.array(["controls" in f.form for e in model.events for f in e.kind.functions[:1]])
    is_tick = np.zeros(len(times), dtype=bool)
    for controller in model.controllers:
        every = np.ravel(controller.parameters[EVERY])
        period = every[trajectories] if len(every) > 1 else every
        is_tick |= np.abs(times - np.rint(times / period) * period) <= TICK * np.abs(times)
    return np.asarray(is_tick & reads[events])


def ending_events(ready: Ready, output: Output) -> Iterator[tuple[int, int]]:
    """Yield the trajectories that an event has ended, with the number of the event."""
    rows: Any = output.events
    terminal = np.array([event.terminal for event in ready.model.events])
    ended = output.status == EVENT
    for row in rows[terminal[rows[:, 1].astype(int)]] if len(rows) else ():
        if ended[int(row[0])]:
            yield int(row[0]), int(row[1])

"""Names of functions by which a trajectory failed, for the warning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from lierb.errors import body_label
from lierb.kernels.functions.signals import Signals
from lierb.kernels.mechanics.added_inertia import VariableMass
from lierb.kernels.mechanics.passive_elements import AddedStates
from lierb.kernels.numbers.arithmetic import flatten, plain
from lierb.kernels.systems.extra_states import with_initial_states
from lierb.kernels.systems.state import NON_FINITE
from lierb.kernels.systems.system_of import system_of
from lierb.runs.output import Output
from lierb.runs.starts import Ready


def unfit_function(run: Ready, output: Output) -> str:
    """Name the function by which the first trajectory that is `non_finite` failed.

    This is a force or state that is not finite at its start, or a negative mass at its end. The
    text, for a warning, is empty without such a function, or if the start is not known.
    """
    failed = np.flatnonzero(output.status == NON_FINITE)
    if not len(failed) or run.before is not None or run.plan.code.is_looped:
        return ""
    number = int(failed[0])
    numbers: list[Any] = list(run.inputs.numbers(number))
    with np.errstate(all="ignore"):
        body = system_of(run.plan).body(numbers)
        for name, value in _numbers_at_start(run, body, numbers):
            if not np.isfinite(value):
                start = body_label("the start", number, run.inputs.count)
                return (
                    f"; {name} is {value} at {start}: start where it is finite, or give a function "
                    "that is finite there"
                )
        return _negative_mass(run, body, float(output.t[number]))


def _numbers_at_start(run: Ready, body: Any, numbers: list[Any]) -> Iterator[tuple[str, float]]:
    """Numbers of wrenches and rates of states at a trajectory's start, with their elements' names.

    Functions of controllers' outputs, and those that run body by body, are left out.
    """
    system: Any = system_of(run.plan)
    state = system.start(body, system.placed(body, numbers), numbers)
    state = with_initial_states(system, body, state, np.float64(0.0))
    body = body._replace(signals=Signals(state.states))
    time = np.float64(run.options.timing.t0)
    motion_of = system.motions(body, system.motion(body, state, time), time)
    for i, element in enumerate(run.model.elements):
        kind, own = element.kind, body.elements[i]
        if any("controls" in f.form or not f.is_traced for f in kind.functions):
            continue
        rates = kind.rates(own, motion_of(i)) if isinstance(kind, AddedStates) else ()
        for x in flatten((*kind.wrench(own, motion_of(i)), rates)):
            yield element.name, float(plain(x))


def _negative_mass(run: Ready, body: Any, end: float) -> str:
    """Name a variable mass that is negative at the end of a trajectory, or in a step from there."""
    for element, own in zip(run.model.elements, body.elements, strict=True):
        kind = element.kind
        if not isinstance(kind, VariableMass) or kind.function.takes_signals:
            continue
        for t in (end, end + (run.options.timing.dt or 0.0)):
            mass = float(plain(kind.function(own[1], np.float64(t))[0]))
            if not mass >= 0.0:
                return f"; the mass of {element.name} is {mass:.6g} kg at t = {t:g} s"
    return ""

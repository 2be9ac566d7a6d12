"""Guesses of parameters, which replace the numbers of the model before a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, LierbError, brief
from lierb.runs.parameters import Parameter, labels_of
from lierb.runs.variations import Variation
from lierb.support.arrays import Array, as_floats


def guessed(
    variation: Variation, guesses: Mapping[str, Any], experiments: int = 0, count: int = 1
) -> Variation:
    """Return a variation whose base has guesses of parameters. Raises ArgumentError.

    experiments : number of those that may have guesses of their own; 0 for none.
    count : number of trajectories of each.
    """
    known = {p.name: p for p in variation.parameters}
    changes = {p.name: np.zeros(p.size) for p in variation.parameters}
    for name, guess in guesses.items():
        if guess is None:
            continue
        if known[name].is_start:
            raise ArgumentError(
                f"parameters[{name!r}]={brief(guess)}: the guess of a start is that of the run; "
                f"give {{{name!r}: None}} and twist0= or pose0="
            )
        changes[name] = _guess(known[name], guess, experiments, count) - variation.values[name]
    try:
        return Variation(variation.at(changes), variation.parameters, variation.t0)
    except LierbError as error:
        raise type(error)(f"the guess of parameters: {error}") from None


def _guess(p: Parameter, guess: Any, experiments: int, count: int) -> Array:
    """Return a guess: a number, (k,), or (trajectories, k). Raises ArgumentError."""
    value, own = as_floats(f"parameters[{p.name!r}]", guess), (experiments, p.size)
    if p.size == 1 and experiments > 1 and value.shape == (experiments,):
        value = value[:, None]
    is_own = experiments > 0 and value.shape == own
    fits = is_own or value.shape in ((), (p.size,))
    if not (fits and np.isfinite(value).all()):
        got = "" if fits else f" has shape {value.shape}"
        single = "a finite number"
        several = f"{p.size} finite numbers, {', '.join(labels_of(p))}"
        each = f", or those of each experiment, shape {own}" if experiments else ""
        raise ArgumentError(
            f"parameters[{p.name!r}]={brief(guess)}{got}; expected "
            f"{single if p.size == 1 else several}{each}"
        )
    return np.repeat(value, count, axis=0) if is_own else value

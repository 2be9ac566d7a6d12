"""Inputs of users' functions beside the motion: extra states, held outputs, memory, noise."""

from __future__ import annotations

from typing import Any, NamedTuple


class Signals(NamedTuple):
    """Signals at one time: numbers side by side, in the order of the problem's elements.

    states : all extra states.   controls : the held outputs of all controllers.
    memory : memory of all controllers; of one alone where a controller is called.
    """

    states: tuple[Any, ...] = ()
    controls: tuple[Any, ...] = ()
    memory: tuple[Any, ...] = ()


NO_SIGNALS = Signals()
NAMES = Signals._fields


class Noise(NamedTuple):
    """Three whole numbers that, beside a name, determine a controller's random numbers."""

    seed: Any
    trajectory: Any
    tick: Any

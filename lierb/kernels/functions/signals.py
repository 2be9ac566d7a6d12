"""Users' functions have inputs besides the motion: states, control outputs, memory, noise."""

from __future__ import annotations

from typing import Any, NamedTuple


class Signals(NamedTuple):
    """Hold the signals at one time, as flat sequences in the order of the problem's elements.

    states : all extra states.   controls : outputs of all controllers, constant between ticks.
    memory : memory of all controllers; in a controller's call, its own memory only.
    """

    states: tuple[Any, ...] = ()
    controls: tuple[Any, ...] = ()
    memory: tuple[Any, ...] = ()


NO_SIGNALS = Signals()
NAMES = Signals._fields


class Noise(NamedTuple):
    """Three whole numbers and a name determine a controller's random numbers."""

    seed: Any
    trajectory: Any
    tick: Any

"""What functions of the user's see beside a motion: extra states, held outputs, memory; noise."""

from __future__ import annotations

from typing import Any, NamedTuple


class Signals(NamedTuple):
    """Of one time; numbers side by side, in the order of the problem's elements.

    states : of all extra states.   controls : what all controllers put out last.
    memory : of all controllers; where one of them is called, its own alone.
    """

    states: tuple[Any, ...] = ()
    controls: tuple[Any, ...] = ()
    memory: tuple[Any, ...] = ()


NO_SIGNALS = Signals()
NAMES = Signals._fields


class Noise(NamedTuple):
    """What a controller's random numbers depend on, beside their name: three whole numbers."""

    seed: Any
    trajectory: Any
    tick: Any

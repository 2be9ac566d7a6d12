"""Times of the rows of a study's history: `save_at` in [integrate], a list or a rule.

save_at = [0.0, 0.5, 2.0]                          s, in ascending order
save_at = { every = 0.5, from = 1.0, to = 4.0 }    defaults: from = t0, to = t_end
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from lierb.errors import ArgumentError
from lierb.support.arrays import Array

RULE = ("every", "from", "to")
MOST_TIMES = 10**7  # most rows of one trajectory: 1 GB and more
NEARLY = 1e-9  # tolerance of `to` relative to `every`: 0.3 is not 3 × 0.1
EXPECTED = "times in s, in ascending order, or { every = …, from = …, to = … }"


def _checked(given: Any) -> Any:
    """Validate a list of times or a rule. Raises PydanticCustomError."""
    if isinstance(given, dict):
        for key in given:
            if key not in RULE:
                raise PydanticCustomError(
                    "save_at", f"has the unknown key {key}; known: {', '.join(RULE)}"
                )
        if "every" not in given:
            raise PydanticCustomError("save_at", "needs every, the time between two rows, s")
        numbers = list(given.values())
    else:
        numbers = given if isinstance(given, list) else [None]
    if not numbers or not all(isinstance(x, (int, float)) and math.isfinite(x) for x in numbers):
        raise PydanticCustomError("save_at", f"input should be {EXPECTED}")
    return given


_NUMBER = {"type": "number"}
SaveAt = Annotated[
    Any,
    BeforeValidator(_checked),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "array", "items": _NUMBER, "minItems": 1},
                {
                    "type": "object",
                    "properties": dict.fromkeys(RULE, _NUMBER),
                    "required": ["every"],
                    "additionalProperties": False,
                },
            ]
        }
    ),
]


def saved_times(given: Any, t0: float, t_end: float) -> Array:
    """Compute the times of `save_at`, s. Raises ArgumentError for a rule without any time."""
    if not isinstance(given, dict):
        return np.array(given, dtype=float)
    every = float(given["every"])
    first, last = float(given.get("from", t0)), float(given.get("to", t_end))
    if every <= 0.0:
        raise ArgumentError(f"save_at: every={every!r}; expected a positive time in s")
    if first > last:
        raise ArgumentError(f"save_at: from={first!r} s is later than to={last!r} s")
    steps = (last - first) / every
    if steps >= MOST_TIMES:
        raise ArgumentError(
            f"save_at: every={every!r} s makes {steps:.3g} times from {first!r} to {last!r} s; "
            f"expected at most {MOST_TIMES:.0e}"
        )
    times: Array = first + every * np.arange(math.floor(steps + NEARLY) + 1.0)
    if abs(times[-1] - last) <= NEARLY * every:
        times[-1] = last
    return times

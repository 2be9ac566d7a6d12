"""Arguments, parameters and results of users' functions have types and shapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Shape = tuple[int, ...]
Shapes = tuple[tuple[str, Shape], ...]
ANY: Shape = (-1,)  # a vector of any length

UserFunction = Callable[..., Any]

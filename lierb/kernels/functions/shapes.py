"""Shapes of arguments, parameters and results of users' functions."""

from __future__ import annotations

Shape = tuple[int, ...]
Shapes = tuple[tuple[str, Shape], ...]
ANY: Shape = (-1,)  # a vector of as many components as there are

"""Formulas compute with floats, arrays, structural zeros, lane packs and dual numbers."""

from lierb.kernels.numbers.arithmetic import repeat

__all__ = ["repeat"]

"""Numbers that formulas compute with: floats, arrays, structural zeros, lane packs, duals."""

from lierb.kernels.numbers.arithmetic import repeat

__all__ = ["repeat"]

"""Compilation of formulas to machine code by Numba and llvmlite, and its disk cache."""

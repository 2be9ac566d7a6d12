"""Numba and llvmlite: what turns formulas into machine code, and keeps it."""

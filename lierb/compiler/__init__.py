"""Compile formulas to machine code with Numba and llvmlite, and cache it on the disk."""

"""Tracing of formulas: LLVM values as numbers, and the kernels made of them."""

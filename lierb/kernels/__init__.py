"""Formulas of rigid-body mechanics as plain scalar functions, and the Numba driver that runs them.

Nothing here imports pyarrow or the public face. `docs/architecture.md` tells how a formula becomes
machine code.
"""

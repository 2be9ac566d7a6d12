"""Determine the CPU features that code is compiled for, and hence the number of lanes."""

from __future__ import annotations

import os

import llvmlite.binding as llvm
from numba import config


def _host_features() -> frozenset[str]:
    """Return the CPU features that Numba compiles for, its own override included."""
    if config.CPU_FEATURES is not None:
        return frozenset(f[1:] for f in config.CPU_FEATURES.split(",") if f.startswith("+"))
    if config.CPU_NAME == "generic":
        return frozenset()
    return frozenset(name for name, present in llvm.get_host_cpu_features().items() if present)


def _default_lanes() -> int:
    """Return a vector register's number of doubles: 8 with AVX-512, 4 with AVX, 2 otherwise."""
    override = os.environ.get("LIERB_LANES")
    if override is not None:
        if override not in {"1", "2", "4", "8"}:
            raise ValueError(f"LIERB_LANES must be 1, 2, 4 or 8, got {override!r}")
        return int(override)
    if "avx512f" in CPU_FEATURES:
        return 8
    return 4 if "avx" in CPU_FEATURES else 2


CPU_FEATURES = _host_features()
IS_X86 = llvm.get_process_triple().split("-")[0] in {"x86_64", "i386", "i686", "amd64"}
# Without the instruction, llvm.fma calls libm for each lane.
HAS_FMA = "fma" in CPU_FEATURES or not IS_X86
DEFAULT_LANES = 1 if config.DISABLE_JIT else _default_lanes()

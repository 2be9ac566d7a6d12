"""Description of the installation, and compilation of kernels ahead of time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import llvmlite
import numba
import pyarrow as pa

from lierb.api import integrate
from lierb.compiler import disk_cache
from lierb.compiler.disk_cache import MOST_BYTES, DiskCache, sized
from lierb.compiler.entries import kernels_loaded
from lierb.compiler.internals import cache_of
from lierb.errors import ArgumentError, brief, items_of, require_name
from lierb.kernels.groups.lie_functions import apply
from lierb.kernels.loops.adjoint import differentiate_blocks
from lierb.kernels.loops.blocks import integrate_blocks
from lierb.kernels.loops.lanes import integrate_lanes
from lierb.kernels.mechanics.rows import parameters_of
from lierb.kernels.tracing.cpu import CPU_FEATURES, DEFAULT_LANES, HAS_FMA
from lierb.methods import Method, method_named
from lierb.model.bodies.body import Body
from lierb.model.joints.joint import Joint
from lierb.model.joints.joint_type import JOINTS
from lierb.model.mechanism.links import Link
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.options import check_names
from lierb.runs.provenance import machine
from lierb.runs.threads import threading_layer

LOOPS = (integrate_blocks, integrate_lanes, differentiate_blocks, apply)
VECTOR_FEATURES = ("sse2", "avx", "avx2", "avx512f", "neon", "sve")


def info() -> dict[str, Any]:
    """Describe the installation: versions, CPU, lanes, threads and the disk cache.

    `lierb info` prints it. The call starts Numba's threads, to determine their layer.

    Returns
    -------
    dict
        Plain values by name. "loaded" is the number of kernels in this process's memory. "cache"
        describes the disk cache: its folder, and the kernels of this version in it.

    Examples
    --------
    >>> import lierb
    >>> lierb.info()["lanes"] in (1, 2, 4, 8)
    True
    """
    return {
        **machine(),
        "llvmlite": llvmlite.__version__,
        "pyarrow": pa.__version__,
        "vectors": [name for name in VECTOR_FEATURES if name in CPU_FEATURES],
        "fma": HAS_FMA,
        "lanes": DEFAULT_LANES,
        "threads": numba.get_num_threads(),
        "threading_layer": threading_layer(),
        "loaded": kernels_loaded(),
        "cache": _cache(),
    }


def _cache() -> dict[str, Any]:
    """Describe the disk cache: its folder, the number of this version's kernels, its size."""
    if numba.config.DISABLE_JIT:
        return {"folder": None, "kernels": 0, "bytes": 0, "most_bytes": 0}
    caches: list[DiskCache] = [cache_of(f) for f in LOOPS]
    return {
        "folder": caches[0].cache_path,
        "kernels": sum(1 for each in caches for _ in sized(each.entries())),
        "bytes": sum(disk_cache.compiled().values()),
        "most_bytes": MOST_BYTES,
    }


def clear_cache() -> dict[Path, int]:
    """Delete all compiled code of lierb on the disk, of any version; return the files' bytes.

    Running processes keep their code; later ones compile again. Raises OSError for a file that
    cannot be deleted.
    """
    return disk_cache.clear()


# ---- compilation ahead of time -------------------------------------------------------------------

ANY_BODY = Body(mass=1.0, inertia=(1.0, 1.0, 1.0))
ANY_TREE = Mechanism([Link("link", ANY_BODY, JOINTS["revolute"]())])
TREE = "tree"


@dataclass(frozen=True)
class Kernel:
    """Compiled or loaded kernel, and the seconds that this took."""

    joint: str
    method: str
    cspace: str
    update: str
    seconds: float


def warmup(
    joints: Iterable[str | Joint] = ("spherical",),
    *,
    methods: Iterable[str | Method] = ("RK4",),
    cspaces: Iterable[str] = ("SE3",),
    updates: Iterable[str] = ("local",),
    solver: str = "auto",
    multipliers: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[Kernel]:
    """Compile the kernel of every combination, or load it from the disk cache.

    One kernel runs every body, frame, gravity, step and batch size. A joint whose motions are not a
    subgroup has no "reduced" kernel; that combination is left out. "tree" stands for the kernel of
    all trees of links (`integrate(solver="looped")`), which is "reduced" and "local" only.

    Parameters
    ----------
    joints : iterable of str or Joint, optional
        Names of the catalogue, joints, or "tree".
    methods : iterable of str or Method, optional
        Methods, as in `integrate`.
    cspaces : iterable of str, optional
        Configuration spaces, as in `integrate`.
    updates : iterable of str, optional
        Updates, as in `integrate`.
    solver : {"auto", "saddle", "subgroup"}, optional
        As in `integrate`, where "auto" means "saddle" if check is not "raise".
    multipliers : bool, optional
        Compile the kernels of runs that record multipliers.
    progress : callable, optional
        Function of (kernels done, kernels in all, name of the next one).

    Returns
    -------
    list of Kernel
        Compiled or loaded kernels: joint, method, cspace, update and seconds.

    Raises
    ------
    UnknownNameError
        A joint, method, c-space, update or solver does not exist.

    Examples
    --------
    >>> import lierb
    >>> [kernel.joint for kernel in lierb.warmup(["revolute"], methods=["Euler"])]
    ['revolute']
    """
    if not (progress is None or callable(progress)):
        raise ArgumentError(f"progress={brief(progress)}; expected None or a function")
    report = progress or (lambda done, total, what: None)
    if not isinstance(multipliers, bool):
        raise ArgumentError(f"multipliers={brief(multipliers)}; expected True or False")
    joints = _several("joints", joints, Joint)
    methods = _several("methods", methods, Method)
    cspaces, updates = _several("cspaces", cspaces), _several("updates", updates)
    for cspace, update in product(cspaces, updates):
        check_names(cspace=cspace, update=update, solver=solver)
    of_one = [j if isinstance(j, Joint) else _named(j) for j in joints if not _is_tree(j)]
    schemes = [method_named(method) for method in methods]
    wanted: list[tuple[Joint | None, Method, str, str]] = [
        (joint, method, cspace, update)
        for joint, method, cspace, update in product(of_one, schemes, cspaces, updates)
        if cspace != "reduced" or (joint.subgroup and joint.rows)
    ]
    if any(map(_is_tree, joints)):
        wanted += [(None, method, "reduced", "local") for method in schemes]
    ready: list[Kernel] = []
    for joint, method, cspace, update in wanted:
        name = TREE if joint is None else joint.name
        report(len(ready), len(wanted), f"{name}, {method.name}, {cspace}, {update}")
        began = time.perf_counter()
        integrate(
            ANY_TREE if joint is None else Problem(ANY_BODY, joint), dt=1.0, t_end=1.0,
            method=method, cspace=cspace, update=update, progress=False,
            solver="looped" if joint is None else "auto" if cspace == "reduced" else solver,
            check="raise" if joint is None or joint.subgroup else "off",
            save_every=1 if multipliers else None, record=("multipliers",) if multipliers else (),
        )  # fmt: skip
        seconds = time.perf_counter() - began
        ready.append(Kernel(name, method.name, cspace, update, seconds))
    report(len(ready), len(wanted), "")
    return ready


def _several(argument: str, given: Any, *single: type) -> tuple[Any, ...]:
    """Return one item or several as a tuple."""
    is_one = isinstance(given, (str, *single))
    return (given,) if is_one else items_of(argument, given, "names")


def _is_tree(joint: Any) -> bool:
    return isinstance(joint, str) and joint == TREE


def _named(name: str) -> Joint:
    require_name("joint", name, JOINTS)
    entry = JOINTS[name]
    return entry(**dict.fromkeys(parameters_of(entry.rows), 1.0))

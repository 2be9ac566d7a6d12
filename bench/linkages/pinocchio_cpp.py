"""Pinocchio from C++: ABA and Runge–Kutta 4 (pinocchio_rk4.cpp), one model a trajectory.

From Python a call costs more than its flops. Headers come with `pin`, Eigen's with `cmeel-eigen`.
Loops are Pinocchio's own constraint dynamics (proximal, tolerance 1e-12).
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from peers.cpp import CACHE

from linkages import cases
from linkages.cases import Form, Tree

COUNTS = {2: 256, 3: 192, 5: 96, 8: 64, 20: 24}
FORMS = {
    **{f"chain{n}": Form(f"chain{n}", "Pinocchio, ABA, RK4", c) for n, c in COUNTS.items()},
    "fourbar": Form("fourbar", "Pinocchio, constraint dynamics, RK4", 48, allowed=1e-6),
}
SOURCE = Path(__file__).with_name("pinocchio_rk4.cpp")
FLAGS = ["-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-shared", "-fPIC", "-w"]
FLAGS += ["-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"]  # its own


def available() -> str:
    if not find_spec("pinocchio"):
        return "pinocchio (pin) is not installed"
    if not shutil.which("g++"):
        return "no g++"
    return "" if (_include() / "eigen3").exists() else "Eigen (cmeel-eigen) is not installed"


def config() -> dict[str, object]:
    return {"pin": version("pin"), "eigen": version("cmeel-eigen"), "flags": FLAGS}


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    n, k = tree.q0.shape
    numbers = np.concatenate(
        [
            tree.frames[..., :3, :3].reshape(n, k, 9), tree.frames[..., :3, 3],
            tree.mass[..., None], tree.com, tree.inertia.reshape(n, k, 9),
            tree.q0[..., None], tree.v0[..., None],
        ],
        axis=-1,
    ).copy()  # fmt: skip
    parents = np.array(tree.parents, np.int32)
    loop = None if tree.loop is None else tree.loop.copy()
    library = ctypes.CDLL(str(_library(loops=loop is not None)))
    library.create.restype = library.advance.restype = None
    library.create(
        ctypes.c_int(n), ctypes.c_int(k), _pointer(parents), _pointer(numbers), _pointer(loop)
    )
    out, steps = np.empty((n, k)), round(cases.T_END / cases.DT)

    def integrate() -> np.ndarray:
        library.advance(ctypes.c_int(steps), ctypes.c_double(cases.DT), _pointer(out))
        return cases.positions(tree, out)

    return integrate


def _pointer(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def _include() -> Path:
    import pinocchio

    return next(p for p in Path(pinocchio.__file__).parents if p.name == "cmeel.prefix") / "include"


def _library(loops: bool) -> Path:
    """Compiled once: Pinocchio's templates take a minute, those of its constraints several."""
    include, flags = _include(), [*FLAGS, *(["-DLOOPS"] if loops else [])]
    made_of = (SOURCE.read_text(), flags, config(), str(include))
    library = CACHE / f"pinocchio-{hashlib.sha256(repr(made_of).encode()).hexdigest()[:16]}.so"
    if not library.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        fresh = library.with_suffix(f".{os.getpid()}")
        lib = include.parent / "lib"
        paths = [f"-I{include}", f"-I{include / 'eigen3'}", f"-L{lib}", f"-Wl,-rpath,{lib}"]
        print("compiling Pinocchio's templates, some minutes", file=sys.stderr, flush=True)
        subprocess.run(["g++", *flags, SOURCE, *paths, "-o", fresh], check=True)
        fresh.replace(library)
    return library

"""The practical limit on this CPU: hand-written C++ on SIMD lanes (cpp_kernels/), compiled here.

`general` makes every row of J in every stage, from the pose, and factors J M⁻¹Jᵀ anew.
`general-fixed` knows that in body axes the rows which hold a point, and Ω rows, are constant, and
that so is their part of the solution.

…-revolute and …-universal are what lierb integrates with

    joints.revolute(body_point=-CENTRE, axis=(0, 1, 0)), ω₀ = (0, ω₂, 0) of the sample
    joints.universal(body_point=-CENTRE),                ω₀ = (0, ω₂, ω₃) of the sample

from R = I, so that their rows hold from the start; `heavy_top.error` means nothing for them.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "reduced": Form("reduced", 131072, "C++, reduced, RKMK4"),
    "reduced-quaternion": Form("reduced", 131072, "C++, reduced, RK4 on quaternions"),
    "reduced-dop853": Form(
        "reduced", 524288, "C++, reduced, DOP853 on quaternions", accuracy=1 / 48,
        accuracies=(1 / 24, 1 / 48, 1 / 96, 1 / 192),
    ),
    "general": Form("general", 32768, "C++, SE(3), saddle point"),
    "general-revolute": Form("general", 16384, "C++, SE(3), saddle point, revolute"),
    "general-universal": Form("general", 16384, "C++, SE(3), saddle point, universal"),
    "general-fixed": Form("general", 65536, "C++, SE(3), fixed rows"),
    "general-fixed-revolute": Form("general", 65536, "C++, SE(3), fixed rows, revolute"),
    "general-fixed-universal": Form("general", 32768, "C++, SE(3), fixed rows, universal"),
}  # fmt: skip
FEASIBLE = {"revolute": (0.0, 1.0, 0.0), "universal": (0.0, 1.0, 1.0)}  # parts of ω₀ left, by joint
SOURCES = Path(__file__).with_name("cpp_kernels")
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lierb-bench"
GROUP = 4  # blocks of lanes that go through the stages together: the fastest of 1, 2, …, 16
FLAGS = ["-std=c++17", "-O3", "-march=native", "-shared", "-fPIC", "-pthread", f"-DGROUP={GROUP}"]
EXTRA = {"general": ("-fschedule-insns", "-fsched-pressure")}  # worth 5 %; costs the others 3 %
_lanes: dict[str, int] = {}  # the faster of 4 and 8, of each form that ran


class _Job(ctypes.Structure):
    _fields_ = (
        ("omega0", ctypes.c_void_p),
        ("out", ctypes.c_void_p),
        ("bodies", ctypes.c_long),
        ("steps", ctypes.c_long),
        ("threads", ctypes.c_long),
        ("h", ctypes.c_double),
        ("top", ctypes.c_double * 8),
    )


def available() -> str:
    return "" if shutil.which("g++") else "no g++"


def config() -> dict[str, object]:
    return {"g++": target()["__VERSION__"], "flags": [*FLAGS, EXTRA], "lanes": dict(_lanes)}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    omega0 = omega0 * FEASIBLE.get(form.rpartition("-")[2], 1.0)
    steps = round(top.T_END / accuracy)
    widths = (4, 8) if "__AVX512F__" in target() else (4,)
    taken = {w: _duration(_integrator(form, omega0[:256], steps, 1, w)) for w in widths}
    _lanes[form] = min(taken, key=taken.get)
    return _integrator(form, omega0, steps, threads, _lanes[form])


def _integrator(
    form: str, omega0: np.ndarray, steps: int, threads: int, lanes: int
) -> Callable[[], Final]:
    count = len(omega0)
    columns = np.pad(omega0, ((0, -count % lanes), (0, 0)), mode="edge").T.copy()
    stem = form.partition("-")[0]
    compiled = library(SOURCES / f"{stem}.cpp", lanes, EXTRA.get(stem, ()))
    kernel = getattr(compiled, form.replace("-", "_"))
    kernel.restype = None
    parameters = (ctypes.c_double * 8)(top.MASS, *top.INERTIA, *top.CENTRE, top.GRAVITY[2])

    def integrate() -> Final:
        out = np.empty((6, columns.shape[1]))
        job = _Job(
            columns.ctypes.data, out.ctypes.data, columns.shape[1], steps, threads,
            top.T_END / steps, parameters,
        )  # fmt: skip
        kernel(ctypes.byref(job))
        return Final(out[:3, :count].T, out[3:, :count].T)

    return integrate


def _duration(integrate: Callable[[], Final]) -> float:
    def once() -> float:
        start = time.process_time()
        integrate()
        return time.process_time() - start

    return min(once() for _ in range(5))


@cache
def target() -> dict[str, str]:
    """The compiler's own macros: they tell its version and the CPU."""
    command = ["g++", "-march=native", "-dM", "-E", "-x", "c++", os.devnull]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return dict(line.partition(" ")[2].partition(" ")[::2] for line in lines.splitlines())


@cache
def library(source: Path, lanes: int, extra: tuple[str, ...] = ()) -> ctypes.CDLL:
    """A kernel, compiled for so many lanes and kept; all of them may include those of this file."""
    flags = [*FLAGS, *extra, f"-DWIDTH={lanes}"]
    made_of = [path.read_text() for path in (*sorted(SOURCES.iterdir()), source)]
    key = hashlib.sha256(repr((made_of, flags, target())).encode()).hexdigest()[:16]
    made = CACHE / f"{source.stem}-{key}.so"
    if not made.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        fresh = made.with_suffix(f".{os.getpid()}")
        subprocess.run(["g++", *flags, source, "-o", fresh], check=True)
        fresh.replace(made)  # another process may be doing the same
    return ctypes.CDLL(str(made))

"""What a user waits for: a process's first result, and a call with next to nothing to do."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from bench_integrate import integrated, problem_of

PROGRAM = """
import lierb
body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
top = lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)))
twist0 = top.joint.twist(omega=(6.28, 3.14, 0.63))
assert lierb.integrate(top, twist0=twist0, dt=1e-3, t_end=0.01).summary.num_rows == 1
"""


@pytest.mark.parametrize("cache", ["warm", "cold"])
def test_first_result(cache, benchmark, tmp_path_factory):
    def environment():
        folder = tmp_path_factory.mktemp("numba") if cache == "cold" else warm
        return (), {"env": os.environ | {"NUMBA_CACHE_DIR": str(folder)}}

    def start(env):
        subprocess.run([sys.executable, "-c", PROGRAM], env=env, check=True)

    warm = tmp_path_factory.mktemp("numba")
    start(os.environ | {"NUMBA_CACHE_DIR": str(warm)})
    benchmark.pedantic(start, setup=environment, rounds=3 if cache == "cold" else 7)


@pytest.mark.parametrize("threads", [1, None])
def test_one_body_ten_steps(threads, benchmark):
    run = integrated(problem_of("spherical", "tilted", 1), steps=10, threads=threads)
    run()
    benchmark.pedantic(run, rounds=500, iterations=1)

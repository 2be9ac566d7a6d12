"""Latency: the first result of a process, and calls with little work."""

from __future__ import annotations

import os
import subprocess
import sys
import timeit
from functools import partial

import numpy as np
import pytest
from bench_integrate import integrated, problem_of
from cases import GRAVITY

import lierb

MANY, DT = 1 << 16, 1 / 48

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


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("start", ["one pose", "an end"])
def test_one_step_of_many(start, threads, benchmark):
    """The speed of whole calls for one step each, over that of the steps of a long one."""
    body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
    top = lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)), GRAVITY)
    omega = np.array([6.28, 3.14, 0.63]) + np.random.default_rng(0).normal(size=(MANY, 3))

    def run(steps, threads=1, t0=0.0, **begun):
        lierb.integrate(
            top, **begun, dt=DT, t0=t0, t_end=t0 + steps * DT, method="DOP853",
            measure_every=steps, threads=threads, progress=False,
        )  # fmt: skip

    begun = {"twist0": top.joint.twist(omega=omega)}
    seconds = [
        min(timeit.repeat(partial(run, steps, **begun), number=1, repeat=4)) for steps in (48, 480)
    ]
    if start == "an end":
        begun = lierb.integrate(top, **begun, dt=DT, t_end=DT, method="DOP853").end
    benchmark.pedantic(partial(run, 1, threads, **begun), rounds=25, warmup_rounds=2)
    step = (seconds[1] - seconds[0]) / 432
    benchmark.extra_info["ratio"] = round(step / benchmark.stats.stats.min, 3)
    benchmark.extra_info["unit"] = "of the speed of one thread's steps"

"""Throughput of RK4 at dt = 1e-3, gravity: saddle point in every stage, and subgroup joints.

Each case runs twice: `aligned` (axes aligned, diagonal inertia, parameters shared) and `tilted`
(tilted frames, full inertia, each body with its own joint point).
"""

from __future__ import annotations

import numpy as np
import pytest
from cases import BODY_FRAME, GRAVITY, GROUND_FRAME, box, frame, joint
from reference_numbers import BOX_POINT

import lierb

BODIES, STEPS, DT = 4096, 500, 1e-3


def _problem(name: str, setting: str) -> tuple[lierb.Problem, np.ndarray]:
    rng = np.random.default_rng(1)
    if setting == "aligned":
        at_point = frame((0, 0, 0), BOX_POINT)
        held, body = joint(name, np.eye(4), at_point), box()
    else:
        frames = np.tile(BODY_FRAME, (BODIES, 1, 1))
        frames[:, :3, 3] += 0.02 * rng.standard_normal((BODIES, 3))
        held, body = joint(name, GROUND_FRAME, frames), box(turned=True)
    problem = lierb.Problem(body, held, GRAVITY)
    return problem, problem.project(rng.standard_normal((BODIES, 6)) + 2.0)


def _measure(body_steps, case: tuple[lierb.Problem, np.ndarray], **options) -> None:
    problem, twist0 = case

    def run():
        lierb.integrate(
            problem, twist0=twist0, dt=DT, t_end=STEPS * DT, measure_every=10, threads=1, **options
        )

    body_steps(run, BODIES * STEPS)


@pytest.mark.parametrize("setting", ["aligned", "tilted"])
@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
@pytest.mark.parametrize("name", ["spherical", "universal", "revolute", "free"])
def test_saddle(name, cspace, setting, body_steps):
    case = _problem(name, setting)
    _measure(body_steps, case, cspace=cspace, solver="saddle", check="off")


@pytest.mark.parametrize("setting", ["aligned", "tilted"])
@pytest.mark.parametrize("cspace", ["SE3", "reduced"])
@pytest.mark.parametrize("name", ["spherical", "revolute", "screw", "planar"])
def test_subgroup(name, cspace, setting, body_steps):
    _measure(body_steps, _problem(name, setting), cspace=cspace)


@pytest.mark.parametrize("method", ["RK4", "DOP853"])
@pytest.mark.parametrize("save_every", [None, 10])
def test_spherical_history(method, save_every, body_steps):
    case = _problem("spherical", "tilted")
    _measure(body_steps, case, method=method, save_every=save_every, solver="saddle", check="off")

"""Throughput on one thread, dt = 1e-3, gravity, maxima every 10 steps: every path, 1 to 5 rows.

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
SETTINGS = pytest.mark.parametrize("setting", ["aligned", "tilted"])
METHODS = pytest.mark.parametrize("method", ["RK4", "DOP853"])


def problem_of(name: str, setting: str, bodies: int = BODIES) -> tuple[lierb.Problem, np.ndarray]:
    """A joint of the catalogue, or `point_on_plane`, with a twist that it allows for each body."""
    rng = np.random.default_rng(1)
    if setting == "aligned":
        ground, body = np.eye(4), frame((0, 0, 0), BOX_POINT)
    else:
        ground, body = GROUND_FRAME, np.tile(BODY_FRAME, (bodies, 1, 1))
        body[:, :3, 3] += 0.02 * rng.standard_normal((bodies, 3))
    if name == "point_on_plane":
        held = lierb.joints.from_rows(["d3"], ground_frame=ground, body_frame=body)
    else:
        held = joint(name, ground, body)
    problem = lierb.Problem(box(turned=setting == "tilted"), held, GRAVITY)
    return problem, problem.project(rng.standard_normal((bodies, 6)) + 2.0)


def integrated(case: tuple[lierb.Problem, np.ndarray], steps: int = STEPS, **options):
    """A function that integrates the case."""
    problem, twist0 = case
    options = {"threads": 1, "measure_every": 10, "progress": False} | options
    return lambda: lierb.integrate(problem, twist0=twist0, dt=DT, t_end=steps * DT, **options)


@SETTINGS
@METHODS
@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
@pytest.mark.parametrize("name", ["point_on_plane", "spherical", "universal", "revolute"])
def test_saddle(name, cspace, method, setting, rate):
    options = {"cspace": cspace, "method": method, "solver": "saddle"}
    rate(integrated(problem_of(name, setting), **options), BODIES * STEPS)


@SETTINGS
@METHODS
@pytest.mark.parametrize("cspace", ["SE3", "reduced"])
@pytest.mark.parametrize("name", ["spherical", "revolute"])
def test_subgroup(name, cspace, method, setting, rate):
    options = {"cspace": cspace, "method": method}
    rate(integrated(problem_of(name, setting), **options), BODIES * STEPS)


@pytest.mark.parametrize("name", ["cylindrical", "prismatic", "screw", "planar"])
def test_reduced(name, rate):
    rate(integrated(problem_of(name, "tilted"), cspace="reduced"), BODIES * STEPS)


# ---- what is recorded, threads -----------------------------------------------------------------


@pytest.mark.parametrize("solver", ["auto", "saddle"])
@pytest.mark.parametrize("record", [(), ("state", "energy"), ("state", "energy", "multipliers")])
def test_history_every_10_steps(record, solver, ratio):
    """Speed with a history over speed without."""
    case = problem_of("spherical", "tilted")
    with_history = integrated(case, solver=solver, save_every=10, record=record)
    ratio(with_history, integrated(case, solver=solver), "of the speed without a history")


@pytest.mark.parametrize("solver", ["auto", "saddle"])
def test_two_threads(solver, ratio):
    """Speed with two threads over speed with one; on two free cores."""
    case = problem_of("spherical", "tilted", 4 * BODIES)
    two = integrated(case, solver=solver, threads=2)
    ratio(two, integrated(case, solver=solver), "of the speed of one thread")

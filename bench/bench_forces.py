"""A force and a joint as users write them against the built-in ones, parameters for every body."""

from __future__ import annotations

import numpy as np
import pytest
from bench_integrate import BODIES, STEPS, integrated, problem_of
from cases import BODY_FRAME, GROUND_FRAME, LENGTH, box, joint

import lierb
from lierb.errors import ScalarFunctionWarning

POINT, ANCHOR = (0.05, 0.02, 0.01), (0.1, 0.2, 0.3)
STIFFNESS = np.linspace(20.0, 40.0, BODIES)  # N/m


@lierb.wrench(stiffness=1.0, damping=0.5, length=0.1, point=POINT, anchor=ANCHOR)
def spring(t, R, r, omega, v, params):
    line = R.T @ (r - params.anchor) + params.point
    stretched = np.sqrt(line @ line)
    rate = line @ (v + np.cross(omega, params.point)) / stretched
    pull = params.stiffness * (stretched - params.length) + params.damping * rate
    force = -pull / stretched * line
    return np.cross(params.point, force), force


@lierb.wrench(stiffness=1.0, damping=0.5, length=0.1, point=POINT, anchor=ANCHOR)
def branching_spring(t, R, r, omega, v, params):
    line = R.T @ (r - params.anchor) + params.point
    stretched = np.sqrt(line @ line)
    if stretched == 0.0:
        return np.zeros(3), np.zeros(3)
    rate = line @ (v + np.cross(omega, params.point)) / stretched
    pull = params.stiffness * (stretched - params.length) + params.damping * rate
    force = -pull / stretched * line
    return np.cross(params.point, force), force


BUILT_IN = lierb.forces.spring_damper(POINT, ANCHOR, stiffness=STIFFNESS, damping=0.5, length=0.1)
PATHS = {"reduced": {"cspace": "reduced"}, "gain": {}, "saddle": {"solver": "saddle"}}


def sprung(force: lierb.forces.Force, path: str, steps: int = STEPS):
    """A function that integrates tops on a spring."""
    plain, twist0 = problem_of("spherical", "tilted")
    problem = lierb.Problem(plain.body, plain.joint, plain.gravity, force)
    return integrated((problem, twist0), steps, **PATHS[path])


@pytest.mark.parametrize("path", PATHS)
def test_spring_of_the_user(path, ratio):
    user = spring(stiffness=STIFFNESS)
    ratio(sprung(user, path), sprung(BUILT_IN, path), "of the built-in spring's speed")


def test_spring_of_the_user_body_by_body(ratio):
    with pytest.warns(ScalarFunctionWarning, match="branching_spring"):
        user = branching_spring(stiffness=STIFFNESS)
    runs = (sprung(force, "saddle", STEPS // 25) for force in (user, BUILT_IN))
    ratio(*runs, "of the built-in spring's speed")


@lierb.constraint(length=LENGTH)
def rod(R, r, params):
    s = r + R @ np.array(BODY_FRAME[:3, 3]) - np.array(GROUND_FRAME[:3, 3])
    return (s @ s / params.length - params.length) / 2


def test_rod_of_the_user(ratio):
    lengths = np.linspace(0.9, 1.1, BODIES) * LENGTH
    built_in = lierb.Problem(box(turned=True), joint("point_on_sphere", length=lengths))
    poses = built_in.joint.closed_pose
    twist0 = built_in.project((0.5, 0.3, 0.2, 0.1, 0.0, 0.0), poses)
    user = lierb.Problem(built_in.body, lierb.joints.free(), constraints=rod(length=lengths))
    runs = (integrated((problem, twist0), pose0=poses) for problem in (user, built_in))
    ratio(*runs, "of the built-in joint's speed")

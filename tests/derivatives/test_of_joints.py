"""Derivatives of one body's motion against complex steps of an independent formulation."""

from __future__ import annotations

import numpy as np
import pytest
from cases import GRAVITY, RECORD, box, tiered
from cases import joint as made_joint

import lierb
from derivatives import complex_steps as steps

T_END = 0.25
# Steps whose error, and that of its derivatives, is of the order of rounding.
RUN = {"dt": 1e-4, "t_end": T_END, "save_every": 2500, "record": RECORD}
COM = np.array((0.03, -0.02, 0.05))
FRAMES = ("joint.body_point", "joint.ground_point")
NUMBERS = ("body.mass", "body.com", "body.inertia", "gravity")
STARTS = ("twist0", "pose0")
ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# One of each kind of rows: the others run with -m long. A study's derivatives on a screw, by its
# pitch as well, are compared with differences in test_study_sensitivities.py.
QUICK, SLOW = ("revolute",), ("spherical",)
# Relative to the largest derivative of the quantity: truncation of RK4, and of DOP853 at 1e-13.
TOLERANCE = 1e-10


def body_off_origin() -> lierb.Body:
    own = box(turned=True)
    shift = COM @ COM * np.eye(3) - np.outer(COM, COM)
    return lierb.Body(float(own.mass), own.inertia + own.mass * shift, COM)


def problem_of(
    name: str, is_centred: bool = False, **more
) -> tuple[lierb.Problem, np.ndarray, np.ndarray]:
    """A tilted joint, displaced from where it is closed, with a twist that it allows."""
    body = box(turned=True) if is_centred else body_off_origin()
    problem = lierb.Problem(body, made_joint(name), GRAVITY, **more)
    pose = np.array(problem.joint.closed_pose)
    with np.errstate(all="ignore"):
        pose = problem.close(pose @ lierb.lie.se3.exp((0.3, -0.2, 0.25, 0.02, 0.05, -0.04)))
    speed = 0.1 if "length" in lierb.joints.JOINTS[name].options else 1.0
    lively = np.array((6.0, 3.0, 0.7, 0.4, 0.3, -1.0))
    return problem, pose, problem.project(speed * lively, pose)


def arguments(problem: lierb.Problem) -> dict:
    body, joint = problem.body, problem.joint
    return {
        "mass": float(body.mass), "inertia": np.array(body.inertia), "com": np.array(body.com),
        "gravity": np.array(problem.gravity), "ground_frame": np.array(joint.ground_frame),
        "body_frame": np.array(joint.body_frame), "pitch": float(joint.pitch),
        "length": float(joint.length) or 1.0,
    }  # fmt: skip


def changed(arguments: dict, weights: dict) -> dict:
    """Arguments plus i h times a combination of the parameters' directions."""
    given, step = dict(arguments), 1j * steps.H
    for name, weight in weights.items():
        owner, _, last = name.rpartition(".")
        if owner not in ("body", "joint", ""):
            continue  # of a force
        if last in ("mass", "pitch", "length"):
            given[last] = given[last] + step * weight[0]
        elif last in ("com", "gravity"):
            given[last] = given[last] + step * weight
        elif last == "inertia":
            given[last] = given[last].astype(complex)
            for w, (i, j) in zip(weight, ENTRIES, strict=True):
                given[last][i, j] += step * w
                given[last][j, i] += step * w * (i != j)
        elif last in ("body_point", "ground_point"):
            frame = last.replace("point", "frame")
            given[frame] = given[frame].astype(complex)
            given[frame][:3, 3] += step * weight
    return given


def along(result, of: str, weights: dict) -> np.ndarray:
    """Derivative of a quantity along a combination of directions."""
    return sum(result.sensitivity(of, name) @ weight for name, weight in weights.items())


def random_weights(result, scales: dict, seed: int) -> dict:
    rng = np.random.default_rng(seed)
    return {
        name: scales.get(name, 1.0) * rng.standard_normal(by.shape[-1])
        for name in result.sensitivities.parameters
        for by in [result.sensitivity("energy", name)]
    }


SCALES = {"body.mass": 5.0, "body.inertia": 0.02, "body.com": 0.1, "joint.pitch": 0.1}


def compare(problem, name, pose, twist, result, seed=0, force=None, scales=SCALES):
    """Compare a random combination of all directions with complex steps from the same start."""
    weights = random_weights(result, scales, seed)
    poses, twists = (along(result, of, weights)[:, 0] for of in ("pose", "twist"))
    h = 1j * steps.H
    given = changed(arguments(problem), weights)
    own = (lambda *motion: force(*motion, weights)) if force else None
    start = steps.moved(pose, h * poses[0]), twist + h * twists[0]
    expected = steps.derivatives(steps.end(name, *start, T_END, **given, force=own))
    for found, wanted in zip((poses[-1], twists[-1]), expected, strict=False):
        # A fixed body does not move but for rounding.
        assert np.abs(found - wanted).max() < TOLERANCE * np.abs(wanted).max() + 1e-13
    return weights, expected[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", tiered(lierb.joints.JOINTS, QUICK, SLOW))
def test_derivatives_on_every_joint_are_those_of_complex_steps(name):
    problem, pose, twist = problem_of(name)
    options = lierb.joints.JOINTS[name].options
    own = [f"joint.{option}" for option in options if option in ("pitch", "length")]
    names = (*STARTS, *NUMBERS, *FRAMES, *own)
    result = lierb.integrate(problem, pose0=pose, twist0=twist, **RUN, with_respect_to=names)
    weights, multipliers = compare(problem, name, pose, twist, result)
    if problem.rows and name != "constant_velocity":  # its λ is of another row in the oracle
        found = along(result, "lambda", weights)[-1, 0]
        assert np.abs(found - multipliers).max() <= TOLERANCE * np.abs(multipliers).max()

"""Derivatives do not depend on how a run is made, and leave its values as they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cases import RECORD

import lierb
from derivatives.test_of_joints import (
    FRAMES,
    NUMBERS,
    STARTS,
    TOLERANCE,
    along,
    compare,
    problem_of,
)  # fmt: skip

ALL = (*STARTS, *NUMBERS, *FRAMES)  # as test_of_joints.py, with its record: they share kernels
ADAPTIVE = {"rtol": 1e-12, "t_end": 0.25, "save_at": (0.0, 0.1, 0.25), "record": "state"}
STEPS = {"dt": 5e-3, "t_end": 0.25, "save_every": 10, "record": RECORD}


def adaptive(names=ALL, **more):
    problem, pose, twist = problem_of("spherical")
    start = {"pose0": pose, "twist0": twist}
    return (
        problem,
        start,
        lierb.integrate(problem, **start, **ADAPTIVE, **more, with_respect_to=names),
    )


def fixed(names=ALL, name="spherical", options=STEPS, is_centred=False, **more):
    problem, pose, twist = problem_of(name, is_centred)
    start = {"pose0": pose, "twist0": twist, "with_respect_to": names}
    return lierb.integrate(problem, **(start | options | more))


def numbers_of(table) -> np.ndarray:
    names = [n for n in table.column_names if n not in ("status",)]
    return np.concatenate([np.array(table[n].to_pylist(), float).ravel() for n in names])


def all_derivatives(result, names) -> dict[str, np.ndarray]:
    pairs = ((of, name) for of in ("pose", "twist", "energy") for name in names)
    return {f"{of}/{name}": result.sensitivity(of, name) for of, name in pairs}


# ---- values and bits ---------------------------------------------------------------------------


@pytest.mark.long
def test_adaptive_steps_have_the_derivatives_of_complex_steps():
    problem, start, result = adaptive()
    compare(problem, "spherical", start["pose0"], start["twist0"], result)
    middle = result.sensitivity("pose", "twist0")  # dense output at 0.1 s
    ends = ADAPTIVE | {"t_end": 0.1, "save_at": (0.1,)}
    alone = lierb.integrate(problem, **start, **ends, with_respect_to=ALL)
    alone = alone.sensitivity("pose", "twist0")[0]
    # the continuous extension of DOP853 is of order 7
    assert np.abs(middle[1] - alone).max() < 1e-9 * np.abs(alone).max()


@pytest.mark.parametrize(
    "options",
    [pytest.param(ADAPTIVE, marks=pytest.mark.long), pytest.param(STEPS, marks=pytest.mark.slow)],
    ids=["adaptive", "fixed"],
)
def test_values_of_a_run_with_derivatives_keep_their_bits(options):
    plain = fixed((), options=options)
    result = fixed(ALL, options=options)
    for name in ("summary", "history"):
        before, after = (numbers_of(getattr(run, name)) for run in (plain, result))
        assert np.array_equal(before.view(np.int64), after.view(np.int64))
        assert getattr(plain, name).schema.equals(getattr(result, name).schema)
    assert plain.sensitivities is None
    problem, _, _ = problem_of("spherical")
    more = {"dt": 5e-3, "t_end": 0.5} if options is STEPS else {"rtol": 1e-12, "t_end": 0.5}
    ends = [lierb.integrate(problem, **run.end, **more).summary for run in (plain, result)]
    assert np.array_equal(*(numbers_of(summary) for summary in ends))


@pytest.mark.long
def test_a_direction_does_not_depend_on_the_others():
    whole = all_derivatives(fixed(ALL), ALL)
    for names in (("twist0",), ("body.com", "body.mass"), ALL[::-1]):
        for key, values in all_derivatives(fixed(names), names).items():
            assert np.array_equal(values, whole[key]), key  # −0 equals 0


@pytest.mark.slow
def test_a_trajectory_in_a_batch_has_the_derivatives_that_it_has_alone():
    problem, pose, twist = problem_of("spherical")
    twists = twist + problem.project(np.random.default_rng(2).standard_normal((11, 6)), pose)
    together = lierb.integrate(
        problem, pose0=pose, twist0=twists, **ADAPTIVE, with_respect_to=ALL, threads=1
    )
    for i in (0, 7):
        alone = lierb.integrate(
            problem, pose0=pose, twist0=twists[i], **ADAPTIVE, with_respect_to=ALL
        )
        for key, values in all_derivatives(together, ALL).items():
            assert np.array_equal(values[:, i], all_derivatives(alone, ALL)[key][:, 0])


@pytest.mark.slow
def test_batched_parameters_have_derivatives_of_their_own():
    problem, pose, twist = problem_of("spherical")
    masses = np.array((5.0, 6.0, 7.0))
    inertia = np.broadcast_to(problem.body.inertia, (3, 3, 3))
    bodies = lierb.Body(masses, inertia, problem.body.com)
    several = lierb.Problem(bodies, problem.joint, problem.gravity)
    start = {"pose0": pose, "twist0": twist, "with_respect_to": ALL}
    together = all_derivatives(lierb.integrate(several, **start, **STEPS), ALL)
    alone = all_derivatives(lierb.integrate(several.of_body(1), **start, **STEPS), ALL)
    for key, values in alone.items():
        assert np.array_equal(together[key][:, 1], values[:, 0])


# ---- the same derivatives by every formulation -------------------------------------------------


@cache
def reference(name: str, is_centred: bool) -> dict[str, np.ndarray]:
    return all_derivatives(fixed(SOME, name, FINE, is_centred), SOME)


SOME = tuple(name for name in ALL if name != "body.com")  # which SO(3)×R³ has at the origin


FINE = {"dt": 1e-4, "t_end": 0.1, "save_every": 1000, "record": RECORD}
FORMULATIONS = [
    pytest.param(name, options, marks=pytest.mark.slow if is_slow else pytest.mark.long)
    for name, options, is_slow in (
        ("spherical", {"solver": "saddle"}, True),
        ("spherical", {"update": "ambient"}, True),
        ("universal", {"cspace": "SO3xR3"}, False),
        ("spherical", {"cspace": "SO3xR3"}, False),
        ("spherical", {"update": "global"}, False),
        ("spherical", {"solver": "saddle", "update": "global"}, False),
        ("spherical", {"method": "CF4"}, False),
        ("cylindrical", {"solver": "saddle"}, False),
        ("planar", {"update": "ambient"}, False),
        ("spherical", {"method": "Rodas4"}, False),
        ("spherical", {"method": "Rodas5P", "solver": "saddle"}, False),
        ("spherical", {"method": "Verlet4"}, False),
        ("universal", {"method": "Rodas4", "cspace": "SO3xR3"}, False),
    )
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "options"), FORMULATIONS)
def test_formulations_agree(name, options):
    is_centred = "cspace" in options
    result = fixed(SOME, name, FINE, is_centred, **options)
    for key, values in all_derivatives(result, SOME).items():
        expected = reference(name, is_centred)[key]
        assert np.abs(values - expected).max() < TOLERANCE * (1.0 + np.abs(expected).max()), key


@pytest.mark.slow
@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.4), (0.7, 0.7, 0.7)], ids=["two", "three"])
def test_bodies_with_equal_moments_are_differentiated_by_all_of_the_inertia(moments):
    # Any axes are principal ones there; those of a neighbour are half a turn away.
    inertia = 0.05 * np.diag(moments)
    joint = lierb.joints.spherical(body_point=(0.0, 0.0, -0.2))
    body = lierb.Body(1.5, inertia + np.diag((0.06, 0.06, 0.0)), (0.0, 0.0, 0.0))
    problem = lierb.Problem(body, joint, (0.0, 0.0, -9.81))
    twist = joint.twist(omega=(1.0, 2.0, 9.0))
    result = lierb.integrate(
        problem, twist0=twist, **FINE | {"t_end": 0.25, "save_every": 2500}, with_respect_to=ALL
    )
    compare(problem, "spherical", np.array(joint.closed_pose), twist, result)


# ---- laws --------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_derivative_along_the_flow_is_the_twist():
    # A start that is later by dt ends later by dt: ∂x/∂x₀ ẋ(0) = ẋ(t).
    problem, _, twist = problem_of("spherical")
    result = fixed(("pose0", "twist0"), options=FINE)

    def rate(R, omega):
        """(V, V̇) of a body that turns about its joint's point, from Euler's equations."""
        point = problem.joint.body_frame[:3, 3]
        c = problem.body.com - point
        about = lambda a: float(problem.body.mass) * (a @ a * np.eye(3) - np.outer(a, a))
        K = problem.body.inertia - about(problem.body.com) + about(c)
        torque = float(problem.body.mass) * np.cross(c, R.T @ problem.gravity)
        alpha = np.linalg.solve(K, torque - np.cross(omega, K @ omega))
        return np.concatenate([alpha, np.cross(point, alpha)])

    first, last = (rate(result.rotation[i, 0], result.omega[i, 0]) for i in (0, -1))
    weights = {"pose0": twist, "twist0": first}
    end = np.concatenate([result.omega[-1, 0], result.v[-1, 0]])
    assert np.abs(along(result, "pose", weights)[-1, 0] - end).max() < 1e-11
    assert np.abs(along(result, "twist", weights)[-1, 0] - last).max() < 1e-10


@pytest.mark.slow
def test_energy_is_conserved_along_every_direction():
    result = fixed(ALL, options=FINE)
    for name in ALL:
        energy = result.sensitivity("energy", name)[:, 0]
        assert np.abs(energy[-1] - energy[0]).max() < 1e-11 * (1.0 + np.abs(energy).max())
    assert np.abs(result.sensitivity("energy", "body.mass")).max() > 1.0


@pytest.mark.slow
def test_momentum_of_a_free_body_is_conserved_along_every_direction():
    body = lierb.Body(2.0, (0.3, 0.5, 0.6))
    flight = lierb.Problem(body, lierb.joints.free())
    twist = np.array((1.0, 2.0, 3.0, 0.4, 0.5, 0.6))
    result = lierb.integrate(
        flight, twist0=twist, dt=1e-4, t_end=0.1, save_at=(0.0, 0.1), record="state",
        with_respect_to=("body.inertia", "omega0"),
    )  # fmt: skip
    J, directions = np.diag((0.3, 0.5, 0.6)), np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        directions[k, i, j] = directions[k, j, i] = 1.0

    def momentum(row):
        """∂(R J ω) by ω and by the inertia."""
        R, omega = result.rotation[row, 0], result.omega[row, 0]
        parts = []
        for name, of_body in (("omega0", np.zeros((3, 3, 3))), ("body.inertia", directions)):
            turn, rate = (result.sensitivity(of, name)[row, 0, :3] for of in ("pose", "twist"))
            parts.append(R @ (np.cross(turn.T, J @ omega).T + J @ rate + (of_body @ omega).T))
        return np.concatenate(parts, 1)

    assert np.abs(momentum(-1) - momentum(0)).max() < 1e-12


@pytest.mark.long
def test_central_differences_of_lierb_itself_come_near():
    problem, pose, twist = problem_of("spherical")
    result = fixed(("body.mass",))
    runs = [
        lierb.integrate(
            lierb.Problem(
                lierb.Body(float(problem.body.mass) + h, problem.body.inertia, problem.body.com),
                problem.joint, problem.gravity,
            ),
            pose0=pose, twist0=twist, **STEPS,
        ).omega[-1, 0]
        for h in (1e-4, -1e-4)
    ]  # fmt: skip
    difference = (runs[0] - runs[1]) / 2e-4
    exact = result.sensitivity("twist", "body.mass")[-1, 0, :3, 0]
    assert np.abs(exact - difference).max() < 1e-7 * np.abs(exact).max()

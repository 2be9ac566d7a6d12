"""A mechanism in free flight moves as one at rest does, however fast it goes (Galilei).

Right values are those of the same mechanism at rest.
"""

from __future__ import annotations

import numpy as np
import pytest
from cases import long_but

import lierb
from lierb.kernels.numbers.vec import cross, mat_t_vec
from mechanisms.samples import random_mechanism, start_of
from mechanisms.shared import in_python

SPEED = np.array((2500.0, 5000.0, -5000.0))  # m/s, 7500 in all, as in a low orbit
FAR = np.array((4e6, -5e6, 3e6))  # m


# ---- accelerations, in plain Python ------------------------------------------------------------


@pytest.mark.parametrize("cspace", ["reduced", "SE3", "SO3xR3"])
@pytest.mark.parametrize("shape", ["star", "floating_loop"])
def test_accelerations_do_not_depend_on_speed(shape, cspace):
    rng = np.random.default_rng(5)
    made, sample = random_mechanism(rng, shape, n=1, centred=cspace == "SO3xR3", forces=True)
    system, body, state = in_python(made, cspace, **start_of(sample))
    seen = system.motion(body, state, 0.0)
    boost, turned = np.zeros((2, len(state.v_or_mu)))  # of V, and of V̇, since body axes turn
    for i, node in enumerate(system.plan.tree):
        if node.is_reduced and node.parent >= 0:
            continue
        at, along = slice(6 * i + 3, 6 * i + 6), mat_t_vec(body.nodes[seen.root(i)].hang[0], SPEED)
        boost[at] = along if cspace == "SO3xR3" else mat_t_vec(seen.place(i)[0], along)
        turned[at] = 0.0 if cspace == "SO3xR3" else cross(boost[at], seen.twists[i][:3])
    fast = state._replace(v_or_mu=tuple(boost + np.asarray(state.v_or_mu, float)))
    if cspace == "reduced":
        (turn, place), *others = state.chart
        fast = fast._replace(chart=((turn, tuple(FAR + place)), *others))
    rates = [
        np.asarray(system.accelerate(body, system.motion(body, each, 0.0)).rates, float)
        for each in (state, fast)
    ]
    wanted = rates[0] + turned
    # Relative velocities of absolute nodes are rounded by 1e-12 m/s, times a damping over a mass.
    np.testing.assert_allclose(rates[1], wanted, rtol=0.0, atol=1e-10)
    if cspace == "reduced":
        np.testing.assert_array_equal(rates[1][:3], wanted[:3])
        np.testing.assert_array_equal(rates[1][6:], wanted[6:])


# ---- motions -----------------------------------------------------------------------------------


def satellite() -> lierb.Mechanism:
    """A hub of 200 kg with two sprung panels and a wheel."""
    revolute, upright = lierb.joints.revolute, {"axis": (0.0, 0.0, 1.0)}
    panel = lierb.bodies.box((0.05, 2.0, 1.0), mass=8.0)
    left = revolute((0.0, -1.0, 0.0), parent_point=(0.0, 0.5, 0.0), **upright)
    right = revolute((0.0, 1.0, 0.0), parent_point=(0.0, -0.5, 0.0), **upright)
    wheel = revolute(axis=(1.0, 0.0, 0.0), parent_point=(0.3, 0.1, 0.2))
    hinge = lierb.forces.torsional_spring(stiffness=30.0, damping=0.05)
    return lierb.Mechanism(
        [
            lierb.Link("hub", lierb.bodies.box((1.2, 1.0, 1.0), mass=200.0), lierb.joints.free()),
            lierb.Link("left", panel, left, "hub"),
            lierb.Link("right", panel, right, "hub"),
            lierb.Link("wheel", lierb.Body(4.0, (0.02, 0.02, 0.04)), wheel, "hub"),
        ],
        forces=[hinge.on("left"), hinge.on("right")],
    )


@pytest.mark.long
@pytest.mark.parametrize("cspace", long_but(["reduced", "SO3xR3"], "reduced"))
def test_satellite_in_orbit_takes_the_steps_of_one_at_rest(cspace):
    made, ends, steps = satellite(), [], []
    far = FAR if cspace == "reduced" else 0.0
    for speed, place in ((0.0 * SPEED, 0.0), (SPEED, far)):
        hub = np.eye(4)
        hub[:3, 3] = place
        pose0 = made.pose({"hub": hub, "left": 0.3, "right": -0.2})
        moving = {"hub": (0.02, 0.01, 0.03, *speed), "left": 0.1, "wheel": 5.0}
        run = lierb.integrate(
            made, pose0=pose0, twist0=made.twist(moving, pose0), t_end=20.0, cspace=cspace,
            method="Tsit5", rtol=1e-8, max_steps=5000,
        )  # fmt: skip
        assert run.summary["status"].to_pylist() == ["ok"]
        steps.append(run.summary["steps"][0].as_py())
        ends.append(np.concatenate([run[name].rotation[0] for name in made.names]))
    # Fewer where rtol of a large v is all that v asks for.
    assert steps[1] < 1.05 * steps[0]
    # Either is off by some rtol; on absolute nodes places of 150 km are rounded by 3e-11 m.
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-8)

"""Ambient updates: what they keep, their order, dense output, and what they refuse."""

from __future__ import annotations

from functools import cache

import numpy as np
import oracle
import pytest
from cases import in_python, slow_but, tiered, tilted

import lierb
from lierb.errors import ArgumentError, UnknownNameError
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.methods import TABLEAUS

# ---- the theorem -------------------------------------------------------------------------------

LOWER_PAIRS = (
    "spherical", "revolute", "cylindrical", "prismatic", "planar", "planar_translation",
    "translation", "schoenflies",
)  # fmt: skip
COARSE = 0.05  # s, in which the weightless box turns by 0.4 rad


@pytest.mark.slow
@pytest.mark.parametrize("name", tiered(LOWER_PAIRS, ["cylindrical"], []))
def test_joints_but_screws_are_kept_in_coarse_steps(name):
    """V̇ and λ of the saddle point, on all six coordinates: nothing else holds the joint.

    Steps of 50 ms are off in the motion itself. What is left is rounding: of J V̇ − η, with a
    direction, which adds up in J V and twice in h (docs/theory.md), and of positions of 0.5 km.
    """
    problem, twist0 = tilted(name, (0.0, 0.0, 0.0))
    result = lierb.integrate(
        problem, twist0=twist0, dt=COARSE, t_end=1e4 * COARSE, solver="saddle", update="ambient"
    )
    (summary,) = result.summary.to_pylist()
    assert summary["status"] == "ok"
    far = 1.0 + np.abs(summary["position"]).max()
    assert summary["position_error_max"] <= 1e-13 * far
    assert summary["rotation_error_max"] <= 1e-14
    assert summary["orthogonality_error_max"] <= 1e-14
    found = lierb.predict(problem, update="ambient")["SE3"]
    assert found.position_exact
    assert found.rotation_exact


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["saddle", pytest.param("subgroup", marks=pytest.mark.long)])
def test_a_screw_drifts_with_the_order(solver):
    """Its axis is kept; the coupling of turn and slide is off by a sixteenth at half the step."""
    problem, twist0 = tilted("screw")
    found = lierb.predict(problem, update="ambient")["SE3"]
    kept = [name for name, e in zip(found.rows, found.rows_exact, strict=True) if e]
    assert (kept, found.group) == (["d1", "d2", "Omega1", "Omega2"], "SO(2)×R")
    errors = []
    for dt in (4e-3, 2e-3):
        (summary,) = lierb.integrate(
            problem, twist0=twist0, dt=dt, t_end=1.0, solver=solver, update="ambient"
        ).summary.to_pylist()
        errors.append(summary["position_error_max"])
        assert summary["rotation_error_max"] <= 1e-15
    assert errors[1] > 1e-11
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


# ---- prediction --------------------------------------------------------------------------------

BOX = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)


def test_prediction_of_other_joints_is_that_of_local_updates():
    for name in ("universal", "pin_in_slot", "point_on_sphere"):
        problem, _ = tilted(name)
        local, ambient = lierb.predict(problem), lierb.predict(problem, update="ambient")
        assert {c: (p.group, p.rows_exact) for c, p in local.items()} == {
            c: (p.group, p.rows_exact) for c, p in ambient.items()
        }


def test_coupled_slides_and_turns_come_apart():
    """The hull of H_p⋉R² is SO(2)⋉R³; on SO(3)×R³ a proportional translation is lost too."""
    problem, _ = tilted("helical_planar")
    local, ambient = lierb.predict(problem), lierb.predict(problem, update="ambient")
    assert [p.position_exact for p in local.values()] == [True, True]
    assert [p.group for p in ambient.values()] == ["SO(2)⋉R³", "SO(2)×R³"]
    assert [p.position_exact for p in ambient.values()] == [False, False]
    assert [p.rotation_exact for p in ambient.values()] == [True, True]


@pytest.mark.slow
def test_bodies_that_are_one_stay_together():
    """Conjugation with their relative pose is an automorphism of the dual quaternions."""
    links = [
        lierb.Link("hull", BOX, lierb.joints.free()),
        lierb.Link("tank", BOX, lierb.joints.fixed(parent_point=(0.3, 0.1, 0.0)), "hull"),
    ]
    ship = lierb.Mechanism(links)
    found = lierb.predict(ship, update="ambient")
    assert (found["SE3"]["tank"].group, found["SE3"].dimension) == ("in SE(3)×SE(3)", 6)
    assert found["SE3"].position_exact
    assert not found["SO3xR3"].position_exact
    twist = {"hull": (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), "tank": np.zeros(6)}
    run = lierb.integrate(
        ship, twist0=ship.project(twist), dt=0.02, t_end=20.0, cspace="SE3", update="ambient"
    )
    (summary,) = run.summary.to_pylist()
    assert summary["position_error_max"] <= 1e-13  # random walk of 1e3 steps
    assert summary["rotation_error_max"] <= 1e-13


# ---- order, in plain Python: nothing is compiled -----------------------------------------------

EXPLICIT = [name for name, tableau in TABLEAUS.items() if not tableau.exponentials]
STEPS = {1: 1000, 2: 500, 3: 200, 4: 100, 5: 40, 6: 16, 7: 12, 8: 10, 9: 8}  # in 0.5 s
T_END = 0.5


def reference(times, **more):
    """The heavy box on its tilted pivot, by Newton and Euler in ground coordinates."""
    problem, twist0 = tilted("spherical")
    return oracle.reference_trajectory(
        "spherical", times, mass=float(problem.body.mass), inertia=problem.body.inertia,
        twist0=twist0, pose0=problem.joint.closed_pose, ground_frame=problem.joint.ground_frame,
        body_frame=problem.joint.body_frame, gravity=problem.gravity, **more,
    )  # fmt: skip


@cache
def truth():
    return reference([T_END])


class InPython:
    """A method's steps of the box on its pivot, on floats."""

    def __init__(self, method, **more):
        scheme = TABLEAUS[method].scheme(is_adaptive=False, interpolates=True)
        self.system, self.body, self.start, self.numbers = in_python(
            *tilted("spherical"), lanes=1, update="ambient", method=scheme,
            multipliers=False, cspace="SE3", solver="subgroup", **more,
        )  # fmt: skip
        self.method = method_of(self.system.plan)

    def after(self, steps, h):
        state = self.start
        for k in range(steps):
            at = Interval(k * h, h, h)
            state = self.method.step(self.system, self.body, state, at).state
        return state

    def between(self, h, theta):
        """State at a fraction of the first step."""
        at = Interval(0.0, h, h)
        slopes = self.method.step(self.system, self.body, self.start, at, True).slopes
        slopes = self.method.extended(self.system, self.body, self.start, at, slopes)
        return self.method.between(self.system, self.body, self.start, at, slopes, theta)

    def seen(self, state):
        """R, r, ω and v, in the user's frames."""
        return np.array(self.system.in_user_frames(self.body, self.numbers, state)[0], float)


@pytest.mark.parametrize("method", slow_but(EXPLICIT, "Heun", "RK4", "Tsit5", "DOP853"))
def test_every_explicit_method_has_its_order(method):
    run, expected, true = InPython(method), TABLEAUS[method].order, truth()
    errors = []
    for steps in (STEPS[expected], 2 * STEPS[expected]):
        found = run.seen(run.after(steps, T_END / steps))
        rotation, position = found[:9].reshape(3, 3) - true.R[0], found[9:12] - true.r[0]
        errors.append(max(np.abs(rotation).max(), np.abs(position).max()))
    order = np.log2(errors[0] / errors[1])
    # At high orders the next terms count; errors end at those of the reference, 5e-13.
    assert expected - (0.15 if expected < 6 else 0.5) < order < expected + 2.5, errors
    if expected < 5:
        assert order < expected + 0.3, errors


@pytest.mark.parametrize("method", ["Tsit5", "DOP853"])
def test_dense_output_has_its_order(method):
    """A row within a step, against a chain of short steps of order 9."""
    run, fine, theta = InPython(method), InPython("Verner98"), 0.37
    errors = []
    for h in (0.08, 0.04):
        found, true = run.seen(run.between(h, theta)), fine.seen(fine.after(8, theta * h / 8))
        errors.append(np.abs(found[:12] - true[:12]).max())
        assert np.abs(found[:9].reshape(3, 3) @ found[:9].reshape(3, 3).T - np.eye(3)).max() < 1e-14
    order = TABLEAUS[method].dense_order + 1  # of one step
    assert order - 0.5 < np.log2(errors[0] / errors[1]) < order + 2.5, errors


# ---- forces, adaptive steps, output between steps and events ------------------------------------

SPRING = {
    "body_point": (0.1, 0.0, 0.05), "stiffness": 40.0, "damping": 0.5, "length": 0.1,
}  # fmt: skip
ANCHOR = (0.4, 0.2, -0.3)


@lierb.event
def level(R):
    return R[2, 2]


@pytest.mark.long
def test_a_sprung_body_is_where_newton_and_euler_say():
    """The spring, at stages off unit length; rows and events within steps."""
    plain, twist0 = tilted("spherical")
    spring = lierb.forces.spring_damper(ground_point=ANCHOR, **SPRING)
    problem = lierb.Problem(plain.body, plain.joint, plain.gravity, spring, events=level())
    times = np.linspace(0.0, 1.0, 9)
    run = lierb.integrate(
        problem, twist0=twist0, t_end=1.0, rtol=1e-9, save_at=times, record="state",
        update="ambient",
    )  # fmt: skip
    crossings = run.events["t"].to_numpy()
    assert len(crossings) >= 2
    every = np.unique([*times, *crossings])
    true = reference(every, forces=[oracle.spring_damper(ground_point=ANCHOR, **SPRING)])
    seen = {t: k for k, t in enumerate(every)}
    rows = [seen[t] for t in times]
    # rtol is of a step; here are some tens of them
    np.testing.assert_allclose(run.position[:, 0], true.r[rows], rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.rotation[:, 0], true.R[rows], rtol=0, atol=1e-8)
    at = [seen[t] for t in crossings]
    assert np.abs(true.R[at, 2, 2]).max() < 1e-8
    assert run.summary["position_error_max"][0].as_py() == 0.0


# ---- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["CF4", "CG3"])
def test_commutator_free_methods_are_refused(method):
    problem, twist0 = tilted("spherical")
    with pytest.raises(ArgumentError, match=r'needs update="local", not update="ambient"'):
        lierb.integrate(problem, twist0=twist0, dt=0.1, t_end=1.0, method=method, update="ambient")


def test_unknown_updates_are_refused():
    problem, _ = tilted("spherical")
    with pytest.raises(UnknownNameError, match="ambient"):
        lierb.predict(problem, update="ambiente")

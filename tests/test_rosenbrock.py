"""Rosenbrock methods: order conditions, stability, Jacobians, stiff problems, kept joints."""

from __future__ import annotations

from functools import cache

import numpy as np
import oracle
import pytest
from cases import in_python, tiered, tilted
from mechanisms.shared import four_bar
from rooted_trees import RosenbrockStages, defect, weights_at, worst_defect
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ArgumentError
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.unknowns import Unknowns
from lierb.methods import METHODS, RosenbrockTableau

ROSENBROCK = {
    name: method for name, method in METHODS.items() if isinstance(method, RosenbrockTableau)
}
EVERY = pytest.mark.parametrize("method", ROSENBROCK.values(), ids=ROSENBROCK)
PAIRS = {name: method for name, method in ROSENBROCK.items() if method.error}
DENSE = {name: method for name, method in ROSENBROCK.items() if method.dense}

# ---- coefficients ------------------------------------------------------------------------------

# Rounding of published coefficients with 15 or 16 digits, up to 165, and of their sums.
ROUNDING = 1e-12
MISSED = 1e-6  # a condition of the order above is missed by at least this


@EVERY
def test_method_has_its_order_and_no_more(method):
    stages = RosenbrockStages(method)
    assert worst_defect(stages, method.b, method.order) <= ROUNDING
    assert defect(stages, method.b, method.order + 1) > MISSED


@pytest.mark.parametrize("method", PAIRS.values(), ids=PAIRS)
def test_embedded_method_has_its_order_and_no_more(method):
    stages = RosenbrockStages(method)
    embedded = [b - e for b, e in zip(method.b, method.error[0], strict=True)]
    assert worst_defect(stages, embedded, method.error_order) <= ROUNDING
    assert defect(stages, embedded, method.error_order + 1) > MISSED


@pytest.mark.parametrize("method", DENSE.values(), ids=DENSE)
@pytest.mark.parametrize("theta", [0.25, 0.5, 0.875])
def test_dense_output_has_its_order(method, theta):
    stages = RosenbrockStages(method)
    weights = weights_at(method.dense, theta)
    assert worst_defect(stages, weights, method.dense_order, theta) <= ROUNDING


@EVERY
def test_method_is_a_stable_and_all_but_ros3p_l_stable(method):
    def stability(z):
        changes = method.linear_stages(z)
        return abs(1.0 + sum(b * k for b, k in zip(method.b, changes, strict=True)))

    axis = 1j * np.concatenate([np.linspace(0.0, 20.0, 2001), np.logspace(1.3, 6.0, 500)])
    assert stability(axis).max() <= 1.0 + 1e-12  # no pole is left of the axis: A-stable
    # R(∞) = √3 − 1 follows from γ = ½ + √3/6 and order 3
    limit = np.sqrt(3.0) - 1.0 if method.name == "ROS3P" else 0.0
    assert stability(-1e9) == pytest.approx(limit, abs=1e-6)


def test_no_weights_of_ros3p_estimate_an_error_of_linear_systems():
    """Weights of order 2 differ from b by a multiple of e; e·k vanishes on ẏ = λy."""
    method = METHODS["ROS3P"]
    stages = RosenbrockStages(method)
    conditions = [[float(stages.weight(tree, unit)) for unit in np.eye(3)] for tree in ((), ((),))]
    e = np.linalg.svd(conditions)[2][-1]
    for z in (0.3j, -2.0 + 0.5j):
        assert abs(e @ np.array(method.linear_stages(z))) < 1e-15 * abs(z)
    assert method.error is None


def test_tableau_is_checked_when_it_is_made():
    euler = {"A": [[]], "b": [1.0], "C": [[]], "gamma": 1.0}
    assert RosenbrockTableau(**euler).linear_stages(-1.0) == [-0.5]
    for changed, named in (
        ({"gamma": 0.0}, "gamma"),
        ({"b": [0.9]}, "Σ b_i k_i"),
        ({"A": [[], [1.0]]}, "A has 2 rows"),
        ({"C": [[1.0]]}, "row 0 of C"),
        ({"error": [[1.0]], "error_order": 1}, "error"),
        ({"error": [[0.0]]}, "error_order"),
        ({"dense": [[0.5, 0.4]]}, "dense"),
    ):
        with pytest.raises(ArgumentError, match=named):
            RosenbrockTableau(**(euler | changed))


def test_standard_form_is_the_same_method():
    """The L-stable ROS2 of Verwer, Spee, Blom and Hundsdorfer (1999), γ = 1 + 1/√2."""
    gamma = 1.0 + np.sqrt(0.5)
    ros2 = RosenbrockTableau.from_standard(
        [[0, 0], [1, 0]], [[gamma, 0], [-2.0 * gamma, gamma]], [0.5, 0.5], order=2
    )
    assert worst_defect(RosenbrockStages(ros2), ros2.b, 2) < 1e-14
    assert ros2.nodes == (0.0, 1.0)
    z = -0.7 + 0.2j
    k1 = z / (1.0 - gamma * z)
    k2 = z * (1.0 + k1 - 2.0 * gamma * k1) / (1.0 - gamma * z)
    changes = ros2.linear_stages(z)
    assert sum(b * k for b, k in zip(ros2.b, changes, strict=True)) == pytest.approx(
        0.5 * (k1 + k2)
    )


# ---- linear equations --------------------------------------------------------------------------


def test_elimination_without_pivots_is_backward_stable_for_mechanical_systems():
    """1 − hγJ of M q̈ + C q̇ + K q = 0, over 20 000 systems with stiffness of 12 orders."""
    rng = np.random.default_rng(7)
    count, n = 20_000, 3

    def definite(scales):
        a = rng.normal(size=(count, n, n))
        return scales[:, None, None] * (a @ np.swapaxes(a, 1, 2))

    mass = definite(np.ones(count)) + 0.1 * np.eye(n)
    stiff, damped = (definite(10.0 ** rng.uniform(-4.0, 8.0, count)) for _ in range(2))
    unit = 10.0 ** rng.uniform(-6.0, 0.0, count)
    matrix = np.zeros((count, 2 * n, 2 * n))
    matrix[:, :n, :n] = matrix[:, n:, n:] = np.eye(n)
    matrix[:, :n, n:] = -unit[:, None, None] * np.eye(n)
    matrix[:, n:, :n] = unit[:, None, None] * np.linalg.solve(mass, stiff)
    matrix[:, n:, n:] += unit[:, None, None] * np.linalg.solve(mass, damped)
    right = rng.normal(size=(count, 2 * n))
    rows = [[matrix[:, i, j] for j in range(2 * n)] for i in range(2 * n)]
    x = np.stack(Factored(rows).solve(tuple(right.T)), axis=1)
    residual = np.abs(np.einsum("nij,nj->ni", matrix, x) - right).max(axis=1)
    size = np.abs(matrix).sum(axis=2).max(axis=1) * np.abs(x).max(axis=1)
    backward = residual / (size + np.abs(right).max(axis=1))
    assert backward.max() < 1e-12  # measured: 3e-14; by NumPy, with pivots, 3e-16


# ---- order, in plain Python: nothing is compiled -----------------------------------------------

T_END = 0.5
STEPS = {3: 100, 4: 60, 5: 40}


@cache
def truth():
    """The heavy box on its tilted pivot, by Newton and Euler in ground coordinates."""
    problem, twist0 = tilted("spherical")
    (found,) = oracle.reference_trajectory(
        "spherical", [T_END], mass=float(problem.body.mass), inertia=problem.body.inertia,
        twist0=twist0, pose0=problem.joint.closed_pose, ground_frame=problem.joint.ground_frame,
        body_frame=problem.joint.body_frame, gravity=problem.gravity,
    ).R  # fmt: skip
    return found


def on_floats(method, cspace="SE3", solver="subgroup"):
    return in_python(
        *tilted("spherical"), lanes=1, update="local", method=method.scheme(False, True),
        multipliers=False, cspace=cspace, solver=solver,
    )  # fmt: skip


def turned(method, steps, h, **form):
    system, body, state, numbers = on_floats(method, **form)
    for k in range(steps):
        state = method_of(system.plan).step(system, body, state, Interval(k * h, h, h)).state
    return np.reshape(system.in_user_frames(body, numbers, state)[0][:9], (3, 3)).astype(float)


# The form and the method know nothing of each other: one method has each form.
FORMS = [
    *((name, "SE3", "subgroup") for name in ROSENBROCK),
    *((name, *form) for form in (("SE3", "saddle"), ("SO3xR3", "saddle")) for name in ROSENBROCK),
]


@pytest.mark.parametrize(
    "form", tiered(FORMS, FORMS[: len(ROSENBROCK)], [("Rodas5P", "SO3xR3", "saddle")]), ids="-".join
)
def test_steps_have_the_order(form):
    name, *form = form
    method = METHODS[name]
    steps = STEPS[method.order]
    options = dict(zip(("cspace", "solver"), form, strict=True))
    coarse, fine = (
        np.abs(turned(method, n, T_END / n, **options) - truth()).max() for n in (steps, 2 * steps)
    )
    assert np.log2(coarse / fine) == pytest.approx(method.order, abs=0.15)


@pytest.mark.parametrize("method", DENSE.values(), ids=DENSE)
def test_dense_output_of_a_step_has_its_order(method):
    system, body, start, numbers = on_floats(method)
    family, theta, errors = method_of(system.plan), 0.3, []
    for h in (4e-3, 2e-3):
        at = Interval(0.0, h, h)
        slopes = family.step(system, body, start, at, True).slopes
        slopes = family.extended(system, body, start, at, slopes)
        between = family.between(system, body, start, at, slopes, theta)
        found = np.reshape(system.in_user_frames(body, numbers, between)[0][:9], (3, 3))
        expected = turned(METHODS["Rodas5P"], 8, theta * h / 8.0)
        errors.append(np.abs(found.astype(float) - expected).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.dense_order + 1, abs=0.25)


@pytest.mark.parametrize("solver", ["subgroup", "saddle"])
def test_jacobian_is_that_of_the_rates(solver):
    """Central differences of the rates, whose errors are near 1e-9 of them at δ = 1e-5."""
    system, body, state, _ = on_floats(METHODS["Rodas4"], solver=solver)
    unknowns = Unknowns(system, state)
    gravity = system.chart_gravity(body, state.chart)
    _, jacobian = unknowns.jacobian(body, gravity, 0.0)
    delta = 1e-5
    for j in range(len(unknowns)):
        unit = tuple(float(i == j) for i in range(len(unknowns)))
        direction = unknowns.rates(body, unit)
        ends = []
        for sign in (1.0, -1.0):
            x = tuple(0.5 * sign * delta * a for a in direction.x)  # a state holds X/2
            v = tuple(
                a + sign * delta * b for a, b in zip(state.v_or_mu, direction.v_or_mu, strict=True)
            )
            moved = state._replace(x=system.in_algebra(body, x), v_or_mu=v)
            ends.append(np.array(unknowns.of(system.stage_rates(body, moved, gravity, 0.0)), float))
        difference = (ends[0] - ends[1]) / (2.0 * delta)
        column = np.array([float(row[j]) for row in jacobian.rows])
        np.testing.assert_allclose(column, difference, atol=1e-8 * (1.0 + np.abs(difference).max()))


# ---- stiff problems ----------------------------------------------------------------------------

WHEEL, HINGE = lierb.Body(1.0, (0.02, 0.02, 0.02)), lierb.joints.revolute()
SPEED, TORQUE, SMOOTH = 3.0, 0.1, 1e-6


def braked(smooth=SMOOTH):
    """A wheel that Coulomb's friction brings to rest after 0.6 s."""
    friction = lierb.forces.joint_friction(coulomb=TORQUE, speed=smooth)
    return lierb.Problem(WHEEL, HINGE, forces=friction)


def angle_of(result):
    turn = np.reshape(result.summary["rotation"][0].as_py(), (3, 3))
    return np.arctan2(turn[1, 0], turn[0, 0])


@pytest.mark.slow
def test_friction_that_is_nearly_coulombs_takes_few_steps():
    """I ω˙ = −τ ω/√(ω² + s²): φ = (I/2τ)(ω₀√(ω₀² + s²) + s² arsinh(ω₀/s)) at rest."""
    twist0 = HINGE.twist(omega=(0.0, 0.0, SPEED))
    result = lierb.integrate(braked(), twist0=twist0, rtol=1e-6, t_end=2.0, method="Rodas4")
    (row,) = result.summary.to_pylist()
    ratio = SPEED / SMOOTH
    turns = SPEED * np.hypot(SPEED, SMOOTH) + SMOOTH**2 * np.arcsinh(ratio)
    assert angle_of(result) == pytest.approx(0.02 / (2.0 * TORQUE) * turns, abs=1e-6)  # rtol
    assert row["status"] == "ok"
    assert row["steps"] + row["rejected"] < 300  # DOP853 takes 10⁶, by its stability
    assert abs(row["omega"][2]) < 1e-9


TUMBLING = (1.0, 100.0, 2.0, 0.0, 0.0, 0.0)


def dragged(angular):
    """A tumbling body, whose turns decay within seconds, or within milliseconds of a long run."""
    body = lierb.Body(1.0, (0.02, 0.03, 0.04))
    return lierb.Problem(body, lierb.joints.free(), forces=lierb.forces.drag(angular=angular))


@pytest.mark.slow
def test_explicit_run_that_stability_limits_says_so():
    with pytest.warns(lierb.errors.StiffStepWarning, match="stability, not accuracy, limits"):
        lierb.integrate(dragged(10.0), twist0=TUMBLING, rtol=1e-6, t_end=60.0)


@pytest.mark.slow
def test_explicit_run_that_accuracy_limits_says_nothing(recwarn):
    result = lierb.integrate(dragged(0.001), twist0=TUMBLING, rtol=1e-9, t_end=60.0)
    assert result.summary["steps"][0].as_py() > 2000
    assert not recwarn.list


BUSHING = 1e4  # rad/s
MASS, MOMENTS = 6.075, np.array((0.0126563, 0.0468281, 0.0569531))
POINT, GRAVITY = np.array((-0.15, 0.0375, 0.0)), np.array((0.0, 0.0, -9.81))


def hung():
    """A heavy top whose pivot is a stiff bushing, and its start."""
    k, c = 2.0 * BUSHING**2, 2.0 * BUSHING
    bushing = lierb.forces.bushing(POINT, stiffness=(0, 0, 0, k, k, k), damping=(0, 0, 0, c, c, c))
    body = lierb.Body(MASS, MOMENTS)
    problem = lierb.Problem(body, lierb.joints.free(), gravity=GRAVITY, forces=bushing)
    pose, omega = np.eye(4), np.array((6.28, 3.14, 0.63))
    pose[:3, 3] = -POINT
    return problem, pose, np.concatenate([omega, np.cross(omega, -POINT)])


def by_radau(pose, twist, times):
    """Position and rotation matrix by SciPy's Radau, on R and in ground axes."""
    k, c = 2.0 * BUSHING**2, 2.0 * BUSHING

    def rate(t, y):
        turn, place, omega, v = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:]
        arm = turn @ POINT
        spin = turn @ omega
        force = -k * (place + arm) - c * (v + np.cross(spin, arm))
        torque = np.cross(POINT, turn.T @ force)
        turning = (torque - np.cross(omega, MOMENTS * omega)) / MOMENTS
        moving = force / MASS + GRAVITY
        return np.concatenate([(turn @ np.cross(np.eye(3), omega)).ravel(), v, turning, moving])

    start = np.concatenate([np.eye(3).ravel(), pose[:3, 3], twist])
    return solve_ivp(rate, times, start, "Radau", rtol=1e-9, atol=1e-9).y[:, -1]


@pytest.mark.long
def test_stiff_bushing_agrees_with_radau_in_few_steps():
    problem, pose, twist = hung()
    result = lierb.integrate(
        problem, pose0=pose, twist0=twist, rtol=1e-6, t_end=0.2, method="Rodas4"
    )
    (row,) = result.summary.to_pylist()
    expected = by_radau(pose, twist, (0.0, 0.2))
    np.testing.assert_allclose(np.ravel(row["rotation"]), expected[:9], atol=1e-6)  # rtol
    np.testing.assert_allclose(row["position"], expected[9:12], atol=1e-6)
    assert row["steps"] < 200  # of 50 times the bushing's decay


# ---- joints, users' functions, mechanisms ------------------------------------------------------

GROUPS = (
    "spherical", "revolute", "cylindrical", "prismatic", "screw", "planar", "planar_translation",
    "translation", "schoenflies", "helical_planar",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", tiered(GROUPS, ["screw"], []))
def test_joints_are_kept_in_coarse_steps(name):
    """By the saddle point on all six coordinates, in steps that turn the box by 0.4 rad."""
    problem, twist0 = tilted(name)
    result = lierb.integrate(
        problem, twist0=twist0, dt=0.05, t_end=5.0, solver="saddle", method="ROS3P"
    )
    (row,) = result.summary.to_pylist()
    assert row["status"] == "ok"
    assert row["position_error_max"] <= 1e-12 * (1.0 + np.abs(row["position"]).max())
    assert row["rotation_error_max"] <= 1e-12


@lierb.wrench
def pushing(t, R, r, omega, v, states):
    torque = (0.3 * np.sin(3 * t) - 0.2 * omega[0], 0.1 * R[0, 0] * states.s, -0.3 * omega[2])
    return torque, (-5.0 * r[0] + np.sin(t), 0.2 * v[1] * v[1], -0.3 * v[2])


@lierb.states(s=0.5)
def servo(t, R, r, omega, v, states):
    return {"s": -3.0 * states.s + omega[1] + np.sin(2 * t)}


@lierb.event(terminal=False)
def level(t, R, r, omega, v):
    return r[0] - 0.1


def flight():
    body = lierb.Body(mass=2.0, inertia=(0.1, 0.2, 0.25))
    free = lierb.joints.free()
    return lierb.Problem(body, free, GRAVITY, [pushing()], states=servo(), events=level())


TWIST = np.array((1.0, 2.0, 3.0, 0.4, 0.2, 0.3))


@pytest.mark.parametrize(
    "method",
    [
        pytest.param("Rodas4", marks=pytest.mark.slow),
        pytest.param("Rodas5P", marks=pytest.mark.long),
    ],
)
def test_functions_of_time_and_states_events_and_output_between_steps(method):
    """Beside RK4's steps of 0.5 ms: rows, states, work, crossings."""
    times = [0.1, 0.45, 0.8]
    options = {"twist0": TWIST, "t_end": 1.0, "save_at": times, "record": ("state", "energy")}
    truth = lierb.integrate(flight(), dt=5e-4, method="RK4", **options)
    result = lierb.integrate(flight(), rtol=1e-8, method=method, **options)
    for name in ("rotation", "position", "omega", "v", "s", "work"):
        found, expected = (np.array(each.history[name].to_pylist()) for each in (result, truth))
        np.testing.assert_allclose(found, expected, atol=1e-6, err_msg=name)  # 100 rtol
    assert len(truth.events) > 0
    np.testing.assert_allclose(result.events["t"], truth.events["t"], atol=1e-6)


@pytest.mark.long
def test_mechanism_with_a_loop_agrees_with_an_explicit_method():
    """A four-bar, projected after each step: 10 rtol."""
    mechanism = four_bar()
    bent = mechanism.pose({"crank": 0.3, "rocker": -1.6, "coupler": -0.5})
    pose0 = mechanism.close(bent)
    twist0 = mechanism.project(mechanism.twist({"crank": 6.0}, pose0), pose0)
    options = {"pose0": pose0, "twist0": twist0, "rtol": 1e-8, "t_end": 0.5}
    rodas, explicit = (
        lierb.integrate(mechanism, method=method, stabilise="project", **options).summary
        for method in ("Rodas4", "DOP853")
    )
    for name in ("rocker.rotation", "rocker.omega"):
        found, expected = (np.array(each[name].to_pylist()) for each in (rodas, explicit))
        np.testing.assert_allclose(found, expected, atol=1e-7)
    assert rodas["position_error_max"][0].as_py() < 1e-12


@pytest.mark.slow
def test_numbers_of_a_trajectory_do_not_depend_on_its_neighbours():
    problem, pose, _ = hung()
    omega = np.random.default_rng(3).uniform(-5.0, 5.0, (40, 3))
    twists = np.concatenate([omega, np.cross(omega, -POINT)], axis=1)
    options = {"pose0": pose, "rtol": 1e-6, "t_end": 0.1, "method": "Rodas4"}
    together = lierb.integrate(problem, twist0=twists, **options).summary
    alone = lierb.integrate(problem, twist0=twists[17], **options).summary
    turned = lierb.integrate(problem, twist0=twists[::-1], threads=2, **options).summary
    assert len(set(together["steps"].to_pylist())) > 1
    for name in ("rotation", "omega", "steps", "energy_drift_max"):
        assert together[name][17] == alone[name][0] == turned[name][22]


# ---- what is refused ---------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning")
def test_what_a_rosenbrock_method_cannot_do_is_named():
    problem, twist0 = tilted("spherical")
    options = {"twist0": twist0, "t_end": 1.0, "method": "Rodas4"}
    for update in ("ambient", "global"):
        with pytest.raises(ArgumentError, match='Rodas4 needs update="local"'):
            lierb.integrate(problem, dt=0.1, update=update, **options)
    with pytest.raises(ArgumentError, match="ROS3P; give another method"):
        lierb.integrate(problem, rtol=1e-3, **(options | {"method": "ROS3P"}))

    @lierb.wrench
    def untraceable(t, R, r, omega, v):
        push = 0.0
        while push < r[0]:
            push += 0.1
        return (push, 0.0, 0.0), (0.0, 0.0, 0.0)

    pushed = lierb.Problem(problem.body, problem.joint, forces=untraceable())
    with pytest.raises(ArgumentError, match="derivatives of untraceable"):
        lierb.integrate(pushed, dt=0.1, **options)

"""Methods that solve for the rows, on mechanisms: the oracle's motion, rows, bits, what is refused.

The descriptor form is compared with the tree's own equations of motion, and with the form of a
single body.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import GRAVITY, box, column, final, integrate, tilted

import lierb
from lierb.errors import ArgumentError, FailedTrajectoryWarning
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.tree_descriptor import TreeDescriptor
from lierb.methods import METHODS
from mechanisms import samples
from mechanisms.samples import SHAPES
from mechanisms.shared import four_bar, in_python
from mechanisms.test_against_oracle import moved, worst
from mechanisms.test_oracle import sample

WITH_CONSTRAINTS = ("RATTLie", "SHAKELie", "alpha3", "alpha2", "BLieDF1", "BLieDF2")
CSPACES = ("SE3", "SO3xR3")
REGULAR = tuple(shape for shape in SHAPES if shape != "four_bar")  # its rows depend on each other


def floats(numbers) -> np.ndarray:
    return np.array([float(x + 0.0) for x in numbers])


def formulas(shape: str, cspace: str, method: str = "RATTLie"):
    """System, constants and start of a random mechanism, on floats."""
    made = sample(shape, 1, centred=cspace == "SO3xR3", forces=True)
    start = {k: {n: x[0] for n, x in v.items()} for k, v in samples.start_of(made).items()}
    mechanism = samples.mechanism_of(made.description)
    return in_python(mechanism, cspace, **start, method=METHODS[method])


# ---- the form ----------------------------------------------------------------------------------


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("shape", REGULAR)
def test_descriptor_has_the_accelerations_of_the_tree(shape, cspace):
    system, body, state = formulas(shape, cspace)
    form, motion = TreeDescriptor(system, body), system.motion(body, state, 0.0)
    rates, multipliers = form.accelerations(state.chart, state.v_or_mu, 0.0)
    expected = floats(system.accelerate(body, motion).rates)
    assert len(multipliers) == form.rows
    np.testing.assert_allclose(floats(rates), expected, atol=1e-10 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("shape", REGULAR)
def test_jacobian_is_the_gradient_of_the_rows(shape, cspace):
    """Central differences along random motions of all nodes, with errors of 1e-6²."""
    system, body, state = formulas(shape, cspace)
    form = TreeDescriptor(system, body)
    rows = np.array([floats(row) for row in form.constraints(state.chart, 0.0).jacobian])

    def values(x) -> np.ndarray:
        return floats(form.constraints(form.moved(state.chart, tuple(x)), 0.0).values)

    for direction in np.random.default_rng(3).normal(size=(2, form.width)):
        slope = (values(1e-6 * direction) - values(-1e-6 * direction)) / 2e-6
        np.testing.assert_allclose(slope, rows @ direction, atol=1e-8)


@pytest.mark.parametrize(
    ("method", "shape", "cspace"),
    [
        *((method, "rssr", "SE3") for method in WITH_CONSTRAINTS),
        ("alpha2", "two_loops", "SO3xR3"),
        *(
            pytest.param(method, shape, "SO3xR3", marks=pytest.mark.slow)
            for method, shapes in (
                ("alpha2", ("chain", "branched")),
                ("SHAKELie", ("star", "loosely", "many_loops")),
            )
            for shape in shapes
        ),
    ],
)
def test_steps_satisfy_all_rows(method, shape, cspace):
    system, body, state = formulas(shape, cspace, method)
    form, stepper, h = TreeDescriptor(system, body), method_of(system.plan), 0.005
    state = stepper.started(system, body, state, Interval(0.0, h, h))
    for k in range(3):
        made = stepper.step(system, body, state, Interval(k * h, h, h))
        assert float(made.unsolved + 0.0) == 0.0
        assert 2.0 <= float(made.turns + 0.0) <= 8.0
        state, constraints = made.state, form.constraints(made.state.chart, (k + 1) * h)
        assert np.abs(floats(constraints.values)).max() < 1e-12
        if method in ("RATTLie", "alpha2"):
            assert np.abs(floats(constraints.rates(state.v_or_mu))).max() < 1e-11


# ---- runs --------------------------------------------------------------------------------------


# What the runs of the pendulum record: another record has kernels of its own.
RECORDED = ["state", "energy", "multipliers"]


def pendulum(count: int = 2, damping: float = 0.1) -> tuple[lierb.Mechanism, dict]:
    """A chain of boxes on crossed axes with a spring and damper, and its start."""
    links = []
    for i in range(count):
        axis = {"axis": (0.0, 1.0, 0.0) if i % 2 == 0 else (1.0, 0.0, 0.0)}
        place = {"parent_point": (0.0, 0.0, -0.2)} if i else {}
        joint = lierb.joints.revolute(body_point=(0.02, 0.0, 0.2), **axis, **place)
        links.append(lierb.Link(f"link{i}", box(), joint, f"link{i - 1}" if i else "ground"))
    spring = lierb.forces.torsional_spring(stiffness=3.0, damping=damping, angle=0.2)
    made = lierb.Mechanism(links, gravity=GRAVITY, forces=spring.on("link1"))
    pose0 = made.close(made.pose())
    rates = {f"link{i}": 2.0 + i for i in range(count)}
    return made, {"pose0": pose0, "twist0": made.twist(rates, pose0)}


def driven() -> tuple[lierb.Mechanism, dict]:
    """The pendulum with a motor that prescribes the angle of its first link, and its start."""
    free, start = pendulum()
    motor = lierb.forces.motor(position=lambda t: 0.3 * math.sin(2.0 * t) + 0.4 * t * t)
    made = lierb.Mechanism(free.links, gravity=GRAVITY, forces=[*free.forces, motor.on("link0")])
    rates = made.twist({"link0": 0.6, "link1": 3.0}, start["pose0"])
    return made, start | {"twist0": rates}


def slopes(errors) -> np.ndarray:
    errors = np.array(errors)
    return np.log2(errors[:-1] / errors[1:])


QUICK = [("RATTLie", "SE3")]
FORMS = [
    pytest.param(*form, marks=pytest.mark.slow if form in QUICK else pytest.mark.long)
    for form in ((m, c) for m in WITH_CONSTRAINTS for c in CSPACES)
]


@pytest.mark.long
@pytest.mark.parametrize("model", [pytest.param(pendulum, marks=pytest.mark.long), driven])
@pytest.mark.parametrize(("method", "cspace"), FORMS)
def test_pendulum_has_the_order(method, cspace, model):
    """Pose, velocity, work and λ; beside RK4, whose steps of 0.5 ms leave 1e-10 and less."""
    made, start = model()
    shorter = {"BLieDF1": 32, "BLieDF2": 4}.get(method, 1)
    run = {**start, "t_end": 0.5, "record": RECORDED}
    exact = lierb.integrate(made, dt=5e-4, method="RK4", cspace=cspace, save_every=1000, **run)
    errors = []
    for dt in np.array((4e-3, 2e-3, 1e-3)) / shorter:
        every = round(0.5 / dt)
        result = lierb.integrate(made, dt=dt, method=method, cspace=cspace, save_every=every, **run)
        assert result.summary["status"].to_pylist() == ["ok"]
        assert max(final(result, f"{kind}_error_max") for kind in ("position", "rotation")) < 1e-13
        off = [
            column(result.history, name)[-1] - column(exact.history, name)[-1]
            for link in made.names
            for name in (f"{link}.rotation", f"{link}.omega", f"{link}.lambda")
        ]
        if model is driven:
            torque = "link0.motor.lambda"
            off.append(column(result.history, torque)[-1] - column(exact.history, torque)[-1])
        off.append(final(result, "work_final") - final(exact, "work_final"))
        errors.append([np.abs(x).max() for x in off])
    driven_exactly = np.max(errors, axis=0) < 1e-12  # the motor's joint
    assert np.count_nonzero(driven_exactly) <= 2 * (model is driven)
    found = slopes(np.array(errors)[:, ~driven_exactly])
    np.testing.assert_allclose(found, METHODS[method].order, atol=0.15)


@pytest.mark.long
@pytest.mark.parametrize("shape", ["rssr", "branched", "two_loops"])
@pytest.mark.parametrize("method", ["RATTLie", "BLieDF2"])
def test_motion_is_the_oracles(method, shape):
    made, motion, _ = moved(shape, False)
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        result = lierb.integrate(
            samples.mechanism_of(made.description), **samples.start_of(made), dt=dt, t_end=0.2,
            method=method, cspace="SE3", save_every=round(0.1 / dt), record=["state"],
        )  # fmt: skip
        assert result.failed.size == 0
        links = [result[samples.link_name(i)] for i in range(len(made.description.bodies))]
        errors.append([
            max(worst(x.rotation, motion.poses[:, :, i, :3, :3]) for i, x in enumerate(links)),
            max(worst(x.v, motion.twists[:, :, i, 3:]) for i, x in enumerate(links)),
        ])  # fmt: skip
    np.testing.assert_allclose(slopes(errors), 2.0, atol=0.2)


@pytest.mark.long
def test_output_between_steps_and_events_have_order_2_on_links_with_their_own_cspaces():
    made, start = pendulum()

    @lierb.wrench
    def shaken(t, R, r, omega, v):
        return (0.2 * np.sin(7.0 * t) - 0.1 * omega[0], 0.0, 0.0), (0.0, 0.5 * np.cos(3.0 * t), 0.0)

    @lierb.event
    def lowest(t, R, r, omega, v):
        return v[2]

    more = {"forces": [*made.forces, shaken().on("link1")], "events": lowest().on("link1")}
    made = lierb.Mechanism(made.links, gravity=GRAVITY, **more)
    run = {**start, "t_end": 0.6, "save_at": (0.1, 0.1234567, 0.377), "record": ["state"]}
    exact = lierb.integrate(made, dt=1e-3, method="DOP853", **run)
    assert len(exact.events) > 0
    errors = []
    for dt in (0.01, 0.005, 0.0025):
        cspace = {"link0": "SE3", "link1": "SO3xR3"}
        coarse = lierb.integrate(made, dt=dt, method="RATTLie", cspace=cspace, **run)
        pairs = [(coarse[name].rotation, exact[name].rotation) for name in made.names]
        pairs.append(tuple(np.array(x.events["t"].to_pylist()) for x in (coarse, exact)))
        errors.append([np.abs(x - y).max() for x, y in pairs])
    np.testing.assert_allclose(slopes(errors), 2.0, atol=0.15)


@lierb.constraint
def upright(R, r):
    return r[1] - 0.3 * r[0]


@pytest.mark.long
@pytest.mark.parametrize("method", ["RATTLie", "alpha2"])
def test_constraints_of_a_users_hold_and_have_the_order(method):
    upper = lierb.joints.spherical(body_point=(0.0, 0.0, 0.2))
    lower = lierb.joints.spherical(body_point=(0.0, 0.0, 0.2), parent_point=(0.0, 0.0, -0.2))
    links = [lierb.Link("upper", box(), upper), lierb.Link("lower", box(), lower, "upper")]
    made = lierb.Mechanism(links, gravity=GRAVITY, constraints=upright().on("lower"))
    pose0 = made.close(made.pose())
    wanted = {"upper": (0.5, 0.7, 2.0, 0.0, 0.0, 0.0), "lower": (-1.0, 0.4, 1.0, 0.0, 0.0, 0.0)}
    run = {"pose0": pose0, "twist0": made.project(wanted, pose0), "t_end": 0.5}
    exact = lierb.integrate(made, dt=1e-3, method="DOP853", **run)
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        coarse = lierb.integrate(made, dt=dt, method=method, cspace="SE3", **run)
        assert max(coarse.summary["position_error_max"].to_pylist()) < 1e-14
        names = [f"{name}.rotation" for name in made.names]
        errors.append([np.abs(final(coarse, name) - final(exact, name)).max() for name in names])
    np.testing.assert_allclose(slopes(errors), 2.0, atol=0.15)


@pytest.mark.long
@pytest.mark.parametrize("method", ["RATTLie", "alpha2"])
def test_one_link_moves_like_a_body(method):
    problem, twist0 = tilted("hook")
    alone = lierb.Mechanism(lierb.Link("body", problem.body, problem.joint), gravity=GRAVITY)
    run = {"dt": 0.01, "t_end": 0.2, "method": method, "cspace": "SE3"}
    body = integrate(problem, twist0=twist0, **run)
    link = lierb.integrate(alone, twist0={"body": twist0}, **run).summary
    for name in ("rotation", "position", "omega", "v"):
        (found,) = link[f"body.{name}" if f"body.{name}" in link.column_names else name].to_pylist()
        np.testing.assert_allclose(found, final(body, name), atol=1e-11)


def bits(result) -> np.ndarray:
    """Every number of the links' states at the end, as integers, (n, numbers)."""
    links = [result[name] for name in ("link0", "link1")]
    ends = [part[-1] for x in links for part in (x.rotation, x.position, x.omega, x.v)]
    return np.concatenate([end.reshape(len(end), -1) for end in ends], axis=1).view(np.int64)


@pytest.mark.parametrize(("method", "cspace"), FORMS)
def test_bits_depend_on_the_trajectory_alone(method, cspace):
    made, start = pendulum()
    rates = 10.0 ** np.random.default_rng(5).uniform(-2.0, 1.0, 21)
    twist0 = made.twist({"link0": rates, "link1": rates[::-1]}, start["pose0"])
    run = {"dt": 5e-3, "method": method, "cspace": cspace, "record": RECORDED}

    def ran(which=slice(None), pose0=start["pose0"], **options):
        some = {name: twist[which] for name, twist in twist0.items()}
        return lierb.integrate(made, pose0=pose0, twist0=some, **(run | options))

    whole = ran(t_end=0.1, save_every=20)
    assert set(whole.summary["status"].to_pylist()) == {"ok"}
    order = np.random.default_rng(1).permutation(21)[:10]
    np.testing.assert_array_equal(bits(ran(order, t_end=0.1, save_every=20)), bits(whole)[order])
    half = ran(t_end=0.05, save_every=10)
    again = lierb.integrate(made, **half.end, **run, t_end=0.1, save_every=10)
    np.testing.assert_array_equal(bits(again), bits(whole))


@pytest.mark.parametrize(("method", "cspace"), FORMS)
def test_status_tells_that_an_iteration_has_not_converged(method, cspace):
    made, start = pendulum()
    twist0 = made.twist({"link0": np.array((1.0, 5e4, 2.0)), "link1": 1.0}, start["pose0"])
    run = {"pose0": start["pose0"], "dt": 5e-3, "method": method, "cspace": cspace}
    run |= {"t_end": 0.1, "save_every": 20, "record": RECORDED}
    with pytest.warns(FailedTrajectoryWarning, match="a smaller dt helps"):
        batch = lierb.integrate(made, twist0=twist0, **run)
    assert batch.summary["status"].to_pylist() == ["ok", "no_convergence", "ok"]
    alone = {name: np.broadcast_to(twist, (3, 6))[2] for name, twist in twist0.items()}
    np.testing.assert_array_equal(bits(lierb.integrate(made, twist0=alone, **run)), bits(batch)[2:])


@pytest.mark.slow
def test_energy_does_not_drift():
    made, start = pendulum(damping=0.0)
    run = {"dt": 5e-3, "t_end": 100.0, "save_every": 20, "record": RECORDED, "cspace": "SE3"}
    drift = np.abs(column(lierb.integrate(made, **start, **run, method="RATTLie").history,
                          "energy_drift"))  # fmt: skip
    assert drift[len(drift) // 2 :].max() < 1.2 * drift[: len(drift) // 10].max() < 0.1


# ---- rows that depend on others -----------------------------------------------------------------


@pytest.mark.long
def test_a_bar_that_is_pinned_twice_moves_as_on_one_hinge():
    """A hinge and a ball joint at one point: three rows of eight depend on the others."""
    hinge = lierb.joints.revolute((0.0, 0.0, 0.2))
    pin = lierb.Loop("pin", lierb.joints.spherical((0.0, 0.0, 0.2)), "bar")
    link = lierb.Link("bar", box(), hinge)
    run = {"dt": 0.01, "t_end": 0.3, "method": "RATTLie", "cspace": "SE3", "save_every": 10}
    run |= {"record": RECORDED}
    once, twice = lierb.Mechanism(link, gravity=GRAVITY), lierb.Mechanism(link, pin, GRAVITY)
    twist0 = once.twist({"bar": [1.0, -2.0]})
    alone, pinned = (lierb.integrate(made, twist0=twist0, **run) for made in (once, twice))
    assert pinned.summary["status"].to_pylist() == ["ok"] * 2
    for name in ("bar.rotation", "bar.omega", "bar.lambda"):
        found, right = (column(result.history, name) for result in (pinned, alone))
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-11)
    assert not column(pinned.history, "pin.lambda").any()


@pytest.mark.long
@pytest.mark.parametrize("cspace", CSPACES)
@pytest.mark.parametrize("method", WITH_CONSTRAINTS)
def test_a_planar_four_bar_has_the_order(method, cspace):
    """Three of its rows depend on the others. Right: RK4 on reduced coordinates."""
    bars = four_bar()
    pose0 = bars.close(bars.pose({"crank": 0.3, "coupler": -0.5, "rocker": -1.0}))
    twist0 = bars.project(bars.twist({"crank": 1.0}, pose0), pose0)
    run = {"pose0": pose0, "twist0": twist0, "t_end": 0.2, "record": ["state", "reaction"]}
    exact = lierb.integrate(bars, dt=1e-4, save_every=2000, **run)
    shorter = {"BLieDF1": 32, "BLieDF2": 4}.get(method, 1)
    errors = []
    for dt in np.array((4e-3, 2e-3)) / shorter:
        every = round(0.2 / dt)
        result = lierb.integrate(bars, dt=dt, save_every=every, method=method, cspace=cspace, **run)
        assert result.summary["status"].to_pylist() == ["ok"]
        names = [*(f"{x}.{y}" for x in bars.names for y in ("rotation", "omega")), "pin.reaction"]
        off = [column(result.history, name)[-1] - column(exact.history, name)[-1] for name in names]
        errors.append([np.abs(x).max() for x in off])
    np.testing.assert_allclose(slopes(errors), METHODS[method].order, atol=0.3)


@pytest.mark.long
def test_a_trajectory_whose_rank_changes_is_singular():
    """A parallelogram leaves its flat pose, where one row more depends on the others."""
    bar = lambda length: lierb.bodies.box((length, 0.02, 0.02), density=2700.0)
    y = {"axis": (0.0, 1.0, 0.0)}
    hinge = lambda at, **where: lierb.joints.revolute((at, 0.0, 0.0), **where, **y)
    links = [
        lierb.Link("crank", bar(0.2), hinge(-0.1)),
        lierb.Link("coupler", bar(0.5), hinge(-0.25, parent_point=(0.1, 0.0, 0.0)), "crank"),
        lierb.Link("rocker", bar(0.2), hinge(-0.1, ground_point=(0.5, 0.0, 0.0))),
    ]
    pin = lierb.Loop("pin", hinge(0.25, parent_point=(0.1, 0.0, 0.0)), "coupler", "rocker")
    bars = lierb.Mechanism(links, pin)
    twist0 = bars.twist({"crank": 1.0, "coupler": -1.0, "rocker": 1.0})
    with pytest.warns(FailedTrajectoryWarning, match="rows that do not say a thing twice"):
        run = lierb.integrate(
            bars, twist0=twist0, dt=0.01, t_end=0.1, method="RATTLie", cspace="SE3"
        )
    assert run.summary["status"].to_pylist() == ["singular"]


# ---- what is refused ---------------------------------------------------------------------------


REFUSED = [
    ({}, 'RATTLie needs cspace="SE3" or "SO3xR3", not cspace=.reduced'),
    ({"cspace": {"link0": "SE3", "link1": "reduced"}}, "not cspace=.reduced"),
    ({"cspace": "SE3", "solver": "looped"}, 'needs solver="unrolled", not solver="looped"'),
    ({"cspace": "SE3", "stabilise": "project"}, "solves for the rows, which need no stabilise="),
    ({"cspace": "SE3", "update": "ambient"}, 'RATTLie needs update="local"'),
    ({"cspace": "SE3", "method": "alpha2", "save_at": [0.1]}, "all its steps have one length"),
    (
        {"cspace": "SE3", "method": "Verlet"},
        "Verlet is for one body .* for a mechanism take RATTLie",
    ),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_options_that_a_method_cannot_take_are_refused(options, message):
    made, start = pendulum()
    run = {"dt": 0.01, "t_end": 0.1, "method": "RATTLie"}
    with pytest.raises(ArgumentError, match=message):
        lierb.integrate(made, **start, **(run | options))


def test_models_that_a_method_cannot_take_are_refused():
    made, start = pendulum()
    run = {**start, "dt": 0.01, "t_end": 0.1, "method": "alpha2", "cspace": "SE3"}
    added = lierb.forces.added_mass(np.eye(6)).on("link0")
    with pytest.raises(ArgumentError, match="constant mass matrix, to which added_mass would add"):
        lierb.integrate(lierb.Mechanism(made.links, forces=added), **run)
    motor = lierb.forces.motor(speed=1.0).on("link0")
    with pytest.raises(ArgumentError, match="motor is one of velocities"):
        lierb.integrate(lierb.Mechanism(made.links, forces=motor), **run)
    gear = lierb.forces.gear(ratio=2.0).on("link0", "link1")
    with pytest.raises(ArgumentError, match="gear is one of velocities"):
        lierb.integrate(lierb.Mechanism(made.links, forces=gear), **run)

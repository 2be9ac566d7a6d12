"""`lierb.gradient` of trees in memory: derivatives forwards, and what must change no bit."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms.test_tree_loop import SIX, start_of, tree_of

import lierb
from derivatives.test_adjoint import agree, chain, drive, fallen, losses, lost
from derivatives.test_adjoint_of_controllers import aim, motor, sensor, turn
from lierb.runs import adjoint

CLOSE = 1e-10  # relative to the largest derivative of a parameter, and to 1
STEPS = {"dt": 2e-3, "t_end": 0.04, "method": "RK4", "solver": "looped"}
ADAPTIVE = {"rtol": 1e-8, "t_end": 0.04, "solver": "looped"}
FORCES = [
    lierb.forces.torsional_spring(stiffness=2.0, damping=0.1).on("link0"),
    lierb.forces.drag(linear=0.2, angular=0.1).on("link3"),
    lierb.forces.spring_damper(
        ground_point=(0.3, 0.0, 0.2), stiffness=40.0, damping=0.5, length=0.1
    ).on("link5", "link1"),
    drive().on("link4"),
]  # fmt: skip


@lierb.observable
def reached(r, omega):
    return r[0] + 0.3 * r[2] * omega[1]


@lierb.wrench(pull=3.0)
def above(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (0.0, 0.0, params.pull * lierb.where(r[2] > 0.0, r[2] ** 1.5, 0.0))


def tree(**more) -> lierb.Mechanism:
    """Six joints on branches, with forces between links, at joints and on the ground."""
    given = {"forces": FORCES, "observables": reached().on("link5")} | more
    return lierb.Mechanism(tree_of(SIX).links, gravity=(0.4, -0.3, -9.81), **given)


def swung(mechanism, speed=1.0) -> dict:
    return {"twist0": mechanism.twist({"upper": speed, "lower": -2.0})}


def are_equal(one, other) -> bool:
    return all(np.array_equal(one[name], part) for name, part in other.parts.items())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of", "options"),
    [
        ("reached", STEPS),
        pytest.param("energy", STEPS, marks=pytest.mark.long),
        pytest.param("reached", ADAPTIVE, marks=pytest.mark.long),
        pytest.param("reached", ADAPTIVE | {"method": "Tsit5"}, marks=pytest.mark.long),
        pytest.param("reached", STEPS | {"discontinuities": [0.0131]}, marks=pytest.mark.long),
    ],
)
def test_trees_have_the_derivatives_forwards(of, options):
    mechanism = tree()
    agree(mechanism, of, CLOSE, **start_of(mechanism), **options)


@pytest.mark.long
@pytest.mark.parametrize("options", [STEPS, ADAPTIVE])
def test_extra_states_have_their_adjoint(options):
    mechanism = tree(
        states=losses().on("link3"), observables=[lost().on("link3"), reached().on("link4")]
    )
    start = start_of(mechanism)
    agree(mechanism, "lost", CLOSE, **start, **options)
    agree(mechanism, "energy", CLOSE, **start, **options)


@pytest.mark.long
@pytest.mark.parametrize("options", [STEPS, ADAPTIVE])
def test_controllers_have_their_adjoint(options):
    plain = chain()
    controlled = lierb.Mechanism(
        plain.links, gravity=plain.gravity, forces=turn().on("lower"),
        observables=aim().on("lower"),
        controllers=[sensor(every=np.linspace(0.02, 0.05, 5)).on("lower"), motor().on("upper")],
    )  # fmt: skip
    agree(controlled, "aim", CLOSE, **swung(controlled), **options | {"t_end": 0.3})


@pytest.mark.long
@pytest.mark.parametrize("of", ["swing", "energy", "t"])
def test_terminal_events_have_the_gradients_of_unrolled_code(of):
    mechanism = chain(events=fallen().on("lower"))
    run = swung(mechanism, np.linspace(1.0, 3.0, 5)[:, None]) | {"rtol": 1e-8, "t_end": 0.2}
    found, expected = (
        lierb.gradient(mechanism, of, **run, solver=solver) for solver in ("looped", "unrolled")
    )
    times = lierb.gradient(mechanism, "t", "gravity", **run, solver="looped").value
    assert times.min() < 0.2 == times.max()  # some go on
    for name, part in expected.parts.items():
        size = 1.0 + np.abs(part).max()
        assert np.abs(found[name] - part).max() < CLOSE * size, name


@pytest.mark.slow
def test_memory_threads_and_other_trajectories_change_no_bit(monkeypatch):
    mechanism, names = chain(), ("twist0", "gravity", "lower.body.mass")
    names = ("upper.twist0", *names[1:])
    run = swung(mechanism, np.linspace(0.5, 1.5, 11)[:, None]) | STEPS
    whole = lierb.gradient(mechanism, "swing", names, **run)
    alone = lierb.gradient(mechanism, "swing", names, **swung(mechanism, 0.5) | STEPS)
    assert all(np.array_equal(alone[name][0], whole[name][0]) for name in names)
    assert are_equal(whole, lierb.gradient(mechanism, "swing", names, threads=1, **run))
    monkeypatch.setattr(adjoint, "MOST_KEPT", 0)
    assert are_equal(whole, lierb.gradient(mechanism, "swing", names, **run))


@pytest.mark.slow
def test_a_failed_trajectory_leaves_the_others_alone():
    mechanism = chain()
    speeds = np.array((1.0, 1e60, 2.0))[:, None]
    with pytest.warns(lierb.errors.FailedTrajectoryWarning, match="1 trajectory failed"):
        found = lierb.gradient(mechanism, "swing", "gravity", **swung(mechanism, speeds) | STEPS)
    alone = lierb.gradient(mechanism, "swing", "gravity", **swung(mechanism) | STEPS)
    assert np.isnan(found.value).tolist() == [False, True, False]
    assert np.isnan(found["gravity"][1]).all()
    assert np.array_equal(found["gravity"][0], alone["gravity"][0])
    again = lierb.gradient(mechanism, "swing", "gravity", **swung(mechanism) | STEPS)
    assert are_equal(alone, again)


@pytest.mark.slow
def test_a_start_has_the_same_bits_in_a_batch_of_any_size():
    mechanism = tree_of(("revolute", "universal", "spherical"))
    start = start_of(mechanism, count=5)
    mechanism = lierb.Mechanism(
        mechanism.links, gravity=mechanism.gravity, observables=reached().on("link2")
    )
    names = [f"link{i}.{name}" for i in range(3) for name in ("pose0", "twist0")]
    whole = lierb.gradient(mechanism, "reached", names, **start, **STEPS)
    for count in (1, 2):
        some = {key: {link: x[:count] for link, x in own.items()} for key, own in start.items()}
        found = lierb.gradient(mechanism, "reached", names, **some, **STEPS)
        assert all(np.array_equal(found[name], whole[name][:count]) for name in names)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.DerivativeWarning")
@pytest.mark.parametrize("options", [STEPS, pytest.param(ADAPTIVE, marks=pytest.mark.long)])
@pytest.mark.parametrize("solver", ["looped", "unrolled"])
def test_what_is_not_chosen_may_have_no_derivative(solver, options):
    mechanism, names = chain(forces=above().on("lower")), ("gravity", "lower.above.pull")
    run = swung(mechanism, np.array((-1.0, 0.0, 1.0))[:, None]) | options  # below, and above 0
    found = lierb.gradient(mechanism, "swing", names, **run | {"solver": solver})
    forwards = lierb.integrate(mechanism, with_respect_to=names, **run)
    assert 0 < np.count_nonzero(found["lower.above.pull"]) < 3
    for name in names:
        assert found[name] == pytest.approx(forwards.sensitivity("swing", name), abs=1e-12)


@pytest.mark.slow
def test_more_steps_than_fit_into_memory_are_refused_at_once():
    mechanism = chain()
    run = swung(mechanism) | {"dt": 1e-9, "t_end": 1e3, "method": "RK4", "solver": "looped"}
    with pytest.raises(lierb.errors.MemoryLimitError, match="the ends of all steps"):
        lierb.gradient(mechanism, "swing", "gravity", **run)

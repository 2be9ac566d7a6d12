"""Angles that count whole turns: springs, stops, observables and events beyond half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from cases import integrate
from public_cases.shared import bounced, summed

import lierb
from lierb.analysis.magnitudes import magnitudes
from lierb.errors import ArgumentError, ForceError, StudyError
from lierb.studies.description.units import unit_of
from lierb.studies.findings.along_parameters import AlongParameters

INERTIA, STIFFNESS = 0.2, 0.05
SWING = np.array([1.0, 10.0, 100.0])  # rad
FREQUENCY = np.sqrt(STIFFNESS / INERTIA)
BODY = lierb.Body(1.0, (0.1, 0.11, INERTIA))


def spring(turns="turned"):
    return lierb.forces.torsional_spring(stiffness=STIFFNESS, turns=turns)


@lierb.observable(unit="1")
def revolutions(states):
    return states.turned / (2.0 * np.pi)


@lierb.event(terminal=True, at=-1e3)
def unwound(states, params):
    return states.turned - params.at


def mainspring(start=SWING, at=-1e3) -> lierb.Problem:
    held = lierb.joints.revolute()
    return lierb.Problem(
        BODY, held, forces=spring(), states=lierb.turns(start=start), observables=revolutions(),
        events=unwound(at=at),
    )  # fmt: skip


FIXED = {"dt": 1e-3, "record": ("state", "energy")}  # a kernel for all of them


def wound(problem) -> np.ndarray:
    return problem.joint.pose(SWING[:, None])


def test_the_size_of_an_energy_has_that_of_a_wound_spring():
    """By it the tables of studies and comparisons judge what is zero."""
    problem = mainspring()
    rest = np.zeros((3, 6))
    _, energies = magnitudes(problem, wound(problem), rest)
    np.testing.assert_allclose(energies, 0.5 * STIFFNESS * SWING**2)


ADAPTIVE = {"rtol": 1e-10, "method": "DOP853"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        FIXED,
        pytest.param(ADAPTIVE, marks=pytest.mark.long),
        pytest.param({"rtol": 1e-10, "method": "Rodas5P"}, marks=pytest.mark.long),
    ],
    ids=["fixed", "adaptive", "Rosenbrock"],
)
def test_a_spring_is_wound_by_many_turns(options):
    """Right: A cos(ωt), 16 turns at most; the energy of the spring is that of the counted angle."""
    problem, t = mainspring(), np.linspace(0.0, 10.0, 11)
    saved = {"save_at": t} if "rtol" in options else {"save_every": 1000}
    result = lierb.integrate(
        problem, pose0=wound(problem), twist0=np.zeros((3, 6)), t_end=10.0,
        **FIXED | {"dt": None} | saved | options,
    )  # fmt: skip
    assert result.failed.size == 0
    angle = SWING * np.cos(FREQUENCY * t[:, None])
    found = np.array(result.history["turned"]).reshape(11, 3)
    # RK4 of ω dt = 5e-4, and rounding of 1e4 steps of up to 100 rad; rtol in 1.6 periods
    np.testing.assert_allclose(found, angle, rtol=0, atol=1e-10 * SWING.max())
    R = result.rotation
    off = np.arctan2(R[..., 1, 0], R[..., 0, 0]) - found
    np.testing.assert_allclose(np.sin(0.5 * off), 0.0, atol=1e-10)
    whole = 0.5 * STIFFNESS * SWING**2
    energy = np.array(result.history["energy"]).reshape(11, 3)
    np.testing.assert_allclose(energy, np.broadcast_to(whole, (11, 3)), rtol=1e-9)
    assert result.history.schema.field("turned").metadata[b"unit"] == b"rad"


@pytest.mark.slow
def test_the_start_is_that_of_the_pose_nearest_to_the_one_given():
    """Right: ten turns and 1 rad, whatever is given within half a turn of it."""
    held, whole = lierb.joints.revolute(), 20.0 * np.pi + 1.0
    start = whole + np.array([0.0, 3.1, -3.1])
    result = integrate(
        mainspring(start), pose0=held.pose([1.0]), twist0=np.zeros((3, 6)), t_end=1e-3, **FIXED
    )
    first = np.array(result.history["turned"])[:3]
    np.testing.assert_allclose(first, whole, rtol=1e-15)
    assert np.ptp(summed(result, "omega")[:, 2]) == 0.0


STOPS = -4.0 * np.pi - 1.0, 9.0 * np.pi  # rad
RATES = np.array([5.0, 7.0, 11.0])


@pytest.mark.long
@pytest.mark.parametrize("solver", ["auto", pytest.param("looped", marks=pytest.mark.long)])
def test_stops_many_turns_apart_are_met(solver):
    """Right: half an oscillation in each stop, straight flight in between (closed form)."""
    lower, upper = STOPS
    stops = lierb.forces.joint_limit(lower=lower, upper=upper, stiffness=200.0, turns="turned")
    wheel = lierb.Link("wheel", BODY, lierb.joints.cylindrical())
    machine = lierb.Mechanism(wheel, forces=stops.on("wheel"), states=lierb.turns().on("wheel"))
    t = np.linspace(0.0, 60.0, 241)
    rates = np.zeros((3, 2))
    rates[:, 0] = RATES
    result = lierb.integrate(
        machine, twist0=machine.twist({"wheel": rates}), rtol=1e-10, method="DOP853", t_end=60.0,
        save_at=t, solver=solver,
    )  # fmt: skip
    assert result.failed.size == 0
    found = np.array(result.history["turned"]).reshape(241, 3)
    frequency = np.sqrt(200.0 / INERTIA)
    for i, rate in enumerate(RATES):
        right, _ = bounced(t, rate, lower, upper, frequency)
        # 15 stops, each of which leaves some 1e-7 of the speed at its kinks, and 60 s after them
        np.testing.assert_allclose(found[:, i], right, rtol=0, atol=1e-3)
    drift = summed(result, "energy_drift_max") / (0.5 * INERTIA * RATES**2)
    assert np.all(drift < 1e-5)


@pytest.mark.slow
def test_observables_and_events_read_the_counted_angle():
    """Right: 100 cos(ωt) = 30 rad, and its turns."""
    problem = mainspring(at=0.3 * SWING)
    result = integrate(problem, pose0=wound(problem), twist0=np.zeros((3, 6)), t_end=10.0, **FIXED)
    assert result.summary["status"].to_pylist() == ["event"] * 3
    np.testing.assert_allclose(summed(result, "t"), np.arccos(0.3) / FREQUENCY, rtol=1e-9)
    np.testing.assert_allclose(
        summed(result, "revolutions_final"), 0.3 * SWING / (2.0 * np.pi), rtol=1e-9
    )
    np.testing.assert_allclose(summed(result, "revolutions_max"), SWING / (2.0 * np.pi), rtol=1e-14)


@pytest.mark.slow
def test_a_continued_run_goes_on_counting():
    """Right: the bits of one run."""
    problem = mainspring()
    given = {"pose0": wound(problem), "twist0": np.zeros((3, 6)), **FIXED}
    whole = integrate(problem, **given, t_end=0.4)
    first = integrate(problem, **given, t_end=0.2)
    second = integrate(problem, **first.end, **FIXED, t_end=0.4)
    for name in ("turned", "rotation", "omega"):
        np.testing.assert_array_equal(summed(second, name), summed(whole, name), err_msg=name)


@pytest.mark.slow
def test_part_of_a_batch_counts_as_before():
    problem = mainspring()
    alone = problem.of_body(2)
    result = integrate(alone, pose0=wound(problem)[2], twist0=np.zeros(6), t_end=0.4, **FIXED)
    whole = integrate(problem, pose0=wound(problem), twist0=np.zeros((3, 6)), t_end=0.4, **FIXED)
    assert summed(result, "turned")[0] == summed(whole, "turned")[2]


@pytest.mark.long
def test_each_force_counts_the_turns_of_its_own_joint():
    """Two wheels; the second state is behind a user's vector. Right: cosines."""

    @lierb.states(rest=(0.0, 0.0))
    def idle(t):
        return {"rest": (t, t)}

    wheels = [lierb.Link(name, BODY, lierb.joints.revolute()) for name in ("a", "b")]
    machine = lierb.Mechanism(
        wheels,
        forces=[spring("second").on("b"), spring("first").on("a")],
        states=[
            lierb.turns("first", start=10.0).on("a"), idle().on("a"),
            lierb.turns("second", start=-50.0).on("b"),
        ],
    )  # fmt: skip
    assert [force.kind.index for force in machine.forces] == [3, 0]
    pose0 = machine.pose({"a": 10.0, "b": -50.0})
    result = integrate(machine, pose0=pose0, twist0=machine.twist(), dt=1e-2, t_end=2.0)
    cosine = np.cos(2.0 * FREQUENCY)
    assert summed(result, "first")[0] == pytest.approx(10.0 * cosine, rel=1e-9)
    assert summed(result, "second")[0] == pytest.approx(-50.0 * cosine, rel=1e-9)


def test_what_cannot_count_is_refused():
    held = lierb.joints.revolute()
    told = r"^torsional_spring counts turns by the state turned, .*states=lierb\.turns\('turned'\)$"
    with pytest.raises(ForceError, match=told):
        lierb.Problem(BODY, held, forces=spring())
    wheels = [lierb.Link(name, BODY, held) for name in ("a", "b")]
    with pytest.raises(ForceError, match=r"on 'b' counts turns.*turns\('turned'\)\.on\('b'\)"):
        lierb.Mechanism(wheels, forces=spring().on("b"), states=lierb.turns().on("a"))
    with pytest.raises(ForceError, match="turned acts about the joint axis, which a spherical"):
        lierb.Problem(BODY, lierb.joints.spherical(), states=lierb.turns())
    with pytest.raises(ForceError, match="about which a prismatic joint does not turn"):
        lierb.Problem(BODY, lierb.joints.prismatic(), states=lierb.turns())
    states = [lierb.turns().on("a"), lierb.turns().on("b")]
    with pytest.raises(ArgumentError, match="two states or outputs are named turned"):
        lierb.Mechanism(wheels, states=states)
    with pytest.raises(ArgumentError, match="which no attribute can be"):
        lierb.turns("class")
    with pytest.raises(ArgumentError, match=r"or turns=, the name of a state of lierb\.turns"):
        lierb.forces.joint_limit(lower=-4.0, upper=4.0, stiffness=1.0)


def test_a_study_counts_turns():
    design = lierb.sampling.Design({"states.turned.start": lierb.sampling.Uniform(40.0, 60.0)}, n=3)
    held = lierb.joints.revolute()
    problem = lierb.Problem(BODY, held, forces=spring(), states=lierb.turns(start=50.0))
    study = lierb.study_of(problem, design, dt=0.01, t_end=0.1)
    made = study.batch(0, 3)
    assert np.ptp(made.problem.states[0].parameters["start"]) > 0.0
    assert made.problem.forces[0].kind.turns == "turned"
    assert unit_of("states.turned.start", study, made.problem) == "rad"


FAR = lierb.sampling.Uniform(-15.0, 15.0)


def winch(start=0.0, **joints) -> lierb.Mechanism:
    """A drum with a mainspring, and a link without one."""
    drum = lierb.Link("drum", BODY, joints.get("drum", lierb.joints.revolute()))
    return lierb.Mechanism(
        [drum, lierb.Link("idle", BODY, lierb.joints.revolute())],
        forces=spring().on("drum"), states=lierb.turns(start=start).on("drum"),
    )  # fmt: skip


def started(problem, quantities, n=5, **given) -> lierb.Study:
    design = lierb.sampling.Design(quantities, n=n, seed=2)
    return lierb.study_of(problem, design, dt=1e-3, t_end=1.0, **given)


@pytest.mark.slow
@pytest.mark.parametrize("is_mechanism", [True, False])
def test_a_study_counts_from_the_coordinates(tmp_path, is_mechanism):
    """Right: q₀ cos ωt, up to two turns in both directions."""
    quantity = f"{'drum.' * is_mechanism}initial.coordinates"
    problem = winch() if is_mechanism else lierb.Problem(
        BODY, lierb.joints.revolute(), forces=spring(), states=lierb.turns()
    )  # fmt: skip
    far = lierb.sampling.Uniform([-15.0], [15.0])
    table = lierb.run(started(problem, {quantity: far}), tmp_path / "out").table().to_table()
    drawn = np.ravel(table[f"sample.{quantity}"].to_pylist())
    assert np.ptp(np.rint(drawn / (2.0 * np.pi))) > 1.0
    np.testing.assert_allclose(table["turned"], drawn * np.cos(FREQUENCY), rtol=0, atol=1e-10)


def starts_of(study) -> np.ndarray:
    (state,) = study.batch(0, len(study.design)).problem.states
    return state.parameters["start"]


def test_a_count_starts_at_given_coordinates_and_at_its_start_without_them():
    gravity = {"problem.gravity": lierb.sampling.Normal((0.0, 0.0, 0.0), 1e-9)}
    at = {"drum": {"coordinates": 15.0}}
    assert starts_of(started(winch(), gravity, initial=at)) == 15.0
    assert starts_of(started(winch(3.0), gravity, initial=at)) == 15.0  # half a turn says nothing
    assert starts_of(started(winch(14.0), gravity, initial=at)) == 15.0
    assert starts_of(started(winch(14.0), gravity)) == 14.0
    idle = {"idle": {"coordinates": 15.0}}
    assert starts_of(started(winch(14.0), gravity, initial=idle)) == 14.0
    sliding = winch(drum=lierb.joints.cylindrical())
    at = {"drum": {"coordinates": [15.0, 0.2]}}
    assert starts_of(started(sliding, gravity, initial=at)) == 15.0
    drawn = lierb.sampling.Uniform(-3.0, 3.0)
    both = {"drum.initial.coordinates": drawn, "states.turned.start": lierb.sampling.Constant(0.0)}
    study = started(winch(), both)
    own = study.design.draw(0, 5)["drum.initial.coordinates"]
    np.testing.assert_array_equal(starts_of(study), own)


def test_coordinates_far_from_a_given_start_are_refused():
    at = lambda angle: {"drum.initial.coordinates": lierb.sampling.Constant(angle)}
    told = r"problem\.links\.drum\.initial\.coordinates: phi is 15 rad in trajectory {}, more than "
    far = told + r"half a turn from {} rad, where the state turned starts"
    with pytest.raises(StudyError, match=far.format(0, 40)):
        started(winch(40.0), at(15.0))
    with pytest.raises(StudyError, match=far.format(0, 1)):
        started(winch(), at(15.0) | {"states.turned.start": lierb.sampling.Constant(1.0)})
    study = started(winch(40.0), at(41.0))
    with pytest.raises(StudyError, match=far.format(7, 40)):
        study.batch(7, 3, lierb.sampling.Design(at(15.0), n=10))


def test_drawn_coordinates_of_a_counted_angle_change_the_pose_alone():
    """Their derivatives need those by pose0, and none by the start of the count."""
    study = started(winch(), {"drum.initial.coordinates": FAR}, sensitivities=["drum.pose0"])
    along = AlongParameters(
        study, study.design.draw(0, 5), {"drum.initial.coordinates": np.ones(1)}
    )
    change = along.along("drum.initial.coordinates")
    np.testing.assert_allclose(change[:, :, 0], np.tile([0, 0, 1, 0, 0, 0], (5, 1)), atol=1e-6)

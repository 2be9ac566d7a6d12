"""`lierb.gradient`: its adjoint against derivatives forwards, closed forms and differences.

Derivatives forwards (`with_respect_to`) are another algorithm on the same formulas; other tests
hold them against complex steps of other formulations. Both round differently: a gradient agrees
with them to rounding, which a run of some hundred steps amplifies.
"""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from derivatives.test_of_mechanisms import four_bar
from lierb.runs import adjoint

ROUNDING = 1e-11  # relative to the largest derivative of a parameter, and to 1
JOINT = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.02))
START = {"twist0": JOINT.twist(omega=(6.28, 3.14, 0.63)), "t_end": 0.2}
STEPS = {"dt": 2e-3}
WIDENED = 1e-8  # of a difference of sixth order, of numbers changed by 0.3 %


@lierb.observable
def aim(R, r, omega):
    return R[0, 2] * r[1] + omega[0] ** 2


@lierb.wrench(torque=0.3, rate=4.0)
def drive(t, R, r, omega, v, params):
    torque = params.torque * np.sin(params.rate * t) - 0.05 * omega[2] * np.abs(omega[2])
    return (0.0, 0.0, torque), (0.0, 0.0, 0.0)


@lierb.states(dissipated=0.0)
def losses(omega, states):
    return {"dissipated": 0.05 * np.abs(omega[2]) ** 3}


@lierb.observable
def lost(states):
    return states.dissipated


def top(mass=6.0, **more) -> lierb.Problem:
    inertia = np.broadcast_to(np.diag((0.2, 0.3, 0.35)), (*np.shape(mass), 3, 3))
    body = lierb.Body(
        mass, inertia, (0.01, 0.0, 0.02) if not more.pop("is_centred", 0) else (0,) * 3
    )
    spring = lierb.forces.spring_damper(
        ground_point=(0.3, 0.0, 0.2), stiffness=40.0, damping=0.5, length=0.1
    )
    given = {"forces": (spring, drive()), "observables": aim()} | more
    return lierb.Problem(body, JOINT, (0.3, 0.0, -9.81), **given)


def agree(problem, of, tolerance=ROUNDING, **run) -> lierb.analysis.adjoint.Gradient:
    """Compare all derivatives of all trajectories, and the values, with those forwards."""
    found = lierb.gradient(problem, of, **run)
    names = [*found.parts]
    forwards = lierb.integrate(problem, **run, with_respect_to=names)
    column = of if of == "energy" else f"{of}_final"
    if of == "energy":
        plain = lierb.integrate(problem, **run, save_at=[run["t_end"]], record="energy")
        values = plain.history[column].to_numpy()
    else:
        values = forwards.summary[column].to_numpy()
    assert np.abs(found.value - values).max() < tolerance * (1.0 + np.abs(values).max())
    assert len(names) > 8
    for name in names:
        expected = forwards.sensitivity(of, name)
        size = 1.0 + np.abs(expected).max()
        assert found[name].shape == expected.shape
        assert np.abs(found[name] - expected).max() < tolerance * size, name
    return found


# ---- truths ------------------------------------------------------------------------------------


@lierb.event(direction=-1, terminal=True, ground=0.0)
def landing(r, params):
    return r[2] - params.ground


@lierb.event(direction=1)
def passing(r):
    return r[2] - 0.4


@lierb.event(terminal=True, wall=100.0)
def arrival(r, params):
    return r[0] - params.wall


@lierb.observable(along=(1.0, 0.0, 0.0), share=0.5)
def reach(t, r, params):
    return params.along @ r + params.share * t


def ball(along=(1.0, 0.0, 0.0), share=0.5, ground=0.0) -> lierb.Problem:
    """Tests of throws have one problem, so that they share kernels."""
    return lierb.Problem(
        lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free(), (0.0, 0.0, -9.81),
        observables=reach(along=along, share=share),
        events=(passing(), arrival(), landing(ground=ground)),
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("options", [{"dt": 0.05}, {"rtol": 1e-9}])
def test_a_throw_has_the_derivatives_of_its_closed_form(options):
    # h = z + v t − g t²/2 of the centre of mass; a body that spins carries the frame's origin along
    speeds = np.array([[0, 0, 0, 0.5, 0, v] for v in (3.0, 1.0, 0.2)])
    problem = ball(along=(0.0, 0.0, 1.0), share=0.0, ground=-100.0)  # it never lands
    found = lierb.gradient(problem, "reach", twist0=speeds, t_end=0.5, **options)
    assert np.abs(found.value - (0.5 * speeds[:, 5] - 0.125 * 9.81)).max() < 1e-12
    twist = np.zeros((3, 6))
    twist[:, 5] = 0.5
    turned = np.zeros((3, 6))  # a velocity turns with its body: ε₂ × v
    turned[:, 1], turned[:, 5] = -0.5 * 0.5, 1.0
    turned[:, 0] = 0.0
    assert np.abs(found["twist0"] - twist).max() < 1e-12
    assert np.abs(found["pose0"] - turned).max() < 1e-12
    assert np.abs(found["gravity"] - (0.0, 0.0, 0.125)).max() < 1e-12
    assert np.abs(found["body.mass"]).max() < 1e-12


@pytest.mark.long
def test_gradients_are_those_of_differences():
    problem, widths = top(), np.array((-3.0, -2.0, -1.0, 1.0, 2.0, 3.0))
    weights = np.array((-1.0, 9.0, -45.0, 45.0, -9.0, 1.0)) / 60.0
    found = lierb.gradient(problem, "aim", ["body.mass", "omega0"], **START, **STEPS)
    runs = lierb.integrate(top(6.0 + 0.01 * widths), **START, **STEPS)
    difference = weights @ runs.summary["aim_final"].to_numpy() / 0.01
    assert abs(found["body.mass"][0, 0] - difference) < WIDENED * abs(difference)
    speeds = np.array((6.28, 3.14, 0.63)) + 0.01 * np.outer(widths, (0.0, 1.0, 0.0))
    runs = lierb.integrate(problem, twist0=JOINT.twist(omega=speeds), t_end=START["t_end"], **STEPS)
    difference = weights @ runs.summary["aim_final"].to_numpy() / 0.01
    assert abs(found["omega0"][0, 1] - difference) < WIDENED * abs(difference)


# ---- every kind of run -------------------------------------------------------------------------


RUNS = [
    STEPS,
    {"rtol": 1e-8},
    STEPS | {"solver": "saddle"},
    STEPS | {"update": "global"},
    STEPS | {"update": "ambient"},
    STEPS | {"method": "CF4"},
    STEPS | {"method": "Rodas4"},
    STEPS | {"method": "Verlet4"},
    STEPS | {"method": "RATTLie"},
    STEPS | {"method": "alpha2"},
    {"rtol": 1e-6, "method": "Rodas4"},
    STEPS | {"discontinuities": [0.0513, 0.1]},
]


@pytest.mark.long
@pytest.mark.parametrize("options", RUNS)
def test_every_method_and_formulation_has_its_adjoint(options):
    agree(top(), "aim", **START, **options)


@pytest.mark.long
def test_trajectories_with_steps_of_their_own_have_their_gradients():
    twists = JOINT.twist(omega=np.random.default_rng(4).normal(size=(11, 3)) * (1.0, 3.0, 6.0))
    run = {"twist0": twists, "t_end": 0.3, "rtol": 1e-7}
    problem = top(np.linspace(5.0, 7.0, 11), states=losses(), observables=lost())
    found = agree(problem, "lost", **run)
    for i in (0, 7):
        alone = lierb.gradient(problem.of_body(i), "lost", **run | {"twist0": twists[i]})
        for name, part in found.parts.items():
            assert np.array_equal(alone[name][0], part[i]), name
    one = lierb.gradient(problem, "lost", threads=1, **run)
    assert all(np.array_equal(one[name], part) for name, part in found.parts.items())


@pytest.mark.long
def test_bodies_on_decoupled_coordinates_have_their_adjoint():
    found = agree(top(is_centred=True), "energy", **START, **STEPS, cspace="SO3xR3")
    assert "body.com" not in found.parts
    with pytest.raises(lierb.errors.ArgumentError, match=r"body\.com cannot change"):
        lierb.gradient(top(is_centred=True), "aim", "body.com", **START, **STEPS, cspace="SO3xR3")


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        {"dt": 1e-3},
        {"dt": 1e-3, "stabilise": "project"},
        {"dt": 1e-3, "stabilise": lierb.baumgarte(5.0, 4.0)},
        {"dt": 1e-3, "cspace": "SE3"},
        {"rtol": 1e-8, "stabilise": "project"},
    ],
)
def test_loops_have_their_adjoint(options):
    mechanism, pose0, twist0 = four_bar()
    agree(mechanism, "energy", pose0=pose0, twist0=twist0, t_end=0.1, **options)


@pytest.mark.long
def test_a_conserved_energy_has_the_gradient_of_the_start():
    pendulum = lierb.Problem(
        lierb.Body(2.0, (0.05, 0.06, 0.02)), lierb.joints.revolute((0.0, 0.0, 0.4), axis=(0, 1, 0)),
        (0.0, 0.0, -9.81),
    )  # fmt: skip
    run = {"twist0": pendulum.joint.twist(omega=(0.0, 2.0, 0.0)), "dt": 5e-4}
    names = ["omega0", "gravity", "body.mass", "body.inertia", "joint.body_point"]
    first, last = (lierb.gradient(pendulum, "energy", names, **run, t_end=t) for t in (5e-4, 1.0))
    for name, part in last.parts.items():
        assert np.abs(part - first[name]).max() < 1e-10 * (1.0 + np.abs(part).max()), name
    # T = (J + m l²) ω²/2, by ω
    assert abs(last["omega0"][0, 1] - (0.06 + 2.0 * 0.16) * 2.0) < 1e-10


# ---- terminal events ---------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("options", [{"dt": 1e-2}, {"rtol": 1e-10}])
def test_objectives_at_terminal_events_change_with_the_end_time(options):
    # z = v t − g t²/2 = ground at t, and the objective is u t + t/2; the last throw flies on.
    speeds = np.array((3.0, 1.0, 20.0))
    twists = np.array([[0, 0, 0, 2.0, 0, v] for v in speeds])
    found = lierb.gradient(ball(), "reach", twist0=twists, t_end=1.0, **options)
    ends = np.minimum(2.0 * speeds / 9.81, 1.0)
    assert np.abs(found.value - 2.5 * ends).max() < 1e-9
    lands = ends < 1.0
    by_speed = np.where(lands, 2.5 * 2.0 / 9.81, 0.0)
    by_gravity = np.where(lands, 2.5 * ends / 9.81, 0.0)  # t = −2 v/g₃
    by_ground = np.where(lands, -2.5 / speeds, 0.0)
    assert np.abs(found["twist0"][:, 5] - by_speed).max() < 1e-9
    assert np.abs(found["twist0"][:, 3] - ends).max() < 1e-9
    assert np.abs(found["gravity"][:, 2] - by_gravity).max() < 1e-9
    assert np.abs(found["landing.ground"][:, 0] - by_ground).max() < 1e-9
    assert np.abs(found["reach.share"][:, 0] - ends).max() < 1e-9
    assert not found["arrival.wall"].any()


@pytest.mark.long
def test_the_time_of_a_terminal_event_has_a_gradient():
    """t = 2 v/g: ∂t/∂v = 2/g, ∂t/∂g₃ = t/g, ∂t/∂ground = −1/v; the last throw flies on."""
    speeds = np.array((3.0, 1.0, 20.0))
    twists = np.array([[0, 0, 0, 2.0, 0, v] for v in speeds])
    found = lierb.gradient(ball(), "t", twist0=twists, t_end=1.0, rtol=1e-10)
    lands = np.array((1.0, 1.0, 0.0))
    assert np.abs(found.value - np.minimum(2.0 * speeds / 9.81, 1.0)).max() < 1e-12
    assert np.abs(found["twist0"][:, 5] - lands * 2.0 / 9.81).max() < 1e-10
    assert np.abs(found["gravity"][:, 2] - lands * found.value / 9.81).max() < 1e-10
    assert np.abs(found["landing.ground"][:, 0] + lands / speeds).max() < 1e-10
    assert not found["twist0"][2].any()


@pytest.mark.long
def test_terminal_events_of_a_top_have_derivatives_forwards():
    @lierb.event(terminal=True, angle=-0.2)
    def tips(R, params):
        return R[2, 2] - params.angle

    # The end of the last step is its continuous extension forwards, and a step of its length here.
    agree(top(events=tips()), "aim", 1e-8, **START | {"t_end": 2.0}, rtol=1e-11)


# ---- memory and failures -----------------------------------------------------------------------


@pytest.mark.long
def test_states_that_are_made_again_change_no_bit(monkeypatch):
    whole = lierb.gradient(top(), "aim", **START, **STEPS)
    monkeypatch.setattr(adjoint, "MOST_KEPT", 0)
    parts = lierb.gradient(top(), "aim", **START, **STEPS)
    assert all(np.array_equal(whole[name], part) for name, part in parts.parts.items())


@pytest.mark.long
def test_more_steps_than_foreseen_are_noted_in_a_second_run(monkeypatch):
    run = START | {"rtol": 1e-8, "t_end": 0.3}
    whole = lierb.gradient(top(), "aim", **run)
    first = adjoint.engine.integrate
    rooms = []

    def integrate(*arguments, step_times, **more):
        rooms.append(len(step_times))
        return first(*arguments, step_times=step_times, **more)

    monkeypatch.setattr(adjoint.engine, "integrate", integrate)
    monkeypatch.setattr(adjoint, "LEAST_ROOM", 3)
    monkeypatch.setattr(adjoint, "FIRST_STEPS", 3)
    again = lierb.gradient(top(), "aim", **run)
    assert len(rooms) == 4  # of the run, and of that with half the steps
    assert rooms[0] == rooms[2] == 3 < rooms[1] < rooms[3]
    assert all(np.array_equal(whole[name], part) for name, part in again.parts.items())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "speed"),
    [
        (STEPS, 1e60),
        pytest.param({"rtol": 1e-8, "max_steps": 100}, 1e6, marks=pytest.mark.long),
    ],
)
def test_a_failed_trajectory_has_no_gradient_and_leaves_the_others_alone(options, speed):
    speeds = np.array(((6.28, 3.14, 0.63), (speed, speed, 0.0), (1.0, 2.0, 3.0)))
    run = START | options
    with pytest.warns(lierb.errors.FailedTrajectoryWarning, match="1 trajectory failed and has no"):
        found = lierb.gradient(top(), "aim", **run | {"twist0": JOINT.twist(omega=speeds)})
    alone = lierb.gradient(top(), "aim", **run)
    assert np.isnan(found.value).tolist() == [False, True, False]
    assert np.isnan(found["body.mass"][1]).all()
    assert np.array_equal(found["body.mass"][0], alone["body.mass"][0])


# ---- arguments ---------------------------------------------------------------------------------


def test_an_unknown_number_is_refused_by_name():
    with pytest.raises(lierb.errors.UnknownNameError, match="of='speed' is unknown; choose from"):
        lierb.gradient(top(), "speed", **START, **STEPS)


def test_options_that_are_none_are_refused():
    with pytest.raises(lierb.errors.UnknownNameError, match="option='save_at' is unknown"):
        lierb.gradient(top(), "aim", **START, **STEPS, save_at=[0.1])
    with pytest.raises(lierb.errors.UnknownNameError, match=r"with_respect_to='body\.size'"):
        lierb.gradient(top(), "aim", "body.size", **START, **STEPS)


@lierb.event(terminal=True)
def fallen(R):
    return R[0, 0] - 0.5


@lierb.observable
def swing(omega, R):
    return omega[1] ** 2 + R[0, 2]


def chain(**more) -> lierb.Mechanism:
    first = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(-0.1, 0.0, 0.0))
    second = lierb.joints.revolute(
        axis=(0.1, 1.0, 0.0), body_point=(-0.1, 0.0, 0.0), ground_point=(0.1, 0.0, 0.0)
    )
    upper = lierb.Link("upper", lierb.bodies.rod(0.2, 0.01, mass=0.3), first)
    lower = lierb.Link("lower", lierb.bodies.rod(0.2, 0.01, mass=0.4), second, "upper")
    observed = {"observables": swing().on("lower")} | more
    return lierb.Mechanism([upper, lower], gravity=(0.0, 0.0, -9.81), **observed)


@pytest.mark.slow
@pytest.mark.parametrize("of", ["swing", pytest.param("energy", marks=pytest.mark.long)])
def test_looped_code_has_the_gradients_of_unrolled_code(of):
    mechanism = chain()
    start = {"twist0": mechanism.twist({"upper": 1.0, "lower": -2.0})}
    run = start | {"dt": 0.01, "t_end": 0.3}
    ahead = lierb.gradient(mechanism, of, solver="looped", **run)
    back = lierb.gradient(mechanism, of, solver="unrolled", **run)
    assert ahead.value == pytest.approx(back.value, rel=1e-12)
    assert ahead.parts.keys() == back.parts.keys()
    for name, part in back.parts.items():
        size = max(np.abs(part).max(), 1.0)
        assert ahead[name] == pytest.approx(part, abs=1e-10 * size), name


def test_the_energy_at_an_event_is_refused_in_looped_code_with_loops():
    plain, pose0, _ = four_bar()
    closed = lierb.Mechanism(plain.links, loops=plain.loops, events=fallen().on("rocker"))
    with pytest.raises(lierb.errors.ArgumentError, match="looped code saves the energy at t_end"):
        lierb.gradient(closed, "energy", pose0=pose0, dt=0.1, t_end=0.2, solver="looped")


def test_a_start_off_its_joint_is_refused():
    with pytest.raises(lierb.errors.TwistError):
        lierb.gradient(top(), "aim", twist0=(0, 0, 0, 1, 0, 0), **STEPS, t_end=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("options", [STEPS, pytest.param({"rtol": 1e-8}, marks=pytest.mark.long)])
def test_warnings_of_a_start_point_to_the_callers_line(options):
    twist = np.add(JOINT.twist(omega=(1.0, 2.0, 3.0)), (0.0, 0.0, 0.0, 0.1, 0.0, 0.0))
    run = {"twist0": twist, "t_end": 0.2, "check": "warn"} | options
    plain = lierb.Problem(top().body, JOINT, top().gravity)
    with pytest.warns(lierb.errors.InconsistentStateWarning) as told:
        lierb.gradient(plain, "energy", "body.mass", **run)
    assert [each.filename for each in told] == [__file__]


@pytest.mark.slow
def test_a_gradient_describes_itself():
    found = lierb.gradient(top(), "aim", "body.mass", **START, **STEPS)
    assert repr(found).startswith("gradient of aim, 1 trajectory\n  body.mass")
    assert "per kg" in repr(found)
    with pytest.raises(lierb.errors.UnknownNameError, match="parameter='gravity'"):
        found["gravity"]

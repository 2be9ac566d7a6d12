"""Derivatives of trees in memory: beside the formulas of unrolled code on dual numbers of floats,
differences, and what does not depend on the number of directions.
"""

import numpy as np
import pytest
from mechanisms.shared import stepped
from mechanisms.test_looped_constraints import chain, driven
from mechanisms.test_tree_loop import SIX, start_of, tree_of

import lierb
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.systems.derivatives import moved_in_body
from lierb.runs.options import Options
from lierb.runs.parameters import all_directions, chosen_parameters
from lierb.runs.start_directions import Start
from lierb.runs.starts import ready

DT, STEPS = 2e-3, 10
FORCES = [
    lierb.forces.torsional_spring(stiffness=2.0, damping=0.1).on("link0"),
    lierb.forces.drag(linear=0.2, angular=0.1).on("link3"),
]
NAMES = (
    "link0.twist0", "link2.pose0", "gravity", "link0.body.mass", "link1.body.com",
    "link4.body.inertia", "link3.joint.body_point", "link5.joint.parent_point",
    "link3.joint.pitch", "link0.torsional_spring.stiffness", "link3.drag.linear",
)  # fmt: skip


def by_formulas(mechanism, start, names, trajectory, stabilise=None):
    """Derivatives of each link's pose and twist after ten steps, [number, direction]."""
    options = Options.of(
        mechanism, dt=DT, t_end=DT * STEPS, method="RK4", solver="unrolled", stabilise=stabilise
    )
    run = ready(mechanism, options, **start)
    at = Start(mechanism, start["pose0"], start["twist0"], 0.0)
    directions = all_directions(chosen_parameters(mechanism, names), at)
    numbers = run.inputs.numbers(trajectory)
    seeds = [np.zeros(len(numbers)) for _ in directions]
    for seed, given in zip(seeds, directions, strict=True):
        for name, array in given.items():
            seed[run.inputs.columns[name]] = array[trajectory if len(array) > 1 else 0]
    numbers = [Dual(x, tuple(parts)) for x, parts in zip(numbers, zip(*seeds))]
    system, constants, state = stepped(run, numbers, DT, STEPS)
    found = system.in_user_frames(constants, numbers, state)
    return {
        name: np.array(moved_in_body(x, len(directions)), float).reshape(12, len(directions))
        for name, x in zip(mechanism.names, found, strict=True)
    }


def looped(mechanism, start, names, **options):
    options = {"dt": DT, "t_end": DT * STEPS, "save_every": STEPS, "record": "state"} | options
    return lierb.integrate(mechanism, **start, solver="looped", with_respect_to=names, **options)


def agree(mechanism, start, names, **options):
    result = looped(mechanism, start, names, **options)
    count = len(result.summary)
    for trajectory in (0, count - 1):
        expected = by_formulas(mechanism, start, names, trajectory, **options)
        scale = max(np.abs(x).max() for x in expected.values())
        for link in mechanism.names:
            parts = [
                np.concatenate(
                    [result.sensitivity(f"{link}.{of}", name)[-1, trajectory] for name in names], -1
                )
                for of in ("pose", "twist")
            ]
            # rounding of ten steps in each of two ways, and of accelerations of 1e3
            np.testing.assert_allclose(
                np.concatenate(parts), expected[link], rtol=1e-10, atol=1e-11 * scale
            )
    return result


@pytest.mark.long
def test_derivatives_of_six_joints_are_those_of_unrolled_formulas():
    mechanism = tree_of(SIX, forces=FORCES)
    agree(mechanism, start_of(mechanism), NAMES)


@pytest.mark.long
@pytest.mark.parametrize("stabilise", [None, "project", lierb.baumgarte(5.0, 4.0)])
def test_derivatives_of_loops_are_those_of_unrolled_formulas(stabilise):
    mechanism, start = chain(6)
    names = ("gravity", "link2.body.mass", "link5.body.com", "link1.joint.body_point")
    agree(mechanism, start, names, stabilise=stabilise)


@pytest.mark.long
def test_derivatives_through_motors_and_constraints_are_those_of_unrolled_formulas():
    mechanism, start = driven()
    names = ("gravity", "link1.body.mass", "loop0.torsional_spring.stiffness")
    agree(mechanism, start, names, stabilise=lierb.baumgarte(5.0, 4.0))


@lierb.event(terminal=True, level=-100.0)
def passes(r, params):
    return r[0] - params.level


@lierb.observable
def away(r):
    return r[0]


def arm(stiffness=20.0, mass=0.7):
    """Ten links of an arm, springs in two of its joints, and a plane that its end never reaches."""
    links = [
        lierb.Link(
            f"link{i}", lierb.bodies.rod(0.3, 0.01, mass=mass if i == 4 else 0.5),
            lierb.joints.revolute(
                axis=(0.0, 1.0, 0.0) if i % 2 else (1.0, 0.0, 0.0), body_point=(0.0, 0.0, 0.15),
                parent_point=(0.0, 0.0, -0.15 if i else 0.0),
            ),
            f"link{i - 1}" if i else "ground",
        )
        for i in range(10)
    ]  # fmt: skip
    springs = [
        lierb.forces.torsional_spring(stiffness=stiffness).on(name) for name in ("link2", "link7")
    ]
    return lierb.Mechanism(
        links, gravity=(0.0, 0.0, -9.81), forces=springs, events=passes().on("link9"),
        observables=away().on("link9"),
    )  # fmt: skip


STIFFNESS = "link7.torsional_spring.stiffness"


def moving(mechanism):
    pose0 = mechanism.pose({f"link{i}": 0.2 for i in range(10)})
    return {"pose0": pose0, "twist0": mechanism.twist({"link0": 1.0, "link9": -2.0}, pose0)}


@pytest.mark.long
def test_derivatives_of_an_arm_are_those_of_differences_and_keep_its_energy():
    names = ["link4.body.mass", STIFFNESS, "link9.twist0"]
    options = {"rtol": 1e-11, "method": "Tsit5", "t_end": 0.5}
    result = lierb.integrate(
        arm(), **moving(arm()), **options, save_at=(0.0, 0.5), record=("state", "energy"),
        with_respect_to=names,
    )  # fmt: skip
    # E(t) is E(0), whatever the parameters are: to the tolerance of the run
    for name in names:
        energy = result.sensitivity("energy", name)[:, 0]
        np.testing.assert_allclose(energy[1], energy[0], rtol=1e-7, atol=1e-7)
    for name, step in ((names[0], 1e-4), (STIFFNESS, 1e-3)):
        middle = {names[0]: 0.7, STIFFNESS: 20.0}[name]
        model = arm().with_({name: [middle - step, middle + step]})
        ends = lierb.integrate(model, **moving(arm()), **options, with_respect_to=names).summary
        for link in ("link0", "link9"):
            rates = np.array(ends[f"{link}.omega"].to_pylist())
            found = result.sensitivity(f"{link}.twist", name)[1, 0, :3, 0]
            expected = (rates[1] - rates[0]) / (2.0 * step)
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)  # of differences


@pytest.mark.long
def test_statistics_have_the_derivatives_of_differences():
    options = {"dt": 2e-3, "t_end": 0.5}
    result = lierb.integrate(arm(), **moving(arm()), **options, with_respect_to=STIFFNESS)
    model = arm().with_({STIFFNESS: [20.0 - 1e-3, 20.0 + 1e-3]})
    ends = lierb.integrate(model, **moving(arm()), **options).summary
    for of in ("away_min", "away_max", "away_mean"):
        less, more = ends[of].to_numpy()
        expected = (more - less) / 2e-3
        np.testing.assert_allclose(result.sensitivity(of, STIFFNESS)[0, 0], expected, rtol=1e-6)


@pytest.mark.long
def test_values_of_a_run_with_derivatives_keep_their_bits():
    """test_of_runs.py shows it of unrolled code."""
    options = {"rtol": 1e-11, "method": "Tsit5", "t_end": 0.5, "save_at": (0.0, 0.5)}
    plain = lierb.integrate(arm(), **moving(arm()), **options)
    result = lierb.integrate(arm(), **moving(arm()), **options, with_respect_to=STIFFNESS)
    for name in arm().names:
        assert plain.summary[f"{name}.omega"].equals(result.summary[f"{name}.omega"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "others",
    [["link4.body.mass", "link0.twist0"], pytest.param([], marks=pytest.mark.long)],
    ids=["others", "none"],
)
def test_a_direction_does_not_depend_on_the_others_nor_its_place_on_the_batch(others):
    model, start = arm().with_({STIFFNESS: np.linspace(10.0, 30.0, 9)}), moving(arm())
    options = {
        "rtol": 1e-11,
        "method": "Tsit5",
        "t_end": 0.1,
        "record": ("state", "energy"),
        "save_at": (0.1,),
    }
    whole = lierb.integrate(model, **start, **options, with_respect_to=[STIFFNESS, "gravity"])
    names = [*others, STIFFNESS]
    alone = lierb.integrate(model.of_body(7), **start, **options, with_respect_to=names)
    found = whole.sensitivity("link9.twist", STIFFNESS)[:, 7]
    np.testing.assert_array_equal(found, alone.sensitivity("link9.twist", STIFFNESS)[:, 0])


@pytest.mark.slow
def test_ends_at_events_change_as_by_differences():
    """A link crosses a plane: time and state there, by a spring and by the place of the plane."""
    model = arm().with_({"link9.passes.level": -0.1})
    options = {"rtol": 1e-11, "method": "Tsit5", "t_end": 2.0}
    names = (STIFFNESS, "link9.passes.level")
    result = lierb.integrate(model, **moving(model), **options, with_respect_to=names)
    for name, middle, step in ((names[0], 20.0, 1e-3), (names[1], -0.1, 1e-5)):
        changed = model.with_({name: [middle - step, middle + step]})
        ends = lierb.integrate(changed, **moving(model), **options, with_respect_to=names).summary
        assert ends["status"].to_pylist() == ["event", "event"]
        times = ends["t"].to_numpy()
        rates = np.array(ends["link3.omega"].to_pylist())
        found = result.sensitivity("t", name)[0, 0]
        assert found == pytest.approx((times[1] - times[0]) / (2.0 * step), rel=1e-5)
        expected = (rates[1] - rates[0]) / (2.0 * step)
        (row,) = result.sensitivities.events.to_pylist()
        assert row[f"t/{name}"][0] == pytest.approx(found, rel=1e-12)
        at_event = np.array(row[f"link3.twist/{name}"])
        twist = result.sensitivity("link3.twist", name)[0, :, 0]
        np.testing.assert_allclose(at_event, twist, rtol=1e-12, atol=1e-12)
        twist = twist[:3]
        np.testing.assert_allclose(twist, expected, rtol=1e-5, atol=1e-6)  # of differences

"""`with_`: models with other numbers and further elements, against models built anew."""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from lierb.errors import ArgumentError, InertiaError, UnknownNameError

ROD = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
HINGE = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}
MASSES = np.array([1.0, 1.5, 2.0, 2.5])
GRAVITY = (0.0, 0.0, -9.81)


def spring(stiffness=4.0):
    return lierb.forces.torsional_spring(stiffness=stiffness)


def pendulum(rod=ROD, point=(0.0, 0.0, -0.25), stiffness=4.0, gravity=GRAVITY, forces=()):
    links = [
        lierb.Link("upper", ROD, lierb.joints.revolute(**HINGE)),
        lierb.Link("lower", rod, lierb.joints.revolute(**HINGE, parent_point=point), "upper"),
    ]
    return lierb.Mechanism(links, gravity=gravity, forces=[spring(stiffness).on("lower"), *forces])


def rates(model):
    """End of a short run from one start in coordinates."""
    pose0 = model.pose({"upper": 0.3, "lower": -0.5})
    result = lierb.integrate(model, pose0=pose0, t_end=0.05, dt=0.01)
    return np.concatenate([result.end["twist0"][name] for name in model.names], axis=-1)


def test_a_four_by_four_number_of_a_function_is_no_pose():
    @lierb.wrench(gains=np.eye(4))
    def steered(t, R, r, omega, v, params):
        return params.gains[0, :3], params.gains[1, :3]

    body = lierb.Problem(ROD, lierb.joints.free(), forces=steered())
    changed = body.with_({"steered.gains": 2.0 * np.ones((4, 4))})
    np.testing.assert_array_equal(changed.forces[0].parameters["gains"], 2.0 * np.ones((4, 4)))


@pytest.mark.slow
def test_with_numbers_equals_the_model_built_so():
    rods = lierb.Body(MASSES, ROD.inertia[None])
    points = np.stack([np.zeros(4), np.zeros(4), [-0.25, -0.2, -0.3, -0.1]], axis=-1)
    stiffness, gravity = [1.0, 2.0, 3.0, 4.0], (0.0, 0.0, -1.62)
    damper = lierb.forces.joint_friction(viscous=0.1).on("upper")
    changed = pendulum().with_(
        {
            "lower.body.mass": MASSES,
            "lower.joint.parent_point": points,
            "lower.torsional_spring.stiffness": stiffness,
            "gravity": gravity,
        },
        forces=damper,
    )
    built = pendulum(rods, points, stiffness, gravity, [damper])
    assert changed.batch_size() == 4
    for name, array in built.inputs.items():
        np.testing.assert_array_equal(changed.inputs[name], array)
    np.testing.assert_array_equal(rates(changed), rates(built))


def test_original_stays():
    original = pendulum()
    original.with_({"gravity": (0.0, 0.0, 0.0)}, forces=spring().on("upper"))
    assert original.gravity.tolist() == [0.0, 0.0, -9.81]
    assert len(original.forces) == 1


def test_problem_has_names_without_a_link():
    top = lierb.Problem(ROD, lierb.joints.screw(pitch=0.1), forces=[spring(), spring(2.0)])
    changed = top.with_(
        {
            "body.inertia": (0.1, 0.2, 0.25),
            "joint.pitch": [0.2, 0.3],
            "torsional_spring_2.stiffness": 7.0,
            "joint.body_point": (0.0, 0.1, 0.0),
            "joint.ground_point": (1.0, 0.0, 0.0),
        }
    )
    assert changed.body.inertia.diagonal().tolist() == [0.1, 0.2, 0.25]
    assert changed.joint.pitch.tolist() == [0.2, 0.3]
    assert [float(f.parameters["stiffness"]) for f in changed.forces] == [4.0, 7.0]
    built = lierb.joints.screw((0.0, 0.1, 0.0), (1.0, 0.0, 0.0), pitch=[0.2, 0.3])
    np.testing.assert_array_equal(changed.joint.body_frame, built.body_frame)
    np.testing.assert_array_equal(changed.joint.ground_frame, built.ground_frame)


def test_principal_moments_of_three_bodies_are_a_batch():
    moments = [[0.1, 0.2, 0.25]] * 2
    changed = pendulum().with_({"upper.body.inertia": moments})
    assert changed.links[0].body.inertia.shape == (2, 3, 3)


def test_functions_with_states_stay_bound():
    @lierb.states(wound=0.0)
    def winding(omega, states):
        return {"wound": omega[1] - states.wound}

    model = lierb.Problem(ROD, lierb.joints.revolute(**HINGE), states=winding(wound=0.5))
    changed = model.with_({"winding.wound": [1.0, 2.0], "body.mass": 2.0}, forces=spring())
    assert changed.states[0].parameters["initial.wound"].tolist() == [1.0, 2.0]
    assert changed.signals == model.signals


@pytest.mark.parametrize(
    ("numbers", "error", "message"),
    [
        ({"lower.body.mas": 1.0}, UnknownNameError, "lower.body.mass"),
        ({"lower.body.mass": -1.0}, InertiaError, r"lower: mass is -1\.0 kg"),
        ({"lower.body.mass": [1.0, 2.0], "gravity": [GRAVITY] * 3}, ArgumentError, "gravity"),
        ({"lower.body.com": (1.0, 2.0)}, ArgumentError, r"lower\.body\.com"),
        ({"lower.torsional_spring.stiffness": -2.0}, ArgumentError, "torsional_spring: stiffness"),
        ({"lower.joint.body_frame": np.eye(3)}, ArgumentError, r"lower\.joint\.body_frame"),
        (
            {"lower.joint.body_point": (0.0, 0.0, 0.1), "lower.joint.body_frame": np.eye(4)},
            ArgumentError,
            "give one of them",
        ),
        ([("gravity", 1.0)], ArgumentError, "expected a dictionary"),
    ],
)
def test_refusals_name_the_number(numbers, error, message):
    with pytest.raises(error, match=message):
        pendulum().with_(numbers)


def test_limits_keep_their_order():
    limit = lierb.forces.joint_limit(lower=-0.5, upper=0.5, stiffness=10.0)
    model = lierb.Problem(ROD, lierb.joints.revolute(**HINGE), forces=limit)
    with pytest.raises(ArgumentError, match=r"joint_limit: lower is 0\.7, above upper"):
        model.with_({"joint_limit.lower": 0.7})


CHANGES = {
    "heavier": {"mass": 5.0},
    "lighter": {"mass": [0.5, 3.0]},
    "moved": {"com": (0.1, 0.0, 0.6)},
    "given": {"mass": 3.0, "inertia": (0.2, 0.2, 0.05)},
    "batch": {"com": [(0.0, 0.0, 0.1), (0.0, 0.1, 0.6), (0.0, 0.0, 0.0)], "mass": 1.5},
}


@pytest.mark.parametrize("is_mechanism", [True, False])
@pytest.mark.parametrize("name", CHANGES)
def test_inertia_about_the_centre_of_mass_stays(name, is_mechanism):
    """The changed body is the one that `Body` makes with about="com"."""
    given = {"mass": 2.0, "inertia": (0.1, 0.1, 0.02), "com": (0.0, 0.0, 0.5)}
    numbers = CHANGES[name]
    body, joint = lierb.Body(**given, about="com"), lierb.joints.revolute()
    model = lierb.Problem(body, joint)
    if is_mechanism:
        model = lierb.Mechanism(lierb.Link("arm", body, joint))
    prefix = "arm.body." if is_mechanism else "body."
    (found,) = model.with_({prefix + k: x for k, x in numbers.items()}, about="com").bodies
    expected = lierb.Body(**given | numbers, about="com")
    np.testing.assert_allclose(found.inertia, expected.inertia, rtol=1e-14, atol=1e-16)
    np.testing.assert_array_equal(found.mass, expected.mass)
    np.testing.assert_array_equal(found.com, expected.com)


def test_inertia_about_the_origin_stays_by_default():
    body = lierb.Body(2.0, (0.1, 0.1, 0.02), com=(0.0, 0.0, 0.5), about="com")
    arm = lierb.Problem(body, lierb.joints.revolute())
    assert arm.with_({"body.mass": 2.2}).body.inertia.tolist() == body.inertia.tolist()
    with pytest.raises(InertiaError, match=r'about="com"'):
        arm.with_({"body.mass": 3.0})
    with pytest.raises(UnknownNameError, match="about="):
        arm.with_({"body.mass": 3.0}, about="centre")

"""Bad input: a ValueError of lierb's that names the argument and the body, before anything runs."""

import datetime
import decimal
import fractions
import itertools
import math
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import lierb
from lierb import errors, joints
from lierb.errors import (
    ArgumentError,
    InconsistentStateWarning,
    InertiaError,
    LierbError,
    PoseError,
    TimeGridError,
    TwistError,
    UnknownNameError,
)
from lierb.kernels.loops.job import UNSEEN
from lierb.kernels.loops.record import load_given
from lierb.kernels.loops.tables import store_start
from lierb.kernels.stepping.clock import time_of
from lierb.support.arrays import as_numbers

POINT = (-0.15, 0.0375, 0.0)
BOX = (0.0126563, 0.0468281, 0.0569531)
COUNT = 20  # bodies in a batch
SECOND = np.timedelta64(1, "s")  # an integer to NumPy


class DriverReached(Exception):
    """The arguments passed every check."""


@pytest.fixture(autouse=True)
def stop_before_running(monkeypatch):
    """Nothing in this file shall run a step, or compile: a stub checks starts in plain Python."""

    def stub(run, chunk, begin, end):
        if begin == UNSEEN:
            for body in range(chunk.start, chunk.stop):
                numbers = np.array(run.inputs.numbers(body))[:, None]
                with np.errstate(all="ignore"):
                    time = time_of(run.times, 0)
                    given = load_given(run.plan, numbers, time)
                    store_start(run.plan, given, numbers, run.output.summary, body, time)
        if end > 0 and (begin != UNSEEN or run.output.starts(chunk.start, chunk.stop).all()):
            raise DriverReached
        return 1.0

    monkeypatch.setattr(lierb.runs.engine.BlockRun, "call", stub)
    monkeypatch.setattr(lierb.runs.engine, "_pace", lambda plan, dt: lierb.runs.engine._Pace())
    monkeypatch.setattr(lierb.runs.engine, "FIRST_CALL_BLOCK_STEPS", 0)  # one step, then the others


def spherical_top(body=None, joint=None, gravity=(0.0, 0.0, 0.0)):
    return lierb.Problem(
        body or lierb.Body(6.075, BOX), joint or joints.spherical(POINT), gravity=gravity
    )


def integrate(problem=None, **given):
    """`lierb.integrate` with arguments that pass, but for those given."""
    problem = problem or spherical_top()
    arguments = {"twist0": np.zeros(6), "dt": 1e-2, "t_end": 1.0} | given
    return lierb.integrate(problem, **arguments)


def repeated(value, count=COUNT):
    return np.tile(np.asarray(value, dtype=float), (count, *(1,) * np.ndim(value)))


def with_body(batch, body, value):
    """The batch with one member replaced."""
    changed = np.array(batch, dtype=float)
    changed[body] = value
    return changed


def test_good_arguments_reach_the_driver():
    with pytest.raises(DriverReached):
        integrate(spherical_top(gravity=(0, 0, -9.81)), save_every=10, record=("state",))


def test_errors_are_value_errors():
    classes = [
        e
        for e in vars(errors).values()
        if isinstance(e, type) and e.__name__ not in ("ForkError", "MissingExtraError")
    ]
    raised = [e for e in classes if issubclass(e, Exception) and not issubclass(e, Warning)]
    assert len(raised) >= 7
    assert all(issubclass(e, LierbError) and issubclass(e, ValueError) for e in raised)


# ---------------------------------------------------------------- mass and inertia


@pytest.mark.parametrize("mass", [0.0, -1.0, -1e-300])
def test_body_rejects_a_mass_that_is_not_positive(mass):
    with pytest.raises(InertiaError, match=r"^mass is .* kg"):
        lierb.Body(mass, BOX)
    with pytest.raises(InertiaError, match=r"mass\[17\]"):
        lierb.Body(with_body(np.ones(COUNT), 17, mass), BOX)


BAD_INERTIAS = {
    "not symmetric": ([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]], "not symmetric"),
    "skew": ([[1, 0.1, 0], [-0.1, 1, 0], [0, 0, 1]], "not symmetric"),
    "symmetric to 1e-11 only": ([[1, 1e-11, 0], [0, 1, 0], [0, 0, 1]], "not symmetric"),
    "zero": (np.zeros((3, 3)), "positive definite"),
    "a zero moment": (np.diag([1.0, 1.0, 0.0]), "positive definite"),
    "a negative moment": (np.diag([1.0, -1.0, 1.0]), "positive definite"),
    "indefinite off the axes": ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "positive definite"),
    "triangle inequality": (np.diag([1.0, 2.0, 3.1]), "exceeds the sum"),
    "triangle inequality by 1e-11": (np.diag([1.0, 2.0, 3.0 + 1e-10]), "exceeds the sum"),
    "triangle inequality off the axes": ([[2, 1.5, 0], [1.5, 2, 0], [0, 0, 0.5]], "exceeds"),
}


@pytest.mark.parametrize(("inertia", "told"), BAD_INERTIAS.values(), ids=BAD_INERTIAS)
def test_body_rejects_an_inertia_that_no_body_has(inertia, told):
    with pytest.raises(InertiaError, match=rf"^inertia .*{told}"):
        lierb.Body(1.0, inertia)
    with pytest.raises(InertiaError, match=rf"^inertia\[17\] .*{told}"):
        lierb.Body(1.0, with_body(repeated(np.eye(3)), 17, inertia))


def test_body_rejects_principal_moments_that_no_body_has():
    with pytest.raises(InertiaError, match=r"^inertia .*1, 2, 4 kg m²"):
        lierb.Body(1.0, (4.0, 1.0, 2.0))
    with pytest.raises(InertiaError, match=r"inertia\[17\]"):
        lierb.Body(1.0, with_body(repeated(BOX), 17, (1, 2, 4)))


def test_body_explains_three_by_three_as_one_matrix():
    with pytest.raises(InertiaError, match="not as three bodies"):
        lierb.Body(1.0, [BOX, BOX, BOX])


@pytest.mark.parametrize("batched", [{"mass": [1, 2, 3]}, {"com": np.zeros((3, 3))}], ids=str)
@pytest.mark.parametrize("inertia", [np.diag(BOX), [BOX, BOX, BOX]], ids=["matrix", "moments"])
def test_body_refuses_three_by_three_for_three_bodies(batched, inertia):
    given = {"mass": 6.0} | batched
    both = r"inertia has shape \(3, 3\).*inertia\[None\].*inertia\[:, :, None\] \* np.eye\(3\)"
    with pytest.raises(ArgumentError, match=both):
        lierb.Body(inertia=inertia, **given)
    inertia = np.array(inertia)
    one, moments = inertia[None], inertia[:, :, None] * np.eye(3)  # as the message says
    if (inertia == inertia.T).all():
        assert lierb.Body(inertia=one, **given).inertia.shape == (1, 3, 3)
    else:
        np.testing.assert_array_equal(
            lierb.Body(inertia=moments, **given).inertia, repeated(np.diag(BOX), 3)
        )


def test_body_takes_three_by_three_for_any_other_number_of_bodies():
    assert lierb.Body(np.ones(4), np.diag(BOX)).inertia.shape == (3, 3)
    assert lierb.Body(np.ones(3), BOX).inertia.shape == (3, 3)


def test_matrix_for_three_bodies_is_that_of_each():
    """Shape that the message recommends: (1, 3, 3)."""
    masses = np.array((5.0, 6.0, 7.0))
    three = lierb.Problem(lierb.Body(masses, np.diag(BOX)[None]), joints.spherical(POINT))
    twist = three.joint.twist((1.0, 2.0, 3.0), point_velocity=(0.1, 0.2, 0.3))
    found = three.project(twist)
    for i in range(3):
        one = lierb.Problem(lierb.Body(masses[i], np.diag(BOX)), joints.spherical(POINT))
        np.testing.assert_array_equal(found[i], one.project(twist))


@pytest.mark.parametrize(
    "inertia",
    [(1.0, 2.0, 3.0), (0.234375, 0.46875, 0.234375), (1.0, 2.0, 3.0 * (1 + 0.9e-12))],
    ids=["a disc", "top of Brüls and Cardona", "within 1e-12"],
)
def test_body_allows_equality_in_the_triangle_inequality(inertia):
    lierb.Body(15.0, inertia)
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    if inertia[2] <= inertia[0] + inertia[1]:  # turned, it is an equality up to rounding
        turned = R @ np.diag(inertia) @ R.T
        lierb.Body(15.0, (turned + turned.T) / 2)


def test_body_checks_the_inertia_about_the_centre_of_mass():
    # a ball of 2 kg, 1 m away from the frame's origin: I = I_com + m (|c|² 1 − c cᵀ)
    about_origin = np.diag([0.1, 2.1, 2.1])
    lierb.Body(2.0, about_origin, com=(1.0, 0.0, 0.0))
    with pytest.raises(InertiaError, match="about the centre of mass"):
        lierb.Body(2.0, np.diag([0.1, 0.1, 0.1]), com=(1.0, 0.0, 0.0))


def test_body_takes_inertia_about_the_centre_of_mass():
    """Right: integrals over six equal masses at ±a e₁, ±b e₂, ±c e₃ around each body's com."""
    mass = np.array((1.5, 3.0))
    com, half = np.array([(0.1, -0.2, 0.4), (2.0, 0.0, -1.0)]), np.array((0.1, 0.2, 0.3))
    points = com[:, None] + np.concatenate([np.diag(half), -np.diag(half)])
    square = np.einsum("nij,nij->n", points, points)[:, None, None] * np.eye(3)
    right = mass[:, None, None] / 6.0 * (square - np.einsum("nki,nkj->nij", points, points))
    moments = mass[:, None] / 3.0 * (half @ half - half * half)
    body = lierb.Body(mass, moments, com, about="com")
    np.testing.assert_allclose(body.inertia, right, rtol=0, atol=1e-14)  # rounding of 15 kg m²
    alone = lierb.Body(mass[1], moments[1], com[1], about="com")
    np.testing.assert_array_equal(body.of(1).inertia, alone.inertia)
    # a plate, whose largest moment is the sum of the others, 1000 times its size away: the part
    # of a batch is checked again, after 1e-10 of that sum has been rounded off
    plate = lierb.Body(1.0, (1.0, 2.0, 3.0), (0.0, 1000.0, 500.0), about="com")
    assert plate.of(slice(0, 1)).com.shape == (3,)


def test_body_says_where_about_com_would_make_sense():
    given = {"mass": 2.0, "inertia": (0.1, 0.1, 0.1), "com": (1.0, 0.0, 0.0)}
    with pytest.raises(InertiaError, match=r'^inertia is not positive .*, give about="com"$'):
        lierb.Body(**given)
    lierb.Body(**given, about="com")
    impossible = {**given, "inertia": (0.1, 0.1, 0.3)}
    for about in ("origin", "com"):
        with pytest.raises(InertiaError) as caught:
            lierb.Body(**impossible, about=about)
        assert "about=" not in str(caught.value)
    with pytest.raises(UnknownNameError, match=r"^about='centre' is unknown"):
        lierb.Body(**given, about="centre")
    with pytest.raises(InertiaError, match=r"^inertia has no inertia about the origin"):
        lierb.Body(1e300, (1e-9, 1e-9, 1e-9), com=(1e10, 0.0, 0.0), about="com")


@pytest.mark.parametrize(
    ("mass", "inertia"),
    [(1e-308, (1.0, 1.0, 1.0)), (1e-300, (1e10, 1e10, 1e10)), (1.0, (1e308,) * 3)],
)
def test_body_blames_its_own_mass_and_inertia(mass, inertia):
    """√(tr Θ/2m) overflows: no pose, twist or joint is at fault."""
    with pytest.raises(InertiaError, match=r"^mass is .* beside an inertia of trace .* gyration"):
        lierb.Body(mass, inertia)
    fine = np.ones((3, 3, 1)) * np.eye(3)
    with pytest.raises(InertiaError, match=r"^mass\[2\] is"):
        lierb.Body([1.0, 2e-3, mass], [*fine[:2], np.diag(inertia)])
    lierb.Body(1e-300, (1e-303, 1e-303, 1e-303))


def test_body_names_the_offender_of_batched_masses():
    # each mass has its own Steiner term: only body 3 is too heavy for the shared inertia
    masses = with_body(np.ones(5), 3, 100.0)
    with pytest.raises(InertiaError, match=r"inertia\[3\]"):
        lierb.Body(masses, np.diag([0.1, 2.1, 2.1]), com=(1.0, 0.0, 0.0))


@pytest.mark.parametrize("argument", ["mass", "inertia", "com"])
def test_body_does_not_follow_later_changes_of_the_callers_array(argument):
    given = {"mass": np.ones(3), "inertia": repeated(np.eye(3), 3), "com": np.zeros((3, 3))}
    body = lierb.Body(**given)
    before = getattr(body, argument).copy()
    given[argument][...] = -5.0
    np.testing.assert_array_equal(getattr(body, argument), before)


def test_problem_does_not_follow_later_changes_of_the_callers_arrays():
    gravity, frame = np.zeros((2, 3)), np.eye(4)
    top = spherical_top(joint=joints.spherical(body_frame=frame), gravity=gravity)
    gravity[...], frame[...] = math.nan, math.nan
    np.testing.assert_array_equal(top.gravity, 0.0)
    np.testing.assert_array_equal(top.joint.body_frame, np.eye(4))


# ---------------------------------------------------------------- shapes

WRONG_SHAPES = {
    "mass of two axes": (lambda: lierb.Body(np.ones((2, 2)), BOX), "mass"),
    "mass is text": (lambda: lierb.Body("heavy", BOX), "mass"),
    "inertia of 2 moments": (lambda: lierb.Body(1.0, (1.0, 1.0)), "inertia"),
    "inertia is a number": (lambda: lierb.Body(1.0, 1.0), "inertia"),
    "inertia (3, 4)": (lambda: lierb.Body(1.0, np.ones((3, 4))), "inertia"),
    "inertia of two batch axes": (lambda: lierb.Body(1.0, np.ones((2, 2, 3, 3))), "inertia"),
    "inertia is ragged": (lambda: lierb.Body(1.0, [[1, 2, 3], [1]]), "inertia"),
    "com (2,)": (lambda: lierb.Body(1.0, BOX, com=(0.0, 0.0)), "com"),
    "gravity is a number": (lambda: spherical_top(gravity=-9.81), "gravity"),
    "gravity (3, 1)": (lambda: spherical_top(gravity=np.zeros((3, 1))), "gravity"),
    "body_point (2,)": (lambda: joints.spherical((1.0, 2.0)), "body_point"),
    "ground_point (4,)": (lambda: joints.spherical(ground_point=np.ones(4)), "ground_point"),
    "axis is a number": (lambda: joints.revolute(axis=3), "axis"),
    "axis is a name": (lambda: joints.revolute(axis="z"), "axis"),
    "slot (3, 3, 3)": (lambda: joints.pin_in_slot(slot=np.ones((3, 3, 3))), "slot"),
    "second_axis (1,)": (lambda: joints.universal(second_axis=[1]), "second_axis"),
    "pitch (2, 2)": (lambda: joints.screw(pitch=np.ones((2, 2))), "pitch"),
    "body_frame (3, 3)": (lambda: joints.spherical(body_frame=np.eye(3)), "body_frame"),
    "ground_frame (4,)": (lambda: joints.spherical(ground_frame=np.ones(4)), "ground_frame"),
    "omega (4,)": (lambda: joints.spherical().twist(np.ones(4)), "omega"),
    "point_velocity ()": (lambda: joints.spherical().twist((0, 0, 1), 1.0), "point_velocity"),
    "pose of twist (3, 3)": (lambda: joints.spherical().twist(pose=np.eye(3)), "pose"),
    "twist of project (3,)": (lambda: spherical_top().project((1, 2, 3)), "twist"),
    "pose of project (4, 3)": (lambda: spherical_top().project(np.ones(6), np.eye(4, 3)), "pose"),
    "twist0 (3,)": (lambda: integrate(twist0=(1, 2, 3)), "twist0"),
    "twist0 (6, 1)": (lambda: integrate(twist0=np.zeros((6, 1))), "twist0"),
    "twist0 of two batch axes": (lambda: integrate(twist0=np.zeros((2, 2, 6))), "twist0"),
    "pose0 (3, 3)": (lambda: integrate(pose0=np.eye(3)), "pose0"),
    "pose0 (3, 4)": (lambda: integrate(pose0=np.eye(3, 4)), "pose0"),
    "pose0 is text": (lambda: integrate(pose0="closed"), "pose0"),
}


@pytest.mark.parametrize(("call", "argument"), WRONG_SHAPES.values(), ids=WRONG_SHAPES)
def test_wrong_shape_names_the_argument(call, argument):
    with pytest.raises(ArgumentError, match=rf"\b{argument}\b"):
        call()


def test_wrong_shape_says_what_was_got_and_expected():
    with pytest.raises(ArgumentError, match=r"twist0 .*\(2, 3\).*\(6,\) or \(n, 6\)"):
        integrate(twist0=np.zeros((2, 3)))


FLIPPED = np.diag([1.0, 1.0, -1.0, 1.0])
SHEARED = np.eye(4) + np.diag([0.001, 0, 0], 1)
MISMATCHES = {
    "mass, inertia": (lambda: lierb.Body(np.ones(2), repeated(BOX, 4)), "mass", "inertia"),
    "inertia, com": (lambda: lierb.Body(1.0, repeated(BOX, 4), np.zeros((2, 3))), "inertia", "com"),
    "body_point, axis": (
        lambda: joints.revolute(np.zeros((2, 3)), axis=np.ones((4, 3))), "body_point", "axis",
    ),
    "body_point, ground_point": (
        lambda: joints.spherical(np.zeros((2, 3)), np.ones((4, 3))), "body_point|body_frame",
        "ground_point",
    ),
    "axis, slot": (
        lambda: joints.pin_in_slot(axis=repeated((0, 0, 1), 4), slot=repeated((1, 0, 0), 2)),
        "axis", "slot",
    ),
    "axis, pitch": (
        lambda: joints.screw(axis=repeated((0, 0, 1), 4), pitch=np.ones(2)), "axis|body_frame",
        "pitch",
    ),
    "frames": (
        lambda: joints.spherical(
            body_frame=repeated(np.eye(4), 2), ground_frame=repeated(np.eye(4), 4)
        ),
        "body_frame", "ground_frame",
    ),
    "body, joint": (
        lambda: spherical_top(lierb.Body(np.ones(2), BOX), joints.spherical(np.zeros((4, 3)))),
        "mass", "body_frame",
    ),
    "body, gravity": (
        lambda: spherical_top(lierb.Body(np.ones(2), BOX), gravity=np.zeros((4, 3))),
        "mass", "gravity",
    ),
    "gravity, twist0": (
        lambda: integrate(spherical_top(gravity=np.zeros((2, 3))), twist0=np.zeros((4, 6))),
        "gravity", "twist0",
    ),
    "pose0, twist0": (
        lambda: integrate(pose0=repeated(np.eye(4), 2), twist0=np.zeros((4, 6))), "pose0", "twist0",
    ),
    "omega, point_velocity": (
        lambda: joints.spherical().twist(np.ones((2, 3)), np.ones((4, 3))), "omega",
        "point_velocity",
    ),
    "omega, pose": (
        lambda: joints.spherical().twist(np.ones((2, 3)), pose=repeated(np.eye(4), 4)), "omega",
        "pose",
    ),
    "omega, joint": (
        lambda: joints.spherical(np.zeros((4, 3))).twist(np.ones((2, 3))), "omega",
        "body_frame|body_point",
    ),
    "twist, pose of project": (
        lambda: spherical_top().project(np.ones((2, 6)), repeated(np.eye(4), 4)), "twist", "pose",
    ),
    "twist of project, mass": (
        lambda: spherical_top(lierb.Body(np.ones(4), BOX)).project(np.ones((2, 6))), "twist",
        "mass",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("call", "one", "other"), MISMATCHES.values(), ids=MISMATCHES)
def test_batch_sizes_that_differ_name_both_arguments(call, one, other):
    with pytest.raises(ArgumentError, match=rf"\b({one})\b") as caught:
        call()
    told = str(caught.value)
    assert any(name in told for name in other.split("|"))
    assert "2" in told
    assert "4" in told


EMPTY = {
    "mass": lambda: integrate(spherical_top(lierb.Body(np.ones(0), BOX))),
    "inertia": lambda: integrate(spherical_top(lierb.Body(1.0, np.ones((0, 3))))),
    "twist0": lambda: integrate(twist0=np.zeros((0, 6))),
    "gravity": lambda: integrate(spherical_top(gravity=np.zeros((0, 3)))),
}


@pytest.mark.parametrize("argument", EMPTY)
def test_batch_of_no_bodies_names_the_argument(argument):
    with pytest.raises(ArgumentError, match=argument):
        EMPTY[argument]()


# ---------------------------------------------------------------- numbers that are none

NOT_FINITE = pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])


@NOT_FINITE
def test_not_finite_body_names_it(bad):
    with pytest.raises(LierbError, match=r"mass\[17\]"):
        lierb.Body(with_body(np.ones(COUNT), 17, bad), BOX)
    with pytest.raises(LierbError, match=r"inertia\[17, 1\]"):
        lierb.Body(1.0, with_body(repeated(BOX), (17, 1), bad))
    with pytest.raises(LierbError, match=r"com\[17, 2\]"):
        lierb.Body(1.0, BOX, with_body(np.zeros((COUNT, 3)), (17, 2), bad))


@NOT_FINITE
def test_not_finite_joint_names_it(bad):
    with pytest.raises(LierbError, match=r"body_point\[1\]"):
        joints.spherical((0.0, bad, 0.0))
    with pytest.raises(LierbError, match=r"axis\[17, 0\]"):
        joints.revolute(axis=with_body(repeated((0, 0, 1)), (17, 0), bad))
    with pytest.raises(LierbError, match="pitch"):
        joints.screw(pitch=bad)
    with pytest.raises(LierbError, match=r"body_frame\[17, 0, 3\]"):
        joints.spherical(body_frame=with_body(repeated(np.eye(4)), (17, 0, 3), bad))


@NOT_FINITE
def test_not_finite_state_names_it(bad):
    with pytest.raises(LierbError, match=r"gravity\[17, 2\]"):
        spherical_top(gravity=with_body(np.zeros((COUNT, 3)), (17, 2), bad))
    with pytest.raises(LierbError, match=r"twist0\[17, 4\]"):
        integrate(twist0=with_body(np.zeros((COUNT, 6)), (17, 4), bad))
    with pytest.raises(LierbError, match=r"pose0\[17, 1, 3\]"):
        integrate(pose0=with_body(repeated(np.eye(4)), (17, 1, 3), bad))


@NOT_FINITE
def test_not_finite_is_found_although_checks_are_off(bad):
    with pytest.raises(LierbError, match="twist0"):
        integrate(twist0=(bad, 0, 0, 0, 0, 0), check="off")


@pytest.mark.parametrize("value", [1j, np.array([1 + 1j])], ids=["number", "array"])
def test_complex_numbers_are_rejected(value):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # for most users warnings are no errors
        with pytest.raises(LierbError, match="mass"):
            lierb.Body(value, BOX)


class Quantity:
    """Quantity with a unit, as in pint and unyt."""

    units = "mm"

    def __array__(self, dtype=None, copy=None):
        return np.array(1.0)


def no_array(self, *_, **__):
    raise RuntimeError("on another device")


Unreadable = type("Unreadable", (), {"__array__": no_array})

NO_NUMBERS = {
    "text": "1.0", "texts": ["1.0", "2.0"], "text as object": np.array(["1.0"], object),
    "bytes": b"1.0", "byte array": bytearray(b"12"), "bytes seen": memoryview(b"12"),
    "flag": True, "flags": np.ones(2, bool), "flag among numbers": [1.0, np.True_],
    "nothing": None, "nothing among numbers": [1.0, None],
    "date": datetime.date(2024, 1, 1), "dates": np.array(["2024-01-01"], "M8[D]"),
    "time span": datetime.timedelta(1), "time spans": np.ones(2, "m8[s]"),
    "set": {1.0, 2.0}, "keys": {1.0: 0, 2.0: 0}.keys(), "values": {"a": 1.0}.values(),
    "generator": (x for x in (1.0, 2.0)), "ragged": [[1.0], [1.0, 2.0]],
    "fields": np.zeros(2, [("x", "f8")]), "beyond float64": 10**400,
    "beyond float64, of NumPy": np.array(["1e400"]).astype(np.longdouble),
    "not to be printed": 10**5000, "masked": np.ma.masked, "masked entry": [1.0, np.ma.masked],
    "masked array": np.ma.masked_equal([1.0, 2.0], 2.0),
    "masked arrays": [np.ma.masked_equal([1.0, 2.0], 2.0)],
    "quantity": Quantity(), "quantities": [Quantity(), Quantity()], "unreadable": Unreadable(),
}  # fmt: skip


@pytest.mark.parametrize("value", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_what_is_no_number_is_refused(value):
    with pytest.raises(LierbError, match=r"^mass ") as told:
        lierb.Body(value, BOX)
    assert len(str(told.value)) < 400


NUMBERS = {
    "integers": [1, 2], "of another width": np.ones(2, "f2"), "of another order": np.ones(2, ">f8"),
    "read only": np.broadcast_to(1.0, (2,)), "strided": np.ones(4)[::2],
    "nothing masked": np.ma.ones(2),
    "fractions": [fractions.Fraction(1, 3), decimal.Decimal("0.5")],
    "buffer": memoryview(np.ones(2)), "range": range(1, 3),
    "Arrow's": pa.array([1.0, 2.0]), "labelled": pd.Series([1.0, 2.0], index=[7, 8]),
}  # fmt: skip


@pytest.mark.parametrize("value", NUMBERS.values(), ids=NUMBERS)
def test_numbers_of_any_make_are_taken(value):
    np.testing.assert_array_equal(lierb.Body(value, BOX).mass, np.asarray(value, dtype=float))


def test_matrices_of_numpy_are_taken_as_arrays():
    matrix = np.diag(BOX).view(np.matrix)
    np.testing.assert_array_equal(lierb.Body(1.0, matrix).inertia, np.diag(BOX))


def test_body_whose_steiner_term_overflows_is_none():
    with pytest.raises(InertiaError, match=r"^inertia .*beyond all numbers"):
        lierb.Body(1e300, BOX, com=(1e10, 0.0, 0.0))
    with pytest.raises(InertiaError, match=r"^inertia\[1\] "):
        lierb.Body((1.0, 1e300), BOX, com=((0.0, 0.0, 0.0), (1e10, 0.0, 0.0)))
    lierb.Body(1e300, (5e307, 5e307, 5e307))
    with pytest.raises(InertiaError, match=r"^mass is 1e\+300 kg .* gyration"):
        lierb.Body(1e300, (1.7e308, 1.7e308, 1.7e308))  # the sum of two overflows, and so the trace


class Posed:
    def __init__(self, found):
        self.found = found

    def as_matrix(self):
        if isinstance(self.found, Exception):
            raise self.found
        return self.found


def test_as_matrix_may_return_what_it_likes():
    joint = joints.spherical()
    for good in (np.eye(4), np.eye(4).tolist(), np.eye(3).tolist()):
        np.testing.assert_array_equal(joint.coordinates(Posed(good)), 0.0)
    for bad in ("pose", None, [[1.0, 2.0]], RuntimeError("gone")):
        with pytest.raises(ArgumentError, match=r"^pose "):
            joint.coordinates(Posed(bad))
        with pytest.raises(ArgumentError, match=r"so3\.log"):
            lierb.lie.so3.log(Posed(bad))


@pytest.mark.parametrize("place", [(1e308, 1e308, 0.0), (1e300, 0.0, 0.0)])
def test_poses_and_twists_that_overflow_are_told_as_such(place):
    far = joints.spherical(place, ground_point=np.negative(place) * 1.5)
    with pytest.raises(ArgumentError, match=r"^the .*beyond all numbers"):
        far.twist((0.0, 1e100, 1e100))
    if place[1]:
        with pytest.raises(ArgumentError, match=r"^the closed pose is beyond all numbers"):
            _ = far.closed_pose


def test_names_given_as_arrays_are_refused():
    for given in (np.array(["body", "ground"]), ["body"], None, 5):
        with pytest.raises(UnknownNameError, match="frame="):
            lierb.forces.constant_wrench(frame=given)
        with pytest.raises(UnknownNameError, match="unit="):
            lierb.constraint(unit=given)(lambda R, r, params: r[0])


def test_predict_rejects_what_is_no_problem():
    with pytest.raises(ArgumentError, match="problem must be"):
        lierb.predict(5)


@pytest.mark.parametrize("name", [None, 5, np.array("mine")], ids=str)
def test_names_of_the_users_own_are_texts(name):
    """They go into the metadata of every table."""
    with pytest.raises(ArgumentError, match="name="):
        joints.from_rows(["d1"], name=name)
    with pytest.raises(ArgumentError, match="name="):
        lierb.ButcherTableau([[]], [1], name=name)


@pytest.mark.parametrize("body", [-1, 2, True, 0.0, "0", None, SECOND, 10**30])
def test_of_body_rejects_what_is_no_number_of_a_body(body):
    with pytest.raises(ArgumentError, match="body="):
        spherical_top(lierb.Body(np.ones(2), BOX)).of_body(body)


def test_huge_direction_is_normalised():
    # |axis|² overflows, the direction is plain
    frame = joints.revolute(axis=(0.0, 3e200, 4e200)).body_frame
    np.testing.assert_allclose(frame[:3, 2], (0.0, 0.6, 0.8), rtol=0, atol=4e-16)  # two roundings


# ---------------------------------------------------------------- joints

BAD_JOINTS = {
    "screw without pitch": (lambda: joints.screw(), "pitch"),
    "rod without length": (lambda: joints.point_on_sphere(), "length=, in m"),
    "rod of no length": (lambda: joints.point_on_sphere(length=(1, 0)), r"length\[1\] is 0.0 m"),
    "revolute with length": (lambda: joints.revolute(length=0.1), "length"),
    "revolute with pitch": (lambda: joints.revolute(pitch=0.1), "pitch"),
    "revolute with slot": (lambda: joints.revolute(slot=(1, 0, 0)), "slot"),
    "spherical with second_axis": (lambda: joints.spherical(second_axis=(0, 1, 0)), "second_axis"),
    "slot along the axis": (lambda: joints.pin_in_slot(slot=(0, 0, 1)), "slot.*perpendicular"),
    "slot aslant": (lambda: joints.pin_in_slot(slot=(1, 0, 1e-8)), "slot.*perpendicular"),
    "second_axis aslant": (
        lambda: joints.universal(second_axis=(0, 1, 1)), "second_axis.*perpendicular",
    ),
    "zero axis": (lambda: joints.revolute(axis=(0, 0, 0)), "axis.*zero"),
    "zero slot": (lambda: joints.pin_in_slot(slot=(0, 0, 0)), "slot.*zero"),
    "body_frame and body_point": (
        lambda: joints.spherical((1, 2, 3), body_frame=np.eye(4)), "body_frame.*body_point",
    ),
    "body_frame and axis": (
        lambda: joints.revolute(axis=(1, 0, 0), body_frame=np.eye(4)), "body_frame.*axis",
    ),
    "body_frame and slot": (
        lambda: joints.pin_in_slot(slot=(1, 0, 0), body_frame=np.eye(4)), "body_frame.*slot",
    ),
    "body_frame and second_axis": (
        lambda: joints.universal(second_axis=(0, 1, 0), body_frame=np.eye(4)),
        "body_frame.*second_axis",
    ),
    "ground_frame and ground_point": (
        lambda: joints.spherical(ground_point=(1, 2, 3), ground_frame=np.eye(4)),
        "ground_frame.*ground_point",
    ),
    "two directions for one frame": (
        lambda: joints.from_rows(["d1"], slot=(1, 0, 0), second_axis=(1, 0, 0)),
        "slot.*second_axis",
    ),
    "rows is a number": (lambda: joints.from_rows(5), "rows"),
    "rows is text": (lambda: joints.from_rows("d1 d2"), "row"),
    "fifteen rows": (
        lambda: joints.from_rows(
            [f"{kind}{i}" for kind in ("d", "Qtd", "Omega", "Q1", "Q2") for i in "123"],
        ),
        "15 rows",
    ),
    "one Omega row": (lambda: joints.from_rows(["d1", "Omega2"]), "one Omega"),
    "screw row without pitch": (
        lambda: joints.from_rows(["screw", "Omega1", "Omega2"]), "pitch",
    ),
    "screw row whose axis may tilt": (  # its rate is d₃′ − pitch Ω₃ only where Ω₁ = Ω₂ = 0
        lambda: joints.from_rows(["d1", "d2", "screw"], pitch=0.1), "screw.*Omega",
    ),
    "rod beside a row of its end": (
        lambda: joints.from_rows(["rod", "d3"], length=1.0), "rod.*another way",
    ),
    "rod row without length": (lambda: joints.from_rows(["rod"]), "length"),
    "pitch without screw row": (lambda: joints.from_rows(["d1"], pitch=0.1), "pitch"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "told"), BAD_JOINTS.values(), ids=BAD_JOINTS)
def test_joint_rejects(call, told):
    with pytest.raises(LierbError, match=told):
        call()


@pytest.mark.parametrize("option", ["axis", "slot"])
def test_joint_names_the_offending_body_of_a_batch(option):
    directions = with_body(repeated((1.0, 0.0, 0.0)), 17, (0.0, 0.0, 0.0))
    with pytest.raises(ArgumentError, match=rf"{option}\[17\]"):
        joints.pin_in_slot(**{"axis": repeated((0, 0, 1)), option: directions})


def test_slant_names_the_offending_body_of_a_batch():
    slots = with_body(repeated((1.0, 0.0, 0.0)), 17, (1.0, 0.0, 0.5))
    with pytest.raises(ArgumentError, match=r"slot\[17\]"):
        joints.pin_in_slot(slot=slots)


@pytest.mark.parametrize("argument", ["body_frame", "ground_frame"])
@pytest.mark.parametrize(
    ("frame", "told"),
    [(FLIPPED, "reflection"), (SHEARED, "RᵀR"), (np.diag([1, 1, 1, 2.0]), "last row")],
    ids=["reflection", "sheared", "last row"],
)
def test_joint_rejects_a_frame_that_is_no_rigid_motion(argument, frame, told):
    with pytest.raises(PoseError, match=rf"{argument}\b.*{told}"):
        joints.spherical(**{argument: frame})
    with pytest.raises(PoseError, match=rf"{argument}\[17\].*{told}"):
        joints.spherical(**{argument: with_body(repeated(np.eye(4)), 17, frame)})


def test_problem_rejects_what_is_no_body_or_joint():
    with pytest.raises(ArgumentError, match=r"body must be a lierb\.Body"):
        lierb.Problem(BOX, joints.free())
    with pytest.raises(ArgumentError, match="joint"):
        lierb.Problem(lierb.Body(1.0, BOX), joints.spherical)  # not called
    with pytest.raises(ArgumentError, match="joint"):
        lierb.Problem(lierb.Body(1.0, BOX), "spherical")


def test_integrate_rejects_what_is_no_problem():
    with pytest.raises(ArgumentError, match="problem"):
        lierb.integrate(lierb.Body(1.0, BOX), twist0=np.zeros(6), dt=0.1, t_end=1.0)


def test_so3xr3_needs_the_frame_at_the_centre_of_mass():
    top = spherical_top(lierb.Body(6.0, BOX, com=(1e-3, 0.0, 0.0)))
    with pytest.raises(ArgumentError, match="centre of mass"):
        integrate(top, cspace="SO3xR3")
    with pytest.raises(DriverReached):
        integrate(top, cspace="SE3")


# ---------------------------------------------------------------- pose0, twist0 and the joint


def shifted(C, by):
    moved = np.array(C)
    moved[:3, 3] += by
    return moved


@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
def test_pose_that_does_not_close_says_which_row_and_how_much(cspace):
    C = shifted(joints.spherical(POINT).closed_pose, (0.0, 0.25, 0.0))
    with pytest.raises(PoseError, match=r"^pose0 .*spherical.*position.*0\.25.*d2 = 0\.25"):
        integrate(pose0=C, cspace=cspace)


def test_pose_that_does_not_close_names_the_body():
    closed = joints.spherical(POINT).closed_pose
    poses = with_body(repeated(closed), 17, shifted(closed, (0, 0, 1e-3)))
    with pytest.raises(PoseError, match=r"pose0\[17\].*0\.001"):
        integrate(pose0=poses)


@pytest.mark.parametrize("far", [1e155, 1e300])  # whose squares are beyond all numbers
def test_starts_whose_squares_overflow_are_told_as_such(far):
    C = shifted(joints.spherical(POINT).closed_pose, (far, 0.0, 0.0))
    with pytest.raises(PoseError, match=r"^pose0 has a position error beyond .* overflow") as told:
        integrate(pose0=C)
    assert "inf" not in str(told.value)
    with pytest.raises(TwistError, match=r"^twist0 has a velocity beyond .* overflow") as told:
        integrate(twist0=(0.0, 0.0, 0.0, far, 0.0, 0.0))
    assert "inf" not in str(told.value)


def test_pose_turned_off_the_axis_is_a_rotation_error():
    top = spherical_top(joint=joints.revolute(POINT))
    turned = np.eye(4)
    turned[1:3, 1:3] = [[math.cos(0.5), -math.sin(0.5)], [math.sin(0.5), math.cos(0.5)]]
    turned[:3, 3] = -turned[:3, :3] @ POINT
    # Q₂₃ = −sin 0.5 = −0.479
    with pytest.raises(PoseError, match=r"pose0 .*revolute.*rotation.*0\.479"):
        integrate(top, pose0=turned)


def test_pose_of_a_universal_joint_names_its_row():
    top = spherical_top(joint=joints.universal())
    turned = np.eye(4)
    turned[1:3, 1:3] = [[0.8, -0.6], [0.6, 0.8]]
    with pytest.raises(PoseError, match=r"rotation.*Q32 = 0\.6"):
        integrate(top, pose0=turned)


def test_pose_may_err_by_rounding():
    by = 0.9e-9 * np.linalg.norm(POINT)  # 1e-9 of the arm, the longest length here
    C = shifted(joints.spherical(POINT).closed_pose, (0.0, by, 0.0))
    with pytest.raises(DriverReached):
        integrate(pose0=C)


@pytest.mark.parametrize(
    ("pose", "told"), [(FLIPPED, "reflection"), (SHEARED, "RᵀR")], ids=["reflection", "sheared"]
)
def test_pose_that_is_no_rigid_motion_names_the_body(pose, told):
    with pytest.raises(PoseError, match=rf"pose0\[17\].*{told}"):
        integrate(pose0=with_body(repeated(np.eye(4)), 17, pose))
    with pytest.raises(PoseError, match=rf"pose0\b.*{told}"):
        integrate(pose0=pose, check="off")


@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
def test_twist_that_violates_says_which_rows_and_how_much(cspace):
    twist0 = joints.spherical(POINT).twist((0, 0, 1), point_velocity=(0.0, 0.0, 0.5))
    with pytest.raises(TwistError, match=r"^twist0 .*spherical.*velocity 0\.5 m/s.*d3: 0\.5.*proj"):
        integrate(twist0=twist0, cspace=cspace)


def test_twist_that_violates_names_the_body():
    good = joints.spherical(POINT).twist((1, 2, 3))
    bad = joints.spherical(POINT).twist((1, 2, 3), point_velocity=(1e-3, 0, 0))
    with pytest.raises(TwistError, match=r"^twist0\[17\].*0\.001"):
        integrate(twist0=with_body(repeated(good), 17, bad))


def test_twist_of_the_paper_violates_the_pin_in_slot():
    # errata E12: ω₀ = (0, π, 0.2π) about axis 2 leaves 0.63 rad/s about axis 3
    joint = joints.pin_in_slot(POINT, axis=(0, 1, 0), slot=(1, 0, 0))
    twist0 = joint.twist((0.0, np.pi, 0.2 * np.pi))
    with pytest.raises(TwistError, match=r"pin_in_slot.*rotation rate 0\.628 rad/s.*Omega"):
        integrate(spherical_top(joint=joint), twist0=twist0)


def test_twist_is_checked_at_the_given_pose():
    joint = joints.prismatic(axis=(0, 0, 1))
    along_ground, quarter = (0, 0, 0, 0.0, 1.0, 0.0), np.eye(4)
    # slid along e₃ the joint stays closed; the twist is tested there too
    quarter[2, 3] = 0.7
    with pytest.raises(TwistError, match="d2: 1"):
        integrate(spherical_top(joint=joint), pose0=quarter, twist0=along_ground)


def test_offender_beyond_the_first_chunk_keeps_its_index(monkeypatch):
    monkeypatch.setattr(lierb.runs.engine, "CHUNK_BODIES", 16)
    count, body = 26, 23
    twists = with_body(np.zeros((count, 6)), (body, 3), 0.1)
    with pytest.raises(TwistError, match=rf"twist0\[{body}\]"):
        integrate(twist0=twists)


def test_offender_is_named_where_only_the_joint_is_batched():
    points = with_body(np.zeros((COUNT, 3)), 17, (1.0, 0.0, 0.0))
    joint = joints.spherical(points, ground_point=points)
    with pytest.raises(TwistError, match=r"\[17\]"):
        integrate(spherical_top(joint=joint), twist0=(0, 0, 1, 0, 0, 0))


BAD_STATES = {
    "pose0": {"pose0": shifted(joints.spherical(POINT).closed_pose, (0, 0, 1.0))},
    "twist0": {"twist0": (0, 0, 0, 0, 0, 1.0)},
}


def test_check_warn_warns_once_about_a_batch_of_many_chunks(monkeypatch):
    monkeypatch.setattr(lierb.runs.engine, "CHUNK_BODIES", 16)
    loose = np.tile((0, 0, 0, 0, 0, 1.0), (60, 1))
    with pytest.warns(InconsistentStateWarning) as told, pytest.raises(DriverReached):
        integrate(twist0=loose, check="warn")
    assert len(told) == 1
    assert told[0].filename == __file__


def test_a_problems_arrays_are_no_ones_to_change():
    """Cached values of changed arrays would be wrong."""
    joint, body = joints.spherical(POINT), lierb.Body(1.0, (1.0, 1.0, 1.0))
    problem = lierb.Problem(body, joint, (0.0, 0.0, -9.81))
    for array in (
        body.mass, body.inertia, body.com, joint.ground_frame, joint.body_frame, joint.pitch,
        joint.length, joint.closed_pose, problem.gravity,
    ):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 2.0


@pytest.mark.parametrize("argument", BAD_STATES)
def test_check_warn_warns_once_and_runs(argument):
    with (
        pytest.warns(InconsistentStateWarning, match=argument) as caught,
        pytest.raises(DriverReached),
    ):
        integrate(**BAD_STATES[argument], check="warn")
    assert len(caught) == 1


def test_check_warn_points_at_the_callers_line():
    with pytest.warns(InconsistentStateWarning) as caught, pytest.raises(DriverReached):
        lierb.integrate(spherical_top(), dt=1.0, t_end=2.0, check="warn", **BAD_STATES["twist0"])
    assert caught[0].filename == __file__


@pytest.mark.parametrize("argument", BAD_STATES)
def test_check_off_is_silent_and_runs(argument):
    with pytest.raises(DriverReached):  # and a warning would be an error
        integrate(**BAD_STATES[argument], check="off")


@pytest.mark.filterwarnings("ignore::lierb.errors.InconsistentStateWarning")
@pytest.mark.parametrize("argument", BAD_STATES)
@pytest.mark.parametrize("check", ["raise", "warn", "off"])
def test_reduced_cspace_never_takes_a_state_that_violates(argument, check):
    # it has no room for one: the run would start from another state than the given
    with pytest.raises(LierbError, match=argument):
        integrate(**BAD_STATES[argument], cspace="reduced", check=check)


@pytest.mark.parametrize(
    "joint", [joints.universal(), joints.pin_in_slot(), joints.free()], ids=repr
)
def test_reduced_cspace_needs_a_joint_with_a_subgroup(joint):
    with pytest.raises(ArgumentError, match=r"cspace=.reduced.*subgroup"):
        integrate(spherical_top(joint=joint), cspace="reduced")


def test_violation_that_overflows_is_one():
    # |twist0|² is inf, and so is what a tolerance relative to it allows
    with pytest.raises(TwistError, match="twist0"):
        integrate(twist0=(0, 0, 0, 1e200, 0, 0))


def test_free_body_takes_any_state():
    with pytest.raises(DriverReached):
        integrate(
            spherical_top(joint=joints.free()),
            pose0=shifted(np.eye(4), 3.0),
            twist0=np.arange(6.0),
        )


# ---------------------------------------------------------------- the grid of times


@pytest.mark.parametrize("argument", ["dt", "t_end"])
@pytest.mark.parametrize(
    "bad",
    [
        0, 0.0, -0.1, math.nan, math.inf, 10**400, 10**5000, "0.1", None, True, 1j, (0.1,), [1, 2],
        SECOND, np.ma.masked,
    ],
    ids=lambda bad: type(bad).__name__,
)  # fmt: skip
def test_time_that_is_not_positive_names_the_argument(argument, bad):
    with pytest.raises(TimeGridError, match=rf"\b{argument}="):
        integrate(**{argument: bad})


@pytest.mark.parametrize("numpy_type", [np.float32, np.float64, np.int64, np.complex128])
def test_time_may_be_a_real_scalar_of_numpy(numpy_type):
    expected = TimeGridError if numpy_type is np.complex128 else DriverReached
    with pytest.raises(expected):
        integrate(dt=numpy_type(1), t_end=numpy_type(3))


NEAREST = [
    (0.01, 0.1234, 0.12, 0.13),
    (0.01, 0.999, 0.99, 1.0),
    (1e-3, 10.0004, 10.0, 10.001),
    (0.25, 1.1, 1.0, 1.25),
    (1.0, 1.5, 1.0, 2.0),
]


@pytest.mark.parametrize(("dt", "t_end", "below", "above"), NEAREST)
def test_t_end_off_the_grid_names_the_two_nearest(dt, t_end, below, above):
    with pytest.raises(TimeGridError, match=r"\bt_end=.*nearest") as caught:
        integrate(dt=dt, t_end=t_end)
    told = str(caught.value).split("nearest", 1)[1]
    named = [float(word.strip(",;.")) for word in told.split() if word[0].isdigit()]
    assert named == pytest.approx([below, above], rel=1e-15)  # printed to the last digit


def test_a_step_longer_than_the_run_is_refused():
    with pytest.raises(TimeGridError, match=r"dt=0\.01 s is longer than the run of 0\.004 s"):
        integrate(dt=0.01, t_end=0.004)


# sums of steps as users write them: a few roundings off the grid
@pytest.mark.parametrize(
    ("dt", "t_end"), [(0.1, 0.3), (1e-3, 10.0), (1e-4, 10.0), (0.1, sum([0.1] * 7)), (1 / 3, 1.0)]
)
def test_t_end_may_err_by_rounding(dt, t_end):
    with pytest.raises(DriverReached):
        integrate(dt=dt, t_end=t_end)


@pytest.mark.parametrize("off", [0.9e-9, -0.9e-9])
def test_t_end_may_err_by_a_billionth_of_a_step(off):
    with pytest.raises(DriverReached):
        integrate(dt=0.01, t_end=0.01 * (100 + off))
    with pytest.raises(TimeGridError):
        integrate(dt=0.01, t_end=0.01 * (100 + 2 * off))


def test_steps_beyond_number_are_rejected():
    with pytest.raises(TimeGridError):
        integrate(dt=1e-300, t_end=1e300)
    with pytest.raises(TimeGridError, match="beyond all numbers"):
        integrate(dt=1e300, t0=-1e308, t_end=1e308)


@pytest.mark.parametrize("argument", ["save_every", "measure_every"])
@pytest.mark.parametrize(
    "bad", [0, -1, 1.0, 2.5, math.nan, True, "1", (1,), np.float64(2.0), np.timedelta64(1, "s")]
)
def test_stride_that_is_no_whole_number_names_the_argument(argument, bad):
    with pytest.raises(TimeGridError, match=rf"\b{argument}="):
        integrate(**{argument: bad})


def test_measure_every_cannot_be_none():
    with pytest.raises(TimeGridError, match="measure_every"):
        integrate(measure_every=None)


# ---------------------------------------------------------------- names

UNKNOWN = {
    "method": ("rk4", "RK4"),
    "cspace": ("se3", "SE3"),
    "update": ("globl", "global"),
    "check": ("warning", "warn"),
    "solver": ("sadle", "saddle"),
    "record": (("states",), "state"),
}


@pytest.mark.parametrize("argument", UNKNOWN)
def test_unknown_name_suggests_the_nearest(argument):
    given, nearest = UNKNOWN[argument]
    with pytest.raises(UnknownNameError, match=rf"\b{argument}=.*Did you mean '{nearest}'"):
        integrate(**{argument: given}, save_every=1)


@pytest.mark.parametrize("argument", UNKNOWN)
def test_unknown_name_lists_the_known_ones(argument):
    nonsense = "%%%%"
    with pytest.raises(UnknownNameError, match=rf"\b{argument}=") as caught:
        integrate(**{argument: nonsense}, save_every=1)
    assert UNKNOWN[argument][1] in str(caught.value)
    assert "Did you mean" not in str(caught.value)


NO_NAMES = {
    "None": None,
    "number": 4,
    "list": ["SE3"],
    "set": {"SE3"},
    "array": np.array(["SE3", "SO3xR3"]),
}


@pytest.mark.parametrize("argument", ["method", "cspace", "update", "check", "solver"])
@pytest.mark.parametrize("given", NO_NAMES.values(), ids=NO_NAMES)
def test_name_of_another_type_is_rejected(argument, given):
    if given is None and argument in ("cspace", "method"):
        return  # the default
    with pytest.raises(LierbError, match=argument):
        integrate(**{argument: given})


@pytest.mark.parametrize("given", [None, 5, (None,), (5,), (np.zeros(2),)], ids=str)
def test_record_of_another_type_is_rejected(given):
    with pytest.raises(LierbError, match="record"):
        integrate(record=given, save_every=1)


@pytest.mark.parametrize(
    "given", [itertools.repeat("state"), np.broadcast_to(np.zeros(6), (10**13, 6))],
    ids=["no end", "ten trillion rows"],
)  # fmt: skip
def test_record_without_an_end_in_sight_is_refused(given):
    """Python 3.14's tuple() would take items one by one until the memory is full."""
    with pytest.raises(ArgumentError, match=r"^record=.* has more than 1000000 items; expected"):
        integrate(record=given, save_every=1)


def test_record_without_a_history_says_so():
    with pytest.raises(ArgumentError, match=r"record.*save_every"):
        integrate(record=("state",))


def test_record_may_be_one_name():
    with pytest.raises(DriverReached):
        integrate(record="energy", save_every=1)


@pytest.mark.parametrize(
    ("row", "nearest"),
    [("D1", "d1"), ("d4", "d"), ("omega2", "Omega2"), ("Q34", "Q3"), ("screws", "screw")],
)
def test_unknown_row_suggests_the_nearest(row, nearest):
    with pytest.raises(UnknownNameError, match=rf"row='{row}'.*Did you mean '{nearest}"):
        joints.from_rows(["d2", row])


@pytest.mark.parametrize("row", [None, 5, ("d", 1), b"d1", ""], ids=repr)
def test_row_of_another_type_is_rejected(row):
    with pytest.raises(LierbError, match="row"):
        joints.from_rows(["d1", row])


# ---------------------------------------------------------------- threads and progress


@pytest.mark.parametrize("threads", [0, -1, 10**6, 1.0, "2", True, (1,)])
def test_threads_out_of_range_names_the_argument(threads):
    with pytest.raises(ArgumentError, match=r"\bthreads="):
        integrate(threads=threads)


@pytest.mark.parametrize("progress", ["yes", 5, (1, 2)])
def test_progress_of_another_type_is_rejected(progress):
    with pytest.raises(ArgumentError, match="progress"):
        integrate(progress=progress)


# ---------------------------------------------------------------- at random


def _random_shape(rng):
    return tuple(rng.choice([0, 1, 2, 3, 4, 6, 9]) for _ in range(rng.integers(0, 4)))


CALLS = {
    "Body": (lambda a: lierb.Body(**a), ["mass", "inertia", "com"]),
    "Problem": (
        lambda a: lierb.Problem(lierb.Body(np.ones(2), BOX), joints.free(), **a), ["gravity"],
    ),
    "pin_in_slot": (
        lambda a: joints.pin_in_slot(**a), ["body_point", "ground_point", "axis", "slot"],
    ),
    "universal": (lambda a: joints.universal(**a), ["axis", "second_axis", "ground_frame"]),
    "screw": (lambda a: joints.screw(**a), ["pitch", "body_frame", "ground_frame"]),
    "rod": (lambda a: joints.point_on_sphere(**a), ["length", "body_frame", "axis"]),
    "twist": (
        lambda a: joints.revolute(np.zeros((2, 3))).twist(**a), ["omega", "point_velocity", "pose"],
    ),
    "project": (lambda a: spherical_top().project(**a), ["twist", "pose"]),
    "integrate": (lambda a: integrate(**a), ["twist0", "pose0", "dt", "t_end"]),
}  # fmt: skip
DEFAULTS = {"mass": 1.0, "inertia": BOX, "pitch": 0.1, "length": 0.1, "twist": np.zeros(6)}


@pytest.mark.parametrize("name", CALLS)
def test_random_shapes_raise_nothing_but_our_errors(name):
    call, arguments = CALLS[name]
    rng = np.random.default_rng(2016)
    for _ in range(200):
        chosen = rng.permutation(arguments)[: rng.integers(1, len(arguments) + 1)]
        given = {a: DEFAULTS[a] for a in arguments if a in DEFAULTS}
        given |= {
            str(a): rng.choice([0.0, 1.0, -1.0]) * np.ones(_random_shape(rng)) for a in chosen
        }
        try:
            call(given)
        except (LierbError, DriverReached):
            pass
        except Exception as error:
            shapes = {a: np.shape(v) for a, v in given.items()}
            raise AssertionError(f"{name}{shapes}: {type(error).__name__}: {error}") from error


@pytest.mark.parametrize("name", CALLS)
def test_random_batches_raise_nothing_but_our_errors(name):
    call, arguments = CALLS[name]
    rng = np.random.default_rng(2017)
    good = {
        "mass": 1.0, "inertia": BOX, "com": np.zeros(3), "gravity": np.zeros(3), "pitch": 0.1,
        "length": 0.1,
        "body_point": np.zeros(3), "ground_point": np.zeros(3), "axis": (0.0, 0.0, 1.0),
        "slot": (1.0, 0.0, 0.0), "second_axis": (0.0, 1.0, 0.0), "body_frame": np.eye(4),
        "ground_frame": np.eye(4), "omega": np.zeros(3), "point_velocity": np.zeros(3),
        "pose": np.eye(4), "twist": np.zeros(6), "twist0": np.zeros(6), "dt": 0.5, "t_end": 1.0,
        "pose0": joints.spherical(POINT).closed_pose,
    }  # fmt: skip
    for _ in range(100):
        given = {a: good[a] for a in arguments}
        for a in arguments:
            if a not in ("dt", "t_end") and rng.random() < 0.7:
                given[a] = repeated(good[a], rng.choice([0, 1, 2, 3]))
        try:
            call(given)
        except (LierbError, DriverReached):
            pass
        except Exception as error:
            shapes = {a: np.shape(v) for a, v in given.items()}
            raise AssertionError(f"{name}{shapes}: {type(error).__name__}: {error}") from error


class Tenth:
    """A number of some other package."""

    def __float__(self):
        return 0.1


def test_numbers_of_other_packages_are_numbers():
    two = pa.scalar(2.0)
    if hasattr(two, "__float__"):  # not before pyarrow 21
        assert lierb.Body(two, BOX).mass == 2.0
    assert lierb.Body(Tenth(), BOX).mass == 0.1


TWISTS = [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.5, 0.0, 2.0, 0.0, -3.0, 0.0]]
COLUMNS = {
    "list": lambda rows: pa.array(rows),
    "large list": lambda rows: pa.array(rows, pa.large_list(pa.float32())),
    "fixed list": lambda rows: pa.array(rows, pa.list_(pa.float64(), 6)),
    "chunks": lambda rows: pa.chunked_array([[row] for row in rows]),
    "column": lambda rows: pa.table({"twist": rows})["twist"],
    "tensor": lambda rows: pa.FixedShapeTensorArray.from_numpy_ndarray(np.array(rows)),
    "whole": lambda rows: pa.array([[int(x) for x in row] for row in rows]),
    "series of lists": lambda rows: pd.Series(rows),
    "series of arrays": lambda rows: pd.Series([np.array(row) for row in rows]),
}


@pytest.mark.parametrize("name", COLUMNS)
def test_columns_of_lists_are_arrays(name):
    """A twist for each body, as Arrow, Parquet files and data frames have them."""
    rows = np.round(TWISTS) if name == "whole" else np.array(TWISTS)
    found = as_numbers("twist0", COLUMNS[name](rows.tolist()), (6,))
    np.testing.assert_array_equal(found, rows)
    poses = as_numbers("pose0", pa.array([np.eye(4).tolist()] * 2), (4, 4))
    np.testing.assert_array_equal(poses, [np.eye(4)] * 2)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[1.0] * 6, [1.0] * 5], "must be numbers"),
        ([[1.0] * 6, None], "must be numbers"),
        ([[1.0] * 5 + [None]], r"twist0\[0, 5\] is nan|must be numbers"),  # Arrow's nulls
        ([["1"] * 6], "must be numbers"),
        ([[True] * 6], "must be numbers"),
        ([[1.0] * 5], r"shape \(1, 5\)"),
    ],
)
def test_columns_of_lists_are_refused_as_lists_are(rows, message):
    for column in (pa.array(rows), pd.Series(rows)):
        with pytest.raises(ArgumentError, match=message):
            as_numbers("twist0", column, (6,))


@pytest.mark.parametrize(
    "call", [lierb.log, lierb.quaternion, lambda R: lierb.table(R, [0, 1], [0, 1])]
)
@pytest.mark.parametrize(
    "R",
    [
        np.eye(3) * 1j,
        np.eye(3).astype(str),
        np.ma.array(np.eye(3), mask=np.eye(3) > 0),
        {},
        10**400,
    ],
    ids=["complex", "text", "masked", "a dictionary", "huge"],
)
def test_functions_for_functions_take_real_numbers(call, R):
    with pytest.raises(ValueError, match="must be real numbers"):
        call(R)


@pytest.mark.parametrize("study", [5, None, object()])
def test_study_that_is_no_path_is_told_as_such(study, tmp_path):
    pytest.importorskip("pydantic")
    calls = [lierb.Study.load, lierb.integrate_batches, lambda given: lierb.run(given, tmp_path)]
    for call in calls:
        with pytest.raises(ArgumentError, match=r"expected a lierb\.Study, or the path"):
            call(study)

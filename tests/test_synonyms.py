"""Names of other tools are told, with the names here."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest

import lierb
from lierb.errors import ArgumentError, ForceError, UnknownNameError, synonyms, unknown_name
from lierb.sampling.distributions import DISTRIBUTIONS

NAMES_HERE = {
    **dict.fromkeys(synonyms.METHODS, lierb.methods.METHODS),
    **dict.fromkeys(synonyms.JOINTS, lierb.joints.JOINTS),
    **dict.fromkeys(synonyms.DISTRIBUTIONS, DISTRIBUTIONS),
}


@pytest.mark.parametrize("name", NAMES_HERE)
def test_names_of_other_packages_are_told(name):
    known, here = NAMES_HERE[name], synonyms.NAMES[name]
    assert here in known
    assert name not in known
    assert f"take {here!r} here" in str(unknown_name("argument", name.upper(), known))


def test_suggestions_have_the_same_meaning():
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    with pytest.raises(UnknownNameError, match=r"'implicitfast' .* take 'Rodas4' here"):
        lierb.integrate(flight, dt=0.1, t_end=1.0, method="implicitfast")
    assert "take dt=" in str(unknown_name("option", "timestep", ["max_steps", "dt"]))
    assert "Did you mean" not in str(unknown_name("key", "gaussian", ["values", "uniform"]))


KEYWORDS = {
    "t_eval": "save_at=", "t_span": "t0= and t_end=", "y0": "pose0= and twist0=",
    "max_step": "dt_max=", "first_step": "dt=", "dense_output": "save_at=", "timestep": "dt=",
    "qpos": "mechanism.pose", "gravity": "lierb.Problem", "save_ever": "'save_every'",
}  # fmt: skip


@pytest.mark.parametrize("keyword", KEYWORDS)
def test_keywords_of_other_packages_are_told(keyword):
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    with pytest.raises(TypeError, match=rf"integrate .*'{keyword}'.*{KEYWORDS[keyword]}"):
        lierb.integrate(flight, t_end=1.0, **{keyword: 0.1})
    with pytest.raises(TypeError, match=r"convergence .*'t_eval'.*save_at="):
        lierb.convergence(flight, t_end=1.0, t_eval=[0.1])


def test_every_synonym_of_an_argument_is_no_argument():
    """A table that went stale would send the reader to what does not exist."""
    tables = {
        lierb.integrate: synonyms.ARGUMENTS,
        type(lierb.joints.revolute).__call__: synonyms.JOINT_ARGUMENTS,
        lierb.Body: synonyms.BODY_ARGUMENTS,
    }
    for function, table in tables.items():
        known = inspect.signature(function).parameters
        assert not table.keys() & known.keys()
        named = {each for text in table.values() for each in re.findall(r"\b(\w+)=(?![…\w])", text)}
        others = (inspect.signature(each).parameters for each in (lierb.Link, lierb.Problem))
        assert named <= known.keys() | set().union(*others)
    members = dir(lierb.Result)
    assert not synonyms.RESULTS.keys() & set(members)


def test_names_of_joints_and_their_arguments_in_other_packages_are_told():
    for name, here in {"hinge": "revolute", "JointModelRX": "revolute", "weld": "fixed"}.items():
        with pytest.raises(AttributeError, match=rf"^lierb.joints has no '{name}'.* {here}$"):
            getattr(lierb.joints, name)
    for name, text in {"spring": "take spring_damper", "frictionloss": "joint_friction"}.items():
        with pytest.raises(AttributeError, match=rf"^lierb.forces has no '{name}'; .*{text}"):
            getattr(lierb.forces, name)
    with pytest.raises(AttributeError, match=r"^lierb.bodies has no 'cube'; take box$"):
        _ = lierb.bodies.cube
    assert not synonyms.FORCES.keys() & {*lierb.forces.__all__}
    assert not synonyms.BODIES.keys() & {*lierb.bodies.__all__}
    with pytest.raises(AttributeError, match="Did you mean 'prismatic'"):
        _ = lierb.joints.prismatc
    with pytest.raises(TypeError, match=r"joint .*'pos'.*body_point="):
        lierb.joints.revolute(pos=(0, 0, 1))
    with pytest.raises(TypeError, match=r"Body .*'diaginertia'.*inertia="):
        lierb.Body(1.0, diaginertia=(1, 1, 1))


@pytest.mark.slow
def test_attributes_and_columns_of_results_of_other_packages_are_told():
    @lierb.observable
    def height(r):
        return r[2]

    body, hinge = lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free()
    link = lierb.Mechanism(lierb.Link("ball", body, hinge), observables=height())
    run = {"dt": 0.1, "t_end": 0.1, "with_respect_to": "ball.body.mass"}
    result = lierb.integrate(link, **run)
    for each in (result, result["ball"]):
        for name, here in {"y": "quaternion", "success": "failed", "qpos": "coordinates"}.items():
            with pytest.raises(
                AttributeError, match=rf"^the result has no '{name}'; take .*{here}"
            ):
                getattr(each, name)
        assert not hasattr(each, "nonsense")
    with pytest.raises(AttributeError, match="Did you mean 'position'"):
        _ = result["ball"].position_
    with pytest.raises(
        UnknownNameError, match=r"'height' .*save_at= keeps; .* height_min, height_max"
    ):
        _ = result["height"]
    with pytest.raises(UnknownNameError, match=r"'qpos' is unknown; take rotation and position"):
        _ = result["qpos"]
    (derivatives, *_) = (name for name in result.sensitivities.summary.column_names if "/" in name)
    of, by = derivatives.split("/")
    with pytest.raises(UnknownNameError, match=rf"take result\.sensitivity\('{of}', '{by}'\)"):
        _ = result[derivatives]
    result.sensitivity(of, by)
    assert "ball" in result
    assert "height_max" in result
    assert "height" not in result
    assert 0 not in result


BODY, BALL = lierb.Body(2.0, (0.1, 0.2, 0.25)), lierb.joints.spherical()
ARM = lierb.Mechanism(lierb.Link("arm", BODY, lierb.joints.revolute()))
SHAPES = {
    "coordinates for pose0": (
        lambda: run(ARM, pose0=[0.1]),
        r"mechanism\.pose\({'arm': …}\) makes",
    ),
    "coordinates by link": (lambda: run(ARM, pose0={"arm": 0.1}), r"mechanism\.pose make poses"),
    "rates for twist0": (lambda: run(ARM, twist0=[0.1]), r"mechanism\.twist\({'arm': …}\) makes"),
    "rates by link": (lambda: run(ARM, twist0={"arm": 0.1}), r"mechanism\.twist those of links"),
    "omega for twist0": (lambda: run(FLIGHT, twist0=(1, 2, 3)), r"ω, then v.*joint\.twist\(omega"),
    "columns": (lambda: run(FLIGHT, twist0=np.ones((6, 10))), r"\(6, 10\).*give twist0\.T"),
    "quaternion": (lambda: BALL.pose((1, 0, 0, 0)), r"scalar_first=True"),
    "quaternions": (lambda: BALL.pose(rotation=np.ones((5, 4))), r"scalar_first=True"),
    "qpos": (lambda: lierb.joints.free().pose((0, 0, 1, 1, 0, 0, 0)), r"scalar_first=True"),
    "angles": (lambda: BALL.pose(rotation=(0.1, 0.2, 0.3)), r"Rotation\.from_euler"),
    "inertia": (lambda: lierb.Body(1.0, (1, 1, 1, 0, 0, 0)), r"xx, xy, xz, yy, yz, zz in URDF"),
    "gravity": (lambda: lierb.Problem(BODY, BALL, gravity=-9.81), r"such as \(0, 0, -9\.81\)"),
    "gravity of links": (lambda: lierb.Mechanism(ARM.links, gravity=9.81), r"\(0, 0, -9\.81\)"),
    "letter": (
        lambda: lierb.joints.revolute(axis="-Y"),
        r"got '-Y'; .* components, such as \(0, -1, 0\)",
    ),
    "function": (lambda: ARM.with_(events=lambda t: t), r"decorate it with @lierb\.event"),
    "functions": (lambda: ARM.with_(forces=[lambda t: t]), r"forces\[0\].*@lierb\.wrench"),
}
FLIGHT = lierb.Problem(BODY, lierb.joints.free())


def run(model, **start):
    lierb.integrate(model, dt=0.1, t_end=0.1, **start)


@pytest.mark.parametrize("what", SHAPES)
def test_forms_of_numbers_of_other_packages_are_told(what):
    call, text = SHAPES[what]
    with pytest.raises(ArgumentError, match=text):
        call()


def test_wrench_of_one_vector_is_told():
    @lierb.wrench
    def push(t, R, r, omega, v):
        return np.array([0.0, 0.0, 1.0])

    with pytest.raises(ForceError, match="2 vectors, torque and force, not an array"):
        push()

"""Names of other tools are told, with the names here."""

from __future__ import annotations

import inspect
import re

import pytest

import lierb
from lierb import synonyms
from lierb.errors import UnknownNameError, unknown_name
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
    assert "Did you mean" not in str(unknown_name("key", "timestamp", ["max_steps", "dt"]))


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

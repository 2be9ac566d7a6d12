"""Derivatives by the motion of a ground, whose numbers act on all links at once."""

import numpy as np
import pytest

import lierb
from lierb.errors import ForceError, UnknownNameError
from lierb.studies.description.differentiated import names_of, parameters_of

BY = "shaking.amplitude"


def swung(axis, frequency, **defaults):
    """Make one motion of several, by the same code."""

    @lierb.ground_motion(**defaults)
    def swinging(t, params):
        size = params.size * np.sin(frequency * t)
        return tuple(size if i == axis else 0.0 * t for i in range(3))

    return swinging


@lierb.ground_motion(amplitude=0.05)
def shaking(t, params):
    return params.amplitude * np.sin(5.0 * t), 0.0, 0.0


def pendulum(amplitude, **more):
    links = [
        lierb.Link(
            name, lierb.Body(mass, (0.01, 0.02, 0.02)),
            lierb.joints.revolute(
                axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.2), parent_point=point
            ),
            parent,
        )
        for name, mass, point, parent in (
            ("upper", 1.0, (0.0, 0.0, 0.0), "ground"),
            ("lower", 0.7, (0.0, 0.0, -0.2), "upper"),
        )
    ]  # fmt: skip
    motion = shaking(amplitude=amplitude)
    return lierb.Mechanism(links, gravity=(0.0, 0.0, -9.81), ground_motion=motion, **more)


def rates(amplitude, **run):
    result = lierb.integrate(pendulum(amplitude), **run)
    return np.stack([result[link].omega for link in ("upper", "lower")])


@pytest.mark.slow
def test_a_number_of_the_motion_is_one_for_all_links():
    """Each link had a number of its own: a fit moved the ground under one link alone."""
    made, h, sigma = pendulum(0.05), 1e-5, 0.02
    run = {"pose0": made.pose({"upper": 0.3, "lower": 0.2}), "dt": 5e-3, "t_end": 2.0}
    result = lierb.integrate(made, **run, with_respect_to=BY)
    ahead, behind = (rates(0.05 + x, **run)[:, 0, 1] for x in (h, -h))
    slopes = (ahead - behind) / (2.0 * h)
    for link, slope in zip(("upper", "lower"), slopes, strict=True):
        by = result.sensitivity(f"{link}.twist", BY)[0, 1, 0]
        assert by == pytest.approx(slope, rel=1e-6)
    gradient = lierb.gradient(made, "energy", **run)
    assert BY in gradient.parts
    assert not any(name.endswith("shaking.amplitude") and name != BY for name in gradient.parts)

    t, noise = np.linspace(0.1, 2.0, 20), np.random.default_rng(0)
    saved = {**run, "save_at": t, "record": "state"}
    moved = lierb.integrate(made, **saved)
    data = {"t": t} | {
        f"{link}.omega": moved[link].omega + sigma * noise.normal(size=(20, 1, 3))
        for link in ("upper", "lower")
    }
    sigmas = {"upper.omega": sigma, "lower.omega": sigma}
    del run["t_end"]
    fit = lierb.fit(pendulum(0.03), data, BY, sigma=sigmas, **run)
    many = lierb.fits(pendulum(0.03), data, BY, sigma=sigmas, **run)
    ahead, behind = (rates(0.05 + x, **saved) for x in (h, -h))
    error = sigma / np.linalg.norm((ahead - behind) / (2.0 * h))
    for found in (fit, many):
        assert np.ravel(found.standard_errors[BY]) == pytest.approx(error, rel=0.02)
        assert np.ravel(found.estimate[BY]) == pytest.approx(0.05, abs=4.0 * error)
    assert fit.problem.forces[0].parameters == fit.problem.forces[1].parameters


def test_a_part_of_the_motion_has_no_name_and_no_numbers_of_its_own():
    made = pendulum(0.05)
    with pytest.raises(UnknownNameError, match=r"Did you mean 'shaking\.amplitude'"):
        lierb.integrate(made, dt=0.01, t_end=0.1, with_respect_to="upper.shaking.amplitude")
    parts = [shaking(amplitude=size).on(link) for link, size in (("upper", 0.1), ("lower", 0.2))]
    with pytest.raises(ForceError, match=r"amplitude of shaking differs for lower and upper"):
        lierb.Mechanism(made.links, forces=parts)


@pytest.mark.slow
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_motions_of_the_same_code_are_different_functions(order):
    """The second motion had the acceleration of the first."""

    @lierb.ground_motion
    def both(t):
        return 0.05 * np.sin(7.0 * t), 0.0, 0.04 * np.sin(9.0 * t)

    motions = swung(0, 7.0, size=0.0)(size=0.05), swung(2, 9.0, size=0.0)(size=0.04)
    pin = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.2))
    rod, run = lierb.Body(1.0, (0.01, 0.02, 0.02)), {"pose0": pin.pose([0.3]), "dt": 5e-3}
    gravity = (0.0, 0.0, -9.81)
    together = lierb.Problem(rod, pin, gravity, ground_motion=both())
    apart = lierb.Problem(rod, pin, gravity, [motions[i] for i in order])
    rates = [lierb.integrate(x, **run, t_end=1.0).omega[0, 1] for x in (together, apart)]
    assert rates[1] == pytest.approx(rates[0], rel=1e-12)


def test_motions_of_the_links_are_in_one_order():
    made, along = pendulum(0.05), (swung(0, 7.0, size=0.05)(), swung(2, 9.0, size=0.05)())
    parts = [
        along[i].on(link) for link, i in (("upper", 0), ("upper", 1), ("lower", 1), ("lower", 0))
    ]
    with pytest.raises(ForceError, match="motions of all links in the same order"):
        lierb.Mechanism(made.links, forces=parts)


CODE = """
import lierb

@lierb.ground_motion(amplitude=0.05)
def shaking(t, params):
    return params.amplitude * t**2, 0.0, 0.0
"""


@pytest.mark.parametrize("links", [1, 2])
def test_a_study_names_the_motion_as_its_other_forces(tmp_path, links):
    (tmp_path / "ground.py").write_text(CODE)
    names = ["upper", "lower"][:links]
    study = lierb.Study.of(
        {
            "problem": {
                "links": [
                    {
                        "name": name, "parent": parent, "joint": {"type": "revolute"},
                        "body": {"mass": 1.0, "inertia": [0.01, 0.02, 0.02]},
                    }
                    for name, parent in zip(names, ["ground", *names], strict=False)
                ],
                "forces": [
                    {"type": "python:ground.py:shaking", "name": f"part{i}", "on": [name]}
                    for i, name in enumerate(names)
                ],
            },
            "sample": {"n": 4},
            "integrate": {
                "dt": 0.01, "t_end": 0.1,
                "sensitivities": ["forces.part0.amplitude"],
            },
        },
        folder=tmp_path,
    )  # fmt: skip
    (parameter,) = parameters_of(study, study.batch(0, 1).problem).values()
    assert parameter.name == "shaking.amplitude"
    assert len(parameter.own_fields) == links
    assert "forces.part0.amplitude" in names_of(study, study.batch(0, 1).problem)

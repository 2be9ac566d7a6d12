"""Covariances over time, against closed forms, and where linear theory ends."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lierb
from lierb.analysis.propagation import _compared
from lierb.errors import FailedTrajectoryWarning, LierbError

TIMES = [0.5, 1.0, 2.0]
STIFFNESS, MASS = 8.0, 2.0
FREQUENCY = np.sqrt(STIFFNESS / MASS)
NAMES = ["slide_spring.stiffness", "pose0", "twist0"]


def oscillator():
    slide = lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))
    spring = lierb.forces.slide_spring(stiffness=STIFFNESS)
    return lierb.Problem(lierb.bodies.sphere(0.1, mass=MASS), slide, forces=spring)


def pendulum():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5))
    return lierb.Problem(lierb.bodies.box((0.1, 0.1, 1.0), mass=1.0), hinge, (0.0, 0.0, -9.81))


@pytest.mark.slow
def test_an_oscillators_covariance_is_the_closed_form():
    """x = x₀ cos ωt + v₀ sin ωt/ω, linear in the start; the correlation of x₀ and v₀ as well."""
    sigma = np.zeros((13, 13))
    start = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])  # of x₀ in m and v₀ in m/s
    sigma[np.ix_([4, 10], [4, 10])] = start
    spread = lierb.propagate(oscillator(), sigma, NAMES, TIMES, ["coordinates", "v"], dt=1e-3)
    for i, t in enumerate(TIMES):
        c, s = np.cos(FREQUENCY * t), np.sin(FREQUENCY * t)
        flow = np.array([[c, s / FREQUENCY], [-FREQUENCY * s, c]])
        right = flow @ start @ flow.T
        # RK4 at 1 ms: 2 · 2⁵ 1e-12 / 120
        assert_allclose(spread.linear["coordinates"][i], right[:1, :1], rtol=1e-10)
        assert_allclose(spread.linear["v"][i][0, 0], right[1, 1], rtol=1e-10)
    assert spread.holds["coordinates"].all()
    assert spread.size == 400
    # a sample of 400 has deviations to 1/√800
    assert np.abs(spread.ratio["coordinates"] - 1.0).max() < 4.0 / np.sqrt(800)
    assert np.isnan(spread.ratio["v"][:, 1:]).all()  # across the slide nothing moves


def test_quantities_without_a_spread_hold_up_to_rounding():
    rounding = np.full((3, 2, 2), 1e-32)
    for shift in (0.0, 1e-16):
        ratio, holds = _compared(np.zeros((3, 2, 2)), rounding, np.full((3, 2), shift), 20, 1e-13)
        assert np.isnan(ratio).all()
        assert holds.all()
    _, holds = _compared(np.zeros((3, 2, 2)), 1e20 * rounding, np.full((3, 2), 0.0), 20, 1e-13)
    assert not holds.any()


@pytest.mark.long
def test_a_parameter_spreads_by_its_exact_derivative():
    """∂x/∂k of x₀ cos ωt is −x₀ sin ωt · t ω/(2k)."""
    problem = oscillator()
    place = problem.joint.pose([0.3])
    spread = lierb.propagate(
        problem, dict(zip(NAMES, (0.02, 0.0, 0.0))), NAMES, TIMES, "position", pose0=place,
        dt=1e-3, monte_carlo=50,
    )  # fmt: skip
    t = np.array(TIMES)
    right = 0.3 * np.abs(np.sin(FREQUENCY * t)) * t * FREQUENCY / (2.0 * STIFFNESS) * 0.02
    assert_allclose(spread.standard_deviations("position")[:, 0], right, rtol=1e-9)


@pytest.mark.long
def test_linear_theory_ends_where_a_pendulum_loses_its_phase():
    """Near the top the period depends strongly on the amplitude; half a turn is no Gaussian."""
    problem = pendulum()
    times = np.linspace(0.5, 10.0, 20)
    spread = lierb.propagate(
        problem, {"omega0": (0.0, 0.15, 0.0)}, "omega0", times, "rotation",
        pose0=problem.joint.pose([3.0]), dt=5e-3,
    )  # fmt: skip
    end = spread.holds_until("rotation")
    assert 0.0 < end < 5.0
    # the sample's rotations are within half a turn of their mean, linear theory knows no bound
    assert spread.standard_deviations("rotation", "sample").max() < np.pi
    assert "linear theory holds until" in repr(spread)
    (panel,) = spread.plot("rotation").axes
    first, dots = panel.lines[:2]
    np.testing.assert_array_equal(first.get_ydata(), spread.standard_deviations("rotation")[:, 0])
    sample = spread.standard_deviations("rotation", "sample")
    np.testing.assert_array_equal(dots.get_ydata(), sample[:, 0])
    assert len(panel.lines) == 2 * 3 + (~spread.holds["rotation"]).sum()
    with pytest.raises(LierbError, match="quantities='omega' is unknown"):
        spread.plot("omega")
    narrow = lierb.propagate(
        problem, {"omega0": (0.0, 1e-6, 0.0)}, "omega0", times, "rotation",
        pose0=problem.joint.pose([3.0]), dt=5e-3,
    )  # fmt: skip
    assert narrow.holds["rotation"].all()


@pytest.mark.slow
@pytest.mark.parametrize("names", [NAMES, NAMES[::-1]], ids=["numbers first", "starts first"])
def test_the_covariance_of_a_fit_goes_on(names):
    problem = oscillator()
    place = problem.joint.pose([0.3])
    truth = lierb.integrate(
        problem, pose0=place, dt=1e-3, t_end=2.0, save_at=0.1 * np.arange(21), record="state"
    )
    data = {"t": truth.t, "position": truth.position}
    fit = lierb.fit(problem, data, names, pose0=place, dt=1e-3, sigma={"position": 1e-3})
    assert list(fit.estimate) == names
    spread = lierb.propagate(
        fit.problem, fit.covariance, names, [5.0], "position", **fit.start, dt=1e-3
    )

    def slopes(t):
        """∂x by k, x₀ and v₀, of x = x₀ cos ωt + v₀ sin ωt/ω at v₀ = 0."""
        s, c = np.sin(FREQUENCY * t), np.cos(FREQUENCY * t)
        return np.stack([-0.3 * s * t * FREQUENCY / (2.0 * STIFFNESS), c, s / FREQUENCY], -1)

    by = slopes(truth.t)
    right = 1e-6 * np.linalg.inv(by.T @ by)
    own = [fit.labels.index(label) for label in (NAMES[0], "pose0[3]", "twist0[3]")]
    assert_allclose(fit.covariance[np.ix_(own, own)], right, rtol=1e-6)
    later = slopes(5.0)
    deviation = np.sqrt(later @ right @ later)
    assert_allclose(spread.standard_deviations("position")[0, 0], deviation, rtol=1e-6)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"covariance": np.eye(5)}, "expected \\(6, 6\\)"),
        ({"covariance": -np.eye(6)}, "eigenvalues of 0 or more"),
        ({"covariance": {"pose0": 1.0}}, "expected an entry for each of"),
        ({"covariance": {"twist0": -1.0}}, "expected deviations, 0 or more"),
        ({"parameters": ()}, "parameters is empty"),
        ({"times": [1.0, 0.5]}, "ascending"),
        ({"of": "twst"}, "Did you mean 'twist'"),
        ({"times": [-1.0, 1.0]}, "^times has -1.0 s, which is not within"),
        ({"times": [1.0, 2.0], "t_end": 1.5}, "^times has 2.0 s, which is not within"),
        ({"parameters": "twst0"}, "^parameters='twst0' is unknown"),
        ({"parameters": ["twist0", "omega0"]}, "omega0 is a part of twist0, leave out omega0"),
        ({"covariance": np.full((6, 6), np.nan)}, "covariance has numbers that are not finite"),
        ({"of": []}, "of is empty"),
        ({"monte_carlo": 0}, "linear theory is not shown without a sample"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(given, message):
    arguments = {"covariance": {"twist0": 0.1}, "parameters": "twist0", "times": [1.0]} | given
    with pytest.raises(LierbError, match=message):
        lierb.propagate(oscillator(), **arguments)


@pytest.mark.long
def test_runs_of_the_sample_that_fail_are_told():
    """Bodies that spin fast need more steps than they may take."""
    flight = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, 0.25)), lierb.joints.free())
    start = {"twist0": (1.0, 0.5, 0.2, 0.0, 0.0, 0.0), "rtol": 1e-8, "max_steps": 40}
    with pytest.warns(FailedTrajectoryWarning, match="of 100 runs of the sample failed"):
        spread = lierb.propagate(
            flight, {"omega0": 5.0}, "omega0", [2.0], "omega", monte_carlo=100, **start
        )
    assert 0 < spread.failed < 100
    assert spread.size + spread.failed == 100


@lierb.controller(every=0.1, size=0.3)
def wind(params):
    return {"push": params.size * lierb.noise.normal("wind", 1)[0]}


@lierb.wrench(drag=0.4)
def pushed(t, R, r, omega, v, params, controls):
    return (0.0, 0.0, 0.0), np.array([controls.push, 0.0, 0.0]) - params.drag * v


@pytest.mark.slow
def test_the_sample_has_the_noise_of_the_nominal_run():
    """The wrench is linear: linear theory is exact, whatever the noise."""
    body, free = lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.free()
    made = lierb.Problem(body, free, forces=pushed(), controllers=wind())
    spread = {"twist0": [0.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3]}
    run = {"dt": 0.01, "of": "position", "monte_carlo": 200}
    for options in ({}, {"trajectories": [2]}):
        found = lierb.propagate(made, spread, "twist0", [0.5, 1.0], **run, **options)
        assert found.holds["position"].all()

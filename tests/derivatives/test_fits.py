"""Many fits side by side agree with single ones, cover their scatter, and flag those that fail."""

from __future__ import annotations

import warnings
from functools import cache

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lierb
from derivatives.complex_steps import H
from lierb.analysis import many_fits
from lierb.analysis.least_squares import steps_of, triangular
from lierb.analysis.pseudo_inertia import SIZES, body_of, coordinates_of, derivatives_of
from lierb.errors import FailedFitWarning, LierbError
from lierb.runs import driver

TIMES = np.linspace(0.0, 5.0, 51)
RUN = {"dt": 2e-2}
DAMPING, STIFFNESS = "torsional_spring.damping", "torsional_spring.stiffness"
FITTED = (DAMPING, STIFFNESS, "omega0")
SIGMA = 0.02
HINGE = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5))
BOX = lierb.bodies.box((0.1, 0.1, 1.0), mass=1.0)


def pendulum(damping=0.02, stiffness=0.4, gravity=(0.0, 0.0, -9.81)):
    spring = lierb.forces.torsional_spring(stiffness=stiffness, damping=damping)
    return lierb.Problem(BOX, HINGE, gravity, spring)


@cache
def swung() -> lierb.Result:
    """Run the pendulum by the kernel of the fits: derivatives change no bit (test_of_runs.py)."""
    start = {"pose0": HINGE.pose([1.0]), "t_end": 5.0, "save_at": TIMES, "record": "state"}
    return lierb.integrate(pendulum(), **start, **RUN, with_respect_to=FITTED)


def measured(count: int, seed=0) -> dict[str, np.ndarray]:
    """Rates of the pendulum with noise, (times, count, 3)."""
    rng = np.random.default_rng(seed)
    rates = np.broadcast_to(swung().omega, (len(TIMES), count, 3)).copy()
    rates[..., 1] += SIGMA * rng.standard_normal(rates.shape[:2])
    return {"t": TIMES, "omega": rates}


def fitted(problem, data, names=FITTED, **more):
    given = {"pose0": HINGE.pose([1.0]), "sigma": {"omega": SIGMA}} | RUN | more
    return lierb.fits(problem, data, names, **given)


def assert_same(many, i: int, single, names=()) -> None:
    """Compare experiment i with a single fit.   names : of estimates, all by default."""
    for name, exact in single.estimate.items():
        if names and name not in names:
            continue
        # SciPy stops a millionth of a standard error before numbers that are zero but for noise
        most = 1e-8 * np.abs(exact).max() + 1e-6 * single.standard_errors[name]
        assert np.all(np.abs(many.estimate[name][i] - exact) <= most)
    deviations = np.sqrt(np.diag(single.covariance))
    deviations[deviations < 1e-12] = 1.0  # of directions that the joint does not admit
    off = (many.covariance[i] - single.covariance) / np.outer(deviations, deviations)
    assert np.abs(off).max() < 1e-6
    assert_allclose(many.chi2[i], single.chi2, rtol=1e-9)
    assert many.freedoms[i] == single.freedoms
    assert many.labels == single.labels


# ---- as single fits ----------------------------------------------------------------------------


@pytest.mark.slow
def test_fits_agree_with_single_fits_and_cover_the_scatter():
    """500 fits of noisy data: scatter over covariance within 10 %, chi-square of its mean."""
    data = measured(500)
    many = fitted(pendulum(0.1, 0.0), data, [DAMPING, STIFFNESS, "omega0"])
    assert many.converged.all()
    single = lierb.fit(
        pendulum(0.1, 0.0), {"t": TIMES, "omega": data["omega"][:, 7]},
        [DAMPING, STIFFNESS, "omega0"], pose0=HINGE.pose([1.0]), sigma={"omega": SIGMA}, **RUN,
    )  # fmt: skip
    assert_same(many, 7, single)
    ratios = np.concatenate([many.ratio[DAMPING], many.ratio[STIFFNESS], many.ratio["omega0"][1:2]])
    assert np.all((ratios > 0.9) & (ratios < 1.1)), ratios
    indices = [0, 1, 3]
    truth = [0.02, 0.4, 0.0]
    offsets = (
        np.column_stack(
            [many.estimate[DAMPING], many.estimate[STIFFNESS], many.estimate["omega0"][:, 1]]
        )
        - truth
    )
    inverse = np.linalg.inv(many.covariance[:, indices][..., indices])
    distances = np.einsum("ni,nij,nj->n", offsets, inverse, offsets)
    assert abs(np.mean(distances) - 3.0) < 5.0 * np.sqrt(6.0 / 500)  # five standard errors
    # the noise has one component of three
    assert_allclose(np.mean(many.reduced_chi2), (len(TIMES) - 3) / many.freedoms[0], rtol=0.03)
    assert not many.misfit.any()
    assert "converged" in repr(many)
    assert "500 of 500" in repr(many)


@pytest.mark.slow
def test_small_oscillations_agree_with_linear_theory():
    """J x″ = −c ẋ − k x of small amplitude: estimates have the covariance σ² (SᵀS)⁻¹.

    S : slopes by c, k and the rate at the start, by complex steps of the closed form, in which
    γ = c/(2J) and ω₁² = k/J − γ².
    """
    moment, angle, count = float(BOX.inertia[1, 1]) + 0.25, 1e-4, 800
    truth = np.array((0.02, 0.4, 0.0))  # c, k and the rate

    def rates(x):
        decay, square = x[0] / (2.0 * moment), x[1] / moment
        frequency = np.sqrt(square - decay**2)
        sine, cosine = np.sin(frequency * TIMES), np.cos(frequency * TIMES)
        swing = -angle * square / frequency * sine
        return np.exp(-decay * TIMES) * (swing + x[2] * (cosine - decay / frequency * sine))

    slopes = np.column_stack([rates(truth + 1j * H * e).imag for e in np.eye(3)]) / H
    sigma = 1e-3 * angle * np.sqrt(truth[1] / moment)
    inverse = np.linalg.inv(slopes.T @ slopes)
    noise = sigma * np.random.default_rng(4).standard_normal((len(TIMES), count))
    data = {"t": TIMES, "omega": np.zeros((len(TIMES), count, 3))}
    data["omega"][..., 1] = rates(truth)[:, None] + noise
    many = fitted(
        pendulum(0.03, 0.5, gravity=(0.0, 0.0, 0.0)), data, pose0=HINGE.pose([angle]),
        sigma={"omega": sigma},
    )  # fmt: skip
    assert many.converged.all()
    linear = noise.T @ slopes @ inverse
    for i, (name, k) in enumerate(((DAMPING, 0), (STIFFNESS, 0), ("omega0", 1))):
        deviation = sigma * np.sqrt(inverse[i, i])
        assert_allclose(many.standard_errors[name][:, k], deviation, rtol=2e-3)  # by the noise
        # of the order of a relative deviation of k
        offsets = many.estimate[name][:, k] - truth[i]
        assert_allclose(offsets / deviation, linear[:, i] / deviation, atol=2e-2)


@pytest.mark.slow
def test_experiments_of_several_trajectories_have_starts_of_their_own():
    poses = HINGE.pose(np.array([[0.5], [1.0]]))
    rng = np.random.default_rng(1)
    rates = 0.2 * rng.standard_normal((3, 2))
    starts = HINGE.twist(omega=np.stack([0.0 * rates, rates, 0.0 * rates], -1).reshape(6, 3))
    truth = lierb.integrate(
        pendulum(), pose0=np.tile(poses, (3, 1, 1)), twist0=starts, **RUN, t_end=5.0,
        save_at=TIMES, record="state",
    )  # fmt: skip
    rates = truth.omega + SIGMA * rng.standard_normal(truth.omega.shape)
    data = {"t": TIMES, "omega": rates.reshape(len(TIMES), 3, 2, 3)}
    names = {DAMPING: 0.05, STIFFNESS: [0.3], "omega0": None}
    many = fitted(pendulum(), data, names, pose0=poses)
    assert many.converged.all()
    assert many.estimate["omega0"].shape == many.standard_errors["omega0"].shape == (3, 2, 3)
    by_list = fitted(
        pendulum(), [{"t": TIMES, "omega": data["omega"][:, i]} for i in range(3)], names,
        pose0=poses,
    )  # fmt: skip
    assert_allclose(by_list.estimate[DAMPING], many.estimate[DAMPING], rtol=1e-12)
    for i in range(3):
        single = lierb.fit(
            pendulum(), {"t": TIMES, "omega": data["omega"][:, i]}, names, pose0=poses,
            sigma={"omega": SIGMA}, **RUN,
        )  # fmt: skip
        assert_same(many, i, single)
    # problem and start are those of the estimate
    again = lierb.integrate(many.problem, **many.start, **RUN, t_end=5.0)
    assert_allclose(again.omega, truth.omega[-1], atol=5.0 * SIGMA)


OF_START = ["pose0", "omega0", "joint.body_point"]


def hung(length):
    """Guess of a pendulum at another point, and options of a fit of its angles."""
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, length))
    guess = lierb.Problem(BOX, hinge, (0.0, 0.0, -9.81), pendulum().forces)
    return guess, {"pose0": hinge.pose([1.1]), "sigma": {"coordinates": 0.01}} | RUN


def measured_angles() -> dict[str, np.ndarray]:
    rotation = swung().rotation
    angles = np.arctan2(-rotation[..., 2, 0], rotation[..., 0, 0])
    noise = 0.01 * np.random.default_rng(5).standard_normal((len(TIMES), 3))
    return {"t": TIMES, "coordinates": angles + noise}


@pytest.mark.slow
def test_a_start_and_a_point_of_the_joint_agree_with_single_fits():
    data = measured_angles()
    guess, options = hung(0.47)
    many = lierb.fits(guess, data, OF_START, **options)
    assert many.converged.all()
    one = {"t": TIMES, "coordinates": data["coordinates"][:, 1:2]}
    single = lierb.fit(guess, one, OF_START, **options)
    assert_same(many, 1, single, ["omega0"])
    for name, told in (("joint.body_point", [0, 2]), ("pose0", [0, 2])):  # all but along the axis
        assert_allclose(many.estimate[name][1][told], single.estimate[name][told], atol=1e-8)
    assert [str(each) for each in many.unidentifiable] == ["joint.body_point[1] has no effect"]


@pytest.mark.slow
def test_angles_of_bodies_that_differ_within_an_experiment():
    """The joints of the second experiment were those behind the last of the bodies."""
    points = np.array([(0.0, 0.0, 0.5), (0.0, 0.0, 0.3)])
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=points)
    two = lierb.Problem(BOX, hinge, (0.0, 0.0, -9.81), pendulum(0.1).forces)
    options = {"pose0": hinge.pose([1.0]), "sigma": {"coordinates": 0.01}} | RUN
    moved = lierb.integrate(
        two, pose0=options["pose0"], t_end=5.0, save_at=TIMES, record="state", **RUN
    )
    angles = np.arctan2(-moved.rotation[..., 2, 0], moved.rotation[..., 0, 0])
    noise = 0.01 * np.random.default_rng(5).standard_normal((3, *angles.shape))
    data = [{"t": TIMES, "coordinates": angles + own} for own in noise]
    many = lierb.fits(two, data, DAMPING, **options)
    assert many.converged.all()
    assert_same(many, 2, lierb.fit(two, data[2], DAMPING, **options))


@pytest.mark.long
def test_a_mass_and_a_start_of_a_mechanism_agree_with_single_fits():
    """The other link follows the start by least kinetic energy: at the mass of the guess."""
    from mechanisms.shared import double_pendulum

    mechanism = double_pendulum()
    start = {"pose0": mechanism.pose({"upper": 1.0, "lower": 0.3}), "dt": 1e-2}
    truth = lierb.integrate(mechanism, **start, t_end=2.0, save_every=10, record="state")
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(truth.t), 3, 3))
    rates = truth["lower"].omega + noise
    mass = mechanism.link("lower").body.mass
    names = {"lower.body.mass": 1.3 * mass, "upper.omega0": None}
    options = {"sigma": {"lower.omega": 1e-3}} | start
    many = lierb.fits(mechanism, {"t": truth.t, "lower.omega": rates}, names, **options)
    assert many.converged.all()
    one = {"t": truth.t, "lower.omega": rates[:, 1]}
    single = lierb.fit(mechanism, one, names, **options)
    assert single.evaluations < 12  # 21 with directions at the mass of each trial
    assert_same(many, 1, single)


INERTIA = np.array([[0.9, 0.05, -0.02], [0.05, 1.2, 0.03], [-0.02, 0.03, 1.5]])


@pytest.mark.slow
def test_tumbles_from_a_far_guess_tell_the_ratios_of_the_inertia():
    def free(inertia):
        return lierb.Problem(lierb.Body(10.0, inertia), lierb.joints.free())

    spin = np.array([0.3, 1.0, 0.2, 0.0, 0.0, 0.0])
    truth = lierb.integrate(
        free(INERTIA), twist0=spin, dt=1e-2, t_end=20.0, save_every=25, record="state"
    )
    noise = 1e-4 * np.random.default_rng(6).standard_normal((len(truth.t), 4, 3))
    noise[:, 0] = 0.0
    many = lierb.fits(
        free(np.diag([1.0, 1.2, 1.4])), {"t": truth.t, "omega": truth.omega + noise},
        ["body.inertia", "omega0"], twist0=1.01 * spin, dt=1e-2,
    )  # fmt: skip
    assert many.converged.all()
    assert many.not_told.tolist() == [1, 1, 1, 1]
    assert "common scale of body.inertia" in many.unidentifiable[0].sentence
    exact = INERTIA[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] / 0.9
    estimate = many.estimate["body.inertia"]
    ratios = estimate / estimate[:, :1]
    assert_allclose(ratios[0], exact, atol=1e-9)
    assert_allclose(ratios[1:], np.broadcast_to(exact, (3, 6)), atol=5e-3)
    assert np.isinf(many.standard_errors["body.inertia"]).all()
    assert np.isfinite(many.standard_errors["omega0"]).all()


@pytest.mark.long
def test_scatter_of_a_body_and_the_starts_of_its_throws_is_covered():
    """34 unknowns: mass, centre of mass and inertia, and the starts of four throws."""
    rng, (n, m) = np.random.default_rng(0), (200, 4)
    spring = lierb.forces.spring_damper(
        body_point=(0.3, 0.1, 0.2), ground_point=(0.0, 0.0, 1.0), stiffness=4.0, damping=0.1,
        length=0.5,
    )  # fmt: skip

    def throw(mass, com):
        body = lierb.Body(mass, INERTIA, com=com)
        return lierb.Problem(body, lierb.joints.free(), (0.0, 0.0, -1.0), spring)

    starts, times = 0.5 * rng.standard_normal((m, 6)), np.linspace(0.04, 4.0, 100)
    truth = lierb.integrate(
        throw(10.0, (0.02, -0.01, 0.03)), twist0=starts, dt=2e-2, t_end=4.0, save_at=times,
        record="state",
    )  # fmt: skip
    sigma = {"omega": 2e-3, "pose": 1e-3}
    poses = np.zeros((100, 1, m, 4, 4))
    poses[..., :3, :3], poses[..., :3, 3] = truth.rotation[:, None], truth.position[:, None]
    poses[..., 3, 3] = 1.0
    data = {
        "t": times,
        "omega": truth.omega[:, None] + sigma["omega"] * rng.standard_normal((100, n, m, 3)),
        "pose": poses @ lierb.lie.se3.exp(sigma["pose"] * rng.standard_normal((100, n, m, 6))),
    }
    names = ["body.mass", "body.com", "body.inertia", "twist0"]
    many = lierb.fits(
        throw(10.5, (0.0, 0.0, 0.02)), data, names, sigma=sigma, twist0=starts, dt=2e-2
    )
    assert many.converged.all()
    assert len(many.labels) == 34
    ratios = np.concatenate([many.ratio[name].ravel() for name in names])
    # the standard deviation of 200 has one of 5 %; the largest of 34 is within three of them
    assert abs(np.sqrt(np.mean(ratios**2)) - 1.0) < 0.05
    assert np.all(np.abs(ratios - 1.0) < 0.16)


# ---- failures ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_experiments_that_fail_are_flagged_and_leave_the_others_alone():
    data = measured(4)
    data["omega"][:, 1] = 40.0 * np.sin(17.0 * TIMES)[:, None]  # no pendulum
    data["omega"][3, 2] = np.nan  # a missing sample
    spins = np.zeros((4, 6))
    spins[3] = HINGE.twist(omega=(0.0, 1e8, 0.0))
    with pytest.warns(FailedFitWarning, match="fits have not converged"):
        many = fitted(pendulum(0.1), data, twist0=spins, max_iterations=12)
    assert many.converged[[0, 2]].all()
    assert not many.converged[3]
    assert "the run of the guess fails" in many.status[3]
    assert "non_finite" in many.status[3]
    for name in (DAMPING, STIFFNESS):
        assert np.isnan(many.estimate[name][3]).all()
        assert np.isnan(many.standard_errors[name][3]).all()
    assert not many.converged[1] or many.misfit[1]
    assert many.freedoms[:3].tolist() == [150, 150, 147]
    alone = fitted(pendulum(0.1), {"t": TIMES, "omega": data["omega"][:, :1]})
    assert_allclose(alone.estimate[DAMPING][0], many.estimate[DAMPING][0], rtol=1e-12)
    assert "fit 3" in repr(many) or "fit 1" in repr(many)
    table = many.table
    assert table.num_rows == 4
    assert table["converged"].to_pylist() == many.converged.tolist()
    assert f"{DAMPING}.error" in table.column_names


def test_an_experiment_without_samples_leaves_the_others_alone():
    data = measured(4)
    whole = fitted(pendulum(0.1), data)
    data["omega"][:, 2] = np.nan
    with pytest.warns(FailedFitWarning, match="1 of 4 fits has not converged; the first is fit 2"):
        many = fitted(pendulum(0.1), data)
    assert many.converged.tolist() == [True, True, False, True]
    assert many.status[2] == "too few data: 0 samples for 3 unknown numbers"
    assert many.iterations[2] == 0
    for name in many.parameters:
        assert np.isnan(many.estimate[name][2]).all()
        assert np.isnan(many.standard_errors[name][2]).all()
        assert_allclose(many.estimate[name][[0, 1, 3]], whole.estimate[name][[0, 1, 3]], rtol=1e-12)
    assert np.isnan(many.covariance[2]).all()
    assert np.isnan(many.chi2[2])
    assert sum(line.endswith(", held") for line in repr(many).splitlines()) == 2


def test_max_iterations_is_reported():
    with pytest.warns(FailedFitWarning, match="max_iterations is reached"):
        many = fitted(pendulum(0.1, 0.0), measured(2), max_iterations=1)
    assert not many.converged.any()
    assert many.iterations.tolist() == [1, 1]


@pytest.mark.slow
def test_directions_that_data_do_not_tell_are_named():
    guess, options = hung(0.5)
    many = lierb.fits(guess, measured_angles(), OF_START, **options)
    assert many.converged.all()
    assert many.not_told.tolist() == [1, 1, 1]
    assert many.unidentifiable[0].sentence == "joint.body_point[1] has no effect"
    assert np.isinf(many.standard_errors["joint.body_point"][:, 1]).all()
    assert np.isfinite(many.standard_errors["joint.body_point"][:, 2]).all()
    assert "not told" in repr(many)


def test_few_at_a_time_are_the_same_fits(monkeypatch):
    data = measured(5)
    whole = fitted(pendulum(0.1), data)
    monkeypatch.setattr(many_fits, "ROOM", 1)
    seen = []
    alone = fitted(pendulum(0.1), data, progress=lambda done, total: seen.append((done, total)))
    for name in (DAMPING, STIFFNESS):
        assert_allclose(alone.estimate[name], whole.estimate[name], rtol=1e-12)
    assert seen[-1] == (5, 5)
    assert sorted(seen) == seen


def test_an_interrupted_fit_leaves_nothing_behind():
    def stop(done, total):
        raise KeyboardInterrupt

    data = measured(2)
    with pytest.raises(KeyboardInterrupt):
        fitted(pendulum(0.1), data, progress=stop)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fitted(pendulum(0.1), data).converged.all()


def test_fits_run_on_the_callers_number_of_threads(monkeypatch):
    """Numba's number of threads is that of a Python thread: fits must not run in another one."""
    used, running = set(), driver.running
    monkeypatch.setattr(driver, "running", lambda count: used.add(count) or running(count))
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        fitted(pendulum(0.1), measured(40))
    finally:
        numba.set_num_threads(before)
    assert used == {1}
    with pytest.raises(lierb.errors.ArgumentError, match="threads=0; expected 1"):
        fitted(pendulum(0.1), measured(2), threads=0)


def test_numbers_and_guesses_may_differ_between_experiments():
    data = measured(3)
    same = fitted(pendulum(0.03, 0.5), data)
    by_problem = fitted(pendulum([0.02, 0.03, 0.04], 0.5), data)
    by_guess = fitted(
        pendulum(), data, {DAMPING: [0.02, 0.03, 0.04], STIFFNESS: 0.5, "omega0": None}
    )
    for many in (by_problem, by_guess):
        assert_allclose(many.estimate[DAMPING], same.estimate[DAMPING], rtol=1e-7)


# ---- formulas ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "k"), [(2, 5), (5, 5), (40, 3), (3000, 4), (700, 17)])
def test_triangular_factors_have_the_gram_matrix_of_the_rows(count, k):
    rows = np.random.default_rng(0).standard_normal((3, count, k))
    factors = triangular(rows)
    assert factors.shape == (3, k, k)
    assert_allclose(
        factors.swapaxes(-1, -2) @ factors, rows.swapaxes(-1, -2) @ rows, atol=1e-12 * count
    )


def test_steps_are_those_of_least_squares_within_the_radius():
    rng = np.random.default_rng(1)
    jacobians, residuals = rng.standard_normal((2, 20, 3)), rng.standard_normal((2, 20))
    factors = triangular(np.concatenate([jacobians, residuals[..., None]], -1))
    scales = np.ones((2, 3))
    whole = steps_of(factors, scales, np.full(2, np.inf))
    for i in range(2):
        exact = -np.linalg.lstsq(jacobians[i], residuals[i], rcond=None)[0]
        assert_allclose(whole.change[i], exact, rtol=1e-9)
        after = np.sum((jacobians[i] @ exact + residuals[i]) ** 2)
        assert_allclose(whole.predicted[i], np.sum(residuals[i] ** 2) - after, rtol=1e-9)
    short = steps_of(factors, scales, 0.1 * whole.length)
    assert short.is_limited.all()
    assert not whole.is_limited.any()
    assert_allclose(short.length, 0.1 * whole.length, rtol=1e-9)
    for i in range(2):  # the shortest way to the same decrease is none shorter
        gradient = jacobians[i].T @ (jacobians[i] @ short.change[i] + residuals[i])
        assert_allclose(np.cross(gradient, short.change[i]), 0.0, atol=1e-9)


def test_stacks_of_bodies_have_the_coordinates_of_each():
    rng = np.random.default_rng(3)
    factors = rng.standard_normal((4, 4, 4))
    pseudo = factors @ factors.swapaxes(-1, -2)
    mass, com = pseudo[:, 3, 3], pseudo[:, :3, 3] / pseudo[:, 3, 3, None]
    second = pseudo[:, :3, :3]
    matrices = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    inertia = matrices[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    stack = coordinates_of(mass, com, inertia)
    bodies, slopes = body_of(stack), derivatives_of(stack)
    assert_allclose(bodies["inertia"], inertia, rtol=1e-10, atol=1e-12)
    for i in range(4):
        own = coordinates_of(mass[i], com[i], inertia[i])
        for name in SIZES:
            assert_allclose(stack[name][i], own[name], rtol=1e-14)
        for pair, slope in derivatives_of(own).items():
            whole = slopes[pair]
            assert_allclose(whole[i] if whole.ndim == 3 else whole, slope, rtol=1e-13, atol=1e-13)


# ---- errors ------------------------------------------------------------------------------------

GOOD = {"t": [0.5, 1.0], "omega": np.zeros((2, 4, 3))}


@pytest.mark.parametrize(
    ("data", "more", "message"),
    [
        (GOOD, {"parameters": ()}, "parameters is empty"),
        (GOOD, {"parameters": {DAMPING: [0.1, 0.2]}}, r"a finite number, or .*\(4, 1\)"),
        (GOOD, {"parameters": ["omega0", "twist0"]}, "omega0 is a part of twist0"),
        (GOOD | {"t": [-0.5, 1.0]}, {}, "data: t has -0.5 s"),
        (GOOD, {"max_iterations": 0}, "expected a whole number"),
        (GOOD, {"progress": 3}, "progress=3"),
        (GOOD, {"bounds": {}}, "option='bounds' is unknown"),
        (GOOD, {"twist0": np.zeros((3, 6))}, "data has 4 experiments of 1 trajectory,"),
        (GOOD, {"sigma": {}}, "sigma lacks omega"),
        (GOOD, {"pose0": np.diag([1.0, 2.0, 1.0, 1.0])}, "pose0"),
        (GOOD, {"dt": 0.3}, "t_end"),
        ({"t": [0.5], "omga": np.zeros((1, 2, 3))}, {}, "Did you mean 'omega'"),
        ({"t": [0.5], "omega": np.zeros((1, 2, 2, 2, 3))}, {}, "omega has shape"),
        (
            {"t": [0.5], "omega": np.zeros((1, 2, 2, 3)), "v": np.zeros((1, 2, 3, 3))}, {},
            "number of trajectories by experiment",
        ),
        ([[GOOD], [GOOD, GOOD]], {}, r"data\[1\] has 8 trajectories and data\[0\] 4"),
        ({"t": [0.5], "omega": np.full((1, 2, 3), np.nan)}, {}, "no experiment has enough data"),
    ],
)  # fmt: skip
def test_arguments_that_do_not_fit_are_refused(data, more, message):
    given = {"parameters": DAMPING} | more
    names = given.pop("parameters")
    with pytest.raises(LierbError, match=message):
        fitted(pendulum(), data, names, **given)


def test_memory_is_estimated_before(monkeypatch):
    monkeypatch.setattr("lierb.support.memory.available", lambda: 1 << 10)
    monkeypatch.setattr("lierb.support.memory.ALWAYS", 0)
    with pytest.raises(lierb.errors.MemoryLimitError, match="a run of the fits takes"):
        fitted(pendulum(), measured(4))


LENGTH, MASS = 1e-3, 1e-6  # of a tiny system, m, kg
TINY = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5 * LENGTH))
SCALE = MASS * LENGTH**2


def tiny_pendulum(damping, stiffness) -> lierb.Problem:
    """A pendulum of 1 mm and 1 mg moves as one of 1 m does under a thousandth of the gravity."""
    spring = lierb.forces.torsional_spring(damping=damping * SCALE, stiffness=stiffness * SCALE)
    box = lierb.bodies.box((0.1 * LENGTH, 0.1 * LENGTH, LENGTH), mass=MASS)
    return lierb.Problem(box, TINY, (0.0, 0.0, -9.81 * LENGTH), spring)


@pytest.mark.parametrize("guess", [(0.0, 0.3), pytest.param((0.0, 0.0), marks=pytest.mark.slow)])
def test_a_guess_of_zero_in_a_tiny_system_has_a_size(guess):
    tiny = tiny_pendulum(*guess)
    data = measured(2)
    wanted = fitted(pendulum(), data)
    many = fitted(tiny, data, pose0=TINY.pose([1.0]))
    single = lierb.fit(
        tiny, {"t": TIMES, "omega": data["omega"][:, :1]}, (DAMPING, STIFFNESS, "omega0"),
        pose0=TINY.pose([1.0]), sigma={"omega": SIGMA}, **RUN,
    )  # fmt: skip
    assert many.converged.all()
    assert single.converged
    assert not single.unidentifiable
    for name in (DAMPING, STIFFNESS):
        off = 1e-4 * wanted.standard_errors[name]  # iterations end within thousandths of them
        assert np.all(np.abs(many.estimate[name] / SCALE - wanted.estimate[name]) < off)
        assert np.all(np.abs(single.estimate[name] / SCALE - wanted.estimate[name][0]) < off[0])


def test_fits_that_take_the_places_of_others_are_the_same(monkeypatch):
    """Beside fits that had begun, a number that is zero at the guess had the size 1."""
    data, pose0 = measured(4), TINY.pose([1.0])
    stiffness = SCALE * np.array([0.4, 0.1, 0.8, 0.3])
    guesses = {DAMPING: 0.0, STIFFNESS: stiffness, "omega0": None}
    whole = fitted(tiny_pendulum(0.0, 0.4), data, guesses, pose0=pose0)
    monkeypatch.setattr(many_fits.Experiments, "bytes_each", 1)
    monkeypatch.setattr(many_fits, "ROOM", 2)
    few = fitted(tiny_pendulum(0.0, 0.4), data, guesses, pose0=pose0)
    assert len({*whole.iterations[:2]}) == 2  # the third one begins beside one of them
    assert not few.not_told.any()
    for name in (DAMPING, STIFFNESS):
        assert_allclose(few.estimate[name], whole.estimate[name], rtol=1e-12)


@pytest.mark.slow
def test_starts_have_the_size_of_the_system():
    """A ball of 1e-10 m, 1e-9 m from its anchor; its turns have no effect."""
    size = 1e-9
    mass, start = 1e3 * size**3, np.eye(4)

    def ball(stiffness, damping):
        spring = lierb.forces.spring_damper(
            stiffness=stiffness * mass, damping=damping * mass, length=0.0
        )
        body = lierb.bodies.sphere(0.1 * size, mass=mass)
        return lierb.Problem(body, lierb.joints.free(), (0.0, 0.0, 0.0), spring)

    start[:3, 3] = size * np.array([1.0, 0.2, 0.1])
    moved = lierb.integrate(
        ball(2.0, 0.1), pose0=start, t_end=5.0, save_at=TIMES, record="state", **RUN
    )
    noise = np.random.default_rng(0).standard_normal((len(TIMES), 1, 3))
    data = {"t": TIMES, "position": moved.position + 0.01 * size * noise}
    start[:3, 3] = size * np.array([0.9, 0.1, 0.2])
    names = ["spring_damper.stiffness", "spring_damper.damping", "pose0", "twist0"]
    fit = lierb.fit(
        ball(1.9, 0.0), data, names, sigma={"position": 0.01 * size}, pose0=start,
        max_evaluations=30, **RUN,
    )  # fmt: skip
    assert fit.chi2 < 1.5 * fit.freedoms  # it was 50 times as much, and called a minimum
    for name, exact in zip(names[:2], (2.0, 0.1), strict=True):
        assert abs(fit.estimate[name][0] / mass - exact) < 5.0 * fit.standard_errors[name][0] / mass

"""Fits recover the truth, their covariance covers it, and they name what data cannot tell."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import lierb
from derivatives.test_of_mechanisms import double_pendulum
from lierb.analysis.bounds import bounds_of
from lierb.analysis.fit_task import Task
from lierb.analysis.fitting import _sides
from lierb.analysis.identifiability import described, identified
from lierb.analysis.measurements import measurements
from lierb.analysis.pseudo_inertia import SIZES, body_of, coordinates_of, derivatives_of
from lierb.analysis.unknowns import Unknowns
from lierb.errors import ArgumentError, InertiaError, LierbError, PoseError
from lierb.runs.parameters import SYMMETRIC, chosen_parameters, separate_parameters
from lierb.runs.variations import Variation, with_start

TIMES = np.linspace(0.0, 5.0, 51)
INERTIA = np.array([[0.9, 0.05, -0.02], [0.05, 1.2, 0.03], [-0.02, 0.03, 1.5]])
SPIN = np.array([0.3, 1.0, 0.2, 0.0, 0.0, 0.0])
RUN = {"dt": 1e-2}
DAMPING, STIFFNESS = "torsional_spring.damping", "torsional_spring.stiffness"


def entries(inertia) -> np.ndarray:
    return np.array([inertia[i, j] for i, j in SYMMETRIC])


def pendulum(damping=0.02, stiffness=0.0, observables=()):
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5))
    spring = lierb.forces.torsional_spring(stiffness=stiffness, damping=damping)
    body = lierb.bodies.box((0.1, 0.1, 1.0), mass=1.0)
    return lierb.Problem(body, hinge, (0.0, 0.0, -9.81), spring, observables=observables)


def swing(problem, **more):
    start = {"pose0": problem.joint.pose([1.0])}
    return start, lierb.integrate(
        problem, **start, **RUN, **more, t_end=5.0, save_at=TIMES, record="state"
    )


@cache
def swung() -> lierb.Result:
    return swing(pendulum())[1]


def angles(result) -> np.ndarray:
    rotation = result.rotation
    return np.arctan2(rotation[..., 0, 2], rotation[..., 0, 0])


def data_of(result, *names, noise=0.0, seed=0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    own = {name: np.asarray(getattr(result, name)) for name in names}
    noisy = {k: x + noise * rng.standard_normal(x.shape) for k, x in own.items()}
    return {"t": result.t, **noisy}


def fitted(problem, data, parameters, **more) -> lierb.analysis.fit_result.Fit:
    return lierb.fit(
        problem, data, parameters, **({"pose0": problem.joint.pose([1.0])} | RUN | more)
    )


# ---- truth -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_fit_recovers_the_parameters_of_exact_data():
    fit = fitted(pendulum(0.3, 0.5), data_of(swung(), "omega"), [DAMPING, STIFFNESS, "omega0"])
    assert fit.converged
    assert_allclose(fit.estimate[DAMPING], [0.02], rtol=1e-9)
    assert_allclose(fit.estimate[STIFFNESS], [0.0], atol=1e-9)
    assert_allclose(fit.estimate["omega0"], 0.0, atol=1e-9)
    assert fit.unidentifiable == ()
    assert_allclose(fit.problem.forces[0].parameters["damping"], 0.02, rtol=1e-9)
    # the run and the start are those of the estimate
    again = lierb.integrate(fit.problem, **fit.start, **RUN, t_end=5.0)
    assert_allclose(again.omega[0], swung().omega[-1, 0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [1e-6, 1e6])
def test_a_fit_ends_after_the_evaluations_that_were_allowed(sigma):
    given = data_of(swung(), "omega")
    fit = fitted(pendulum(0.3, 0.5), given, [DAMPING], sigma={"omega": sigma}, max_evaluations=3)
    assert fit.evaluations == 3
    assert not fit.converged
    assert fit.status.startswith("max_evaluations is reached")


@pytest.mark.slow
def test_a_fit_that_cannot_go_on_has_not_converged(monkeypatch):
    """SciPy reports small steps as convergence, whatever the gradient."""

    def refused(task, x):
        if x[0] < 0.1:
            raise PoseError("no such start")
        return varied(task, x)

    varied = Task.varied
    monkeypatch.setattr(Task, "varied", refused)
    unknown = [DAMPING, STIFFNESS, "omega0"]
    fit = fitted(pendulum(0.3, 0.5), data_of(swung(), "omega"), unknown)
    assert not fit.converged
    assert fit.status.endswith("for there is no run nearby: no such start")
    assert fit.estimate[DAMPING][0] == pytest.approx(0.1, rel=0.1)
    guess = swing(pendulum(0.3, 0.5))[1]
    assert fit.chi2 < np.sum((guess.omega - swung().omega) ** 2)


@pytest.mark.long
@pytest.mark.parametrize("column", ["rotation", "quaternion", "coordinates", "pose"])
def test_every_column_recovers_the_start_and_the_length(column):
    truth = swung()
    values = {
        "coordinates": angles(truth), "pose": lierb_poses(truth),
    }  # fmt: skip
    data = {"t": truth.t, column: values.get(column, getattr(truth, column, None))}
    guess = pendulum()
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.45))
    guess = lierb.Problem(guess.body, hinge, guess.gravity, guess.forces)
    names = ["pose0", "joint.body_point"]
    fit = lierb.fit(guess, data, names, pose0=hinge.pose([1.2]), **RUN)
    # gravity and inertia of a point on the axis alone: x moves the axis sideways
    point = fit.estimate["joint.body_point"]
    assert_allclose(point[[0, 2]], [0.0, 0.5], atol=1e-8)
    assert_allclose(hinge_angle(fit), 1.0, atol=1e-8)


def hinge_angle(fit) -> float:
    rotation = fit.start["pose0"][:3, :3]
    return float(np.arctan2(rotation[0, 2], rotation[0, 0]))


def lierb_poses(result) -> np.ndarray:
    poses = np.zeros((*result.rotation.shape[:2], 4, 4))
    poses[..., :3, :3], poses[..., :3, 3], poses[..., 3, 3] = result.rotation, result.position, 1.0
    return poses


@pytest.mark.slow
def test_damping_agrees_with_a_fit_of_an_equation_of_its_own():
    data = data_of(swung(), "omega", noise=1e-2)
    fit = fitted(pendulum(0.1), data, DAMPING, dt=2e-3)
    body = pendulum().body
    moment = float(body.inertia[1, 1]) + 0.25

    def residuals(x):
        def rates(t, y):
            return y[1], (-9.81 * 0.5 * np.sin(y[0]) - x[0] * y[1]) / moment

        run = solve_ivp(rates, (0.0, 5.0), (1.0, 0.0), t_eval=TIMES, rtol=1e-10, atol=1e-12)
        return run.y[1] - data["omega"][:, 0, 1]

    own = least_squares(residuals, [0.1], xtol=1e-12, ftol=1e-12)
    assert_allclose(fit.estimate[DAMPING], own.x, rtol=1e-6)
    # the two other components have noise as well, which the variance takes in
    deviation = np.sqrt(fit.reduced_chi2 / (own.jac.T @ own.jac)[0, 0])
    assert_allclose(fit.standard_errors[DAMPING], deviation, rtol=1e-4)


@pytest.mark.slow
def test_missing_samples_tables_and_lists_give_the_same_fit():
    truth = swung()
    data = data_of(truth, "omega", noise=1e-2)
    data["omega"][7] = np.nan
    whole = fitted(pendulum(0.1), data, DAMPING)
    kept = np.delete(np.arange(51), 7)
    cut = {"t": data["t"][kept], "omega": data["omega"][kept]}
    frame = truth.to_pandas("history")[["t", "omega_x", "omega_y", "omega_z"]]
    exact = fitted(pendulum(0.1), frame, DAMPING)
    history = truth.history.select(["trajectory", "t", "omega"])
    for other in (cut, [cut]):
        fit = fitted(pendulum(0.1), other, DAMPING)
        assert_allclose(
            fit.estimate[DAMPING],
            whole.estimate[DAMPING],
            rtol=1e-9,
        )
    for other in (history, data_of(truth, "omega")):
        fit = fitted(pendulum(0.1), other, DAMPING)
        assert_allclose(
            fit.estimate[DAMPING],
            exact.estimate[DAMPING],
            rtol=1e-9,
        )
    assert np.isnan(whole.residuals["omega"][7]).all()


@pytest.mark.slow
def test_several_trajectories_share_parameters_and_have_starts_of_their_own():
    problem = pendulum(0.02, 0.4)
    starts = problem.joint.pose(np.array([[0.5], [1.0], [1.5]]))
    rates = problem.joint.twist(omega=np.array([[0, 0.2, 0], [0, -0.3, 0], [0, 0.5, 0.0]]))
    truth = lierb.integrate(
        problem, pose0=starts, twist0=rates, **RUN, t_end=5.0, save_at=TIMES, record="state"
    )
    data = data_of(truth, "omega")
    fit = fitted(
        pendulum(0.05, 0.5), data, [DAMPING, STIFFNESS, "omega0"], pose0=starts, twist0=None,
        sigma={"omega": 1e-3},
    )  # fmt: skip
    assert_allclose(fit.estimate[DAMPING], [0.02], rtol=1e-9)
    assert_allclose(fit.estimate[STIFFNESS], [0.4], rtol=1e-9)
    assert_allclose(fit.estimate["omega0"], truth.omega[0], atol=1e-9)
    assert fit.estimate["omega0"].shape == fit.standard_errors["omega0"].shape == (3, 3)
    assert "omega0[2][1]" in fit.labels
    # the joint admits one of three directions of each start
    assert np.linalg.matrix_rank(fit.covariance, tol=1e-16) == 5
    assert fit.unidentifiable == ()


@pytest.mark.long
def test_a_mechanism_with_names_of_links_is_fitted():
    from mechanisms.shared import double_pendulum

    mechanism = double_pendulum()
    pose0 = mechanism.pose({"upper": 1.0, "lower": 0.3})
    truth = lierb.integrate(mechanism, pose0=pose0, **RUN, t_end=2.0, save_every=10, record="state")
    rates = truth["lower"].omega
    data = {"t": truth.t, "lower.omega": rates, "upper.coordinates": truth_angles(mechanism, truth)}
    mass = mechanism.link("lower").body.mass
    fit = lierb.fit(mechanism, data, {"lower.body.mass": 1.3 * mass}, pose0=pose0, **RUN)
    assert_allclose(fit.estimate["lower.body.mass"], [mass], rtol=1e-9)


def truth_angles(mechanism, result) -> np.ndarray:
    poses = {name: lierb_poses(result[name])[:, 0] for name in ("upper", "lower")}
    return mechanism.coordinates(poses)["upper"]


# ---- what data cannot tell ---------------------------------------------------------------------


def tumbling(inertia, mass=10.0):
    return lierb.Problem(lierb.Body(mass, inertia), lierb.joints.free())


@pytest.mark.slow
def test_a_gyro_of_a_tumbling_body_tells_ratios_of_the_inertia_but_no_scale():
    truth = lierb.integrate(
        tumbling(INERTIA), twist0=SPIN, **RUN, t_end=20.0, save_every=25, record="state"
    )
    fit = lierb.fit(
        tumbling(np.diag([1.0, 1.2, 1.4])), data_of(truth, "omega"), ["body.inertia", "omega0"],
        twist0=1.01 * SPIN, **RUN,
    )  # fmt: skip
    (direction,) = fit.unidentifiable
    assert direction.sentence == "the common scale of body.inertia has no effect"
    estimate = fit.estimate["body.inertia"]
    assert_allclose(estimate / estimate[0], entries(INERTIA) / INERTIA[0, 0], atol=1e-9)
    assert_allclose(fit.estimate["omega0"], SPIN[:3], atol=1e-9)
    assert np.isinf(fit.standard_errors["body.inertia"]).all()
    assert np.isfinite(fit.standard_errors["omega0"]).all()
    assert "not told" in repr(fit)
    assert fit.problem.body.inertia[0, 1] == estimate[3]


@pytest.mark.long
def test_two_springs_in_parallel_are_told_in_sum_only():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5))
    body = lierb.bodies.box((0.1, 0.1, 1.0), mass=1.0)

    def problem(*stiffness):
        springs = [lierb.forces.torsional_spring(stiffness=k) for k in stiffness]
        return lierb.Problem(body, hinge, (0.0, 0.0, -9.81), springs)

    data = data_of(swing(problem(1.0, 3.0))[1], "omega")
    names = [f"torsional_spring_{i}.stiffness" for i in (1, 2)]
    fit = fitted(problem(1.5, 2.0), data, [*names, "gravity"])
    sentences = [each.sentence for each in fit.unidentifiable]
    assert any(all(name in sentence for name in names) for sentence in sentences)
    assert "gravity[1] has no effect" in sentences
    assert_allclose(sum(fit.estimate[name][0] for name in names), 4.0, rtol=1e-8)
    assert_allclose(fit.estimate["gravity"][2], -9.81, rtol=1e-8)
    pair = next(each for each in fit.unidentifiable if names[0] in each.changes)
    assert_allclose(pair.changes[names[0]], -pair.changes[names[1]], rtol=1e-6)


def test_hidden_directions_of_a_matrix_are_found_and_named():
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((20, 5)) * (1.0, 1e6, 1.0, 1e-3, 1.0)
    jacobian[:, 2] = 2.0 * jacobian[:, 0]
    jacobian[:, 4] = 0.0
    told = identified(jacobian, np.ones(5))
    assert told.rank == 3
    assert told.is_known.tolist() == [False, True, False, True, False]
    assert np.abs(jacobian @ told.null.T).max() < 1e-12
    names, values, units = "abcde", np.array([1.0, 1.0, 3.0, 1.0, 1.0]), ["m"] * 5
    sentences = {described(each, names, values, units).sentence for each in told.null}
    assert "e has no effect" in sentences
    assert any("a by" in text and "c by" in text for text in sentences)
    kept = np.ix_([1, 3], [1, 3])
    whole = np.linalg.inv((x := jacobian[:, [0, 1, 3]]).T @ x)[1:, 1:]
    assert_allclose(told.covariance[kept], whole, rtol=1e-9)


def test_directions_of_many_numbers_are_described_in_a_line():
    names = [f"drag.coefficient[{i}]" for i in range(20)]
    changes = 1.0 + np.arange(20.0) ** 2
    direction = described(changes, names, np.ones(20), [""] * 20)
    assert len(direction.changes) == 20
    assert "\n" not in direction.sentence
    assert "[16]" not in direction.sentence
    assert direction.sentence.startswith("drag.coefficient[19] by +1, drag.coefficient[18] by")
    assert direction.sentence.endswith("and 17 other numbers together have no effect")
    one_scale = described(np.ones(20), names, np.ones(20), [""] * 20)
    assert one_scale.sentence == "the common scale of drag.coefficient has no effect"


# ---- statistics --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_model_that_does_not_explain_the_data_is_said_to():
    """Of the same data and sigma, a model without the spring does not; without sigma who knows."""
    sigma = {"omega": 0.02}
    data = data_of(swing(pendulum(0.02, 0.4))[1], "omega", noise=0.02)
    right, wrong = (fitted(pendulum(0.1, k), data, DAMPING, sigma=sigma) for k in (0.4, 0.0))
    assert right.misfit == ""
    assert "misfit" not in repr(right)
    assert wrong.reduced_chi2 > 4.0
    assert "A force may be missing" in wrong.misfit
    assert "does not explain the data: residuals are" in repr(wrong)
    assert fitted(pendulum(0.1, 0.0), data, DAMPING).misfit == ""
    assert replace(wrong, freedoms=0).misfit == ""  # as many unknowns as samples


@pytest.mark.slow
def test_covariance_of_names_is_a_block():
    data = data_of(swing(pendulum(0.02, 0.4))[1], "omega", noise=0.02)
    fit = fitted(pendulum(0.1, 0.4), data, [DAMPING, STIFFNESS, "omega0"], sigma={"omega": 0.02})
    whole = fit.covariance
    assert fit.labels == (DAMPING, STIFFNESS, *(f"omega0[{i}]" for i in range(3)))
    np.testing.assert_array_equal(fit.covariance_of("omega0"), whole[2:, 2:])
    turned = fit.covariance_of("omega0[1]", DAMPING)
    np.testing.assert_array_equal(turned, whole[np.ix_([3, 0], [3, 0])])
    deviation = np.sqrt(fit.covariance_of(DAMPING))[0]
    np.testing.assert_array_equal(deviation, fit.standard_errors[DAMPING])
    with pytest.raises(LierbError, match=r"name='dampign' is unknown.*torsional_spring.damping"):
        fit.covariance_of("dampign")
    residuals, matrix, _ = fit.plot().axes  # the last one is the scale of the colours
    drawn = np.array([line.get_ydata() for line in residuals.lines[:3]])
    np.testing.assert_array_equal(drawn, fit.residuals["omega"][:, 0].T)
    np.testing.assert_array_equal(matrix.images[0].get_array(), fit.correlation)


@pytest.mark.slow
@pytest.mark.parametrize("experiments", [0, pytest.param(2, marks=pytest.mark.long)])
def test_errors_of_a_start_on_a_hinge_are_those_of_a_straight_line(experiments):
    """φ = φ₀ + ω t on a hinge 0.5 m from the frame: a turn of the start moves the frame, too."""
    hinge = lierb.joints.revolute(body_point=(0.5, 0.0, 0.0))
    wheel = lierb.Problem(lierb.Body(1.0, (0.5, 0.6, 0.7)), hinge)
    t, sigma = np.linspace(0.0, 2.0, 21), 0.01
    data = {"t": t, "coordinates": (0.3 + 0.2 * t)[:, None]}
    start = {"pose0": hinge.pose([0.3]), "twist0": hinge.twist(omega=(0.0, 0.0, 0.2)), "dt": 0.02}
    names, noise = ["pose0", "twist0"], {"coordinates": sigma}
    if experiments:
        data["coordinates"] = np.stack([data["coordinates"]] * experiments, axis=1)
        found = lierb.fits(wheel, data, names, sigma=noise, **start)
    else:
        found = lierb.fit(wheel, data, names, sigma=noise, **start)
    errors = {name: np.atleast_2d(found.standard_errors[name])[0] for name in names}
    turning = np.array((0.0, 0.0, 1.0, 0.0, -0.5, 0.0))  # of the frame, about the hinge
    spread = np.sum((t - t.mean()) ** 2)
    right = sigma * np.sqrt(1.0 / len(t) + t.mean() ** 2 / spread)
    assert_allclose(errors["pose0"], right * np.abs(turning), rtol=1e-9, atol=1e-16)
    assert_allclose(
        errors["twist0"], sigma / np.sqrt(spread) * np.abs(turning), rtol=1e-9, atol=1e-16
    )
    covariance = found.covariance[0] if experiments else found.covariance
    assert_allclose(covariance[2, 4], right**2 * turning[4], rtol=1e-9)


@pytest.mark.long
def test_covariance_covers_the_scatter_of_estimates():
    """500 fits of noisy data: scatter over covariance within 10 %, chi-square of its mean."""
    truth = {DAMPING: 0.02, STIFFNESS: 0.4}
    names = [*truth, "omega0"]
    problem = pendulum(0.02, 0.4)
    exact = swing(problem)[1]
    sigma, offsets, chi2 = 0.05, [], []
    for seed in range(500):
        data = data_of(exact, "omega", noise=sigma, seed=seed)
        fit = fitted(problem, data, names, sigma={"omega": sigma})
        estimate = np.array([*(fit.estimate[n][0] for n in truth), fit.estimate["omega0"][1]])
        offsets.append(estimate - [*truth.values(), 0.0])
        chosen = np.ix_(indices := [0, 1, 3], indices)
        chi2.append(offsets[-1] @ np.linalg.solve(fit.covariance[chosen], offsets[-1]))
    deviations = np.sqrt(np.diag(fit.covariance))[indices]
    ratios = np.std(offsets, axis=0) / deviations
    assert np.all((ratios > 0.9) & (ratios < 1.1)), ratios
    assert abs(np.mean(chi2) - 3.0) < 5.0 * np.sqrt(6.0 / 500)  # five standard errors


# ---- physical bodies ---------------------------------------------------------------------------


def test_log_cholesky_coordinates_invert_and_have_exact_derivatives():
    rng = np.random.default_rng(2)
    for _ in range(5):
        factor = rng.standard_normal((4, 4))
        pseudo = factor @ factor.T
        mass, com = pseudo[3, 3], pseudo[:3, 3] / pseudo[3, 3]
        inertia = entries(np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3])
        at = coordinates_of(mass, com, inertia)
        for name, value in (("mass", [mass]), ("com", com), ("inertia", inertia)):
            assert_allclose(
                body_of(at)[name], value, rtol=1e-12, atol=1e-14 * np.abs(inertia).max()
            )
        exact = derivatives_of(at)
        for name, size in SIZES.items():
            for i in range(size):
                ends = []
                for h in (1e-6, -1e-6):
                    moved = {k: x.copy() for k, x in at.items()}
                    moved[name][i] += h
                    ends.append(body_of(moved))
                for row in SIZES:
                    slope = (ends[0][row] - ends[1][row]) / 2e-6
                    own = exact.get((row, name))
                    own = np.zeros(SIZES[row]) if own is None else own[:, i]
                    assert_allclose(
                        own, slope, rtol=1e-6, atol=1e-7 * (1.0 + np.abs(inertia).max())
                    )


def test_a_body_at_the_limit_cannot_be_varied():
    with pytest.raises(InertiaError, match="flat body or a rod"):
        coordinates_of(1.0, np.zeros(3), np.array([1.0, 1.0, 2.0, 0.0, 0.0, 0.0]))


# ---- errors ------------------------------------------------------------------------------------

GOOD = {"t": [0.5, 1.0], "omega": np.zeros((2, 3))}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"omega": np.zeros((2, 3))}, 'data has no column "t", .* its columns are omega$'),
        ([GOOD, {"v": np.zeros((2, 3))}], r'data\[1\] has no column "t"'),
        ({"t": [0.5, 1.0], "omega_x": [0.0, 0.0]}, "data has omega_x without omega_y, omega_z;"),
        ({"t": [0.5, 1.0], "quaternion": 3.0 * np.ones((2, 4))}, r"length 6; .*\(w, x, y, z\)"),
        ({"t": [0.5, 1.0], "quaternion": [[0.0] * 4, [1.0, 0.0, 0.0, 0.0]]}, "one of length 0;"),
        ({"t": [0.5, 1.0], "pose": np.tile(np.eye(4) + np.eye(4, k=-3), (2, 1, 1))}, "last row"),
        ({"t": [0.5, 1.0]}, "no measured column"),
        ({"t": [0.5, 1.0], "omga": np.zeros((2, 3))}, "Did you mean 'omega'"),
        ({"t": [1.0, 0.5], "omega": np.zeros((2, 3))}, "does not ascend"),
        ({"t": [0.5, 1.0], "omega": np.zeros((3, 3))}, r"omega has shape \(3, 3\)"),
        ({"t": [0.5, 1.0], "rotation": np.ones((2, 3, 3))}, "no rotations"),
        ({"t": [0.5], "omega": np.full((1, 3), np.nan)}, "has 0 samples for 1 unknown number;"),
        ({"t": [-1.0, 1.0], "omega": np.zeros((2, 3))}, "data: t has -1.0 s, .* not within t0"),
        ({"t": [0.0], "omega": np.zeros((1, 3))}, "data: t ends at 0.0 s; expected a time later"),
        ({"t": [0.505], "omega": np.zeros((1, 3))}, "data: t ends at 0.505 s.* the nearest are"),
        ({"t": [np.nan, 1.0], "omega": np.zeros((2, 3))}, r"t\[0\] is nan; leave out"),
        ({"t": [0.5, 1.0], "omega": np.full((2, 3), np.inf)}, "infinite numbers; a missing"),
        (3.0, "a dictionary or a table"),
        ([], "data is empty"),
        ([GOOD, {"t": [1.0]}], "expected those of data"),
    ],
)  # fmt: skip
def test_data_that_are_none_are_refused(data, message):
    with pytest.raises(LierbError, match=message):
        fitted(pendulum(), data, DAMPING)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": ()}, "parameters is empty"),
        ({"parameters": "torsional_spring.dampng"}, "parameters='torsional_.* Did you mean"),
        ({"parameters": [DAMPING, DAMPING]}, f"parameters names {DAMPING} twice"),
        ({"parameters": ["twist0", DAMPING, "omega0"]}, "omega0 is a part of twist0, leave out"),
        ({"parameters": {"body.com": None}, "cspace": "SO3xR3"}, "^parameters: body.com cannot"),
        ({"parameters": {DAMPING: [0.1, 0.2]}}, r"shape \(2,\); expected a finite number$"),
        (
            {"parameters": {"body.com": [0.1, 0.2]}},
            r"3 finite numbers, body.com\[0\], body.com\[1\]",
        ),
        ({"parameters": {DAMPING: np.nan}}, r"\]=nan; expected a finite number$"),
        ({"t_end": 0.7}, "data: t has 1.0 s, which is not within"),
        ({"dt": -1.0}, "^dt=-1.0"),
        ({"sigma": {"omega": 0.0}}, "expected a positive number"),
        ({"sigma": {}}, "sigma lacks omega"),
        ({"sigma": {"omega": 1.0, "v": 1.0}}, "sigma='v' is unknown"),
        ({"bounds": {DAMPING: (1.0, 2.0)}}, "with the guess between"),
        ({"bounds": {"body.mass": (1.0, 2.0)}}, "bounds='body.mass' is unknown"),
        ({"parameters": {"omega0": [1.0, 0.0, 0.0]}}, "give {'omega0': None}"),
        ({"parameters": {"body.mass": -1.0}}, "the guess of parameters: mass is -1.0"),
        ({"max_evaluations": 0}, "expected a whole number"),
        ({"save_every": 3}, "option='save_every' is unknown"),
        ({"twist0": np.zeros((4, 6))}, "data has 1 trajectory and"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(options, message):
    given = {"parameters": DAMPING} | options
    with pytest.raises(ValueError, match=message):
        fitted(pendulum(), GOOD, **given)


@pytest.mark.slow
def test_bounds_are_kept():
    bounds = {DAMPING: (0.05, 1.0)}
    fit = fitted(pendulum(0.1), data_of(swung(), "omega"), DAMPING, bounds=bounds)
    assert 0.05 <= fit.estimate[DAMPING][0] < 0.0501
    assert fit.status.endswith(f"; {DAMPING} is at its lower bound")
    assert f"{DAMPING}  0.05, at its lower bound\n" in repr(fit)
    told = replace(fit, has_sigma=True, chi2=1e6).misfit
    assert told.index(f"{DAMPING} is at its lower bound") < told.index("A force may be missing")
    inside = fitted(pendulum(0.1), data_of(swung(), "omega"), DAMPING, bounds={DAMPING: (0.0, 1.0)})
    assert "bound" not in inside.status + repr(inside)


def test_only_variables_that_a_bound_stops_are_at_it():
    """Minima of (x − m)²/2: beyond the bounds, inside them, and beside one of them."""
    minima, low, high = np.array([-3.0, 0.5, 2.0, 1e-8]), np.zeros(4), np.ones(4)
    for start in (0.2, 0.8):
        solution = least_squares(lambda x: x - minima, np.full(4, start), bounds=(low, high))
        assert _sides(solution, low, high).tolist() == [-1.0, 0.0, 1.0, 0.0]


@pytest.mark.parametrize("mass", np.linspace(0.1, 1.9, 37))
def test_a_mass_that_ended_at_its_bound_begins_again_there(mass):
    """The logarithm of the mass, rounded on the way to the model and back, may lie outside."""
    coordinate = 0.5 * np.log(mass)
    for _ in range(3):
        body = lierb.Body(np.exp(2.0 * coordinate), INERTIA)
        problem = lierb.Problem(body, lierb.joints.free())
        chosen = chosen_parameters(problem, ["body.mass", "body.inertia"])
        unknowns = Unknowns(Variation(with_start(problem, None, None), chosen, 0.0), 1)
        low, high = bounds_of(unknowns, {"body.mass": (mass, 2.0)})
        coordinate = unknowns.base[0]
        assert low[0] <= coordinate <= high[0]
        assert_allclose(low[0], 0.5 * np.log(mass), rtol=1e-12, atol=1e-15)


def test_two_names_of_a_point_and_starts_of_different_links():
    arm = double_pendulum()
    with pytest.raises(LierbError, match=r"parent_point is another name of lower.joint.ground_po"):
        separate_parameters(arm, ["lower.joint.ground_point", "lower.joint.parent_point"])
    with pytest.raises(LierbError, match=r"lower.omega0 is a part of lower.twist0"):
        separate_parameters(arm, ["lower.omega0", "upper.omega0", "lower.twist0"])
    names = ["lower.omega0", "upper.twist0", "lower.pose0", "lower.joint.parent_point"]
    assert [p.name for p in separate_parameters(arm, names)] == names


def test_numbered_components_of_a_data_frame_are_put_together():
    """`Result.to_pandas` numbers the multipliers: lambda_1 … lambda_5."""
    rows = np.arange(10.0).reshape(2, 5)
    data = {"t": [0.5, 1.0]} | {f"lambda_{i + 1}": rows[:, i] for i in range(5)}
    (column,) = measurements(pendulum(), data, None).columns
    assert column.quantity.name == "lambda"
    assert np.array_equal(column.values[:, 0], rows)
    del data["lambda_4"]
    with pytest.raises(LierbError, match="data has lambda_1 without lambda_4; expected all"):
        measurements(pendulum(), data, None)


def test_quaternions_may_be_rounded_and_of_either_sign():
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    turn = Rotation.random(5, rng=3)
    data = {"t": np.arange(1.0, 6.0), "quaternion": -turn.as_quat()[:, [3, 0, 1, 2]].round(3)}
    data["quaternion"][2] = np.nan
    (column,) = measurements(flight, data, None).columns
    known = [0, 1, 3, 4]
    assert_allclose(column.values[known, 0], turn.as_matrix()[known], atol=3e-3)
    assert not column.present[2].any()


@pytest.mark.long
def test_a_printed_fit_shows_the_pose_and_what_the_joint_holds():
    """The rotation vector of a hinge about y at angle φ is (0, φ, 0)."""
    data = data_of(swung(), "omega", noise=1e-2)
    lines = repr(fitted(pendulum(), data, "pose0", pose0=pendulum().joint.pose([0.9]))).splitlines()
    vector = re.search(r"pose0 +rotation vector \(0, (.*), 0\) rad, position \((.*)\) m", lines[1])
    assert abs(float(vector[1]) - 1.0) < 0.01
    place = -0.5 * np.array([np.sin(float(vector[1])), 0.0, np.cos(float(vector[1]))])
    assert_allclose([float(x) for x in vector[2].split(",")], place, rtol=1e-6)
    held = [i for i in range(6) if lines[2 + i].endswith("ε, held")]
    assert held == [0, 2, 4, 5]  # at a hinge about y, a body turns about y and moves along its x
    assert "ε ± " in lines[3]
    exact = data_of(swung(), "omega")
    assert "held" not in repr(replace(fitted(pendulum(), exact, "pose0"), chi2=0.0))


@pytest.mark.slow
def test_a_whole_history_is_read_without_the_errors_of_joints():
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    run = {"twist0": np.ones(6), "dt": 0.1, "t_end": 0.2, "save_every": 1, "record": "state"}
    history = lierb.integrate(flight, **run).history
    for table in (history, history.to_pandas()):
        columns = measurements(flight, table, None).columns
        assert [c.quantity.name for c in columns] == ["rotation", "position", "omega", "v"]


@lierb.event(terminal=True)
def at_ground(r):
    return r[2] + 0.5


@pytest.mark.slow
def test_a_guess_that_ends_before_the_data_is_told():
    body = lierb.Body(1.3, (0.02, 0.02, 0.02))
    drag = lierb.forces.drag(linear=0.5)
    made = lierb.Problem(body, lierb.joints.free(), (0.0, 0.0, -9.0), drag, events=at_ground())
    t = np.linspace(0.1, 0.5, 5)
    data = {"t": t, "position": -2.0 * t[:, None] ** 2 * np.array([0.0, 0.0, 1.0])}
    with pytest.raises(ArgumentError, match=r"guess is not finite .* event ends it at t = 0\.34"):
        lierb.fit(made, data, "drag.linear")


@pytest.mark.slow
@pytest.mark.parametrize("fit", [lierb.fit, lierb.fits])
def test_coordinates_of_trajectories_with_joints_of_their_own(fit):
    """Rows of all times were put into joints as if each were a body: refused, or mixed up."""
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.8, 0.6], [0.6, 0.8, 0.0]])
    joint = lierb.joints.revolute(axis=axes, body_point=(0.0, 0.0, 0.5))

    def held(damping):
        body = lierb.Body([1.0, 1.2, 0.9], (0.1, 0.1, 0.1))
        spring = lierb.forces.torsional_spring(damping=damping)
        return lierb.Problem(body, joint, (0.0, 0.0, -9.81), spring)

    t = np.linspace(0.2, 1.0, 5)
    run = {"pose0": joint.pose([[0.5]] * 3), "dt": 1e-2}
    moved = lierb.integrate(held(0.02), t_end=1.0, save_at=t, record="state", **run)
    names = "torsional_spring.damping"
    by_rate = fit(held(0.01), {"t": t, "omega": moved.omega}, names, **run)
    poses = np.zeros((5, 3, 4, 4))
    poses[..., :3, :3], poses[..., :3, 3] = moved.rotation.reshape(5, 3, 3, 3), moved.position
    poses[..., 3, 3] = 1.0
    angles = np.stack([joint.coordinates(each) for each in poses])
    by_angle = fit(held(0.01), {"t": t, "coordinates": angles}, names, **run)
    for found in (by_rate, by_angle):
        np.testing.assert_allclose(np.ravel(found.estimate[names]), 0.02, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("level", [1e-17, 1e-14, 1e-10, 1e-4])
def test_data_may_be_small_beside_the_misfit_of_the_guess(level):
    """The first step was as short as the data are small: the fit ended at the guess."""
    ball = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, 0.3)), lierb.joints.free())
    data = {"t": np.linspace(0.1, 1.0, 10)}
    data["twist"] = level * np.random.default_rng(0).normal(size=(10, 1, 6))
    for call in (lierb.fit, lierb.fits):
        fit = call(ball, data, "twist0", twist0=(0.0, 0.5, 0.0, -0.1, 0.0, 0.0), dt=0.05)
        assert np.all(fit.converged)
        assert np.abs(fit.estimate["twist0"]).max() < 2.0 * level + 1e-12

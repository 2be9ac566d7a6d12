"""docs/jobs/inertia.md: estimate against the inertia of the data, scatter against covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

import lierb

from .page import names_of

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("inertia", tmp_path_factory.mktemp("inertia"))


@pytest.fixture(scope="module")
def refit(page):
    """Fit with other noise.   noise : (times, 3), rad/s."""
    clean = page["rates"](page["most"])

    def fitted(noise):
        data = {"t": page["t"], "omega": clean + noise}
        return lierb.fit(
            page["model"](page["most"]), data, page["unknown"],
            twist0=page["start"], **page["options"],
        )  # fmt: skip

    return fitted


def test_estimate_is_the_inertia_of_the_data(page):
    """χ² of six numbers, with the covariance of the fit: below its 99.9 % quantile."""
    off = page["estimate"] - page["truth"]
    assert off @ np.linalg.solve(page["fit"].covariance[:6, :6], off) < chi2.ppf(0.999, 6)
    assert page["worst"] < 1e-3  # as the page says


def test_residuals_are_the_noise(page):
    fit = page["fit"]
    low, high = chi2.ppf((0.001, 0.999), fit.freedoms)
    assert fit.converged
    assert low < fit.chi2 < high


def test_without_noise_the_inertia_is_exact(page, refit):
    """RK4 with 0.25 s, rates of 0.1 rad/s: 1e-8 of the rates, 1e-4 of the errors by noise."""
    fit = refit(np.zeros((len(page["t"]), 3)))
    assert (np.abs(fit.estimate["body.inertia"] - page["truth"]) < 1e-3 * page["errors"]).all()


def test_without_the_wheel_the_ratios_are_right_and_the_scale_is_not_told(page):
    """Ratios: 1e-3, more than four of their standard errors of some 2e-4."""
    free, truth = page["free"], page["truth"]
    assert len(free.unidentifiable) == 1
    assert "common scale" in free.unidentifiable[0].sentence
    assert np.isinf(free.standard_errors["body.inertia"]).all()
    assert np.abs(page["ratios"][:3] - truth[:3] / truth[0]).max() < 1e-3


@pytest.mark.long
def test_scatter_of_repeated_fits_is_the_covariance(page, refit):
    """The sum of χ² over 40 fits of nine numbers is that of 360 freedoms: 0.1 % at each end.

    The nine variances separately have 40 freedoms each, and as much at each end in all.
    """
    rng = np.random.default_rng(7)
    truth = np.concatenate([page["truth"], page["omega0"]])
    offs, covariance = [], page["fit"].covariance
    for _ in range(40):
        estimate = refit(rng.normal(scale=page["sigma"], size=(len(page["t"]), 3))).estimate
        offs.append(np.concatenate([estimate["body.inertia"], estimate["omega0"].ravel()]) - truth)
    offs = np.array(offs)
    total = np.einsum("ij,ij->", offs, np.linalg.solve(covariance, offs.T).T)
    low, high = chi2.ppf((0.001, 0.999), offs.size)
    assert low < total < high
    low, high = chi2.ppf((0.001 / 9, 1 - 0.001 / 9), len(offs))
    squares = (offs**2).sum(axis=0) / covariance.diagonal()
    assert ((low < squares) & (squares < high)).all()

"""docs/jobs/debris.md against exponential decay, SciPy and the law of eddy currents."""

from __future__ import annotations

import numpy as np
import pytest

from .page import names_of

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("debris", tmp_path_factory.mktemp("debris"))


def test_pure_spins_decay_exponentially(page):
    """Times J/K ln(ω₀/limit): the tolerance of the run is 1e-9, its location of events likewise."""
    assert page["event"].num_rows == page["n"]
    assert page["spun"] < 1e-8


def test_slowest_stage_moves_as_scipy_integrates_eulers_equations(page):
    """Global error of the run with rtol 1e-9: 1e-7 of 5 °/s is ample."""
    assert page["off"] < 5e-7


def test_slowest_stage_is_captured_when_scipy_says(page):
    """Rates saved every 5 min bracket the time; between them the decay is nearly exponential."""
    rate = np.linalg.norm(page["peer"].y, axis=0)
    limit = np.radians(0.5)
    after = np.flatnonzero(rate > limit)[-1]
    hours = page["t"][after : after + 2]
    part = np.log(rate[after] / limit) / np.log(rate[after] / rate[after + 1])
    estimate = hours[0] + part * np.diff(hours)[0]
    assert abs(page["captured"][page["worst"]] - estimate) < 1e-3  # h: curvature of ln|ω|


def test_every_stage_is_captured_and_stays_slow(page):
    captured, t, rate = page["captured"], page["t"], page["rate"]
    assert np.isfinite(captured).all()
    later = t[:, None] > captured
    assert rate[later].max() < 0.5
    assert page["sure"].low < page["late"] < page["sure"].high


def test_median_is_that_of_a_flat_spin(page):
    """Spin about a transverse axis, nominal: 3 % for the spin about z and 3 % by sampling."""
    K = 1e-6 / 3 * (9e5 + 7e5)
    omega0 = np.radians(np.hypot(4.0, 2.0))
    flat = 6000.0 / K * np.log(omega0 / np.radians(0.5)) / 3600.0
    assert abs(page["median"] / flat - 1.0) < 0.06


def test_matrix_is_the_mean_of_the_law_over_all_directions_of_the_field(page):
    """Means of bbᵀ over ±e₁, ±e₂, ±e₃ are those over the sphere, and the law is quadratic in b."""
    tensor, field, omega = np.array((9e5, 8e5, 7e5)), 1e-3, np.array((0.03, -0.05, 0.02))
    law = [
        np.cross(tensor * np.cross(omega, field * b), field * b)
        for b in np.concatenate([np.eye(3), -np.eye(3)])
    ]
    K = field**2 / 3 * (tensor.sum() - tensor)
    assert np.allclose(np.mean(law, axis=0), -K * omega, rtol=1e-14)

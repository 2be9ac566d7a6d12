"""docs/jobs/cable.md against the weight, the pendulum of a point mass, and Bessel's function J₀."""

from __future__ import annotations

import numpy as np
import pytest

from .page import names_of

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("cable", tmp_path_factory.mktemp("cable"))


def test_force_at_rest_is_the_weight(page):
    assert not page["result"].failed.size
    assert page["at_rest"] < 1e-13  # rounding


def test_swing_is_that_of_a_point_mass(page):
    """The rope's mass, 1 to 3 % of the load's, and angles up to 0.25 rad change it by 3 %."""
    assert np.abs(page["after"] / page["point"] - 1.0).max() < 0.03


def test_frequency_converges_to_the_zero_of_bessel(page):
    """A quarter at twice as many rods."""
    ratio = page["off"][20] / page["off"][40]
    assert page["off"][40] < 3e-5
    assert 3.6 < ratio < 4.6

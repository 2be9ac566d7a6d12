"""docs/jobs/linkage.md against the cosine law."""

from __future__ import annotations

import numpy as np
import pytest

from .page import names_of

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("linkage", tmp_path_factory.mktemp("linkage"))


def test_every_pose_is_that_of_the_cosine_law(page):
    """Loops are closed to 1e-12 of the lengths; the angle amplifies this by no more than 10."""
    assert page["made"].shape == (300, 37)
    assert page["worst"] < 1e-11


def test_bars_keep_their_lengths(page):
    """Distances of the pins by hand, from the wiper's angle: coupler and crank."""
    crank, coupler, rocker, base = (page["drawn"][k][:, None] for k in page["drawing"])
    angles, wiper = page["angles"], page["made"]
    x = base + rocker * np.cos(wiper) - crank * np.cos(angles)
    y = rocker * np.sin(wiper) - crank * np.sin(angles)
    assert np.abs(np.hypot(x, y) - coupler).max() < 1e-12


def test_scatter_is_that_of_linear_shares(page):
    """300 machines: a standard deviation is known to 4 %, those of all angles are correlated."""
    assert abs(page["ratio"] - 1.0) < 0.12
    total = sum(np.mean(x**2) for x in page["share"].values())
    assert np.isclose(total, np.mean(page["sigma"] ** 2), rtol=1e-12)

"""docs/jobs/arm.md against momentum: torques from the prescribed motion alone, by differences."""

from __future__ import annotations

import numpy as np
import pytest

from .page import names_of

pytestmark = pytest.mark.long
STEP = 2e-3  # s, of the differences
GRAVITY = np.array((0.0, 0.0, -9.81))  # m/s²


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("arm", tmp_path_factory.mktemp("arm"))


def turned(axis: int, angle: float) -> np.ndarray:
    """Rotation about y (1) or z (2)."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == 2:
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def places(page, t: float, member: int) -> np.ndarray:
    """Rotations and centres of mass of the four bodies, and the elbow."""
    s = t / page["T"]
    part = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    q = [page["begin"][k] + (page["end"][k] - page["begin"][k]) * part for k in page["begin"]]
    column = turned(2, q[0])
    upper = column @ turned(1, q[1])
    fore = upper @ turned(1, q[2])
    elbow = upper[:, 0] * page["reach"][0]
    gripper = elbow + fore @ (page["place"][member] + (page["reach"][1], 0.0, 0.0))
    return (
        np.array([column, upper, fore, fore]),
        np.array(
            [np.zeros(3), upper[:, 0] * page["reach"][0] / 2, elbow + fore[:, 0] * 0.2, gripper]
        ),
        elbow,
    )


def slope(values):
    """First derivative in the middle of five equidistant values; error of order STEP⁴."""
    return (values[0] - 8.0 * values[1] + 8.0 * values[3] - values[4]) / (12.0 * STEP)


def bend(values):
    a, b, c, d, e = values
    return (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) / (12.0 * STEP**2)


def torques(page, t: float, member: int) -> list[float]:
    """Torque of each motor: rate of angular momentum of all that it moves, less that of gravity."""
    masses = 6.0, 4.0, 2.5, page["mass"][member]
    bodies = [link.body for link in page["links"]]
    inertias = [
        np.asarray(b.inertia if b.inertia.ndim == 2 else b.inertia[member])
        - m * (np.dot(c, c) * np.eye(3) - np.outer(c, c))
        for b, m, c in zip(bodies, masses, (np.zeros(3), (0.225, 0, 0), (0.2, 0, 0), np.zeros(3)))
    ]
    times = t + STEP * np.arange(-2, 3)
    poses = [places(page, time, member) for time in times]

    def spin(at: float) -> np.ndarray:
        """Angular momenta about the bodies' centres, by differences of the rotations."""
        near = [places(page, at + k * STEP, member)[0] for k in range(-2, 3)]
        rates = slope(near) @ np.swapaxes(near[2], 1, 2)
        omega = np.stack([rates[:, 2, 1], rates[:, 0, 2], rates[:, 1, 0]], axis=1)
        return np.array([r @ i @ r.T @ w for r, i, w in zip(near[2], inertias, omega)])

    turning = slope([spin(time) for time in times])
    pulled = bend([p[1] for p in poses]) - GRAVITY
    rotations, centres, elbow = poses[2]
    joints = (
        (np.zeros(3), np.array((0.0, 0.0, 1.0)), 0),
        (np.zeros(3), rotations[0][:, 1], 1),
        (elbow, rotations[1][:, 1], 2),
    )
    return [
        axis
        @ sum(
            turning[i] + masses[i] * np.cross(centres[i] - point, pulled[i])
            for i in range(first, 4)
        )
        for point, axis, first in joints
    ]


def test_torques_are_those_of_momentum(page):
    """Differences of order 4 with steps of T/400: 1e-6 of the torque."""
    for row in (25, 50, 70):
        for member in (0, 7):
            right = torques(page, page["t"][row], member)
            ours = [page["torque"][name][row, member] for name in page["begin"]]
            assert np.abs(np.array(ours) - right).max() < 1e-5 * np.abs(right).max()


def test_work_of_the_motors_is_the_gain_of_energy(page):
    """Work is integrated by RK4, 400 steps."""
    assert np.abs(page["work"] / page["gain"] - 1.0).max() < 1e-8
    assert not page["result"].failed.size

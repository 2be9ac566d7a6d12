"""The problem that every peer integrates: heavy tops, each with its own initial velocity.

The box of Müller (BIT 56, 2016, section 5) on a spherical joint at the origin, under gravity.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

MASS = 6.075  # kg
INERTIA = np.array((0.0126563, 0.0468281, 0.0569531))  # kg m², principal, about the centre of mass
CENTRE = np.array((0.15, -0.0375, 0.0))  # m, from the pivot to the centre of mass, body axes
GRAVITY = np.array((0.0, 0.0, -9.81))  # m/s²
OMEGA = np.array((2.0, 1.0, 0.2)) * np.pi  # rad/s, mean of the initial velocities; at R = I
SPREAD = 0.5  # rad/s, their standard deviation
T_END = 1.0  # s
DT = 1e-3  # s, of the tables; the work–precision diagram has others
SEED = 20160916
REFERENCE = Path(__file__).with_name("reference.npy")


def pivot_inertia() -> np.ndarray:
    """(3, 3) kg m², about the pivot, body axes."""
    return np.diag(INERTIA) + MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))


def samples(count: int) -> np.ndarray:
    """(count, 3) rad/s, body axes; the first ones are the same for every count."""
    return OMEGA + SPREAD * np.random.default_rng(SEED).standard_normal((count, 3))


class Final(NamedTuple):
    """The state at T_END."""

    centre: np.ndarray  # (n, 3) m, position of the centre of mass in the ground frame
    omega: np.ndarray  # (n, 3) rad/s, body axes


@dataclass(frozen=True)
class Form:
    """One way in which a peer integrates the tops.

    family : "reduced" (minimal coordinates, or a constant gain) or "general" (absolute coordinates
        and a constraint solve in every stage); the two are never compared.
    bodies : how many tops make one timed call last about a second on one core.
    accuracies : steps in s, or relative tolerances if `adaptive`, for the work–precision diagram.
    """

    family: str
    bodies: int
    label: str
    adaptive: bool = False
    accuracy: float = DT  # of the tables
    accuracies: tuple[float, ...] = field(default=(1e-2, 5e-3, 2e-3, 1e-3, 5e-4))
    threads: tuple[int, ...] = (1, 2)  # that it can use


def error(final: Final) -> float:
    """The largest distance, m, of a centre of mass from the committed reference."""
    reference = np.load(REFERENCE)
    count = min(len(reference), len(final.centre))
    return float(np.linalg.norm(final.centre[:count] - reference[:count, 3:6], axis=1).max())

"""Problems that several of these files integrate, and what they look at."""

from __future__ import annotations

from functools import cache

import numpy as np
from cases import BODY_FRAME, GRAVITY, GROUND_FRAME, box, joint

import lierb

G = 9.81  # m/s²


@cache
def spread_tops(count: int = 1000, seed: int = 11) -> np.ndarray:
    """(count, 6) twists of tops, from slow to very fast: steps of all sizes."""
    rng = np.random.default_rng(seed)
    omega = rng.standard_normal((count, 3)) * np.exp(rng.standard_normal((count, 1))) * 5.0
    return joint("spherical").twist(omega=omega)


def top_problem(count: int | None = None, **more) -> lierb.Problem:
    """Shared parameters, or the same ones for each of `count` bodies."""
    body = box(turned=True)
    if count is None:
        return lierb.Problem(body, joint("spherical"), GRAVITY, **more)

    def each(array):
        return np.broadcast_to(array, (count, *np.shape(array))).copy()

    held = joint("spherical", each(GROUND_FRAME), each(BODY_FRAME))
    own = lierb.Body(each(body.mass), each(body.inertia))
    return lierb.Problem(own, held, each(GRAVITY), **more)


def thrown(height, speed, omega=(0.0, 0.0, 0.0), **more):
    """A free body `height` above the ground, thrown up at `speed`: the problem, and its start."""
    height, speed = np.atleast_1d(height).astype(float), np.atleast_1d(speed).astype(float)
    problem = lierb.Problem(
        lierb.Body(1.5, (0.1, 0.2, 0.25)), lierb.joints.free(), (0.0, 0.0, -G), **more
    )
    pose0 = np.tile(np.eye(4), (len(height), 1, 1))
    pose0[:, 2, 3] = height
    twist0 = np.zeros((len(height), 6))
    twist0[:, :3], twist0[:, 5] = omega, speed
    return problem, {"pose0": pose0, "twist0": twist0}


def spinning(rates, **more):
    """Balls that turn about e₃ at the given rates: the problem, and its start."""
    rates = np.atleast_1d(rates).astype(float)
    problem = lierb.Problem(lierb.Body(1.0, (0.4, 0.4, 0.4)), lierb.joints.free(), **more)
    twist0 = np.zeros((len(rates), 6))
    twist0[:, 2] = rates
    return problem, {"twist0": twist0}


def bits(result: lierb.Result, *left_out: str) -> np.ndarray:
    """Every number of the summary, as integers: −0 and NaN count as themselves."""
    return table_bits(result.summary, "trajectory", "status", *left_out)


def table_bits(table, *left_out: str) -> np.ndarray:
    names = [name for name in table.column_names if name not in left_out]
    rows = [np.array(table[name].to_pylist(), dtype=float) for name in names]
    return np.concatenate(
        [x.reshape(table.num_rows, x.size // max(table.num_rows, 1)) for x in rows], axis=1
    ).view(np.int64)


def rows_of(table, name: str) -> np.ndarray:
    """A column as an array, (rows, …)."""
    return np.array(table[name].to_pylist(), float)

"""Controllers draw random numbers, addressed by seed, trajectory, name, tick and component.

`normal` draws in functions of `@lierb.controller`; `sample` computes the same bits elsewhere.
No draw depends on an earlier one: a trajectory has the same noise alone and in a batch of a
million, on one lane or eight, in a continued run and on another machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief
from lierb.kernels.functions.noise import MOST, normal, normals
from lierb.kernels.functions.signals import Noise
from lierb.support.arrays import Array, as_floats

LARGEST = 2**53 - 1  # largest integer to which no other integer rounds

__all__ = ["normal", "sample"]


def sample(
    seed: int, trajectory: ArrayLike, name: str, tick: ArrayLike, size: int | tuple[()] = ()
) -> Array:
    """Compute the numbers that `normal(name, size)` draws in a controller, to the bit.

    Parameters
    ----------
    seed : int
        Seed of the run, `lierb.integrate(seed=…)`, 0 to 2⁵³ − 1.
    trajectory : int or array_like of int
        Index of the trajectory, `lierb.integrate(trajectories=…)`, 0 to 2⁵³ − 1.
    name : str
        Name of the noise.
    tick : int or array_like of int
        Index of the call; a controller with period T is called at tick·T.
    size : int or (), optional
        Number of components; () for a single number.

    Returns
    -------
    ndarray
        Numbers; the shape is that of trajectory and tick, broadcast, followed by (size,) unless
        size is ().

    Examples
    --------
    >>> import lierb
    >>> lierb.noise.sample(0, trajectory=[0, 1, 2], name="gyro", tick=5, size=3).round(3).tolist()
    [[1.334, 0.184, -0.075], [1.292, -0.763, 0.197], [2.011, 1.632, 0.737]]
    """
    if not (isinstance(name, str) and name):
        raise ArgumentError(f"name={brief(name)}; expected the noise's name, as text")
    count = 1 if size == () else size
    if not (isinstance(count, int) and not isinstance(count, bool) and 1 <= count <= MOST):
        raise ArgumentError(f"size={brief(size)}; expected () or how many numbers, 1 to {MOST}")
    seeds = _whole("seed", seed, least=0)
    if seeds.ndim:
        raise ArgumentError(f"seed has shape {seeds.shape}; expected one number")
    numbers = _whole("trajectory", trajectory, least=0), _whole("tick", tick, least=-LARGEST)
    try:
        trajectories, ticks = np.broadcast_arrays(*numbers)
    except ValueError:
        raise ArgumentError(
            f"trajectory has shape {numbers[0].shape}, tick {numbers[1].shape}; expected shapes "
            "that broadcast"
        ) from None
    noise = Noise(float(seeds), trajectories.ravel(), ticks.ravel())
    draws = np.stack(normals(noise, name, count), axis=-1)
    return draws.reshape((*ticks.shape, *(() if size == () else (count,))))


def _whole(argument: str, value: Any, least: int) -> Array:
    """Check that a value is whole numbers from `least` to `LARGEST`; return them."""
    numbers = as_floats(argument, value)
    if np.any((numbers != np.floor(numbers)) | ~(numbers >= least) | ~(numbers <= LARGEST)):
        raise ArgumentError(
            f"{argument}={brief(value)}; expected whole numbers, {least} to {LARGEST}"
        )
    return numbers


def __dir__() -> list[str]:
    return list(__all__)

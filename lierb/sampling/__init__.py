"""Each Monte Carlo draw, for very many bodies, is a function of the seed and the body's number.

::

    design = Design({"mass": Uniform(1.0, 2.0), "omega0": Normal((0.0, 0.0, 9.0), 0.1)}, n=10**9)
    chunk = design.draw(first=5_000_000, count=100_000)        # {"mass": (100000,), "omega0": …}

Bodies may be drawn in chunks of any size, in any order, by any number of processes, or one of them
again years later: on one kind of CPU, with one NumPy and SciPy, the bits are the same. No draw is
rejected and no generator has a state. A quantity takes a fixed number of uniforms per body: those
of body b have fixed positions in the stream of a counter-based generator, or are coordinates of
point b of a Sobol sequence. Inverse distribution functions turn them into values.

Units are the caller's, those of the quantity. Normal distributions and Sobol points need SciPy
(the extra `lierb[scipy]`).

>>> design = Design({"mass": Uniform(1.0, 2.0), "spin": Direction(9.0)}, n=1000, seed=7)
>>> whole, part = design.draw(), design.draw(first=600, count=2)
>>> whole["spin"].shape, part["spin"].shape
((1000, 3), (2, 3))
>>> bool((whole["spin"][600:602] == part["spin"]).all())
True
"""

from lierb.sampling.design import Design, inertia_of
from lierb.sampling.distribution import Distribution
from lierb.sampling.distributions import Constant, Direction, Rotation, Uniform, Values
from lierb.sampling.normal import LogNormal, Normal, TruncatedNormal

__all__ = [
    "Constant",
    "Design",
    "Direction",
    "Distribution",
    "LogNormal",
    "Normal",
    "Rotation",
    "TruncatedNormal",
    "Uniform",
    "Values",
    "inertia_of",
]


def __dir__() -> list[str]:
    return list(__all__)

"""Monte Carlo over bodies: distributions of what they have, and designs that draw from them."""

from lierb.sampling.design import Design, inertia_of
from lierb.sampling.distributions import (
    Constant,
    Direction,
    Distribution,
    LogNormal,
    Normal,
    Rotation,
    TruncatedNormal,
    Uniform,
    Values,
)

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

"""lierb: a batch integrator for constrained rigid bodies on Lie groups, compiled by Numba."""

from lierb import bodies, errors, forces, joints, lie, sampling
from lierb.api import Result, integrate
from lierb.elements import constraint, wrench
from lierb.installation import info, warmup
from lierb.kernels.dual import where
from lierb.model import Body, Problem
from lierb.prediction import predict
from lierb.provenance import package_version
from lierb.tableaus import ButcherTableau

__version__ = package_version()
__all__ = [
    "Body",
    "ButcherTableau",
    "Problem",
    "Result",
    "bodies",
    "constraint",
    "errors",
    "forces",
    "info",
    "integrate",
    "joints",
    "lie",
    "predict",
    "sampling",
    "warmup",
    "where",
    "wrench",
]

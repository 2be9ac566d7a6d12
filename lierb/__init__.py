"""lierb: a batch integrator for constrained rigid bodies on Lie groups, compiled by Numba."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lierb import animation, bodies, errors, forces, joints, lie, noise, sampling
from lierb.animation import animate
from lierb.api import integrate
from lierb.extras import is_installed, require
from lierb.installation import info, warmup
from lierb.kernels.functions.user_number import where
from lierb.kernels.numbers.vocabulary import clip, log, quaternion, table
from lierb.links import Link, Loop
from lierb.mechanism import Mechanism
from lierb.model import Body, Problem
from lierb.prediction import predict
from lierb.result import Result
from lierb.runs.mechanisms import baumgarte
from lierb.runs.provenance import package_version
from lierb.studies.comparing import convergence
from lierb.tableaus import TABLEAUS, ButcherTableau
from lierb.user_elements import constraint, observable, wrench
from lierb.user_signals import controller, event, states

if TYPE_CHECKING:
    from lierb.studies.from_python import study_of as study_of
    from lierb.studies.running import integrate_batches as integrate_batches
    from lierb.studies.running import run as run
    from lierb.studies.study import Study as Study

__version__ = package_version()
__all__ = [
    "TABLEAUS",
    "Body",
    "ButcherTableau",
    "Link",
    "Loop",
    "Mechanism",
    "Problem",
    "Result",
    "animate",
    "animation",
    "baumgarte",
    "bodies",
    "clip",
    "constraint",
    "controller",
    "convergence",
    "errors",
    "event",
    "forces",
    "info",
    "integrate",
    "joints",
    "lie",
    "log",
    "noise",
    "observable",
    "predict",
    "quaternion",
    "sampling",
    "states",
    "table",
    "warmup",
    "where",
    "wrench",
]

_STUDIES = {
    "Study": "lierb.studies.study",
    "integrate_batches": "lierb.studies.running",
    "run": "lierb.studies.running",
    "study_of": "lierb.studies.from_python",
}


def __dir__() -> list[str]:
    """What is public, and no module that is not; studies where what they need is installed."""
    underscored = [name for name in globals() if name.startswith("__")]
    return sorted([*__all__, *underscored, *(_STUDIES if is_installed("study") else ())])


def __getattr__(name: str) -> Any:
    """What needs `lierb[study]`, imported when it is first asked for."""
    if name not in _STUDIES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require("study")
    return getattr(import_module(_STUDIES[name]), name)

"""lierb: a batch integrator for constrained rigid bodies on Lie groups, compiled by Numba."""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from lierb import errors, lie, sampling
from lierb.analysis.comparing import convergence
from lierb.analysis.prediction import predict
from lierb.api import integrate
from lierb.installation import info, warmup
from lierb.kernels.functions.user_number import where
from lierb.kernels.functions.vocabulary import clip, log, quaternion, table
from lierb.methods import TABLEAUS, ButcherTableau
from lierb.model import bodies, forces, joints
from lierb.model.bodies.body import Body
from lierb.model.forces.gear_pair import gear
from lierb.model.formulation import baumgarte
from lierb.model.functions import noise
from lierb.model.functions.constraints import constraint, velocity_constraint
from lierb.model.functions.controllers import controller
from lierb.model.functions.events import event
from lierb.model.functions.ground_motion import ground_motion
from lierb.model.functions.observables import observable
from lierb.model.functions.states import states
from lierb.model.functions.turns import turns
from lierb.model.functions.variable_mass import variable_mass
from lierb.model.functions.wrenches import wrench
from lierb.model.mechanism.links import Link, Loop
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results import animation
from lierb.results.animation import animate
from lierb.results.result import Result
from lierb.runs.provenance import package_version
from lierb.support.extras import is_installed, require

if TYPE_CHECKING:
    from lierb.analysis.adjoint import gradient
    from lierb.analysis.fitting import fit
    from lierb.analysis.many_fits import fits
    from lierb.analysis.propagation import propagate
    from lierb.studies.description.from_python import study_of as study_of
    from lierb.studies.description.study import Study as Study
    from lierb.studies.execution.running import run as run
    from lierb.studies.execution.streaming import integrate_batches as integrate_batches

__version__ = package_version()
__all__ = [
    "TABLEAUS", "Body", "ButcherTableau", "Link", "Loop", "Mechanism", "Problem", "Result",
    "animate", "animation", "baumgarte", "bodies", "clip", "constraint", "controller",
    "convergence", "errors", "event", "fit", "fits", "forces", "gear", "gradient", "ground_motion",
    "info", "integrate", "joints", "lie", "log", "noise", "observable", "predict", "propagate",
    "quaternion", "sampling", "states", "table", "turns", "variable_mass", "velocity_constraint",
    "warmup", "where", "wrench",
]  # fmt: skip

# Public names of modules: `from lierb.joints import revolute`.
for _module in (animation, bodies, forces, joints, noise):
    sys.modules[f"lierb.{_module.__name__.rpartition('.')[2]}"] = _module

_LATER = {
    "fit": "lierb.analysis.fitting",
    "fits": "lierb.analysis.many_fits",
    "gradient": "lierb.analysis.adjoint",
    "propagate": "lierb.analysis.propagation",
}
_STUDIES = {
    "Study": "lierb.studies.description.study",
    "integrate_batches": "lierb.studies.execution.streaming",
    "run": "lierb.studies.execution.running",
    "study_of": "lierb.studies.description.from_python",
}


def __dir__() -> list[str]:
    """Public names; those of studies if `lierb[study]` is installed."""
    underscored = [name for name in globals() if name.startswith("__")]
    return sorted([*__all__, *underscored, *(_STUDIES if is_installed("study") else ())])


def __getattr__(name: str) -> Any:
    """Import names of fits, and of studies, which need `lierb[study]`, at their first use."""
    module = _LATER.get(name) or _STUDIES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _STUDIES:
        require("study")
    return getattr(import_module(module), name)

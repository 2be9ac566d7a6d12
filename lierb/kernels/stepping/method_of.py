"""Make the method of a plan."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from lierb.kernels.stepping.bliedf import BLieDF
from lierb.kernels.stepping.differentiable import DifferentiableMethod
from lierb.kernels.stepping.generalised_alpha import GeneralisedAlpha
from lierb.kernels.stepping.method import Method
from lierb.kernels.stepping.rattle import Rattle
from lierb.kernels.stepping.rosenbrock import Rosenbrock
from lierb.kernels.stepping.runge_kutta import ExplicitRungeKutta
from lierb.kernels.stepping.shake import Shake
from lierb.kernels.stepping.taped import TapedMethod
from lierb.kernels.stepping.verlet import Verlet
from lierb.kernels.systems.layout import FEW_DIRECTIONS
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.scheme import (
    AlphaScheme,
    BLieDFScheme,
    ExplicitScheme,
    RattleScheme,
    RosenbrockScheme,
    Scheme,
    ShakeScheme,
    VerletScheme,
)

FAMILIES: dict[type[Scheme], Callable[[Any], Method]] = {
    ExplicitScheme: ExplicitRungeKutta,
    RosenbrockScheme: Rosenbrock,
    VerletScheme: Verlet,
    RattleScheme: Rattle,
    ShakeScheme: Shake,
    AlphaScheme: GeneralisedAlpha,
    BLieDFScheme: BLieDF,
}


@lru_cache(256)
def method_of(plan: AnyPlan) -> Method:
    """Return the method of a plan, of the family of its scheme."""
    method: Method = FAMILIES[type(plan.method)](plan.method)
    if plan.moving and not plan.is_explicit:
        method = DifferentiableMethod(method)
    if plan.directions > FEW_DIRECTIONS:
        method = TapedMethod(method, plan.is_continuous)
    return method

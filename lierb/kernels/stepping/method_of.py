"""Make the method of a plan."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from lierb.kernels.stepping.method import Method
from lierb.kernels.stepping.rosenbrock import Rosenbrock
from lierb.kernels.stepping.runge_kutta import ExplicitRungeKutta
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.scheme import ExplicitScheme, RosenbrockScheme, Scheme

FAMILIES: dict[type[Scheme], Callable[[Any], Method]] = {
    ExplicitScheme: ExplicitRungeKutta,
    RosenbrockScheme: Rosenbrock,
}


@lru_cache(256)
def method_of(plan: AnyPlan) -> Method:
    """Return the method of a plan, of the family of its scheme."""
    return FAMILIES[type(plan.method)](plan.method)

"""What a plan integrates, in the driver's terms: one body, or a mechanism."""

from __future__ import annotations

from functools import lru_cache

from lierb.kernels.stepping.mechanism import MechanismPlan, TreeFormulation
from lierb.kernels.stepping.one_body import OneBody
from lierb.kernels.stepping.plan import AnyPlan, Plan

System = OneBody | TreeFormulation


@lru_cache(64)
def system_of(plan: AnyPlan) -> System:
    """How it is read, carried and seen."""
    if isinstance(plan, MechanismPlan):
        return plan.formulation
    assert isinstance(plan, Plan)
    return OneBody(plan)

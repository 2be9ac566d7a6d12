"""A plan integrates a system: one body, or a mechanism."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, cast

from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.mechanics.tree import TreeConstants, TreeMotion
from lierb.kernels.systems.formulations import FORMULATIONS
from lierb.kernels.systems.layout import FEW_DIRECTIONS
from lierb.kernels.systems.one_body import BodyMotion
from lierb.kernels.systems.plan import AnyPlan, LoopPlan, MechanismPlan, Plan
from lierb.kernels.systems.system import AnySystem, System
from lierb.kernels.systems.tree_loop import TreeLoop
from lierb.kernels.systems.tree_system import TreeFormulation
from lierb.kernels.systems.tree_table import joint_kind_of
from lierb.kernels.tracing.cpu import DEFAULT_LANES


@lru_cache(256)
def in_memory(plan: AnyPlan) -> TreeLoop:
    """Return the system of a looped plan, for steps of one length; it stores its results."""
    assert isinstance(plan, LoopPlan)
    return TreeLoop(plan)


@lru_cache(256)
def system_of(plan: AnyPlan) -> AnySystem:
    """Return the system of a plan."""
    if isinstance(plan, LoopPlan):
        return cast(AnySystem, in_memory(plan))
    if isinstance(plan, MechanismPlan):
        mechanism: System[TreeConstants, TreeMotion] = TreeFormulation(plan)
        return mechanism
    assert isinstance(plan, Plan)
    one_body: System[BodyConstants, BodyMotion] = FORMULATIONS[plan.solver](plan)
    return one_body


def takes_small_angle_steps(plan: AnyPlan) -> bool:
    """Return whether to try small-angle steps without branches.

    They must not call functions that may raise. With derivatives the second kernel does not pay.
    """
    calls = any(not f.is_traced for element in plan.acting for f in element.functions)
    is_plain = plan.is_explicit and plan.update == "local" and not calls and not plan.moving
    return is_plain and system_of(plan).takes_small_angle_steps


@lru_cache(256)
def plan_of(width: int, **described: Any) -> Plan:
    """Return the plan for registers of `width` numbers, one object for the same arguments.

    The plan is the key of its compiled code, and identity makes look-up fast.

    Every operation of a step waits for the one before it. Two interleaved packs hide this latency,
    as long as the live values fit into the registers.
    Measured, M body-steps/s on AVX-512 with 8, 16 and 32: revolute 200, 297, 310; cylindrical 181,
    280, 217; spherical 103, 107, 75; spherical by DOP853 21, 23, 18. On AVX2 with 4, 8 and 16:
    revolute 121, 187, 176; cylindrical 115, 156, 160; spherical 57, 65, 43; spherical by DOP853
    13, 11, 9. Saddle points, AVX-512 on another machine with 8 and 16: revolute 153, 163;
    spherical 77, 80. A batch smaller than a block takes as long as a full block, since one kernel
    serves all batches.
    """
    plan = Plan(lanes=width, **described)
    doubles = width > 1 and system_of(plan).is_light
    return replace(plan, lanes=2 * width) if doubles else plan


@lru_cache(256)
def plan_with_derivatives(
    plan: AnyPlan, moving: tuple[str, ...], abreast: int = FEW_DIRECTIONS
) -> AnyPlan:
    """Return the plan of the same run, with derivatives of these fields of the inputs.

    moving, abreast : see `AnyPlan`.

    It takes one pack: dual numbers fill the registers. Looped code has no kinds of joints beside
    those of the mechanism: each takes a second of compiling or more.
    """
    if isinstance(plan, MechanismPlan) and plan.is_in_memory:
        own = {joint_kind_of(plan, i) for i in range(len(plan.tree))}
        kinds = tuple(kind for kind in plan.joint_kinds if kind in own)
        plan = replace(plan, joint_kinds=kinds, usual_constraints=())
    return replace(plan, moving=moving, abreast=abreast, lanes=min(plan.lanes, DEFAULT_LANES))

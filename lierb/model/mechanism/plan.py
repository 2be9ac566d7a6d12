"""Formulation and plan of a mechanism: nodes and connections on which code is specialised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numba
import numpy as np

from lierb.errors import ArgumentError, require_name
from lierb.kernels.mechanics.rows import FIXED
from lierb.kernels.mechanics.subgroup import Slots, slots_of
from lierb.kernels.mechanics.tree import FREE, GROUND, MASSLESS, NONE, Connection, Node
from lierb.kernels.mechanics.tree_nodes import JointKind, Kind
from lierb.kernels.systems.plan import ConstraintKind, MechanismPlan, Stabilisation
from lierb.kernels.systems.tree_table import joint_kind_of
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.model.connections import NOWHERE
from lierb.model.formulation import TREE_SOLVERS, CSpace, Formulation, stabilisation_of
from lierb.model.joints.joint_type import JOINTS
from lierb.model.mechanism.tree import Tree

CSPACES = ("reduced", "SE3", "SO3xR3")
# Joints of loops in all looped code with loops, which compiles 0.8 s longer.
USUAL_LOOPS = ("revolute", "cylindrical", "spherical", "universal", "fixed")
UNROLLED_NODES = 7  # with more, loops over the nodes are as fast as unrolled code, or faster


def cspaces_of(mechanism: Tree, cspace: CSpace) -> tuple[str, ...]:
    """Return the c-space of each link. Raises ArgumentError for an invalid name or body."""
    if isinstance(cspace, Mapping):
        given = mechanism.by_link("cspace", cspace)
        spaces = tuple(given[name] for name in mechanism.names)
        for name in spaces:
            require_name("cspace of a link", name, CSPACES[1:])
    else:
        require_name("cspace", cspace, CSPACES)
        spaces = (cspace,) * len(mechanism.links)
    for link, space in zip(mechanism.links, spaces, strict=True):
        if space == "SO3xR3" and np.any(link.body.com != 0.0):
            raise ArgumentError(
                f'cspace="SO3xR3" needs the body frame at the centre of mass (com = 0), that of '
                f"link {link.name} is elsewhere, where its equations do not decouple; move the "
                'frame, or use "SE3" or "reduced"'
            )
    return spaces


def formulation_of(
    mechanism: Tree, cspace: CSpace, update: str, solver: str, stabilise: Any
) -> Formulation:
    """Validate the options that select the equations. Raises ArgumentError."""
    cspaces, stabilisation = cspaces_of(mechanism, cspace), stabilisation_of(stabilise)
    if solver not in ("auto", *TREE_SOLVERS):
        raise ArgumentError(
            f'solver="{solver}" is for a lierb.Problem; a mechanism has '
            f"{', '.join(TREE_SOLVERS)} to choose from: leave solver out"
        )
    if stabilisation.kind == "project" and update == "global":
        raise ArgumentError(
            'stabilise="project" needs update="local" or "ambient": it moves poses, and a global '
            "update keeps them in one chart"
        )
    return Formulation(cspaces, solver, stabilisation)


def mechanism_plan_of(
    mechanism: Tree,
    cspaces: tuple[str, ...],
    stabilisation: Stabilisation,
    solver: str = "auto",
    **described: Any,
) -> MechanismPlan:
    """Return the plan of a mechanism with a c-space for each link."""
    tree: list[Node] = []
    nodes = {NOWHERE: GROUND}  # node index by link index
    doubled = set()  # links that two nodes connect with their parents
    for i in mechanism.order:
        joint, parent = mechanism.links[i].joint, nodes[mechanism.parents[i]]
        is_reduced = cspaces[i] == "reduced"
        if is_reduced and joint.factors:
            first, last = (_only(factor.slot) for factor in joint.factors)
            tree.append(Node(parent, MASSLESS, "reduced", first, ()))
            tree.append(Node(len(tree) - 1, i, "reduced", last, ()))
            doubled.add(i)
        elif is_reduced and (joint.subgroup or slots_of(joint.rows) == (FIXED,) * 6):
            tree.append(Node(parent, i, "reduced", slots_of(joint.rows), ()))
        else:
            tree.append(Node(parent, i, cspaces[i], FREE, joint.rows))
        nodes[i] = len(tree) - 1
    hanging = {*range(len(mechanism.links))} - doubled
    joints = [
        Connection(nodes[c.body], nodes[c.parent], c.rows, i in hanging, i)
        for i, c in enumerate(mechanism.joints)
    ]
    numbers = {each.name: i for i, each in enumerate(mechanism.links_and_loops)}
    acting = []
    for k, (element, c) in enumerate(zip(mechanism.elements, mechanism.places, strict=True)):
        number = numbers[element.at[0]] if element.kind.needs_axis else NONE
        hangs = number != NONE and joints[number].hangs
        second = NONE if c.second == NOWHERE else c.second
        rows = tuple(element.kind.row(k, i) for i in range(element.kind.rows))
        acting.append(Connection(nodes[c.body], nodes[c.parent], rows, hangs, number, second))
    plan = MechanismPlan(
        lanes=DEFAULT_LANES,
        tree=tuple(tree),
        connections=(*joints, *acting),
        loops=len(mechanism.loops),
        stabilisation=stabilisation,
        **described,
    )
    is_large = solver == "auto" and len(tree) > UNROLLED_NODES
    return looped(plan) if solver == "looped" or (is_large and not why_unrolled(plan)) else plan


def why_unrolled(plan: MechanismPlan) -> str:
    """Return what a plan has that looped code has not, or an empty string."""
    reasons = {
        "links outside the reduced c-space": any(not n.is_reduced for n in plan.tree),
        "NUMBA_DISABLE_JIT": bool(numba.config.DISABLE_JIT),
        "joints whose motions are neither a group nor a product of two groups": any(
            node.rows for node in plan.tree
        ),
        "functions that are called body by body": plan.calls_functions,
        "functions of accelerations": any(e.feels for e in plan.elements),
        "added inertia": any(e.adds_inertia for e in plan.elements),
        f'update="{plan.update}"': plan.update != "local",
        "this method": not plan.is_explicit or plan.has_exponentials,
    }
    return next((reason for reason, applies in reasons.items() if applies), "")


def looped(plan: MechanismPlan) -> MechanismPlan:
    """Return a plan with looped code. Raises ArgumentError if there is none."""
    if reason := why_unrolled(plan):
        raise ArgumentError(
            f'solver="looped" does not support {reason}; leave solver out, for unrolled code'
        )
    own = (joint_kind_of(plan, i) for i in range(len(plan.tree)))
    usual = tuple(ConstraintKind(JOINTS[name].rows) for name in USUAL_LOOPS if plan.loops)
    kinds = tuple(dict.fromkeys((*_catalogue(), *own)))
    return replace(plan, joint_kinds=kinds, usual_constraints=usual)


@cache
def _catalogue() -> tuple[JointKind, ...]:
    """Kinds of the joints of the catalogue that have coordinates, each on one or two nodes."""
    kinds = []
    for joint in JOINTS.values():
        if joint.factors:
            first, last = (_only(factor.slot) for factor in joint.factors)
            kinds += [JointKind(Kind(first), ()), JointKind(Kind(last), joint.rows, first)]
        elif joint.subgroup:
            kinds.append(JointKind(Kind(slots_of(joint.rows)), joint.rows))
    return tuple(dict.fromkeys(kinds))


def _only(slot: int) -> Slots:
    return tuple(0 if i == slot else FIXED for i in range(6))

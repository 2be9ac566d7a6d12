"""A mechanism made ready to be integrated: its plan, its c-spaces, its start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lierb.arrays import Array, as_number, as_numbers, as_poses
from lierb.errors import ArgumentError, require_name, told, unknown_name
from lierb.joints import Joint
from lierb.kernels.mechanics.rows import FIXED
from lierb.kernels.mechanics.subgroup import Slots, slots_of
from lierb.kernels.mechanics.tree import FREE, GROUND, MASSLESS, NONE, Connection, Node
from lierb.kernels.numbers.lanes import DEFAULT_LANES
from lierb.kernels.stepping.clock import Clock
from lierb.kernels.stepping.mechanism import MechanismPlan, Stabilisation
from lierb.kernels.stepping.systems import system_of
from lierb.links import NOWHERE
from lierb.mechanism import Mechanism
from lierb.runs.continuation import continuation_of
from lierb.runs.engine import Inputs
from lierb.runs.starts import Ready

CSPACES = ("reduced", "SE3", "SO3xR3")
CSpace = str | Mapping[str, str]


def cspaces_of(mechanism: Mechanism, cspace: CSpace) -> tuple[str, ...]:
    """Of every link. Raises ArgumentError for what is none, and for a body that it does not fit."""
    if isinstance(cspace, Mapping):
        for name in cspace:
            if name not in mechanism.names:
                raise unknown_name("cspace", str(name), mechanism.names)
        lacking = [name for name in mechanism.names if name not in cspace]
        if lacking:
            raise ArgumentError(f"cspace={told(dict(cspace))} lacks {', '.join(lacking)}")
        found = tuple(cspace[name] for name in mechanism.names)
        for name in found:
            require_name("cspace of a link", name, CSPACES[1:])
    else:
        require_name("cspace", cspace, CSPACES)
        found = (cspace,) * len(mechanism.links)
    for link, space in zip(mechanism.links, found, strict=True):
        if space == "SO3xR3" and np.any(link.body.com != 0.0):
            raise ArgumentError(
                f'cspace="SO3xR3" needs the body frame at the centre of mass (com = 0), that of '
                f"link {link.name} is elsewhere, where its equations do not decouple; move the "
                'frame, or use "SE3" or "reduced"'
            )
    return found


def plan_of(
    mechanism: Mechanism,
    cspaces: tuple[str, ...],
    stabilisation: Stabilisation,
    **described: Any,
) -> MechanismPlan:
    """What compiled code is specialised on."""
    tree: list[Node] = []
    nodes = {NOWHERE: GROUND}  # by the numbers of links
    for i in mechanism.order:
        joint, parent = mechanism.links[i].joint, nodes[mechanism.parents[i]]
        if cspaces[i] != "reduced":
            tree.append(Node(parent, i, cspaces[i], FREE, joint.rows))
        elif joint.factors:
            first, last = (_only(factor.slot) for factor in joint.factors)
            tree.append(Node(parent, MASSLESS, "reduced", first, ()))
            tree.append(Node(len(tree) - 1, i, "reduced", last, ()))
        elif is_group(joint):
            tree.append(Node(parent, i, "reduced", slots_of(joint.rows), ()))
        else:
            tree.append(Node(parent, i, "reduced", FREE, joint.rows))
        nodes[i] = len(tree) - 1
    joints = [
        Connection(
            nodes[c.body],
            nodes[c.parent],
            c.rows,
            i < len(mechanism.links) and _hangs(mechanism, i, cspaces),
            i,
        )
        for i, c in enumerate(mechanism.joints)
    ]
    numbers = {each.name: i for i, each in enumerate(mechanism.held)}
    acting = []
    for k, (element, c) in enumerate(zip(mechanism.elements, mechanism.places, strict=True)):
        number = numbers[element.at[0]] if element.kind.needs_axis else NONE
        hangs = number != NONE and joints[number].hangs
        rows = tuple(element.kind.row(k, i) for i in range(element.kind.rows))
        acting.append(Connection(nodes[c.body], nodes[c.parent], rows, hangs, number))
    return MechanismPlan(
        lanes=DEFAULT_LANES,
        tree=tuple(tree),
        connections=(*joints, *acting),
        loops=len(mechanism.loops),
        stabilisation=stabilisation,
        **described,
    )


def is_group(joint: Joint) -> bool:
    """Whether its motions are a subgroup of SE(3), that of a fixed joint included."""
    return joint.subgroup is not None or slots_of(joint.rows) == (FIXED,) * 6


def _hangs(mechanism: Mechanism, i: int, cspaces: tuple[str, ...]) -> bool:
    """Whether a link hangs on its parent by one node."""
    return cspaces[i] != "reduced" or not mechanism.links[i].joint.factors


def _only(slot: int) -> Slots:
    return tuple(0 if i == slot else FIXED for i in range(6))


def ready_mechanism(
    mechanism: Mechanism,
    pose0: Any,
    twist0: Any,
    clock: Clock,
    t0: float,
    cspace: CSpace,
    stabilise: Any,
    described: dict[str, Any],
) -> Ready:
    """described : what of the plan does not depend on what hangs on what."""
    poses = arrays_of(mechanism, "pose0", mechanism.pose() if pose0 is None else pose0)
    twists = arrays_of(mechanism, "twist0", twist0)
    sizes = {f"pose0[{name!r}]": (array, 2) for name, array in poses.items()}
    sizes |= {f"twist0[{name!r}]": (array, 1) for name, array in twists.items()}
    count = mechanism.batch_size(**sizes) or 1
    plan = plan_of(
        mechanism, cspaces_of(mechanism, cspace), stabilisation_of(stabilise), **described
    )
    starts = {f"{i}.pose": poses[name] for i, name in enumerate(mechanism.names)}
    starts |= {f"{i}.twist": twists[name] for i, name in enumerate(mechanism.names)}
    known = continuation_of(pose0)
    if known is not None and not known.fits(mechanism, plan, twist0, t0):
        known = None
    if known is not None:
        clock = Clock(*clock[:4], *known.origin(clock.dt))
    state = None if known is None else known.state
    inputs = Inputs(mechanism, system_of(plan).inputs, starts, count, t0, state)
    return Ready(plan, inputs, clock, poses, twists, known is not None)


def arrays_of(mechanism: Mechanism, argument: str, given: Any) -> dict[str, Array]:
    """Poses or twists of all links, checked."""
    given = mechanism.by_link(argument, given)
    if argument == "pose0":
        return {n: as_poses(f"pose0[{n!r}]", given[n], copy=None) for n in mechanism.names}
    return {n: as_numbers(f"twist0[{n!r}]", given[n], (6,), copy=None) for n in mechanism.names}


# ---- stabilisation -----------------------------------------------------------------------------


def baumgarte(alpha: float, beta: float) -> Stabilisation:
    """Baumgarte's stabilisation, for `lierb.integrate(…, stabilise=…)`.

    alpha, beta : 1/s. In place of ḧ = 0 the constraints obey ḧ + 2α ḣ + β² h = 0, so that errors
        die out like e^(−αt) where β = α; values beyond 1/dt make steps unstable.

    J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972) 1–16.

    >>> import lierb
    >>> lierb.baumgarte(10.0, 10.0)
    Stabilisation(kind='baumgarte', alpha=10.0, beta=10.0)
    """
    rates = {}
    for name, given in (("alpha", alpha), ("beta", beta)):
        rates[name] = float(as_number(name, given))
        if rates[name] < 0.0:
            raise ArgumentError(f"{name}={told(given)}; expected zero or a positive number, 1/s")
    return Stabilisation("baumgarte", **rates)


def stabilisation_of(given: Any) -> Stabilisation:
    """Of the argument `stabilise`. Raises ArgumentError for anything else."""
    if given is None:
        return Stabilisation()
    if isinstance(given, Stabilisation):
        return given
    if isinstance(given, str) and given == "project":
        return Stabilisation("project")
    raise ArgumentError(
        f'stabilise={told(given)}; expected None, "project" or lierb.baumgarte(alpha, beta)'
    )


def told_stabilisation(given: Any) -> str | None:
    """As metadata have it."""
    kept = stabilisation_of(given)
    rates = f"({kept.alpha:g}, {kept.beta:g})" if kept.kind == "baumgarte" else ""
    return None if kept.kind == "none" else f"{kept.kind}{rates}"


def told_cspace(given: CSpace) -> str:
    """As metadata have it."""
    return given if isinstance(given, str) else ", ".join(f"{k}: {v}" for k, v in given.items())


def check_mechanism_options(mechanism: Mechanism, update: str, solver: str, stabilise: Any) -> None:
    kept = stabilisation_of(stabilise)
    if solver != "auto":
        raise ArgumentError(
            f'solver="{solver}" is for a lierb.Problem; a mechanism is solved by articulated '
            "bodies; leave solver out"
        )
    if kept.kind == "project" and update == "global":
        raise ArgumentError(
            'stabilise="project" needs update="local": it moves poses, and a global update keeps '
            "them in one chart"
        )

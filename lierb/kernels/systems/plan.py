"""Plans: the compile-time options on which code is specialised."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from lierb.compiler.tags import Tag
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import CSPACES, SE3, SO3xR3
from lierb.kernels.mechanics.rows import Row, Rows
from lierb.kernels.mechanics.tree import GROUND, Connection, Node
from lierb.kernels.mechanics.tree_nodes import JointKind, Kind
from lierb.kernels.systems.layout import FEW_DIRECTIONS
from lierb.kernels.systems.scheme import ExplicitScheme, HashedOnce, Scheme, StagedScheme

UPDATES = ("local", "global", "ambient")
EVERYTHING = ("inputs",)  # `moving` of looped code, in which all inputs have derivatives


@dataclass(frozen=True, kw_only=True)
class AnyPlan(HashedOnce, Tag):
    """Fields and properties shared by the plans of one body and of a mechanism.

    update : "local" or "global", coordinates X of a step's chart or of a chart for many steps;
        "ambient", coordinates Y of a step's chart (`lierb.kernels.groups.ambient`).
    method : the coefficients of the method.
    multipliers, reaction : True to record λ, and the joints' wrenches.
    elements : forces except gravity, constraints except the joints', and observables.
    clock : "steps", one clock for all lanes, or "lanes", a clock for each lane.
    interpolates : whether states between steps are needed, for output and events.
    samples : whether observables are sampled within steps.
    jumps : whether elements may jump at given times, at which steps then end.
    moving : fields of the inputs that have derivatives (`lierb.kernels.systems.derivatives`).
    abreast : number of directions of these derivatives.
    """

    lanes: int
    update: str
    method: Scheme
    multipliers: bool
    reaction: bool = False
    elements: tuple[Element, ...] = ()
    clock: str = "steps"
    interpolates: bool = False
    samples: bool = False
    jumps: bool = False
    moving: tuple[str, ...] = ()
    abreast: int = FEW_DIRECTIONS

    if TYPE_CHECKING:

        @property
        def rows(self) -> Rows:
            """Rows of all joints."""

    is_looped: ClassVar[bool] = False  # True if the size of the system is known at run time only

    @property
    def is_in_memory(self) -> bool:
        """True if a looped plan runs it, whose code loops over nodes in memory."""
        return False

    @property
    def directions(self) -> int:
        """Number of derivatives that a run carries."""
        return self.abreast if self.moving else 0

    @property
    def code(self) -> AnyPlan:
        """Plan on which the compiled code is specialised."""
        return self

    @property
    def carried(self) -> int:
        """Return how many numbers the method passes on from step to step."""
        return self.method.carried(len(self.rows))

    @property
    def keeps_rank(self) -> bool:
        """True if a run must end with the number of redundant rows that it starts with."""
        return False

    @property
    def has_lane_clocks(self) -> bool:
        return self.clock == "lanes"

    @property
    def has_stages(self) -> bool:
        """True for methods whose steps end at a weighted sum of slopes."""
        return isinstance(self.method, StagedScheme)

    @property
    def is_explicit(self) -> bool:
        """True for explicit Runge–Kutta methods, whose slopes are rates of the stages."""
        return isinstance(self.method, ExplicitScheme)

    @property
    def has_exponentials(self) -> bool:
        """True for commutator-free methods."""
        return isinstance(self.method, ExplicitScheme) and bool(self.method.exponentials)

    @property
    def is_adaptive(self) -> bool:
        """True if the length of each step depends on its error estimate."""
        return self.method.embedded is not None

    @property
    def is_continuous(self) -> bool:
        """True if states between steps are those of a continuous extension."""
        return self.interpolates and self.method.extension is not None

    @property
    def is_local(self) -> bool:
        """True if each step has a chart of its own, so that X or Y is zero at its start."""
        return self.update != "global"

    @property
    def is_ambient(self) -> bool:
        """True if steps are made in the algebra of quaternions, in coordinates Y instead of X."""
        return self.update == "ambient"

    @cached_property
    def does_work(self) -> bool:
        """True if an element can change E = T + U, so that its work has to be integrated."""
        return any(element.does_work for element in self.elements)

    @property
    def prescribes_motion(self) -> bool:
        """True if a motor's position or speed is given as a function of time."""
        return any(row.depends_on_time for row in self.rows)

    @cached_property
    def acting(self) -> tuple[Element, ...]:
        """Elements on which the motion depends."""
        return tuple(e for e in self.elements if not e.is_passive)

    @cached_property
    def calls_functions(self) -> bool:
        """True if users' functions are called body by body, and so may raise."""
        return any(not f.is_traced for element in self.elements for f in element.functions)


@dataclass(frozen=True, kw_only=True)
class Plan(AnyPlan):
    """Compiled integrator of one body: joint rows, elements, c-space, update, method, lanes.

    solver : "saddle", the saddle point in every stage, or "subgroup", the constant gain of a
        subgroup joint, with which poses stay in the subgroup.
    """

    rows: Rows
    cspace: str
    solver: str = "saddle"

    @cached_property
    def space(self) -> type[SE3] | type[SO3xR3]:
        return CSPACES[self.cspace]

    @cached_property
    def turns_about_a_point(self) -> bool:
        """True for a spherical joint: any body axes can be its axes, such as the principal axes."""
        joint = [row for row in self.rows if row.is_of_joint]
        return len(joint) == 3 and holds_a_point(self.rows)


@dataclass(frozen=True)
class Stabilisation:
    """Stabilisation of rows that the coordinates of the tree do not satisfy exactly.

    kind : "none", "project" or "baumgarte", with its α and β, 1/s.
    """

    kind: str = "none"
    alpha: float = 0.0
    beta: float = 0.0


UNSTABILISED = Stabilisation()


class ElementKind(NamedTuple):
    """Kind of an element between two nodes in memory.

    on_ground : True if its other frame is that of the ground.   on_joint : True if its frames are
    those of a joint, not those of the nodes.   on_loop : True if this joint, or the second one of a
    gear, closes a loop.
    """

    element: Element
    on_ground: bool
    on_joint: bool
    on_loop: bool = False


class ConstraintKind(NamedTuple):
    """Kind of a connection in memory whose rows have multipliers.

    element : kind of the motor or user's constraint that has the rows; None for a loop's joint.
    """

    rows: Rows
    element: ElementKind | None = None

    @property
    def is_on_two_joints(self) -> bool:
        return any(r.second for r in self.rows)


@dataclass(frozen=True, kw_only=True)
class LoopPlan(AnyPlan):
    """Compiled integrator of any tree whose nodes, joints and elements have these kinds.

    `lierb.kernels.systems.tree_table` describes the tree at run time.

    elements : one of each kind that acts, then all listed ones; see `Element.is_listed`.
    has_gains : True if each number in memory has the gain of an objective beside it.
    listed_kinds : kinds of the elements that the code has one by one; see `MechanismPlan.listed`.
    """

    kinds: tuple[Kind, ...]
    joint_kinds: tuple[JointKind, ...]
    element_kinds: tuple[ElementKind, ...] = ()
    listed_kinds: tuple[ElementKind, ...] = ()
    constraint_kinds: tuple[ConstraintKind, ...] = ()
    stabilisation: Stabilisation = UNSTABILISED
    has_gains: bool = False

    is_looped = True

    @property
    def packs(self) -> int:
        """Number of packs of a row of memory."""
        return 1 + self.directions + self.has_gains

    @property
    def keeps_rank(self) -> bool:
        return bool(self.constraint_kinds)

    @property
    def prescribes_motion(self) -> bool:
        return any(row.depends_on_time for kind in self.constraint_kinds for row in kind.rows)

    @property
    def rows(self) -> Rows:
        """No row has a multiplier."""
        return ()


@dataclass(frozen=True, kw_only=True)
class MechanismPlan(AnyPlan):
    """Compiled integrator of a mechanism.

    tree : nodes, each after its parent.
    connections : the joint of each link, in order; then the joint of each loop; then one connection
        for each element.   loops : number of loops.
    joint_kinds : kinds of joints of the code, if it loops over nodes; none if it is unrolled.
    usual_constraints : kinds of constraints that looped code has beside those of the mechanism.
    """

    tree: tuple[Node, ...]
    connections: tuple[Connection, ...]
    loops: int
    stabilisation: Stabilisation = UNSTABILISED
    joint_kinds: tuple[JointKind, ...] = ()
    usual_constraints: tuple[ConstraintKind, ...] = ()

    @property
    def carried(self) -> int:
        return self.method.carried(len(self.rows), 6 * len(self.tree))

    @cached_property
    def code(self) -> AnyPlan:
        if not self.is_in_memory:
            return self
        common = {field.name: getattr(self, field.name) for field in fields(AnyPlan)}
        common["moving"] = EVERYTHING if self.moving else ()
        kinds = tuple(dict.fromkeys(self.element_kinds))
        acting = tuple(k for k in kinds if not k.element.is_passive)
        looped = (kind.element for kind in acting if not kind.element.is_listed)
        listed = (element for element in self.elements if element.is_listed)
        common["elements"] = (*dict.fromkeys(looped), *listed)
        constraints = {kind for _, kind in self.constraints} | {*self.usual_constraints}
        return LoopPlan(
            **common,
            kinds=self.kinds,
            joint_kinds=self.joint_kinds,
            element_kinds=tuple(kind for kind in acting if not kind.element.rows),
            listed_kinds=tuple(self.element_kinds[k] for k in self.listed),
            constraint_kinds=tuple(sorted(constraints, key=repr)),
            stabilisation=self.stabilisation,
        )

    @cached_property
    def element_kinds(self) -> tuple[ElementKind, ...]:
        """Kind of each element."""
        places = self.connections[len(self.joints) :]
        return tuple(
            ElementKind(
                element,
                at.other == GROUND and at.joint < 0,
                at.joint >= 0,
                max(at.joint, at.second) >= self.links,
            )
            for element, at in zip(self.elements, places, strict=True)
        )

    @cached_property
    def listed(self) -> tuple[int, ...]:
        """Indices of elements that looped code lists one by one: `Element.is_listed`, then those
        that may jump.
        """
        listed = [k for k, e in enumerate(self.elements) if e.is_listed]
        return (*listed, *(k for k, e in enumerate(self.elements) if e.discontinuities))

    @cached_property
    def constraints(self) -> tuple[tuple[int, ConstraintKind], ...]:
        """Connections with rows, except joints of links: their index, and their kind."""
        loops = range(self.links, self.links + self.loops)
        pairs = [(number, ConstraintKind(self.connections[number].rows)) for number in loops]
        for number, kind in enumerate(self.element_kinds, loops.stop):
            if kind.element.rows:
                rows = tuple(kind.element.row(0, i) for i in range(kind.element.rows))
                pairs.append((number, ConstraintKind(rows, kind)))
        return tuple(pairs)

    @property
    def is_in_memory(self) -> bool:
        return bool(self.joint_kinds)

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        return tuple(dict.fromkeys(joint.kind for joint in self.joint_kinds))

    @property
    def links(self) -> int:
        return len(self.connections) - self.loops - len(self.elements)

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Joints of links, then of loops."""
        return self.connections[: self.links + self.loops]

    @property
    def rows(self) -> Rows:
        """Rows of all joints, then of motors and constraints."""
        return tuple(row for connection in self.connections for row in connection.rows)

    @cached_property
    def rows_with_multipliers(self) -> tuple[tuple[int, Row], ...]:
        """Rows that have a multiplier, with the index of their connection."""
        pairs: list[tuple[int, Row]] = []
        for number, connection in enumerate(self.connections):
            is_link = number < self.links
            rows = self.tree[connection.node].others if is_link else connection.rows
            pairs += [(number, row) for row in rows]
        return tuple(pairs)

    @property
    def keeps_rank(self) -> bool:
        return bool(self.rows_with_multipliers)

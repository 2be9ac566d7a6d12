"""What compiled code is specialised on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

from lierb.compiler.tags import Tag
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import CSPACES, SE3, SO3xR3
from lierb.kernels.mechanics.rows import Row, Rows
from lierb.kernels.mechanics.tree import Connection, Node

Stages = tuple[tuple[float, ...], ...]  # rows of weights of the stages before


@dataclass(frozen=True)
class Embedded:
    """What a step's error is estimated by.

    weights : b − b̂, a row of it; or two rows, E₅ and E₃ of DOP853.   order : of b̂.
    """

    weights: Stages
    order: int


@dataclass(frozen=True)
class Extension:
    """A continuous extension: further stages, and each stage's weight as a polynomial in θ,
    Σ weights[i][k] θᵏ⁺¹.
    """

    stages: Stages
    weights: Stages


class AnyPlan(Tag):
    """What the plans of one body and of a mechanism have in common."""

    lanes: int
    update: str
    stages: Stages
    weights: tuple[float, ...]
    exponentials: tuple[Stages, ...]  # of a commutator-free method: of each stage, then of the end
    clock: str  # "steps", the same in all lanes, or "lanes", each with its own
    embedded: Embedded | None  # of adaptive steps
    extension: Extension | None
    looks: bool  # between steps, too: for output and events
    jumps: bool  # whether something may jump at given times, at which steps end
    elements: tuple[Element, ...]
    multipliers: bool
    reaction: bool
    rows: Rows  # of all joints
    keeps_rank: bool = False  # whether a run's end has the number of redundant rows of its start

    @cached_property
    def _digest(self) -> int:
        return hash(tuple(getattr(self, field.name) for field in fields(self)))  # type: ignore[arg-type]

    def __hash__(self) -> int:  # of a tableau's numbers each time, otherwise
        return self._digest

    @cached_property
    def last_stage(self) -> int:
        """How many stages a step needs that nobody looks into."""
        asked = [i for i, weight in enumerate(self.weights) if weight != 0.0]
        return asked[-1] + 1

    @property
    def has_lane_clocks(self) -> bool:
        return self.clock == "lanes"

    @property
    def is_local(self) -> bool:
        return self.update == "local"

    @cached_property
    def does_work(self) -> bool:
        """Whether something can change E = T + U, so that its work has to be counted."""
        return any(element.does_work for element in self.elements)

    @cached_property
    def acting(self) -> tuple[Element, ...]:
        """The elements that do something to the motion."""
        return tuple(e for e in self.elements if not e.is_passive)

    @cached_property
    def calls_functions(self) -> bool:
        """Whether functions of the user's are called body by body, and so may raise."""
        return any(not f.is_traced for element in self.elements for f in element.functions)


@dataclass(frozen=True)
class Plan(AnyPlan):
    """One compiled integrator: a joint's rows, forces, a c-space, an update form, a method, L."""

    lanes: int
    rows: Rows
    cspace: str
    update: str
    stages: Stages  # A of the Butcher tableau, strictly lower triangle
    weights: tuple[float, ...]  # b
    multipliers: bool  # whether λ is recorded
    reaction: bool = False  # whether the joint's wrench is
    # Forces beside gravity, constraints beside the joint's, and observables.
    elements: tuple[Element, ...] = ()
    # Where accelerations come from: "saddle", the saddle point in every stage, or "subgroup", a
    # subgroup joint's constant gain, by which poses stay in the subgroup.
    solver: str = "saddle"
    exponentials: tuple[Stages, ...] = ()
    clock: str = "steps"
    embedded: Embedded | None = None
    extension: Extension | None = None
    looks: bool = False
    jumps: bool = False

    __hash__ = AnyPlan.__hash__

    @cached_property
    def space(self) -> type[SE3] | type[SO3xR3]:
        return CSPACES[self.cspace]

    @cached_property
    def turns_about_a_point(self) -> bool:
        """Whether the joint is spherical: any axes on the body will do, also its inertia's."""
        joint = [row for row in self.rows if row.is_of_joint]
        return len(joint) == 3 and holds_a_point(self.rows)


@dataclass(frozen=True)
class Stabilisation:
    """What keeps rows that the tree does not keep by itself.

    kind : "none", "project" or "baumgarte", with its α and β, 1/s.
    """

    kind: str = "none"
    alpha: float = 0.0
    beta: float = 0.0


UNSTABILISED = Stabilisation()


@dataclass(frozen=True)
class MechanismPlan(AnyPlan):
    """One compiled integrator of a mechanism.

    tree : its nodes, each after the one that it hangs on.
    connections : a joint for every link, in their order; a joint for every loop; one for every
        element.   loops : how many loops.
    """

    lanes: int
    tree: tuple[Node, ...]
    connections: tuple[Connection, ...]
    loops: int
    update: str
    stages: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]
    multipliers: bool
    reaction: bool = False
    elements: tuple[Element, ...] = ()
    stabilisation: Stabilisation = UNSTABILISED
    exponentials: tuple[Stages, ...] = ()
    clock: str = "steps"
    embedded: Embedded | None = None
    extension: Extension | None = None
    looks: bool = False
    jumps: bool = False

    @property
    def links(self) -> int:
        return len(self.connections) - self.loops - len(self.elements)

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Of links, then of loops."""
        return self.connections[: self.links + self.loops]

    @property
    def rows(self) -> Rows:  # type: ignore[override]
        """Of all joints, then of motors and constraints."""
        return tuple(row for connection in self.connections for row in connection.rows)

    @cached_property
    def rows_with_multipliers(self) -> tuple[tuple[int, Row], ...]:
        """Rows that have a multiplier, each with the number of its connection."""
        found = []
        for number, connection in enumerate(self.connections):
            is_link = number < self.links
            rows = self.tree[connection.node].others if is_link else connection.rows
            found += [(number, row) for row in rows]
        return tuple(found)

    @property
    def keeps_rank(self) -> bool:  # type: ignore[override]
        return bool(self.rows_with_multipliers)

    __hash__ = AnyPlan.__hash__

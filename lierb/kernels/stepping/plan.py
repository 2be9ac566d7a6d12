"""What compiled code is specialised on."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

from lierb.compiler.tags import Tag
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import CSPACES, SE3, SO3xR3
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.stepping.formulations import FORMULATIONS, Formulation

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

    @cached_property
    def _digest(self) -> int:
        return hash(tuple(getattr(self, field.name) for field in fields(self)))  # type: ignore[arg-type]

    def __hash__(self) -> int:  # of a tableau's numbers each time, otherwise
        return self._digest

    @property
    def formulation(self) -> Any:
        """Where accelerations come from."""
        raise NotImplementedError

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

    @property
    def takes_gentle_steps(self) -> bool:
        """Whether steps are so little work that it pays to try them without branches. What is but
        tried asks no function that may raise.
        """
        calls = any(not f.is_traced for element in self.acting for f in element.functions)
        return self.is_local and not calls and self.formulation.takes_gentle_steps


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
    def formulation(self) -> Formulation:
        return FORMULATIONS[self.solver](self)

    @cached_property
    def turns_about_a_point(self) -> bool:
        """Whether the joint is spherical: any axes on the body will do, also its inertia's."""
        joint = [row for row in self.rows if row.is_of_joint]
        return len(joint) == 3 and holds_a_point(self.rows)


@lru_cache(256)
def plan_of(width: int, **described: Any) -> Plan:
    """The plan for registers that hold `width` numbers, always the same object: found again at once
    wherever code is kept by plan.

    Every operation of a step waits for the one before it. Two packs side by side hide that, as
    long as what is alive fits the registers.
    Measured, M body-steps/s on AVX-512 with 8, 16 and 32: revolute 200, 297, 310; cylindrical 181,
    280, 217; spherical 103, 107, 75; spherical by DOP853 21, 23, 18. On AVX2 with 4, 8 and 16:
    revolute 121, 187, 176; cylindrical 115, 156, 160; spherical 57, 65, 43; spherical by DOP853
    13, 11, 9. Saddle points, AVX-512 on another machine with 8 and 16: revolute 153, 163;
    spherical 77, 80. A batch that fills no block pays for one all the same: one kernel serves every
    batch.
    """
    plan = Plan(lanes=width, **described)
    doubles = width > 1 and plan.formulation.is_light
    return replace(plan, lanes=2 * width) if doubles else plan

"""What compiled code is specialised on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

from lierb.compiler._jit import Tag
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import CSPACES, SE3, SO3xR3
from lierb.kernels.mechanics.rows import Rows, fixed_axes
from lierb.kernels.mechanics.subgroup import Slots, slots_of

GENTLE_STAGES = 4  # of a saddle point, at most: more of them compile for long


def is_light(solver: str, cspace: str, rows: Rows, stages: int) -> bool:
    """Whether a step is little work: a rate for each of few stages and freedoms."""
    outright = solver != "saddle" or (
        cspace == "SE3" and holds_a_point(rows) and len(rows) == 3 + len(fixed_axes(rows))
    )
    return outright and stages * (6 - len(rows)) <= 12


def block_lanes(width: int, solver: str, cspace: str, rows: Rows, stages: int) -> int:
    """Bodies in a block, for registers that hold `width` numbers.

    Every operation of a step waits for the one before it. Two packs side by side hide that, as
    long as what is alive fits the registers.
    Measured, M body-steps/s on AVX-512 with 8, 16 and 32: revolute 200, 297, 310; cylindrical 181,
    280, 217; spherical 103, 107, 75; spherical by DOP853 21, 23, 18. On AVX2 with 4, 8 and 16:
    revolute 121, 187, 176; cylindrical 115, 156, 160; spherical 57, 65, 43; spherical by DOP853
    13, 11, 9. Saddle points, AVX-512 on another machine with 8 and 16: revolute 153, 163;
    spherical 77, 80. A batch that fills no block pays for one all the same: one kernel serves every
    batch.
    """
    return 2 * width if is_light(solver, cspace, rows, stages) and width > 1 else width


@dataclass(frozen=True)
class Plan(Tag):
    """One compiled integrator: a joint's rows, forces, a c-space, an update form, a method, L."""

    lanes: int
    rows: Rows
    cspace: str
    update: str
    stages: tuple[tuple[float, ...], ...]  # A of the Butcher tableau, strictly lower triangle
    weights: tuple[float, ...]  # b
    multipliers: bool  # whether λ is recorded
    reaction: bool = False  # whether the joint's wrench is
    elements: tuple[Element, ...] = ()  # forces beside gravity, and constraints beside the joint's
    # Where accelerations come from: "saddle", the saddle point in every stage, or "subgroup", a
    # subgroup joint's constant gain, by which poses stay in the subgroup.
    solver: str = "saddle"

    @cached_property
    def _digest(self) -> int:
        return hash(tuple(getattr(self, field.name) for field in fields(self)))

    def __hash__(self) -> int:  # of a tableau's numbers each time, otherwise
        return self._digest

    @cached_property
    def space(self) -> type[SE3] | type[SO3xR3]:
        return CSPACES[self.cspace]

    @cached_property
    def slots(self) -> Slots | None:
        """The joint's subalgebra, where velocities are held in its coordinates."""
        return None if self.solver == "saddle" else slots_of(self.rows)

    @cached_property
    def nodes(self) -> tuple[float, ...]:
        """c of the Butcher tableau: when each stage is."""
        return tuple(sum(weights) for weights in self.stages)

    @cached_property
    def turns_about_a_point(self) -> bool:
        """Whether the joint is spherical: any axes on the body will do, also its inertia's."""
        joint = [row for row in self.rows if row.is_of_joint]
        return len(joint) == 3 and holds_a_point(self.rows)

    @cached_property
    def slides_as_it_turns(self) -> bool:
        """Whether H has turns about e₃ and slides normal to it. Any point of the body will do then
        for the joint's, but for its height: the centre of mass, beside which nothing is small.
        """
        if self.slots is None:
            return False
        return self.slots[0] < 0 <= self.slots[2] and min(self.slots[3:5]) >= 0

    @property
    def is_local(self) -> bool:
        return self.update == "local"

    @cached_property
    def still(self) -> tuple[int, ...]:
        """Components of V that a saddle point keeps at zero, once they are: rows that are constant
        in body axes ask for nothing else, and nothing else moves them.
        """
        if self.solver != "saddle":
            return ()
        fixed = fixed_axes(self.rows)
        return (*fixed, 3, 4, 5) if self.cspace == "SE3" and holds_a_point(self.rows) else fixed

    @cached_property
    def does_work(self) -> bool:
        """Whether something can change E = T + U, so that its work has to be counted."""
        return any(element.does_work for element in self.elements)

    @cached_property
    def calls_functions(self) -> bool:
        """Whether functions of the user's are called body by body, and so may raise."""
        return any(not f.is_traced for element in self.elements for f in element.functions)

    @property
    def takes_gentle_steps(self) -> bool:
        """Whether steps are so little work that it pays to try them without branches. What is but
        tried asks no function that may raise.
        """
        if not self.is_local or self.calls_functions:
            return False
        if self.solver == "saddle":
            return bool(self.still) and len(self.stages) <= GENTLE_STAGES
        return is_light(self.solver, self.cspace, self.rows, len(self.stages))


@lru_cache(256)
def plan_of(**described: Any) -> Plan:
    """The plan, always the same object: found again at once wherever code is kept by plan."""
    return Plan(**described)

"""What compiled code is specialised on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from lierb.kernels._jit import Tag
from lierb.kernels.constraints import Row
from lierb.kernels.newton_euler import CSPACES, SE3, SO3xR3
from lierb.kernels.subgroup import Slots, slots_of


@dataclass(frozen=True)
class Plan(Tag):
    """One compiled integrator: a joint's rows, a c-space, an update form, a method, L."""

    lanes: int
    rows: tuple[Row, ...]
    cspace: str
    update: str
    stages: tuple[tuple[float, ...], ...]  # A of the Butcher tableau, strictly lower triangle
    weights: tuple[float, ...]  # b
    multipliers: bool  # whether λ is recorded
    # Where accelerations come from: "saddle", the saddle point in every stage, or a subgroup
    # joint's constant gain, on poses in SE(3) ("gain") or in the subgroup itself ("reduced").
    solver: str = "saddle"

    @cached_property
    def space(self) -> type[SE3] | type[SO3xR3]:
        return CSPACES[self.cspace]

    @cached_property
    def slots(self) -> Slots | None:
        """The joint's subalgebra, where velocities are held in its coordinates."""
        return None if self.solver == "saddle" else slots_of(self.rows)

    @property
    def is_local(self) -> bool:
        return self.update == "local"

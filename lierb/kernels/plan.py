"""What compiled code is specialised on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from lierb.kernels._jit import Tag
from lierb.kernels.constraints import Row
from lierb.kernels.newton_euler import CSPACES, SE3, SO3xR3


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

    @cached_property
    def space(self) -> type[SE3] | type[SO3xR3]:
        return CSPACES[self.cspace]

    @property
    def is_local(self) -> bool:
        return self.update == "local"

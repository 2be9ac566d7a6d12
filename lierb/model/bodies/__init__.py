"""Homogeneous solids are bodies with mass and inertia from dimensions, or from a mesh.

The body frame is at the centre of mass, with axes along those of the solid; for a mesh it is the
frame of the mesh. Each function takes either `mass` or `density`. Arguments may be batched.
"""

from typing import TYPE_CHECKING, NoReturn

from lierb.errors.synonyms import BODIES
from lierb.model.bodies.solids import box, cylinder, from_mesh, rod, sphere
from lierb.support.keywords import no_attribute

__all__ = ["box", "cylinder", "rod", "sphere", "from_mesh"]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> NoReturn:
        """Raise AttributeError for a name that does not exist, with the one that it has here."""
        raise no_attribute("lierb.bodies", name, __all__, BODIES)


def __dir__() -> list[str]:
    return list(__all__)

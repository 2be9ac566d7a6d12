"""Homogeneous solids are bodies with mass and inertia from dimensions, or from a mesh.

The body frame is at the centre of mass, with axes along those of the solid; for a mesh it is the
frame of the mesh. Each function takes either `mass` or `density`. Arguments may be batched.
"""

from typing import TYPE_CHECKING

from lierb.errors.synonyms import BODIES
from lierb.model.bodies.solids import box, cylinder, from_mesh, rod, sphere
from lierb.support.keywords import names_of_module

__all__ = ["box", "cylinder", "rod", "sphere", "from_mesh"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = names_of_module("lierb.bodies", __all__, BODIES)

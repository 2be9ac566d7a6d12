"""Homogeneous solids are bodies with mass and inertia from dimensions, or from a mesh.

The body frame is at the centre of mass, with axes along those of the solid; for a mesh it is the
frame of the mesh. Each function takes either `mass` or `density`. Arguments may be batched.
"""

from lierb.model.bodies.solids import box, cylinder, from_mesh, rod, sphere

__all__ = ["box", "cylinder", "rod", "sphere", "from_mesh"]


def __dir__() -> list[str]:
    return list(__all__)

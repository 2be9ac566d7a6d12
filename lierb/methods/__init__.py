"""Each method of the catalogue is one entry of a module as data."""

from __future__ import annotations

from lierb.errors import require_name
from lierb.methods import (
    classical,
    commutator_free,
    dop853,
    pairs,
    rosenbrock,
    structure_preserving,
    verner,
)
from lierb.methods.checks import MOST_STAGES
from lierb.methods.method import Method
from lierb.methods.rosenbrock_tableau import RosenbrockTableau
from lierb.methods.structure_preserving import generalised_alpha
from lierb.methods.tableau import ButcherTableau

__all__ = [
    "METHODS", "MOST_STAGES", "TABLEAUS", "ButcherTableau", "Method", "RosenbrockTableau",
    "generalised_alpha", "method_named",
]  # fmt: skip

TABLEAUS: dict[str, ButcherTableau] = {
    tableau.name: tableau
    for file in (classical, pairs, verner, dop853, commutator_free)
    for tableau in file.METHODS
}
METHODS: dict[str, Method] = {
    **TABLEAUS,
    **{each.name: each for file in (rosenbrock, structure_preserving) for each in file.METHODS},
}


def method_named(method: str | Method) -> Method:
    """Return the method of a name; a method itself."""
    if isinstance(method, Method):
        return method
    require_name("method", method, METHODS)
    return METHODS[method]


def __dir__() -> list[str]:
    return list(__all__)

"""Catalogue of methods, each one entry of a module as data."""

from __future__ import annotations

from lierb.errors import require_name
from lierb.methods import classical, commutator_free, dop853, pairs, rosenbrock, verner
from lierb.methods.checks import MOST_STAGES
from lierb.methods.method import Method
from lierb.methods.rosenbrock_tableau import RosenbrockTableau
from lierb.methods.tableau import ButcherTableau

__all__ = [
    "METHODS", "MOST_STAGES", "TABLEAUS", "ButcherTableau", "Method", "RosenbrockTableau",
    "method_named",
]  # fmt: skip

TABLEAUS: dict[str, ButcherTableau] = {
    tableau.name: tableau
    for file in (classical, pairs, verner, dop853, commutator_free)
    for tableau in file.METHODS
}
METHODS: dict[str, Method] = {
    **TABLEAUS, **{tableau.name: tableau for tableau in rosenbrock.METHODS}
}  # fmt: skip


def method_named(method: str | Method) -> Method:
    """Return the method of a name; a method itself."""
    if isinstance(method, Method):
        return method
    require_name("method", method, METHODS)
    return METHODS[method]


def __dir__() -> list[str]:
    return list(__all__)

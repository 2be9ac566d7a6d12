"""Catalogue of explicit Runge–Kutta methods, each one entry of a module as data."""

from lierb.errors import require_name
from lierb.methods import classical, commutator_free, dop853, pairs, verner
from lierb.methods.tableau import MOST_STAGES, ButcherTableau

__all__ = ["MOST_STAGES", "TABLEAUS", "ButcherTableau", "tableau_of"]

TABLEAUS: dict[str, ButcherTableau] = {
    tableau.name: tableau
    for file in (classical, pairs, verner, dop853, commutator_free)
    for tableau in file.METHODS
}


def tableau_of(method: str | ButcherTableau) -> ButcherTableau:
    """Return the tableau of a method's name; a tableau itself."""
    if isinstance(method, ButcherTableau):
        return method
    require_name("method", method, TABLEAUS)
    return TABLEAUS[method]


def __dir__() -> list[str]:
    return list(__all__)

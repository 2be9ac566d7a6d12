"""Each method of the catalogue is one entry of a module as data."""

from __future__ import annotations

from lierb.errors import UnknownNameError, require_name
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


# Names in SciPy, MATLAB and Julia's OrdinaryDiffEq of methods that are here, or of their kind.
ELSEWHERE = {
    "RK45": "DP54", "RK23": "BS32", "ode45": "DP54", "ode23": "BS32", "DP5": "DP54", "BS3": "BS32",
    "DP8": "DOP853", "dopri5": "DP54", "dop853": "DOP853", "Vern6": "Verner65", "Vern8": "Verner87",
    "Vern9": "Verner98", "Radau": "Rodas4", "BDF": "Rodas4", "LSODA": "Rodas4", "ode15s": "Rodas4",
    "ode23s": "ROS34PW2", "Rosenbrock23": "ROS34PW2", "RKMK4": "RK4",
    "leapfrog": "Verlet", "VelocityVerlet": "Verlet", "RATTLE": "RATTLie", "SHAKE": "SHAKELie",
}  # fmt: skip


def method_named(method: str | Method) -> Method:
    """Return the method of a name; a method itself."""
    if isinstance(method, Method):
        return method
    if isinstance(method, str) and method in ELSEWHERE:
        raise UnknownNameError(
            f"method={method!r} is a name of other packages; take {ELSEWHERE[method]!r} here"
        )
    require_name("method", method, METHODS)
    return METHODS[method]


def __dir__() -> list[str]:
    return list(__all__)

"""Applied forces other than gravity: springs, stops, friction, drag, added mass, motors, gears.

::

    problem = lierb.Problem(body, joint, forces=[lierb.forces.drag(linear=0.1)])

Every parameter is one value for all bodies or one for each: (n,), (n, 3). The name of a point or
direction includes its frame; the default point is the origin of that frame. `lierb.wrench` makes
a force from a function.

Each force is a class with name, parameters and formulas, and a function of that name makes it.
Studies use the same names.
"""

from typing import TYPE_CHECKING

from lierb.errors.synonyms import FORCES
from lierb.model.forces import (
    added_masses,
    bushings,
    friction,
    gears,
    limits,
    motors,
    springs,
    stiction,
    wrenches,
)
from lierb.model.forces.added_masses import *  # noqa: F403
from lierb.model.forces.built_in import UNITS
from lierb.model.forces.built_in import BuiltIn as BuiltIn
from lierb.model.forces.bushings import *  # noqa: F403
from lierb.model.forces.friction import *  # noqa: F403
from lierb.model.forces.gears import *  # noqa: F403
from lierb.model.forces.limits import *  # noqa: F403
from lierb.model.forces.motors import *  # noqa: F403
from lierb.model.forces.springs import *  # noqa: F403
from lierb.model.forces.stiction import *  # noqa: F403
from lierb.model.forces.wrenches import *  # noqa: F403
from lierb.model.forces.wrenches import BodyWrench as BodyWrench
from lierb.model.functions.wrenches import Force as Force
from lierb.support.keywords import names_of_module

__all__ = [
    *wrenches.__all__, *added_masses.__all__, *springs.__all__, *bushings.__all__,
    *friction.__all__, *stiction.__all__, *limits.__all__, *motors.__all__, *gears.__all__,
]  # fmt: skip
FORCE_UNITS = {name: UNITS[name] for name in __all__}  # units of parameters, by force

if not TYPE_CHECKING:
    __getattr__, __dir__ = names_of_module("lierb.forces", __all__, FORCES)

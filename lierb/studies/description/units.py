"""Name the units of sampled quantities, for the fields of tables and the axes of figures."""

from __future__ import annotations

from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.model import forces
from lierb.model.joints.joint import Joint
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import ELEMENTS

UNITS = {
    "mass": "kg", "inertia": "kg m²", "second_moments": "kg m²", "com": "m", "size": "m",
    "radius": "m", "length": "m", "density": "kg/m³",
    "body_point": "m", "ground_point": "m", "parent_point": "m",
    "axis": "1", "slot": "1", "second_axis": "1",
    "pitch": "m/rad", "gravity": "m/s²",
    "omega": "rad/s", "point_velocity": "m/s", "twist": "rad/s, rad/s, rad/s, m/s, m/s, m/s",
    "rotation": "1", "place": "m", "pose": "",
}  # fmt: skip


def unit_of(quantity: str, study: Study, problem: Problem | Mechanism) -> str:
    """Return the unit of a sampled quantity such as `initial.omega`.

    Mixed units are separated by commas. The unit of a user's parameter is unknown, "".

    problem : problem of the study, whose joints determine the units of coordinates.
    """
    section, _, key = quantity.rpartition(".")
    table, _, label = section.partition(".")
    if table == "controllers" and key == "every":
        return "s"
    if table in ELEMENTS:
        labels = [each.label for each in getattr(study.problem, table)]
        element = getattr(problem, table)[labels.index(label)]
        if isinstance(element.kind, TurnCounter):
            return str(element.units[element.name]) if key == "start" else ""
        if table == "states":
            return element.units.get(key, "1") if key in dict(element.columns) else ""
        return element.kind.unit_of(key) if isinstance(element.kind, forces.BuiltIn) else ""
    if key in ("coordinates", "velocities"):
        names = joint_of(quantity, problem).coordinate_names
        of_each = ["m" if name[0] in "ds" else "rad" for name in names]
        return ", ".join(unit + "/s" * (key == "velocities") for unit in of_each)
    return UNITS[key]


def joint_of(quantity: str, problem: Problem | Mechanism) -> Joint:
    """Return the joint of a quantity such as `initial.velocities` or `rod.initial.velocities`."""
    if isinstance(problem, Problem):
        return problem.joint
    return problem.link(quantity.partition(".")[0]).joint


def each_unit(unit: str, width: int) -> list[str]:
    """Return the unit of each component."""
    units = unit.split(", ")
    return units if len(units) == width else [unit] * width

"""Read the springs, dampers and stops of the joints of a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lierb.model import forces
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import Joint

if TYPE_CHECKING:
    from mujoco import MjModel

KINDS = ("free", "ball", "slide", "hinge")  # by mjtJoint
WITH_FORCES = {  # kind of MuJoCo's joint: lierb's joints about or along whose axis forces act
    "hinge": ("revolute", "cylindrical", "planar", "schoenflies"),
    "slide": ("prismatic", "cylindrical"),
}


@dataclass(frozen=True)
class JointForces:
    """The forces act in joint j of the MuJoCo model, which is part of the joint of a link."""

    model: MjModel
    j: int
    link: str
    joint: Joint
    limit_stiffness: float | None

    @property
    def label(self) -> str:
        return f"joint {self.model.joint(self.j).name or self.link}"

    @property
    def kind(self) -> str:
        return KINDS[self.model.jnt_type[self.j]]

    @property
    def has_force(self) -> bool:
        """Return whether a force of `lierb.forces` can act about or along the axis."""
        return self.joint.name in WITH_FORCES.get(self.kind, ())

    @property
    def needs_its_axis(self) -> bool:
        """Return whether the joint has a force that can act only if its axis stays a joint's."""
        has_stop = self.model.jnt_limited[self.j] and self.limit_stiffness is not None
        return self.kind in WITH_FORCES and bool(has_stop or any(self.spring))

    @property
    def spring(self) -> tuple[float, float]:
        """Return stiffness and damping, N m/rad and N m s/rad or N/m and N s/m."""
        damping = self.model.dof_damping[self.model.jnt_dofadr[self.j]]
        return float(self.model.jnt_stiffness[self.j]), float(damping)

    @property
    def is_polynomial(self) -> bool:
        """Return whether stiffness or damping is a polynomial with more than one coefficient."""
        dof = self.model.jnt_dofadr[self.j]
        return any(
            np.any(getattr(self.model, name)[at])
            for name, at in (("jnt_stiffnesspoly", self.j), ("dof_dampingpoly", dof))
            if hasattr(self.model, name)  # not in all releases
        )

    @property
    def _slack(self) -> float:
        """Return the coordinate at which the spring is slack, relative to qpos0."""
        return self._on_axis(self.model.qpos_spring[self.model.jnt_qposadr[self.j]])

    @property
    def _is_wound(self) -> bool:
        """Return whether the spring is slack beyond half a turn, which a pose cannot represent."""
        stiffness, _ = self.spring
        return self.kind == "hinge" and stiffness > 0.0 and abs(self._slack) > np.pi

    @property
    def range(self) -> tuple[float, float] | None:
        """Return the limits relative to qpos0 along the axis of the catalogue's joint.

        If the joint has no such coordinate, they are those of the file.
        """
        if not self.model.jnt_limited[self.j]:
            return None
        least, most = self.model.jnt_range[self.j]
        if not self.has_force:
            return float(least), float(most)
        ends = self._on_axis(least), self._on_axis(most)
        return ends if self.direction > 0.0 else ends[::-1]

    @property
    def direction(self) -> float:
        """−1 if the axis of the file is opposite to that of the catalogue's joint, else 1."""
        return float(np.sign(self.model.jnt_axis[self.j] @ self.joint.body_frame[:3, 2]))

    def _on_axis(self, q: float) -> float:
        return self.direction * float(q - self.model.qpos0[self.model.jnt_qposadr[self.j]])

    @property
    def _stops(self) -> tuple[float, float] | None:
        """Return the limits at which stops act, if the shorter way to them is that of the file."""
        if self.range is None or self.limit_stiffness is None or not self.has_force:
            return None
        lower, upper = self.range
        if lower > upper:
            return None
        is_shorter = self.kind == "slide" or upper - lower < 2 * np.pi > abs(lower + upper)
        return (lower, upper) if is_shorter else None

    def forces(self) -> Iterator[Force]:
        stiffness, damping = self.spring
        if (stiffness or damping) and self.has_force:
            slack = self._slack
            if self._is_wound:
                stiffness = slack = 0.0
            if self.kind == "hinge":
                yield forces.torsional_spring(stiffness=stiffness, damping=damping, angle=slack)
            else:
                yield forces.slide_spring(stiffness=stiffness, damping=damping, position=slack)
        if self._stops:
            stop = forces.joint_limit if self.kind == "hinge" else forces.slide_limit
            lower, upper = self._stops
            yield stop(lower=lower, upper=upper, stiffness=self.limit_stiffness)  # type: ignore[arg-type]

    def left_out(self) -> Iterator[str]:
        """Yield messages on properties of the joint that the mechanism lacks."""
        model, label, at = self.model, self.label, self.model.jnt_dofadr[self.j]
        if any(self.spring) and not self.has_force:
            yield f"{label}: stiffness and damping of a {self.kind} joint"
        elif self._is_wound:
            yield f"{label}: stiffness {self.spring[0]:.6g}, slack at {self._slack:.6g} rad"
        if self.is_polynomial:
            yield f"{label}: stiffness and damping beyond their first coefficients"
        if self.range and not self._stops:
            yield f"{label}: limits {self.range[0]:.6g} … {self.range[1]:.6g}"
        least, most = model.jnt_range[self.j]
        if self.range is None and least >= most and (least or most):
            yield f"{label}: limits {least:.6g} … {most:.6g}, which MuJoCo ignores"
        for what, value in (("friction", model.dof_frictionloss), ("armature", model.dof_armature)):
            if value[at]:
                yield f"{label}: {what} {value[at]:.6g}"
        if hasattr(model, "jnt_springyield") and model.jnt_springyield[self.j]:
            yield f"{label}: springyield"

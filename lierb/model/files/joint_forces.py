"""Read the springs, dampers and stops of the joints of a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lierb.model import forces
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.turns import turns
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import Joint

if TYPE_CHECKING:
    from mujoco import MjModel

KINDS = ("free", "ball", "slide", "hinge")  # by mjtJoint
WITH_FORCES = {  # kind of MuJoCo's joint: lierb's joints about or along whose axis forces act
    "hinge": ("revolute", "cylindrical", "planar", "schoenflies"),
    "slide": ("prismatic", "cylindrical"),
}
KEPT = 2.5  # rad from a force's zero: the rest of half a turn is for motion beyond stops
NEAR = 3.0  # rad, less than half a turn


def is_coupling(model: MjModel, k: int) -> bool:
    """Return whether equality k is an equality/joint."""
    from mujoco import mjtEq

    return int(model.eq_type[k]) == int(mjtEq.mjEQ_JOINT)


def is_curved(model: MjModel, k: int) -> bool:
    """Return whether equality/joint k couples two joints by a polynomial beyond a₁."""
    return bool(model.eq_obj2id[k] >= 0 and np.any(model.eq_data[k][2:5]))


def _couplings(model: MjModel) -> Iterator[int]:
    """Yield each equality/joint that becomes a gear or a motor."""
    for k in map(int, np.flatnonzero(model.eq_active0)):
        if is_coupling(model, k) and not is_curved(model, k):
            yield k


def coupled(model: MjModel) -> Iterator[tuple[int, int]]:
    """Yield the joints of each equality/joint that becomes a gear or a motor; −1 for none."""
    for k in _couplings(model):
        yield int(model.eq_obj1id[k]), int(model.eq_obj2id[k])


def _coupled_coordinate(model: MjModel, j: int) -> float:
    """Return the coordinate of joint j, relative to qpos0, if the joints that lead it are at qpos0.

    An equality/joint y = a₀ + a₁ x leads y; a joint that none leads has 0.
    """
    leading = {int(model.eq_obj1id[k]): k for k in _couplings(model)}
    coordinate, factor = 0.0, 1.0
    while j in leading:
        k = leading.pop(j)  # once each: chains may go round in a circle
        offset, slope = (float(x) for x in model.eq_data[k][:2])
        coordinate, factor = coordinate + factor * offset, factor * slope
        j = int(model.eq_obj2id[k])
    return coordinate


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
        is_coupled = any(self.j in pair for pair in coupled(self.model))
        return self.kind in WITH_FORCES and bool(has_stop or any(self.spring) or is_coupled)

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
    def counts_turns(self) -> bool:
        """Return whether its forces need an angle that counts whole turns, unlike a pose's.

        By a pose, a spring acts within half a turn of its slack angle, and stops within half a turn
        of their middle. Only stops keep a joint there.
        """
        if self.kind != "hinge" or not self.has_force:
            return False
        is_sprung = self.spring[0] != 0.0
        if self._stops is None:
            return is_sprung
        zeros = [sum(self._stops) / 2.0, *([self._slack] if is_sprung else [])]
        reached = 0.0, self._rest, *self._stops
        return max(abs(angle - zero) for angle in reached for zero in zeros) > KEPT

    @property
    def start(self) -> float:
        """Return the angle, rad, to which the angle at the start is the nearest of a pose's.

        Half a turn about it includes the angle at qpos0, or the one to which an equality/joint
        leads. As far as that leaves a choice, it includes the limits, even without stops, or, if
        they are wider, no angle beyond them.
        """
        rest = self._rest
        lower, upper = self._limits or (rest, rest)
        least, most = sorted((upper - NEAR, lower + NEAR))
        return float(np.clip(np.clip(rest, least, most), rest - NEAR, rest + NEAR))

    @property
    def _rest(self) -> float:
        """Return the coordinate at qpos0, or that to which an equality/joint leads from there."""
        return self.direction * _coupled_coordinate(self.model, self.j)

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
    def _limits(self) -> tuple[float, float] | None:
        """Return the range if stops can act at its ends."""
        if self.range is None or not self.has_force:
            return None
        lower, upper = self.range
        return (lower, upper) if lower <= upper else None

    @property
    def _stops(self) -> tuple[float, float] | None:
        """Return the limits at which stops act."""
        return None if self.limit_stiffness is None else self._limits

    def on(self, link: str) -> tuple[list[Force], list[ExtraStates]]:
        """Return the forces on a link, and the state that counts its turns if they need it."""
        counter = f"turned_{link}" if self.counts_turns else None
        states = [] if counter is None else [turns(counter, start=self.start).on(link)]
        return [force.on(link) for force in self._forces(counter)], states

    def _forces(self, counter: str | None) -> Iterator[Force]:
        stiffness, damping = self.spring
        slack, is_hinge = self._slack, self.kind == "hinge"
        if (stiffness or damping) and self.has_force:
            given = {"stiffness": stiffness, "damping": damping}
            if is_hinge:
                yield forces.torsional_spring(**given, angle=slack, turns=counter)
            else:
                yield forces.slide_spring(**given, position=slack)
        if self._stops and self.limit_stiffness is not None:
            lower, upper = self._stops
            ends = {"lower": lower, "upper": upper, "stiffness": self.limit_stiffness}
            if is_hinge:
                yield forces.joint_limit(**ends, turns=counter)
            else:
                yield forces.slide_limit(**ends)

    def left_out(self) -> Iterator[str]:
        """Yield messages on properties of the joint that the mechanism lacks."""
        model, label, at = self.model, self.label, self.model.jnt_dofadr[self.j]
        if any(self.spring) and not self.has_force:
            yield f"{label}: stiffness and damping of a {self.kind} joint"
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

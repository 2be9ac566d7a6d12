"""Measures of a mechanism: constraint residuals, energy, reactions, and poses for the user."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import errors_squared
from lierb.kernels.mechanics.ground_motion import GroundMotion
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.mechanics.tree import Connection, TreeConstants, TreeMotion
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import (
    ZERO3,
    ZERO6,
    Vec,
    add,
    axpy,
    cross_add,
    dot,
    mat_vec,
    mat_vec_add,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.measures import JOINT_ERRORS, Observed, orthogonality_squared
from lierb.kernels.systems.relatives import Relatives, largest, multipliers_of_wrench
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_acceleration import TreeAccelerations


class TreeMeasures(TreeAccelerations):
    """Measured quantities of a mechanism."""

    @property
    def links(self) -> int:
        return self.plan.links

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Joints, whose errors have separate columns."""
        return self.plan.joints

    def dropped(self, body: TreeConstants, state: State) -> Any:
        if not self.rows:
            return ZERO
        return self.accelerate(body, self.motion(body, state, ZERO), forces=False).dropped

    def measured(
        self,
        body: TreeConstants,
        state: State,
        motion: TreeMotion,
        time: Any,
        first_energy: Any = ZERO,
    ) -> Observed:
        """Value or square of every measure; errors are the largest over all connections."""
        plan, relatives = self.plan, self.relatives(body, motion)
        errors = []
        for number, connection in enumerate(plan.connections):
            if number >= len(plan.joints) and not connection.rows:
                continue
            x, ends, rows = relatives[number].x, body.ends[number], connection.rows
            rates = [relatives.rate_error(number, r) for r in rows]
            errors.append(errors_squared(rows, x, ends, rates))
        energy = self._energy(body, relatives)
        names = (measure.name for measure in JOINT_ERRORS)
        values = dict(zip(names, map(largest, zip(*errors, strict=True)), strict=True))
        values |= {
            "energy": energy,
            "energy_drift": energy - first_energy - state.work,
            "work": state.work,
            "orthogonality_error": largest(
                [orthogonality_squared(motion.place(i)[0]) for i in self._link_nodes]
            ),
        }
        return Observed(values, tuple(errors[: len(plan.joints)]))

    @property
    def _link_nodes(self) -> list[int]:
        """Index of each link's node, in the order of the links."""
        return [joint.node for joint in self.plan.connections[: self.plan.links]]

    def _energy(self, body: TreeConstants, relatives: Relatives) -> Any:
        """Kinetic energy plus the potential energies of gravity and all applied forces, J."""
        total, motion = ZERO, relatives.motion
        for i in self._link_nodes:
            constants, twist = body.nodes[i], motion.twists[i]
            moving = cross_add(twist[:3], constants.com, twist[3:])
            turning = dot(twist[:3], mat_vec(constants.inertia, twist[:3]))
            mass = constants.rigid.mass
            total = total + 0.5 * fma(mass, dot(moving, moving), turning)
            pose = motion.pose(i)
            place = mat_vec_add(pose[0], constants.com, pose[1])
            total = fma(-mass, dot(body.gravity, place), total)
        first = len(self.plan.joints)
        pairs = zip(self.plan.elements, body.elements, strict=True)
        for number, (element, placed) in enumerate(pairs, first):
            if not (element.is_passive or element.rows):
                x = relatives[number].x._replace(time=ZERO).motion  # no potential depends on time
                total = total + element.energy(placed, x._replace(signals=body.signals))
        return total

    def motions(
        self, body: TreeConstants, motion: TreeMotion, time: Any
    ) -> Callable[[int], Motion]:
        relatives, first = self.relatives(body, motion), len(self.plan.joints)
        return lambda i: relatives[first + i].x.motion._replace(signals=body.signals)

    def felt(self, body: TreeConstants, motion: TreeMotion, time: Any) -> Callable[[int], Vec]:
        response = self.accelerate(body, motion).solved.response
        moved = [*response.moved]  # of a ground that falls by −g
        places = [each.node for each in self.plan.connections[len(self.plan.joints) :]]
        seen, pairs = self.motions(body, motion, time), zip(self.plan.elements, body.elements)
        for i, (element, placed) in enumerate(pairs):
            if isinstance(element, GroundMotion):
                moved[places[i]] = add(moved[places[i]], ZERO3 + element.felt(placed, seen(i)))
        return lambda i: moved[places[i]]

    def in_user_frames(self, body: TreeConstants, numbers: list[Any], state: State) -> list[Vec]:
        motion = self.motion(body, state, ZERO)
        links = []
        for i in self._link_nodes:
            frame = body.nodes[i].frame
            pose = se3.compose(motion.pose(i), se3.inverse(frame))
            links.append(pose[0] + pose[1] + se3.Ad(frame, motion.twists[i]))
        return links

    def forces(self, body: TreeConstants, state: State, time: Any) -> tuple[Vec, list[Vec]]:
        """λ of all rows, and every joint's wrench on its body, about its frame there.

        The wrench includes those of motors that prescribe the joint's motion, and of gears.
        """
        acceleration = self.accelerate(body, self.motion(body, state, time))
        solution = dict(zip(self.rows, acceleration.solved.multipliers, strict=True))
        first = len(self.plan.joints)
        acting = enumerate(self.plan.connections[first:], first)
        added = [(place, r) for place, each in acting for r in each.rows]
        multipliers: list[Any] = []
        wrenches = []
        for number, joint in enumerate(self.plan.joints):
            total = ZERO6
            x, ends = acceleration.relatives[number].x, body.ends[number]
            if number < self.plan.links:
                total = acceleration.solved.transmitted(acceleration.bodies, joint.node)
            kept = tuple(r for r in joint.rows if (number, r) not in solution)
            own = multipliers_of_wrench(kept, x, ends, total)
            for r in joint.rows:
                if (number, r) in solution:
                    own[r] = solution[number, r]
                    total = axpy(-own[r], r.jacobian(x, ends), total)
            for place, r in added:
                for at, part in acceleration.relatives.parts(place, r):
                    if (at if at < first else self.plan.connections[at].joint) == number:
                        total = axpy(-solution[place, r], part.jacobian(x, ends), total)
            multipliers += [own[r] for r in joint.rows]
            wrenches.append(total)
        multipliers += [solution[place, r] for place, r in added]
        return tuple(multipliers), wrenches

"""A mechanism in the driver's terms: what is read of it, its state, its rates, what is seen of it.

The state is that of `lierb.kernels.mechanics.tree`: a chart, X and a velocity for every node, side
by side. On reduced coordinates they have the structural zeros of the joint's subgroup.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.functions.function import size_of
from lierb.kernels.groups import quaternion, se3, turns
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    residuals,
    rotation_error_squared,
)
from lierb.kernels.mechanics.newton_euler import Kinematics, Motion, girth_of
from lierb.kernels.mechanics.rows import PITCHED, Row, Screw
from lierb.kernels.mechanics.saddle import is_other_rank, kinds_of
from lierb.kernels.mechanics.spatial import twist_at
from lierb.kernels.mechanics.tree import (
    GROUND,
    HERE,
    MASSLESS,
    Connection,
    Ends,
    TreeConstants,
    TreeMotion,
    root_of,
)
from lierb.kernels.mechanics.tree_dynamics import (
    Bodies,
    Solved,
    bodies_of,
    solved,
)
from lierb.kernels.mechanics.tree_rows import Asked
from lierb.kernels.numbers.arithmetic import any_lanes, branch, fma, maximum, sqrt, where
from lierb.kernels.numbers.vec import (
    ZERO3,
    ZERO6,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
    neg,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.formulations import Rates, recharted
from lierb.kernels.systems.layout import Columns, Field
from lierb.kernels.systems.measures import JOINT_ERRORS, Observed, orthogonality_squared
from lierb.kernels.systems.plan import MechanismPlan
from lierb.kernels.systems.relatives import _bound, _held_multipliers, _largest, _Relatives
from lierb.kernels.systems.signals import Watching, lane_end, states_of
from lierb.kernels.systems.stabilisation import CLOSED, OPEN, _length
from lierb.kernels.systems.state import Stabilised, State
from lierb.kernels.systems.tree_inputs import (
    apart,
    chart_of,
    charts_of,
    charts_side_by_side,
    factored,
    first_of_joint,
    given_start,
    inputs_of,
    joint_ends,
    node_constants,
    placed_element,
    sixes,
    with_burdens,
)

GENTLE = 8  # nodes times stages
# In the same: how far it may move a mechanism at rest, whose start may be open by 1e-9 and whose
# rows may be near a singular pose.
UNMOVED = 1e-6


@dataclass(frozen=True)
class TreeFormulation(Watching):
    """Of a plan: what the stepper asks of a formulation, and the driver of a system."""

    plan: MechanismPlan
    still = ()
    is_homogeneous = False

    # ---- what is read ----

    @cached_property
    def inputs(self) -> Columns:
        """What is read of a mechanism, then a state to go on from."""
        plan = self.plan
        columns = inputs_of(plan.links, plan.loops, plan.elements)
        return Columns(
            *columns.fields,
            Field("state", (self.state.count,)),
            Field("lane", (lane_end(plan).count,)),
        )

    @cached_property
    def state(self) -> Columns:
        count = len(self.plan.tree)
        return Columns(
            Field("charts", (7 * count,)), Field("x", (6 * count,)), Field("v", (6 * count,)),
            Field("work"), Field("states", (size_of(states_of(self.plan)),)),
        )  # fmt: skip

    def body(self, numbers: list[Any]) -> TreeConstants:
        """Everything in joint axes."""
        plan, read = self.plan, self.inputs.parts(numbers)
        gravity = read["gravity"]
        nodes = tuple(node_constants(plan, i, read) for i in range(len(plan.tree)))
        nodes = with_burdens(plan.tree, nodes)
        ends = [joint_ends(plan, nodes, number, read) for number in range(len(plan.joints))]
        acting = [*zip(plan.elements, plan.connections[len(ends) :], strict=True)]
        placed = tuple(
            placed_element(element, k, c, nodes, read) for k, (element, c) in enumerate(acting)
        )
        ends += [Ends(HERE, HERE) if c.joint < 0 else ends[c.joint] for _, c in acting]
        found = TreeConstants(
            nodes, tuple(end._replace(elements=placed) for end in ends), gravity, placed
        )
        return found._replace(girth=girth_of(*((n.rigid.mass, n.inertia) for n in nodes)))

    def placed(self, body: TreeConstants, numbers: list[Any]) -> tuple[()]:
        """Nothing: starts of links depend on twists and poses together."""
        return ()

    def start(self, body: TreeConstants, placed: Any, numbers: list[Any]) -> State:
        """The state from poses and twists in the user's frames; what is off a subgroup is left."""
        plan, read = self.plan, self.inputs.parts(numbers)
        given = {
            i: given_start(body.nodes[i], read, node.link)
            for i, node in enumerate(plan.tree)
            if node.link != MASSLESS
        }
        given[GROUND] = HERE, ZERO6
        charts: list[Chart] = []
        velocities: list[Vec] = []
        for i, (place, twist) in [*given.items()][:-1]:
            first = first_of_joint(plan, i)
            outside, moving = given[plan.tree[first].parent]
            seat = se3.compose(se3.inverse(outside), place)
            relative = sub(twist, twist_at(seat, moving))
            d = se3.compose(se3.inverse(body.nodes[first].hang), seat)
            if not plan.tree[i].is_reduced:
                root = body.nodes[root_of(plan.tree, i)].hang
                chart, velocity = apart(plan.tree[i], body.nodes[i], root, place, twist)
                charts.append(chart)
                velocities.append(velocity)
                continue
            parts = [(d, relative)]
            if first != i:
                parts = factored(plan.tree[first].slots, plan.tree[i].slots, d, relative)
            for node, (part, velocity) in zip(plan.tree[first : i + 1], parts, strict=True):
                charts.append(chart_of(node, part))
                velocities.append(velocity)
        velocity = tuple(x for v in velocities for x in v)
        still = tuple(0.0 * x for x in velocity)
        state = State(tuple(charts), still, velocity, 0.0 * body.mass)
        tidied = self.tidied(body, self.structured(state, body).chart)
        return self.structured(state._replace(chart=tidied), body)

    def state_of(self, numbers: Sequence[Any], body: TreeConstants | None = None) -> State:
        """From its numbers side by side, as the driver carries them."""
        parts = self.state.parts(numbers)
        charts = charts_side_by_side(parts["charts"])
        (work,) = parts["work"]
        found = State(charts, parts["x"], parts["v"], work, parts["states"])
        return self.structured(found, body)

    def structured(self, state: State, body: TreeConstants | None = None) -> State:
        """With the structural zeros of each node's subgroup."""
        plan = self.plan
        charts: list[Chart] = []
        xs: list[Any] = []
        velocities: list[Any] = []
        for i, (node, chart, x, v) in enumerate(
            zip(plan.tree, state.chart, sixes(state.x), sixes(state.v_or_mu), strict=True)
        ):
            if node.is_reduced:
                pitch = 1.0 if body is None else body.nodes[i].pitch
                chart = subgroup.on_subgroup(node.slots, chart)
                x = subgroup.in_subalgebra(node.slots, x, pitch)
                v = subgroup.in_subalgebra(node.slots, v, pitch)
            charts.append(chart)
            xs += ZERO6 if plan.is_local else x
            velocities += v
        work = state.work if plan.does_work else ZERO
        return State(tuple(charts), tuple(xs), tuple(velocities), work, state.states)

    # ---- what is seen ----

    @property
    def links(self) -> int:
        return self.plan.links

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Those whose errors have columns of their own."""
        return self.plan.joints

    def told_by(self, chart: tuple[Chart, ...]) -> tuple[Vec, Vec]:
        """Of its charts, numbers that are finite if all turns are, and all places."""
        return tuple(p[0] for p, _ in chart), tuple(x for _, d in chart for x in d)

    def turning(self, body: TreeConstants, state: State) -> list[Any]:
        """The square of each node's angular velocity on its joint, or of its own, rad²/s²."""
        return [dot(v[:3], v[:3]) for v in sixes(state.v_or_mu)]

    def seen(self, body: TreeConstants, state: State, time: Any) -> TreeMotion:
        chart = state.chart if self.plan.is_local else self.moved(state.chart, state.x)
        return self.motion(body, chart, state.v_or_mu, time)

    def dropped(self, body: TreeConstants, state: State) -> Any:
        """How many rows depend on others."""
        if not self.plan.rows_with_multipliers:
            return ZERO
        return self.accelerate(body, self.seen(body, state, ZERO), forces=False).dropped

    def measured(
        self,
        body: TreeConstants,
        state: State,
        seen: Any,
        time: Any,
        first_energy: Any = ZERO,
    ) -> Observed:
        """Every measure's value or square; of errors the largest over all connections."""
        plan, relatives = self.plan, _Relatives(self.plan.connections, body.ends, seen)
        errors = []
        for number, connection in enumerate(plan.connections):
            if number >= len(plan.joints) and not connection.rows:
                continue
            x, ends, rows = relatives[number].x, body.ends[number], connection.rows
            rates = rate_errors_squared(rows, x, ends, x.omega + x.point_rate)
            position = position_error_squared(rows, x, ends)
            errors.append((position, rotation_error_squared(rows, x, ends), *rates))
        energy = self._energy(body, relatives)
        largest = (_largest(squares) for squares in zip(*errors, strict=True))
        found = dict(zip((measure.name for measure in JOINT_ERRORS), largest, strict=True))
        found |= {
            "energy": energy,
            "energy_drift": energy - first_energy - state.work,
            "work": state.work,
            "orthogonality_error": _largest(
                [orthogonality_squared(seen.place(i)[0]) for i in self._linked]
            ),
        }
        return Observed(found, tuple(errors[: len(plan.joints)]))

    @property
    def _linked(self) -> list[int]:
        """Numbers of the nodes that are links, in the order of these."""
        return [joint.node for joint in self.plan.connections[: self.plan.links]]

    def _energy(self, body: TreeConstants, relatives: _Relatives) -> Any:
        """Kinetic energy, and the potentials of gravity and all forces that have one."""
        total, motion = ZERO, relatives.motion
        for i in self._linked:
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
                still = relatives[number].x._replace(time=ZERO)  # potentials do not depend on it
                total = total + element.energy(placed, still.motion)
        return total

    def motions(self, body: TreeConstants, seen: Any, time: Any) -> Callable[[int], Motion]:
        relatives, first = _Relatives(self.plan.connections, body.ends, seen), len(self.plan.joints)
        return lambda i: relatives[first + i].x.motion._replace(signals=body.signals)

    def in_user_frames(self, body: TreeConstants, numbers: list[Any], state: State) -> list[Vec]:
        """R (row by row), r, ω, v, of every link."""
        motion = self.seen(body, state, ZERO)
        found = []
        for i in self._linked:
            frame = body.nodes[i].frame
            pose = se3.compose(motion.pose(i), se3.inverse(frame))
            found.append(pose[0] + pose[1] + se3.Ad(frame, motion.twists[i]))
        return found

    def forces(self, body: TreeConstants, state: State, time: Any) -> tuple[Vec, list[Vec]]:
        """λ of all rows, and every joint's wrench on its body, about its frame there, with that of
        a motor that prescribes its speed.
        """
        found = self.accelerate(body, self.seen(body, state, time))
        solution = dict(zip(self.plan.rows_with_multipliers, found.solved.multipliers, strict=True))
        multipliers: list[Any] = []
        wrenches = []
        for number, joint in enumerate(self.plan.joints):
            total = ZERO6
            x, ends = found.relatives[number].x, body.ends[number]
            if number < self.plan.links:
                total = found.solved.transmitted(found.bodies, joint.node)
            kept = tuple(r for r in joint.rows if (number, r) not in solution)
            own = _held_multipliers(kept, x, ends, total)
            for r in joint.rows:
                if (number, r) in solution:
                    own[r] = solution[number, r]
                    total = axpy(-own[r], r.jacobian(x, ends), total)
            for place, acting in enumerate(self.plan.connections):
                for r in acting.rows if acting.joint == number and place != number else ():
                    total = axpy(-solution[place, r], r.jacobian(x, ends), total)
            multipliers += [own[r] for r in joint.rows]
            wrenches.append(total)
        first = len(self.plan.joints)
        for place, acting in enumerate(self.plan.connections[first:], first):
            multipliers += [solution[place, r] for r in acting.rows]
        return tuple(multipliers), wrenches

    def given(self, numbers: list[Any], time: Any) -> tuple[()]:
        return ()

    def starts_well(self, given: Any, numbers: list[Any], time: Any) -> Any:
        """1: mechanisms are looked at before they are packed, by `lierb.runs.mechanism_checks`."""
        return 1.0

    # ---- a step ----

    @property
    def is_light(self) -> bool:
        """Whether registers hold two packs of it: never, of many bodies."""
        return False

    @property
    def takes_gentle_steps(self) -> bool:
        """Whether to try steps without branches.

        With two links on SE(3) they save a sixth; on reduced coordinates nothing. What is compiled
        twice takes half as long again.
        """
        plan = self.plan
        is_small = len(plan.tree) * len(plan.stages) <= GENTLE
        is_plain = not self.plan.rows_with_multipliers and plan.stabilisation.kind == "none"
        return is_small and is_plain and not any(node.is_reduced for node in plan.tree)

    def before_step(self, body: TreeConstants, chart: tuple[Chart, ...]) -> None:
        return None

    def velocity(self, body: TreeConstants, velocity: Vec) -> Vec:
        """The nodes' twists, side by side."""
        return velocity

    def places(self, chart: tuple[Chart, ...]) -> Vec:
        """Where the nodes are, side by side."""
        return self.told_by(chart)[1]

    def moved(self, chart: tuple[Chart, ...], x: Vec) -> tuple[Chart, ...]:
        """C₀ exp X, node by node."""
        return tuple(
            charts_of(node).compose_exp(each, part)
            for node, each, part in zip(self.plan.tree, chart, sixes(x), strict=True)
        )

    def in_algebra(self, body: TreeConstants, x: Vec) -> Vec:
        found: list[Any] = []
        for node, constants, part in zip(self.plan.tree, body.nodes, sixes(x), strict=True):
            reduced = node.is_reduced
            found += subgroup.in_subalgebra(node.slots, part, constants.pitch) if reduced else part
        return tuple(found)

    def rates(
        self,
        body: TreeConstants,
        chart: tuple[Chart, ...],
        before: None,
        x: Vec,
        velocity: Vec,
        time: Any,
    ) -> Rates:
        """Of one stage; arguments as of `SaddlePoint`."""
        parts = sixes(x)
        angles = [quaternion.angle_coefficients(part) for part in parts]
        tree = self.plan.tree
        moved = tuple(
            charts_of(node).compose_exp(each, part, k)
            for node, each, part, k in zip(tree, chart, parts, angles, strict=True)
        )
        motion = self.motion(body, moved, velocity, time)
        found = self.accelerate(body, motion)
        singular = found.singular
        if self.plan.rows_with_multipliers:  # another rank is another mechanism
            singular = where(is_other_rank(found.dropped, body.dropped), 1.0, singular)
        x_rates: list[Any] = []
        for node, part, v, k in zip(tree, parts, sixes(velocity), angles, strict=True):
            x_rates += charts_of(node).dexpinv(neg(part), v, k)
        return Rates(tuple(x_rates), found.rates, found.power, singular)

    def motion(
        self, body: TreeConstants, chart: tuple[Chart, ...], velocity: Vec, time: Any
    ) -> TreeMotion:
        poses = [
            (turns if charts_of(node) is turns else quaternion).pose(each)
            for node, each in zip(self.plan.tree, chart, strict=True)
        ]
        return TreeMotion(self.plan.tree, body, poses, sixes(velocity), time)

    def recharted(self, chart: tuple[Chart, ...], x: Vec) -> tuple[tuple[Chart, ...], Vec]:
        pairs = [
            recharted(charts_of(node), each, part)
            for node, each, part in zip(self.plan.tree, chart, sixes(x), strict=True)
        ]
        return tuple(pair[0] for pair in pairs), tuple(y for pair in pairs for y in pair[1])

    def tidied(self, body: TreeConstants, chart: tuple[Chart, ...]) -> tuple[Chart, ...]:
        """What rounding has taken from it: quaternions to unit length, screws on H."""
        found = []
        for node, constants, (p, d) in zip(self.plan.tree, body.nodes, chart, strict=True):
            p = quaternion.normalised(p)
            if node.is_reduced and PITCHED in node.slots:
                at = Kinematics(quaternion.matrix(p), d, ZERO3, ZERO3, ZERO3, ZERO3, True)
                off = Screw().value(at, Ends(HERE, HERE, constants.pitch))
                d = (d[0], d[1], d[2] - off)
            found.append((p, d))
        return tuple(found)

    # ---- accelerations ----

    def accelerate(
        self, body: TreeConstants, motion: TreeMotion, forces: bool = True
    ) -> TreeAcceleration:
        """forces : whether elements act."""
        plan = self.plan
        relatives = _Relatives(plan.connections, body.ends, motion)
        loads, power = self._applied(body, relatives) if forces else ({}, ZERO)
        wanted = [
            self._acceleration(number, row, relatives)
            for number, row in self.plan.rows_with_multipliers
        ]
        fall = {
            i: ZERO3 + neg(body.nodes[i].gravity)
            for i, node in enumerate(plan.tree)
            if node.parent == GROUND
        }
        damped = [self._damped(i, motion) for i in range(len(plan.tree))]
        biases = [add(motion.bias(i), each) for i, each in enumerate(damped)]
        rows = self._asked(relatives, wanted)
        bodies = bodies_of(motion, rows)
        found = solved(bodies, rows, loads, biases, fall, lambda: self._off_rows(motion))
        for (number, r), multiplier in zip(
            self.plan.rows_with_multipliers, found.multipliers, strict=True
        ):
            rate = r.prescribed_rate(relatives[number].x, body.ends[number])
            power = fma(-multiplier, rate, power)
        rates = self._state_rates(motion, found, damped)
        return TreeAcceleration(
            rates, power, found.singular, found.dropped, bodies, found, relatives
        )

    def _asked(self, relatives: _Relatives, wanted: list[Any]) -> list[Asked]:
        """All rows, those of joints of the tree stiff."""
        found = []
        for (number, r), value in zip(self.plan.rows_with_multipliers, wanted, strict=True):
            each = relatives.asked(number, r, value)
            if number < self.plan.links:
                mass, inertia = relatives.motion.body.nodes[each.node].burden
                each = each._replace(stiffness=mass if r.is_translational else inertia)
            found.append(each)
        return found

    def _applied(self, body: TreeConstants, relatives: _Relatives) -> tuple[dict[int, Vec], Any]:
        """Wrenches of all elements on the nodes, and what they add to E."""
        loads: dict[int, Vec] = {}
        power: Any = ZERO
        first = len(self.plan.joints)
        for number, (element, placed) in enumerate(
            zip(self.plan.elements, body.elements, strict=True), first
        ):
            if element.is_passive or element.rows:
                continue
            x = relatives[number].x.motion._replace(signals=body.signals)
            wrench = element.wrench(placed, x)
            power = power + element.power(placed, x, wrench)
            for i, load in relatives.asked(number, wrench[0] + wrench[1], ZERO).loads().items():
                loads[i] = add(loads[i], load) if i in loads else load
        return loads, power

    def _acceleration(self, number: int, row: Row, relatives: _Relatives) -> Any:
        """What J has to be of A_a − Ad A_b."""
        relative, ends = relatives[number], relatives.ends[number]
        x, kept = relative.x, self.plan.stabilisation
        jacobian = row.jacobian(x, ends)
        wanted = row.acceleration(x, ends) + dot(jacobian, relative.bias)
        if kept.kind != "baumgarte":
            return wanted
        off = dot(jacobian, x.omega + x.point_rate) - row.prescribed_rate(x, ends)
        wanted = fma(-2.0 * kept.alpha, off, wanted)
        return fma(-kept.beta * kept.beta, relatives.residual(number, row), wanted)

    def _damped(self, i: int, motion: TreeMotion) -> Vec:
        """What Baumgarte's method adds to a node's acceleration on its joint."""
        kept = self.plan.stabilisation
        if kept.kind != "baumgarte":
            return ZERO6
        off, moving = self._off(i, motion), _bound(motion, i, motion.relative[i])
        return axpy(-2.0 * kept.alpha, moving, scale(-kept.beta * kept.beta, off))

    def _off(self, i: int, motion: TreeMotion) -> Vec:
        """How far a node is off the rows on whose null space it is solved."""
        held, fixed, _ = kinds_of(self.plan.tree[i].rows)
        own = (*held.values(), *fixed.values())
        x = motion.kinematics(motion.hung(i), ZERO6)
        values = dict(zip(own, residuals(own, x, Ends(HERE, HERE)), strict=True))
        turn = tuple(values[fixed[k]] if k in fixed else ZERO for k in range(3))
        d = tuple(x.d[j] if j in held else ZERO for j in range(3))
        return turn + mat_t_vec(x.q, d)

    def _state_rates(self, motion: TreeMotion, found: Solved, damped: list[Vec]) -> Vec:
        """V̇_rel, or V̇ as the node's c-space has it."""
        rates: list[Any] = []
        for i, node in enumerate(self.plan.tree):
            if node.is_reduced:
                relative, rate = motion.relative[i], add(found.response.rates[i], damped[i])
                rates += rate[:3] + cross_add(relative[3:], relative[:3], rate[3:])
                continue
            falling = motion.body.nodes[root_of(self.plan.tree, i)].gravity
            moved, q = found.response.moved[i], motion.place(i)[0]
            twist, com = motion.twists[i], motion.body.nodes[i].com
            if node.cspace == "SE3":
                moving = cross_add(twist[3:], twist[:3], moved[3:])
                rates += moved[:3] + add(moving, mat_t_vec(q, falling))
                continue
            turning = moved[:3]
            swing = cross_add(twist[:3], cross(twist[:3], com), cross_add(turning, com, moved[3:]))
            rates += turning + mat_vec_add(q, swing, falling)
        return tuple(rates)

    # ---- stabilisation ----

    def stabilised(
        self, body: TreeConstants, before: State, state: State, time: Any, h: Any
    ) -> Stabilised:
        """Pose and velocity put back on all rows, by the least kinetic energy.

        before : the state at the start of the step, h seconds earlier.

        The step is marked as singular where Newton's method leads away from the rows, and where a
        correction is larger than the step can have made necessary. With s = h ‖V‖ and the
        mechanism's length ℓ, the step moves the pose by s and turns the rows by s/ℓ; its drift is a
        part of s in the pose and of ‖V‖ s/ℓ in V. A larger correction leads to another branch of
        the rows, across a jump in them, or along directions that a singular pose has left open.
        The bound on V holds where no motor prescribes a rate, which may jump.
        """
        if self.plan.stabilisation.kind != "project":
            return Stabilised(state)
        length = _length(body)
        nearer = self._closing(body, state.chart, time)
        first = self.moved(state.chart, scale(0.5, nearer))
        off, way = self._openness(body, first, time), _size(length, nearer)

        def again() -> Any:
            further = self._closing(body, first, time)
            second = self.moved(first, scale(0.5, further)), add(nearer, further)
            is_open = off > CLOSED * CLOSED
            second, x = where(is_open, second, (first, nearer))
            left, opened = (self._openness(body, chart, time) for chart in (second, state.chart))
            mark = where((left > OPEN * OPEN) & (left >= 0.25 * opened), 1.0, 0.0)
            return second, x, where(is_open, way + _size(length, further), way), mark

        chart, x, way, mark = branch(
            any_lanes(off > CLOSED * CLOSED), again, lambda: (first, nearer, way, 0.0), likely=False
        )
        speed = maximum(*(_size(length, each.v_or_mu) for each in (before, state)))
        most = fma(h, speed, UNMOVED * length)
        mark = where(way > most, 1.0, mark)
        change = self._onto_rows(body, chart, state.v_or_mu, time)
        if all(row.is_holonomic for _, row in self.plan.rows_with_multipliers):
            mark = where(h * length * _size(length, change) > most * most, 1.0, mark)
        kept = state._replace(chart=chart, v_or_mu=add(state.v_or_mu, change))
        return Stabilised(kept, mark, x, change)

    def _openness(self, body: TreeConstants, chart: tuple[Chart, ...], time: Any) -> Any:
        """The sum of the squares of all rows' values, lengths in units of the mechanism's own."""
        motion = self.motion(body, chart, (ZERO,) * (6 * len(chart)), time)
        return self._open(_Relatives(self.plan.connections, body.ends, motion))

    def _off_rows(self, motion: TreeMotion) -> Any:
        """How far pose and velocity are off all rows, as `multipliers_of` takes it."""
        again = motion.again()  # what is found here alone is not at hand elsewhere
        relatives = _Relatives(self.plan.connections, motion.body.ends, again)
        length, pose = _length(motion.body), self._open(relatives)
        rates: Any = ZERO
        for number, r in self.plan.rows_with_multipliers:
            x, ends = relatives[number].x, motion.body.ends[number]
            rate = dot(r.jacobian(x, ends), x.omega + x.point_rate) - r.prescribed_rate(x, ends)
            part = rate if r.is_translational else length * rate
            rates = fma(part, part, rates)
        speed = _size(length, tuple(x for relative in again.relative for x in relative))
        whole = fma(speed, speed, rates)
        return sqrt(pose + rates / where(whole > 0.0, whole, 1.0))

    def _open(self, relatives: _Relatives) -> Any:
        """`_openness` of poses that are seen already."""
        inverse = 1.0 / _length(relatives.motion.body)
        total: Any = ZERO
        for number, connection in enumerate(self.plan.connections):
            for r, value in relatives.residuals(number, connection.rows).items():
                part = value * inverse if r.is_translational else value
                total = fma(part, part, total)
        return total

    def _closing(self, body: TreeConstants, chart: tuple[Chart, ...], time: Any) -> Vec:
        """A step of Newton's method onto all rows, in the algebra."""
        motion = self.motion(body, chart, (ZERO,) * (6 * len(chart)), time)
        relatives = _Relatives(self.plan.connections, body.ends, motion)
        wanted = [
            -relatives.residual(number, row) for number, row in self.plan.rows_with_multipliers
        ]
        biases = [neg(self._off(i, motion)) for i in range(len(self.plan.tree))]
        return self._displaced(motion, relatives, wanted, biases)

    def _onto_rows(
        self, body: TreeConstants, chart: tuple[Chart, ...], velocity: Vec, time: Any
    ) -> Vec:
        """The least change of the velocity with which it satisfies all rows."""
        motion = self.motion(body, chart, velocity, time)
        relatives = _Relatives(self.plan.connections, body.ends, motion)
        wanted = []
        for number, r in self.plan.rows_with_multipliers:
            x, ends = relatives[number].x, body.ends[number]
            rate = dot(r.jacobian(x, ends), x.omega + x.point_rate)
            wanted.append(r.prescribed_rate(x, ends) - rate)
        biases = [neg(_bound(motion, i, relative)) for i, relative in enumerate(motion.relative)]
        return self._displaced(motion, relatives, wanted, biases)

    def _displaced(
        self, motion: TreeMotion, relatives: _Relatives, wanted: list[Any], biases: list[Vec]
    ) -> Vec:
        """The smallest motion, in the kinetic metric, of which rows are `wanted`."""
        rows = [each._replace(fall=None) for each in self._asked(relatives, wanted)]
        bodies, openness = bodies_of(motion, rows), lambda: self._off_rows(motion)
        found = solved(bodies, rows, {}, biases, openness=openness)
        moved: list[Any] = []
        for i, node in enumerate(self.plan.tree):
            twist = found.response.moved[i]
            if node.is_reduced:
                moved += add(found.response.rates[i], biases[i])
            elif node.cspace == "SE3":
                moved += twist
            else:
                com = motion.body.nodes[i].com
                along = mat_vec(motion.place(i)[0], cross_add(twist[:3], com, twist[3:]))
                moved += twist[:3] + along
        return tuple(moved)


class TreeAcceleration(NamedTuple):
    """rates : flat, as velocities are.   power : what forces and motors add to E."""

    rates: Vec
    power: Any
    singular: Any
    dropped: Any
    bodies: Bodies
    solved: Solved
    relatives: _Relatives


# ---- what is seen ------------------------------------------------------------------------------


def _size(length: Any, motion: Vec) -> Any:
    """Norm of a motion or velocity of all nodes, m or m/s: turns count by the length."""
    total: Any = ZERO
    for each in sixes(motion):
        turn = scale(length, each[:3])
        total = total + (dot(turn, turn) + dot(each[3:], each[3:]))
    return sqrt(total)

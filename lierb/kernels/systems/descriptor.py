"""The descriptor form of the equations of motion keeps constraints as equations.

    M V̇ + Jᵀλ = ad_Vᵀ M V + W,   h(C, t) = 0,   J V = w(t)

on SE(3) or SO(3)×R³; w is the rate of a motor of given position. Methods that keep h = 0 step this
form. That of a body is at its frame's
origin; `lierb.kernels.systems.tree_descriptor` has that of a mechanism.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.constraints import smooth_residuals
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.mechanics.saddle import PIVOT_TOLERANCE, Elimination, has_others, is_other_rank
from lierb.kernels.numbers.arithmetic import any_lanes, branch, fma, sqrt, where
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.numbers.newton import total, without_derivatives
from lierb.kernels.numbers.vec import (
    ZERO6,
    Mat,
    Vec,
    axpy,
    cross_add,
    dot,
    mat_vec,
    norm,
    scale,
    units,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.formulations import SaddlePoint
from lierb.kernels.systems.plan import Plan


class Constraints(NamedTuple):
    """Constraints have values h, a Jacobian J and prescribed rates w, row by row.

    width : number of columns of J.
    """

    values: Vec
    jacobian: tuple[Vec, ...]
    prescribed: Vec
    width: int = 6

    def force(self, multipliers: Vec) -> Vec:
        """Return Jᵀλ."""
        result: Vec = (ZERO,) * self.width
        for row, size in zip(self.jacobian, multipliers, strict=True):
            pairs = zip(row, result, strict=True)
            result = tuple(y if is_zero(x) else fma(size, x, y) for x, y in pairs)
        return result

    def rates(self, velocity: Vec) -> Vec:
        """Return J V − w."""
        pairs = zip(self.jacobian, self.prescribed, strict=True)
        return tuple(dot(row, velocity) - w for row, w in pairs)


class Descriptor:
    """The descriptor form has these terms, of one body or of several.

    n = 6 for one body, and 6 times their number for several.
    """

    width: int  # n
    rows: int  # number of constraint rows
    plan: Any
    system: Any
    body: Any

    @property
    def may_depend(self) -> bool:
        """Return whether rows may depend on other rows, as in a planar loop."""
        raise NotImplementedError

    def dependent(self, constraints: Constraints) -> Vec:
        """Return 1 for each row of J that depends on the rows before it, else 0.

        Such a row is left out: the others imply it, and its multiplier is 0. () if no rows may
        depend on others.
        """
        if not self.may_depend:
            return ()
        dropped = without_derivatives(self.body.dropped)

        def found() -> Vec:
            rows = [without_derivatives(row) for row in constraints.jacobian]
            columns = _over(without_derivatives(self.mass_matrix()), rows)
            schur = [[dot(row, columns[j]) for j in range(i + 1)] for i, row in enumerate(rows)]
            mobilities = [line[-1] for line in schur]
            nothing = [ZERO] * len(rows)
            return tuple(Elimination(schur, nothing, mobilities, PIVOT_TOLERANCE).dropped)

        none = (0.0 * dropped,) * self.rows
        return branch(any_lanes(dropped > 0.5), found, lambda: none, likely=False)

    def singular(self, dependent: Vec) -> Any:
        """Return 1 where the number of dependent rows is not that at the start of the run.

        dependent : as returned by `dependent`.
        """
        if not dependent:
            return ZERO
        changes = is_other_rank(sum(dependent, start=ZERO), without_derivatives(self.body.dropped))
        return where(changes, 1.0, 0.0 * without_derivatives(self.body.dropped))

    def momentum(self, velocity: Vec) -> Vec:
        """Return M V."""
        raise NotImplementedError

    def applied(self, chart: Any, velocity: Vec, time: Any) -> Applied:
        """Return W of gravity and all other forces, and the power of those without potential."""
        raise NotImplementedError

    def gyroscopic(self, velocity: Vec) -> Vec:
        """Return ad_Vᵀ M V."""
        raise NotImplementedError

    def constraints(self, chart: Any, time: Any) -> Constraints:
        raise NotImplementedError

    def power(self, chart: Any, velocity: Vec, time: Any) -> Any:
        """Return the power of forces without potential and of motors of given position, W."""
        power = self.applied(chart, velocity, time).power
        if any(row.depends_on_time for row in self.plan.rows):
            rates = self.constraints(chart, time).prescribed
            power = power - dot(rates, self.accelerations(chart, velocity, time)[1])
        return power

    def accelerations(self, chart: Any, velocity: Vec, time: Any) -> tuple[Vec, Vec]:
        """Return V̇ and λ."""
        raise NotImplementedError

    def pulled(self, x: Vec, momentum: Vec) -> Vec:
        """Return dexp⁻ᵀ_X p."""
        raise NotImplementedError

    def size(self, chart: Any, x: Vec) -> Any:
        """Return the size of X, relative to 1 rad and to the bodies' size and position."""
        raise NotImplementedError

    @property
    def forces_depend_on_velocity(self) -> bool:
        return any(element.depends_on_velocity for element in self.plan.acting)

    def moved(self, chart: Any, x: Vec) -> Any:
        """Return C exp X."""
        return self.system.moved(chart, scale(0.5, x))

    def mass_matrix(self) -> Mat:
        """Return the columns of M, which is symmetric."""
        return tuple(self.momentum(unit) for unit in units(self.width))

    def per_mass(self, constraints: Constraints) -> Constraints:
        """Return the constraints with J M⁻¹ in place of J."""
        return constraints._replace(jacobian=_over(self.mass_matrix(), constraints.jacobian))

    def consistent(self, constraints: Constraints, dependent: Vec) -> Factored:
        """Factor [[M, Jᵀ], [J, 0]] without the rows that are `dependent`."""
        rows, m = constraints.jacobian, len(constraints.jacobian)
        mass = self.mass_matrix()
        upper = [[*mass[i], *(row[i] for row in rows)] for i in range(self.width)]
        return Factored([*upper, *([*row, *(ZERO,) * m] for row in rows)], dependent)


class BodyDescriptor(Descriptor):
    """The descriptor form of one body."""

    plan: Plan
    width = 6

    def __init__(self, system: SaddlePoint, body: BodyConstants) -> None:
        self.system, self.body, self.plan = system, body, system.plan
        self.rows = len(self.plan.rows)
        self.is_mixed = self.plan.cspace == "SO3xR3"

    @property
    def may_depend(self) -> bool:
        return has_others(self.plan.rows)

    def momentum(self, velocity: Vec) -> Vec:
        if self.is_mixed:
            turning = mat_vec(self.body.inertia, velocity[:3])
            return turning + scale(self.body.mass, velocity[3:])
        return self.body.momentum(velocity)

    def applied(self, chart: Chart, velocity: Vec, time: Any) -> Applied:
        body, plan = self.body, self.plan
        applied = Applied(ZERO6, ZERO)
        if plan.acting:
            x = plan.space.kinematics(body, quaternion.pose(chart), velocity)
            applied = applied_to(body, plan.elements, x._replace(time=time).motion)
        torque, force = applied.wrench[:3], applied.wrench[3:]  # about the joint's point
        if self.is_mixed:
            torque = cross_add(body.arm, force, torque)
            force = axpy(body.mass, body.gravity, quaternion.rotated(chart[0], force))
        else:
            fall = quaternion.rotated_back(chart[0], body.gravity)
            torque = cross_add(body.first_moment, fall, torque)
            force = axpy(body.mass, fall, force)
        return Applied(torque + force, applied.power)

    def gyroscopic(self, velocity: Vec) -> Vec:
        return spun(velocity, self.momentum(velocity), self.is_mixed)

    def constraints(self, chart: Chart, time: Any) -> Constraints:
        x = self.plan.space.kinematics(self.body, quaternion.pose(chart), ZERO6)
        x = x._replace(time=time)
        values = smooth_residuals(self.plan.rows, x, self.body)
        jacobian = tuple(row.jacobian(x, self.body) for row in self.plan.rows)
        rates = tuple(row.prescribed_rate(x, self.body) for row in self.plan.rows)
        return Constraints(tuple(values), jacobian, rates)

    def accelerations(self, chart: Chart, velocity: Vec, time: Any) -> tuple[Vec, Vec]:
        solution = accelerate(self.plan, self.body, chart, velocity, time)
        return solution.rate, solution.multipliers

    def pulled(self, x: Vec, momentum: Vec) -> Vec:
        return pulled_by(self.plan.space.charts, x, momentum)

    def size(self, chart: Chart, x: Vec) -> Any:
        return size_of(self.body.girth, chart, x)


def _over(mass: Mat, rows: Sequence[Vec]) -> tuple[Vec, ...]:
    """Return M⁻¹ times each row."""
    factored = Factored([list(column) for column in mass])
    return tuple(map(factored.solve, rows))


def spun(velocity: Vec, momentum: Vec, is_mixed: bool) -> Vec:
    """Return ad_Vᵀ p of a body.   is_mixed : True on SO(3)×R³."""
    omega = velocity[:3]
    spin = cross_add(momentum[:3], omega, (ZERO,) * 3)
    if is_mixed:
        return spin + (ZERO,) * 3
    torque = cross_add(momentum[3:], velocity[3:], spin)
    return torque + cross_add(momentum[3:], omega, (ZERO,) * 3)


def pulled_by(charts: ModuleType, x: Vec, momentum: Vec) -> Vec:
    """Return dexp⁻ᵀ_X p of a body.   charts : formulas of its group."""
    half = scale(0.5, x)
    k = quaternion.angle_coefficients(half)
    return tuple(dot(charts.dexpinv(half, unit, k), momentum) for unit in units(6))


def size_of(girth: Any, chart: Chart, x: Vec) -> Any:
    """Return the size of a body's X.   girth : square of the radius of gyration, m²."""
    length = sqrt(girth) + norm(chart[1])
    return total(x[:3]) + total(x[3:6]) * (1.0 / length)

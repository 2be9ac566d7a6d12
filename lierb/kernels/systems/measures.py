"""Measure constraint residuals, energy and orthogonality of the rotation along a trajectory.

Each measure is an entry of MEASURES, which determines its columns in histories and summaries, and
their units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.kernels.mechanics.constraints import position_error_squared, rotation_error_squared
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics, Pose
from lierb.kernels.numbers.arithmetic import absolute, fma, maximum, plain, sqrt, where
from lierb.kernels.numbers.vec import IDENTITY, Mat, mat_t_mat
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.layout import Columns, Field
from lierb.kernels.systems.plan import Plan


class Sample(NamedTuple):
    """All measures are computed from a sample: motion and energies of a body at one time."""

    plan: Plan
    body: BodyConstants
    pose: Pose
    x: Kinematics
    rate_errors: tuple[Any, Any]
    energy: Any
    first_energy: Any
    work: Any


class Observed(NamedTuple):
    """Hold the measures at one time: value or square by name, and the errors of each joint.

    joints : squares of JOINT_ERRORS for each joint of a mechanism; empty for one body.
    """

    values: dict[str, Any]
    joints: tuple[tuple[Any, ...], ...] = ()


class Measure(NamedTuple):
    """A measure is column `name` of a history, and `name_max` or `name_final` of a summary.

    of : function that computes its value, or its square: the root is taken once, of the largest.
    keeps : "max", the largest magnitude, and "final", the value at the end.
    recorded_by : value of `record` that includes it in a history; None if it is always included.
    """

    name: str
    unit: str
    of: Callable[[Sample], Any]
    is_square: bool = False
    keeps: tuple[str, ...] = ()
    recorded_by: str | None = None

    def shown(self, value: Any) -> Any:
        """Return the value in the measure's unit."""
        return sqrt(value) if self.is_square else value

    def size(self, value: Any) -> Any:
        """Return the number of which a summary keeps the largest."""
        return value if self.is_square else absolute(value)


def orthogonality_squared(q: Mat) -> Any:
    """Return ‖QᵀQ − I‖², Frobenius."""
    total: Any = ZERO
    for entry, one in zip(mat_t_mat(q, q), IDENTITY, strict=True):
        excess = entry - one
        total = fma(excess, excess, total)
    return total


MEASURES = (
    Measure(
        "position_error", "m", lambda s: position_error_squared(s.plan.rows, s.x, s.body),
        is_square=True, keeps=("max", "final"),
    ),
    Measure(
        "rotation_error", "1", lambda s: rotation_error_squared(s.plan.rows, s.x, s.body),
        is_square=True, keeps=("max", "final"),
    ),
    Measure("velocity_error", "m/s", lambda s: s.rate_errors[0], is_square=True, keeps=("max",)),
    Measure(
        "rotation_rate_error", "rad/s", lambda s: s.rate_errors[1], is_square=True, keeps=("max",)
    ),
    # E(t) − E(0) − W(t), with the work W of forces without potential.
    Measure("energy_drift", "J", lambda s: s.energy - s.first_energy - s.work, keeps=("max",)),
    Measure("energy", "J", lambda s: s.energy, recorded_by="energy"),
    Measure("work", "J", lambda s: s.work, keeps=("final",), recorded_by="energy"),
    Measure(
        "orthogonality_error", "1", lambda s: orthogonality_squared(s.pose[0]),
        is_square=True, keeps=("max",),
    ),
)  # fmt: skip
KEPT = tuple((measure, how) for measure in MEASURES for how in measure.keeps)
JOINT_ERRORS = tuple(m for m in MEASURES[:4])
JOINT_KEPT = tuple((m, how) for m in JOINT_ERRORS for how in m.keeps)
SUMMARY = Columns(
    *(Field(f"{measure.name}_{how}", (), measure.unit) for measure, how in KEPT),
    Field("status"),
    Field("failed_step"),
    Field("raised"),  # index of the exception that a user's function raised
    Field("starts"),  # 1 where the start is on the joint, and 0 elsewhere
)
MUST_BE_FINITE = tuple(m.name for m in MEASURES if m.is_square or m.name == "energy_drift")


def retained(how: str, old: Any, value: Any, size: Any, alive: Any) -> Any:
    """Return what a summary keeps of a measure after one more value.

    how : one of `Measure.keeps`.   size : `Measure.size` of the value.
    alive : mask of trajectories that have not failed.
    """
    if how == "final":
        return where(alive, plain(value), float("nan"))
    return old if is_zero(size) else where(alive, maximum(old, size), old)

"""Mechanisms that several test files integrate, whose kernels are compiled once, and the kernels'
formulas of any mechanism in plain Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import lierb
from lierb.kernels.mechanics.tree import TreeConstants
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.plan import UNSTABILISED
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.systems.tree_system import TreeFormulation
from lierb.methods import TABLEAUS
from lierb.model.mechanism.plan import mechanism_plan_of
from lierb.runs.starts import Ready

GRAVITY = (0.0, 0.0, -9.81)
TURNING = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}


@cache
def double_pendulum() -> lierb.Mechanism:
    """Two equal rods on revolute joints."""
    rod = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    lower = lierb.joints.revolute(**TURNING, parent_point=(0.0, 0.0, -0.25))
    return lierb.Mechanism(
        [
            lierb.Link("upper", rod, lierb.joints.revolute(**TURNING)),
            lierb.Link("lower", rod, lower, "upper"),
        ],
        gravity=GRAVITY,
    )


@cache
def four_bar() -> lierb.Mechanism:
    """Crank 0.1 m, coupler 0.3 m and rocker 0.25 m on a base of 0.3 m, in the plane e₁ e₃."""
    y = {"axis": (0.0, 1.0, 0.0)}
    lengths = {"crank": 0.1, "coupler": 0.3, "rocker": 0.25}
    bars = {n: lierb.bodies.box((x, 0.02, 0.02), density=2700.0) for n, x in lengths.items()}
    left = {n: (-0.5 * x, 0.0, 0.0) for n, x in lengths.items()}
    right = {n: (0.5 * x, 0.0, 0.0) for n, x in lengths.items()}
    return lierb.Mechanism(
        [
            lierb.Link("crank", bars["crank"], lierb.joints.revolute(left["crank"], **y)),
            lierb.Link(
                "coupler", bars["coupler"],
                lierb.joints.revolute(left["coupler"], parent_point=right["crank"], **y), "crank",
            ),
            lierb.Link(
                "rocker", bars["rocker"],
                lierb.joints.revolute(left["rocker"], ground_point=(0.3, 0.0, 0.0), **y),
            ),
        ],
        [
            lierb.Loop(
                "pin", lierb.joints.revolute(right["coupler"], parent_point=right["rocker"], **y),
                "coupler", "rocker",
            )
        ],
        gravity=GRAVITY,
        forces=lierb.forces.drag(angular=0.002).on("rocker"),
    )  # fmt: skip


def in_python(
    mechanism: lierb.Mechanism,
    cspace: str,
    pose0: dict[str, Any],
    twist0: dict[str, Any],
    method: Any = TABLEAUS["Euler"],
) -> tuple[TreeFormulation, TreeConstants, State]:
    """Formulas, constants and start of a mechanism, or of the first of a batch, on floats."""
    plan = mechanism_plan_of(
        mechanism, (cspace,) * len(mechanism.links), UNSTABILISED, elements=mechanism.kinds,
        update="local", method=method.scheme(False, False), multipliers=False,
    )  # fmt: skip
    given = dict(mechanism.inputs)
    for i, name in enumerate(mechanism.names):
        given |= {f"{i}.pose": pose0[name], f"{i}.twist": twist0[name]}
    flat: list[float] = []
    for field, _ in system_of(plan).inputs:
        first = np.ravel(given.get(field.name, 0.0))[: int(np.prod(field.shape))]
        numbers = np.broadcast_to(first.reshape(-1), int(np.prod(field.shape)))
        flat += map(float, numbers if field.entries is None else numbers[list(field.entries)])
    body = system_of(plan).body(flat)
    return system_of(plan), body, system_of(plan).start(body, (), flat)


def stepped(run: Ready, numbers: Any, dt: float, steps: int) -> tuple[Any, Any, State]:
    """System, constants and last state of a trajectory, stepped by the formulas of unrolled code.

    numbers : the trajectory's inputs, floats or dual numbers.
    """
    system = system_of(run.plan)
    constants = system.body(numbers)
    state = system.start(constants, (), numbers)
    constants = constants._replace(dropped=0.0 + system.dropped(constants, state))
    for k in range(steps):
        at = Interval(k * dt, dt, dt)
        state = method_of(run.plan).step(system, constants, state, at).state
    return system, constants, state


def bits(result: lierb.Result) -> np.ndarray:
    """Every number of the summary, as integers."""
    names = [n for n in result.summary.column_names if n not in ("trajectory", "status")]
    rows = [np.array(result.summary[n].to_pylist(), float) for n in names]
    return np.concatenate([x.reshape(len(x), -1) for x in rows], axis=1).view(np.int64)

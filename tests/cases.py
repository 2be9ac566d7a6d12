"""Problems that several test files integrate: the paper's box, tilted frames, every joint."""

from __future__ import annotations

import numpy as np
import pytest
import reference_numbers as ref

import lierb
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.system_of import system_of

# Joints whose motions are a subgroup of SE(3): kept exactly there.
SUBGROUP_JOINTS = [name for name, entry in lierb.joints.JOINTS.items() if entry.subgroup]
PITCH = 0.07  # m/rad
LENGTH = 0.35  # m, of a rod
GRAVITY = (0.0, 0.0, -9.81)
RECORD = ("state", "multipliers", "reaction")


def rotation(*xi: float) -> np.ndarray:
    return lierb.lie.so3.exp(xi)


def frame(xi, point) -> np.ndarray:
    """A joint frame turned by the rotation vector xi, at a point."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(*xi)
    matrix[:3, 3] = point
    return matrix


# Nothing is aligned with anything, and the joint is away from both origins.
GROUND_FRAME = frame((0.4, -1.1, 0.7), (0.3, -0.2, 0.5))
BODY_FRAME = frame((-0.9, 0.5, 1.3), (-0.15, 0.0375, 0.02))


def slow_but(names, *quick) -> list:
    """Parameters of which only `quick` run with -m "not slow": each compiles kernels of its own."""
    return tiered(names, quick, names)


def long_but(names, *slow) -> list:
    """Parameters of which `slow` run in every run of all tests, the others with -m long alone."""
    return tiered(names, (), slow)


def tiered(names, quick, slow) -> list:
    """Parameters: `quick` ones, those that are `slow`, and the others, that run with -m long."""
    later = lambda n: pytest.mark.slow if n in slow else pytest.mark.long
    return [n if n in quick else pytest.param(n, marks=later(n)) for n in names]


# A row is the same formula in both c-spaces: ONCE run in one, and in both those that other tests
# compile for both; COMPOSED with -m long alone.
ONCE = (
    "fixed", "hook", "point_on_line", "point_on_plane", "point_on_sphere", "constant_velocity",
)  # fmt: skip
COMPOSED = (
    "planar_translation", "translation", "helical_planar", "schoenflies", "pin_in_slot_body",
)  # fmt: skip
JOINTS_IN_CSPACES = [
    pytest.param(
        cspace, name,
        marks=pytest.mark.long if name in COMPOSED or (cspace == "SO3xR3" and name in ONCE)
        else pytest.mark.slow,
    )
    for cspace in ("SE3", "SO3xR3")
    for name in lierb.joints.JOINTS
]  # fmt: skip


def box(turned: bool = False) -> lierb.Body:
    """The paper's box; `turned`, its inertia is a full matrix."""
    inertia = np.diag(ref.BOX_INERTIA)
    turn = rotation(0.3, -0.8, 0.5)
    return lierb.Body(ref.BOX_MASS, turn @ inertia @ turn.T if turned else inertia)


def joint(
    name: str, ground_frame=GROUND_FRAME, body_frame=BODY_FRAME, length=LENGTH
) -> lierb.joints.Joint:
    """A catalogue joint in tilted frames."""
    entry = lierb.joints.JOINTS[name]
    values = {"pitch": PITCH, "length": length}
    options = {name: value for name, value in values.items() if name in entry.options}
    return entry(ground_frame=ground_frame, body_frame=body_frame, **options)


def tilted(name: str, gravity=GRAVITY) -> tuple[lierb.Problem, np.ndarray]:
    """A turned box on a tilted joint, and a lively twist that the joint allows.

    A rod swings so fast that it takes a tenth of the others' speed.
    """
    speed = 0.1 if "length" in lierb.joints.JOINTS[name].options else 1.0
    problem = lierb.Problem(box(turned=True), joint(name), gravity)
    lively = np.array((2 * np.pi, np.pi, 0.2 * np.pi, 0.4, 0.3, -1.0))
    return problem, problem.project(speed * lively)


def top() -> tuple[lierb.Problem, np.ndarray]:
    """The heavy top of Brüls and Cardona."""
    held = lierb.joints.spherical(body_point=-np.array(ref.TOP_CENTRE_OF_MASS))
    problem = lierb.Problem(lierb.Body(ref.TOP_MASS, ref.TOP_INERTIA), held, ref.TOP_GRAVITY)
    return problem, held.twist(omega=ref.TOP_OMEGA_0)


def in_python(problem: lierb.Problem, twist: np.ndarray, **described):
    """System, constants, start and input numbers of a body, on floats.   described : the plan."""
    system = system_of(Plan(rows=problem.joint.rows, **described))
    given = problem.quantities | {"pose": problem.joint.closed_pose, "twist": twist}
    numbers: list[float] = []
    for field, _ in system.inputs:
        values = np.broadcast_to(np.asarray(given.get(field.name, 0.0)), field.shape).ravel()
        numbers += map(float, values if field.entries is None else values[list(field.entries)])
    body = system.body(numbers)
    return system, body, system.start(body, system.placed(body, numbers), numbers), numbers


def integrate(problem: lierb.Problem, **options) -> lierb.Result:
    """`lierb.integrate`, recording RECORD, at the ends by default.

    A record, like a method, has kernels of its own, and compiling is what the tests take time for:
    those that run over the joints ask for the same one.
    """
    ends = {"save_every": round(options["t_end"] / options["dt"]), "record": RECORD}
    return lierb.integrate(problem, **(ends | options))


def column(table, name: str) -> np.ndarray:
    """A column of an Arrow table as an array, (rows,) or (rows, width)."""
    return np.array(table[name].to_pylist())


def final(result: lierb.Result, name: str) -> np.ndarray:
    """The only body's entry of the summary."""
    (value,) = result.summary[name].to_pylist()
    return np.array(value)

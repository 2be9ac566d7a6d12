"""Four motions known to 30 digits, in lierb's terms, and how far a result is from them.

The numbers of each are here once, as plain data: `make_reference` reads them too, and knows nothing
of lierb. `reference.json` holds where each body is at a few times.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import reference_numbers as ref
from scipy.spatial.transform import Rotation

PATH = Path(__file__).with_name("reference.json")


@dataclass(frozen=True)
class Data:
    """A body that starts with R = I unless its joint says otherwise.

    mass : kg.   inertia : (3,) kg m², about the centre of mass, principal.
    centre : (3,) m, from the fixed point to the centre of mass, body axes; None: nothing is fixed.
    gravity : (3,) m/s².   omega0 : (3,) rad/s.   v0 : (3,) m/s, of a body that nothing holds.
    ground_turn, body_turn : (3,) rad, rotation vectors of a universal joint's frames, which are at
        the ground's origin and at the fixed point; None: a spherical joint.
    rates0 : (2,) rad/s, of a universal joint's two angles.
    """

    mass: float
    inertia: tuple[float, float, float]
    centre: tuple[float, float, float] | None
    gravity: tuple[float, float, float]
    omega0: tuple[float, float, float] = (0.0, 0.0, 0.0)
    v0: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ground_turn: tuple[float, float, float] | None = None
    body_turn: tuple[float, float, float] | None = None
    rates0: tuple[float, float] = (0.0, 0.0)
    times: tuple[str, ...] = ()


DATA = {
    # README.md: Müller's box on a point near its corner, under gravity
    "heavy_top": Data(
        ref.BOX_MASS, ref.BOX_INERTIA, (0.15, -0.0375, 0.0), (0.0, 0.0, -9.81),
        omega0=(6.28, 3.14, 0.63), times=("0.25", "0.5", "1", "2"),
    ),
    # ω encircles e₃, and starts so far from it that the middle axis counts
    "free_body": Data(
        2.0, (0.3, 0.5, 0.7), None, (0.0, 0.0, 0.0),
        omega0=(1.2, -0.7, 2.5), v0=(0.4, -0.2, 0.3), times=("1", "2", "5", "10"),
    ),
    # Brüls and Cardona (2010): 24 turns a second
    "fast_top": Data(
        ref.TOP_MASS, ref.TOP_INERTIA, ref.TOP_CENTRE_OF_MASS, ref.TOP_GRAVITY,
        omega0=ref.TOP_OMEGA_0, times=("0.05", "0.1", "0.2", "1"),
    ),
    # Müller's box on a universal joint, whose frames are aligned with nothing
    "universal": Data(
        ref.BOX_MASS, ref.BOX_INERTIA, (0.15, -0.0375, 0.0), (0.0, 0.0, -9.81),
        ground_turn=(0.4, -1.1, 0.7), body_turn=(-0.9, 0.5, 1.3), rates0=(6.0, 3.0),
        times=("0.25", "0.5", "1", "2"),
    ),
}  # fmt: skip


def turned(xi) -> np.ndarray:
    """(3, 3), the rotation of a rotation vector."""
    return Rotation.from_rotvec(xi).as_matrix()


class State(NamedTuple):
    """State of a body: R, r in the ground frame, ω and v in body axes."""

    rotation: np.ndarray  # (3, 3)
    position: np.ndarray  # (3,) m
    omega: np.ndarray  # (3,) rad/s
    v: np.ndarray  # (3,) m/s


@cache
def reference(name: str) -> dict[str, State]:
    """Time, as written in DATA, → state."""
    kept = json.loads(PATH.read_text(encoding="utf-8"))[name]["states"]
    return {
        t: State(*(np.array(row[field], float) for field in State._fields))
        for t, row in kept.items()
    }


def problem_of(name: str):
    """The lierb.Problem, and (6,) twist0 of its closed joint."""
    import lierb

    data = DATA[name]
    body = lierb.Body(data.mass, data.inertia)
    if data.centre is None:
        made = lierb.Problem(body, lierb.joints.free(), gravity=data.gravity)
        return made, np.array([*data.omega0, *data.v0])
    point = -np.array(data.centre)
    if data.ground_turn is None:
        held, omega = lierb.joints.spherical(body_point=point), np.array(data.omega0)
    else:
        ground, own = np.eye(4), np.eye(4)
        ground[:3, :3], own[:3, :3] = turned(data.ground_turn), turned(data.body_turn)
        own[:3, 3] = point
        held = lierb.joints.universal(ground_frame=ground, body_frame=own)
        omega = own[:3, :3] @ (0.0, data.rates0[1], data.rates0[0])
    made = lierb.Problem(body, held, gravity=data.gravity)
    return made, np.concatenate([omega, np.cross(omega, data.centre)])


def distance(found: State, true: State) -> float:
    """Return the distance of a state from the truth, in the norm of the step-size control.

    The largest of: the angle between the rotations, rad; ‖Δ‖/‖true‖ of position, ω and v.
    """
    turn = Rotation.from_matrix(found.rotation @ true.rotation.T).magnitude()
    parts = [turn]
    for a, b in zip(found[1:], true[1:], strict=True):
        parts.append(float(np.linalg.norm(a - b) / np.linalg.norm(b)))
    return max(parts)


def states_of(table, row: int, link: str = "") -> State:
    """The state in a row of a summary or a history; of a mechanism, that of a link."""
    shapes = ((3, 3), 3, 3, 3)
    pairs = zip(State._fields, shapes, strict=True)
    prefix = link and f"{link}."
    columns = ((table[f"{prefix}{field}"], shape) for field, shape in pairs)
    return State(*(np.array(c[row].as_py(), float).reshape(shape) for c, shape in columns))

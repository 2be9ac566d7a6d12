"""lierb itself, through its public face, at the settings of the tables: maxima every 10 steps.

`…-tilted` is the same top described the hard way: axes turned, full inertia, every
body with joint frames of its own. `…-revolute` turns about the body's e₂ (of ω₀ that part);
`…-universal` keeps the body's e₂ perpendicular to the ground's e₃ (of ω₀ the second and third).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

import lierb
from peers import heavy_top as top
from peers.heavy_top import Final, Form

ACCURACIES = (1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)  # relative tolerances
ADAPTIVE = {"": "DOP853", "-tsit5": "Tsit5", "-verner87": "Verner87", "-verner98": "Verner98"}
FORMS = {
    "reduced": Form("reduced", 65536, "lierb, reduced"),
    "gain": Form("reduced", 65536, "lierb, SE(3), constant gain"),
    "reduced-dop853": Form(
        "reduced", 65536, "lierb, reduced, DOP853", accuracy=1 / 48,
        accuracies=(1 / 12, 1 / 24, 1 / 48, 1 / 72, 1 / 96, 1 / 144, 1 / 192),
    ),
    "reduced-ambient": Form("reduced", 65536, "lierb, reduced, ambient"),
    "reduced-ambient-dop853": Form(
        "reduced", 65536, "lierb, reduced, DOP853, ambient", accuracy=1 / 48,
        accuracies=(1 / 24, 1 / 48, 1 / 96, 1 / 192),
    ),
    **{
        f"reduced-adaptive{end}": Form(
            "reduced", 65536, f"lierb, reduced, {method}, adaptive", adaptive=True, accuracy=1e-8,
            accuracies=ACCURACIES if end == "" else (), threads=(1, 2) if end == "" else (1,),
        )
        for end, method in ADAPTIVE.items()
    },
    "saddle": Form("general", 16384, "lierb, SE(3), saddle point"),
    "saddle-so3xr3": Form("general", 16384, "lierb, SO(3)×ℝ³, saddle point"),
    **{
        name: Form(family, bodies, f"lierb, {name}", accuracies=(), threads=(1,))
        for name, family, bodies in (
            ("reduced-tilted", "reduced", 65536), ("gain-tilted", "reduced", 65536),
            ("saddle-tilted", "general", 16384),
            ("saddle-revolute", "general", 16384), ("saddle-revolute-tilted", "general", 16384),
            ("saddle-universal", "general", 16384), ("saddle-universal-tilted", "general", 16384),
        )
    },
}  # fmt: skip
OPTIONS = {
    "reduced": {"cspace": "reduced"},
    "gain": {},
    "reduced-dop853": {"cspace": "reduced", "method": "DOP853"},
    "reduced-ambient": {"cspace": "reduced", "update": "ambient"},
    "reduced-ambient-dop853": {"cspace": "reduced", "method": "DOP853", "update": "ambient"},
    **{
        f"reduced-adaptive{end}": {"cspace": "reduced", "method": method}
        for end, method in ADAPTIVE.items()
    },
    "saddle": {"solver": "saddle"},
    "saddle-so3xr3": {"cspace": "SO3xR3"},
}
# The joint frame in the ground, its axes as columns, and the part of ω₀ that the joint allows.
JOINTS = {
    "spherical": (np.eye(3), (1, 1, 1)),
    "revolute": (np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), (0, 1, 0)),
    "universal": (np.eye(3), (0, 1, 1)),
}
TURN = lierb.lie.so3.exp((0.7, -0.4, 1.1))


def available() -> str:
    return ""


def config() -> dict[str, object]:
    from lierb.runs.provenance import machine

    return {**machine(), "measure_every": 10}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    summary, turn = _prepared(form, omega0, accuracy, threads)

    def integrate() -> Final:
        found = summary()
        centre, omega = (_vectors(found[name]) for name in ("position", "omega"))
        return Final(centre, omega @ turn.T)

    return integrate


def work(form: str, omega0: np.ndarray, accuracy: float) -> dict[str, float]:
    """Steps tried by a top, on average, and the share of lanes that try one: of those that choose
    their own.
    """
    if not FORMS[form].adaptive:
        return {"steps": top.T_END / accuracy}
    found = _prepared(form, omega0, accuracy, 1)[0]()
    steps, rejected = (found[name].to_numpy() for name in ("steps", "rejected"))
    tried = steps + rejected
    return {
        "steps": float(tried.mean()), "rejected": float(rejected.mean()), "busy": busy(tried),
    }  # fmt: skip


def busy(tried: np.ndarray) -> float:
    """The share of lanes that try a step: each takes the next top when its own has ended."""
    until = [0] * lierb.info()["lanes"]
    for steps in tried.tolist():
        heapq.heappush(until, heapq.heappop(until) + steps)
    return float(tried.sum() / (len(until) * max(until)))


def _prepared(form: str, omega0: np.ndarray, accuracy: float, threads: int):
    """Function that integrates to a summary, and the body's axes relative to the principal ones."""
    words = form.split("-")
    name = next((word for word in words if word in JOINTS), "spherical")
    turn = TURN if "tilted" in words else np.eye(3)  # the body's axes, seen from the principal ones
    axes, allowed = JOINTS[name]
    ground, pose0 = np.eye(4), np.eye(4)
    ground[:3, :3] = TURN @ axes if name == "spherical" and "tilted" in words else axes
    pose0[:3, :3], pose0[:3, 3] = turn, top.CENTRE
    held = np.linalg.inv(pose0) @ ground
    if "tilted" in words:
        ground, held = (np.tile(frame, (len(omega0), 1, 1)) for frame in (ground, held))
    joint = getattr(lierb.joints, name)(ground_frame=ground, body_frame=held)
    body = lierb.Body(top.MASS, turn.T @ np.diag(top.INERTIA) @ turn)
    problem = lierb.Problem(body, joint, top.GRAVITY)
    twist0 = joint.twist(omega=(omega0 * allowed) @ turn)
    options = OPTIONS["-".join(w for w in words if w not in JOINTS and w != "tilted")]
    clock = {"rtol": accuracy, "measure_every": 10}
    if not FORMS[form].adaptive:
        clock = {"dt": top.T_END / round(top.T_END / accuracy), "measure_every": 10}

    def integrate():
        return lierb.integrate(
            problem, twist0=twist0, t_end=top.T_END, threads=threads, progress=False, **clock,
            **options,
        ).summary  # fmt: skip

    return integrate, turn


def _vectors(column) -> np.ndarray:
    return column.combine_chunks().flatten().to_numpy().reshape(-1, 3)

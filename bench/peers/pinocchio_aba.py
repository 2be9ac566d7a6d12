"""Pinocchio: the articulated-body algorithm for the batch, a Lie-group Runge–Kutta in Python.

The fourth-order commutator-free method of Celledoni, Marthinsen and Owren (2003): stages are made
of `integrate` alone. Calls, not flops, cost time in Python, so `abaInParallel` takes a block of
tops a call, and `integrate` sees it as one model with that many joints (whose data, with
the cube of that number of entries, nobody needs). `integrate` stays on one thread.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {"aba": Form("reduced", 512, "Pinocchio, ABA")}
BLOCK = 512  # tops integrated side by side


def available() -> str:
    return "" if find_spec("pinocchio") else "pinocchio (pin) is not installed"


def config() -> dict[str, object]:
    import pinocchio

    return {
        "pinocchio": pinocchio.__version__, "openmp": pinocchio.WITH_OPENMP, "block": BLOCK,
        "method": "CF4", "precision": "float64", "wait policy": os.environ.get("OMP_WAIT_POLICY"),
    }  # fmt: skip


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    # Thousands of short parallel loops: threads that spin at their ends starve a shared machine.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    import pinocchio as pin

    steps = round(top.T_END / accuracy)
    h = top.T_END / steps
    pool = pin.ModelPool(_model(1), threads)
    blocks = np.array_split(omega0, -(-len(omega0) // BLOCK))
    models = {len(block): _model(len(block)) for block in blocks}  # of one or two sizes

    def advance(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flat vectors: quaternions (x, y, z, w) and angular velocities in body axes."""
        model = models[v.size // 3]
        torque = np.zeros((3, v.size // 3), order="F")
        move = lambda q, by: pin.integrate(model, q, by)

        def slope(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            a = np.empty_like(torque)
            columns = q.reshape(-1, 4).T, v.reshape(-1, 3).T
            pin.abaInParallel(threads, pool, *columns, torque, a)
            return a.T.ravel()

        q = pin.neutral(model)
        for _ in range(steps):
            a1, t1 = slope(q, v), h * v
            q2, v2 = move(q, t1 / 2), v + h / 2 * a1
            a2, t2 = slope(q2, v2), h * v2
            q3, v3 = move(q, t2 / 2), v + h / 2 * a2
            a3, t3 = slope(q3, v3), h * v3
            q4, v4 = move(q2, t3 - t1 / 2), v + h * a3
            a4, t4 = slope(q4, v4), h * v4
            both = 2 * (t2 + t3)
            q = move(move(q, (3 * t1 + both - t4) / 12), (3 * t4 + both - t1) / 12)
            v = v + h / 6 * (a1 + 2 * (a2 + a3) + a4)
        return q.reshape(-1, 4), v.reshape(-1, 3)

    def integrate() -> Final:
        q, v = map(np.concatenate, zip(*(advance(block.ravel()) for block in blocks)))
        twice = 2 * np.cross(q[:, :3], top.CENTRE)
        return Final(top.CENTRE + q[:, 3:] * twice + np.cross(q[:, :3], twice), v)

    return integrate


def _model(bodies: int):
    import pinocchio as pin

    model = pin.Model()
    model.gravity.linear = top.GRAVITY
    box = pin.Inertia(top.MASS, top.CENTRE, np.diag(top.INERTIA))
    for body in range(bodies):
        joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), str(body))
        model.appendBodyToJoint(joint, box, pin.SE3.Identity())
    return model

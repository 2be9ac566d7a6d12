"""lierb itself, through its public face: RK4, and DOP853 with adaptive steps that is as accurate.

Maxima are measured at the end only. Chains of more than seven links run in looped code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import lierb
from linkages import cases
from linkages.cases import Form, Tree

COUNTS = {2: 16384, 3: 8192, 5: 4096, 8: 2048, 20: 512}
RTOL = {"loose": 1e-8, "tight": 1e-11}  # tolerances of DOP853
FORMS = {
    **{
        f"chain{n}-reduced": Form(f"chain{n}", "lierb, reduced, RK4", count)
        for n, count in COUNTS.items()
    },
    **{
        f"chain{n}-SE3": Form(f"chain{n}", "lierb, SE(3)ⁿ, saddle point, RK4", count // 4)
        for n, count in COUNTS.items()
        if n <= 8
    },
    **{
        f"chain{n}-{kind}": Form(
            f"chain{n}", f"lierb, reduced, DOP853, rtol {rtol:g}", count, dt=None
        )
        for n, count in COUNTS.items()
        for kind, rtol in RTOL.items()
    },
    "fourbar-reduced": Form("fourbar", "lierb, reduced, projected, RK4", 2048),
}  # fmt: skip


def available() -> str:
    return ""


def config() -> dict[str, object]:
    from lierb.runs.provenance import machine

    return {**machine(), "measure_every": "the last step"}


def mechanism_of(tree: Tree) -> lierb.Mechanism:
    """Body frames are the tree's `bodies`: away from the joints, in general orientations."""
    links = []
    for k, parent in enumerate(tree.parents):
        back = np.linalg.inv(tree.bodies[:, k])
        R = back[:, :3, :3]
        com = np.einsum("nij,nj->ni", R, tree.com[:, k]) + back[:, :3, 3]
        m = tree.mass[:, k, None, None]
        squares = np.einsum("ni,ni->n", com, com)[:, None, None] * np.eye(3)
        central = R @ tree.inertia[:, k] @ R.transpose(0, 2, 1)
        inertia = central + m * (squares - np.einsum("ni,nj->nij", com, com))
        placed = tree.frames[:, k]
        if parent >= 0:
            placed = np.linalg.inv(tree.bodies[:, parent]) @ placed
        joint = lierb.joints.revolute(body_frame=back, parent_frame=placed)
        body = lierb.Body(tree.mass[:, k], 0.5 * (inertia + inertia.transpose(0, 2, 1)), com)
        on = "ground" if parent < 0 else f"link{parent}"
        links.append(lierb.Link(f"link{k}", body, joint, on))
    loops = []
    if tree.loop is not None:
        points = [
            np.einsum("nij,nj->ni", np.linalg.inv(tree.bodies[:, k])[:, :3, :3], point)
            + np.linalg.inv(tree.bodies[:, k])[:, :3, 3]
            for k, point in zip((1, 2), np.moveaxis(tree.loop, 1, 0))
        ]
        pin = lierb.joints.spherical(body_point=points[0], parent_point=points[1])
        loops = [lierb.Loop("pin", pin, "link1", "link2")]
    return lierb.Mechanism(links, loops, cases.GRAVITY)


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    mechanism = mechanism_of(tree)
    pose0 = mechanism.pose({f"link{k}": tree.q0[:, k] for k in range(len(tree.parents))})
    rates = {f"link{k}": tree.v0[:, k] for k in range(len(tree.parents))}
    twist0 = mechanism.twist(rates, pose0)
    options: dict[str, Any] = {"stabilise": "project"} if tree.loop is not None else {}
    kind = form.partition("-")[2]
    if kind in RTOL:
        options |= {"rtol": RTOL[kind], "atol": RTOL[kind]}
    else:
        options |= {"dt": cases.DT, "measure_every": 10**9}
    cspace = "SE3" if kind == "SE3" else "reduced"

    def integrate() -> np.ndarray:
        summary = lierb.integrate(
            mechanism, pose0=pose0, twist0=twist0, t_end=cases.T_END, cspace=cspace,
            threads=1, progress=False, **options,
        ).summary  # fmt: skip
        columns = (summary[f"link{k}.position"] for k in range(len(tree.parents)))
        return np.stack([_vectors(column) for column in columns], axis=1)

    return integrate


def _vectors(column) -> np.ndarray:
    return column.combine_chunks().flatten().to_numpy().reshape(-1, 3)

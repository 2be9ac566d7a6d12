"""MuJoCo: Runge–Kutta 4, every optional stage off, one model a trajectory, one thread.

`mujoco.batch` steps them in C and records nothing. A loop is an equality `connect`, which MuJoCo
softens by design; it is as stiff here as it stays stable.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from peers.mujoco_rollout import OFF

from linkages import cases
from linkages.cases import Form, Tree

COUNTS = {2: 192, 3: 160, 5: 128, 8: 96, 20: 32}
FORMS = {
    **{f"chain{n}": Form(f"chain{n}", "MuJoCo, RK4", count) for n, count in COUNTS.items()},
    "fourbar": Form("fourbar", "MuJoCo, RK4, connect", 96, allowed=1e-5),
}
LOOP_NEEDS = ("constraint", "equality", "warmstart")
STIFF = {"solref": "0.002 1", "solimp": "0.9999 0.9999 0.001"}  # time constant of two steps


def available() -> str:
    return "" if find_spec("mujoco") else "mujoco is not installed"


def config() -> dict[str, object]:
    import mujoco

    return {
        "mujoco": mujoco.__version__, "integrator": "RK4", "disable": OFF,
        "loops": {"enabled": LOOP_NEEDS, **STIFF}, "precision": "float64",
    }  # fmt: skip


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    import mujoco
    from mujoco.batch import Batch

    models = [mujoco.MjModel.from_xml_string(_xml(tree, i)) for i in range(len(tree))]
    batch = Batch(models[0], len(tree), nthread=1)
    batch.set_models(models)
    q, v = batch.bind("qpos"), batch.bind("qvel")
    order = [models[0].joint(f"joint{i}").qposadr[0] for i in range(len(tree.parents))]
    q[:, order], v[:, order] = tree.q0, tree.v0
    start, steps = batch.state.copy(), round(cases.T_END / cases.DT)

    def integrate() -> np.ndarray:
        batch.state[:] = start
        batch.step(nstep=steps)
        return cases.positions(tree, q[:, order])

    return integrate


def _xml(tree: Tree, i: int) -> str:
    """Body frames at the centres of mass, along the principal axes: faster than elsewhere."""
    own, text = _own_frames(tree, i), _text
    texts = [""] * len(tree.parents)
    for k in reversed(range(len(texts))):
        children = "".join(texts[j] for j, parent in enumerate(tree.parents) if parent == k)
        parent = tree.parents[k]
        placed = (np.linalg.inv(own[parent]) if parent >= 0 else np.eye(4)) @ tree.frames[i, k]
        placed, back = placed @ own[k], np.linalg.inv(own[k])
        moments = np.diag(own[k][:3, :3].T @ tree.inertia[i, k] @ own[k][:3, :3])
        texts[k] = f"""<body name="body{k}" pos="{text(placed[:3, 3])}" quat="{_quat(placed)}">
            <joint name="joint{k}" pos="{text(back[:3, 3])}" axis="{text(back[:3, 2])}"/>
            <inertial pos="0 0 0" mass="{tree.mass[i, k]!s}" diaginertia="{text(moments)}"/>
            {children}</body>"""
    roots = "".join(texts[j] for j, parent in enumerate(tree.parents) if parent < 0)
    off = [flag for flag in OFF if tree.loop is None or flag not in LOOP_NEEDS]
    flags = " ".join(f'{flag}="disable"' for flag in off)
    return f"""<mujoco>
        <option integrator="RK4" timestep="{cases.DT!r}" gravity="{text(cases.GRAVITY)}">
            <flag {flags}/>
        </option>
        <worldbody>{_sites(tree, i, own, roots)}</worldbody>
        {"" if tree.loop is None else _connect()}
    </mujoco>"""


def _own_frames(tree: Tree, i: int) -> list[np.ndarray]:
    """(4, 4) of each body's principal axes, seen from its joint."""
    found = []
    for k in range(len(tree.parents)):
        axes = np.linalg.eigh(tree.inertia[i, k])[1]
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = axes * np.linalg.det(axes), tree.com[i, k]
        found.append(frame)
    return found


def _sites(tree: Tree, i: int, own: list[np.ndarray], bodies: str) -> str:
    """Sites where a loop's points are on their bodies: where they meet at q0, not at 0."""
    if tree.loop is None:
        return bodies
    for k, point in zip((1, 2), tree.loop[i]):
        local = np.linalg.inv(own[k]) @ (*point, 1.0)
        site = f'<site name="end{k}" pos="{_text(local[:3])}"/>'
        head, mark, rest = bodies.partition(f'<joint name="joint{k}"')
        bodies = f"{head}{mark}{rest}".replace(
            f'<joint name="joint{k}"', f'{site}<joint name="joint{k}"'
        )
    return bodies


def _connect() -> str:
    options = " ".join(f'{name}="{value}"' for name, value in STIFF.items())
    return f'<equality><connect site1="end1" site2="end2" {options}/></equality>'


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, np.asarray(values).tolist()))


def _quat(frame: np.ndarray) -> str:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(frame[:3, :3]).as_quat()
    return _text(np.array((w, x, y, z)))

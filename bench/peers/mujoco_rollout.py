"""MuJoCo: ball joints, Runge–Kutta 4, all optional stages off, many simulations of one model.

`mujoco.batch` rolls out to the final state and records nothing; `mujoco.rollout` writes every step
and is 1 to 3 % slower. Fourth order since MuJoCo 4.0; before, only second for ball joints.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "one": Form("reduced", 192, "MuJoCo, one body a model"),
    "many": Form("reduced", 768, "MuJoCo, 64 bodies a model"),
}
BODIES = {"one": 1, "many": 64}  # in a model
OFF = (
    "constraint", "equality", "frictionloss", "limit", "contact", "spring", "damper", "clampctrl",
    "warmstart", "filterparent", "actuation", "refsafe", "sensor", "midphase", "eulerdamp",
    "autoreset", "nativeccd", "island", "multiccd",
)  # fmt: skip


def available() -> str:
    return "" if find_spec("mujoco") else "mujoco is not installed"


def config() -> dict[str, object]:
    import mujoco

    return {
        "mujoco": mujoco.__version__, "integrator": "RK4", "disable": OFF, "jacobian": "auto",
        "precision": np.dtype(mujoco.MJTNUM_DTYPE).name,
    }  # fmt: skip


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    from mujoco.batch import Batch

    count, bodies = len(omega0), BODIES[form]
    simulations = -(-count // bodies)
    steps = round(top.T_END / accuracy)
    batch = Batch(_model(bodies, top.T_END / steps), simulations, nthread=threads)
    omega = batch.bind("qvel")  # of a ball joint: in body axes; a view of the state
    omega[:] = np.resize(omega0, omega.shape)  # the last model may repeat some tops
    start = batch.state.copy()
    quaternion = batch.bind("qpos")

    def integrate() -> Final:
        batch.state[:] = start
        batch.step(nstep=steps)
        q = quaternion.reshape(-1, 4)[:count]
        return Final(_rotate(q[:, :1], q[:, 1:], top.CENTRE), omega.reshape(-1, 3)[:count].copy())

    return integrate


def _model(bodies: int, dt: float):
    """Body frames at the centres of mass, along the principal axes: 10 % faster than elsewhere."""
    import mujoco

    text = lambda values: " ".join(map(repr, np.asarray(values).tolist()))
    body = f"""<body pos="{text(top.CENTRE)}">
        <joint type="ball" pos="{text(-top.CENTRE)}"/>
        <inertial pos="0 0 0" mass="{top.MASS}" diaginertia="{text(top.INERTIA)}"/>
    </body>"""
    flags = " ".join(f'{flag}="disable"' for flag in OFF)
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco>
            <option integrator="RK4" timestep="{dt!r}" gravity="{text(top.GRAVITY)}">
                <flag {flags}/>
            </option>
            <worldbody>{body * bodies}</worldbody>
        </mujoco>"""
    )


def _rotate(scalar: np.ndarray, vector: np.ndarray, by: np.ndarray) -> np.ndarray:
    twice = 2 * np.cross(vector, by)
    return by + scalar * twice + np.cross(vector, twice)

"""Drake: a continuous MultibodyPlant of ball joints, fifth-order Runge–Kutta at a fixed step.

Drake has no fixed-step RK4, and at equal error this is faster than its third-order Runge–Kutta and
than error control. Nor has it a ball joint with quaternions: the frames put the singularity of
roll–pitch–yaw, body x along ground y, where the tops stay 29° away from.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "rk5": Form(
        "reduced", 384, "Drake, RK5, 64 bodies a plant", accuracy=5e-3,
        accuracies=(2e-2, 1e-2, 5e-3, 2e-3, 1e-3),
    ),
}  # fmt: skip
BODIES = 64  # in a plant
GROUND = np.array(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)))  # axes of the joint's frame


def available() -> str:
    return "" if find_spec("pydrake") else "drake is not installed"


def config() -> dict[str, object]:
    from importlib.metadata import version

    return {"drake": version("drake"), "integrator": "runge_kutta5", "precision": "float64"}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    blocks = np.array_split(omega0, -(-len(omega0) // BODIES))
    advances = [_simulation(len(blocks[0]), accuracy) for _ in range(threads)]
    shares = [blocks[i::threads] for i in range(threads)]
    pool = ThreadPoolExecutor(threads)  # Drake drops the GIL

    def integrate() -> Final:
        done = pool.map(lambda advance, share: [advance(w) for w in share], advances, shares)
        states = [None] * len(blocks)
        for i, share in enumerate(done):
            states[i::threads] = share
        angles, spins = map(np.concatenate, zip(*states))
        R = GROUND @ _rotations(angles)
        omega = np.einsum("nji,nj->ni", R, spins @ GROUND.T)
        return Final(R @ top.CENTRE, omega)

    return integrate


def _simulation(bodies: int, dt: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Integrate from initial velocities to the final angles and velocities in the joint's frame."""
    from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import BallRpyJoint, FixedOffsetFrame, SpatialInertia, UnitInertia
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    plant = MultibodyPlant(time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector(top.GRAVITY)
    world = plant.world_frame()
    pose = RigidTransform(RotationMatrix(GROUND))
    ground = plant.AddFrame(FixedOffsetFrame("ground", world, pose))
    unit = top.pivot_inertia() / top.MASS
    box = SpatialInertia(
        top.MASS, top.CENTRE, UnitInertia(*np.diag(unit), *unit[np.triu_indices(3, 1)])
    )
    for i in range(bodies):
        body = plant.AddRigidBody(f"body{i}", box)
        plant.AddJoint(BallRpyJoint(f"joint{i}", ground, body.body_frame()))
    plant.Finalize()

    simulator = Simulator(plant)
    ResetIntegratorFromFlags(simulator, "runge_kutta5", top.T_END / round(top.T_END / dt))
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    context = simulator.get_mutable_context()
    angles0 = np.tile(RollPitchYaw(RotationMatrix(GROUND.T)).vector(), bodies)

    def advance(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = len(omega)  # smaller in the last blocks: the rest of the plant repeats tops
        context.SetTime(0.0)
        plant.SetPositions(context, angles0)
        plant.SetVelocities(context, np.resize(omega @ GROUND, 3 * bodies))
        simulator.Initialize()
        simulator.AdvanceTo(top.T_END)
        state = plant.GetPositions(context), plant.GetVelocities(context)
        return tuple(part.reshape(-1, 3)[:count] for part in state)

    return advance


def _rotations(angles: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of roll, pitch and yaw about fixed axes."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles).T, np.cos(angles).T
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.moveaxis(np.array(rows), 2, 0)

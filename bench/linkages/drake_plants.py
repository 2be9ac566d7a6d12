"""Drake: a continuous MultibodyPlant of revolute joints, fifth-order Runge–Kutta at a fixed step.

Drake has no fixed-step RK4; at these steps its RK5 is about as accurate. One plant a trajectory.
Loops it has in discrete time only, so that there is no four-bar.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from linkages import cases
from linkages.cases import Form, Tree

STEPS = {2: 4e-3, 3: 4e-3, 5: 4e-3, 8: 2e-3}  # s
COUNTS = {2: 96, 3: 80, 5: 64, 8: 48}
FORMS = {
    f"chain{n}": Form(f"chain{n}", f"Drake, RK5 at {1e3 * STEPS[n]:.0f} ms", count, dt=STEPS[n])
    for n, count in COUNTS.items()
}


def available() -> str:
    return "" if find_spec("pydrake") else "drake is not installed"


def config() -> dict[str, object]:
    from importlib.metadata import version

    return {"drake": version("drake"), "integrator": "runge_kutta5", "precision": "float64"}


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    advances = [_simulation(tree, i, FORMS[form].dt) for i in range(len(tree))]
    return lambda: cases.positions(tree, np.array([advance() for advance in advances]))


def _simulation(tree: Tree, i: int, dt: float) -> Callable[[], np.ndarray]:
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import (
        FixedOffsetFrame,
        RevoluteJoint,
        RotationalInertia,
        SpatialInertia,
    )
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    plant = MultibodyPlant(time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector(cases.GRAVITY)
    bodies, joints = [], []
    for k, parent in enumerate(tree.parents):
        inertia, mass = tree.inertia[i, k], tree.mass[i, k]
        central = RotationalInertia(
            *np.diag(inertia), *(inertia[a, b] for a, b in ((0, 1), (0, 2), (1, 2)))
        )
        spatial = SpatialInertia.MakeFromCentralInertia(mass, tree.com[i, k], central)
        bodies.append(plant.AddRigidBody(f"body{k}", spatial))
        on = plant.world_frame() if parent < 0 else bodies[parent].body_frame()
        pose = RigidTransform(tree.frames[i, k])
        frame = plant.AddFrame(FixedOffsetFrame(f"frame{k}", on, pose))
        joint = RevoluteJoint(f"joint{k}", frame, bodies[k].body_frame(), (0, 0, 1))
        joints.append(plant.AddJoint(joint))
    plant.Finalize()
    simulator = Simulator(plant)
    ResetIntegratorFromFlags(simulator, "runge_kutta5", dt)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    context = simulator.get_mutable_context()

    def advance() -> np.ndarray:
        context.SetTime(0.0)
        for joint, q, v in zip(joints, tree.q0[i], tree.v0[i], strict=True):
            joint.set_angle(context, q)
            joint.set_angular_rate(context, v)
        simulator.Initialize()
        simulator.AdvanceTo(cases.T_END)
        return np.array([joint.get_angle(context) for joint in joints])

    return advance

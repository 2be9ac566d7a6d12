"""Exudyn, the build without range checks: a kinematic tree in joint angles, explicit RK44.

No four-bar: explicit methods do not take its loop, and the pin's rows hold the links in their plane
once more than needed, which makes the implicit ones singular.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from peers import exudyn_tops

from linkages import cases
from linkages.cases import Form, Tree

COUNTS = {2: 96, 3: 80, 5: 64, 8: 48}
FORMS = {
    f"chain{n}": Form(f"chain{n}", "Exudyn, kinematic tree, RK44", count)
    for n, count in COUNTS.items()
}
available = exudyn_tops.available


def config() -> dict[str, object]:
    return {
        "exudyn": exudyn_tops.exudyn().config.Version(), "exudynFast": True,
        "linear solver": "EXUdense", "precision": "float64",
    }  # fmt: skip


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    exu = exudyn_tops.exudyn()
    systems = [_system(tree, i) for i in range(len(tree))]
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.active = False
    settings.show.globalTimers = False
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense
    time = settings.timeIntegration
    time.endTime, time.numberOfSteps = cases.T_END, round(cases.T_END / cases.DT)
    time.verboseMode = time.stepInformation = 0
    time.explicit.computeEndOfStepAccelerations = False
    solver = exu.DynamicSolverType.RK44

    def integrate() -> np.ndarray:
        found = []
        for _, system in systems:
            exu.SolveDynamic(system, settings, solverType=solver, showHints=False)
            found.append(system.systemData.GetODE2Coordinates())
        return cases.positions(tree, np.array(found))

    return integrate


def _system(tree: Tree, i: int):
    import exudyn.itemInterface as items

    exu = exudyn_tops.exudyn()
    container = exu.SystemContainer()  # owns the system
    system = container.AddSystem()
    links = len(tree.parents)
    node = system.AddNode(
        items.NodeGenericODE2(
            numberOfODE2Coordinates=links,
            referenceCoordinates=[0.0] * links,
            initialCoordinates=tree.q0[i].tolist(),
            initialCoordinates_t=tree.v0[i].tolist(),
        )
    )
    matrices, vectors = exu.Matrix3DList, exu.Vector3DList
    system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=cases.GRAVITY.tolist(),
            jointTypes=[exu.JointType.RevoluteZ] * links,
            linkParents=list(tree.parents),
            jointTransformations=matrices(list(tree.frames[i, :, :3, :3])),
            jointOffsets=vectors(list(tree.frames[i, :, :3, 3])),
            linkInertiasCOM=matrices(list(tree.inertia[i])),
            linkCOMs=vectors(list(tree.com[i])),
            linkMasses=tree.mass[i].tolist(),
        )
    )
    system.Assemble()
    return container, system

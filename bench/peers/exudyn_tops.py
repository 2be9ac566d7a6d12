"""Exudyn, the build without range checks: explicit Lie-group RK44, or generalised-α with the joint.

RK44 cannot take the joint: it integrates a body with its reference point, its centre of mass and
its inertia at the pivot, turned by the weight and an equal force upwards at the pivot.
Generalised-α is of second order; at a spectral radius of 0.9 it is unstable for steps of 5 ms.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib.util import find_spec
from io import StringIO

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

# One system at a time, as Exudyn holds the GIL; its own threads gain nothing at this size.
FORMS = {
    "rk44": Form("reduced", 320, "Exudyn, RK44", threads=(1,)),
    "generalised-alpha": Form("general", 96, "Exudyn, generalised-α", threads=(1,)),
}
BODIES = {"rk44": 16, "generalised-alpha": 1}  # in a system
RADIUS = 0.8


def available() -> str:
    return "" if find_spec("exudyn") else "exudyn is not installed"


def config() -> dict[str, object]:
    return {
        "exudyn": exudyn().config.Version(), "exudynFast": True, "bodies in a system": BODIES,
        "linear solver": {"rk44": "EigenSparse", "generalised-alpha": "EXUdense"},
        "spectral radius": RADIUS, "Newton": "modified, a Jacobian per step",
        "precision": "float64",
    }  # fmt: skip


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    exu = exudyn()
    build = {"rk44": _free, "generalised-alpha": _jointed}[form]
    systems = []
    for block in np.array_split(omega0, -(-len(omega0) // BODIES[form])):
        container = exu.SystemContainer()  # owns the system
        system = container.AddSystem()
        for omega in block:
            build(system, omega)
        system.Assemble()
        systems.append((container, system))
    settings, solver = _settings(form, round(top.T_END / accuracy), threads)

    def integrate() -> Final:
        x, v = [], []
        for _, system in systems:
            exu.SolveDynamic(system, settings, solverType=solver, showHints=False)
            x.append(system.systemData.GetODE2Coordinates().reshape(-1, 6))
            v.append(system.systemData.GetODE2Coordinates_t().reshape(-1, 6))
        return Final(_rotate(np.concatenate(x)[:, 3:], top.CENTRE), np.concatenate(v)[:, 3:])

    return integrate


def exudyn():
    sys.exudynFast = True
    with redirect_stdout(StringIO()):  # it says which build it is
        import exudyn

    return exudyn


def _settings(form: str, steps: int, threads: int):
    exu = exudyn()
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.active = False
    settings.show.globalTimers = False
    settings.parallel.numberOfThreads = threads
    time = settings.timeIntegration
    time.endTime, time.numberOfSteps = top.T_END, steps
    time.verboseMode = time.stepInformation = 0
    if form == "rk44":
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
        time.explicit.computeMassMatrixInversePerBody = True
        time.explicit.computeEndOfStepAccelerations = False
        time.explicit.eliminateConstraints = False
        return settings, exu.DynamicSolverType.RK44
    time.generalizedAlpha.spectralRadius = RADIUS
    time.newton.useModifiedNewton = time.newton.modifiedNewtonJacUpdatePerStep = True
    return settings, exu.DynamicSolverType.GeneralizedAlpha


def _body(system, position: np.ndarray, inertia: np.ndarray, omega: np.ndarray, speed: np.ndarray):
    import exudyn.itemInterface as items

    node = items.NodeRigidBodyRotVecLG(
        referenceCoordinates=[*position, 0.0, 0.0, 0.0], initialVelocities=[*speed, *omega]
    )
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    return system.AddObject(
        items.ObjectRigidBody(
            nodeNumber=system.AddNode(node), mass=top.MASS, inertia=[xx, yy, zz, yz, xz, xy]
        )
    )


def _free(system, omega: np.ndarray) -> None:
    import exudyn.itemInterface as items

    body = _body(system, np.zeros(3), top.pivot_inertia(), omega, np.zeros(3))
    weight = top.MASS * top.GRAVITY
    for point, force in ((top.CENTRE, weight), (np.zeros(3), -weight)):
        marker = items.MarkerBodyPosition(bodyNumber=body, localPosition=point)
        system.AddLoad(
            items.LoadForceVector(markerNumber=system.AddMarker(marker), loadVector=force)
        )


def _jointed(system, omega: np.ndarray) -> None:
    import exudyn.itemInterface as items

    body = _body(system, top.CENTRE, np.diag(top.INERTIA), omega, np.cross(omega, top.CENTRE))
    mass = system.AddMarker(items.MarkerBodyMass(bodyNumber=body))
    system.AddLoad(items.LoadMassProportional(markerNumber=mass, loadVector=top.GRAVITY))
    ground = system.AddObject(items.ObjectGround())
    ends = [
        system.AddMarker(items.MarkerBodyRigid(bodyNumber=number, localPosition=point))
        for number, point in ((ground, np.zeros(3)), (body, -top.CENTRE))
    ]
    system.AddObject(items.ObjectJointSpherical(markerNumbers=ends))


def _rotate(vector: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Rotate by the rotation vectors (n, 3)."""
    angle = np.linalg.norm(vector, axis=1)[:, None]
    once = np.cross(vector, by)
    sine, half = np.sinc(angle / np.pi), np.sinc(angle / 2 / np.pi)
    return by + sine * once + half**2 / 2 * np.cross(vector, once)

"""Robots of public packages, as many as are installed, move as in Pinocchio and MuJoCo.

None of their files is part of lierb. To run all:

    pip install pin example-robot-data dm_control gymnasium gymnasium-robotics robosuite
    make test-long ARGS="tests/test_public_robots.py"

Springs, dampers, mimics and loops are left out on both sides: they have tests of their own
(test_model_files.py, test_urdf.py, test_gears.py), and some are too stiff for explicit steps.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from sysconfig import get_path

import numpy as np
import pytest

import lierb
from lierb.errors import ArgumentError, LeftOutWarning

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.long

DT, STEPS = 1e-4, 20
SITE = Path(get_path("purelib"))
PACKAGES = ("dm_control", "gymnasium", "gymnasium_robotics", "robosuite")
URDF = sorted(SITE.glob("cmeel.prefix/share/example-robot-data/robots/**/*.urdf"))
MJCF = [path for name in PACKAGES for path in sorted(SITE.glob(f"{name}/**/*.xml"))]
# their mass matrix is singular, or no rigid body has an inertia; the last has no joint that moves
REFUSED = ("icub", "romeo", "romeo_laas_small", "romeo_small", "ur3")
ONE_BODY = ("iris_simple", "quadrotor_base")  # which moves only if its base does
RENAMED = {"ground_2": "ground"}  # by lierb, whose ground has that name


def named(path: Path) -> str:
    return "/".join(path.relative_to(SITE).parts[-4:])


def without_forces(read, path, **options) -> lierb.Mechanism:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LeftOutWarning)
        mechanism = read(path, **options)
    return lierb.Mechanism(mechanism.links, gravity=mechanism.gravity)


def by_link(mechanism, frames):
    known = {re.sub(r"\W", "_", name): frame for name, frame in frames.items()}
    names = {name: RENAMED.get(name, name) for name in mechanism.names}
    return {link: known[name] for link, name in names.items() if name in known}


def assert_moves(mechanism, start, end):
    """Move the links from `start` and compare with `end`: poses and body-fixed twists by name.

    Links without mass are lierb's own and have no frame in the file; they begin at rest.
    """
    start, end = (by_link(mechanism, frames) for frames in (start, end))
    own = [name for name in mechanism.names if name not in start]
    given = {} if own else {
        "pose0": {name: start[name][0] for name in mechanism.names},
        "twist0": {name: start[name][1] for name in mechanism.names},
    }  # fmt: skip
    result = lierb.integrate(mechanism, dt=DT, t_end=STEPS * DT, solver="looped", **given)
    assert result.summary["status"].to_pylist() == ["ok"]
    change = max(np.abs(end[x][1] - start[x][1]).max() for x in mechanism.names if x not in own)
    for name in mechanism.names:
        if name in own:
            continue
        pose, twist = end[name]
        np.testing.assert_allclose(result[name].rotation[0], pose[:3, :3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(result[name].position[0], pose[:3, 3], rtol=0, atol=1e-12)
        found = np.concatenate([result[name].omega[0], result[name].v[0]])
        # rounding, of inertias of 1e-12 kg m² too; methods of both are of fourth order
        np.testing.assert_allclose(found, twist, rtol=0, atol=1e-9 * max(change, 0.01))


@pytest.mark.parametrize("base", ["fixed", "free"])
@pytest.mark.parametrize("path", URDF, ids=named)
def test_urdf_moves_as_in_pinocchio(path, base):
    """Pinocchio steps by RK4, in coordinates ξ with q = q₀ ⊕ ξ."""
    pin = pytest.importorskip("pinocchio")
    if path.stem in REFUSED or (base == "fixed" and path.stem in ONE_BODY):
        with pytest.raises(ArgumentError):
            without_forces(lierb.Mechanism.from_urdf, path, base=base)
        return
    mechanism = without_forces(lierb.Mechanism.from_urdf, path, base=base)
    model = pin.buildModelFromUrdf(str(path), *([pin.JointModelFreeFlyer()] * (base == "free")))
    data, random = model.createData(), np.random.default_rng(5)
    q0 = pin.integrate(model, pin.neutral(model), random.uniform(-0.4, 0.4, model.nv))
    x, v, still = np.zeros(model.nv), random.uniform(-1.0, 1.0, model.nv), np.zeros(model.nv)

    def rates(x, v):
        q = pin.integrate(model, q0, x)
        turned = np.linalg.solve(pin.dIntegrate(model, q0, x, pin.ARG1), v)
        return np.array((turned, pin.aba(model, data, q, v, still)))

    def frames():
        pin.forwardKinematics(model, data, pin.integrate(model, q0, x), v)
        pin.updateFramePlacements(model, data)
        found = {}
        for i, frame in enumerate(model.frames):
            if frame.type == pin.FrameType.BODY:
                moving = pin.getFrameVelocity(model, data, i, pin.ReferenceFrame.LOCAL)
                twist = np.concatenate([moving.angular, moving.linear])
                found[frame.name] = data.oMf[i].homogeneous.copy(), twist
        return found

    start = frames()
    for _ in range(STEPS):
        a = rates(x, v)
        b = rates(x + DT / 2 * a[0], v + DT / 2 * a[1])
        c = rates(x + DT / 2 * b[0], v + DT / 2 * b[1])
        d = rates(x + DT * c[0], v + DT * c[1])
        moved = DT / 6 * (a + 2 * b + 2 * c + d)
        x, v = x + moved[0], v + moved[1]
    assert_moves(mechanism, start, frames())


@pytest.mark.parametrize("path", MJCF, ids=named)
def test_mjcf_moves_as_in_mujoco(path):
    """MuJoCo steps by its RK4, without what lierb lists as left out."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        pytest.skip("part of another file")
    if not model.njnt:
        pytest.skip("nothing moves")
    mechanism = without_forces(lierb.Mechanism.from_mjcf, path)
    bits = mujoco.mjtDisableBit
    for bit in ("CONTACT", "FRICTIONLOSS", "LIMIT", "ACTUATION", "EQUALITY"):
        model.opt.disableflags |= int(getattr(bits, f"mjDSBL_{bit}"))
    for numbers in (
        model.dof_armature, model.dof_damping, model.jnt_stiffness, model.body_gravcomp,
        model.tendon_stiffness, model.tendon_damping, model.tendon_armature, model.opt.wind,
        model.dof_dampingpoly, model.jnt_stiffnesspoly,
    ):  # fmt: skip
        numbers[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, DT
    data, random = mujoco.MjData(model), np.random.default_rng(3)
    bodies = {model.body(i).name or f"body{i}": i for i in range(1, model.nbody)}
    if len(by_link(mechanism, bodies)) == len(mechanism.names):
        mujoco.mj_integratePos(model, data.qpos, random.uniform(-0.3, 0.3, model.nv), 1.0)
        data.qvel[:] = random.uniform(-1.0, 1.0, model.nv)

    def frames():
        mujoco.mj_forward(model, data)
        found = {}
        for name, i in bodies.items():
            pose, twist = np.eye(4), np.zeros(6)
            pose[:3, :3], pose[:3, 3] = data.xmat[i].reshape(3, 3), data.xpos[i]
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, i, twist, 1)
            found[name] = pose, twist
        return found

    start = frames()
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    assert_moves(mechanism, start, frames())

"""Trees on reduced coordinates keep every joint over a million steps, whatever the method does.

Measured from the poses in the result by 4×4 products, with no formula of the package's: on a joint
of frames G and B is D = G⁻¹ C_parent⁻¹ C B, and each joint says what entries of D are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cases import GRAVITY, long_but, rotation
from scipy.spatial.transform import Rotation

import lierb

STEPS = 10**6
SAVED = 200
BOUND = 1e-14  # rad, and of 1 m + the size, m, that links and their places have
PITCH = 0.05  # m/rad
# Against drag, without which Euler's method gains energy until its numbers overflow.
DRIVE = lierb.forces.motor(torque=15.0)

# of each joint what is to be zero: of its rotation, and of its place, m
Errors = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _about_e3(q: np.ndarray) -> np.ndarray:
    return np.concatenate([q[:, :2, 2], q[:, 2, :2]], axis=1)


def _screw(q: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d₃ is the pitch times an angle that is known up to whole turns."""
    angle, turn = np.arctan2(q[:, 1, 0], q[:, 0, 0]), 2.0 * np.pi * PITCH
    ahead = d[:, 2] - PITCH * angle
    return _about_e3(q), np.column_stack([d[:, :2], ahead - turn * np.rint(ahead / turn)])


ERRORS: dict[str, Errors] = {
    "revolute": lambda q, d: (_about_e3(q), d),
    "spherical": lambda q, d: (np.zeros((len(q), 1)), d),
    "universal": lambda q, d: (q[:, 2:, 1], d),  # Rz(α) Ry(β) turns e₂ in the plane of e₁ and e₂
    "screw": _screw,
    "prismatic": lambda q, d: ((q - np.eye(3)).reshape(-1, 9), d[:, :2]),
}
CHAINS = {
    "revolute-spherical-universal": {
        "revolute": 0.5, "spherical": (0.4, 0.2, 0.3), "universal": (0.2, 0.4)
    },
    "screw-prismatic": {"screw": 0.2, "prismatic": 0.1},
}  # fmt: skip


def _chain(names: tuple[str, ...]) -> lierb.Mechanism:
    """Chain of links with full inertias, in general frames, that are kept moving."""
    rng = np.random.default_rng(31)
    links, parent = [], "ground"
    for name in names:
        frames = {}
        for which in ("body_frame", "ground_frame"):
            frames[which] = np.eye(4)
            frames[which][:3, :3] = Rotation.random(random_state=rng).as_matrix()
            frames[which][:3, 3] = rng.uniform(-0.3, 0.3, 3)
        turn, com = rotation(*rng.uniform(-1, 1, 3)), rng.uniform(-0.1, 0.1, 3)
        inertia = turn @ np.diag((0.02, 0.03, 0.04)) @ turn.T
        body = lierb.Body(1.0, inertia + com @ com * np.eye(3) - np.outer(com, com), com)
        pitch = {"pitch": PITCH} if name == "screw" else {}
        joint = lierb.joints.JOINTS[name](**frames, **pitch)
        links.append(lierb.Link(name, body, joint, parent))
        parent = name
    drag = [lierb.forces.drag(linear=0.1, angular=1.0).on(name) for name in names]
    return lierb.Mechanism(links, gravity=GRAVITY, forces=[*drag, DRIVE.on(names[0])])


def _worst(result: lierb.Result, chain: lierb.Mechanism) -> tuple[float, float]:
    """Largest errors of rotation, and of place relative to 1 m + the size."""
    poses = {"ground": np.broadcast_to(np.eye(4), (SAVED + 1, 4, 4)).copy()}
    turned, apart = 0.0, 0.0
    for link in chain.links:
        view, pose = result[link.name], poses["ground"].copy()
        pose[:, :3, :3], pose[:, :3, 3] = view.rotation[:, 0], view.position[:, 0]
        poses[link.name] = pose
        ground, body = link.joint.ground_frame, link.joint.body_frame
        relative = np.linalg.inv(poses[link.parent] @ ground) @ pose @ body
        rotation_errors, place_errors = ERRORS[link.name](relative[:, :3, :3], relative[:, :3, 3])
        size = 1.0 + max(np.abs(poses[n][:, :3, 3]).max() for n in (link.name, link.parent))
        turned = max(turned, float(np.abs(rotation_errors).max()))
        apart = max(apart, float(np.abs(place_errors).max() / size))
    return turned, apart


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
@pytest.mark.parametrize("method", ["RK4", pytest.param("Euler", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", long_but(CHAINS, "screw-prismatic"))
def test_trees_on_reduced_coordinates_keep_every_joint(name, method, dt):
    chain = _chain(tuple(CHAINS[name]))
    pose0 = chain.pose()
    result = lierb.integrate(
        chain, pose0=pose0, twist0=chain.twist(CHAINS[name], pose0), dt=dt, t_end=dt * STEPS,
        method=method, save_every=STEPS // SAVED, record=("state",),
    )  # fmt: skip
    assert result.summary["status"].to_pylist() == ["ok"]
    turned, apart = _worst(result, chain)
    moving = np.ptp(result[chain.names[-1]].position[-20:, 0], axis=0)
    assert moving.max() > 0.1  # to the end, or little was asked
    assert turned <= BOUND
    assert apart <= BOUND

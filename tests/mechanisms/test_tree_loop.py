"""Code that loops over the nodes of a tree, beside the formulas of unrolled code in NumPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lierb
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.runge_kutta import method_of
from lierb.kernels.systems.system_of import system_of
from lierb.runs.options import Options
from lierb.runs.starts import ready

GRAVITY = (0.4, -0.3, -9.81)
GROUPS = tuple(n for n, joint in lierb.joints.JOINTS.items() if joint.subgroup or joint.factors)
CLOSE = 1e-13  # rounding of ten steps, of numbers up to about 10


def frame(rng) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return matrix


def body(rng) -> lierb.Body:
    turn, com, mass = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3), 1.3
    inertia = turn @ np.diag((0.02, 0.03, 0.04)) @ turn.T
    return lierb.Body(mass, inertia + mass * (com @ com * np.eye(3) - np.outer(com, com)), com)


def tree_of(names, seed=0, reach=3) -> lierb.Mechanism:
    """Links on the ground or on one of the last `reach` links, with frames turned in all ways."""
    rng, links = np.random.default_rng(seed), []
    for i, name in enumerate(names):
        entry = lierb.joints.JOINTS[name]
        values = {"pitch": 0.2} if "pitch" in entry.options else {}
        joint = entry(body_frame=frame(rng), parent_frame=frame(rng), **values)
        above = rng.integers(max(0, i - reach), i) if i and rng.random() < 0.9 else None
        parent = "ground" if above is None else f"link{above}"
        links.append(lierb.Link(f"link{i}", body(rng), joint, parent))
    return lierb.Mechanism(links, gravity=GRAVITY)


def start_of(mechanism, count, seed=1):
    """Poses and twists in random coordinates and rates, one for each of `count` trajectories."""
    rng = np.random.default_rng(seed)

    def drawn(size):
        return {
            link.name: rng.uniform(-size, size, (count, len(link.joint.coordinate_names)))
            for link in mechanism.links
        }

    pose0 = mechanism.pose({n: x for n, x in drawn(1.0).items() if x.shape[1] != 0})
    rates = {n: x for n, x in drawn(2.0).items() if x.shape[1] != 0}
    return {"pose0": pose0, "twist0": mechanism.twist(rates, pose0)}


def in_numpy(mechanism, start, trajectory, dt, steps, method="RK4") -> list[Vec]:
    """R, r, ω, v of every link after some steps, by the formulas of unrolled code on floats."""
    options = Options.of(mechanism, dt=dt, t_end=dt * steps, method=method, solver="unrolled")
    run = ready(mechanism, options, **start)
    system, numbers = system_of(run.plan), run.inputs.numbers(trajectory)
    body = system.body(numbers)
    state = system.start(body, (), numbers)
    for k in range(steps):
        at = Interval(k * dt, dt, dt)
        state = method_of(run.plan).step(system, body, state, at).state
    return system.in_user_frames(body, numbers, state)


def numbers_of(result, name, trajectory) -> np.ndarray:
    view = result[name]
    parts = (view.rotation, view.position, view.omega, view.v)
    return np.concatenate([np.ravel(part[trajectory]) for part in parts])


def looped(mechanism, start, **options):
    return lierb.integrate(mechanism, **start, solver="looped", progress=False, **options)


@pytest.mark.parametrize("method", ["RK4", "DOP853"])
def test_every_joint_agrees_with_unrolled_formulas(method):
    mechanism = tree_of(GROUPS * 2)
    start = start_of(mechanism, 4)
    result = looped(mechanism, start, dt=0.01, t_end=0.1, method=method)
    for trajectory in (0, 3):
        expected = in_numpy(mechanism, start, trajectory, 0.01, 10, method)
        for name, numbers in zip(mechanism.names, expected, strict=True):
            found = numbers_of(result, name, trajectory)
            np.testing.assert_allclose(found, np.array(numbers, float), rtol=0, atol=30 * CLOSE)


def test_forces_agree_with_unrolled_formulas():
    tree = tree_of(("revolute", "universal", "free", "revolute", "cylindrical", "spherical"))
    drawn = lierb.forces.spring_damper(
        stiffness=7.0, damping=0.4, length=0.3, body_point=(0.1, 0.2, 0.0), ground_point=(0.5, 0, 0)
    )
    forces = [
        drawn.on("link2"),
        drawn.on("link4", "link1"),
        lierb.forces.torsional_spring(stiffness=3.0, damping=0.2).on("link3"),
        lierb.forces.drag(linear=0.2, angular=0.1).on("link5"),
        lierb.forces.joint_friction(coulomb=0.3, speed=0.5).on("link0"),
    ]
    mechanism = lierb.Mechanism(tree.links, gravity=GRAVITY, forces=forces)
    start = start_of(mechanism, 4)
    result = looped(mechanism, start, dt=0.01, t_end=0.1)
    for trajectory in (0, 3):
        expected = in_numpy(mechanism, start, trajectory, 0.01, 10)
        for name, numbers in zip(mechanism.names, expected, strict=True):
            found = numbers_of(result, name, trajectory)
            np.testing.assert_allclose(found, np.array(numbers, float), rtol=0, atol=30 * CLOSE)

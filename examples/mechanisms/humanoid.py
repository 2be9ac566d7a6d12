"""A diver tucks: springs in the joints pull knees and hips up, and the somersault gets faster.

The model is humanoid.xml beside this file, 16 links with 21 freedoms. Nothing but gravity acts from
outside: the angular momentum about the centre of mass stays as it is, while the moment of inertia
falls to less than a half.

    python humanoid.py [FIGURE.png]
"""

import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lierb

SPIN = 5.0  # rad/s, at the take-off, about the axis to the left
STRENGTH = np.linspace(0.0, 1.0, 9)  # of the springs, one for each diver
TUCK = {  # angle at which a joint's spring rests, rad, and its stiffness, N m/rad
    "thigh": (-1.9, 250.0), "shank": (2.2, 150.0), "foot": (0.3, 20.0), "chest": (0.6, 250.0),
    "abdomen": (0.0, 200.0), "head": (0.4, 20.0), "upper_arm": (-0.9, 60.0),
    "forearm": (-0.9, 20.0), "hand": (0.0, 5.0),
}  # fmt: skip

with warnings.catch_warnings():
    warnings.simplefilter("ignore", lierb.errors.LeftOutWarning)  # what collides: nothing does
    model = lierb.Mechanism.from_mjcf(Path(__file__).with_suffix(".xml"))

springs = []
for name in model.names[1:]:
    angle, stiffness = TUCK[name.removeprefix("left_").removeprefix("right_")]
    spring = lierb.forces.torsional_spring(
        stiffness=STRENGTH * stiffness, damping=0.08 * stiffness, angle=angle
    )
    springs.append(spring.on(name))
divers = lierb.Mechanism(model.links, gravity=model.gravity, forces=springs)

arms_up = {"left_upper_arm": -3.0, "right_upper_arm": -3.0}  # rad
pose0 = divers.pose(arms_up)
twist0 = {  # all links turn as one body about the pelvis
    name: np.concatenate([pose[:3, :3].T @ (0.0, SPIN, 0.0), pose[:3, :3].T @ velocity])
    for name, pose in pose0.items()
    for velocity in [np.cross((0.0, SPIN, 0.0), pose[:3, 3] - pose0["pelvis"][:3, 3])]
}
result = lierb.integrate(
    divers, pose0=pose0, twist0=twist0, dt=5e-4, t_end=1.2, save_every=20, record="state"
)


def momentum(result: lierb.Result) -> tuple[np.ndarray, np.ndarray]:
    """Angular momentum and moment of inertia about the centre of mass and the axis to the left.

    Both (time, diver), N m s and kg m².
    """
    bodies = {link.name: link.body for link in divers.links}
    places, speeds, own, spread, masses = [], [], [], [], []
    for name, body in bodies.items():
        view, com = result[name], np.asarray(body.com, float).reshape(3)
        turn, mass = view.rotation, float(body.mass)
        about = np.asarray(body.inertia, float).reshape(3, 3)
        about = about - mass * (com @ com * np.eye(3) - np.outer(com, com))
        inertia = turn @ about @ np.swapaxes(turn, -1, -2)
        places.append(view.position + turn @ com)
        moving = view.v + np.cross(view.omega, com)
        speeds.append(np.einsum("...ij,...j->...i", turn, moving))
        turning = np.einsum("...ij,...j->...i", turn, view.omega)
        own.append(np.einsum("...ij,...j->...i", inertia, turning)[..., 1])
        spread.append(inertia[..., 1, 1])
        masses.append(mass)
    weights = np.array(masses)[:, None, None, None]
    places, speeds = np.array(places), np.array(speeds)
    arms = places - (weights * places).sum(0) / weights.sum()
    drift = speeds - (weights * speeds).sum(0) / weights.sum()
    orbital = (weights[..., 0] * np.cross(arms, drift)[..., 1]).sum(0)
    radii = (weights[..., 0] * (arms[..., 0] ** 2 + arms[..., 2] ** 2)).sum(0)
    return np.sum(own, axis=0) + orbital, np.sum(spread, axis=0) + radii


spin_momentum, inertia = momentum(result)
spin = spin_momentum / inertia
kept = np.abs(spin_momentum / spin_momentum[0] - 1.0).max()
print(f"angular momentum: {spin_momentum[0, 0]:.2f} N m s, kept to {kept:.0e}")
print(f"moment of inertia: {inertia[0, -1]:.1f} kg m² upright, {inertia[:, -1].min():.1f} tucked")
print(f"fastest somersault: {spin.max():.1f} rad/s after {SPIN:.1f} rad/s at the take-off")

figure, (above, below) = plt.subplots(2, 1, figsize=(8.0, 7.0), layout="constrained")
colours = plt.cm.viridis(np.linspace(0.0, 0.9, len(STRENGTH)))
for diver, colour in enumerate(colours):
    label = {0: "no springs", len(STRENGTH) - 1: "the strongest springs"}.get(diver)
    below.plot(result["pelvis"].t, spin[:, diver], color=colour, label=label)
below.set(xlabel="time, s", ylabel="angular momentum /\nmoment of inertia, rad/s")
below.legend(frameon=False)
arm, leg = (
    [f"left_{name}" for name in part]
    for part in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot"))
)
for shown, row in enumerate(range(0, 49, 8)):
    hips = result["pelvis"].position[row, -1]
    points = {name: result[name].position[row, -1] - hips for name in divers.names}
    for limb in (["head", "chest", "pelvis", leg[0]], ["chest", *arm], leg):
        x, z = np.array([points[name][[0, 2]] for name in limb]).T
        above.plot(x + 1.4 * shown, z, "o-", ms=4, color=colours[-1])
    time = f"{result['pelvis'].t[row]:.2f} s"
    above.annotate(time, (1.4 * shown, -1.3), ha="center")
above.set(aspect="equal", ylim=(-1.5, 1.1))
above.axis("off")

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

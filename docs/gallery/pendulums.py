"""Four thousand pendulums with drag, released from every angle: angle and rate at four times."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

rod = lierb.bodies.rod(radius=0.01, length=0.6, density=2700.0)
hinge = lierb.joints.revolute(body_point=(0.0, 0.0, 0.3), axis=(0.0, 1.0, 0.0))
pendulum = lierb.Problem(
    rod,
    hinge,
    gravity=(0.0, 0.0, -9.81),
    forces=lierb.forces.drag(linear=0.05, point=(0.0, 0.0, -0.3)),
)
angles = np.linspace(-np.pi, np.pi, 4000)
run = lierb.integrate(
    pendulum,
    pose0=hinge.pose(angles[:, None]),
    twist0=np.zeros((len(angles), 6)),
    dt=1e-3,
    t_end=3.0,
    cspace="reduced",
    save_every=1000,
    record="state",
)
figure, panels = plt.subplots(
    2, 2, figsize=(6.4, 5.6), sharex=True, sharey=True, layout="constrained"
)
for ax, t, R, omega in zip(panels.flat, run.t, run.rotation, run.omega, strict=True):
    turn = np.arctan2(R[:, 0, 2], R[:, 0, 0])
    ax.scatter(turn, omega[:, 1], c=angles, cmap="twilight", s=3)
    ax.set(xlim=(-np.pi, np.pi), title=f"t = {t:g} s")
    ax.spines[["top", "right"]].set_visible(False)
figure.supxlabel("angle [rad]")
figure.supylabel("rate [rad/s]")

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

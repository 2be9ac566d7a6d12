"""A cable of a hundred links hangs from two hooks, and is cut from one of them."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

COUNT, LENGTH = 100, 0.04  # links, m
rod = lierb.bodies.rod(LENGTH, radius=0.004, mass=0.01)  # along its e₃
start, end, hinge = (0.0, 0.0, -0.5 * LENGTH), (0.0, 0.0, 0.5 * LENGTH), lierb.joints.revolute
links = [
    lierb.Link(
        f"link{i}", rod,
        hinge(start, axis=(0.0, 1.0, 0.0), **({"parent_point": end} if i else {})),
        f"link{i - 1}" if i else "ground",
    )
    for i in range(COUNT)
]  # fmt: skip
damping = [lierb.forces.joint_friction(viscous=2e-5).on(link.name) for link in links]  # N m s
cable = lierb.Mechanism(links, gravity=(0.0, 0.0, -9.81), forces=damping)

# At rest the horizontal force is the same in all links, and the vertical one grows by a link's
# weight from each to the next: the slopes of the links are an arithmetic sequence.
steepness = 0.05  # weight of a link over the horizontal force
slope = np.arctan(steepness * (np.arange(COUNT) - 0.5 * (COUNT - 1)))
angle = 0.5 * np.pi - slope  # from e₃ towards e₁
pose0 = cable.pose({f"link{i}": turn for i, turn in enumerate(np.diff(angle, prepend=0.0))})
result = lierb.integrate(
    cable, pose0=pose0, twist0=cable.twist(), dt=2e-4, t_end=1.2, save_every=300, record="state"
)

figure, ax = plt.subplots(figsize=(6.4, 5.4), layout="constrained")
colours = plt.cm.viridis(np.linspace(0.0, 0.95, len(result["link0"].t)))
for row, colour in enumerate(colours):
    middles = np.array([result[link.name].position[row, 0] for link in links])
    axes = np.array([result[link.name].rotation[row, 0][:, 2] for link in links])
    ends = np.concatenate([middles[:1] - 0.5 * LENGTH * axes[:1], middles + 0.5 * LENGTH * axes])
    ax.plot(ends[:, 0], ends[:, 2], color=colour, lw=1.4)
ax.plot(0.0, 0.0, "o", color="black", ms=6)
ax.set(xlabel="x, m", ylabel="z, m", aspect="equal")
scale = plt.cm.ScalarMappable(plt.Normalize(0.0, 1.2), plt.cm.viridis)
figure.colorbar(scale, ax=ax, label="time since the cut, s", shrink=0.8)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

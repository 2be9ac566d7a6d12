"""Bricard's mechanism: six bars, six hinges, no freedom by counting, and yet it moves.

The bars are at right angles to the hinges at their ends; count 6·5 freedoms less 5·6, and none is
left. One row of the loop is redundant, though, and `freedoms` says so. A04 of the IFToMM multibody
benchmarks: rods of 1 m and 1 kg, with a square section of 0.1 m, from rest, gravity along −y.

    python bricard.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], float)
AXES = np.eye(3)[[1, 2, 0, 1, 2, 0]]  # of the hinge at each corner
SECTION = 0.1  # m

names = ["ground", "rod1", "rod2", "rod3", "rod4", "rod5"]
middles = [np.zeros(3), *((CORNERS[:-1] + CORNERS[1:]) / 2)]  # where the body frames are
sizes = [np.where(CORNERS[i] != CORNERS[i + 1], 1.0, SECTION) for i in range(5)]
hinges = [
    lierb.joints.revolute(
        CORNERS[i] - middles[(i + 1) % 6], parent_point=CORNERS[i] - middles[i], axis=AXES[i]
    )
    for i in range(6)
]
links = [
    lierb.Link(names[i + 1], lierb.bodies.box(sizes[i], mass=1.0), hinges[i], names[i])
    for i in range(5)
]
last = lierb.joints.revolute(CORNERS[5] - middles[5], CORNERS[5], axis=AXES[5])
bricard = lierb.Mechanism(links, lierb.Loop("last", last, "rod5"), gravity=(0.0, -9.81, 0.0))

pose0 = bricard.pose()  # all coordinates 0: so it is drawn above
print(bricard.freedoms(pose0))
result = lierb.integrate(
    bricard, pose0=pose0, twist0=bricard.twist({}, pose0), dt=1e-3, t_end=10.0,
    stabilise="project", save_every=20, record=["state", "energy"],
)  # fmt: skip


def turned(link, parent, axis):
    """The coordinate of a hinge along the coordinate axis with that number, (times,)."""
    R = link if parent is None else np.swapaxes(parent, 1, 2) @ link
    i, j = (axis + 1) % 3, (axis + 2) % 3
    return np.arctan2(R[:, j, i], R[:, i, i])


# Hinges turn by the same two angles in turns, and these obey (1 + sin α)(1 + sin β) = 1.
t = result.t
R1, R2 = (result[name].rotation[:, 0] for name in ("rod1", "rod2"))
alpha, beta = turned(R1, None, 1), turned(R2, R1, 2)
off = np.abs((1.0 + np.sin(alpha)) * (1.0 + np.sin(beta)) - 1.0).max()
opened, drift = (result.summary[c][0].as_py() for c in ("position_error_max", "energy_drift_max"))
print(f"off its closed form by {off:.0e}, open by {opened:.0e} m, energy off by {drift:.0e} J")

figure = plt.figure(figsize=(6.4, 8.0), layout="constrained")
space = figure.add_subplot(2, 1, 1, projection="3d")
ends = {
    name: np.stack([
        result[name].position[:, 0] + result[name].rotation[:, 0] @ (corner - middle)
        for corner in CORNERS[i : i + 2]
    ])
    for i, (name, middle) in enumerate(zip(names[1:], middles[1:]))
}  # fmt: skip
for k, shade in ((0, 1.0), (25, 0.5), (50, 0.25)):
    for i, points in enumerate(ends.values()):
        # the plot's third axis is up, and here that is −gravity, y
        space.plot(*points[:, k, [0, 2, 1]].T, color=f"C{i}", alpha=shade, linewidth=3)
space.plot([0, 0], [0, 1], [0, 0], color="0.3", linewidth=3)
space.set(xlabel="x [m]", ylabel="z [m]", zlabel="y [m]", aspect="equal")
space.locator_params(nbins=4)
space.set_box_aspect(None, zoom=0.85)
space.set_title(f"at 0, {t[25]:.1f} and {t[50]:.1f} s", fontsize=10)
curve = figure.add_subplot(2, 1, 2)
curve.plot(t, np.degrees(alpha), label="α", color="#0072B2")
curve.plot(t, np.degrees(beta), label="β", color="#D55E00")
curve.set(xlabel="t [s]", ylabel="turn of the hinges [°]", xlim=(0, 10))
curve.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
curve.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

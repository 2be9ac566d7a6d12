"""RSSR: a crank and a rocker about skew axes, joined by a rod with a ball at each end.

Ninety-nine rods of different lengths: how far does each let the rocker swing, and for which does
the crank turn all the way round?

    python rssr.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

CRANK, ROCKER = 0.1, 0.3  # m
PIVOT, AXIS = np.array([0.35, 0.05, 0.1]), np.array([0.6, 0.0, 0.8])  # m, and a direction
LENGTHS = np.linspace(0.3, 0.496, 99)  # m, of the rod
SPEED = 2.0 * np.pi  # rad/s

ball = lierb.joints.spherical
end = np.stack([0.5 * LENGTHS, 0.0 * LENGTHS, 0.0 * LENGTHS], axis=1)
machine = lierb.Mechanism(
    links=[
        lierb.Link(
            "crank", lierb.bodies.rod(CRANK, 0.01, mass=0.4),
            lierb.joints.revolute(axis=(0.0, 0.0, 1.0)),
        ),
        lierb.Link(
            "rod", lierb.Body(0.3, (2e-5, 6e-3, 6e-3)),
            ball(-end, parent_point=(CRANK, 0.0, 0.0)), parent="crank",
        ),
        lierb.Link(
            "rocker", lierb.Body(0.6, (1e-3, 5e-3, 6e-3)),
            lierb.joints.revolute(ground_point=PIVOT, axis=AXIS),
        ),
    ],
    loops=[lierb.Loop("ball", ball(end, parent_point=(0.0, ROCKER, 0.0)), "rod", "rocker")],
)  # fmt: skip

# Each rod closes by itself. Of the two angles of the rocker at which it fits, the larger;
# the rod's own axis, e₁, is from the crank's end to the rocker's.
crank_end = np.array([CRANK, 0.0, 0.0])
side, arm = (
    np.cross(AXIS, (0.0, 1.0, 0.0)),
    crank_end - PIVOT,
)  # the rocker's e₂ is y cos φ + side sin φ
reach = (arm @ arm + ROCKER**2 - LENGTHS**2) / (2.0 * ROCKER)
angle = np.arctan2(arm @ side, arm[1]) + np.arccos(reach / np.hypot(arm @ side, arm[1]))
rocker_end = PIVOT + ROCKER * (np.outer(np.cos(angle), (0, 1, 0)) + np.outer(np.sin(angle), side))
e1 = (rocker_end - crank_end) / LENGTHS[:, None]
e2 = np.cross((0.0, 0.0, 1.0), e1) / np.linalg.norm(e1[:, :2], axis=1, keepdims=True)
rod = np.tile(np.eye(4), (len(LENGTHS), 1, 1))
rod[:, :3, :3] = np.stack([e1, e2, np.cross(e1, e2)], axis=-1)
rod[:, :3, 3] = (crank_end + rocker_end) / 2.0
pose0 = machine.close(machine.pose({"rocker": angle, "rod": rod}))
# The crank turns; what the others do follows from the loop: the twist of a motor at that speed.
motor = lierb.forces.motor(speed=SPEED).on("crank")
driven = lierb.Mechanism(machine.links, machine.loops, forces=motor)
twist0 = driven.project(machine.twist({}, pose0), pose0)
result = lierb.integrate(
    machine, pose0=pose0, twist0=twist0, dt=5e-4, t_end=3.0, stabilise="project",
    save_every=10, record="state",
)  # fmt: skip


def turned(name, axis, start):
    """About an axis, from where a direction of the body starts, rad, (times, n)."""
    now = result[name].rotation @ start
    return np.unwrap(np.arctan2(now @ np.cross(axis, start), now @ start), axis=0)


crank = turned("crank", np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
rocker = turned("rocker", AXIS, np.array([0.0, 1.0, 0.0]))
rocker += 2.0 * np.pi * np.round((angle - rocker[0]) / (2.0 * np.pi))
runs = np.ptp(crank, axis=0) > 2.0 * np.pi
swing = np.degrees(np.ptp(rocker, axis=0))
print(f"{runs.sum()} of {len(LENGTHS)} rods let the crank turn all the way round: "
      f"{LENGTHS[runs].min():.3f} to {LENGTHS[runs].max():.3f} m")  # fmt: skip
print(f"there the rocker swings by {swing[runs].min():.1f}° to {swing[runs].max():.1f}°")
opened, drift = (
    result.summary[c].to_numpy().max() for c in ("position_error_max", "energy_drift_max")
)
print(f"open by at most {opened:.0e} m, energy off by at most {drift:.0e} J")

figure, (transfer, width) = plt.subplots(2, 1, figsize=(6.4, 7.4), layout="constrained")
colours = plt.get_cmap("viridis")(np.linspace(0.0, 1.0, len(LENGTHS)))
for k in range(0, len(LENGTHS), 4):
    style = "-" if runs[k] else ":"
    transfer.plot(*np.degrees([crank[:, k], rocker[:, k]]), style, color=colours[k], linewidth=0.9)
transfer.set(xlabel="crank [°]", ylabel="rocker [°]", xlim=(-180, 400))
transfer.set_title("dotted: the crank turns back", fontsize=10)
width.scatter(1e3 * LENGTHS[runs], swing[runs], color=colours[runs], s=14)
width.set(xlabel="rod [mm]", ylabel="the rocker swings by [°]")
width.set_title("rods with which the crank turns all the way round", fontsize=10)
for axes in (transfer, width):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

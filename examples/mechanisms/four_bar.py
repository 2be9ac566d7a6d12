"""A four-bar as it is made: Chebyshev's straight-line linkage, its bars within tolerances.

Crank : base : rocker : coupler = 1 : 2 : 2.5 : 5. For half of a turn the coupler's end goes along a
line that is nearly straight. How straight is it for machines whose bars are within ±0.1 mm, and
what torque do their motors need?

    python four_bar.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

COUNT, SPEED = 1000, 2.0 * np.pi  # machines; rad/s
NOMINAL = {"crank": 0.04, "base": 0.08, "rocker": 0.1, "half": 0.1, "coupler": 0.2}  # m
TOLERANCE = 1e-4  # m: three standard deviations

rng = np.random.default_rng(5)
length = {name: x + TOLERANCE / 3.0 * rng.normal(size=COUNT) for name, x in NOMINAL.items()}
for name, x in NOMINAL.items():
    length[name][0] = x  # machine 0 is the drawing


def along(x):
    """Points of a bar, on its own e₁."""
    return np.stack([x, 0.0 * x, 0.0 * x], axis=-1)


def bar(name):
    return lierb.bodies.box((NOMINAL[name], 0.012, 0.006), density=2700.0)


pin = lambda body, parent: lierb.joints.revolute(
    along(body), parent_point=along(parent), axis=(0.0, 1.0, 0.0)
)
crank, rocker, coupler = (0.5 * length[name] for name in ("crank", "rocker", "coupler"))
linkage = lierb.Mechanism(
    links=[
        lierb.Link("crank", bar("crank"), pin(-crank, 0.0 * crank)),
        lierb.Link("coupler", bar("coupler"), pin(-coupler, crank), parent="crank"),
        lierb.Link("rocker", bar("rocker"), pin(-rocker, length["base"])),
    ],
    loops=[lierb.Loop("pin", pin(length["half"] - coupler, rocker), "coupler", "rocker")],
    gravity=(0.0, 0.0, -9.81),
    forces=lierb.forces.motor(speed=SPEED).on("crank"),
)

# Each machine closes by itself: no two are alike.
pose0 = linkage.close(linkage.pose({"coupler": -1.2, "rocker": -1.7}))
twist0 = linkage.project(linkage.twist({"crank": SPEED}, pose0), pose0)
result = lierb.integrate(
    linkage, pose0=pose0, twist0=twist0, dt=1e-3, t_end=1.0, stabilise="project",
    save_every=5, record=["state", "energy"],
)  # fmt: skip

t, link = result.t, result["coupler"]
ends = link.position + np.einsum("tnij,nj->tni", link.rotation, along(coupler))
line = np.abs(t - 0.5) <= 0.25  # half of a turn
x, z = ends[line, :, 0], ends[line, :, 2]
slopes, middles = (np.array([np.polyfit(x[:, k], z[:, k], 1) for k in range(COUNT)])).T
bends = np.ptp(z - slopes * x - middles, axis=0)  # m, from the highest to the lowest
work = result.history["work"].to_numpy().reshape(len(t), COUNT)
torques = np.gradient(work, t, axis=0) / SPEED
peaks = np.abs(torques).max(axis=0)  # N m

print(f"as drawn: straight to {1e3 * bends[0]:.3f} mm, at most {peaks[0]:.4f} N m")
low, middle, high = (1e3 * np.quantile(bends, q) for q in (0.05, 0.5, 0.95))
print(f"as made:  straight to {middle:.3f} mm, 90 % between {low:.3f} and {high:.3f} mm")
print(f"          at most {peaks.min():.4f} to {peaks.max():.4f} N m")
print(f"tilted by at most {1e3 * np.abs(slopes).max():.1f} mrad; "
      f"open by at most {result.summary['position_error_max'].to_numpy().max():.0e} m")  # fmt: skip

figure, (path, flat, spread) = plt.subplots(
    3, 1, figsize=(6.4, 9.0), layout="constrained", height_ratios=(1.4, 1.2, 1.0)
)
k = int(np.argmin(np.abs(t - 0.3)))  # a time at which the machine is drawn
rod = result["rocker"]
knee = rod.position[k, 0] + rod.rotation[k, 0] @ along(rocker)[0]
heel = link.position[k, 0] - link.rotation[k, 0] @ along(coupler)[0]
for points, colour in (
    ([np.zeros(3), heel], "0.2"),
    ([(NOMINAL["base"], 0.0, 0.0), knee], "0.5"),
    ([heel, ends[k, 0]], "#0072B2"),
):
    path.plot(*np.array(points)[:, ::2].T, "o-", color=colour, linewidth=3)
path.plot(ends[:, 0, 0], ends[:, 0, 2], color="#D55E00", linewidth=1.2)
path.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
for k in range(1, 120):
    flat.plot(1e3 * x[:, k], 1e3 * z[:, k], color="#D55E00", linewidth=0.4, alpha=0.35)
flat.plot(1e3 * x[:, 0], 1e3 * z[:, 0], color="black", linewidth=1.4)
flat.set(xlabel="x [mm]", ylabel="z [mm]")
flat.set_title("the line, as drawn and as made", fontsize=10)
spread.hist(1e3 * bends, bins=40, color="#D55E00")
spread.axvline(1e3 * bends[0], color="black")
spread.set(xlabel="straight to [mm]", yticks=[])
spread.set_title(f"{COUNT} machines", fontsize=10)
for axes in (path, flat, spread):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

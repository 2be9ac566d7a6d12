"""Chaos: two hundred double pendulums, released a nanoradian apart, fan out.

python double_pendulum.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

ROD = lierb.bodies.box((0.03, 0.03, 0.5), mass=1.0)  # m, kg; the frame is in the middle
TOP, TIP = (0.0, 0.0, 0.25), np.array([0.0, 0.0, -0.25])
Y = {"axis": (0.0, 1.0, 0.0)}
pendulum = lierb.Mechanism(
    links=[
        lierb.Link("upper", ROD, lierb.joints.revolute(TOP, **Y)),
        lierb.Link("lower", ROD, lierb.joints.revolute(TOP, parent_point=TIP, **Y), "upper"),
    ],
    gravity=(0.0, 0.0, -9.81),
)

COUNT, APART = 200, 1e-9  # pendulums; rad
angles = np.radians(130.0) + APART * np.arange(COUNT)
pose0 = pendulum.pose({"upper": angles, "lower": 0.5})
result = lierb.integrate(
    pendulum, pose0=pose0, twist0=pendulum.twist({}, pose0), dt=1e-3, t_end=15.0,
    save_every=10, record="state",
)  # fmt: skip

t, lower = result.t, result["lower"]
tips = lower.position + lower.rotation @ TIP  # (times, pendulums, 3)
spread = np.linalg.norm(np.std(tips, axis=1), axis=-1)
parted = int(np.argmax(spread > 0.1))
rate, start = np.polyfit(t[:parted], np.log(spread[:parted]), 1)
drift = result.summary["energy_drift_max"].to_numpy().max()

print(f"{COUNT} double pendulums {APART:g} rad apart: after {t[parted]:.1f} s their tips are "
      f"{spread[parted]:.1f} m apart")  # fmt: skip
print(f"distances grow by e every {1.0 / rate:.2f} s; energies are kept to {drift:.0e} J")

figure, (path, fan) = plt.subplots(2, 1, figsize=(6.4, 7.6), layout="constrained")
colours = plt.get_cmap("viridis")(np.linspace(0.0, 1.0, COUNT))
shown = slice(parted - 90, parted + 25)
for k in range(0, COUNT, 4):
    path.plot(*tips[shown, k, ::2].T, color=colours[k], linewidth=0.8)
path.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", xticks=(-0.5, 0.0, 0.5))
path.set_title(f"the tips, {t[shown.start]:.1f} to {t[shown.stop]:.1f} s", fontsize=10)
fan.semilogy(t, spread, color="#0072B2")
fan.semilogy(t[:parted], np.exp(start + rate * t[:parted]), "--", color="0.4")
fan.set(xlabel="t [s]", ylabel="standard deviation of the tips [m]")
fan.set_title(f"×e every {1.0 / rate:.2f} s", fontsize=10)
fan.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

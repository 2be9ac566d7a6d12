"""Forty four-bar windows side by side: A02 of the IFToMM multibody benchmarks, with N = 40.

81 rods of 1 m and 1 kg, 40 loops, and one freedom, until all rods lie in a line: there the windows
may fold in many ways, and 20 times in 20 s they go on with parallel cranks. In this motion N + 1
cranks turn and N bars only move along, so that the windows are one pendulum,

    ((N + 1)/3 + N) φ'' = ((N + 1)/2 + N) g sin φ,   φ from the upright position, φ'(0) = 1 rad/s.

Code that loops over the links is compiled once for all mechanisms of this kind, in seconds.

    python windows.py [FIGURE.png]
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import lierb

N, G0 = 40, 9.81
ROD = lierb.Body(1.0, np.diag((1e-3, 1.0 / 12.0, 1.0 / 12.0)))  # along e₁


def pin(body, parent):
    return lierb.joints.revolute((body, 0.0, 0.0), parent_point=parent)


# Cranks point upwards, bars to the right; crank i stands at x = i.
cranks = [f"crank{i}" for i in range(N + 1)]
bars = [f"bar{i}" for i in range(N)]
links = [lierb.Link(name, ROD, pin(-0.5, (i, 0.0, 0.0))) for i, name in enumerate(cranks)]
links += [
    lierb.Link(name, ROD, pin(-0.5, (0.5, 0.0, 0.0)), cranks[i]) for i, name in enumerate(bars)
]
loops = [
    lierb.Loop(f"pin{i}", pin(0.5, (0.5, 0.0, 0.0)), name, cranks[i + 1])
    for i, name in enumerate(bars)
]
windows = lierb.Mechanism(links, loops, gravity=(0.0, -G0, 0.0))

upright = dict.fromkeys(cranks, 0.5 * np.pi) | dict.fromkeys(bars, -0.5 * np.pi)
pose0 = windows.pose(upright)
twist0 = windows.twist(dict.fromkeys(cranks, -1.0) | dict.fromkeys(bars, 1.0), pose0)
begun = time.perf_counter()
result = lierb.integrate(
    windows, pose0=pose0, twist0=twist0, dt=2.5e-3, t_end=20.0, method="Tsit5",
    stabilise="project", save_every=40, record=["state", "energy"],
)  # fmt: skip
taken = time.perf_counter() - begun

t = result.t
own = (N + 1) / 3 + N, (N + 1) / 2 + N
pendulum = solve_ivp(
    lambda t, y: (y[1], own[1] / own[0] * G0 * np.sin(y[0])), (0.0, 20.0), (0.0, 1.0),
    method="DOP853", rtol=1e-13, atol=1e-13, t_eval=t,
)  # fmt: skip
phi = pendulum.y[0]
expected = 0.5 * np.stack([np.sin(phi), np.cos(phi)], axis=-1)
off = max(
    np.abs(result[name].position[:, 0, :2] - (i, 0.0) - expected).max()
    for i, name in enumerate(cranks)
)
opened = result.summary["position_error_max"][0].as_py()
print(f"{N} windows: {len(links)} rods, {len(loops)} loops, {taken:.1f} s for 8000 steps")
print(f"off the closed form by {off:.0e} m, open by {opened:.0e} m")

figure, (drawn, curve) = plt.subplots(
    2, 1, figsize=(7.2, 4.6), layout="constrained", height_ratios=(1.0, 2.0)
)
for k, shade in ((0, 1.0), (5, 0.6), (8, 0.3)):
    for names, colour in ((cranks, "#0072B2"), (bars, "#D55E00")):
        for name in names:
            place, half = result[name].position[k, 0], 0.5 * result[name].rotation[k, 0, :, 0]
            ends = np.stack([place - half, place + half])
            drawn.plot(*ends[:, :2].T, color=colour, alpha=shade, linewidth=1.5)
drawn.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
drawn.set_title(f"at 0, {t[5]:.1f} and {t[8]:.1f} s", fontsize=10)
height = result["crank0"].position[:, 0, 1]
curve.plot(t, 2.0 * height, color="#0072B2", label="windows")
curve.plot(t, np.cos(phi), ".", color="black", markersize=3, label="pendulum")
curve.set(xlabel="t [s]", ylabel="height [m]", xlim=(0, 20))
curve.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
for axes in (drawn, curve):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

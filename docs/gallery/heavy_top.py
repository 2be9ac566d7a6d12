"""Heavy tops: where the axis goes, and how far each c-space lets the pivot open."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

COLOURS = {"SE3": "#0072B2", "SO3xR3": "#D55E00"}
BODY = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))  # kg, kg m²
PIVOT = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))  # m
TOP = lierb.Problem(BODY, PIVOT, gravity=(0.0, 0.0, -9.81))

omega0 = np.array([6.28, 3.14, 0.63]) + np.random.default_rng(0).normal(size=(64, 3))
runs = {
    cspace: lierb.integrate(
        TOP,
        twist0=PIVOT.twist(omega=omega0),
        dt=1e-3,
        t_end=10.0,
        cspace=cspace,
        solver="saddle",
        save_every=5,
        record="state",
    )
    for cspace in ("SE3", "SO3xR3")
}

figure = plt.figure(figsize=(8.0, 3.7), layout="constrained")
ball = figure.add_subplot(1, 2, 1, projection="3d")
u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
ball.plot_wireframe(
    np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="0.85", linewidth=0.4
)
places = runs["SE3"].position  # (times, tops, 3): of the centre of mass, from the pivot
axes = places / np.linalg.norm(places, axis=-1, keepdims=True)
for k, color in enumerate(("#009E73", "#CC79A7", "#E69F00")):
    ball.plot(*axes[:301, k].T, color=color, linewidth=1.3)
    ball.scatter(*axes[300, k], color=color, s=25)
ball.set_box_aspect((1, 1, 1), zoom=1.65)
ball.set_axis_off()
ball.view_init(-12, -50)
ball.set_title("three tops: from pivot to centre of mass", fontsize=10)

drift = figure.add_subplot(1, 2, 2)
for cspace in ("SO3xR3", "SE3"):
    color = COLOURS[cspace]
    run = runs[cspace]
    t = run.t
    error = run.history["position_error"].to_numpy().reshape(len(t), -1)
    label = {"SE3": "SE(3)", "SO3xR3": "SO(3)×R³"}[cspace]
    median, largest = np.median(error, axis=1), error.max(axis=1)
    drift.plot(t, median, color=color, linewidth=1.8)
    drift.fill_between(t, median, largest, color=color, alpha=0.25, linewidth=0)
    drift.annotate(f"{label}: {largest[-1]:.1g} m" if largest[-1] else f"{label}: exactly 0",
                   (t[-1], largest[-1]), xytext=(-4, 9), textcoords="offset points",
                   ha="right", color=color, fontweight="bold")  # fmt: skip
drift.set_yscale("symlog", linthresh=1e-12)
drift.set(xlabel="t [s]", ylabel="the joint has opened by [m]", xlim=(0, 10), ylim=(-2e-13, 1e-5))
drift.set_yticks([0, 1e-12, 1e-10, 1e-8, 1e-6])
drift.set_title("64 tops, RK4, 1 ms: median and largest", fontsize=10)
drift.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

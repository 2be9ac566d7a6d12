"""The pivot's error over the step, for three methods and both c-spaces."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
pivot = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))
top = lierb.Problem(body, pivot, gravity=(0.0, 0.0, -9.81))
twist0 = pivot.twist(omega=(6.28, 3.14, 0.63))
ROUGH, EXACT = "#D55E00", "#0072B2"  # SO(3)×R³, SE(3)
steps = np.array([1e-2, 5e-3, 2.5e-3, 1e-3, 5e-4])

figure, ax = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
for method, marker in (("Euler", "o"), ("Heun", "s"), ("RK4", "D")):
    errors = {}
    for cspace in ("SO3xR3", "SE3"):
        runs = [
            lierb.integrate(
                top, twist0=twist0, dt=dt, t_end=1.0, method=method, cspace=cspace, solver="saddle"
            )
            for dt in steps
        ]
        errors[cspace] = [run.summary["position_error_max"][0].as_py() for run in runs]
    ax.plot(steps, errors["SO3xR3"], marker=marker, color=ROUGH)
    ax.annotate(f"{method}", (steps[0], errors["SO3xR3"][0]), xytext=(8, -3),
                textcoords="offset points", color=ROUGH)  # fmt: skip
    ax.plot(steps, errors["SE3"], marker=marker, color=EXACT, markersize=4)
ax.annotate("SO(3)×R³: with the method's order", (4.5e-4, 1.5e-6), color=ROUGH, weight="bold")
ax.annotate("SE(3): zero, whatever the method and the step", (6e-4, 2e-17), color=EXACT,
            xytext=(0, 0), textcoords="offset points", weight="bold", va="bottom")  # fmt: skip
ax.set_xscale("log")
ax.set_yscale("symlog", linthresh=1e-16)
ax.set_yticks([0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
ax.set(xlabel="step [s]", ylabel="the joint opened by at most [m]", ylim=(-2e-17, 0.5))
ax.set_xlim(4e-4, 1.4e-2)
ax.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

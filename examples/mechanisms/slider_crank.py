"""The spatial slider-crank, and three ways to treat the loop that drifts.

Crank, slider and places are those of E. J. Haug, Computer Aided Kinematics and Dynamics of
Mechanical Systems (1989), and of the IFToMM multibody benchmarks; the rod's mass and inertia are
our own. A ball joins crank and rod, a universal joint rod and slider: one freedom.

    python slider_crank.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

R, L = 0.08, 0.3  # m, crank and rod
PIVOT, SLIDER = np.array([0.0, 0.1, 0.12]), np.array([0.2, 0.0, 0.0])  # m
BALL = PIVOT + np.array(
    [0.0, 0.0, R]
)  # where crank and rod meet at the start: the crank is upright
X = np.array([1.0, 0.0, 0.0])

# Body frames are at the centres of mass; the rod's e₂ is along it, from the slider to the crank.
e2 = (BALL - SLIDER) / L
e1 = np.cross(X, e2) / np.linalg.norm(np.cross(X, e2))
rod_pose = np.eye(4)
rod_pose[:3, :3], rod_pose[:3, 3] = (
    np.stack([e1, e2, np.cross(e1, e2)], axis=1),
    (BALL + SLIDER) / 2,
)
knuckle = np.eye(4)  # of the universal joint: its e₃ is the slider's axis X, its e₂ the rod's e₁
knuckle[:3, :3], knuckle[:3, 3] = np.stack([np.cross(e1, X), e1, X], axis=1), SLIDER
slider_pose = np.eye(4)
slider_pose[:3, 3] = SLIDER

machine = lierb.Mechanism(
    links=[
        lierb.Link(
            "crank", lierb.Body(0.12, (1e-4, 1e-5, 1e-4)),
            lierb.joints.revolute((0.0, 0.0, -R / 2), PIVOT, axis=X),
        ),
        lierb.Link(
            "rod", lierb.Body(0.5, (4e-3, 4e-4, 4e-3)),
            lierb.joints.spherical((0.0, L / 2, 0.0), parent_point=(0.0, 0.0, R / 2)), "crank",
        ),
        lierb.Link("slider", lierb.Body(2.0, (1e-4,) * 3), lierb.joints.prismatic(axis=X)),
    ],
    loops=[
        lierb.Loop(
            "knuckle",
            lierb.joints.universal(
                body_frame=np.linalg.inv(rod_pose) @ knuckle,
                parent_frame=np.linalg.inv(slider_pose) @ knuckle,
            ),
            body="rod", parent="slider",
        )
    ],
    gravity=(0.0, 0.0, -9.81),
)  # fmt: skip
start = machine.pose({"rod": rod_pose, "slider": 0.2})  # a link's whole pose, or its coordinate
pose0 = machine.close(start)
# The crank turns; what the others do follows from the loop: the twist of a motor at that speed.
driven = lierb.Mechanism(
    machine.links, machine.loops, forces=lierb.forces.motor(speed=6.0).on("crank")
)
twist0 = driven.project(machine.twist({}, pose0), pose0)

ways = {"None": None, "baumgarte(20, 20)": lierb.baumgarte(20.0, 20.0), '"project"': "project"}
runs = {
    name: lierb.integrate(
        machine, pose0=pose0, twist0=twist0, dt=2e-3, t_end=20.0, stabilise=way,
        save_every=4, record=["state", "reaction"],
    )
    for name, way in ways.items()
}  # fmt: skip
print(f"{'stabilise':20} open by at most   energy drifts by")
for name, result in runs.items():
    opened, drift = (
        result.summary[c][0].as_py() for c in ("position_error_max", "energy_drift_max")
    )
    print(f"{name:20} {opened:12.0e} m {drift:14.0e} J")

result = runs['"project"']
t = result.t
force = np.linalg.norm(np.stack(result.history["knuckle.reaction"].to_numpy())[:, 3:], axis=1)

figure, (motion, pull, gap) = plt.subplots(3, 1, figsize=(6.4, 8.0), layout="constrained")
motion.plot(t, result["slider"].position[:, 0, 0], color="#0072B2")
motion.set(xlabel="t [s]", ylabel="slider at x [m]", xlim=(0, 4))
pull.plot(t, force, color="#0072B2")
pull.set(xlabel="t [s]", ylabel="force in the knuckle [N]", xlim=(0, 4))
for (name, run), colour in zip(runs.items(), ("#D55E00", "#E69F00", "#0072B2"), strict=True):
    error = run.history["position_error"].to_numpy()
    gap.semilogy(t, np.where(error > 0.0, error, np.nan), color=colour, label=name)
gap.set(xlabel="t [s]", ylabel="the knuckle is open by [m]", ylim=(1e-18, 1e-3))
gap.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
for axes in (motion, pull, gap):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

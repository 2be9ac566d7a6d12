"""A six-axis arm with payloads of 0 to 5 kg: how far do its soft joints let the tool sag?

Denavit–Hartenberg parameters, masses and centres of mass of the UR5e as its maker publishes them
(Universal Robots, "DH parameters for calculations of kinematics and dynamics"). The inertias are
those of balls of 5 cm radius, and stiffness and damping of the joints our own. A file would do
as well: lierb.Mechanism.from_urdf.

    python arm.py [FIGURE.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)  # m
A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)  # m
ALPHA = np.pi * np.array([0.5, 0.0, 0.0, 0.5, -0.5, 0.0])
MASS = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)  # kg
COM = [
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
]  # fmt: skip, m, in the frame at the link's end
TARGET = np.radians([30.0, -80.0, 100.0, -110.0, -90.0, 20.0])
STIFFNESS = np.array([4e3, 4e3, 3e3, 1e3, 1e3, 3e2])  # N m/rad
DAMPING = np.array([200.0, 200.0, 80.0, 5.0, 1.5, 0.3])  # N m s/rad
PAYLOAD = np.linspace(0.0, 5.0, 51)  # kg, a ball at the flange
BALL = 0.4 * 0.05**2  # m²


def end_of(d, a, alpha):
    """The link's frame, seen from the joint that turns it: Tz(d) Tx(a) Rx(α)."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, d], [0, 0, 0, 1.0]])


names = ["base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"]
bodies = [
    lierb.Body(m, np.eye(3) * m * BALL + m * (np.dot(c, c) * np.eye(3) - np.outer(c, c)), com=c)
    for m, c in zip(MASS, COM, strict=True)
]
joints = [
    lierb.joints.revolute(body_frame=np.linalg.inv(end_of(*row)), parent_frame=np.eye(4))
    for row in zip(D, A, ALPHA, strict=True)
]
links = [
    lierb.Link(name, body, joint, parent)
    for name, body, joint, parent in zip(
        names, bodies, joints, ["ground", *names[:-1]], strict=True
    )
]
load = lierb.Body(
    PAYLOAD + 1e-3, (PAYLOAD[:, None] + 1e-3) * (BALL, BALL, BALL)
)  # at the flange; a gram where there is none
links.append(lierb.Link("load", load, lierb.joints.fixed(), "wrist3"))
arm = lierb.Mechanism(
    links,
    gravity=(0.0, 0.0, -9.81),
    forces=[
        lierb.forces.torsional_spring(stiffness=k, damping=c, angle=angle).on(name)
        for name, k, c, angle in zip(names, STIFFNESS, DAMPING, TARGET, strict=True)
    ],
)

pose0 = arm.pose(dict(zip(names, TARGET, strict=True)))  # where it is without gravity
result = lierb.integrate(
    arm, pose0=pose0, twist0=arm.twist({}, pose0), dt=5e-4, t_end=2.0,
    save_every=10, record="state",
)  # fmt: skip
t, place = result.t, result["load"].position
sag = 1e3 * (pose0["load"][2, 3] - place[..., 2])  # mm
left = np.linalg.norm(result["load"].v[-1], axis=-1).max()
print(f"without a load the tool sags by {sag[-1, 0]:.2f} mm")
print(f"with {PAYLOAD[-1]:.0f} kg by {sag[-1, -1]:.2f} mm, {sag[:, -1].max():.2f} mm on the way")
print(f"{np.polyfit(PAYLOAD, sag[-1], 1)[0]:.3f} mm/kg; what still moves does so at {left:.0e} m/s")

figure, (course, rest) = plt.subplots(2, 1, figsize=(6.4, 7.0), layout="constrained")
for k in range(0, len(PAYLOAD), 5):
    colour = plt.get_cmap("viridis")(k / len(PAYLOAD))
    course.plot(t, sag[:, k], color=colour, label=f"{PAYLOAD[k]:.1f} kg")
course.set(xlabel="t [s]", ylabel="the tool is lower by [mm]", xlim=(0, 1))
course.legend(fontsize=9, reverse=True, loc="center left", bbox_to_anchor=(1.0, 0.5))
rest.plot(PAYLOAD, sag[-1], color="#0072B2")
rest.set(xlabel="payload [kg]", ylabel="at rest lower by [mm]")
for axes in (course, rest):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

"""A satellite with two reaction wheels turns about the axis for which it has none.

It turns by 90° about x, by an angle about y, and back about x: what is left is a turn about z. No
wheel turns in the end, and the total angular momentum, zero, is what it was all the time.

    python reaction_wheels.py [FIGURE.png]
"""

import math
import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

HULL = lierb.bodies.box((0.5, 0.4, 0.6), mass=60.0)
WHEEL = lierb.bodies.cylinder(0.08, 0.04, density=2700.0)  # about its e₃
AXES = {"wheel_x": np.eye(3)[0], "wheel_y": np.eye(3)[1]}
PLACES = {"wheel_x": np.array([0.0, 0.0, 0.2]), "wheel_y": np.array([0.0, 0.0, -0.2])}  # m
SLEW = 30.0  # s, for each of the three


def frame(axis, point):
    """With e₃ along an axis, on the hull."""
    found = np.eye(4)
    found[:3, :3] = np.stack([np.roll(axis, 1), np.roll(axis, 2), axis], axis=1)
    found[:3, 3] = point
    return found


def slew(t, params):
    """Smooth, from rest to rest: the wheel's torque over one turn of a sine, begun at a time."""
    phase = (t - params.begin) / 30.0
    return lierb.where(
        (phase > 0.0) & (phase < 1.0), params.peak * math.sin(2 * math.pi * phase), 0.0
    )


def inertia_about(axis):
    """Of all that a wheel's torque turns: the hull and the wheels, but for its own spin."""
    total = HULL.inertia @ axis @ axis
    for name, place in PLACES.items():
        own = frame(AXES[name], place)[:3, :3].T @ axis
        away = np.cross(axis, place)
        total += WHEEL.inertia @ own @ own * (own[2] == 0.0) + WHEEL.mass * away @ away
    return total


wanted = np.radians(np.linspace(-90.0, 90.0, 37))  # about z, of a satellite each
peak = {name: 2.0 * np.pi * inertia_about(axis) / SLEW**2 for name, axis in AXES.items()}  # per rad
turn = lambda name, begin, angle: lierb.forces.motor(
    slew, begin=begin, peak=-angle * peak[name]
).on(name)

satellite = lierb.Mechanism(
    links=[
        lierb.Link("hull", HULL, lierb.joints.free()),
        *(
            lierb.Link(
                name, WHEEL, lierb.joints.revolute(parent_frame=frame(axis, PLACES[name])), "hull"
            )
            for name, axis in AXES.items()
        ),
    ],
    forces=[
        turn("wheel_x", 0.0, 0.5 * np.pi),
        turn("wheel_y", SLEW, wanted),
        turn("wheel_x", 2.0 * SLEW, -0.5 * np.pi),
    ],
)  # fmt: skip


def in_ground(state, vectors):
    """Vectors that were in the body's axes."""
    return np.einsum("...ij,...j->...i", state.rotation, vectors)


def angular_momentum(result):
    """Of all bodies about the ground's origin, (times, n, 3), kg m²/s."""
    total = 0.0
    for link in satellite.links:
        state, body = result[link.name], link.body
        spin = in_ground(state, state.omega @ body.inertia)
        total = total + spin + body.mass * np.cross(state.position, in_ground(state, state.v))
    return total


pose0 = satellite.pose()
result = lierb.integrate(
    satellite, pose0=pose0, twist0=satellite.twist({}, pose0), dt=1e-2, t_end=3.0 * SLEW,
    save_every=50, record="state",
)  # fmt: skip
R = result["hull"].rotation[-1]
found = np.arctan2(R[:, 1, 0], R[:, 0, 0])
away = np.abs(np.linalg.norm(angular_momentum(result), axis=-1)).max()
spins = {name: WHEEL.inertia[2, 2] * result[name].omega[..., 2] for name in AXES}
print(f"turned about z by {np.degrees(found[0]):.3f}° … {np.degrees(found[-1]):.3f}°, "
      f"off by {np.degrees(np.abs(found - wanted).max()):.0e}° at worst")  # fmt: skip
print(f"total angular momentum {away:.0e} kg m²/s, of which a wheel had "
      f"{np.abs(spins['wheel_x']).max():.2f}")  # fmt: skip

figure, (momenta, turns) = plt.subplots(2, 1, figsize=(6.4, 7.4), layout="constrained")
t = result.t
for (name, spin), colour in zip(spins.items(), ("#0072B2", "#D55E00"), strict=True):
    momenta.plot(t, spin[:, -1], color=colour, label=name)
total = angular_momentum(result)[:, -1]
momenta.plot(t, np.linalg.norm(total, axis=-1), color="black", label="total of all bodies")
momenta.set(xlabel="t [s]", ylabel="angular momentum about its axis [kg m²/s]")
momenta.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
for k in range(0, len(wanted), 4):
    R = result["hull"].rotation[:, k]
    turns.plot(t, np.degrees(np.arccos(np.clip(R[:, 2, 2], -1, 1))), color="0.75", linewidth=0.8)
    angle = np.degrees(np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0])))
    turns.plot(t, angle, linewidth=1.2, color=plt.get_cmap("viridis")(k / len(wanted)))
turns.set(xlabel="t [s]", ylabel="turned about z [°]")
turns.set_title("grey: how far z is tilted", fontsize=10)
for axes in (momenta, turns):
    axes.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=110) if sys.argv[1:] else plt.show()

"""A free body turns over and over about its middle axis: angular velocities in body axes."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import lierb

moments = np.array([1.0, 2.0, 3.0])  # kg m²
body = lierb.Body(mass=1.0, inertia=moments)
flying = lierb.Problem(body, lierb.joints.free())

# one kinetic energy, 2 J, and starts all over its ellipsoid
towards = np.random.default_rng(3).normal(size=(48, 3))
towards /= np.linalg.norm(towards, axis=1, keepdims=True)
omega0 = np.sqrt(4.0 / moments) * towards
twist0 = np.hstack([omega0, np.zeros_like(omega0)])
run = lierb.integrate(flying, twist0=twist0, dt=5e-3, t_end=12.0, save_every=4, record="state")

# the momentum decides whether a body turns about axis 1 or axis 3; the separatrix is at √(2T·I₂)
momentum = np.linalg.norm(moments * omega0, axis=1)
separatrix = np.sqrt(4.0 * moments[1])

figure = plt.figure(figsize=(6.4, 4.6), layout="constrained")
ax = figure.add_subplot(projection="3d")
for k, path in enumerate(run.omega.swapaxes(0, 1)):
    ax.plot(*path.T, color="#D55E00" if momentum[k] < separatrix else "#0072B2", linewidth=1.1)
a, b, c = np.sqrt(4.0 / moments)
ax.set_box_aspect((a, b, c), zoom=0.95)
ax.set(xlim=(-a, a), ylim=(-b, b), zlim=(-c, c))
ax.set_xlabel("ω₁ [rad/s]")
ax.set_ylabel("ω₂ [rad/s]")
ax.set_zlabel("ω₃ [rad/s]", labelpad=10)
ax.locator_params(nbins=5)
ax.view_init(24, 36)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

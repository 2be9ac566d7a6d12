"""A heavy top on both c-spaces side by side, the gap of its joint magnified."""

import sys

import lierb

body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))  # kg, kg m²
pivot = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))  # m
top = lierb.Problem(body, pivot, gravity=(0.0, 0.0, -9.81))
twist0 = pivot.twist(omega=(6.28, 3.14, 0.63))
runs = [
    lierb.integrate(
        top, twist0=twist0, dt=5e-3, t_end=6.0, cspace=cspace, solver="saddle",
        save_every=5, record="state",
    )
    for cspace in ("SE3", "SO3xR3")
]  # fmt: skip
animation = lierb.animate(runs, magnify=1e4, title="heavy top, RK4, dt = 5 ms")

if sys.argv[1:]:
    animation.save(sys.argv[1])

"""Chebyshev's straight-line linkage, moving; the coupler's end leaves a trail."""

import sys

import lierb

Y = {"axis": (0.0, 1.0, 0.0)}
LENGTH = {"crank": 0.04, "coupler": 0.2, "rocker": 0.1}  # m; the base is 0.08 m
bar = {name: lierb.bodies.box((x, 0.012, 0.006), density=2700.0) for name, x in LENGTH.items()}


def pin(body, parent):
    return lierb.joints.revolute((body, 0.0, 0.0), parent_point=(parent, 0.0, 0.0), **Y)


linkage = lierb.Mechanism(
    links=[
        lierb.Link("crank", bar["crank"], pin(-0.02, 0.0)),
        lierb.Link("coupler", bar["coupler"], pin(-0.1, 0.02), "crank"),
        lierb.Link("rocker", bar["rocker"], pin(-0.05, 0.08)),
    ],
    loops=[lierb.Loop("pin", pin(0.0, 0.05), "coupler", "rocker")],
    gravity=(0.0, 0.0, -9.81),
    forces=lierb.forces.motor(speed=4.0).on("crank"),
)
pose0 = linkage.close(linkage.pose({"coupler": -1.2, "rocker": -1.7}))
twist0 = linkage.project(linkage.twist({}, pose0), pose0)
result = lierb.integrate(
    linkage, pose0=pose0, twist0=twist0, dt=1e-3, t_end=5.0, stabilise="project",
    save_every=10, record="state",
)  # fmt: skip
animation = result.animate(
    trail={"coupler": (0.1, 0.0, 0.0)}, title="Chebyshev's straight-line linkage"
)

if sys.argv[1:]:
    animation.save(sys.argv[1])

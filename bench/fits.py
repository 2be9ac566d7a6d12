"""Measure many fits side by side: the figures of docs/howto/fitting.md.

`python bench/fits.py` prints wall time and CPU time of each, and scatter over standard errors.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import lierb

INERTIA = np.array([[0.9, 0.05, -0.02], [0.05, 1.2, 0.03], [-0.02, 0.03, 1.5]])  # kg m²
SATELLITE = np.array([[4.20, 0.15, -0.10], [0.15, 3.60, 0.20], [-0.10, 0.20, 2.50]])  # kg m²
AXIS, MOST, PERIOD = np.array((0.48, 0.60, 0.64)), 0.5, 60.0  # of the wheel: –, N m s, s


def throws(count: int = 200) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Return arguments of `lierb.fits`: 34 numbers from four throws each, on a spring."""
    rng, throw_count = np.random.default_rng(0), 4
    spring = lierb.forces.spring_damper(
        body_point=(0.3, 0.1, 0.2), ground_point=(0.0, 0.0, 1.0), stiffness=4.0, damping=0.1,
        length=0.5,
    )  # fmt: skip

    def throw(mass: float, com: tuple[float, ...]) -> lierb.Problem:
        body = lierb.Body(mass, INERTIA, com=com)
        return lierb.Problem(body, lierb.joints.free(), (0.0, 0.0, -1.0), spring)

    twists, t = 0.5 * rng.standard_normal((throw_count, 6)), np.linspace(0.04, 4.0, 100)
    run = lierb.integrate(
        throw(10.0, (0.02, -0.01, 0.03)), twist0=twists, dt=2e-2, t_end=4.0, save_at=t,
        record="state",
    )  # fmt: skip
    sigma = {"omega": 2e-3, "pose": 1e-3}  # rad/s; rad and m
    poses = np.zeros((100, 1, throw_count, 4, 4))
    poses[..., :3, :3], poses[..., :3, 3] = run.rotation[:, None], run.position[:, None]
    poses[..., 3, 3] = 1.0
    shape = (100, count, throw_count)
    data = {
        "t": t,
        "omega": run.omega[:, None] + sigma["omega"] * rng.standard_normal((*shape, 3)),
        "pose": poses @ lierb.lie.se3.exp(sigma["pose"] * rng.standard_normal((*shape, 6))),
    }
    names = ["body.mass", "body.com", "body.inertia", "twist0"]
    guess = throw(10.5, (0.0, 0.0, 0.02))
    return (guess, data, names), {"sigma": sigma, "twist0": twists + 0.01, "dt": 2e-2}


@lierb.wrench(axis=(0.0, 0.0, 1.0), most=0.5, period=60.0)
def wheel(t, R, r, omega, v, params):
    phase = 2 * np.pi * t / params.period
    h = params.most * np.sin(phase) * params.axis
    dh = params.most * np.cos(phase) * 2 * np.pi / params.period * params.axis
    return -dh - np.cross(omega, h), np.zeros(3)


def tumbles(count: int = 10_000) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Return arguments of `lierb.fits`: inertia and start of satellites with a wheel."""
    rng = np.random.default_rng(1)

    def satellite(inertia: Any) -> lierb.Problem:
        turning = wheel(axis=AXIS, most=MOST, period=PERIOD)
        return lierb.Problem(lierb.Body(80.0, inertia), lierb.joints.free(), forces=turning)

    t, sigma = np.linspace(1.2, 120.0, 100), np.radians(0.02)
    twists = np.zeros((count, 6))
    twists[:, :3] = np.radians(np.array((3.0, -2.0, 4.0)) + rng.standard_normal((count, 3)))
    run = lierb.integrate(
        satellite(SATELLITE), twist0=twists, dt=0.3, t_end=120.0, save_at=t, record="state"
    )
    data = {"t": t, "omega": run.omega + sigma * rng.standard_normal(run.omega.shape)}
    arguments = satellite((4.0, 3.8, 2.3)), data, ["body.inertia", "omega0"]
    return arguments, {"sigma": {"omega": sigma}, "twist0": twists, "dt": 1.2}


def main() -> None:
    for case in (throws, tumbles):
        arguments, options = case()
        for _ in range(3):  # the first one compiles
            wall, cpu = time.perf_counter(), time.process_time()
            many = lierb.fits(*arguments, **options)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            print(f"{case.__name__}: {wall:.1f} s, {cpu:.1f} s of CPU")
        own = [name for name in many.parameters if name.startswith("body")]
        ratios = np.concatenate([many.ratio[name].ravel() for name in own])
        print(f"  {many.converged.sum()} of {len(many.converged)} have converged, "
              f"{many.iterations.mean():.2g} iterations, ratio {ratios.min():.3f} … "
              f"{ratios.max():.3f}")  # fmt: skip


if __name__ == "__main__":
    main()

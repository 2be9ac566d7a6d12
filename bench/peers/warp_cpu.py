"""NVIDIA Warp on the CPU: one thread a body, float64, the whole time loop in the kernel.

The CPU backend runs a launch serially; a second thread launches the other half of the tops.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec

import numpy as np

from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {"rk4": Form("reduced", 16384, "Warp on the CPU, RK4 on quaternions")}
# Fused multiply-adds: 35 % faster. Its SLP vectoriser slows a body down.
FLAGS = "-march=native -mllvm=-inline-threshold=9000 -ffp-contract=fast -fno-slp-vectorize"


def available() -> str:
    return "" if find_spec("warp") else "warp-lang is not installed"


def config() -> dict[str, object]:
    import warp

    return {"warp": warp.config.version, "cpu_compiler_flags": FLAGS, "precision": "float64"}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    wp, kernel = _kernel()
    # Axes, in the body and on the ground alike, along the principal ones about the pivot: the
    # inertia is diagonal, and R is still I at the start.
    inertia, axes = np.linalg.eigh(top.pivot_inertia())
    axes *= np.linalg.det(axes)
    centre = top.CENTRE @ axes
    steps = round(top.T_END / accuracy)
    launches, finals = [], []
    for part in np.array_split(omega0, threads):
        quaternion = wp.zeros(len(part), dtype=wp.quatd, device="cpu")
        omega = wp.zeros(len(part), dtype=wp.vec3d, device="cpu")
        start = wp.array(part @ axes, dtype=wp.vec3d, device="cpu")
        constants = (wp.vec3d(a) for a in (inertia, 1 / inertia, centre * top.MASS))
        launches.append(
            wp.launch(
                kernel, dim=len(part), device="cpu", record_cmd=True,
                inputs=[start, *constants, wp.vec3d(top.GRAVITY @ axes), top.T_END / steps, steps],
                outputs=[quaternion, omega],
            )
        )  # fmt: skip
        finals.append((quaternion.numpy(), omega.numpy()))  # views, without a copy
    pool = ThreadPoolExecutor(threads)

    def integrate() -> Final:
        list(pool.map(lambda launch: launch.launch(), launches))
        q, omega = map(np.concatenate, zip(*finals))
        twice = 2 * np.cross(q[:, :3], centre)
        turned = centre + q[:, 3:] * twice + np.cross(q[:, :3], twice)
        return Final(turned @ axes.T, omega @ axes.T)

    return integrate


@cache
def _kernel():
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR  # no banner on stdout, no warning that there is no GPU
    wp.config.cpu_compiler_flags = FLAGS
    quat, real, vec = wp.quatd, wp.float64, wp.vec3d

    @wp.func
    def slope(q: quat, w: vec, inertia: vec, inverse: vec, lever: vec, gravity: vec):
        torque = wp.cross(wp.cw_mul(inertia, w), w) + wp.cross(
            lever, wp.quat_rotate_inv(q, gravity)
        )
        return wp.cw_mul(inverse, torque)

    @wp.func
    def turn(q: quat, w: vec):
        return q * quat(w[0], w[1], w[2], real(0.0))  # twice the slope of q

    @wp.kernel(enable_backward=False)
    def rk4(
        start: wp.array(dtype=vec), inertia: vec, inverse: vec, lever: vec, gravity: vec,
        h: real, steps: int, quaternion: wp.array(dtype=quat), omega: wp.array(dtype=vec),
    ):  # fmt: skip
        i = wp.tid()
        two = real(2.0)
        half, sixth, quarter, twelfth = h / two, h / real(6.0), h / real(4.0), h / real(12.0)
        q = wp.quat_identity(dtype=real)
        w = start[i]
        for _ in range(steps):
            a1 = slope(q, w, inertia, inverse, lever, gravity)
            r1 = turn(q, w)
            q2, w2 = q + quarter * r1, w + half * a1
            a2 = slope(q2, w2, inertia, inverse, lever, gravity)
            r2 = turn(q2, w2)
            q3, w3 = q + quarter * r2, w + half * a2
            a3 = slope(q3, w3, inertia, inverse, lever, gravity)
            r3 = turn(q3, w3)
            q4, w4 = q + half * r3, w + h * a3
            a4 = slope(q4, w4, inertia, inverse, lever, gravity)
            r4 = turn(q4, w4)
            q += twelfth * (r1 + two * (r2 + r3) + r4)
            w += sixth * (a1 + two * (a2 + a3) + a4)
        quaternion[i] = wp.normalize(q)  # its length is off by less than the error of a step
        omega[i] = w

    return wp, rk4

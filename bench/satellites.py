"""Ten thousand satellites under sampled control with noise: `python bench/satellites.py`.

Each has moments of inertia, a pose and an angular velocity of its own, a PD controller at 10 Hz and
noise on its gyro; percentiles of the pointing error and of the speed are taken every second of
300 s. Beside it a loop as one writes it without controllers: `integrate` from tick to tick, NumPy
between the ticks. Both step by RK4 at the controller's period. It prints seconds, and whether
satellites that are integrated alone have the same bits; what was found is stored in bench/results.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import lierb

RESULTS = Path(__file__).parent / "results"
COUNT, T_END, EVERY = 10_000, 300.0, 0.1
SEED = 20261123
KP, KD, GYRO = 0.4, 4.0, 1e-3  # N m, N m s, rad/s
LEVELS = (5, 50, 95)
ALONE = (0, 17, 4711)  # satellites that are integrated again, on their own


def fleet(count: int) -> dict[str, np.ndarray]:
    """Moments kg m², rotation, ω rad/s, each of `count`."""
    rng = np.random.default_rng(SEED)
    moments = np.array((12.0, 15.0, 18.0)) * (1.0 + 0.05 * rng.standard_normal((COUNT, 3)))
    turns = lierb.lie.so3.exp(0.5 * rng.standard_normal((COUNT, 3)))
    omega = 0.02 * rng.standard_normal((COUNT, 3))
    return {"moments": moments[:count], "rotation": turns[:count], "omega": omega[:count]}


def off_axis(R: np.ndarray) -> np.ndarray:
    """(n, 3), sin of the angle times the axis by which R is turned."""
    skew = [R[:, i, j] - R[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return 0.5 * np.stack(skew, axis=1)


def percentiles(R: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """(2, levels): of the pointing error, rad, and of the speed, rad/s."""
    pointing = np.arctan2(np.linalg.norm(off_axis(R), axis=1), (np.trace(R.T).T - 1.0) / 2.0)
    return np.stack([np.percentile(x, LEVELS) for x in (pointing, np.linalg.norm(omega, axis=1))])


# ---- with a controller -------------------------------------------------------------------------


def controlled(count: int, which=slice(None)):
    """The lierb.Problem, its start, and the satellites' numbers."""

    @lierb.controller(every=EVERY, kp=KP, kd=KD, gyro=GYRO)
    def attitude(t, R, omega, params):
        error = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        rate = omega + params.gyro * lierb.noise.normal("gyro", 3)
        return {"torque": -(params.kp * error + params.kd * rate)}

    @lierb.wrench
    def thrusters(t, R, r, omega, v, params, controls):
        return controls.torque, (0.0, 0.0, 0.0)

    given = {name: array[which] for name, array in fleet(count).items()}
    held = lierb.joints.spherical()
    inertia = given["moments"][:, :, None] * np.eye(3)
    body = lierb.Body(np.full(len(given["omega"]), 100.0), inertia)
    problem = lierb.Problem(body, held, forces=[thrusters()], controllers=[attitude()])
    pose0 = np.tile(np.eye(4), (len(given["omega"]), 1, 1))
    pose0[:, :3, :3] = given["rotation"]
    start = {"pose0": pose0, "twist0": held.twist(omega=given["omega"])}
    return problem, start, np.arange(count)[which]


def by_controller(
    count: int, t_end: float, threads: int | None, which=slice(None)
) -> Callable[[], tuple[lierb.Result, np.ndarray]]:
    problem, start, numbers = controlled(count, which)
    seconds = np.arange(1.0, t_end + 0.5)

    def run():
        result = lierb.integrate(
            problem, **start, dt=EVERY, t_end=t_end, method="RK4", cspace="reduced",
            save_at=seconds, record=("state",), seed=SEED, trajectories=numbers, threads=threads,
            progress=False,
        )  # fmt: skip
        history, n = result.history, len(numbers)
        R = _rows(history["rotation"]).reshape(len(seconds), n, 3, 3)
        omega = _rows(history["omega"]).reshape(len(seconds), n, 3)
        return result, np.stack([percentiles(r, w) for r, w in zip(R, omega, strict=True)])

    return run


def _rows(column) -> np.ndarray:
    return column.combine_chunks().flatten().to_numpy()


# ---- the loop ----------------------------------------------------------------------------------


def by_loop(count: int, t_end: float, threads: int | None) -> Callable[[], np.ndarray]:
    given = fleet(count)
    held = lierb.joints.spherical()
    body = lierb.Body(np.full(count, 100.0), given["moments"])

    def run() -> np.ndarray:
        rng = np.random.default_rng(SEED)
        R, omega, rows = given["rotation"], given["omega"], []
        pose = np.tile(np.eye(4), (count, 1, 1))
        ticks = round(t_end / EVERY)
        for tick in range(ticks):
            rate = omega + GYRO * rng.standard_normal((count, 3))
            torque = -(KP * off_axis(R) + KD * rate)
            force = lierb.forces.constant_wrench(torque, frame="body")
            problem = lierb.Problem(body, held, forces=force)
            pose[:, :3, :3] = R
            summary = lierb.integrate(
                problem, pose0=pose, twist0=held.twist(omega=omega), dt=EVERY, t_end=EVERY,
                cspace="reduced", check="off", threads=threads, progress=False,
            ).summary  # fmt: skip
            R = _rows(summary["rotation"]).reshape(-1, 3, 3)
            omega = _rows(summary["omega"]).reshape(-1, 3)
            if (tick + 1) % round(1.0 / EVERY) == 0:
                rows.append(percentiles(R, omega))
        return np.stack(rows)

    return run


# ---- both --------------------------------------------------------------------------------------


def timed(run: Callable) -> tuple[float, object]:
    began = time.perf_counter()
    result = run()
    return time.perf_counter() - began, result


def same_alone(result: lierb.Result, count: int, t_end: float) -> bool:
    """Return whether a few satellites alone have the bits that they have in the batch."""
    which = np.array([i for i in ALONE if i < count])
    alone, _ = by_controller(count, t_end, 1, which)()
    return all(
        np.array_equal(
            _rows(alone.summary[name]).reshape(len(which), -1).view(np.int64),
            _rows(result.summary[name]).reshape(count, -1)[which].view(np.int64),
        )
        for name in ("rotation", "omega")
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--t-end", type=float, default=T_END)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--loop-only", action="store_true")
    given = parser.parse_args()
    results: dict[str, object] = {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": {k: v for k, v in lierb.info().items() if k != "cache"},
        "count": given.count, "t_end": given.t_end, "threads": given.threads,
    }  # fmt: skip
    by_loop(given.count, 1.0, given.threads)()  # compiles
    results["loop_s"], last = timed(by_loop(given.count, given.t_end, given.threads))
    print(f"loop of integrate(): {results['loop_s']:.2f} s; at the end {last[-1].tolist()}")
    if not given.loop_only:
        by_controller(given.count, 1.0, given.threads)()
        run = by_controller(given.count, given.t_end, given.threads)
        results["controller_s"], (result, last) = timed(run)
        results["same_bits_alone"] = same_alone(result, given.count, given.t_end)
        results["percentiles_at_the_end"] = last[-1].tolist()
        print(f"controller: {results['controller_s']:.2f} s; at the end {last[-1].tolist()}")
        print(f"the same bits alone: {results['same_bits_alone']}")
        stamp = str(results["time"]).replace(":", "")
        path = RESULTS / f"satellites-{stamp}-{results['machine']['cpu']}.json"
        path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(f"stored in {path}")


if __name__ == "__main__":
    main()

"""Work and precision of heavy tops: lierb, C++ and other libraries, from a stored run."""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

BENCH = Path(__file__).parents[2] / "bench" / "results"
STORED = json.loads((BENCH / "peers-2026-11-29T145243-znver5.json").read_text())
SHOWN = {  # by the names of the stored run: label, colour
    "cpp/reduced-quaternion": ("C++\nRK4", "0.2"),
    "lierb/reduced": ("lierb\nRK4", "#0072B2"),
    "lierb/reduced-dop853": ("lierb\nDOP853", "#56B4E9"),
    "jax_vmap/reduced-rows": ("JAX", "#E69F00"),
    "numpy_batch/reduced": ("NumPy", "#009E73"),
    "mujoco_rollout/many": ("MuJoCo", "#882255"),
    "scipy_ivp/reduced": ("SciPy", "#CC79A7"),
}

figure, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
for name, (label, colour) in SHOWN.items():
    points = [
        (p["cpu_s"] / p["bodies"] * 1e6, p["error_m"])
        for p in STORED["entries"][name]["curve"]
        if p["error_m"] > 0.0
    ]
    ax.loglog(*zip(*points, strict=True), "o-", color=colour, markersize=4)
    ax.annotate(label, min(points, key=lambda point: point[1]), xytext=(0, -6), va="top",
                textcoords="offset points", color=colour, weight="bold",
                ha="right" if label in ("C++\nRK4", "MuJoCo") else "left")  # fmt: skip
ax.set(xlabel="CPU time per body and simulated second [µs]", ylabel="error at 1 s [m]",
       xlim=(0.2, 4e4), ylim=(1e-16, 1e-4))  # fmt: skip
ax.spines[["top", "right"]].set_visible(False)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()

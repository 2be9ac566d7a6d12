"""Examples of mechanisms: each runs as it stands, and what it shows is true."""

from __future__ import annotations

import json
import runpy
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from cases import tiered
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

import lierb

FOLDER = Path(__file__).parent.parent / "examples" / "mechanisms"
REFERENCE = Path(__file__).parent / "mechanisms" / "reference.json"
NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))
QUICK = {"double_pendulum"}  # whose kernel other tests need as well


@cache
def example(name: str) -> dict:
    """Namespace of the script after its run."""
    import matplotlib.pyplot as plt

    matplotlib.use("Agg")
    try:
        return runpy.run_path(str(FOLDER / f"{name}.py"))
    finally:
        plt.close("all")


@pytest.mark.parametrize("name", tiered(NAMES, QUICK, ()))
def test_example_prints_and_draws(name):
    """And no trajectory of it fails."""
    script = example(name)
    assert script["result"].failed.size == 0
    assert all(axes.has_data() for axes in script["figure"].axes)


def test_double_pendulum_moves_as_lagrange_says():
    """Two rods of mass m and length l: M(θ) θ̈ = −C − G, θ from the vertical."""
    script = example("double_pendulum")
    m, l, g = 1.0, 0.5, 9.81
    own = float(script["ROD"].inertia[1, 1])

    def rate(_, y):
        a, b, u, w = y
        mixed = m * l * l / 2.0
        mass = [[own + 1.25 * m * l * l, mixed * np.cos(a - b)],
                [mixed * np.cos(a - b), own + 0.25 * m * l * l]]  # fmt: skip
        force = [-mixed * np.sin(a - b) * w * w - 1.5 * m * g * l * np.sin(a),
                 mixed * np.sin(a - b) * u * u - 0.5 * m * g * l * np.sin(b)]  # fmt: skip
        return [u, w, *np.linalg.solve(mass, force)]

    start = np.radians(130.0)
    ends = solve_ivp(rate, (0, 2), [start, start + 0.5, 0, 0], "DOP853", rtol=1e-12, atol=1e-13)
    a, b = ends.y[:2, -1]
    k = int(np.argmin(np.abs(script["t"] - 2.0)))
    # turned by +θ about y, what hangs along −z goes to −x
    expected = [-l * (np.sin(a) + np.sin(b)), 0.0, -l * (np.cos(a) + np.cos(b))]
    # RK4 at 1 ms, over 2 s of chaos
    np.testing.assert_allclose(script["tips"][k, 0], expected, rtol=0, atol=1e-6)
    assert 0.3 < 1.0 / script["rate"] < 0.8


@pytest.mark.long
def test_four_bar_is_where_circles_meet():
    """Two circles, round the crank's end and the rocker's pivot, meet where these bars do."""
    script = example("four_bar")
    t, length, ends = script["t"], script["length"], script["ends"]
    pose = script["pose0"]["crank"]
    first = np.arctan2(-pose[:, 2, 0], pose[:, 0, 0])  # about y, z → x
    angle = first + script["SPEED"] * t[:, None]
    heel = length["crank"][:, None] * np.stack([np.cos(angle), -np.sin(angle)], -1)
    base = np.stack([length["base"], 0.0 * length["base"]], -1)
    across = base - heel
    apart = np.linalg.norm(across, axis=-1)
    a, b = length["half"], length["rocker"]
    along = (apart**2 + a**2 - b**2) / (2.0 * apart)
    up = np.sqrt(a**2 - along**2)
    unit = across / apart[..., None]
    normal = np.stack([-unit[..., 1], unit[..., 0]], -1)
    knee = heel + along[..., None] * unit + up[..., None] * normal
    tip = heel + (length["coupler"] / length["half"])[:, None] * (knee - heel)
    # the motor's speed is kept by projection, its angle by RK4: 1e-13 rad
    np.testing.assert_allclose(ends[..., ::2], tip, rtol=0, atol=1e-11)
    assert script["result"].summary["energy_drift_max"].to_numpy().max() < 1e-9


@pytest.mark.long
def test_slider_is_a_rod_away_from_the_crank():
    script = example("slider_crank")
    crank, slider = script["result"]["crank"], script["result"]["slider"]
    B = crank.position[:, 0] + crank.rotation[:, 0] @ (0.0, 0.0, script["R"] / 2)
    x = B[:, 0] + np.sqrt(script["L"] ** 2 - B[:, 1] ** 2 - B[:, 2] ** 2)
    np.testing.assert_allclose(slider.position[:, 0, 0], x, rtol=0, atol=1e-13)
    opened = [run.summary["position_error_max"][0].as_py() for run in script["runs"].values()]
    assert opened[0] > 1e3 * opened[1] > 1e6 * opened[2]


@pytest.mark.long
def test_rssr_turns_where_the_rod_reaches_all_the_way():
    """A rod fits at a crank's angle if the rocker's circle has a point at that distance."""
    script = example("rssr")
    theta = np.linspace(0.0, 2.0 * np.pi, 2001)
    ends = script["CRANK"] * np.stack([np.cos(theta), np.sin(theta), 0.0 * theta], -1)
    phi = np.linspace(0.0, 2.0 * np.pi, 2001)[:, None]
    side = np.cross(script["AXIS"], (0.0, 1.0, 0.0))
    circle = script["PIVOT"] + script["ROCKER"] * (np.cos(phi) * (0, 1, 0) + np.sin(phi) * side)
    apart = np.linalg.norm(ends[:, None] - circle, axis=-1)
    shortest, longest = apart.min(axis=1).max(), apart.max(axis=1).min()
    fits = (shortest < script["LENGTHS"]) & (script["LENGTHS"] < longest)
    np.testing.assert_array_equal(script["runs"], fits)


@pytest.mark.long
def test_bricard_ends_where_its_benchmark_does():
    script = example("bricard")
    kept = json.loads(REFERENCE.read_text(encoding="utf-8"))["A04"]
    assert script["off"] < 1e-13  # of a closed form of which the integrator knows nothing
    for time, y in zip(("0.5", "1", "2", "10"), _states(kept), strict=True):
        k = int(np.argmin(np.abs(script["t"] - float(time))))
        a, b = y[:2]
        angles = [script["alpha"][k], script["beta"][k]]
        # RK4 at 1 ms is off by 1e-10 after 10 s
        np.testing.assert_allclose(
            angles, [np.pi / 2 - a - b, np.pi / 2 - a + b], rtol=0, atol=1e-8
        )


@pytest.mark.long
def test_windows_are_a_pendulum():
    """Of the closed form, at 201 times in 20 s: `test_looped_constraints` says why not less."""
    script = example("windows")
    assert script["off"] < 1e-8
    assert script["opened"] < 1e-12


def _states(kept) -> list[list[float]]:
    return [[float(x) for x in row] for row in kept["y"]]


@pytest.mark.long
def test_satellite_keeps_no_momentum_and_turns_as_it_should():
    script = example("reaction_wheels")
    assert script["away"] < 1e-13  # of wheels that have 0.3
    np.testing.assert_allclose(script["found"], script["wanted"], rtol=0, atol=1e-9)
    R = script["result"]["hull"].rotation[-1]
    np.testing.assert_allclose(R[:, 2, 2], 1.0, rtol=0, atol=1e-9)


@pytest.mark.long
def test_arm_comes_to_rest_where_its_energy_is_least():
    """Oracle: forward kinematics and potentials written here, a minimum by SciPy."""
    script = example("arm")

    def places(q):
        """Positions of all centres of mass, and of the flange."""
        T, centres = np.eye(4), []
        for angle, d, a, alpha, com in zip(
            q, script["D"], script["A"], script["ALPHA"], script["COM"]
        ):
            c, s, u, v = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
            T = T @ [
                [c, -s * u, s * v, a * c],
                [s, c * u, -c * v, a * s],
                [0, v, u, d],
                [0, 0, 0, 1],
            ]
            centres.append((T @ [*com, 1.0])[:3])
        return np.array(centres), T[:3, 3]

    for k in (0, 50):
        carried = script["PAYLOAD"][k] + 1e-3

        def energy(q, carried=carried):
            centres, flange = places(q)
            weight = 9.81 * (np.dot(script["MASS"], centres[:, 2]) + carried * flange[2])
            return weight + 0.5 * np.sum(script["STIFFNESS"] * (q - script["TARGET"]) ** 2)

        best = minimize(energy, script["TARGET"], method="BFGS", options={"gtol": 1e-7})
        # BFGS with finite differences finds the minimum to 1e-6 rad or so
        np.testing.assert_allclose(script["place"][-1, k], places(best.x)[1], rtol=0, atol=1e-6)


@pytest.mark.long
def test_humanoid_keeps_its_angular_momentum():
    """Springs in joints exert no moment about the centre of mass: the rest is the error of RK4."""
    found = example("humanoid")
    assert found["kept"] < 1e-7
    assert found["inertia"][:, -1].min() < 0.5 * found["inertia"][0, 0]
    np.testing.assert_allclose(found["inertia"][0], found["inertia"][0, 0], rtol=1e-12)
    half = lierb.integrate(
        found["divers"], pose0=found["pose0"], twist0=found["twist0"], dt=2.5e-4, t_end=1.2,
        save_every=40, record="state",
    )  # fmt: skip
    about = found["momentum"](half)[0]
    assert np.abs(about / about[0] - 1.0).max() < found["kept"] / 10

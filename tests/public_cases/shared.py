"""Mechanisms and closed forms that several of these files use."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

import numpy as np
from cases import integrate

import lierb


def summed(result: lierb.Result, name: str) -> np.ndarray:
    """A column of the summary, (n, …)."""
    return np.array(result.summary[name].to_pylist(), float)


def read_urdf(path: Path, text: str, **options) -> tuple[lierb.Mechanism, tuple[str, ...]]:
    """The mechanism of a URDF file with this text, and what its warning lists as left out."""
    path.write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mechanism = lierb.Mechanism.from_urdf(path, **options)
    return mechanism, caught[0].message.left_out if caught else ()


def urdf_link(name: str, mass: float = 1.0, moments=(0.02, 0.03, 0.04), xyz="0 0 0") -> str:
    """A link of a URDF file; `moments` are about its centre of mass, which is at xyz."""
    x, y, z = moments
    return f"""<link name="{name}"><inertial><origin xyz="{xyz}"/><mass value="{mass}"/>
      <inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def urdf_joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    """A joint of a URDF file."""
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
      {inside}</joint>"""


# ---- a slider-crank ----------------------------------------------------------------------------

CRANK, ROD = 0.1, 0.35  # m
CRANK_INERTIA = 0.004  # kg m², about its pivot; its centre of mass is there
ROD_MASS, ROD_INERTIA = 0.8, 0.009  # kg, kg m²
SLIDER_MASS = 1.3  # kg


@cache
def slider_crank() -> lierb.Mechanism:
    """A crank about e₃ at the origin, a rod on its end, and a slider along e₁ at the rod's end.

    Stretched along e₁ where all coordinates are 0: a dead point. No gravity.
    """
    thin = lambda mass, inertia: lierb.Body(mass, (0.6 * inertia, 0.7 * inertia, inertia))
    along = {"axis": (1.0, 0.0, 0.0), "ground_point": (CRANK + ROD, 0.0, 0.0)}
    revolute = lierb.joints.revolute
    return lierb.Mechanism(
        [
            lierb.Link("crank", thin(1.0, CRANK_INERTIA), revolute()),
            lierb.Link(
                "rod", thin(ROD_MASS, ROD_INERTIA),
                revolute((-ROD / 2, 0.0, 0.0), parent_point=(CRANK, 0.0, 0.0)), "crank",
            ),
            lierb.Link("slider", thin(SLIDER_MASS, 0.001), lierb.joints.prismatic(**along)),
        ],
        [lierb.Loop("pin", revolute(parent_point=(ROD / 2, 0.0, 0.0)), "slider", "rod")],
    )  # fmt: skip


# ---- stops --------------------------------------------------------------------------------------

INERTIA = 0.02  # kg m²
# SO(2) × R: mass 1 kg, and any inertia across the axis
WHEEL = lierb.Body(1.0, (0.015, 0.015, INERTIA))


def bounced(t, speed, lower, upper, frequency) -> tuple[np.ndarray, np.ndarray]:
    """Place and speed at t of what starts at 0 with a positive speed between two elastic stops.

    frequency : √(k/I), 1/s, of the oscillation in a stop, which is as long as half a period of it.
    """
    contact, flight = np.pi / frequency, (upper - lower) / speed
    # clock that shows 0 where the upper stop is met, and what a whole cycle takes
    clock = (t - upper / speed) % (2.0 * (contact + flight))
    sign = np.where(clock < contact + flight, 1.0, -1.0)  # 1: in the upper stop, or from it
    clock = np.where(clock < contact + flight, clock, clock - contact - flight)
    start = np.where(sign > 0.0, upper, lower)
    inside = clock < contact
    turn = frequency * clock
    place = np.where(inside, np.sin(turn) / frequency, contact - clock) * speed * sign + start
    rate = np.where(inside, np.cos(turn), -1.0) * speed * sign
    return place, rate


def wheels(speeds, lower, upper, stiffness, joint="revolute"):
    """Wheels at these speeds between these stops, or sliders: the problem, and its twist0."""
    held = lierb.joints.JOINTS[joint]()
    limit = lierb.forces.joint_limit if joint == "revolute" else lierb.forces.slide_limit
    stops = limit(lower=lower, upper=upper, stiffness=stiffness)
    twist0 = np.zeros((len(speeds), 6))
    twist0[:, 2 if joint == "revolute" else 5] = speeds
    return lierb.Problem(WHEEL, held, forces=stops), twist0


def angles_of(body) -> np.ndarray:
    """(times, n) about e₃, rad; of a result, or of a link's part of one."""
    return np.arctan2(body.rotation[..., 1, 0], body.rotation[..., 0, 0])


def assert_bounces(result, t, rtol, speeds, lower, upper, stiffness, inertia=INERTIA):
    """All go on bouncing: their energy, where they turn back, and where they are.

    A step that meets a stop crosses a kink, at which an estimate of its error is rough, and now and
    then small by chance. For each stop that is met nine of ten are to keep their energy to 600 rtol
    and all to 3e4 rtol, and all to 1 % on the whole: steps of 0.1 and 0.3 ms, short beside a
    contact, left 1 to 500 rtol, and 9500 once. What is off in energy shifts the phase, in
    proportion to the path.
    """
    count = result.summary.num_rows
    slides = inertia == WHEEL.mass
    place = result.position[..., 2] if slides else angles_of(result)
    rate = (result.v if slides else result.omega)[..., 2]
    frequency = np.sqrt(stiffness / inertia)
    met = 1.0 + t[-1] / ((upper - lower) / speeds + np.pi / frequency)  # stops
    assert result.summary["status"].to_pylist() == ["ok"] * count
    drift = summed(result, "energy_drift_max") / (0.5 * inertia * speeds**2)
    assert np.quantile(drift / met, 0.9) < 600.0 * rtol
    assert np.all(drift < np.minimum(3e4 * rtol * met, 1e-2))
    allowed = drift + 300.0 * rtol * met
    # ½ I ω² = ½ k δ²: as deep as its energy takes it, and no deeper
    deepest = speeds / frequency * (1.0 + allowed) + allowed
    assert np.all(place.max(axis=0) < upper + deepest)
    assert np.all(place.min(axis=0) > lower - deepest)
    right, right_rate = bounced(t[:, None], speeds, lower, upper, frequency)
    off = allowed * (1.0 + speeds * t[-1])
    np.testing.assert_array_less(np.abs(place - right).max(axis=0), off)
    # in a stop the speed changes by frequency · speed each second
    rate_off = np.abs(rate - right_rate).max(axis=0)
    np.testing.assert_array_less(rate_off, off * (speeds + frequency))


# ---- Cardan shafts -----------------------------------------------------------------------------

BEND = 0.5  # rad
SHAFT, MIDDLE = 0.003, 0.002  # kg m², each of a body for which all directions are alike
X, UP = np.array((1.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0))
LEAN = np.array((np.cos(BEND), np.sin(BEND), 0.0))
FORKS = {  # of a straight shaft, and of the bent one beside it
    "first": (UP, np.cross(UP, LEAN)),
    "second": (np.cross(UP, X), UP),
}


@cache
def cardan(branches: tuple[str, ...], closed_by: str) -> lierb.Mechanism:
    """Two parallel shafts along e₁, joined by bent ones that have a Cardan joint at each end.

    The bent shafts are at the same place; the first one's forks are in the plane of the bend, the
    second one's across it. All bodies are turned by R = I at first.

    closed_by : what of the first branch is the loop: the output's "bearing", or its "cross".
    """
    far, here = 0.3 * LEAN, np.zeros(3)
    straight, bent = lierb.Body(0.5, (SHAFT,) * 3), lierb.Body(0.4, (MIDDLE,) * 3)

    def crossed(on_body, on_parent, fork, parent_fork):
        frames = [np.eye(4), np.eye(4)]
        for frame, point in zip(frames, (on_body, on_parent), strict=True):
            frame[:3, :3] = np.stack([np.cross(fork, parent_fork), fork, parent_fork], 1)
            frame[:3, 3] = point
        return lierb.joints.universal(body_frame=frames[0], parent_frame=frames[1])

    bearing = lierb.joints.revolute(axis=X, ground_point=far)
    links = [lierb.Link("input", straight, lierb.joints.revolute(axis=X))]
    loops = []
    for name in branches:
        fork, own = FORKS[name]
        links.append(lierb.Link(name, bent, crossed(-far / 2, here, own, fork), "input"))
        if name == "first" and closed_by == "bearing":
            joint = crossed(here, far / 2, fork, own)
            links.append(lierb.Link("output", straight, joint, "first"))
            loops.append(lierb.Loop("bearing", bearing, "output"))
        else:
            joint = crossed(far / 2, here, own, fork)
            loops.append(lierb.Loop(f"{name}_cross", joint, name, "output"))
    if closed_by == "cross":
        links.append(lierb.Link("output", straight, bearing))
    return lierb.Mechanism(links, loops)


def assert_turns_by_cardan(machine: lierb.Mechanism, branches: tuple[str, ...]) -> None:
    """Turned freely, with all loops projected: tan θ = cos β tan φ for the first bent shaft.

    And tan θ = tan φ / cos β for the second one; the output turns as the input does, and ½ M(φ) φ̇²
    stays.
    """
    twist0 = machine.project(machine.twist({"input": np.array([15.0, -8.0])}))
    rates = machine.velocities(twist0)["input"][:, 0]
    result = integrate(
        machine, twist0=twist0, dt=5e-4, t_end=1.0, save_every=20, stabilise="project"
    )
    assert result.failed.size == 0
    R = result["input"].rotation
    phi = np.arctan2(R[..., 2, 1], R[..., 1, 1])
    # rounding, here and below
    np.testing.assert_allclose(result["output"].rotation, R, rtol=0, atol=1e-13)
    sin, cos, bent = np.sin(phi), np.cos(phi), np.cos(BEND)
    mass, start = np.full_like(phi, 2.0 * SHAFT), 2.0 * SHAFT
    for name, s, c in (("first", bent * sin, cos), ("second", sin, bent * cos)):
        if name in branches:
            turn = np.arctan2(s, c)[..., None]
            right = lierb.lie.so3.exp(turn * LEAN)
            np.testing.assert_allclose(result[name].rotation, right, rtol=0, atol=1e-13)
            mass += MIDDLE * (bent / (s * s + c * c)) ** 2
            start += MIDDLE * (bent if name == "first" else 1.0 / bent) ** 2  # at φ = 0
    # RK4 at 0.5 ms and 15 rad/s
    right = rates * np.sqrt(start / mass)
    np.testing.assert_allclose(result["input"].omega[..., 0], right, rtol=1e-9)

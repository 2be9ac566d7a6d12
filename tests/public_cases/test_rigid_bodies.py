"""Rackets, centres off the frame, tiny pendulums, long runs, a satellite with panels."""

from __future__ import annotations

from functools import cache

import mpmath
import numpy as np
import pytest
from cases import integrate, rotation
from clocks.shared import G, rows_of
from clocks.test_events import NEVER_TURNED, rate
from scipy.special import ellipk, ellipkinc

import lierb
from public_cases.shared import summed

# ---- c08: the racket that flips ----------------------------------------------------------------


def flips(moments, omega0, t_end) -> np.ndarray:
    """Times at which ω about the middle axis, e₂, crosses zero, by Jacobi's elliptic functions.

    ω₂ = peak · sn(rate (t − t₀), m), where the body turns about e₃ on the whole (2 T I₂ < L²).
    """
    a, b, c = moments
    spin = np.array(moments) * omega0
    twice, square = float(spin @ omega0), float(spin @ spin)
    assert a < b < c
    assert twice * b < square < twice * c
    least, most = square - twice * a, twice * c - square
    speed = np.sqrt((c - b) * least / (a * b * c))
    m = (b - a) * most / ((c - b) * least)
    first, peak = np.sqrt(most / (a * (c - a))), np.sqrt(most / (b * (c - b)))
    # ω₁ = first · cn, ω₂ = peak · sn, and ω₃ is positive as dn
    at = ellipkinc(np.arctan2(omega0[1] / peak, omega0[0] / first), m)
    assert omega0[2] > 0.0
    half = 2.0 * ellipk(m)
    found = (half * np.arange(-1, 2 + int(t_end * speed / half)) - at) / speed
    return found[(found > 0.0) & (found < t_end)]


@pytest.mark.parametrize(
    ("moments", "omega0"),
    [
        ((0.3, 0.5, 0.7), (1e-3, 2.0, 1e-3)),
        ((0.3, 0.5, 0.7), (-1e-4, 2.0, 1e-3)),
        ((0.013, 0.047, 0.057), (0.1, 5.0, 0.5)),
    ],
)
def test_c08_racket_flips_when_jacobi_says(moments, omega0):
    """Principia#2251, bepuphysics2#79, Genesis#3074, avian#993: no flip, or energy is lost."""
    omega0, t_end = np.array(omega0), 200.0
    problem = lierb.Problem(
        lierb.Body(1.0, moments), lierb.joints.free(), events=[NEVER_TURNED, rate(value=0.0)]
    )
    result = lierb.integrate(
        problem, twist0=(*omega0, 0.0, 0.0, 0.0), t_end=t_end, rtol=1e-13, method="DP54"
    )
    right = flips(moments, omega0, t_end)
    assert right.size >= 10
    # at the middle axis an error grows by e^(rate·t): 1e4 from one flip to the next one, and all
    # that is kept is energy and momentum; the time of a flip is their logarithm. 2e-7 s were found
    # for 59 of them
    np.testing.assert_allclose(rows_of(result.events, "t"), right, rtol=0, atol=1e-6)
    kinetic = 0.5 * float(np.array(moments) @ omega0**2)
    # rounding of some 1e5 steps
    assert summed(result, "energy_drift_max")[0] < 1e-10 * kinetic


# ---- c09: a centre of mass that is not the frame's origin --------------------------------------


def test_c09_centre_of_mass_flies_straight_whatever_the_frame():
    """newton#1366, newton#2682: it drifts when it is off the frame. Right: both momenta.

    Centres up to 5 m off a body of a few dm; RK4 at 1 ms, of turns of 0.4 … 4 rad/s.
    """
    centres = np.array([(0.0, 0.0, 0.0), (0.1, -0.05, 0.2), (1.0, 2.0, -0.5), (-5.0, 0.0, 0.1)])
    mass, moments = 2.0, np.diag((0.3, 0.4, 0.5))
    shift = [mass * (c @ c * np.eye(3) - np.outer(c, c)) for c in centres]
    body = lierb.Body(np.full(4, mass), moments + np.array(shift), centres)
    problem = lierb.Problem(body, lierb.joints.free())
    omega = np.array((0.4, -1.0, 2.0))
    velocity = np.array((0.3, 0.1, -0.2))  # of the centre of mass, at the start in body axes
    twist0 = np.concatenate(
        [np.broadcast_to(omega, (4, 3)), velocity - np.cross(omega, centres)], axis=1
    )
    result = integrate(problem, twist0=twist0, dt=1e-3, t_end=10.0)
    R = summed(result, "rotation").reshape(4, 3, 3)
    placed = summed(result, "position") + np.einsum("nij,nj->ni", R, centres)
    # the method's order, of a lever arm of 5 m, and rounding of 1e4 steps
    np.testing.assert_allclose(placed, centres + 10.0 * velocity, rtol=0, atol=1e-9)
    spin = np.einsum("nij,jk,nk->ni", R, moments, summed(result, "omega"))
    np.testing.assert_allclose(spin, np.broadcast_to(moments @ omega, (4, 3)), rtol=0, atol=1e-9)


def test_c09_so3xr3_refuses_a_centre_that_is_off():
    """newton#1366. There position is that of the frame, and a turn alone would move the centre."""
    body = lierb.Body(1.0, (0.5, 0.6, 0.7), com=(0.1, 0.0, 0.0))
    problem = lierb.Problem(body, lierb.joints.free())
    with pytest.raises(lierb.errors.LierbError, match=r"SO3xR3.*com|com.*SO3xR3"):
        lierb.integrate(problem, twist0=np.ones(6), dt=0.1, t_end=1.0, cspace="SO3xR3")


# ---- c10, c20: small ones ----------------------------------------------------------------------


@lierb.event(terminal=True)
def at_rest(omega):
    return omega[1]


@pytest.mark.slow
def test_c10_a_pendulum_has_its_period_whatever_its_size():
    """newton#2211, mujoco#1086: mm and grams are inflated or refused. 1 m to 1 µm, 1 kg to 1 ag.

    Right: half a period is 2 K(sin²(θ₀/2))/w. The last one is c20 (CodingTrain#533, drake#16992),
    a point mass: a sphere with 1e-12 of the inertia that its mass has about the pivot.
    """
    length = np.array([1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1.0])
    gyration = np.array([0.3] * 7 + [1e-6]) * length
    mass = length**3
    body = lierb.Body(mass, (mass * gyration**2)[:, None] * np.ones(3))
    points = length[:, None] * (0.0, 0.0, 1.0)
    held = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=points)
    problem = lierb.Problem(body, held, (0.0, 0.0, -G), events=at_rest())
    angle = 2.0
    result = lierb.integrate(
        problem, pose0=held.pose(coordinates=[angle]), twist0=np.zeros((8, 6)), t_end=5.0,
        rtol=1e-12, method="DP54",
    )  # fmt: skip
    quarter = float(mpmath.ellipk(mpmath.sin(angle / 2) ** 2))
    right = 2.0 * quarter * np.sqrt((length**2 + gyration**2) / (G * length))
    # 30 times rtol, and where the speed crosses zero the angle does not tell the time
    np.testing.assert_allclose(result.t, right, rtol=1e-10)


# ---- c42: inertia about which point ------------------------------------------------------------


@pytest.mark.slow
def test_c42_a_data_sheets_pendulum_has_its_period():
    """kdl_parser#39, IsaacLab#4162, trimesh#1640: inertia is taken about another point.

    A rod of 1 m on a pivot at its end, where its frame is. The data sheet's m L²/12 is about its
    centre. Right: half a period is 2 K(sin²(θ₀/2)) √(2 L / 3 g). About the frame m L²/12 would be
    too little for any body, and the refusal names the remedy.
    """
    mass, length, angle = 0.7, 1.0, 0.3
    across, along = mass * length**2 / 12.0, 1e-4
    sheet = {"mass": mass, "inertia": (across, across, along), "com": (0.0, 0.0, -length / 2)}
    with pytest.raises(lierb.errors.InertiaError, match='about="com"'):
        lierb.Body(**sheet)
    held = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    body = lierb.Body(**sheet, about="com")
    problem = lierb.Problem(body, held, (0.0, 0.0, -G), events=at_rest())
    result = lierb.integrate(
        problem, pose0=held.pose(coordinates=[angle]), twist0=np.zeros(6), t_end=5.0,
        rtol=1e-12, method="DP54",
    )  # fmt: skip
    quarter = float(mpmath.ellipk(mpmath.sin(angle / 2) ** 2))
    right = 2.0 * quarter * np.sqrt(2.0 * length / (3.0 * G))
    np.testing.assert_allclose(result.t, right, rtol=1e-10)  # as of c10


# ---- c21: two million steps --------------------------------------------------------------------


def test_c21_attitude_stays_a_rotation():
    """drake#14800, jaxsim#192, RocketPy#245: quaternions leave the sphere. Right: RᵀR = 1."""
    problem = lierb.Problem(lierb.Body(1.0, (0.3, 0.4, 0.5)), lierb.joints.free())
    twist0 = np.array([(1.0, 20.0, 0.5, 0.0, 0.0, 0.0), (3.0, -2.0, 5.0, 1.0, 2.0, 3.0)])
    result = integrate(problem, twist0=twist0, dt=1e-3, t_end=2000.0, measure_every=1000)
    R = summed(result, "rotation").reshape(2, 3, 3)
    # rounding of one product of matrices
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), [np.eye(3)] * 2, rtol=0, atol=1e-15)
    assert np.all(summed(result, "orthogonality_error_max") < 1e-14)


# ---- c58: a moving frame -----------------------------------------------------------------------

VELOCITIES = np.array(
    [(0.0, 0.0, 0.0), (7500.0, 0.0, 0.0), (0.0, -7500.0, 0.0), (4330.0, 4330.0, 4330.0)]
)


@pytest.mark.slow
def test_c58_a_free_body_turns_as_at_rest_at_orbital_speed():
    """newton#3868. Its frame is off its centre of mass, where ω × v and m v of the frame differ."""
    com = np.array([0.1, -0.05, 0.2])
    about = np.diag((30.0, 50.0, 70.0)) + 200.0 * (com @ com * np.eye(3) - np.outer(com, com))
    body = lierb.Body(200.0, about, com)
    problem = lierb.Problem(body, lierb.joints.free())
    twist0 = np.zeros((4, 6))
    twist0[:, :3], twist0[:, 3:] = (0.05, 0.3, -0.02), VELOCITIES
    result = lierb.integrate(problem, twist0=twist0, t_end=30.0, rtol=1e-9, max_steps=2000)
    assert result.summary["status"].to_pylist() == ["ok"] * 4
    steps, R = summed(result, "steps"), summed(result, "rotation").reshape(-1, 3, 3)
    # steps are chosen by relative errors, of v too, which is 1e4 times as large: no more of them
    assert np.all(steps <= 1.2 * steps[0] + 5)
    # 30 times rtol, of a rotation by 9 rad
    np.testing.assert_allclose(R, np.broadcast_to(R[0], R.shape), rtol=0, atol=30e-9 * 9)
    np.testing.assert_allclose(
        summed(result, "omega"), np.broadcast_to(summed(result, "omega")[0], (4, 3)), atol=30e-9
    )


@cache
def satellite(appendages: tuple[str, ...]) -> lierb.Mechanism:
    """A hub of 200 kg with sprung panels and a wheel, or some of them, in no field of gravity."""
    hinge = lambda side: lierb.joints.revolute(
        (-side * 0.9, 0.0, 0.0), parent_point=(side * 0.6, 0.0, 0.0), axis=(0.0, 1.0, 0.0)
    )
    panel, spring = lierb.Body(12.0, (1.0, 3.3, 4.3)), lierb.forces.torsional_spring
    bearing = lierb.joints.revolute(parent_point=(0.1, 0.05, -0.1))
    links = [
        lierb.Link("hub", lierb.Body(200.0, (30.0, 35.0, 40.0)), lierb.joints.free()),
        lierb.Link("left", panel, hinge(-1.0), "hub"),
        lierb.Link("right", panel, hinge(1.0), "hub"),
        lierb.Link("wheel", lierb.Body(8.0, (0.05, 0.05, 0.09)), bearing, "hub"),
    ]
    return lierb.Mechanism(
        [link for link in links if link.name in ("hub", *appendages)],
        forces=[
            spring(stiffness=15.0, damping=0.2).on(side) for side in appendages if side != "wheel"
        ],
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "appendages",
    [("left",), pytest.param(("left", "right", "wheel"), marks=pytest.mark.long)],
    ids=",".join,
)
def test_c58_a_satellite_moves_as_at_rest_at_orbital_speed(appendages):
    """newton#3868, Basilisk's hinged panels. 50 s, panels bent at first, the wheel at 60 rad/s."""
    machine, spin = satellite(appendages), rotation(0.3, -0.2, 0.5)
    bent, turning = {"left": 0.2, "right": -0.1}, {"wheel": 60.0} if "wheel" in appendages else {}
    pose0 = machine.pose({name: bent[name] for name in appendages if name in bent})
    for name, pose in pose0.items():
        pose0[name] = np.block([[spin, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]]) @ pose
    twists = [
        machine.twist({"hub": (0.02, 0.0, 0.1, *velocity), **turning}, pose0)
        for velocity in VELOCITIES
    ]
    twist0 = {name: np.stack([twist[name] for twist in twists]) for name in machine.names}
    result = lierb.integrate(
        machine, pose0=pose0, twist0=twist0, t_end=50.0, rtol=1e-9, max_steps=3000
    )
    assert result.summary["status"].to_pylist() == ["ok"] * 4
    steps = summed(result, "steps")
    assert np.all(steps <= 1.2 * steps[0] + 5)
    for name in machine.names:
        turn = 3000.0 if name == "wheel" else 6.0
        R = summed(result, f"{name}.rotation").reshape(-1, 3, 3)
        # 30 times rtol, and of the angle by which it has turned
        np.testing.assert_allclose(R, np.broadcast_to(R[0], R.shape), rtol=0, atol=30e-9 * turn)

"""The oracle against numbers of others, and against the laws that define what it computes."""

from itertools import permutations

import mpmath
import numpy as np
import oracle
import pytest
import reference_numbers as ref
from oracle import JOINT_ROWS, lie, mp

ANGLES = (1e-12, 1e-6, 1e-3, 0.1, 1.0, 3.0, 3.1415926, 6.28)
# mp errors are about 1e-80 times the size of the numbers and, near 2π, the condition of dexp (1e3)
MP_TOLERANCE = mp.mpf("1e-70")


def algebra_element(group: str, angle: float, seed: int = 1):
    """A random element whose rotation has the given angle."""
    x = np.random.default_rng(seed).normal(size=lie[group].dim)
    x[:3] *= angle / np.linalg.norm(x[:3])
    return x.tolist()


def size(matrix):
    return max(abs(x) for x in matrix)


def frame(point=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)) -> np.ndarray:
    """4x4 of a rotation vector and a point."""
    result = np.eye(4)
    result[:3, :3] = oracle.to_float(lie["so3"].exp(rotation))
    result[:3, 3] = point
    return result


# ---------------------------------------------------------------- groups


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("group", lie)
def test_dexp_is_the_derivative_of_exp(group, angle):
    G, X = lie[group], mp.matrix(algebra_element(group, angle))
    rate = mp.matrix(algebra_element(group, 1.0, seed=2))
    h = mp.mpf("1e-25")
    ahead, behind, here = (G.matrix(G.exp(X + s * rate)) for s in (h, -h, 0))
    spatial_velocity = G.vee((ahead - behind) / (2 * h) * mp.inverse(here))
    # central difference: h² = 1e-50 times a third derivative, for which 1e3 is ample
    assert size(G.dexp(X) * rate - spatial_velocity) < mp.mpf("1e-47")
    assert size(G.dexpinv(X) * spatial_velocity - rate) < mp.mpf("1e-44")  # condition of dexp: 1e3


@pytest.mark.parametrize("angle", [a for a in ANGLES if a < np.pi])
@pytest.mark.parametrize("group", lie)
def test_log_inverts_exp(group, angle):
    X = mp.matrix(algebra_element(group, angle))
    assert size(lie[group].log(lie[group].exp(X)) - X) < MP_TOLERANCE


@pytest.mark.parametrize("group", lie)
def test_log_is_principal(group):
    C = lie[group].exp(algebra_element(group, 6.28))
    X = lie[group].log(C)
    assert mp.norm(X[:3]) < mp.pi
    assert size(lie[group].exp(X) - C) < MP_TOLERANCE


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("group", lie)
def test_log_of_a_half_turn(group, axis):
    X = mp.zeros(lie[group].dim, 1)
    X[axis] = mp.pi
    log = lie[group].log(lie[group].exp(X))
    assert size(mp.matrix([abs(x) for x in log]) - X) < MP_TOLERANCE  # either sense is right


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("group", lie)
def test_Ad_of_exp_is_exp_of_ad(group, angle):
    G, X = lie[group], algebra_element(group, angle)
    assert size(G.Ad(G.exp(X)) - mp.expm(G.ad(X))) < MP_TOLERANCE


@pytest.mark.parametrize("group", lie)
def test_group_axioms(group):
    G = lie[group]
    A, B, C = (G.exp(algebra_element(group, 2.0, seed)) for seed in range(3))
    assert size(G.compose(A, G.compose(B, C)) - G.compose(G.compose(A, B), C)) < MP_TOLERANCE
    assert size(G.compose(A, G.inverse(A)) - mp.eye(A.rows)) < MP_TOLERANCE
    assert size(G.Ad(G.compose(A, B)) - G.Ad(A) * G.Ad(B)) < MP_TOLERANCE


def test_so3xr3_is_the_direct_product():
    X, G = algebra_element("so3xr3", 2.0), lie["so3xr3"]
    C = G.exp(X)
    R = lie["so3"].exp(X[:3])
    assert size(C[:3, :3] - R) < MP_TOLERANCE
    assert size(C[:3, 3] - mp.matrix(X[3:])) == 0
    Ad = mp.eye(6)
    Ad[:3, :3] = R
    assert size(G.Ad(C) - Ad) < MP_TOLERANCE
    assert size(G.ad(X)[3:, :]) == size(G.ad(X)[:, 3:]) == 0


def test_se3_translation_is_dexp_of_eta():
    X = algebra_element("se3", 2.0)
    translation = lie["so3"].dexp(X[:3]) * mp.matrix(X[3:])
    assert size(lie["se3"].exp(X)[:3, 3] - translation) < MP_TOLERANCE


def test_precision_of_the_caller_is_left_alone():
    lie["se3"].dexpinv([mpmath.mpf(0.5)] * 6)
    oracle.coefficients(1e-12)
    assert mpmath.mp.dps == 15


@pytest.mark.parametrize(("xi", "w", "expected"), ref.DEXPINV_SO3)
def test_dexpinv_so3_published(xi, w, expected):
    result = oracle.to_float(lie["so3"].dexpinv(xi) * mp.matrix(w))
    # computed by others in float64 and printed to 15 decimals: half a digit and two ulp
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-15)


# ---------------------------------------------------------------- coefficients


@pytest.mark.parametrize("angle", ANGLES)
def test_coefficients_are_those_of_dexp(angle):
    X = algebra_element("se3", angle)
    xi, eta = mp.matrix(X[:3]), mp.matrix(X[3:])
    x, y = lie["so3"].hat(xi), lie["so3"].hat(eta)
    c = {name: mp.mpf(value) for name, value in oracle.coefficients(mp.norm(xi)).items()}
    pitch = (xi.T * eta)[0]
    A = mp.eye(3) + c["a"] * x + c["b"] * x**2
    Q = c["a"] * y + c["b"] * (y * x + x * y) + pitch * (c["a1"] * x + c["b1"] * x**2)
    B = mp.eye(3) - x / 2 + c["c0"] * x**2
    U = -y / 2 + c["c0"] * (y * x + x * y) + pitch * c["c1"] * x**2
    for closed, exact in (((A, Q), lie["se3"].dexp(X)), ((B, U), lie["se3"].dexpinv(X))):
        for block, row in zip(closed, (0, 3)):
            difference = size(block - exact[row : row + 3, :3])
            # each coefficient is rounded once to float64 (half an ulp), and a few of them are added
            assert difference < 4e-16 * max(1, *(abs(v) for v in exact))


@pytest.mark.parametrize("angle", ANGLES)
def test_coefficients_are_their_series(angle):
    def series(first, factor=lambda k: 1):  # Σ factor(k) (−1)^k z^k / (2k + first)!, entire
        z = mp.mpf(angle) ** 2
        return mp.fsum(factor(k) * (-z) ** k / mp.factorial(2 * k + first) for k in range(80))

    with mp.workdps(150):
        exact = {"sinc": series(1), "a": series(2), "b": series(3)}
        even = lambda k: 2 * k + 2
        exact |= {"a1": -series(4, even), "b1": -series(5, even)}
        exact |= {"c0": -exact["a1"] / (2 * exact["a"]), "c1": series(6, even) / (2 * exact["a"])}
    # the series are exact to 100 digits here, so this is the rounding to float64
    assert oracle.coefficients(angle) == {name: float(value) for name, value in exact.items()}


def test_coefficients_at_zero_are_their_limits():
    limits = {"sinc": 1, "a": 1 / 2, "b": 1 / 6, "a1": -1 / 12, "b1": -1 / 60, "c0": 1 / 12}
    assert oracle.coefficients(0.0) == limits | {"c1": 1 / 360}


# ---------------------------------------------------------------- published discretisations


def rk4_step(rate, y, h):
    k1 = rate(y)
    k2 = rate(y + h / 2 * k1)
    k3 = rate(y + h / 2 * k2)
    k4 = rate(y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def test_rkmk4_step_on_rotation_vectors_published():
    inertia = mp.diag(ref.ROTATION_VECTOR_INERTIA)

    def rate(y):
        omega = y[3:]
        momentum = inertia * omega
        omega_rate = inertia**-1 * -(lie["so3"].hat(omega) * momentum)
        return mp.matrix([*(lie["so3"].dexpinv(-y[:3]) * omega), *omega_rate])

    G = lie["so3"]
    y = mp.matrix([0, 0, 0, *ref.ROTATION_VECTOR_OMEGA_0])
    y = rk4_step(rate, y, mp.mpf(ref.ROTATION_VECTOR_STEP))
    xi = G.log(G.compose(G.exp(ref.ROTATION_VECTOR_0), G.exp(y[:3])))
    xi *= 1 - 2 * mp.pi / mp.norm(xi)  # the published vector goes the long way round
    result = oracle.to_float(mp.matrix([*xi, *y[3:]]))
    expected = [*ref.ROTATION_VECTOR_1, *ref.ROTATION_VECTOR_OMEGA_1]
    # 15 decimals, computed in float64: two ulp of 6
    np.testing.assert_allclose(result, expected, rtol=0, atol=2e-15)


def test_rkmk4_of_the_heavy_top_published():
    arm, weight = np.array(ref.TOP_CENTRE_OF_MASS), ref.TOP_MASS * np.array(ref.TOP_GRAVITY)
    inertia = np.diag(ref.TOP_INERTIA) + ref.TOP_MASS * (np.eye(3) - np.outer(arm, arm))
    cross = oracle._cross
    bernoulli = (1 / 2, 1 / 12, 0, -1 / 720, 0, 1 / 30240, 0, -1 / 1209600)

    def rate(y):
        xi, omega = y[:3], y[3:]
        turned = R @ oracle.rotation_matrix(np.array([1, *(xi / 2 * tangent(xi))]))
        omega_rate = np.linalg.solve(
            inertia, cross(arm, turned.T @ weight) - cross(omega, inertia @ omega)
        )
        xi_rate, term = omega.copy(), omega
        for factor in bernoulli:  # dexpinv at −ξ by its series; |ξ| < 0.16 leaves less than 1e-16
            term = cross(xi, term)
            xi_rate += factor * term
        return np.concatenate([xi_rate, omega_rate])

    def tangent(xi):
        half = np.linalg.norm(xi) / 2
        return np.tan(half) / half if half else 1.0

    R, omega = np.eye(3), np.array(ref.TOP_OMEGA_0)
    for _ in range(2000):
        y = rk4_step(rate, np.concatenate([np.zeros(3), omega]), ref.TOP_RKMK4_STEP)
        R, omega = R @ oracle.rotation_matrix(np.array([1, *(y[:3] / 2 * tangent(y[:3]))])), y[3:]
    # rounding of 2000 steps: Exudyn's own versions of this number differ by 2e-12
    assert (R @ omega)[1] == pytest.approx(ref.TOP_RKMK4_SPATIAL_OMEGA_Y_2, rel=0, abs=1e-11)


# ---------------------------------------------------------------- trajectories


def box(joint, times, omega, gravity=0.0, orientation=(0.0, 0.0, 0.0)):
    omega = np.array(omega)
    return oracle.reference_trajectory(
        joint,
        times,
        mass=ref.BOX_MASS,
        inertia=ref.BOX_INERTIA,
        twist0=[*omega, *np.cross(ref.BOX_POINT, omega)],
        ground_frame=frame(rotation=orientation),
        body_frame=frame(ref.BOX_POINT, orientation),
        gravity=(0, 0, -gravity),
    )


def test_trajectory_of_the_box_on_a_spherical_joint():
    result = box("spherical", [1.0, 10.0], ref.BOX_SPHERICAL_OMEGA_0)
    # DOP853 at rtol 3e-14; the motion turns its errors into 1e-12 at t = 1 and 1e-10 at t = 10
    np.testing.assert_allclose(result.r[0], ref.BOX_SPHERICAL_R_1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(result.omega[0], ref.BOX_SPHERICAL_OMEGA_1, rtol=0, atol=2e-12)
    np.testing.assert_allclose(result.r[1], ref.BOX_SPHERICAL_R_10, rtol=0, atol=1e-11)
    np.testing.assert_allclose(result.omega[1], ref.BOX_SPHERICAL_OMEGA_10, rtol=0, atol=5e-10)


def test_trajectory_of_the_box_with_gravity():
    result = box("spherical", [10.0], ref.BOX_SPHERICAL_OMEGA_0, gravity=9.81)
    # this motion amplifies errors a thousandfold in 10 s
    np.testing.assert_allclose(result.r[0], ref.BOX_SPHERICAL_GRAVITY_R_10, rtol=0, atol=5e-10)


def test_trajectory_of_the_box_on_a_revolute_joint():
    # the joint's e3 along the body's e2
    result = box("revolute", [0.3, 10.0], ref.BOX_REVOLUTE_OMEGA_0, orientation=(-np.pi / 2, 0, 0))
    for t, R, r in zip(result.t, result.R, result.r):
        expected = frame(rotation=(0.0, 2 * np.pi * t, 0.0))[:3, :3]
        np.testing.assert_allclose(R, expected, rtol=0, atol=1e-11)  # ten turns at rtol 3e-14
        np.testing.assert_allclose(r, -expected @ ref.BOX_POINT, rtol=0, atol=1e-11)


def test_trajectory_of_the_heavy_top():
    omega = np.array(ref.TOP_OMEGA_0)
    point = -np.array(ref.TOP_CENTRE_OF_MASS)
    result = oracle.reference_trajectory(
        "spherical",
        [0.2, 1.0, 2.0],
        mass=ref.TOP_MASS,
        inertia=ref.TOP_INERTIA,
        twist0=[*omega, *np.cross(point, omega)],
        body_frame=frame(point),
        gravity=ref.TOP_GRAVITY,
    )
    # 24 turns a second: the phase error grows with the number of turns
    np.testing.assert_allclose(result.r[0], ref.TOP_R_02, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.r[1], ref.TOP_R_1, rtol=0, atol=2e-11)
    spatial_omega = result.R[2] @ result.omega[2]
    assert spatial_omega[1] == pytest.approx(ref.TOP_SPATIAL_OMEGA_Y_2, rel=0, abs=1e-10)
    published = result.r[1] - ref.TOP_CENTRE_OF_MASS
    np.testing.assert_allclose(published, ref.TOP_KYNEMA_DISPLACEMENT_1, rtol=0, atol=2e-7)


# Twists (Ω, u) in the joint frame that the closed joint allows (each column of the free directions)
FREE_DIRECTIONS = {
    "free": "w1 w2 w3 u1 u2 u3",
    "spherical": "w1 w2 w3",
    "revolute": "w3",
    "cylindrical": "w3 u3",
    "prismatic": "u3",
    "screw": "screw",
    "planar": "w3 u1 u2",
    "universal": "w2 w3",
    "pin_in_slot": "w3 u1",
    "pin_in_slot_body": "w3 u1",
    "planar_translation": "u1 u2",
    "translation": "u1 u2 u3",
    "helical_planar": "u1 u2 screw",
    "schoenflies": "w3 u1 u2 u3",
    "fixed": "",
    "point_on_line": "w1 w2 w3 u3",
    "point_on_plane": "w1 w2 w3 u1 u2",
    "point_on_sphere": "w1 w2 w3 u1 u2",
    "constant_velocity": "w1 w2",
}
DIRECTIONS = dict(zip(("w1", "w2", "w3", "u1", "u2", "u3"), np.eye(6)))
PITCH, LENGTH = 0.2, 0.6
DIRECTIONS["screw"] = np.array([0, 0, 1, 0, 0, PITCH])
GROUND_FRAME = frame((0.3, -0.2, 0.5), (0.4, -0.9, 0.7))
BODY_FRAME = frame((-0.15, 0.0375, 0.1), (-0.5, 0.3, 1.1))
INERTIA = np.array([[0.05, 0.004, -0.003], [0.004, 0.07, 0.006], [-0.003, 0.006, 0.09]])
MASS = 2.0
GRAVITY = np.array([1.0, -4.0, -8.0])
CALM = {"constant_velocity": 0.2}  # else it comes to where its shafts fold together


def moving(joint, times):
    """A body of full inertia on a joint of tilted frames, moving in every free direction."""
    calm = CALM.get(joint, 1.0)
    speeds = calm * np.random.default_rng(3).uniform(1.0, 3.0, 6)
    directions = [DIRECTIONS[name] for name in FREE_DIRECTIONS[joint].split()]
    relative = sum((s * d for s, d in zip(speeds, directions)), np.zeros(6))
    omega = BODY_FRAME[:3, :3] @ relative[:3]
    v = BODY_FRAME[:3, :3] @ relative[3:] + np.cross(BODY_FRAME[:3, 3], omega)
    return oracle.reference_trajectory(
        joint,
        times,
        mass=MASS,
        inertia=INERTIA,
        twist0=[*omega, *v],
        ground_frame=GROUND_FRAME,
        body_frame=BODY_FRAME,
        gravity=calm**2 * GRAVITY,
        pitch=PITCH,
        length=LENGTH if "rod" in JOINT_ROWS[joint] else 0.0,
    )


def joint_values(joint, R, r):
    """Values of the joint's rows by their definition on D = G⁻¹ C B = (Q, d)."""
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = R, r
    D = np.linalg.inv(GROUND_FRAME) @ C @ BODY_FRAME
    Q, d = D[:3, :3], D[:3, 3]
    angle = np.arctan2(Q[1, 0], Q[0, 0])
    remainder = d[2] - PITCH * angle
    remainder -= 2 * np.pi * PITCH * round(remainder / (2 * np.pi * PITCH))
    values = {f"d{i + 1}": d[i] for i in range(3)} | {"screw": remainder, "cross32": Q[2, 1]}
    values |= {f"slot{i + 1}": (Q.T @ d)[i] for i in range(3)}
    values |= {"rod": (d @ d - LENGTH**2) / (2 * LENGTH), "equal": (Q[1, 0] - Q[0, 1]) / 2}
    values |= {"turn1": Q[1, 2], "turn2": Q[0, 2], "turn3": Q[1, 0]}
    return np.array([values[name] for name in JOINT_ROWS[joint].split()])


@pytest.mark.parametrize("joint", JOINT_ROWS)
def test_trajectory_keeps_joint_and_energy(joint):
    result = moving(joint, [0.0, 0.5, 1.0])

    def energy(R, r, omega, v):
        weight = MASS * CALM.get(joint, 1.0) ** 2 * GRAVITY
        return 0.5 * (MASS * v @ v + omega @ INERTIA @ omega) - weight @ r

    states = list(zip(result.R, result.r, result.omega, result.v))
    for state in states:
        # nothing holds them but the accelerations: some 100 steps with rtol 3e-14, energy of 20 J
        np.testing.assert_allclose(joint_values(joint, *state[:2]), 0, atol=1e-13)
        assert energy(*state) == pytest.approx(energy(*states[0]), rel=0, abs=1e-12)


@pytest.mark.parametrize("joint", JOINT_ROWS)
def test_multipliers_balance_body_in_its_own_frame(joint):
    # M V̇ + Jᵀ λ = ad_Vᵀ M V + W in the body frame: J from differences of the rows along e_i of
    # se(3), V̇ from those of V in time. Turning rows: angular velocity in the body's joint frame.
    h = 1e-4
    before, now, after = 0.5 - h, 0.5, 0.5 + h
    result = moving(joint, [before, now, after])
    V = np.hstack([result.omega, result.v])
    R, r = result.R[1], result.r[1]
    M = np.block([[INERTIA, np.zeros((3, 3))], [np.zeros((3, 3)), MASS * np.eye(3)]])
    weight = MASS * CALM.get(joint, 1.0) ** 2 * GRAVITY
    W = np.concatenate([np.zeros(3), R.T @ weight])
    J = np.zeros((len(JOINT_ROWS[joint].split()), 6))
    for i in range(6):
        moved = []
        for sign in (1, -1):
            step = oracle.to_float(lie["se3"].exp(sign * h * np.eye(6)[i]))
            moved.append(joint_values(joint, R @ step[:3, :3], r + R @ step[:3, 3]))
        J[:, i] = (moved[0] - moved[1]) / (2 * h)
    for row, name in enumerate(JOINT_ROWS[joint].split()):
        if name.startswith("turn"):
            J[row] = [*BODY_FRAME[:3, int(name[-1]) - 1], 0, 0, 0]
    ad = oracle.to_float(lie["se3"].ad(V[1]))
    V_rate = (V[2] - V[0]) / (2 * h)
    balance = M @ V_rate + J.T @ result.multipliers[1] - ad.T @ M @ V[1] - W
    # central differences: h² = 1e-8 times third derivatives of V up to some hundred
    np.testing.assert_allclose(balance, 0, atol=2e-5)


def test_multipliers_of_the_pendulum():
    # axis e2: the joint's e3, by a quarter turn about e1; the body's centre of mass on its e1
    turn = (-np.pi / 2, 0, 0)
    mass, length, gravity = ref.PENDULUM_MASS, ref.PENDULUM_LENGTH, ref.PENDULUM_GRAVITY
    ground = frame(rotation=turn)
    result = oracle.reference_trajectory(
        "revolute",
        [0.4, 5.0],
        mass=mass,
        inertia=(0.2, ref.PENDULUM_INERTIA, 0.3),
        twist0=np.zeros(6),
        ground_frame=ground,
        body_frame=frame((-length, 0, 0), turn),
        gravity=(0, 0, -gravity),
    )
    for t, r, multipliers in zip(result.t, result.r, result.multipliers):
        exact = pendulum(t)
        np.testing.assert_allclose(r, (exact.x, 0, exact.z), rtol=0, atol=1e-12)  # rtol 3e-14
        sin, cos = np.sin(exact.angle), np.cos(exact.angle)
        angle_rate2 = -mass * gravity * length * sin / (ref.PENDULUM_INERTIA + mass * length**2)
        along, inward = np.array([cos, 0, sin]), np.array([-sin, 0, cos])
        acceleration = length * (angle_rate2 * along + exact.rate**2 * inward)
        force = mass * (acceleration + np.array([0, 0, gravity]))
        # the joint's force is −Jᵀλ, its rows the axes of the ground's joint frame; up to 30 N
        np.testing.assert_allclose(multipliers[:3], -ground[:3, :3].T @ force, rtol=0, atol=1e-11)


# ---------------------------------------------------------------- closed forms


def pendulum(t):
    return oracle.pendulum(
        t,
        mass=ref.PENDULUM_MASS,
        length=ref.PENDULUM_LENGTH,
        inertia=ref.PENDULUM_INERTIA,
        gravity=ref.PENDULUM_GRAVITY,
    )


def test_pendulum_numbers():
    state = pendulum(5.0)
    assert state.x == pytest.approx(ref.PENDULUM_X_5, rel=0, abs=6e-15)  # given to 14 decimals
    assert state.z == pytest.approx(ref.PENDULUM_Z_5, rel=0, abs=1e-16)  # cut after 16 decimals
    assert state.period == ref.PENDULUM_PERIOD  # given to more digits than float64 has


def test_pendulum_starts_at_rest_and_returns():
    start, later = pendulum(0.0), pendulum(pendulum(0.0).period)
    assert (start.x, start.z, start.rate) == pytest.approx((ref.PENDULUM_LENGTH, 0, 0), abs=1e-15)
    # the period is rounded to float64: half an ulp, 2e-16 s, at up to 5 rad/s²
    assert later[:4] == pytest.approx(start[:4], rel=0, abs=5e-15)


def test_axisymmetric_body_numbers():
    q, _ = oracle.torque_free_axisymmetric(ref.AXISYMMETRIC_INERTIA, ref.AXISYMMETRIC_OMEGA_0, 5.0)
    assert q[0] == pytest.approx(ref.AXISYMMETRIC_QUATERNION_5[0], rel=0, abs=6e-15)
    # given to 8 decimals
    np.testing.assert_allclose(q[1:], ref.AXISYMMETRIC_QUATERNION_5[1:], rtol=0, atol=6e-9)


def free_body(inertia, omega0, times):
    twist0 = [*omega0, 0, 0, 0]
    return oracle.reference_trajectory("free", times, mass=1.0, inertia=inertia, twist0=twist0)


def test_axisymmetric_body_moves_by_newton_and_euler():
    inertia, omega0 = (0.7, 0.7, 1.1), (0.9, -2.0, 1.5)
    result = free_body(inertia, omega0, [0.3, 2.0])
    for t, R, omega in zip(result.t, result.R, result.omega):
        q, exact = oracle.torque_free_axisymmetric(inertia, omega0, t)
        np.testing.assert_allclose(omega, exact, rtol=0, atol=1e-12)  # rtol 3e-14, some 100 steps
        np.testing.assert_allclose(R, oracle.rotation_matrix(q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize(
    "omega0",
    [(2.0, 0.3, -0.4), (0.5, 0.1, 3.0), (-0.2, 2.0, 0.3), (0.3, -2.0, -0.2), (0.0, 0.0, 2.0)],
)
def test_triaxial_body_moves_by_newton_and_euler(omega0, order):
    inertia = np.array([0.5, 0.8, 1.2])[list(order)]
    result = free_body(inertia, omega0, [0.7, 4.0])
    for t, omega in zip(result.t, result.omega):
        exact = oracle.torque_free_triaxial(inertia, omega0, t)
        # rtol 3e-14, some 100 steps, and up to e^4 near the unstable middle axis
        np.testing.assert_allclose(omega, exact, rtol=0, atol=5e-11)

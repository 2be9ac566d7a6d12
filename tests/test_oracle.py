"""The oracle against numbers of others, and against the laws that define what it computes."""

from itertools import permutations

import mpmath
import numpy as np
import oracle
import pytest
import reference_numbers as ref
from cases import slow_but
from oracle import JOINT_ROWS, lie, mp, row_jacobian, sizes_of
from scipy.special import fresnel

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


@pytest.mark.slow
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


@pytest.mark.slow
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


PITCH, LENGTH = 0.2, 0.6
GROUND_FRAME = frame((0.3, -0.2, 0.5), (0.4, -0.9, 0.7))
BODY_FRAME = frame((-0.15, 0.0375, 0.1), (-0.5, 0.3, 1.1))
INERTIA = np.array([[0.05, 0.004, -0.003], [0.004, 0.07, 0.006], [-0.003, 0.006, 0.09]])
MASS = 2.0
GRAVITY = np.array([1.0, -4.0, -8.0])


def moving(joint, times, **options):
    """A body of full inertia on a joint of tilted frames, moving in every free direction."""
    sizes = sizes_of(joint, pitch=PITCH, length=LENGTH)
    speeds = np.random.default_rng(3).uniform(1.0, 3.0, 6)
    held = row_jacobian(joint, frame((0, 0, sizes.get("length", 0.0))), **sizes)
    relative = speeds - np.linalg.pinv(held) @ (held @ speeds)
    return on_tilted_joint(joint, times, relative, gravity=GRAVITY, **sizes, **options)


def on_tilted_joint(joint, times, relative, **options):
    """One body; relative: its twist (Ω, u) in the joint frame at t = 0."""
    relative = np.asarray(relative, float)
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
        **options,
    )


def joint_values(joint, R, r):
    """Values of the joint's rows by their definition on D = G⁻¹ C B."""
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = R, r
    D = np.linalg.inv(GROUND_FRAME) @ C @ BODY_FRAME
    sizes = sizes_of(joint, pitch=PITCH, length=LENGTH)
    return np.array(oracle.row_values(joint, D, **sizes), dtype=float)


@pytest.mark.parametrize("joint", JOINT_ROWS)
def test_trajectory_keeps_joint_and_energy(joint):
    result = moving(joint, [0.0, 0.5, 1.0])

    def energy(R, r, omega, v):
        weight = MASS * GRAVITY
        return 0.5 * (MASS * v @ v + omega @ INERTIA @ omega) - weight @ r

    states = list(zip(result.R, result.r, result.omega, result.v))
    # nothing holds them but the accelerations: some 100 steps with rtol 3e-14, energy of 20 J;
    # where shafts fold together, their bisector loses a digit
    lost = 10 if joint == "constant_velocity" else 1
    for state, reported in zip(states, result.energy):
        np.testing.assert_allclose(joint_values(joint, *state[:2]), 0, atol=lost * 1e-13)
        assert energy(*state) == pytest.approx(energy(*states[0]), rel=0, abs=lost * 1e-12)
        assert reported == pytest.approx(energy(*state), rel=0, abs=1e-13)  # an ulp of 20: 4e-15


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
    weight = MASS * GRAVITY
    W = np.concatenate([np.zeros(3), R.T @ weight])
    J = np.zeros((len(JOINT_ROWS[joint].split()), 6))
    for i in range(6):
        moved = []
        for sign in (1, -1):
            step = oracle.to_float(lie["se3"].exp(sign * h * np.eye(6)[i]))
            moved.append(joint_values(joint, R @ step[:3, :3], r + R @ step[:3, 3]))
        J[:, i] = (moved[0] - moved[1]) / (2 * h)
    for row, name in enumerate(JOINT_ROWS[joint].split()):
        if name.startswith("Omega"):
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


# ---------------------------------------------------------------- forces

TIMES = [0.0, 0.3, 1.0]
POINT = np.array([0.2, -0.1, 0.3])  # of the body
ANCHOR = np.array([-0.4, 0.5, 0.2])  # of the ground
AXIS = BODY_FRAME[:3, 2]  # e3 of the joint, in the body
OFF_AXIS = np.cross(BODY_FRAME[:3, 3], AXIS)  # (its length) from the axis to the centre of mass
INERTIA_ABOUT_AXIS = AXIS @ INERTIA @ AXIS + MASS * OFF_AXIS @ OFF_AXIS
SPHERE = (0.3, 0.3, 0.3)
SPIN = np.array([1.2, -0.7, 0.9])


def in_space(force, **options):
    """A free body with three equal moments of inertia, at r = (1, 2, 3) and R not the identity."""
    options = {"inertia": SPHERE, "twist0": [*SPIN, 0.5, -1.0, 2.0]} | options
    pose = frame((1.0, 2.0, 3.0), (0.3, -0.8, 0.5))
    return oracle.reference_trajectory(
        "free", TIMES, mass=MASS, pose0=pose, forces=[force], **options
    )


def oscillation(t, inertia, damping, stiffness, x, rate):
    """x(t) and its rate of inertia x¨ + damping x˙ + stiffness x = 0, by its complex roots."""
    decay = damping / (2 * inertia)
    w = np.emath.sqrt(stiffness / inertia - decay**2)
    a, b = x, (rate + decay * x) / w
    fading, c, s = np.exp(-decay * t), np.cos(w * t), np.sin(w * t)
    return fading * (a * c + b * s), fading * ((b * w - decay * a) * c - (a * w + decay * b) * s)


def turn_about_axis(R):
    """Turn of the body's joint frame against the ground's, about e3."""
    D = GROUND_FRAME[:3, :3].T @ R @ BODY_FRAME[:3, :3]
    return np.arctan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1])


# length at rest, damping; where the spring's end is on the line on which the body's point moves
@pytest.mark.parametrize(
    ("rest", "damping", "start"),
    [(0.5, 0, 0.8), (0.5, 3, 0.8), (0, 3, 0), (0, 0, 0.1), (0.5, 60, 2)],
)
def test_spring_on_a_prismatic_joint_is_an_oscillator(rest, damping, start):
    stiffness, rate = 50.0, 0.7
    along = GROUND_FRAME[:3, 2]
    R0 = GROUND_FRAME[:3, :3] @ BODY_FRAME[:3, :3].T
    r0 = GROUND_FRAME[:3, 3] - R0 @ BODY_FRAME[:3, 3]
    anchor = r0 + R0 @ POINT - start * along
    force = oracle.spring_damper(POINT, anchor, stiffness, damping, rest)
    result = on_tilted_joint("prismatic", TIMES, [0, 0, 0, 0, 0, rate], forces=[force])
    for t, r, v, reaction in zip(result.t, result.r, result.v, result.reaction):
        x, x_rate = oscillation(t, MASS, damping, stiffness, start - rest, rate)
        # rtol 3e-14, at most some 100 steps; v up to 5 m/s
        np.testing.assert_allclose(r, r0 + (x + rest - start) * along, rtol=0, atol=1e-12)
        np.testing.assert_allclose(R0 @ v, x_rate * along, rtol=0, atol=1e-11)
        # along the free direction the joint has no force: m r̈ is the spring's; it holds the torque
        pull = -(stiffness * x + damping * x_rate) * AXIS
        held = -BODY_FRAME[:3, :3].T @ np.cross(POINT, pull)
        np.testing.assert_allclose(reaction, [*held, 0, 0, 0], rtol=0, atol=1e-9)  # of 100 N


def test_spring_without_length_moves_its_end_on_an_ellipse():
    stiffness = 30.0
    result = in_space(oracle.spring_damper((0, 0, 0), ANCHOR, stiffness))
    v0 = result.R[0] @ result.v[0]
    for t, r, omega in zip(result.t, result.r, result.omega):
        exact = oscillation(t, MASS, 0.0, stiffness, result.r[0] - ANCHOR, v0)[0]
        np.testing.assert_allclose(r - ANCHOR, exact, rtol=0, atol=1e-12)  # rtol 3e-14, 4 m
        np.testing.assert_allclose(omega, SPIN, rtol=0, atol=1e-13)  # a sphere's, untouched


def test_spring_at_rest_where_its_ends_meet_is_without_force():
    body = {"mass": MASS, "inertia": SPHERE, "twist0": np.zeros(6)}
    force = oracle.spring_damper((0, 0, 0), (0, 0, 0), 10.0, 1.0)
    result = oracle.reference_trajectory("free", TIMES, forces=[force], **body)
    assert not result.r.any()
    assert not result.energy.any()


@pytest.mark.parametrize("damping", [0.0, 0.3, 8.0])
@pytest.mark.parametrize("angle", [0.4, 3.0])  # from 3.0 it swings beyond π
def test_torsional_spring_on_a_revolute_joint_is_an_oscillator(angle, damping):
    stiffness, rate = 5.0, 1.5
    ground = GROUND_FRAME @ frame(rotation=(0, 0, -angle))  # φ = angle at t = 0
    R0 = GROUND_FRAME[:3, :3] @ BODY_FRAME[:3, :3].T
    pose = frame(GROUND_FRAME[:3, 3] - R0 @ BODY_FRAME[:3, 3])
    pose[:3, :3] = R0
    result = oracle.reference_trajectory(
        "revolute",
        TIMES,
        mass=MASS,
        inertia=INERTIA,
        twist0=[*(rate * AXIS), *(rate * OFF_AXIS)],
        ground_frame=ground,
        body_frame=BODY_FRAME,
        pose0=pose,
        forces=[oracle.torsional_spring(stiffness, damping, angle)],
    )
    for t, R, omega in zip(result.t, result.R, result.omega):
        x, x_rate = oscillation(t, INERTIA_ABOUT_AXIS, damping, stiffness, 0.0, rate)
        assert turn_about_axis(R) == pytest.approx(x, rel=0, abs=1e-12)  # rtol 3e-14, 100 steps
        np.testing.assert_allclose(omega, x_rate * AXIS, rtol=0, atol=1e-11)


def test_wrapped_is_in_its_interval():
    for angle in (-3.0, 0.0, 0.5, np.pi):
        assert oracle.wrapped(angle) == angle
        for turns in (-2, 1, 3):  # 2π times an integer has an error of an ulp of up to 20
            assert oracle.wrapped(angle + 2 * np.pi * turns) in (
                pytest.approx(angle, rel=0, abs=4e-15),
                pytest.approx(angle - 2 * np.pi, rel=0, abs=4e-15),
            )
    assert oracle.wrapped(-np.pi) == np.pi
    assert oracle.wrapped(np.nextafter(np.pi, 4)) < -3


@pytest.mark.parametrize(("linear", "quadratic"), [(3.0, 0.0), (0.0, 2.0), (3.0, 2.0)])
def test_drag_of_a_body_that_does_not_turn(linear, quadratic):
    # the "translation" joint holds the torque of a point away from the centre of mass
    velocity = np.array([1.0, -2.0, 2.0])
    force = oracle.drag(linear, quadratic, 5.0, POINT)
    result = on_tilted_joint("translation", TIMES, [0, 0, 0, *velocity], forces=[force])
    direction = GROUND_FRAME[:3, :3] @ velocity / 3
    a, b = linear / MASS, 3 * quadratic / MASS
    for t, R, r, v in zip(result.t, result.R, result.r, result.v):
        passed = -np.expm1(-a * t) / a if a else t
        speed = 3 * np.exp(-a * t) / (1 + b * passed)  # of v˙ = −a v − (b/3) v²
        way = 3 * (np.log1p(b * passed) / b if b else passed)
        # rtol 3e-14, some 100 steps
        np.testing.assert_allclose(R @ v, speed * direction, rtol=0, atol=1e-12)
        np.testing.assert_allclose(r - result.r[0], way * direction, rtol=0, atol=1e-12)


def test_drag_of_a_turning_body():
    angular = 0.4
    result = in_space(oracle.drag(angular=angular))
    expected = np.exp(-angular / SPHERE[0] * result.t)[:, None] * SPIN
    np.testing.assert_allclose(result.omega, expected, rtol=0, atol=1e-12)  # rtol 3e-14


@pytest.mark.parametrize(("linear", "quadratic"), [(3.0, 0.0), (0.0, 2.0)])
def test_drag_of_a_point_on_a_lever(linear, quadratic):
    rate = 2.0
    force = oracle.drag(linear, quadratic, 0.0, POINT)
    result = on_tilted_joint("revolute", TIMES, [0, 0, rate, 0, 0, 0], forces=[force])
    lever = np.linalg.norm(np.cross(AXIS, POINT - BODY_FRAME[:3, 3]))
    a = linear * lever**2 / INERTIA_ABOUT_AXIS
    b = quadratic * lever**3 / INERTIA_ABOUT_AXIS * rate
    for t, omega in zip(result.t, result.omega):
        expected = rate * np.exp(-a * t) / (1 + b * t)  # one of a and b is 0
        np.testing.assert_allclose(omega, expected * AXIS, rtol=0, atol=1e-12)  # rtol 3e-14


@pytest.mark.parametrize("joint", ["free", "universal", "cylindrical"])
def test_constant_force_at_the_centre_of_mass_is_a_weight(joint):
    extra = np.array([2.0, 3.0, -1.0])
    body = {"mass": MASS, "inertia": INERTIA, "twist0": np.zeros(6), "ground_frame": GROUND_FRAME}
    body |= {"body_frame": BODY_FRAME}
    force = oracle.constant_wrench(force=MASS * extra)
    pushed = oracle.reference_trajectory(joint, TIMES, gravity=GRAVITY, forces=[force], **body)
    heavier = oracle.reference_trajectory(joint, TIMES, gravity=GRAVITY + extra, **body)
    for name in ("R", "r", "omega", "v", "multipliers", "reaction", "energy"):
        # the same equations but for the order of a sum: rounding only, in some 100 steps
        expected = getattr(heavier, name)
        np.testing.assert_allclose(getattr(pushed, name), expected, rtol=0, atol=1e-11)


def test_constant_ground_wrench_changes_the_momenta():
    torque, push = np.array([0.3, -0.2, 0.4]), np.array([1.0, 2.0, -0.5])
    force = oracle.constant_wrench(torque, push)
    result = in_space(force, inertia=INERTIA)  # it tumbles
    angular = np.einsum("nij,jk,nk->ni", result.R, INERTIA, result.omega)
    linear = MASS * np.einsum("nij,nj->ni", result.R, result.v)
    for t, L, p, r in zip(result.t, angular, linear, result.r):
        # rtol 3e-14, some 100 steps, in numbers of about 1
        np.testing.assert_allclose(L, angular[0] + torque * t, rtol=0, atol=1e-12)
        np.testing.assert_allclose(p, linear[0] + push * t, rtol=0, atol=1e-12)
        exact = result.r[0] + (linear[0] * t + push * t**2 / 2) / MASS
        np.testing.assert_allclose(r, exact, rtol=0, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_constant_body_torque_spins_up_a_principal_axis(axis):
    inertia, torque = np.array([0.5, 0.8, 1.2]), 3.0 * np.eye(3)[axis]
    force = oracle.constant_wrench(torque, frame="body")
    result = in_space(force, inertia=inertia, twist0=np.zeros(6))
    for t, R, omega in zip(result.t, result.R, result.omega):
        rate = torque / inertia * t
        np.testing.assert_allclose(omega, rate, rtol=0, atol=1e-13)  # rtol 3e-14
        turn = frame(rotation=rate * t / 2)[:3, :3]
        np.testing.assert_allclose(R, result.R[0] @ turn, rtol=0, atol=1e-13)


def test_constant_body_force_off_the_centre_of_mass_draws_a_clothoid():
    # torque about e3 only: φ = ½ a t², and the force's direction turns with it
    push, lever, inertia3 = 4.0, 0.5, 0.6
    force = oracle.constant_wrench(force=(push, 0, 0), point=(0, -lever, 0), frame="body")
    result = in_space(force, inertia=(0.3, 0.4, inertia3), twist0=np.zeros(6))
    a = push * lever / inertia3
    for t, R, v in zip(result.t, result.R, result.v):
        sine, cosine = np.sqrt(np.pi / a) * np.array(fresnel(np.sqrt(a / np.pi) * t))
        turn = frame(rotation=(0, 0, a * t**2 / 2))[:3, :3]
        np.testing.assert_allclose(R, result.R[0] @ turn, rtol=0, atol=1e-12)  # rtol 3e-14
        exact = result.R[0] @ [push / MASS * cosine, push / MASS * sine, 0]
        np.testing.assert_allclose(R @ v, exact, rtol=0, atol=1e-12)


def test_ground_force_off_the_centre_of_mass_turns_a_pendulum():
    # a body held at its centre of mass and pulled down at a point: the physical pendulum of
    # that weight and no mass; axis e2 is the joint's e3
    pull, length, inertia = 7.0, 0.6, 0.3
    turn = frame(rotation=(-np.pi / 2, 0, 0))
    result = oracle.reference_trajectory(
        "revolute",
        TIMES,
        mass=MASS,
        inertia=(0.2, inertia, 0.25),
        twist0=np.zeros(6),
        ground_frame=turn,
        body_frame=turn,
        forces=[oracle.constant_wrench(force=(0, 0, -pull), point=(length, 0, 0))],
    )
    for t, R in zip(result.t, result.R):
        # m → 0 with m g = pull; 1e-30 kg are not felt
        exact = oracle.pendulum(
            t, mass=1e-30, length=length, inertia=inertia, gravity=mp.mpf(pull) * mp.mpf(10) ** 30
        )
        end = R @ [length, 0, 0]
        np.testing.assert_allclose(end, (exact.x, 0, exact.z), rtol=0, atol=1e-12)  # rtol 3e-14


def test_motor_torque_is_the_rate_of_the_angular_momentum():
    strength, w, rate = 1.7, 5.0, 0.6
    motor = oracle.motor_torque(lambda t: strength * np.cos(w * t))
    result = on_tilted_joint("revolute", TIMES, [0, 0, rate, 0, 0, 0], forces=[motor])
    for t, R, omega, reaction in zip(result.t, result.R, result.omega, result.reaction):
        impulse = strength / w * np.sin(w * t)
        expected = rate + impulse / INERTIA_ABOUT_AXIS
        # rtol 3e-14, some 100 steps, rates of up to 7 rad/s
        np.testing.assert_allclose(omega, expected * AXIS, rtol=0, atol=1e-12)
        angle = rate * t + strength / (w**2 * INERTIA_ABOUT_AXIS) * (1 - np.cos(w * t))
        assert turn_about_axis(R) == pytest.approx(oracle.wrapped(angle), rel=0, abs=1e-12)
        assert reaction[2] == pytest.approx(0, abs=1e-12)  # the joint itself turns freely


def test_wrench_is_given_what_it_is_said_to_be_given():
    # a damped isotropic oscillator about the anchor and a torque of the time, both in body axes
    stiffness, damping, strength = 30.0, 1.5, 0.8
    direction = np.array([0.6, 0.0, -0.8])

    def function(t, R, r, omega, v):
        torque = strength * np.cos(t) * direction - damping * omega
        return torque, -stiffness * R.T @ (r - ANCHOR) - damping * v

    result = in_space(oracle.wrench(function))
    decay = damping / SPHERE[0]
    v0 = result.R[0] @ result.v[0]
    for t, r, omega in zip(result.t, result.r, result.omega):
        exact = oscillation(t, MASS, damping, stiffness, result.r[0] - ANCHOR, v0)[0]
        np.testing.assert_allclose(r - ANCHOR, exact, rtol=0, atol=1e-12)  # rtol 3e-14, 4 m
        fading = np.exp(-decay * t)
        driven = (decay * np.cos(t) + np.sin(t) - decay * fading) / (1 + decay**2)
        exact = fading * SPIN + strength / SPHERE[0] * driven * direction
        np.testing.assert_allclose(omega, exact, rtol=0, atol=1e-12)


CONSERVATIVE = {
    "constant_wrench": oracle.constant_wrench(force=(3.0, -5.0, 2.0), point=POINT),
    "spring_damper": oracle.spring_damper(POINT, ANCHOR, 40.0, 0.0, 0.3),
    "torsional_spring": oracle.torsional_spring(2.0, 0.0, 0.5),
}


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_forces_are_the_slopes_of_their_potentials(name):
    force, h = CONSERVATIVE[name], 1e-5
    turned = GROUND_FRAME @ frame((0.3, 0.5, -0.2), (0, 0, 1.9)) @ np.linalg.inv(BODY_FRAME)
    here = oracle.State(
        0.0, turned[:3, :3], turned[:3, 3], SPIN, np.ones(3), GROUND_FRAME, BODY_FRAME
    )
    slopes = np.zeros(6)
    for i, direction in enumerate(np.eye(6)):
        for sign in (1, -1):
            step = sign * h * direction
            R = frame(rotation=step[:3])[:3, :3] @ here.R
            moved = here._replace(R=R, r=here.r + step[3:])
            slopes[i] += sign * force.potential(moved) / (2 * h)
    # central differences: h² = 1e-10 times third derivatives of up to 100, ulps of 10 J over h
    np.testing.assert_allclose(np.hstack(force(here)), -slopes, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("joint", "names"),
    [
        ("free", "constant_wrench spring_damper"),
        ("universal", "constant_wrench spring_damper"),
        ("point_on_line", "spring_damper"),
        ("cylindrical", "constant_wrench spring_damper torsional_spring"),
        ("schoenflies", "torsional_spring spring_damper"),
    ],
)
def test_energy_is_kept_by_conservative_forces(joint, names):
    forces = [CONSERVATIVE[name] for name in names.split()]
    result = moving(joint, [0.0, 0.2, 0.5], forces=forces)
    bare = moving(joint, [0.0])
    assert abs(bare.energy[0] - result.energy[0]) > 0.1  # potentials count
    # some 100 steps with rtol 3e-14, energies of up to 100 J
    np.testing.assert_allclose(result.energy, result.energy[0], rtol=0, atol=1e-11)


def _velocity(R, omega, v, point):
    return R @ (v + np.cross(omega, point))


TORQUE, PUSH = np.array([0.7, -0.4, 0.9]), np.array([2.0, 3.0, -1.0])


def _stretching(R, r, omega, v):
    s = r + R @ POINT - ANCHOR
    return s @ _velocity(R, omega, v, POINT) / np.linalg.norm(s)


def _power_of_drag(t, R, r, omega, v):
    speed = np.linalg.norm(_velocity(R, omega, v, POINT))
    return -0.9 * speed**2 - 0.7 * speed**3 - 0.2 * omega @ omega


# each force and its power, but for what its potential has, as a function of (t, R, r, ω, v)
WORKING = {
    "ground_torque": (
        oracle.constant_wrench(TORQUE, PUSH, POINT),
        lambda t, R, r, omega, v: TORQUE @ R @ omega,
    ),
    "body_wrench": (
        oracle.constant_wrench(TORQUE, PUSH, POINT, frame="body"),
        lambda t, R, r, omega, v: TORQUE @ omega + PUSH @ (v + np.cross(omega, POINT)),
    ),
    "spring_damper": (
        oracle.spring_damper(POINT, ANCHOR, 15.0, 1.5, 0.3),
        lambda t, R, r, omega, v: -1.5 * _stretching(R, r, omega, v) ** 2,
    ),
    "torsional_spring": (
        oracle.torsional_spring(2.0, 0.3, 0.5),
        lambda t, R, r, omega, v: -0.3 * (AXIS @ omega) ** 2,
    ),
    "drag": (oracle.drag(0.9, 0.7, 0.2, POINT), _power_of_drag),
    "motor_torque": (
        oracle.motor_torque(lambda t: 2 * np.sin(3 * t)),
        lambda t, R, r, omega, v: 2 * np.sin(3 * t) * AXIS @ omega,
    ),
    "wrench": (
        oracle.wrench(lambda t, R, r, omega, v: (np.cos(t) * TORQUE, t * PUSH + R.T @ r)),
        lambda t, R, r, omega, v: np.cos(t) * TORQUE @ omega + (t * PUSH + R.T @ r) @ v,
    ),
}
END = 0.25
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)
NODES, WEIGHTS = END / 2 * (1 + NODES), END / 2 * WEIGHTS


@pytest.mark.parametrize("name", WORKING)
def test_work_is_the_change_of_the_energy(name):
    force, power = WORKING[name]
    result = moving("cylindrical", [0.0, *NODES, END], forces=[force])
    states = zip(result.t, result.R, result.r, result.omega, result.v)
    powers = [power(*state) for state in states]
    work = WEIGHTS @ powers[1:-1]
    assert abs(work) > 1e-3
    # 20 Gauss points integrate polynomials of degree 39 exactly; rtol 3e-14, energies of 20 J
    assert result.energy[-1] - result.energy[0] == pytest.approx(work, rel=0, abs=1e-12)


# ---------------------------------------------------------------- prescribed speed, extra rows


def ramp(t):
    """Speed of a motor that swings, rad/s."""
    return 1.5 + 2 * np.sin(3 * t)


def ramp_rate(t):
    return 6 * np.cos(3 * t)


def test_speed_turns_a_revolute_joint_and_its_multiplier_is_the_torque():
    result = on_tilted_joint("revolute", TIMES, [0, 0, 1.5, 0, 0, 0], speed=(ramp, ramp_rate))
    assert result.multipliers.shape == (3, 6)
    for i, t in enumerate(result.t):
        # rtol 3e-14, some 100 steps
        np.testing.assert_allclose(result.omega[i], ramp(t) * AXIS, rtol=0, atol=1e-12)
        angle = 1.5 * t + 2 / 3 * (1 - np.cos(3 * t))
        turn = turn_about_axis(result.R[i])
        assert turn == pytest.approx(oracle.wrapped(angle), rel=0, abs=1e-12)
        torque = INERTIA_ABOUT_AXIS * ramp_rate(t)  # of the wrench −Jᵀλ on the body
        assert result.multipliers[i, 5] == pytest.approx(-torque, rel=0, abs=1e-12)
        assert result.reaction[i, 2] == pytest.approx(torque, rel=0, abs=1e-12)


def test_speed_by_a_motor_torque_of_the_same_size():
    start = [0, 0, 1.5, 0, 0, 0.3]
    options = {"gravity": GROUND_FRAME[:3, 2] * 3}  # along the axis: it does not turn the body
    motor = oracle.motor_torque(lambda t: INERTIA_ABOUT_AXIS * ramp_rate(t))
    driven = on_tilted_joint("cylindrical", TIMES, start, speed=(ramp, ramp_rate), **options)
    pushed = on_tilted_joint("cylindrical", TIMES, start, forces=[motor], **options)
    for name in ("R", "r", "omega", "v", "energy"):  # rtol 3e-14, some 100 steps
        expected = getattr(pushed, name)
        np.testing.assert_allclose(getattr(driven, name), expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(driven.multipliers[:, :4], pushed.multipliers, rtol=0, atol=1e-11)
    difference = driven.reaction - pushed.reaction
    difference[:, 2] -= INERTIA_ABOUT_AXIS * ramp_rate(driven.t)
    np.testing.assert_allclose(difference, 0, atol=1e-11)


@pytest.mark.parametrize("joint", ["free", "spherical", "cylindrical", "point_on_plane"])
def test_speed_is_kept_and_its_work_changes_the_energy(joint):
    start = moving(joint, [0.0]).omega[0] @ AXIS
    speed = (lambda t: start + np.sin(4 * t), lambda t: 4 * np.cos(4 * t))
    result = moving(joint, [0.0, *NODES, END], speed=speed)
    about_axis = result.omega @ AXIS
    # held by the acceleration only: rtol 3e-14, some 100 steps
    np.testing.assert_allclose(about_axis, speed[0](result.t), rtol=0, atol=1e-12)
    work = WEIGHTS @ (-result.multipliers[:, -1] * about_axis)[1:-1]
    assert abs(work) > 0.01
    # 20 Gauss points integrate polynomials of degree 39 exactly; rtol 3e-14, energies of 20 J
    assert result.energy[-1] - result.energy[0] == pytest.approx(work, rel=0, abs=1e-12)


def test_speed_that_the_body_does_not_start_with():
    with pytest.raises(AssertionError, match="speed"):
        on_tilted_joint("revolute", TIMES, np.zeros(6), speed=(ramp, ramp_rate))


def test_rod_rows_are_the_joint_point_on_a_sphere():
    rod = oracle.rod_rows(BODY_FRAME[:3, 3], GROUND_FRAME[:3, 3], LENGTH)
    joint = moving("point_on_sphere", TIMES)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = joint.R[0], joint.r[0]
    rows = oracle.reference_trajectory(
        "free",
        TIMES,
        mass=MASS,
        inertia=INERTIA,
        twist0=[*joint.omega[0], *joint.v[0]],
        pose0=pose,
        gravity=GRAVITY,
        extra_rows=rod,
    )
    for name in ("R", "r", "omega", "v", "multipliers", "energy"):
        expected = getattr(joint, name)  # the same equations: rounding only, in some 100 steps
        np.testing.assert_allclose(getattr(rows, name), expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(rows.reaction, 0, atol=1e-12)  # the joint "free" exerts nothing
    assert abs(joint.reaction).max() > 1


def test_newton_and_euler_hold_with_everything_at_once():
    # M V̇ = ad_Vᵀ M V + W of gravity, forces, rod and joint, V̇ from differences of V in time; the
    # wrenches of the forces by hand, of the rod by its multiplier, of the joint as reported
    h, now = 1e-4, 0.3
    start = moving("spherical", [0.0])
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = start.R[0], start.r[0]
    point = (C @ [*POINT, 1])[:3]
    # a rod whose ground end is where the body's point does not move towards it
    way = np.cross(start.R[0] @ (start.v[0] + np.cross(start.omega[0], POINT)), (0.3, 0.5, -0.4))
    rod_length = 0.7
    end = point - rod_length * way / np.linalg.norm(way)
    turning = start.omega[0] @ AXIS
    result = moving(
        "spherical",
        [now - h, now, now + h],
        forces=[
            oracle.constant_wrench(TORQUE, PUSH, POINT, frame="body"),
            oracle.drag(0.9, 0.0, 0.2, POINT),
            oracle.motor_torque(np.cos),
        ],
        extra_rows=oracle.rod_rows(POINT, end, rod_length),
        speed=(lambda t: turning + t, lambda t: 1.0),
    )
    assert result.multipliers.shape == (3, 5)
    V = np.hstack([result.omega, result.v])
    R, r, (omega, v) = result.R[1], result.r[1], np.split(V[1], 2)
    rod = r + R @ POINT - end
    assert rod @ rod == pytest.approx(rod_length**2, rel=0, abs=1e-12)  # rtol 3e-14
    assert omega @ AXIS == pytest.approx(turning + now, rel=0, abs=1e-12)
    M = np.block([[INERTIA, np.zeros((3, 3))], [np.zeros((3, 3)), MASS * np.eye(3)]])
    at_point = PUSH - 0.9 * (v + np.cross(omega, POINT))
    at_point = at_point - result.multipliers[1, 3] * R.T @ rod / rod_length
    torque = TORQUE - 0.2 * omega + np.cos(now) * AXIS + np.cross(POINT, at_point)
    force = MASS * R.T @ GRAVITY + at_point
    joint_torque, joint_force = np.split(result.reaction[1], 2)
    joint_torque, joint_force = BODY_FRAME[:3, :3] @ joint_torque, BODY_FRAME[:3, :3] @ joint_force
    torque = torque + joint_torque + np.cross(BODY_FRAME[:3, 3], joint_force)
    ad = oracle.to_float(lie["se3"].ad(V[1]))
    balance = (
        M @ (V[2] - V[0]) / (2 * h) - ad.T @ M @ V[1] - np.array([*torque, *force + joint_force])
    )
    # central differences: h² = 1e-8 times third derivatives of V up to some hundred
    np.testing.assert_allclose(balance, 0, atol=2e-5)
    # at the point of a spherical joint only the motor of the speed has a torque
    held = [0, 0, -result.multipliers[1, 4]]
    np.testing.assert_allclose(result.reaction[1, :3], held, rtol=0, atol=1e-11)  # of 10 N m


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
    slow_but(
        [(2.0, 0.3, -0.4), (0.5, 0.1, 3.0), (-0.2, 2.0, 0.3), (0.3, -2.0, -0.2), (0.0, 0.0, 2.0)],
        (2.0, 0.3, -0.4),
        (0.0, 0.0, 2.0),
    ),
)
def test_triaxial_body_moves_by_newton_and_euler(omega0, order):
    inertia = np.array([0.5, 0.8, 1.2])[list(order)]
    result = free_body(inertia, omega0, [0.7, 4.0])
    for t, omega in zip(result.t, result.omega):
        exact = oracle.torque_free_triaxial(inertia, omega0, t)
        # rtol 3e-14, some 100 steps, and up to e^4 near the unstable middle axis
        np.testing.assert_allclose(omega, exact, rtol=0, atol=5e-11)

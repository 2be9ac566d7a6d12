"""Joint frames, twists and rows, against their definitions in matrices.

Nothing here compiles: rows run as the plain Python that they are written in.
"""

import mpmath
import numpy as np
import oracle
import pytest
from cases import slow_but
from scipy.linalg import expm

import lierb
from lierb.kernels.mechanics.constraints import position_error_squared, rotation_error_squared
from lierb.kernels.mechanics.newton_euler import CSPACES, Parameters
from lierb.kernels.mechanics.rows import JOINT_ROWS, parameters_of
from lierb.model.joints.catalogue import from_rows
from lierb.model.joints.joint_type import JOINTS

mp = mpmath.mp.clone()
mp.dps = 50

BODY = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))

# Options without which an entry cannot be made.
OPTIONS = {"pitch": {"pitch": 0.13}, "length": {"length": 0.8}}

EVERY_JOINT = pytest.mark.parametrize("entry", JOINTS.values(), ids=JOINTS)
SUBGROUPS = pytest.mark.parametrize(
    "entry", [e for e in JOINTS.values() if e.subgroup], ids=lambda e: e.name
)

OTHERS = [e for e in JOINTS.values() if e.subgroup is None and len(e.rows) < 6]

# Freedoms of the motion groups (Müller, table 1; errata E16).
FREEDOMS = {
    "R": 1, "SO(2)": 1, "H_p": 1, "R²": 2, "SO(2)×R": 2, "R³": 3, "SO(3)": 3, "SE(2)": 3,
    "H_p⋉R²": 3, "SO(2)⋉R³": 4, "SE(3)": 6,
}  # fmt: skip


# ---------------------------------------------------------------- helpers


def rotation(rng):
    """A random rotation matrix, by QR: nothing of the library's."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def pose_of(R, r):
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = R, r
    return C


def random_pose(rng):
    return pose_of(rotation(rng), rng.normal(size=3))


def turn_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turn_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def twist_matrix(X):
    """The 4×4 matrix whose exponential is the screw motion X = (ξ, η)."""
    return np.array(
        [[0, -X[2], X[1], X[3]], [X[2], 0, -X[0], X[4]], [-X[1], X[0], 0, X[5]], [0] * 4]
    )


def make(entry, **frames):
    """The joint of a catalogue entry, with the options that it must have."""
    options = {}
    for option in entry.options:
        options |= OPTIONS.get(option, {})
    return entry(**frames, **options)


def tilted(entry, rng):
    return make(entry, body_frame=random_pose(rng), ground_frame=random_pose(rng))


def pose_tuple(C):
    return tuple(C[:3, :3].reshape(-1).tolist()), tuple(C[:3, 3].tolist())


def parameters(joint):
    """Arguments of formulas, in plain floats."""
    return Parameters(
        mass=float(BODY.mass),
        inertia=tuple(BODY.inertia.reshape(-1).tolist()),
        com=(0.0, 0.0, 0.0),
        gravity=(0.0, 0.0, 0.0),
        ground=pose_tuple(joint.ground_frame),
        body=pose_tuple(joint.body_frame),
        pitch=float(joint.pitch),
        length=float(joint.length),
    )


def kinematics(cspace, joint, C, twist):
    """Kinematics of rows, and the velocity on which J acts."""
    space, p = CSPACES[cspace], parameters(joint)
    body = space.body(p)
    placed, velocity = space.to_joint_axes(p, pose_tuple(C), tuple(map(float, twist)))
    return space.kinematics(body, placed, velocity), np.array(velocity, dtype=float)


def numbers(row):
    """Structural zeros as 0."""
    return np.array([x if isinstance(x, float) else 0.0 for x in row], dtype=float)


def jacobian_of(joint, x):
    rows = [numbers(r.jacobian(x, parameters(joint))) for r in joint.rows]
    return np.array(rows).reshape(-1, 6)


def relative_pose(joint, C):
    """D = G⁻¹CB, by NumPy's matrix product and inverse."""
    return np.linalg.inv(joint.ground_frame) @ C @ joint.body_frame


# All rows that can be looked at alone.
PRIMITIVES = [n for n, row in JOINT_ROWS.items() if row.has_value and not row.objection((row,))]
EVERY_CSPACE = pytest.mark.parametrize("cspace", CSPACES)

# Rounding of a handful of products of numbers of size 1 to 20; a wrong sign or a missing term is
# larger by ten orders.
ROUNDING = 1e-13


# ---------------------------------------------------------------- frames: short form


def test_point_moves_both_frames_apart_from_their_axes():
    joint = lierb.joints.spherical(body_point=(1.0, 2.0, 3.0), ground_point=(4.0, 5.0, 6.0))
    np.testing.assert_array_equal(joint.body_frame[:3, 3], (1.0, 2.0, 3.0))
    np.testing.assert_array_equal(joint.ground_frame[:3, 3], (4.0, 5.0, 6.0))
    np.testing.assert_array_equal(joint.body_frame[:3, :3], joint.ground_frame[:3, :3])


def test_default_frame_is_the_body_frame():
    np.testing.assert_array_equal(lierb.joints.revolute().body_frame, np.eye(4))


# The first coordinate axis whose |cos| with e₃ is below 0.9: x, unless e₃ is near it.
DEFAULT_E1 = [
    ((0, 0, 1), (1, 0, 0)),
    ((0, 0, -1), (1, 0, 0)),
    ((0, 1, 0), (1, 0, 0)),
    ((0, -2, 0), (1, 0, 0)),
    ((1, 0, 0), (0, 1, 0)),
    ((-3, 0, 0), (0, 1, 0)),
    ((0.89, 0, np.sqrt(1 - 0.89**2)), (1, 0, 0)),
    ((0.91, 0, np.sqrt(1 - 0.91**2)), (0, 1, 0)),
    ((-0.91, np.sqrt(1 - 0.91**2), 0), (0, 1, 0)),
    ((1, 1, 1), (1, 0, 0)),
]


@pytest.mark.parametrize(("axis", "chosen"), DEFAULT_E1)
def test_axis_default_e1_is_the_first_coordinate_axis_that_fits(axis, chosen):
    e1, e2, e3 = lierb.joints.revolute(axis=axis).body_frame[:3, :3].T
    unit = np.array(axis) / np.linalg.norm(axis)
    expected = chosen - np.dot(chosen, unit) * unit
    # 4e-16: two roundings in a normalised vector
    np.testing.assert_allclose(e3, unit, rtol=0, atol=4e-16)
    np.testing.assert_allclose(e1, expected / np.linalg.norm(expected), rtol=0, atol=1e-15)
    np.testing.assert_allclose(e2, np.cross(e3, e1), rtol=0, atol=4e-16)


def test_axis_length_does_not_matter():
    one = lierb.joints.revolute(axis=(1.0, 2.0, -2.0)).body_frame
    # powers of two change no bit of a quotient
    np.testing.assert_array_equal(one, lierb.joints.revolute(axis=(4.0, 8.0, -8.0)).body_frame)


def test_slot_is_e1_of_the_ground_frame():
    joint = lierb.joints.pin_in_slot(axis=(0, 1, 0), slot=(3.0, 0.0, 4.0))
    e1, e2, e3 = joint.ground_frame[:3, :3].T
    np.testing.assert_allclose(e1, (0.6, 0.0, 0.8), rtol=0, atol=2e-16)  # one rounding
    np.testing.assert_array_equal(e3, (0, 1, 0))
    np.testing.assert_allclose(e2, (0.8, 0.0, -0.6), rtol=0, atol=2e-16)  # e₃ × e₁


def test_second_axis_is_e2_of_the_body_frame():
    joint = lierb.joints.universal(axis=(0, 0, 1), second_axis=(0.0, 5.0, 0.0))
    np.testing.assert_array_equal(joint.body_frame[:3, :3], np.eye(3))
    tilted_joint = lierb.joints.universal(axis=(1, 0, 0), second_axis=(0, 0.6, 0.8))
    np.testing.assert_allclose(tilted_joint.body_frame[:3, 1], (0, 0.6, 0.8), rtol=0, atol=4e-16)
    np.testing.assert_allclose(tilted_joint.body_frame[:3, 2], (1, 0, 0), rtol=0, atol=4e-16)


def test_slot_slightly_aslant_gives_an_orthogonal_frame():
    # within the tolerance of 1e-9 it is straightened, not copied
    R = lierb.joints.pin_in_slot(slot=(1.0, 0.0, 5e-10)).body_frame[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=1e-15)


@EVERY_JOINT
def test_short_form_closes_with_the_body_unturned(entry):
    joint = make(entry, body_point=(0.3, -0.2, 0.5), ground_point=(1, 2, 3), axis=(1.0, -2.0, 0.5))
    C = joint.closed_pose
    # a product of a rotation and its transpose, and one subtraction of points
    np.testing.assert_allclose(C[:3, :3], np.eye(3), rtol=0, atol=4e-16)
    along = joint.length * np.array((1.0, -2.0, 0.5)) / np.sqrt(5.25)  # of a rod
    np.testing.assert_allclose(C[:3, 3], np.add((1, 2, 3), along) - (0.3, -0.2, 0.5), atol=2e-15)


def test_short_form_equals_its_own_frames():
    short = lierb.joints.pin_in_slot((0.1, 0.2, 0.3), (1, 0, 0), axis=(1, 1, 0), slot=(1, -1, 3))
    long = lierb.joints.pin_in_slot(body_frame=short.body_frame, ground_frame=short.ground_frame)
    np.testing.assert_array_equal(long.body_frame, short.body_frame)
    np.testing.assert_array_equal(long.closed_pose, short.closed_pose)


def test_ground_frame_alone_is_kept_and_closes():
    G = random_pose(np.random.default_rng(1))
    joint = lierb.joints.revolute(body_point=(0.1, 0.2, 0.3), axis=(0, 1, 1), ground_frame=G)
    np.testing.assert_array_equal(joint.ground_frame, G)
    # the closed pose takes the joint frame of the body to that of the ground
    np.testing.assert_allclose(joint.closed_pose @ joint.body_frame, G, rtol=0, atol=1e-15)


@EVERY_JOINT
def test_closed_pose_makes_the_joint_frames_coincide(entry):
    joint = tilted(entry, np.random.default_rng(2))
    D = relative_pose(joint, joint.closed_pose)
    # 4×4 products and an inverse; the other end of a rod is up its e₃
    np.testing.assert_allclose(D, pose_of(np.eye(3), (0, 0, joint.length)), rtol=0, atol=2e-15)


def test_frames_from_scipy_equal_those_from_matrices():
    transform = pytest.importorskip("scipy.spatial.transform")
    B, G = (random_pose(np.random.default_rng(i)) for i in (3, 4))
    given = [transform.RigidTransform.from_matrix(X) for X in (B, G)]
    joint = lierb.joints.revolute(body_frame=given[0], ground_frame=given[1])
    # SciPy re-orthonormalises what it is given: a few roundings
    np.testing.assert_allclose(joint.body_frame, B, rtol=0, atol=2e-15)
    np.testing.assert_allclose(joint.ground_frame, G, rtol=0, atol=2e-15)


# ---------------------------------------------------------------- frames: batches

AXES = np.array([(0, 0, 1), (1, 0, 0), (1, 1, 1), (0.95, 0.1, 0.2), (0, -1, 3)], dtype=float)
POINTS = np.linspace(-1.0, 1.0, 15).reshape(5, 3)


@pytest.mark.parametrize("points", [POINTS, POINTS[0]], ids=["a point each", "one point"])
def test_batched_axes_give_each_body_the_bits_that_it_has_alone(points):
    together = lierb.joints.revolute(points, ground_point=2 * points, axis=AXES)
    for i, axis in enumerate(AXES):
        point = points[i] if points.ndim > 1 else points
        alone = lierb.joints.revolute(point, ground_point=2 * point, axis=axis)
        np.testing.assert_array_equal(together.body_frame[i], alone.body_frame)
        np.testing.assert_array_equal(together.ground_frame[i], alone.ground_frame)
        np.testing.assert_array_equal(together.closed_pose[i], alone.closed_pose)


def test_batched_points_alone_give_batched_frames():
    joint = lierb.joints.spherical(body_point=POINTS)
    assert joint.body_frame.shape == joint.closed_pose.shape == (5, 4, 4)


def test_batched_slots_and_pitches_are_kept():
    slots = np.array([(1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)
    joint = lierb.joints.pin_in_slot(slot=slots)
    np.testing.assert_allclose(
        joint.body_frame[:, :3, 0], slots / np.linalg.norm(slots, axis=1)[:, None], atol=2e-16
    )
    assert lierb.joints.screw(pitch=(0.1, 0.2)).pitch.tolist() == [0.1, 0.2]


# ---------------------------------------------------------------- twist


def test_twist_moves_the_joint_point_as_asked():
    rng = np.random.default_rng(5)
    joint = lierb.joints.spherical(body_point=(0.3, -0.2, 0.5), ground_point=(1, 2, 3))
    C, omega, velocity = random_pose(rng), rng.normal(size=3), rng.normal(size=3)
    V = joint.twist(omega, velocity, C)
    np.testing.assert_array_equal(V[:3], omega)
    moved = C[:3, :3] @ (V[3:] + np.cross(omega, joint.body_frame[:3, 3]))
    np.testing.assert_allclose(moved, velocity, rtol=0, atol=ROUNDING)


def test_twist_uses_the_closed_pose_unless_given_one():
    rng = np.random.default_rng(6)
    joint = tilted(lierb.joints.revolute, rng)
    omega, velocity = rng.normal(size=3), rng.normal(size=3)
    default = joint.twist(omega, velocity)
    np.testing.assert_array_equal(default, joint.twist(omega, velocity, joint.closed_pose))
    p, R = joint.body_frame[:3, 3], joint.closed_pose[:3, :3]
    np.testing.assert_allclose(
        default[3:], np.cross(p, omega) + R.T @ velocity, rtol=0, atol=ROUNDING
    )


def test_twist_broadcasts_and_keeps_each_bodys_bits():
    joint = lierb.joints.spherical(body_point=POINTS)
    omegas = POINTS[::-1] + 1.0
    together = joint.twist(omegas, (1.0, 2.0, 3.0))
    assert together.shape == (5, 6)
    for i in range(5):
        alone = lierb.joints.spherical(POINTS[i]).twist(omegas[i], (1.0, 2.0, 3.0))
        np.testing.assert_array_equal(together[i], alone)


def test_twist_of_one_body_has_one_axis():
    assert lierb.joints.revolute().twist((0, 0, 1)).shape == (6,)


# ---------------------------------------------------------------- rows: values


@EVERY_CSPACE
@pytest.mark.parametrize("name", [*PRIMITIVES, "screw"])
def test_value_is_that_of_the_definition(cspace, name):
    rng = np.random.default_rng(7)
    needed = parameters_of([JOINT_ROWS[name]])
    options = {n: x for n, x in {"length": 1.3, "pitch": 0.4}.items() if n in needed}
    frames = {"body_frame": random_pose(rng), "ground_frame": random_pose(rng)}
    names = [name, *(["Omega1", "Omega2"] if name == "screw" else [])]
    joint = from_rows(names, **frames, **options)
    for _ in range(20):
        C = random_pose(rng)
        x, _ = kinematics(cspace, joint, C, np.zeros(6))
        got = joint.rows[0].value(x, parameters(joint))
        D = relative_pose(joint, C)
        expected = oracle.row_value(name, D[:3, :3], D[:3, 3], **options)
        assert got == pytest.approx(float(expected), rel=0, abs=ROUNDING)


def test_screw_value_forgets_whole_turns():
    joint = lierb.joints.screw(pitch=0.25)
    for angle in np.linspace(-20.0, 20.0, 81):
        x, _ = kinematics("SE3", joint, pose_of(turn_z(angle), (0, 0, 0.25 * angle)), np.zeros(6))
        # |d₃| ≤ 5 m and its reduction modulo 2π·pitch: a few roundings of 5
        assert abs(joint.rows[2].value(x, parameters(joint))) <= 1e-14


@pytest.mark.parametrize("pitch", [0.25, -0.25])
def test_screw_value_is_the_nearest_slip(pitch):
    joint = lierb.joints.screw(pitch=pitch)
    half_turn = np.pi * abs(pitch)
    for slip in (-0.9 * half_turn, -1e-3, 1e-3, 0.9 * half_turn):
        C = pose_of(turn_z(7.0), (0, 0, pitch * 7.0 + slip))
        x, _ = kinematics("SE3", joint, C, np.zeros(6))
        assert joint.rows[2].value(x, parameters(joint)) == pytest.approx(slip, rel=0, abs=1e-14)


# ---------------------------------------------------------------- rows: J and η

SPAN = mp.mpf("1e-15")  # s; with 50 digits the second difference below errs by 1e-20


def _exp_hat(omega, t):
    """exp(t ω̂) by Rodrigues' formula, 50 digits."""
    w = mp.matrix([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    rate = mp.sqrt(sum(mp.mpf(o) ** 2 for o in omega))
    if rate == 0:
        return mp.eye(3)
    return mp.eye(3) + w * (mp.sin(rate * t) / rate) + w * w * ((1 - mp.cos(rate * t)) / rate**2)


def _moved(cspace, C, twist, t):
    """(R, r) after t seconds at V̇ = 0: constant body-fixed twist, or constant ω and ṙ."""
    R, r = mp.matrix(C[:3, :3].tolist()), mp.matrix(C[:3, 3].tolist())
    omega, v = [mp.mpf(float(w)) for w in twist[:3]], mp.matrix([float(u) for u in twist[3:]])
    if cspace == "SO3xR3":
        return R * _exp_hat(omega, t), r + R * v * t
    # ∫₀ᵗ exp(s ω̂) v ds, term by term: t is tiny, three terms leave 1e-60
    w = mp.matrix([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    swept = v * t + w * v * (t**2 / 2) + w * (w * v) * (t**3 / 6)
    return R * _exp_hat(omega, t), r + R * swept


def _values_at(joint, cspace, C, twist, t):
    """h of every row but the `Omega` ones, 50 digits."""
    R, r = _moved(cspace, C, twist, t)
    G, B = (mp.matrix(X.tolist()) for X in (joint.ground_frame, joint.body_frame))
    Q = G[0:3, 0:3].T * R * B[0:3, 0:3]
    d = G[0:3, 0:3].T * (R * B[0:3, 3] + r - G[0:3, 3])
    names = [str(row) for row in joint.rows if row.symbol != "Omega"]
    return [oracle.row_value(n, Q, d, float(joint.pitch), float(joint.length)) for n in names]


def rates_and_accelerations(joint, cspace, C, twist):
    """ḣ and ḧ at V̇ = 0 of every row but the `Omega` ones, by central differences."""
    before, now, after = (_values_at(joint, cspace, C, twist, k * SPAN) for k in (-1, 0, 1))
    rates = [(b - a) / (2 * SPAN) for a, b in zip(before, after, strict=True)]
    bends = [(a - 2 * m + b) / SPAN**2 for a, m, b in zip(before, now, after, strict=True)]
    return np.array(rates, dtype=float), np.array(bends, dtype=float)


def random_case(names, seed):
    """A joint between tilted frames, a pose far from closed and a twist."""
    rng = np.random.default_rng(seed)
    frames = {"body_frame": random_pose(rng), "ground_frame": random_pose(rng)}
    needed = parameters_of([JOINT_ROWS[name] for name in names])
    options = {n: x for n, x in {"length": 1.3, "pitch": 0.13}.items() if n in needed}
    return from_rows(names, **frames, **options), random_pose(rng), rng.normal(size=6)


@EVERY_CSPACE
@pytest.mark.parametrize("name", PRIMITIVES)
@pytest.mark.parametrize("seed", [8, 9])
def test_jacobian_times_velocity_is_the_rate_of_the_row(cspace, name, seed):
    joint, C, twist = random_case([name], seed)
    x, velocity = kinematics(cspace, joint, C, twist)
    rates, _ = rates_and_accelerations(joint, cspace, C, twist)
    np.testing.assert_allclose(jacobian_of(joint, x) @ velocity, rates, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    "joint",
    [
        *(tilted(entry, np.random.default_rng(4)) for entry in JOINTS.values()),
        *(from_rows(names) for names in (["Q21"], ["Qtd2"], ["cv"])),
    ],
    ids=repr,
)
def test_error_kinds_are_the_errors_of_a_body_in_a_wrong_pose(joint):
    # any rows are violated where the body is put at random
    x, _ = kinematics("SE3", joint, random_pose(np.random.default_rng(5)), np.zeros(6))
    errors = {
        "position": position_error_squared(joint.rows, x, parameters(joint)),
        "rotation": rotation_error_squared(joint.rows, x, parameters(joint)),
    }
    assert joint.error_kinds == tuple(k for k, e in errors.items() if numbers([e]) > 0.0)


@EVERY_CSPACE
@pytest.mark.parametrize("name", PRIMITIVES)
@pytest.mark.parametrize("seed", [10, 11])
def test_acceleration_is_minus_the_second_derivative_at_rest_acceleration(cspace, name, seed):
    joint, C, twist = random_case([name], seed)
    x, _ = kinematics(cspace, joint, C, twist)
    _, bends = rates_and_accelerations(joint, cspace, C, twist)
    eta = numbers([r.acceleration(x, parameters(joint)) for r in joint.rows])
    np.testing.assert_allclose(eta, -bends, rtol=0, atol=ROUNDING)


@EVERY_CSPACE
@pytest.mark.parametrize("angle", [0.3, 2.0, -3.0])
def test_screw_row_has_the_rate_and_acceleration_of_the_slip(cspace, angle):
    # φ̇ = Ω₃ holds where the screw's other rows do: Q a turn about e₃, Ω₁ = Ω₂ = 0
    joint = lierb.joints.screw(pitch=0.7, body_point=(0.2, -0.1, 0.4), axis=(1, 2, -1))
    D = pose_of(turn_z(angle), (0.3, -0.5, 0.8))
    C = joint.ground_frame @ D @ np.linalg.inv(joint.body_frame)
    turning = joint.body_frame[:3, 2] * 1.7
    twist = np.concatenate([turning, (0.4, -1.1, 0.6)])
    x, velocity = kinematics(cspace, joint, C, twist)
    rates, bends = rates_and_accelerations(joint, cspace, C, twist)
    J = jacobian_of(joint, x)[:3]
    np.testing.assert_allclose(J @ velocity, rates, rtol=0, atol=ROUNDING)
    eta = numbers([r.acceleration(x, parameters(joint)) for r in joint.rows[:3]])
    np.testing.assert_allclose(eta, -bends, rtol=0, atol=ROUNDING)


@EVERY_CSPACE
def test_omega_rows_are_the_relative_angular_velocity_in_the_bodys_joint_frame(cspace):
    joint, C, twist = random_case(["Omega1", "Omega2", "Omega3"], 12)
    x, velocity = kinematics(cspace, joint, C, twist)
    expected = joint.body_frame[:3, :3].T @ twist[:3]
    np.testing.assert_allclose(jacobian_of(joint, x) @ velocity, expected, rtol=0, atol=ROUNDING)
    assert numbers([r.acceleration(x, parameters(joint)) for r in joint.rows]).tolist() == [
        0.0,
        0.0,
        0.0,
    ]


@EVERY_JOINT
def test_rates_do_not_depend_on_the_cspace(entry):
    rng = np.random.default_rng(13)
    joint = tilted(entry, rng)
    C, twist = random_pose(rng), rng.normal(size=6)
    both = []
    for cspace in CSPACES:
        x, velocity = kinematics(cspace, joint, C, twist)
        both.append(jacobian_of(joint, x) @ velocity)
    np.testing.assert_allclose(both[0], both[1], rtol=0, atol=ROUNDING)


def bent(bend, direction, twist):
    """A quaternion, 50 digits: shafts bent by an angle about an axis ⊥ e₃, one then twisted."""
    half, about = mp.mpf(bend) / 2, mp.mpf(direction)
    sine = mp.sin(half)
    return product(
        (mp.cos(mp.mpf(twist) / 2), 0, 0, mp.sin(mp.mpf(twist) / 2)),
        (mp.cos(half), sine * mp.cos(about), sine * mp.sin(about), 0),
    )


def product(p, q):
    (a, *u), (b, *v) = p, q
    return (
        a * b - sum(x * y for x, y in zip(u, v, strict=True)),
        *(a * v[i] + b * u[i] + u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)),
    )


@pytest.mark.parametrize("twist", [0.0, 0.6], ids=["closed", "off"])
@pytest.mark.parametrize(
    "bend", [0.0, 1e-9, 0.4, 2.5, mp.pi - mp.mpf("1e-9"), mp.pi, mp.pi + mp.mpf("1e-9"), 4.0]
)
def test_constant_velocity_row_is_regular_at_any_bend(bend, twist):
    joint = from_rows(["cv"])
    (row,) = joint.rows
    start, omega = bent(bend, 0.7, twist), (0.9, -1.3, 0.8)

    def at(t):
        """2z of the quaternion that turns at ω."""
        speed = mp.sqrt(sum(mp.mpf(w) ** 2 for w in omega))
        sine = mp.sin(speed * t / 2) / speed
        turned = product(start, (mp.cos(speed * t / 2), *(sine * mp.mpf(w) for w in omega)))
        return 2 * turned[3]

    w, x, y, z = start
    Q = mp.matrix([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    C = pose_of(np.array(Q.tolist(), dtype=float), (0.0, 0.0, 0.0))
    x, velocity = kinematics("SE3", joint, C, (*omega, 0.0, 0.0, 0.0))
    found = [
        row.value(x, parameters(joint)),
        float(jacobian_of(joint, x)[0] @ velocity),
        row.acceleration(x, parameters(joint)),
    ]
    rate, bending = mp.diff(at, 0), mp.diff(at, 0, 2)
    expected = np.array([at(0), rate, -bending], dtype=float)
    # a quaternion and its negative are one rotation, and which is meant is rounding's choice at a
    # half turn: all three change sign together
    sign = np.sign(found[1] * expected[1])
    np.testing.assert_allclose(found, sign * expected, rtol=0, atol=ROUNDING)
    # a unit vector on the constraint, shorter off it by what the twist leaves
    length = np.linalg.norm(jacobian_of(joint, x))
    assert length == pytest.approx(np.sqrt(1 - found[0] ** 2 / 4), abs=ROUNDING)


def test_constant_velocity_row_is_the_twist_where_shafts_are_in_line():
    """Scaled so that λ is the torque about e₃ there, as of an `Omega3` row."""
    joint = from_rows(["cv"])
    x, _ = kinematics("SE3", joint, np.eye(4), np.zeros(6))
    np.testing.assert_array_equal(jacobian_of(joint, x), [[0, 0, 1, 0, 0, 0]])
    small = pose_of(turn_z(1e-5), (0.0, 0.0, 0.0))
    x, _ = kinematics("SE3", joint, small, np.zeros(6))
    # 2 sin(φ/2) is φ but for φ³/24
    assert joint.rows[0].value(x, parameters(joint)) == pytest.approx(1e-5, abs=1e-15)


# ---------------------------------------------------------------- the catalogue


def constrained_rank(joint, C, cspace="SE3"):
    """Rank and smallest singular value of J, rows scaled to length 1."""
    x, _ = kinematics(cspace, joint, C, np.zeros(6))
    J = jacobian_of(joint, x)
    if not len(J):
        return 0, 1.0
    sizes = np.linalg.svd(J / np.linalg.norm(J, axis=1)[:, None], compute_uv=False)
    # rounding leaves 1e-16 of a dependent row, an independent one keeps 1e-2 or more here
    return int((sizes > 1e-6).sum()), sizes[-1]


def test_catalogue_holds_every_motion_group():
    """Müller, table 1: the subgroups of SE(3), but for the trivial one."""
    assert {entry.subgroup for entry in JOINTS.values()} - {None} == FREEDOMS.keys()


def test_catalogue_entry_has_its_rows_in_order():
    """The oracle's, in the order that λ has them."""
    listed = {name: " ".join(map(str, entry.rows)) for name, entry in JOINTS.items()}
    assert listed == oracle.JOINT_ROWS
    assert all(getattr(lierb.joints, name) is entry for name, entry in JOINTS.items())


@EVERY_JOINT
def test_catalogue_entry_says_what_it_is(entry):
    assert entry.summary
    assert entry.name in repr(entry)
    assert entry.name in repr(make(entry))


@EVERY_JOINT
@EVERY_CSPACE
def test_joint_leaves_the_freedoms_of_its_motion(entry, cspace):
    joint = tilted(entry, np.random.default_rng(14))
    rank, _ = constrained_rank(joint, joint.closed_pose, cspace)
    assert rank == len(entry.rows)
    assert 6 - rank == FREEDOMS.get(entry.subgroup, 6 - rank)


@pytest.mark.parametrize("angle", np.radians([0, 45, 80, 89, 90, 135, 180, 270]))
@EVERY_CSPACE
def test_revolute_leaves_one_freedom(angle, cspace):
    joint = tilted(lierb.joints.revolute, np.random.default_rng(15))
    turned = joint.ground_frame @ pose_of(turn_z(angle), (0, 0, 0))
    C = turned @ np.linalg.inv(joint.body_frame)
    rank, smallest = constrained_rank(joint, C, cspace)
    assert rank == 5
    assert smallest > 0.1  # 0.3 at every angle; 0 at 90° with the rows as printed, see below


def test_revolute_as_printed_loses_rank_at_a_quarter_turn():
    # R₁₂ = R₂₃ = 0 about axis 2 (errata E9), which the catalogue therefore does not use
    joint = from_rows(["d1", "d2", "d3", "Q12", "Q23"])
    turned = [pose_of(turn_y(np.radians(angle)), (0, 0, 0)) for angle in (0, 60, 90)]
    ranks, smallest = zip(*(constrained_rank(joint, C) for C in turned), strict=True)
    assert ranks == (5, 5, 4)
    assert smallest[2] < 1e-15 < 0.1 < smallest[1] < smallest[0]


@SUBGROUPS
@EVERY_CSPACE
def test_subgroup_motion_keeps_every_row_at_zero(entry, cspace):
    rng = np.random.default_rng(16)
    joint = tilted(entry, rng)
    x, _ = kinematics("SE3", joint, joint.closed_pose, np.zeros(6))
    free = np.linalg.svd(np.vstack([jacobian_of(joint, x), np.zeros((1, 6))]))[2][len(joint.rows) :]
    for _ in range(10):
        X = 4.0 * rng.normal(size=len(free)) @ free  # several turns and metres
        C = joint.ground_frame @ expm(twist_matrix(X)) @ np.linalg.inv(joint.body_frame)
        x, _ = kinematics(cspace, joint, C, np.zeros(6))
        # products of 4×4 matrices with lengths up to 20 m; the angle of the screw
        assert position_error_squared(joint.rows, x, parameters(joint)) <= (1e-13) ** 2
        assert rotation_error_squared(joint.rows, x, parameters(joint)) <= (1e-14) ** 2


@pytest.mark.parametrize("name", slow_but([e.name for e in OTHERS], "universal", "point_on_line"))
def test_joint_allows_its_own_motion(name):
    """Poses that are on the oracle's rows, far from the closed one: every row is zero there."""
    rng, entry = np.random.default_rng(17), JOINTS[name]
    joint = tilted(entry, rng)
    sizes = oracle.sizes_of(entry.name, pitch=float(joint.pitch), length=float(joint.length))
    for _ in range(5):
        D = oracle.relative_pose_on(entry.name, pose_of(rotation(rng), rng.normal(size=3)), **sizes)
        C = joint.ground_frame @ D @ np.linalg.inv(joint.body_frame)
        for cspace in CSPACES:
            x, _ = kinematics(cspace, joint, C, np.zeros(6))
            # products of 4×4 matrices with lengths of some metres, and Newton's last step
            assert position_error_squared(joint.rows, x, parameters(joint)) <= (2e-14) ** 2
            assert rotation_error_squared(joint.rows, x, parameters(joint)) <= (5e-15) ** 2


@EVERY_CSPACE
def test_screw_without_pitch_is_a_revolute(cspace):
    rng = np.random.default_rng(18)
    frames = {"body_frame": random_pose(rng), "ground_frame": random_pose(rng)}
    pair = lierb.joints.screw(pitch=0.0, **frames), lierb.joints.revolute(**frames)
    C, twist = random_pose(rng), rng.normal(size=6)
    for joint in pair:
        assert joint.pitch == 0.0
    (x, _), (y, _) = (kinematics(cspace, joint, C, twist) for joint in pair)
    np.testing.assert_array_equal(jacobian_of(pair[0], x), jacobian_of(pair[1], y))
    p = parameters(pair[0])
    assert pair[0].rows[2].value(x, p) == pair[1].rows[2].value(y, p)
    assert [numbers([r.acceleration(x, p)]) for r in pair[0].rows] == [
        numbers([r.acceleration(y, p)]) for r in pair[1].rows
    ]


# ---------------------------------------------------------------- rows: names


@pytest.mark.parametrize("name", JOINT_ROWS)
def test_row_name_survives_parsing(name):
    assert str(JOINT_ROWS[name]) == name


def test_from_rows_takes_greek():
    assert [*map(str, from_rows(["Ω1", "Ω3"]).rows)] == ["Omega1", "Omega3"]


def test_from_rows_equals_the_catalogue():
    frames = {"body_point": (0.1, 0.2, 0.3), "axis": (0, 1, 1)}
    built, listed = (
        from_rows(oracle.JOINT_ROWS["revolute"].split(), **frames),
        lierb.joints.revolute(**frames),
    )
    assert built.rows == listed.rows
    np.testing.assert_array_equal(built.body_frame, listed.body_frame)


def test_row_units_are_those_of_the_wrench():
    units = [JOINT_ROWS[name].unit for name in ("d1", "Qtd2", "screw", "Omega1", "Q32")]
    assert units == ["N", "N", "N", "N m", "N m"]


# ---------------------------------------------------------------- Problem.project


def mass_matrix(body):
    """M of a body-fixed twist (ω, v), from the kinetic energy ½ω·Iω + m ω·(c × v) + ½ m v·v."""
    m, c = float(body.mass), body.com
    c_hat = np.array([[0, -c[2], c[1]], [c[2], 0, -c[0]], [-c[1], c[0], 0]])
    return np.block([[body.inertia, m * c_hat], [-m * c_hat, m * np.eye(3)]])


OFF_CENTRE = lierb.Body(
    mass=2.5,
    inertia=[[1.2, 0.1, -0.2], [0.1, 1.0, 0.05], [-0.2, 0.05, 0.9]],
    com=(0.1, -0.2, 0.3),
)


def projected(entry, seed):
    rng = np.random.default_rng(seed)
    problem = lierb.Problem(OFF_CENTRE, tilted(entry, rng))
    given = rng.normal(size=6)
    return problem, given, problem.project(given)


@EVERY_JOINT
def test_project_satisfies_the_joint(entry):
    problem, _, V = projected(entry, 19)
    x, velocity = kinematics("SE3", problem.joint, problem.joint.closed_pose, V)
    # ROUNDING × 10: a 6×6 solve with a condition number of about 1e2
    np.testing.assert_allclose(jacobian_of(problem.joint, x) @ velocity, 0.0, atol=10 * ROUNDING)


@EVERY_JOINT
def test_project_changes_nothing_the_second_time(entry):
    problem, _, V = projected(entry, 20)
    np.testing.assert_allclose(problem.project(V), V, rtol=0, atol=10 * ROUNDING)


@EVERY_JOINT
def test_project_is_nearest_in_the_kinetic_energy(entry):
    problem, given, V = projected(entry, 21)
    joint = problem.joint
    # J in the user's body-fixed twist, column by column
    J = np.empty((len(joint.rows), 6))
    for i, unit in enumerate(np.eye(6)):
        x, velocity = kinematics("SE3", joint, joint.closed_pose, unit)
        J[:, i] = jacobian_of(joint, x) @ velocity
    allowed = np.linalg.svd(np.vstack([J, np.zeros((1, 6))]))[2][len(J) :]
    # what is taken away is orthogonal, in the metric M, to every allowed twist
    np.testing.assert_allclose(
        allowed @ mass_matrix(problem.body) @ (given - V), 0.0, atol=100 * ROUNDING
    )


def test_project_uses_the_given_pose():
    rng = np.random.default_rng(22)
    joint = tilted(lierb.joints.pin_in_slot, rng)
    C = (
        joint.ground_frame
        @ pose_of(turn_z(rng.uniform(-3, 3)), (rng.uniform(-5, 5), 0, 0))
        @ np.linalg.inv(joint.body_frame)
    )
    problem = lierb.Problem(OFF_CENTRE, joint)
    V = problem.project(rng.normal(size=6), C)
    x, velocity = kinematics("SE3", joint, C, V)
    np.testing.assert_allclose(jacobian_of(joint, x) @ velocity, 0.0, atol=10 * ROUNDING)
    assert np.abs(V - problem.project(V)).max() > 1e-3  # it is another pose's projection


def test_project_gives_each_body_of_a_batch_the_bits_that_it_has_alone():
    rng = np.random.default_rng(23)
    twists = rng.normal(size=(5, 6))
    together = lierb.Problem(OFF_CENTRE, lierb.joints.revolute(POINTS, axis=AXES)).project(twists)
    assert together.shape == (5, 6)
    for i in range(5):
        alone = lierb.Problem(OFF_CENTRE, lierb.joints.revolute(POINTS[i], axis=AXES[i]))
        np.testing.assert_array_equal(together[i], alone.project(twists[i]))


def test_project_of_a_free_body_is_the_identity():
    V = np.arange(6.0)
    # taken to the joint's frame and back: the default frame turns nothing
    np.testing.assert_array_equal(lierb.Problem(BODY, lierb.joints.free()).project(V), V)


def test_project_passes_the_check_of_integrate(monkeypatch):
    rng = np.random.default_rng(24)
    problem = lierb.Problem(OFF_CENTRE, tilted(lierb.joints.universal, rng))
    reached = []
    monkeypatch.setattr(lierb.runs.engine, "integrate", lambda *a, **k: reached.append(a) or 1 / 0)
    with pytest.raises(ZeroDivisionError):  # the run is reached: the twist has passed
        lierb.integrate(problem, twist0=problem.project(rng.normal(size=6)), dt=0.1, t_end=0.1)
    assert reached

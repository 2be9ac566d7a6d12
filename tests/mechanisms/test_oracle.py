"""The oracle of mechanisms against laws, against other solutions, and its samples against it."""

from dataclasses import replace

import mpmath
import numpy as np
import oracle as one_body
import pytest
from cases import integrate

import lierb
from mechanisms import extrapolation, oracle, samples
from mechanisms.minimal import REAL, Arm, Chain, Planar
from mechanisms.samples import SHAPES

# A state has entries of up to 10; an estimated error of 1e-14 a step, a few steps, and digits
# that a mechanism with a mass ratio of 10 or so loses.
EXACT = 1e-11

# Seeds with which a sample stays away from singular places for a while, and turns no faster than
# the oracle can follow in a few seconds.
SEEDS = {
    "chain": 1, "star": 4, "branched": 3, "sliding": 4, "loosely": 5, "four_bar": 0,
    "slider_crank": 0, "rssr": 0, "two_loops": 1, "floating_loop": 5, "many_loops": 4,
}  # fmt: skip
FREEDOMS = {
    **{tree: sum(6 - len(oracle.CONDITIONS[kind]) for kind, _ in SHAPES[tree].links)
       for tree in samples.TREES},
    "four_bar": 1, "slider_crank": 1, "rssr": 2, "two_loops": 5, "floating_loop": 8,
    "many_loops": 4,
}  # fmt: skip


def sample(shape: str, n: int = 2, **options) -> samples.Sample:
    return samples.random_description(np.random.default_rng(SEEDS[shape]), shape, n, **options)


# elsewhere numpy.longdouble is a float64
EXTENDED = pytest.mark.skipif(np.finfo(REAL).eps > 1e-18, reason="no extended precision here")


# ---- the integrator ----------------------------------------------------------------------------


@EXTENDED
def test_step_has_order_sixteen():
    # ẏ = i y on a circle: halving a step of 2 rad takes off 2¹⁶ or so of its error
    turn = lambda y: np.array([-y[1], y[0]])
    off = []
    for h in (np.longdouble(2), np.longdouble(1)):
        y, _ = extrapolation.step(turn, np.array([1, 0], np.longdouble), h)
        off.append(np.hypot(y[0] - np.cos(h), y[1] - np.sin(h)))
    assert 2**15 < off[0] / off[1] < 2**19  # one step: order 17 or, for a linear equation, more


def test_estimate_is_larger_than_the_error():
    for columns in (2, 3, 4):
        y, estimate = extrapolation.step(lambda y: y, np.array([1.0]), 1.0, columns)
        assert 1e-12 < abs(y[0] - np.e) < abs(estimate[0])


def test_integrated_takes_shorter_steps_where_they_are_needed():
    # 1/(1 + 10⁴ t²) turned into an equation: steps of 0.5 would not see the peak
    peak = lambda y: np.array([1.0, 1.0 / (1.0 + 1e4 * y[0] ** 2)])
    y, worst = extrapolation.integrated(peak, np.array([-1.0, 0.0]), [0.0, 2.0], 0.5)
    assert worst <= 1e-14
    assert abs(y[-1, 1] - 0.02 * np.arctan(100.0)) < 1e-13


# ---- joints ------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_random_description_closes_as_it_is_made(shape):
    # frames are put where the joints want them: what is left is rounding
    rng = np.random.default_rng(SEEDS[shape])
    made = samples.random_description(rng, shape, 3)
    system = oracle.System(made.description)
    rows, _ = system.conditions(system._placed(system.state(made.poses, made.twists)))
    assert np.max(np.abs(rows.value)) < 1e-13
    assert np.max(np.abs(rows.rate)) < 1e-13
    assert np.all(oracle.mobility(made.description, made.poses) == FREEDOMS[shape])


def test_samples_have_every_joint_of_the_catalogue():
    kinds = {kind for s in SHAPES.values() for kind, *_ in (*s.links, *s.loops)}
    assert kinds == set(lierb.joints.JOINTS)


@pytest.mark.parametrize("shape", SHAPES)
def test_rows_are_differentiated_right(shape):
    # along the motion: a central difference of the values, and of the rates, with its own error
    made = sample(shape, forces=True)
    system = oracle.System(made.description)
    y = system.state(made.poses, made.twists)
    rate = system.rate(y)
    h = 1e-5
    ends = [system.conditions(system._placed(y + s * h * rate))[0] for s in (1.0, -1.0)]
    rows, _ = system.conditions(system._placed(y))
    velocity = y[..., 7:].reshape(len(y), -1)
    acceleration = rate[..., 7:].reshape(len(y), -1)
    along = np.einsum("nri,ni->nr", rows.jacobian, velocity)
    second = np.einsum("nri,ni->nr", rows.jacobian, acceleration) + rows.bias
    scale = 1.0 + np.max(np.abs(rate))
    # truncation h² times a third derivative, rounding 1e-16/h
    for found, wanted in ((along, "value"), (second, "rate")):
        slope = (getattr(ends[0], wanted) - getattr(ends[1], wanted)) / (2.0 * h)
        assert np.max(np.abs(found - slope)) < 1e-8 * scale**2, wanted
    assert np.max(np.abs(along - rows.rate)) < 1e-12


# ---- laws --------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["chain", "branched", "four_bar", "rssr"])
def test_motion_keeps_energy(shape):
    made = sample(shape)
    system = oracle.System(made.description)
    moved = oracle.motion(made.description, made.poses, made.twists, [0.0, 0.1])
    energies = [system.energy(state) for state in moved.states]
    assert np.max(np.abs(energies[1] - energies[0])) < EXACT * (1 + np.max(np.abs(energies[0])))


def test_motion_of_what_floats_keeps_momentum():
    made = sample("star")
    floating = replace(made.description, gravity=np.zeros((2, 3)))
    system = oracle.System(floating)
    moved = oracle.motion(floating, made.poses, made.twists, [0.0, 0.2])
    momenta = [system.momentum(state) for state in moved.states]
    assert np.max(np.abs(momenta[1] - momenta[0])) < EXACT
    assert np.max(np.abs(momenta[0])) > 0.1


@pytest.mark.parametrize("shape", ["chain", "slider_crank"])
def test_reactions_balance_every_link(shape):
    # Newton and Euler for each link alone, of differences of momentum along the motion
    made = sample(shape)
    system = oracle.System(made.description)
    y = system.state(made.poses, made.twists)
    h, ends = 1e-4, []
    for s in (1.0, -1.0):
        y1, _ = extrapolation.step(system.rate, y, s * h)
        ends.append(y1)
    reactions = system.reactions(y)
    R = oracle.matrix_of(y[..., 3:7])
    total = np.zeros((len(y), len(made.description.bodies), 6))
    for k, joint in enumerate(made.description.joints):
        i, B = joint.body, joint.B
        axes = R[:, i] @ B[:, :3, :3]
        torque, force = (np.einsum("nij,nj->ni", axes, reactions[:, k, s]) for s in
                         (slice(3), slice(3, 6)))  # fmt: skip
        point = y[:, i, :3] + np.einsum("nij,nj->ni", R[:, i], B[:, :3, 3] - system.com[:, i])
        for body, sign in ((i, 1.0), (joint.parent, -1.0)):
            if body is not None:
                total[:, body, :3] += sign * (torque + np.cross(point - y[:, body, :3], force))
                total[:, body, 3:] += sign * force
    spin = []
    for state in ends:
        turned = oracle.matrix_of(state[..., 3:7])
        world = turned @ system.inertia @ np.swapaxes(turned, -1, -2)
        spin.append(np.einsum("nlij,nlj->nli", world, state[..., 10:]))
    changed = (ends[0][..., 7:10] - ends[1][..., 7:10]) / (2 * h) - system.gravity[:, None]
    wanted = np.concatenate(
        [(spin[0] - spin[1]) / (2 * h), system.mass[..., None] * changed], axis=-1
    )
    # the difference's own error: h² of a third derivative, which is of order 1e3
    assert np.max(np.abs(total - wanted)) < 1e-4 * (1 + np.max(np.abs(total)))


# ---- other solutions ---------------------------------------------------------------------------


def test_planar_double_pendulum_moves_as_lagrange_says():
    # two rods on pins, angles from the x axis: Lagrange's equations as textbooks have them
    m, l, g = 1.3, 0.7, 9.81
    J = m * l * l / 12

    def lagrange(y):
        a, b, u, v = y
        c, s = np.cos(a - b), np.sin(a - b)
        half = 0.5 * m * l * l
        M = np.array([[J + 1.25 * m * l * l, half * c], [half * c, J + 0.25 * m * l * l]])
        F = [-half * s * v * v - 1.5 * m * g * l * np.cos(a),
             half * s * u * u - 0.5 * m * g * l * np.cos(b)]  # fmt: skip
        return np.array([u, v, *np.linalg.solve(M, F)])

    start = np.array([0.4, -0.9, 1.0, -2.0])
    times = [0.0, 0.2, 0.4]
    wanted, _ = extrapolation.integrated(lagrange, start, times, 0.1)

    half = np.array([0.5 * l, 0.0, 0.0])
    body = oracle.Body(np.full(1, m), np.diag([0.01, J, J])[None], np.zeros((1, 3)))
    at = lambda r: samples.frame(np.eye(3)[None], np.asarray(r, float)[None])
    zero = np.zeros(1)
    joints = [
        oracle.Joint("revolute", 0, None, at(-half), at([0, 0, 0]), zero, zero),
        oracle.Joint("revolute", 1, 0, at(-half), at(half), zero, zero),
    ]
    given = oracle.Description([body, body], joints, np.array([[0.0, -g, 0.0]]))
    turned = lambda a: samples.rotation(np.array([[0.0, 0.0, a]]))[0]
    R = [turned(a) for a in start[:2]]
    x = [R[0] @ half, 2 * R[0] @ half + R[1] @ half]
    poses = np.stack([samples.frame(R[i][None], x[i][None])[0] for i in range(2)])[None]
    w = np.array([[0, 0, u] for u in start[2:]])
    v = [np.cross(w[0], R[0] @ half), np.cross(w[0], 2 * R[0] @ half) + np.cross(w[1], R[1] @ half)]
    twists = np.stack([np.concatenate([w[i], R[i].T @ v[i]]) for i in range(2)])[None]
    moved = oracle.motion(given, poses, twists, times)
    angles = np.arctan2(moved.poses[:, 0, :, 1, 0], moved.poses[:, 0, :, 0, 0])
    assert np.max(np.abs(angles - wanted[:, :2])) < EXACT
    assert np.max(np.abs(moved.twists[:, 0, :, 2] - wanted[:, 2:])) < EXACT
    # and so does the chain of complex exponentials that the benchmarks' planar solutions are
    rods = (Planar(m, J, (Arm(0.5 * l, (1.0, 0.0)),), (1.0, 0.0)),
            Planar(m, J, (Arm(l, (1.0, 0.0)), Arm(0.5 * l, (0.0, 1.0))), (0.0, 1.0)))  # fmt: skip
    found, _ = Chain(rods, (), (0.0, 0.0), g).motion(start[:2], start[2:], times, 0.1)
    assert np.max(np.abs(found - wanted)) < EXACT


def on_the_ground(joint: str) -> samples.Sample:
    """One body, its centre of mass at its origin, on a joint to the ground, in general frames."""
    SHAPES["one"] = samples.Shape(((joint, None),))
    try:
        return samples.random_description(np.random.default_rng(2), "one", 1, centred=True)
    finally:
        del SHAPES["one"]


@pytest.mark.slow
@pytest.mark.parametrize("joint", sorted(oracle.CONDITIONS))
def test_one_body_moves_as_the_oracle_of_one_body_says(joint):
    # Newton and Euler with other rows, by another hand, integrated by DOP853 at 3e-14
    made = on_the_ground(joint)
    body, held = made.description.bodies[0], made.description.joints[0]
    times = [0.2, 0.4]
    wanted = one_body.reference_trajectory(
        joint, times, mass=body.mass[0], inertia=body.inertia[0], twist0=made.twists[0, 0],
        pose0=made.poses[0, 0], ground_frame=held.G[0], body_frame=held.B[0],
        gravity=made.description.gravity[0], pitch=held.pitch[0], length=held.length[0],
    )  # fmt: skip
    moved = oracle.motion(made.description, made.poses, made.twists, [0.0, *times])
    # DOP853 leaves 1e-12 or so, and does not put the body back onto its joint
    assert np.max(np.abs(moved.poses[1:, 0, 0, :3, :3] - wanted.R)) < 1e-10
    assert np.max(np.abs(moved.poses[1:, 0, 0, :3, 3] - wanted.r)) < 1e-10
    assert np.max(np.abs(moved.twists[1:, 0, 0, :3] - wanted.omega)) < 1e-10
    scale = 1 + np.max(np.abs(moved.reactions))
    assert np.max(np.abs(moved.reactions[1:, 0, 0] - wanted.reaction)) < 1e-9 * scale


@pytest.mark.slow
def test_heavy_top_moves_as_lierb_says():
    made = on_the_ground("spherical")
    body, held = made.description.bodies[0], made.description.joints[0]
    joint = lierb.joints.spherical(ground_frame=held.G[0], body_frame=held.B[0])
    problem = lierb.Problem(
        lierb.Body(body.mass[0], body.inertia[0]), joint, made.description.gravity[0]
    )
    result = integrate(
        problem, pose0=made.poses[0, 0], twist0=made.twists[0, 0], dt=2e-4, t_end=0.5
    )
    moved = oracle.motion(made.description, made.poses, made.twists, [0.0, 0.5])
    R, r = moved.poses[1, 0, 0, :3, :3], moved.poses[1, 0, 0, :3, 3]
    assert np.max(np.abs(np.ravel(result.rotation[-1]) - R.ravel())) < EXACT
    assert np.max(np.abs(np.ravel(result.position[-1]) - r)) < EXACT
    reaction = np.array(result.history["reaction"].to_pylist())[-1]
    assert np.max(np.abs(reaction - moved.reactions[1, 0, 0])) < 1e-10


def test_pendulum_swings_as_elliptic_functions_say():
    m, l, g, start = 0.8, 0.6, 9.81, 2.0
    c = np.array([0.0, -l, 0.0])
    J = np.diag([0.05, 0.02, 0.05])
    steiner = m * (l * l * np.eye(3) - np.outer(c, c))
    zero, eye = np.zeros(1), np.eye(4)[None]
    body = oracle.Body(np.full(1, m), (J + steiner)[None], c[None])
    hinge = oracle.Joint("revolute", 0, None, eye, eye, zero, zero)
    given = oracle.Description([body], [hinge], np.array([[0.0, -g, 0.0]]))
    pose = samples.frame(samples.rotation(np.array([[0.0, 0.0, start]])), np.zeros((1, 3)))
    moved = oracle.motion(given, pose[:, None], np.zeros((1, 1, 6)), [0.0, 0.5, 1.0])
    k = mpmath.sin(start / 2)
    w = mpmath.sqrt(m * g * l / (0.05 + m * l * l))
    for t, place in zip((0.5, 1.0), moved.poses[1:, 0, 0], strict=True):
        s = k * mpmath.ellipfun("sn", mpmath.ellipk(k * k) - w * t, m=k * k)
        assert abs(np.arctan2(place[1, 0], place[0, 0]) - float(2 * mpmath.asin(s))) < EXACT


# ---- to and from lierb's objects ---------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_description_of_gives_back_what_a_mechanism_is_made_of(shape):
    made = sample(shape, forces=True)
    found = samples.description_of(samples.mechanism_of(made.description))
    for a, b in zip(found.bodies, made.description.bodies, strict=True):
        for x, y in zip(vars(a).values(), vars(b).values(), strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-14, atol=1e-16)
    for a, b in zip(found.joints, made.description.joints, strict=True):
        assert (a.kind, a.body, a.parent) == (b.kind, b.body, b.parent)
        for name in ("B", "G", "pitch", "length"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-13)
    np.testing.assert_array_equal(found.gravity, made.description.gravity)
    system = [oracle.System(x) for x in (found, made.description)]
    y = system[0].state(made.poses, made.twists)
    loads = [s.applied(s._placed(y)) for s in system]
    np.testing.assert_allclose(loads[0], loads[1], atol=1e-12)

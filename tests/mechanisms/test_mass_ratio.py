"""Heavy links on light ones, on joints that are made of rows: nothing is lost to the ratio.

Right values are those of Lagrange's equations in the two angles: with 50 digits where an instant is
looked at (mpmath), by SciPy's DOP853 where time passes.
"""

from __future__ import annotations

from collections.abc import Sequence

import mpmath
import numpy as np
import pytest
from cases import slow_but
from mpmath import mpf
from scipy.integrate import solve_ivp

import lierb
from mechanisms.shared import in_python

DIGITS = 50
SHAPE = np.diag((0.02, 0.0204, 0.0006))  # m², of links of 1 kg: slender ones
AXES = np.array([(0.48, 0.6, 0.64), (0.36, -0.8, 0.48)])
POINTS = np.array([(0.05, 0.02, 0.3), (-0.04, 0.06, 0.25)])  # on the body
HANGS = np.array([(0.0, 0.0, 0.0), (0.03, -0.05, -0.28)])  # on what it hangs on
GRAVITY = np.array((0.3, -0.4, -9.81))
ANGLES, RATES = (0.7, 0.9), (1.0, -0.5)
ROWS = {
    "point": ("d1", "d2", "d3", "Q13", "Q23"),
    "point of the parent": ("Qtd1", "Qtd2", "Qtd3", "Q13", "Q23"),
    "twice": ("d1", "d2", "d3", "Qtd1", "Q13", "Q23", "Q31"),
}


def two_links(masses: Sequence[float], rows: Sequence[str] | None) -> lierb.Mechanism:
    """Links whose axes are at no right angle to anything."""
    links, parent = [], "ground"
    for name, mass, axis, point, hang in zip(
        ("near", "far"), masses, AXES, POINTS, HANGS, strict=True
    ):
        frames = {"body_point": point, "parent_point": hang, "axis": axis}
        joint = lierb.joints.from_rows(rows, **frames) if rows else lierb.joints.revolute(**frames)
        links.append(lierb.Link(name, lierb.Body(mass, mass * SHAPE), joint, parent))
        parent = name
    return lierb.Mechanism(links, gravity=GRAVITY)


# ---- Lagrange's equations ----------------------------------------------------------------------


def exact(x: np.ndarray) -> mpmath.matrix:
    return mpmath.matrix([mpf(float(v)) for v in x])


def cross(a: mpmath.matrix, b: mpmath.matrix) -> mpmath.matrix:
    (x, y, z), (u, v, w) = a, b
    return mpmath.matrix([y * w - z * v, z * u - x * w, x * v - y * u])


def turn(axis: np.ndarray, angle: mpf) -> mpmath.matrix:
    """Rodrigues' formula."""
    x, y, z = unit = exact(axis) / mpmath.norm(exact(axis))
    skew = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    assert mpmath.almosteq(mpmath.norm(unit), 1)
    return mpmath.eye(3) + mpmath.sin(angle) * skew + (1 - mpmath.cos(angle)) * skew * skew


def placed(angles: Sequence[mpf]) -> list[tuple[mpmath.matrix, mpmath.matrix, mpmath.matrix]]:
    """Rotation, place of the centre of mass, and place of the joint, of each link."""
    rotation, centre, found = mpmath.eye(3), mpmath.zeros(3, 1), []
    for axis, point, hang, angle in zip(AXES, POINTS, HANGS, angles, strict=True):
        pivot = centre + rotation * exact(hang)
        rotation = rotation * turn(axis, angle)
        centre = pivot - rotation * exact(point)
        found.append((rotation, centre, pivot))
    return found


def energies(angles: Sequence[mpf], masses: Sequence[float]) -> tuple[mpmath.matrix, mpf]:
    """The mass matrix of the angles, and the potential of gravity."""
    total, potential, links = mpmath.zeros(2), mpf(0), placed(angles)
    axes = [r * exact(a) / mpmath.norm(exact(a)) for (r, *_), a in zip(links, AXES, strict=True)]
    for i, (rotation, centre, _) in enumerate(links):
        mass = mpf(masses[i])
        inertia = mass * rotation * mpmath.matrix(SHAPE.tolist()) * rotation.T
        moving = [cross(axes[j], centre - links[j][2]) for j in range(i + 1)]
        for j in range(i + 1):
            for k in range(i + 1):
                total[j, k] += (axes[j].T * inertia * axes[k] + mass * moving[j].T * moving[k])[0]
        potential -= mass * (exact(GRAVITY).T * centre)[0]
    return total, potential


def accelerations(masses: Sequence[float]) -> mpmath.matrix:
    """Accelerations from d/dt ∂L/∂q̇ = ∂L/∂q, with differences of 1e-17 rad for M and U."""
    w, step, slopes = mpmath.matrix([mpf(x) for x in RATES]), mpf(10) ** -17, []
    for k in range(2):
        ends = []
        for sign in (1, -1):
            moved = [mpf(x) for x in ANGLES]
            moved[k] += sign * step
            ends.append(energies(moved, masses))
        slopes.append([(a - b) / (2 * step) for a, b in zip(*ends, strict=True)])
    drift = w[0] * slopes[0][0] + w[1] * slopes[1][0]  # Ṁ
    forces = [(w.T * slopes[k][0] * w)[0] / 2 - slopes[k][1] - (drift * w)[k] for k in range(2)]
    return mpmath.lu_solve(energies([mpf(x) for x in ANGLES], masses)[0], mpmath.matrix(forces))


def joint_forces(bend: mpmath.matrix, masses: Sequence[float]) -> list[mpf]:
    """Sizes of both, by Newton's law of what hangs there."""

    def centre(i: int, axis: int, t: mpf) -> mpf:
        moved = [q + w * t + b * t * t / 2 for q, w, b in zip(ANGLES, RATES, bend, strict=True)]
        return placed(moved)[i][1][axis]

    pulls = []
    for i, mass in enumerate(masses):
        moving = [mpmath.diff(lambda t, i=i, k=k: centre(i, k, t), 0, 2) for k in range(3)]
        pulls.append(mpf(mass) * (mpmath.matrix(moving) - exact(GRAVITY)))
    return [mpmath.norm(pulls[0] + pulls[1]), mpmath.norm(pulls[1])]


@pytest.mark.parametrize("cspace", ["reduced", "SE3"])
@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize(
    "masses",
    slow_but(
        [(1.0, 1.0), (1.0, 1e6), (1.0, 1e10), (1.0, 1e14), (1e10, 1.0)], (1.0, 1e14), (1e10, 1.0)
    ),
)
def test_joints_of_rows_do_not_feel_the_mass_ratio(masses, rows, cspace):
    plain, made = two_links((1.0, 1.0), None), two_links(masses, ROWS[rows])
    names = plain.names
    pose0 = plain.pose(dict(zip(names, ANGLES, strict=True)))
    twist0 = plain.twist(dict(zip(names, RATES, strict=True)), pose0)
    system, body, state = in_python(made, cspace, pose0, twist0)
    found = system.accelerate(body, system.motion(body, state, 0.0))
    assert found.dropped == (4 if rows == "twice" else 0)
    _, wrenches = system.forces(body, state, 0.0)
    with mpmath.workdps(DIGITS):
        wanted = accelerations(masses)
        forces = [float(x) for x in joint_forces(wanted, masses)]
    # About e₃ of its joint the far link turns by what the near one does there and by its own.
    near, far = (np.array(v[:3], float) for v in found.solved.response.moved)
    seen = system.motion(body, state, 0.0)
    turned = np.array(seen.steps[1][0], float).reshape(3, 3)
    own = (far - turned.T @ near)[2]
    # An ulp of each of some hundred operations; 1e-15 measured, where it was 1e-4 at 1e10.
    np.testing.assert_allclose((near[2], own), [float(x) for x in wanted], rtol=2e-14)
    sizes = [np.linalg.norm([float(x) for x in wrench[3:]]) for wrench in wrenches]
    np.testing.assert_allclose(sizes, forces, rtol=2e-14)


# ---- in time -----------------------------------------------------------------------------------

LENGTH, WIDTH, HEAVY = 0.5, 0.06, 1e10


def swinging(_t: float, y: np.ndarray) -> np.ndarray:
    """A planar double pendulum of equal rods; both angles are from the vertical."""
    p, q, u, v = y
    half, square = 0.5 * LENGTH, (LENGTH**2 + WIDTH**2) / 12.0
    sine, cosine = np.sin(p - q), np.cos(p - q)
    light, mixed = 1.0 / HEAVY, LENGTH * half * cosine  # per heavy rod's mass
    matrix = [[light * (square + half**2) + LENGTH**2, mixed], [mixed, square + half**2]]
    push = [
        -LENGTH * half * sine * v * v - (light * half + LENGTH) * 9.81 * np.sin(p),
        LENGTH * half * sine * u * u - half * 9.81 * np.sin(q),
    ]
    return np.array([u, v, *np.linalg.solve(matrix, push)])


@pytest.mark.long
def test_a_heavy_rod_on_a_light_one_swings_as_lagrange_says():
    along = {"body_point": (0.0, 0.0, 0.5 * LENGTH), "axis": (0.0, 1.0, 0.0)}
    links, parent = [], "ground"
    for name, mass in (("light", 1.0), ("heavy", HEAVY)):
        hang = (0.0, 0.0, -0.5 * LENGTH if links else 0.0)
        joint = lierb.joints.from_rows(ROWS["point"], parent_point=hang, **along)
        rod = lierb.bodies.box((WIDTH, WIDTH, LENGTH), mass=mass)
        links.append(lierb.Link(name, rod, joint, parent))
        parent = name
    made = lierb.Mechanism(links, gravity=(0.0, 0.0, -9.81))
    plain = lierb.joints.revolute
    turned = lierb.Mechanism([
        lierb.Link(x.name, x.body, plain(body_frame=x.joint.body_frame,
                                         ground_frame=x.joint.ground_frame), x.parent)
        for x in links
    ])  # fmt: skip
    pose0 = turned.pose({"light": 0.7, "heavy": 0.5})
    twist0 = turned.twist({"light": 0.2, "heavy": -0.3}, pose0)
    run = lierb.integrate(made, pose0=pose0, twist0=twist0, dt=2.5e-4, t_end=1.0)
    start = (0.7, 1.2, 0.2, -0.1)
    end = solve_ivp(swinging, (0.0, 1.0), start, "DOP853", rtol=1e-13, atol=1e-14).y[:2, -1]
    angles = [np.arctan2(r[0, 2], r[0, 0]) for r in (run[n].rotation[0] for n in made.names)]
    # RK4 leaves 1e-12 at 0.25 ms; by one Schur complement of all rows it was 3e-7.
    off = np.remainder(angles - end + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0.0, rtol=0.0, atol=5e-12)

"""Gears on trees in memory, beside the formulas of unrolled code on NumPy's numbers and SciPy on
MuJoCo's matrices.
"""

import mujoco
import numpy as np
import pytest
from cases import column
from derivatives import test_of_looped_code
from scipy.integrate import solve_ivp

import lierb
from lierb.compiler.entries import kernels_loaded
from lierb.kernels.systems.connection_table import legs_of
from lierb.runs import lane_engine
from lierb.runs.options import Options
from lierb.runs.starts import ready
from mechanisms.shared import bits
from mechanisms.test_looped_constraints import (
    DT,
    KEPT,
    RECORDED,
    STEPS,
    TIGHT,
    agree,
    driven,
    looped,
)
from mechanisms.test_tree_loop import body, tree_of

COUNT = 4  # trajectories, each with ratios of its own
GRAVITY = (0.4, -0.3, -9.81)
gear = lierb.forces.gear


# ---- the way of the wrenches -------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(50))
def test_every_node_hands_on_once_what_acts_on_it_and_behind_it(seed):
    """Right: each wrench reaches all nodes between its own and the ground, all at one time."""
    rng = np.random.default_rng(seed)
    above = [-1, *(int(rng.integers(0, i)) for i in range(1, 9))]
    ends = [int(i) for i in rng.integers(0, 9, 2 + 2 * (seed % 2))]
    carried, handed = [{end} for end in range(len(ends))], {}
    for end, joining, nodes in legs_of(above, ends):
        if joining:
            carried[end] |= carried[joining]
        for node in nodes:
            assert node not in handed
            handed[node] = {*carried[end]}
    expected = {}
    for end, node in enumerate(ends):
        while node > 0:
            expected.setdefault(node, set()).add(end)
            node = above[node]
    assert handed == expected


# ---- the same motion and the same forces -------------------------------------------------------


def started(mechanism, rng):
    """Poses that close, and rates that all constraints allow."""
    names = {link.name: len(link.joint.coordinate_names) for link in mechanism.links}
    drawn = lambda: {n: rng.uniform(-1.0, 1.0, (COUNT, k)) for n, k in names.items() if k}
    pose0 = mechanism.close(mechanism.pose(drawn()))
    return {"pose0": pose0, "twist0": mechanism.project(mechanism.twist(drawn(), pose0), pose0)}


def steady(t, params):
    return params.rate


def with_gears(mechanism, pairs, slides, driven, rng, **more):
    """Gears of turns, racks of a slide and a turn, a motor; the first gear is there twice."""
    ratios = lambda: rng.uniform(-2.0, 2.0, COUNT)
    gears = [gear(ratios()).on(*pair) for pair in pairs]
    rack = gear(0.1 * ratios(), coordinates=("slide", "turn"))
    forces = [
        gears[0], *gears, *(rack.on(*pair) for pair in slides),
        lierb.forces.motor(speed=steady, rate=ratios()).on(driven),
    ]  # fmt: skip
    made = lierb.Mechanism(mechanism.links, mechanism.loops, gravity=GRAVITY, forces=forces, **more)
    return made, started(made, rng)


SLIDING = ("prismatic", "screw", "cylindrical")
# The joints of a gear are on one parent, one above the other, in two branches, on the ground.
TREES = {
    "chain": ("revolute", "prismatic", "revolute", "screw", "revolute", "cylindrical", "revolute"),
    "few": ("revolute", "revolute", "cylindrical", "revolute"),
    "branched": ("screw", "universal", "revolute", "revolute", "prismatic", "revolute"),
    "floating": ("free", "revolute", "revolute", "planar", "prismatic"),
}


def geared(name, seed):
    rng, joints = np.random.default_rng(seed), TREES[name]
    turning = [f"link{i}" for i, joint in enumerate(joints) if joint == "revolute"]
    sliding = [f"link{i}" for i, joint in enumerate(joints) if joint in SLIDING]
    rng.shuffle(turning)
    pairs = [turning[:2], turning[1:3]][: len(turning) - 2 or 1]
    racks = [(sliding[0], turning[0])]
    return with_gears(tree_of(joints, seed), pairs, racks, turning[-1], rng)


@pytest.mark.slow
@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_gears_move_and_react_as_by_unrolled_formulas(name, seed):
    agree(*geared(name, seed), stabilise=KEPT)


@pytest.mark.long
@pytest.mark.parametrize("stabilise", [None, "project"])
@pytest.mark.parametrize("name", TREES)
def test_gears_drift_and_are_projected_as_by_unrolled_formulas(name, stabilise):
    agree(*geared(name, 3), stabilise=stabilise)


def geared_loop():
    """The four-bar of `driven`, whose loop's hinge is geared to a wheel and to a rotor on the
    coupler. The two are geared to each other as well, which is redundant.
    """
    given, start = driven()
    rng, place = np.random.default_rng(4), np.eye(4)
    place[:3, 3] = 0.1, 0.0, 0.05
    hinge = lierb.joints.revolute(parent_point=place[:3, 3])
    first, second = rng.uniform(0.5, 2.0, (2, COUNT))
    links = [lierb.Link("wheel", body(rng), hinge), lierb.Link("rotor", body(rng), hinge, "link1")]
    gears = [
        gear(first).on("wheel", "loop0"), gear(-second).on("loop0", "rotor"),
        gear(-first * second).on("wheel", "rotor"),
    ]  # fmt: skip
    mechanism = lierb.Mechanism(
        [*given.links, *links], given.loops, gravity=given.gravity,
        constraints=given.constraints, forces=[*given.forces, *gears],
    )  # fmt: skip
    pose0 = start["pose0"] | {"wheel": place, "rotor": start["pose0"]["link1"] @ place}
    twist0 = start["twist0"] | {"wheel": np.zeros(6), "rotor": np.zeros(6)}
    return mechanism, {"pose0": pose0, "twist0": mechanism.project(twist0, pose0)}


@pytest.mark.long
def test_gears_on_loops_beside_motors_and_constraints_act_as_by_unrolled_formulas():
    agree(*geared_loop(), stabilise="project")


# ---- beside others -----------------------------------------------------------------------------

LINKS = 10
AXES = np.random.default_rng(7).normal(size=(LINKS, 3))
SLIDES, DRIVEN = (3, 7), 5


def chain_of_mujoco():
    """Hinges and slides on axes in general directions."""
    opened = closed = ""
    for i, axis in enumerate(AXES):
        kind = "slide" if i in SLIDES else "hinge"
        opened += f"""<body name="l{i}" pos="{0.2 * (i > 0)} 0.05 -0.1" euler="{0.1 * i} 0.2 -0.3">
          <joint name="l{i}" type="{kind}" axis="{axis[0]} {axis[1]} {axis[2]}" pos="0.01 0.02 0"/>
          <inertial pos="0.1 0.01 {-0.02 * i}" mass="{1 + 0.1 * i}" euler="0.3 0.1 0"
            diaginertia="0.01 0.012 0.009"/>"""
        closed += "</body>"
    return f"""<mujoco><compiler angle="radian"/><option gravity="0.3 -0.2 -9.81"/>
      <worldbody>{opened}{closed}</worldbody></mujoco>"""


def mass_matrix(model, data):
    matrix = np.zeros((LINKS, LINKS))
    old = hasattr(data, "qM")
    mujoco.mj_fullM(model, matrix, data.qM) if old else mujoco.mj_fullM(model, data, matrix)
    return matrix


@pytest.mark.slow
def test_ten_links_with_gears_move_and_react_as_scipy_says(tmp_path):
    """Right: KKT of MuJoCo's mass matrix and bias with the rows of gears and motor, by SciPy.

    Their code is that of the trees above.
    """
    looped(*geared("few", 1), **RECORDED, stabilise=KEPT)
    path = tmp_path / "chain.xml"
    path.write_text(chain_of_mujoco())
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    bevels, racks, rates = np.array([-1.5, 0.7]), np.array([0.1, -0.2]), np.array([0.8, -0.4])
    read = lierb.Mechanism.from_mjcf(path)
    mechanism = lierb.Mechanism(
        read.links, gravity=read.gravity,
        forces=[
            gear(bevels).on("l6", "l1"),
            gear(racks, coordinates=("slide", "turn")).on("l3", "l9"),
            lierb.forces.motor(speed=steady, rate=rates).on(f"l{DRIVEN}"),
        ],
    )  # fmt: skip
    signs = np.array([
        np.sign(link.joint.body_frame[:3, 2] @ AXES[i]) for i, link in enumerate(mechanism.links)
    ])  # fmt: skip
    place, speed = 0.1 * np.arange(LINKS) - 0.3, np.sin(np.arange(LINKS) + 1.0)
    q = np.broadcast_to(signs * place, (2, LINKS))
    v = np.tile(signs * speed, (2, 1))
    v[:, 6], v[:, 3], v[:, DRIVEN] = bevels * v[:, 1], racks * v[:, 9], rates
    by_name = lambda x: {f"l{i}": x[:, i : i + 1] for i in range(LINKS)}
    pose0 = mechanism.pose(by_name(q))
    start = {"pose0": pose0, "twist0": mechanism.twist(by_name(v), pose0)}
    before = kernels_loaded()
    result = looped(mechanism, start, dt=1e-3, t_end=0.1, stabilise=KEPT, **RECORDED)
    assert kernels_loaded() == before
    ends = mechanism.velocities(result.end["twist0"], result.end["pose0"])
    for k in range(2):
        rows = np.zeros((3, LINKS))
        rows[0, [6, 1]], rows[1, [3, 9]], rows[2, DRIVEN] = (1, -bevels[k]), (1, -racks[k]), 1
        rows *= signs

        def solved(y, rows=rows):
            data.qpos[:], data.qvel[:] = np.split(y, 2)
            mujoco.mj_forward(model, data)
            system = np.block([[mass_matrix(model, data), rows.T], [rows, np.zeros((3, 3))]])
            return np.linalg.solve(system, np.concatenate([-data.qfrc_bias, np.zeros(3)]))

        rate = lambda _, y, solved=solved: np.concatenate([y[LINKS:], solved(y)[:LINKS]])
        first = np.concatenate([place, signs * v[k]])
        y = solve_ivp(rate, (0.0, 0.1), first, "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
        moved = np.array([ends[f"l{i}"][k] for i in range(LINKS)]).ravel()
        np.testing.assert_allclose(moved, signs * y[LINKS:], rtol=0, atol=1e-8)
        expected = solved(y)[LINKS:]
        names = ("l6.gear", "l3.gear", f"l{DRIVEN}.motor")
        table = result.history
        last = [column(table, f"{n}.lambda").reshape(-1, 2)[-1, k] for n in names]
        np.testing.assert_allclose(last, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_gears_drive_ten_links_in_looped_code():
    """They would be unrolled otherwise, which takes minutes to compile."""
    mechanism, start = chain_with_gears(np.ones(1))
    options = Options.of(mechanism, dt=DT, t_end=DT * STEPS)
    assert ready(mechanism, options, **start).plan.is_in_memory


# ---- bits, and adaptive steps ------------------------------------------------------------------


def chain_with_gears(ratio):
    links = tree_of(("revolute",) * LINKS, seed=2).links
    forces = [gear(ratio).on("link6", "link1"), gear(0.5).on("link9", "link2")]
    mechanism = lierb.Mechanism(links, gravity=GRAVITY, forces=forces)
    rates = {link.name: 0.3 * i - 1.0 + 0.0 * ratio[:, None] for i, link in enumerate(links)}
    pose0 = mechanism.pose(rates)
    return mechanism, {
        "pose0": pose0, "twist0": mechanism.project(mechanism.twist(rates, pose0), pose0)
    }  # fmt: skip


@pytest.mark.long
def test_bits_of_geared_lanes_depend_on_nothing_else(monkeypatch):
    ratio = np.linspace(-2.0, 2.0, 11)
    run = lambda which, **options: bits(looped(*chain_with_gears(which), **TIGHT, **options))
    expected = run(ratio)
    order = np.random.default_rng(2).permutation(11)
    np.testing.assert_array_equal(run(ratio[order]), expected[order])
    np.testing.assert_array_equal(run(ratio[[4]]), expected[[4]])
    np.testing.assert_array_equal(run(ratio, threads=2), expected)
    monkeypatch.setattr(lane_engine, "FIRST_ITERATIONS", 1)
    monkeypatch.setattr(lane_engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(run(ratio), expected)


@pytest.mark.long
def test_adaptive_steps_keep_ratio_and_energy():
    """Right: gears do no work."""
    ratio = np.linspace(-2.0, 2.0, COUNT)
    mechanism, start = chain_with_gears(ratio)
    result = looped(mechanism, start, **TIGHT)
    rates = mechanism.velocities(result.end["twist0"], result.end["pose0"])
    np.testing.assert_allclose(rates["link6"][:, 0], ratio * rates["link1"][:, 0], atol=1e-12)
    assert np.abs(result.summary["energy_drift_max"]).max() < 1e-6  # J, of about 100 J


# ---- derivatives -------------------------------------------------------------------------------


@pytest.mark.long
def test_derivatives_by_ratios_are_those_of_unrolled_formulas():
    base = tree_of(("revolute", "prismatic", "revolute", "revolute", "cylindrical"), seed=5)
    ratio, radius = np.linspace(-2.0, 2.0, COUNT), 0.1
    forces = [gear(ratio).on("link3", "link0"), gear(radius).on("link1", "link2")]
    mechanism = lierb.Mechanism(base.links, gravity=GRAVITY, forces=forces)
    names = (
        "link3.gear.ratio", "link1.gear.ratio", "gravity", "link2.body.mass",
        "link0.joint.body_point",
    )  # fmt: skip
    start = started(mechanism, np.random.default_rng(6))
    test_of_looped_code.agree(mechanism, start, names, stabilise=KEPT)

"""Code that loops over the nodes of a tree in memory, compiled once for all trees.

It is compared with the formulas of unrolled code, evaluated by NumPy, which share the equations of
a joint but no recursion, no axes and no memory with it; and with MuJoCo.
"""

import numpy as np
import pytest
from cases import slow_but
from scipy.spatial.transform import Rotation

import lierb
from lierb.compiler.entries import kernels_loaded
from lierb.errors import ArgumentError, FailedTrajectoryWarning, MemoryLimitError
from lierb.kernels.numbers.vec import Vec
from lierb.runs import engine, lane_engine
from lierb.runs.options import Options
from lierb.runs.starts import ready
from lierb.support import memory
from mechanisms.shared import bits, stepped

GRAVITY = (0.4, -0.3, -9.81)
ENTRIES = lierb.joints.JOINTS
MOTIONS = tuple(name for name, joint in ENTRIES.items() if joint.subgroup or joint.factors)
SIX = ("revolute", "universal", "free", "screw", "cylindrical", "spherical")
# Accelerations reach 1e3 in these trees: rounding of ten steps of 0.01 s, in each of two ways.
CLOSE = {"rtol": 1e-13, "atol": 1e-12}


def frame(rng) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return matrix


def body(rng) -> lierb.Body:
    turn, com, mass = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3), 1.3
    inertia = turn @ np.diag((0.02, 0.03, 0.04)) @ turn.T
    return lierb.Body(mass, inertia + mass * (com @ com * np.eye(3) - np.outer(com, com)), com)


def tree_of(names, seed=0, forces=()) -> lierb.Mechanism:
    """Links on the ground or on one of the last three links, with frames turned in all ways."""
    rng, links = np.random.default_rng(seed), []
    for i, name in enumerate(names):
        values = {"pitch": 0.2} if "pitch" in ENTRIES[name].options else {}
        joint = ENTRIES[name](body_frame=frame(rng), parent_frame=frame(rng), **values)
        above = rng.integers(max(0, i - 3), i) if i and rng.random() < 0.9 else None
        parent = "ground" if above is None else f"link{above}"
        links.append(lierb.Link(f"link{i}", body(rng), joint, parent))
    return lierb.Mechanism(links, gravity=GRAVITY, forces=forces)


def start_of(mechanism, count=4, speed=2.0):
    """Poses and twists in random coordinates and rates, one for each of `count` trajectories."""
    rng = np.random.default_rng(1)

    def drawn(size):
        moving = [link for link in mechanism.links if link.joint.name in MOTIONS]
        widths = {link.name: len(link.joint.coordinate_names) for link in moving}
        return {n: rng.uniform(-size, size, (count, width)) for n, width in widths.items() if width}

    pose0 = mechanism.pose(drawn(1.0))
    return {"pose0": pose0, "twist0": mechanism.twist(drawn(speed), pose0)}


def in_numpy(mechanism, start, trajectory, method="RK4") -> dict[str, Vec]:
    """R, r, ω, v of every link after ten steps, by the formulas of unrolled code on floats."""
    options = Options.of(mechanism, dt=0.01, t_end=0.1, method=method, solver="unrolled")
    run = ready(mechanism, options, **start)
    numbers = run.inputs.numbers(trajectory)
    system, constants, state = stepped(run, numbers, 0.01, 10)
    found = system.in_user_frames(constants, numbers, state)
    return dict(zip(mechanism.names, (np.array(x, float) for x in found), strict=True))


def numbers_of(result, name, trajectory) -> np.ndarray:
    view = result[name]
    parts = (view.rotation, view.position, view.omega, view.v)
    return np.concatenate([np.ravel(part[trajectory]) for part in parts])


def looped(mechanism, start, **options):
    options = {"dt": 0.01, "t_end": 0.1, "solver": "looped"} | options
    return lierb.integrate(mechanism, **start, **options)


def agree(mechanism, method="RK4"):
    start = start_of(mechanism)
    result = looped(mechanism, start, method=method)
    assert result.summary["status"].to_pylist() == ["ok"] * 4
    for trajectory in (0, 3):
        expected = in_numpy(mechanism, start, trajectory, method)
        for name, numbers in expected.items():
            np.testing.assert_allclose(numbers_of(result, name, trajectory), numbers, **CLOSE)


def part(start, which):
    """Some members of a batch's start."""
    return {k: {n: x[which] for n, x in by_link.items()} for k, by_link in start.items()}


# ---- the same motion ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK4", pytest.param("DOP853", marks=pytest.mark.long)])
def test_every_joint_moves_as_by_unrolled_formulas(method):
    agree(tree_of(MOTIONS * 2), method)


@pytest.mark.parametrize("seed", slow_but(range(4), 0, 1))
def test_random_trees_move_as_by_unrolled_formulas(seed):
    rng = np.random.default_rng(seed)
    agree(tree_of(rng.choice(MOTIONS, 2 + 2 * seed), seed))


@pytest.mark.long
def test_links_on_fixed_joints_move_with_their_parents():
    agree(tree_of(("revolute", "fixed", "universal", "fixed", "spherical", "fixed", "revolute")))


@lierb.wrench(stiffness=2.0)
def swaying(t, R, r, omega, v, params):
    return -0.1 * omega, R.T @ np.array((np.sin(3.0 * t), 0.0, -params.stiffness * r[2]))


@pytest.mark.long
def test_a_users_force_acts_as_in_unrolled_formulas():
    agree(tree_of(SIX, forces=(swaying().on("link3"), swaying(stiffness=1.0).on("link5"))))


@pytest.mark.slow
def test_forces_act_as_in_unrolled_formulas():
    spring = lierb.forces.spring_damper(
        (0.1, 0.2, 0.0), (0.5, 0.0, 0.0), stiffness=7.0, damping=0.4, length=0.3
    )
    forces = (
        spring.on("link2"),
        spring.on("link4", "link1"),
        lierb.forces.torsional_spring(stiffness=3.0, damping=0.2).on("link3"),
        lierb.forces.drag(linear=0.2, angular=0.1).on("link5"),
        lierb.forces.joint_friction(coulomb=0.3, speed=0.5).on("link0"),
    )
    agree(tree_of(("revolute", *SIX[1:3], "revolute", *SIX[4:]), forces=forces))


@pytest.mark.long
def test_all_columns_are_those_of_unrolled_code():
    drag = lierb.forces.drag(linear=0.2, angular=0.1).on("link1")
    mechanism = tree_of(("screw", "universal"), forces=(drag,))
    recorded = {"save_every": 5, "record": ("state", "energy", "multipliers", "reaction")}
    both = [
        looped(mechanism, start_of(mechanism), solver=solver, **recorded)
        for solver in ("looped", "unrolled")
    ]
    for tables in ([r.summary for r in both], [r.history for r in both]):
        found, expected = tables
        assert found.schema.equals(expected.schema, check_metadata=False)
        for name in found.column_names:
            columns = (np.array(table[name].to_pylist()) for table in (found, expected))
            if name == "status":
                np.testing.assert_array_equal(*columns)
            else:
                np.testing.assert_allclose(*columns, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("links", slow_but([20, 40, 100], 20))
def test_chains_move_as_in_mujoco(links, tmp_path):
    """Both make RK4 steps in the same angles, so that they differ by rounding alone."""
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(links)
    axes, angles = rng.normal(size=(links, 3)), rng.uniform(-0.5, 0.5, links)
    body = '<body name="b{}" pos="0 0 {}"><joint name="j{}" axis="{} {} {}" pos="0 0 .1"/><inertial pos="0 .02 0" mass="1" diaginertia=".01 .02 .015"/>'  # noqa: E501
    bodies = "".join(
        body.format(i, -0.2 if i else 0, i, *axis) for i, axis in enumerate(axes.tolist())
    )
    text = f"<mujoco><worldbody>{bodies}{'</body>' * links}</worldbody></mujoco>"
    (tmp_path / "chain.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = 5e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    for _ in range(100):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    chain = lierb.Mechanism.from_mjcf(tmp_path / "chain.xml")
    pose0 = chain.pose({f"b{i}": angle for i, angle in enumerate(angles)})
    result = lierb.integrate(
        chain, pose0=pose0, twist0=chain.twist(None, pose0), dt=5e-4, t_end=0.05
    )
    for name in (f"b{i}" for i in range(links)):
        np.testing.assert_allclose(result[name].position[0], data.body(name).xpos, atol=1e-12)


# ---- one compilation, the same bits --------------------------------------------------------------


def test_another_tree_needs_no_other_kernel():
    first, second = tree_of(SIX), tree_of(("prismatic", *SIX[::-1]), seed=3)
    looped(first, start_of(first))
    before = kernels_loaded()
    looped(second, start_of(second))
    assert kernels_loaded() == before


def test_bits_do_not_depend_on_the_batch_the_place_or_the_threads():
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 19, speed=5.0)

    expected = bits(looped(mechanism, start))
    order = np.random.default_rng(2).permutation(19)
    np.testing.assert_array_equal(bits(looped(mechanism, part(start, order))), expected[order])
    np.testing.assert_array_equal(bits(looped(mechanism, part(start, [4]))), expected[[4]])
    np.testing.assert_array_equal(bits(looped(mechanism, start, threads=2)), expected)


def test_bits_do_not_depend_on_breaks(monkeypatch):
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 5)
    expected = bits(looped(mechanism, start, t_end=0.4))
    half = looped(mechanism, start, t_end=0.2).end
    rest = looped(mechanism, {}, t_end=0.4, **half)
    states = [n for n in rest.summary.column_names if n.endswith(("rotation", "position", "omega"))]
    whole = looped(mechanism, start, t_end=0.4)
    for name in states:
        columns = (r.summary[name].to_pylist() for r in (rest, whole))
        np.testing.assert_array_equal(*columns)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 3)
    engine._pace.cache_clear()
    np.testing.assert_array_equal(bits(looped(mechanism, start, t_end=0.4)), expected)
    engine._pace.cache_clear()


ADAPTIVE = {"dt": None, "rtol": 1e-8, "t_end": 0.5, "method": "DOP853"}


@pytest.mark.long
def test_adaptive_steps_reach_the_motion_of_small_steps():
    """DOP853 at 0.5 ms leaves rounding; the tolerance of a step is 1e-11."""
    mechanism = tree_of(SIX)
    start = start_of(mechanism)
    fine = looped(
        mechanism, start, dt=5e-4, t_end=0.3, method="DOP853", save_every=100, record="state"
    )
    tight = ADAPTIVE | {"rtol": 1e-11, "atol": 1e-11, "t_end": 0.3}
    found = looped(mechanism, start, **tight, save_at=fine["link0"].t, record="state")
    for name in mechanism.names:
        for part in ("position", "rotation", "omega", "v"):
            pair = (getattr(result[name], part) for result in (found, fine))
            np.testing.assert_allclose(*pair, rtol=1e-9, atol=1e-8)


@pytest.mark.slow
def test_bits_of_adaptive_steps_depend_on_nothing_else(monkeypatch):
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 19, speed=5.0)

    expected = bits(looped(mechanism, start, **ADAPTIVE))
    order = np.random.default_rng(2).permutation(19)
    np.testing.assert_array_equal(
        bits(looped(mechanism, part(start, order), **ADAPTIVE)), expected[order]
    )
    np.testing.assert_array_equal(
        bits(looped(mechanism, part(start, [4]), **ADAPTIVE)), expected[[4]]
    )
    np.testing.assert_array_equal(bits(looped(mechanism, start, **ADAPTIVE, threads=2)), expected)
    monkeypatch.setattr(lane_engine, "FIRST_ITERATIONS", 1)
    monkeypatch.setattr(lane_engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(bits(looped(mechanism, start, **ADAPTIVE)), expected)


@pytest.mark.long  # test_looped_elements.py has rows beside other rows
def test_rows_between_steps_change_no_bit():
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 11, speed=5.0)
    rows = {"save_at": np.linspace(0.0, 0.5, 40), "record": ("state", "energy")}
    plain, saved = (looped(mechanism, start, **ADAPTIVE, **more) for more in ({}, rows))
    for name in mechanism.names:
        last = (plain[name].position, saved[name].position[-1])
        np.testing.assert_array_equal(*(x.view(np.int64) for x in last))
    assert plain.summary["steps"].to_pylist() == saved.summary["steps"].to_pylist()
    drift = np.array(saved.history["energy_drift"].to_pylist())
    assert np.abs(drift).max() < 1e-4  # of about 100 J, between steps as well


@pytest.mark.slow
def test_an_adaptive_run_goes_on_to_the_bits_of_one_run():
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 5)
    whole = looped(mechanism, start, **ADAPTIVE | {"t_end": 0.6}, save_at=[0.3, 0.6])
    first = looped(mechanism, start, **ADAPTIVE | {"t_end": 0.3})
    rest = looped(mechanism, {}, **ADAPTIVE | {"t_end": 0.6}, **first.end)
    assert np.isfinite(rest["link5"].position).all()
    np.testing.assert_allclose(rest["link5"].position, whole["link5"].position, atol=1e-6)


# ---- failures, refusals, long runs ---------------------------------------------------------------


def test_a_trajectory_that_fails_leaves_the_others_alone():
    mechanism = tree_of(SIX)
    start = start_of(mechanism, 9)
    expected = bits(looped(mechanism, start))
    for twists in start["twist0"].values():
        twists[4] *= 1e120
    with pytest.warns(FailedTrajectoryWarning):
        result = looped(mechanism, start, save_every=1, record=("state",))
    statuses = result.summary["status"].to_pylist()
    assert statuses == ["ok"] * 4 + ["non_finite"] + ["ok"] * 4
    assert np.isnan(result["link5"].position[-1, 4]).all()
    fine = [i for i in range(9) if i != 4]
    np.testing.assert_array_equal(bits(result)[fine], expected[fine])


def test_what_loops_cannot_run_is_refused_by_name():
    mechanism = tree_of(("point_on_line", "revolute"))
    start = {"pose0": mechanism.pose(), "twist0": mechanism.twist()}
    with pytest.raises(ArgumentError, match='solver="looped" does not support joints whose'):
        looped(mechanism, start)
    tree = tree_of(("revolute", "revolute"))
    with pytest.raises(ArgumentError, match='does not support update="ambient"'):
        looped(tree, start_of(tree), update="ambient")
    body = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.spherical())
    for solver, cspace in (("looped", "SE3"), ("unrolled", "SE3"), ("looped", "reduced")):
        with pytest.raises(ArgumentError, match=r"is for a lierb\.Mechanism; leave"):
            lierb.integrate(body, twist0=[0.0] * 6, dt=0.1, t_end=0.1, solver=solver, cspace=cspace)
    with pytest.raises(ArgumentError, match="looped, unrolled"):
        looped(tree, start_of(tree), solver="saddle")


def test_memory_that_a_tree_takes_on_all_threads_is_asked_for(monkeypatch):
    mechanism = tree_of(SIX)
    start = start_of(mechanism)
    monkeypatch.setattr(memory, "ALWAYS", 0)
    monkeypatch.setattr(memory, "available", lambda: 100_000)
    with pytest.raises(MemoryLimitError, match=r"memory for 6 links takes .* lower threads="):
        looped(mechanism, start, threads=2)


@pytest.mark.slow
def test_joints_are_kept_and_rotations_stay_orthogonal_for_long():
    mechanism = tree_of(("screw", "universal", "revolute"))
    result = looped(mechanism, start_of(mechanism, 8), dt=2e-3, t_end=400.0)
    summary, size = result.summary, np.abs(result["link0"].position).max()
    worst = {
        n: max(summary[n].to_pylist()) for n in summary.column_names if n.endswith("error_max")
    }
    assert max(worst.values()) < 1e-13 * (1.0 + size), worst

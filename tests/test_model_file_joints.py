"""Stops, springs and couplings of files' joints, and the names of links.

Motions are compared with SciPy's, of MuJoCo's mass matrix and bias, with stops and rows as given.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import LeftOutWarning

mujoco = pytest.importorskip("mujoco")

STIFFNESS = 50.0
LIGHT = "links without mass or inertia, which have 1e-12 of what hangs on them: "


def body(name, joints, inside="", pos="0 0 0"):
    inertial = '<inertial pos=".2 0.03 0.05" mass="1.3" diaginertia="0.03 0.04 0.05"/>'
    return f'<body name="{name}" pos="{pos}" euler=".2 -.3 .1">{joints}{inertial}{inside}</body>'


def read(tmp_path, bodies, equalities="", **options):
    """Path, mechanism, and what it lacks."""
    path = tmp_path / "model.xml"
    path.write_text(f"""<mujoco><compiler angle="radian" autolimits="true"/>
      <option gravity="0.3 0 -9.81"/><worldbody>{bodies}</worldbody>
      <equality>{equalities}</equality></mujoco>""")
    return path, *read_file(path, **options)


def read_file(path, **options):
    load = lierb.Mechanism.from_urdf if path.suffix == ".urdf" else lierb.Mechanism.from_mjcf
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LeftOutWarning)
        mechanism = load(path, **options)
    return mechanism, caught[0].message.left_out if caught else ()


def right_end(path, q0, v0, t, rows=()):
    """Places of all bodies after t.

    rows : (joint, other, coefficients) of q = p(q of the other), relative to qpos0; or (joint,).
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, n = mujoco.MjData(model), model.nv

    def rates(_, y):
        data.qpos[:], data.qvel[:] = y[:n], y[n:]
        mujoco.mj_forward(model, data)
        M, J, bend = np.zeros((n, n)), np.zeros((len(rows), n)), np.zeros(len(rows))
        old = hasattr(data, "qM")
        mujoco.mj_fullM(model, M, data.qM) if old else mujoco.mj_fullM(model, data, M)
        lower, upper = model.jnt_range.T
        beyond = np.maximum(y[:n] - upper, 0.0) + np.minimum(y[:n] - lower, 0.0)
        load = data.qfrc_passive - data.qfrc_bias - STIFFNESS * model.jnt_limited * beyond
        for k, (own, *coupled) in enumerate(rows):
            J[k, model.joint(own).id] = 1.0
            if coupled:
                other, slope = model.joint(coupled[0]).id, Polynomial(coupled[1]).deriv()
                from_start = data.qpos[other] - model.qpos0[other]
                J[k, other] = -slope(from_start)
                bend[k] = slope.deriv()(from_start) * data.qvel[other] ** 2
        system = np.block([[M, J.T], [J, np.zeros((len(rows), len(rows)))]])
        return np.r_[y[n:], np.linalg.solve(system, np.r_[load, bend])[:n]]

    accuracy = {"rtol": 1e-10, "atol": 1e-11, "method": "DOP853", "max_step": 5e-3}
    data.qpos[:] = solve_ivp(rates, (0.0, t), np.r_[q0, v0], **accuracy).y[:n, -1]
    mujoco.mj_kinematics(model, data)
    return data


def assert_same_end(mechanism, coordinates, rates, t, right, solver, allowed=1e-9):
    """Both are accurate to some 1e-11, or 1e-7 where steps cross the kinks of stops."""
    pose0 = mechanism.pose(coordinates)
    twist0 = mechanism.twist(rates, pose0)
    run = {"rtol": 1e-10, "t_end": t, "solver": solver}
    result = lierb.integrate(mechanism, pose0=pose0, twist0=twist0, **run)
    assert result.failed.size == 0
    for name in mechanism.names:
        if mujoco.mj_name2id(right.model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0:
            place, link = right.body(name), result[name]
            np.testing.assert_allclose(link.position[0], place.xpos, rtol=0, atol=allowed)
            np.testing.assert_allclose(link.rotation[0].ravel(), place.xmat, rtol=0, atol=allowed)


def hinge(limits, more="", name="j", axis="0 1 0"):
    return f'<joint name="{name}" axis="{axis}" range="{limits}" {more}/>'


# ---- stops and springs that count turns --------------------------------------------------------


@pytest.mark.parametrize(
    ("joint", "stops", "start"),
    [
        (hinge("-10 10"), (-10.0, 10.0), 0.0),
        (hinge("-6.28 6.28"), (-6.28, 6.28), 0.0),
        (hinge("-3.14 3.14"), (-3.14, 3.14), 0.0),  # a pose is beyond them for 3 mrad alone
        (hinge("3.5 5"), (3.5, 5.0), 2.0),
        (hinge("-5 -3.5"), (-5.0, -3.5), -2.0),
        (hinge("4.5 15", 'ref="5"'), (-0.5, 10.0), 2.5),
        (hinge("-1 1"), (-1.0, 1.0), None),
        (hinge("3.5 5", 'ref="4"'), (-0.5, 1.0), None),
        ('<joint type="slide" axis="0 0 1" range="-7 20"/>', (-7.0, 20.0), None),
    ],
)
def test_stops_of_hinges_count_turns_where_a_pose_does_not(tmp_path, joint, stops, start):
    """Limits relative to qpos0; the count starts within half a turn of 0, and of the limits."""
    _, mechanism, left_out = read(tmp_path, body("a", joint), limit_stiffness=STIFFNESS)
    (force,) = mechanism.forces
    found = force.parameters["lower"], force.parameters["upper"]
    np.testing.assert_allclose(found, stops, rtol=1e-15)
    counted = [(state.name, float(state.parameters["start"])) for state in mechanism.states]
    assert counted == ([] if start is None else [("turned_a", pytest.approx(start, abs=1e-15))])
    assert left_out == ()


SPRUNG = 'stiffness="2" springref="{}"'


@pytest.mark.parametrize(
    ("joint", "stops", "start"),
    [
        ('<joint axis="0 1 0" stiffness="2"/>', True, 0.0),  # it may spin
        ('<joint axis="0 1 0" damping="2"/>', True, None),
        (hinge("-1 1", SPRUNG.format(0.5)), True, None),
        (hinge("-1 1", SPRUNG.format(0.5)), False, 0.0),  # nothing keeps it within the limits
        (hinge("-1.7 1.7", SPRUNG.format(2.4)), True, 0.0),
        (hinge("-0.5 1", SPRUNG.format(2.4)), True, 0.0),
        (hinge("0 1", SPRUNG.format(2.4)), True, None),
        (hinge("4 5", SPRUNG.format(4.5)), True, 2.0),  # at qpos0 the shorter way would be wrong
        (hinge("0 5.5", SPRUNG.format(1.0)), False, 2.5),
        (hinge("-5.5 0.5", SPRUNG.format(1.0)), False, -2.5),
        (hinge("-0.5 5.5", SPRUNG.format(-1.0), axis="0 -1 0"), False, 2.5),
    ],
)
def test_springs_of_hinges_count_turns_unless_stops_keep_them_near(tmp_path, joint, stops, start):
    """Half a turn about the start includes the limits and the angle at qpos0."""
    stiffness = STIFFNESS if stops else None
    _, mechanism, _ = read(tmp_path, body("a", joint), limit_stiffness=stiffness)
    assert [float(x.parameters["start"]) for x in mechanism.states] == [start] * (start is not None)
    for force in mechanism.forces:
        assert force.kind.turns == ("" if start is None else "turned_a")


@pytest.mark.long
def test_springs_pull_back_from_every_pose_within_the_limits_and_from_many_turns(tmp_path):
    """Right: s + (q₀ − s) cos ωt + v₀/ω sin ωt of two hinges; b spins six turns."""
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.006 0.006 0.006"/>'
    path = tmp_path / "springs.xml"
    path.write_text(f"""<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>
      <body name="a"><joint axis="0 0 1" range="-1.7 1.7" limited="true" stiffness="0.02"
        springref="2.4"/>{inertial}</body>
      <body name="b"><joint axis="0 0 1" stiffness="0.006"/>{inertial}</body>
      </worldbody></mujoco>""")
    mechanism, _ = read_file(path)
    q0 = np.linspace(-1.7, 1.7, 9)
    pose0 = mechanism.pose({"a": q0})
    twist0 = mechanism.twist({"b": 40.0}, pose0)
    result = lierb.integrate(mechanism, pose0=pose0, twist0=twist0, dt=1e-3, t_end=2.0)
    frequency = np.sqrt(0.02 / 0.006)
    right = 2.4 + (q0 - 2.4) * np.cos(2.0 * frequency)
    np.testing.assert_allclose(np.asarray(result["turned_a"]), right, rtol=0, atol=1e-10)
    right = np.full(9, 40.0 * np.sin(2.0))
    np.testing.assert_allclose(np.asarray(result["turned_b"]), right, rtol=0, atol=1e-10)


SCENES = {  # joints of a body; q0 and v0 of MuJoCo; q0 of links relative to qpos0
    "wide": (hinge("-10 10"), [0.0], [30.0], {}),
    "far_from_qpos0": (hinge("3.5 5"), [0.0], [1.0], {}),
    "far_from_between": (hinge("3.5 5", 'ref="1"'), [4.0], [1.0], {"": 3.0}),
    "nearly_a_turn": (hinge("-3.14 3.14"), [0.0], [20.0], {}),
    "wound": (
        hinge("-3.5 15", 'ref="4" springref="9" stiffness="2" damping="0.1"'), [4.0], [20.0], {},
    ),
    "far_from_slack": (hinge("-1.7 1.7", SPRUNG.format(2.4)), [-1.5], [0.0], {"": -1.5}),
    "spun": ('<joint axis="0 1 0" stiffness="1"/>', [0.0], [40.0], {}),
    "two": (
        hinge("-8 8", 'stiffness="1"', "p", "1 0 0")
        + hinge("4 9", 'stiffness="2" springref="5" damping="0.1"', "q"),
        [0.0, 4.5], [20.0, 3.0], {"": 4.5},
    ),
    "cylindrical": (
        '<joint axis="0 0 1" range="-4 9" stiffness="1" springref="5"/>'
        '<joint type="slide" axis="0 0 -1" range="-7 20"/>',
        [1.0, 0.3], [20.0, -1.0], {"": (1.0, -0.3)},
    ),
}  # fmt: skip
RATES = {"two_1": 20.0, "two": 3.0, "cylindrical": (20.0, 1.0)}  # of joints that are none alone


@pytest.mark.long
def test_far_stops_and_springs_act_where_those_of_the_file_do(tmp_path):
    """Bodies beside each other, on joints that have nothing to do with each other."""
    bodies, q0, v0, coordinates, rates = "", [], [], {}, {}
    for name, (joints, q, v, given) in SCENES.items():
        bodies += body(name, joints.replace('name="', f'name="{name}_'))
        q0, v0 = [*q0, *q], [*v0, *v]
        coordinates |= {f"{name}{end}": value for end, value in given.items()}
        rates |= {name: v[0]}
    path, mechanism, _ = read(tmp_path, bodies, limit_stiffness=STIFFNESS)
    right = right_end(path, q0, v0, 0.6)
    assert_same_end(mechanism, coordinates, rates | RATES, 0.6, right, "looped", 1e-6)


def test_limits_of_balls_and_of_composed_joints_are_listed(tmp_path):
    """With a stiffness the hinges of a universal joint stay separate, and have stops."""
    ball = body("a", '<joint name="p" type="ball" range="0 1" stiffness="1"/>')
    _, _, left_out = read(tmp_path, ball, limit_stiffness=STIFFNESS)
    assert left_out == ("joint p: stiffness and damping of a ball joint", "joint p: limits 0 … 1")
    universal = body("a", hinge("-1 1", "", "p", "1 0 0") + hinge("-4 9", "", "q"))
    _, whole, left_out = read(tmp_path, universal)
    assert whole.link("a").joint.name == "universal"
    assert left_out == ("joint p: limits -1 … 1", "joint q: limits -4 … 9")
    _, parted, left_out = read(tmp_path, universal, limit_stiffness=STIFFNESS)
    assert [(force.name, *force.at) for force in parted.forces] == [
        ("joint_limit", "a_1"), ("joint_limit", "a"),
    ]  # fmt: skip
    assert left_out == (f"{LIGHT}a_1",)


# ---- couplings ---------------------------------------------------------------------------------

UNIVERSAL = '<joint name="p" axis="1 0 0"/><joint name="q" axis="0 1 0"/>'
SCREW = '<joint name="s" type="slide" axis="0 0 -1"/><joint name="h" axis="0 0 1"/>'
PLANAR = (
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 0 1"/>'
    '<joint name="h" axis="0 1 0"/>'
)
OTHER = body("b", '<joint name="z" axis="0 0 1"/>', pos="1 0 0")
COUPLED = {  # bodies, joints and coefficients of the equality; q0, v0; coordinates, rates
    "universal": (
        body("a", UNIVERSAL) + OTHER, ("z", "q", (0.0, -2.0)), [0.2, 0.3, -0.6], [1.0, 2.0, -4.0],
        {"a_1": 0.2, "a": 0.3, "b": -0.6}, {"a_1": 1.0, "a": 2.0, "b": -4.0},
    ),
    "itself": (
        body("a", UNIVERSAL), ("p", "q", (0.1, -0.5)), [-0.1, 0.4], [-1.0, 2.0],
        {"a_1": -0.1, "a": 0.4}, {"a_1": -1.0, "a": 2.0},
    ),
    "screw": (
        body("a", SCREW), ("s", "h", (0.0, 0.1)), [0.05, 0.5], [0.1, 1.0],
        {"a_1": 0.05, "a": 0.5}, {"a_1": 0.1, "a": 1.0},
    ),
    "wheel": (
        body("a", PLANAR), ("x", "h", (0.0, -0.5)), [0.0, 0.3, 0.0], [-1.0, 1.0, 2.0],
        {"a_2": 0.3}, {"a_1": -1.0, "a_2": 1.0, "a": 2.0},
    ),
    "held": (
        body("a", UNIVERSAL + '<joint name="r" axis="0 0 1"/>'), ("q",), [0.1, 0.3, 0.2],
        [1.0, 0.0, 2.0], {"a_1": 0.1, "a_2": 0.3, "a": 0.2}, {"a_1": 1.0, "a": 2.0},
    ),
}  # fmt: skip


def equality(own, other=None, polynomial=(0.3, 0.0)):
    second = "" if other is None else f'joint2="{other}"'
    numbers = " ".join(map(str, (*polynomial, *(0.0,) * (5 - len(polynomial)))))
    return f'<joint joint1="{own}" {second} polycoef="{numbers}"/>'


LONG = {"itself", "wheel", "held", "screw", "led"}


@pytest.mark.long
@pytest.mark.parametrize(
    "scene", [pytest.param(x, marks=pytest.mark.long) if x in LONG else x for x in COUPLED]
)
def test_coupled_joints_of_one_body_are_those_of_the_file(tmp_path, scene):
    """Gears and motors also act on links without mass, which stay between the joints."""
    bodies, row, q0, v0, coordinates, rates = COUPLED[scene]
    path, mechanism, left_out = read(tmp_path, bodies, equality(*row))
    assert not any("equality/joint" in line for line in left_out)
    right = right_end(path, q0, v0, 0.4, [row])
    assert_same_end(mechanism, coordinates, rates, 0.4, right, "auto")


@pytest.mark.long
def test_a_motor_holds_a_link_without_mass_in_looped_code(tmp_path):
    bodies, row, q0, v0, coordinates, rates = COUPLED["held"]
    path, mechanism, _ = read(tmp_path, bodies, equality(*row))
    right = right_end(path, q0, v0, 0.4, [row])
    assert_same_end(mechanism, coordinates, rates, 0.4, right, "looped")


def test_joints_compose_where_their_couplings_act_on_the_whole(tmp_path):
    """A cylindrical joint turns and slides along its axis; a polynomial is left out anyway."""
    _, mechanism, _ = read(tmp_path, body("a", SCREW) + OTHER, equality("z", "h", (0.0, 1.5)))
    assert mechanism.link("a").joint.name == "cylindrical"
    curved = equality("z", "q", (0.0, 1.0, 0.5))
    _, mechanism, left_out = read(tmp_path, body("a", UNIVERSAL) + OTHER, curved)
    assert mechanism.link("a").joint.name == "universal"
    assert left_out == ("equality 0: equality/joint with a polynomial beyond a₁",)


def test_a_count_starts_where_couplings_lead(tmp_path):
    """z = 4 + q/2 and y = 1 − 2z; w and u lead each other round in a circle."""
    rows = (
        ("z", "q", (4.0, 0.5)),
        ("y", "z", (1.0, -2.0)),
        ("w", "u", (0.0, 1.0)),
        ("u", "w", (5, 1)),
    )
    bodies = "".join(body(x, f'<joint name="{x}" axis="0 0 1" stiffness="1"/>') for x in "qzyuw")
    _, mechanism, _ = read(tmp_path, bodies, "".join(equality(*row) for row in rows))
    starts = {x.name: float(x.parameters["start"]) for x in mechanism.states}
    assert starts == {
        "turned_q": 0.0, "turned_z": 4.0, "turned_y": -7.0, "turned_u": 5.0, "turned_w": 5.0,
    }  # fmt: skip


def test_a_floating_base_keeps_couplings_and_stops(tmp_path):
    joints = hinge("-8 8", 'stiffness="1"', "p", "1 0 0") + hinge("4 9", "", "q")
    inside = body("a", joints) + OTHER
    options = {"equalities": equality("z", "q", (0.0, -0.5)), "limit_stiffness": STIFFNESS}
    _, fixed, _ = read(tmp_path, body("f", "", inside), **options)
    _, floating, _ = read(tmp_path, body("f", "", inside), base="free", **options)
    assert (fixed.names, floating.names) == (("a_1", "a", "b"), ("f", "a_1", "a", "b"))
    listed = lambda mechanism: [
        (x.name, x.at, *x.parameters.values()) for x in (*mechanism.forces, *mechanism.states)
    ]
    assert listed(fixed) == listed(floating)
    assert [x[:2] for x in listed(fixed)] == [
        ("torsional_spring", ("a_1",)), ("joint_limit", ("a_1",)), ("joint_limit", ("a",)),
        ("gear", ("b", "a")), ("turned_a_1", ("a_1",)), ("turned_a", ("a",)),
    ]  # fmt: skip


LINK = """<link name="{}"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="1"/><inertia
  ixx="0.01" iyy="0.013" izz="0.012" ixy="0.0005" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="j{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="0.3 0 0.1" rpy="0.1 0.2 -0.3"/><axis xyz="{axis}"/>{mimic}</joint>"""
MIMICS = (  # child, parent, kind, axis; joint that it mimics, multiplier and offset
    ("a", "root", "continuous", "0 1 0.2", ()),
    ("b", "a", "continuous", "1 0 0", ("ja", -0.5, 0.4)),
    ("c", "b", "continuous", "0 0 1", ("jb", -0.7, -0.1)),
    ("d", "root", "prismatic", "0 1 0", ("jc", 0.2, 0.05)),
)


@pytest.mark.long
def test_mimics_of_mimics_keep_their_ratios(tmp_path):
    """A slide mimics a hinge that mimics one that mimics another; the start has the offsets."""
    path, rows = tmp_path / "robot.urdf", []
    text, q, v = LINK.format("root"), {"ja": 0.3}, {"ja": 6.0}
    for child, parent, kind, axis, given in MIMICS:
        mimic = ""
        if given:
            other, ratio, offset = given
            mimic = f'<mimic joint="{other}" multiplier="{ratio}" offset="{offset}"/>'
            rows.append((f"j{child}", other, (offset, ratio)))
            q[f"j{child}"], v[f"j{child}"] = offset + ratio * q[other], ratio * v[other]
        text += LINK.format(child)
        text += JOINT.format(child=child, parent=parent, kind=kind, axis=axis, mimic=mimic)
    path.write_text(f'<robot name="r">{text}</robot>')
    mechanism, left_out = read_file(path)
    assert sum("its offset" in line for line in left_out) == 3
    assert mechanism.freedoms().freedoms == 1
    right = right_end(path, [*q.values()], [*v.values()], 0.5, rows)
    by_link = lambda numbers: {name.removeprefix("j"): x for name, x in numbers.items()}
    assert_same_end(mechanism, by_link(q), by_link(v), 0.5, right, "auto")


# ---- names -------------------------------------------------------------------------------------


def nested(*names, joints='<joint axis="0 1 0"/>'):
    text = ""
    for name in reversed(names):
        text = body(name, joints, text)
    return text


@pytest.mark.parametrize(
    ("given", "found"),
    [
        (("a b", "a_b", "a-b"), ("a_b_2", "a_b", "a_b_3")),
        (("a b", "a-b", "a_b_2", "a_b"), ("a_b_3", "a_b_4", "a_b_2", "a_b")),
        (("a b", "A_B"), ("a_b_2", "A_B")),  # SQL ignores case
        (("arm", "Arm", "Arm_2"), ("arm", "Arm_3", "Arm_2")),
        (("", "body1", "_1x", "1x"), ("body1_2", "body1", "_1x", "_1x_2")),
        (("ground", "ground_2"), ("ground_3", "ground_2")),
    ],
)
def test_names_that_are_changed_take_none_of_the_file(tmp_path, given, found):
    _, mechanism, left_out = read(tmp_path, nested(*given))
    assert mechanism.names == found
    pairs = zip(given, found, strict=True)
    assert left_out == tuple(f"the name {a!r}: it is {b}" for a, b in pairs if a and a != b)


def test_a_site_with_the_name_of_a_body_in_a_link_is_said(tmp_path):
    site = '<site name="tool" pos="0.1 0 0"/>'
    arm = body("arm", '<joint axis="0 1 0"/>', site + body("tool", "", pos="0 0 1"))
    _, mechanism, left_out = read(tmp_path, arm, merge_fixed=True)
    np.testing.assert_array_equal(mechanism.sites["tool"].point, (0.1, 0.0, 0.0))
    assert left_out == ("the frame of body tool: a site has its name",)


def test_names_that_are_made_take_none_of_the_file(tmp_path):
    """Links between joints, loops, and bodies that are part of another one's link."""
    sprung = '<joint axis="1 0 0" stiffness="1"/><joint axis="0 1 0"/>'
    thigh = body("thigh", sprung, nested("thigh_1", "pin"))
    merged = body("foot_", '<joint axis="1 0 0"/>', body("foot 1", "") + body("foot_1", ""))
    _, mechanism, _ = read(
        tmp_path, thigh + merged + nested("foot-1"),
        '<connect body1="pin" body2="foot_" anchor="0 0 0"/>'
        '<connect name="pin" body1="thigh" body2="foot-1" anchor="0 0 0"/>',
        merge_fixed=True,
    )  # fmt: skip
    assert mechanism.names == ("thigh_1_2", "thigh", "thigh_1", "pin", "foot_", "foot_1_2")
    assert [loop.name for loop in mechanism.loops] == ["loop0", "pin_2"]
    sites = {name: site.link for name, site in mechanism.sites.items()}
    assert sites == {"foot 1": "foot_", "foot_1": "foot_", "foot-1": "foot_1_2"}

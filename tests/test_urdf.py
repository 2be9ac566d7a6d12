"""URDF: what is welded, limits, refusals, and what is left out; against MuJoCo and by hand."""

from __future__ import annotations

import warnings
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lierb
from lierb.errors import ArgumentError, LeftOutWarning

mujoco = pytest.importorskip("mujoco")

ROUNDING = 1e-12  # of some ten rotations one after another, and lengths of metres
SOUND = (0.2, 0.25, 0.3, 0.01, 0.02, -0.03)
POINT = (0.0,) * 6
FLAT = (0.01, 0.001, 0.001, 0.0, 0.0, 0.0)  # breaks A + B ≥ C
NEGATIVE = (-0.001, 0.001, 0.001, 0.0, 0.0, 0.0)


def inertial(mass=2.0, moments=SOUND, xyz=(0, 0, 0), rpy=(0, 0, 0)):
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    values = " ".join(f'{n}="{float(x)!r}"' for n, x in zip(names, moments))
    mass = f'<mass value="{float(mass)!r}"/>'
    return f"<inertial>{origin(xyz, rpy)}{mass}<inertia {values}/></inertial>"


def origin(xyz, rpy):
    listed = lambda numbers: " ".join(repr(float(x)) for x in numbers)
    return f'<origin xyz="{listed(xyz)}" rpy="{listed(rpy)}"/>'


def link(name, inside=None):
    return f"<link name={quoteattr(name)}>{inertial() if inside is None else inside}</link>"


def joint(name, parent, child, kind="revolute", inside='<axis xyz="0 0 1"/>'):
    ends = f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>"
    return f"<joint name={quoteattr(name)} type={quoteattr(kind)}>{ends}{inside}</joint>"


def robot(tmp_path, *parts):
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def read(path, **options):
    """The mechanism, and what it lacks."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mechanism = lierb.Mechanism.from_urdf(path, **options)
    assert [w.category for w in caught] in ([], [LeftOutWarning])
    return mechanism, caught[0].message.left_out if caught else ()


def pair(tmp_path, inside="", kind="revolute", around="", child=None):
    """A robot of one joint."""
    moving = f'<axis xyz="0 0 1"/>{inside}'
    return robot(
        tmp_path, link("base", ""), link("arm", child), joint("hinge", "base", "arm", kind, moving),
        around,
    )  # fmt: skip


# ---- what is welded ----------------------------------------------------------------------------


@pytest.mark.parametrize("moments", [POINT, FLAT, NEGATIVE])
@pytest.mark.parametrize("root", ["base", "world"])
def test_from_urdf_needs_no_inertia_of_what_is_on_the_ground(tmp_path, moments, root):
    path = robot(
        tmp_path, link(root, inertial(3.25, moments)), link("plate", inertial(0.5, moments)),
        link("arm"), joint("weld", root, "plate", "fixed"), joint("hinge", "plate", "arm"),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert mechanism.names == ("arm",)
    assert left_out == (f"mass of what is welded to the ground: {root} 3.25 kg, plate 0.5 kg",)


@pytest.mark.parametrize("moments", [POINT, FLAT, NEGATIVE])
def test_from_urdf_merges_a_welded_link_whose_inertia_no_body_has(tmp_path, moments):
    """Masses and inertias by hand: parallel axes, in the frame of the moving link."""
    weld = origin((0.3, -0.1, 0.2), (0.4, 0.5, -0.6))
    tool = inertial(0.1, moments, (0.01, 0.02, 0.03), (0.7, -0.8, 0.9))
    path = robot(
        tmp_path, link("base", ""), link("arm"), link("tool", tool),
        joint("hinge", "base", "arm"), joint("weld", "arm", "tool", "fixed", weld),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert mechanism.names == ("arm",)
    (lost,) = left_out
    assert lost.startswith("body tool as a link of its own: tool's inertia ")
    assert lost.endswith("; it is part of arm")
    turn = Rotation.from_euler("xyz", (0.4, 0.5, -0.6))
    centre = np.array((0.3, -0.1, 0.2)) + turn.apply((0.01, 0.02, 0.03))
    R = (turn * Rotation.from_euler("xyz", (0.7, -0.8, 0.9))).as_matrix()
    about = R @ np.diag(moments[:3]) @ R.T
    steiner = 0.1 * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    body = mechanism.link("arm").body
    # Rounding of principal axes, back and forth, of moments below 1.
    np.testing.assert_allclose(body.mass, 2.1, rtol=1e-15)
    np.testing.assert_allclose(body.com, 0.1 * centre / 2.1, rtol=1e-14)
    np.testing.assert_allclose(body.inertia, matrix(SOUND) + about + steiner, rtol=0, atol=1e-14)


def matrix(six):
    xx, yy, zz, xy, xz, yz = six
    return np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def test_from_urdf_merges_through_a_sound_link_where_it_has_to(tmp_path):
    """The tool is too much for the light flange, which is a body by itself, and not for the arm."""
    flange, tool = inertial(0.001, np.array(SOUND) * 1e-5), inertial(0.1, FLAT)
    path = robot(
        tmp_path, link("base", ""), link("arm"), link("flange", flange), link("tool", tool),
        joint("hinge", "base", "arm"), joint("k", "arm", "flange", "fixed"),
        joint("l", "flange", "tool", "fixed"),
    )  # fmt: skip
    mechanism, _ = read(path)
    assert mechanism.names == ("arm",)
    np.testing.assert_allclose(mechanism.link("arm").body.mass, 2.101, rtol=1e-15)


@pytest.mark.parametrize("arm", ["", inertial(0.01, POINT), inertial(0.0, SOUND)])
def test_from_urdf_gives_a_moving_link_what_it_lacks(tmp_path, arm):
    """The first of two shells welded to a link is part of it, the second a link."""
    path = robot(
        tmp_path, link("base", ""), link("arm", arm), link("frame", ""), link("shell"),
        link("cover"), joint("hinge", "base", "arm"), joint("k", "arm", "frame", "fixed"),
        joint("l", "frame", "shell", "fixed"), joint("m", "arm", "cover", "fixed"),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert mechanism.names == ("arm", "cover")
    assert [lost.partition(":")[0] for lost in left_out] == (
        ["body shell as a link of its own"] if arm else []
    )


def test_from_urdf_renames_links_alone(tmp_path):
    """A root and a link that is part of another one need no name, and take none from others."""
    path = robot(
        tmp_path, link("base-link", ""), link("Base_Link"), link("tool-0", ""), link("tip-1"),
        joint("hinge", "base-link", "Base_Link"), joint("k", "Base_Link", "tool-0", "fixed"),
        joint("l", "tool-0", "tip-1"),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert mechanism.names == ("Base_Link", "tip_1")
    assert left_out == ("the name 'tip-1': it is tip_1",)


@pytest.mark.parametrize("root", ["base", "world"])
def test_from_urdf_takes_links_without_mass_where_they_are_welded(tmp_path, root):
    path = robot(
        tmp_path, link(root, ""), link("arm"), link("frame", ""), link("lower"),
        joint("hinge", root, "arm"), joint("k", "arm", "frame", "fixed"),
        joint("l", "frame", "lower"),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert (mechanism.names, left_out) == (("arm", "lower"), ())
    assert mechanism.link("lower").parent == "arm"


# ---- random trees against MuJoCo ---------------------------------------------------------------


def frame(xyz, rpy):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
    return pose


def random_tree(rng, count=10):
    """Links with random joints, half of them fixed; most inertias are no body's own.

    One link of each rigid group, not always the one that moves, is heavy enough for all of it.
    """
    tree = []
    for i in range(count):
        kinds = ("fixed", "fixed", "fixed", "revolute", "continuous", "prismatic")
        tree.append({
            "name": f"link{i}", "parent": int(rng.integers(i)) if i else None,
            "kind": "revolute" if i == 1 else str(rng.choice(kinds)), "axis": rng.normal(size=3),
            "xyz": 0.3 * rng.normal(size=3), "rpy": rng.uniform(-3, 3, size=3),
            "inertial": (*doubtful(rng), 0.1 * rng.normal(size=3), rng.uniform(-3, 3, size=3)),
        })  # fmt: skip
    for group in {base(tree, i) for i in range(count)} - {0}:
        heavy = rng.choice([i for i in range(count) if base(tree, i) == group])
        xyz, rpy = tree[heavy]["inertial"][2:]
        tree[heavy]["inertial"] = 5.0, np.array(SOUND), xyz, rpy
    return tree


def doubtful(rng):
    return [
        (0.02, np.array(POINT)), (0.02, np.array(FLAT)), (0.02, np.array(NEGATIVE)),
        (0.0, np.array(POINT)), (0.0, 0.1 * np.array(SOUND)), (-0.02, np.array(POINT)),
        (0.02, np.array((0.001, 0.001, 0, 0, 0, 0))), (0.02, 0.01 * np.array(SOUND)),
    ][rng.integers(8)]  # fmt: skip


def base(tree, i):
    """The link that moves, or the root, of all that link i is welded to."""
    while i and tree[i]["kind"] == "fixed":
        i = tree[i]["parent"]
    return i


def place(tree, i):
    """The frame of link i in that of its base."""
    if i == base(tree, i):
        return np.eye(4)
    return place(tree, tree[i]["parent"]) @ frame(tree[i]["xyz"], tree[i]["rpy"])


def written(tree, tmp_path):
    """The file, its joints in another order than its links."""
    parts = []
    for i, x in enumerate(tree):
        parts.append(link(x["name"], inertial(*x["inertial"])))
        if i:
            axis = " ".join(repr(float(a)) for a in x["axis"])
            inside = f'{origin(x["xyz"], x["rpy"])}<axis xyz="{axis}"/>'
            parts.append(joint(f"j{i}", tree[x["parent"]]["name"], x["name"], x["kind"], inside))
    return robot(tmp_path, *sorted(parts, key=lambda part: (part[:6], part[::-1])))


def merged(tree):
    """Robot with one link for each rigid group: masses add up, about parallel axes."""
    groups = {}
    for i in sorted({base(tree, i) for i in range(len(tree))}):
        mass, moment, about = 0.0, np.zeros(3), np.zeros((3, 3))
        for k, x in enumerate(tree):
            if base(tree, k) == i and i:
                m, six, xyz, rpy = x["inertial"]
                pose = place(tree, k) @ frame(xyz, rpy)
                R, c = pose[:3, :3], pose[:3, 3]
                mass, moment = mass + m, moment + m * c
                about += R @ matrix(six) @ R.T + m * (c @ c * np.eye(3) - np.outer(c, c))
        c = moment / (mass or 1.0)
        I = about - mass * (c @ c * np.eye(3) - np.outer(c, c))
        six = I[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        x = dict(tree[i], inertial=(mass, six, c, np.zeros(3)))
        if i:
            at = place(tree, x["parent"]) @ frame(x["xyz"], x["rpy"])
            x |= {
                "parent": list(groups).index(base(tree, x["parent"])), "xyz": at[:3, 3],
                "rpy": Rotation.from_matrix(at[:3, :3]).as_euler("xyz"),
            }  # fmt: skip
        groups[i] = x
    return list(groups.values())


def mass_matrix(mechanism, q):
    """Σ Jᵀ G J over the links, and the mass moments ∂V/∂g, from twists at unit rates."""
    pose = mechanism.pose(q)
    zero = dict.fromkeys(q, 0.0)
    columns = [mechanism.twist(zero | {name: 1.0}, pose) for name in q]
    found, moment = 0.0, np.zeros(3)
    for each in mechanism.links:
        J = np.column_stack([column[each.name] for column in columns])
        body = each.body
        coupling = body.mass * np.cross(np.eye(3), body.com)  # of ω with v
        G = np.block([[body.inertia, coupling], [coupling.T, body.mass * np.eye(3)]])
        found = found + J.T @ G @ J
        moment = moment + body.mass * (pose[each.name] @ (*body.com, 1.0))[:3]
    return found, moment


def mass_matrix_of(model, data):
    M = np.zeros((model.nv, model.nv))
    for k in range(model.nv):
        unit = np.eye(model.nv)[k]
        mujoco.mj_mulM(model, data, M[k], unit)
    return M


@pytest.mark.parametrize(("seed", "merge_fixed"), [(k, k % 3 == 0) for k in range(15)])
def test_from_urdf_has_the_mass_matrix_of_mujoco(tmp_path, seed, merge_fixed):
    """MuJoCo reads the robot with its groups merged here, since it refuses most of the others."""
    tree = random_tree(np.random.default_rng(seed))
    mechanism, _ = read(written(tree, tmp_path), merge_fixed=merge_fixed)
    model = mujoco.MjModel.from_xml_path(str(written(merged(tree), tmp_path)))
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(seed).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    moving = [model.body(model.jnt_bodyid[j]).name for j in range(model.njnt)]
    q = dict(zip(moving, data.qpos))
    M, moment = mass_matrix(mechanism, q)
    # MuJoCo's principal axes and quaternions are exact to 1e-14 or so; lengths are below 10 m.
    np.testing.assert_allclose(M, mass_matrix_of(model, data), rtol=0, atol=1e-9)
    np.testing.assert_allclose(moment, model.body_mass @ data.xipos, rtol=0, atol=1e-9)
    for name in moving:
        np.testing.assert_allclose(
            mechanism.pose(q)[name][:3, 3], data.xpos[model.body(name).id], atol=ROUNDING
        )


def test_from_urdf_has_the_links_in_the_order_of_mujoco(tmp_path):
    tree = [dict(x, inertial=(1.0, SOUND)) for x in random_tree(np.random.default_rng(0))]
    path = written(tree, tmp_path)
    model = mujoco.MjSpec.from_file(str(path))
    model.compiler.fusestatic = False
    model = model.compile()
    names = [model.body(i).name for i in range(1, model.nbody)]
    links = read(path)[0].names
    assert links == tuple(name for name in names if name in links)
    assert names != sorted(names)


# ---- refusals ----------------------------------------------------------------------------------

NAMES = {
    "short": "knee",
    "long": "n" * 99 + "MIDDLE" + "e" * 95,
    "odd": "links/knie é [%s] {0} \"'<&>",
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("", "has no mass"),
        (inertial(0.0), "mass is zero"),
        (inertial(-1.0), "mass is -1.0 kg"),
        (inertial(1.0, POINT), "not positive definite"),
        (inertial(1.0, FLAT), "exceeds the sum"),
    ],
)
def test_from_urdf_names_the_moving_link_whose_inertia_no_body_has(tmp_path, name, inside, message):
    path = robot(
        tmp_path, link("base"), link(name, inside), link("tip", inside),
        joint("hinge", "base", name), joint("next", name, "tip"),
    )  # fmt: skip
    with pytest.raises(ArgumentError) as raised:
        read(path)
    assert f"body {name}" in str(raised.value)
    assert message in str(raised.value)


def test_from_urdf_names_what_is_welded_to_a_link_that_it_refuses(tmp_path):
    path = robot(
        tmp_path, link("base"), link("arm", inertial(1.0, FLAT)), link("tool", inertial(1.0, FLAT)),
        link("frame", ""), joint("hinge", "base", "arm"), joint("k", "arm", "tool", "fixed"),
        joint("l", "arm", "frame", "fixed"),
    )  # fmt: skip
    with pytest.raises(ArgumentError, match="body arm, with tool welded to it: inertia"):
        read(path)


def faulty(name):
    """Parts of a file beside the links base and arm, by mistake, and words of the message."""
    axis = lambda numbers: f'<axis xyz="{numbers}"/>'
    twice = link("arm") + link(name, "") * 2
    ends = f'<joint name={quoteattr(name)} type="fixed">'
    return {
        "type": (joint(name, "base", "arm", "hingey"), f"joint {name}: type='hingey'"),
        "parent": (joint(name, "nowhere", "arm"), f"joint {name}: its parent nowhere"),
        "child": (joint(name, "base", "nowhere"), f"joint {name}: its child nowhere"),
        "no parent": (ends + '<child link="arm"/></joint>', f"joint {name} has no parent"),
        "no child": (ends + '<parent link="base"/></joint>', f"joint {name} has no child"),
        "two parents": (
            joint("first", "base", "arm") + joint(name, "base", "arm"),
            f"link arm is the child of two joints, first and {name}",
        ),
        "no axis": (joint(name, "base", "arm", inside=axis("0 0 0")), f"joint {name}: its axis"),
        "planar": (
            joint(name, "base", "arm", "planar", axis("0 1e-200 0")), f"joint {name}: its axis",
        ),
        "words": (joint(name, "base", "arm", inside=axis("0 x 1")), f"joint {name}: <axis xyz="),
        "nan": (joint(name, "base", "arm", inside=axis("0 nan 1")), f"joint {name}: <axis xyz="),
        "two numbers": (joint(name, "base", "arm", inside=axis("0 1")), f"joint {name}: <axis xyz"),
        "two axes": (
            joint(name, "base", "arm", inside=axis("0 0 1") * 2), f"joint {name} has 2 elements",
        ),
        "limit": (
            joint(name, "base", "arm", inside='<limit lower="low"/>'), f"joint {name}: <limit",
        ),
        "joints": (
            joint(name, "base", "arm") + joint(name, "arm", "base"), f"two joints are named {name}",
        ),
        "links": (twice, f"two links are named {name}"),
        "roots": (link(name), f"links base, arm, {name} are children of no joint"),
        "circle": (
            link(name) + joint("hinge", "base", "arm") + joint("self", name, name),
            f"the links {name} do not hang on a root",
        ),
        "mass": (link(name, inertial("1").replace('"1.0"', '"1 kg"')), f"link {name}: <mass value"),
        "no mass": (
            link(name, "<inertial><inertia/></inertial>"), f"link {name}: its <inertial> has no <m",
        ),
        "moment": (link(name, inertial().replace("ixy=", "ixx2=")), f"link {name}: <inertia> has"),
        "frame": (link(name, inertial(xyz=(0, 0))), f"link {name}: <origin xyz"),
    }  # fmt: skip


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
@pytest.mark.parametrize("fault", faulty(""))
def test_from_urdf_names_the_link_or_joint_at_fault(tmp_path, name, fault):
    parts, message = faulty(name)[fault]
    if fault in ("mass", "no mass", "moment", "frame"):
        parts += joint("hinge", "base", "arm") + joint("weld", "arm", name, "fixed")
    path = robot(tmp_path, link("base"), "" if "arm" in parts[:20] else link("arm"), parts)
    with pytest.raises(ArgumentError) as raised:
        read(path)
    assert "cannot be read as URDF" in str(raised.value)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robo/>", "its root element is <robo>; expected <robot>"),
        ("<robot><link/></robot>", "link 1 of the file has no name"),
        ("<robot>", "line 1"),
        (f"<robot>{link('base')}</robot>", "no body that moves"),
        (
            f"<robot>{link('a')}{link('world')}{joint('j', 'a', 'world')}</robot>",
            "link world: only the root can have this name",
        ),
    ],
)
def test_from_urdf_refuses_what_is_no_robot(tmp_path, text, message):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=message):
        read(path)


def test_from_urdf_turns_by_quaternions(tmp_path):
    """As by the angles of the same rotation, in joints and inertias; a factor has no effect."""
    angles, made = (0.3, -0.4, 0.5), []
    turn = Rotation.from_euler("xyz", angles).as_quat()
    numbers = " ".join(repr(float(3.0 * x)) for x in turn)
    for given in ('rpy="{} {} {}"'.format(*angles), f'quat_xyzw="{numbers}"'):
        at = f'<origin xyz="1 2 3" {given}/>'
        arm = inertial().replace(origin((0, 0, 0), (0, 0, 0)), at)
        mechanism, left_out = read(pair(tmp_path, at, child=arm))
        assert not left_out
        made.append((mechanism.pose()["arm"], np.squeeze(mechanism.link("arm").body.inertia)))
    for by_angles, by_quaternion in zip(*made, strict=True):
        np.testing.assert_allclose(by_quaternion, by_angles, atol=1e-14)  # rounding


@pytest.mark.parametrize(
    "given", ['quat_xyzw="0 0 0 0"', 'quat_xyzw="0 0 1"', 'rpy="0 0 0" quat_xyzw="0 0 0 1"']
)
def test_from_urdf_refuses_other_quaternions(tmp_path, given):
    with pytest.raises(ArgumentError, match=r"joint hinge: <origin.*quat"):
        read(pair(tmp_path, f"<origin {given}/>"))


# ---- limits, and what is left out --------------------------------------------------------------


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    ("limit", "ends"),
    [
        ('lower="0" upper="0"', "0 … 0"),
        ('effort="1"', "0 … 0"),  # URDF: both are zero where the file has none
        ('lower="0.5" upper="0.5"', "0.5 … 0.5"),
        ('lower="0.5" upper="-0.5"', "0.5 … -0.5"),
        ('lower="-5" upper="7"', "-5 … 7"),
    ],
)
def test_from_urdf_lists_limits(tmp_path, kind, limit, ends):
    _, left_out = read(pair(tmp_path, f"<limit {limit}/>", kind))
    assert f"joint hinge: limits {ends}" in left_out


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("at", [0.0, 0.5])
def test_from_urdf_stops_a_joint_that_is_locked_where_it_is(tmp_path, kind, at):
    path = pair(tmp_path, f'<limit lower="{at}" upper="{at}"/>', kind)
    mechanism, left_out = read(path, limit_stiffness=1e4)
    (stop,) = mechanism.forces
    assert (stop.parameters["lower"], stop.parameters["upper"], left_out) == (at, at, ())


@pytest.mark.parametrize("limit", [(-4, 4), (2, 5), (7, 8), (-8, -7)])
def test_from_urdf_counts_turns_for_stops_that_a_pose_does_not_determine(tmp_path, limit):
    path = pair(tmp_path, '<limit lower="{}" upper="{}"/>'.format(*limit))
    mechanism, left_out = read(path, limit_stiffness=1e4)
    (stop,), (counter,) = mechanism.forces, mechanism.states
    assert (stop.parameters["lower"], stop.parameters["upper"]) == limit
    assert (stop.kind.turns, left_out) == (counter.name, ())


def test_from_urdf_makes_no_stops_of_limits_in_reverse(tmp_path):
    path = pair(tmp_path, '<limit lower="0.5" upper="-0.5"/>')
    mechanism, left_out = read(path, limit_stiffness=1e4)
    assert (mechanism.forces, left_out) == ((), ("joint hinge: limits 0.5 … -0.5",))


LINES = {
    "friction": ({"inside": '<dynamics friction="0.3"/>'}, "joint hinge: friction 0.3"),
    "mimic": ({"inside": '<mimic joint="other"/>'}, "joint hinge: mimic of other"),
    "continuous": ({"kind": "continuous", "inside": '<limit lower="-1" upper="1"/>'},
        "joint hinge: limits -1 … 1, which a continuous joint does not have",
    ),
    "effort": ({"kind": "continuous", "inside": '<limit effort="1" velocity="2"/>'},
        "limits of effort and velocity of 1 joint",
    ),
    "safety": ({"inside": "<safety_controller k_velocity='1'/><calibration rising='0'/>"},
        "1 safety_controller element",
    ),
    "transmission": ({"around": "<transmission/>" * 2}, "2 transmission elements"),
    "gazebo": ({"around": "<gazebo/>"}, "1 gazebo element"),
    "xacro": ({"around": '<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro"/>'},
        "1 xacro:macro element",
    ),
    "collision": ({"child": f"{inertial()}<collision/><collision/>"}, "2 geoms that collide"),
    "planar": ({"kind": "planar", "inside": '<limit lower="0" upper="0"/>'},
        "joint hinge: limits 0 … 0, which a planar joint does not have",
    ),
    "floating": ({"kind": "floating", "inside": '<dynamics damping="2"/>'},
        "joint hinge: damping 2 and friction 0",
    ),
    "attribute": ({"inside": '<limit low="-1" high="1"/>'}, "1 attribute low of <limit>"),
    "attributes": ({"inside": '<origin rpyy="1 0 0"/>',
        "child": inertial().replace("<mass", '<mass unit="g"')}, "1 attribute rpyy of <origin>",
    ),
    "within inertial": ({"child": inertial().replace("<mass", "<centre/><mass")},
        "1 centre element",
    ),
    "gravity": ({"around": '<mujoco><option gravity="0 0 -1"/></mujoco>'},
        "gravity, which is an argument",
    ),
}  # fmt: skip


def test_from_urdf_keeps_the_damping_of_a_planar_joint(tmp_path):
    inside = '<dynamics damping="2"/>'
    mechanism, left_out = read(pair(tmp_path, kind="planar", inside=inside))
    assert [force.parameters["damping"] for force in mechanism.forces] == [2.0] * 3
    assert len(left_out) == 1  # links without mass between two slides and a hinge


@pytest.mark.parametrize("what", LINES)
def test_from_urdf_says_what_is_left_out(tmp_path, what):
    parts, line = LINES[what]
    _, left_out = read(pair(tmp_path, **parts))
    assert line in left_out


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic", "planar", "spherical"])
def test_from_urdf_says_nothing_where_nothing_is_left_out(tmp_path, kind):
    path = robot(
        tmp_path, link("base", "<visual/>"), link("arm"), "<material name='red'/>",
        joint("hinge", "base", "arm", kind),
    )  # fmt: skip
    assert read(path)[1] == ()


# ---- joints of several freedoms, and settings --------------------------------------------------


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (1, -2, 3), (0, 0, -1)])
def test_from_urdf_has_the_planar_joint_of_mujoco(tmp_path, axis):
    """Pose and coordinates of MuJoCo's own reader; lierb counts the turn first."""
    inside = f'{origin((1, 2, 3), (0.4, 0.5, 0.6))}<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
    path = robot(
        tmp_path, link("base", ""), link("arm"), joint("j", "base", "arm", "planar", inside)
    )
    mechanism, _ = read(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = (0.3, -0.7, 0.9)
    mujoco.mj_kinematics(model, data)
    pose = mechanism.pose({"arm": (0.9, 0.3, -0.7)})["arm"]
    np.testing.assert_allclose(pose[:3, 3], data.xpos[-1], atol=ROUNDING)
    np.testing.assert_allclose(pose[:3, :3], data.xmat[-1].reshape(3, 3), atol=ROUNDING)


def test_from_urdf_lets_a_link_float_on_one_that_moves(tmp_path):
    """MuJoCo's reader takes floating joints of its world alone."""
    at = (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)
    path = robot(
        tmp_path, link("base", ""), link("arm"), link("bird"), joint("hinge", "base", "arm"),
        joint("launch", "arm", "bird", "floating", origin(*at)),
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert mechanism.link("bird").joint.name == "free"
    assert (mechanism.link("bird").parent, left_out) == ("arm", ())
    np.testing.assert_allclose(mechanism.pose()["bird"], frame(*at), atol=ROUNDING)


@pytest.mark.parametrize(
    "settings", ['balanceinertia="true"', 'boundmass="3"', 'boundinertia="0.27"']
)
def test_from_urdf_minds_settings_of_mujoco(tmp_path, settings):
    """The extension <mujoco>, as MuJoCo's own reader takes it."""
    path = pair(
        tmp_path, child=inertial(2.0, FLAT if "balance" in settings else SOUND),
        around=f"<mujoco><compiler {settings}/></mujoco>",
    )  # fmt: skip
    body = read(path)[0].link("arm").body
    model = mujoco.MjModel.from_xml_path(str(path))
    assert float(body.mass) == model.body_mass[-1]
    np.testing.assert_allclose(
        np.linalg.eigvalsh(body.inertia), np.sort(model.body_inertia[-1]), rtol=1e-14
    )


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
def test_from_urdf_scales_to_a_total_mass(tmp_path):
    """Masses in proportion, inertias with them; MuJoCo refuses this file for its flange."""
    path = robot(
        tmp_path, link("base", inertial(1.0, POINT)), link("arm", inertial(2.0)),
        link("flange", inertial(1.0, FLAT)), joint("hinge", "base", "arm"),
        joint("weld", "arm", "flange", "fixed"),
        '<mujoco><compiler settotalmass="10"/></mujoco>',
    )  # fmt: skip
    body = read(path)[0].link("arm").body
    np.testing.assert_allclose(body.mass, 7.5, rtol=1e-15)
    np.testing.assert_allclose(body.inertia, 2.5 * (matrix(SOUND) + matrix(FLAT)), atol=1e-14)

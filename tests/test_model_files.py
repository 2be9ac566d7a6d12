"""MJCF and URDF as mechanisms, against MuJoCo's own kinematics and energies, and by hand."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from jobs.page import names_of
from scipy.spatial.transform import Rotation

import lierb
from lierb.errors import ArgumentError, LeftOutWarning, MissingExtraError

mujoco = pytest.importorskip("mujoco")

DATA = Path(__file__).parent / "data"
ROUNDING = 1e-12  # of some ten rotations one after another, and lengths of metres
INERTIA = '<inertial pos="0.1 0.02 -0.3" mass="1.3" diaginertia="0.03 0.02 0.025"/>'


def read(path, **options):
    """The mechanism, and what it lacks."""
    load = lierb.Mechanism.from_urdf if path.suffix == ".urdf" else lierb.Mechanism.from_mjcf
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mechanism = load(path, **options)
    assert [w.category for w in caught] in ([], [LeftOutWarning])
    return mechanism, caught[0].message.left_out if caught else ()


def one_body(tmp_path, joints, **more):
    """The path of a file with one body on these joints, after another one that is turned."""
    path = tmp_path / "body.xml"
    path.write_text(f"""<mujoco>
      <compiler angle="radian"/>
      <worldbody>{more.get("around", "")}
        <body name="base" pos="0.1 0.2 0.3" euler="0.3 0.2 0.1">
          <joint type="hinge" axis="1 2 3"/>{INERTIA}
          <body name="body" pos="-0.3 0.1 0.5" euler="0.5 -0.4 0.2">
            {joints}{more.get("inertial", INERTIA)}{more.get("inside", "")}
          </body>
        </body>
      </worldbody>{more.get("outside", "")}
    </mujoco>""")
    return path


def model_of(path):
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    if path.suffix == ".urdf":
        for geom in list(spec.geoms):
            spec.delete(geom)
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    return spec.compile()


def coordinates_of(model, data, mechanism):
    """Coordinates of every link from qpos, in the order of a body's joints in the file."""
    numbers_of_links = {}
    for link in mechanism.links:
        body = model.body(link.name)
        numbers = []
        for j in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0]):
            at = model.jnt_qposadr[j]
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL:
                w, x, y, z = data.qpos[at : at + 4]
                numbers += list(Rotation.from_quat((x, y, z, w)).as_rotvec())
            else:
                numbers.append(data.qpos[at] - model.qpos0[at])
        if numbers:
            numbers_of_links[link.name] = numbers
    return numbers_of_links


def assert_same_places(model, data, mechanism, pose):
    for link in mechanism.links:
        i = model.body(link.name).id
        np.testing.assert_allclose(pose[link.name][:3, 3], data.xpos[i], atol=ROUNDING)
        np.testing.assert_allclose(
            pose[link.name][:3, :3], data.xmat[i].reshape(3, 3), atol=ROUNDING
        )


def kinetic_energy(mechanism, twist):
    total = 0.0
    for link in mechanism.links:
        w, v = np.split(twist[link.name], 2)
        body = link.body
        total += 0.5 * (w @ body.inertia @ w + body.mass * (v @ v))
        total += body.mass * (body.com @ np.cross(v, w))
    return total


def potential_energy(mechanism, pose):
    centres = ((x, pose[x.name] @ (*x.body.com, 1.0)) for x in mechanism.links)
    return -sum(x.body.mass * (c[:3] @ mechanism.gravity) for x, c in centres)


def scattered(model, rng):
    data = mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def assert_same_mechanics(path, coordinates=coordinates_of, rates=None, **options):
    """Poses, and energies at random velocities, which is to say mass matrices and weights."""
    mechanism, _ = read(path, **options)
    model, rng = model_of(path), np.random.default_rng(7)
    rest = mujoco.MjData(model)
    mujoco.mj_forward(model, rest)
    assert_same_places(model, rest, mechanism, mechanism.pose({}))
    for _ in range(3):
        data = scattered(model, rng)
        pose = mechanism.pose(coordinates(model, data, mechanism))
        assert_same_places(model, data, mechanism, pose)
        springs = sum(  # those of hinges only
            0.5 * model.jnt_stiffness[j] * (data.qpos[q] - model.qpos_spring[q]) ** 2
            for j, q in enumerate(model.jnt_qposadr)
        )
        weight = potential_energy(mechanism, pose)
        still = -model.opt.gravity @ sum(  # what is welded to the world counts there, and not here
            (model.body_mass[i] * data.xipos[i] for i in range(1, model.nbody)
             if model.body_weldid[i] == 0), start=np.zeros(3),
        )  # fmt: skip
        np.testing.assert_allclose(weight + springs + still, data.energy[0], rtol=ROUNDING)
        if rates is not None:
            twist = mechanism.twist(rates(model, data, mechanism), pose)
            found = kinetic_energy(mechanism, twist)
            np.testing.assert_allclose(found, data.energy[1], rtol=ROUNDING)
    return mechanism


def rates_of(model, data, mechanism):
    """Rates of joints from qvel: all joints but balls."""
    found = {}
    for link in mechanism.links:
        body = model.body(link.name)
        numbers = data.qvel[body.dofadr[0] : body.dofadr[0] + body.dofnum[0]]
        if len(numbers):
            found[link.name] = numbers
    return found


def test_double_pendulum_moves_as_in_mujoco():
    mechanism = assert_same_mechanics(DATA / "double_pendulum.xml", rates=rates_of)
    assert mechanism.names == ("upper", "lower", "weight")
    assert mechanism.link("upper").parent == "ground"
    assert mechanism.link("weight").joint.name == "fixed"
    np.testing.assert_array_equal(mechanism.gravity, (0.3, 0.0, -9.81))


def test_springs_are_slack_where_those_of_the_file_are():
    mechanism, left_out = read(DATA / "double_pendulum.xml")
    first, second = (force.parameters for force in mechanism.forces)
    assert [force.at for force in mechanism.forces] == [("upper",), ("lower",)]
    assert (first["stiffness"], first["damping"]) == (1.5, 0.02)
    np.testing.assert_allclose(first["angle"], 0.5 - 0.2, rtol=1e-15)
    assert (second["stiffness"], second["damping"]) == (0.0, 0.02)
    assert left_out == ("options of MuJoCo's own solver: integrator, timestep",)


def test_a_link_weighs_what_is_welded_to_it(tmp_path):
    """File with an empty link for the joint, and the mass on a fixed link after it."""
    inside = f'<body name="shell" pos="0 0.1 0" euler="0.3 0 0">{INERTIA}</body>'
    path = one_body(tmp_path, '<joint axis="1 2 2"/>', inertial="", inside=inside)
    mechanism = assert_same_mechanics(path, rates=rates_of)
    assert mechanism.names == ("base", "body")


def test_a_slide_has_its_spring_and_its_stops(tmp_path):
    slide = (
        '<joint name="rail" type="slide" axis="0 0 1" ref="0.1" springref="0.3" stiffness="20"'
        ' damping="0.5" range="-0.2 0.4" limited="true"/>'
    )
    path = one_body(tmp_path, slide)
    mechanism, left_out = read(path, limit_stiffness=1e4)
    spring, stop = mechanism.forces
    found = {n: float(x) for n, x in (spring.parameters | stop.parameters).items()}
    expected = {"stiffness": 1e4, "damping": 0.0, "position": 0.2, "lower": -0.3, "upper": 0.3}
    assert found == pytest.approx(expected, rel=1e-14)
    assert (spring.parameters["stiffness"], spring.parameters["damping"]) == (20.0, 0.5)
    assert (stop.at, left_out) == (("body",), ())


def test_the_stiffness_of_stops_is_positive(tmp_path):
    one_body(tmp_path, "<joint/>")
    with pytest.raises(ArgumentError, match="limit_stiffness"):
        lierb.Mechanism.from_mjcf(tmp_path / "body.xml", limit_stiffness=-1.0)


@pytest.mark.parametrize(
    ("flag", "gone"),
    [
        ("gravity", "gravity"), ("spring", "stiffness"), ("damper", "damping"), ("limit", "stop"),
        ("equality", "loop"), ("constraint", "stop loop"),
    ],
)  # fmt: skip
def test_what_flags_disable_is_not_there(tmp_path, flag, gone):
    joint = '<joint axis="0 0 1" stiffness="2" damping="0.3" range="-1 1" limited="true"/>'
    path = one_body(
        tmp_path, joint,
        outside='<equality><connect body1="body" anchor="0 0 -1"/></equality>'
        f'<option><flag {flag}="disable"/></option>',
    )  # fmt: skip
    mechanism, _ = read(path, limit_stiffness=10.0)
    acting = {force.name: force.parameters for force in mechanism.forces}
    spring = acting.get("torsional_spring", {})
    found = {
        "gravity": np.any(mechanism.gravity), "stiffness": spring.get("stiffness", 0.0) > 0.0,
        "damping": spring.get("damping", 0.0) > 0.0, "stop": "joint_limit" in acting,
        "loop": bool(mechanism.loops),
    }  # fmt: skip
    assert {name for name, is_there in found.items() if not is_there} == set(gone.split())


def test_a_spring_wound_by_more_than_half_a_turn_counts_turns(tmp_path):
    """By the pose alone it would pull the other way."""
    joint = '<joint name="coil" springref="4" stiffness="3" damping="0.1"/>'
    mechanism, left_out = read(one_body(tmp_path, joint))
    (force,), (counter,) = mechanism.forces, mechanism.states
    numbers = {name: float(x) for name, x in force.parameters.items()}
    assert numbers == {"stiffness": 3.0, "damping": 0.1, "angle": 4.0}
    assert (force.kind.turns, counter.at, counter.parameters["start"]) == (
        counter.name, ("body",), 0.0,
    )  # fmt: skip
    assert left_out == ()


@pytest.mark.skipif(
    not hasattr(mujoco.MjModel, "jnt_stiffnesspoly"), reason="numbers alone in this release"
)
@pytest.mark.parametrize("further", ['stiffness="1 0 30"', 'stiffness="1" damping=".1 2"'])
def test_further_coefficients_of_springs_are_left_out(tmp_path, further):
    mechanism, left_out = read(one_body(tmp_path, f'<joint name="stiff" {further}/>'))
    assert mechanism.forces[0].parameters["stiffness"] == 1.0
    assert left_out == ("joint stiff: stiffness and damping beyond their first coefficients",)


@pytest.mark.skipif(
    not hasattr(mujoco.MjModel, "jnt_springyield"), reason="no springs that yield in this release"
)
def test_springs_that_yield_are_said(tmp_path):
    path = one_body(tmp_path, '<joint name="wire" stiffness="1" springyield="0.5"/>')
    assert read(path)[1] == ("joint wire: springyield",)


def test_limits_that_lierb_has_no_stops_for_are_told_as_they_are(tmp_path):
    ball = '<joint name="hip" type="ball" range="0 0.5" limited="true"/>'
    _, left_out = read(one_body(tmp_path, ball), limit_stiffness=10.0)
    assert left_out == ("joint hip: limits 0 … 0.5",)


@pytest.mark.parametrize("root", ["base", "world"])
def test_a_floating_joint_of_urdf_is_free_whatever_its_root_is_called(tmp_path, root):
    path = tmp_path / "craft.urdf"
    inertia = '<inertia ixx="1" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/>'
    path.write_text(f"""<robot name="craft">
      <link name="{root}"/>
      <link name="bus"><inertial><mass value="3"/>{inertia}</inertial></link>
      <joint name="launch" type="floating">
        <parent link="{root}"/><child link="bus"/><origin xyz="1 2 3"/>
      </joint>
    </robot>""")
    mechanism, left_out = read(path)
    assert (mechanism.names, left_out) == (("bus",), ())
    assert mechanism.link("bus").joint.name == "free"
    assert float(mechanism.link("bus").body.mass) == 3.0
    np.testing.assert_array_equal(mechanism.pose()["bus"][:3, 3], (1.0, 2.0, 3.0))


UNSOUND = {
    "point": 'mass="0.1" diaginertia="0 0 0"',
    "flat": 'mass="0.1" diaginertia="0.01 0.001 0.001"',
    "negative": 'mass="0.1" fullinertia="0.001 0.001 -0.001 0.0001 0 0"',
    "no mass": 'mass="0" diaginertia="0.01 0.02 0.02"',
}  # fmt: skip


@pytest.mark.parametrize("moments", UNSOUND.values(), ids=UNSOUND)
def test_bodies_are_checked_as_one_with_what_is_welded_to_them(tmp_path, moments):
    """Against MuJoCo's M at unit rates, of a sound body to which the unsound one has been added.

    The sum by parallel axes, in the frame of the body, is made here.
    """
    inertial = f'<inertial pos="0.02 0.03 0.01" {moments}/>'
    sensor = f'<body name="sensor" pos="0 0.1 0" euler="0.3 0 0.2">{inertial}</body>'
    around = f'<body name="post">{inertial}</body>'
    path = one_body(tmp_path, "<joint/>", inside=sensor, around=around)
    mechanism, left_out = read(path)
    assert mechanism.names == ("base", "body")
    assert any(lost.startswith("body sensor as a link of its own: sensor's") for lost in left_out)
    combined = mechanism.link("body").body
    turn = Rotation.from_euler("XYZ", (0.3, 0.0, 0.2))
    numbers = dict(x.split("=") for x in moments.replace('" ', '"|').split("|"))
    added = float(numbers["mass"].strip('"'))
    values = [float(x) for x in moments.rpartition("inertia=")[2].strip('"').split()]
    xx, yy, zz, xy, xz, yz = (*values, 0.0, 0.0, 0.0)[:6]
    R, own = turn.as_matrix(), np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    steiner = lambda m, c: m * (c @ c * np.eye(3) - np.outer(c, c))
    c, c_own = turn.apply((0.02, 0.03, 0.01)) + np.array((0, 0.1, 0)), np.array((0.1, 0.02, -0.3))
    expected = (
        R @ own @ R.T + steiner(added, c) + np.diag((0.03, 0.02, 0.025)) + steiner(1.3, c_own)
    )
    # Rounding of principal axes, back and forth, of moments below 1.
    np.testing.assert_allclose(combined.inertia, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(combined.mass, 1.3 + added, rtol=1e-15)
    np.testing.assert_allclose(combined.com, (added * c + 1.3 * c_own) / (1.3 + added), rtol=1e-13)


@pytest.mark.parametrize("moments", UNSOUND.values(), ids=UNSOUND)
def test_bodies_that_move_are_refused_by_name(tmp_path, moments):
    """On a hinge beside it a point mass would do."""
    inertial = f'<inertial pos="0.02 0.03 0.01" {moments}/>'
    with pytest.raises(ArgumentError, match=r"body body(:| has no mass or no inertia)"):
        read(one_body(tmp_path, '<joint type="ball"/>', inertial=inertial))


def test_a_mass_on_the_ground_is_said(tmp_path):
    around = f'<body name="table">{INERTIA}<body><geom size="1" mass="2" contype="0"'
    path = one_body(tmp_path, "<joint/>", around=around + ' conaffinity="0"/></body></body>')
    _, left_out = read(path)
    assert left_out == ("mass of what is welded to the ground: table 1.3 kg, body2 2 kg",)


WORM = """<mujoco><compiler autolimits="true" {settings}/><worldbody>
  <body name="head"><joint axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 {length} 0 0" size="{radius}" contype="0" conaffinity="0"/>
    <body name="tail" pos="{length} 0 0"><joint axis="0 1 0"/>
      <geom type="box" size="{radius} {radius} {radius}" contype="0" conaffinity="0"/>
    </body>
  </body>
</worldbody></mujoco>"""


@pytest.mark.skipif(
    not hasattr(mujoco.MjSpec, "adopt_inertial"), reason="no inertials of geoms in this release"
)
@pytest.mark.parametrize(
    ("length", "settings"),
    [(100.0, ""), (1.0, ""), (1e-3, ""), (1e-6, ""), (1e-3, 'inertiafromgeom="true"')],
)
def test_bodies_of_any_size_are_read(tmp_path, length, settings):
    """Capsule and box of 1000 kg/m³ in closed form; MuJoCo takes no moment below 1e-15 kg m²."""
    path, r = tmp_path / "worm.xml", 0.05 * length
    path.write_text(WORM.format(length=length, radius=r, settings=settings))
    head, tail = (link.body for link in read(path)[0].links)
    rod, ball = 1e3 * np.pi * r**2 * length, 1e3 * 4 / 3 * np.pi * r**3
    np.testing.assert_allclose(head.mass, rod + ball, rtol=1e-13)
    about_axis = rod * r**2 / 2 + ball * 2 / 5 * r**2
    about_centre = (
        rod * (length**2 / 12 + r**2 / 4)
        + ball * (2 / 5 * r**2 + length**2 / 4 + 3 / 8 * length * r)
    )  # fmt: skip
    across = about_centre + (rod + ball) * length**2 / 4
    # MuJoCo's closed forms and principal axes round a dozen times.
    np.testing.assert_allclose(
        head.inertia, np.diag((about_axis, across, across)), rtol=1e-12, atol=1e-14 * across
    )
    side = 2 * r
    np.testing.assert_allclose(
        tail.inertia, 1e3 * side**5 / 6 * np.eye(3), rtol=1e-12, atol=1e-14 * side**5
    )


def test_a_size_that_no_release_can_read_is_refused_by_name(tmp_path):
    """`inertiafromgeom="true"` overrides the inertial of the file, which no inertial replaces."""
    path = tmp_path / "worm.xml"
    text = WORM.format(length=1e-3, radius=5e-5, settings='inertiafromgeom="true"')
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    path.write_text(text.replace('<body name="head">', f'<body name="head">{inertial}'))
    with pytest.raises(ArgumentError, match="mjMINVAL Element name 'head'"):
        read(path)


SETTINGS = {
    "balanceinertia": ('balanceinertia="true"', 'mass="1" diaginertia="1 2 8"'),
    "boundmass": ('boundmass="3"', 'mass="1" diaginertia="1 2 2"'),
    "boundinertia": ('boundinertia="1.5"', 'mass="1" diaginertia="1e-9 2 2"'),
    "tiny": ('boundmass="1e-3" boundinertia="1e-3"', 'mass="0" diaginertia="0 0 0"'),
    "geoms": ('inertiafromgeom="true"', 'mass="1" diaginertia="1 2 8"'),
    "no geoms": ('inertiafromgeom="false"', 'mass="1" diaginertia="1 2 2.5"'),
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_settings_of_inertias_are_those_of_mujoco(tmp_path, setting):
    attributes, moments = SETTINGS[setting]
    path, geom = tmp_path / "model.xml", '<geom size="0.5" contype="0" conaffinity="0"/>'
    body = f'<body name="b"><joint/><inertial pos="0 0 0" {moments}/>{geom}</body>'
    path.write_text(f"<mujoco><compiler {attributes}/><worldbody>{body}</worldbody></mujoco>")
    found, model = read(path)[0].link("b").body, model_of(path)
    np.testing.assert_allclose(found.mass, model.body_mass[1], rtol=1e-15)
    moments = np.sort(model.body_inertia[1])
    np.testing.assert_allclose(np.linalg.eigvalsh(found.inertia), moments, rtol=1e-14)


def test_a_springdamper_has_the_inertia_of_the_file(tmp_path):
    """MuJoCo makes stiffness and damping of it; what is welded and unsound stays refused there."""
    joint = '<joint springdamper="0.1 1"/>'
    path = one_body(tmp_path, joint)
    mechanism, _ = read(path)
    assert mechanism.forces[0].parameters["stiffness"] == model_of(path).jnt_stiffness[1] > 0.0
    flat = f'<body name="sensor"><inertial pos="0 0 0" {UNSOUND["flat"]}/></body>'
    with pytest.raises(ArgumentError, match="Element name 'sensor'"):
        read(one_body(tmp_path, joint, inside=flat))


def test_merged_bodies_weigh_the_same():
    mechanism = assert_same_mechanics(
        DATA / "double_pendulum.xml", rates=rates_of, merge_fixed=True
    )
    assert mechanism.names == ("upper", "lower")
    np.testing.assert_allclose(mechanism.link("lower").body.mass, 1.2 + 0.4, rtol=1e-15)


def test_arm_moves_as_in_mujoco():
    mechanism = assert_same_mechanics(DATA / "arm.urdf", rates=rates_of)
    assert len(mechanism.links) == 7
    assert mechanism.link("tool").parent == "flange"


def test_arm_stands_where_its_origins_put_it():
    """Poses from xyz and rpy (about fixed axes) of the file, by URDF's definition."""
    mechanism, left_out = read(DATA / "arm.urdf", gravity=(0.0, 0.0, -1.62))
    angles = np.random.default_rng(3).normal(size=6)
    placed = np.eye(4)
    for xyz, rpy, axis, angle in zip(
        ((0, 0, 0.3), (0, 0.08, 0.12), (0.02, -0.05, 0.45), (0.1, 0, 0.05), (0.3, 0, 0),
         (0.09, 0, 0)),
        ((0, 0, 0), (0, 0, 0.1), (0, 0.2, 0), (0.1, 0, 0), (0, 0.4, 0), (0, 0, 0.3)),
        ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (0.6, 0, 0.8)),
        angles,
    ):  # fmt: skip
        step = np.eye(4)
        turn = Rotation.from_rotvec(angle * np.array(axis, float))
        step[:3, :3] = (Rotation.from_euler("xyz", rpy) * turn).as_matrix()
        step[:3, 3] = xyz
        placed = placed @ step
    pose = mechanism.pose(dict(zip(mechanism.names, angles)))
    np.testing.assert_allclose(pose["flange"], placed, atol=ROUNDING)
    np.testing.assert_array_equal(mechanism.gravity, (0.0, 0.0, -1.62))
    limits = tuple(
        f"joint {name}: limits -2.5 … 2.5"
        for name in ("base_yaw", "shoulder_pitch", "elbow", "wrist_pitch")
    )
    others = "1 geom that collides", "limits of effort and velocity of 4 joints"
    assert left_out == (*limits, *others)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "allowed"),
    [pytest.param("double_pendulum.xml", 1e-9, marks=pytest.mark.long), ("arm.urdf", 1e-9)],
)
def test_trajectories_are_those_of_mujoco(name, allowed):
    """Both by RK4 at 0.1 ms, whose own error is below 1e-12 here; joint springs and dampers act."""
    mechanism, _ = read(DATA / name, merge_fixed=True)
    spec = mujoco.MjSpec.from_file(str(DATA / name))
    for geom in list(spec.geoms) if name.endswith("urdf") else ():
        spec.delete(geom)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = 1e-4
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model = spec.compile()
    data = scattered(model, np.random.default_rng(11))
    pose0 = mechanism.pose(coordinates_of(model, data, mechanism))
    twist0 = mechanism.twist(rates_of(model, data, mechanism), pose0)
    try:
        result = lierb.integrate(
            mechanism, pose0=pose0, twist0=twist0, dt=1e-4, t_end=0.1, cspace="reduced"
        )
    except ArgumentError as error:
        if "must be a lierb.Problem" in str(error):
            pytest.skip("lierb.integrate takes no mechanism yet")
        raise
    for _ in range(1000):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    for link in mechanism.names:
        position = result.summary[f"{link}.position"].combine_chunks().flatten().to_numpy()
        np.testing.assert_allclose(position, data.xpos[model.body(link).id], atol=allowed)


def gap(mechanism, pose):
    """(4, 4): the body's frame of the only loop, seen from its parent's."""
    at = mechanism.joints[-1]
    poses = mechanism.poses("pose", pose)
    rotation, place = mechanism.relative(at, poses)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.reshape(rotation, (3, 3)), place
    return matrix


def assert_same_gap(path):
    """Compare the gap with MuJoCo's at a random pose; return the mechanism and MuJoCo's data."""
    mechanism, left_out = read(path)
    assert not any("equality" in what for what in left_out)
    model = model_of(path)
    data = scattered(model, np.random.default_rng(5))
    found = gap(mechanism, mechanism.pose(coordinates_of(model, data, mechanism)))
    np.testing.assert_allclose(
        np.linalg.norm(found[:3, 3]), np.linalg.norm(data.efc_pos[:3]), rtol=1e-12
    )
    return mechanism, found, data


def test_connect_is_a_spherical_loop():
    mechanism, _, _ = assert_same_gap(DATA / "four_bar.xml")
    np.testing.assert_allclose(gap(mechanism, mechanism.pose({})), np.eye(4), atol=ROUNDING)
    (loop,) = mechanism.loops
    assert (loop.name, loop.joint.name) == ("pin", "spherical")
    assert (loop.body, loop.parent) == ("coupler", "rocker")


WELDS = {
    "bodies": '<weld body1="body" body2="base" anchor="0.1 0.2 0"'
    ' relpose="0.3 -0.2 0.1 0.8 0.6 0 0"/>',
    "ground": '<weld body1="body"/>',
    "sites": '<weld site1="here" site2="there"/>',
}  # fmt: skip


@pytest.mark.parametrize("weight", ["1", "0", "2.5", "-1"])
@pytest.mark.parametrize("ends", WELDS)
def test_weld_is_a_fixed_loop_unless_it_leaves_rotations_free(tmp_path, ends, weight):
    """MuJoCo's rows of a rotation are sin(angle/2) of the axis, times the torquescale."""
    path = one_body(
        tmp_path,
        '<joint type="ball"/>',
        inside='<body pos="0 0.1 0"><site name="here" pos="0.1 0 0" euler="0 1 0"/></body>',
        outside=f"<equality>{WELDS[ends]}</equality>".replace("/>", f' torquescale="{weight}"/>'),
        around='<site name="there" pos="0 0 1" euler="0.3 0 0"/>',
    )
    mechanism, found, data = assert_same_gap(path)
    half = Rotation.from_matrix(found[:3, :3]).magnitude() / 2
    rows = np.linalg.norm(data.efc_pos[3:6])
    np.testing.assert_allclose(rows, abs(float(weight)) * np.sin(half), rtol=1e-12)
    assert mechanism.loops[0].joint.name == ("spherical" if weight == "0" else "fixed")


SEQUENCES = {
    "revolute": '<joint axis="1 2 0.5" pos="0.1 0 0.2"/>',
    "prismatic": '<joint type="slide" axis="1 2 0.5"/>',
    "universal": '<joint axis="1 0 0" pos="0.3 0.1 0"/><joint axis="0 0 1" pos="0 0.1 0.4"/>',
    "pin_in_slot": '<joint type="slide" axis="0 1 0"/><joint axis="0 0 1" pos="0.1 0.2 0"/>',
    "pin_in_slot_body": '<joint axis="0 0 1" pos="0.1 0.2 0"/><joint type="slide" axis="0 1 0"/>',
    "planar_translation": '<joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>',
}  # fmt: skip


@pytest.mark.parametrize("name", SEQUENCES)
def test_joints_of_one_body_are_the_one_of_the_catalogue(tmp_path, name):
    mechanism = assert_same_mechanics(one_body(tmp_path, SEQUENCES[name]), rates=rates_of)
    assert mechanism.link("body").joint.name == name


# name: joints of the file, and the order in which lierb has their coordinates
REORDERED = {
    "cylindrical": (
        '<joint type="slide" axis="1 2 2"/><joint axis="1 2 2" pos="0 0.1 0"/>', (1, 0),
    ),
    "planar": (
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint axis="0 0 1" pos="0.1 0.2 0"/>', (2, 0, 1),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REORDERED)
def test_slides_with_a_hinge_keep_their_coordinates(tmp_path, name):
    joints, order = REORDERED[name]
    mine = lambda source: (
        lambda *given: {
            link: np.asarray(numbers)[list(order)] if link == "body" else numbers
            for link, numbers in source(*given).items()
        }
    )
    mechanism = assert_same_mechanics(
        one_body(tmp_path, joints), coordinates=mine(coordinates_of), rates=mine(rates_of)
    )
    assert mechanism.link("body").joint.name == name


def test_ball_turns_as_in_mujoco(tmp_path):
    mechanism = assert_same_mechanics(one_body(tmp_path, '<joint type="ball" pos="0.1 0.2 0"/>'))
    assert mechanism.link("body").joint.name == "spherical"


EQUALLY_FREE = {
    "spherical": '<joint axis="1 0 0"/><joint axis="0 1 0"/><joint axis="0 0 1"/>',
    "translation": "".join(
        f'<joint type="slide" axis="{a}"/>' for a in ("1 0 0", "1 1 0", "0 0 1")
    ),
    "schoenflies": "".join(
        f'<joint type="slide" axis="{a}"/>' for a in ("1 0 0", "0 1 0", "0 0 1")
    ) + '<joint axis="1 1 0" pos="0 0.1 0"/>',
    "free": "".join(f'<joint type="slide" axis="{a}"/>' for a in ("1 0 0", "0 1 0", "0 0 1"))
    + '<joint type="ball"/>',
}  # fmt: skip


def test_a_slide_against_its_hinge_counts_the_other_way(tmp_path):
    """The springs hold as much energy as MuJoCo's at a random pose."""
    joints = (
        '<joint type="slide" axis="0 0 -1" springref="0.3" stiffness="20" range="-1 2"'
        ' limited="true"/><joint axis="0 0 1" springref="-0.2" stiffness="3"/>'
    )
    flipped = lambda source: (
        lambda *given: {
            link: (numbers[1], -numbers[0]) if link == "body" else numbers
            for link, numbers in source(*given).items()
        }
    )
    path = one_body(tmp_path, joints)
    mechanism = assert_same_mechanics(path, flipped(coordinates_of), flipped(rates_of))
    slide, turn = (force.parameters for force in mechanism.forces)
    np.testing.assert_allclose((slide["position"], turn["angle"]), (-0.3, -0.2), rtol=1e-14)
    stop = read(path, limit_stiffness=1.0)[0].forces[1].parameters
    assert (stop["lower"], stop["upper"]) == (-2.0, 1.0)


@pytest.mark.parametrize("name", EQUALLY_FREE)
def test_other_joints_allow_the_same_poses(tmp_path, name):
    """MuJoCo's pose, taken for lierb's, leaves the joint closed: no row has a value there."""
    path = one_body(tmp_path, EQUALLY_FREE[name])
    mechanism, _ = read(path)
    link = mechanism.link("body")
    assert link.joint.name == name
    model = model_of(path)
    data = scattered(model, np.random.default_rng(1))
    pose = {}
    for x in mechanism.links:
        i = model.body(x.name).id
        pose[x.name] = np.eye(4)
        pose[x.name][:3, :3], pose[x.name][:3, 3] = data.xmat[i].reshape(3, 3), data.xpos[i]
    again = mechanism.pose(mechanism.coordinates(pose))
    np.testing.assert_allclose(again["body"], pose["body"], atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(
    "joints",
    [
        '<joint axis="1 0 0"/><joint axis="1 0 0" pos="0 0.3 0"/>',  # parallel hinges
        '<joint axis="1 0 0"/><joint axis="0 1 0" pos="0 0 0.3"/>',  # that do not meet
        pytest.param(  # not at right angles
            '<joint axis="1 0 0"/><joint axis="1 1 0"/>', marks=pytest.mark.long
        ),
        '<joint type="slide" axis="1 0 0"/><joint axis="1 1 0"/>',  # askew
        '<joint type="ball"/><joint type="slide" axis="1 0 0"/>',
        pytest.param(  # a universal joint, about whose axes no spring acts
            '<joint axis="1 0 0" stiffness="4" damping="0.3"/><joint axis="0 1 0" damping="0.2"/>',
            marks=pytest.mark.long,
        ),
    ],
)
def test_joints_that_are_none_of_the_catalogue_have_links_without_mass_between_them(
    tmp_path, joints
):
    """dm_control's humanoid has hinges that do not meet. Right: MuJoCo, which needs no links."""
    path = one_body(tmp_path, joints)
    mechanism, left_out = read(path)
    assert mechanism.names == ("base", "body_1", "body")
    (line,) = left_out
    assert line == "links without mass or inertia, which have 1e-12 of what hangs on them: body_1"
    model = model_of(path)
    model.opt.timestep, model.opt.integrator = 2.5e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    result = lierb.integrate(mechanism, rtol=1e-11, t_end=0.25, solver="looped")
    mujoco.mj_kinematics(model, data)
    place = data.body("body")
    # MuJoCo's steps, of about 1 m/s and 5 rad/s: 0.25 · 5⁵ (2.5e-4)⁴ / 120 is 3e-14
    np.testing.assert_allclose(result["body"].position[0], place.xpos, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["body"].rotation[0].ravel(), place.xmat, rtol=0, atol=1e-10)


def test_sites_and_merged_bodies_are_named_frames(tmp_path):
    """Right: MuJoCo's frames at a random pose, and after a change of the body frames."""
    site = '<site name="tip" pos="0.1 0.2 0.3" euler="0.3 0 0.2"/>'
    flange = f'<body name="flange" pos="0 0 0.4" euler="0 0.2 0">{site}</body>'
    path = one_body(tmp_path, "<joint/>", inside=flange, around='<site name="mark" pos="1 2 3"/>')
    model = model_of(path)
    data = mujoco.MjData(model)
    data.qpos[:] = (0.7, -0.4)
    mujoco.mj_kinematics(model, data)
    right = {
        "tip": (data.site("tip").xpos, data.site("tip").xmat),
        "mark": (data.site("mark").xpos, data.site("mark").xmat),
        "flange": (data.body("flange").xpos, data.body("flange").xmat),
    }
    for frames in ("file", "centre"):
        mechanism, _ = read(path, frames=frames)
        assert {name: site.link for name, site in mechanism.sites.items()} == {
            "tip": "body", "mark": "ground", "flange": "body",
        }  # fmt: skip
        pose = {"ground": np.eye(4)} | mechanism.pose({"base": 0.7, "body": -0.4})
        for name, site in mechanism.sites.items():
            place = pose[site.link] @ site.pose
            np.testing.assert_allclose(place[:3, 3], right[name][0], rtol=0, atol=1e-12)
            np.testing.assert_allclose(place[:3, :3].ravel(), right[name][1], rtol=0, atol=1e-12)
        assert (
            mechanism.with_({"body.body.mass": [1.0, 1.2]}).of_body(1).sites.keys() == right.keys()
        )


def test_joints_compose_only_if_their_forces_can_act(tmp_path):
    plain, sprung = '<joint axis="1 0 0"/>', '<joint axis="1 0 0" stiffness="4" damping="0.3"/>'
    other, stopped = '<joint axis="0 1 0"/>', '<joint axis="0 1 0" limited="true" range="-1 1"/>'
    joints = lambda mechanism: [link.joint.name for link in mechanism.links[1:]]
    composed, _ = read(one_body(tmp_path, plain + stopped))
    assert joints(composed) == ["universal"]
    single, left_out = read(one_body(tmp_path, sprung + other))
    assert joints(single) == ["revolute", "revolute"]
    (spring,) = single.forces
    assert (spring.parameters["stiffness"], spring.parameters["damping"]) == (4.0, 0.3)
    assert not any("stiffness" in line for line in left_out)
    with_stops, _ = read(one_body(tmp_path, plain + stopped), limit_stiffness=100.0)
    assert joints(with_stops) == ["revolute", "revolute"]
    assert len(with_stops.forces) == 1


@pytest.mark.long
def test_c24_a_mobile_base_may_have_carriages_without_mass(tmp_path):
    """Genesis#3185, drake#13903, pinocchio#60: slides of a base, merged by hand or refused.

    Right: a planar joint, on which the chassis and its arm move.
    """
    text = """<mujoco><compiler angle="radian"/><worldbody>{base}
        <body name="arm" pos="0.2 0 0.1"><joint axis="0 1 0"/>
          <inertial pos="0.1 0.02 -0.3" mass="1.3" diaginertia="0.03 0.02 0.025"/></body>
      {end}</worldbody></mujoco>"""
    chassis = '<inertial pos="0.1 0 0" mass="5" diaginertia="0.2 0.3 0.4"/>'
    slides = """<body name="x"><joint type="slide" axis="1 0 0"/>
      <body name="y"><joint type="slide" axis="0 1 0"/>
      <body name="chassis"><joint axis="0 0 1"/>"""
    together = """<body name="chassis"><joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/><joint axis="0 0 1"/>"""
    ends = []
    for base, end in ((slides, "</body></body></body>"), (together, "</body>")):
        path = tmp_path / "base.xml"
        path.write_text(text.format(base=base + chassis, end=end))
        machine, _ = read(path)
        twist0 = machine.twist({"arm": 3.0, "chassis": 2.0 if end != "</body>" else (2.0, 0, 0)})
        ends.append(lierb.integrate(machine, twist0=twist0, dt=2e-3, t_end=0.5, solver="looped"))
    for link in ("chassis", "arm"):
        # 1e-12 of 6 kg between, whose effect over 0.5 s is of that part
        np.testing.assert_allclose(
            ends[0][link].position, ends[1][link].position, rtol=0, atol=1e-11
        )
        np.testing.assert_allclose(ends[0][link].omega, ends[1][link].omega, rtol=0, atol=1e-11)


LEGS = """<mujoco><compiler angle="radian"/><option gravity="{gravity}"/><worldbody>
  <body name="trunk" pos="0.1 0.2 1" euler="0.1 0.2 0.3">{joint}
    <inertial pos="0.05 0 0.1" mass="4" diaginertia="0.1 0.12 0.05"/>
    <body name="leg" pos="0.1 0.2 0" euler="0.3 0 0"><joint axis="1 2 0" pos="0 0 0.05"/>
      <inertial pos="0.1 0.02 -0.3" mass="1.3" diaginertia="0.03 0.02 0.025"/></body>
  </body></worldbody>{keys}</mujoco>"""


def test_c41_a_base_floats_or_is_fixed(tmp_path):
    """crocoddyl#979: files of legged robots and drones hold the base.

    Right: a file with a free joint.
    """
    keys = '<keyframe><key qpos="0 0 1 1 0 0 0 0.3"/></keyframe>'
    texts = {
        "fixed": LEGS.format(gravity="0 0 -9.81", joint="", keys=""),
        "free": LEGS.format(gravity="0 0 -9.81", joint="<freejoint/>", keys=keys),
    }
    made = {}
    for kind, text in texts.items():
        for base in (None, "free", "fixed"):
            path = tmp_path / f"{kind}.xml"
            path.write_text(text)
            made[kind, base], left_out = read(path, base=base)
            assert ("1 keyframe" in left_out) == (kind == "free")
    assert made["fixed", "free"].names == made["free", None].names == ("trunk", "leg")
    assert made["free", "fixed"].names == made["fixed", None].names == ("leg",)
    run = {"twist0": {"leg": (0.1, 0.2, 0.0, 0.0, 0.0, 0.0)}, "dt": 1e-3, "t_end": 0.3}
    for first, second in (
        (("fixed", "free"), ("free", None)),
        (("free", "fixed"), ("fixed", None)),
    ):
        ends = [
            lierb.integrate(m, **run | {"twist0": m.twist({"leg": 2.0})}, solver="looped")["leg"]
            for m in (made[first], made[second])
        ]
        np.testing.assert_array_equal(ends[0].position, ends[1].position)
    with pytest.raises(lierb.errors.UnknownNameError, match=r"base='floating'"):
        lierb.Mechanism.from_mjcf(path, base="floating")


SCENERY = """<body name="table" pos="1 0 0"><geom type="box" size="1 1 0.1"/></body>
  <body name="mark"/><body name="floor"><geom type="plane" size="1 1 1"/></body>
  <body name="target" mocap="true"><geom size="0.1"/></body></worldbody>"""


def test_c41_bodies_that_carry_no_joints_stay_on_the_ground(tmp_path):
    """crocoddyl#979: the base floats, not the table, a mark without mass or a mocap body.

    A drone has no joints: it floats, and a mark does not.
    """
    path = tmp_path / "scene.xml"
    legs = LEGS.format(gravity="0 0 -9.81", joint="", keys="")
    path.write_text(legs.replace("</worldbody>", SCENERY))
    assert read(path, base="free")[0].names == ("trunk", "leg")
    assert read(path, base="fixed")[0].names == ("leg",)
    path.write_text("""<mujoco><worldbody><body name="drone"><body name="frame"><geom size="0.1"/>
      </body></body><body name="mark"/></worldbody></mujoco>""")
    assert read(path, base="free", merge_fixed=True)[0].names == ("drone",)


def test_c41_the_root_of_a_urdf_floats(tmp_path):
    """The root has its mass; the momentum of all stays. Right: gravity's impulse."""
    text = """<robot name="r"><link name="trunk"><inertial><origin xyz="0.05 0 0.1"/>
      <mass value="4"/><inertia ixx="0.1" iyy="0.12" izz="0.05" ixy="0" ixz="0" iyz="0"/>
      </inertial></link>
      <link name="leg"><inertial><origin xyz="0.1 0.02 -0.3"/><mass value="1.3"/>
      <inertia ixx="0.03" iyy="0.02" izz="0.025" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="hip" type="continuous"><parent link="trunk"/><child link="leg"/>
      <origin xyz="0.1 0.2 0"/><axis xyz="0 1 0"/></joint></robot>"""
    path = tmp_path / "r.urdf"
    path.write_text(text)
    held, left_out = read(path)
    assert held.names == ("leg",)
    assert "mass of what is welded to the ground: trunk 4 kg" in left_out
    machine, left_out = read(path, base="free")
    assert (machine.names, left_out) == (("trunk", "leg"), ())
    twist0 = machine.twist({"leg": 3.0})
    result = lierb.integrate(machine, twist0=twist0, dt=1e-3, t_end=0.5, solver="looped")
    start = 1.3 * (twist0["leg"][3:] + np.cross(twist0["leg"][:3], (0.1, 0.02, -0.3)))
    end = sum(
        link.body.mass * result[link.name].rotation[0]
        @ (result[link.name].v[0] + np.cross(result[link.name].omega[0], link.body.com))
        for link in machine.links
    )  # fmt: skip
    np.testing.assert_allclose(end - start, (0.0, 0.0, -(4.0 + 1.3) * 0.5 * 9.81), atol=1e-10)


@pytest.mark.slow
def test_c50_an_imported_arm_runs_on_so3xr3(tmp_path):
    """jaxsim#205: frames of files are not at centres of mass. Right: the c-spaces agree."""
    path = tmp_path / "legs.xml"
    path.write_text(LEGS.format(gravity="0 0 -9.81", joint='<joint axis="0 1 0"/>', keys=""))
    (of_file, _), (centred, _) = read(path), read(path, frames="centre")
    assert not any(np.any(link.body.com) for link in centred.links)
    rates = {"trunk": 1.0, "leg": 2.0}
    end = lierb.integrate(
        of_file, twist0=of_file.twist(rates), dt=1e-3, t_end=0.3, solver="looped"
    )["leg"]
    run = {"twist0": centred.twist(rates), "dt": 1e-3, "t_end": 0.3}
    centre = end.position[0] + end.rotation[0] @ of_file.link("leg").body.com
    # RK4, of 4 rad/s: 0.3 · 4⁵ · 1e-12 / 120
    for more in ({"solver": "looped"}, {"cspace": "SO3xR3"}):
        moved = lierb.integrate(centred, **run, **more)["leg"]
        np.testing.assert_allclose(moved.position[0], centre, rtol=0, atol=2e-11)
        np.testing.assert_allclose(moved.rotation[0], end.rotation[0], rtol=0, atol=2e-11)


def test_links_without_mass_that_nothing_moves_are_refused(tmp_path):
    inside = '<body name="tip"><joint axis="{axis}"/>' + INERTIA + "</body>"
    path = one_body(
        tmp_path, '<joint axis="1 0 0"/>', inertial="", inside=inside.format(axis="1 0 0")
    )
    with (
        pytest.warns(LeftOutWarning),
        pytest.raises(ArgumentError, match="body has no mass or no inertia, and can move without"),
    ):
        lierb.Mechanism.from_mjcf(path)
    path = one_body(
        tmp_path, '<joint axis="1 0 0"/>', inertial="", inside=inside.format(axis="0 1 0")
    )
    assert read(path)[0].names == ("base", "body", "tip")


@pytest.mark.parametrize(
    ("joint", "place", "message"),
    [
        ('<joint axis="0 0 1"/>', "0 0 -1", "turn about an axis through its point mass"),
        ('<joint type="ball"/>', "0 0 -1", "turn about an axis through its point mass"),
        ('<joint type="ball"/>', "0 0 0", "body: the inertia is not positive definite: a point"),
        ('<joint axis="0 1 0"/>', "0 0 -1", None),
    ],
)
def test_point_masses_that_turn_about_themselves_are_refused(tmp_path, joint, place, message):
    point = f'<inertial pos="{place}" mass="1" diaginertia="0 0 0"/>'
    path = one_body(tmp_path, joint, inertial=point)
    if message is None:
        assert "body" in read(path)[0].names
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LeftOutWarning)
        with pytest.raises(ArgumentError, match=message):
            lierb.Mechanism.from_mjcf(path)


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ('range="1 1"', "joint knee: limits 1 … 1, which MuJoCo ignores"),
        ('range="1 -1"', "joint knee: limits 1 … -1, which MuJoCo ignores"),
        ('range="0 0"', None),  # MuJoCo's way to say that there are none
        ('range="-1 1" limited="false"', None),
    ],
)
def test_ranges_that_are_no_limits_are_said(tmp_path, given, line):
    _, left_out = read(one_body(tmp_path, f'<joint name="knee" {given}/>'), limit_stiffness=10.0)
    assert left_out == (() if line is None else (line,))


def test_a_range_of_zero_that_is_a_limit_is_refused_by_name(tmp_path):
    joint = '<joint name="knee" range="0 0" limited="true"/>'
    with pytest.raises(ArgumentError, match="Element name 'knee'"):
        read(one_body(tmp_path, joint))


LEFT_OUT = {
    "actuatorfrcrange": ('actuatorfrcrange="-1 1"', "", "1 joint with limits of its actuators"),
    "tendon": (
        "", '<tendon><fixed><joint joint="knee" coef="1"/></fixed></tendon>', "1 tendon",
    ),
    "sensor": ("", '<sensor><jointpos joint="knee"/></sensor>', "1 sensor"),
    "keyframe": ("", '<keyframe><key qpos="0 1"/></keyframe>', "1 keyframe"),
    "pair": (
        "", '<contact><pair geom1="ball" geom2="floor"/></contact>', "1 contact pair",
    ),
    "fluid": ("", '<option density="1.2" wind="1 0 0"/>', "the fluid's density and viscosity"),
    "options": (
        "", '<option integrator="implicitfast" timestep="0.001" cone="elliptic"/>',
        "options of MuJoCo's own solver: cone, integrator, timestep",
    ),
    "equality": (
        "", '<equality><joint joint1="knee" active="false"/></equality>',
        "equality 0: an equality that is not active",
    ),
    "armature": ('armature="0.1"', "", "joint knee: armature 0.1"),
    "friction": ('class="stiff"', "", "joint knee: friction 0.3"),
}  # fmt: skip


@pytest.mark.parametrize("what", LEFT_OUT)
def test_each_kind_that_is_left_out_is_said(tmp_path, what):
    """Friction from a default class within another one."""
    attributes, outside, line = LEFT_OUT[what]
    geom = '<geom name="{}" size="0.1" contype="0" conaffinity="0"/>'
    defaults = (
        '<default><default class="outer"><joint frictionloss="0.3"/><default class="stiff">'
        '<joint stiffness="7"/></default></default></default>'
    )
    path = one_body(
        tmp_path, f'<joint name="knee" {attributes}/>', inside=geom.format("ball"),
        around=geom.format("floor"), outside=defaults + outside,
    )  # fmt: skip
    mechanism, left_out = read(path)
    assert any(each.startswith(line) for each in left_out)
    if what == "friction":
        assert mechanism.forces[0].parameters["stiffness"] == 7.0


def test_gravity_compensation_is_said(tmp_path):
    path = one_body(tmp_path, "<joint/>")
    path.write_text(path.read_text().replace('name="body"', 'name="body" gravcomp="1"'))
    assert read(path)[1] == ("1 body with gravcomp",)


@pytest.mark.parametrize("flag", ["contact", "constraint", "frictionloss"])
def test_what_is_disabled_anyhow_is_not_left_out(tmp_path, flag):
    path = one_body(
        tmp_path, '<joint name="knee" frictionloss="0.1"/>', inside='<geom size="0.1"/>',
        outside=f'<option><flag {flag}="disable"/></option>',
    )  # fmt: skip
    friction, contact = "joint knee: friction 0.1", "1 geom that collides"
    expected = {"contact": (friction,), "constraint": (), "frictionloss": (contact,)}
    assert read(path)[1] == expected[flag]


def test_what_is_left_out_is_said_once(tmp_path):
    path = one_body(
        tmp_path,
        '<joint name="knee" range="-1 1" limited="true" frictionloss="0.1" armature="0.01"/>',
        inside='<geom size="0.1"/>',
        outside='<actuator><motor joint="knee"/></actuator>'
        '<equality><joint joint1="knee" active="false"/></equality>',
    )
    _, left_out = read(path)
    assert left_out == (
        "joint knee: limits -1 … 1", "joint knee: friction 0.1", "joint knee: armature 0.01",
        "equality 0: an equality that is not active", "1 geom that collides", "1 actuator",
    )  # fmt: skip
    with pytest.warns(LeftOutWarning, match="left out are joint knee: limits -1 … 1; joint knee"):
        lierb.Mechanism.from_mjcf(path)


def test_names_that_no_column_can_have_are_changed_and_said(tmp_path):
    path = one_body(tmp_path, "<joint/>")
    path.write_text(path.read_text().replace('name="body"', 'name="left/hip-1"'))
    mechanism, left_out = read(path)
    assert mechanism.names == ("base", "left_hip_1")
    assert left_out == ("the name 'left/hip-1': it is left_hip_1",)


def test_names_that_differ_in_case_alone_are_made_to_differ(tmp_path):
    """Names that differ in case only are equal, as columns are in SQL."""
    path, ball = tmp_path / "model.xml", "<joint/><geom size='1'/></body>"
    bodies = f"<body name='arm'>{ball}<body name='Arm'>{ball}"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert read(path)[0].names == ("arm", "Arm_2")


FAULTS = {
    "type": '<joint name="{}" type="hingey"/>',
    "axis": '<joint name="{}" axis="0 0 0"/>',
    "words": '<joint name="{}" axis="0 x 0"/>',
    "attribute": '<joint name="{}" nonsense="1"/>',
    "class": '<joint name="{}" class="nowhere"/>',
    "damping": '<joint name="{}" damping="-1"/>',
    "twice": '<joint name="{0}"/><joint name="{0}"/>',
}  # fmt: skip


@pytest.mark.parametrize("name", ["knee", "n" * 99 + "MIDDLE" + "e" * 95, "knie é/[%s] {0} '"])
@pytest.mark.parametrize("fault", FAULTS)
def test_refusals_name_the_joint_at_fault(tmp_path, fault, name):
    """MuJoCo's parser gives the line alone."""
    with pytest.raises(ArgumentError) as raised:
        read(one_body(tmp_path, FAULTS[fault].format(name)))
    assert name in str(raised.value)


@pytest.mark.parametrize("fault", ["type", "axis", "words", "attribute", "class", "damping"])
def test_refusals_name_the_body_of_a_joint_without_a_name(tmp_path, fault):
    with pytest.raises(ArgumentError, match=r"body body|joint body"):
        read(one_body(tmp_path, FAULTS[fault].replace('name="{}"', "")))


def test_refusals_name_the_body_of_a_mesh(tmp_path):
    path = one_body(
        tmp_path, "<joint/>", inside='<geom type="mesh" mesh="shell"/>',
        outside='<asset><mesh name="shell" file="nowhere.stl"/></asset>',
    )  # fmt: skip
    with pytest.raises(ArgumentError, match=r"nowhere.stl'.* \(a mesh of body body\)"):
        read(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody/></mujoco>", "no body that moves"),
        ("<mujoco><nonsense/></mujoco>", "cannot be read as MJCF"),
        ("", "cannot be read as MJCF"),
    ],
)
def test_files_without_a_mechanism_are_refused(tmp_path, text, message):
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=message):
        lierb.Mechanism.from_mjcf(path)


def test_what_to_install_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"URDF needs mujoco, .*pip install .*mjcf"):
        lierb.Mechanism.from_urdf(DATA / "arm.urdf")


def test_a_path_that_is_none_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="cannot be read as URDF"):
        lierb.Mechanism.from_urdf(tmp_path / "missing.urdf")
    with pytest.raises(ArgumentError, match="expected the path of a file"):
        lierb.Mechanism.from_urdf(17)


@pytest.mark.slow
def test_the_page_on_model_files_names_what_replaces_what_is_left_out(tmp_path):
    """Its cells run: friction, an actuator and an armature that the file would have."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # as for a reader; the page keeps the one that it prints
        names = names_of("../howto/model_files", tmp_path)
    arm, driven = names["arm"], names["driven"]
    added = [(force.name, *force.at) for force in driven.forces[len(arm.forces) :]]
    friction = [("joint_friction", "upper"), ("joint_friction", "lower")]
    assert added == [*friction, ("motor", "lower")]
    more = driven.link("upper").body.inertia - arm.link("upper").body.inertia
    np.testing.assert_allclose(more, 0.003 * np.eye(3), rtol=0, atol=1e-16)

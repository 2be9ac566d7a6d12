"""Studies of mechanisms, made in Python or written in TOML: the same, with loops that close."""

from __future__ import annotations

import shutil
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from mechanisms.shared import GRAVITY, double_pendulum, four_bar
from studies import bits, hashes, sorted_rows
from studies import study as one_body

import lierb
from lierb.api import integrate_model
from lierb.cli import cli
from lierb.errors import ArgumentError, StudyError, UnknownNameError
from lierb.results.columns import as_array
from lierb.studies.dataset import Dataset
from lierb.studies.description.moved_starts import moved_start
from lierb.studies.description.study import Study
from lierb.studies.execution.replaying import replay

# Of four_bar, as a file says it; one length is drawn at each end, so that no two loops are alike.
TEXT = """\
[problem]
gravity = [0.0, 0.0, -9.81]

[[problem.links]]
name = "crank"
body = {solid = "box", size = [0.1, 0.02, 0.02], density = 2700.0}
joint = {type = "revolute", axis = [0, 1, 0], body_point = [-0.05, 0, 0]}
initial = {coordinates = -1.0, velocities = 5.0}

[[problem.links]]
name = "coupler"
parent = "crank"
body = {solid = "box", size = [0.3, 0.02, 0.02], density = 2700.0}
initial = {coordinates = 0.5}

[problem.links.joint]
type = "revolute"
axis = [0, 1, 0]
body_point = [-0.15, 0, 0]
parent_point = [0.05, 0, 0]

[[problem.links]]
name = "rocker"
body = {solid = "box", size = [0.25, 0.02, 0.02], density = 2700.0}
initial = {coordinates = -1.6}

[problem.links.joint]
type = "revolute"
axis = [0, 1, 0]
body_point = [-0.125, 0, 0]
ground_point = [0.3, 0, 0]

[[problem.loops]]
name = "pin"
body = "coupler"
parent = "rocker"

[problem.loops.joint]
type = "revolute"
axis = [0, 1, 0]
body_point = [0.15, 0, 0]
parent_point = [0.125, 0, 0]

[[problem.forces]]
type = "drag"
on = "rocker"
angular = 0.002

[sample]
n = 40
seed = 5

[sample.crank.joint.body_point]
distribution = "uniform"
low = [-0.051, 0, 0]
high = [-0.049, 0, 0]

[sample.pin.joint.parent_point]
distribution = "normal"
mean = [0.125, 0, 0]
std = [0.0002, 0, 0]

[sample.crank.initial.velocities]
distribution = "uniform"
low = 4.0
high = 6.0

[sample.forces.drag.angular]
distribution = "uniform"
low = 0.0
high = 0.004

[integrate]
dt = 1e-3
t_end = 0.02
save_every = 10
record = ["state"]

[output]
part = 16
"""
QUANTITIES = {
    "crank.joint.body_point": lierb.sampling.Uniform((-0.051, 0, 0), (-0.049, 0, 0)),
    "pin.joint.parent_point": lierb.sampling.Normal((0.125, 0, 0), (0.0002, 0, 0)),
    "crank.initial.velocities": lierb.sampling.Uniform(4.0, 6.0),
    "forces.drag.angular": lierb.sampling.Uniform(0.0, 0.004),
}
SETTINGS = {"dt": 1e-3, "t_end": 0.02, "save_every": 10, "record": ["state"], "part": 16}
INITIAL = {
    "crank": {"coordinates": -1.0, "velocities": 5.0},
    "coupler": {"coordinates": 0.5},
    "rocker": {"coordinates": -1.6},
}
DESIGN = lierb.sampling.Design(QUANTITIES, n=40, seed=5)
LINKS = ("crank", "coupler", "rocker")


def load(tmp_path, *edits: list[str]) -> Study:
    text = TEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "bar.toml").write_text(text)
    return Study.load(tmp_path / "bar.toml")


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Study:
    return load(tmp_path_factory.mktemp("written"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run without a break."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    lierb.run(four_bar(), DESIGN, folder, initial=INITIAL, **SETTINGS)
    return folder


# ---- what is made ------------------------------------------------------------------------------


def test_study_of_a_mechanism_makes_the_same_mechanism():
    """Every number to the bit, drawn ones apart."""
    given = four_bar()
    study = lierb.study_of(given, DESIGN, initial=INITIAL, **SETTINGS)
    made = study.batch(0, 3).problem
    assert (made.names, made.parents, made.kinds) == (given.names, given.parents, given.kinds)
    assert [element.at for element in made.elements] == [("rocker",)]
    drawn = {"0.body_frame", "3.ground_frame", "element0.angular"}
    for name, array in given.quantities.items():
        if name not in drawn:
            np.testing.assert_array_equal(made.quantities[name], array)
    assert Study.of(study.model_dump()) == study
    assert study.integrate.cspace == ["reduced"]


def test_points_of_a_made_joint_are_drawn_on_its_frame():
    study = lierb.study_of(four_bar(), DESIGN, initial=INITIAL, **SETTINGS)
    batch = study.batch(2, 3)
    crank, draws = batch.problem.link("crank").joint, batch.draws["crank.joint.body_point"]
    np.testing.assert_array_equal(crank.body_frame[:, :3, 3], draws)
    turned = four_bar().link("crank").joint.body_frame[:3, :3]
    np.testing.assert_array_equal(crank.body_frame[:, :3, :3], np.broadcast_to(turned, (3, 3, 3)))


def test_file_and_python_make_the_same_bodies(written):
    """A file gives points and axes, Python frames: the same to rounding."""
    study = lierb.study_of(four_bar(), DESIGN, initial=INITIAL, **SETTINGS)
    one, other = written.batch(0, 5), study.batch(0, 5)
    assert one.draws.keys() == other.draws.keys()
    for name, draws in one.draws.items():
        np.testing.assert_array_equal(draws, other.draws[name])
    for link in LINKS:
        np.testing.assert_allclose(one.pose0[link], other.pose0[link], rtol=0, atol=1e-13)
        np.testing.assert_allclose(one.twist0[link], other.twist0[link], rtol=0, atol=1e-11)
    assert Study.of(study_tables(written)).digest() == written.digest()


def study_tables(study: Study) -> dict:
    import tomllib

    return tomllib.loads(study.to_toml())


def test_hold_keeps_given_coordinates_and_velocities(tmp_path):
    """Oracle: the pin seen from both sides, with the crank as given, by sums of the bars."""
    study = load(tmp_path, ["[sample]", '[initial]\nhold = "crank"\n\n[sample]'])
    batch = study.batch(0, 20)
    places = batch.problem.coordinates(batch.pose0)
    rates = batch.problem.velocities(batch.twist0, batch.pose0)
    # Coordinates are made of a rotation by arctan2, rates of twists: a few roundings.
    np.testing.assert_allclose(places["crank"], -1.0, rtol=0, atol=1e-15)
    drawn = batch.draws["crank.initial.velocities"].reshape(20)
    np.testing.assert_allclose(rates["crank"][:, 0], drawn, rtol=1e-14)

    def along(length, angle, rate):  # about y, z → x
        turned = np.stack([np.cos(angle), -np.sin(angle)], -1)
        across = np.stack([-np.sin(angle), -np.cos(angle)], -1)
        return length[:, None] * turned, (length * rate)[:, None] * across

    angle, rate = places["crank"][:, 0], rates["crank"][:, 0]
    crank = along(0.05 - batch.draws["crank.joint.body_point"][:, 0], angle, rate)
    turned = angle + places["coupler"][:, 0], rate + rates["coupler"][:, 0]
    coupler = along(np.full(20, 0.3), *turned)
    rocker = along(0.125 + batch.draws["pin.joint.parent_point"][:, 0],
                   places["rocker"][:, 0], rates["rocker"][:, 0])  # fmt: skip
    np.testing.assert_allclose(crank[0] + coupler[0] - rocker[0], [[0.3, 0.0]] * 20, atol=1e-13)
    np.testing.assert_allclose(crank[1] + coupler[1], rocker[1], rtol=0, atol=1e-13)
    assert moved_start(study) == ""
    same = lierb.study_of(four_bar(), DESIGN, initial=INITIAL | {"hold": ["crank"]}, **SETTINGS)
    np.testing.assert_allclose(
        same.batch(0, 20).twist0["rocker"], batch.twist0["rocker"], atol=1e-11
    )


def test_moved_starts_are_described(written):
    batch = written.batch(0, 40)
    rates = batch.problem.velocities(batch.twist0, batch.pose0)["crank"][:, 0]
    given = batch.draws["crank.initial.velocities"].reshape(40)
    body = int(np.abs(rates - given).argmax())
    line = moved_start(written)
    assert f"crank.velocities from {given[body]:.3g} to {rates[body]:.3g} rad/s" in line
    assert "(the largest changes of 40 bodies); hold in [initial] keeps" in line


@pytest.mark.parametrize(
    ("hold", "message"),
    [
        ('"krank"', r"^bar.toml:\d+: initial: hold='krank' is unknown; .* Did you mean 'crank'"),
        ('["crank", "coupler"]', r"initial: trajectory 0: no closed pose .* hold gives the "
         "coordinates of crank, coupler"),
        ('"rocker"\nclose = "never"', "initial.hold: is of starts that are closed; leave out"),
    ],
)  # fmt: skip
def test_hold_is_refused_with_the_reason(tmp_path, hold, message):
    with pytest.raises(StudyError, match=message):
        load(tmp_path, ["[sample]", f"[initial]\nhold = {hold}\n\n[sample]"])


def test_hold_of_a_link_without_numbers_is_refused(tmp_path):
    edits = (
        ["initial = {coordinates = -1.6}\n", ""],
        ["[sample]", '[initial]\nhold = "rocker"\n[sample]'],
    )
    with pytest.raises(StudyError, match="rocker has neither coordinates nor velocities to keep"):
        load(tmp_path, *edits)


def test_every_loop_of_a_study_is_closed(written):
    """Oracle: where the two ends of the pin are and how they move, from poses and twists alone."""
    batch = written.batch(0, 20)
    ends = {}
    for link, points in (
        ("coupler", np.array((0.15, 0.0, 0.0))),
        ("rocker", batch.draws["pin.joint.parent_point"]),
    ):
        pose, twist = batch.pose0[link], batch.twist0[link]
        rotation = pose[:, :3, :3]
        at = np.einsum("nij,nj->ni", rotation, np.broadcast_to(points, (20, 3))) + pose[:, :3, 3]
        own = twist[:, 3:] + np.cross(twist[:, :3], points)
        ends[link] = at, np.einsum("nij,nj->ni", rotation, own)
    # lengths are 0.3 m and speeds 1 m/s; closing ends at 1e-15 of them, rounding included at 1e-13
    for one, other in zip(ends["coupler"], ends["rocker"], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13)
    spread = np.ptp(batch.pose0["rocker"][:, 0, 3])
    assert spread > 1e-5  # lengths differ, and so do the angles that close them


def test_start_of_a_tree_is_that_of_the_mechanism():
    """Coordinates are not moved where nothing is open."""
    pendulum = double_pendulum()
    start = {"upper": {"coordinates": 0.4, "velocities": 2.0}, "lower": {"coordinates": -0.3}}
    values = lierb.sampling.Values([1.0, -1.0])
    design = lierb.sampling.Design({"lower.initial.velocities": values}, method="grid")
    batch = lierb.study_of(pendulum, design, initial=start, dt=1e-2, t_end=0.1).batch(0, 2)
    pose0 = pendulum.pose({"upper": 0.4, "lower": -0.3})
    twist0 = pendulum.twist({"upper": 2.0, "lower": [1.0, -1.0]}, pose0)
    for link in pendulum.names:
        np.testing.assert_array_equal(batch.pose0[link], np.tile(pose0[link], (2, 1, 1)))
        np.testing.assert_array_equal(batch.twist0[link], twist0[link])


def satellite() -> lierb.Mechanism:
    """A body in flight and a wheel on it."""
    body = lierb.bodies.box((1.0, 1.2, 0.8), mass=100.0)
    wheel = lierb.bodies.cylinder(0.1, 0.05, mass=2.0)
    return lierb.Mechanism(
        [
            lierb.Link("wheel", wheel, lierb.joints.revolute(ground_point=(0, 0, 0.3)), "hull"),
            lierb.Link("hull", body, lierb.joints.free()),
        ],
        gravity=GRAVITY,
    )


def test_links_in_flight_start_with_rotation_place_and_omega():
    quantities = {
        "hull.initial.omega": lierb.sampling.Direction(0.1),
        "hull.initial.rotation": lierb.sampling.Rotation(),
        "wheel.initial.velocities": lierb.sampling.Uniform(100.0, 200.0),
    }
    design = lierb.sampling.Design(quantities, n=3)
    start = {"hull": {"place": (1.0, 2.0, 3.0)}}
    batch = lierb.study_of(satellite(), design, initial=start, dt=0.1, t_end=1.0).batch(0, 3)
    draws, hull, wheel = batch.draws, batch.pose0["hull"], batch.pose0["wheel"]
    np.testing.assert_array_equal(hull[:, :3, :3], draws["hull.initial.rotation"])
    np.testing.assert_array_equal(hull[:, :3, 3], np.tile((1.0, 2.0, 3.0), (3, 1)))
    above = hull[:, :3, 3] + 0.3 * hull[:, :3, 2]
    np.testing.assert_allclose(wheel[:, :3, 3], above, rtol=0, atol=1e-15)
    omega, spin = draws["hull.initial.omega"], draws["wheel.initial.velocities"]
    np.testing.assert_allclose(batch.twist0["hull"][:, :3], omega, rtol=0, atol=1e-15)
    relative = batch.twist0["wheel"][:, :3] - omega  # their axes coincide at coordinate 0
    along = spin[:, None] * np.array((0.0, 0.0, 1.0))
    np.testing.assert_allclose(relative, along, rtol=0, atol=1e-12)


def test_digest_of_a_study_of_one_body_is_as_before_mechanisms():
    """Computed before there were any: folders of results that were begun then go on."""
    digest = "136cbbc7764c929d49ab772c45f42a5de8458e53b9adedce793d8b24fda46798"
    assert one_body().digest() == digest


# ---- runs --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_rows_of_a_mechanism_are_those_of_integrate(whole):
    study = Study.load(whole / "study.toml")
    batch = study.batch(0, 40)
    options = study.options(study.settings[0], batch.problem)
    result = integrate_model(batch.problem, options, batch.pose0, batch.twist0)
    rows = sorted_rows(whole)
    assert [row["trajectory"] for row in rows] == list(range(40))
    for name in ("rocker.position", "coupler.omega", "pin.position_error_max", "energy_drift_max"):
        found = np.array([row[name] for row in rows])
        np.testing.assert_array_equal(found, as_array(result.summary[name]))
    draws = DESIGN.draw()
    for name in QUANTITIES:
        found = np.array([row[f"sample.{name}"] for row in rows])
        np.testing.assert_array_equal(found, draws[name])


@pytest.mark.slow
def test_bits_of_mechanisms_do_not_depend_on_parts(whole, tmp_path):
    lierb.run(whole / "study.toml", tmp_path / "out", changes={"output.part": 7})
    assert bits(tmp_path / "out") == bits(whole)
    assert bits(tmp_path / "out", "history") == bits(whole, "history")


@pytest.mark.slow
def test_resume_of_mechanisms_does_what_is_missing(whole, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    sorted((folder / "summary").glob("*.parquet"))[1].unlink()
    lierb.run(four_bar(), DESIGN, folder, initial=INITIAL, resume=True, **SETTINGS)
    assert hashes(folder) == hashes(whole)
    other = {**SETTINGS, "stabilise": "project"}
    with pytest.raises(StudyError, match="has the results of another study"):
        lierb.run(four_bar(), DESIGN, folder, initial=INITIAL, resume=True, **other)


def test_manifest_says_the_mechanism(whole):
    import json

    told = json.loads((whole / "manifest.json").read_text())["study"]["problem"]
    assert [link["name"] for link in told["links"]] == [*LINKS]
    assert [loop["name"] for loop in told["loops"]] == ["pin"]
    assert told["forces"][0]["on"] == ["rocker"]


@pytest.mark.long
def test_replay_of_a_mechanism_has_the_studys_row(whole):
    ((_, tables),) = replay(whole / "study.toml", 23)
    (row,) = tables["summary"].to_pylist()
    assert row == sorted_rows(whole)[23]
    assert {"pin.reaction", "pin.lambda", "crank.position"} <= {*tables["history"].column_names}


@pytest.mark.long
def test_workers_give_the_same_bytes_of_mechanisms(whole, tmp_path):
    from lierb.studies.execution.cluster import local_client

    with local_client(2) as client:
        lierb.run(
            four_bar(), DESIGN, tmp_path / "out", initial=INITIAL, client=client, **SETTINGS
        )  # fmt: skip
    assert bits(tmp_path / "out") == bits(whole)


def test_command_shows_a_study_of_mechanisms(whole):
    shown = CliRunner().invoke(cli, ["show", str(whole)], catch_exceptions=False)
    assert "Closing the loops moved starts: " in shown.stdout
    (dataset := Dataset(whole)).read()
    assert "Closing the loops moved starts: " in str(dataset)
    assert shown.exit_code == 0
    assert "position, m" in shown.output


@pytest.mark.slow
def test_command_predicts_joint_by_joint(whole):
    said = CliRunner().invoke(cli, ["predict", str(whole / "study.toml")], catch_exceptions=False)
    words = [line.split()[:2] for line in said.output.splitlines()]
    assert ["pin", "reduced"] in words  # of its table
    assert ["pin,", "reduced:"] in words  # of the reasons


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_report_of_a_study_of_mechanisms_is_complete(whole, tmp_path):
    from lierb.studies.dataset import Dataset
    from lierb.studies.pages.report import write_report

    dataset = Dataset(whole)
    dataset.read()
    page = write_report(dataset, tmp_path / "report.html").read_text()
    assert "crank.initial.velocities" in page
    assert page.count("&quot;closes&quot;:true") or page.count('"closes":true')


def test_units_and_symbols_of_a_mechanism(whole):
    from lierb.studies.dataset import Dataset
    from lierb.studies.findings.columns import drawn_columns
    from lierb.studies.findings.symbols import labelled

    dataset = Dataset(whole)
    dataset.read()
    units = drawn_columns(dataset)
    assert units["sample.crank.initial.velocities"] == "rad/s"
    assert units["sample.pin.joint.parent_point"] == "m"
    study = Study.load(whole / "study.toml")
    rows = {f"sample.{name}": values for name, values in study.batch(0, 4).draws.items()}
    labels = [*labelled(units, [rows], study)[0]]
    assert labels == [
        "crank: φ̇ [rad/s]", "crank: body point₁ [m]", "drag: angular [N m s]",
        "pin: parent point₁ [m]",
    ]  # fmt: skip


def test_stopping_rule_may_be_about_a_joint(written):
    rule = "width of 95% of pin.position_error_max < 50%"
    assert written.changed({"sample.stop_when": rule}).stopping_rule.column == rule.split()[4]


# ---- what is wrong -----------------------------------------------------------------------------

PIN = "[sample.pin.joint.parent_point]"
CRANK = 'joint = {type = "revolute", axis = [0, 1, 0], body_point = [-0.05'
WRONG = {
    "sampled link": (PIN, "[sample.pinn.joint.parent_point]", "sample.pinn: unknown key; did you"),
    "sampled part": (
        "[sample.crank.joint.body_point]", "[sample.crank.joit.body_point]",
        "sample.crank.joit: unknown key; did you mean joint?",
    ),
    "sampled key": (PIN, "[sample.pin.joint.parent_pt]", "parent_pt: unknown key; did you mean"),
    "body of a loop": (PIN, "[sample.pin.body.com]", "sample.pin.body: a loop has a joint, and"),
    "parent": ('parent = "crank"', 'parent = "crnk"', "Did you mean 'crank'"),
    "key of a link": (
        "initial = {coordinates = 0.5}", "initial = {coordinate = 0.5}",
        "toml:14: problem.links.coupler.initial.coordinate: unknown key; did you mean coordinates?",
    ),
    "joint": (
        CRANK, CRANK.replace("revolute", "revolut"),
        "toml:7: problem.links.crank.joint: type='revolut' is unknown",
    ),
    "second joint": (
        "body_point = [-0.15, 0, 0]", "body_points = [-0.15, 0, 0]",
        "toml:19: problem.links.coupler.joint.body_points: unknown key; did you mean body_point?",
    ),
    "second joint's type": (
        '[problem.links.joint]\ntype = "revolute"', '[problem.links.joint]\ntype = "revolut"',
        "toml:16: problem.links.coupler.joint: type='revolut' is unknown",
    ),
    "reserved": ('name = "rocker"', 'name = "sample"', "is named sample, as a table of [sample]"),
    "one body's": ("[sample]\n", "[body]\nmass = 1.0\n[sample]\n", "body: is of one body"),
    "start of one body": (
        "[sample]\n", "[initial]\nomega = [0, 0, 1]\n[sample]\n", "initial.omega: is of one body",
    ),
    "open": ("[sample]\n", '[initial]\nclose = "never"\n[sample]\n', "does not close"),
    "out of reach": (
        "parent_point = [0.05, 0, 0]", "parent_point = [1.05, 0, 0]", "initial: trajectory 0",
    ),
    "on": ('on = "rocker"', 'on = "rcker"', "Did you mean 'rocker'"),
    "solid without its radius": (
        '{solid = "box", size = [0.3, 0.02, 0.02], density = 2700.0}',
        '{solid = "rod", length = 0.3, density = 2700.0}',
        "bar.toml:13: problem.links.coupler.body: radius missing; rod needs length, radius",
    ),
    "two numbers of one coordinate": (  # no batch of two
        "{coordinates = 0.5}", "{coordinates = [0.5, 0.6]}",
        "problem.links.coupler.initial.coordinates: has 2 numbers; expected a number, of phi",
    ),
    "two rates of one coordinate": (
        "{coordinates = 0.5}", "{coordinates = 0.5, velocities = [0.5, 0.6]}",
        "problem.links.coupler.initial.velocities: has 2 numbers; expected a number, of phi",
    ),
    "two starts": (
        "{coordinates = 0.5}", "{coordinates = 0.5, place = [0, 0, 0]}",
        "problem.links.coupler.initial: give coordinates, or rotation and place, or pose",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_mechanism_of_a_study_is_told(name, tmp_path):
    *edit, message = WRONG[name]
    with pytest.raises(StudyError) as caught:
        load(tmp_path, edit)
    assert message in str(caught.value)
    assert str(caught.value).startswith("bar.toml")


def test_trajectory_that_cannot_be_closed_is_named_by_its_number():
    """The eleventh, in a part of its own: the first eight are looked at when it is made."""
    levels = np.zeros((11, 3))
    levels[:, 0] = np.linspace(-0.15, -0.1501, 11)
    levels[10, 0] = -1.15
    quantities = {"coupler.joint.body_point": lierb.sampling.Values(levels)}
    design = lierb.sampling.Design(quantities, method="grid")
    study = lierb.study_of(four_bar(), design, initial=INITIAL, dt=1e-3, t_end=0.1)
    assert len(study.batch(0, 10).twist0["crank"]) == 10
    with pytest.raises(StudyError, match="initial: trajectory 10: no closed pose is found"):
        study.batch(8, 3)


def test_loops_alone_are_told():
    with pytest.raises(StudyError, match="body: is missing"):
        Study.of({"integrate": {"dt": 1e-3, "t_end": 1.0}, "problem": {"loops": []}})


def test_names_of_elements_in_a_study_are_told():
    """Those of `with_` and of derivatives begin with the link."""
    springs = [
        lierb.forces.torsional_spring(stiffness=1.0).on(name) for name in ("crank", "rocker")
    ]
    machine = lierb.Mechanism(four_bar().links, four_bar().loops, forces=springs)
    own = "rocker.torsional_spring.stiffness"
    machine.with_({own: 2.0})
    study = partial(lierb.study_of, initial=INITIAL, dt=0.1, t_end=1.0)
    for name, told in (
        (own, r"a study names it forces\.torsional_spring_2\.stiffness"),
        ("springs.x", r"are forces\.torsional_spring \(crank\.torsional_spring\), forces\.tors"),
    ):
        with pytest.raises(StudyError, match=told):
            study(machine, lierb.sampling.Design({name: 2.0}, n=2))
    drawn = study(machine, lierb.sampling.Design({"forces.torsional_spring_2.stiffness": 2.0}, n=2))
    _, second = drawn.batch(0, 2).problem.forces
    assert second.at == ("rocker",)
    assert second.parameters["stiffness"].tolist() == [2.0, 2.0]


@pytest.mark.parametrize(
    ("given", "kind", "told"),
    [
        ({"quantities": {"crank.mass": 1.0}}, StudyError, "expected names such as crank.body.mass"),
        ({"quantities": {"pin.body.mass": 1.0}}, StudyError, "'pin.body.mass' is no quantity"),
        ({"quantities": {"crank.joint.axis": (1.0, 0, 0)}}, StudyError, "a joint that is made has"),
        ({"initial": [1.0]}, ArgumentError, r"initial=\[1.0\]; expected a dictionary"),
        ({"initial": {"crnk": {}}}, UnknownNameError, "Did you mean 'crank'"),
        ({"initial": {"crank": 0.3}}, ArgumentError, "expected a dictionary, such as"),
        ({"initial": {"crank": {"angle": 0.3}}}, UnknownNameError, "initial\\['crank'\\]='angle'"),
    ],
)
def test_mechanism_that_no_file_can_say_is_refused(given, kind, told):
    design = lierb.sampling.Design(given.pop("quantities", {"crank.body.mass": 1.0}), n=2)
    with pytest.raises(kind, match=told):
        lierb.study_of(four_bar(), design, **({"initial": INITIAL} | given), dt=0.1, t_end=1.0)

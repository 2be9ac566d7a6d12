"""Studies: their files, and runs that stream, stop and go on."""

from __future__ import annotations

import contextlib
import copy
import errno
import inspect
import json
import os
import random
import re
import shlex
import shutil
import signal
import time
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from cases import column, slow_but
from click.testing import CliRunner
from documented import entries, sections
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from studies import (
    PARTS,
    TEXT,
    bits,
    errors_when_stopped,
    hashes,
    sorted_rows,
    start,
    start_long,
    study,
)

import lierb
from lierb.cli import cli
from lierb.errors import StudyError, StudyWarning
from lierb.studies.dataset import Dataset
from lierb.studies.description.sections.sampling import KEYS
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import line_of
from lierb.studies.description.units import UNITS
from lierb.studies.execution import opening, replaying, running
from lierb.studies.execution.replaying import replay
from lierb.studies.storage import store as store_module
from lierb.studies.storage.manifest import sealed
from lierb.studies.storage.parts import Parts, _with_draws
from lierb.studies.storage.store import Store

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.toml"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The study run without a break."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    lierb.run(study(), folder)
    return folder


# ---- files -------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_is_a_study(path):
    loaded = Study.load(path)
    assert loaded.name == path.stem
    assert Study.of(tomllib.loads(loaded.to_toml()), folder=path.parent) == loaded


LOW, HIGH = "low = 5.0", "high = 7.0"
DOWN, SLIGHTLY = "low = [0, 0, -9]", "high = [0, 0, -8]"
WRONG = {
    "syntax": ([("mass = 6.075", "mass = ")], "s.toml: Invalid value (at line 2"),
    "key": ([("t_end", "tend")], "s.toml:38: integrate.tend: unknown key; did you mean t_end?"),
    "missing": ([("t_end = 0.05", "")], "s.toml:35: integrate.t_end: is missing"),
    "table": ([("[joint]", "[jonit]")], "s.toml:5: jonit: unknown key; did you mean joint?"),
    "joint's type": ([("spherical", "sphericl")], "s.toml:5: joint: type='sphericl' is unknown"),
    "vector": ([("[0.0, 0.0, -9.81]", "[0.0, -9.81]")], "s.toml:10: problem.gravity: list"),
    "word": ([("dt = [1e-3, 2e-3]", 'dt = "1 ms"')], "s.toml:37: integrate.dt"),
    "sign": (
        [("= 6.075", "= -1"), ("sample.body.mass", "sample.problem.gravity"), (LOW, DOWN),
         (HIGH, SLIGHTLY)],
        "s.toml:1: body: mass is -1.0 kg",
    ),
    "grid": ([("t_end = 0.05", "t_end = 0.0505")], "s.toml:35: integrate: t_end=0.0505 s is no"),
    "cspace": ([('"SE3"', '"SE4"')], "s.toml:35: integrate: cspace='SE4' is unknown"),
    "distribution": ([("normal", "norml")], "sample.initial.omega.distribution: it='norml'"),
    "parameter": (
        [("std = 0.5", "sdt = 0.5")],
        "s.toml:23: sample.initial.omega.sdt: unknown key; did you mean std?",
    ),
    "no distribution": (
        [('distribution = "normal"', "")], "sample.initial.omega: needs distribution",
    ),
    "quantity": ([("body.mass]", "body.mas]")], "body.mas: unknown key; did you mean mass?"),
    "force": ([("drag.linear]", "darg.linear]")], "sample.forces.darg: there is no such force"),
    "force's parameter": (
        [("linear = 0.1", "linaer = 0.1")],
        "forces.drag.linaer: unknown key; did you mean linear?",
    ),
    "force's distribution in both places": (
        [("linear = 0.1", 'linear = { distribution = "uniform", low = 0, high = 1 }')],
        "problem.forces.drag.linear is a table, and sample.forces.drag.linear is where",
    ),
    "force's joint": (
        [("drag", "torsional_spring"), ("linear", "stiffness")],
        "problem: torsional_spring acts about the joint axis",
    ),
    "ignored quantity": ([("initial.omega", "initial.omgea")], "sample.initial.omgea: unknown key"),
    "ignored field": ([("body.mass", "problem.gravty")], "sample.problem.gravty: unknown key"),
    "numbers for a vector": (
        [("mean = [6.28, 3.14, 0.63]", "mean = 1.0"), ("n = 50", "n = 3")],
        "sample.initial.omega: a draw has shape (); expected a list of numbers",
    ),
    "a vector for a number": (
        [("low = 0.0", "low = [0.0, 0.0]"), ("high = 0.2", "high = [0.2, 0.2]")],
        "linear has shape (8, 2)",
    ),
    "start": (
        [("[sample]\n", "[initial]\nplace = [0.1, 0.0, 0.0]\n[sample]\n")],
        "s.toml:16: initial: pose0[0] does not close the spherical joint",
    ),
    "two forces": (
        [("[sample]\n", '[[problem.forces]]\ntype = "drag"\n[sample]\n')],
        "problem.forces: two have the same name",
    ),
    "two forces but for case": (
        [("[sample]\n", '[[problem.forces]]\ntype = "drag"\nname = "DRAG"\n[sample]\n')],
        "problem.forces: two have the same name",
    ),
    "list as a name": ([('"normal"', '["normal"]')], "sample.initial.omega: needs distribution"),
    "n": ([("n = 50", "n = 0")], "s.toml:17: sample.n: input should be greater than 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_error_names_line_and_key(name, tmp_path):
    edits, message = WRONG[name]
    text = TEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(StudyError) as caught:
        Study.load(path)
    assert message in str(caught.value)


NEGATIVE = """\
[body]
mass = 2.0
inertia = [0.05, 0.06, 0.07]
[joint]
type = "free"
[sample]
n = 60_000
seed = 3
[sample.body.mass]
distribution = "normal"
mean = 4.0
std = 1.0
[integrate]
dt = 0.1
t_end = 0.1
[output]
part = 1000
"""


@pytest.mark.parametrize("part", [1000, 1])
def test_draws_that_make_no_body_are_refused_before_the_run(part, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(NEGATIVE.replace("part = 1000", f"part = {part}"))
    masses = Study.load(file).design.draw()["body.mass"]
    body = int(np.flatnonzero(masses <= 0.0)[0])
    assert body > 30_000
    told = f"s.toml:9: sample.body.mass: trajectory {body}: mass is {masses[body]} kg; expected a"
    for run in (lierb.integrate_batches, lambda path: lierb.run(path, tmp_path / "out")):
        with pytest.raises(StudyError, match=re.escape(told)):
            run(file)
    assert not (tmp_path / "out" / "manifest.json").exists()


@pytest.mark.parametrize("count", [100, 1])
def test_draws_beyond_those_checked_name_the_trajectory(count):
    given = Study.of(tomllib.loads(NEGATIVE))
    body = int(np.flatnonzero(given.design.draw()["body.mass"] <= 0.0)[0])
    with pytest.raises(StudyError, match=rf"^sample\.body\.mass: trajectory {body}: mass is -0\."):
        given.batch(body - count + 1, count)


def test_first_draws_without_a_body_name_the_trajectory():
    """An index is that of a body only for what is drawn: that of a constant is a component."""
    changed = tomllib.loads(TEXT)
    changed["sample"] |= {"n": 1, "forces": {"drag": {"linear": NUMBER | {"low": [0.1, 0.1]}}}}
    with pytest.raises(StudyError, match=r"linear has shape \(1, 2\); expected .*$") as caught:
        Study.of(changed)
    assert "trajectory" not in str(caught.value)
    drag = {"distribution": "values", "values": [-1.0, -2.0]}
    changed["sample"]["forces"] = {"drag": {"linear": drag}}
    with pytest.raises(
        StudyError, match=r"sample\.forces\.drag\.linear: trajectory 0: linear is -"
    ):
        Study.of(changed)
    spring = {"type": "spring_damper", "stiffness": 1.0, "ground_point": [0.0, 0.0, np.inf]}
    changed["problem"]["forces"] = [{"type": "drag"}, spring]
    changed["sample"]["forces"] = {"drag": {"linear": drag | {"values": [0.1]}}}
    with pytest.raises(StudyError, match=r"ground_point\[2\] is inf; expected finite numbers$"):
        Study.of(changed)


def test_line_of_finds_the_nearest_key():
    assert line_of(TEXT, ("integrate", "dt")) == TEXT.splitlines().index("dt = [1e-3, 2e-3]") + 1
    assert line_of(TEXT, ("sample", "initial", "omega", "std")) == 23
    assert line_of(TEXT, ("integrate", "nothing")) == line_of(TEXT, ("integrate",)) == 35
    assert line_of(TEXT, ("nothing",)) is None


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 10**6), st.floats(), st.text(max_size=5),
    st.lists(st.floats(), max_size=4), st.dictionaries(st.text(max_size=5), st.integers()),
    st.sampled_from(["SE3", "RK4", "normal", "spherical", [1.0, 2.0, 3.0], [[1.0]], {}]),
)  # fmt: skip


@pytest.mark.slow
@settings(
    max_examples=400, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
@given(data=st.data())
def test_any_file_is_a_study_or_an_error_that_says_so(data):
    tables = copy.deepcopy(tomllib.loads(TEXT))
    for _ in range(data.draw(st.integers(1, 3))):
        place = tables
        while True:
            if isinstance(place, list):
                place = place[0]
            key = data.draw(st.sampled_from([*place, "extra"]))
            inner = place.get(key)
            deeper = isinstance(inner[0] if isinstance(inner, list) and inner else inner, dict)
            if not deeper or data.draw(st.booleans()):
                break
            place = inner
        action = data.draw(st.sampled_from(["set", "set", "delete"]))
        if action == "set":
            place[key] = copy.deepcopy(data.draw(VALUES))  # it may be changed in its turn
        else:
            place.pop(key, None)
    with contextlib.suppress(StudyError):  # and nothing else
        Study.of(tables)


def test_schema_is_that_of_the_code():
    stored = json.loads((EXAMPLES[0].parent.parent / "docs" / "study.schema.json").read_text())
    assert _without_defaults(stored) == _without_defaults(Study.model_json_schema())


def _without_defaults(schema):
    """Pydantic spells out from 2.11 on that any key is allowed, which is so if nothing is said."""
    if isinstance(schema, list):
        return [_without_defaults(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: _without_defaults(part)
        for key, part in schema.items()
        if (key, part) != ("additionalProperties", True)
    }


# ---- bodies and starts -------------------------------------------------------------------------

FRAME = [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]


def started(name, initial, **changes):
    """The problem, twists and poses of three bodies on a joint of turned frames."""
    pitch = {"pitch": 0.2} if "pitch" in lierb.joints.JOINTS[name].options else {}
    frames = {"body_frame": FRAME, "ground_frame": np.eye(4).tolist()}
    tables = {
        "body": {"mass": 1.0, "inertia": [1.0, 1.1, 1.2]},
        "joint": {"type": name, **frames, **pitch},
        "initial": initial,
        "sample": {"n": 3},
        "integrate": {"dt": 0.1, "t_end": 1.0},
    }
    made = Study.of(tables | changes).batch(0, 3)
    return made.problem, made.twist0, made.pose0


@pytest.mark.parametrize("name", [n for n, e in lierb.joints.JOINTS.items() if e.subgroup])
def test_velocities_of_a_study_are_the_rates_of_its_coordinates(name):
    problem, *_ = started(name, {})
    k = len(problem.joint.coordinate_names)
    coordinates, rates = np.linspace(0.5, 1.5, k), np.linspace(-1.0, 2.0, k)
    start = {"coordinates": coordinates.tolist(), "velocities": rates.tolist()}
    problem, twists, pose = started(name, start)

    def moved(t):
        w, v = twists[0, :3], twists[0, 3:]
        screw = np.zeros((4, 4))
        screw[:3, :3], screw[:3, 3] = np.cross(w, np.eye(3)).T, v
        return problem.joint.coordinates(pose @ expm(t * screw))

    np.testing.assert_allclose(moved(0.0), coordinates, rtol=0, atol=1e-14)
    # central differences: a square of 1e-4 times third derivatives of up to ten, 1e-15 over 1e-4
    differences = (moved(1e-4) - moved(-1e-4)) / 2e-4
    np.testing.assert_allclose(differences, rates, rtol=0, atol=1e-6)


def test_velocities_go_with_a_rotation_and_place():
    turn = Rotation.from_rotvec((0.4, -1.0, 2.0))
    start = {
        "rotation": turn,
        "place": [1.0, 2.0, 3.0],
        "velocities": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    }
    problem, twists, pose = started("free", start)
    found = problem.joint.velocities(twists, pose)
    np.testing.assert_allclose(found, [start["velocities"]] * 3, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        problem.joint.coordinates(pose), (*turn.as_rotvec(), 1.0, 2.0, 3.0), rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("key", ["coordinates", "velocities"])
def test_wrong_number_of_coordinates_in_a_study_is_told(key):
    with pytest.raises(StudyError, match=rf"initial: {key} has shape \(2,\); expected \(3,\).*xi1"):
        started("spherical", {key: [1.0, 2.0]})


HINGE = {
    "body": {"mass": 1.0, "inertia": [1.0, 1.1, 1.2]},
    "joint": {"type": "revolute", "axis": [0.0, 1.0, 0.0]},
    "integrate": {"dt": 0.1, "t_end": 1.0},
}
NUMBER = {"distribution": "uniform", "low": -1.0, "high": 1.0}


@pytest.mark.parametrize("n", [1, 3, 8])
def test_a_single_coordinate_of_a_study_is_a_number(n):
    drawn = {"coordinates": NUMBER, "velocities": NUMBER}
    given = Study.of(HINGE | {"sample": {"n": n, "initial": drawn}})
    made = given.batch(0, n)
    joint, draws = made.problem.joint, made.draws
    found = joint.coordinates(made.pose0)[:, 0]
    np.testing.assert_allclose(found, draws["initial.coordinates"], rtol=0, atol=1e-15)
    rates = joint.velocities(made.twist0, made.pose0)[:, 0]
    np.testing.assert_allclose(rates, draws["initial.velocities"], rtol=0, atol=1e-15)
    fixed = Study.of(HINGE | {"initial": {"coordinates": 0.3, "velocities": -2.0}})
    assert joint.coordinates(fixed.batch(0, 1).pose0) == pytest.approx(0.3, abs=1e-15)
    assert fixed == Study.of(tomllib.loads(fixed.to_toml()))


@pytest.mark.parametrize("key", ["coordinates", "velocities"])
@pytest.mark.parametrize("link", [False, True])
def test_numbers_of_three_bodies_are_no_coordinates_of_one(key, link):
    """A number for each of three bodies, on a joint of three coordinates."""
    body, joint = {"mass": 1.0, "inertia": [1.0, 1.1, 1.2]}, {"type": "spherical"}
    given = {"integrate": {"dt": 0.1, "t_end": 1.0}, "sample": {"n": 3, "initial": {key: NUMBER}}}
    if link:
        given["problem"] = {"links": [{"name": "a", "body": body, "joint": joint}]}
        given["sample"] = {"n": 3, "a": {"initial": {key: NUMBER}}}
    else:
        given |= {"body": body, "joint": joint}
    with pytest.raises(StudyError, match=r"has shape \(3, 1\); expected \(3,\) or \(n, 3\)"):
        Study.of(given)


def test_three_bodies_of_a_study_may_draw_rotation_vectors():
    """(3, 3), like a matrix."""
    drawn = {"coordinates": {"distribution": "uniform", "low": [0.0] * 3, "high": [1.0] * 3}}
    problem, _, pose = started("spherical", {}, sample={"n": 3, "initial": drawn})
    assert pose.shape == (3, 4, 4)
    found = problem.joint.coordinates(pose)
    assert ((found > 0.0) & (found < 1.0)).all()


@pytest.mark.parametrize(("force", "told"), [
    ({"type": "drag", "linear": [1.0, 2.0, 3.0]}, r"drag\.linear has shape \(3,\).* one number"),
    ({"type": "drag", "linear": 1.0, "point": [[0.0] * 3] * 3}, r"drag\.point has shape \(3, 3\)"),
])  # fmt: skip
def test_numbers_of_each_bodys_own_are_drawn(force, told):
    """Three of them for three bodies, too: a study of other parts would have others."""
    with pytest.raises(StudyError, match=rf"problem\.forces\.{told}.*\[sample\]"):
        started("free", {}, problem={"forces": [force]})


@pytest.mark.parametrize("key", ["inertia", "second_moments"])
def test_three_bodies_of_a_study_may_have_one_inertia_matrix(key):
    given = np.diag((1.0, 1.1, 1.2)).tolist() if key == "inertia" else [0.5, 0.6, 0.7]
    masses = {"distribution": "uniform", "low": 1.0, "high": 2.0}
    problem, *_ = started(
        "free", {}, body={"mass": 1.0, key: given}, sample={"n": 3, "body": {"mass": masses}}
    )
    assert problem.body.mass.shape == (3,)
    assert problem.body.inertia.shape == (1, 3, 3)
    assert problem.batch_size() == 3


@pytest.mark.parametrize("key", ["inertia", "second_moments"])
def test_a_study_may_give_inertia_about_the_centre_of_mass(key):
    given = [1.0, 1.1, 1.2] if key == "inertia" else [0.65, 0.55, 0.45]
    centres = {"distribution": "uniform", "low": [0.0, 0.0, 0.1], "high": [0.0, 0.0, 0.9]}
    problem, *_ = started(
        "free", {}, body={"mass": 2.0, key: given, "about": "com"},
        sample={"n": 4, "body": {"com": centres}},
    )  # fmt: skip
    z = problem.body.com[:, 2]
    right = np.array([1.0, 1.1, 1.2]) + 2.0 * z[:, None] ** 2 * (1.0, 1.0, 0.0)
    moments = np.diagonal(problem.body.inertia, axis1=1, axis2=2)
    np.testing.assert_allclose(moments, right, rtol=1e-15)
    with pytest.raises(StudyError, match=r"body\.about: unknown key"):
        started("free", {}, body={"solid": "sphere", "radius": 1.0, "mass": 1.0, "about": "com"})


@pytest.mark.parametrize(
    ("rotation", "told"),
    [
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 1.0]], "the rotation of rotation has"),
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], r"rotation has shape \(2, 3\)"),
    ],
)
def test_rotation_of_a_study_must_be_one(rotation, told):
    with pytest.raises(StudyError, match=f"initial: {told}"):
        started("free", {"rotation": rotation})


def test_rotations_may_be_scipys():
    turn = Rotation.from_rotvec((0.4, -1.0, 2.0))
    problem, *_ = started("free", {}, joint={"type": "free", "ground_frame": turn})
    np.testing.assert_array_equal(problem.joint.ground_frame[:3, :3], turn.as_matrix())
    values = lierb.sampling.Values(Rotation.from_rotvec([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]))
    assert values.shape == (3, 3)


# ---- runs --------------------------------------------------------------------------------------


def test_rows_are_those_of_integrate(whole):
    given = study()
    rows = Dataset(whole)
    rows.read()
    assert len(rows.parts) == PARTS == Parts(given).total
    stored = sorted_rows(whole)
    batch = given.batch(0, 50)
    for n, (cspace, dt) in enumerate((c, d) for c in ("SE3", "SO3xR3") for d in (1e-3, 2e-3)):
        result = lierb.integrate(
            batch.problem, twist0=batch.twist0, cspace=cspace, dt=dt, t_end=0.05
        ).summary
        part = stored[50 * n : 50 * n + 50]
        own = [{name: row[name] for name in result.column_names} for row in part]
        assert own == result.to_pylist()
        drawn = np.array([row["sample.initial.omega"] for row in part])
        np.testing.assert_array_equal(drawn, batch.draws["initial.omega"])


@pytest.mark.parametrize("part", slow_but([1, 13, 1000], 13, 1000))
def test_bits_do_not_depend_on_parts(whole, part, tmp_path):
    given = study(output={"part": part})
    lierb.run(given, tmp_path / "out")
    assert bits(tmp_path / "out") == bits(whole)


@pytest.mark.parametrize("n", [1, 3, 6])
def test_few_bodies_are_not_taken_for_a_matrix(n):
    moments = {"distribution": "uniform", "low": [0.02] * 3, "high": [0.03] * 3}
    few = study(sample={"n": n, "body": {"inertia": moments}})
    many = study(sample={"n": 50, "body": {"inertia": moments}})
    own, whole_batch = few.batch(0, n).problem.body, many.batch(0, 50).problem.body
    np.testing.assert_array_equal(own.inertia, whole_batch.inertia[:n])
    assert few.batch(0, n).problem.batch_size() == n


def test_resuming_elsewhere_warns(tmp_path, monkeypatch):
    lierb.run(study(sample={"n": 8}), tmp_path)
    monkeypatch.setattr(opening, "machine", lambda: {"cpu": "another"})
    with pytest.warns(StudyWarning, match="on another machine"):
        lierb.run(study(sample={"n": 8}), tmp_path, resume=True)


def test_kernels_of_a_study_are_compiled_ahead():
    took = replaying.compile_for(study())
    assert [setting.label for setting, _ in took] == [s.label for s in study().settings]


def test_quantities_have_no_order():
    tables = tomllib.loads(TEXT)
    tables["sample"]["method"] = "sobol"
    turned = copy.deepcopy(tables)
    turned["sample"] = dict(reversed(turned["sample"].items()))
    one, other = Study.of(tables), Study.of(turned)
    assert one.digest() == other.digest()
    for name, values in one.design.draw(0, 8).items():
        np.testing.assert_array_equal(other.design.draw(0, 8)[name], values)


def test_a_study_without_samples_is_one_body(tmp_path):
    tables = tomllib.loads(TEXT)
    del tables["sample"]
    tables["initial"] = {"omega": [1.0, 2.0, 3.0]}
    done = lierb.run(Study.of(tables), tmp_path)
    assert done.table().to_table().num_rows == 4


def test_a_run_that_did_nothing_does_not_block_its_folder(whole, tmp_path):
    given = study(sample={"seed": 9})
    Store(tmp_path).begin(given, "", 1)
    lierb.run(study(), tmp_path)
    assert bits(tmp_path) == bits(whole)


@pytest.mark.parametrize("content", [b"[]", b"{}", b"\xff", b"{"])
def test_a_manifest_that_is_none_is_named(content, tmp_path):
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(StudyError, match="manifest"):
        lierb.run(study(), tmp_path)


def test_results_of_version_0_1_are_refused_by_name(tmp_path):
    (tmp_path / "manifest.json").write_text('{"format": 1, "parts": {}}')
    with pytest.raises(StudyError, match=r"lierb 0\.1.*other names"):
        lierb.run(study(), tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1"])
def test_encodings(encoding, tmp_path):
    path = tmp_path / "s.toml"
    path.write_bytes(("# °\n" + TEXT).encode(encoding))
    if encoding == "latin-1":
        with pytest.raises(StudyError, match=r"s\.toml:1: .*UTF-8"):
            Study.load(path)
    else:
        assert Study.load(path).sample.n == 50


def test_stream_has_the_same_rows(whole):
    reader = lierb.integrate_batches(study())
    table = reader.read_all()
    assert table.num_rows == 200
    rows = Dataset(whole)
    rows.read()
    assert table.equals(rows.table().to_table().cast(table.schema), check_metadata=False)


def test_start_time_is_that_of_the_study():
    """Nothing in it knows the time: a study from 2 s on is one from 0 s on, at other times."""
    settings = {"cspace": ["SE3"], "dt": [1e-3]}
    runs = [
        study(integrate={**settings, "t0": t0, "t_end": t0 + 0.05, "measure_every": 10})
        for t0 in (0.0, 2.0)
    ]
    tables = [lierb.integrate_batches(each).read_all() for each in runs]
    assert set(tables[1]["t"].to_pylist()) == {2.05}
    for name in ("omega", "work_final"):
        columns = [np.array(table[name].to_pylist()) for table in tables]
        # rounding is tidied at steps that are counted from 0 s: 1e-15 of 10 rad/s
        np.testing.assert_allclose(*columns, rtol=0, atol=1e-13)
    assert next(iter(Parts(runs[1]))).work(runs[1]) == 8 * 50


def test_history_has_its_own_parts(tmp_path):
    given = study(integrate={"save_every": 10, "record": ["state"], "dt": 1e-3})
    done = lierb.run(given, tmp_path)
    errors = done.table("history").to_table()
    assert errors.num_rows == 2 * 50 * 6
    assert {"cspace", "method", "dt", "trajectory", "step", "rotation"} <= set(errors.column_names)


@pytest.mark.slow
def test_one_body_is_replayed_bit_for_bit(whole):
    rows = Dataset(whole)
    rows.read()
    stored = rows.table().to_table().to_pylist()
    for setting, tables in replay(study(integrate={"cspace": "SE3"}), 17):
        (row,) = tables["summary"].to_pylist()
        (same,) = [
            r for r in stored
            if (r["trajectory"], r["cspace"], r["dt"]) == (17, setting.cspace, setting.dt)
        ]  # fmt: skip
        assert row == same
        assert "lambda" in tables["history"].column_names


def test_column_names_differ_where_case_is_ignored(whole):
    assert_names_differ_in_sql(ds.dataset(whole / "summary").schema)
    found = pytest.importorskip("duckdb").sql(
        f"""select position, "sample.body.mass" from '{whole}/summary/*.parquet' where
        cspace = 'SE3' and dt = 1e-3 and trajectory = 17"""
    )
    (row,) = [
        row for row in sorted_rows(whole)
        if (row["trajectory"], row["cspace"], row["dt"]) == (17, "SE3", 1e-3)
    ]  # fmt: skip
    assert found.fetchall() == [(row["position"], row["sample.body.mass"])]


def units_of(schema) -> dict[str, str | None]:
    told = {field.name: (field.metadata or {}).get(b"unit") for field in schema}
    return {name: unit.decode() if unit else None for name, unit in told.items()}


def test_sampled_columns_bear_their_units(whole):
    units = units_of(ds.dataset(whole / "summary").schema)
    assert {name: unit for name, unit in units.items() if name.startswith("sample.")} == {
        "sample.body.mass": "kg", "sample.forces.drag.linear": "N s/m",
        "sample.initial.omega": "rad/s",
    }  # fmt: skip


SCREWED = """
[body]
mass = 1.0
inertia = [0.02, 0.03, 0.04]
[joint]
type = "cylindrical"
[[problem.forces]]
type = "torsional_spring"
name = "a.b"
[[problem.forces]]
type = "spring_damper"
[sample.initial]
coordinates = [0.1, 0.2]
velocities = [1.0, 2.0]
[sample.forces]
"a.b".damping = 0.1
spring_damper.damping = 0.2
[sample.joint]
axis = [0.0, 0.0, 1.0]
[sample]
n = 3
[integrate]
dt = 0.1
t_end = 0.1
"""


def test_units_are_those_of_the_joint_and_of_the_force():
    """Each coordinate has its own unit; a damping has that of its force, whatever its name."""
    given = Study.of(tomllib.loads(SCREWED))
    rows = pa.table({"trajectory": [0, 1, 2]})
    assert units_of(_with_draws(rows, given, given.batch(0, 3)).schema) == {
        "trajectory": None, "sample.forces.a.b.damping": "N m s/rad",
        "sample.forces.spring_damper.damping": "N s/m", "sample.initial.coordinates": "rad, m",
        "sample.initial.velocities": "rad/s, m/s", "sample.joint.axis": "1",
    }  # fmt: skip


def test_whatever_can_be_sampled_has_a_unit():
    for keys in KEYS.values():
        assert set(keys) <= {*UNITS, "coordinates", "velocities", "body_frame", "ground_frame"}
    for name, units in lierb.forces.FORCE_UNITS.items():
        force = getattr(lierb.forces, name)
        parameters = inspect.signature(force).parameters.values()
        names = {p.name for p in parameters if p.kind is not p.VAR_KEYWORD}
        names -= {"frame", "coordinate", "coordinates", "turns", "state"}
        assert set(units) == names
        listed = entries(sections(force.__doc__)["Parameters"])
        for parameter in names:  # as the function's own text has it: "Stiffness, N/m."
            assert re.search(rf", {re.escape(units[parameter])}[,.]", listed[parameter][1])


@pytest.mark.parametrize("library", ["pandas", "polars", "duckdb"])
def test_other_libraries_read_the_parts(library, whole):
    module = pytest.importorskip(library)
    pattern = str(whole / "summary" / "*.parquet")
    if library == "pandas":
        count = len(module.read_parquet(whole / "summary"))
    elif library == "polars":
        count = module.read_parquet(pattern).height
    else:
        count = module.sql(f"select count(*) from '{pattern}'").fetchall()[0][0]
    assert count == 200
    assert ds.dataset(whole / "summary").count_rows() == 200


# ---- settings from the command line ------------------------------------------------------------

CHANGED = ["--set", "integrate.dt=1e-3", "--set", "integrate.cspace=SO3xR3", "--n", 20, "--seed", 4]
CHANGES = {"integrate.dt": 1e-3, "integrate.cspace": "SO3xR3", "sample.n": 20, "sample.seed": 4}


def command(*arguments):
    """`lierb …`; what it prints and its exit status."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def succeed(*arguments):
    result = command(*arguments)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def run_changed(tmp_path_factory):
    """TEXT's file, and the folder of its run with CHANGED."""
    folder = tmp_path_factory.mktemp("changed")
    (folder / "top.toml").write_text(TEXT)
    succeed("run", folder / "top.toml", "--out", folder / "out", *CHANGED)
    return folder / "top.toml", folder / "out"


def test_set_runs_the_study_that_says_so(run_changed, tmp_path):
    _, out = run_changed
    same = study(integrate={"dt": 1e-3, "cspace": "SO3xR3"}, sample={"n": 20, "seed": 4})
    lierb.run(same, tmp_path)
    assert bits(out) == bits(tmp_path)
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["set"] == CHANGES
    assert manifest["digest"] == same.digest()
    assert manifest["study"]["name"] == "top"


def test_a_folder_has_the_study_as_it_was_run(run_changed, tmp_path):
    file, out = run_changed
    succeed("run", out / "study.toml", "--out", tmp_path / "again")
    assert bits(tmp_path / "again") == bits(out)
    assert "top.toml with integrate.dt=0.001" in (out / "study.toml").read_text()
    lierb.run(file, tmp_path / "python", changes=CHANGES)
    assert hashes(tmp_path / "python") == hashes(out)


@pytest.mark.parametrize("before", [8, 20, 24, 3])
def test_resume_with_more_bodies_adds_them(before, whole, tmp_path):
    """Files, the manifest too, are those of one run; whole parts are not run again."""
    out = tmp_path / "out"
    lierb.run(study(sample={"n": before}), out)
    parts = sorted((out / "summary").iterdir())
    ages = {part: part.stat().st_mtime_ns for part in parts}
    lierb.run(study(), out, resume=True)
    assert hashes(out) == hashes(whole)
    kept = [part for part in parts if part.stat().st_mtime_ns == ages[part]]
    assert len(kept) == 4 * (before // 8)


@pytest.mark.parametrize(("method", "before", "after"), [("sobol", 20, 50), ("saltelli", 20, 40)])
def test_more_points_of_a_sobol_sequence_leave_the_first_ones(method, before, after, tmp_path):
    for n in (before, after):
        lierb.run(study(sample={"n": n, "method": method}), tmp_path / "out", resume=True)
    lierb.run(study(sample={"n": after, "method": method}), tmp_path / "whole")
    assert hashes(tmp_path / "out") == hashes(tmp_path / "whole")


def test_resume_with_more_bodies_and_another_change_is_refused(tmp_path):
    lierb.run(study(sample={"n": 8}), tmp_path)
    before = hashes(tmp_path)
    for sample in ({"n": 20, "seed": 4}, {"n": 4}):
        with pytest.raises(StudyError, match=r"results of another study: sample\.n = 8 there"):
            lierb.run(study(sample=sample), tmp_path, resume=True)
    with pytest.raises(StudyError, match=r"--resume \(resume=True\) adds bodies to them"):
        lierb.run(study(sample={"n": 20}), tmp_path)
    assert hashes(tmp_path) == before


def test_more_bodies_leave_a_study_of_the_users_alone(tmp_path):
    """A study.toml that was edited is not written over."""
    lierb.run(study(sample={"n": 8}), tmp_path)
    text = study(sample={"n": 8}).to_toml() + "# mine\n"
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(StudyError, match=r"study\.toml says another study"):
        lierb.run(study(), tmp_path, resume=True)
    assert (tmp_path / "study.toml").read_text() == text


def test_resume_needs_the_same_settings(run_changed):
    file, out = run_changed
    before = hashes(out)
    succeed("run", file, "--out", out, "--resume", *reversed_pairs(CHANGED))
    refused = command("run", file, "--out", out, "--resume", *CHANGED[2:])
    assert refused.exit_code == 1
    assert "results of another study: integrate.dt = [0.001] there, [0.001, 0.002] here; it was r" \
        "un with integrate.dt=0.001, integrate.cspace=" in refused.output  # fmt: skip
    assert hashes(out) == before


def reversed_pairs(options):
    """Options and their values, the last first: their order does not matter."""
    return [each for pair in reversed([*zip(options[::2], options[1::2])]) for each in pair]


@pytest.mark.slow
def test_only_replays_the_study_that_was_set(run_changed):
    file, out = run_changed
    printed = succeed("run", file, "--out", out, *CHANGED, "--only", 17)
    (row,) = [row for row in sorted_rows(out) if row["trajectory"] == 17]
    assert f"energy_drift_max            {row['energy_drift_max']!r}" in printed
    replayed = pq.read_schema(out / "trajectory-17-00.parquet")
    assert {"rotation", "position", "energy", "lambda", "reaction"} <= set(replayed.names)
    assert_names_differ_in_sql(replayed)


def assert_names_differ_in_sql(schema):
    """SQL is blind to case: of two columns `R` and `r` it gives the first for either."""
    lowered = [name.lower() for name in schema.names]
    assert len(set(lowered)) == len(lowered)


def test_commands_to_go_on_are_whole(run_changed, tmp_path, monkeypatch):
    """The printed command, run by a shell, computes the rest."""
    file, whole_out = run_changed
    out = tmp_path / "my results"

    def stopped(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(running, "run", stopped)
        result = command("run", file, "--out", out, *CHANGED)
    assert result.exit_code == 130
    succeed(*shlex.split(result.output.partition("go on with:  lierb ")[2]))
    assert bits(out) == bits(whole_out)
    manifest = json.loads((out / "manifest.json").read_text())
    lost = manifest["parts"].popitem()[0]
    (out / "manifest.json").write_bytes(sealed(manifest))
    shown = succeed("show", out)
    assert "2 of 3 parts; the rest with: lierb run" in shown
    succeed(*shlex.split(shown.partition("the rest with: lierb ")[2]))
    assert lost in json.loads((out / "manifest.json").read_text())["parts"]
    assert bits(out) == bits(whole_out)


def test_predict_and_warmup_take_settings(run_changed):
    file, _ = run_changed
    assert "SE3" in succeed("predict", file)
    universal = succeed("predict", file, "--set", "joint.type=universal")
    assert universal != succeed("predict", file)
    assert succeed("warmup", file, *CHANGED[:4]).splitlines()[0].startswith("SO3xR3, RK4, dt = 0.0")
    assert command("warmup", "spherical", "--set", "sample.n=3").exit_code == 2
    assert "--set changes" in command("warmup", file, "--method", "Euler").stderr
    assert "--set changes" in command("warmup", file, "--multipliers").stderr
    assert "one study or joints" in command("warmup", file, "spherical").stderr


def test_only_of_a_number_that_is_none_is_named(run_changed):
    result = command("run", run_changed[0], *CHANGED, "--only", 20)
    assert result.exit_code == 1
    assert "there is no trajectory 20 in the study; it has 0 … 19" in result.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--n", "3", "--set", "sample.n=4"], "sample.n is set twice"),
        (["--set", "sample.n=4", "--set", "sample.n=5"], "sample.n is set twice"),
        (["--set", "sample.n"], "is no KEY=VALUE"),
        (["--n", "many"], "not a valid integer"),
    ],
)
def test_settings_that_are_none_are_named(options, message, run_changed):
    result = command("run", run_changed[0], *options)
    assert result.exit_code == 2
    assert message in result.output


# ---- nothing is lost ---------------------------------------------------------------------------


def test_results_are_not_run_over(whole, tmp_path):
    with pytest.raises(StudyError, match="has results of this study already; --resume"):
        lierb.run(study(), whole)
    with pytest.raises(StudyError, match=r"of another study: sample\.seed = 3 there, 4 here"):
        lierb.run(study(sample={"seed": 4}), whole, resume=True)
    before = hashes(whole)
    lierb.run(study(), whole, resume=True)
    assert hashes(whole) == before


def test_results_are_run_over_on_request(tmp_path):
    """The folder is that of the new study alone; files of the user's stay."""
    lierb.run(study(sample={"n": 30}), tmp_path / "first")
    (tmp_path / "first" / "notes.txt").write_text("mine")
    dataset = lierb.run(study(sample={"seed": 4}), tmp_path / "first", overwrite=True)
    lierb.run(study(sample={"seed": 4}), tmp_path / "second")
    assert (tmp_path / "first" / "notes.txt").read_text() == "mine"
    (tmp_path / "first" / "notes.txt").unlink()
    assert hashes(tmp_path / "first") == hashes(tmp_path / "second")
    assert dataset.table("summary").count_rows() == 4 * study().sample.n
    with pytest.raises(
        lierb.errors.ArgumentError, match="resume=True keeps what overwrite=True deletes"
    ):
        lierb.run(study(), tmp_path / "first", resume=True, overwrite=True)
    (tmp_path / "s.toml").write_text(study().to_toml())
    assert (
        command("run", tmp_path / "s.toml", "--out", tmp_path / "first", "--overwrite").exit_code
        == 0
    )


def test_damaged_and_lost_parts_are_done_again(whole, tmp_path):
    lierb.run(study(), tmp_path)
    parts = sorted((tmp_path / "summary").iterdir())
    content = bytearray(parts[3].read_bytes())
    content[100] ^= 1
    parts[3].write_bytes(content)
    parts[5].unlink()
    left = f".{parts[3].name}.0123abcd.unfinished"
    (tmp_path / "summary" / left).write_text("left by a crash")
    lierb.run(study(), tmp_path, resume=True)
    assert hashes(tmp_path) == hashes(whole)


def test_two_runs_into_one_folder_are_refused(tmp_path):
    with (
        Store(tmp_path).locked(),
        pytest.raises(StudyError, match="is being written by another run"),
    ):
        lierb.run(study(), tmp_path)


def test_a_large_manifest_is_not_written_for_every_part(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(store_module, "MANIFEST_SHARE", 1e-9)
    monkeypatch.setattr(store_module, "QUICK_SECONDS", 0.0)
    written = []
    write = Store.write
    monkeypatch.setattr(
        Store, "write", lambda self, name, *rest: (written.append(name), write(self, name, *rest))
    )
    lierb.run(study(), tmp_path)
    assert written.count("manifest.json") == 2  # at the beginning and at the end
    assert hashes(tmp_path) == hashes(whole)


def test_full_disk_leaves_what_is_there(whole, tmp_path, monkeypatch):
    sync, left = os.fsync, [9]

    def fills_up(handle):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    monkeypatch.setattr(store_module.os, "fsync", fills_up)
    with pytest.raises(OSError, match=r"/part-.* written: No space left.*--resume") as caught:
        lierb.run(study(), tmp_path)
    assert isinstance(caught.value, StudyError)
    monkeypatch.undo()
    assert not list(tmp_path.rglob("*.unfinished"))
    lierb.run(study(), tmp_path, resume=True)
    assert hashes(tmp_path) == hashes(whole)


@pytest.mark.slow
def test_killed_at_any_moment_it_resumes_bit_for_bit(whole, tmp_path):
    rng = random.Random(5)
    (tmp_path / "study.toml").write_text(TEXT)
    whole_again = tmp_path / "whole"
    lierb.run(tmp_path / "study.toml", whole_again)
    out = tmp_path / "out"
    manifest = out / "manifest.json"
    for kill in range(3):
        if manifest.exists() and len(json.loads(manifest.read_text())["parts"]) == PARTS:
            shutil.rmtree(out)
        before = len(list(out.rglob("*")))
        process = start(tmp_path, "--resume")
        while len(list(out.rglob("*"))) == before and process.poll() is None:
            time.sleep(0.01)  # it imports yet
        time.sleep(rng.uniform(0.0, 0.02 if kill % 2 else 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
    process = start(tmp_path, "--resume")
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert hashes(tmp_path / "out") == hashes(whole_again)
    assert bits(tmp_path / "out") == bits(whole)


@pytest.mark.slow
def test_ctrl_c_finishes_the_part_and_says_how_to_go_on(tmp_path, interruptible):
    process = start_long(tmp_path)
    process.send_signal(signal.SIGINT)
    assert "go on with:  lierb run" in errors_when_stopped(process, tmp_path / "out")


def test_summary_of_a_study(whole):
    from lierb.studies.findings.findings import findings, orders

    rows = Dataset(whole)
    rows.read()
    found = findings(rows)
    assert [f.bodies for f in found] == [50] * 4
    stored = column(rows.table().to_table(), "position_error_max")
    assert max(f.quantiles["position"][-1] for f in found) == stored.max()
    drift = next(f for f in found if f.setting.cspace == "SO3xR3")
    order = orders(found, drift)["position"]
    assert order is None or order.slope == pytest.approx(4.0, abs=0.3)


def cells_of(shown: str) -> dict[tuple[str, ...], list[str]]:
    """The numbers in a printed table's rows of an error, by c-space."""
    found, cspace = {}, ""
    for line in shown.splitlines():
        cspace = line.partition(",")[0] if ", RK4," in line else cspace
        for label in ("position, m", "rotation", "energy, J"):
            if line.startswith(f"  {label}  "):
                found[cspace, label] = line.rpartition(label)[2].split()
    return found


@pytest.mark.long
def test_errors_that_a_joint_has_no_rows_for_are_dashes(whole, tmp_path):
    """A spherical joint restricts no rotation; on SE(3) it keeps its point, and that is a 0."""
    shown = cells_of(succeed("show", whole))
    assert shown["SE3", "rotation"] == shown["SO3xR3", "rotation"] == ["–"] * 2
    assert shown["SE3", "position, m"] == ["0"] * 2  # median, largest
    assert "–" not in "".join(shown["SO3xR3", "position, m"] + shown["SE3", "energy, J"])
    free = study(joint={"type": "free"}, integrate={"cspace": "SE3", "dt": 1e-3}, sample={"n": 3})
    lierb.run(free, tmp_path / "free")
    shown = cells_of(succeed("show", tmp_path / "free"))
    assert shown["SE3", "rotation"] == shown["SE3", "position, m"] == ["–"] * 2


@pytest.mark.slow
def test_figures_of_a_study_are_complete(tmp_path, monkeypatch):
    study_plots = pytest.importorskip("lierb.studies.pages.figures")
    given = study(integrate={"save_every": 10}, sample={"n": 8})
    done = lierb.run(given, tmp_path / "out")
    drawn = dict(study_plots.figures(done))
    monkeypatch.setattr(study_plots, "figures", lambda dataset: drawn.items())
    written = study_plots.draw_all(done, tmp_path / "figures")
    assert [path.name for path in written] == [
        f"{name}.{kind}"
        for name in ("distribution", "time", "order", "parameters")
        for kind in ("png", "svg")
    ]
    for name in ("distribution", "time", "order", "parameters"):
        figure = drawn[name]
        for panel in figure.axes:
            if panel.get_visible():
                assert panel.lines or panel.patches  # a histogram's steps
                assert panel.get_xlabel()
                assert all(np.isfinite(line.get_ydata()).all() for line in panel.lines)
    sampled = [panel.get_xlabel() for panel in figure.axes if panel.get_visible()]
    assert sampled == [
        "mass [kg]", "drag: linear [N s/m]", "ω₁ [rad/s]", "ω₂ [rad/s]", "ω₃ [rad/s]",
    ]  # fmt: skip

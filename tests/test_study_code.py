"""Studies of the user's own physics: functions in a file beside them, problems made in Python."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from tempfile import gettempdir

import numpy as np
import pytest
import tomli_w
from command import invoke
from hypothesis import given
from hypothesis import strategies as st
from studies import hashes, sorted_rows

import lierb
from lierb.errors import ArgumentError, ForceError, StudyError, StudyWarning, UnknownNameError
from lierb.studies.dataset import Dataset
from lierb.studies.description.study import Study
from lierb.studies.description.toml import toml_of
from lierb.studies.execution import cluster
from lierb.studies.execution.replaying import replay
from lierb.studies.findings.findings import findings
from lierb.studies.storage.manifest import sealed

EXAMPLES = Path(__file__).parent.parent / "examples"
CODE = (EXAMPLES / "pointing.py").read_text(encoding="utf-8")
TEXT = """\
[body]
mass = 120.0
inertia = [19.0, 17.0, 14.0]

[joint]
type = "free"

[[problem.forces]]
type = "python:attitude.py:controller"
most = 0.1

[[problem.observables]]
type = "python:attitude.py:pointing_error"

[sample]
n = 40
seed = 2

[sample.forces.controller.damping]
distribution = "uniform"
low = 2.0
high = 6.0

[sample.initial.rotation]
distribution = "rotation"

[integrate]
dt = 0.2
t_end = 4.0
save_every = 10

[output]
part = 16
"""
MANY = TEXT.replace("n = 40", "n = 6000").replace("part = 16", "part = 200")


@pytest.fixture
def folder(tmp_path) -> Path:
    """Folder of the study and its file."""
    return written(tmp_path / "study")


def written(folder: Path, text: str = TEXT, code: str = CODE) -> Path:
    folder.mkdir()
    (folder / "study.toml").write_text(text, encoding="utf-8")
    (folder / "attitude.py").write_text(code, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The results of TEXT, run without a break in one process."""
    place = tmp_path_factory.mktemp("whole")
    lierb.run(written(place / "study") / "study.toml", place / "out")
    return place / "out"


# ---- a run like any other ----------------------------------------------------------------------


def test_run_copies_the_file_and_says_what_it_was(whole):
    assert (whole / "attitude.py").read_text(encoding="utf-8") == CODE
    manifest = json.loads((whole / "manifest.json").read_text())
    assert manifest["code"] == {"attitude.py": hashes(whole)["attitude.py"]}
    made = Study.load(whole / "study.toml").batch(0, 1).problem
    assert manifest["functions"] == {
        "forces.controller": made.forces[0].kind.function.fingerprint,
        "observables.pointing_error": made.observables[0].kind.function.fingerprint,
    }


def test_observables_of_a_study_are_columns(whole):
    table = Dataset(whole)
    table.read()
    history = table.table("history").to_table()
    assert history.schema.field("pointing_error").metadata[b"unit"] == b"rad"
    rows = sorted_rows(whole)
    errors = np.array(history["pointing_error"]).reshape(-1, 1).ravel()
    least, largest = (min(r["pointing_error_min"] for r in rows), errors.max())
    assert 0.0 <= least <= errors.min()
    assert largest <= max(r["pointing_error_max"] for r in rows) <= np.pi
    field = table.table().schema.field("sample.forces.controller.damping")
    assert b"unit" not in (field.metadata or {})  # which the user alone knows


def test_the_folder_of_results_is_a_study_of_its_own(whole, tmp_path):
    again = tmp_path / "moved"
    shutil.copytree(whole, again)
    lierb.run(again / "study.toml", tmp_path / "anew")
    assert hashes(tmp_path / "anew") == hashes(whole)
    dataset = Dataset(again)
    dataset.read()
    assert findings(dataset)[0].bodies == 40


@pytest.mark.slow
def test_replay_has_the_studys_row(whole):
    ((_, tables),) = replay(whole / "study.toml", 17)
    (row,) = tables["summary"].to_pylist()
    wanted = sorted_rows(whole)[17]
    assert {name: row[name] for name in wanted} == wanted
    assert tables["history"].num_rows == 21


@pytest.mark.slow
def test_only_tells_long_names_and_their_numbers_apart(whole, tmp_path):
    printed = invoke("run", whole / "study.toml", "--out", tmp_path, "--only", 17).output
    damping = sorted_rows(whole)[17]["sample.forces.controller.damping"]
    assert f"  sample.forces.controller.damping {damping!r}\n" in printed


def test_file_with_a_byte_order_mark_is_one_like_any_other(tmp_path):
    place = written(tmp_path / "marked", code=f"\ufeff{CODE}")
    made = Study.load(place / "study.toml")
    assert made.code_digests == {"attitude.py": hashes(place)["attitude.py"]}


def test_resume_does_what_is_missing(whole, folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    for file in (out / "summary").glob("*16.parquet"):
        file.unlink()
    (out / "attitude.py").unlink()
    with pytest.warns(StudyWarning, match=r"attitude\.py was missing; it is written again"):
        lierb.run(folder / "study.toml", out, resume=True)
    assert hashes(out) == hashes(whole)


@pytest.mark.parametrize(
    "gather", [False, pytest.param(True, marks=pytest.mark.long)], ids=["shared", "gather"]
)
@pytest.mark.long
def test_workers_have_the_file_and_give_the_same_bytes(gather, whole, folder, tmp_path):
    pytest.importorskip("distributed")
    with cluster.local_client(2) as client:
        lierb.run(folder / "study.toml", tmp_path / "out", client=client, gather=gather)
    assert hashes(tmp_path / "out") == hashes(whole)


def entered(out) -> int:
    """Number of parts in the manifest, which may lag behind the files."""
    manifest = out / "manifest.json"
    return len(json.loads(manifest.read_text()).get("parts", {})) if manifest.exists() else 0


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(tmp_path):
    folder, out = written(tmp_path / "study", MANY), tmp_path / "out"
    command = [sys.executable, "-m", "lierb", "run", str(folder / "study.toml"), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not entered(out):
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    assert process.wait(timeout=60) == -signal.SIGKILL
    left = Dataset(out)
    left.read()
    assert 0 < len(left.parts) < 30
    lierb.run(folder / "study.toml", out, resume=True)
    lierb.run(folder / "study.toml", tmp_path / "whole")
    assert hashes(out) == hashes(tmp_path / "whole")


def test_the_example_is_what_it_names(tmp_path):
    for name in ("pointing.toml", "pointing.py"):
        given = name.removesuffix(".toml")
        (tmp_path / name).write_bytes(invoke("example", given).stdout_bytes)
    assert (tmp_path / "pointing.py").read_text(encoding="utf-8") == CODE
    study = Study.load(tmp_path / "pointing.toml", {"sample.n": 3, "integrate.t_end": 4.0})
    assert study.files == ("pointing.py",)
    assert lierb.integrate_batches(study).read_all().num_rows == 3


# ---- edited since ------------------------------------------------------------------------------


def test_resume_notices_an_edited_file(whole, folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (folder / "attitude.py").write_text(CODE.replace("stiffness=0.3", "stiffness=0.4"))
    with pytest.raises(StudyError, match=r"another study: attitude\.py was edited since"):
        lierb.run(folder / "study.toml", out, resume=True)


def test_resume_notices_an_edited_copy(whole, folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    with (out / "attitude.py").open("a") as file:
        file.write("# a comment\n")
    with pytest.raises(StudyError, match=r"out/attitude\.py is not the file that the study is run"):
        lierb.run(folder / "study.toml", out, resume=True)
    with pytest.raises(StudyError, match=r"another study: attitude\.py was edited since"):
        lierb.run(out / "study.toml", out, resume=True)
    dataset = Dataset(out)
    dataset.read()
    with pytest.raises(StudyError, match=r"attitude\.py is not the file"):
        findings(dataset)
    (out / "attitude.py").unlink()
    with pytest.raises(StudyError, match=r"attitude\.py is missing; --resume"):
        findings(dataset)


def test_manifest_names_no_file_outside_its_folder(whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["code"]["../attitude.py"] = manifest["code"].pop("attitude.py")
    (out / "manifest.json").write_bytes(sealed(manifest))
    with pytest.raises(StudyError, match=r"manifest\.json is damaged \(code\.\.\./attitude"):
        Dataset(out).read()


def test_run_does_not_overwrite_a_file_of_the_users(folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "attitude.py").write_text("mine = 1\n")
    with pytest.raises(StudyError, match="choose another folder"):
        lierb.run(folder / "study.toml", out)
    assert (out / "attitude.py").read_text() == "mine = 1\n"


# ---- what is refused ---------------------------------------------------------------------------

FORCE = "python:attitude.py:controller"
TYPES = {
    "path": (
        "python:../attitude.py:controller",
        "input should be 'constant_wrench'.* or \"python:",
    ),
    "absolute": ("python:/tmp/attitude.py:controller", "input should be"),
    "no name": ("python:attitude.py", "input should be"),
    "dotted": ("python:attitude.py:np.zeros", "input should be"),
    "absent file": ("python:other.py:controller", r"other\.py is not in .*, beside the study"),
    "absent name": ("python:attitude.py:contrller", r"attitude\.py defines no contrller"),
    "observable": (
        "python:attitude.py:pointing_error",
        r"pointing_error in attitude\.py is <.*>; expected a function with @lierb\.wrench",
    ),
    "module": ("python:attitude.py:np", r"np in attitude\.py is <module"),
}


@pytest.mark.parametrize("name", TYPES)
def test_type_that_names_no_function_is_refused(name, folder):
    kind, told = TYPES[name]
    (folder / "study.toml").write_text(TEXT.replace(FORCE, kind))
    with pytest.raises(StudyError, match=told) as raised:
        Study.load(folder / "study.toml")
    assert str(raised.value).startswith("study.toml:")


@pytest.mark.parametrize("table", ["constraints", "observables"])
def test_type_of_lierbs_own_forces_is_none_of_others(table, folder):
    text = TEXT + f'\n[[problem.{table}]]\ntype = "drag"\n'
    (folder / "study.toml").write_text(text)
    with pytest.raises(StudyError, match=r'input should be "python:FILE\.py:NAME"'):
        Study.load(folder / "study.toml")


CODES = {
    "syntax": ("def f(:\n", r"attitude\.py:1: "),
    "raises": ("x = 1\nraise KeyError('no')\n", r"line 2, .raise KeyError.*: KeyError"),
    "exits": ("import sys\nsys.exit(3)\n", r"attitude\.py: line 2, .*: SystemExit"),
    "sibling": ("import beside\n", r"attitude\.py:1: it imports beside, which lies beside it"),
    "sibling's name": ("from beside import x\n", "it imports beside"),
    "relative": ("from . import beside\n", r"it imports \."),
    "its place": ("import pathlib\nhere = pathlib.Path(__file__)\n", "NameError"),
    "a run": (
        "import lierb\nlierb.run('study.toml', 'out')\n",
        r"attitude\.py runs a study when it is loaded .* if __name__ == \"__main__\":",
    ),
    "plain function": (
        "def controller(t, R, r, omega, v):\n    return r, r\n",
        r"with @lierb\.wrench, @lierb\.variable_mass or @lierb\.ground_motion before it",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CODES)
def test_file_that_cannot_be_loaded_is_refused(name, folder):
    code, told = CODES[name]
    (folder / "attitude.py").write_text(code)
    (folder / "beside.py").write_text("x = 1\n")
    with pytest.raises(StudyError, match=told):
        Study.load(folder / "study.toml")


def test_file_that_is_no_text_is_refused(folder):
    (folder / "attitude.py").write_bytes(b"# \xff\n")
    with pytest.raises(StudyError, match="save it as UTF-8"):
        Study.load(folder / "study.toml")


@pytest.mark.skipif(os.name != "posix", reason="links as POSIX has them")
def test_nothing_outside_the_folder_is_run(folder, tmp_path):
    (tmp_path / "outside.py").write_text("raise SystemExit('it ran')\n")
    (folder / "attitude.py").unlink()
    (folder / "attitude.py").symlink_to(tmp_path / "outside.py")
    with pytest.raises(StudyError, match="nothing outside the study's folder is run"):
        Study.load(folder / "study.toml")


def test_parameter_that_is_none_is_refused(folder):
    (folder / "study.toml").write_text(TEXT.replace("most = 0.1", "mast = 0.1"))
    with pytest.raises(StudyError, match=r"parameter='mast' is unknown.*Did you mean 'most'"):
        Study.load(folder / "study.toml")
    (folder / "study.toml").write_text(TEXT.replace("forces.controller.d", "forces.contrller.d"))
    with pytest.raises(
        StudyError, match=r"contrller: there is no such force; known: .'controller'"
    ):
        Study.load(folder / "study.toml")


def test_study_without_a_folder_says_so():
    with pytest.raises(StudyError, match=r"Study\.of\(…, folder=…\)"):
        Study.of(Study.load(EXAMPLES / "attitude.toml").model_dump())
    loaded = Study.load(EXAMPLES / "attitude.toml")
    assert Study.of(loaded.model_dump(), folder=EXAMPLES) == loaded


def test_settings_of_functions_can_be_changed(folder):
    changes = {"problem.forces.controller.most": 0.2, "problem.observables.0.name": "off_axis"}
    study = Study.load(folder / "study.toml", changes)
    problem = study.batch(0, 2).problem
    assert problem.forces[0].parameters["most"] == 0.2
    assert problem.observables[0].name == "off_axis"
    with pytest.raises(StudyError, match=r"each body draws its own; change sample\.forces\.contro"):
        Study.load(folder / "study.toml", {"problem.forces.controller.damping": 1.0})


def test_digest_is_of_the_file_too(folder):
    before = Study.load(folder / "study.toml").digest()
    (folder / "attitude.py").write_text(CODE + "\n")
    assert Study.load(folder / "study.toml").digest() != before


def test_constraints_of_a_study_are_held(folder):
    code = "@lierb.constraint\ndef level(R, r):\n    return r[2]\n"
    (folder / "attitude.py").write_text(CODE + code)
    text = TEXT + '\n[[problem.constraints]]\ntype = "python:attitude.py:level"\n'
    (folder / "study.toml").write_text(text)
    assert (
        Study.load(folder / "study.toml").batch(0, 2).problem.rows[0].element.function.name
        == "level"
    )


# ---- problems and designs made in Python -------------------------------------------------------

QUANTITIES = {
    "forces.controller.damping": lierb.sampling.Uniform(2.0, 6.0),
    "initial.rotation": lierb.sampling.Rotation(),
}
SETTINGS = {"dt": 0.2, "t_end": 4.0, "save_every": 10, "part": 16}
SATELLITE = lierb.Body(120.0, (19.0, 17.0, 14.0))


def imported(folder: Path):
    """attitude.py, imported as a user's script does."""
    found = importlib.util.spec_from_file_location("attitude", folder / "attitude.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def pointing(attitude, **more) -> lierb.Problem:
    return lierb.Problem(
        SATELLITE, lierb.joints.free(), forces=attitude.controller(most=0.1),
        observables=attitude.pointing_error(), **more,
    )  # fmt: skip


def test_problem_and_design_run_to_the_bytes_of_the_file(whole, folder, tmp_path):
    problem, design = pointing(imported(folder)), lierb.sampling.Design(QUANTITIES, n=40, seed=2)
    dataset = lierb.run(problem, design, tmp_path / "out", **SETTINGS)
    assert dataset.trajectories == 40
    found, wanted = hashes(tmp_path / "out"), hashes(whole)
    for name in found.keys() - {"manifest.json", "study.toml"}:
        assert found[name] == wanted[name]
    draws = design.draw()["forces.controller.damping"]
    rows = sorted_rows(tmp_path / "out")
    assert [row["sample.forces.controller.damping"] for row in rows] == draws.tolist()
    lierb.run(problem, design, tmp_path / "out", resume=True, **SETTINGS)
    assert hashes(tmp_path / "out") == found
    # Named by its folder, and of its function what differs from the defaults.
    text = (tmp_path / "out" / "study.toml").read_text()
    assert dataset.study.name == tomllib.loads(text)["name"] == "out"
    assert "study 'out'" in str(dataset)
    (force,) = tomllib.loads(text)["problem"]["forces"]
    assert force == {"type": "python:attitude.py:controller", "most": 0.1}


def test_study_of_a_problem_makes_the_same_problem():
    """Every number to the bit, whatever the joint and the forces."""
    held = lierb.joints.screw(axis=(1.0, 2.0, 3.0), body_point=(0.1, 0.2, 0.3), pitch=0.07)
    acting = [
        lierb.forces.drag(0.1, 0.2, point=(0.1, 0.0, 0.0)),
        lierb.forces.drag(angular=0.3),
        lierb.forces.constant_wrench(force=(1.0, 2.0, 3.0), frame="body"),
        lierb.forces.constant_wrench(torque=(1.0, 2.0, 3.0)),
        lierb.forces.motor(torque=0.1),
        lierb.forces.torsional_spring(stiffness=2.0),
    ]
    body = lierb.Body(2.0, np.diag((0.3, 0.2, 0.4)) + 0.01, (0.01, 0.02, 0.03))
    given = lierb.Problem(body, held, (0.1, 0.2, -9.8), acting)
    design = lierb.sampling.Design({"initial.velocities": [1.0]}, n=2)
    study = lierb.study_of(given, design, dt=1e-3, t_end=0.1, cspace=["SE3", "reduced"])
    made = study.batch(0, 2).problem
    assert made.kinds == given.kinds
    for name, array in given.quantities.items():
        np.testing.assert_array_equal(made.quantities[name], array)
    for one, other in zip(given.elements, made.elements, strict=True):
        for name, array in one.parameters.items():
            np.testing.assert_array_equal(other.parameters[name], array)
    assert [force.label for force in study.problem.forces[:2]] == ["drag", "drag_2"]
    assert Study.of(study.model_dump()) == study


def test_study_of_leaves_out_numbers_that_are_defaults():
    """What a reader sees of a file is what is special about it; and it is the same study."""
    acting = [
        lierb.forces.joint_friction(viscous=0.1),
        lierb.forces.torsional_spring(stiffness=1.0),
        lierb.forces.joint_limit(lower=-1.0, upper=1.0, stiffness=5.0),
        lierb.forces.motor(torque=0.0),
        lierb.forces.constant_wrench((0.0, 0.0, 1.0), frame="ground"),
    ]
    problem = lierb.Problem(
        lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.revolute(), forces=acting
    )
    values = lierb.sampling.Values
    quantities = {
        "forces.torsional_spring.damping": values([1.0, 2.0]),
        "body.com": values([[0.0, 0.0, 0.1]] * 2),
        "joint.ground_point": values([[0.1, 0.0, 0.0]] * 2),
    }
    design = lierb.sampling.Design(quantities, n=2)
    study = lierb.study_of(problem, design, dt=1e-3, t_end=0.1, cspace=["SE3"])
    tables = tomllib.loads(study.to_toml())
    assert tables["body"].keys() == {"mass", "inertia"}
    assert tables["joint"] == {"type": "revolute"}
    assert tables["problem"]["forces"] == [
        {"type": "joint_friction", "viscous": 0.1},
        {"type": "torsional_spring", "stiffness": 1.0},
        {"type": "joint_limit", "lower": -1.0, "upper": 1.0, "stiffness": 5.0},
        {"type": "motor", "torque": 0.0},
        {"type": "constant_wrench", "torque": [0.0, 0.0, 1.0]},
    ]
    assert tables["integrate"].keys() == {"dt", "t_end"}
    assert Study.of(tables).digest() == study.digest()
    made = study.batch(0, 2).problem
    np.testing.assert_array_equal(made.forces[1].parameters["damping"], [1.0, 2.0])
    np.testing.assert_array_equal(made.body.com[0], [0.0, 0.0, 0.1])
    np.testing.assert_array_equal(made.joint.ground_frame[:, :3, 3], [[0.1, 0.0, 0.0]] * 2)
    np.testing.assert_array_equal(made.joint.ground_frame[0, :3, :3], np.eye(3))
    turned = lierb.Problem(problem.body, lierb.joints.revolute(axis=(1.0, 0.0, 0.0)))
    joint = lierb.study_of(turned, design=lierb.sampling.Design({"body.mass": 1.0}, n=1),
                           dt=1e-3, t_end=0.1).joint  # fmt: skip
    assert joint.given() == {"type": "revolute", "axis": [1.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("given", "kind", "told"),
    [
        ({"design": None}, ArgumentError, "design=None; expected a lierb.sampling.Design"),
        ({"steps": 3}, UnknownNameError, "setting='steps' is unknown"),
        ({"initial": {"omga": 1}}, UnknownNameError, "initial='omga' is unknown"),
        ({"quantities": {"omega": 1.0}}, StudyError, "'omega' is no quantity of a problem"),
        (
            {"forces": lierb.forces.drag(linear=1.0), "quantities": {"drag.linear": 1.0}},
            StudyError, r"drag\.linear: a study names it forces\.drag\.linear",
        ),
        ({"quantities": {"joint.axis": (1.0, 0.0, 0.0)}}, StudyError, "a joint that is made has"),
        ({"quantities": {"forces.drag.linear": 1.0}}, StudyError, "there is no such force"),
        ({"body": lierb.Body([1.0, 2.0], (1.0, 1.0, 1.0))}, StudyError, "mass has numbers of"),
        (
            {"forces": lierb.forces.motor(lambda t: t), "joint": lierb.joints.revolute()},
            StudyError, "motor is made of a function of time",
        ),
    ],
)  # fmt: skip
def test_problem_that_no_file_can_say_is_refused(given, kind, told):
    body, joint = given.pop("body", SATELLITE), given.pop("joint", lierb.joints.free())
    problem = lierb.Problem(body, joint, forces=given.pop("forces", ()))
    design = lierb.sampling.Design(given.pop("quantities", {"body.mass": 1.0}), n=2)
    with pytest.raises(kind, match=told):
        lierb.study_of(problem, **{"design": design, "dt": 0.1, "t_end": 1.0} | given)


def test_study_of_refuses_what_is_no_problem():
    design = lierb.sampling.Design({"body.mass": 1.0}, n=2)
    with pytest.raises(ArgumentError, match=r"problem=None; expected a lierb\.Problem"):
        lierb.study_of(None, design, dt=0.1, t_end=1.0)


def test_sobol_design_is_taken_in_the_order_of_names():
    problem = lierb.Problem(SATELLITE, lierb.joints.free())
    names = {"initial.omega": lierb.sampling.Direction(), "body.mass": lierb.sampling.Uniform(1, 2)}
    design = lierb.sampling.Design(names, n=8, method="sobol")
    with pytest.raises(StudyError, match=r"give them so, body\.mass, initial\.omega"):
        lierb.study_of(problem, design, dt=0.1, t_end=1.0)


def test_function_that_cannot_be_loaded_again_is_refused(tmp_path):
    @lierb.observable
    def inner(t):
        return t

    design = lierb.sampling.Design({"body.mass": 1.0}, n=2)
    problem = lierb.Problem(SATELLITE, lierb.joints.free(), observables=inner())
    with pytest.raises(StudyError, match="inner is defined inside another function"):
        lierb.study_of(problem, design, dt=0.1, t_end=1.0)
    known: dict = {}
    exec("import lierb\n@lierb.observable\ndef typed(t):\n    return t\n", known)
    problem = lierb.Problem(SATELLITE, lierb.joints.free(), observables=known["typed"]())
    with pytest.raises(StudyError, match=r"typed is defined in '<string>', .*%%writefile"):
        lierb.study_of(problem, design, dt=0.1, t_end=1.0)


def test_function_that_differs_from_its_file_is_refused(folder):
    problem = pointing(imported(folder))
    (folder / "attitude.py").write_text(CODE.replace("params.stiffness * turn", "0.5 * turn"))
    design = lierb.sampling.Design(QUANTITIES, n=4)
    with pytest.raises(StudyError, match="controller is another function in its file"):
        lierb.study_of(problem, design, dt=0.2, t_end=4.0)


def test_run_says_how_it_is_called(folder, tmp_path):
    problem = lierb.Problem(SATELLITE, lierb.joints.free())
    with pytest.raises(ArgumentError, match=r"lierb\.run\(problem, design, out, dt=…, t_end=…\)"):
        lierb.run(problem, tmp_path / "out")
    with pytest.raises(ArgumentError, match=r"lierb\.run\(study, out\)"):
        lierb.run(folder / "study.toml", "x", tmp_path / "out")
    with pytest.raises(ArgumentError, match="out=None; expected the path of a folder"):
        lierb.run(folder / "study.toml")
    with pytest.raises(ArgumentError, match="dt is a setting of the study; give it in changes="):
        lierb.run(folder / "study.toml", tmp_path / "out", dt=1.0)
    assert not (tmp_path / "out").exists()


def test_functions_of_a_study_are_named_in_errors(folder):
    (folder / "attitude.py").write_text(CODE.replace("np.zeros(3)", "np.random.normal(3)"))
    with pytest.raises((StudyError, ForceError), match=r"line 13, .*it draws random numbers"):
        Study.load(folder / "study.toml")


def test_a_file_made_in_python_is_short(tmp_path):
    """Moments, points and axes in place of matrices; arrays on lines of at most 80 columns."""
    pin = lierb.joints.revolute((0.1, 0.0, 0.0), (0.2, 0.0, 0.3), axis=(0.0, 1.0, 0.0))
    body = lierb.Body(3.0, (40.0, 45.0, 60.0))
    machine = lierb.Mechanism(lierb.Link("a", body, pin))
    masses = lierb.sampling.Design({"a.body.mass": lierb.sampling.Uniform(2.9, 3.1)}, n=3)
    times = np.linspace(0.0, 100.0, 26)
    study = lierb.study_of(machine, masses, rtol=1e-6, save_at=times, t_end=100.0)
    text = study.to_toml()
    assert "inertia = [40.0, 45.0, 60.0]\n" in text
    assert "body_point = [0.1, 0.0, 0.0]\n" in text
    assert "axis = [0.0, 1.0, 0.0]\n" in text
    for word in ("body_frame", "ground_frame", "cspace", "method", 'name = "study"'):
        assert word not in text
    assert max(map(len, text.splitlines())) <= 80
    assert len(text.splitlines()) < 32
    assert Study.of(tomllib.loads(text)) == study
    made = study.batch(0, 3).problem
    for name, array in machine.quantities.items():
        if not name.endswith("mass"):
            np.testing.assert_array_equal(made.quantities[name], array, err_msg=name)
    other = lierb.study_of(machine, masses, dt=1e-3, cspace="SE3", method="Heun", t_end=1.0)
    assert 'cspace = ["SE3"]' in other.to_toml()
    assert 'method = ["Heun"]' in other.to_toml()
    assert Study.of(tomllib.loads(other.to_toml())) == other


@pytest.mark.slow
@given(
    st.recursive(
        st.floats(allow_nan=False, allow_infinity=False)
        | st.integers(-9, 9)
        | st.text(max_size=20),
        lambda inner: (
            st.lists(inner, max_size=30)
            | st.dictionaries(st.text(min_size=1, max_size=8), inner, max_size=4)
        ),
        max_leaves=40,
    )
)
def test_toml_of_any_tables_is_read_back(value):
    tables = {"a": {"b": value}, "c": [{"d": value}, {"e": [value]}]}
    text = toml_of(tables)
    assert tomllib.loads(text) == tomllib.loads(tomli_w.dumps(tables))


def test_a_study_from_standard_input_has_no_python_files():
    text = (EXAMPLES / "pointing.toml").read_text(encoding="utf-8")
    result = invoke("run", "-", input=text)
    assert result.exit_code == 1
    told = "pointing.py cannot be found: a study from standard input or a pipe has no folder"
    assert told in " ".join(result.stderr.split())
    assert gettempdir() not in result.stderr


# ---- problems made in Python -------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["body.com", "body.mass"])
def test_an_inertia_about_the_centre_of_mass_stays_so_where_com_or_mass_is_drawn(quantity):
    moments = (2.0, 2.5, 2.2)
    body = lierb.Body(50.0, moments, com=(0.0, 0.0, 0.1), about="com")
    drawn = {
        "body.com": lierb.sampling.Normal((0.0, 0.0, 0.1), 0.02),
        "body.mass": lierb.sampling.Uniform(40.0, 60.0),
    }[quantity]
    design = lierb.sampling.Design({quantity: drawn}, n=4, seed=1)
    problem = lierb.Problem(body, lierb.joints.free())
    made = lierb.study_of(problem, design, dt=0.01, t_end=0.1).batch(0, 4).problem.body
    expected = lierb.Body(made.mass, moments, com=made.com, about="com")
    assert np.array_equal(np.broadcast_to(made.inertia, expected.inertia.shape), expected.inertia)


def test_rows_of_the_users_with_the_name_of_a_joint_stay_theirs():
    own = lierb.joints.from_rows(["d1", "d2", "d3"], name="revolute", body_point=(0, 0, 0.15))
    problem = lierb.Problem(lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0), own)
    design = lierb.sampling.Design({"body.mass": lierb.sampling.Uniform(1.0, 2.0)}, n=2)
    made = lierb.study_of(problem, design, dt=0.01, t_end=0.1).batch(0, 2).problem
    assert made.rows == problem.rows


def test_a_line_of_a_function_names_no_trajectory(tmp_path):
    code = """\
import lierb


@lierb.constraint
def on_line(R, r):
    return r[2] - 0.1 * R[9, 0]
"""
    text = TEXT[: TEXT.index("[[problem.forces]]")] + TEXT[TEXT.index("[sample]") :]
    text = text.replace("[sample.forces.controller.damping]", "[sample.body.mass]")
    text += '\n[[problem.constraints]]\ntype = "python:attitude.py:on_line"\n'
    folder = written(tmp_path / "study", text, code)
    with pytest.raises(StudyError, match="on_line") as told:
        lierb.run(folder / "study.toml", tmp_path / "out")
    assert "return r[2] - 0.1" in str(told.value)
    assert "trajectory" not in str(told.value)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning")
def test_what_a_function_raised_reaches_the_reader_of_a_study(tmp_path):
    code = """\
import lierb


@lierb.wrench
def controller(t, R, r, omega, v, params):
    if t > 1.0:
        raise ValueError("the table ends at 1 s")
    return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@lierb.observable
def pointing_error(r):
    return r[2]
"""
    text = TEXT.replace("most = 0.1\n", "").replace("n = 40", "n = 4")
    text = text.replace("[sample.forces.controller.damping]", "[sample.body.mass]")
    folder, out = written(tmp_path / "study", text, code), tmp_path / "out"
    with pytest.warns(UserWarning, match="raised"):
        dataset = lierb.run(folder / "study.toml", out)
    assert "the table ends at 1 s" in str(dataset.failures())
    shown = invoke("run", folder / "study.toml", "--out", out, "--only", 2, "--seed", 5)
    assert "the table ends at 1 s" in shown.stdout
    assert "has results of another study" in " ".join(shown.stderr.split())

"""The diffs that CONTRIBUTING.md shows apply, what they add works, and the tests know of it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "CONTRIBUTING.md"
IN_PACKAGE = (
    "lierb/model/joints/catalogue.py", "lierb/kernels/mechanics/rows.py",
    "lierb/model/forces/springs.py", "lierb/methods/classical.py",
    "lierb/kernels/systems/measures.py", "lierb/kernels/systems/tree_measures.py",
)  # fmt: skip
CATALOGUES = (
    "test_joints", "test_oracle", "test_initial_conditions", "test_prediction", "test_scale",
    "test_site", "test_study", "test_tableaus", "test_tableaus_orders", "test_mechanism",
    "test_multipliers", "test_tables", "test_animation", "test_history_plots",
    "kernels/test_every_formula", "mechanisms/test_oracle",
)  # fmt: skip

SCRIPT = """
import numpy as np
import lierb
from lierb.studies.description.units import unit_of

centre = [0.7, 0.2, -0.4]
box = {"solid": "box", "size": [0.1, 0.2, 0.3], "mass": 1.0}
study = lierb.Study.of({
    "body": box,
    "joint": {"type": "point_in_tube", "length": 0.5, "body_point": [0.0, 0.1, 0.2]},
    "problem": {"forces": [{"type": "attraction", "centre": centre, "strength": 0.2}]},
    "initial": {"omega": [1.0, 2.0, 3.0], "point_velocity": [0.3, 0.4, 0.0]},
    "sample": {"n": 3, "forces": {"attraction": {"centre": {
        "distribution": "uniform", "low": [0.6, 0.2, -0.4], "high": [0.8, 0.2, -0.4],
    }}}},
    "integrate": {"dt": 1e-3, "t_end": 0.5},
})
assert study.problem.forces[0].type == "attraction"
batch = study.batch(0, 3)
problem = batch.problem
assert unit_of("forces.attraction.strength", study, problem) == "N m²"

off = lierb.lie.se3.exp((0.1, 0.2, -0.3, 0.02, 0.03, -0.04))
pose = problem.close(off)
d = np.linalg.inv(problem.joint.ground_frame) @ pose @ problem.joint.body_frame
np.testing.assert_allclose(np.hypot(d[..., 1, 3], d[..., 2, 3]), 0.5, rtol=1e-12)
rate = problem.project([1.0, 2.0, 3.0, 0.3, 0.4, 0.5], pose)

assert lierb.methods.TABLEAUS["Heun3"].stages == 3
for cspace in ("SE3", "SO3xR3"):
    run = lierb.integrate(problem, twist0=rate, pose0=pose, dt=1e-3, t_end=0.5, cspace=cspace)
    assert run.summary["spin_max"].to_numpy().min() > 1.0, run.summary["spin_max"]
    # of RK4; a wrong acceleration term or potential leaves far more
    for name in ("position_error_max", "velocity_error_max", "energy_drift_max"):
        assert run.summary[name].to_numpy().max() < 1e-9, (cspace, name, run.summary[name])

turning = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
wheel = lierb.Mechanism(turning)
run = lierb.integrate(wheel, twist0=wheel.twist({"wheel": 3.0}), dt=0.1, t_end=0.2)
assert run.summary["spin_max"].to_pylist() == [3.0]
"""


def hunks(page: str):
    """(file, text before, text after) of every hunk."""
    for diff in re.findall(r"^```diff\n(.*?)^```", page, re.MULTILINE | re.DOTALL):
        for of_file in re.split(r"^--- a/.*\n", diff, flags=re.MULTILINE)[1:]:
            head, *parts = re.split(r"^@@.*\n", of_file, flags=re.MULTILINE)
            file = re.search(r"^\+\+\+ b/(.*)$", head, re.MULTILINE)[1]
            for part in parts:
                lines = part.splitlines(keepends=True)
                yield (
                    file,
                    *("".join(x[1:] for x in lines if x[0] in side) for side in (" -", " +")),
                )


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The checkout's lierb, tests and reference with all diffs applied."""
    root = tmp_path_factory.mktemp("checkout")
    for folder in ("lierb", "tests", "docs", "examples", "bench"):
        stored = ("results",) if folder == "bench" else ()  # lierb/results is a part of the package
        left_out = shutil.ignore_patterns("*.nbi", "*.nbc", "_build", *stored)
        shutil.copytree(ROOT / folder, root / folder, ignore=left_out)
    shutil.copy(ROOT / "pyproject.toml", root)
    for file, before, after in hunks(PAGE.read_text(encoding="utf-8")):
        text = (root / file).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{file} no longer has {before!r} once"
        (root / file).write_text(text.replace(before, after), encoding="utf-8")
    return root


def run(copy: Path, *arguments: str) -> str:
    """Output of Python in the copy; it must end well."""
    paths = {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy / "cache")}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=copy,
        env=os.environ | paths,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr
    return done.stdout


def test_package_changes_where_the_page_says():
    """A joint, a row, a force and a method by one file each, a measure by two."""
    changed = {file for file, _, _ in hunks(PAGE.read_text(encoding="utf-8"))}
    assert {file for file in changed if file.startswith("lierb/")} == {*IN_PACKAGE}


@pytest.mark.long
def test_diffs_add_what_they_say(copy):
    run(copy, "-c", SCRIPT)


@pytest.mark.long  # collects the tests over the catalogues
def test_tests_over_the_catalogues_take_what_the_diffs_add(copy):
    """Run the tests that compile no kernel, of the additions and of whole catalogues."""
    files = [f"tests/{name}.py" for name in CATALOGUES]
    added = "tube or loosely or attraction or Heun3 or spin"
    wholes = "catalogue or follow_from or page_of_methods or schema or adds_its_columns or views"
    out = run(
        copy,
        "-m",
        "pytest",
        "-n",
        "0",
        "-q",
        "-m",
        "not slow",
        "-k",
        f"{added} or {wholes}",
        *files,
    )
    assert " passed" in out

"""The diffs that CONTRIBUTING.md shows apply to the package, and what they add works."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import lierb

PACKAGE = Path(lierb.__file__).parent
PAGE = Path(__file__).parents[1] / "CONTRIBUTING.md"

SCRIPT = """
import numpy as np
import lierb
from lierb.studies.units import unit_of

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
assert unit_of("forces.attraction.strength", study, problem.joint) == "N m²"

off = lierb.lie.se3.exp((0.1, 0.2, -0.3, 0.02, 0.03, -0.04))
pose = problem.close(off)
d = np.linalg.inv(problem.joint.ground_frame) @ pose @ problem.joint.body_frame
np.testing.assert_allclose(np.hypot(d[..., 1, 3], d[..., 2, 3]), 0.5, rtol=1e-12)
rate = problem.project([1.0, 2.0, 3.0, 0.3, 0.4, 0.5], pose)

assert lierb.tableaus.TABLEAUS["Heun3"].stages == 3
for cspace in ("SE3", "SO3xR3"):
    run = lierb.integrate(problem, twist0=rate, pose0=pose, dt=1e-3, t_end=0.5, cspace=cspace)
    assert run.summary["spin_max"].to_numpy().min() > 1.0, run.summary["spin_max"]
    # of RK4; a wrong acceleration term or potential leaves far more
    for name in ("position_error_max", "velocity_error_max", "energy_drift_max"):
        assert run.summary[name].to_numpy().max() < 1e-9, (cspace, name, run.summary[name])
"""


def hunks(page: str):
    """(file, text before, text after) of every hunk."""
    for diff in re.findall(r"^```diff\n(.*?)^```", page, re.MULTILINE | re.DOTALL):
        head, *parts = re.split(r"^@@.*\n", diff, flags=re.MULTILINE)
        file = re.search(r"^\+\+\+ b/(.*)$", head, re.MULTILINE)[1]
        for part in parts:
            lines = part.splitlines(keepends=True)
            yield file, *("".join(x[1:] for x in lines if x[0] in side) for side in (" -", " +"))


@pytest.mark.slow  # compiles two kernels
def test_diffs_add_what_they_say(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "lierb", ignore=shutil.ignore_patterns("__pycache__"))
    files = []
    for file, before, after in hunks(PAGE.read_text(encoding="utf-8")):
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{file} no longer has {before!r} once"
        (tmp_path / file).write_text(text.replace(before, after), encoding="utf-8")
        files.append(file)
    assert len(files) == len(set(files))  # what is added takes one file each
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 0, done.stderr

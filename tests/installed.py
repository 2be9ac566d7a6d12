"""Checks of an installed lierb without its checkout, run by `make dist`.

python tests/installed.py lierb-0.1.0-py3-none-any.whl
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import readme

import lierb

NAMES = {"heavy_top", "pendulum", "pin_in_slot", "satellite"}


def main(wheel: str) -> None:
    package = Path(lierb.__file__).parent
    assert "site-packages" in package.parts, f"{package} is no installation"
    assert lierb.__version__ == wheel.split("-")[1], (lierb.__version__, wheel)

    said = _printed("--version")
    assert lierb.__version__ in said, said
    listed = {line.split()[0] for line in _printed("example").splitlines()}
    assert listed >= NAMES, listed
    for name in NAMES:
        study = lierb.Study.of(tomllib.loads(_printed("example", name)))
        assert study.batch(0, 2).twist0.shape == (2, 6)
    schema = json.loads((package / "examples" / "study.schema.json").read_text(encoding="utf-8"))
    assert "integrate" in schema["properties"]

    body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
    top = lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)))
    twist0 = top.joint.twist(omega=(6.28, 3.14, 0.63))
    run = lierb.integrate(top, twist0=twist0, dt=1e-3, t_end=0.1, solver="saddle")
    (told,) = run.summary.to_pylist()
    assert told["status"] == "ok"
    assert told["position_error_max"] < 1e-15
    readme.run()
    print(f"lierb {lierb.__version__} works in {sys.prefix}, and so does README.md")


def _printed(*arguments: str) -> str:
    command = [sys.executable, "-m", "lierb", *arguments]
    return subprocess.run(command, check=True, capture_output=True, encoding="utf-8").stdout


if __name__ == "__main__":
    main(Path(sys.argv[1]).name)

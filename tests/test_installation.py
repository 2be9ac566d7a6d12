"""`lierb.info`, `lierb.warmup` and their commands."""

import json
import os
import subprocess
import sys

import numba
import pytest

import lierb
from lierb.errors import UnknownNameError

pytest.importorskip("click")
pytest.importorskip("rich")

from command import invoke

# Says how many kernels the process has compiled, and how many it has found in the disk cache.
COUNT = """
from lierb.kernels.loops.blocks import integrate_blocks as driver
print(sum(driver.stats.cache_misses.values()), sum(driver.stats.cache_hits.values()))
"""
WARM_UP = "import lierb; lierb.warmup(['revolute'], methods=['Euler'], cspaces=['SO3xR3'])" + COUNT
INTEGRATE = (
    """
import lierb
body = lierb.Body(2.0, (0.1, 0.2, 0.25))
top = lierb.Problem(body, lierb.joints.revolute((0.1, 0.2, 0.3), axis=(0, 1, 1)), (0, 0, -9.81))
twist0 = top.project([(1.0, 2.0, 3.0, 0.0, 0.0, 0.0)] * 5)
lierb.integrate(top, twist0=twist0, dt=1e-3, t_end=0.1, method="Euler", cspace="SO3xR3",
                save_every=10, record="state")
"""
    + COUNT
)


def run(program, cache):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_warmup_leaves_out_what_does_not_exist():
    seen = []
    kernels = lierb.warmup(
        ["spherical", "universal", lierb.joints.free()],
        methods=["Euler"],
        cspaces=["reduced"],
        progress=lambda *of: seen.append(of),
    )
    assert [(k.joint, k.method, k.cspace, k.update) for k in kernels] == [
        ("spherical", "Euler", "reduced", "local")
    ]
    assert kernels[0].seconds > 0.0
    assert seen == [(0, 1, "spherical, Euler, reduced, local"), (1, 1, "")]


def test_warmup_takes_one_name_for_a_list_of_one():
    (kernel,) = lierb.warmup("spherical", methods="Euler", cspaces="reduced")
    assert (kernel.joint, kernel.method, kernel.cspace) == ("spherical", "Euler", "reduced")


@pytest.mark.long
def test_warmup_knows_the_kernel_of_all_trees():
    joints = [lierb.joints.revolute(), lierb.joints.universal(parent_point=(0.0, 0.0, 0.1))]
    names = ("upper", "lower")
    body = lierb.bodies.sphere(0.1, mass=1.0)
    links = [lierb.Link(n, body, j, p) for n, j, p in zip(names, joints, ("ground", "upper"))]
    (kernel,) = lierb.warmup("tree")
    before = lierb.info()["loaded"]
    tree = lierb.Mechanism(links)
    lierb.integrate(tree, twist0=tree.twist(), dt=0.1, t_end=0.2, solver="looped")
    assert (kernel.joint, kernel.cspace, lierb.info()["loaded"]) == ("tree", "reduced", before)


@pytest.mark.slow
def test_warmup_takes_a_joint_that_does_not_close_at_rest():
    held = lierb.joints.from_rows(["Q11"])
    (kernel,) = lierb.warmup(held, methods="Euler")
    assert kernel.joint == "from_rows"


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        ({"joints": ["sperical"]}, "spherical"),
        ({"methods": ["RK5"]}, "RK4"),
        ({"cspaces": ["SE3", "SE2"]}, "SE3"),
        ({"updates": ["locale"]}, "local"),
        ({"solver": "saddles"}, "saddle"),
    ],
)
def test_warmup_knows_its_names_before_it_compiles(arguments, hint, monkeypatch):
    monkeypatch.setattr(lierb.installation, "integrate", None)
    with pytest.raises(UnknownNameError, match=f"Did you mean '{hint}'"):
        lierb.warmup(**arguments)


@pytest.mark.slow  # three processes, one of which compiles
def test_warmup_spares_another_process_the_compile_and_info_counts_it(tmp_path):
    count = "import lierb; print(lierb.info()['cache']['kernels'])"
    assert run(f"{count}\n{WARM_UP}", tmp_path) == ["0", "1", "0"]
    assert run(count + INTEGRATE, tmp_path) == ["1", "0", "1"]
    (kernel,) = tmp_path.rglob("blocks.integrate_blocks-*.nbc")
    _, stamp, digest = kernel.name.split("-")
    kernel.rename(kernel.with_name(f"blocks.integrate_blocks-{stamp[::-1]}-{digest}"))
    told = run(f"{count}; from lierb.cli import cli; cli(['cache', '--clear'])", tmp_path)
    # the loop over blocks has a file, too, and the syntax trees
    assert told[:4] == ["0", "Deleted", "3", "files,"]
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".nbc", ".trees")]


@pytest.mark.long
def test_info_counts_kernels_of_adaptive_steps(tmp_path):
    program = """
import lierb
top = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free())
lierb.integrate(top, rtol=1e-3, t_end=0.1)
print(lierb.info()["cache"]["kernels"], lierb.info()["cache"]["bytes"])
"""
    count, size = map(int, run(program, tmp_path))
    assert count == 1
    assert size == sum(path.stat().st_size for path in tmp_path.rglob("*.nbc"))


def test_info_is_plain_and_complete():
    found = json.loads(json.dumps(lierb.info()))
    assert found["lierb"] == lierb.__version__
    assert found["threads"] >= 1
    assert found["threading_layer"] in {"omp", "tbb", "workqueue"}
    assert {"cpu", "vectors", "fma", "numba", "numpy", "pyarrow", "python"} <= found.keys()


class TestCommands:
    def test_info_prints_what_it_knows(self):
        result = invoke("info")
        assert result.exit_code == 0, result.output
        found = lierb.info()
        for text in (f"lierb {lierb.__version__}", found["cpu"], found["cache"]["folder"]):
            assert text in result.stdout

    def test_info_as_json_is_info(self, tmp_path, monkeypatch):
        monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))  # a folder of this test only
        result = invoke("info", "--json")
        assert json.loads(result.stdout) == lierb.info()

    def test_warmup_lists_every_kernel(self):
        options = ["--method", "Euler", "--cspace", "SE3", "--cspace", "reduced"]
        result = invoke("warmup", "spherical", *options)
        assert result.exit_code == 0, result.output
        for cspace in ("SE3", "reduced"):
            assert f"spherical, Euler, {cspace}, local" in result.stdout
        assert "ready: 2 kernels" in result.stdout

    def test_warmup_suggests_a_name(self):
        result = invoke("warmup", "sperical")
        assert result.exit_code == 1
        assert result.stderr.endswith("Did you mean 'spherical'?\n")

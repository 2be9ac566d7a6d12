"""The disk cache of compiled code, through processes of their own with a cache of their own."""

import json
import os
import pickle
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numba
import pytest

import lierb
from lierb.kernels import _jit

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="nothing is compiled with the JIT off"
)

# A free fall by Euler's method, the least to compile: v₃ = −g t, and r₃ = −½ g t (t − dt).
# Prints what the run gave and where its machine code came from.
FALL = """
import json, sys
import lierb
from lierb.kernels.driver import integrate_block

def fall(method="Euler"):
    body = lierb.Body(mass=2.0, inertia=(1.0, 1.0, 1.0))
    problem = lierb.Problem(body, lierb.joints.free(), gravity=(0.0, 0.0, -8.0))
    still = [0.0] * 6
    summary = lierb.integrate(problem, twist0=still, dt=0.25, t_end=1.0, method=method).summary
    stats = integrate_block.stats
    print(json.dumps({
        "v": summary["v"][0].as_py()[2],
        "r": summary["position"][0].as_py()[2],
        "loaded": sum(stats.cache_hits.values()),
        "compiled": sum(stats.cache_misses.values()),
        "cache": stats.cache_path,
    }), flush=True)
"""
NOW = FALL + "fall(*sys.argv[1:])"
FALLEN = {"Euler": {"v": -8.0, "r": -3.0}, "Heun": {"v": -8.0, "r": -4.0}}  # exact in binary


class Copy:
    """A copy of the package, to edit, and a cache of its own."""

    def __init__(self, folder):
        self.folder = folder
        source = Path(lierb.__file__).parent
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source, folder / "lierb", ignore=ignored)

    def kernel(self, name):
        return self.folder / "lierb" / "kernels" / name

    def edit(self, name, old, new):
        text = self.kernel(name).read_text()
        assert text.count(old) == 1, f"{name} no longer reads {old!r}: edit something else here"
        self.kernel(name).write_text(text.replace(old, new))

    def start(self, script=NOW, *arguments, **environment):
        own = {
            "PYTHONPATH": str(self.folder),
            "NUMBA_CACHE_DIR": str(self.folder / "cache"),
            # Python compares bytecode with its source to the second only
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        return subprocess.Popen(
            [sys.executable, "-c", script, *arguments],
            cwd=self.folder,
            env=os.environ | own | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, script=NOW, *arguments, **environment):
        return finished(self.start(script, *arguments, **environment))

    def entries(self):
        return len(list((self.folder / "cache").rglob("*integrate_block-*.nbc")))


def finished(process):
    out, err = process.communicate("\n", timeout=180)
    assert process.returncode == 0, err
    return json.loads(out)


def fallen(told):
    return {name: told[name] for name in ("v", "r")}


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path)


# ---------------------------------------------------------------- hits and misses


@pytest.mark.slow  # two processes, one of which compiles
def test_second_process_loads_what_the_first_compiled(copy):
    first, second = copy.run(), copy.run()
    assert first["cache"].startswith(str(copy.folder))  # not the cache of the tests
    assert (first["compiled"], first["loaded"]) == (1, 0)
    assert (second["compiled"], second["loaded"]) == (0, 1)
    assert fallen(first) == fallen(second) == FALLEN["Euler"]


EDITS = {
    "gravity": (
        "newton_euler.py",
        "gravity=mat_t_vec(p.ground[0], p.gravity)",
        "gravity=mat_t_vec(p.ground[0], scale(2.0, p.gravity))",
        {"v": -16.0, "r": -6.0},
    ),
    "step size": (
        "stepper.py", "hw = h * weight", "hw = 2.0 * h * weight", {"v": -16.0, "r": -12.0},
    ),
}  # fmt: skip


@pytest.mark.slow  # four processes that compile
def test_edited_kernel_changes_the_next_process(copy):
    assert fallen(copy.run()) == FALLEN["Euler"]
    for name, old, new, changed in EDITS.values():
        copy.edit(name, old, new)
        assert fallen(copy.run()) == changed
        assert copy.entries() == 1  # the old code is gone: nothing can ask for it
        copy.edit(name, new, old)
    assert fallen(copy.run()) == FALLEN["Euler"]


@pytest.mark.slow
def test_edit_after_the_import_does_not_poison_the_cache(copy):
    name, old, new, changed = EDITS["gravity"]
    # this process has read the old source when the new one is written
    process = copy.start(FALL + "print(flush=True)\ninput()\nfall()")
    process.stdout.readline()
    copy.edit(name, old, new)
    assert fallen(finished(process)) == FALLEN["Euler"]
    assert fallen(copy.run()) == changed


@pytest.mark.slow
def test_process_of_the_old_source_keeps_its_code_to_itself(copy):
    name, old, new, changed = EDITS["gravity"]
    process = copy.start(FALL + "fall()\ninput()\nfall('Heun')")
    assert fallen(json.loads(process.stdout.readline())) == FALLEN["Euler"]
    copy.edit(name, old, new)
    assert fallen(copy.run()) == changed
    assert fallen(finished(process)) == FALLEN["Heun"]  # it goes on as it began
    assert fallen(copy.run(NOW, "Heun")) == {"v": -16.0, "r": -8.0}


@pytest.mark.slow
def test_processes_that_compile_at_once_are_both_right(copy):
    methods = ["Euler", "Heun", "Euler", "Heun"]
    together = [finished(process) for process in [copy.start(NOW, m) for m in methods]]
    afterwards = [copy.run(NOW, method) for method in methods[:2]]
    for method, told in zip(methods + methods[:2], together + afterwards, strict=True):
        assert fallen(told) == FALLEN[method]
    assert [told["loaded"] for told in afterwards] == [1, 1]
    assert copy.entries() == 2


@pytest.mark.slow
def test_interrupted_compilation_leaves_no_lock_behind(copy):
    process = copy.start()
    while not list((copy.folder / "cache").rglob("lierb.lock")):  # it is compiling now
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert fallen(copy.run()) == FALLEN["Euler"]


# ---------------------------------------------------------------- LIERB_LANES

# A batch that fills no pack, on a joint whose saddle point is solved in every stage.
BATCH = """
import json
import numpy as np
import lierb

joint = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))
body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
problem = lierb.Problem(body, joint, gravity=(0.0, 0.0, -9.81))
twists = joint.twist(np.linspace(-6.0, 6.0, 33).reshape(11, 3))
result = lierb.integrate(
    problem, twist0=twists, dt=1e-2, t_end=0.3, save_every=7, record=("state", "energy")
)
told = json.loads(result.summary.schema.metadata[b"lierb"])["lanes"]
columns = [c.to_pylist() for t in (result.summary, result.history) for c in t.columns]
print(json.dumps({"lanes": told, "columns": columns}))
"""


@pytest.mark.slow  # four processes, each of which compiles
def test_lierb_lanes_sets_the_width_and_changes_no_bit(copy):
    found = {lanes: copy.run(BATCH, LIERB_LANES=str(lanes)) for lanes in (1, 2, 4, 8)}
    for lanes, told in found.items():
        assert told["lanes"] == lanes
        assert told["columns"] == found[1]["columns"], lanes
    # one cache for all of them: a process with another L must not find the first one's code
    assert copy.run(BATCH, LIERB_LANES="2") == found[2]


@pytest.mark.parametrize("lanes", ["3", "16", "-1", "four"])
def test_lierb_lanes_out_of_range_is_told_clearly(copy, lanes):
    process = copy.start("import lierb", LIERB_LANES=lanes)
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert f"LIERB_LANES must be 1, 2, 4 or 8, got '{lanes}'" in err.splitlines()[-1]


# ---------------------------------------------------------------- how quickly it loads

IMPORTED = (
    NOW
    + """
print(json.dumps(sorted({"pandas", "scipy.linalg"} & sys.modules.keys())))
import numba
assert numba.njit(lambda x: x + 1)(1) == 2  # what was left out is there when something compiles
"""
)


@pytest.mark.slow  # two processes, one of which compiles
def test_warm_process_imports_no_package_that_it_does_not_use(copy):
    copy.run()
    out, err = copy.start(IMPORTED).communicate(timeout=60)
    told, imported = map(json.loads, out.splitlines())
    assert told["loaded"] == 1, err
    assert imported == []


# ---------------------------------------------------------------- functions of the user's

PUSH = """
import json
import lierb
from lierb.kernels.driver import integrate_block

scale = {scale}

def twice(x):
    return {twice}

@lierb.wrench
def push(t, R, r, omega, v, params):
    {branch}
    return (0.0, 0.0, 0.0), (scale * params.size, twice(params.size), 0.0)

body = lierb.Body(mass=2.0, inertia=(1.0, 1.0, 1.0))
problem = lierb.Problem(body, lierb.joints.free(), forces=push(size=4.0))
result = lierb.integrate(problem, twist0=[0.0] * 6, dt=0.25, t_end=1.0, method="Euler")
stats = integrate_block.stats
print(json.dumps({{
    "v": result.summary["v"][0].as_py(),
    "loaded": sum(stats.cache_hits.values()),
    "compiled": sum(stats.cache_misses.values()),
}}))
"""


def push(scale=1.0, twice="2.0 * x", branch="pass"):
    return PUSH.format(scale=scale, twice=twice, branch=branch)


@pytest.mark.slow  # several processes, most of which compile
@pytest.mark.parametrize("branch", ["pass", "if v[0] > 100.0: t = 0.0"], ids=["packs", "bodies"])
def test_function_of_the_user_comes_from_the_cache_until_it_is_edited(copy, branch):
    quiet = {"PYTHONWARNINGS": "ignore"}  # of one that runs body by body
    first, second = (copy.run(push(branch=branch), **quiet) for _ in range(2))
    assert (first["compiled"], first["loaded"]) == (1, 0)
    assert (second["compiled"], second["loaded"]) == (0, 1)
    assert first["v"] == second["v"] == [2.0, 4.0, 0.0]
    edited = copy.run(push(branch=branch, twice="3.0 * x"), **quiet)
    assert (edited["compiled"], edited["v"]) == (1, [2.0, 6.0, 0.0])
    rescaled = copy.run(push(branch=branch, scale=2.0), **quiet)
    assert (rescaled["compiled"], rescaled["v"]) == (1, [4.0, 4.0, 0.0])
    back = copy.run(push(branch=branch), **quiet)
    assert (back["loaded"], back["v"]) == (1, [2.0, 4.0, 0.0])
    assert not needed_packages(copy.folder / "cache") - OWN


# ---------------------------------------------------------------- what is on the disk

OWN = {"builtins", "collections", "copyreg", "lierb", "llvmlite", "numba", "numpy"}


class Recorder(pickle.Unpickler):
    """Notes which packages the unpickled needs."""

    def __init__(self, stream):
        super().__init__(stream)
        self.packages = set()

    def find_class(self, module, name):
        self.packages.add(module.split(".")[0])
        if name == "_rebuild_env":  # Numba's environments import a module by its name
            return lambda imported, *_: self.packages.add(imported.split(".")[0])
        return super().find_class(module, name)


def needed_packages(folder):
    """What must be there for the cache's files to be read."""
    found = set()
    for path in folder.rglob("*.nb[ic]"):
        with path.open("rb") as stream:
            if path.suffix == ".nbc":
                stream.seek(_jit.DIGEST_SIZE)
            while stream.peek(1):
                recorder = Recorder(stream)
                recorder.load()
                found |= recorder.packages
    assert "numba" in found
    return found


SPRING = """
import lierb, settings

@lierb.wrench
def spring(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (0.0, 0.0, settings.K)
"""
SPRING += NOW.replace("gravity=", "forces=spring(), gravity=")


@pytest.mark.slow  # two processes that compile
def test_function_of_the_user_leaves_nothing_of_its_own_in_the_cache(copy):
    project = copy.folder / "project"
    project.mkdir()
    (project / "settings.py").write_text("K = 16.0\n")
    path = os.pathsep.join((str(copy.folder), str(project)))
    assert fallen(copy.run(SPRING, PYTHONPATH=path)) == {"v": 0.0, "r": 0.0}  # it floats
    assert not needed_packages(copy.folder / "cache") - OWN
    # another project, without those settings, through the same cache
    assert fallen(copy.run()) == FALLEN["Euler"]
    again = copy.run(SPRING, PYTHONPATH=path)
    assert (again["loaded"], fallen(again)) == (1, {"v": 0.0, "r": 0.0})


@dataclass(frozen=True)
class Times(_jit.Tag):
    factor: float


def times(tag, x):
    return tag.factor * x


_jit.kernel(times)


def product(tag, x):
    return times(tag, x)


def computed(factor):
    """factor · 2 by a new dispatcher, as a new process has it, and whether that was loaded."""
    dispatcher = _jit.cached()(product)
    found = _jit.compiled(dispatcher, Times(factor), 2.0)(Times(factor), 2.0)
    return found, bool(dispatcher.stats.cache_hits)


def cut(size, *files):
    for file in files:
        file.write_bytes(file.read_bytes()[:size])


def flip_a_bit(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def exchange(first, second):
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])


DAMAGES = {
    "index cut": lambda index, *data: cut(40, index),
    "index empty": lambda index, *data: cut(0, index),
    "index of something else": lambda index, *data: index.write_bytes(b"no pickle at all"),
    "index that lists nothing": lambda index, *data: index.write_bytes(pickle.dumps(None)),
    "data cut": lambda index, *data: cut(100, *data),
    "data empty": lambda index, *data: cut(0, *data),
    "data with a bit wrong": lambda index, *data: [flip_a_bit(file) for file in data],
    "data exchanged": lambda index, *data: exchange(*data),
    "data gone": lambda index, *data: [file.unlink() for file in data],
    "stamp no text": lambda index, *data: next(index.parent.glob("*.stamp")).write_bytes(b"\xff"),
}


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]
    return [*tmp_path.rglob("*.nbi"), *tmp_path.rglob("*.nbc")]


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_entry_is_compiled_anew_and_replaced(own_cache, name):
    DAMAGES[name](*own_cache)
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]


class Gone:
    """Something that no longer exists when the index is read again."""


def read_index(index):
    with index.open("rb") as file:
        return pickle.load(file), *pickle.load(file)


def test_foreign_entry_hides_no_other(own_cache, monkeypatch):
    index = own_cache[0]
    version, stamp, entries = read_index(index)
    index.write_bytes(pickle.dumps(version) + pickle.dumps((stamp, {Gone(): "1.nbc"} | entries)))
    monkeypatch.delattr(sys.modules[__name__], "Gone")
    with pytest.raises(AttributeError):  # as Numba would read it
        read_index(index)
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]
    assert computed(7.0) == (14.0, False)
    assert entries.items() < read_index(index)[2].items()  # written again, without it

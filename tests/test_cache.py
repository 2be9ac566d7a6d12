"""The disk cache of compiled code, through processes of their own with a cache of their own."""

import errno
import hashlib
import io
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, is_dataclass
from pathlib import Path

import numba
import numpy as np
import pytest
from cases import long_but
from numba.core.caching import InTreeCacheLocator

import lierb
from lierb.compiler import disk_cache, entries, sealed, stamp
from lierb.compiler.code import cached, compiled
from lierb.compiler.tags import Tag
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.tracing.trace import kernel

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="nothing is compiled with the JIT off"
)

# A free fall by Euler's method, the least to compile: v₃ = −g t, and r₃ = −½ g t (t − dt).
# Prints what the run gave and where its machine code came from.
FALL = """
import json, sys
import lierb
from lierb.kernels.loops.blocks import integrate_blocks

def fall(method="Euler"):
    body = lierb.Body(mass=2.0, inertia=(1.0, 1.0, 1.0))
    problem = lierb.Problem(body, lierb.joints.free(), gravity=(0.0, 0.0, -8.0))
    still = [0.0] * 6
    summary = lierb.integrate(problem, twist0=still, dt=0.25, t_end=1.0, method=method).summary
    stats = integrate_blocks.stats
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

# A bracket of two unit vectors, compiled in a fifth of the time: for what concerns any code.
BRACKET = """
import json, sys
import lierb
from lierb.kernels.groups.lie_functions import apply

def bracket(group="so3"):
    x, y = ([float(i == k) for i in range(3 if group == "so3" else 6)] for k in (0, 1))
    z, stats = getattr(lierb.lie, group).ad(x, y)[2], apply.stats
    print(json.dumps({
        "z": z,
        "loaded": sum(stats.cache_hits.values()),
        "compiled": sum(stats.cache_misses.values()),
    }), flush=True)
"""
BRACKET_NOW = BRACKET + "bracket(*sys.argv[1:])"
CROSS = "numbers/vec.py", "fma(a[0], b[1], -(a[1] * b[0]))", "fma(2.0 * a[0], b[1], -a[1] * b[0])"


SOURCE = Path(lierb.__file__).parent


def ignored(folder, names):
    """Kernels; bytecode stays, which is taken for what it was made of alone: so a process begins in
    two thirds of the time.
    """
    is_cache = Path(folder).name == "__pycache__"
    return [name for name in names if is_cache and not name.endswith(".pyc")]


class Copy:
    """A copy of the package, to edit, and a cache of its own."""

    def __init__(self, folder):
        self.folder = folder
        self.renew()

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
            # Python compares bytecode with its source to the second only: none of edits
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

    def files(self):
        return sorted((self.folder / "cache").rglob("*.nbc"))

    def entries(self, function="integrate_blocks"):
        return len([file for file in self.files() if f"{function}-" in file.name])

    def renew(self, cache=None):
        """The package as it is, and of a cache what there is in another folder."""
        for path in self.folder.glob("*"):
            shutil.rmtree(path)
        shutil.copytree(SOURCE, self.folder / "lierb", ignore=ignored)
        if cache:
            shutil.copytree(cache, self.folder / "cache")


def finished(process):
    out, err = process.communicate("\n", timeout=180)
    assert process.returncode == 0, err
    return json.loads(out)


def fallen(told):
    return {name: told[name] for name in ("v", "r")}


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path)


@pytest.fixture(scope="module")
def fallen_once(tmp_path_factory):
    """Copy whose cache has the free fall, a copy of that cache, and the output of the run."""
    copy = Copy(tmp_path_factory.mktemp("fallen") / "copy")
    told = copy.run()
    kept = shutil.copytree(copy.folder / "cache", copy.folder.parent / "cache")
    return copy, kept, told


@pytest.fixture
def warm(fallen_once):
    """The copy as it was after its first run: in the same folder, as caches are found by it."""
    copy, cache, _ = fallen_once
    copy.renew(cache)
    return copy


# ---------------------------------------------------------------- hits and misses


@pytest.mark.slow  # two processes, one of which compiles
def test_next_process_loads_what_the_first_compiled_whatever_comments_say(fallen_once, warm):
    copy, first, kept = warm, fallen_once[-1], warm.files()
    copy.edit(*COMMENT)
    with (copy.folder / "lierb" / "api.py").open("a") as unrelated:
        unrelated.write("\nNEW = 1\n")
    second = copy.run()
    assert first["cache"].startswith(str(copy.folder))  # not the cache of the tests
    assert (first["compiled"], first["loaded"]) == (1, 0)
    assert (second["compiled"], second["loaded"]) == (0, 1)
    assert fallen(first) == fallen(second) == FALLEN["Euler"]
    assert copy.files() == kept


COMMENT = "numbers/vec.py", "def cross(", "# a comment\ndef cross("
EDITS = {
    "gravity": (
        "mechanics/newton_euler.py",
        "gravity=mat_t_vec(p.ground[0], p.gravity)",
        "gravity=mat_t_vec(p.ground[0], scale(2.0, p.gravity))",
        {"v": -16.0, "r": -6.0},
    ),
    "step size": (
        "systems/combine.py",
        "else h * weight",
        "else 2.0 * h * weight",
        {"v": -16.0, "r": -12.0},
    ),
}


def test_formulas_of_every_element_are_among_the_sources():
    kinds = [Element]
    for kind in kinds:
        kinds += kind.__subclasses__()
    made = [kind for kind in kinds if not kind.__subclasses__()]  # others are in no plan
    assert all(map(is_dataclass, made))  # by which their modules are in a tag's stamp
    assert len(made) > 8


@pytest.mark.slow  # two processes that compile
@pytest.mark.parametrize("edit", long_but(EDITS, "gravity"))
def test_edited_kernel_changes_the_next_process(warm, edit):
    copy, (name, old, new, changed) = warm, EDITS[edit]
    copy.edit(name, old, new)
    assert fallen(copy.run()) == changed
    assert copy.entries() == 1  # the old code is gone: nothing can ask for it
    copy.edit(name, new, old)
    assert fallen(copy.run()) == FALLEN["Euler"]


@pytest.mark.long
def test_edit_after_the_import_does_not_poison_the_cache(copy):
    # this process has read the old source when the new one is written
    process = copy.start(BRACKET + "print(flush=True)\ninput()\nbracket()")
    process.stdout.readline()
    copy.edit(*CROSS)
    old, new = finished(process), copy.run(BRACKET_NOW)
    assert (old["z"], new["z"]) == (1.0, 2.0)
    assert old["compiled"] == new["compiled"] == 1


@pytest.mark.long
def test_process_of_the_old_source_keeps_its_code_to_itself(copy):
    process = copy.start(BRACKET + "bracket()\ninput()\nbracket('se3')")
    assert json.loads(process.stdout.readline())["z"] == 1.0
    copy.edit(*CROSS)
    assert copy.run(BRACKET_NOW)["z"] == 2.0
    assert finished(process)["z"] == 1.0  # it goes on as it began
    assert copy.run(BRACKET_NOW, "se3")["z"] == 2.0


@pytest.mark.long
def test_processes_that_compile_at_once_are_both_right(copy):
    groups = ["so3", "se3", "so3", "se3"]
    together = [finished(process) for process in [copy.start(BRACKET_NOW, g) for g in groups]]
    afterwards = [copy.run(BRACKET_NOW, group) for group in groups[:2]]
    assert [told["z"] for told in together + afterwards] == [1.0] * 6
    assert [told["loaded"] for told in afterwards] == [1, 1]
    assert copy.entries("apply") == 2


@pytest.mark.slow
def test_process_killed_while_it_compiles_leaves_nothing_behind(copy):
    process = copy.start(BRACKET + "print(flush=True)\nbracket('se3')")
    process.stdout.readline()
    time.sleep(0.3)
    process.kill()
    process.communicate()
    assert copy.run(BRACKET_NOW, "se3")["z"] == 1.0


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


@pytest.mark.long  # two processes that compile; other widths: test_bits_do_not_depend_on_lanes
def test_lierb_lanes_sets_the_width_and_changes_no_bit(copy):
    runs = {lanes: copy.run(BATCH, LIERB_LANES=str(lanes)) for lanes in (1, 4)}
    for lanes, told in runs.items():
        assert told["lanes"] == lanes
        assert told["columns"] == runs[1]["columns"], lanes
    # one cache for all of them: a process with another L must not find the first one's code
    assert copy.run(BATCH, LIERB_LANES="4") == runs[4]


@pytest.mark.slow
@pytest.mark.parametrize("lanes", long_but(["3", "16", "-1", "four"], "3", "four"))
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


@pytest.mark.slow  # its copy has to compile before
def test_warm_process_imports_no_package_that_it_does_not_use(warm):
    out, err = warm.start(IMPORTED).communicate(timeout=60)
    told, imported = map(json.loads, out.splitlines())
    assert told["loaded"] == 1, err
    assert imported == []


# ---------------------------------------------------------------- functions of the user's

PUSH = """
import json
import lierb
from lierb.kernels.loops.blocks import integrate_blocks

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
stats = integrate_blocks.stats
print(json.dumps({{
    "v": result.summary["v"][0].as_py(),
    "loaded": sum(stats.cache_hits.values()),
    "compiled": sum(stats.cache_misses.values()),
}}))
"""


def push(scale=1.0, twice="2.0 * x", branch="pass"):
    return PUSH.format(scale=scale, twice=twice, branch=branch)


@pytest.mark.slow  # several processes, most of which compile
@pytest.mark.parametrize(
    "branch",
    [
        pytest.param("pass", id="packs", marks=pytest.mark.long),
        pytest.param("if v[0] > 100.0: t = 0.0", id="bodies"),
    ],
)
@pytest.mark.parametrize(
    ("change", "v"),
    [
        pytest.param({"twice": "3.0 * x"}, [2.0, 6.0, 0.0], id="helper"),
        pytest.param({"scale": 2.0}, [4.0, 4.0, 0.0], id="global", marks=pytest.mark.long),
    ],
)
def test_function_of_the_user_comes_from_the_cache_until_it_is_edited(copy, branch, change, v):
    quiet = {"PYTHONWARNINGS": "ignore"}  # of one that runs body by body
    first = copy.run(push(branch=branch), **quiet)
    assert (first["compiled"], first["loaded"], first["v"]) == (1, 0, [2.0, 4.0, 0.0])
    edited = copy.run(push(branch=branch, **change), **quiet)
    assert (edited["compiled"], edited["v"]) == (1, v)
    back = copy.run(push(branch=branch), **quiet)
    assert (back["compiled"], back["loaded"], back["v"]) == (0, 1, [2.0, 4.0, 0.0])
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
    """Requirements for reading the cache's files."""
    imported = set()
    for path in folder.rglob("*.nbc"):
        content = path.read_bytes()[sealed.DIGEST_SIZE :]
        recorder = Recorder(io.BytesIO(content.partition(b"\0")[2]))
        recorder.load()
        imported |= recorder.packages
    assert "numba" in imported
    return imported


SPRING = """
import lierb, settings

@lierb.wrench
def spring(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (0.0, 0.0, settings.K)
"""
SPRING += NOW.replace("gravity=", "forces=spring(), gravity=")


@pytest.mark.long  # two processes, one of which compiles
def test_function_of_the_user_leaves_nothing_of_its_own_in_the_cache(warm):
    copy = warm
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
class Times(Tag):
    factor: float


def times(tag, x):
    return tag.factor * x


kernel(times)


def product(tag, x):
    return times(tag, x)


def computed(factor):
    """factor · 2 by a new dispatcher, as a new process has it, and whether that was loaded."""
    dispatcher = cached()(product)
    value = compiled(dispatcher, Times(factor), 2.0)(Times(factor), 2.0)
    return value, bool(dispatcher.stats.cache_hits)


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
    "cut": lambda *files: cut(100, *files),
    "empty": lambda *files: cut(0, *files),
    "a bit wrong": lambda *files: [flip_a_bit(file) for file in files],
    "exchanged": lambda *files: exchange(*files),
    "something else": lambda *files: [file.write_bytes(b"no code at all") for file in files],
    "an honest digest of nonsense": lambda *files: [
        file.write_bytes(signed(b"x")) for file in files
    ],
    "gone": lambda *files: [file.unlink() for file in files],
    "folders": lambda *files: [(file.unlink(), file.mkdir()) for file in files],
}


def signed(content):
    return hashlib.sha256(content).digest() + content


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(disk_cache, "_has_warned", False)
    return tmp_path / "cache"


@pytest.fixture
def two_files(own_cache):
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]
    return sorted(own_cache.rglob("*.nbc"))


@pytest.mark.parametrize("name", sorted(DAMAGES.keys() - {"folders"}))
def test_damaged_file_is_compiled_anew_and_replaced(two_files, name):
    DAMAGES[name](*two_files)
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]


def test_folder_in_the_place_of_a_file_costs_a_warning(two_files):
    DAMAGES["folders"](*two_files)
    with pytest.warns(RuntimeWarning, match="compiled code cannot be kept"):
        assert computed(3.0) == (6.0, False)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_pipe_in_the_place_of_a_file_is_not_waited_for(two_files):
    for file in two_files:
        file.unlink()
        os.mkfifo(file)
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, True), (10.0, True)]


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_full_disk_costs_a_warning_and_leaves_nothing_unfinished(own_cache, monkeypatch):
    monkeypatch.setattr(Path, "replace", full)
    with pytest.warns(RuntimeWarning, match=r"kept \(.*: No space left on device\)") as told:
        assert [computed(factor) for factor in (3.0, 5.0)] == [(6.0, False), (10.0, False)]
    assert len(told) == 1
    assert not [path for path in own_cache.rglob("*") if path.is_file()]


def test_folder_that_cannot_be_made_costs_a_warning(own_cache):
    own_cache.write_text("a file, where the folder should be")
    with pytest.warns(RuntimeWarning, match="set NUMBA_CACHE_DIR to a folder that can be written"):
        assert computed(3.0) == (6.0, False)
    assert lierb.info()["cache"]["folder"] is None


def test_without_a_folder_beside_the_sources_the_users_own_is_taken(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    beside = InTreeCacheLocator(product, __file__)
    monkeypatch.setattr(InTreeCacheLocator, "get_cache_path", lambda _: __file__)  # a file
    assert [computed(11.0), computed(11.0)] == [(22.0, False), (22.0, True)]
    assert list(tmp_path.rglob("test_cache.product-*.nbc"))
    monkeypatch.undo()
    assert not list(Path(beside.get_cache_path()).glob("test_cache.product-*"))


def test_sources_that_were_edited_leave_no_code_behind(two_files, monkeypatch):
    monkeypatch.setattr(disk_cache, "source_stamp", lambda *_: "another")
    assert computed(3.0) == (6.0, False)
    (left,) = two_files[0].parent.iterdir()
    assert "-another-" in left.name


def test_code_used_last_stays_when_there_is_too_much(two_files, monkeypatch):
    first, second = two_files
    os.utime(first, (1.0, 1.0))
    monkeypatch.setattr(disk_cache, "MOST_BYTES", 2 * first.stat().st_size + 100)
    assert computed(7.0) == (14.0, False)
    assert not first.exists()
    assert second.exists()


def test_file_left_unfinished_is_deleted_once_it_is_old(two_files):
    old, new = (file.with_name(f".{file.stem}.0123abcd.nbc.unfinished") for file in two_files)
    foreign = old.with_name("thesis.unfinished")
    for file in (old, new, foreign):
        file.write_text("half")
    for file in (old, foreign):
        os.utime(file, (1.0, 1.0))
    assert computed(7.0) == (14.0, False)
    assert not old.exists()
    assert new.exists()
    assert foreign.exists()


def test_clearing_deletes_code_of_every_version_and_nothing_else(two_files):
    two_files[0].rename(two_files[0].with_name("test_cache.product-0123-4567.nbc"))
    foreign = two_files[0].with_name("other.function-1.py311.1.nbc")
    foreign.write_text("of another package")
    trees = sealed.folders_of(stamp.described)[0] / stamp.FILE
    trees.parent.mkdir(exist_ok=True)
    trees.write_bytes(bytes(1001))
    cleared = disk_cache.clear()
    assert len(cleared) == 3  # the syntax trees are counted, too
    assert min(cleared.values()) > 1000
    assert not trees.exists()
    assert list(foreign.parent.iterdir()) == [foreign]
    assert disk_cache.clear() == {}


def doubled(tag, x):
    return x + x


def sized(tag, x):
    return x.size


def test_code_is_found_by_its_tag_and_its_arguments_types():
    dispatcher, tag = cached()(doubled), Times(1.0)
    values = [compiled(dispatcher, tag, x)(tag, x) for x in (3.0, 3, 3.0)]
    assert list(map(type, values)) == [float, int, float]
    dispatcher = cached()(sized)  # for no code that is kept makes an array
    rows = [np.ones((2, 2)), np.ones((2, 1)), np.ones((2, 2), order="F"), np.ones(2)]
    entered = [entries.entry_of(dispatcher, tag, row) for row in rows]
    assert entered[0] == entered[1]  # of several kinds, and one type
    assert len(set(entered)) == 3


# ---------------------------------------------------------------- Ctrl-C


@pytest.mark.usefixtures("own_cache")
def test_code_that_two_calls_wait_for_is_entered_once():
    key = cached()(product), Times(13.0), float
    for _ in range(2):  # the wait for the first one was interrupted
        entries._enter(key, (numba.typeof(key[1]), numba.float64))


INTERRUPTED = """
import signal, sys, time, threading
import numpy as np
import lierb

class Alarm(Exception):
    pass

def alarm(number, frame):
    raise Alarm

signal.signal(signal.SIGALRM, alarm)
signal.signal(signal.SIGINT, signal.default_int_handler)

def compute():
    turn = lierb.lie.so3.exp([[0.0, 0.0, np.pi / 2]])
    twice = lierb.lie.so3.ad([[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return np.round([turn[0, 1, 0], twice[0, 2]], 12).tolist()

kind, after = sys.argv[1], float(sys.argv[2])
outcome = "result"
try:
    signal.setitimer(signal.ITIMER_REAL, after)
    if kind == "SIGINT":
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    compute()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
except (KeyboardInterrupt, Alarm) as error:
    outcome = type(error).__name__
print(json.dumps([outcome, compute()]))
"""
INTERRUPTED = "import json\n" + INTERRUPTED


@pytest.mark.slow  # each compiles two functions
@pytest.mark.parametrize("kind", ["SIGINT", pytest.param("SIGALRM", marks=pytest.mark.long)])
@pytest.mark.parametrize("after", long_but([0.02, 0.1, 0.4, 0.7], 0.1, 0.7))
def test_interrupted_compilation_leaves_the_next_call_right(copy, kind, after):
    if not hasattr(signal, "setitimer"):
        pytest.skip("no timers of signals here")
    outcome, values = copy.run(INTERRUPTED, kind, str(after))
    assert outcome in {"result", {"SIGINT": "KeyboardInterrupt", "SIGALRM": "Alarm"}[kind]}
    assert values == [1.0, 1.0]

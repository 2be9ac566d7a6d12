"""The stamp of compiled code: of what it does, and not of how that looks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numba
import pytest

import lierb
from lierb.compiler import sealed, stamp
from lierb.compiler.stamp import described, parts, source_stamp
from lierb.compiler.tags import Tag, TagType
from lierb.kernels.functions.fingerprint import modules_named
from lierb.kernels.loops import blocks as driver
from lierb.kernels.systems import plan, scheme

DRIVER = driver.__name__

FORMULA = '''"""A module."""

from lierb.kernels.numbers.arithmetic import fma, sqrt

LIMITS = (1.0, 2)


class Sphere:
    """A body."""

    radius: float = 1.0

    @property
    def size(self):
        """4π r²/3."""
        return fma(self.radius, 4.0 / 3.0, 0.0)


def norm(x, y=0.0):
    # Pythagoras
    for side in (x, y):
        """No docstring, and no code."""
    total = x * x + y * y
    return sqrt(total)
'''
LOOKS = {
    "a comment": ("# Pythagoras", "# Euclid, I.47"),
    "a comment less": ("    # Pythagoras\n", ""),
    "a comment after code": ("y * y", "y * y  # a sum"),
    "the module's docstring": ('"""A module."""', '"""A module of formulas.\n\nAt length.\n"""'),
    "no docstring": ('"""A module."""\n', ""),
    "a class's docstring": ("A body.", "A ball."),
    "a function's docstring": ("4π r²/3.", "Its surface."),
    "a docstring in a loop": ("No docstring, and no code.", "None."),
    "a new docstring": ("y=0.0):\n", 'y=0.0):\n    """Length of (x, y)."""\n'),
    "an empty line": ("\ndef norm", "\n\ndef norm"),
    "a broken line": ("x * x + y * y", "(\n        x * x\n        + y * y\n    )"),
    "spaces": ("x * x", "x*x"),
    "digits that say the same": ("4.0 / 3.0", "4. / 3.00"),
}
EDITS = {
    "an operator": ("x * x + y", "x * x - y"),
    "the order of operands": ("x * x + y * y", "y * y + x * x"),
    "a bracket": ("x * x + y * y", "x * (x + y) * y"),
    "a number": ("4.0 / 3.0", "4.0 / 3.1"),
    "a number's type": ("(1.0, 2)", "(1.0, 2.0)"),
    "a truth for a number": ("(1.0, 2)", "(True, 2)"),
    "a zero's sign": ("3.0, 0.0)", "3.0, -0.0)"),
    "a text": ('LIMITS = (1.0, 2)', 'LIMITS = ("1.0", 2)'),
    "a default": ("y=0.0", "y=1.0"),
    "a field's default": ("float = 1.0", "float = 2.0"),
    "a field's type": ("radius: float", "radius: int"),
    "a decorator": ("    @property\n", ""),
    "a name": ("def norm(", "def length("),
    "a statement more": ("    return sqrt", "    total = total\n    return sqrt"),
    "a statement less": ("    total = x * x + y * y\n", ""),
    "where a statement belongs": ("    total = x", "        total = x"),
    "what is imported": ("fma, sqrt", "fma"),
    "where it is imported from": ("numbers.arithmetic", "numbers.dual"),
}  # fmt: skip


def digest(text):
    return described(text.encode())[0]


def edited(old, new):
    assert FORMULA.count(old) == 1, old
    return FORMULA.replace(old, new)


@pytest.mark.parametrize("name", LOOKS)
def test_looks_keep_the_digest(name):
    assert digest(edited(*LOOKS[name])) == digest(FORMULA)


@pytest.mark.parametrize("name", EDITS)
def test_edits_change_the_digest(name):
    assert digest(edited(*EDITS[name])) != digest(FORMULA)


def test_digests_of_edits_differ_from_each_other():
    assert len({digest(edited(*edit)) for edit in EDITS.values()}) == len(EDITS)


# ---------------------------------------------------------------- what code is made of

PACKAGE = {
    "lierb": "from lierb.api import integrate",
    "lierb.api": "from lierb.steps import driver",
    "lierb.steps": "",
    "lierb.steps.driver": "from lierb.steps.deep import rule\nimport lierb.forces\nimport numpy",
    "lierb.steps.deep": "ORDER = 4",
    "lierb.steps.deep.rule": "def rule():\n    from lierb.tables import TABLE\n    return TABLE",
    "lierb.steps.other": "from lierb.steps.driver import step",
    "lierb.forces": "import math",
    "lierb.tables": "TABLE = 1",
    "lierb.report": "TEXT = 2",
}
MADE_OF = {"lierb.steps", "lierb.steps.driver", "lierb.steps.deep", "lierb.steps.deep.rule",
           "lierb.forces", "lierb.tables"}  # fmt: skip


@pytest.fixture
def package(monkeypatch):
    """Function that returns the modules of which PACKAGE, edited, is made."""
    monkeypatch.setattr(stamp, "_trees", {})
    monkeypatch.setattr(stamp, "_remember", lambda: None)

    def found(root="lierb.steps.driver", **edits):
        edits = {f"lierb.{name}".replace("__", "."): text for name, text in edits.items()}
        sources = {name: text.encode() for name, text in (PACKAGE | edits).items()}
        monkeypatch.setattr(stamp, "SOURCES", sources)
        stamp._tree_of.cache_clear()
        return parts(root)

    yield found
    stamp._tree_of.cache_clear()


def test_code_is_made_of_all_that_its_module_imports(package):
    found = package()
    assert found.keys() == MADE_OF
    assert package("lierb.report").keys() == {"lierb.report"}
    assert package(tables="TABLE = 1  # one") == found


@pytest.mark.parametrize("module", sorted(MADE_OF))
def test_an_edit_anywhere_in_it_is_seen(package, module):
    name = module.removeprefix("lierb.").replace(".", "__")
    before, after = package(), package(**{name: PACKAGE[module] + "\nEDITED = True"})
    assert {each for each in before if before[each] != after[each]} == {module}


def test_a_file_that_comes_to_be_imported_is_part_of_it(package):
    assert "lierb.new" not in package(new="X = 1")
    assert "lierb.new" in package(new="X = 1", tables="TABLE = 1\nfrom lierb.new import X")
    assert "lierb.new" in package(new="X = 1", tables="TABLE = 1\nfrom lierb import new")


@pytest.mark.parametrize(
    "text",
    ["from lierb import integrate", "import lierb"],
)
def test_what_lierb_itself_has_is_what_lierb_imports(package, text):
    assert {"lierb", "lierb.api"} <= package(tables=f"TABLE = 1\n{text}").keys()


@pytest.mark.parametrize(
    "text",
    ["import importlib", "from importlib import import_module", "import pkgutil",
     "from . import report", "from .report import TEXT", "from importlib.util import find_spec"],
)  # fmt: skip
def test_what_may_import_anything_is_made_of_everything(package, text):
    assert package(tables=f"TABLE = 1\n{text}").keys() == PACKAGE.keys()


def test_what_was_typed_at_a_prompt_is_made_of_everything(package):
    assert package("prompt").keys() == {"prompt", *PACKAGE}


def test_kernels_are_made_of_what_they_import_and_no_more():
    found = parts(DRIVER).keys()
    rooms = ("numbers", "groups", "mechanics", "stepping", "functions")
    assert all(any(f"lierb.kernels.{room}." in name for name in found) for room in rooms)
    assert {"lierb.kernels.tracing.trace", "lierb.kernels.mechanics.constraints"} <= found
    assert all(name.startswith(("lierb.kernels", "lierb.compiler")) for name in found)
    assert found <= stamp.SOURCES.keys()  # none by a name that is made at run time
    lie = parts("lierb.kernels.groups.lie_functions").keys()
    assert "lierb.kernels.groups.se3" in lie
    assert "lierb.kernels.mechanics.constraints" not in lie


def test_sources_are_those_of_the_whole_package():
    files = Path(lierb.__file__).parent.rglob("*.py")
    assert len(stamp.SOURCES) == len(list(files))
    assert stamp.SOURCES[DRIVER] == Path(driver.__file__).read_bytes()


# ---------------------------------------------------------------- tags


@dataclass(frozen=True)
class Inner:
    number: float = 1.0


@dataclass(frozen=True)
class Outer(Tag):
    members: tuple = ()


def stamp_of(tag):
    return re.fullmatch(r"\w+<(\w{16}),\w{16}>", TagType(tag).name)[1]


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled with the JIT off")
def test_stamp_of_a_tag_is_of_the_modules_of_all_its_classes():
    assert stamp_of(Outer()) == source_stamp(__name__)
    assert stamp_of(Outer((1.0, (Inner(),)))) == source_stamp(__name__)
    within = Outer(
        (
            (
                plan.Plan(
                    lanes=1,
                    rows=(),
                    cspace="SE3",
                    update="local",
                    method=scheme.StagedScheme(stages=(), weights=()),
                    multipliers=False,
                ),
            ),
        )
    )
    modules = sorted((__name__, plan.Plan.__module__, scheme.StagedScheme.__module__))
    assert stamp_of(within) == source_stamp(*modules)


def limited(x):
    return twice(lierb.clip(x, 0.0, 1.0))


def twice(x, by=(lierb.log,)):
    return lierb.lie.so3.exp(2.0 * x)


def test_functions_of_the_user_are_made_of_what_they_name_of_lierb():
    vocabulary = "lierb.kernels.functions.vocabulary"
    assert modules_named(limited, set(), []) == {vocabulary, "lierb.lie"}
    assert modules_named(lambda x: x + 1.0, set(), []) == set()
    force = lierb.wrench(lambda t, R, r, omega, v: ((0.0,) * 3, lierb.clip(v, -1.0, 1.0)))()
    assert vocabulary in force.kind.function.modules
    assert stamp_of(Outer((force.kind,))) == source_stamp(
        *sorted({__name__, type(force.kind).__module__, vocabulary,
                 type(force.kind.function).__module__})
    )  # fmt: skip


# ---------------------------------------------------------------- trees that are remembered


VEC = "lierb.kernels.numbers.vec"


@pytest.fixture
def remembered(tmp_path, monkeypatch):
    """The file in which trees are, and what a new process finds a module made of."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def anew():
        monkeypatch.setattr(stamp, "_trees", {})
        for cached in (stamp._recall, stamp._tree_of):
            cached.cache_clear()
        return parts(VEC)

    anew()
    (file,) = tmp_path.rglob(f"*{stamp.SUFFIX}")
    yield file, anew
    for cached in (stamp._recall, stamp._tree_of):
        cached.cache_clear()


def test_trees_are_parsed_once(remembered, monkeypatch):
    _, anew = remembered
    known = parts(VEC)
    monkeypatch.setattr(stamp, "described", None)
    with monkeypatch.context() as patched:
        patched.setattr(sealed, "folders_of", lambda _: [remembered[0].parent])
        assert anew() == known


@pytest.mark.parametrize("content", [b"", b"{}", None])
def test_damaged_trees_are_made_anew(remembered, content):
    file, anew = remembered
    known, whole = parts(VEC), file.read_bytes()
    file.write_bytes(whole.replace(known[VEC].encode(), b"0" * 64) if content is None else content)
    assert anew() == known
    assert file.read_bytes() == whole


def test_trees_of_another_lierb_are_not_asked(remembered):
    file, anew = remembered
    known = parts(VEC)
    sealed.write(file, "another", b'{"0": ["1", []]}')
    assert anew() == known


def test_trees_that_cannot_be_kept_cost_nothing_but_time(remembered):
    file, anew = remembered
    known = parts(VEC)
    file.unlink()
    file.mkdir()
    assert anew() == known

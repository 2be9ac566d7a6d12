"""The site: every public name has its place and an example; docstrings become what Sphinx reads."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

import lierb

DOCS = Path(__file__).parent.parent / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

import docstrings  # noqa: E402

REFERENCE = [page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("reference/*.md"))]
DIRECTIVE = re.compile(
    r"^\.\. (auto)?(\w+):: (lierb[\w.]*)(?:\(\))?\n((?:   :.*\n)*)", re.MULTILINE
)


def _public() -> dict[str, object]:
    """Everything that a user is to find, by its dotted name."""
    names = {f"lierb.{name}": getattr(lierb, name) for name in (*lierb.__all__, *lierb._STUDIES)}
    for module in (lierb.joints, lierb.forces, lierb.noise, lierb.sampling):
        names |= {f"{module.__name__}.{name}": getattr(module, name) for name in module.__all__}
    for module in (lierb.bodies, lierb.errors):
        for name, item in vars(module).items():
            is_own = getattr(item, "__module__", "") == module.__name__ and name[0] != "_"
            is_error = name.endswith(("Error", "Warning"))
            if is_own and (is_error or module is lierb.bodies):
                names[f"{module.__name__}.{name}"] = item
    groups = ("so3", "se3", "so3xr3")
    return names | {f"lierb.lie.{name}": getattr(lierb.lie, name) for name in groups}


def _documented() -> set[str]:
    found = set()
    for _, kind, name, options in DIRECTIVE.findall("\n".join(REFERENCE)):
        found.add(name)
        members = re.search(r":members:(.*)", options)
        if kind == "module" and members:
            module = importlib.import_module(name)
            listed = members[1].replace(",", " ").split() or vars(module)
            found |= {f"{name}.{member}" for member in listed}
    return found


PUBLIC = _public()
WITHOUT_EXAMPLE = {
    "lierb.bodies.from_mesh",  # needs a mesh, and trimesh
    "lierb.sampling.Distribution",  # what all distributions have in common
    "lierb.joints.JOINTS",
    "lierb.TABLEAUS",
}


@pytest.mark.parametrize("name", PUBLIC)
def test_public_name_is_in_the_reference(name):
    assert name in _documented(), (
        f"add it to a page in docs/reference, as `.. autofunction:: {name}`"
    )


@pytest.mark.parametrize("name", [n for n in PUBLIC if n not in WITHOUT_EXAMPLE])
def test_public_name_has_an_example(name):
    """In its docstring or, of a class, in a method's; test_docs.py runs them."""
    item = PUBLIC[name]
    is_error = inspect.isclass(item) and issubclass(item, (Exception, Warning))
    if is_error or isinstance(item, (ModuleType, lierb.joints.JointType)):
        return
    where = item if inspect.isclass(item) or inspect.isroutine(item) else type(item)
    methods = vars(where).values() if inspect.isclass(where) else ()
    texts = [inspect.getdoc(x) or "" for x in (where, *methods)]
    assert any(">>> " in text for text in texts)


def test_a_name_without_an_example_has_none():
    """The list of exceptions does not outlive its reasons."""
    assert PUBLIC.keys() >= WITHOUT_EXAMPLE
    exempt = [PUBLIC[name] for name in WITHOUT_EXAMPLE]
    assert not [x for x in exempt if inspect.isroutine(x) and ">>> " in (inspect.getdoc(x) or "")]


class TestDocstrings:
    def test_arguments_become_definitions(self):
        given = ["mass : number, kg.   com : (3,), m,", "    centre of mass.", "Returns a body."]
        assert docstrings.restructured(given) == [
            "``mass``", "    number, kg.", "",
            "``com``", "    (3,), m,", "    centre of mass.", "",
            "Returns a body.", "",
        ]  # fmt: skip

    def test_prose_keeps_its_words_and_loses_its_markup(self):
        (line, _) = docstrings.restructured(["−c·|u|·u, 2*x, C_ of `d_i*`, ArgumentError."])
        assert line == (r"−c·\|u\|·u, 2\*x, C\_ of `d_i*`, :py:exc:`~lierb.errors.ArgumentError`.")

    def test_examples_stay_as_they_are(self):
        given = [">>> a = {'b : c': 1}", ">>> a", "{'b : c': 1}"]
        assert docstrings.restructured(given) == [*given, ""]

    def test_a_block_of_its_own_is_code(self):
        assert docstrings.restructured(["Say:", "", "    x = f(y)"])[2:4] == [
            ".. code-block:: python", "",
        ]  # fmt: skip

    def test_a_sentence_with_a_colon_is_no_argument(self):
        (line, _) = docstrings.restructured(["Raises what it must: an error."])
        assert line == "Raises what it must: an error."

"""The site: every public name has its place, an example, and a docstring that is true."""

from __future__ import annotations

import importlib
import inspect
import re
import typing
from functools import cached_property
from itertools import chain
from pathlib import Path
from types import ModuleType

import pytest
from documented import entries, sections

import lierb

DOCS = Path(__file__).parent.parent / "docs"
REFERENCE = [page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("reference/*.md"))]
DIRECTIVE = re.compile(
    r"^\.\. (auto)?(\w+):: (lierb[\w.]*)(\(.*\))?\n((?:   :.*\n)*)", re.MULTILINE
)


def _public() -> dict[str, object]:
    """Everything that a user is to find, by its dotted name."""
    names = {f"lierb.{name}": getattr(lierb, name) for name in (*lierb.__all__, *lierb._STUDIES)}
    for module in ("bodies", "errors", "forces", "joints", "lie", "noise", "sampling"):
        face = getattr(lierb, module)
        names |= {f"lierb.{module}.{name}": getattr(face, name) for name in face.__all__}
    return names


def _item(name: str) -> typing.Any:
    """The object of a dotted name; a module may have to be imported first."""
    parent, _, last = name.rpartition(".")
    if not parent:
        return lierb
    holder = _item(parent)
    return getattr(holder, last) if hasattr(holder, last) else importlib.import_module(name)


def _documented() -> dict[str, str]:
    """Every name in the reference, and the signature that it has there, if it is not its own."""
    names: dict[str, str] = {}
    for _, kind, name, signature, options in DIRECTIVE.findall("\n".join(REFERENCE)):
        if kind == "currentmodule":
            continue
        names[name] = signature
        if members := re.search(r":(?:special-)?members:(.*)", options):
            item = _item(name)
            public = [x for x, y in vars(item).items() if x[0] != "_" and inspect.getdoc(y)]
            listed = members[1].replace(",", " ").split() or getattr(item, "__all__", public)
            names |= {f"{name}.{member}": "" for member in listed}
    return names


def _is_error(item: object) -> bool:
    return inspect.isclass(item) and issubclass(item, (Exception, Warning))


PUBLIC = _public()
DOCUMENTED = _documented()
WITHOUT_EXAMPLE = {
    "lierb.bodies.from_mesh",  # needs a mesh, and trimesh
    "lierb.sampling.Distribution",  # what all distributions have in common
    "lierb.joints.JOINTS",
    "lierb.TABLEAUS",
}


def test_documented_names_of_a_module_are_public():
    """autodoc leaves out, with a warning, what is not in the `__all__` of an automodule."""
    for name in DOCUMENTED:
        holder, _, last = name.rpartition(".")
        if holder in DOCUMENTED and isinstance(module := _item(holder), ModuleType):
            assert last in getattr(module, "__all__", [last]), name


@pytest.mark.parametrize("name", PUBLIC)
def test_public_name_is_in_the_reference(name):
    assert name in DOCUMENTED, f"add it to a page in docs/reference, as `.. autofunction:: {name}`"


@pytest.mark.parametrize("name", [n for n in PUBLIC if n not in WITHOUT_EXAMPLE])
def test_public_name_has_an_example(name):
    """Examples are in its docstring or, for a class, in a method's; test_docs.py runs them."""
    item = PUBLIC[name]
    if _is_error(item) or isinstance(item, (ModuleType, lierb.joints.JointType)):
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


# ---- docstrings --------------------------------------------------------------------------------

FUNCTIONS = [n for n in DOCUMENTED if inspect.isfunction(_item(n)) or inspect.ismethod(_item(n))]
CLASSES = [n for n in DOCUMENTED if inspect.isclass(_item(n)) and not _is_error(_item(n))]
WITH_SIGNATURE = FUNCTIONS + CLASSES
EMPTY = inspect.Parameter.empty
ODD_OPENINGS = {"Of", "What", "Whether", "How", "Those", "The same", "That", "Where"}


def _parameters(item: typing.Any) -> dict[str, bool]:
    """Map each parameter, with its stars, to whether it is optional.

    Overloads say more than the function that they are of, whose order counts.
    """
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    signatures = [
        {stars.get(p.kind, "") + p.name: p for p in inspect.signature(x).parameters.values()}
        for x in typing.get_overloads(item) or (item,)
    ]
    first = [name for name in inspect.signature(item).parameters if name in signatures[-1]]
    names = sorted(dict.fromkeys([*first, *chain(*signatures)]), key=lambda name: name[:1] == "*")
    return {
        name: name[:1] != "*"
        and any(name not in each or each[name].default is not EMPTY for each in signatures)
        for name in names
        if name != "self"
    }


@pytest.mark.parametrize("name", WITH_SIGNATURE)
def test_documented_parameters_are_the_real_ones(name):
    """Names, order, which are optional; each has a type and a description.

    A class whose signature the reference leaves out lists attributes instead.
    """
    item = _item(name)
    text = sections(inspect.getdoc(item) or "")
    if DOCUMENTED[name] == "()":
        assert "Parameters" not in text
        listed = entries(text.get("Attributes", ""))
        known = {
            *dir(item),
            *inspect.signature(item.__init__).parameters,
            *inspect.get_annotations(item),
        }
        assert known >= listed.keys()
    else:
        assert "Attributes" not in text
        listed, real = entries(text.get("Parameters", "")), _parameters(item)
        assert list(listed) == list(real)
        shown = re.findall(r"(\*{0,2}[a-z]\w*)(?:=[^,)]*)?[,)]", DOCUMENTED[name])
        assert shown in ([], list(real))
        for parameter, (kind, _) in listed.items():
            assert kind.endswith(", optional") == real[parameter], parameter
    assert all(kind and said for kind, said in listed.values()), listed


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_returned_is_documented(name):
    item = _item(name)
    text = sections(inspect.getdoc(item) or "")
    returns = inspect.signature(item).return_annotation not in ("None", None)
    assert ("Returns" in text) == returns
    assert all(said for _, said in entries(text.get("Returns", "")).values())


@pytest.mark.parametrize("name", WITH_SIGNATURE)
def test_named_errors_exist(name):
    text = sections(inspect.getdoc(_item(name)) or "")
    named = entries(text.get("Raises", "")) | entries(text.get("Warns", ""))
    for error, (_, said) in named.items():
        assert said
        assert f"lierb.errors.{error}" in DOCUMENTED or error in (
            "OSError", "TypeError", "ValueError",
        )  # fmt: skip


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_docstring_opens_with_its_subject(name):
    """And has its arguments in sections, in no form of its own."""
    holder, _, last = name.rpartition(".")
    item = inspect.getattr_static(_item(holder), last, None) if holder != "lierb" else _item(name)
    if isinstance(item, (dict, lierb.joints.JointType)):
        return
    before = sections(inspect.getdoc(item or _item(name)) or "")[""]
    if isinstance(item, (property, cached_property)):  # `x: y` would be its type
        assert ": " not in before.partition("\n")[0]
    assert before.strip()
    assert not re.match(rf"({'|'.join(ODD_OPENINGS)})\b", before)
    assert not re.search(r"^[a-z]\w*(, \w+)* : ", before, re.MULTILINE), before


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_docstring_has_no_substitution(name):
    """In reStructuredText |x| names a substitution: `make docs` fails on an unknown one."""
    assert not re.findall(r"(?<![\w`|])\|[^\s|][^|]*\|", inspect.getdoc(_item(name)) or "")

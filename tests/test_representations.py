"""Representations of objects at a prompt and in a notebook; completions of `lierb.`."""

from __future__ import annotations

from html.parser import HTMLParser
from rlcompleter import Completer

import numpy as np
import pytest
from studies import study

import lierb
from lierb import joints
from lierb.studies.storage.store import Store
from lierb.support import representations

BODY = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
JOINT = joints.spherical(body_point=(-0.15, 0.0375, 0.0))


class Table(HTMLParser):
    """The texts of a page, and its cells row by row."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data):
        self.text += data
        if self.tags[-1] in ("th", "td"):
            self.rows[-1][-1] += data


def lines(thing):
    """Label → text, as its repr has them; the texts' own lines joined."""
    found = {}
    for line in repr(thing).splitlines()[1:]:
        label, _, text = line.strip().partition("  ")
        found[label] = text.strip()
    return found


def things(tmp_path):
    problem = lierb.Problem(BODY, JOINT, (0.0, 0.0, -9.81), forces=lierb.forces.drag(linear=0.1))
    dataset = lierb.run(study(sample={"n": 3}), tmp_path)
    return {"problem": problem, "joint": JOINT, "body": BODY, "study": study(), "data": dataset}


def test_html_has_what_text_has(tmp_path):
    for name, thing in things(tmp_path).items():
        title, rows = thing._representation()
        table = Table(thing._repr_html_())
        assert repr(thing).splitlines()[0] == title, name
        assert table.rows == [list(row) for row in rows], name
        assert title in table.text
        for label, text in rows:
            assert label in repr(thing), name
            for line in text.splitlines():
                assert line in repr(thing), name
        assert " at 0x" not in repr(thing)


def test_body_says_its_numbers():
    assert lines(BODY) == {
        "mass": "6.075 kg", "inertia": "(0.0126563, 0.0468281, 0.0569531) kg m², principal",
    }  # fmt: skip
    tilted = np.array(((2.0, 0.1, 0.0), (0.1, 2.0, 0.0), (0.0, 0.0, 2.0)))
    batch = lierb.Body([1.0, 3.0, 2.0], tilted[None], com=0.1 * np.eye(3))
    assert "3 of them" in repr(batch)
    assert lines(batch) == {
        "mass": "1 … 3 kg", "inertia": "((2, 0.1, 0), (0.1, 2, 0), (0, 0, 2)) kg m²",
        "com": "one for each of 3, m",
    }  # fmt: skip


@pytest.mark.parametrize("name", joints.JOINTS)
def test_joint_says_its_rows_and_frames(name):
    entry = joints.JOINTS[name]
    given = {"pitch": 0.25, "length": 0.75}
    options = {key: value for key, value in given.items() if key in entry.options}
    held = entry((0.5, 0.0, 0.0), (0.0, 2.0, 0.0), axis=(0.0, 1.0, 0.0), **options)
    assert repr(held).startswith(f"{name} joint: {entry.summary}\n")
    said = lines(held)
    assert said["rows"] == (" ".join(map(str, entry.rows)) or "none")
    assert said["on the body"].startswith("(0.5, 0, 0) m")
    assert said["on the body"].endswith("e₃ (0, 1, 0)")
    assert said["on the ground"].startswith("(0, 2, 0) m")
    assert ("motions" in said) == bool(entry.subgroup)
    assert ("0.25 m/rad" in repr(held)) == ("pitch" in entry.options)
    assert ("0.75 m" in repr(held)) == ("length" in entry.options)


def test_problem_says_how_many_bodies():
    batch = lierb.Problem(lierb.Body(np.linspace(1.0, 2.0, 7), np.eye(3)), JOINT)
    assert "7 bodies on a spherical joint" in repr(batch)
    assert "1 body on a spherical joint" in repr(lierb.Problem(BODY, JOINT))


def test_study_says_what_it_samples():
    text = repr(study())
    assert str(study()) == text
    assert "'study': 50 bodies on a spherical joint" in text
    assert "body.mass: Uniform(" in text
    assert "SE3, SO3xR3 × RK4 × dt = 0.001, 0.002 s" in text
    assert "8 bodies" in text


def test_study_of_another_kind_of_mistake_still_has_a_repr():
    unchecked = study().model_copy(update={"sample": study().sample.model_copy(update={"n": None})})
    assert "failed" in repr(unchecked)


def test_dataset_says_what_is_in_the_folder(tmp_path):
    dataset = lierb.run(study(), tmp_path / "out")
    said = lines(dataset)
    assert str(tmp_path / "out") in repr(dataset)
    assert said["trajectories"] == "200"
    assert said["parts"] == "28 of 28"
    assert "failed" not in said
    (tmp_path / "out" / "summary" / f"part-{next(iter(dataset.parts))}.parquet").unlink()
    left = Store(tmp_path / "out")
    left.read()
    left.drop_damaged()
    dataset.read()
    assert lines(dataset)["parts"] == "27 of 28; resume=True does the rest"
    assert lines(dataset)["trajectories"] == "192"


def test_names_of_the_users_are_escaped():
    name = "<script>alert('&')</script>"
    named = joints.from_rows(["d1"], name=name)
    for thing in (named, study().model_copy(update={"name": name}), lierb.Problem(BODY, named)):
        table = Table(thing._repr_html_())
        assert "script" not in table.tags
        assert "<script>alert(" in table.text


def test_failures_stand_out():
    page = representations.as_html("a run", [("failed", "2 of 5"), ("history", "none")])
    assert page.count(representations.LOUD) == 2  # label and text


@pytest.mark.parametrize(
    ("array", "item_axes", "text"),
    [
        (np.array(2.0), 0, "2 m"),
        (np.array([2.0]), 0, "2 m"),
        (np.array([2.0, -1.0]), 0, "-1 … 2 m"),
        (np.array([-0.0, 1e-7]), 1, "(0, 1e-07) m"),
        (np.eye(2), 1, "one for each of 2, m"),
    ],
)
def test_quantity_is_a_value_or_a_range(array, item_axes, text):
    assert representations.quantity(array, "m", item_axes) == text


# ---- completion --------------------------------------------------------------------------------

STUDIES = {"Study", "integrate_batches", "run", "study_of"}


def public():
    return {name for name in dir(lierb) if not name.startswith("__")}


def test_dir_is_what_is_public():
    assert public() == {*lierb.__all__, *STUDIES}
    for name in public():
        assert getattr(lierb, name) is not None


def test_completion_shows_what_is_public():
    completer = Completer({"lierb": lierb})
    found = set()
    while match := completer.complete("lierb.", len(found)):
        found.add(match)
    assert {name.removeprefix("lierb.").rstrip("()") for name in found} == public()


def test_dir_leaves_out_what_cannot_be_used(monkeypatch):
    """Completers and inspect.getmembers ask for every name that `dir` has."""
    monkeypatch.setattr(lierb, "is_installed", lambda extra: extra != "study")
    assert public() == set(lierb.__all__)

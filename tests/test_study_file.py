"""Contents of a study file, and the errors for everything else."""

from __future__ import annotations

import json
import os
import threading
import tomllib
import warnings
from datetime import date
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from faults.study_files import EVERY_KEY, EVERY_KEY_OF_TIME, assert_survives, campaign
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from studies import TEXT, sorted_rows, study, tables

import lierb
from lierb.errors import StudyError
from lierb.sampling import Constant, Direction, LogNormal, Normal, TruncatedNormal, Values
from lierb.sampling.distribution import Distribution
from lierb.sampling.distributions import DISTRIBUTIONS, Uniform
from lierb.studies.dataset import Dataset
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import DEEPEST, LONGEST_STUDY, plain


def load(tmp_path, text):
    (tmp_path / "s.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    return Study.load(tmp_path / "s.toml")


def test_hostile_files_are_studies_or_errors():
    """A campaign runs many more: `python -m faults`."""
    outcomes = campaign(150, seed=0)
    assert outcomes.keys() == {"taken", "refused"}


@pytest.mark.parametrize("text", [EVERY_KEY, EVERY_KEY_OF_TIME], ids=["grid", "time"])
def test_the_file_with_every_key_is_a_study(text):
    assert_survives(Study.of(tomllib.loads(text)))


DEEP = "[" * 5000
FILES = {
    "lists": (f"x = 1\n[body]\nmass = {DEEP}", r"s\.toml:3: body\.mass: lists or tables nested to"),
    "tables": ("x = " + "{a = " * 5000, r"s\.toml:1: x: lists or tables nested too deeply"),
    "closed": (
        f"[body]\nmass = {'[' * 99}{']' * 99}",
        r"s\.toml:2: body\.mass\.0\.0: nested too d",
    ),
    "key": ("[body]\n" + "a." * 100_000 + "a = 1", r"s\.toml:2: .*: a key of 32\+ parts"),
    "quoted key": ('"a". ' * 50_000 + "a = 1", r"s\.toml:1: .*: a key of 32\+ parts"),
    "key in a table": ("x = {" + "a . " * 50_000 + "a = 1}", r"s\.toml:1: x: a key of 32\+ parts"),
    "digits": (TEXT.replace("6.075", "1" * 401), r"s\.toml:2: body\.mass: a whole number of more"),
    "many digits": (TEXT.replace("6.075", "1" * 5000), r"s\.toml:2: body\.mass: a whole number of"),
    "hexadecimal": (TEXT.replace("6.075", f"0x{'f' * 5000}"), r"s\.toml:2: body\.mass: a whole nu"),
    "date": (
        TEXT.replace("6.075", "1979-05-27"),
        r"s\.toml:2: body\.mass: is a date; expected a n",
    ),
    "time": (
        TEXT.replace("6.075", "07:32:00"),
        r"s\.toml:2: body\.mass: is a time; expected a num",
    ),
    "flag": (TEXT.replace("6.075", "true"), r"s\.toml:2: body\.mass: is True; a study has numbers"),
    "text": (TEXT.replace("6.075", '"6.075"'), r"s\.toml:2: body\.mass: input should be a valid n"),
    "text for n": (TEXT.replace("n = 50", 'n = "50"'), r"s\.toml:17: sample\.n: input should be a"),
    "nan": (TEXT.replace("6.075", "nan"), r"s\.toml:2: body\.mass: input should be a finite numb"),
    "inf": (
        TEXT.replace("t_end = 0.05", "t_end = inf"),
        r"s\.toml:38: integrate\.t_end: input sho",
    ),
    "too large": (
        TEXT.replace("low = 0.0", "low = -1e308"),
        r"low is -1e\+308; expected numbers up",
    ),
    "long text": (TEXT.replace('"drag"', f'"{"d" * 10**5}"'), "type: text of 100000 characters"),
    "nothing there": (
        TEXT.replace('"drag"', '"dr\\u0000g"'),
        r"type: text with the character '\\x0",
    ),
    "bell": (TEXT.replace('"drag"', '"dr\\u0007g"'), r"type: text with the character '\\x07'"),
    "twice": (
        TEXT.replace("n = 50", "n = 50\nn = 51"),
        r"s\.toml: Cannot overwrite a value \(at li",
    ),
    "table for one": (
        TEXT.replace("[sample]", "[[sample]]"),
        r"s\.toml:16: sample: input should be a table, got",
    ),
    "a table more": (
        TEXT.replace("[output]", "[[output]]"),
        r"s\.toml:40: output: input should be",
    ),
    "UTF-16": (TEXT.encode("utf-16"), r"s\.toml:1: byte 0 is not UTF-8 .*save the file as UTF-8"),
    "empty": ("", r"s\.toml: integrate: is missing"),
    "no text": (b"\x00\xff" * 100, r"s\.toml:1: byte 1 is not UTF-8"),
    "large": (b"#" * (LONGEST_STUDY + 1), r"s\.toml is larger than 4 MiB, the most for a study"),
    "the same dt": (
        TEXT.replace("2e-3", "0.001"),
        r"s\.toml:37: integrate\.dt: 0\.001 is given tw",
    ),
    "settings": (
        TEXT.replace("[1e-3, 2e-3]", str([1e-5 * n for n in range(1, 600)])),
        r"s\.toml:35: integrate: .* make 1198 settings; expected at most 1000",
    ),
    "forces": (
        TEXT.replace("[sample]", '[[problem.forces]]\ntype = "drag"\n' * 100 + "[sample]"),
        r"s\.toml:12: problem\.forces: list should have at most 100 items",
    ),
    "of a force": (TEXT.replace("linear = 0.1", "linaer = 1"), r"s\.toml:14: forces\.drag\.linaer"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_no_study_is_told_with_line_and_key(name, tmp_path):
    text, message = FILES[name]
    with pytest.raises(StudyError, match=message) as caught:
        load(tmp_path, text)
    assert len(str(caught.value)) < 1000


def test_a_folder_is_told(tmp_path):
    with pytest.raises(StudyError, match="is a folder; give the study's file"):
        Study.load(tmp_path)
    with pytest.raises(FileNotFoundError):
        Study.load(tmp_path / "none.toml")


def test_messages_are_bounded(tmp_path):
    many = TEXT.replace("[0.0, 0.0, -9.81]", str(["y"] * 5000))
    many = many.replace("t_end = 0.05", f"t_end = 0.05\nrecord = {[1] * 50}")
    with pytest.raises(StudyError) as caught:
        load(tmp_path, many)
    assert str(caught.value).count("\n") <= 10
    assert "more" in str(caught.value).splitlines()[-1]


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_ends_of_lines_do_not_matter(ends, tmp_path):
    assert load(tmp_path, TEXT.replace("\n", ends)).digest() == study().digest()


def test_lines_are_those_of_an_editor(tmp_path):
    """U+2028 and a form feed in a comment end no line of TOML."""
    with pytest.raises(StudyError, match=r"s\.toml:3: body\.mass"):
        load(tmp_path, "# \u2028 \u0085\n" + TEXT.replace("6.075", "'x'"))


def test_whole_numbers_may_have_exponents(tmp_path):
    assert load(tmp_path, TEXT.replace("n = 50", "n = 1e6")).sample.n == 1_000_000
    with pytest.raises(StudyError, match=r"sample\.n: .* valid integer, got 1e\+20"):
        load(tmp_path, TEXT.replace("n = 50", "n = 1e20"))  # written out, no file could hold it


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    thread = threading.Thread(target=(tmp_path / "pipe").write_text, args=(TEXT,))
    thread.start()
    assert Study.load(tmp_path / "pipe").digest() == study().digest()
    thread.join()


# ---- from Python -------------------------------------------------------------------------------

ANY_DISTRIBUTION = {
    "normal": Normal((6.28, 3.14, 0.63), 0.5),
    "covariance": Normal(0.0, covariance=np.eye(3)),
    "uniform": Uniform((0.0, 1.0, 2.0), 3),
    "truncated_normal": TruncatedNormal((0.0, 1.0, 2.0), 1.0, low=-1.0),
    "log_normal": LogNormal((1.0, 2.0, 3.0), 0.1),
    "direction": Direction(2),
    "direction, length": Direction(Uniform(1.0, 2.0)),
    "values": Values([(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]),
    "constant": Constant((1.0, 2.0, 3.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", ANY_DISTRIBUTION)
def test_distributions_are_written_as_their_tables(name):
    made = study(sample={"n": 5, "initial": {"omega": ANY_DISTRIBUTION[name]}})
    assert_survives(made)
    u = np.random.default_rng(0).uniform(size=(5, ANY_DISTRIBUTION[name].dimension))
    again = Study.of(tomllib.loads(made.to_toml())).design.quantities["initial.omega"]
    np.testing.assert_array_equal(again.draw(u), ANY_DISTRIBUTION[name].draw(u))


def test_every_distribution_has_a_table():
    written = {plain({"x": d})["x"]["distribution"] for d in ANY_DISTRIBUTION.values()
               if not isinstance(d, Constant)}  # fmt: skip
    assert written | {"rotation"} == DISTRIBUTIONS.keys()


def test_what_python_gives_is_run(tmp_path):
    """Arrays, tuples, NumPy's numbers, a distribution, −0 and None: the same results, and files."""
    plainly = study(sample={"n": np.int32(3), "initial": {"omega": {
        "distribution": "uniform", "low": [0.0, 1.0, 2.0], "high": [1.0, 2.0, 3.0],
    }}}, integrate={"dt": 1e-3})  # fmt: skip
    made = study(
        body={"inertia": np.array((0.0126563, 0.0468281, 0.0569531)), "com": None},
        joint={"body_point": (-0.15, np.float64(0.0375), -0.0)},
        sample={"n": 3.0, "initial": {"omega": Uniform(np.arange(3.0), np.arange(1, 4))}},
        integrate={"dt": np.float64(1e-3), "cspace": ("SE3", "SO3xR3")},
    )
    assert made == plainly
    assert made.digest() == plainly.digest()
    lierb.run(made, tmp_path / "made")
    lierb.run(tmp_path / "made" / "study.toml", tmp_path / "made", resume=True)
    changes = {"sample.n": np.int64(3), "integrate.dt": np.array([1e-3]),
               "sample.initial.omega": Uniform(np.arange(3.0), np.arange(1, 4))}  # fmt: skip
    lierb.run(study(), tmp_path / "changed", changes=changes)
    assert sorted_rows(tmp_path / "made") == sorted_rows(tmp_path / "changed")
    found = Dataset(tmp_path / "changed")
    found.read()
    assert found.changes["integrate.dt"] == [1e-3]


def test_rotations_of_scipy_become_matrices():
    turn = Rotation.from_rotvec((0.4, -1.0, 2.0))
    made = study(
        joint={"type": "free", "body_frame": turn, "body_point": None},
        initial={"rotation": turn},
        sample={"n": 2, "initial": {"rotation": turn}},
    )
    assert_survives(made)
    assert np.shape(made.joint.body_frame) == (4, 4)
    np.testing.assert_array_equal(made.initial.rotation, turn.as_matrix())


class Loud:
    def __array__(self, *_args, **_options):
        raise RuntimeError("no")

    def __repr__(self):
        raise RuntimeError("no")


class Turned:
    def as_matrix(self):
        raise RuntimeError("no")


class Own(Uniform):
    """A distribution of the user's."""


def endless():
    table = {}
    table["again"] = table
    return table


def wide():
    """A list of 10¹² entries in little memory."""
    found = [0.0] * 100
    for _ in range(6):
        found = [found] * 100
    return found


REFUSED = {
    "matrix that raises": (Turned(), "whose as_matrix\\(\\) raised RuntimeError"),
    "duration": (np.timedelta64(1, "s"), "is a timedelta64"),
    "object": (Loud(), "is a Loud"),
    "function": (len, "is a builtin_function"),
    "path": (Path("x"), "is a PosixPath"),
    "bytes": (b"1.0", "is a bytes"),
    "complex": (1j, "is a complex"),
    "decimal": (Decimal(1), "is a Decimal"),
    "fraction": (Fraction(1, 2), "is a Fraction"),
    "set": ({1.0}, "is a set"),
    "generator": ((x for x in ()), "is a generator"),
    "range": (range(3), "is a range"),
    "date": (date(2020, 1, 1), "is a date"),
    "datetime64": (np.datetime64("2020"), "is a date"),
    "flag": (True, "is True"),
    "NumPy's flag": (np.bool_(True), "is True"),
    "flags": (np.array([True]), "is True"),
    "complex array": (np.array([1j]), "0: is a complex"),
    "objects": (np.array([len]), "0: is a builtin"),
    "dates": (np.array(["2020"], "M8[D]"), "0: is a date"),
    "masked": (np.ma.array([1.0, 2.0], mask=[0, 1]), "is an array with masked entries"),
    "masked number": (np.ma.masked, "is an array with masked entries"),
    "None in a list": ([None], "0: is a NoneType"),
    "large": (10**400, "a whole number of more th"),
    "very large": (10**5000, "a whole number of more"),
    "surrogate": ("\ud800", "the character"),
    "number as a key": ({1: 2.0}, "has the key 1; expected text"),
    "nothing as a key": ({None: 2.0}, "has the key None; expected text"),
    "own distribution": (Own(0.0, 1.0), "is a Own, a distribution that no file can name"),
    "endless": (endless(), "nested too deeply"),
    "wide": (wide(), "larger than 4 MiB"),
    "huge array": (np.broadcast_to(0.0, (10**12,)), "larger than 4 MiB"),
    "deep": (json.loads("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1)), "nested too deeply"),
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("place", ["body.mass", "sample.body.mass", "problem.forces.drag.linear"])
def test_what_no_file_can_hold_is_refused_by_key(name, place):
    value, message = REFUSED[name]
    with pytest.raises(StudyError, match=message) as caught:
        Study.of(tables(), changes={place: value})
    section, _, key = place.rpartition(".")
    assert f"{section}.{key}" in str(caught.value)
    assert len(str(caught.value)) < 2000
    if place == "body.mass":
        with pytest.raises(StudyError, match=rf"body\.mass.*{message}"):
            study(body={"mass": value})


@pytest.mark.parametrize("given", [None, [], 3, "body", np.zeros(3), Loud()])
def test_what_is_no_tables_is_refused(given):
    with pytest.raises(StudyError, match="a study is made of tables, a dictionary, got a"):
        Study.of(given)


@pytest.mark.parametrize("changes", [[1], "x", {1: 2}, {"": 1}, {"a\nb": 1}, {"." * 999: 1}])
def test_changes_that_are_none_are_refused(changes):
    with pytest.raises(StudyError):
        Study.of(tables(), changes=changes)


def test_no_more_is_taken_than_can_be_read_again(monkeypatch):
    monkeypatch.setattr("lierb.studies.description.study.LONGEST_STUDY", 20_000)
    values = {"distribution": "values", "values": np.random.default_rng(0).uniform(size=1000)}
    with pytest.raises(StudyError, match="larger than 4 MiB, the most for a study"):
        study(sample={"body": {"mass": values}})


NUMBERS = st.one_of(
    st.floats(), st.integers(-(10**20), 10**20), st.floats(width=32).map(np.float32),
    st.integers(0, 255).map(np.uint8), st.just(-0.0), st.booleans(),
)  # fmt: skip
LISTS = st.lists(NUMBERS, max_size=4)
THINGS = st.one_of(
    NUMBERS,
    LISTS,
    LISTS.map(tuple),
    st.lists(st.floats(-9, 9), min_size=3, max_size=3).map(np.array),
    st.text(max_size=5),
    st.none(),
    st.sampled_from(list(ANY_DISTRIBUTION.values())),
    st.sampled_from(
        [value for value, _ in REFUSED.values() if not isinstance(value, (dict, list))]
    ),
    st.floats(0.1, 9).map(lambda x: Uniform(x, 2 * x)),
    st.just(np.float64(1.0)),
    st.just({}),
    st.just(np.array(2.5)),
    st.dictionaries(st.text(max_size=3), NUMBERS, max_size=2),
)
PLACES = st.sampled_from(
    [
        "name",
        "body.mass",
        "body.com",
        "body.inertia",
        "joint.body_point",
        "problem.gravity",
        "problem.forces.0.linear",
        "problem.forces.0.name",
        "problem.forces.0.point",
        "initial.omega",
        "sample.n",
        "sample.seed",
        "sample.body.mass",
        "sample.initial.omega",
        "sample.forces.drag.linear",
        "sample.problem.gravity",
        "integrate.dt",
        "integrate.t0",
        "integrate.cspace",
        "output.part",
        "sample.initial",
        "sample.forces.drag",
        "sample.forces",
        "integrate.save_every",
        "sample",
    ]
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(changes=st.dictionaries(PLACES, THINGS, min_size=1, max_size=2))
def test_what_is_taken_is_the_same_when_it_was_written(changes):
    """A study has one form in the manifest and in the folder's study.toml."""
    changed = tables()
    for key, value in changes.items():
        place = changed
        *way, last = (int(part) if part.isdecimal() else part for part in key.split("."))
        for part in way:
            if isinstance(place, dict):
                place.setdefault(part, {})
            place = place[part]
            if not isinstance(place, (dict, list)):
                return
        place[last] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            made = Study.of(changed)
        except StudyError as error:
            assert str(error)  # noqa: PT017
            return
        assert_survives(made)


def test_a_study_made_without_of_can_be_written():
    made = Study(**tables() | {"body": {"mass": np.float64(2.0), "inertia": np.ones(3)}})
    assert Study.of(tomllib.loads(made.to_toml())) == made
    assert isinstance(made.design.quantities["body.mass"], Distribution)

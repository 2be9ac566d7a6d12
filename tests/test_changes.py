"""Changes of a study by dotted keys: read as in a TOML file, made as if written there."""

from __future__ import annotations

import doctest
import math
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from studies import TEXT, study

import lierb.studies.description.changes
from lierb.errors import StudyError
from lierb.studies.description.changes import applied, parsed, path_of, written
from lierb.studies.description.study import Study

READ = {
    "integrate.dt=1e-4": ("integrate.dt", 1e-4),
    "integrate.dt = [1e-3, 1e-4]": ("integrate.dt", [1e-3, 1e-4]),
    "sample.n=100_000": ("sample.n", 100_000),
    "problem.gravity=[0,0,-1.62]": ("problem.gravity", [0, 0, -1.62]),
    "integrate.cspace=reduced": ("integrate.cspace", "reduced"),
    'integrate.cspace="reduced"': ("integrate.cspace", "reduced"),
    "integrate.cspace=[SE3, SO3xR3]": ("integrate.cspace", ["SE3", "SO3xR3"]),
    'integrate.cspace=["SE3", "SO3xR3"]': ("integrate.cspace", ["SE3", "SO3xR3"]),
    "sample.body.mass={distribution='uniform', low=1, high=2}": (
        "sample.body.mass", {"distribution": "uniform", "low": 1, "high": 2},
    ),
    "name=a=b": None,
    'name="a=b"': ("name", "a=b"),
    "body.mass=inf": ("body.mass", math.inf),
    "name=true": ("name", True),
    "name=": None,
    "name": None,
    "=3": None,
    "a b=3": None,
    "name=two words": None,
    "integrate.dt=1e-3s": None,
    "integrate.dt=[1e-3": None,
    "integrate.dt=1\nt_end=2": None,
    "a=1\nb=2": None,
}  # fmt: skip


@pytest.mark.parametrize("text", READ)
def test_parsed_is_what_a_file_would_have(text):
    if READ[text] is None:
        with pytest.raises(StudyError, match=r"no (KEY=VALUE|key|value)|expected one value"):
            parsed(text)
        return
    key, value = parsed(text)
    assert (key, value) == READ[text]
    assert type(value) is type(READ[text][1])


VALUES = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(min_size=1), inner),
    max_leaves=8,
)


@given(value=VALUES)
def test_written_changes_are_read_back(value):
    (line,) = written({'sample.forces."a.b".linear': value})
    assert "\n" not in line
    assert parsed(line) == ('sample.forces."a.b".linear', value)


def test_examples_in_the_text_run():
    assert doctest.testmod(lierb.studies.description.changes).failed == 0


def test_path_of_quoted_keys():
    assert path_of('sample.forces."my drag.1".linear') == (
        "sample",
        "forces",
        "my drag.1",
        "linear",
    )


WITH_ANGULAR = "linear = 0.1\nangular = 2"
SAME = {  # changes, and the text of the file that says the same
    "number": ({"sample.n": 3}, [("n = 50", "n = 3")]),
    "list": ({"integrate.dt": [1e-3]}, [("[1e-3, 2e-3]", "[1e-3]")]),
    "one for a list": ({"integrate.dt": 1e-3}, [("[1e-3, 2e-3]", "1e-3")]),
    "deep": ({"sample.body.mass.high": 9.0}, [("high = 7.0", "high = 9.0")]),
    "component": ({"problem.gravity.2": -1.62}, [("-9.81", "-1.62")]),
    "by type": ({"problem.forces.drag.angular": 2}, [("linear = 0.1", WITH_ANGULAR)]),
    "by number": ({"problem.forces.0.angular": 2}, [("linear = 0.1", WITH_ANGULAR)]),
    "constant for a distribution": (
        {"sample.forces.drag.linear": 0.3},
        [('[sample.forces.drag.linear]\ndistribution = "uniform"\nlow = 0.0\nhigh = 0.2\n',
          "[sample.forces.drag]\nlinear = 0.3\n")],
    ),
    "new table": ({"output.compression": "zstd"}, [("part = 8", 'part = 8\ncompression = "zstd"')]),
    "two that build on each other": (
        {"sample.joint.body_point": {"distribution": "direction"},
         "sample.joint.body_point.length": 0.15},
        [("[integrate]",
          '[sample.joint.body_point]\ndistribution = "direction"\nlength = 0.15\n[integrate]')],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_a_change_is_as_if_written_in_the_file(name, tmp_path):
    changes, edits = SAME[name]
    text = TEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    expected = Study.of(tomllib.loads(text))
    before = repr(changes)
    assert Study.of(tomllib.loads(TEXT), changes=changes) == expected
    assert study().changed(changes) == expected
    (tmp_path / "study.toml").write_text(TEXT)
    assert Study.load(tmp_path / "study.toml", changes) == expected
    assert repr(changes) == before  # what was given goes into the manifest as it was


def test_applied_leaves_the_tables_alone():
    tables = tomllib.loads(TEXT)
    applied(tables, {"problem.gravity.2": 0.0, "problem.forces.drag.linear": 5.0})
    assert tables == tomllib.loads(TEXT)


WRONG = {
    "key": ({"integrate.tend": 5}, "integrate.tend=5: integrate.tend: unknown key; did you mean t"),
    "table": ({"sampel.n": 5}, "s.toml with sampel.n=5: sampel: unknown key; did you mean sample?"),
    "value": ({"sample.n": 0}, "s.toml with sample.n=0: sample.n: input should be greater than 0"),
    "name": (
        {"integrate.cspace": "SE4"},
        's.toml:35 with integrate.cspace="SE4": integrate: cspace=\'SE4\' is unknown',
    ),
    "combination": (
        {"integrate.t_end": 0.0505, "sample.n": 5},
        "s.toml:35 with integrate.t_end=0.0505: integrate: t_end=0.0505 s is no",
    ),
    "elsewhere": ({"sample.n": 5, "body.mass": "x"}, 's.toml with body.mass="x": body.mass: inp'),
    "through a number": ({"body.mass.mean": 3}, "body.mass.mean: body.mass is 6.075, no table"),
    "no such force": ({"problem.forces.darg.linear": 1}, "problem.forces.darg: there is none; kno"),
    "no such component": ({"problem.gravity.3": 1}, "problem.gravity.3: there is none; known: 0, "),
    "force's parameter": (
        {"problem.forces.drag.linaer": 1},
        "with problem.forces.drag.linaer=1: forces.drag.linaer: unknown key; did you mean linear?",
    ),
    "drawn": (
        {"body.mass": 5.0},
        "body.mass: has no effect, since each body draws its own; change sample.body.mass",
    ),
    "drawn of a force": (
        {"problem.forces.0.linear": 5.0},
        "has no effect, since each body draws its own; change sample.forces.drag.linear",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_error_names_the_change(name, tmp_path):
    changes, message = WRONG[name]
    (tmp_path / "s.toml").write_text(TEXT)
    with pytest.raises(StudyError) as caught:
        Study.load(tmp_path / "s.toml", changes)
    assert message in str(caught.value)

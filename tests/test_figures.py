"""Figures of a study: what is drawn of what was found, in which words, and what moves."""

from __future__ import annotations

import base64
import json
import warnings
from itertools import pairwise
from unicodedata import normalize

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from studies import sorted_rows, study

import lierb
from lierb.errors import FailedTrajectoryWarning, UnknownNameError
from lierb.results.colours import CSPACE_COLOURS
from lierb.results.columns import as_array
from lierb.studies.description.settings import Setting
from lierb.support.files import sha256_of

pytest.importorskip("matplotlib")
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from lierb.results import panels
from lierb.studies.findings import statistics, symbols
from lierb.studies.findings.ranking import Ranking
from lierb.studies.pages import figures, over_bodies, replays
from lierb.studies.pages.looks import Look, looks

SAVED = {"save_every": 10}


@pytest.fixture(scope="module")
def given():
    return study(sample={"n": 20}, integrate=SAVED, output={"part": 10})


@pytest.fixture(scope="module")
def dataset(given, tmp_path_factory):
    return lierb.run(given, tmp_path_factory.mktemp("figures") / "out")


def panels_of(figure) -> list:
    return [axes for axes in figure.axes if axes.get_visible()]


def drawn(dataset, name: str) -> list:
    return panels_of(dataset.plot(name))


@pytest.fixture(scope="module")
def over_time(dataset):
    return dataset.plot()


def words(axes) -> list[str]:
    return [*(text.get_text() for text in axes.texts), axes.get_title("right")]


# ---- labels ------------------------------------------------------------------------------------


def labels(given, **columns) -> list[str]:
    named = {f"sample.{name.replace('__', '.')}": unit for name, (unit, _) in columns.items()}
    rows = {
        f"sample.{name.replace('__', '.')}": np.zeros((3, width) if width else 3)
        for name, (_, width) in columns.items()
    }
    return [*symbols.labelled(named, [rows], given)[0]]


def test_parameters_of_two_elements_have_two_labels(given):
    found = labels(given, observables__up__gain=("", 0), observables__down__gain=("", 0))
    assert found == ["up: gain", "down: gain"]
    assert len(set(labels(given, forces__a__x=("", 0), states__a__x=("", 0)))) == 2


def test_settings_have_the_same_labels(given):
    """A component that differs in one setting only, or that has no bodies in another."""
    units = {"sample.initial.omega": "rad/s"}
    across = [
        {"sample.initial.omega": np.array([[1.0, 2.0, 3.0], [1.5, 2.0, 3.0]])},
        {"sample.initial.omega": np.array([[1.0, 2.0, 3.0], [1.0, 2.5, 3.0]])},
        {"sample.initial.omega": np.empty((0, 3))},
    ]
    found = symbols.labelled(units, across, given)
    assert [[*each] for each in found] == [["ω₁ [rad/s]", "ω₂ [rad/s]"]] * 3


def test_sampled_numbers_are_labelled_by_symbols(given):
    twist = "rad/s, rad/s, rad/s, m/s, m/s, m/s"
    assert labels(given, initial__twist=(twist, 6)) == [
        "ω₁ [rad/s]", "ω₂ [rad/s]", "ω₃ [rad/s]", "v₁ [m/s]", "v₂ [m/s]", "v₃ [m/s]",
    ]  # fmt: skip
    assert labels(given, body__mass=("kg", 0), body__inertia=("kg m²", 3)) == [
        "mass [kg]", "I₁ [kg m²]", "I₂ [kg m²]", "I₃ [kg m²]",
    ]  # fmt: skip
    assert labels(given, forces__drag__linear=("N s/m", 0)) == ["drag: linear [N s/m]"]
    assert labels(given, joint__axis=("1", 3)) == ["axis₁", "axis₂", "axis₃"]
    assert labels(given, initial__rotation=("1", 9)) == []  # a matrix has no axis


def test_coordinates_are_labelled_as_the_joint_names_them(given):
    joint = {"type": "cylindrical", "axis": [0.0, 0.0, 1.0], "body_point": [0.0, 0.0, 0.1]}
    start = {"coordinates": [0.1, 0.2]}
    held = study(sample={"n": 2, "initial": {}}, joint=joint, initial=start)
    assert labels(held, initial__coordinates=("rad, m", 2)) == ["φ [rad]", "d₃ [m]"]
    rates = labels(held, initial__velocities=("rad/s, m/s", 2))
    assert rates == [normalize("NFC", text) for text in ("φ̇ [rad/s]", "ḋ₃ [m/s]")]


# ---- zeros, many lines -------------------------------------------------------------------------


@pytest.mark.slow
def test_zeros_are_said_in_words_and_not_drawn(dataset, over_time):
    """An exact joint, as on SE(3), does not extend an axis to 1e-18."""
    shares, ridges = drawn(dataset, "distribution")[:2]
    assert shares.get_xlim()[0] > 1e-17
    told = [line for text in words(shares) for line in text.splitlines()]
    assert sum(line.endswith("exactly 0") for line in told) == 2  # two dt
    assert words(ridges).count("exactly 0") == 2
    assert len(shares.lines) == 2
    assert len(panels_of(over_time)[0].lines) == 4  # median and largest, of SO(3)×ℝ³


def test_the_legend_tells_what_an_outline_is(dataset):
    """The energy drift at the end is neither printed nor drawn."""
    sheet = dict(figures.sheets(dataset))["distribution"]
    assert [key.label for key in sheet.keys][-1] == "outline: at the end"
    shown = [Figure().subplots() for _ in sheet.panels]
    for draw, panel in zip(sheet.panels, shown, strict=True):
        draw(panel)
    outlined = [
        any(patch.get_edgecolor()[:3] == to_rgb(sheet.keys[-1].colour) for patch in panel.patches)
        for panel in shown
    ]
    assert outlined == [False, True, False, False]


def test_shares_begin_at_the_share_of_zeros():
    figure = Figure()
    key = panels.Key("a", "#000000")
    row = panels.Ridge(key, np.array([0.0, 0.0, 1e-9, 1e-7, 1e-8]), np.empty(0))
    look = Look(Setting("SE3", "RK4", 1e-3), key, 1.0)
    axes = figure.subplots()
    over_bodies._draw_shares([row], [look], 1e-18, "error", axes)
    np.testing.assert_allclose(axes.lines[0].get_xdata(), (1e-9, 1e-8, 1e-7))
    np.testing.assert_allclose(axes.lines[0].get_ydata(), (0.6, 0.8, 1.0))
    axes = figure.subplots()
    panels.ridges(axes, [row], 1e-18, is_log=True)
    assert "40 % exactly 0" in words(axes)


def test_histograms_do_not_hide_each_other():
    """Each has its own base line."""
    rng = np.random.default_rng(1)
    rows = [panels.Ridge(panels.Key(f"{n}", "#000000"), 10 ** rng.normal(-6, 1, 100), np.empty(0))
            for n in range(4)]  # fmt: skip
    axes = Figure().subplots()
    panels.ridges(axes, rows, 0.0, is_log=True)
    tops = [np.nanmax(patch.get_data().values) for patch in axes.patches]
    bases = [patch.get_data().baseline for patch in axes.patches]
    assert bases == [3.0, 2.0, 1.0, 0.0]
    assert all(base < top < base + 1.0 for base, top in zip(bases, tops))


def test_more_lines_than_a_legend_has_room_for_are_labelled_where_they_end(dataset, given):
    """Settings have colours of their own, and are drawn apart."""
    axes = Figure().subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0])
    panels.label_lines(axes, [(f"line {n}", "#000000", 1.0, 0.5) for n in range(9)])
    places = sorted(text.get_position()[1] for text in axes.texts)
    assert len(places) == 9
    assert np.diff(places).min() > 0.04
    many = given.changed({"integrate.dt": [1e-3, 2e-3, 5e-3, 1e-2, 5e-4]})
    assert len(looks(many)) > panels.MOST_KEYS
    sheet = panels.Sheet("", [lambda axes: None], [look.key for look in looks(many)])
    assert not panels.figure_of(sheet, many).legends
    with_legend = panels.Sheet("", [lambda axes: None], [looks(given)[0].key])
    assert panels.figure_of(with_legend, given).legends


def test_a_cspace_has_its_colour_whatever_stands_before_it(given):
    for spaces in (["SE3", "SO3xR3"], ["SO3xR3", "SE3"], ["SO3xR3"], ["reduced", "SO3xR3", "SE3"]):
        for look in looks(given.changed({"integrate.cspace": spaces})):
            assert look.key.colour == CSPACE_COLOURS[look.setting.cspace]
    several = given.changed({"integrate.method": ["RK4", "Heun"], "integrate.cspace": ["SE3"]})
    by_method = {look.setting.method: look.key.colour for look in looks(several)}
    assert by_method["RK4"] == CSPACE_COLOURS["SE3"]
    assert by_method["Heun"] not in (CSPACE_COLOURS["SE3"], CSPACE_COLOURS["SO3xR3"])


# ---- further columns ---------------------------------------------------------------------------


@pytest.mark.slow
def test_columns_that_nobody_knows_are_drawn_with_their_units(given, tmp_path):
    """Columns of observables, in the history and in the summary."""
    done = lierb.run(given, tmp_path / "out")
    for files in done.parts.values():
        for name, entry in files.items():
            path = tmp_path / "out" / name
            table = pq.read_table(path)
            values = pa.array(np.arange(table.num_rows) / 3.0)
            plain = "height" if name.startswith("history") else "height_max"
            field = pa.field(plain, pa.float64(), metadata={"unit": "m"})
            pq.write_table(table.append_column(field, values), path)
            entry["sha256"] = sha256_of(path)
    (axes,) = drawn(done, "recorded")
    assert axes.get_ylabel() == "height [m]"
    assert len(axes.lines) == 4
    (axes,) = drawn(done, "quantities")
    assert axes.get_xlabel() == "height max [m]"
    assert axes.get_xscale() == "linear"


@pytest.mark.slow
def test_figures_over_time_read_a_few_times_at_once(dataset, given, over_time, monkeypatch):
    """A history may be larger than the memory."""
    sizes = []

    def counted(column):
        sizes.append(len(column))
        return as_array(column)

    def heights(axes: list) -> list[np.ndarray]:
        return [line.get_ydata() for each in axes for line in each.lines]

    monkeypatch.setattr(statistics, "as_array", counted)
    monkeypatch.setattr(statistics, "MOST_NUMBERS", 2 * given.sample.n)
    found, whole = heights(drawn(dataset, "time")), heights(panels_of(over_time))
    for some, wanted in zip(found, whole, strict=True):
        np.testing.assert_array_equal(some, wanted)
    assert 0 < max(sizes) <= 2 * given.sample.n


@pytest.mark.slow
def test_dataset_plot_names_its_figures(dataset, over_time):
    assert isinstance(over_time, Figure)
    assert "errors over time" in over_time.get_suptitle()
    with pytest.raises(UnknownNameError, match="choose from distribution, time, order, parameters"):
        dataset.plot("recorded")


# ---- what moves --------------------------------------------------------------------------------


def last_pose(view) -> np.ndarray:
    return np.frombuffer(base64.b64decode(view["bodies"][0]["poses"]), "<f4").reshape(-1, 7)[-1]


def test_worst_and_median_trajectories_run_again_as_in_the_study(dataset, given):
    rows = sorted_rows(dataset.folder)
    worst = max(rows, key=lambda row: row["position_error_max"])
    same = [row for row in rows if (row["cspace"], row["dt"]) == (worst["cspace"], worst["dt"])]
    ranked = sorted(same, key=lambda row: row["position_error_max"])
    picked = replays.chosen(dataset, Ranking("position_error_max"))
    assert picked.trajectories == {"worst": worst["trajectory"], "median": ranked[9]["trajectory"]}
    assert [s.cspace for s in picked.settings] == ["SE3", "SO3xR3"]
    assert {s.dt for s in picked.settings} == {worst["dt"]}
    views = replays.replayed(given, picked).scene["views"]
    assert len(views) == 4
    for view, (number, setting) in zip(
        views, [(n, s) for n in picked.trajectories.values() for s in picked.settings]
    ):
        assert str(number) in view["title"]
        (row,) = [r for r in rows if (r["cspace"], r["dt"], r["trajectory"])
                  == (setting.cspace, setting.dt, number)]  # fmt: skip
        np.testing.assert_array_equal(last_pose(view)[4:], np.float32(row["position"]))


def test_of_a_study_that_failed_the_first_failure_is_shown(tmp_path):
    omega = {"distribution": "uniform", "low": [-1e140] * 3, "high": [1e140] * 3}
    given = study(sample={"n": 3, "initial": {"omega": omega}}, integrate=SAVED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FailedTrajectoryWarning)
        done = lierb.run(given, tmp_path / "out")
    picked = replays.chosen(done, Ranking("position_error_max"))
    assert picked.trajectories == {"failed": 0}
    assert picked.ranking is None
    animation = replays.replayed(given, picked)
    assert "non_finite" in animation.scene["views"][0]["title"]
    json.dumps(animation.scene, allow_nan=False)  # which a browser would not read


@pytest.mark.parametrize("is_log", [True, False])
@pytest.mark.parametrize(
    ("low", "high"),
    [(7.25e-11, 8.75e-11), (0.1912, 0.1916), (1.0, 4.5), (2e-11, 2e-10), (1e-12, 3e-9), (0.1, 9.0),
     (3e-17, 3.1e-17), (123456.0, 123457.0), (1e-16, 1e-2)],
)  # fmt: skip
def test_labels_of_ticks_do_not_overlap(low, high, is_log):
    """At the width of a phone, on axes of less than a decade too."""
    values = np.geomspace(low, high, 200)
    row = panels.Ridge(panels.Key("a", "#000000"), values, np.empty(0))
    sheet = panels.Sheet("", [lambda axes: panels.ridges(axes, [row], 0.0, is_log=is_log)])
    (figure,) = panels.panels_of(sheet)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    first, last = axes.get_xlim()
    shown = [
        tick.label1.get_window_extent()
        for tick in axes.xaxis.get_major_ticks()
        if first <= tick.get_loc() <= last and tick.label1.get_text()
    ]
    assert shown
    for before, after in pairwise(sorted(shown, key=lambda box: box.x0)):
        assert before.x1 + 2.0 < after.x0

"""Bodies of a report are ranked by the column that was asked for."""

from __future__ import annotations

import re

import numpy as np
import pytest
from command import invoke
from studies import TEXT, sorted_rows, tables

import lierb
from lierb.errors import UnknownNameError
from lierb.studies.description.study import Study
from lierb.studies.findings.ranking import Ranking, ranking_named, rankings

SEEN = """\
import lierb

@lierb.observable(unit="m")
def height(r):
    return r[2]
"""
RULE = "width of 50% of energy_drift_max < 1e-30"  # which never holds


def study(seen: bool = True, **sample) -> Study:
    """Heavy tops, whose height is observed."""
    given = tables()
    given["sample"] |= {"n": 12} | sample
    given["integrate"] |= {"save_every": 10}
    if seen:
        given["problem"]["observables"] = [{"type": "python:seen.py:height"}]
    return Study.of(given, code={"seen.py": SEEN} if seen else {})


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return lierb.run(study(), tmp_path_factory.mktemp("ranking") / "out")


def test_order_begins_with_the_worst():
    values = np.array([2.0, np.nan, 5.0, -1.0, 5.0])
    assert Ranking("x").order(values).tolist() == [2, 4, 0, 3]
    assert Ranking("x", is_reversed=True).order(values).tolist() == [3, 0, 2, 4]
    assert Ranking("x").order(np.full(3, np.nan)).size == 0


@pytest.mark.slow
def test_default_is_the_rule_or_the_observable_or_the_errors(dataset, monkeypatch):
    assert rankings(dataset) == [Ranking("height_max")]
    assert rankings(dataset, "-height_min") == [Ranking("height_min", is_reversed=True)]
    errors = [Ranking("position_error_max"), Ranking("energy_drift_max")]
    for given, expected in (
        (study(stop_when=RULE), [Ranking("energy_drift_max")]),
        (study(stop_when="width of failed < 0.1"), [Ranking("height_max")]),
        (study(seen=False), errors),
    ):
        monkeypatch.setattr(dataset, "study", given)
        assert rankings(dataset) == expected


@pytest.mark.parametrize(
    "name", ["hight_max", "position", "trajectory", "sample.body.mass", "-", ""]
)
def test_ranking_refuses_what_is_no_column_of_numbers(name):
    with pytest.raises(UnknownNameError, match=r"rank_by=.* is unknown; choose from .*height_max"):
        ranking_named(study(), name)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("rank_by", [None, pytest.param("-height_mean", marks=pytest.mark.long)])
def test_report_lists_and_animates_the_worst(dataset, tmp_path, rank_by):
    pytest.importorskip("plotly")
    from lierb.studies.pages.replays import chosen, description_of
    from lierb.studies.pages.report import write_report

    column = "height_max" if rank_by is None else "height_mean"
    rows = sorted_rows(dataset.folder)
    ranked = sorted(rows, key=lambda row: row[column], reverse=rank_by is None)
    page = write_report(dataset, tmp_path / "page.html", rank_by=rank_by).read_text("utf-8")
    word = "largest" if rank_by is None else "smallest"
    listed = re.findall(
        rf'<td class="of">{word} {column}, m<td class="n" data-head="value">([^<]*)<td>[^<]*'
        r'<td class="n" data-head="trajectory">(\d+)<',
        page,
    )
    assert [int(number) for _, number in listed] == [row["trajectory"] for row in ranked[:5]]
    values = [row[column] for row in ranked[:5]]
    assert [float(value) for value, _ in listed] == pytest.approx(values, rel=1e-2)
    picked = chosen(dataset, *rankings(dataset, rank_by))
    assert picked.trajectories["worst"] == ranked[0]["trajectory"]
    setting = (ranked[0]["cspace"], ranked[0]["dt"])
    same = [row for row in ranked if (row["cspace"], row["dt"]) == setting]
    assert picked.trajectories["median"] == same[6]["trajectory"]
    assert description_of(picked) in page
    assert page.index(f"y: height {column[7:]} [m]") < page.index("y: position error [m]")
    assert (f"--rank-by={rank_by}" in page) == (rank_by is not None)


@pytest.mark.slow
def test_figure_of_parameters_shows_the_ranked_column(dataset):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from lierb.studies.pages.figures import sheets

    assert dict(sheets(dataset))["parameters"].title.startswith("height max [m]")
    errors = dict(sheets(dataset, "energy_drift_max"))["parameters"]
    assert errors.title.startswith("largest energy drift [J]")
    panel = Figure().subplots()
    dict(sheets(dataset))["parameters"].panels[0](panel)
    (masses, heights) = panel.lines[0].get_data()
    rows = [row for row in sorted_rows(dataset.folder) if row["dt"] == 2e-3]
    assert panel.get_yscale() == "linear"
    assert set(heights) == {row["height_max"] for row in rows if row["cspace"] == "SE3"}
    assert set(masses) == {row["sample.body.mass"] for row in rows}


def test_commands_refuse_an_unknown_column_before_the_run(tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(TEXT)
    out = tmp_path / "out"
    refused = invoke("run", file, "--out", out, "--report", "--rank-by", "energy_drift")
    assert refused.exit_code == 1
    assert "Did you mean 'energy_drift_max'?" in refused.stderr
    assert not out.exists()
    refused = invoke("run", file, "--out", out, "--rank-by", "energy_drift_max")
    assert refused.exit_code == 2
    assert "--rank-by is for --report" in refused.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_commands_take_a_column(tmp_path):
    file, out = tmp_path / "study.toml", tmp_path / "out"
    file.write_text(TEXT)
    done = invoke("run", file, "--out", out, "--n", 5, "--report", "--rank-by", "-work_final")
    assert done.exit_code == 0, done.output
    assert "has the smallest work_final of the bodies" in (out / "report.html").read_text("utf-8")
    done = invoke("report", out, "--rank-by", "energy_drift_max")
    assert done.exit_code == 0, done.output
    assert "has the largest energy_drift_max of" in (out / "report.html").read_text("utf-8")

"""The HTML page on a study: complete, self-contained, and true to the tables."""

from __future__ import annotations

import base64
import html
import json
import re
import shutil
import subprocess
import warnings
from html.parser import HTMLParser

import pytest
from cases import tiered
from click.testing import CliRunner
from studies import BLANK, PARTS, TEXT, sorted_rows, study

import lierb
from lierb.cli import cli
from lierb.errors import FailedTrajectoryWarning, StudyError
from lierb.studies.dataset import Dataset
from lierb.studies.storage.store import Store

pytest.importorskip("plotly")
from lierb.studies.pages.explorer import POINTS
from lierb.studies.pages.figures import figures, omitted
from lierb.studies.pages.report import write_report
from lierb.support.files import require_page

BODIES = 50


class Page(HTMLParser):
    """Contents and references of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.pictures: dict[str, bytes] = {}
        self.cells: list[list[str]] = []
        self.texts: dict[str, list[str]] = {"h2": [], "pre": [], "p": []}
        self._open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.references += [given[key] for key in ("src", "href") if key in given]
        if tag == "img":
            kind, _, content = given["src"].partition(";base64,")
            assert kind == "data:image/svg+xml"
            assert given["alt"]
            self.pictures[self._figure] = base64.b64decode(content)
        if tag == "figure":
            self._figure = given["id"]
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag in self.texts:
            self.texts[tag].append("")
        self._open = [tag]

    def handle_endtag(self, tag):
        self._open = []

    def handle_data(self, data):
        for tag in self._open:
            if tag in ("td", "th"):
                self.cells[-1][-1] += data.strip()
            elif tag in self.texts:
                self.texts[tag][-1] += data


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    given = study(integrate={"save_every": 10}, output={"part": 32})  # two parts of each setting
    return lierb.run(given, tmp_path_factory.mktemp("report") / "out")


@pytest.fixture(scope="module")
def text(dataset):
    """The page on the study, with blank figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lierb.studies.pages.report.data_url", lambda figure: BLANK)
        return write_report(dataset, dataset.folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_page_is_complete(dataset, tmp_path):
    text = write_report(dataset, tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.texts["h2"] == [
        "How large the errors get", "Quantiles and how well they are known",
        "What the theory says", "How they move", "Figures", "Body by body",
        "The worst bodies", "How to reproduce it",
    ]  # fmt: skip
    assert list(page.pictures) == ["distribution", "time", "order", "parameters"]
    for picture in page.pictures.values():
        assert b"<svg" in picture
        assert b"</svg>" in picture
    assert "50 bodies over 0.05 s" in text
    assert "No run failed." in text
    assert "Unfinished" not in text


def test_page_has_the_call_that_replays_each_listed_trajectory(dataset, text):
    number = r'<td class="n" data-head="trajectory">(\d+)<td'
    rows = re.findall(rf'{number}.*<td class="of"><code>(dataset.replay\(.*\))</code>', text)
    assert len(rows) == 10  # five by each of the two errors
    assert html.unescape(rows[0][1]) in Page(text).texts["pre"][-3]
    number, call = rows[-1]
    replay = eval(html.unescape(call), {"dataset": dataset})
    energy = replay.result.summary["energy_drift_max"].to_pylist()
    cells = [c for c in Page(text).cells if c[0] == "largest energy_drift_max, J"]
    assert cells[-1][2:4] == [replay.setting.label, number]
    assert float(cells[-1][1]) == pytest.approx(energy[0], rel=1e-2)


FOREIGN = ("manifest.json", "study.toml", "summary/part-00000.parquet", "notes.txt", "data.svg")


@pytest.mark.parametrize("is_link", [False, True])
@pytest.mark.parametrize("name", FOREIGN)
def test_report_overwrites_nothing_but_pages(dataset, tmp_path, name, is_link):
    out = tmp_path / "results"
    shutil.copytree(dataset.folder, out)
    (out / "notes.txt").write_text("an <html> tag that does not begin the text")
    (out / "data.svg").write_text('<?xml version="1.0"?><svg></svg>')
    (part,) = sorted((out / "summary").iterdir())[:1]
    file = out / name if (out / name).exists() else part
    before, path = file.read_bytes(), file
    if is_link:
        path = tmp_path / "page.html"
        path.symlink_to(file)
    refused = CliRunner().invoke(cli, ["report", str(out), "--out", str(path)])
    assert refused.exit_code == 1
    assert f"{path} is there and no HTML page, and would be lost" in refused.stderr
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "page",
    [
        "",
        "<!doctype html>\n<p>",
        "\ufeff  <HTML lang='en'>",
        "<!-- a -->\n<!-- b --><!DOCTYPE html>",
    ],
)
def test_require_page_lets_pages_be_replaced(tmp_path, page):
    path = tmp_path / "page.html"
    require_page(path)
    path.write_text(page, encoding="utf-8")
    require_page(path)


def test_page_needs_no_network(text):
    assert [x for x in Page(text).references if not x.startswith("data:")] == []
    assert not re.search(r"@import|url\((?!['\"]?(data:|#))", text.split("<script")[0])


def test_page_shows_what_was_found(dataset, text):
    cells = Page(text).cells
    rows = sorted_rows(dataset.folder)
    for cspace in ("SE3", "SO3xR3"):
        for dt in (1e-3, 2e-3):
            errors = [
                row["position_error_max"]
                for row in rows
                if (row["cspace"], row["dt"]) == (cspace, dt)
            ]
            (shown,) = [c for c in cells if c[:3] == [cspace, "RK4", f"{dt:g}"]]
            largest = f"{max(errors):.1e}" if max(errors) else "0"
            assert shown[3:5] == [str(BODIES), "0"]
            assert shown[5] == "position, m"
            assert shown[7] == largest
    assert not [c for c in cells if "rotation" in c[:6]]  # a spherical joint restricts none
    worst = max(rows, key=lambda row: row["energy_drift_max"])
    listed = next(c for c in cells if c[0] == "largest energy_drift_max, J")
    assert float(listed[1]) == pytest.approx(worst["energy_drift_max"], rel=1e-2)
    assert listed[3] == str(worst["trajectory"])
    head = next(c for c in cells if c[:2] == ["ranked by", "value"])
    assert head[-1] == "in Python"
    assert head[3] == "trajectory"  # as the tables have it


def drawn(text: str) -> tuple[list, dict]:
    """Traces and layout of the interactive figure."""
    start = text.index("[", re.search(r'Plotly\.newPlot\(\s*"explorer"', text).end())
    traces, end = json.JSONDecoder().raw_decode(text, start)
    layout, _ = json.JSONDecoder().raw_decode(text, text.index("{", end))
    return traces, layout


def test_every_body_is_in_the_interactive_figure(dataset, text):
    traces, layout = drawn(text)
    assert BODIES < POINTS
    assert [trace["name"] for trace in traces] == [
        setting.label for setting in study(integrate={"save_every": 10}).settings
    ]
    for trace in traces:
        assert len(base64.b64decode(trace["x"]["bdata"])) == 8 * BODIES
    menus = [[button["label"] for button in menu["buttons"]] for menu in layout["updatemenus"]]
    assert menus == [
        ["x: mass [kg]", "x: drag: linear [N s/m]"] + [f"x: ω{i} [rad/s]" for i in "₁₂₃"],
        ["y: position error [m]", "y: energy drift [J]"],
    ]


@pytest.mark.slow
def test_page_has_the_functions_of_the_study(tmp_path):
    """Files made of the page's texts alone run the same study."""
    code = 'import lierb\n\n\n@lierb.observable(unit="1")\ndef speed(R, r, omega, v):\n'
    code += "    return 2.0 * omega[0]\n"
    (tmp_path / "fast.py").write_text(code)
    listed = '[[problem.observables]]\ntype = "python:fast.py:speed"\n\n[sample]'
    (tmp_path / "top.toml").write_text(
        TEXT.replace("[sample]", listed, 1).replace("n = 50", "n = 4")
    )
    done = lierb.run(tmp_path / "top.toml", tmp_path / "out", changes={"integrate.cspace": "SE3"})
    text = write_report(done, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "that of <code>fast.py</code> beside it" in text
    texts = [html.unescape(each) for each in Page(text).texts["pre"]]
    again = tmp_path / "again"
    again.mkdir()
    (again / "study.toml").write_text(texts[-2])
    (again / "fast.py").write_text(texts[-1])
    repeated = lierb.run(again / "study.toml", again / "out")
    assert sorted_rows(repeated.folder) == sorted_rows(done.folder)
    assert text.index("Quantiles and how well") < text.index("How large the errors get")  # asked
    (again / "fast.py").unlink()
    with pytest.raises(StudyError, match=f"fast.py is not in {re.escape(str(again))}, .* put it"):
        lierb.run(again / "study.toml", again / "other")


def test_page_says_how_to_do_it_again(dataset, text):
    commands = " ".join(Page(text).texts["pre"])
    assert "lierb run study.toml --report" in commands
    assert (dataset.folder / "study.toml").read_text() in commands
    assert dataset.manifest["digest"][:16] in text
    assert dataset.manifest["machine"]["cpu"] in text


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.filterwarnings("ignore::lierb.errors.StiffStepWarning")  # of such a drag
def test_unfinished_and_failed_bodies_are_told(tmp_path):
    """The last setting has no finished part, and no setting has a history of zeros."""
    drag = {"linear": {"distribution": "uniform", "low": 1e7, "high": 1e9}}
    given = study(sample={"forces": {"drag": drag}}, integrate={"save_every": 10})
    with pytest.warns(FailedTrajectoryWarning):
        done = lierb.run(given, tmp_path / "out")
    last = [name for name in done.parts if name.startswith("03-")]
    for name in last:
        (tmp_path / "out" / "summary" / f"part-{name}.parquet").unlink()
    left = Store(tmp_path / "out")
    left.read()
    left.drop_damaged()
    done.read()
    text = write_report(done, tmp_path / "page.html").read_text(encoding="utf-8")
    page, failures = Page(text), done.failures()
    assert failures.count == sum(row["status"] != "ok" for row in sorted_rows(done.folder))
    told = f"<b>{failures.count} of {failures.runs} runs failed</b>: {failures.count} non_finite"
    assert text.index("<h1>") < text.index(told) < text.index('class="lead"') < text.index("<h2")
    assert f"--only {failures.trajectory}" in page.texts["pre"][0]
    assert f"dataset.replay({failures.trajectory}, cspace=" in text[text.index('id="failed"') :]
    assert "No run failed" not in text
    assert f"Unfinished: {PARTS - len(last)} of {PARTS} parts." in " ".join(page.texts["p"])
    assert "Bodies that failed" in page.texts["h2"]


OMEGA = {"distribution": "uniform", "low": [-1e140] * 3, "high": [1e140] * 3}
HARD = {  # what a study may find, and its figures
    "all failed": {
        "sample": {"n": 3, "initial": {"omega": OMEGA}}, "integrate": {"save_every": 10},
    },
    "all failed, one dt": {
        "sample": {"n": 1, "initial": {"omega": OMEGA}}, "integrate": {"dt": 1e-3, "cspace": "SE3"},
    },
    "one body, one step": {"sample": {"n": 1}, "integrate": {"dt": 0.05, "save_every": 1}},
    "no error at all": {
        "sample": {"n": 3, "initial": {"omega": [0.0, 0.0, 0.0]}},
        "problem": {"gravity": [0.0] * 3}, "integrate": {"save_every": 10, "cspace": "SE3"},
    },
    "names that no font has": {"sample": {"n": 3}, "integrate": {"dt": 1e-3}},
}  # fmt: skip
LONG = ("names that no font has", "no error at all", "all failed, one dt", "one body, one step")
APPLICABLE = {"all failed": 4, "one body, one step": 3, "no error at all": 4}


@pytest.fixture(
    scope="module",
    params=tiered(HARD, {*HARD} - {*LONG}, ()),
)
def hard(request, tmp_path_factory):
    given = study(**HARD[request.param])
    if request.param.startswith("names"):
        given = given.changed({"name": "中😀$x^{ $\\frac " + "w" * 900})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FailedTrajectoryWarning)
        return request.param, lierb.run(given, tmp_path_factory.mktemp("hard") / "out")


def test_figures_of_hard_cases_are_drawn_or_say_why(hard):
    name, dataset = hard
    drawn = dict(figures(dataset))
    assert drawn.keys() | omitted(dataset).keys() == {"distribution", "time", "order", "parameters"}
    assert not drawn.keys() & omitted(dataset).keys()
    assert len(drawn) == APPLICABLE.get(name, 2)
    for figure in drawn.values():
        for panel in figure.axes:
            if not panel.get_visible():
                continue
            told = [text.get_text() for text in panel.texts]
            assert told or panel.lines or panel.patches
            reasons = [text for text in told if "no body got" in text]
            assert bool(reasons) == name.startswith("all failed")
            zeros = any("exactly 0" in text for text in told)
            assert zeros or name != "no error at all"


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_pages_of_hard_cases_are_whole(hard, tmp_path):
    name, dataset = hard
    result = CliRunner().invoke(cli, ["plot", str(dataset.folder)])
    assert result.exit_code == 0, result.output
    for figure, why in omitted(dataset).items():
        assert f"{figure}: left out, since {why}" in result.output
    text = write_report(dataset, tmp_path / "page.html").read_text(encoding="utf-8")
    page, failed = Page(text), name.startswith("all failed")
    assert ("No body got to its end: there are no errors to show." in text) == failed
    assert ("Body by body" in page.texts["h2"]) == (not failed)
    assert ("The worst bodies" in page.texts["h2"]) == (not failed)
    assert ("No body got to its end: the first that failed" in text) == failed
    assert len(page.pictures) == APPLICABLE.get(name, 2)
    assert ("Left out: " in text) == bool(omitted(dataset))


@pytest.mark.slow
def test_texts_are_escaped(tmp_path):
    """Names are the user's: of the study, and of a force whose parameter is on an axis."""
    force = "</script><script>alert(1)</script>$\\foo$"
    tables = study(sample={"n": 3}).model_dump(exclude_none=True)
    tables["name"] = "<b>& $\\foo$"
    tables["problem"]["forces"][0]["name"] = force
    tables["sample"]["forces"] = {force: tables["sample"]["forces"]["drag"]}
    dataset = lierb.run(type(study()).of(tables), tmp_path / "out")
    page = write_report(dataset, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<h1>&lt;b&gt;&amp; $\\foo$</h1>" in page
    assert "<script>alert(1)" not in page


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_a_study_without_samples_has_a_page(tmp_path):
    tables = study().model_dump(exclude={"sample"})
    given = type(study()).of(tables)
    text = write_report(lierb.run(given, tmp_path / "out"), tmp_path / "page.html").read_text()
    assert "Body by body" not in text
    assert "The worst bodies" in text


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_commands(tmp_path):
    one = TEXT.replace("n = 50", "n = 3").replace("[1e-3, 2e-3]", "2e-3\nsave_every = 10")
    (tmp_path / "study.toml").write_text(one.replace('["SE3", "SO3xR3"]', '"SO3xR3"'))
    out = tmp_path / "out"
    result = CliRunner().invoke(
        cli, ["run", str(tmp_path / "study.toml"), "--out", str(out), "--report"]
    )
    assert result.exit_code == 0, result.output
    page = (out / "report.html").read_text(encoding="utf-8")
    (out / "report.html").unlink()
    result = CliRunner().invoke(cli, ["report", str(out)])
    assert result.exit_code == 0, result.output
    assert str(out / "report.html") in result.output
    assert (out / "report.html").read_text(encoding="utf-8") == page  # of what is on the disk
    result = CliRunner().invoke(cli, ["report", str(tmp_path)])
    assert result.exit_code == 1
    assert "holds no results" in result.output


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="no Chromium here")
def test_a_browser_without_a_network_draws_it(text, tmp_path):
    page = tmp_path / "page.html"
    page.write_text(text, encoding="utf-8")
    shown = subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
         "--disable-background-networking", "--host-resolver-rules=MAP * ~NOTFOUND",
         f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=5000", "--dump-dom",
         page.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    assert shown.count('<path class="point') == BODIES * 4
    assert "updatemenu-header" in shown


@pytest.mark.long
@pytest.mark.usefixtures("blank_pictures")
def test_read_from_the_disk_it_is_the_same_page(dataset, tmp_path):
    again = Dataset(dataset.folder)
    again.read()
    pages = [
        write_report(results, tmp_path / f"{name}.html").read_text(encoding="utf-8")
        for name, results in (("written", dataset), ("read", again))
    ]
    assert pages[0] == pages[1]

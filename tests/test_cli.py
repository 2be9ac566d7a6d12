"""The `lierb` command, through click's runner and as a process of its own."""

import functools
import json
import os
import signal
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import lierb.analysis.paper
import lierb.analysis.paper_examples
from lierb.errors import MissingExtraError
from lierb.support.extras import EXTRAS, remedy, require

pytest.importorskip("rich")
pytest.importorskip("click")
pytest.importorskip("matplotlib")

from cases import slow_but
from command import invoke
from rich.table import Table

from lierb.cli.terminal import print_whole

# Runs `python -m lierb` where the modules named in the first argument cannot be imported.
WITHOUT = """
import sys

class Blocked:
    names = set(sys.argv.pop(1).split(","))

    def find_spec(self, name, path=None, target=None):
        if name in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocked())
from lierb.__main__ import main
main()
"""


EXAMPLES = lierb.analysis.paper_examples.EXAMPLES


@pytest.fixture
def short_run(monkeypatch):
    """`lierb paper` over 0.1 s instead of 10 s, with three of its examples."""
    run = functools.partial(lierb.analysis.paper.run_paper, t_end=0.1)
    monkeypatch.setattr(lierb.analysis.paper, "run_paper", run)
    chosen = [
        e
        for e in lierb.analysis.paper_examples.EXAMPLES
        if e.key in ("spherical", "hook_R32", "hook_R23")
    ]
    monkeypatch.setattr(lierb.analysis.paper_examples, "EXAMPLES", chosen)


@pytest.fixture
def every_example(short_run, monkeypatch):
    monkeypatch.setattr(lierb.analysis.paper_examples, "EXAMPLES", EXAMPLES)


def run_without(modules, *arguments):
    command = [sys.executable, "-c", WITHOUT, modules, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


# ---------------------------------------------------------------- lierb paper


@pytest.mark.usefixtures("papers_kernels", "short_run")
class TestPaper:
    @pytest.mark.slow
    def test_writes_tables_and_figures_and_says_where(self, tmp_path, monkeypatch):
        monkeypatch.setattr(lierb.analysis.paper_examples, "EXAMPLES", EXAMPLES[:1])
        out = tmp_path / "out"
        result = invoke("paper", "--out", out)
        assert result.exit_code == 0, result.output
        assert f"Written to {out}:" in result.stdout
        assert "  figure_2_spherical_position.png, .svg\n" in result.stdout
        for name in ("summary.parquet", "history.parquet", "figure_2_spherical_position.png"):
            assert (out / name).stat().st_size > 1000

    @pytest.mark.slow
    def test_errors_that_a_joint_has_no_rows_for_are_dashes(self, tmp_path):
        table = invoke("paper", "--no-figures", "--out", tmp_path).stdout.split("\npos, rot:")[0]
        rows = [line.split() for line in table.splitlines() if " 1e-2 " in line]
        assert rows[0][0] == "spherical"
        assert (rows[1][:2], rows[1][3]) == (["SE3", "1e-2"], "–")
        cells = [row[row.index("1e-2") + 1 :][:2] for row in rows]
        assert [pair.count("–") for pair in cells] == [1, 1, 0, 0, 0, 0]

    @pytest.mark.slow
    @pytest.mark.usefixtures("every_example")
    def test_table_is_whole_in_eighty_columns(self, tmp_path):
        output = invoke("paper", "--no-figures", "--out", tmp_path).stdout
        table = output.split("\npos, rot:")[0].splitlines()
        assert max(map(len, table)) <= 80
        assert "…" not in output
        for word in ("joint", "c-space", "dt/s", "position", "rotation", "observed", "agrees"):
            assert word in output
        blocks = [line for line in table if " 1e-2 " in line]
        assert len(blocks) == 2 * len(lierb.analysis.paper_examples.EXAMPLES)

    @pytest.mark.slow
    @pytest.mark.usefixtures("every_example")
    def test_table_is_not_cut_in_a_narrow_window(self, tmp_path, monkeypatch):
        monkeypatch.setenv("COLUMNS", "40")
        output = invoke("paper", "--no-figures", "--out", tmp_path).stdout
        assert "…" not in output

    @pytest.mark.slow
    @pytest.mark.usefixtures("every_example")
    def test_says_which_reading_was_used(self, tmp_path):
        corrected = invoke("paper", "--no-figures", "--out", tmp_path).stdout
        assert "planar (corrected): " in corrected
        assert "hook R32 (text): " in corrected
        assert "hook R23 (formula): " in corrected
        assert "is ours" in " ".join(corrected.split())
        printed = invoke("paper", "--no-figures", "--as-printed", "--out", tmp_path).stdout
        assert "planar (as printed): " in printed
        assert "warning: " in printed

    def test_no_figures_writes_the_tables_only(self, tmp_path):
        invoke("paper", "--no-figures", "--out", tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            "history.parquet",
            "summary.parquet",
        ]

    def test_progress_goes_to_standard_error(self, tmp_path):
        result = invoke("paper", "--no-figures", "--out", tmp_path)
        assert "[0/18] spherical" in result.stderr
        assert "[0/18]" not in result.stdout

    def test_interrupt_ends_with_one_sentence_and_130(self, tmp_path, monkeypatch):
        def interrupted(*args, **kwargs):
            raise KeyboardInterrupt

        monkeypatch.setattr(lierb.analysis.paper, "run_paper", interrupted)
        result = invoke("paper", "--out", tmp_path)
        assert result.exit_code == 130
        assert "Interrupted" in result.stderr
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["paper", "--gravty", "1"], "--gravity"),
        (["paper", "--gravity", "much"], "--gravity"),
        (["paper", "--gravity", "nan"], "not a finite number"),
        (["paper", "--update", "sideways"], "'local', 'global'"),
        (["paper", "--out", __file__], "is a file"),
        (["papers"], "No such command"),
    ],
)
def test_wrong_arguments_are_named(arguments, expected):
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert expected in result.stderr
    assert "Traceback" not in result.stderr


def test_an_unwritable_folder_is_one_sentence():
    result = invoke("paper", "--out", "/dev/null/folder")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: ")
    assert "/dev/null" in result.stderr


# ---------------------------------------------------------------- extras


@pytest.mark.parametrize("extra", EXTRAS)
def test_require_passes_when_the_extra_is_there(extra):
    require(extra)


@pytest.mark.parametrize("extra", EXTRAS)
def test_require_says_what_to_install(extra, monkeypatch):
    package = EXTRAS[extra][1][0]
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=package) as caught:
        require(extra)
    assert str(caught.value).endswith(f"which is not installed: {remedy(extra)}")


WHEEL = "lierb-0.1.0-py3-none-any.whl"
GIT = {"vcs": "git", "commit_id": "83de077", "requested_revision": "main"}
INSTALLED = {  # what installers leave behind (PEP 610), and what follows from it
    "editable checkout": (
        {"url": "{folder}", "dir_info": {"editable": True}},
        "pip install -e '{path}[cli]'",
    ),
    "folder": ({"url": "{folder}", "dir_info": {}}, "pip install '{path}[cli]'"),
    "wheel": (
        {"url": "{folder}/" + WHEEL, "archive_info": {"hash": "sha256=0"}},
        "pip install 'lierb[cli] @ {folder}/" + WHEEL + "'",
    ),
    "wheel that is gone": (
        {"url": "{folder}/gone.whl", "archive_info": {}}, "pip install click rich",
    ),
    "folder that is gone": (
        {"url": "{folder}/gone", "dir_info": {"editable": True}}, "pip install click rich",
    ),
    "wheel on a server": (
        {"url": "https://example.org/" + WHEEL, "archive_info": {}},
        "pip install 'lierb[cli] @ https://example.org/" + WHEEL + "'",
    ),
    "repository": (
        {"url": "https://example.org/l.git", "vcs_info": GIT, "subdirectory": "python"},
        "pip install 'lierb[cli] @ git+https://example.org/l.git@83de077#subdirectory=python'",
    ),
    "index": (None, "pip install 'lierb[cli]'"),
}  # fmt: skip


@pytest.mark.skipif(os.name == "nt", reason="other quotes there")
@pytest.mark.parametrize("way", INSTALLED)
def test_remedy_names_the_way_it_was_installed(way, tmp_path, monkeypatch):
    origin, expected = INSTALLED[way]
    there = tmp_path / "a checkout"  # its space is %20 in a URL, and needs quotes
    there.mkdir()
    (there / WHEEL).touch()
    names = {"{folder}": there.as_uri(), "{path}": str(there)}
    for name, value in names.items():
        origin = json.loads(json.dumps(origin).replace(name, value))
        expected = expected.replace(name, value)
    files = {"direct_url.json": json.dumps(origin)} if origin else {}
    install(tmp_path / "site", monkeypatch, **files)
    assert remedy("cli") == expected


def install(site, monkeypatch, **files):
    """Make `site` the only place where distributions are, lierb among them with these files."""
    folder = site / "lierb-0.1.0.dist-info"
    folder.mkdir(parents=True)
    for name, text in {"METADATA": "Name: lierb\nVersion: 0.1.0\n", **files}.items():
        (folder / name).write_text(text)
    import_module("urllib.request")  # which looks at URLs, while the standard library is found
    monkeypatch.setattr(sys, "path", [str(site)])


@pytest.mark.skipif(os.name == "nt", reason="other quotes there")
def test_remedy_in_the_checkout_and_with_uv_and_from_nowhere(tmp_path, monkeypatch):
    origin = {"url": tmp_path.as_uri(), "dir_info": {"editable": True}}
    files = {"direct_url.json": json.dumps(origin), "INSTALLER": "uv\n"}
    install(tmp_path / "site", monkeypatch, **files)
    monkeypatch.chdir(tmp_path)
    assert remedy("study") == "uv pip install -e '.[study]'"
    monkeypatch.setattr(sys, "path", [])
    assert remedy("study") == "pip install filelock pydantic scipy tomli_w"


def test_all_hints_to_install_come_from_one_function():
    sources = {path.name: path.read_text() for path in Path(lierb.__file__).parent.rglob("*.*py")}
    sources |= {p.name: p.read_text() for p in Path(lierb.__file__).parent.rglob("*.html")}
    assert [name for name, text in sources.items() if "pip install" in text] == ["extras.py"]


@pytest.mark.parametrize("package", slow_but(["click", "rich"], "click"))
def test_command_without_its_extra_is_one_sentence(package):
    done = run_without(package, "paper")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.strip() == (
        f"The command line needs {package}, which is not installed: {remedy('cli')}"
    )


@pytest.mark.slow
def test_figures_without_their_extra_are_one_sentence(tmp_path):
    done = run_without("matplotlib", "paper", "--out", tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip() == (
        f"Error: Drawing figures needs matplotlib, which is not installed: {remedy('plot')}"
    )
    assert not list(tmp_path.iterdir())


def test_importing_plots_without_matplotlib_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "lierb.results.plots", raising=False)
    with pytest.raises(MissingExtraError, match="needs matplotlib, which is not installed: "):
        import lierb.results.plots  # noqa: F401


# ---------------------------------------------------------------- examples

ROOT = Path(__file__).parent.parent
FILES = {path.stem: path for path in (ROOT / "examples").glob("*.toml")}


def test_examples_are_listed_with_a_line_each():
    lines = invoke("example").stdout.splitlines()
    assert [line.split()[0] for line in lines] == sorted(FILES)
    for line in lines:
        assert len(line) <= 80
        assert line.split(maxsplit=1)[1].endswith(".")  # a sentence, whole


@pytest.mark.parametrize("name", FILES)
def test_example_prints_the_study(name):
    text = invoke("example", name).stdout_bytes.decode()
    assert tomllib.loads(text) == tomllib.loads(FILES[name].read_text(encoding="utf-8"))
    assert "#:schema" not in text  # its path is the checkout's


def test_example_that_is_none_is_named():
    result = invoke("example", "heavytop")
    assert result.exit_code == 1
    assert "Did you mean 'heavy_top'?" in result.stderr


@pytest.mark.slow
def test_example_is_utf8_whatever_the_terminal_has():
    command = [sys.executable, "-m", "lierb", "example", "heavy_top"]
    environment = {**os.environ, "PYTHONIOENCODING": "koi8-r"}
    done = subprocess.run(command, capture_output=True, timeout=120, check=True, env=environment)
    assert "SO(3)×R³" in done.stdout.decode()


@pytest.mark.slow
def test_a_wheel_has_the_examples_and_names_itself(tmp_path):
    """Built, and installed beside what is here: it prints them, and its hint is its own path."""
    pytest.importorskip("hatchling")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, capture_output=True, timeout=120, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    install = ["pip", "install", "--quiet", "--no-deps", "--no-index", "--target", site, wheel]
    subprocess.run([sys.executable, "-m", *map(str, install)], timeout=120, check=True)
    shown = [sys.executable, "-c", WITHOUT, "rich", "example", "heavy_top"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
    options = {"cwd": tmp_path, "capture_output": True, "timeout": 120, "env": environment}
    hint = subprocess.run(shown, check=False, text=True, **options).stderr
    assert f"pip install 'lierb[cli] @ {wheel.as_uri()}'" in hint
    command = [sys.executable, "-m", "lierb", "example"]
    listed = subprocess.run(command, check=True, text=True, **options).stdout
    assert [line.split()[0] for line in listed.splitlines()] == sorted(FILES)
    printed = subprocess.run([*command, "satellite"], check=True, **options).stdout
    assert tomllib.loads(printed.decode())["sample"]["n"] == 20_000
    schema = site / "lierb" / "examples" / "study.schema.json"
    assert schema.read_bytes() == (ROOT / "docs" / "study.schema.json").read_bytes()


# ---------------------------------------------------------------- as a process


def test_command_line_starts_without_matplotlib_and_rich_tables():
    code = "import sys, lierb.cli; print({'matplotlib', 'rich.table'} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.slow
def test_a_warning_is_told_without_a_line_of_python():
    code = """
import lierb.__main__, lierb.cli, warnings
lierb.cli.cli = lambda **_: warnings.warn("mind it", stacklevel=1)
lierb.__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "Warning: mind it\n"


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_the_process_cleanly(tmp_path):
    command = [sys.executable, "-m", "lierb", "paper", "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as run:
        assert "spherical" in run.stderr.readline()  # it has begun
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=120)
    assert run.returncode == 130
    assert "Interrupted" in errors
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_module_runs_as_a_command_and_survives_a_terminal_without_umlauts():
    command = [sys.executable, "-m", "lierb", "paper", "--help"]
    environment = {**os.environ, "PYTHONIOENCODING": "koi8-r"}
    done = subprocess.run(
        command, capture_output=True, encoding="koi8-r", timeout=120, check=True, env=environment
    )
    assert "M?ller" in done.stdout


def test_tables_print_names_and_units_with_brackets(capsys):
    table = Table("force", "unit")
    table.add_row("air[/x].drag[blue]", "[m/s]")
    print_whole(table)
    printed = capsys.readouterr().out
    assert "air[/x].drag[blue]" in printed
    assert "[m/s]" in printed

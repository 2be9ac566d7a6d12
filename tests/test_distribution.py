"""Versions come from tags; workflows call what there is, and need no secret."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
from importlib import metadata
from pathlib import Path

import pytest

import lierb

ROOT = Path(__file__).parent.parent
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

pytest.importorskip("hatchling")
pytest.importorskip("hatch_vcs")
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")


def test_version_is_that_of_the_installation():
    assert lierb.__version__ == metadata.version("lierb")


@pytest.fixture
def checkout(tmp_path) -> Path:
    """Files of a version and an sdist, in a folder outside of any repository."""
    folder = tmp_path / "checkout"
    (folder / "lierb").mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, folder)
    (folder / "lierb" / "__init__.py").touch()
    return folder


def hatchling(folder: Path, *arguments: object) -> str:
    command = [sys.executable, "-m", "hatchling", *map(str, arguments)]
    environment = os.environ | {"GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def git(folder: Path, *arguments: str) -> None:
    own = ["-c", "user.name=lierb", "-c", "user.email=lierb@example.org", "-c", "commit.gpgsign=no"]
    subprocess.run(["git", "-C", str(folder), *own, *arguments], check=True, capture_output=True)


def test_version_without_git_is_the_fallback(checkout):
    said = re.search(r'fallback-version = "(.*?)"', (ROOT / "pyproject.toml").read_text("utf-8"))
    assert hatchling(checkout, "version") == said[1]


@needs_git
def test_version_is_the_tag_and_an_sdist_keeps_it(checkout, tmp_path):
    git(checkout, "init", "--quiet")
    git(checkout, "add", ".")
    git(checkout, "commit", "--quiet", "-m", "first")
    without_tag = hatchling(checkout, "version")
    assert re.fullmatch(r"\d+\.\d+\.\d+\.dev1\+g[0-9a-f]+", without_tag)
    git(checkout, "tag", "v12.3.4")
    assert hatchling(checkout, "version") == "12.3.4"
    hatchling(checkout, "build", "-t", "sdist", "-d", tmp_path)
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    assert hatchling(tmp_path / "lierb-12.3.4", "version") == "12.3.4"


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflow_calls_targets_that_exist_and_no_secret(workflow):
    text = workflow.read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    called = re.findall(r"run: make ([a-z-]+)", text)
    assert called
    assert set(called) <= set(targets)
    assert "secrets." not in text


def test_workflows_build_the_site_the_tests_and_the_release():
    assert {path.stem for path in WORKFLOWS} == {"docs", "release", "tests"}

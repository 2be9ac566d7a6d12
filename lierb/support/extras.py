"""The optional parts of lierb, the packages that each needs, and how to install them here."""

from __future__ import annotations

import json
import os
import shlex
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

EXTRAS = {
    "cli": ("The command line", ("click", "rich")),
    "mesh": ("Making a body of a mesh", ("trimesh",)),
    "mjcf": ("Reading MJCF and URDF", ("mujoco",)),
    "scipy": ("Drawing from normal distributions, or by Sobol points,", ("scipy",)),
    "plot": ("Drawing figures", ("matplotlib",)),
    "pandas": ("A pandas data frame", ("pandas",)),
    "polars": ("A polars data frame", ("polars",)),
    "study": ("Running studies", ("filelock", "pydantic", "scipy", "tomli_w")),
    "report": ("Writing reports", ("jinja2", "plotly", "matplotlib", "pydantic")),
    "cluster": ("Running studies on a cluster", ("distributed",)),
}
DIRECT = "direct_url.json"  # where a distribution is from if not from an index: PEP 610


class MissingExtraError(ImportError):
    """A package of an optional part is not installed."""


def is_installed(extra: str) -> bool:
    """Whether the packages of `extra` are there, none of them imported."""
    _, packages = EXTRAS[extra]
    return all(find_spec(package) is not None for package in packages)


def require(extra: str) -> None:
    """Import the packages of `extra`, or say in one sentence what to install.

    Raises
    ------
    MissingExtraError
        when one of them is not installed.
    """
    purpose, packages = EXTRAS[extra]
    for package in packages:
        try:
            import_module(package)
        except ModuleNotFoundError as error:
            # A package that is there and lacks one of its own dependencies names that one instead.
            message = f"{purpose} needs {error.name}, which is not installed: {remedy(extra)}"
            raise MissingExtraError(message) from error


# ---- how to install ----------------------------------------------------------------------------


def remedy(extra: str) -> str:
    """The command that adds an optional part to lierb as it is installed here.

    A checkout is named by its path, a wheel or a repository by its URL: the name alone would be
    looked for in an index. Where it is from nowhere that is still there, the packages are named.
    """
    packages = " ".join(EXTRAS[extra][1])
    try:
        installed = metadata.distribution("lierb")
    except metadata.PackageNotFoundError:
        return f"pip install {packages}"
    installer = (installed.read_text("INSTALLER") or "").strip()
    command = "uv pip install" if installer == "uv" else "pip install"
    origin = json.loads(installed.read_text(DIRECT) or "{}")
    url = origin.get("url", "")
    if url.startswith("file:") and not _path(url).exists():
        return f"{command} {packages}"
    return f"{command} {_requirement(extra, url, origin)}"


def _requirement(extra: str, url: str, origin: dict[str, Any]) -> str:
    """lierb with an extra, from where it was installed, quoted for a shell."""
    if "dir_info" in origin:
        folder = _path(url)
        here = "." if folder == Path.cwd() else str(folder)
        editable = "-e " if origin["dir_info"].get("editable") else ""
        return editable + _quoted(f"{here}[{extra}]")
    if "vcs_info" in origin:
        version = origin["vcs_info"]
        url = f"{version['vcs']}+{url}@{version['commit_id']}"
    if "subdirectory" in origin:
        url += f"#subdirectory={origin['subdirectory']}"
    return _quoted(f"lierb[{extra}] @ {url}" if url else f"lierb[{extra}]")


def _path(url: str) -> Path:
    """What a file:// URL names."""
    from urllib.parse import urlsplit
    from urllib.request import url2pathname  # 30 ms, which importing lierb should not take

    return Path(url2pathname(urlsplit(url).path))


def _quoted(text: str) -> str:
    """Brackets are patterns to a shell; Windows knows double quotes only."""
    return f'"{text}"' if os.name == "nt" else shlex.quote(text)

"""Require the optional parts of lierb, and name the commands that install them."""

from __future__ import annotations

import json
import os
import shlex
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lierb.errors import MissingExtraError

EXTRAS = {
    "cli": ("The command line", ("click", "rich")),
    "mesh": ("Making a body of a mesh", ("trimesh",)),
    "mjcf": ("Reading MJCF and URDF", ("mujoco",)),
    "scipy": ("Fitting, or drawing from normal distributions or by Sobol points,", ("scipy",)),
    "plot": ("Drawing figures", ("matplotlib",)),
    "pandas": ("A pandas data frame", ("pandas",)),
    "polars": ("A polars data frame", ("polars",)),
    "study": ("Running studies", ("filelock", "pydantic", "scipy", "tomli_w")),
    "report": ("Writing reports", ("jinja2", "plotly", "matplotlib", "pydantic")),
    "cluster": ("Running studies on a cluster", ("distributed",)),
}
DIRECT = "direct_url.json"  # origin of a distribution that is not from an index (PEP 610)


def is_installed(extra: str) -> bool:
    """Return whether the packages of `extra` are installed, without importing them."""
    _, packages = EXTRAS[extra]
    return all(find_spec(package) is not None for package in packages)


def require(extra: str) -> None:
    """Import the packages of `extra`.

    Raises
    ------
    MissingExtraError
        A package is not installed. The message contains the command that installs it.
    """
    purpose, packages = EXTRAS[extra]
    for package in packages:
        try:
            import_module(package)
        except ModuleNotFoundError as error:
            # The missing module may be a dependency of an installed package.
            message = f"{purpose} needs {error.name}, which is not installed: {remedy(extra)}"
            raise MissingExtraError(message) from error


def remedy(extra: str) -> str:
    """Return the command that adds an optional part to the installed lierb.

    The command names a checkout by its path, a wheel or a repository by its URL, as lierb may not
    be in an index. If that origin no longer exists, the command installs the packages themselves.
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
    """Return the requirement for lierb with an extra, from its origin, quoted for a shell."""
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
    """Return the path of a file:// URL."""
    from urllib.parse import urlsplit
    from urllib.request import url2pathname  # imported here: it takes 30 ms

    return Path(url2pathname(urlsplit(url).path))


def _quoted(text: str) -> str:
    """Quote a requirement, as shells expand brackets; Windows needs double quotes."""
    return f'"{text}"' if os.name == "nt" else shlex.quote(text)

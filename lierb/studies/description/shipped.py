"""Example studies of the package."""

from __future__ import annotations

from pathlib import Path

from lierb.errors import unknown_name

PACKAGE = Path(__file__).parents[2]
SCHEMA = "#:schema "  # for editors; its path holds in the checkout only


def _folder() -> Path:
    """Folder of the examples: inside the package in a wheel, beside it in a checkout."""
    inside = PACKAGE / "examples"
    return inside if inside.is_dir() else PACKAGE.parent / "examples"


def examples() -> dict[str, str]:
    """Return the first comment of each example, by name."""
    names = sorted(path.stem for path in _folder().glob("*.toml"))
    return {name: example(name).partition("\n")[0].removeprefix("# ") for name in names}


def example(name: str) -> str:
    """Return the TOML text of an example, or a Python file FILE.py that an example refers to.

    Raises UnknownNameError.
    """
    known = sorted(path.stem for path in _folder().glob("*.toml"))
    files = sorted(path.name for path in _folder().glob("*.py"))
    if name in files:
        return (_folder() / name).read_text(encoding="utf-8")
    if name not in known:
        raise unknown_name("example", name, (*known, *files))
    text = (_folder() / f"{name}.toml").read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith(SCHEMA))

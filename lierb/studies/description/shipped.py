"""Find the example studies of the package."""

from __future__ import annotations

from pathlib import Path

from lierb.errors import require_name

PACKAGE = Path(__file__).parents[2]
SCHEMA = "#:schema "  # for editors; the path is valid only in the checkout


def _folder() -> Path:
    """Return the folder of the examples: in the installed package, or beside it in a checkout."""
    inside = PACKAGE / "examples"
    return inside if inside.is_dir() else PACKAGE.parent / "examples"


def examples() -> dict[str, str]:
    """Return the first comment line of each example, by name."""
    names = sorted(path.stem for path in _folder().glob("*.toml"))
    return {name: example(name).partition("\n")[0].removeprefix("# ") for name in names}


def example(name: str) -> str:
    """Return the text of an example, or of a Python file FILE.py to which an example refers.

    Raises UnknownNameError.
    """
    known = sorted(path.stem for path in _folder().glob("*.toml"))
    files = sorted(path.name for path in _folder().glob("*.py"))
    if name in files:
        return (_folder() / name).read_text(encoding="utf-8")
    require_name("example", name, (*known, *files))
    text = (_folder() / f"{name}.toml").read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith(SCHEMA))

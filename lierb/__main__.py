"""Entry point of the `lierb` command and of `python -m lierb`."""

import sys
import warnings
from typing import Any

from lierb.support.extras import MissingExtraError, require


def main() -> None:
    """Run the command line; without its packages, say how to get them."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show "ü" shows "?" instead of a traceback.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        require("cli")
    except MissingExtraError as error:
        sys.exit(str(error))
    from lierb.cli import cli

    warnings.showwarning = _tell
    cli(prog_name="lierb")


def _tell(message: Warning | str, *_: Any, **__: Any) -> None:
    """A warning in its own words: nobody who types a command asks for a line of Python."""
    print(f"Warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    main()

"""Entry point of the `lierb` command and of `python -m lierb`."""

import sys
import warnings
from typing import Any

from lierb.errors import MissingExtraError
from lierb.support.extras import require


def main() -> None:
    """Run the command line, or exit with a message if its packages are not installed."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show "ü" shows "?" instead of a traceback.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        require("cli")
    except MissingExtraError as error:
        sys.exit(str(error))
    try:
        from lierb.cli import cli

        warnings.showwarning = _show_warning
        cli(prog_name="lierb")
    except KeyboardInterrupt:  # before a command has begun
        sys.exit(130)  # 128 + SIGINT, as of shells


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning without the line of Python that caused it."""
    print(f"Warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    main()

"""Entry point of the `lierb` command and of `python -m lierb`."""

import sys

from lierb.extras import MissingExtraError, require


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

    cli(prog_name="lierb")


if __name__ == "__main__":
    main()

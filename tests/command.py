"""The `lierb` command as a function."""

from __future__ import annotations

import inspect
from typing import Any

from click.testing import CliRunner, Result

from lierb.cli import cli

# This option separates the two outputs before click 8.2, which always separates them.
APART = {"mix_stderr": False} if "mix_stderr" in inspect.signature(CliRunner).parameters else {}


def invoke(*arguments: object, **options: Any) -> Result:
    """`lierb ARGUMENTS …`: its `exit_code`, `stdout` and `stderr`; options as click's `invoke`."""
    return CliRunner(**APART).invoke(cli, [str(argument) for argument in arguments], **options)

"""Define the `lierb` command, which needs click and rich: the extra `lierb[cli]`."""

from lierb.cli.main import cli

__all__ = ["cli"]

"""The optional parts of lierb and the packages that each needs."""

from importlib import import_module

EXTRAS = {
    "cli": ("The command line", ("click", "rich")),
    "scipy": ("Drawing from normal distributions, or by Sobol points,", ("scipy",)),
    "plot": ("Drawing figures", ("matplotlib",)),
    "study": ("Running studies", ("pydantic", "scipy", "tomli_w")),
    "report": ("Writing reports", ("jinja2", "plotly", "matplotlib", "pydantic")),
    "cluster": ("Running studies on a cluster", ("distributed",)),
}


class MissingExtraError(ImportError):
    """A package of an optional part is not installed."""


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
            remedy = f'pip install "lierb[{extra}]"'
            message = f"{purpose} needs {error.name}, which is not installed: {remedy}"
            raise MissingExtraError(message) from error

"""Messages for keyword arguments and attributes that do not exist."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import wraps
from typing import NoReturn, ParamSpec, TypeVar

from lierb.errors import NEAR

P = ParamSpec("P")
R = TypeVar("R")


def explains_keywords(
    synonyms: Mapping[str, str], name: str = ""
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function: a TypeError for an unknown keyword has what to give instead.

    synonyms : text of what to give, by names in other tools.
    name : name in messages. Default: that of the function.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        known = inspect.signature(function).parameters

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for keyword in kwargs:
                if keyword not in known:
                    raise TypeError(
                        f"{name or function.__name__} got an unexpected keyword argument "
                        f"{keyword!r}{_remedy(keyword, synonyms, known, 'give')}"
                    )
            return function(*args, **kwargs)

        return call

    return decorate


def no_attribute(
    owner: str, name: str, known: Iterable[str], synonyms: Mapping[str, str]
) -> AttributeError:
    """Return the error for an attribute that does not exist.

    synonyms : what to take instead, by names in other tools.
    """
    return AttributeError(f"{owner} has no {name!r}{_remedy(name, synonyms, known, 'take')}")


def names_of_module(
    owner: str, known: Sequence[str], synonyms: Mapping[str, str]
) -> tuple[Callable[[str], NoReturn], Callable[[], list[str]]]:
    """Return a module's `__getattr__` and `__dir__`; see `no_attribute`.   known : public names."""

    def missing(name: str) -> NoReturn:
        raise no_attribute(owner, name, known, synonyms)

    return missing, lambda: list(known)


def _remedy(name: str, synonyms: Mapping[str, str], known: Iterable[str], verb: str) -> str:
    if here := synonyms.get(name) or synonyms.get(name.lower()):
        return f"; {verb} {here}"
    public = [each for each in known if not each.startswith("_")]
    near = get_close_matches(name, public, n=1, cutoff=NEAR)
    return f". Did you mean {near[0]!r}?" if near else ""

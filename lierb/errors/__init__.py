"""Errors and warnings of the public functions.

A message states the fault, its place, the actual and the expected value, and a remedy.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from itertools import islice
from reprlib import Repr
from typing import Any

from lierb.errors.synonyms import here

__all__ = [
    "LierbError", "ArgumentError", "UnknownNameError", "InertiaError", "ForceError", "PoseError",
    "TwistError", "StudyError", "StudyFileError", "TimeGridError", "MemoryLimitError",
    "InconsistentStateWarning", "FailedTrajectoryWarning", "FailedFitWarning",
    "ScalarFunctionWarning", "StudyWarning", "StiffStepWarning", "LeftOutWarning",
    "DerivativeWarning", "ForkError", "MissingExtraError",
]  # fmt: skip


def __dir__() -> list[str]:
    return list(__all__)


class LierbError(ValueError):
    """Base of all of lierb's errors about arguments."""


class ArgumentError(LierbError):
    """An argument has the wrong shape, type or value."""


class UnknownNameError(LierbError):
    """A name (joint row, method, c-space, …) does not exist."""


class InertiaError(LierbError):
    """A mass or inertia is impossible for a rigid body."""


class ForceError(LierbError):
    """A force acts about an axis that its joint lacks, or a kernel cannot run a function."""


class PoseError(LierbError):
    """A pose is not a rigid motion, or violates the joint."""


class TwistError(LierbError):
    """A twist violates the joint."""


class StudyError(LierbError):
    """A study cannot be run, or results belong to another study."""


class StudyFileError(StudyError, OSError):
    """A file of a study's results cannot be read or written, as on a full disk."""

    __new__ = OSError.__new__  # type: ignore[assignment]  # else `distributed` cannot unpickle it


class TimeGridError(LierbError):
    """dt, t_end, save_every or measure_every do not make a time grid."""


class MemoryLimitError(LierbError):
    """Results are larger than the free memory."""


class InconsistentStateWarning(UserWarning):
    """The initial pose or twist violates the joint, with check="warn"; or a motor's position."""


class FailedTrajectoryWarning(UserWarning):
    """Trajectories ended early, as `singular`, `non_finite` or `raised`."""


class FailedFitWarning(UserWarning):
    """Some of many fits have not converged, or the runs of their guesses failed."""


class StiffStepWarning(UserWarning):
    """Steps are too long for the stability of an explicit method, or are limited by it.

    Fixed steps: they are beyond the method's stability bound for a force of `lierb.forces`. Forces
    are linearised at the start: springs and dampers at the initial state, friction at zero
    velocity, and stops in contact. For an eigenvalue λ of the result, an error grows from step to
    step if the magnitude of R(hλ) exceeds 1, though the force damps it. The warning is issued if
    the error doubles within the run. Users' functions are not examined.

    Adaptive steps: a trajectory of 2000 steps or more has a mean step near the stability bound for
    the fastest decay of the motion at its end, users' functions included.
    """


class ScalarFunctionWarning(UserWarning):
    """A user's function runs body by body, because it cannot run for many bodies at once."""


class StudyWarning(UserWarning):
    """Results of a study may differ between machines or versions, or a file was missing."""


class LeftOutWarning(UserWarning):
    """A mechanism lacks elements of the file that it was read from; `left_out` lists them."""

    def __init__(self, path: object, left_out: Iterable[str]) -> None:
        self.left_out = tuple(left_out)
        super().__init__(f"{brief(path)}: left out are {'; '.join(self.left_out)}")


class DerivativeWarning(UserWarning):
    """A force or function switches, or adaptive steps are long: derivatives may be wrong.

    Where a force or a rate of a state jumps at a place or speed, the derivatives of the motion jump
    too. `lierb.integrate` does not add this jump: derivatives are right only if the function is
    continuous there, such as a spring that is slack on one side, or if no trajectory gets there.
    """


class MissingExtraError(ImportError):
    """A package of an optional part of lierb is not installed."""


class ForkError(RuntimeError):
    """The process was forked after its threads had started; they do not exist in the child."""


NEAR = 0.5  # least similarity of a name that is suggested
MOST_ITEMS = 10**6  # limit for an iterable argument, which may be infinite

_short = Repr()
_short.maxstring = _short.maxother = _short.maxlong = 100
_short.maxlevel = 3


def brief(given: object) -> str:
    """Return a short description of any object, on one line, for a message."""
    try:
        words = " ".join(_short.repr(given).split())
    except Exception:  # any from a user's object; ValueError for integers above 4300 digits
        words = f"<{type(given).__name__}>"
    return words if len(words) <= 200 else f"{words[:100]} … {words[-80:]}"


def items_of(argument: str, given: Any, expected: str) -> tuple[Any, ...]:
    """Return the items of an iterable, MOST_ITEMS at most; raise ArgumentError otherwise."""
    try:
        items = tuple(islice(given, MOST_ITEMS + 1))
    except Exception as error:  # a user's object may raise any exception
        raise ArgumentError(f"{argument}={brief(given)}; expected {expected}") from error
    if len(items) > MOST_ITEMS:
        raise ArgumentError(
            f"{argument}={brief(given)} has more than {MOST_ITEMS} items; expected {expected}"
        )
    return items


def require_name(argument: str, got: object, known: Iterable[str]) -> None:
    """Raise UnknownNameError unless `got` is one of the known strings."""
    if not (isinstance(got, str) and got in known):
        raise unknown_name(argument, got, known)


def unknown_name(argument: str, got: object, known: Iterable[str]) -> UnknownNameError:
    """Return the error for a name outside `known`, with its synonym or the nearest one."""
    names = list(dict.fromkeys(known))
    lowered = {name.lower(): name for name in names}
    if synonym := here(got, lowered):
        return UnknownNameError(
            f"{argument}={brief(got)} is a name of other packages; take {synonym} here"
        )
    text = got[:100].lower() if isinstance(got, str) else ""
    near = get_close_matches(text, list(lowered), n=1, cutoff=NEAR)
    hint = f" Did you mean {lowered[near[0]]!r}?" if near else ""
    return UnknownNameError(
        f"{argument}={brief(got)} is unknown; choose from {', '.join(names)}.{hint}"
    )


def two_readings(argument: str, shape: tuple[int, ...], **ways: str) -> ArgumentError:
    """Return the error for an ambiguous shape. ways : expression for each meaning, by meaning."""
    listed = ", ".join(f"{way} for {meaning.replace('_', ' ')}" for meaning, way in ways.items())
    return ArgumentError(f"{argument} has shape {shape}, which may mean two things; give {listed}")


def body_label(argument: str, body: int, count: int) -> str:
    """Label of a body's argument in messages: `twist0[17]`, or `twist0` for a single body."""
    return f"{argument}[{body}]" if count > 1 else argument


def beyond_numbers(label: str, what: str) -> str:
    """Message for a start whose constraint residual overflows."""
    return (
        f"{label} has a {what} beyond all numbers: the squares of what it is made of overflow; "
        "give smaller numbers, or choose larger units"
    )

"""The reference of a comparison is the states at t_end, and their errors."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from lierb.analysis.case import Case
from lierb.analysis.magnitudes import magnitudes
from lierb.errors import ArgumentError, FailedTrajectoryWarning, LierbError, brief
from lierb.model.base import Model
from lierb.results.columns import as_array
from lierb.results.failures import Failures, has_failed
from lierb.results.result import Result
from lierb.runs.options import Options
from lierb.runs.starts import arrays_of, start_of
from lierb.support.arrays import Array, components, pose_matrix
from lierb.support.representations import counted

ERRORS = {"rotation": "rad", "position": "m", "omega": "rad/s", "v": "m/s"}
NORMS: dict[str, Callable[[Array], Any]] = {"largest": np.max, "median": np.median}
METHOD = "DOP853"  # method of the reference
CSPACES = ("reduced", "SE3", "SO3xR3")  # c-spaces of the reference, in order of preference
MARGIN = 10.0  # least ratio of an error to the reference's error, for an accuracy of 10 %
EPSILON = float(np.finfo(float).eps)
LEAST_STEPS = 64  # their accumulated rounding equals that of the data and of the end states
RESOLVED = 1e-6  # relative differences above this are not rounding
GIVEN = "given"
FIRST_STEPS = 256  # first number of the reference's steps, without dt
HALVINGS, MORE_HALVINGS = 6, 12  # most halvings of the reference's step, with and without dt


def rounding(steps: Any) -> Any:
    """Return a bound of the accumulated relative rounding error: one unit in each step."""
    return EPSILON * np.maximum(steps, LEAST_STEPS)


# ---- ends --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ends:
    """States at t_end.

    poses : (n, 4, 4), and twists : (n, 6), by link.   failed : trajectories that did not get there.
    """

    poses: dict[str, Array]
    twists: dict[str, Array]
    failed: NDArray[np.bool_]

    @classmethod
    def of(cls, summary: pa.Table, links: tuple[str, ...]) -> Ends:
        """Return the ends in a result's summary."""
        poses, twists = {}, {}
        for link in links or ("",):
            prefix = f"{link}." if link else ""
            rotation, position, omega, v = (as_array(summary[f"{prefix}{name}"]) for name in ERRORS)
            poses[link] = pose_matrix((components(rotation), components(position)))
            twists[link] = np.hstack((omega, v))
        return cls(poses, twists, has_failed(summary))

    @classmethod
    def at(cls, model: Model, poses: Any, twists: Any) -> Ends:
        """Make the ends from poses and twists in the form of pose0 and twist0."""
        placed = arrays_of(model, "reference: pose0", poses)
        moving = arrays_of(model, "reference: twist0", twists)
        placed = {link: pose.reshape(-1, 4, 4) for link, pose in placed.items()}
        moving = {link: twist.reshape(-1, 6) for link, twist in moving.items()}
        counts = {len(array) for array in (*placed.values(), *moving.values())}
        if len(counts) > 1:  # arrays are not broadcast
            raise ArgumentError(
                f"reference has poses and twists of {', '.join(map(str, sorted(counts)))} "
                "trajectories; expected a pose and a twist for each"
            )
        return cls(placed, moving, np.zeros(counts.pop(), dtype=bool))

    def state_of(self, link: str) -> dict[str, Array]:
        """Return the state of a link, by the names in ERRORS."""
        pose, twist = self.poses[link], self.twists[link]
        parts = pose[:, :3, :3], pose[:, :3, 3], twist[:, :3], twist[:, 3:]
        return dict(zip(ERRORS, parts, strict=True))

    def errors(self, exact: Ends) -> dict[str, Array]:
        """Return the distances from other ends, (n,) by ERRORS; the largest over the links.

        NaN for trajectories that have failed in either.
        """
        by_name = {}
        pairs = [(self.state_of(link), exact.state_of(link)) for link in self.poses]
        for name in ERRORS:
            distance = _angle if name == "rotation" else _distance
            each = [distance(own[name], other[name]) for own, other in pairs]
            largest = np.max(np.broadcast_arrays(*each, self.failed)[:-1], axis=0)
            by_name[name] = np.where(self.failed | exact.failed, np.nan, largest)
        return by_name


def _angle(a: Array, b: Array) -> Array:
    """Return the angle of AᵀB, rad, by ‖A − B‖ = 2√2 sin(θ/2), accurate at 0 and π."""
    norm = np.sqrt(((a - b) ** 2).sum(axis=(1, 2)))
    return np.asarray(2.0 * np.arcsin(np.minimum(norm / np.sqrt(8.0), 1.0)))


def _distance(a: Array, b: Array) -> Array:
    return np.asarray(np.linalg.norm(a - b, axis=1))


# ---- sizes -------------------------------------------------------------------------------------


def sizes_of(model: Model, ends: Ends, twist0: Any) -> dict[str, float]:
    """Return the scales of errors and drifts by name, medians over the trajectories."""
    _, starts = start_of(model, None, twist0)
    with np.errstate(all="ignore"):  # a trajectory may diverge
        placed, moving = model.from_links(ends.poses), model.from_links(ends.twists)
        length, energy = (float(np.nanmedian(each)) for each in magnitudes(model, placed, moving))
        twists = (*starts.values(), *ends.twists.values())
        omega, v = (
            max(float(np.nanmedian(np.linalg.norm(twist[..., part], axis=-1))) for twist in twists)
            for part in (slice(0, 3), slice(3, 6))
        )
    return {
        "error.rotation": 1.0, "error.position": length, "error.omega": omega,
        "error.v": max(v, length * omega),
        "drift.position": length, "drift.rotation": 1.0, "drift.energy": energy,
    }  # fmt: skip


# ---- references --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """States of the trajectories at t_end.

    errors : estimated errors of the reference, by ERRORS, in the norm of the comparison.
    what : description of the reference.
    """

    ends: Ends
    errors: dict[str, float]
    what: str


def given_reference(given: Any, model: Model, t_end: float) -> Reference:
    """Return a user's reference: a Result, a `Result.end` or a like dict, or (pose, twist)."""
    expected = (
        "the lierb.Result of another run, its `end`, or a pair of poses and twists at t_end, as "
        "pose0 and twist0 of integrate"
    )
    links = tuple(filter(None, model.link_names))
    if isinstance(given, Result):
        if given.links != links:
            raise ArgumentError(f"reference has the links {given.links}; expected {links}")
        ends = Ends.of(given.summary, given.links)
        if ends.failed.all():
            raise ArgumentError(f"reference: {Failures.of(given.summary)}; none is left to compare")
        went_on = pc.equal(given.summary["status"].cast(pa.string()), "ok").to_numpy()
        for t in as_array(given.summary["t"])[went_on][:1].tolist():
            _require_time(t, t_end)
        return Reference(ends, dict.fromkeys(ERRORS, 0.0), GIVEN)
    if isinstance(given, Mapping) and {"pose0", "twist0"} <= given.keys():
        _require_time(given.get("t0", t_end), t_end)
        given = given["pose0"], given["twist0"]
    if not (isinstance(given, tuple) and len(given) == 2):
        raise ArgumentError(f"reference={brief(given)}; expected {expected}")
    return Reference(Ends.at(model, *given), dict.fromkeys(ERRORS, 0.0), GIVEN)


def _require_time(t: Any, t_end: float) -> None:
    is_time = isinstance(t, (float, int)) and abs(t - t_end) <= 1e-9 * max(1.0, abs(t_end))
    if not is_time:
        raise ArgumentError(f"reference is of t = {brief(t)} s; expected t_end = {t_end!r} s")


def found_reference(case: Case, dts: list[float], tell: Callable[[str], None]) -> Reference:
    """Solve the model by METHOD, halving the step until the error no longer decreases.

    The error estimate is the difference from the run with the double step or, if larger, from a run
    on another c-space, which shares neither equations nor charts.

    dts : steps of the comparison, s; the finest is the reference's first step.
    """
    length, norm = case.length, case.norm
    dt, halvings = (min(dts), HALVINGS) if dts else (length / FIRST_STEPS, MORE_HALVINGS)

    def ends_of(cspace: str, steps: int) -> Ends:
        tell(f"reference: {cspace}, {METHOD}, dt = {length / steps:g} s")
        common = {name: case.common[name] for name in ("stabilise", "seed", "discontinuities")}
        options = Options.of(
            case.model, t0=case.t0, t_end=case.t_end, dt=length / steps, method=METHOD,
            cspace=cspace, measure_every=steps, **common,
        )  # fmt: skip
        result = case.integrated(options, threads=None)
        return Ends.of(result.summary, result.links)

    own, *others = _cspaces_of(case.model)
    steps = max(round(length / dt), 1)
    before = ends_of(own, steps)
    best: tuple[float, dict[str, float], Ends, int] | None = None
    for _ in range(halvings):
        steps *= 2
        ends = ends_of(own, steps)
        errors = normed(ends.errors(before), norm)
        is_alike = before.failed.sum() == ends.failed.sum() < len(ends.failed)
        relative = (
            _relative(errors, sizes_of(case.model, ends, case.twist0)) if is_alike else np.inf
        )
        has_settled = best is not None and relative > 0.5 * best[0] and best[0] < RESOLVED
        if best is None or relative < best[0]:
            best = relative, errors, ends, steps
        if has_settled or relative <= rounding(steps):
            break
        before = ends
    assert best is not None
    _, errors, ends, steps = best
    what = f"{METHOD} on {own} with dt = {length / steps:g} s"
    for other in others:
        apart = normed(ends.errors(ends_of(other, steps)), norm)
        errors = {name: max(error, apart[name]) for name, error in errors.items()}
        what += f", beside {other}"
    _require_numbers(ends, errors, what)
    return Reference(ends, errors, what)


def _relative(errors: dict[str, float], sizes: dict[str, float]) -> float:
    """Return the largest error relative to its scale; ∞ if an error is not finite."""
    each = [error / (sizes[f"error.{name}"] or 1.0) for name, error in errors.items()]
    return max(each) if np.isfinite(each).all() else np.inf


def _require_numbers(ends: Ends, errors: dict[str, float], what: str) -> None:
    if not np.isfinite(list(errors.values())).all():
        raise ArgumentError(
            f"the reference ({what}) failed: {int(ends.failed.sum())} of {len(ends.failed)} "
            "trajectories did not get to t_end; choose an earlier t_end, or give reference="
        )


def _cspaces_of(model: Model) -> list[str]:
    """Return the reference's c-space, and a second one with the most different equations."""
    known = [cspace for cspace in CSPACES if _has(model, cspace)]
    return [known[0], *known[:0:-1][:1]]


def _has(model: Model, cspace: str) -> bool:
    try:
        model.formulation(
            cspace=cspace, update="local", check="raise", solver="auto", stabilise=None
        )
    except LierbError:
        return False
    return True


def normed(errors: Mapping[str, Array], norm: str) -> dict[str, float]:
    """Return the norm of each error over the trajectories with finite errors; NaN if none has."""
    norms = {}
    for name, each in errors.items():
        finite = each[np.isfinite(each)]
        norms[name] = float(NORMS[norm](finite)) if finite.size else np.nan
    return norms


def warn_of_runs(failed: list[str]) -> None:
    """Issue one warning for all runs with failed trajectories, which `failed` describes."""
    if failed:
        more = f" and in {counted(len(failed) - 3, 'more run')}" if len(failed) > 3 else ""
        warnings.warn(
            f"trajectories failed in {'; in '.join(failed[:3])}{more}; they are left out of the "
            "errors, and their runs of the orders: see the column failed",
            FailedTrajectoryWarning,
            stacklevel=4,
        )

"""Draw motion over time: coordinates, position, direction and angular velocity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lierb.model.joints.coordinates import motions_of
from lierb.model.joints.joint import Joint
from lierb.model.joints.motions import TURNS
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.states import RunStates, States, poses_of
from lierb.support.arrays import Array
from lierb.support.representations import with_unit

SUBSCRIPTS = "₁₂₃₄₅₆₇₈₉"
NEAR = 0.02  # distance of centre of mass and joint that counts as zero, in gyration radii


@dataclass(frozen=True)
class Series:
    """Quantity over time, (times, trajectories)."""

    label: str
    values: Array


@dataclass(frozen=True)
class Panel:
    """Series with one unit on one axis."""

    title: str
    unit: str
    series: tuple[Series, ...]
    is_error: bool = False

    @property
    def axis(self) -> str:
        return with_unit(self.title, self.unit)


@dataclass(frozen=True)
class Trace:
    """Direction of a unit vector on an equal-area map of the sphere, (times, trajectories, 2)."""

    title: str
    points: Array


class Coordinates:
    """Panels of the joint coordinates of a mechanism; see `Mechanism.coordinates`."""

    def __init__(self, result: RunStates, mechanism: Mechanism) -> None:
        self.result, self.mechanism = result, mechanism

    def angles(self) -> Panel | None:
        """Coordinates that are angles, or components of rotation vectors."""
        return self._panel("joint angles", "rad")

    def slides(self) -> Panel | None:
        """Coordinates that are lengths."""
        return self._panel("joint slides", "m")

    def _panel(self, title: str, unit: str) -> Panel | None:
        series = [Series(label, values) for label, own, values in self._series if own == unit]
        return Panel(title, unit, tuple(series)) if series else None

    @cached_property
    def _series(self) -> list[tuple[str, str, Array]]:
        """Label, unit and values, (times, trajectories), of each coordinate."""
        made = []
        for link in self.mechanism.links:
            names = [] if motions_of(link.joint) is None else link.joint.coordinate_names
            for i, name in enumerate(names):
                values, rates = (each[link.name][..., i] for each in self._coordinates)
                is_length = name[0] in "ds"
                if not is_length and name not in TURNS:
                    values = _with_turns(link.joint, values, rates, self.result.t)
                label = link.name if len(names) == 1 else f"{link.name} {name}"
                made.append((label, "m" if is_length else "rad", values))
        return made

    @cached_property
    def _coordinates(self) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return coordinates and rates by link, (times, trajectories, k); NaN after a failure."""
        poses = {name: poses_of(self.result[name]) for name in self.mechanism.names}
        twists = {name: _twists_of(self.result[name]) for name in self.mechanism.names}
        lost = np.any([~np.isfinite(pose).all(axis=(2, 3)) for pose in poses.values()], axis=0)
        for name, pose in poses.items():
            pose[lost], twists[name][lost] = np.eye(4), 0.0
        values, rates = [], []
        for k in range(len(lost)):
            at, moving = ({name: x[k] for name, x in each.items()} for each in (poses, twists))
            values.append(self.mechanism.coordinates(at))
            rates.append(self.mechanism.velocities(moving, at))
        return _stacked(values, lost), _stacked(rates, lost)


class State:
    """Panels of poses and velocities."""

    def __init__(self, result: RunStates, problem: Problem | None) -> None:
        self.result, self.problem = result, problem
        self.rotation = result.rotation

    @property
    def _has_coordinates(self) -> bool:
        """True if the joint has coordinates other than a rotation vector."""
        joint = self.problem.joint if self.problem else None
        if joint is None or joint.subgroup is None or not joint.rows:
            return False
        return TURNS[0] not in joint.coordinate_names

    def angles(self) -> Panel | None:
        """Return the joint's angle or, without one, tilt and azimuth of the body's axis."""
        if self._has_coordinates:
            assert self.problem is not None
            names = self.problem.joint.coordinate_names
            if "phi" not in names:
                return None  # the body does not turn
            angles, rates = (each[..., names.index("phi")] for each in self._coordinates())
            turns = _with_turns(self.problem.joint, angles, rates, self.result.t)
            return Panel("angle of the joint", "rad", (Series("φ", turns),))
        if np.ptp(np.nan_to_num(self.rotation - self.rotation[:1])) == 0.0:
            return None
        axis, up, _ = self._axis()
        a, b = _across(up)
        tilt = np.arccos(np.clip(axis @ up, -1.0, 1.0))
        azimuth = np.unwrap(np.arctan2(axis @ b, axis @ a), axis=0)
        return Panel(
            "direction of the axis", "rad", (Series("tilt", tilt), Series("azimuth", azimuth))
        )

    def trace(self) -> Trace | None:
        """Return the direction of the body's axis; None where it is constant."""
        axis, up, name = self._axis()
        moves = np.nan_to_num(axis - axis[:1])
        if self._has_coordinates or np.abs(moves).max(initial=0.0) < 1e-9:
            return None
        is_above = np.nanmean(axis @ up) >= 0.0
        towards = up if is_above else -up
        a, b = _across(towards)
        level = np.stack([axis @ a, axis @ b], axis=-1)
        # Lambert's map: radius 2 sin(θ/2)
        with np.errstate(invalid="ignore", divide="ignore"):
            stretch = np.sqrt(2.0 / (1.0 + axis @ towards))
        side = "above" if is_above else "below"
        return Trace(f"{name}, seen from {side}", level * stretch[..., None])

    def position(self) -> Panel | None:
        """Return the position of the centre of mass; None if it rests."""
        com = np.zeros(3) if self.problem is None else np.asarray(self.problem.body.com)
        com = np.broadcast_to(com, self.rotation.shape[1:3])
        place = self.result.position + np.einsum("tnij,nj->tni", self.rotation, com)
        if np.nanmax(np.ptp(place, axis=0), initial=0.0) == 0.0:
            return None
        series = tuple(Series(f"r{SUBSCRIPTS[i]}", place[..., i]) for i in range(3))
        return Panel("centre of mass" if self.problem else "position", "m", series)

    def omega(self) -> Panel:
        """Return the angular velocity in body axes."""
        omega = self.result.omega
        series = tuple(Series(f"ω{SUBSCRIPTS[i]}", omega[..., i]) for i in range(3))
        return Panel("angular velocity", "rad/s", series)

    def _coordinates(self) -> tuple[Array, Array]:
        """Return coordinates and rates, (times, trajectories, k); NaN after a failure."""
        assert self.problem is not None
        joint, poses, twists = self.problem.joint, poses_of(self.result), _twists_of(self.result)
        lost = ~np.isfinite(poses).all(axis=(2, 3))
        poses[lost], twists[lost] = np.eye(4), 0.0
        values = np.stack([joint.coordinates(each) for each in poses])
        rates = np.stack([joint.velocities(*each) for each in zip(twists, poses, strict=True)])
        values[lost] = rates[lost] = np.nan
        return values, rates

    def _axis(self) -> tuple[Array, Array, str]:
        """Return the body's axis, (times, trajectories, 3), the vertical, and the axis's name.

        The axis points from the joint to the centre of mass. If these coincide, it is e₃ of the
        joint; without a problem, it is e₃ of the body.
        """
        up, own, name = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), "e₃ of the body"
        if self.problem is not None:
            joint, gravity = self.problem.joint, np.atleast_2d(self.problem.gravity)[0]
            if np.any(gravity):
                up = -gravity / np.linalg.norm(gravity)
            if joint.rows:
                frame = np.atleast_3d(joint.body_frame).reshape(-1, 4, 4)
                arm = np.asarray(self.problem.body.com) - frame[:, :3, 3]
                far = np.linalg.norm(arm, axis=-1, keepdims=True)
                gyration = np.sqrt(
                    np.max(self.problem.body.inertia) / np.min(self.problem.body.mass)
                )
                is_apart = bool(np.all(far > NEAR * gyration))
                own = arm / far if is_apart else frame[:, :3, 2]
                name = "the centre of mass" if is_apart else "e₃ of the joint on the body"
        own = np.broadcast_to(np.atleast_2d(own), self.rotation.shape[1:3])
        return np.einsum("tnij,nj->tni", self.rotation, own), up, name


def _across(up: Array) -> tuple[Array, Array]:
    """Return two unit vectors ⊥ up, right-handed: e₁ and e₂ where up is e₃."""
    start = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    a = start - (start @ up) * up
    a /= np.linalg.norm(a)
    return a, np.cross(up, a)


def _twists_of(states: States) -> Array:
    return np.concatenate([states.omega, states.v], axis=-1)


def _stacked(each: list[dict[str, Array]], lost: NDArray[np.bool_]) -> dict[str, Array]:
    """Return arrays (times, trajectories, k), NaN in lost rows, of those at each time."""
    arrays = {name: np.stack([at[name] for at in each]) for name in each[0]}
    for values in arrays.values():
        values[lost] = np.nan
    return arrays


def _with_turns(joint: Joint, angles: Array, rates: Array, times: Array) -> Array:
    """Add the whole turns that a joint has made; angles between saved times go by the mean rate.

    The angles of a screw with a pitch have them.   angles, rates : (times, trajectories).
    """
    steps = np.diff(angles, axis=0)
    means = 0.5 * (rates[1:] + rates[:-1]) * np.diff(times)[:, None]
    turns = 2.0 * np.pi * np.rint((means - steps) / (2.0 * np.pi))
    total = np.cumsum(np.where(joint.pitch == 0.0, turns, 0.0), axis=0)
    return np.concatenate([angles[:1], angles[1:] + total])

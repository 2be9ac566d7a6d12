"""What an animation shows, as plain data that becomes JSON: `scene_of` says all that is in it.

    scene   title, up (3), centre (3) and radius of what is seen, size of its bodies, m; floor: how
            high along up it is drawn, m, or null; follow: whether the camera goes with the bodies;
            magnify: the slider's largest factor, magnified: its first; curves: names and labels;
            colours: of views' further bodies; notes; views
    view    title, colour, t, bodies, joints, errors: side by side with the others, on the same
            clock; dash: which of the view's colour it is, from 0, as lines tell apart
    body    name, shape, com, poses (times, 7): unit quaternion (w, x, y, z), place; trail: a point
            of the body or null
    joint   name, parent and child: indices of bodies, null for the ground; parent_frame and
            child_frame: 4×4, row by row; parent_axes, child_axes, slides, child_slides: which of
            their axes to draw; is_rod; gap (times, 6): see `lierb.animation.gaps`
    errors  of each of curves, how large over time

A view has as many bodies and joints as there are. Arrays over time are float32, t is float64,
little-endian, in base64; NaN after a failure.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.animation.gaps import gap_of
from lierb.animation.shapes import Shape, equivalent
from lierb.arrays import Array, assembled, components, pose_matrix
from lierb.colours import COLOURS, CSPACE_COLOURS, colours_of
from lierb.errors import ArgumentError
from lierb.joints import Joint
from lierb.kernels.groups import so3
from lierb.kernels.mechanics.rows import keeps_axis
from lierb.kernels.numbers.vec import norm, scale
from lierb.model import Problem
from lierb.runs.columns import as_array

if TYPE_CHECKING:
    from lierb.result import Result

GAP_SHOWN = 0.4  # of the bodies' size, and rad: how far the largest gap opens, fully magnified
MOST_MAGNIFIED = 1e12  # rounding, 1e-16, stays invisible: it is no gap
WANDERS = 12.0  # times its size: a body that goes farther is followed by the camera
TURN_SEEN = 0.5 * math.pi  # rad from frame to frame: beyond, one does not see which way it turns
CENTRED = 0.02  # of the size: a centre of mass nearer to the joint draws no trail
RUNAWAY = 1e30  # m: what is farther is not looked at; float32 ends at 3e38
RECORD = (
    'an animation needs the poses over time: integrate with save_every=… and record="state", such '
    "as save_every=10"
)
CURVES = {
    "position_error": "position error [m]",
    "rotation_error": "rotation error",
    "energy_drift": "energy drift [J]",
}


def scene_of(
    named: Sequence[tuple[str, Result, Problem, int]],
    *,
    title: str,
    shape: Shape | None,
    trail: Array | bool,
    frames: int,
    magnified: float = 1.0,
) -> dict[str, Any]:
    """The scene of these trajectories, a view for each.

    named : titles, results with states, problems of one body, numbers of trajectories.
    """
    looks = [
        _view(name, result, problem, number, shape, trail, frames)
        for name, result, problem, number in named
    ]
    views, swept, sizes, gaps, curves, turns = zip(*looks, strict=True)
    for view, (colour, dash) in zip(views, _colours([r for _, r, _, _ in named])):
        view |= {"colour": colour, "dash": dash}
    size, points = max(sizes), np.vstack(swept)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    first, is_heavy = _up(named[0][2]), bool(np.any(named[0][2].gravity != 0.0))
    follow = bool(np.max(high - low) > WANDERS * size)
    notes = []
    if max(turns) > TURN_SEEN:
        notes.append(
            f"A body turns by up to {max(turns):.3g} rad from one saved time to the next: save "
            "more often to see which way."
        )
    return {
        "title": title,
        "up": first.tolist(),
        "centre": centre.tolist(),
        "radius": float(size if follow else np.linalg.norm(points - centre, axis=1).max()),
        "size": float(size),
        "floor": None if follow or not is_heavy else float((points @ first).min()),
        "follow": follow,
        "magnify": max(_largest_factor(max(gaps), size), magnified),
        "magnified": magnified,
        "curves": {name: CURVES[name] for name in CURVES if any(name in of for of in curves)},
        "colours": list(COLOURS),
        "notes": notes,
        "views": list(views),
    }


def settings_of(result: Result) -> dict[str, Any]:
    """What the metadata of its tables tell: the problem and the options."""
    found: dict[str, Any] = json.loads((result.summary.schema.metadata or {}).get(b"lierb", b"{}"))
    return found


def cspace_of(result: Result) -> str | None:
    """The c-space that it was integrated on."""
    found: str | None = settings_of(result).get("options", {}).get("cspace")
    return found


def _colours(results: Sequence[Result]) -> list[tuple[str, int]]:
    """A colour and a dash for each: c-spaces have their own, views of one c-space dashes in it.

    Where all are on one c-space, each has a colour of its own.
    """
    spaces = [cspace_of(result) for result in results]
    if len({*spaces}) == 1 or not {*spaces} <= CSPACE_COLOURS.keys():
        return [(colour, 0) for colour in colours_of(spaces)]
    return [(CSPACE_COLOURS[str(s)], spaces[:n].count(s)) for n, s in enumerate(spaces)]


def encoded(array: Array) -> str:
    """float32, little-endian, in base64."""
    return _text(_single(array))


def _text(array: NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode()


def _rounded(points: Array, size: float) -> Array:
    """To nine digits of the size, for a shorter page."""
    return np.asarray(np.round(points, 9 - math.ceil(math.log10(size))))


def _single(array: Array) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # of a body that runs away: infinite, which is not drawn
        return np.ascontiguousarray(array, "<f4")


def poses_of(history: pa.Table, count: int, number: int, rows: Array) -> Array:
    """Poses of a trajectory at some of the saved times, (rows, 4, 4).

    count : of the trajectories in the history.
    """
    rotation = as_array(history["rotation"]).reshape(-1, count, 9)[rows, number]
    position = as_array(history["position"]).reshape(-1, count, 3)[rows, number]
    return pose_matrix((components(rotation), components(position)))


# ---- a view ------------------------------------------------------------------------------------


def _view(
    name: str,
    result: Result,
    problem: Problem,
    number: int,
    shape: Shape | None,
    trail: Array | bool,
    frames: int,
) -> tuple[dict[str, Any], Array, float, float, list[str], float]:
    """A view; points it reaches, how large its body is, its largest gap, its curves, its turns."""
    history = result.history
    if history is None or "position" not in history.column_names:
        raise ArgumentError(f"{name or 'the result'}: {RECORD}")
    count = result.summary.num_rows
    t = as_array(history["t"]).reshape(-1, count)[:, number]
    rows = np.unique(np.rint(np.linspace(0, len(t) - 1, min(frames, len(t)))).astype(int))
    poses = poses_of(history, count, number, rows)
    seen = shape or equivalent(problem.body)
    point = _trail(problem, seen, trail)
    gap = gap_of(problem, poses)
    errors = _errors(history, problem.joint, count, number, rows)
    quaternions = _quaternions(poses)
    view = {
        "title": name,
        "t": _text(np.ascontiguousarray(t[rows], "<f8")),  # steps of 1e-3 s after days
        "bodies": [
            {
                "name": "body",
                "shape": {
                    "vertices": _rounded(seen.vertices, seen.size).tolist(),
                    "faces": seen.faces, "marked": seen.marked,
                },
                "poses": encoded(np.hstack([quaternions, poses[:, :3, 3]])),
                "com": problem.body.com.tolist(),
                "trail": None if point is None else point.tolist(),
            }
        ],
        "joints": [_joint(problem.joint, gap)] if problem.joint.rows else [],
        "errors": {name: encoded(values) for name, values in errors.items()},
    }  # fmt: skip
    size, turn = seen.size, _turn(history, count, number, rows, t[rows])
    return view, _swept(poses, seen, problem), size, _gap_size(gap, size), [*errors], turn


def _quaternions(poses: Array) -> Array:
    with np.errstate(invalid="ignore"):  # NaN after a failure
        p = so3.quaternion(components(poses[:, :3, :3], 2))
        return assembled(scale(1.0 / norm(p), p))


def _trail(problem: Problem, shape: Shape, trail: Array | bool) -> Array | None:
    """The body's point that leaves a trail: the centre of mass, or if that rests a far corner."""
    if isinstance(trail, bool):
        if not trail:
            return None
        com, pin = np.asarray(problem.body.com), problem.joint.body_frame[:3, 3]
        if not problem.joint.rows or np.linalg.norm(com - pin) > CENTRED * shape.size:
            return com
        away = np.linalg.norm(shape.vertices - pin, axis=1)
        return np.asarray(shape.vertices[int(away.argmax())])
    return trail


def _up(problem: Problem) -> Array:
    """Against gravity; e₃ where there is none."""
    pull = np.linalg.norm(problem.gravity)
    up = -problem.gravity / pull if pull else np.array([0.0, 0.0, 1.0])
    return np.asarray(up) + 0.0  # no −0


def _errors(
    history: pa.Table, joint: Joint, count: int, number: int, rows: Array
) -> dict[str, Array]:
    """The errors that the joint has rows for; without any, the drift of energy.

    Where frames are left out, the largest since the one before.
    """
    kinds = [f"{kind}_error" for kind in joint.error_kinds] or ["energy_drift"]
    starts = np.append(0, rows[:-1] + 1)
    return {
        name: np.maximum.reduceat(
            np.abs(as_array(history[name]).reshape(-1, count)[:, number]), starts
        )
        for name in kinds
    }


def _joint(joint: Joint, gap: Array) -> dict[str, Any]:
    ground, body = _axes(joint)
    slides, child_slides = _slides(joint)
    return {
        "name": joint.name, "parent": None, "child": 0,
        "parent_frame": joint.ground_frame.ravel().tolist(),
        "child_frame": joint.body_frame.ravel().tolist(),
        "parent_axes": ground, "child_axes": body,
        "slides": slides, "child_slides": child_slides,
        "is_rod": "rod" in map(str, joint.rows),
        "gap": encoded(gap),
    }  # fmt: skip


def _axes(joint: Joint) -> tuple[list[int], list[int]]:
    """Axes of the joint frame on the ground, and of that on the body, about which it turns."""
    ground, body = set(), set()
    if keeps_axis(joint.rows) and not {"Omega3"} & {*map(str, joint.rows)}:
        ground.add(2)
        body.add(2)
    for row in joint.rows:
        if row.symbol == "Q":
            ground.add(row.i)
            body.add(row.j)
        if row.symbol == "cv":
            ground.add(2)
            body.add(2)
    return sorted(ground), sorted(body)


def _slides(joint: Joint) -> tuple[list[int], list[int]]:
    """Axes of the joint frame on the ground, and of that on the body, along which it slides."""
    found = []
    for symbol in ("d", "Qtd"):
        held = {row.i for row in joint.rows if row.symbol == symbol}
        if "screw" in map(str, joint.rows) and symbol == "d" and len(held) < 2:
            held = {0, 1, 2}  # a plane that rises: no line to draw
        found.append([i for i in range(3) if i not in held] if len(held) == 2 else [])
    return found[0], found[1]


# ---- sizes -------------------------------------------------------------------------------------


def _swept(poses: Array, shape: Shape, problem: Problem) -> Array:
    """Places of the body's outermost vertices, and the ground's joint point; (k, 3)."""
    with np.errstate(invalid="ignore"):
        alive = poses[(np.abs(poses) < RUNAWAY).all(axis=(1, 2))]
    corners = shape.vertices[np.unique(np.r_[shape.vertices.argmin(0), shape.vertices.argmax(0)])]
    swept = np.einsum("tij,kj->tki", alive[:, :3, :3], corners) + alive[:, None, :3, 3]
    points = swept.reshape(-1, 3) if len(alive) else corners  # failed from the start: no place
    return np.vstack([points, problem.joint.ground_frame[:3, 3]]) if problem.joint.rows else points


def _turn(history: pa.Table, count: int, number: int, rows: Array, t: Array) -> float:
    """The largest turn from one frame to the next, rad, by its rates: poses do not count turns."""
    omega = as_array(history["omega"]).reshape(-1, count, 3)[rows, number]
    with np.errstate(all="ignore"):
        turns = np.linalg.norm(omega[:-1], axis=1) * np.diff(t)
    return float(np.nanmax(turns, initial=0.0))


def _gap_size(gap: Array, size: float) -> float:
    """The largest gap relative to the body's size, or in rad."""
    with np.errstate(invalid="ignore"):
        near = gap[(np.abs(gap) < RUNAWAY).all(axis=1)]
    turned, moved = (np.linalg.norm(part, axis=1) for part in (near[:, :3], near[:, 3:]))
    return float(np.max(np.maximum(turned, moved / size), initial=0.0))


def _largest_factor(gap: float, size: float) -> float:
    """By how much the slider magnifies at most: a power of ten; 1 where nothing would be seen."""
    if gap * MOST_MAGNIFIED < 1e-3:
        return 1.0
    factor = 10.0 ** math.ceil(math.log10(GAP_SHOWN / gap))
    return float(min(max(factor, 1.0), MOST_MAGNIFIED))

"""Make the scene of an animation: plain data that becomes JSON.

    scene   title; up (3); centre (3) and radius of the visible region; size of the bodies, m;
            floor: height of the floor along up, m, or null; follow: true if the camera follows the
            bodies; magnify: largest factor of the slider; magnified: its initial factor; curves:
            names and labels; linear: names of those on linear axes; colours: colours of the further
            bodies of a view; targets; notes; views
    target  name; points (k, 3): one is a cross, several are a path; axes (3, 3): of a frame at the
            point, row by row, or null
    view    title, colour, t, bodies, joints, values; dash: index, from 0, among the views of the
            same colour, which selects the line style
    body    name, shape, com, poses (times, 7): unit quaternion (w, x, y, z), position; trail: a
            body point or null; bones: pairs of points of a link that a line connects
    joint   name; parent and child: indices of bodies, null for the ground, parents first; closes:
            true for a loop's joint, listed after the links' joints; parent_frame and child_frame:
            4×4, row by row; parent_axes, child_axes, slides, child_slides: axes of these frames to
            draw; is_rod; gap (times, 6): see `lierb.results.animation.drawn_joints`
    values  values of each of the curves over time: errors, and observables

Views are shown side by side on a common clock. Bodies and joints are those of a mechanism; a single
body has at most one joint. Arrays over time are float32, t is float64, little-endian, in base64;
NaN after a failure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lierb.model.base import Model
from lierb.model.bodies.body import Body
from lierb.model.joints.joint import Joint
from lierb.results.animation.drawn_joints import DrawnJoint, drawn_joints
from lierb.results.animation.encoding import RUNAWAY, encoded
from lierb.results.animation.shapes import Shape, equivalent
from lierb.results.colours import COLOURS, CSPACE_COLOURS, colours_of
from lierb.results.states import RunStates, States, metadata_of, poses_of, quaternions_of
from lierb.support.arrays import Array
from lierb.support.representations import with_unit

Shapes = Shape | Mapping[str, Shape] | None
Trails = Array | bool | Mapping[str, Array]
GAP_SHOWN = 0.4  # largest gap at full magnification, relative to the bodies' size, or in rad
TARGET_REACH = 6.0  # distance, relative to the motion's size, up to which the view has targets
MOST_MAGNIFIED = 1e12  # rounding, 1e-16, stays invisible
FOLLOW_DISTANCE = 12.0  # distance, relative to its size, beyond which the camera follows a body
TURN_SEEN = 0.5 * math.pi  # rad from frame to frame; the sense of a larger turn is not visible
CENTRED = 0.02  # relative to the size: a centre of mass nearer to the joint has no trail
MOST_OBSERVED = 3  # curves of observables, the first ones
RECORD = (
    "an animation needs the poses over time: integrate with save_every=… or save_at=…, and "
    'record="state", such as save_every=10'
)
CURVES = {
    "position_error": "position error [m]",
    "rotation_error": "rotation error",
    "energy_drift": "energy drift [J]",
}


def scene_of(
    named: Sequence[tuple[str, RunStates, Model, int]],
    *,
    title: str,
    shape: Shapes,
    trail: Trails,
    frames: int,
    magnified: float = 1.0,
    targets: Mapping[str, Array] | None = None,
) -> dict[str, Any]:
    """Return the scene of trajectories, with one view for each.

    named : titles, results with states, models of one member each, numbers of trajectories.
    shape, trail : of the body; for a mechanism by link, not necessarily of all links.
    targets : points (k, 3), m, or poses (4, 4) by name, fixed to the ground.
    """
    aims = [_target(name, target) for name, target in (targets or {}).items()]
    looks = [_view(*each, shape, trail, frames) for each in named]
    views, swept, sizes, gaps, curves, turns = zip(*looks, strict=True)
    observed = [_observed(model) for _, _, model, _ in named]
    for view, (colour, dash) in zip(views, _colours([r for _, r, _, _ in named])):
        view |= {"colour": colour, "dash": dash}
    size = max(sizes)
    follow = bool(np.ptp(np.vstack(swept), axis=0).max() > FOLLOW_DISTANCE * size)
    near, far = _near(np.vstack(swept), aims)
    notes = [f"Far from the motion, and out of sight: {', '.join(far)}."] if far else []
    points = np.vstack([*swept, *near])
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    first, is_heavy = _up(named[0][2]), bool(np.any(named[0][2].gravity != 0.0))
    if max(turns) > TURN_SEEN:
        notes.append(
            f"A body turns by up to {max(turns):.3g} rad from one saved time to the next: save "
            "more often to see which way."
        )
    shown = max(1.0, min(magnified, _in_view(max(gaps))))
    if shown < magnified:
        notes.append(
            f"The gap is magnified {shown:g} times instead of {magnified:g}, so that the bodies "
            "stay in view."
        )
    return {
        "title": title,
        "up": first.tolist(),
        "centre": centre.tolist(),
        "radius": float(size if follow else np.linalg.norm(points - centre, axis=1).max()),
        "size": float(size),
        "floor": None if follow or not is_heavy else float((points @ first).min()),
        "follow": follow,
        "magnify": max(_largest_factor(max(gaps)), shown),
        "magnified": shown,
        "curves": {name: CURVES[name] for name in CURVES if any(name in of for of in curves)}
        | {name: label for of in observed for name, label in of.items()},
        "linear": sorted({name for of in observed for name in of}),
        "colours": list(COLOURS),
        "targets": aims,
        "notes": notes,
        "views": list(views),
    }


def _near(swept: Array, aims: list[dict[str, Any]]) -> tuple[list[Array], list[str]]:
    """Return the points of targets that are near the motion, and the names of far targets."""
    middle = 0.5 * (swept.min(axis=0) + swept.max(axis=0))
    most = TARGET_REACH * np.linalg.norm(swept - middle, axis=1).max()
    near, far = [], []
    for aim in aims:
        points = np.asarray(aim["points"])
        is_near = np.linalg.norm(points - middle, axis=1) <= most
        near.append(points[is_near])
        far += [] if is_near.any() else [aim["name"] or "the target"]
    return near, far


def _target(name: str, target: Array) -> dict[str, Any]:
    if target.shape == (4, 4):
        axes, points = target[:3, :3].tolist(), [target[:3, 3].tolist()]
    else:
        axes, points = None, target.tolist()
    return {"name": name, "points": points, "axes": axes}


def cspace_of(result: RunStates) -> str | None:
    """Return the c-space of a result; None if its metadata lack it."""
    cspace: str | None = metadata_of(result.summary).get("options", {}).get("cspace")
    return cspace


def _colours(results: Sequence[RunStates]) -> list[tuple[str, int]]:
    """Return a colour and a dash index for each result.

    Each c-space has a colour, and the results on it differ by dashes. If all results are on one
    c-space, each has its own colour.
    """
    spaces = [cspace_of(result) for result in results]
    if len({*spaces}) == 1 or not {*spaces} <= CSPACE_COLOURS.keys():
        return [(colour, 0) for colour in colours_of(spaces)]
    return [(CSPACE_COLOURS[str(s)], spaces[:n].count(s)) for n, s in enumerate(spaces)]


def _rounded(points: Array, size: float) -> Array:
    """Round to nine digits of the size, for a shorter page."""
    return np.asarray(np.round(points, 9 - math.ceil(math.log10(size))))


# ---- a view ------------------------------------------------------------------------------------


class Linked(NamedTuple):
    """A drawn body has its states, and joint points, that of its own joint first.

    name : of the link; "" for a single body.
    """

    name: str
    states: States
    body: Body
    points: list[Array]
    has_children: bool
    is_pinned: bool


def _linked(model: Model, result: RunStates) -> list[Linked]:
    links, linked = model.joints[: len(model.bodies)], []
    for i, (name, body) in enumerate(zip(model.link_names, model.bodies, strict=True)):
        own = links[i].joint
        assert own is not None
        points = [own.body_frame[:3, 3]] if own.rows else []
        points += [
            at.joint.ground_frame[:3, 3] if at.parent == i else at.joint.body_frame[:3, 3]
            for n, at in enumerate(model.joints)
            if n != i and i in (at.parent, at.body) and at.joint is not None and at.rows
        ]
        is_parent = i in (at.parent for at in links)
        states = result[name] if name else result
        linked.append(Linked(name, states, body, points, is_parent, bool(own.rows)))
    return linked


def _view(
    name: str,
    result: RunStates,
    model: Model,
    number: int,
    shape: Shapes,
    trail: Trails,
    frames: int,
) -> tuple[dict[str, Any], Array, float, float, list[str], float]:
    """Return a view, its swept points, the bodies' size, largest gap, curves and largest turn."""
    t = result["t"][:, number]
    rows = np.unique(np.rint(np.linspace(0, len(t) - 1, min(frames, len(t)))).astype(int))
    links = _linked(model, result)
    poses = [poses_of(each.states, (rows, number)) for each in links]
    shapes = [_of_link(shape, each.name) or equivalent(each.body) for each in links]
    joints = drawn_joints(model, poses)
    errors = _errors(result, [each.joint for each in joints], number, rows)
    for each in joints:
        each.take_rounding_off(errors)
    observed = {name: result[name][rows, number] for name in _observed(model)}
    view = {
        "title": name,
        "t": encoded(t[rows], "<f8"),  # resolves 1e-3 s after days
        "bodies": [
            _body(each, own, placed, trail) for each, own, placed in zip(links, shapes, poses)
        ],
        "joints": [each.described() for each in joints],
        "values": {name: encoded(x) for name, x in {**errors, **observed}.items()},
    }
    size = max(each.size for each in shapes)
    turn = max(_turn(each.states.omega[rows, number], t[rows]) for each in links)
    grounds = [each.joint.ground_frame[:3, 3] for each in joints if each.parent is None]
    swept = np.vstack([_swept(*each) for each in zip(poses, shapes)] + grounds)
    return view, swept, size, _displacement(joints, size), [*errors], turn


def _of_link(given: Shapes, name: str) -> Shape | None:
    return given.get(name) if isinstance(given, Mapping) else given


def _body(link: Linked, shape: Shape, poses: Array, trail: Trails) -> dict[str, Any]:
    point = _trail(link, shape, trail)
    with np.errstate(invalid="ignore"):  # NaN after a failure
        turns = quaternions_of(poses[:, :3, :3])
    made = {
        "name": link.name or "body",
        "shape": {
            "vertices": _rounded(shape.vertices, shape.size).tolist(),
            "faces": shape.faces, "marked": shape.marked,
        },
        "poses": encoded(np.hstack([turns, poses[:, :3, 3]])),
        "com": link.body.com.tolist(),
        "trail": None if point is None else point.tolist(),
    }  # fmt: skip
    if link.name:
        first, *others = link.points or [link.body.com]
        ends = others or [link.body.com]
        made["bones"] = [[first.tolist(), end.tolist()] for end in ends]
    return made


def _trail(link: Linked, shape: Shape, trail: Trails) -> Array | None:
    """Return the body point that leaves a trail; None for no trail.

    The default is the centre of mass, or a far corner if the centre of mass rests. Links with
    children have no trail by default.
    """
    if isinstance(trail, Mapping):
        return trail.get(link.name)
    if not isinstance(trail, bool):
        return trail
    if not trail or link.has_children:
        return None
    com = np.asarray(link.body.com)
    if not link.is_pinned or np.linalg.norm(com - link.points[0]) > CENTRED * shape.size:
        return com
    away = np.linalg.norm(shape.vertices - link.points[0], axis=1)
    return np.asarray(shape.vertices[int(away.argmax())])


def _up(model: Model) -> Array:
    """Return the direction opposite to gravity; e₃ without gravity."""
    pull = np.linalg.norm(model.gravity)
    up = -model.gravity / pull if pull else np.array([0.0, 0.0, 1.0])
    return np.asarray(up) + 0.0  # no −0


def _errors(result: RunStates, joints: list[Joint], number: int, rows: Array) -> dict[str, Array]:
    """Return the errors for which joints have rows; without any, the energy drift.

    Each value is the maximum since the previous frame.
    """
    names = {kind for joint in joints for kind in joint.error_kinds}
    kinds = [f"{kind}_error" for kind in sorted(names)] or ["energy_drift"]
    starts = np.append(0, rows[:-1] + 1)
    return {name: np.maximum.reduceat(np.abs(result[name][:, number]), starts) for name in kinds}


def _observed(model: Model) -> dict[str, str]:
    """Return the names and labels of the observables that have curves."""
    return {x.name: with_unit(x.name, x.unit) for x in model.observables[:MOST_OBSERVED]}


# ---- sizes -------------------------------------------------------------------------------------


def _displacement(joints: Sequence[DrawnJoint], size: float) -> float:
    """Return the largest displacement of a body by the gaps of all joints that carry it.

    It is relative to the bodies' size, or in rad.
    """
    total: dict[int | None, float] = {None: 0.0}
    for each in joints:  # parents first; loops, which displace nothing, last
        carried = 0.0 if each.closes else total.get(each.parent, 0.0)
        total[each.child] = max(total.get(each.child, 0.0), carried + each.gap_size(size))
    return max(total.values())


def _swept(poses: Array, shape: Shape) -> Array:
    """Return the positions of a body's outermost vertices, (k, 3)."""
    with np.errstate(invalid="ignore"):
        alive = poses[(np.abs(poses) < RUNAWAY).all(axis=(1, 2))]
    corners = shape.vertices[np.unique(np.r_[shape.vertices.argmin(0), shape.vertices.argmax(0)])]
    swept = np.einsum("tij,kj->tki", alive[:, :3, :3], corners) + alive[:, None, :3, 3]
    return np.asarray(
        swept.reshape(-1, 3) if len(alive) else corners
    )  # failed from the start: no position


def _turn(omega: Array, t: Array) -> float:
    """Return the largest turn between frames, rad, from rates: poses omit whole turns."""
    with np.errstate(all="ignore"):
        rates = np.linalg.norm(omega, axis=1)
        turns = np.fmax(rates[:-1], rates[1:]) * np.diff(t)
    return float(np.nanmax(turns, initial=0.0))


def _largest_factor(gap: float) -> float:
    """Return the largest factor of the slider; 1 if no gap would be visible."""
    if gap * MOST_MAGNIFIED < 1e-3:
        return 1.0
    return max(1.0, min(_in_view(gap), MOST_MAGNIFIED))


def _in_view(gap: float) -> float:
    """Return the factor, 1, 2 or 5 times a power of ten, up to which bodies stay in view."""
    if gap == 0.0:
        return math.inf
    power = 10.0 ** math.floor(math.log10(GAP_SHOWN / gap))
    return max(n * power for n in (1.0, 2.0, 5.0) if n * power <= GAP_SHOWN / gap)

"""Make the HTML page of a scene: one file, without network or libraries."""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief, items_of, require_name
from lierb.model.base import Model
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.animation.scene import (
    MOST_MAGNIFIED,
    RECORD,
    Shapes,
    Trails,
    cspace_of,
    scene_of,
)
from lierb.results.animation.shapes import Shape
from lierb.results.colours import CSPACE_NAMES
from lierb.results.states import RunStates, chosen_trajectories, metadata_of
from lierb.support.arrays import Array, as_floats, as_matrix, as_numbers, as_poses, is_whole
from lierb.support.files import require_page, write_whole
from lierb.support.representations import counted, counted_links, steps_text

MOST_VIEWS = 8  # most views by default
FRAMES = 2000  # most frames of a trajectory; longer histories are thinned
HEIGHT = 640  # height of the frame in a notebook, pixels


class Animation:
    """Animation; `save` writes it to a file, a notebook shows it.

    Attributes
    ----------
    scene : dict
        Views, bodies, joints and curves, as `lierb.results.animation.scene` describes them.
    """

    def __init__(self, scene: dict[str, Any]) -> None:
        self.scene = scene

    def html(self) -> str:
        """Return the page as text.

        Returns
        -------
        str
            HTML.
        """
        data = json.dumps(self.scene, separators=(",", ":"), ensure_ascii=False)
        texts = {
            "TITLE": html.escape(self.scene["title"]),
            "PLAYER": _asset("player.js"),
            "SCENE": data.replace("<", "\\u003c"),  # a "<" in a name could end the script
        }
        return re.sub("%([A-Z]+)%", lambda mark: texts[mark[1]], _asset("player.html"))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page.

        Parameters
        ----------
        path : path
            HTML file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        StudyFileError
            The file cannot be written, or it would replace a file that is not an HTML page. It is
            an OSError.
        """
        file = Path(path).expanduser()
        require_page(file)
        write_whole(file, self.html().encode())
        return file

    def frame(self, height: int = HEIGHT) -> str:
        """Return an <iframe> with the page inside, for another page.

        Parameters
        ----------
        height : int, optional
            Height, pixels.

        Returns
        -------
        str
            HTML.
        """
        return (
            f'<iframe srcdoc="{html.escape(self.html())}" sandbox="allow-scripts" loading="lazy" '
            f'title="{html.escape(self.scene["title"])}" '
            f'style="width:100%;height:{height}px;border:0"></iframe>'
        )

    def _repr_html_(self) -> str:
        return self.frame()

    def __repr__(self) -> str:
        views = counted(len(self.scene["views"]), "view")
        return f"<lierb.animation.Animation {self.scene['title']!r}: {views}; save(path) writes it>"


def animate(
    results: RunStates | Sequence[RunStates] | Mapping[str, RunStates],
    path: str | os.PathLike[str] | None = None,
    *,
    trajectories: int | Iterable[int] | None = None,
    problem: Problem | Mechanism | None = None,
    shape: Shape | Mapping[str, Shape] | None = None,
    trail: bool | ArrayLike | Mapping[str, ArrayLike] = True,
    frames: int = FRAMES,
    magnify: float = 1.0,
    targets: ArrayLike | Mapping[str, ArrayLike] | None = None,
    title: str | None = None,
) -> Animation:
    """Animate trajectories side by side, with a common clock and camera.

    A slider magnifies the gap of the joint, which is 1e-7 m or less. Curves below show the joints'
    errors and the first three observables.

    Parameters
    ----------
    results : RunStates, sequence of RunStates or dict of RunStates
        Results with states (`save_every=…, record="state"`): one, several, or several by name, such
        as one for each c-space. Each trajectory has its own view.
    path : path, optional
        HTML file to write; it opens without a network. Default: none.
    trajectories : int or iterable of int, optional
        Numbers of the trajectories. Default: the first ones, for 8 views at most.
    problem : Problem or Mechanism, optional
        Problem of the results; needed if they were pickled, which drops the problem.
    shape : Shape or dict of Shape, optional
        Shape of the body, see `lierb.animation.box`, `cylinder` and `mesh`; for a mechanism a
        dictionary by link. Default: the box or cylinder of the body's mass and inertia.
    trail : bool, array_like of shape (3,), or dict of them, optional
        True for a trail of the centre of mass (or of a corner, for a body that turns about its
        centre of mass), or the body point that leaves the trail, m. For a mechanism, a dictionary
        link → point. Default: True; for a mechanism, trails of the links without children.
    frames : int, optional
        Largest number of frames; longer histories are thinned evenly.
    magnify : float, optional
        Initial magnification of the gap, as far as the bodies stay in view.
    targets : array_like of shape (3,), (k, 3) or (4, 4), or dict of them, optional
        What the motion should reach, drawn in every view, fixed to the ground: a point (3,), m; a
        path (k, 3) through k points, m; or a pose (4, 4). A dictionary gives them names, which are
        written beside them. The view has room for those up to six times the motion's size away.
        Default: none.
    title : str, optional
        Title. Default: joint and method.

    Returns
    -------
    Animation
        The animation, which a notebook shows.

    Raises
    ------
    ArgumentError
        A result has no states, or has lost its problem.

    Examples
    --------
    >>> import lierb
    >>> top = lierb.Problem(
    ...     lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0),
    ...     lierb.joints.spherical(body_point=(0.0, 0.0, -0.15)),
    ... )
    >>> start = {"twist0": top.joint.twist(omega=(1.0, 0.0, 9.0)), "dt": 1e-3, "t_end": 0.1}
    >>> saved = {"save_every": 10, "record": "state"}
    >>> spaces = {c: lierb.integrate(top, cspace=c, **start, **saved) for c in ("SE3", "SO3xR3")}
    >>> lierb.animation.animate(spaces)
    <lierb.animation.Animation 'spherical joint, RK4, dt = 0.001 s': 2 views; save(path) writes it>
    """
    if not (is_whole(frames) and frames >= 2):
        raise ArgumentError(f"frames={brief(frames)}; expected a whole number, at least 2")
    named = _named(results)
    models = {name: _model_of(name, result, problem) for name, result in named.items()}
    count = min(result.summary.num_rows for result in named.values())
    chosen = chosen_trajectories(trajectories, count, max(MOST_VIEWS // len(named), 1))
    first = next(iter(models.values()))
    scene = scene_of(
        list(_views(named, models, chosen)),
        title=_title(next(iter(named.values()))) if title is None else str(title),
        shape=_shapes(shape, first), trail=_trails(trail, first),
        frames=int(frames), magnified=_factor(magnify), targets=_targets(targets),
    )  # fmt: skip
    if trajectories is None and len(chosen) < count:
        scene["notes"].append(f"The first {len(chosen)} of {count} trajectories.")
    made = Animation(scene)
    if path is not None:
        made.save(path)
    return made


@cache
def _asset(name: str) -> str:
    return files("lierb.results.animation").joinpath(name).read_text(encoding="utf-8")


def _named(results: Any) -> dict[str, RunStates]:
    """Return results by name; the default name is that of the c-space."""
    given: list[tuple[str | None, Any]]
    if isinstance(results, Mapping):
        given = [(str(name), result) for name, result in results.items()]
    elif hasattr(results, "summary"):
        given = [("", results)]
    else:
        given = [(None, result) for result in items_of("results", results, RESULTS)]
    named: dict[str, RunStates] = {}
    for number, (name, result) in enumerate(given):
        if not hasattr(result, "summary") or not hasattr(result, "history"):
            raise ArgumentError(f"results has {brief(result)}; expected {RESULTS}")
        if name is None:
            space = cspace_of(result) or ""
            name = CSPACE_NAMES.get(space, space) if len(given) > 1 else ""
        if result.history is None or not result.has_states:
            raise ArgumentError(f"{f'{name}: ' if name else ''}{RECORD}")
        named[name if name not in named else f"{name} ({number + 1})"] = result
    if not named:
        raise ArgumentError(f"results is empty; expected {RESULTS}")
    return named


RESULTS = "what lierb.integrate returned, one or several"


def _model_of(name: str, result: Any, given: Model | None) -> Model:
    known = given if given is not None or result._end is None else result._end.model
    if not isinstance(known, Model):
        label = f"{name}: " if name else ""
        raise ArgumentError(
            f"{label}the result has lost its problem, as by pickling; give problem="
        )
    count = result.summary.num_rows
    batch = known.batch_size() or 1
    if batch not in (1, count):
        raise ArgumentError(f"problem= has {batch} bodies, the result {count} trajectories")
    return known


def _views(
    named: dict[str, RunStates], models: dict[str, Model], chosen: list[int]
) -> Iterator[tuple[str, RunStates, Model, int]]:
    """Yield title, result, model and trajectory number of each view, by trajectory."""
    for number in chosen:
        for name, result in named.items():
            known = models[name]
            own = known.of_body(number if (known.batch_size() or 1) > 1 else 0)
            many = result.summary.num_rows > 1
            labels = [name] if name else []
            labels += [f"trajectory {number}"] if many else []
            row = result.summary.slice(number, 1).select(["status", "t"]).to_pylist()[0]
            if row["status"] != "ok":
                labels.append(f"{row['status']} at {row['t']:g} s")
            yield ", ".join(labels), result, own, number


def _title(result: RunStates) -> str:
    known = metadata_of(result.summary)
    joint, options = known.get("problem", {}).get("joint", ""), known.get("options", {})
    parts = [f"{joint} joint"] if joint else [described_links(known) or "lierb"]
    if options:
        parts += [options["method"], steps_text(options)]
    return ", ".join(parts)


def described_links(known: dict[str, Any]) -> str:
    """Return "2 links and 1 loop" or the like, from the metadata of a mechanism."""
    kinds = [each["kind"] for each in known.get("problem", {}).get("mechanism", {}).values()]
    return counted_links(kinds.count("link"), kinds.count("loop")) if kinds else ""


def _shapes(given: Any, model: Model) -> Shapes:
    names = model.joint_names and model.link_names
    if given is None or (isinstance(given, Shape) and not names):
        return given
    if not (isinstance(given, Mapping) and names):
        expected = "a lierb.animation.Shape"
        if names:
            expected = f"a dictionary of shapes by link, as {{{names[0]!r}: …}}"
        raise ArgumentError(f"shape={brief(given)}; expected {expected}")
    for name, each in given.items():
        require_name("shape", name, names)
        if not isinstance(each, Shape):
            raise ArgumentError(f"shape[{name!r}]={brief(each)}; expected a lierb.animation.Shape")
    return given


def _trails(given: Any, model: Model) -> Trails:
    names = model.joint_names and model.link_names
    if isinstance(given, bool):
        return given
    if not names:
        return _point("trail", given)
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f"trail={brief(given)}; expected a flag, or a dictionary of points by link, as "
            f"{{{names[0]!r}: (0.0, 0.0, 0.1)}}"
        )
    for name in given:
        require_name("trail", name, names)
    return {name: _point(f"trail[{name!r}]", point) for name, point in given.items()}


def _factor(given: Any) -> float:
    is_number = isinstance(given, (int, float, np.number)) and not isinstance(given, bool)
    if not (is_number and 1.0 <= given <= MOST_MAGNIFIED):
        raise ArgumentError(f"magnify={brief(given)}; expected a number, 1 … {MOST_MAGNIFIED:g}")
    return float(given)


def _targets(given: Any) -> dict[str, Array]:
    """Return points (k, 3) and poses (4, 4) by name; a target without a name has the name ""."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        return {"": _target("targets", given)}
    return {str(name): _target(f"targets[{name!r}]", each) for name, each in given.items()}


def _target(argument: str, given: Any) -> Array:
    target = as_floats(argument, as_matrix(argument, given))
    if target.shape == (4, 4):
        return as_poses(argument, target)
    if target.shape[-1:] != (3,) or target.ndim > 2 or not target.size:
        raise ArgumentError(
            f"{argument} has shape {target.shape}; expected (3,), (k, 3) of a path or (4, 4)"
        )
    return np.atleast_2d(as_numbers(argument, target, (3,)))


def _point(argument: str, given: ArrayLike) -> Array:
    shape = as_floats(argument, given).shape
    if shape != (3,):
        raise ArgumentError(f"{argument} has shape {shape}; expected (3,), a point of the body")
    return np.asarray(as_numbers(argument, given, (3,)))

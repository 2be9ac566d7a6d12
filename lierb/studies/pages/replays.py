"""Animation of the worst and the median trajectory of a study, which are integrated again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lierb.results.animation import Animation
from lierb.results.animation.scene import scene_of
from lierb.results.colours import CSPACE_NAMES
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.columns import ok_columns, rows_of
from lierb.studies.findings.ranking import Ranking
from lierb.studies.storage.parts import Part
from lierb.studies.storage.results import IS_SUCCESS, Results
from lierb.support.arrays import Array

FRAMES = 500  # frames of each trajectory
MORE = 4  # times as many frames of trajectories that turn fast
MOST_SPACES = 2  # most settings side by side


@dataclass(frozen=True)
class Chosen:
    """Trajectories to animate, by their description, and the settings to show them in.

    ranking : ranking by which they were chosen; None where none got to its end.
    """

    trajectories: dict[str, int]
    settings: list[Setting]
    ranking: Ranking | None


def chosen(dataset: Results, ranking: Ranking) -> Chosen | None:
    """Choose the worst trajectory and, in its setting, the median one.

    Of a study none of whose bodies got to its end, the first that failed. None without any row.
    """
    study = dataset.study
    ranked: list[tuple[float, Setting, Array]] = []  # worst value of a setting, its trajectories
    for setting in study.settings:
        rows = ok_columns(dataset, setting, ["trajectory", ranking.column])
        values, order = rows[ranking.column], ranking.order(rows[ranking.column])
        if order.size:
            ranked.append((values[order[0]], setting, rows["trajectory"][order]))
    if ranked:
        first, *_ = ranking.order(np.array([value for value, *_ in ranked]))
        _, setting, trajectories = ranked[first]
        worst, median = (int(trajectories[i]) for i in (0, len(trajectories) // 2))
        named = {"worst": worst} | ({"median": median} if median != worst else {})
        return Chosen(named, _beside(study, setting), ranking)
    for setting in study.settings:
        rows = dataset.table().head(
            1, columns=["trajectory"], filter=rows_of(setting) & ~IS_SUCCESS
        )
        if rows.num_rows:
            return Chosen({"failed": rows["trajectory"][0].as_py()}, _beside(study, setting), None)
    return None


def _beside(study: Study, setting: Setting) -> list[Setting]:
    """Return the setting, and other c-spaces with its method and step."""
    alike = [s for s in study.settings if (s.method, s.step) == (setting.method, setting.step)]
    others = [s for s in alike if s != setting][: MOST_SPACES - 1]
    return [s for s in alike if s == setting or s in others]


def replayed(study: Study, picked: Chosen) -> Animation:
    """Integrate the chosen trajectories again, each as in the study, and animate them.

    With more frames where a body turns far from one to the next. See
    `lierb.studies.dataset.Dataset.replay`.
    """
    animation = _animated(study, picked, FRAMES)
    return _animated(study, picked, MORE * FRAMES) if animation.scene["notes"] else animation


def _animated(study: Study, picked: Chosen, frames: int) -> Animation:
    views = []
    for what, trajectory in picked.trajectories.items():
        for setting in picked.settings:
            recorded = _with_states(study, setting, frames)
            batch, result = Part("", setting, trajectory, 1).run(recorded, study.design)
            ((status, t),) = zip(*(result.summary[n].to_pylist() for n in ("status", "t")))
            space = CSPACE_NAMES.get(setting.cspace, setting.cspace)
            label = f"{what}: {trajectory}, {space}"
            label += "" if status == "ok" else f", {status} at {t:g} s"
            views.append((label, result, batch.problem.of_body(0), 0))
    run = picked.settings[0]
    title = f"{study.name}: {run.method}, {run.step_label}"
    return Animation(scene_of(views, title=title, shape=None, trail=True, frames=frames))


def _with_states(study: Study, setting: Setting, frames: int) -> Study:
    """Return the study with states recorded, and nothing that needs a kernel of its own."""
    run = study.integrate
    kept = [name for name in run.record if name not in ("energy", "state")]
    changes: dict[str, Any] = {"record": ["state", *kept] if run.saves else ["state"]}
    if study.has_lane_clocks:
        length = (run.t_end - run.t0) / frames
        changes |= {"save_every": None, "save_at": {"every": length}}
    else:
        assert setting.dt is not None
        steps = round((run.t_end - run.t0) / setting.dt)
        changes["save_every"] = max(1, steps // frames)
    changed = run.model_copy(update=changes)
    return study.model_copy(update={"integrate": changed})


def description_of(picked: Chosen) -> str:
    """Describe the chosen trajectories in a sentence."""
    if picked.ranking is None:
        return "No body got to its end: the first that failed, until it did."
    (worst, *middle) = picked.trajectories.values()
    also = f", trajectory {middle[0]} the median one" if middle else ""
    return f"Trajectory {worst} has the {picked.ranking.label} of the bodies{also}."

"""How large a study's lengths and energies are: rounding is told from error relative to them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from lierb.arrays import Array, components, pose_components, pose_matrix
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.scale import length_of
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import norm
from lierb.model import Problem
from lierb.studies.dataset import Dataset
from lierb.studies.study import Setting, Study

BODIES = 64  # that are looked at: the order of magnitude of a median is all that is needed
STATE = {"rotation": 9, "position": 3, "omega": 3, "v": 3}


def rows_of(setting: Setting) -> pc.Expression:
    """The filter for a setting's rows."""
    return (
        (pc.field("cspace") == setting.cspace)
        & (pc.field("method") == setting.method)
        & (pc.field("dt") == setting.dt)
    )


def as_array(table: pa.Table, name: str) -> Array:
    """A column of numbers; lists as (n, k)."""
    column = table[name].combine_chunks()
    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten().to_numpy().reshape(-1, column.type.list_size))
    return np.asarray(column.to_numpy())


def sizes_of(dataset: Dataset, study: Study, setting: Setting) -> dict[str, float]:
    """What a setting's errors are relative to: position, m; rotation, 1; energy, J.

    Medians over the first bodies, of the larger of the numbers at start and end. Position: the
    problem's own length and the distance from the ground's origin. Energy: the kinetic one, the
    magnitudes of all potential ones, and m g times the problem's own length.
    """
    rows = dataset.table().head(
        BODIES,
        columns=["trajectory", *STATE],
        filter=rows_of(setting) & (pc.field("status") == "ok"),
    )
    ended = as_array(rows, "trajectory")
    first = int(ended.min()) if rows.num_rows else 0
    batch = study.batch(first, min(BODIES, len(study.design) - first))
    poses = batch.problem.joint.closed_pose if batch.pose0 is None else batch.pose0
    lengths, energies = _sizes(batch.problem, poses, batch.twist0)
    if rows.num_rows:
        seen = ended < first + len(batch.twist0)
        state = {name: np.full((len(batch.twist0), width), np.nan) for name, width in STATE.items()}
        for name, values in state.items():
            values[ended[seen] - first] = as_array(rows, name)[seen]
        poses = pose_matrix((components(state["rotation"]), components(state["position"])))
        ends = _sizes(batch.problem, poses, np.hstack((state["omega"], state["v"])))
        lengths, energies = np.fmax(lengths, ends[0]), np.fmax(energies, ends[1])
    return {
        "position": float(np.median(lengths)),
        "rotation": 1.0,
        "energy": float(np.median(energies)),
    }


def _sizes(problem: Problem, poses: Array, twists: Array) -> tuple[Array, Array]:
    """Of each body in its own pose and motion: m and J."""
    parameters, body = problem.parameters(), problem.in_joint_axes(SE3)
    with np.errstate(all="ignore"):  # a body that runs away is ok as long as it is finite
        length = length_of(parameters)
        placed, velocity = SE3.to_joint_axes(parameters, pose_components(poses), components(twists))
        motion = SE3.kinematics(body, placed, velocity).motion
        energies = [
            SE3.kinetic_energy(body, velocity),
            SE3.potential_energy(body, placed),
            parameters.mass * norm(parameters.gravity) * length,
            *(e.energy(own, motion) for e, own in zip(problem.kinds, body.elements, strict=True)),
        ]
        total = sum(np.abs(plain(energy)) for energy in energies)
        reach = length + norm(components(poses[..., :3, 3]))
    return reach, np.broadcast_to(total, len(twists))

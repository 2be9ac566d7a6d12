"""What `lierb.integrate` gives back."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from lierb.animation.page import Animation, animate, links_told
from lierb.arrays import Array, assembled, components
from lierb.column_names import COMPONENTS
from lierb.errors import ArgumentError, require_name, told, unknown_name
from lierb.extras import require
from lierb.kernels.groups import so3
from lierb.kernels.mechanics.rows import JOINT_ROWS
from lierb.kernels.mechanics.spatial import Rigid, wrench_from
from lierb.kernels.numbers.vec import ZERO6, Vec, add, norm, scale
from lierb.model import Body, Problem
from lierb.runs.columns import as_array, as_codes, numbers
from lierb.runs.continuation import End
from lierb.runs.failures import Failures, has_failed
from lierb.shown import FAILED, Lines, Shown, counted, steps_told

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

    from lierb.mechanism import Mechanism

STATE = ("t", "position", "rotation", "quaternion", "omega", "v")
TABLES = ("summary", "history", "events")
NAMED = 3  # links in a message
OBSERVED = "observables"  # of a problem, in the tables' metadata
LARGEST = ("position_error", "rotation_error", "energy_drift")


@dataclass(frozen=True, repr=False)
class States(Shown):
    """Tables of a run, and the state in them as NumPy arrays: of one body, or of one link."""

    summary: pa.Table
    history: pa.Table | None

    @property
    def _prefix(self) -> str:
        """What stands before the names of the state's columns."""
        return ""

    @property
    def t(self) -> Array:
        """Times of the state, s, (times,) of the history, or (n,), the end of each trajectory.

        A trajectory that failed ends there; the history goes on.
        """
        if self.history is not None and self.has_states:
            return np.asarray(self._array(self.history, "t")[:, 0])
        return np.asarray(self._array(self.summary, "t")[0])

    @property
    def position(self) -> Array:
        """Position r in the ground frame, m, (times, n, 3), or (n, 3) at the end."""
        return self._state("position", 3)

    @property
    def rotation(self) -> Array:
        """Rotation R from body axes to ground axes, (times, n, 3, 3), or (n, 3, 3) at the end."""
        return self._state("rotation", 3, 3)

    @property
    def quaternion(self) -> Array:
        """Rotation as a unit quaternion (w, x, y, z), (times, n, 4), or (n, 4) at the end.

        Of the two, p and −p, that with w ≥ 0, so that a row is the same whatever else is saved.
        Along a history it jumps where w would pass through 0. Made of `rotation` when asked for.
        """
        p = so3.quaternion(components(self._state("rotation", 3, 3, asked="quaternion"), 2))
        unit = assembled(scale(1.0 / norm(p), p))
        unit.setflags(write=False)
        return unit

    @property
    def omega(self) -> Array:
        """Angular velocity in the body's axes, rad/s, (times, n, 3), or (n, 3) at the end."""
        return self._state("omega", 3)

    @property
    def v(self) -> Array:
        """Velocity of the body frame's origin, in the body's axes, m/s; shaped like `omega`."""
        return self._state("v", 3)

    @property
    def has_states(self) -> bool:
        """Whether the history has the state, which its arrays are then of."""
        return self.history is not None and f"{self._prefix}position" in self.history.column_names

    def _state(self, name: str, *item: int, asked: str = "") -> Array:
        """asked : what it is for, for messages."""
        if self.history is not None and self.has_states:
            return self._array(self.history, f"{self._prefix}{name}", *item)
        return np.asarray(self._array(self.summary, f"{self._prefix}{name}", *item)[0])

    def _array(self, table: pa.Table, column: str, *item: int) -> Array:
        """(times, n, *item)"""
        return as_array(table[column]).reshape(-1, self.summary.num_rows, *item)

    def _told_arrays(self) -> str:
        times = (len(self.t),) if self.has_states else ()
        return f"({', '.join(map(str, (*times, self.summary.num_rows)))}, …)"


@dataclass(frozen=True, repr=False)
class LinkResult(States):
    """Motion of one link of a mechanism, `result["rod"]`; it has the arrays of `Result`.

    Attributes
    ----------
    summary : pyarrow.Table
        Summary of the whole mechanism.
    history : pyarrow.Table or None
        History of the whole mechanism.
    name : str
        Name of the link.
    """

    name: str

    @property
    def _prefix(self) -> str:
        return f"{self.name}."

    def _shown(self) -> tuple[str, Lines]:
        count = counted(self.summary.num_rows, "trajectory", "trajectories")
        rows = [("arrays", f"{', '.join(STATE)}: {self._told_arrays()}")]
        return f"lierb.result.LinkResult {self.name!r}: {count}", rows


@dataclass(frozen=True, repr=False)
class Result(States):
    """Tables that `integrate` returns, and the state in them as NumPy arrays.

    `t`, `position`, `rotation`, `quaternion`, `omega` and `v` are of the history where it has the
    state (`save_every=…` or `save_at=…`, `record="state"`), an axis of times before that of
    trajectories; else they are of the end. The arrays are read-only: they are the tables' memory. A
    batch of one keeps its axis. After a failure all but `t` are NaN; so are rows after the end of a
    trajectory that an event has ended. A mechanism's links have results of their own:
    `result["rod"].position`.

    Attributes
    ----------
    summary : pyarrow.Table
        One row for each trajectory.
    history : pyarrow.Table or None
        One row for each saved time and trajectory, time-major; None without `save_every` or
        `save_at`.
    events : pyarrow.Table or None
        One row for each crossing of an event, with the state there, by trajectory and time; None
        for a problem without events.

    Examples
    --------
    >>> import lierb
    >>> body = lierb.Body(mass=1.0, inertia=(1.0, 1.0, 1.0))
    >>> start = {"twist0": (0.0, 0.0, 1.0, 2.0, 0.0, 0.0), "dt": 0.1, "t_end": 0.5}
    >>> flight = lierb.Problem(body, lierb.joints.free())
    >>> lierb.integrate(flight, **start).position.shape
    (1, 3)
    >>> result = lierb.integrate(flight, **start, save_every=1, record="state")
    >>> result.t.shape, result.position.shape, result.quaternion.shape
    ((6,), (6, 1, 3), (6, 1, 4))
    """

    _end: End | None = field(default=None, repr=False, compare=False)
    events: pa.Table | None = None

    @property
    def failed(self) -> NDArray[np.int64]:
        """Numbers of the trajectories whose status is neither ok nor event, in order."""
        return np.asarray(as_array(self.summary["trajectory"])[has_failed(self.summary)])

    # ---- links ----

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links of a mechanism; none for a single body."""
        ends = (n.rpartition(".") for n in self.summary.column_names)
        return tuple(link for link, _, what in ends if link and what == "rotation")

    def __getitem__(self, link: str) -> LinkResult:
        """The state of one link of a mechanism, by its name.

        Raises UnknownNameError for another name, ArgumentError for the result of one body.

        >>> import lierb
        >>> hinge = lierb.joints.revolute(body_point=(0.5, 0.0, 0.0))
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), hinge)
        >>> swing = lierb.Mechanism(wheel)
        >>> result = lierb.integrate(swing, twist0=swing.twist({"wheel": 2.0}), dt=0.1, t_end=0.5)
        >>> result["wheel"].omega.round(9).tolist()
        [[0.0, 0.0, 2.0]]
        """
        if not self.links:
            raise ArgumentError(
                f"result[{told(link)}]: it is of one body, which has no links; take "
                f"{', '.join(f'result.{name}' for name in STATE[1:])}"
            )
        if not (isinstance(link, str) and link in self.links):
            raise unknown_name("result: link", link, self.links)
        return LinkResult(self.summary, self.history, link)

    @property
    def momentum(self) -> Array:
        """Angular momentum about the ground's origin, N m s, and linear momentum, N s.

        Both are sums over all links, in the ground's axes: (times, n, 6), or (n, 6) at the end.

        Raises
        ------
        ArgumentError
            The result was pickled, and has lost its bodies.

        Examples
        --------
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=2.0), lierb.joints.free())
        >>> twist0 = (0.0, 0.0, 0.0, 3.0, 0.0, 0.0)
        >>> lierb.integrate(flight, twist0=twist0, dt=0.1, t_end=0.5).momentum.round(9).tolist()
        [[0.0, 0.0, 0.0, 6.0, 0.0, 0.0]]
        """
        if self._end is None:
            raise ArgumentError("result.momentum: only a result that integrate returned has bodies")
        problem = self._end.problem
        pairs: list[tuple[Body, States]] = []
        if isinstance(problem, Problem):
            pairs.append((problem.body, self))
        else:
            pairs += [(link.body, self[link.name]) for link in problem.links]
        total = ZERO6
        for body, link in pairs:
            total = add(total, _momentum_of(body, link))
        return assembled(total)

    def _state(self, name: str, *item: int, asked: str = "") -> Array:
        if self.links:
            asked = asked or name
            raise ArgumentError(
                f"result.{asked}: every link has its own; take "
                f"{', '.join(f'result[{link!r}].{asked}' for link in self.links[:NAMED])}"
                f"{', …' if len(self.links) > NAMED else ''}"
            )
        return super()._state(name, *item)

    @property
    def has_states(self) -> bool:
        """Whether the history has the states of all links."""
        name = f"{self.links[0]}.position" if self.links else "position"
        return self.history is not None and name in self.history.column_names

    # ---- the end ----

    @cached_property
    def end(self) -> dict[str, Any]:
        """End of the run, as the keywords `pose0`, `twist0` and `t0` with which it continues.

        `lierb.integrate(problem, **result.end, dt=…, t_end=…)` continues: with bodies, joints and
        constraints of equal numbers and functions, and the same formulation, in the same process,
        from the driver's own state, so that with the same dt and method the bits are those of one
        run without a break. A state that has drifted off its joint goes on as it is. Maxima, energy
        drift and work count from the new start. Copies and parts of `pose0`, or another twist or
        time with it, start as any other pose does.

        The problem's own states, the outputs and memory of its controllers, and the length of
        adaptive steps continue too: the bits are those of one run in which a step ends here, as one
        does at every tick of a controller. `seed` and `trajectories` are to be given again.
        `integrate` raises ArgumentError where states or memory would be lost.

        Raises
        ------
        ArgumentError
            A trajectory has failed, or trajectories have ended at different times.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.15))
        >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
        >>> pendulum = lierb.Problem(box, hinge, gravity=(0.0, 0.0, -9.81))
        >>> twist0 = hinge.twist(omega=(0.0, 3.0, 0.0))
        >>> first = lierb.integrate(pendulum, twist0=twist0, dt=1e-3, t_end=0.5)
        >>> second = lierb.integrate(pendulum, **first.end, dt=1e-3, t_end=1.0)
        >>> whole = lierb.integrate(pendulum, twist0=twist0, dt=1e-3, t_end=1.0)
        >>> second.summary["omega"] == whole.summary["omega"]
        True
        """
        if self._end is None:
            raise ArgumentError("result.end: only a result that integrate returned has an end")
        return self._end.keywords()

    def __reduce__(self) -> Any:
        """Without its end, whose problem may have functions that cannot be pickled."""
        return Result, (self.summary, self.history, None, self.events)

    # ---- pictures ----

    def animate(self, path: str | os.PathLike[str] | None = None, **options: Any) -> Animation:
        """Make a moving picture of trajectories, and write it to an HTML file; a notebook shows it.

        It needs the poses over time: `save_every=…` or `save_at=…`, `record="state"`.

        Parameters
        ----------
        path : path, optional
            HTML file to write. Default: none.
        **options : object
            Arguments of `lierb.animate`, such as `trajectories`, `shape`, `trail`, `frames` and
            `title`. That function also puts several results side by side.

        Returns
        -------
        Animation
            The moving picture.

        Raises
        ------
        ArgumentError
            The result has no states.

        Examples
        --------
        >>> import lierb
        >>> body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
        >>> flight = lierb.Problem(body, lierb.joints.free())
        >>> start = {"twist0": (0.0, 0.0, 1.0, 2.0, 0.0, 0.0), "dt": 0.1, "t_end": 0.5}
        >>> lierb.integrate(flight, **start, save_every=1, record="state").animate()
        <lierb.animation.Animation 'free joint, RK4, dt = 0.1 s': 1 view; save(path) writes it>
        """
        return animate(self, path, **options)

    def plot(
        self,
        columns: str | Iterable[str] = (),
        *,
        trajectories: int | Iterable[int] | None = None,
        problem: Problem | Mechanism | None = None,
    ) -> Figure:
        """Draw the history over time, as a Matplotlib figure; needs `lierb[plot]`.

        Errors are drawn on logarithmic axes, where a zero is a gap.

        Parameters
        ----------
        columns : str or iterable of str, optional
            Panels: "angles", "trace" (where the body's axis points, on the sphere), "position" and
            "omega", of a recorded state; and any column of the history, such as "energy",
            "position_error" or an observable. Default: all but rates of errors. For a mechanism
            "angles" and "slides" are the coordinates of its joints, and the default is what all
            joints have together; ask for "rod.omega", "pin.position_error", "pin.force" and the
            like.
        trajectories : int or iterable of int, optional
            Numbers of the trajectories. Default: all; of more than six, their median and 5 to 95 %.
        problem : Problem or Mechanism, optional
            The problem of a result that was pickled, which has lost its own.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        ArgumentError
            The result has no history.
        MissingExtraError
            Matplotlib is not installed.

        Examples
        --------
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> start = {"twist0": (0.0, 0.0, 1.0, 2.0, 0.0, 0.0), "dt": 0.1, "t_end": 0.5}
        >>> result = lierb.integrate(flight, **start, save_every=1, record="state")
        >>> [panel.get_title(loc="left") for panel in result.plot(["position", "omega"]).axes]
        ['centre of mass [m]', 'angular velocity [rad/s]']
        """
        require("plot")
        from lierb.history_plots import history_figure

        return history_figure(self, columns, trajectories=trajectories, problem=problem)

    # ---- data frames ----

    def to_pandas(self, table: str = "summary") -> pandas.DataFrame:
        """Convert a table to a pandas data frame, with a column for each component of a vector.

        `position` becomes `position_x`, `position_y`, `position_z`; `rotation` becomes
        `rotation_xx`, `rotation_xy`, … row by row; `reaction` becomes `reaction_torque_x` … and
        `reaction_force_x` …; `lambda` becomes `lambda_1` …. The link's or joint's name of a
        mechanism comes first: `rod.position_x`. `attrs["units"]` has the units.

        Parameters
        ----------
        table : {"summary", "history", "events"}, optional
            Name of the table.

        Returns
        -------
        pandas.DataFrame
            The table.

        Raises
        ------
        ArgumentError
            The result has no such table.
        MissingExtraError
            pandas is not installed.
        """
        require("pandas")
        chosen = self._expanded(table)
        frame = chosen.to_pandas()
        frame.attrs["units"] = {f.name: _unit(f) for f in chosen.schema if _unit(f)}
        return frame

    def to_polars(self, table: str = "summary") -> polars.DataFrame:
        """Convert a table to a polars data frame, with the columns of `to_pandas`.

        Parameters
        ----------
        table : {"summary", "history", "events"}, optional
            Name of the table.

        Returns
        -------
        polars.DataFrame
            The table.

        Raises
        ------
        ArgumentError
            The result has no such table.
        MissingExtraError
            polars is not installed.
        """
        require("polars")
        import polars

        frame = polars.from_arrow(self._expanded(table))
        assert isinstance(frame, polars.DataFrame)
        return frame

    def _expanded(self, name: str) -> pa.Table:
        require_name("table", name, TABLES)
        table = getattr(self, name)
        if table is None:
            remedy = {
                "history": "integrate with save_every= or save_at= for one",
                "events": "give the problem, or integrate, events= made by lierb.event",
            }
            raise ArgumentError(f"there is no table of {name}; {remedy[name]}")
        columns: dict[pa.Field, Any] = {}
        for each in table.schema:
            columns |= _scalars(each, table[each.name])
        return pa.Table.from_arrays(list(columns.values()), schema=pa.schema(list(columns)))

    # ---- at a prompt ----

    def _shown(self) -> tuple[str, Lines]:
        options = _metadata(self.summary).get("options")
        title = f"lierb.Result: {counted(self.summary.num_rows, 'trajectory', 'trajectories')}"
        if self.links:
            title += (
                f" of {links_told(_metadata(self.summary)) or counted(len(self.links), 'link')}"
            )
        if options:
            times = "from t = {t0:g} s to {t_end:g} s" if options["t0"] else "to t = {t_end:g} s"
            told = f" {times} ({{cspace}}, {{method}}, ".format(**options)
            title += f"{told}{steps_told(options)})"
        failures = Failures.of(self.summary)
        rows = [("status", self._told_ends())] if failures is None else [(FAILED, str(failures))]
        if "steps" in self.summary.column_names:
            rows.append(("steps", self._told_steps()))
        rows += self._largest()
        if self.events is not None:
            rows.append(("events", self._told_events()))
        rows.append(("history", self._told_history()))
        shape = self._told_arrays()
        if self.links:
            rows.append(("links", ", ".join(f"result[{link!r}]" for link in self.links)))
        rows.append(("arrays", f"{', '.join(STATE)}: {shape}"))
        return title, rows

    def _told_ends(self) -> str:
        """Of trajectories that are fine."""
        codes, names = as_codes(self.summary["status"])
        ended = np.count_nonzero(codes == names.index("event")) if "event" in names else 0
        return f"all ok, {ended} ended by an event" if ended else "all ok"

    def _told_steps(self) -> str:
        """How many the trajectories have made, and the share of tries that were rejected."""
        steps, rejected = (as_array(self.summary[name]) for name in ("steps", "rejected"))
        few, many = steps.min(), steps.max()
        told = f"{few}" if few == many else f"{few} to {many}"
        tries = steps.sum() + rejected.sum()
        return told + (f", {rejected.sum() / tries:.2g} of all tries rejected" if tries else "")

    def _told_events(self) -> str:
        """How many there are of each."""
        assert self.events is not None
        counts = pc.value_counts(self.events["event"].cast(pa.string())).to_pylist()
        return ", ".join(f"{each['counts']} {each['values']}" for each in counts) or "none"

    def _largest(self) -> Lines:
        """The largest errors of the trajectories that are ok, of those that there are rows for."""
        ok, kinds = ~has_failed(self.summary), _kinds_of(_metadata(self.summary))
        if not ok.any():
            return []
        texts = []
        for name in kinds:
            column = self.summary.schema.field(f"{name}_max")
            unit = _unit(column)
            largest = as_array(self.summary[column.name])[ok].max()
            plain = name.replace("_", " ")
            where = self._where(column.name, largest, ok)
            texts.append(f"{plain} {largest:.2g}{f' {unit}' if unit != '1' else ''}{where}")
        return [("largest", ", ".join(texts))]

    def _where(self, column: str, largest: float, ok: NDArray[np.bool_]) -> str:
        """Of a mechanism, the joint that has the largest error, if it is one's and not zero."""
        for name in self.summary.column_names:
            joint, _, what = name.rpartition(".")
            if (
                joint
                and what == column
                and largest
                and as_array(self.summary[name])[ok].max() == largest
            ):
                return f" ({joint})"
        return ""

    def _told_history(self) -> str:
        if self.history is None:
            return "none; save_every= or save_at= keeps one"
        times = self.history.num_rows // self.summary.num_rows
        there = {name.rpartition(".")[2] for name in self.history.column_names}
        more = [name for name in ("energy", "work", "lambda", "reaction") if name in there]
        problem = _metadata(self.summary).get("problem", {})
        more += [each["name"] for each in problem.get(OBSERVED, [])]
        recorded = ", ".join(["errors", *["state"] * self.has_states, *more])
        return f"{counted(times, 'time')}: {recorded}"


def _momentum_of(body: Body, link: States) -> Vec:
    """Of one body, about the ground's origin and in its axes."""
    com, inertia = components(body.com), components(body.inertia, 2)
    rigid = Rigid(body.mass, scale(body.mass, com), inertia)
    momentum = rigid.momentum(components(link.omega) + components(link.v))
    place = components(link.rotation, 2), components(link.position)
    return wrench_from(place, momentum)


def _metadata(table: pa.Table) -> dict[str, Any]:
    """What the metadata of a table of lierb's tell."""
    metadata = (table.schema.metadata or {}).get(b"lierb")
    found: dict[str, Any] = json.loads(metadata) if metadata else {}
    return found


def _kinds_of(told: dict[str, Any]) -> list[str]:
    """Those of LARGEST that there are rows for; an added row may be of either kind."""
    kinds = {"energy_drift"}
    for name in told.get("problem", {}).get("rows", [""]):
        row = JOINT_ROWS.get(name.rpartition(".")[2])  # of a mechanism, the joint's name before
        kinds.update([f"{row.error_kind}_error"] if row else LARGEST)
    return [name for name in LARGEST if name in kinds]


def _unit(field: pa.Field) -> str:
    """ "" where it has none."""
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode()


def _scalars(field: pa.Field, column: pa.ChunkedArray) -> dict[pa.Field, Any]:
    """A column as it is, or one for each component of its vectors."""
    if not pa.types.is_fixed_size_list(field.type):
        return {field: column}
    width = field.type.list_size
    names = COMPONENTS.get(field.name.rpartition(".")[2], tuple(str(i + 1) for i in range(width)))
    units = _unit(field).split(", ")
    units = units * width if len(units) == 1 else units
    return {
        pa.field(
            f"{field.name}_{name}", field.type.value_type, metadata={"unit": unit} if unit else None
        ): numbers(values)
        for name, unit, values in zip(names, units, as_array(column).T, strict=True)
    }

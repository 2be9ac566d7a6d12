"""Result of `lierb.integrate`."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from lierb.errors import ArgumentError, UnknownNameError, brief, require_name
from lierb.model.problem import Problem
from lierb.results.animation.page import Animation, animate, described_links
from lierb.results.columns import as_array, as_codes, unit_of
from lierb.results.failures import Failures, has_failed
from lierb.results.sensitivities import SEPARATOR, Sensitivities
from lierb.results.states import STATE, RunStates, _kinds_of, _scalars, metadata_of
from lierb.support.arrays import is_whole
from lierb.support.extras import require
from lierb.support.representations import FAILED, Lines, counted, steps_text

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

    from lierb.model.mechanism.mechanism import Mechanism

TABLES = ("summary", "history", "events")
OBSERVED = "observables"  # key in the metadata's description of the problem


@dataclass(frozen=True, repr=False, eq=False)
class Result(RunStates):
    """Tables that `integrate` returns, and the state in them as NumPy arrays.

    `t`, `position`, `rotation`, `quaternion`, `omega` and `v` come from the history if it has the
    state (`save_every=…` or `save_at=…`, `record="state"`), with an axis of times before the axis
    of trajectories; otherwise they are the values at the end. The arrays are read-only views of the
    tables' memory. A batch of one keeps its axis. After a failure all but `t` are NaN, as are rows
    after a terminal event. Each link of a mechanism has these arrays: `result["rod"].position`.

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
    sensitivities : Sensitivities or None
        Tables of derivatives, `summary`, `history` and `events`; None without `with_respect_to`.

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

    sensitivities: Sensitivities | None = None

    @property
    def failed(self) -> NDArray[np.int64]:
        """Numbers of the trajectories whose status is neither ok nor event, ascending."""
        return np.asarray(as_array(self.summary["trajectory"])[has_failed(self.summary)])

    def __reduce__(self) -> Any:
        """Pickle without the end, whose model may have functions that cannot be pickled."""
        return Result, (self.summary, self.history, None, self.events, self.sensitivities)

    def _no_column(self, name: Any) -> UnknownNameError:
        tables = self.sensitivities
        columns = [] if tables is None else tables.summary.column_names
        if isinstance(name, str) and SEPARATOR in name and name in columns:
            of, by = name.split(SEPARATOR)
            return UnknownNameError(
                f"result: column={name!r} has derivatives; take result.sensitivity({of!r}, {by!r})"
            )
        return super()._no_column(name)

    def sensitivity(self, of: str, with_respect_to: str) -> NDArray[np.float64]:
        """Return the derivatives of a quantity by a parameter of `with_respect_to`.

        Parameters
        ----------
        of : str
            "pose", as C⁻¹∂C (rotation in rad, then displacement in m, in body axes); "twist", ω and
            v; "energy"; "lambda" and "reaction", if recorded; the name of an extra state or
            observable; "t", the end time, for a problem with terminal events. For a mechanism
            "rod.pose", "rod.twist", "pin.lambda" and "pin.reaction".
        with_respect_to : str
            Name of the parameter, as in the call of `lierb.integrate`.

        Returns
        -------
        ndarray, shape (times, n, …, k) or (n, …, k)
            Derivatives at the saved times if there is a history, otherwise at the end of each
            trajectory, by the k numbers of the parameter; SI units. `…` is the shape of the
            quantity: 6 for a pose and a twist. `sensitivities.summary` has the end beside a
            history. At the end of a trajectory that a terminal event ends, a derivative includes
            the change of the end time. After a failure all are NaN.

        Raises
        ------
        ArgumentError
            The run has no derivatives.
        UnknownNameError
            The quantity is not differentiated, or the parameter was not given.

        Examples
        --------
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> start = {"twist0": (0.0, 0.0, 0.0, 2.0, 0.0, 0.0), "dt": 0.1, "t_end": 0.5}
        >>> result = lierb.integrate(flight, **start, with_respect_to="twist0")
        >>> result.sensitivity("pose", "twist0")[0, 3:, 3:].round(9).tolist()
        [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]
        """
        if self.sensitivities is None:
            raise ArgumentError(
                "there are no derivatives; integrate with with_respect_to=, the parameters' names"
            )
        return self.sensitivities.array(of, with_respect_to)

    def event_times(self, event: str, trajectory: int = 0) -> NDArray[np.float64]:
        """Return the times at which an event happens in a trajectory.

        Parameters
        ----------
        event : str
            Name of the event.
        trajectory : int, optional
            Number of the trajectory, as in the tables.

        Returns
        -------
        ndarray, shape (k,)
            Times, ascending, s; empty if the event does not happen.

        Raises
        ------
        ArgumentError
            The problem has no events, or the result no such trajectory.
        UnknownNameError
            The problem has no event of this name.

        Examples
        --------
        >>> import lierb
        >>> @lierb.event
        ... def at_the_wall(r):
        ...     return r[0] - 0.3
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> start = {"twist0": (0.0, 0.0, 0.0, 2.0, 0.0, 0.0), "dt": 0.1, "t_end": 0.5}
        >>> result = lierb.integrate(flight, **start, events=at_the_wall())
        >>> result.event_times("at_the_wall").round(9).tolist()
        [0.15]
        """
        table = self._table("events")
        codes, names = as_codes(table["event"])
        require_name("event", event, names)
        if not (is_whole(trajectory) and trajectory in as_array(self.summary["trajectory"])):
            raise ArgumentError(
                f"trajectory={brief(trajectory)}; expected a number in the column trajectory of "
                "the summary"
            )
        chosen = (codes == names.index(event)) & (as_array(table["trajectory"]) == trajectory)
        return np.asarray(as_array(table["t"])[chosen])

    def animate(self, path: str | os.PathLike[str] | None = None, **options: Any) -> Animation:
        """Animate trajectories; write an HTML file, or show the animation in a notebook.

        The history must have the state: `save_every=…` or `save_at=…`, `record="state"`.

        Parameters
        ----------
        path : path, optional
            HTML file to write. Default: none.
        **options : object
            Arguments of `lierb.animate`, such as `trajectories`, `shape`, `trail`, `frames` and
            `title`. `lierb.animate` also shows several results side by side.

        Returns
        -------
        Animation
            The animation.

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
            "angles" and "slides" are the coordinates of its joints. The default then has the
            quantities of all joints together; "rod.omega", "pin.position_error", "pin.force" and
            the like are drawn on request.
        trajectories : int or iterable of int, optional
            Numbers of the trajectories. Default: all; for more than six, their median and 5 to
            95 %.
        problem : Problem or Mechanism, optional
            Problem of the result; needed if the result was pickled, which drops the problem.

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
        from lierb.results.history_plots import history_figure

        return history_figure(self, columns, trajectories=trajectories, problem=problem)

    def to_pandas(self, table: str = "summary") -> pandas.DataFrame:
        """Convert a table to a pandas data frame, with a column for each component of a vector.

        `position` becomes `position_x`, `position_y`, `position_z`; `rotation` becomes
        `rotation_xx`, `rotation_xy`, … row by row; `reaction` becomes `reaction_torque_x` … and
        `reaction_force_x` …; `lambda` becomes `lambda_1` …. For a mechanism, the name of the link
        or joint comes first: `rod.position_x`. `attrs["units"]` has the units.

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
        frame.attrs["units"] = {f.name: unit_of(f) for f in chosen.schema if unit_of(f)}
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
        table = self._table(name)
        columns: dict[pa.Field, Any] = {}
        for each in table.schema:
            columns |= _scalars(each, table[each.name])
        return pa.Table.from_arrays(list(columns.values()), schema=pa.schema(list(columns)))

    def _table(self, name: str) -> pa.Table:
        table = getattr(self, name)
        if table is None:
            remedy = {
                "history": "integrate with save_every= or save_at= for one",
                "events": "give the problem, or integrate, events= made by lierb.event",
            }
            raise ArgumentError(f"there is no table of {name}; {remedy[name]}")
        return table

    def _representation(self) -> tuple[str, Lines]:
        options = metadata_of(self.summary).get("options")
        title = f"lierb.Result: {counted(self.summary.num_rows, 'trajectory', 'trajectories')}"
        if self.links:
            links = described_links(metadata_of(self.summary))
            title += f" of {links or counted(len(self.links), 'link')}"
        if options:
            times = "from t = {t0:g} s to {t_end:g} s" if options["t0"] else "to t = {t_end:g} s"
            text = f" {times} ({{cspace}}, {{method}}, ".format(**options)
            title += f"{text}{steps_text(options)})"
        failures = Failures.of(self.summary)
        rows = [("status", self._ends_text())] if failures is None else [(FAILED, str(failures))]
        if "steps" in self.summary.column_names:
            rows.append(("steps", self._steps_text()))
        rows += self._largest()
        if self.events is not None:
            rows.append(("events", self._events_text()))
        rows.append(("history", self._history_text()))
        if self.sensitivities is not None:
            rows.append(("derivatives", f"by {', '.join(self.sensitivities.parameters)}"))
        shape = self._array_shape()
        if self.links:
            rows.append(("links", ", ".join(f"result[{link!r}]" for link in self.links)))
        rows.append(("arrays", f"{', '.join(STATE)}: {shape}"))
        return title, rows

    def _ends_text(self) -> str:
        """Return the text for a summary without failures."""
        codes, names = as_codes(self.summary["status"])
        ended = np.count_nonzero(codes == names.index("event")) if "event" in names else 0
        return f"all ok, {ended} ended by an event" if ended else "all ok"

    def _steps_text(self) -> str:
        """Return the text for the numbers of steps and the fraction of rejected ones."""
        steps, rejected = (as_array(self.summary[name]) for name in ("steps", "rejected"))
        few, many = steps.min(), steps.max()
        text = f"{few}" if few == many else f"{few} to {many}"
        tries = steps.sum() + rejected.sum()
        return text + (f", {rejected.sum() / tries:.2g} of all tries rejected" if tries else "")

    def _events_text(self) -> str:
        """Return the text for the number of each event."""
        assert self.events is not None
        counts = pc.value_counts(self.events["event"].cast(pa.string())).to_pylist()
        return ", ".join(f"{each['counts']} {each['values']}" for each in counts) or "none"

    def _largest(self) -> Lines:
        """Return the row of the largest errors of the trajectories that are ok."""
        ok, kinds = ~has_failed(self.summary), _kinds_of(metadata_of(self.summary))
        if not ok.any():
            return []
        texts = []
        for name in kinds:
            column = self.summary.schema.field(f"{name}_max")
            unit = unit_of(column)
            largest = as_array(self.summary[column.name])[ok].max()
            plain = name.replace("_", " ")
            where = self._where(column.name, largest, ok)
            texts.append(f"{plain} {largest:.2g}{f' {unit}' if unit != '1' else ''}{where}")
        return [("largest", ", ".join(texts))]

    def _where(self, column: str, largest: float, ok: NDArray[np.bool_]) -> str:
        """Return the joint with the largest error, in parentheses; "" without one."""
        for name in self.summary.column_names if largest else ():
            joint, _, what = name.rpartition(".")
            if joint and what == column and as_array(self.summary[name])[ok].max() == largest:
                return f" ({joint})"
        return ""

    def _history_text(self) -> str:
        if self.history is None:
            return "none; save_every= or save_at= keeps one"
        times = self.history.num_rows // self.summary.num_rows
        there = {name.rpartition(".")[2] for name in self.history.column_names}
        more = [name for name in ("energy", "work", "lambda", "reaction") if name in there]
        problem = metadata_of(self.summary).get("problem", {})
        more += [each["name"] for each in problem.get(OBSERVED, [])]
        recorded = ", ".join(["errors", *["state"] * self.has_states, *more])
        return f"{counted(times, 'time')}: {recorded}"

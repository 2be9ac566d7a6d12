"""States of bodies and links as arrays and tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from lierb.errors import ArgumentError, UnknownNameError, brief, items_of, unknown_name
from lierb.errors.synonyms import RESULTS
from lierb.kernels.groups import so3
from lierb.kernels.mechanics.rows import JOINT_ROWS
from lierb.kernels.mechanics.spatial import wrench_from
from lierb.kernels.numbers.vec import ZERO6, Vec, add, norm, scale
from lierb.model.bodies.body import Body
from lierb.model.functions.column_names import COMPONENTS
from lierb.model.numbers import rigid_of
from lierb.results.columns import as_array, numbers, unit_of
from lierb.runs.continuation import End
from lierb.support.arrays import Array, assembled, components, is_whole, pose_matrix
from lierb.support.keywords import no_attribute
from lierb.support.representations import Lines, Represented, counted

STATE = ("t", "position", "rotation", "quaternion", "omega", "v")


ENDS = ("min", "max", "mean", "final")  # of the names of a column in summaries
NAMED = 3  # most links named in a message
LARGEST = ("position_error", "rotation_error", "energy_drift")


@dataclass(frozen=True, repr=False, eq=False)
class States(Represented):
    """State of one body or link as NumPy arrays, read from the tables of a run.

    _summary : the table, or a function that makes it, which takes a third of a call for one body.
    """

    _summary: pa.Table | Callable[[], pa.Table]
    history: pa.Table | None

    @cached_property
    def summary(self) -> pa.Table:
        """Table with one row for each trajectory."""
        return self._summary() if callable(self._summary) else self._summary

    def __eq__(self, other: object) -> bool:
        """Return whether two results have equal tables."""
        compared = [each.name.lstrip("_") for each in fields(self) if each.compare]
        return type(other) is type(self) and all(
            getattr(self, name) == getattr(other, name) for name in compared
        )

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Raise AttributeError for an attribute that does not exist, with what there is."""
            if hasattr(type(self), name):  # a property, which has raised AttributeError
                return object.__getattribute__(self, name)
            raise no_attribute("the result", name, dir(type(self)), RESULTS)

    @property
    def _prefix(self) -> str:
        """Prefix of the state's column names."""
        return ""

    @property
    def t(self) -> Array:
        """Times of the state, s, (times,) of the history, or (n,), each trajectory's end time.

        The end time of a failed trajectory is that of its failure; the history goes on.
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

        Of p and −p, the one with w ≥ 0 is returned, so that a row does not depend on the other
        saved rows. Along a history the sign jumps where w would pass through 0. The quaternion is
        computed from `rotation` on access.
        """
        unit = quaternions_of(self._state("rotation", 3, 3, quantity="quaternion"))
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
        """True if the history has the state; the arrays are then those of the history."""
        return self.history is not None and f"{self._prefix}position" in self.history.column_names

    def _state(self, name: str, *item: int, quantity: str = "") -> Array:
        """Return a state array.   quantity : name of the requested quantity, for messages."""
        if self.history is not None and self.has_states:
            return self._array(self.history, f"{self._prefix}{name}", *item)
        return np.asarray(self._array(self.summary, f"{self._prefix}{name}", *item)[0])

    def _array(self, table: pa.Table, column: str, *item: int) -> Array:
        """Return a column as an array, (times, n, *item)."""
        return as_array(table[column]).reshape(-1, self.summary.num_rows, *item)

    def _array_shape(self) -> str:
        times = (len(self.t),) if self.has_states else ()
        return f"({', '.join(map(str, (*times, self.summary.num_rows)))}, …)"


@dataclass(frozen=True, repr=False, eq=False)
class LinkResult(States):
    """Motion of one link of a mechanism, `result["rod"]`, with the arrays of `Result`.

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

    def _representation(self) -> tuple[str, Lines]:
        count = counted(self.summary.num_rows, "trajectory", "trajectories")
        rows = [("arrays", f"{', '.join(STATE)}: {self._array_shape()}")]
        return f"lierb.results.states.LinkResult {self.name!r}: {count}", rows


def quaternions_of(rotation: Array) -> Array:
    """Return the unit quaternions (w, x, y, z) of rotation matrices."""
    p = so3.quaternion(components(rotation, 2))
    return assembled(scale(1.0 / norm(p), p))


def poses_of(states: States, at: Any = ...) -> Array:
    """Return the homogeneous matrices of a history.   at : indices of times and trajectories."""
    rotation, position = states.rotation[at], states.position[at]
    return pose_matrix((components(rotation, 2), components(position)))


def _momentum_of(body: Body, link: States) -> Vec:
    """Return the momentum of one body about the ground's origin, in the ground's axes."""
    momentum = rigid_of(body).momentum(components(link.omega) + components(link.v))
    place = components(link.rotation, 2), components(link.position)
    return wrench_from(place, momentum)


def metadata_of(table: pa.Table) -> dict[str, Any]:
    """Return the metadata of a table as a dictionary."""
    metadata = (table.schema.metadata or {}).get(b"lierb")
    content: dict[str, Any] = json.loads(metadata) if metadata else {}
    return content


def chosen_trajectories(given: Any, count: int, most: int) -> list[int]:
    """Check numbers of trajectories, of `count` in all; None stands for the first `most`."""
    if given is None:
        return list(range(min(count, most)))
    numbers = (given,) if is_whole(given) else items_of("trajectories", given, "whole numbers")
    for number in numbers:
        if not (is_whole(number) and 0 <= number < count):
            raise ArgumentError(f"trajectories has {brief(number)}; expected 0 … {count - 1}")
    if not numbers:
        raise ArgumentError("trajectories is empty; expected numbers of trajectories")
    return [int(number) for number in numbers]


def _kinds_of(metadata: dict[str, Any]) -> list[str]:
    """Return the members of LARGEST with rows; a constraint's row may be of either kind."""
    kinds = {"energy_drift"}
    for name in metadata.get("problem", {}).get("rows", [""]):
        row = JOINT_ROWS.get(name.rpartition(".")[2])  # a mechanism has a prefix
        kinds.update([f"{row.error_kind}_error"] if row else LARGEST)
    return [name for name in LARGEST if name in kinds]


def _scalars(field: pa.Field, column: pa.ChunkedArray) -> dict[pa.Field, Any]:
    """Return a scalar column, or the component columns of a vector column, by field."""
    if not pa.types.is_fixed_size_list(field.type):
        return {field: column}
    width = field.type.list_size
    names = COMPONENTS.get(field.name.rpartition(".")[2], tuple(str(i + 1) for i in range(width)))
    units = unit_of(field).split(", ")
    units = units * width if len(units) == 1 else units
    return {
        pa.field(
            f"{field.name}_{name}", field.type.value_type, metadata={"unit": unit} if unit else None
        ): numbers(values)
        for name, unit, values in zip(names, units, as_array(column).T, strict=True)
    }


def _column(column: pa.ChunkedArray) -> Array:
    """Return a column as an array; of objects for strings."""
    is_text = pa.types.is_string(column.type) or pa.types.is_dictionary(column.type)
    return np.array(column.to_pylist(), dtype=object) if is_text else as_array(column)


@dataclass(frozen=True, repr=False, eq=False)
class RunStates(States):
    """Tables of a whole run, the states of its body or links, and the run's end.

    Attributes: see `lierb.Result`.
    """

    _end: End | None = field(default=None, repr=False, compare=False)
    events: pa.Table | None = None

    @property
    def links(self) -> tuple[str, ...]:
        """Return the names of the links of a mechanism; empty for a single body."""
        ends = (n.rpartition(".") for n in self.summary.column_names)
        return tuple(link for link, _, what in ends if link and what == "rotation")

    def __getitem__(self, name: str) -> Any:
        """Return the state of one link of a mechanism, or a column as an array.

        A column of numbers or strings is (times, n) or (times, n, width) from the history if it has
        the column, otherwise (n,) or (n, width) from the summary.

        Raises UnknownNameError for another name.

        >>> import lierb
        >>> hinge = lierb.joints.revolute(body_point=(0.5, 0.0, 0.0))
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), hinge)
        >>> swing = lierb.Mechanism(wheel)
        >>> result = lierb.integrate(swing, twist0=swing.twist({"wheel": 2.0}), dt=0.1, t_end=0.5)
        >>> result["wheel"].omega.round(9).tolist()
        [[0.0, 0.0, 2.0]]
        """
        if isinstance(name, str) and name in self.links:
            return LinkResult(self.summary, self.history, name)
        for table in (self.history, self.summary):
            if table is not None and isinstance(name, str) and name in table.column_names:
                values = _column(table[name])
                shape = () if table is self.summary else (-1,)
                return values.reshape(*shape, self.summary.num_rows, *values.shape[1:])
        raise self._no_column(name)

    def __contains__(self, name: object) -> bool:
        """Return whether `result[name]` is a link or a column."""
        return name in (*self.links, *self._columns)

    @property
    def _columns(self) -> tuple[str, ...]:
        saved = [] if self.history is None else self.history.column_names
        return tuple(dict.fromkeys((*saved, *self.summary.column_names)))

    def _no_column(self, name: Any) -> UnknownNameError:
        """Return the error for a name that is no link and no column."""
        what = f"result: {'link or column' if self.links else 'column'}"
        known = (*self.links, *self._columns)
        if not isinstance(name, str):
            return unknown_name(what, name, known)
        least = [f"{name}_{end}" for end in ENDS if f"{name}_{end}" in known]
        if least and self.history is None:
            return UnknownNameError(
                f"{what}={name!r} is one of a history, which save_every= or save_at= keeps; "
                f"without one there are {', '.join(least)}"
            )
        if name in RESULTS:
            return UnknownNameError(f"{what}={brief(name)} is unknown; take {RESULTS[name]}")
        return unknown_name(what, name, known)

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
        model, total = self._end.model, ZERO6
        for name, body in zip(model.link_names, model.bodies, strict=True):
            total = add(total, _momentum_of(body, self[name] if name else self))
        return assembled(total)

    def _state(self, name: str, *item: int, quantity: str = "") -> Array:
        if self.links:
            quantity = quantity or name
            raise ArgumentError(
                f"result.{quantity}: every link has its own; take "
                f"{', '.join(f'result[{link!r}].{quantity}' for link in self.links[:NAMED])}"
                f"{', …' if len(self.links) > NAMED else ''}"
            )
        return super()._state(name, *item)

    @property
    def has_states(self) -> bool:
        """True where the history has the states of all links."""
        name = f"{self.links[0]}.position" if self.links else "position"
        return self.history is not None and name in self.history.column_names

    @cached_property
    def end(self) -> dict[str, Any]:
        """End of the run, as the keywords `pose0`, `twist0` and `t0` with which it continues.

        `lierb.integrate(problem, **result.end, dt=…, t_end=…)` continues the run. In the same
        process, and if the bodies, joints and constraints have equal numbers and functions and the
        formulation is the same, it starts from the driver's own state. With the same dt and method,
        the result is then bit for bit that of one uninterrupted run. A state that has drifted off
        its joint is not corrected. Maxima, energy drift and work count from the new start. A copy
        or slice of `pose0`, or `pose0` with another twist or time, is an ordinary start.

        The problem's own states, the outputs and memory of its controllers, and the length of
        adaptive steps continue too. The result is bit for bit that of one run in which a step ends
        here, as at every tick of a controller. `seed` and `trajectories` must be passed again.
        `integrate` raises ArgumentError if states or memory would be lost by a change of the run;
        a problem that has neither goes on without them. With `with_respect_to` in both runs, the
        derivatives of all these numbers continue.

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

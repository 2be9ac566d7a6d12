"""Columns of the numbers of a trajectory; each field is defined once, with shape and unit.

Packing, loading, storing, tables of results and their units are derived from these definitions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import accumulate
from math import prod
from typing import Any, NamedTuple

from lierb.kernels.mechanics.elements import Element

END = ("state", "lane")  # last fields of the inputs, from which a run continues
POSE = (0, 1, 2, 4, 5, 6, 8, 9, 10, 3, 7, 11)  # of a 4×4 matrix: R, then r


def pose_of(numbers: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return (R, r) from numbers in the order of POSE."""
    return numbers[:9], numbers[9:]


class Field(NamedTuple):
    """A field is a quantity of a trajectory.

    shape : shape of its array.   unit : unit of its numbers.
    entries : indices into the flattened array, in the order of the numbers; None for all.
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str = "1"
    entries: tuple[int, ...] | None = None

    @property
    def width(self) -> int:
        return prod(self.shape) if self.entries is None else len(self.entries)


class Columns:
    """Columns are fields side by side, with one column for each number."""

    def __init__(self, *fields: Field) -> None:
        ends = tuple(accumulate((field.width for field in fields), initial=0))
        self.fields = fields
        self.count = ends[-1]
        self._named = {field.name: field for field in fields}
        self._slices = dict(zip(self._named, map(slice, ends, ends[1:]), strict=True))

    def __getitem__(self, name: str) -> slice:
        return self._slices[name]

    def __iter__(self) -> Iterator[tuple[Field, slice]]:
        return zip(self.fields, self._slices.values(), strict=True)

    def field(self, name: str) -> Field:
        return self._named[name]

    def index(self, name: str) -> int:
        """Return the column of a field of one number."""
        return self._slices[name].start

    def parts(self, numbers: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
        """Return the numbers of each field, by name."""
        return {name: tuple(numbers[columns]) for name, columns in self._slices.items()}


INPUTS = Columns(
    Field("mass", (), "kg"),
    Field("inertia", (3, 3), "kg m²"),
    Field("com", (3,), "m"),
    Field("gravity", (3,), "m/s²"),
    Field("ground_frame", (4, 4), "1, m", POSE),
    Field("body_frame", (4, 4), "1, m", POSE),
    Field("pitch", (), "m/rad"),
    Field("length", (), "m"),
    Field("pose", (4, 4), "1, m", POSE),
    Field("twist", (6,), "rad/s, m/s"),
)

STATE = Columns(
    Field("p", (4,)),  # of C₀, a unit quaternion
    Field("d", (3,), "m"),
    Field("x", (6,), "rad, m"),
    Field("v_or_mu", (6,)),
    Field("work", (), "J"),
)

POSE_AND_TWIST = Columns(
    Field("rotation", (9,)),
    Field("position", (3,), "m"),
    Field("omega", (3,), "rad/s"),
    Field("v", (3,), "m/s"),
)


# Directions of derivatives of one run, if there are several: few by dual numbers, or many in a loop
# (`lierb.kernels.stepping.taped`). docs/decisions/formulas.md has times of other numbers.
FEW_DIRECTIONS, MANY_DIRECTIONS = 3, 6

LANE_SUMMARY = Columns(
    Field("t", (), "s"), Field("steps"), Field("rejected"), Field("dt_last", (), "s")
)
"""Columns of a lane's own clock in a summary, last but for the user's states and outputs."""


LANE_END = Columns(
    Field("anchor", (), "s"), Field("counted"), Field("h", (), "s"), Field("before"), Field("ahead")
)
"""Columns of a lane's own clock at the end of a run, for one that resumes it."""


@lru_cache(64)
def inputs_of(
    elements: tuple[Element, ...],
    state: int = STATE.count,
    lane: int = 0,
    moving: tuple[str, ...] = (),
    directions: int = 0,
) -> Columns:
    """Return INPUTS and the elements' parameters, then the columns of `with_end`."""
    parameters = (
        Field(f"{number}.{name}", shape)
        for number, element in enumerate(elements)
        for name, shape in element.shapes.items()
    )
    return with_end((*INPUTS.fields, *parameters), state, lane, moving, directions)


def with_end(
    fields: Sequence[Field], state: int, lane: int, moving: tuple[str, ...], directions: int
) -> Columns:
    """Return the columns of fields, of their seeds, and of the end of a run to continue from.

    state, lane : numbers of a state, and of `lierb.kernels.systems.signals.lane_end`.
    moving : fields with derivatives along some directions. The seeds are these derivatives,
        [number of a moving field][direction].
    """
    end = [Field(name, (count,)) for name, count in zip(END, (state, lane), strict=True)]
    count = sum(field.width for field in (*fields, *end) if field.name in moving)
    seeds = (Field("seeds", (directions * count,)),) if moving else ()
    return Columns(*fields, *seeds, *end)

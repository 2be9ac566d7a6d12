"""Base class of `lierb.Problem` and `lierb.Mechanism`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import Parameters
from lierb.kernels.numbers.vec import IDENTITY, ZERO3
from lierb.model.acting import ELEMENTS, bind, shown_element
from lierb.model.bodies.body import Body
from lierb.model.functions.binding import Column, columns_of
from lierb.model.functions.constraints import Constraint
from lierb.model.functions.controllers import Controller
from lierb.model.functions.elements import Element
from lierb.model.functions.events import Event
from lierb.model.functions.observables import Observable
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import Joint
from lierb.support.arrays import (
    Array,
    Pose,
    Which,
    batch_size,
    components,
    member_of,
    pose_components,
)
from lierb.support.shown import Shown


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Model(Shown):
    """Gravity, and forces and other elements, of a problem or a mechanism or a batch of them."""

    gravity: Array
    forces: tuple[Force, ...]
    constraints: tuple[Constraint, ...]
    observables: tuple[Observable, ...]
    events: tuple[Event, ...]
    states: tuple[ExtraStates, ...]
    controllers: tuple[Controller, ...]

    def _set(self, **attributes: Any) -> None:
        for name, value in attributes.items():
            object.__setattr__(self, name, value)

    def _set_elements(self, *given: Any) -> None:
        """Check and set the elements, which are in the order of ELEMENTS."""
        for (label, kind), elements in zip(ELEMENTS.items(), given, strict=True):
            self._set(**{label: self._fitted(label, elements, kind)})
        bind(self)

    # ---- implemented by problems and mechanisms ----

    def _fitted(self, label: str, given: Any, kind: type[Element]) -> tuple[Any, ...]:
        """Check elements; raise where they do not act on this model."""
        raise NotImplementedError

    @property
    def _structure(self) -> tuple[Any, ...]:
        """Arguments of the constructor that come before the elements."""
        raise NotImplementedError

    def _structure_of(self, which: Which) -> tuple[Any, ...]:
        """Arguments of the constructor that come before the elements, for part of the batch."""
        raise NotImplementedError

    @property
    def _arguments(self) -> dict[str, tuple[Array, int]]:
        """Arrays that may be batched by name, with the number of an item's axes."""
        raise NotImplementedError

    # ---- elements ----

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """Forces, constraints, observables, events, states and controllers."""
        return tuple(e for label in ELEMENTS for e in getattr(self, label))

    @cached_property
    def signals(self) -> tuple[Column, ...]:
        """Columns of the extra states, then of the controllers' outputs."""
        return columns_of(self.elements)

    @cached_property
    def kinds(self) -> tuple[kinds.Element, ...]:
        """Kinds of the elements, on which compiled code is specialised."""
        return tuple(element.kind for element in self.elements)

    def require_unchanged(self) -> None:
        """Raise ForceError where a variable that a function refers to has changed."""
        for element in self.elements:
            if element.references:
                element.require_unchanged()

    def with_events(self, events: Event | Iterable[Event]) -> Self:
        """Return the same model with further events after its own."""
        elements = {label: getattr(self, label) for label in ELEMENTS}
        elements["events"] = (*self.events, *self._fitted("events", events, Event))
        return type(self)(*self._structure, **elements)

    def _shown_elements(self) -> list[tuple[str, str]]:
        def line(element: Element) -> str:
            return shown_element(element) + (
                f", on {' and '.join(element.at)}" if element.at else ""
            )

        return [
            (label, "\n".join(map(line, elements)))
            for label in ELEMENTS
            if (elements := getattr(self, label))
        ]

    # ---- batches ----

    @cached_property
    def _batched(self) -> dict[str, tuple[Array, int]]:
        return {
            name: (array, axes)
            for name, (array, axes) in self._arguments.items()
            if array.ndim > axes
        }

    def batch_size(self, **more: Any) -> int | None:
        """Return the number of members of the batch; None if no argument is batched."""
        return batch_size(**self._batched, **more)

    def of_body(self, body: int) -> Self:
        """Return one member of the batch.

        Parameters
        ----------
        body : int
            Number of the member.

        Returns
        -------
        Problem or Mechanism
            The member, not batched.

        Raises
        ------
        ArgumentError
            The batch has no member of that number.
        """
        return self.part(member_of(body, self.batch_size()))

    def part(self, which: Which) -> Self:
        """Return one member of the batch, or a range of them."""
        elements = {label: [e.of_body(which) for e in getattr(self, label)] for label in ELEMENTS}
        return type(self)(*self._structure_of(which), **elements)


def _shown_with_links(element: Element) -> str:
    return ", on ".join(filter(None, (shown_element(element), " and ".join(element.at))))


def parameters_of(body: Body, joint: Joint | None, gravity: Array) -> Parameters:
    """Return the numbers of a body as formulas take them; without a joint, in the body frame."""
    own: Pose = (IDENTITY, ZERO3)
    return Parameters(
        mass=body.mass,
        inertia=components(body.inertia, 2),
        com=components(body.com),
        gravity=components(gravity),
        ground=own if joint is None else pose_components(joint.ground_frame),
        body=own if joint is None else pose_components(joint.body_frame),
        pitch=np.float64(0.0) if joint is None else joint.pitch,
        length=np.float64(0.0) if joint is None else joint.length,
    )


def numbers_of(elements: Sequence[Element]) -> list[Array]:
    """Return the parameters of elements, one array per component."""
    return [
        x
        for element in elements
        for name, shape in element.kind.shapes.items()
        for x in components(element.parameters[name], len(shape))
    ]

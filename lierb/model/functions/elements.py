"""A model's elements, besides bodies, joints and gravity, have parameters and kernel elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from lierb.errors import ArgumentError, ForceError, brief
from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.fingerprint import Reference
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.passive_elements import INITIAL, AddedStates
from lierb.model.functions.decorated import Decorated
from lierb.model.functions.tracing import runnable
from lierb.support.arrays import Array, Which, as_numbers, batch_size, items_at


@dataclass(frozen=True, eq=False)
class Element:
    """A model's element is a force, a constraint, an observable or another function of motion.

    Attributes
    ----------
    name : str
        Name of the function that makes such elements.
    parameters : dict of ndarray
        Parameters by name, each with its shape for one body, or with a leading axis for bodies.
    made_by : callable or None
        Decorated user's function; None for a force of `lierb.forces`.
    at : tuple of str
        Place in a mechanism: a link, two links, or the joint about whose axis it acts.
    """

    name: str
    kind: kinds.Element
    parameters: dict[str, Array]
    made_by: Decorated | None = None
    at: tuple[str, ...] = ()
    words: ClassVar[tuple[str, str]] = "an element", "elements"  # singular and plural of its kind
    because: ClassVar[str | None] = None  # reason why its function must be traced

    @classmethod
    def of(cls, name: str, kind: kinds.Element, values: Mapping[str, Any], **fields: Any) -> Self:
        """Check the parameters' values and make an element of them."""
        parameters = {
            parameter: as_numbers(cls.short(parameter), values[parameter], shape)
            for parameter, shape in kind.shapes.items()
        }
        return cls(name, kind, parameters, **fields).checked()

    def checked(self) -> Self:
        """Return the element. Raises ArgumentError if its parameters do not fit."""
        shapes = self.kind.shapes
        given = {f"{self.name}.{n}": (a, len(shapes[n])) for n, a in self.parameters.items()}
        batch_size(**given)
        self.kind.require_fit(self.parameters)
        return self

    def __repr__(self) -> str:
        where = f", on {' and '.join(self.at)}" if self.at else ""
        return f"<{self.name}: {', '.join(self.parameters) or 'no parameters'}{where}>"

    @staticmethod
    def short(parameter: str) -> str:
        """Return the name that users give to a parameter of the kernels."""
        return parameter.removeprefix(INITIAL)

    def on(self, link: str, other: str | None = None) -> Self:
        """Place the element on a link of a `lierb.Mechanism`, or between two links.

        Parameters
        ----------
        link : str
            Name of the link. For an element that acts about a joint axis, the name of the link or
            loop whose joint it is.
        other : str, optional
            Link that replaces the ground: points and directions on the ground, R and r are then in
            the body frame of this link, and the reaction of a force acts on it.

        Returns
        -------
        Element
            The element, placed there.

        Examples
        --------
        >>> import lierb
        >>> spring = lierb.forces.spring_damper(stiffness=10.0)
        >>> spring.on("rod", "crank")
        <spring_damper: body_point, ground_point, stiffness, damping, length, on rod and crank>
        """
        at = (link,) if other is None else (link, other)
        for name in at:
            if not isinstance(name, str):
                raise ArgumentError(f"on({brief(name)}); expected the name of a link, as text")
        if link == other:
            raise ArgumentError(f"on({link!r}, {other!r}); expected two different links")
        return replace(self, at=at)

    def of_body(self, which: Which) -> Self:
        """Return the element for one body of the batch, or for part of the batch."""
        shapes = self.kind.shapes
        parameters = {n: items_at(a, which, len(shapes[n])) for n, a in self.parameters.items()}
        return replace(self, parameters=parameters)

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """Return the objects that the element's users' functions referred to when it was made."""
        return tuple(r for function in self.kind.functions for r in function.references)

    def require_unchanged(self) -> None:
        """Raise ForceError if an object that the element's function refers to has changed."""
        for reference in self.references:
            if reference.has_changed():
                raise ForceError(
                    f"{reference.name} has changed since {self.name} was made with it; make the "
                    f"{self.words[0].partition(' ')[2]} anew, or make {reference.name} a parameter"
                )

    @property
    def columns(self) -> Shapes:
        """Names and shapes of the extra states, or outputs of a controller, that it has."""
        return self.kind.states if isinstance(self.kind, AddedStates) else ()

    def unit_of_column(self, name: str) -> str:
        """Return the unit of one of `columns`."""
        return self.kind.state_unit if isinstance(self.kind, AddedStates) else "1"

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        """Return the element bound to a problem's extra states and outputs of controllers.

        Raises ForceError if its function uses states or outputs that the problem lacks.
        """
        function = getattr(self.kind, "function", None)
        if self.made_by is None or not (isinstance(function, Function) and function.takes_signals):
            return self
        seeing_them = seeing(function, states, controls)
        if not function.is_traced:
            if seeing_them == function:
                return self
            python = traceable(self.made_by.function)
            seeing_them = replace(seeing_them, is_traced=True, python=python)
        return self.of_kind(function=runnable(seeing_them, self.made_by.function, self.because))

    def of_kind(self, **changed: Any) -> Self:
        """Copy of the element with changed fields of its kernel element."""
        kind: Any = self.kind
        return replace(self, kind=replace(kind, **changed))


def seeing(function: Function, states: Shapes, controls: Shapes) -> Function:
    """Copy of the function, bound to those of a problem's states and controls that it takes."""
    return replace(
        function,
        states=states if "states" in function.form else (),
        controls=controls if "controls" in function.form else (),
    )

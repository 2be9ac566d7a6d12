"""What a problem has beside its body, joint and gravity: forces, constraints and observables.

Some are functions of the user's: `@lierb.wrench` makes a force of one, `@lierb.constraint` a
constraint, `@lierb.observable` an observable. They are written for one body and compiled for many
at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, told
from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.fingerprint import Reference
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.decorated import Decorated
from lierb.model.functions.tracing import runnable
from lierb.support.arrays import Array, Which, as_numbers, batch_size, taken


@dataclass(frozen=True, eq=False)
class Element:
    """A force, a constraint or an observable.

    Attributes
    ----------
    name : str
        Name of the function that made it.
    parameters : dict of ndarray
        Parameters by name, each in its own shape, or with an axis for the bodies before it.
    made_by : callable or None
        The user's function, as it was decorated.
    at : tuple of str
        Place in a mechanism: a link, two links, or the joint about whose axis it acts.
    """

    name: str
    kind: kinds.Element
    parameters: dict[str, Array]
    made_by: Decorated | None = None
    at: tuple[str, ...] = ()
    words: ClassVar[tuple[str, str]] = "an element", "elements"  # for one of its kind, for many

    @classmethod
    def of(cls, name: str, kind: kinds.Element, /, **given: ArrayLike) -> Self:
        parameters = {
            parameter: as_numbers(parameter.removeprefix(kinds.INITIAL), given[parameter], shape)
            for parameter, shape in kind.shapes.items()
        }
        element = cls(name, kind, parameters)
        batch_size(**element.batched())
        return element

    def __repr__(self) -> str:
        where = f", on {' and '.join(self.at)}" if self.at else ""
        return f"<{self.name}: {', '.join(self.parameters) or 'no parameters'}{where}>"

    def on(self, link: str, other: str | None = None) -> Self:
        """Place the element on a link of a `lierb.Mechanism`, or between two links.

        Parameters
        ----------
        link : str
            Name of the link. For an element that acts about a joint axis, the name of the link or
            loop whose joint it is.
        other : str, optional
            Link in place of the ground: the element's points and directions of the ground, R and r
            are in its body frame, and it receives the reaction of a force.

        Returns
        -------
        Element
            The element in that place.

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
                raise ArgumentError(f"on({told(name)}); expected the name of a link, as text")
        if link == other:
            raise ArgumentError(f"on({link!r}, {other!r}); expected two different links")
        return replace(self, at=at)

    def of_body(self, which: Which) -> Self:
        """That of one body of the batch, or of a part of it."""
        shapes = self.kind.shapes
        given = {n: taken(a, which, len(shapes[n])) for n, a in self.parameters.items()}
        return replace(self, parameters=given)

    def batched(self) -> dict[str, tuple[Array, int]]:
        """The parameters as `batch_size` takes them."""
        return {
            f"{self.name}.{name}": (array, len(self.kind.shapes[name]))
            for name, array in self.parameters.items()
        }

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """What functions of the user's in it referred to when it was made."""
        return tuple(r for function in self.kind.functions for r in function.references)

    def require_unchanged(self) -> None:
        """Raise ForceError if something that its function has been made with is another by now."""
        for reference in self.references:
            if reference.has_changed():
                raise ForceError(
                    f"{reference.name} has changed since {self.name} was made with it; make the "
                    f"{self.words[0].partition(' ')[2]} anew, or make {reference.name} a parameter"
                )

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        """The same in a problem with these extra states and outputs of controllers.

        Raises ForceError where its function sees others.
        """
        function = getattr(self.kind, "function", None)
        if self.made_by is None or not (isinstance(function, Function) and function.sees_others):
            return self
        seen = seeing(function, states, controls)
        if not function.is_traced:
            if seen == function:
                return self
            seen = replace(seen, is_traced=True, python=traceable(self.made_by.function))
        seen = runnable(seen, self.made_by.function)
        return self.of_kind(function=seen)

    def of_kind(self, **changed: Any) -> Self:
        """The same with other fields of its kind."""
        kind: Any = self.kind
        return replace(self, kind=replace(kind, **changed))


def seeing(function: Function, states: Shapes, controls: Shapes) -> Function:
    """The function, with what it sees of a problem."""
    return replace(
        function,
        states=states if "states" in function.form else (),
        controls=controls if "controls" in function.form else (),
    )

"""`lierb.event` makes events from users' functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.mechanics.passive_elements import UserEvent
from lierb.model.functions.decorated import Decorated, column_name, decorated
from lierb.model.functions.elements import Element
from lierb.model.functions.tracing import number_of_motion


@dataclass(frozen=True, eq=False, repr=False)
class Event(Element):
    """An event is a zero crossing of a function of the motion, made by `lierb.event`.

    Attributes
    ----------
    name : str
        Name in the table of events.
    parameters : dict of ndarray
        Parameters by name, each with its shape for one body, or with a leading axis for bodies.
    made_by : callable or None
        Decorated user's function.
    at : tuple of str
        Place in a mechanism: one or two links.
    direction : {-1, 0, 1}
        Crossings that count: 1 rising, −1 falling, 0 both.
    terminal : bool
        True if the trajectory ends there.
    """

    direction: int = 0
    terminal: bool = False
    words: ClassVar = "an event", "events"

    def named(self, name: str) -> Self:
        """Rename the event, so that a problem can use one function several times.

        Parameters
        ----------
        name : str
            Name in the table of events.

        Returns
        -------
        Event
            The event with that name.

        Examples
        --------
        >>> import lierb
        >>> @lierb.event(height=0.0)
        ... def crossing(r, params):
        ...     return r[2] - params.height
        >>> crossing(height=2.0).named("the_roof")
        <the_roof: height>
        """
        return replace(self, name=column_name("name", name))


class EventFunction(Decorated):
    """A function decorated by `lierb.event` returns a number whose zeros are events."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        direction, terminal = defaults.pop("direction", 0), defaults.pop("terminal", False)
        if isinstance(direction, bool) or direction not in (-1, 0, 1):
            raise ArgumentError(
                f"direction={brief(direction)}; expected -1 (falling), 1 (rising) or 0 (both)"
            )
        if not isinstance(terminal, bool):
            raise ArgumentError(f"terminal={brief(terminal)}; expected True or False")
        super().__init__(function, defaults)
        self.direction, self.terminal = int(direction), terminal

    def __call__(self, **parameters: ArrayLike) -> Event:
        """Make the event with these parameters, one value for all bodies or one for each."""
        function = number_of_motion(self.function, self._shapes(parameters))
        return Event.of(
            column_name("the event's name", function.name), UserEvent(function),
            self.defaults | parameters,
            direction=self.direction, terminal=self.terminal, made_by=self,
        )  # fmt: skip


@overload
def event(function: UserFunction, /) -> EventFunction: ...
@overload
def event(
    *, direction: int = 0, terminal: bool = False, **defaults: ArrayLike
) -> Callable[[UserFunction], EventFunction]: ...
def event(function: UserFunction | None = None, /, **defaults: Any) -> Any:
    """Make an event from a function: `@lierb.event(terminal=True)`, with defaults as in `wrench`.

    The function takes any of t, R, r, omega, v, params, body, states, controls, alpha and
    specific_force, by these names and in any order, each as in `lierb.observable`, and returns one
    number, which should be smooth. An event occurs when this number crosses zero. The crossings are
    in `result.events`.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    direction : {-1, 0, 1}, optional
        Crossings that count: 1 rising, −1 falling, 0 both.
    terminal : bool, optional
        End the trajectory at the first crossing.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes an event for `Problem(events=…)` and
        `lierb.integrate(events=…)`.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be compiled.
    ArgumentError
        The direction is not −1, 0 or 1.

    Examples
    --------
    >>> import lierb
    >>> @lierb.event(direction=-1, terminal=True, ground=0.0)
    ... def landing(r, params):
    ...     return r[2] - params.ground
    >>> landing(ground=[0.0, 0.5])
    <landing: ground>
    """
    return decorated(EventFunction, function, defaults)

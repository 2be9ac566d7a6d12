"""Base class of `lierb.Problem` and `lierb.Mechanism`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import LierbError, require_name
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import BodyConstants, Parameters
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.systems.plan import AnyPlan
from lierb.model.acting import ELEMENTS, all_of, bind, shown_element
from lierb.model.bodies.body import POINTS, Body
from lierb.model.connections import Connection
from lierb.model.formulation import Formulation
from lierb.model.functions.binding import Column, columns_of
from lierb.model.functions.constraints import Constraint
from lierb.model.functions.controllers import Controller
from lierb.model.functions.elements import Element
from lierb.model.functions.events import Event
from lierb.model.functions.ground_motion import MovingGround, moving_ground, require_one_ground
from lierb.model.functions.observables import Observable
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import JOINT, Joint
from lierb.model.numbers import (
    BODY,
    Numbers,
    body_with,
    by_field,
    elements_with,
    joint_with,
    qualified,
)
from lierb.support.arrays import Array, Which, batch_size, items_at, member_of
from lierb.support.representations import Represented

OfBody = Callable[[Body, str, str], Body]
OfJoint = Callable[[Joint, str], Joint]
DESCRIBED = ("forces", "constraints", "observables")  # in metadata, even if there are none


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Model(Represented):
    """Rigid bodies, their joints, and the elements that act on them; one model or a batch.

    A `Problem` is a model of one link, which has the name "" and a joint without a name. Its poses
    and twists are arrays; those of a `Mechanism` are dictionaries by link.
    """

    default_cspace: ClassVar[str]
    element_prefix: ClassVar[str]  # of `element_fields`
    flags_starts: ClassVar[bool]  # True if the kernels flag starts that violate the joint

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

    def _set_elements(self, *given: Any, ground_motion: Any = None) -> None:
        """Check and set the elements, which are in the order of ELEMENTS."""
        for (label, kind), elements in zip(ELEMENTS.items(), given, strict=True):
            self._set(**{label: self._fitted(label, elements, kind)})
        if (motion := moving_ground(ground_motion)) is not None:
            on_links = [motion.on(link) if link else motion for link in self.link_names]
            moved = self._fitted("ground_motion", on_links, Force)
            self._set(forces=(*self.forces, *moved))
        require_one_ground(self)
        bind(self)

    def _fitted(self, label: str, given: Any, kind: type[Element]) -> tuple[Any, ...]:
        """Check elements; raise if they cannot act on this model."""
        one, several = (f"{words} made by lierb" for words in kind.words)
        elements = all_of(label, given, kind, one, several)
        return tuple(self._placed(f"{label}[{i}]", e) for i, e in enumerate(elements))

    # ---- implemented by problems and mechanisms ----

    def _placed(self, label: str, element: Element) -> Any:
        """Return the element at its place; raise if it cannot act on this model."""
        raise NotImplementedError

    def _structure(self, body: OfBody, joint: OfJoint) -> tuple[Any, Any]:
        """First two arguments of the constructor, with other bodies and joints.

        body : function of a body, the prefix of its fields and its link's name.
        joint : function of a joint and the prefix of its fields.
        """
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
        """Kernel element of each element, on which compiled code is specialised."""
        return tuple(element.kind for element in self.elements)

    def require_unchanged(self) -> None:
        """Raise ForceError if a variable that a function refers to has changed."""
        for element in self.elements:
            if element.references:
                element.require_unchanged()

    def with_(
        self,
        numbers: Mapping[str, ArrayLike] | None = None,
        *,
        forces: Force | Iterable[Force] = (),
        constraints: Constraint | Iterable[Constraint] = (),
        observables: Observable | Iterable[Observable] = (),
        events: Event | Iterable[Event] = (),
        states: ExtraStates | Iterable[ExtraStates] = (),
        controllers: Controller | Iterable[Controller] = (),
        ground_motion: MovingGround | UserFunction | None = None,
        about: str = "origin",
    ) -> Self:
        """Return the model with other numbers and with further elements, such as forces.

        Parameters
        ----------
        numbers : dict, optional
            New numbers, or arrays of n of them, by name: `gravity`, m/s²; `body.mass`, kg;
            `body.inertia`, kg m², see `about`; `body.com`, m;
            `joint.body_point` and `joint.ground_point` (of links also `joint.parent_point`), m;
            `joint.body_frame` and `joint.ground_frame`; `joint.pitch`, m/rad; `joint.length`, m;
            and each parameter of a force or other element, such as `spring_damper.stiffness`. In a
            mechanism the link's or loop's name comes first: `forearm.body.mass`. Names are those of
            `with_respect_to` in `lierb.integrate`.
        forces : Force or iterable of Force, optional
            Forces after those that the model has, as for its constructor.
        constraints : Constraint or iterable of Constraint, optional
            Further constraints.
        observables : Observable or iterable of Observable, optional
            Further observables.
        events : Event or iterable of Event, optional
            Further events.
        states : ExtraStates or iterable of ExtraStates, optional
            Further states.
        controllers : Controller or iterable of Controller, optional
            Further controllers.
        ground_motion : motion of a ground, or callable, optional
            Motion of the ground, in addition to the one that the model has.
        about : {"origin", "com"}, optional
            Point to which inertias refer, those in `numbers` and those that a body keeps if its
            mass or centre of mass changes. "origin": the inertia about the body frame's origin
            stays, so that one about the centre of mass changes by −Δm c², as with the derivatives
            by `body.mass`. "com": the inertia about the centre of mass stays, as for another mass
            of the same extent, or one that is moved.

        Returns
        -------
        Problem or Mechanism
            The changed model; the original stays as it is.

        Raises
        ------
        UnknownNameError
            The model has no number of that name.
        ArgumentError
            An array has a wrong shape, or batches differ in size.
        InertiaError
            No rigid body can have this mass or inertia.
        ForceError
            An element does not fit the model.

        Examples
        --------
        >>> import lierb
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
        >>> plain = lierb.Mechanism(wheel)
        >>> brake = lierb.forces.joint_friction(coulomb=0.1, speed=1e-3).on("wheel")
        >>> braked = plain.with_({"wheel.body.mass": [1.0, 1.5, 2.0]}, forces=brake)
        >>> braked.batch_size(), braked.with_({"wheel.joint_friction.coulomb": 0.2}).forces
        (3, (<joint_friction: viscous, coulomb, speed, on wheel>,))
        """
        require_name("about", about, POINTS)
        changed = self.renumbered(by_field(self, numbers), about) if numbers else self
        added = {
            "forces": forces, "constraints": constraints, "observables": observables,
            "events": events, "states": states, "controllers": controllers,
        }  # fmt: skip
        elements: dict[str, Any] = {
            label: (*getattr(changed, label), *self._fitted(label, added[label], kind))
            for label, kind in ELEMENTS.items()
        }
        if ground_motion is not None:
            elements["ground_motion"] = ground_motion
        structure = changed._structure(lambda body, *_: body, lambda joint, _: joint)
        return self._remade((*structure, changed.gravity), elements)

    def renumbered(self, numbers: Numbers, about: str = "origin") -> Self:
        """Return the model with other numbers in some fields of `inputs`, in the shapes there.

        about : point of inertias; see `with_`.
        """
        numbers = {field: np.asarray(x) for field, x in numbers.items()}  # kernels read addresses
        structure = self._structure(
            lambda body, field, link: body_with(body, numbers, field, link, about),
            lambda joint, field: joint_with(joint, numbers, field),
        )
        gravity = numbers.get("gravity", self.gravity)
        return self._remade((*structure, gravity), elements_with(self, numbers))

    def _remade(self, structure: tuple[Any, ...], elements: dict[str, Any]) -> Self:
        return type(self)(*structure, **elements)

    def _shown_elements(self) -> list[tuple[str, str]]:
        return [
            (label, "\n".join(map(shown_element, elements)))
            for label in ELEMENTS
            if (elements := getattr(self, label))
        ]

    # ---- batches ----

    @cached_property
    def _batched(self) -> dict[str, tuple[Array, int]]:
        """Arrays with a number for each member, by name, with the number of axes of one item."""
        entries = {"gravity": (self.gravity, 1)}
        for name, body in zip(self.link_names, self.bodies, strict=True):
            entries |= {qualified(name, k): (getattr(body, k), n) for k, n in BODY.items()}
        for at in self.joints:
            entries |= {qualified(at.name, k): (getattr(at.joint, k), n) for k, n in JOINT.items()}
        for number, element in enumerate(self.elements):
            for k, shape in element.kind.shapes.items():
                name = ".".join((*element.at, element.name, k))
                name += f"[{number}]" if name in entries else ""
                entries[name] = element.parameters[k], len(shape)
        return {name: (array, axes) for name, (array, axes) in entries.items() if array.ndim > axes}

    def batch_size(self, **more: Any) -> int | None:
        """Return the number of members of the batch; None if no argument is batched."""
        return batch_size(**self._batched, **more)

    def of_body(self, body: int) -> Self:
        """Return one member of the batch.

        Parameters
        ----------
        body : int
            Index of the member.

        Returns
        -------
        Problem or Mechanism
            The member, not batched.

        Raises
        ------
        ArgumentError
            The batch has no member with that index.
        """
        return self.part(member_of(body, self.batch_size()))

    def part(self, which: Which) -> Self:
        """Return one member of the batch, or a range of them."""
        elements = {label: [e.of_body(which) for e in getattr(self, label)] for label in ELEMENTS}
        structure = self._structure(lambda body, *_: body.of(which), lambda x, _: x.of(which))
        return self._remade((*structure, items_at(self.gravity, which, 1)), elements)

    # ---- runs ----

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints of links and loops; empty for a single body."""
        return tuple(at.name for at in self.joints if at.name)

    @cached_property
    def topology(self) -> tuple[Any, ...]:
        """Names, ends and rows of the joints; models with equal ones can exchange states."""
        return tuple((at.name, at.body, at.parent, at.rows) for at in self.joints)

    @cached_property
    def has_jumps(self) -> bool:
        """True if a force may jump at times that are among its parameters."""
        return any(element.kind.discontinuities for element in self.elements)

    @cached_property
    def has_own_time(self) -> bool:
        """True if each trajectory needs a clock, for events, states, controllers or jumps."""
        has_states = any(element.columns for element in self.elements)
        return bool(self.events or has_states or self.controllers) or self.has_jumps

    @property
    def described_elements(self) -> dict[str, tuple[Element, ...]]:
        """Elements by label, for `description`."""
        given = {label: getattr(self, label) for label in ELEMENTS}
        return {k: elements for k, elements in given.items() if elements or k in DESCRIBED}

    # ---- interface of runs and results, implemented by problems and mechanisms ----

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links."""
        raise NotImplementedError

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Body of each link."""
        raise NotImplementedError

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Joints of the links, in order, then of the loops."""
        raise NotImplementedError

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of the links, parents before their children."""
        raise NotImplementedError

    def parameters(self, at: Connection) -> Parameters:
        """Return the parameters of a joint's body and frames, one array per component."""
        raise NotImplementedError

    def constants(self, at: Connection) -> BodyConstants:
        """Return the constants of a joint's body, with the elements that act there."""
        raise NotImplementedError

    @property
    def fields(self) -> tuple[str, ...]:
        """Prefix of each link's fields in the inputs of the kernels."""
        raise NotImplementedError

    @property
    def joint_fields(self) -> tuple[str, ...]:
        """Prefix of each joint's fields in the inputs of the kernels."""
        raise NotImplementedError

    @cached_property
    def element_fields(self) -> tuple[str, ...]:
        """Prefix of each element's fields in the inputs of the kernels."""
        return tuple(f"{self.element_prefix}{i}." for i in range(len(self.elements)))

    @cached_property
    def quantities(self) -> dict[str, Array]:
        """Numbers of bodies and joints, and gravity, by field of the inputs."""
        bodies = zip(self.fields, self.bodies, strict=True)
        numbers = {f"{field}{k}": getattr(body, k) for field, body in bodies for k in BODY}
        numbers["gravity"] = self.gravity
        for field, at in zip(self.joint_fields, self.joints, strict=True):
            numbers |= {f"{field}{k}": getattr(at.joint, k) for k in JOINT}
        return numbers

    @cached_property
    def inputs(self) -> dict[str, Array]:
        """Input numbers of the kernels, by field."""
        elements = zip(self.element_fields, self.elements, strict=True)
        parameters = {f"{field}{k}": x for field, e in elements for k, x in e.parameters.items()}
        return self.quantities | parameters

    @property
    def rows_by_name(self) -> tuple[tuple[str, Rows], ...]:
        """Constraint rows of each joint and element, by name."""
        raise NotImplementedError

    @property
    def description(self) -> dict[str, Any]:
        """Contents of the metadata, in order."""
        raise NotImplementedError

    def by_link(self, argument: str, given: Any, is_whole: bool = True) -> dict[str, Any]:
        """Return an argument's value for each link, by name."""
        raise NotImplementedError

    def from_links(self, values: dict[str, Any]) -> Any:
        """Convert values of all links to the form of arguments; the inverse of `by_link`."""
        raise NotImplementedError

    def label(self, argument: str, link: str) -> str:
        """Return the name of an argument's value for one link, for messages."""
        return f"{argument}[{link!r}]" if link else argument

    def default_pose(self) -> Any:
        """Return the default of pose0; None stands for the closed joint."""
        raise NotImplementedError

    def formulation(
        self, *, cspace: Any, update: str, check: str, solver: str, stabilise: Any
    ) -> Formulation:
        """Validate the options that select the equations. Raises ArgumentError."""
        raise NotImplementedError

    def plan(self, formulation: Formulation, **described: Any) -> AnyPlan:
        """Return the plan of a run, on which compiled code is specialised."""
        raise NotImplementedError

    def violation(
        self, pose0: Any, twist0: Any, t0: float = 0.0, number: int | None = None
    ) -> LierbError | None:
        """Return the error of the first member whose start violates its joints, or None.

        pose0, twist0 : None for the defaults, the closed joint of a problem, and rest.
        number : index of the only member to check. Default: check all.
        """
        raise NotImplementedError

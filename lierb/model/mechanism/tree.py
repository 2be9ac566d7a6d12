"""Tree of a mechanism: links, loops and elements by name, their parameters, relative motions.

A joint acts between a frame B on its body and a frame G on what it hangs on, the ground or another
link: D = G⁻¹ C_parent⁻¹ C B, and its rows act on D⁻¹Ḋ = Ad(B⁻¹) V − Ad(D⁻¹G⁻¹) V_parent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, items_of, told, unknown_name
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Parameters
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, Vec, sub
from lierb.model.acting import ELEMENTS, bind, require, require_fit, shown_element
from lierb.model.functions.binding import Column, columns_of
from lierb.model.functions.elements import Constraint, Element, Force, Observable, reject_functions
from lierb.model.functions.in_time import Controller, Event, ExtraStates
from lierb.model.mechanism.links import GROUND, NOWHERE, Connection, Link, Loop
from lierb.support.arrays import (
    Array,
    Pose,
    Which,
    as_numbers,
    as_poses,
    batch_size,
    components,
    member_of,
    pose_components,
    taken,
)
from lierb.support.shown import Lines, Shown, counted, quantity

BODY = ("mass", "inertia", "com")
JOINT = ("ground_frame", "body_frame", "pitch", "length")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Tree(Shown):
    """Links, loops and elements of a mechanism, checked.

    Parameters and attributes are those of `lierb.Mechanism`.
    """

    links: tuple[Link, ...]
    loops: tuple[Loop, ...]
    gravity: Array
    forces: tuple[Force, ...]
    constraints: tuple[Constraint, ...]
    observables: tuple[Observable, ...]
    events: tuple[Event, ...]
    states: tuple[ExtraStates, ...]
    controllers: tuple[Controller, ...]

    def __init__(
        self,
        links: Link | Iterable[Link],
        loops: Loop | Iterable[Loop] = (),
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        forces: Force | Iterable[Force] = (),
        constraints: Constraint | Iterable[Constraint] = (),
        observables: Observable | Iterable[Observable] = (),
        events: Event | Iterable[Event] = (),
        states: ExtraStates | Iterable[ExtraStates] = (),
        controllers: Controller | Iterable[Controller] = (),
    ) -> None:
        object.__setattr__(self, "links", _all_of("links", links, Link, "lierb.Link"))
        object.__setattr__(self, "loops", _all_of("loops", loops, Loop, "lierb.Loop"))
        object.__setattr__(self, "gravity", as_numbers("gravity", gravity, (3,)))
        self._check_names()
        _ = self.order
        given = forces, constraints, observables, events, states, controllers
        for (label, kind), elements in zip(ELEMENTS.items(), given, strict=True):
            object.__setattr__(self, label, self._all_fitted(label, elements, kind))
        bind(self)
        self.batch_size()

    # ---- what it is made of ----------------------------------------------------------------------

    def _check_names(self) -> None:
        if not self.links:
            raise ArgumentError("links is empty; a mechanism has one link at least")
        owners: dict[str, str] = {}
        for each in self.held:
            what = "link" if isinstance(each, Link) else "loop"
            name = each.name.lower()  # SQL, in which their columns are named, is blind to case
            if name in owners:
                hint = ""
                if what == owners[name] == "link":
                    hint = "; a body with two parents is one Link, and a Loop for its other joint"
                raise ArgumentError(
                    f"two are named {each.name}, a {owners[name]} and a {what}; give every "
                    f"link and every loop its own name{hint}"
                )
            owners[name] = what
        known = (*self.names, GROUND)
        for link in self.links:
            if link.parent not in known:
                choice = [name for name in known if name not in self._hanging_on(link.name)]
                raise unknown_name(f"link {link.name}: parent", link.parent, choice)
        for loop in self.loops:
            for argument, name, other in (
                ("body", loop.body, loop.parent), ("parent", loop.parent, loop.body),
            ):  # fmt: skip
                if name not in known:
                    choice = [x for x in known if x != other]
                    raise unknown_name(f"loop {loop.name}: {argument}", name, choice)
            if loop.body == GROUND:
                raise ArgumentError(
                    f'loop {loop.name}: body="{GROUND}"; expected a link, and "{GROUND}" as parent'
                )

    def _hanging_on(self, name: str) -> set[str]:
        """The link itself, and all that hang on it, which cannot be what it hangs on."""
        found = {name}
        while more := {x.name for x in self.links if x.parent in found} - found:
            found |= more
        return found

    @property
    def held(self) -> tuple[Link | Loop, ...]:
        """All that have a joint: the links, and after them the loops."""
        return (*self.links, *self.loops)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the links, in the order given."""
        return tuple(link.name for link in self.links)

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Of the links, by name; and of the ground."""
        return {name: i for i, name in enumerate(self.names)} | {GROUND: NOWHERE}

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The number of what each link hangs on; NOWHERE is the ground."""
        return tuple(self.numbers[link.parent] for link in self.links)

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Numbers of the links, parents before their children; else in the order given."""
        found: list[int] = []
        placed = {NOWHERE}
        while len(found) < len(self.links):
            ready = [i for i, p in enumerate(self.parents) if i not in placed and p in placed]
            if not ready:
                raise self._cycle(next(i for i in range(len(self.links)) if i not in placed))
            found += ready
            placed |= {*ready}
        return tuple(found)

    def _cycle(self, start: int) -> ArgumentError:
        seen = [start]
        while self.parents[seen[-1]] not in seen:
            seen.append(self.parents[seen[-1]])
        ring = seen[seen.index(self.parents[seen[-1]]) :]
        names = " → ".join(self.names[i] for i in (*ring, ring[0]))
        return ArgumentError(
            f"links hang on each other in a cycle, {names}; hang one of them on the ground, or on "
            "a link outside of it, and make the joint that closes the cycle a lierb.Loop"
        )

    def link(self, name: str) -> Link:
        """Return the link of that name.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        Link
            The link.

        Raises
        ------
        UnknownNameError
            No link has that name.
        """
        if not (isinstance(name, str) and name in self.names):
            raise unknown_name("link", name, self.names)
        return self.links[self.numbers[name]]

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """Forces, constraints, observables, events, states and controllers, each with its place."""
        return tuple(e for label in ELEMENTS for e in getattr(self, label))

    @cached_property
    def signals(self) -> tuple[Column, ...]:
        """Its extra states, then what its controllers put out, as they stand side by side."""
        return columns_of(self.elements)

    @cached_property
    def kinds(self) -> tuple[kinds.Element, ...]:
        """Of the elements, as compiled code is specialised on them."""
        return tuple(element.kind for element in self.elements)

    @cached_property
    def quantities(self) -> dict[str, Array]:
        """Its numbers, by the fields of `lierb.kernels.systems.tree_inputs.inputs_of`."""
        found: dict[str, Array] = {"gravity": self.gravity}
        for i, link in enumerate(self.links):
            found |= {f"{i}.{name}": getattr(link.body, name) for name in BODY}
        for i, each in enumerate(self.held):
            found |= {f"{i}.{name}": getattr(each.joint, name) for name in JOINT}
        for k, element in enumerate(self.elements):
            found |= {f"element{k}.{name}": x for name, x in element.parameters.items()}
        return found

    def require_unchanged(self) -> None:
        """Raise ForceError where a force's function refers to something that is another by now."""
        for element in self.elements:
            if element.references:
                element.require_unchanged()

    @cached_property
    def joints(self) -> tuple[Connection, ...]:
        """The joints of the links, in their order, and after them those of the loops."""
        found = [(x.name, x.name, x.parent, x.joint) for x in self.links]
        found += [(x.name, x.body, x.parent, x.joint) for x in self.loops]
        return tuple(
            Connection(name, self.numbers[body], self.numbers[parent], joint, joint.rows)
            for name, body, parent, joint in found
        )

    @cached_property
    def places(self) -> tuple[Connection, ...]:
        """Of every element, where it acts, and the rows that it adds."""
        held = {c.name: c for c in self.joints}
        found = []
        for i, element in enumerate(self.elements):
            rows = tuple(element.kind.row(0, j) for j in range(element.kind.rows))
            if element.kind.needs_axis:
                at = held[element.at[0]]
                found.append(at._replace(name=element.name, rows=rows, elements=(i,)))
            else:
                body, parent = (*element.at, GROUND)[:2]
                ends = self.numbers[body], self.numbers[parent]
                found.append(Connection(element.name, *ends, None, rows, (i,)))
        return tuple(found)

    def name_of(self, element: int) -> str:
        """Of an element's own columns: link.element, with a number where there are several."""
        names = [f"{each.at[0]}.{each.name}" for each in self.elements]
        name = names[element]
        before = names[:element].count(name)
        return f"{name}_{before + 1}" if names.count(name) > 1 else name

    @cached_property
    def connections(self) -> tuple[Connection, ...]:
        """All that have rows: joints, loops, constraints and motors."""
        return tuple(c for c in (*self.joints, *self.places) if c.rows)

    def _all_fitted(self, label: str, given: Any, kind: type[Element]) -> tuple[Any, ...]:
        elements = _all_of(label, given, kind, f"{kind.words[1]} made by lierb")
        return tuple(self._fitted(f"{label}[{i}]", e) for i, e in enumerate(elements))

    def _fitted(self, label: str, element: Element) -> Any:
        """The element with its place. Raises where it has none, or does not act there."""
        if not element.at:
            if len(self.links) > 1:
                raise ArgumentError(
                    f"{label}, {element.name}, is on no link; place it by "
                    f".on({self.names[0]!r}), or on another one of {', '.join(self.names)}"
                )
            element = replace(element, at=self.names)
        if element.kind.needs_axis:
            self._require_joint(label, element)
            return element
        for name in element.at:
            others = [x for x in (*self.names, GROUND) if x != element.at[0]]
            known = self.names if name == element.at[0] else others
            if name not in known:
                raise unknown_name(f"{label}, {element.name}: on", name, known)
        element.require_unchanged()
        return element

    def _require_joint(self, label: str, element: Element) -> None:
        owners = {x.name: x.joint for x in self.held}
        if len(element.at) > 1:
            raise ArgumentError(
                f"{label}, {element.name}, is on {' and '.join(element.at)}, but acts about the "
                f"axis of one joint; place it by .on({element.at[0]!r}) on the joint of that link"
            )
        (name,) = element.at
        if name not in owners:
            raise unknown_name(f"{label}, {element.name}: on", name, owners)
        require_fit(element, owners[name])

    # ---- batches ---------------------------------------------------------------------------------

    @cached_property
    def _batched(self) -> dict[str, tuple[Array, int]]:
        """The batched arguments, with the number of an item's axes."""
        entries: dict[str, tuple[Array, int]] = {"gravity": (self.gravity, 1)}
        for link in self.links:
            for name, axes in (("mass", 0), ("inertia", 2), ("com", 1)):
                entries[f"{link.name}.{name}"] = getattr(link.body, name), axes
        for each in self.held:
            for name, axes in (("ground_frame", 2), ("body_frame", 2), ("pitch", 0), ("length", 0)):
                entries[f"{each.name}.{name}"] = getattr(each.joint, name), axes
        for number, element in enumerate(self.elements):
            for name, entry in element.batched().items():
                entries[f"{'.'.join(element.at)}.{name}[{number}]"] = entry
        return {name: (array, axes) for name, (array, axes) in entries.items() if array.ndim > axes}

    def batch_size(self, **more: Any) -> int | None:
        """Number of members that the batched arguments ask for; None where none is batched."""
        return batch_size(**self._batched, **more)

    def of_body(self, body: int) -> Self:
        """Return one member of the batch.

        Parameters
        ----------
        body : int
            Number of the member.

        Returns
        -------
        Mechanism
            The member, not batched.

        Raises
        ------
        ArgumentError
            The batch has no member of that number.
        """
        return self.part(member_of(body, self.batch_size()))

    def part(self, which: Which) -> Self:
        """One member of the batch, or some that follow each other."""
        return type(self)(
            [Link(x.name, x.body.of(which), x.joint.of(which), x.parent) for x in self.links],
            [Loop(x.name, x.joint.of(which), x.body, x.parent) for x in self.loops],
            taken(self.gravity, which, 1),
            **{label: [e.of_body(which) for e in getattr(self, label)] for label in ELEMENTS},
        )

    def with_events(self, events: Event | Iterable[Event]) -> Self:
        """The same mechanism with more events, after its own."""
        elements = {label: getattr(self, label) for label in ELEMENTS}
        elements["events"] = (*self.events, *self._all_fitted("events", events, Event))
        return type(self)(self.links, self.loops, self.gravity, **elements)

    def _shown(self) -> tuple[str, Lines]:
        rows = [("links", "\n".join(_shown_joint(x, x.body._shown()[1]) for x in self.links))]
        if self.loops:
            rows.append(("loops", "\n".join(_shown_joint(x, ()) for x in self.loops)))
        rows.append(("gravity", quantity(self.gravity, "m/s²", 1)))
        rows += [
            (label, "\n".join(f"{shown_element(e)}, on {' and '.join(e.at)}" for e in elements))
            for label in ELEMENTS
            if (elements := getattr(self, label))
        ]
        parts = [counted(len(self.links), "link")]
        if self.loops:
            parts.append(counted(len(self.loops), "loop"))
        size = self.batch_size() or 1
        tail = f", {size} of it" if size > 1 else ""
        return f"lierb.Mechanism: {' and '.join(parts)}{tail}", rows

    # ---- numbers of its parts --------------------------------------------------------------------

    def parameters(self, at: Connection) -> Parameters:
        """The body of a connection and its two frames, as formulas take them.

        As if the parent were the ground: gravity is that of the ground's axes all the same.
        """
        body, joint = self.links[at.body].body, at.joint
        own: Pose = (IDENTITY, ZERO3)
        return Parameters(
            mass=body.mass,
            inertia=components(body.inertia, 2),
            com=components(body.com),
            gravity=components(self.gravity),
            ground=own if joint is None else pose_components(joint.ground_frame),
            body=own if joint is None else pose_components(joint.body_frame),
            pitch=np.float64(0.0) if joint is None else joint.pitch,
            length=np.float64(0.0) if joint is None else joint.length,
        )

    def constants(self, at: Connection) -> BodyConstants:
        """The body of a connection in its joint's axes, with the elements that act there."""
        elements = [self.elements[i] for i in at.elements]
        numbers = [
            x
            for element in elements
            for name, shape in element.kind.shapes.items()
            for x in components(element.parameters[name], len(shape))
        ]
        given = tuple(element.kind for element in elements)
        return kinds.body_with(SE3, self.parameters(at), given, numbers)

    def relative(self, at: Connection, poses: list[Pose]) -> Pose:
        """D = G⁻¹ C_parent⁻¹ C B of a connection."""
        p = self.parameters(at)
        ground = p.ground if at.parent == NOWHERE else se3.compose(poses[at.parent], p.ground)
        return se3.compose(se3.compose(se3.inverse(ground), poses[at.body]), p.body)

    def carried(self, at: Connection, poses: list[Pose], twists: Mapping[int, Vec]) -> Vec:
        """Ad(D⁻¹G⁻¹) V_parent: how the body's joint frame would move if the joint were rigid."""
        seen = se3.compose(self.parameters(at).ground, self.relative(at, poses))
        return se3.Ad(se3.inverse(seen), twists[at.parent])

    def relative_twist(self, at: Connection, poses: list[Pose], twists: Any) -> Vec:
        """D⁻¹Ḋ = Ad(B⁻¹) V − Ad(D⁻¹G⁻¹) V_parent."""
        own = se3.Ad(se3.inverse(self.parameters(at).body), twists[at.body])
        return own if at.parent == NOWHERE else sub(own, self.carried(at, poses, twists))

    # ---- poses and twists of all links -----------------------------------------------------------

    def poses(self, argument: str, given: Any) -> list[Pose]:
        """The poses of all links, checked, one array per component."""
        found = self.by_link(argument, given)
        poses = {n: as_poses(f"{argument}[{n!r}]", found[n]) for n in self.names}
        self.batch_size(**{f"{argument}[{n!r}]": (array, 2) for n, array in poses.items()})
        return [pose_components(poses[name]) for name in self.names]

    def twists(self, argument: str, given: Any) -> list[Vec]:
        """The twists of all links, checked, one array per component."""
        found = self.by_link(argument, given)
        twists = {n: as_numbers(f"{argument}[{n!r}]", found[n], (6,)) for n in self.names}
        self.batch_size(**{f"{argument}[{n!r}]": (array, 1) for n, array in twists.items()})
        return [components(twists[name]) for name in self.names]

    def by_link(self, argument: str, given: Any, is_whole: bool = True) -> dict[str, Any]:
        """A dictionary with the names of links, of all of them where it must be whole."""
        if given is None and not is_whole:
            return {}
        if not isinstance(given, Mapping):
            raise ArgumentError(
                f"{argument}={told(given)}; expected a dictionary of what each link has, as "
                f"{{{self.names[0]!r}: …}}"
            )
        for name in given:
            if name not in self.names:
                raise unknown_name(argument, name, self.names)
        lacking = [name for name in self.names if name not in given]
        if is_whole and lacking:
            raise ArgumentError(
                f"{argument} lacks {', '.join(lacking)}; expected an entry for every link"
            )
        return dict(given)


def _all_of(argument: str, given: Any, kind: type, expected: str) -> Any:
    items = items_of(argument, given, f"{expected}s") if isinstance(given, Iterable) else (given,)
    for number, item in enumerate(items):
        reject_functions(f"{argument}[{number}]", item)
        require(f"{argument}[{number}]", item, kind, f"{expected}(…)")
    return items


def _shown_joint(each: Link | Loop, lines: Lines) -> str:
    ends = f" of {each.body}" if isinstance(each, Loop) else ""
    parts = (f"{each.name}: {each.joint.name} joint{ends} to {each.parent}", *map(" ".join, lines))
    return ", ".join(parts)

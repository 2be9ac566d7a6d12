"""Tree of a mechanism: checked links, loops and elements, and connections between links."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, brief, unknown_name
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.mechanics.rows import Rows
from lierb.model.acting import all_of, fitted
from lierb.model.base import Model, OfBody, OfJoint
from lierb.model.bodies.body import Body
from lierb.model.connections import NOWHERE, Connection
from lierb.model.functions.constraints import Constraint
from lierb.model.functions.controllers import Controller
from lierb.model.functions.elements import Element
from lierb.model.functions.events import Event
from lierb.model.functions.ground_motion import MovingGround, for_all_links
from lierb.model.functions.observables import Observable
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import JOINT
from lierb.model.mechanism.links import GROUND, Link, Loop, Site
from lierb.model.numbers import BODY, labelled
from lierb.support.arrays import GRAVITY, as_numbers
from lierb.support.representations import Lines, counted_links, quantity


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Tree(Model):
    """Checked links, loops and elements of a mechanism.

    Parameters and attributes are those of `lierb.Mechanism`.
    """

    links: tuple[Link, ...]
    loops: tuple[Loop, ...]
    sites: dict[str, Site]

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
        sites: Mapping[str, Site] | None = None,
        ground_motion: MovingGround | UserFunction | None = None,
    ) -> None:
        self._set(
            links=all_of("links", links, Link, "lierb.Link(…)", "lierb.Links"),
            loops=all_of("loops", loops, Loop, "lierb.Loop(…)", "lierb.Loops"),
            gravity=as_numbers("gravity", gravity, (3,), hint=GRAVITY),
            sites=_sites_of(sites or {}),
        )
        self._check_names()
        _ = self.order  # raises for a cycle
        elements = forces, constraints, observables, events, states, controllers
        self._set_elements(*elements, ground_motion=ground_motion)
        self.batch_size()

    # ---- links and loops -------------------------------------------------------------------------

    def _check_names(self) -> None:
        if not self.links:
            raise ArgumentError("links is empty; a mechanism has one link at least")
        owners: dict[str, str] = {}
        for each in self.links_and_loops:
            what = "link" if isinstance(each, Link) else "loop"
            name = each.name.lower()  # SQL ignores case in names of columns
            if name in owners:
                hint = ""
                if what == owners[name] == "link":
                    hint = "; a body with two parents is one Link, and a Loop for its other joint"
                raise ArgumentError(
                    f"two parts are named {each.name}, a {owners[name]} and a {what}; give every "
                    f"link and every loop its own name{hint}"
                )
            owners[name] = what
        known = (*self.names, GROUND)
        for link in self.links:
            if link.parent not in known:
                below = self._subtree(link.name)
                choice = [name for name in known if name not in below]
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

        for name, site in self.sites.items():
            if site.link not in known:
                raise unknown_name(f"site {name}: link", site.link, known)

    def _remade(self, structure: tuple[Any, ...], elements: dict[str, Any]) -> Self:
        return type(self)(*structure, **elements | {"sites": self.sites})

    def _subtree(self, name: str) -> set[str]:
        """Names of a link and its descendants."""
        names = {name}
        while more := {x.name for x in self.links if x.parent in names} - names:
            names |= more
        return names

    @property
    def links_and_loops(self) -> tuple[Link | Loop, ...]:
        """Links, then loops: the objects with a joint."""
        return (*self.links, *self.loops)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the links, in the order of the argument."""
        return tuple(link.name for link in self.links)

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Indices of the links and the ground, by name."""
        return {name: i for i, name in enumerate(self.names)} | {GROUND: NOWHERE}

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """Index of each link's parent; NOWHERE is the ground."""
        return tuple(self.numbers[link.parent] for link in self.links)

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Indices of the links, parents before children, otherwise in the order of `links`."""
        order: dict[int, None] = {NOWHERE: None}
        while len(order) <= len(self.links):
            ready = [i for i, p in enumerate(self.parents) if i not in order and p in order]
            if not ready:
                raise self._cycle(next(i for i in range(len(self.links)) if i not in order))
            order |= dict.fromkeys(ready)
        return tuple(order)[1:]

    def _cycle(self, start: int) -> ArgumentError:
        path = [start]
        while self.parents[path[-1]] not in path:
            path.append(self.parents[path[-1]])
        ring = path[path.index(self.parents[path[-1]]) :]
        names = " → ".join(self.names[i] for i in (*ring, ring[0]))
        return ArgumentError(
            f"links hang on each other in a cycle, {names}; hang one of them on the ground, or on "
            "a link outside of it, and make the joint that closes the cycle a lierb.Loop"
        )

    def link(self, name: str) -> Link:
        """Return the link with that name.

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

    # ---- connections and elements ----------------------------------------------------------------

    @cached_property
    def joints(self) -> tuple[Connection, ...]:
        """Joints of the links, in order, then of the loops."""
        ends = [x.name if isinstance(x, Link) else x.body for x in self.links_and_loops]
        return tuple(
            Connection(x.name, self.numbers[body], self.numbers[x.parent], x.joint, x.joint.rows)
            for x, body in zip(self.links_and_loops, ends, strict=True)
        )

    @cached_property
    def places(self) -> tuple[Connection, ...]:
        """Connection at which each element acts, with the rows that the element adds."""
        joints = {c.name: c for c in self.joints}
        numbers = {c.name: i for i, c in enumerate(self.joints)}
        places = []
        for i, element in enumerate(self.elements):
            rows = tuple(element.kind.row(0, j) for j in range(element.kind.rows))
            if element.kind.needs_axis:
                at, second = joints[element.at[0]], NOWHERE
                if element.kind.joints == 2:
                    second = numbers[element.at[1]]
                added = at._replace(name=element.name, rows=rows, elements=(i,), second=second)
                places.append(added)
            else:
                body, parent = (*element.at, GROUND)[:2]
                ends = self.numbers[body], self.numbers[parent]
                places.append(Connection(element.name, *ends, None, rows, (i,)))
        return tuple(places)

    @cached_property
    def connections(self) -> tuple[Connection, ...]:
        """Connections with constraint rows: joints, loops, constraints and motors."""
        return tuple(c for c in (*self.joints, *self.places) if c.rows)

    def _placed(self, label: str, element: Element) -> Any:
        """Return the element on its links; raise if it has none or cannot act there."""
        if not element.at:
            if len(self.links) > 1 and isinstance(element, MovingGround):
                raise ArgumentError(
                    f"{label}, {element.name}, is on no link; {for_all_links(element)}"
                )
            if len(self.links) > 1:
                raise ArgumentError(
                    f"{label}, {element.name}, is on no link; place it by "
                    f".on({self.names[0]!r}), or on another one of {', '.join(self.names)}"
                )
            element = replace(element, at=self.names)
        if element.kind.needs_axis:
            return self._on_joint(label, element)
        is_absolute = element.kind.adds_inertia or isinstance(element, MovingGround)
        if len(element.at) > 1 and (element.kind.feels or is_absolute):
            raise ForceError(
                f"{label}, {element.name}, depends on accelerations, which are relative to the "
                f"ground, but is on two links; place it by .on({element.at[0]!r})"
            )
        others = [x for x in (*self.names, GROUND) if x != element.at[0]]
        for name, known in zip(element.at, (self.names, others), strict=False):
            if name not in known:
                raise unknown_name(f"{label}, {element.name}: on", name, known)
        element.require_unchanged()
        return element

    def _on_joint(self, label: str, element: Element) -> Any:
        owners = {x.name: x.joint for x in self.links_and_loops}
        if len(element.at) > element.kind.joints:
            raise ArgumentError(
                f"{label}, {element.name}, is on {' and '.join(element.at)}, but acts about the "
                f"axis of one joint; place it by .on({element.at[0]!r}) on the joint of that link"
            )
        for name in element.at:
            if name not in owners:
                raise unknown_name(f"{label}, {element.name}: on", name, owners)
        if len(element.at) < element.kind.joints:
            others = [name for name in owners if name not in element.at] or ["another"]
            raise ArgumentError(
                f"{label}, {element.name}, is on {element.at[0]} alone, but couples two joints; "
                f"place it by .on({element.at[0]!r}, {others[0]!r}) or the like"
            )
        return fitted(element, *(owners[name] for name in element.at))

    # ---- interface of a model --------------------------------------------------------------------

    default_cspace = "reduced"
    flags_starts = False
    element_prefix = "element"

    @property
    def link_names(self) -> tuple[str, ...]:
        return self.names

    @cached_property
    def fields(self) -> tuple[str, ...]:
        return tuple(f"{i}." for i in range(len(self.links)))

    @cached_property
    def joint_fields(self) -> tuple[str, ...]:
        return tuple(f"{i}." for i in range(len(self.links_and_loops)))

    @property
    def bodies(self) -> tuple[Body, ...]:
        return tuple(link.body for link in self.links)

    @cached_property
    def rows_by_name(self) -> tuple[tuple[str, Rows], ...]:
        places = zip(labelled(self), self.places, strict=True)
        added = ((label, place.rows) for (_, label, _), place in places)
        return (*((each.name, each.joint.rows) for each in self.links_and_loops), *added)

    @property
    def description(self) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        for each in self.links_and_loops:
            is_loop = isinstance(each, Loop)
            numbers = {} if is_loop else {name: getattr(each.body, name) for name in BODY}
            entries[each.name] = {
                "kind": "loop" if is_loop else "link",
                "parent": each.parent,
                **({"body": each.body} if is_loop else {}),
                "joint": each.joint.name,
                "rows": [str(row) for row in each.joint.rows],
                **numbers,
                **{name: getattr(each.joint, name) for name in JOINT},
            }
        rows = [f"{each.name}.{row}" for each in self.connections for row in each.rows]
        return {
            "mechanism": entries, "gravity": self.gravity, **self.described_elements, "rows": rows,
        }  # fmt: skip

    def from_links(self, values: dict[str, Any]) -> dict[str, Any]:
        return dict(values)

    # ---- arguments -------------------------------------------------------------------------------

    def _structure(self, body: OfBody, joint: OfJoint) -> tuple[Any, Any]:
        fields = zip(self.joint_fields, self.links_and_loops, strict=True)
        joints = [joint(each.joint, field) for field, each in fields]
        links = [
            replace(x, body=body(x.body, field, x.name), joint=of_link)
            for field, x, of_link in zip(self.fields, self.links, joints, strict=False)
        ]
        of_loops = zip(self.loops, joints[len(links) :], strict=True)
        return links, [replace(x, joint=of_loop) for x, of_loop in of_loops]

    def _representation(self) -> tuple[str, Lines]:
        rows = [
            ("links", "\n".join(_joint_text(x, x.body._representation()[1]) for x in self.links))
        ]
        if self.loops:
            rows.append(("loops", "\n".join(_joint_text(x, ()) for x in self.loops)))
        rows.append(("gravity", quantity(self.gravity, "m/s²", 1)))
        rows += self._shown_elements()
        size = self.batch_size() or 1
        tail = f", {size} of it" if size > 1 else ""
        return f"lierb.Mechanism: {counted_links(len(self.links), len(self.loops))}{tail}", rows


def _sites_of(sites: Mapping[str, Any]) -> dict[str, Site]:
    for name, site in sites.items():
        if not (isinstance(site, tuple) and len(site) == 2):
            raise ArgumentError(f"site {name}: {brief(site)}; expected the link's name and a pose")
    return {
        name: Site(link, as_numbers(f"site {name}: pose", pose, (4, 4)))
        for name, (link, pose) in sites.items()
    }


def _joint_text(each: Link | Loop, lines: Lines) -> str:
    ends = f" of {each.body}" if isinstance(each, Loop) else ""
    parts = (f"{each.name}: {each.joint.name} joint{ends} to {each.parent}", *map(" ".join, lines))
    return ", ".join(parts)

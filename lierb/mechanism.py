"""Mechanisms: several bodies, held by joints in a tree and by loops that close it.

A joint acts between a frame B on its body and a frame G on what it hangs on, the ground or another
link: D = G⁻¹ C_parent⁻¹ C B, and its rows act on D⁻¹Ḋ = Ad(B⁻¹) V − Ad(D⁻¹G⁻¹) V_parent.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb import mechanism_closing, model_files
from lierb.arrays import (
    Array,
    Pose,
    as_number,
    as_numbers,
    as_poses,
    assembled,
    batch_size,
    components,
    finite,
    member_of,
    pose_components,
    pose_matrix,
    taken,
)
from lierb.errors import ArgumentError, LeftOutWarning, items_of, told, unknown_name
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Parameters
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, ZERO6, Vec, add, sub
from lierb.link_coordinates import is_pose, is_rigid, motions_of, numbers_of, relative_of
from lierb.links import GROUND, NOWHERE, Connection, Link, Loop
from lierb.mechanism_closing import Mobility
from lierb.model import ELEMENTS, bind, require, require_fit, shown_element
from lierb.shown import Lines, Shown, counted, quantity
from lierb.user_binding import Column, columns_of
from lierb.user_elements import Constraint, Element, Force, Observable, reject_functions
from lierb.user_signals import Controller, Event, ExtraStates

BODY = ("mass", "inertia", "com")
JOINT = ("ground_frame", "body_frame", "pitch", "length")
_quiet = np.errstate(all="ignore")  # what overflows is found in the result


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Mechanism(Shown):
    """Bodies, joints between them, and the forces on them.

    Every argument of every link may be batched. Poses and twists are dictionaries, of a (4, 4) or
    (n, 4, 4) and a (6,) or (n, 6) for each link, C in the ground frame and V body-fixed. Forces and
    other elements act where their method `on` says, `.on(link)` or `.on(link, other)`; with one
    link it may be left out.

    Parameters
    ----------
    links : Link or iterable of Link
        Links in any order; a link's parent may come after it.
    loops : Loop or iterable of Loop, optional
        Joints beside those of the links.
    gravity : array_like, shape (3,) or (n, 3), optional
        Acceleration of gravity in the ground frame, m/s². Default: none.
    forces : Force or iterable of Force, optional
        Forces made by `lierb.forces` and `lierb.wrench`.
    constraints : Constraint or iterable of Constraint, optional
        Constraints made by `lierb.constraint`.
    observables : Observable or iterable of Observable, optional
        Columns of the results, made by `lierb.observable`.
    events : Event or iterable of Event, optional
        Crossings of zero to be located, made by `lierb.event`.
    states : ExtraStates or iterable of ExtraStates, optional
        Further states, made by `lierb.states` and integrated with the mechanism's.
    controllers : Controller or iterable of Controller, optional
        Sampled controllers, made by `lierb.controller`.

    Raises
    ------
    ArgumentError
        The links make no tree, or a name is no link's.
    ForceError
        A force acts about a joint axis that does not exist, or a function uses states or controls
        that the mechanism does not have.

    Examples
    --------
    >>> import lierb
    >>> pin = dict(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.25))
    >>> body = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    >>> pendulum = lierb.Mechanism(
    ...     links=[
    ...         lierb.Link("upper", body, lierb.joints.revolute(**pin)),
    ...         lierb.Link(
    ...             "lower", body,
    ...             lierb.joints.revolute(**pin, parent_point=(0.0, 0.0, -0.25)), parent="upper",
    ...         ),
    ...     ],
    ...     gravity=(0.0, 0.0, -9.81),
    ... )
    >>> pose0 = pendulum.pose({"upper": np.pi / 2})
    >>> pose0["lower"][:3, 3].round(9).tolist()
    [-0.75, 0.0, 0.0]
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

    # ---- from files ----------------------------------------------------------------------------

    @classmethod
    def from_mjcf(
        cls, path: Any, *, merge_fixed: bool = False, limit_stiffness: float | None = None
    ) -> Mechanism:
        """Read the mechanism of an MJCF file, MuJoCo's format.

        Bodies keep their names and frames. Hinge, slide, ball and free joints become joints of the
        catalogue; several on one body become the joint that combines them, such as universal.
        `equality/connect` and `weld` become loops, springs and dampers of joints that keep their
        axis become forces, and `pose()` is the pose at qpos0. A LeftOutWarning lists what is left
        out: contacts, friction, actuators, tendons and other elements of MuJoCo's. Needs mujoco
        (the extra `lierb[mjcf]`).

        Parameters
        ----------
        path : path
            The file; files that it includes and refers to are found from there.
        merge_fixed : bool, optional
            Make bodies that are welded to each other one link, rather than a link each on a fixed
            joint. A welded body without mass, or with an inertia that no rigid body has, is merged
            with its parent in any case, and one that is welded to the world is the ground.
        limit_stiffness : float, optional
            Stiffness of stops at the limits of hinges, N m/rad, and slides, N/m; None leaves limits
            out. MuJoCo's own stiffness depends on the mass that a stop holds.

        Returns
        -------
        Mechanism
            The mechanism.

        Raises
        ------
        ArgumentError
            MuJoCo refuses the file or is not installed, the joints of a body combine to none of the
            catalogue, or a link that moves has no mass or an inertia that no rigid body has.
        """
        return cls._of_file(path, "MJCF", None, merge_fixed, limit_stiffness)

    @classmethod
    def from_urdf(
        cls,
        path: Any,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        merge_fixed: bool = False,
        limit_stiffness: float | None = None,
    ) -> Mechanism:
        """Read the mechanism of a URDF file; its root link is the ground.

        Revolute and continuous, prismatic, fixed, planar and floating joints are read by MuJoCo's
        compiler, as in `from_mjcf`.

        The file has revolute, continuous, prismatic, fixed, planar and floating joints.

        Parameters
        ----------
        path : path
            The file. Meshes are not read: all mass is in <inertial>.
        gravity : array_like, shape (3,) or (n, 3), optional
            Acceleration of gravity, m/s², which URDF does not have.
        merge_fixed : bool, optional
            Make welded bodies one link, as in `from_mjcf`.
        limit_stiffness : float, optional
            Stiffness of stops at the limits of joints, N m/rad or N/m; None leaves limits out.

        Returns
        -------
        Mechanism
            The mechanism.

        Raises
        ------
        ArgumentError
            MuJoCo refuses the file or is not installed.
        """
        return cls._of_file(path, "URDF", gravity, merge_fixed, limit_stiffness)

    @classmethod
    def _of_file(cls, path: Any, language: str, gravity: Any, *options: Any) -> Mechanism:
        parts = model_files.read(path, language, *options)
        if parts.left_out:
            warnings.warn(LeftOutWarning(path, parts.left_out), stacklevel=3)
        return cls(
            [Link(*link) for link in parts.links],
            [Loop(*loop) for loop in parts.loops],
            parts.gravity if gravity is None else gravity,
            parts.forces,
        )

    # ---- what it is made of --------------------------------------------------------------------

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
        """Its numbers, by the fields of `lierb.kernels.stepping.mechanism_inputs.inputs_of`."""
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

    # ---- batches -------------------------------------------------------------------------------

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

    def of_body(self, body: int) -> Mechanism:
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

    def part(self, which: int | slice) -> Mechanism:
        """One member of the batch, or some that follow each other."""
        return Mechanism(
            [Link(x.name, x.body.of(which), x.joint.of(which), x.parent) for x in self.links],
            [Loop(x.name, x.joint.of(which), x.body, x.parent) for x in self.loops],
            taken(self.gravity, which, 1),
            **{label: [e.of_body(which) for e in getattr(self, label)] for label in ELEMENTS},
        )

    def with_events(self, events: Event | Iterable[Event]) -> Mechanism:
        """The same mechanism with more events, after its own."""
        elements = {label: getattr(self, label) for label in ELEMENTS}
        elements["events"] = (*self.events, *self._all_fitted("events", events, Event))
        return Mechanism(self.links, self.loops, self.gravity, **elements)

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

    # ---- numbers of its parts ------------------------------------------------------------------

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

    # ---- coordinates along the tree ------------------------------------------------------------

    @_quiet
    def pose(self, coordinates: Mapping[str, Any] | None = None) -> dict[str, Array]:
        """Compute the poses of all links from the coordinates of their joints; loops may stay open.

        `close` then closes the loops.

        Parameters
        ----------
        coordinates : dict, optional
            Coordinates of each link's joint, as `lierb.joints.Joint.pose` takes them: (k,) or (n,
            k), a number or (n,) where there is one, or a rotation. Coordinates left out are 0. Any
            link may be given its pose in the ground frame instead, (4, 4) or (n, 4, 4). A link
            whose joint has no coordinates, such as point_on_line, and that is left out has
            coinciding joint frames.

        Returns
        -------
        dict of ndarray, shape (4, 4) or (n, 4, 4)
            Pose of each link.

        Examples
        --------
        >>> import lierb
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
        >>> lierb.Mechanism([wheel]).pose({"wheel": [0.0, 0.1, 0.2]})["wheel"].shape
        (3, 4, 4)
        """
        given = self.by_link("coordinates", coordinates, is_whole=False)
        found: dict[int, Pose] = {}
        sizes = {}
        for i in self.order:
            link, joint = self.links[i], self.links[i].joint
            argument = f"coordinates[{link.name!r}]"
            place = given.get(link.name)
            if place is not None and is_pose(argument, place, joint):
                whole = as_poses(argument, place)
                sizes[argument] = whole, 2
                self.batch_size(**sizes)
                found[i] = pose_components(whole)
                continue
            relative, size = relative_of(argument, place, joint)
            sizes |= size
            self.batch_size(**sizes)
            ground, body = pose_components(joint.ground_frame), pose_components(joint.body_frame)
            local = se3.compose(se3.compose(ground, relative), se3.inverse(body))
            parent = self.parents[i]
            found[i] = local if parent == NOWHERE else se3.compose(found[parent], local)
        self.batch_size(**sizes)
        return self._poses_of(found)

    def _poses_of(self, found: dict[int, Pose]) -> dict[str, Array]:
        return _alike({n: pose_matrix(found[i]) for i, n in enumerate(self.names)}, "pose", 2)

    @_quiet
    def coordinates(self, pose: Mapping[str, Any]) -> dict[str, Array]:
        """Compute the coordinates of the joints, as `lierb.joints.Joint.coordinates` does.

        Parameters
        ----------
        pose : dict
            Poses of all links; that they close the joints is not checked.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Coordinates of each link's joint. A joint without coordinates has the link's pose in the
            ground frame instead, as `pose` takes it; the link of a fixed joint is left out.
        """
        poses = self.poses("pose", pose)
        found = {}
        for i, link in enumerate(self.links):
            if motions := motions_of(link.joint):
                numbers = motions.coordinates(self.relative(self.joints[i], poses))
                found[link.name] = finite(f"a coordinate of {link.name}", assembled(numbers))
            elif not is_rigid(link.joint):
                found[link.name] = pose_matrix(poses[i])
        return found

    @_quiet
    def twist(
        self, velocities: Mapping[str, Any] | None = None, pose: Mapping[str, Any] | None = None
    ) -> dict[str, Array]:
        """Compute the twists of all links from the rates of their joints' coordinates.

        `project` then satisfies the loops.

        Parameters
        ----------
        velocities : dict, optional
            Rates of each link's joint, rad/s and m/s, (k,) or (n, k), or a number or (n,) where
            there is one. Rates left out are 0. A link whose joint has no coordinates may be given
            its body-fixed twist, (6,) or (n, 6); left out, it moves with its parent.
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.

        Returns
        -------
        dict of ndarray, shape (6,) or (n, 6)
            Body-fixed twist (ω, v) of each link, rad/s and m/s.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(body_point=(0.5, 0.0, 0.0))
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), hinge)
        >>> lierb.Mechanism([wheel]).twist({"wheel": 2.0})["wheel"].tolist()
        [0.0, 0.0, 2.0, 0.0, -1.0, 0.0]
        """
        poses = self.poses("pose", self.pose() if pose is None else pose)
        given = self.by_link("velocities", velocities, is_whole=False)
        found: dict[int, Vec] = {}
        sizes: dict[str, Any] = {f"pose[{n!r}]": poses[i][1][0] for i, n in enumerate(self.names)}
        for i in self.order:
            link, at = self.links[i], self.joints[i]
            argument, motions = f"velocities[{link.name!r}]", motions_of(self.links[i].joint)
            relative: Vec = ZERO6
            if motions:
                rates = numbers_of(argument, given.get(link.name, 0.0), motions.names)
                sizes[argument] = rates, 1
                self.batch_size(**sizes)  # before they meet
                relative = motions.twist(components(rates), self.relative(at, poses))
            elif link.name in given:
                whole = as_numbers(argument, given[link.name], (6,))
                sizes[argument] = whole, 1
                self.batch_size(**sizes)
                found[i] = components(whole)
                continue
            frame = pose_components(link.joint.body_frame)
            if at.parent != NOWHERE:
                relative = add(relative, self.carried(at, poses, found))
            found[i] = se3.Ad(frame, relative)
        self.batch_size(**sizes)
        return _alike({n: assembled(found[i]) for i, n in enumerate(self.names)}, "twist", 1)

    @_quiet
    def velocities(
        self, twist: Mapping[str, Any], pose: Mapping[str, Any] | None = None
    ) -> dict[str, Array]:
        """Compute the rates of the joints' coordinates, in the order of `coordinate_names`.

        Parameters
        ----------
        twist : dict
            Body-fixed twists of all links; that they satisfy the joints is not checked.
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.

        Returns
        -------
        dict of ndarray, shape (k,) or (n, k)
            Rates of each link's joint, rad/s and m/s. A joint without coordinates has the link's
            twist instead, as `twist` takes it; the link of a fixed joint is left out.
        """
        poses = self.poses("pose", self.pose() if pose is None else pose)
        twists = self.twists("twist", twist)
        sizes: dict[str, Any] = {f"pose[{n!r}]": poses[i][1][0] for i, n in enumerate(self.names)}
        self.batch_size(
            **sizes, **{f"twist[{n!r}]": v[0] for n, v in zip(self.names, twists, strict=True)}
        )
        found = {}
        for i, link in enumerate(self.links):
            at = self.joints[i]
            if motions := motions_of(link.joint):
                moving = self.relative_twist(at, poses, twists)
                rates = motions.rates(moving, self.relative(at, poses))
                found[link.name] = finite(f"a rate of {link.name}", assembled(rates))
            elif not is_rigid(link.joint):
                found[link.name] = assembled(twists[i])
        return found

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

    # ---- closing -------------------------------------------------------------------------------

    def close(self, pose: Mapping[str, Any]) -> dict[str, Array]:
        """Find poses that close all joints and loops near given ones, by Newton's method.

        Every step is the motion of least kinetic energy that closes the joints, as in
        `lierb.Problem.close`; rows may be redundant. A pose that is closed to rounding already is
        returned unchanged.

        Parameters
        ----------
        pose : dict
            Poses of all links, (4, 4) or (n, 4, 4).

        Returns
        -------
        dict of ndarray, shape (4, 4) or (n, 4, 4)
            Closed pose of each link.

        Raises
        ------
        PoseError
            The iteration does not converge; the message says which joint stays open by how much.

        Examples
        --------
        >>> import lierb
        >>> rod = lierb.bodies.rod(1.0, 0.01, mass=1.0)
        >>> turning = dict(axis=(0.0, 1.0, 0.0))
        >>> bar = lierb.Link("bar", rod, lierb.joints.revolute((0.0, 0.0, 0.5), **turning))
        >>> strut = lierb.Link(
        ...     "strut", rod, lierb.joints.revolute((0.0, 0.0, 0.5), (1.0, 0.0, 0.0), **turning)
        ... )
        >>> tie = lierb.Loop(
        ...     "tie",
        ...     lierb.joints.revolute((0.0, 0.0, -0.5), parent_point=(0.0, 0.0, -0.5), **turning),
        ...     "strut",
        ...     "bar",
        ... )
        >>> truss = lierb.Mechanism([bar, strut], tie)
        >>> closed = truss.close(truss.pose({"bar": -0.4, "strut": 0.4}))
        >>> truss.coordinates(closed)["bar"].round(6).tolist()  # −π/6
        [-0.523599]
        """
        self.poses("pose", pose)
        given = [as_poses(f"pose[{name!r}]", pose[name]) for name in self.names]
        with np.errstate(all="ignore"):  # what overflows does not come to close
            found = mechanism_closing.closed(self, given)
        return {
            n: finite(f"the closed pose of {n}", x) for n, x in zip(self.names, found, strict=True)
        }

    def project(
        self, twist: Mapping[str, Any], pose: Mapping[str, Any] | None = None, *, t0: float = 0.0
    ) -> dict[str, Array]:
        """Return the nearest twists that satisfy all joints and loops, in kinetic energy.

        Parameters
        ----------
        twist : dict
            Body-fixed twists of all links, (6,) or (n, 6).
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.
        t0 : float, optional
            Time at which motors have their speeds, s.

        Returns
        -------
        dict of ndarray, shape (6,) or (n, 6)
            V − M⁻¹Jᵀ(J M⁻¹Jᵀ)⁺ (J V − prescribed), of all links together.

        Raises
        ------
        TwistError
            Motors prescribe speeds that no twist has.

        Examples
        --------
        >>> import lierb
        >>> box = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0)
        >>> pair = lierb.Mechanism([
        ...     lierb.Link("a", box, lierb.joints.free()),
        ...     lierb.Link("b", box, lierb.joints.fixed(), parent="a"),
        ... ])
        >>> found = pair.project({"a": (0, 0, 0, 1.0, 0, 0), "b": (0, 0, 0, 0.0, 0, 0)})
        >>> found["b"].round(9).tolist()
        [0.0, 0.0, 0.0, 0.5, 0.0, 0.0]
        """
        placed = self.pose() if pose is None else pose
        self.poses("pose", placed), self.twists("twist", twist)
        poses = [as_poses(f"pose[{name!r}]", placed[name]) for name in self.names]
        twists = [as_numbers(f"twist[{name!r}]", twist[name], (6,)) for name in self.names]
        with np.errstate(all="ignore"):
            found = mechanism_closing.projected(self, twists, poses, as_number("t0", t0))
        return {
            n: finite(f"the projected twist of {n}", x)
            for n, x in zip(self.names, found, strict=True)
        }

    def freedoms(self, pose: Mapping[str, Any] | None = None) -> Mobility:
        """Count the freedoms that joints and loops leave at a pose, and the redundant rows.

        Parameters
        ----------
        pose : dict, optional
            Closed poses of all links. Default: all coordinates 0.

        Returns
        -------
        Mobility
            `freedoms` and `redundant`, whole numbers or (n,) of them. Motors do not count.

        Examples
        --------
        >>> import lierb
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
        >>> bearing = lierb.Loop("bearing", lierb.joints.revolute(), "wheel")
        >>> lierb.Mechanism(wheel, bearing).freedoms()
        Mobility(freedoms=1, redundant=5)
        """
        placed = self.pose() if pose is None else pose
        self.poses("pose", placed)
        poses = [as_poses(f"pose[{name!r}]", placed[name]) for name in self.names]
        with np.errstate(all="ignore"):
            return mechanism_closing.mobility(self, poses)

    # ---- poses and twists of all links ---------------------------------------------------------

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


def _alike(found: dict[str, Array], what: str, item_axes: int) -> dict[str, Array]:
    """Of all links, each for every member of the batch where it is of one's."""
    for name, array in found.items():
        finite(f"the {what} of {name}", array)
    sizes = [len(array) for array in found.values() if array.ndim > item_axes]
    if not sizes:
        return found
    return {
        name: array
        if array.ndim > item_axes and len(array) == max(sizes)
        else np.broadcast_to(array, (max(sizes), *array.shape[-item_axes:])).copy()
        for name, array in found.items()
    }


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

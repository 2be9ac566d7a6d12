"""Bodies and problems: what is integrated, in SI units, checked when it is made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from operator import methodcaller
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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
from lierb.column_names import require_free
from lierb.errors import (
    ArgumentError,
    ForceError,
    InertiaError,
    PoseError,
    TwistError,
    body_label,
    items_of,
    told,
    two_readings,
)
from lierb.joints import MOST_ROWS, Joint
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Parameters,
    SO3xR3,
    unit_inertia,
)
from lierb.kernels.mechanics.rows import Rows, keeps_axis, slides, turns
from lierb.kernels.mechanics.saddle import Load, solve
from lierb.kernels.mechanics.scale import ROUNDING, bearings, length_of, rounding_of
from lierb.kernels.numbers.arithmetic import absolute, plain, where
from lierb.kernels.numbers.vec import ZERO3, Vec, add, diagonal, dot, norm
from lierb.kernels.stepping.layout import INPUTS
from lierb.shown import Lines, Shown, counted, quantity
from lierb.user_binding import Column, bound, columns_of, require_different_events
from lierb.user_elements import Constraint, Element, Force, Observable, reject_functions
from lierb.user_signals import Controller, Event, ExtraStates

SYMMETRY_TOLERANCE = 1e-12  # relative to the largest entry
NEWTON_STEPS = 50  # quadratic convergence takes 4 to 6 from any place that it converges from
CLOSED = 1e-13  # rad, and relative to the problem's length: where rounding ends it
TRIANGLE_TOLERANCE = 1e-12  # relative to the largest principal moment
MOMENTS_OF_EACH = "inertia[:, :, None] * np.eye(3)"
LEAST_GYRATION = 0.03  # of the problem's length, that a pose is closed with
AT_REST = Load(ZERO3, ZERO3, ZERO3)
# Of a problem and a mechanism: the arguments that are elements, in the order of all.
ELEMENTS: dict[str, type[Element]] = {
    "forces": Force,
    "constraints": Constraint,
    "observables": Observable,
    "events": Event,
    "states": ExtraStates,
    "controllers": Controller,
}


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Body(Shown):
    """A rigid body, or a batch of them.

    Parameters
    ----------
    mass : float or array_like, shape (n,)
        Mass, kg.
    inertia : array_like, shape (3,), (n, 3), (3, 3) or (n, 3, 3)
        Principal moments or inertia matrices, kg m², about the body frame's origin and in its axes.
        A shape (3, 3) is one matrix, and refused where mass or com are those of three bodies.
    com : array_like, shape (3,) or (n, 3), optional
        Centre of mass in the body frame, m. Default: its origin.

    Raises
    ------
    InertiaError
        No body has such a mass or inertia.
    ArgumentError
        A shape is wrong.

    Examples
    --------
    >>> import lierb
    >>> lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531)).inertia.shape
    (3, 3)
    """

    mass: Array
    inertia: Array
    com: Array

    def __init__(self, mass: ArrayLike, inertia: ArrayLike, com: ArrayLike | None = None) -> None:
        masses = as_numbers("mass", mass, ())
        moments = as_numbers("inertia", inertia, (3,), (3, 3))
        centre = as_numbers("com", (0.0, 0.0, 0.0) if com is None else com, (3,))
        if moments.shape == (3, 3) and batch_size(mass=masses, com=(centre, 1)) == 3:
            raise two_readings(
                "inertia", moments.shape, one_matrix_for_all="inertia[None]",
                principal_moments_of_each=MOMENTS_OF_EACH,
            )  # fmt: skip
        if not (moments.ndim >= 2 and moments.shape[-2:] == (3, 3)):
            moments = moments[..., :, None] * np.eye(3)
        batch_size(mass=masses, inertia=(moments, 2), com=(centre, 1))
        _check_mass(masses)
        moments = _checked_symmetric(moments)
        _check_physical(_about_com(masses, moments, centre))
        _check_gyration(masses, moments)
        moments.setflags(write=False)
        for name, value in (("mass", masses), ("inertia", moments), ("com", centre)):
            object.__setattr__(self, name, value)

    def of(self, which: int | slice) -> Body:
        """One body of the batch, or a part of it."""
        inertia = taken(self.inertia, which, 2)
        if inertia.ndim == 2 and isinstance(which, slice):
            inertia = inertia[None]  # or a part of three bodies might be read in two ways
        return Body(taken(self.mass, which), inertia, taken(self.com, which, 1))

    def _shown(self) -> tuple[str, Lines]:
        count = batch_size(mass=self.mass, inertia=(self.inertia, 2), com=(self.com, 1)) or 1
        rows = [("mass", quantity(self.mass, "kg")), ("inertia", _shown_inertia(self.inertia))]
        if np.any(self.com != 0.0):
            rows.append(("com", quantity(self.com, "m", 1)))
        return f"lierb.Body{f': {count} of them' if count > 1 else ''}", rows


def _shown_inertia(moments: Array) -> str:
    if moments.size > 9 or np.any(moments.reshape(3, 3) != np.diag(np.diag(moments.reshape(3, 3)))):
        return quantity(moments, "kg m²", 2)
    return f"{quantity(np.diag(moments.reshape(3, 3)), item_axes=1)} kg m², principal"


def _check_mass(masses: Array) -> None:
    bad = np.flatnonzero(np.atleast_1d(masses) <= 0.0)
    if bad.size:
        label = body_label("mass", int(bad[0]), masses.size)
        raise InertiaError(
            f"{label} is {np.atleast_1d(masses)[bad[0]]} kg; expected a positive mass"
        )


@np.errstate(over="ignore")
def _check_gyration(masses: Array, moments: Array) -> None:
    """Raise InertiaError where tr Θ/m, which lengths are measured by, is beyond all numbers."""
    traces = np.trace(moments, axis1=-2, axis2=-1)
    squares = np.atleast_1d(traces / masses)
    for body in np.flatnonzero(~np.isfinite(squares))[:1]:
        mass, trace = (np.broadcast_to(x, squares.shape)[body] for x in (masses, traces))
        raise InertiaError(
            f"{body_label('mass', int(body), squares.size)} is {mass} kg beside an inertia of "
            f"trace {trace} kg m²: the radius of gyration is beyond all numbers; give those of one "
            "body, or choose other units"
        )


def _checked_symmetric(moments: Array) -> Array:
    flat = moments.reshape(-1, 3, 3)
    size = np.abs(flat).max(axis=(1, 2))
    skew = np.abs(flat - flat.transpose(0, 2, 1)).max(axis=(1, 2))
    bad = np.flatnonzero(skew > SYMMETRY_TOLERANCE * size)
    if bad.size:
        label = body_label("inertia", int(bad[0]), len(flat))
        raise InertiaError(
            f"{label} is not symmetric: entries differ by {skew[bad[0]]:.3g} kg m²; "
            "give (I + I.T) / 2. A shape (3, 3) is read as one matrix, not as three bodies: "
            f"give {MOMENTS_OF_EACH} for the principal moments of three"
        )
    half = 0.5 * flat  # first: the sum of two of the largest numbers overflows
    return (half + half.transpose(0, 2, 1)).reshape(moments.shape)


@np.errstate(all="ignore")
def _about_com(masses: Array, moments: Array, centre: Array) -> Array:
    """The inertia about the centre of mass. Raises InertiaError where it overflows."""
    shift = unit_inertia(components(centre))
    parts = zip(components(moments, 2), shift, strict=True)
    found = assembled(tuple(i - masses * s for i, s in parts), 3, 3)
    flat = found.reshape(-1, 9)
    for body in np.flatnonzero(~np.isfinite(flat).all(axis=1))[:1]:
        raise InertiaError(
            f"{body_label('inertia', int(body), len(flat))} has no inertia about the centre of "
            "mass: mass times the square of com is beyond all numbers; give smaller numbers, or "
            "choose larger units"
        )
    return found


def _check_physical(about_com: Array) -> None:
    """Positive definite, and no principal moment above the sum of the two others."""
    flat = about_com.reshape(-1, 3, 3)
    principal = np.linalg.eigvalsh(flat)
    for body in np.flatnonzero(principal[:, 0] <= 0.0)[:1]:
        raise InertiaError(
            f"{body_label('inertia', int(body), len(flat))} is not positive definite: its "
            f"principal moments about the centre of mass are {_listed(principal[body])} kg m²"
        )
    excess = principal[:, 2] - principal[:, 0] - principal[:, 1]
    for body in np.flatnonzero(excess > TRIANGLE_TOLERANCE * principal[:, 2])[:1]:
        raise InertiaError(
            f"{body_label('inertia', int(body), len(flat))} belongs to no rigid body: the largest "
            f"of the principal moments {_listed(principal[body])} kg m² about the centre of mass "
            "exceeds the sum of the two others"
        )


def _listed(numbers: Array) -> str:
    return ", ".join(f"{x:.6g}" for x in numbers)


def shown_element(element: Element) -> str:
    shapes = element.kind.shapes
    given = (f"{n} {quantity(a, item_axes=len(shapes[n]))}" for n, a in element.parameters.items())
    return f"{element.name}: {', '.join(given) or 'no parameters'}"


def require(argument: str, value: object, kind: type, expected: str) -> None:
    if not isinstance(value, kind):
        raise ArgumentError(f"{argument} must be {expected}, got {told(value)}")


def _checked(argument: str, given: Any, kind: type[Element], joint: Joint) -> tuple[Element, ...]:
    one, expected = (f"{words} made by lierb" for words in kind.words)
    elements = items_of(argument, given, expected) if isinstance(given, Iterable) else (given,)
    for number, element in enumerate(elements):
        label = f"{argument}[{number}]"
        reject_functions(label, element)
        require(label, element, kind, one)
        if element.at:
            raise ArgumentError(
                f"{label} is on {' and '.join(element.at)}; a Problem has one body and no names: "
                "leave .on(…) out, or make a lierb.Mechanism"
            )
        require_fit(element, joint)
    return elements


def bind(problem: Any) -> None:
    """Let functions of a problem or a mechanism see its states and controllers.

    Raises ForceError for one that sees what there is not, ArgumentError for names that are taken.
    """
    labels = ("states", "controllers", "forces", "observables", "events")
    parts = bound(*(getattr(problem, label) for label in labels))
    for label, elements in zip(labels, parts, strict=True):
        object.__setattr__(problem, label, elements)
    require_different_events(problem.events)
    require_free(problem.observables, columns_of((*problem.states, *problem.controllers)))


def require_fit(element: Element, joint: Joint) -> None:
    """Raise ForceError for an element that has changed, or that cannot act at the joint."""
    element.require_unchanged()
    if not element.kind.needs_axis:
        return
    name = f"{element.name} on {element.at[0]!r}" if element.at else element.name
    acts = f"{name} acts {'along' if element.kind.needs_slide else 'about'} the joint axis"
    if not keeps_axis(joint.rows):
        raise ForceError(
            f"{acts}, which a {joint.name} joint does not keep: its body turns about others too; "
            "take a joint such as revolute, or a constant_wrench or lierb.wrench"
        )
    if element.kind.needs_slide and not slides(joint.rows):
        raise ForceError(
            f"{acts}, along which a {joint.name} joint does not slide; take a joint such as "
            "prismatic, or a torque about the axis"
        )
    if not element.kind.needs_slide and not turns(joint.rows):
        raise ForceError(
            f"{acts}, about which a {joint.name} joint does not turn; take a joint such as "
            "revolute, or what acts along the axis: motor(force=…), slide_spring, slide_friction "
            "or slide_limit"
        )


def unfit_rate(rows: Rows, rates: Iterable[Any], t0: float) -> TwistError | None:
    """The error for rows whose prescribed rates, such as a motor's speed, are no numbers at t0."""
    for row, rate in zip(rows, rates, strict=True):
        each = np.atleast_1d(plain(rate))
        for body in np.flatnonzero(~np.isfinite(each))[:1]:
            return TwistError(
                f"{body_label('the speed', int(body), each.size)} that {row} prescribes is "
                f"{each[body]} rad/s at t0={t0:g} s, and no twist has it; give a function that has "
                "a value there, or another t0"
            )
    return None


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Problem(Shown):
    """A body, the joint that holds it to the ground, and the forces on it.

    Parameters
    ----------
    body : Body
        The body or the batch of bodies.
    joint : Joint
        Its joint to the ground; `lierb.joints.free()` for none.
    gravity : array_like, shape (3,) or (n, 3), optional
        Acceleration of gravity in the ground frame, m/s². Default: none.
    forces : Force or iterable of Force, optional
        Forces made by `lierb.forces` and `lierb.wrench`.
    constraints : Constraint or iterable of Constraint, optional
        Constraints made by `lierb.constraint`, beside the joint's own.
    observables : Observable or iterable of Observable, optional
        Columns of the results, made by `lierb.observable`.
    events : Event or iterable of Event, optional
        Crossings of zero to be located, made by `lierb.event`.
    states : ExtraStates or iterable of ExtraStates, optional
        Further states, made by `lierb.states` and integrated with the body's.
    controllers : Controller or iterable of Controller, optional
        Sampled controllers, made by `lierb.controller`: called once a period, their outputs are
        held.

    Raises
    ------
    ForceError
        A force acts about a joint axis that the joint does not have, or a function uses states or
        controls that the problem does not have.

    Examples
    --------
    >>> import lierb
    >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=[1.0, 2.0])
    >>> lierb.Problem(box, lierb.joints.free(), forces=lierb.forces.drag(linear=0.1)).batch_size()
    2
    """

    body: Body
    joint: Joint
    gravity: Array
    forces: tuple[Force, ...]
    constraints: tuple[Constraint, ...]
    observables: tuple[Observable, ...]
    events: tuple[Event, ...]
    states: tuple[ExtraStates, ...]
    controllers: tuple[Controller, ...]

    def __init__(
        self,
        body: Body,
        joint: Joint,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        forces: Force | Iterable[Force] = (),
        constraints: Constraint | Iterable[Constraint] = (),
        observables: Observable | Iterable[Observable] = (),
        events: Event | Iterable[Event] = (),
        states: ExtraStates | Iterable[ExtraStates] = (),
        controllers: Controller | Iterable[Controller] = (),
    ) -> None:
        require("body", body, Body, "a lierb.Body")
        require("joint", joint, Joint, "a joint from lierb.joints, such as spherical(…)")
        field = as_numbers("gravity", gravity, (3,))
        object.__setattr__(self, "body", body)
        object.__setattr__(self, "joint", joint)
        object.__setattr__(self, "gravity", field)
        given = forces, constraints, observables, events, states, controllers
        for (label, kind), elements in zip(ELEMENTS.items(), given, strict=True):
            object.__setattr__(self, label, _checked(label, elements, kind, joint))
        bind(self)
        if len(self.rows) > MOST_ROWS:
            raise ArgumentError(f"{len(self.rows)} constraint rows; at most {MOST_ROWS} are solved")
        self.batch_size()

    def _shown(self) -> tuple[str, Lines]:
        _, mass = self.body._shown()
        name, held = self.joint._shown()
        rows = [
            ("body", "\n".join(f"{label} {text}" for label, text in mass)),
            ("joint", "\n".join((name, *(f"{label} {text}" for label, text in held)))),
            ("gravity", quantity(self.gravity, "m/s²", 1)),
        ]
        rows += [
            (label, "\n".join(map(shown_element, elements)))
            for label in ELEMENTS
            if (elements := getattr(self, label))
        ]
        count = counted(self.batch_size() or 1, "body", "bodies")
        return f"lierb.Problem: {count} on a {self.joint.name} joint", rows

    def of_body(self, body: int) -> Problem:
        """Return the problem of one body of the batch.

        Parameters
        ----------
        body : int
            Number of the body.

        Returns
        -------
        Problem
            Its problem, not batched.

        Raises
        ------
        ArgumentError
            The batch has no body of that number.
        """
        which = member_of(body, self.batch_size())
        elements = {label: [e.of_body(which) for e in getattr(self, label)] for label in ELEMENTS}
        gravity = taken(self.gravity, which, 1)
        return Problem(self.body.of(which), self.joint.of(which), gravity, **elements)

    def with_events(self, events: Event | Iterable[Event]) -> Problem:
        """The same problem with more events, after its own."""
        more = _checked("events", events, Event, self.joint)
        elements = {label: getattr(self, label) for label in ELEMENTS}
        elements["events"] = (*self.events, *more)
        return Problem(self.body, self.joint, self.gravity, **elements)

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """Forces, constraints, observables, events, states and controllers."""
        return tuple(e for label in ELEMENTS for e in getattr(self, label))

    @cached_property
    def signals(self) -> tuple[Column, ...]:
        """Its extra states, then what its controllers put out, as they stand side by side."""
        return columns_of(self.elements)

    def require_unchanged(self) -> None:
        """Raise ForceError where a force's function refers to something that is another by now."""
        for element in self.elements:
            if element.references:
                element.require_unchanged()

    @cached_property
    def kinds(self) -> tuple[kinds.Element, ...]:
        """Of the elements, as compiled code is specialised on them."""
        return tuple(element.kind for element in self.elements)

    @cached_property
    def rows(self) -> Rows:
        """Every constraint row: the joint's, those of motors, and further ones."""
        added = (
            element.kind.row(place, i)
            for place, element in enumerate(self.elements)
            for i in range(element.kind.rows)
        )
        return (*self.joint.rows, *added)

    @cached_property
    def quantities(self) -> dict[str, Array]:
        """Its numbers, but for the elements' parameters; each for every body, or one for all."""
        owners = {"gravity": self, **dict.fromkeys(("mass", "inertia", "com"), self.body)}
        given = (f.name for f in INPUTS.fields if f.name not in ("pose", "twist"))
        return {name: getattr(owners.get(name, self.joint), name) for name in given}

    @cached_property
    def _batched(self) -> dict[str, tuple[Array, int]]:
        """The batched arguments, with the number of an item's axes."""
        entries = {
            name: (array, len(field.shape))
            for field in INPUTS.fields
            for name, array in self.quantities.items()
            if name == field.name
        }
        for element in self.elements:
            for name, entry in element.batched().items():
                same = sum(known.partition("[")[0] == name for known in entries)
                entries[f"{name}[{same}]" if same else name] = entry
        return {name: (array, axes) for name, (array, axes) in entries.items() if array.ndim > axes}

    def batch_size(self, **more: Any) -> int | None:
        """Number of bodies that the batched arguments ask for; None where none is batched."""
        return batch_size(**self._batched, **more)

    def parameters(self) -> Parameters:
        """The problem as formulas take it, one array per component."""
        return Parameters(
            mass=self.body.mass,
            inertia=components(self.body.inertia, 2),
            com=components(self.body.com),
            gravity=components(self.gravity),
            ground=pose_components(self.joint.ground_frame),
            body=pose_components(self.joint.body_frame),
            pitch=self.joint.pitch,
            length=self.joint.length,
        )

    def in_joint_axes(self, space: type[SE3] | type[SO3xR3]) -> BodyConstants:
        """The body, with its elements, as that c-space's formulas take it."""
        parameters = self.parameters()
        numbers = [
            x
            for element in self.elements
            for name, shape in element.kind.shapes.items()
            for x in components(element.parameters[name], len(shape))
        ]
        return kinds.body_with(space, parameters, self.kinds, numbers)

    def close(self, pose: Any) -> Array:
        """Find a pose that closes the joint near a given one, by Newton's method on its rows.

        Every step is the screw motion X of least XᵀMX, the kinetic-energy metric, that cancels the
        constraints' values; a body that is small beside its lever arm counts as larger there, so
        that it does not turn by a radian to move by a hair. The iteration ends at rounding,
        relative to the problem's own length.

        Parameters
        ----------
        pose : array_like or RigidTransform, shape (4, 4) or (n, 4, 4)
            Pose near the joint.

        Returns
        -------
        ndarray, shape (4, 4) or (n, 4, 4)
            Pose that closes the joint.

        Raises
        ------
        PoseError
            The iteration does not converge: the pose is too far away, in a singular configuration,
            or exactly half a turn off.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
        >>> pendulum = lierb.Problem(lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0), hinge)
        >>> off = lierb.lie.se3.exp((1e-3, 0.5, 2e-3, 0.01, -0.02, 0.0))
        >>> hinge.coordinates(pendulum.close(off)).round(2).tolist()
        [0.5]
        """
        poses = as_poses("pose", pose)
        self.batch_size(pose=(poses, 2))
        with np.errstate(all="ignore"):  # what overflows does not come to close
            return self._closed(poses)

    def _closed(self, poses: Array) -> Array:
        rows, parameters, body = self.rows, self.parameters(), self.in_joint_axes(SE3)
        placed, still = SE3.to_joint_axes(parameters, pose_components(poses), (0.0,) * 6)
        length = length_of(parameters)
        small = CLOSED * length  # m
        stout = body.mass * (LEAST_GYRATION * length) ** 2
        trace = body.inertia[0] + body.inertia[4] + body.inertia[8]
        added = where(trace < stout, stout, 0.0 * stout)
        body = body._replace(inertia=add(body.inertia, diagonal((added, added, added))))
        # Functions of the user's see the place from the origins of the user's frames.
        rounding = rounding_of(parameters, pose_components(poses))
        for _ in range(NEWTON_STEPS):
            x = SE3.kinematics(body, placed, still)
            off = residuals(rows, x, body)
            here = ROUNDING * norm((0.0, *placed[1]))
            closed = np.isfinite(small)  # or any distance passes for rounding
            for r, h in zip(rows, off, strict=True):
                near = small + (here if r.is_of_joint else rounding)
                closed = closed & (absolute(h) <= (near if r.is_translational else CLOSED))
            if np.all(closed):
                break
            found = solve(
                body,
                x.q,
                rows,
                methodcaller("jacobian", x, body),
                tuple(-h for h in off),
                AT_REST,
            )
            moved = se3.compose(placed, se3.exp(found.turning + found.moving))
            placed = where(closed, placed, moved)  # no body waits, or moves on, for another
        open_ones = np.flatnonzero(~np.atleast_1d(closed))
        if open_ones.size:
            raise PoseError(
                f"{body_label('pose', int(open_ones[0]), np.size(closed))} does not come to close "
                f"the {self.joint.name} joint in {NEWTON_STEPS} Newton steps; start nearer to a "
                "pose that does, such as problem.joint.closed_pose"
            )
        q, d = placed
        turned = [bearing <= 0.0 for bearing in bearings(rows, q)]
        against = np.flatnonzero(np.any(np.broadcast_arrays(np.bool_(False), *turned), axis=0))
        if against.size:
            raise PoseError(
                f"{body_label('pose', int(against[0]), np.size(closed))} holds the "
                f"{self.joint.name} joint the wrong way round, half a turn off, from where no way "
                "back is the shortest; turn it by less, or one of the joint's frames by 180°"
            )
        turned_back = SE3.to_user_axes(parameters, (so3.orthonormalised(q), d), still)[0]
        return finite("the closed pose", pose_matrix(turned_back))

    def project(self, twist: ArrayLike, pose: Any = None, *, t0: float = 0.0) -> Array:
        """Return the nearest twist that satisfies the joint, in the kinetic-energy metric.

        Parameters
        ----------
        twist : array_like, shape (6,) or (n, 6)
            Body-fixed twist (ω, v), rad/s and m/s.
        pose : array_like or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Pose of the body. Default: the closed joint.
        t0 : float, optional
            Time at which a motor has its speed, s.

        Returns
        -------
        ndarray, shape (6,) or (n, 6)
            V − M⁻¹Jᵀ(J M⁻¹Jᵀ)⁻¹ J V.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 0.0, 1.0))
        >>> wheel = lierb.Problem(lierb.bodies.cylinder(0.3, 0.05, mass=2.0), hinge)
        >>> wheel.project((1.0, 2.0, 3.0, 4.0, 5.0, 6.0)).round(9).tolist()
        [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
        """
        twists, start = as_numbers("twist", twist, (6,)), as_number("t0", t0)
        pose = self.joint.closed_pose if pose is None else as_poses("pose", pose)
        self.batch_size(twist=(twists, 1), pose=(pose, 2))
        with np.errstate(all="ignore"):
            found = self._projected(components(twists), pose_components(pose), start)
        return finite("the projected twist", found)

    def _projected(self, given: Vec, pose: Pose, t0: Any) -> Array:
        parameters, body = self.parameters(), self.in_joint_axes(SE3)
        placed, velocity = SE3.to_joint_axes(parameters, pose, given)
        x = SE3.kinematics(body, placed, velocity)._replace(time=t0)
        wanted = [r.prescribed_rate(x, body) for r in self.rows]
        if error := unfit_rate(self.rows, wanted, t0):
            raise error
        along = methodcaller("jacobian", x, body)
        for _ in range(2):  # the second time, for what rounding has left of a large part
            rates = [dot(along(r), velocity) for r in self.rows]
            lacking = tuple(w - rate for w, rate in zip(wanted, rates, strict=True))
            change = solve(body, x.q, self.rows, along, lacking, AT_REST)
            velocity = add(velocity, change.turning + change.moving)
        _, projected = SE3.to_user_axes(parameters, placed, velocity)
        return assembled(projected)

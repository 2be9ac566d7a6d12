"""Problem of one body: the body, its joint to the ground, and forces on it, in SI units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from operator import methodcaller
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, LierbError, PoseError, body_label
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Parameters
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.mechanics.saddle import solve
from lierb.kernels.mechanics.scale import ROUNDING, bearings, length_of, rounding_of
from lierb.kernels.mechanics.support import Load
from lierb.kernels.numbers.arithmetic import absolute, where
from lierb.kernels.numbers.vec import ZERO3, Vec, add, diagonal, dot, norm
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.system_of import plan_of
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.model.acting import on_one_body, require
from lierb.model.base import Model, OfBody, OfJoint
from lierb.model.bodies.body import Body
from lierb.model.connections import NOWHERE, Connection
from lierb.model.formulation import Formulation, formulation_of_body
from lierb.model.functions.constraints import Constraint
from lierb.model.functions.controllers import Controller
from lierb.model.functions.elements import Element
from lierb.model.functions.events import Event
from lierb.model.functions.ground_motion import MovingGround
from lierb.model.functions.observables import Observable
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import MOST_ROWS, Joint
from lierb.model.mechanism.links import Link
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.row_system import CLOSED, LEAST_GYRATION, NEWTON_STEPS
from lierb.model.mechanism.start_checks import start_of_body, violation_of
from lierb.model.numbers import numbers_of, parameters_of
from lierb.model.unfit import unfit_constraint, unfit_place, unfit_rate
from lierb.support.arrays import (
    GRAVITY,
    Array,
    Pose,
    as_number,
    as_numbers,
    as_poses,
    as_twists,
    assembled,
    components,
    finite,
    pose_components,
    pose_matrix,
)
from lierb.support.representations import Lines, counted, quantity

BODY = "body"  # link of a single body as a mechanism
AT_REST = Load(ZERO3, ZERO3, ZERO3)
CLOSED_POSE = np.full((4, 4), np.nan)  # input value that represents the pose of the closed joint


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Problem(Model):
    """Body, its joint to the ground, and the forces on it.

    Parameters
    ----------
    body : Body
        The body or the batch of bodies.
    joint : Joint
        Joint to the ground; `lierb.joints.free()` for an unconstrained body.
    gravity : array_like, shape (3,) or (n, 3), optional
        Acceleration of gravity in the ground frame, m/s². Default: none.
    forces : Force or iterable of Force, optional
        Forces made by `lierb.forces` and `lierb.wrench`.
    constraints : Constraint or iterable of Constraint, optional
        Constraints made by `lierb.constraint` and `lierb.velocity_constraint`, in addition to the
        joint.
    observables : Observable or iterable of Observable, optional
        Columns of the results, made by `lierb.observable`.
    events : Event or iterable of Event, optional
        Crossings of zero to be located, made by `lierb.event`.
    states : ExtraStates or iterable of ExtraStates, optional
        Further states, made by `lierb.states` and integrated with those of the body.
    controllers : Controller or iterable of Controller, optional
        Sampled controllers, made by `lierb.controller`: called once per period, with constant
        outputs in between.
    ground_motion : ground motion or callable, optional
        Displacement of the ground: made by a function decorated by `lierb.ground_motion`, or a
        function of t in s that returns (3,) in m. All results are relative to the moving ground.
        Default: the ground is at rest.

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
        ground_motion: MovingGround | UserFunction | None = None,
    ) -> None:
        require("body", body, Body, "a lierb.Body")
        require("joint", joint, Joint, "a joint from lierb.joints, such as spherical(…)")
        pull = as_numbers("gravity", gravity, (3,), hint=GRAVITY)
        self._set(body=body, joint=joint, gravity=pull)
        elements = forces, constraints, observables, events, states, controllers
        self._set_elements(*elements, ground_motion=ground_motion)
        if len(self.rows) > MOST_ROWS:
            raise ArgumentError(f"{len(self.rows)} constraint rows; at most {MOST_ROWS} are solved")
        self.batch_size()

    def _representation(self) -> tuple[str, Lines]:
        _, mass = self.body._representation()
        name, joint = self.joint._representation()
        rows = [
            ("body", "\n".join(f"{label} {text}" for label, text in mass)),
            ("joint", "\n".join((name, *(f"{label} {text}" for label, text in joint)))),
            ("gravity", quantity(self.gravity, "m/s²", 1)),
        ]
        count = counted(self.batch_size() or 1, "body", "bodies")
        title = f"lierb.Problem: {count} on a {self.joint.name} joint"
        return title, [*rows, *self._shown_elements()]

    def _placed(self, label: str, element: Element) -> Any:
        return on_one_body(label, element, self.joint)

    def _structure(self, body: OfBody, joint: OfJoint) -> tuple[Any, Any]:
        return body(self.body, "", ""), joint(self.joint, "")

    @cached_property
    def rows(self) -> Rows:
        """Constraint rows of the joint, then of the elements."""
        added = (
            element.kind.row(place, i)
            for place, element in enumerate(self.elements)
            for i in range(element.kind.rows)
        )
        return (*self.joint.rows, *added)

    # ---- interface of a model --------------------------------------------------------------------

    default_cspace = "SE3"
    flags_starts = True
    link_names = ("",)
    fields = ("",)
    joint_fields = ("",)
    element_prefix = ""
    order = (0,)

    @cached_property
    def joints(self) -> tuple[Connection, ...]:
        return (Connection("", 0, NOWHERE, self.joint, self.joint.rows),)

    @property
    def bodies(self) -> tuple[Body, ...]:
        return (self.body,)

    @cached_property
    def inputs(self) -> dict[str, Array]:
        return {**super().inputs, "pose": CLOSED_POSE}

    @property
    def rows_by_name(self) -> tuple[tuple[str, Rows], ...]:
        return (("", self.rows),)

    @property
    def description(self) -> dict[str, Any]:
        rows = [str(row) for row in self.rows]
        return {
            **self.quantities, "joint": self.joint.name, "rows": rows, **self.described_elements,
        }  # fmt: skip

    def by_link(self, argument: str, given: Any, is_whole: bool = True) -> dict[str, Any]:
        return {"": given}

    def from_links(self, values: dict[str, Any]) -> Any:
        return values[""]

    def default_pose(self) -> None:
        return None

    def formulation(
        self, *, cspace: Any, update: str, check: str, solver: str, stabilise: Any
    ) -> Formulation:
        added = [element.name for element in self.elements if element.kind.rows]
        return formulation_of_body(self.body, self.joint, added, cspace, check, solver, stabilise)

    def plan(self, formulation: Formulation, **described: Any) -> Plan:
        (space,) = formulation.cspaces
        return plan_of(
            DEFAULT_LANES,
            rows=self.rows,
            cspace="SO3xR3" if space == "SO3xR3" else "SE3",
            solver=formulation.solver,
            **described,
        )

    def violation(
        self, pose0: Any, twist0: Any, t0: float = 0.0, number: int | None = None
    ) -> LierbError | None:
        poses = self.joint.closed_pose if pose0 is None else as_poses("pose0", pose0)
        twists = None if twist0 is None else as_twists("twist0", twist0)
        with np.errstate(all="ignore"):
            return violation_of(start_of_body(self, poses, twists, t0, number))

    def parameters(self, at: Connection | None = None) -> Parameters:
        """Return the problem's parameters for formulas, one array per component."""
        return parameters_of(self.body, self.joint, self.gravity)

    def constants(self, at: Connection | None = None) -> BodyConstants:
        """Return the constants of the body and its elements for formulas in joint axes."""
        return kinds.body_with(SE3, self.parameters(), self.kinds, numbers_of(self.elements))

    def close(self, pose: Any, *, t0: float = 0.0) -> Array:
        """Find a pose near `pose` that closes the joint, by Newton's method on its rows.

        Every step is the screw motion X of least XᵀMX, the kinetic-energy metric, that cancels the
        constraint residuals. For a body that is small relative to its lever arm the metric has a
        larger inertia, so that a small displacement does not cause a large rotation. The iteration
        ends at rounding, relative to the characteristic length of the problem.

        Parameters
        ----------
        pose : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4)
            Pose near the joint.
        t0 : float, optional
            Time at which the position of a motor is evaluated, s.

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
        poses, start = as_poses("pose", pose), as_number("t0", t0)
        self.batch_size(pose=(poses, 2))
        with np.errstate(all="ignore"):  # with an overflow it does not converge
            return self._closed(poses, start)

    def _closed(self, poses: Array, t0: float) -> Array:
        rows = tuple(r for r in self.rows if r.is_holonomic or r.depends_on_time)
        parameters = self.parameters()
        placed, at_rest = SE3.to_joint_axes(parameters, pose_components(poses), (0.0,) * 6)
        length = length_of(parameters)
        small = CLOSED * length  # m
        body = _stout(self.constants(), length)
        # Positions in users' functions are relative to the origins of the users' frames.
        rounding = rounding_of(parameters, pose_components(poses))
        given = SE3.kinematics(body, placed, at_rest)
        for _ in range(NEWTON_STEPS):
            x = SE3.kinematics(body, placed, at_rest)._replace(time=t0)
            if error := unfit_place(rows, [r.prescribed_place(x, body) for r in rows], t0):
                raise error
            off = residuals(rows, x, body)
            here = ROUNDING * norm((0.0, *placed[1]))
            closed = np.isfinite(small)  # infinite lengths would accept any residual
            for r, h in zip(rows, off, strict=True):
                near = small + (here if r.is_of_joint else rounding)
                closed = closed & (absolute(h) <= (near if r.is_translational else CLOSED))
            if np.all(closed):
                break
            jacobian, wanted = methodcaller("jacobian", x, body), tuple(-h for h in off)
            step = solve(body, x.q, rows, jacobian, wanted, AT_REST)
            moved = se3.compose(placed, se3.exp(step.turning + step.moving))
            placed = where(closed, placed, moved)  # converged bodies are frozen
        label = partial(body_label, "pose", count=np.size(closed))
        for number in np.flatnonzero(~np.atleast_1d(closed))[:1].tolist():
            if unfit := unfit_constraint(rows, given, body, label, member=number):
                raise unfit
            raise PoseError(
                f"{label(number)}: {NEWTON_STEPS} Newton steps do not close the {self.joint.name} "
                "joint; start nearer to a closed pose, such as problem.joint.closed_pose"
            )
        q, d = placed
        turned = [bearing <= 0.0 for bearing in bearings(rows, q)]
        against = np.any(np.broadcast_arrays(np.bool_(False), *turned), axis=0)
        for number in np.flatnonzero(against)[:1].tolist():
            raise PoseError(
                f"{label(number)} holds the "
                f"{self.joint.name} joint the wrong way round, half a turn off, where both "
                "ways back are equally short; turn it by less, or one of the joint's frames by 180°"
            )
        in_body_axes, _ = SE3.to_user_axes(parameters, (so3.orthonormalised(q), d), at_rest)
        return finite("the closed pose", pose_matrix(in_body_axes))

    def project(self, twist: ArrayLike, pose: Any = None, *, t0: float = 0.0) -> Array:
        """Return the nearest twist that satisfies the joint, in the kinetic-energy metric.

        Parameters
        ----------
        twist : array_like, shape (6,) or (n, 6)
            Body-fixed twist (ω, v), rad/s and m/s.
        pose : array_like, Rotation or RigidTransform, shape (4, 4) or (n, 4, 4), optional
            Pose of the body. Default: the closed joint.
        t0 : float, optional
            Time at which the speed or position of a motor is evaluated, s.

        Returns
        -------
        ndarray, shape (6,) or (n, 6)
            V − M⁻¹Jᵀ(J M⁻¹Jᵀ)⁻¹ (J V − prescribed).

        Raises
        ------
        ArgumentError
            An argument has the wrong shape, or is not finite.
        PoseError
            A constraint of your own has no value at the pose.

        Examples
        --------
        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 0.0, 1.0))
        >>> wheel = lierb.Problem(lierb.bodies.cylinder(0.3, 0.05, mass=2.0), hinge)
        >>> wheel.project((1.0, 2.0, 3.0, 4.0, 5.0, 6.0)).round(9).tolist()
        [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
        """
        twists, start = as_twists("twist", twist), as_number("t0", t0)
        pose = self.joint.closed_pose if pose is None else as_poses("pose", pose)
        self.batch_size(twist=(twists, 1), pose=(pose, 2))
        with np.errstate(all="ignore"):
            nearest = self._projected(components(twists), pose_components(pose), start)
        return finite("the projected twist", nearest)

    def _projected(self, twist: Vec, pose: Pose, t0: Any) -> Array:
        parameters, body = self.parameters(), self.constants()
        placed, velocity = SE3.to_joint_axes(parameters, pose, twist)
        x = SE3.kinematics(body, placed, velocity)._replace(time=t0)
        prescribed = [r.prescribed_rate(x, body) for r in self.rows]
        if error := unfit_rate(self.rows, prescribed, t0):
            raise error
        label = partial(body_label, "pose", count=np.size(placed[1][0]))
        if unfit := unfit_constraint(self.rows, x, body, label):
            raise unfit
        jacobian = methodcaller("jacobian", x, body)
        for _ in range(2):  # the second step corrects the rounding of the first
            rates = [dot(jacobian(r), velocity) for r in self.rows]
            lacking = tuple(p - rate for p, rate in zip(prescribed, rates, strict=True))
            change = solve(body, x.q, self.rows, jacobian, lacking, AT_REST)
            velocity = add(velocity, change.turning + change.moving)
        _, projected = SE3.to_user_axes(parameters, placed, velocity)
        return assembled(projected)


def as_mechanism(model: Model, **elements: Any) -> Mechanism:
    """Return a model's bodies and joints as a mechanism with these elements.

    The link of a single body is named BODY.
    """
    if isinstance(model, Mechanism):
        return Mechanism(model.links, model.loops, **elements)
    assert isinstance(model, Problem)
    return Mechanism(Link(BODY, model.body, model.joint), **elements)


def _stout(body: BodyConstants, length: Any) -> BodyConstants:
    """Return the body with a radius of gyration of at least LEAST_GYRATION · length."""
    least = body.mass * (LEAST_GYRATION * length) ** 2
    trace = body.inertia[0] + body.inertia[4] + body.inertia[8]
    added = where(trace < least, least, 0.0 * least)
    return body._replace(inertia=add(body.inertia, diagonal((added, added, added))))

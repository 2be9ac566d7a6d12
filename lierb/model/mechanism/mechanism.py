"""Mechanism: rigid bodies in a tree of joints, with closed loops."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import LeftOutWarning, LierbError
from lierb.kernels.systems.plan import UNSTABILISED, MechanismPlan
from lierb.model.files import mujoco as model_files
from lierb.model.formulation import Formulation
from lierb.model.mechanism.branches import assemblies_at
from lierb.model.mechanism.closing import Mobility, closed, mobility, projected
from lierb.model.mechanism.holding import closed_at, projected_at
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.links import ByLink, Hold, Link, Loop, Site
from lierb.model.mechanism.plan import formulation_of, mechanism_plan_of
from lierb.model.mechanism.regularity import require_regular
from lierb.model.mechanism.start_checks import immobile, start_of_mechanism, violation_of
from lierb.support.arrays import Array, as_number, finite


class Mechanism(TreeKinematics):
    """Bodies, joints between them, and forces on them.

    Every argument of every link may be batched. Poses and twists are dictionaries by link: C in the
    ground frame, (4, 4) or (n, 4, 4), and V body-fixed, (6,) or (n, 6). The method `on` of forces
    and other elements sets where they act, `.on(link)` or `.on(link, other)`; it is optional if
    there is only one link.

    Parameters
    ----------
    links : Link or iterable of Link
        Links in any order; a link's parent may come after it.
    loops : Loop or iterable of Loop, optional
        Joints that close loops.
    gravity : array_like, shape (3,) or (n, 3), optional
        Acceleration of gravity in the ground frame, m/s². Default: none.
    forces : Force or iterable of Force, optional
        Forces made by `lierb.forces` and `lierb.wrench`.
    constraints : Constraint or iterable of Constraint, optional
        Constraints made by `lierb.constraint` and `lierb.velocity_constraint`.
    observables : Observable or iterable of Observable, optional
        Columns of the results, made by `lierb.observable`.
    events : Event or iterable of Event, optional
        Crossings of zero to be located, made by `lierb.event`.
    states : ExtraStates or iterable of ExtraStates, optional
        Further states, made by `lierb.states` and integrated with those of the mechanism.
    controllers : Controller or iterable of Controller, optional
        Sampled controllers, made by `lierb.controller`.
    sites : mapping of str to Site, optional
        Named frames of links, which have no effect on the motion: `(link, pose, point)` of each.
        `from_mjcf` and `from_urdf` read them.
    ground_motion : ground motion or callable, optional
        Displacement of the ground: made by a function decorated by `lierb.ground_motion`, or a
        function of t in s that returns (3,) in m. All results are relative to the moving ground.
        Default: the ground is at rest.

    Raises
    ------
    ArgumentError
        The links do not form a tree, or a link that is named does not exist.
    ForceError
        A force acts about a joint axis that does not exist, or a function uses states or controls
        that the mechanism does not have.

    Examples
    --------
    >>> import lierb
    >>> import numpy as np
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

    # ---- from files ------------------------------------------------------------------------------

    @classmethod
    def from_mjcf(
        cls,
        path: Any,
        *,
        base: str | None = None,
        frames: str = "file",
        merge_fixed: bool = False,
        limit_stiffness: float | None = None,
    ) -> Mechanism:
        """Read the mechanism of an MJCF file, MuJoCo's format.

        Bodies keep their names. Hinge, slide, ball and free joints become joints of the catalogue;
        several on one body become the joint that combines them, such as universal, if their springs
        and couplings can act about its axes. Otherwise they stay separate, with links without mass
        between them.
        A link without mass or inertia has 1e-12 of what hangs on it.
        `equality/connect` and `weld` become loops, `equality/joint` gears. Springs and dampers of
        joints that keep their axis become forces. A state `turned_LINK`, made by `lierb.turns`,
        counts the turns of a hinge with a spring, unless stops keep it within 2.5 rad of its slack
        angle, and of a hinge with stops more than 5 rad apart, or whose middle is more than 2.5 rad
        from qpos0. `pose()` is the pose at qpos0. A LeftOutWarning
        lists the elements that are left out: contacts, friction, actuators, tendons and others.
        Requires mujoco (the extra `lierb[mjcf]`).

        Parameters
        ----------
        path : path
            The file. Paths of included files and meshes are relative to it.
        base : {"free", "fixed"}, optional
            With "free", bodies that the file puts on the ground without a joint, and that carry
            bodies with joints, move freely; if no body has a joint, those with a mass. Others, such
            as a floor or a mocap body, stay part of the ground. With "fixed", free joints on the
            ground are removed. Default: as in the file.
        frames : {"file", "centre"}, optional
            With "centre", body frames are moved to the centres of mass, as cspace="SO3xR3" needs
            them; their axes stay. Default: those of the file.
        merge_fixed : bool, optional
            Merge bodies that are welded to each other into one link, instead of one link for each,
            on a fixed joint. A welded body without mass, or with an inertia that no rigid body has,
            is always merged with its parent. A body that is welded to the world is the ground.
        limit_stiffness : float, optional
            Stiffness of stops at the limits of hinges, N m/rad, and slides, N/m; with None,
            limits are left out. In MuJoCo stiffness depends on the mass at a stop.

        Returns
        -------
        Mechanism
            The mechanism.

        Raises
        ------
        ArgumentError
            MuJoCo refuses the file; a moving link has an inertia that no rigid body has; or a link
            without mass or inertia can move without what hangs on it.
        MissingExtraError
            MuJoCo is not installed.
        """
        return cls._of_file(path, "MJCF", None, merge_fixed, limit_stiffness, base, frames)

    @classmethod
    def from_urdf(
        cls,
        path: Any,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        base: str | None = None,
        frames: str = "file",
        merge_fixed: bool = False,
        limit_stiffness: float | None = None,
    ) -> Mechanism:
        """Read the mechanism of a URDF file; its root link is the ground, unless base="free".

        Revolute and continuous, prismatic, fixed, planar and floating joints are read by MuJoCo's
        compiler, as in `from_mjcf`. Mimics become gears.

        Parameters
        ----------
        path : path
            The file. Meshes are not read: masses are those in <inertial>.
        gravity : array_like, shape (3,) or (n, 3), optional
            Acceleration of gravity, m/s², which URDF does not have.
        base : {"free", "fixed"}, optional
            With "free" the root floats. Default, and "fixed": it is the ground.
        frames : {"file", "centre"}, optional
            With "centre", body frames are moved to the centres of mass, as in `from_mjcf`.
        merge_fixed : bool, optional
            Merge welded bodies into one link, as in `from_mjcf`.
        limit_stiffness : float, optional
            Stiffness of stops at the limits of joints, N m/rad or N/m; None leaves limits out.

        Returns
        -------
        Mechanism
            The mechanism.

        Raises
        ------
        ArgumentError
            MuJoCo refuses the file.
        MissingExtraError
            MuJoCo is not installed.
        """
        return cls._of_file(path, "URDF", gravity, merge_fixed, limit_stiffness, base, frames)

    @classmethod
    def _of_file(cls, path: Any, language: str, gravity: Any, *options: Any) -> Mechanism:
        parts = model_files.read(path, language, *options)
        if parts.left_out:
            warnings.warn(LeftOutWarning(path, parts.left_out), stacklevel=3)
        mechanism = cls(
            [Link(*link) for link in parts.links],
            [Loop(*loop) for loop in parts.loops],
            parts.gravity if gravity is None else gravity,
            parts.forces,
            states=parts.states,
            sites={name: Site(*placed) for name, placed in parts.sites.items()},
        )
        if parts.light:
            require_regular(mechanism, parts.light)
        return mechanism

    # ---- runs ------------------------------------------------------------------------------------

    def default_pose(self) -> dict[str, Array]:
        return self.pose()

    def formulation(
        self, *, cspace: Any, update: str, check: str, solver: str, stabilise: Any
    ) -> Formulation:
        return formulation_of(self, cspace, update, solver, stabilise)

    def plan(self, formulation: Formulation, **described: Any) -> MechanismPlan:
        stabilisation = formulation.stabilisation or UNSTABILISED
        return mechanism_plan_of(
            self, formulation.cspaces, stabilisation, formulation.solver, **described
        )

    def violation(
        self, pose0: Any, twist0: Any, t0: float = 0.0, number: int | None = None
    ) -> LierbError | None:
        with np.errstate(all="ignore"):
            start = start_of_mechanism(self, pose0, twist0, t0)
            return violation_of(start) or immobile(self, pose0)

    # ---- closing ---------------------------------------------------------------------------------

    def close(self, pose: ByLink, *, hold: Hold | None = None, t0: float = 0.0) -> dict[str, Array]:
        """Find poses near `pose` that close all joints and loops, by Newton's method.

        Every step is the motion of least kinetic energy that cancels the residuals, as in
        `lierb.Problem.close`; rows may be redundant. A pose that is already closed to rounding is
        returned unchanged. Redundant rows, such as those of a planar loop, agree only to the
        accuracy of the given points and axes: they may keep an error that `lierb.integrate` accepts
        at a start.

        Parameters
        ----------
        pose : dict
            Poses of all links, (4, 4) or (n, 4, 4).
        hold : dict, str or iterable of str, optional
            Prescribed coordinates of joints, by link, as for `Mechanism.pose`: numbers or arrays of
            n; or names of links whose joints keep the coordinates that they have in `pose`. The
            coordinates change from those of `pose` in steps of at most 0.1 rad, or a tenth of the
            mechanism's size, and each step is closed from the one before: so the assembly stays on
            its branch. Several coordinates change together, in equal steps; the poses in between
            must close, too. Angles go the shorter way, unless the mechanism has gears or screws,
            for which whole turns count. A motor of given position is ignored at a joint in `hold`.
        t0 : float, optional
            Time at which the positions of motors are evaluated, s.

        Returns
        -------
        dict of ndarray, shape (4, 4) or (n, 4, 4)
            Closed pose of each link.

        Raises
        ------
        ArgumentError
            The joint of a link in `hold` has no coordinates.
        PoseError
            The iteration does not converge; the message has the largest residual and its joint. Or
            a motor prescribes a position that is not finite.

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
        given, time = self.pose_arrays("pose", pose), as_number("t0", t0)
        with np.errstate(all="ignore"):  # with an overflow it does not converge
            poses = closed_at(self, given, hold, time) if hold else closed(self, given, time)
        return self._checked("the closed pose", poses)

    def assemblies(
        self,
        hold: ByLink | None = None,
        *,
        pose: ByLink | None = None,
        starts: int = 200,
        t0: float = 0.0,
    ) -> dict[str, Array]:
        """Search for all poses that close the loops at given coordinates of joints.

        All other joints start at random coordinates, which are the same in every call, and each
        start is closed as by `close`. Poses that agree to 1e-5 count as one assembly. The search
        may miss assemblies to which few starts lead; more starts find more of them. To follow one
        assembly to other coordinates, use `close`.

        Parameters
        ----------
        hold : dict, optional
            Coordinates of joints by link, as in `close`, of one mechanism. They must leave no
            freedom.
        pose : dict, optional
            Poses of all links, from which distances are measured. Default: all coordinates 0.
        starts : int, optional
            Number of random starts.
        t0 : float, optional
            Time at which the positions of motors are evaluated, s.

        Returns
        -------
        dict of ndarray, shape (k, 4, 4)
            Poses of each link in the k assemblies, the nearest to `pose` first.

        Raises
        ------
        ArgumentError
            The mechanism is a batch or has gears, or the links can still move.
        PoseError
            No start leads to a closed pose.

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
        >>> both = truss.assemblies()
        >>> truss.coordinates(both)["bar"].round(6).tolist()  # −π/6 and −5π/6
        [[-0.523599], [-2.617994]]
        """
        near = self.pose() if pose is None else pose
        arrays = dict(zip(self.names, self.pose_arrays("pose", near), strict=True))
        with np.errstate(all="ignore"):
            poses = assemblies_at(self, hold, arrays, starts, as_number("t0", t0))
        return self._checked("the closed pose", poses)

    def project(
        self,
        twist: ByLink,
        pose: ByLink | None = None,
        *,
        hold: Hold | None = None,
        t0: float = 0.0,
    ) -> dict[str, Array]:
        """Return the nearest twists that satisfy joints and loops, in the kinetic-energy metric.

        The projection changes given rates too: if only the crank of a four-bar has a rate, its
        projected rate depends on the links' masses. `hold` fixes rates of joints.

        Parameters
        ----------
        twist : dict
            Body-fixed twists of all links, (6,) or (n, 6).
        pose : dict, optional
            Poses of all links. Default: all coordinates 0.
        hold : dict, str or iterable of str, optional
            Prescribed rates of joints, by link, as for `Mechanism.twist`: numbers or arrays of n;
            or names of links whose joints keep the rates that they have in `twist`.
        t0 : float, optional
            Time at which the speeds and positions of motors are evaluated, s.

        Returns
        -------
        dict of ndarray, shape (6,) or (n, 6)
            V − M⁻¹Jᵀ(J M⁻¹Jᵀ)⁺ (J V − prescribed), of all links together.

        Raises
        ------
        TwistError
            No twist satisfies the rates prescribed by motors and by `hold`.
        ArgumentError
            The joint of a link in `hold` has no coordinates.

        Examples
        --------
        >>> import lierb
        >>> box = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0)
        >>> pair = lierb.Mechanism([
        ...     lierb.Link("a", box, lierb.joints.free()),
        ...     lierb.Link("b", box, lierb.joints.fixed(), parent="a"),
        ... ])
        >>> twist0 = pair.project({"a": (0, 0, 0, 1.0, 0, 0), "b": (0, 0, 0, 0.0, 0, 0)})
        >>> twist0["b"].round(9).tolist()
        [0.0, 0.0, 0.0, 0.5, 0.0, 0.0]
        """
        poses = self.pose_arrays("pose", self.pose() if pose is None else pose)
        twists = self.twist_arrays("twist", twist)
        with np.errstate(all="ignore"):
            time = as_number("t0", t0)
            if hold:
                nearest = projected_at(self, twists, poses, hold, time)
            else:
                nearest = projected(self, twists, poses, time)
        return self._checked("the projected twist", nearest)

    def _checked(self, what: str, arrays: list[Array]) -> dict[str, Array]:
        pairs = zip(self.names, arrays, strict=True)
        return {name: finite(f"{what} of {name}", array) for name, array in pairs}

    def freedoms(self, pose: ByLink | None = None) -> Mobility:
        """Count the degrees of freedom of joints and loops at a pose, and redundant rows.

        Parameters
        ----------
        pose : dict, optional
            Closed poses of all links. Default: all coordinates 0.

        Returns
        -------
        Mobility
            `freedoms` and `redundant`, integers or (n,). Motors are not counted.

        Examples
        --------
        >>> import lierb
        >>> wheel = lierb.Link("wheel", lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.revolute())
        >>> bearing = lierb.Loop("bearing", lierb.joints.revolute(), "wheel")
        >>> lierb.Mechanism(wheel, bearing).freedoms()
        Mobility(freedoms=1, redundant=5)
        """
        poses = self.pose_arrays("pose", self.pose() if pose is None else pose)
        with np.errstate(all="ignore"):
            return mobility(self, poses)

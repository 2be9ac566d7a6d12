"""The protocol of a system is the interface that steppers, loops and results use.

Numbers are floats, arrays, lanes of a pack or duals, of one type in each call. n is 6 for one body,
and 6 times the number of nodes for a mechanism.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

from lierb.kernels.functions.signals import Noise
from lierb.kernels.mechanics.kinks import Bound
from lierb.kernels.mechanics.tree import Connection
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.layout import Columns
from lierb.kernels.systems.measures import Observed
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import Factors, Rates, Slopes, Stabilised, State, Units, Weights

Body = TypeVar("Body")
Motion = TypeVar("Motion")


class System(Protocol[Body, Motion]):
    """A system is one body on a joint, or a mechanism.

    Body : its constants, in joint axes.   Motion : poses and velocities at one time.
    """

    # ---- constants of the plan ----

    @property
    def plan(self) -> AnyPlan: ...
    @property
    def links(self) -> int:
        """Return the number of links."""

    @property
    def joints(self) -> tuple[Connection, ...]:
        """Return the joints whose errors have separate columns."""

    @property
    def inputs(self) -> Columns:
        """Columns of a trajectory's inputs; a state to continue from comes last."""

    @property
    def state(self) -> Columns:
        """Return the columns of a state, in the order of its numbers."""

    @property
    def invariant(self) -> tuple[int, ...]:
        """Return the components of V that stay exactly zero if they are zero."""

    @property
    def is_homogeneous(self) -> bool:
        """Return whether the rates of s V under s² times gravity are s Ẋ and s² V̇, for any s."""

    @property
    def is_light(self) -> bool:
        """Return whether a step is so simple that registers hold two packs of its numbers."""

    @property
    def takes_small_angle_steps(self) -> bool:
        """Return whether a second kernel, for small-angle steps without branches, pays."""

    # ---- start ----

    def body(self, numbers: list[Any]) -> Body:
        """Return the constants in joint axes, from the numbers of all inputs but a state (SI)."""

    def placed(self, body: Body, numbers: list[Any]) -> Any:
        """Part of a start that depends on the pose only, not on the twist."""

    def start(self, body: Body, placed: Any, numbers: list[Any]) -> State:
        """Return the state at the start, from poses and twists in the user's frames."""

    def state_of(self, numbers: Sequence[Any], body: Body | None = None) -> State:
        """Return the state from concatenated numbers, with the structural zeros of the plan."""

    def pose_check(self, numbers: list[Any], time: Any) -> Any:
        """Part of the check of a start that depends on the pose only.   time : s."""

    def is_on_joint(self, check: Any, numbers: list[Any], time: Any) -> Any:
        """1 where the start satisfies the joint's rows within the tolerances, else 0."""

    # ---- steps ----

    def chart_gravity(self, body: Body, chart: Any) -> Any:
        """Return gravity in the axes of C₀, (3,) m/s², for all stages on one chart; or None."""

    def rates(self, body: Body, state: State, gravity: Any, time: Any) -> Rates:
        """Return the rates at C₀ exp X.   gravity : see `chart_gravity`.   time : s."""

    def stage_rates(
        self, body: Body, state: State, gravity: Any, time: Any, stage: int = 0
    ) -> Rates:
        """Return the rates at C₀ exp X, including those of the extra states.

        stage : index in `Slopes`.
        """

    def combine(
        self,
        body: Body,
        state: State,
        weights: Weights,
        slopes: Slopes,
        units: Units,
        factors: Factors | None = None,
    ) -> State:
        """Add h Σ weights · slopes to X (n,), V or μ (n,), work and extra states; C₀ stays.

        factors : rows of weights, one for each exponential of the pose; None for X alone.
        """

    def move(self, body: Body, state: State) -> State:
        """Move C₀ by exp X: always in a local update; in a global one, where X is large.

        In an ambient update move C₀ by (1 + Y)/‖1 + Y‖.
        """

    def tidied(self, body: Body, chart: Any) -> Any:
        """Remove rounding: normalise quaternions, put screw joints on their subgroup."""

    def stabilised(self, body: Body, before: State, state: State, time: Any, h: Any) -> Stabilised:
        """Project a state onto its constraints.   before : state h seconds earlier.   time : s."""

    def silenced(self, body: Body, v_or_mu: Vec, alive: Any) -> Vec:
        """Set V or μ to NaN where a trajectory is not alive; the pose follows in the next step."""

    # ---- independent numbers ----

    @property
    def free(self) -> tuple[int, ...]:
        """Return the components of X, and of V or μ, that are independent."""

    def completed(self, body: Body, v_or_mu: Vec) -> Vec:
        """Complete V or μ (n,) with the components that follow from the independent ones."""

    # ---- error control ----

    def in_algebra(self, body: Body, x: Vec) -> Vec:
        """Return X (n,) with the structural zeros of the joints' subalgebras; Y as it is."""

    def turning_and_moving(self, x: Vec) -> tuple[Vec, Vec]:
        """Return the parts that turn and that displace of a sum of slopes of X or Y, concatenated.

        The length of such a part is that of its motion, rad or m.
        """

    def velocity(self, body: Body, v_or_mu: Vec) -> Vec:
        """Return V (n,), rad/s and m/s, from V or μ."""

    def places(self, chart: Any) -> Vec:
        """Return the positions of the chart, m, concatenated."""

    def turns_and_places(self, chart: Any) -> tuple[Vec, Vec]:
        """Return numbers that are finite if all rotations are, and positions, m."""

    def angular_speeds_squared(self, body: Body, state: State) -> list[Any]:
        """Return ‖ω‖² of each node, rad²/s²."""

    # ---- measures ----

    def motion(self, body: Body, state: State, time: Any, is_next: bool = False) -> Motion:
        """Return poses and velocities, from which measures, elements and events are computed.

        is_next : whether the state is the end of a step, if states are in memory.
        """

    def dropped(self, body: Body, state: State) -> Any:
        """Return the number of rows that depend on others."""

    def measured(
        self, body: Body, state: State, motion: Motion, time: Any, first_energy: Any = ...
    ) -> Observed:
        """Return every measure's value or square.   first_energy : energy at the start, J."""

    def in_user_frames(self, body: Body, numbers: list[Any], state: State) -> list[Vec]:
        """Return R (9,) row by row, r (3,), ω (3,), v (3,) of every link, in the user's frames."""

    def forces(self, body: Body, state: State, time: Any) -> tuple[Vec, list[Vec]]:
        """Return all rows' λ, and every joint's wrench (6,) on its body, about its frame there."""

    # ---- passive elements; see `lierb.kernels.systems.signals.PassiveElements` ----

    def travel(
        self, body: Body, start: Motion, end: Motion, time: Any, h: Any, watched: type | None
    ) -> tuple[Bound, ...]: ...
    def jumps(self, body: Body) -> tuple[Any, ...]: ...
    def observed(self, body: Body, motion: Motion, time: Any) -> tuple[Any, ...]: ...
    def events(self, body: Body, motion: Motion, time: Any) -> tuple[Any, ...]: ...
    def events_nearby(self, body: Body, motion: Motion, time: Any) -> tuple[Any, ...]: ...
    def state_rates(self, body: Body, motion: Motion, time: Any) -> Vec: ...
    def initial_states(self, body: Body, state: State) -> Vec: ...
    def initial_memory(self, body: Body) -> Vec: ...
    def periods(self, body: Body) -> Vec: ...
    def controlled(
        self, body: Body, motion: Motion, time: Any, which: int, noise: Noise
    ) -> tuple[Vec, Vec]: ...


AnySystem = System[Any, Any]

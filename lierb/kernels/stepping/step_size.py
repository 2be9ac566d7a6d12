"""Step-size control of a lane: the error of a step relative to its tolerances, and the next step.

Errors are those of an embedded method, in the Lie algebra, in blocks: rotation, position, ω, v, and
each extra state. The square of a block's error is compared with atol² + rtol² ‖y‖², where ‖y‖ is
the block's own size, 1 rad for a rotation; the largest block counts. Control is PI, as in Hairer,
Nørsett, Wanner, Solving ODEs I, II.4 and IV.2, by logarithms of squares.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from lierb.kernels.mechanics.scale import START_TOLERANCE
from lierb.kernels.numbers.arithmetic import fma, maximum, minimum, sqrt, where
from lierb.kernels.numbers.vec import Vec, dot, sub
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.method import Defect
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.combine import weighted
from lierb.kernels.systems.extra_states import in_states
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import Rates, Slopes, Stabilised, State, Units, Weights
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.words import rough_exp2, rough_log2

EPS = 2.0**-52
SAFETY = 0.8
SHRINKS, GROWS = 0.2, 6.0  # limits of the factor from one step to the next
DAMPING = 0.1  # of PI control: β = 0.1 / k, α = 1 / k − 0.75 β
LEAST_REMEMBERED = -26.0  # log₂ of a squared error: 1e-8
SMALLEST, LARGEST = 1e-20, 1e60  # a squared error is clipped to these limits
LEAST_ULPS = 16.0  # least step, in units of the rounding of time
# Relative rounding of the effect of gravity on v and on a position in a step; methods of high order
# have weights of 50 and more.
ROUNDED_V, ROUNDED_PLACE = 64.0 * EPS, 1024.0 * EPS
# Relative error of a start's twist and pose: the start's tolerance times the rows' amplification.
ADMITTED = 1e3 * START_TOLERANCE
# A step is too rough for its error estimate if the rate of one stage, applied to the whole step,
# changes a velocity by ROUGH times its size and moves the pose by THROW, in rad or in radii of
# gyration. Its squared error is then at least ROUGH_ERROR.
ROUGH, THROW, ROUGH_ERROR = 2.0, 1e-3, 1e6
INF = float("inf")
DOP853_MIX = 0.01  # weight of E₃² in the error of a method with two estimates (dop853.f)


class Tolerances(NamedTuple):
    """Hold the tolerances and limits of steps.

    dt : length of the first adaptive step, 0 to choose it, or of all fixed steps, s.
    rtol, …_atol : tolerances of each block, rad, m, rad/s, m/s, and units of the extra states.
    position_is_own, v_is_own : 1 if atol is in units of the radius of gyration instead of m.
    dt_min, dt_max : s.   max_steps : accepted and rejected steps.
    """

    dt: float
    rtol: float
    rotation_atol: float
    position_atol: float
    omega_atol: float
    v_atol: float
    states_atol: float
    dt_min: float
    dt_max: float
    max_steps: float
    position_is_own: float
    v_is_own: float


def within(h: Any, limits: Tolerances) -> Any:
    """Return the step length nearest to h within the limits, s."""
    return maximum(minimum(h, limits.dt_max), limits.dt_min)


def squared_error(
    plan: AnyPlan, body: Any, state: State, moved: State, slopes: Slopes, h: Any, limits: Any
) -> Any:
    """Return the square of a step's error, relative to its tolerance."""
    scales = _scales(plan, body, state, moved, limits, h)
    estimates = [*_estimates(plan, body, slopes, h, scales)]
    if plan.does_work and plan.prescribes_motion:
        of_work = _estimates_of_work(plan, state, moved, slopes, h, limits)
        estimates = [*map(maximum, estimates, of_work)]
    error = estimates[0]
    if len(estimates) > 1:
        fine, coarse = estimates  # err² = e₅⁴ / (e₅² + 0.01 e₃²)
        total = fma(DOP853_MIX, coarse, fine)
        error = where(total > 0.0, fine * fine / where(total > 0.0, total, 1.0), fine)
    if plan.is_explicit and any(element.bounds_steps for element in plan.acting):
        is_rough = _is_rough(plan, body, state, moved, slopes, h)
        error = where(is_rough, maximum(error, ROUGH_ERROR), error)
    return error


def _estimates(plan: AnyPlan, body: Any, slopes: Slopes, h: Any, scales: _Scales) -> Iterator[Any]:
    """Yield the squares of a step's error estimates."""
    if not plan.is_looped:
        for defect in method_of(plan).defects(system_of(plan), body, slopes, h):
            yield _largest(plan, body, defect, scales)
        return
    assert plan.method.embedded is not None
    for row in plan.method.embedded.weights:
        weights = {j: h * weight for j, weight in enumerate(row) if weight != 0.0}
        squares = in_memory(plan).slope_squares(body, weights)
        states = weighted((ZERO,) * len(slopes.states[0]), row, slopes.states, h)
        yield _largest_of(body, squares, _squares_of(plan, states), scales)


def _estimates_of_work(
    plan: AnyPlan, state: State, moved: State, slopes: Slopes, h: Any, limits: Tolerances
) -> Iterator[Any]:
    """Yield the squares of the error estimates of the work.

    They are for motors of given motion: no force changes that motion, so that an error of the work,
    as at a stop, has no other effect.
    """
    assert plan.method.embedded is not None
    change = moved.work - state.work
    size = maximum(moved.work * moved.work, maximum(state.work * state.work, change * change))
    allowed = limits.rtol * limits.rtol * size
    for row in plan.method.embedded.weights:
        (off,) = weighted((ZERO,), row, slopes.work, h)
        yield where(allowed > 0.0, off * off / where(allowed > 0.0, allowed, 1.0), 0.0)


def _is_rough(plan: AnyPlan, body: Any, state: State, moved: State, slopes: Slopes, h: Any) -> Any:
    """Return whether the force at a stage would change a velocity by far more than the step does.

    A stage far inside a stiff stop moves the next stages out of it. Methods of high order have zero
    weights for their first stages; the stop then affects neither the step nor its error estimate.
    """
    if plan.is_looped:
        return in_memory(plan).is_rough(body, len(slopes.x), h, ROUGH, THROW)
    velocity = system_of(plan).velocity
    before, after = (velocity(body, each.v_or_mu) for each in (state, moved))
    first, *rest = slopes.v_or_mu
    changes = [velocity(body, tuple(h * x for x in sub(rate, first))) for rate in rest]
    rough: Any = h < 0.0  # never
    for i in range(0, len(before), 3):
        part = slice(i, i + 3)
        speed = maximum(dot(before[part], before[part]), dot(after[part], after[part]))
        throw = THROW * THROW * (1.0 if i % 6 == 0 else body.girth)
        for change in changes:
            square = dot(change[part], change[part])
            if not is_zero(square):
                is_fast = square > ROUGH * ROUGH * speed
                rough = rough | (is_fast & (h * h * square > throw))
    return rough


def squared_correction(
    plan: AnyPlan, body: Any, state: State, kept: Stabilised, h: Any, limits: Any, is_first: Any
) -> Any:
    """Return the square of a stabilisation's correction of pose and V, relative to the tolerance;
    structurally zero without stabilisation.

    The exact motion satisfies the rows, and projection is at most the distance to it. The
    correction is therefore a part of the step's error that the embedded method does not estimate.
    Near a singular pose a small singular value amplifies it, and it dominates the error.

    is_first : mask of first steps, which also correct the residual of a start.
    """
    if not kept.x:
        return ZERO
    rtol = where(is_first, limits.rtol + ADMITTED, limits.rtol)
    scales = _scales(plan, body, state, kept.state, limits._replace(rtol=rtol), h)
    states = (ZERO,) * len(state.states)
    if plan.is_looped:  # squares
        return _largest_of(body, (*kept.x, *kept.v_or_mu), _squares_of(plan, states), scales)
    turning, moving = (_parts(kept.x, first) for first in (0, 3))
    return _largest(plan, body, Defect(turning, moving, kept.v_or_mu, states), scales)


class _Scales(NamedTuple):
    """Reciprocal of the squared tolerance of each block; `states` has one for each extra state."""

    rotation: Any
    position: Any
    omega: Any
    v: Any
    states: tuple[Any, ...]


def _scales(
    plan: AnyPlan, body: Any, state: State, moved: State, limits: Tolerances, h: Any = ZERO
) -> _Scales:
    """Return the scales of a step, from the larger of a block's sizes at both ends.

    If atol is in radii of gyration, the tolerance is at least the rounding of the weight and of a
    force that supports it: for a small body this exceeds its radius.
    """
    ends = [_sizes(plan, body, each, is_next=each is not state) for each in (state, moved)]
    rtol = limits.rtol * limits.rtol

    def allowed(atol: Any, *sizes: Any, unit: Any = 1.0, least: Any = ZERO) -> Any:
        largest = sizes[0]
        for size in sizes[1:]:
            largest = maximum(largest, size)
        return 1.0 / (fma(atol * atol, unit, rtol * largest) + least)

    def unit(is_own: Any) -> Any:  # squared
        return where(is_own > 0.5, body.girth, 1.0)

    falls = h * h * dot(body.gravity, body.gravity)
    atols = (
        (
            limits.position_atol, unit(limits.position_is_own),
            limits.position_is_own * ROUNDED_PLACE**2 * (h * h * falls),
        ),
        (limits.omega_atol, 1.0, ZERO),
        (limits.v_atol, unit(limits.v_is_own), limits.v_is_own * ROUNDED_V**2 * falls),
    )  # fmt: skip
    places, turning, moving = (
        allowed(atol, *(end[i] for end in ends), unit=size, least=least)
        for i, (atol, size, least) in enumerate(atols)
    )
    states = tuple(
        allowed(limits.states_atol, *pair) for pair in zip(*(e[3] for e in ends), strict=True)
    )
    return _Scales(allowed(limits.rotation_atol, 1.0), places, turning, moving, states)


def _sizes(
    plan: AnyPlan, body: Any, state: State, is_next: bool = False
) -> tuple[Any, Any, Any, tuple[Any, ...]]:
    """Return ‖y‖² of position, ω, v, and of each extra state.

    is_next : whether the state is the end of a step, for a looped plan.
    """
    if plan.is_looped:
        return *in_memory(plan).sizes(body, is_next), _squares_of(plan, state.states)
    system = system_of(plan)
    place = system.places(state.chart)
    twist = system.velocity(body, state.v_or_mu)
    states = _squares_of(plan, state.states)
    return dot(place, place), _squares(twist, 0), _squares(twist, 3), states


def _squares(sixes: Vec, first: int) -> Any:
    """Return ‖·‖² of the angular (first = 0) or linear parts (3) of concatenated twists."""
    parts = _parts(sixes, first)
    return dot(parts, parts)


def _parts(sixes: Vec, first: int) -> Vec:
    """Return the angular (first = 0) or linear parts (3) of concatenated twists."""
    return tuple(x for i in range(first, len(sixes), 6) for x in sixes[i : i + 3])


def _largest(plan: AnyPlan, body: Any, defect: Defect, scales: _Scales) -> Any:
    """Return the largest ‖e‖² · scale of all blocks; NaN where one is NaN."""
    squares = (
        dot(defect.turning, defect.turning), dot(defect.moving, defect.moving),
        _squares(defect.twist, 0), _squares(defect.twist, 3),
    )  # fmt: skip
    return _largest_of(body, squares, _squares_of(plan, defect.states), scales)


def _squares_of(plan: AnyPlan, states: Vec) -> Vec:
    """Return ‖·‖² of each extra state."""
    return tuple(dot(part, part) for part in in_states(plan, states))


def _largest_of(body: Any, squares: Vec, states: Vec, scales: _Scales) -> Any:
    """Return the largest ‖e‖² · scale, from the squares of rotation, position, ω, v and states."""
    pairs = [*zip(squares, scales[:4], strict=True), *zip(states, scales.states, strict=True)]
    largest: Any = ZERO
    for square, scale in pairs:
        if not is_zero(square):
            # 0 / 0 counts as no error; 1 / 0, with atol = 0, as an infinite one.
            ratio = where(square == 0.0, 0.0, square * scale)
            largest = ratio if is_zero(largest) else where(ratio <= largest, largest, ratio)
    return 0.0 * body.mass if is_zero(largest) else largest


# ---- the next step -----------------------------------------------------------------------------


class Change(NamedTuple):
    """Hold the factor from the step tried to the next one, and log₂ of the squared error."""

    factor: Any
    level: Any


def change(plan: AnyPlan, square: Any, before: Any, accepted: Any) -> Change:
    """Return the change of the step length, by PI control.

    square : square of the error; ∞ if it is NaN.   before : level of the step before.
    accepted : mask of accepted steps.

    Approximate logarithms change a step by 0.4 % at most.
    """
    k = _power_of(plan)
    beta = DAMPING / k
    level = rough_log2(minimum(maximum(square, SMALLEST), LARGEST))
    longer = 0.5 * (beta * before - (1.0 / k - 0.75 * beta) * level)
    shorter = (-0.5 / k) * level
    factor = SAFETY * rough_exp2(where(accepted, longer, shorter))
    most = where(accepted, GROWS, SAFETY)
    return Change(minimum(maximum(factor, SHRINKS), most), maximum(level, LEAST_REMEMBERED))


def _power_of(plan: AnyPlan) -> int:
    """Return the power of h in the error."""
    assert plan.method.embedded is not None
    return plan.method.embedded.order + 1


def first_step(
    plan: AnyPlan, body: Any, state: State, time: Any, length: Any, limits: Tolerances
) -> Any:
    """Return the first step, s, by Hairer's choice (Solving ODEs I, II.4): a hundredth of a block's
    size over its rate, then an Euler step to estimate how fast that rate changes.

    length : of the run, s.
    """
    scales = _scales(plan, body, state, state, limits)
    system = system_of(plan)
    falling = system.chart_gravity(body, state.chart)

    def moved(h: Any, weights: Weights, slopes: Slopes) -> State:
        return system.combine(body, state, weights, slopes, Units(0.5 * h, h, h))

    still = moved(length, (), Slopes())
    start = system.stage_rates(body, still, falling, time)
    size = _size_against(plan, body, state, scales)
    speed = _rate_against(plan, body, start, scales, {0: 1.0})
    tiny = (size < 1e-10) | (speed < 1e-10)
    guess = where(tiny, 1e-6 * length, 0.01 * sqrt(size / where(tiny, 1.0, speed)))
    guess = minimum(guess, length)
    euler = moved(guess, (1.0,), Slopes().with_stage(start))
    there = system.stage_rates(body, euler, falling, time + guess, 1)
    x, v_or_mu = sub(there.x, start.x), sub(there.v_or_mu, start.v_or_mu)
    change = Rates(x, v_or_mu, ZERO, states=sub(there.states, start.states))
    bend = _rate_against(plan, body, change, scales, {0: -1.0, 1: 1.0}) / (guess * guess)
    largest = maximum(speed, bend)
    at_rest = largest < 1e-30
    level = rough_log2(minimum(maximum(1e-4 / where(at_rest, 1.0, largest), 1e-200), 1e200))
    wanted = rough_exp2((0.5 / _power_of(plan)) * level)
    wanted = where(at_rest, maximum(1e-6 * length, guess * 1e-3), wanted)
    wanted = minimum(100.0 * guess, wanted)
    # NaN gives the whole length, which the trial judges. Tolerances of 0 give 0, which grows.
    return where(wanted < length, maximum(wanted, 1e-12 * length), length)


def _size_against(plan: AnyPlan, body: Any, state: State, scales: _Scales) -> Any:
    """Return the largest ‖y‖² · scale of all blocks; a rotation's size is 1 rad."""
    place, turning, moving, states = _sizes(plan, body, state)
    largest: Any = scales.rotation
    for square, scale in zip(
        (place, turning, moving, *states), (*scales[1:4], *scales.states), strict=True
    ):
        if not is_zero(square):
            largest = maximum(largest, where(square == 0.0, 0.0, square * scale))
    return largest


def _rate_against(
    plan: AnyPlan, body: Any, rates: Rates, scales: _Scales, stages: dict[int, float]
) -> Any:
    """Return the largest ‖k‖² · scale of all blocks.

    stages : weights of the stages whose sum the rates are, for a looped plan.
    """
    if plan.is_looped:
        squares = in_memory(plan).slope_squares(body, stages)
        return _largest_of(body, squares, _squares_of(plan, rates.states), scales)
    system = system_of(plan)
    twist = system.velocity(body, rates.v_or_mu)
    defect = Defect(*system.turning_and_moving(rates.x), twist, rates.states)
    return _largest(plan, body, defect, scales)

"""States, controllers and events as kernels have them, asked in plain Python on floats."""

from __future__ import annotations

import numpy as np
import pytest

from kernels.controlled_body import (
    ATTITUDE,
    ELEMENTS,
    FILTERED,
    GAIN,
    HELD,
    HELD_LAMP,
    INTEGRAL,
    LAMP,
    LEVEL,
    MEMORY,
    NOISE,
    OMEGA,
    PLACE,
    PLAN,
    SIGNALS,
    STATES,
    STEPS,
    SYSTEM,
    TAU,
    TIME,
    TORQUE,
    WANTED,
    WHEEL,
    V,
    body,
    made,
    seen,
)
from kernels.packs import FORMULAS, on_lanes
from lierb.kernels.functions.noise import normals
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.functions.trials import outputs_of, trial
from lierb.kernels.systems import signals as sides
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.one_body import BodyMotion
from lierb.kernels.systems.plan import MechanismPlan


def test_shapes_of_plan_are_in_the_order_of_elements():
    assert sides.states_of(PLAN) == STATES
    assert sides.outputs_of(PLAN) == (*LAMP, *TORQUE)
    assert sides.memory_of(PLAN) == MEMORY
    assert sides.memory_slices(PLAN) == (slice(0, 0), slice(0, 3))
    assert sides.output_slices(PLAN) == (slice(0, 1), slice(1, 5))


def test_initial_values_and_periods_are_the_parameters():
    assert SYSTEM.initial_states(body(), None) == (11.0, 12.0, 13.0, 14.0)
    assert SYSTEM.initial_memory(body()) == (21.0, 22.0, 23.0)
    assert SYSTEM.periods(body()) == (0.2, 0.1)


def test_state_rates_are_in_declared_order():
    expected = (*(-x for x in HELD), (OMEGA[2] - FILTERED) / TAU)
    np.testing.assert_allclose(SYSTEM.state_rates(body(), seen(), TIME), expected, rtol=1e-15)


def test_events_see_held_outputs():
    np.testing.assert_allclose(SYSTEM.events(body(), seen(), TIME), [PLACE[2] + V[0] - HELD_LAMP])


def test_controlled_gives_outputs_and_memory_of_one_controller():
    outputs, memory = SYSTEM.controlled(body(), seen(), TIME, 1, NOISE)
    error = OMEGA - WANTED + 1e-3 * np.array(normals(NOISE, "gyro", 3))
    integral = np.array(INTEGRAL) + error
    torque = -GAIN * error - 0.1 * integral - 0.01 * np.array(WHEEL)
    np.testing.assert_allclose(outputs, (*torque, TIME + HELD_LAMP), rtol=1e-14)
    np.testing.assert_allclose(memory, integral, rtol=1e-14)
    assert SYSTEM.controlled(body(), seen(), TIME, 0, NOISE) == ((LEVEL,), ())


FORMULAS["controlled"] = lambda *x: sum(
    SYSTEM.controlled(body(), BodyMotion(seen().pose, (*x[:3], *V)), TIME, 1, Noise(*x[3:])), ()
)


def test_controlled_on_lanes_draws_for_each_lane_its_own():
    count = 11  # no whole packs
    rng = np.random.default_rng(8)
    noise = np.full(count, 7.0), np.arange(count), rng.permutation(count)
    columns = [*rng.normal(size=(3, count)), *noise]
    found = on_lanes("controlled", *columns, results=7)
    expected = [FORMULAS["controlled"](*map(float, row)) for row in zip(*columns, strict=True)]
    # Lanes fuse products with sums; noise, 1e-3 of it, would be off by that
    np.testing.assert_allclose(found.T, expected, rtol=1e-14, atol=1e-15)


def test_wrench_sees_states_and_controls():
    chart = (1.0, 0.0, 0.0, 0.0), PLACE
    found = accelerate(PLAN, body(), chart, (0.0,) * 6)
    expected = (*(np.array(HELD) / (1.0, 2.0, 3.0)), *(np.array(WHEEL) / 2.0))
    np.testing.assert_allclose(found.rate, expected, rtol=1e-14)
    other = body()._replace(signals=SIGNALS._replace(states=(0.0,) * 4))
    assert tuple(accelerate(PLAN, other, chart, (0.0,) * 6).rate[3:]) == (0.0, 0.0, 0.0)


def test_passive_elements_do_nothing():
    passive = [e for e in ELEMENTS if e.is_passive]
    assert len(passive) == 4
    assert not any(e.does_work or e.rows for e in passive)


def test_outputs_of_are_found_by_tracing():
    assert outputs_of(ATTITUDE) == TORQUE
    assert trial(ATTITUDE) == 7


def test_function_without_its_signals_says_so():
    with pytest.raises(ValueError, match="takes 5 numbers of controls, got 0"):
        SYSTEM.events(body()._replace(signals=Signals()), seen(), TIME)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        ({"wheel": (0.0,) * 3}, "a dictionary of wheel, filtered, not a dictionary of wheel"),
        ({"wheel": (0.0,) * 2, "filtered": 0.0}, "wheel must return 3 components"),
        ((0.0,) * 4, "must return a dictionary, not "),
    ],
)
def test_states_that_return_something_else_are_refused(returned, message):
    def odd():
        return returned

    with pytest.raises(UnfitFunctionError, match=message):
        trial(made(odd, (), outputs=(STATES,)))


def test_mechanism_plans_have_the_same_shapes():
    plan = MechanismPlan(tree=(), connections=(), loops=0, elements=ELEMENTS, **STEPS)
    assert sides.states_of(plan) == STATES

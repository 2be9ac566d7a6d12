"""States, controllers and events as kernels have them, asked in plain Python on floats."""

from __future__ import annotations

import numpy as np
import pytest

from lierb.kernels.functions.fingerprint import UnfitFunctionError, fingerprint
from lierb.kernels.functions.function import Function, outputs_of, traceable, trial
from lierb.kernels.functions.noise import normal, normals
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.stepping import signals as sides
from lierb.kernels.stepping.formulations import accelerate
from lierb.kernels.stepping.mechanism import MechanismPlan
from lierb.kernels.stepping.one_body import OneBody, Seen
from lierb.kernels.stepping.plan import Plan
from lierb.user_elements import ARGUMENTS

LAMP = (("brightness", ()),)
TORQUE = (("torque", (3,)), ("lamp", ()))
STATES = (("wheel", (3,)), ("filtered", ()))
MEMORY = (("integral", (3,)),)
SEEN = {"states": STATES, "controls": (*LAMP, *TORQUE)}
WHEEL, FILTERED = (1.0, 2.0, 3.0), 4.0
BRIGHTNESS, HELD, HELD_LAMP = 5.0, (7.0, 8.0, 9.0), 10.0
INTEGRAL = (0.5, 0.25, 0.125)
SIGNALS = Signals((*WHEEL, FILTERED), (BRIGHTNESS, *HELD, HELD_LAMP), INTEGRAL)
NOISE = Noise(7.0, 3.0, 12.0)
TIME, OMEGA, V, PLACE = 1.5, np.array((0.1, 0.2, 0.3)), (1.0, 2.0, 3.0), (0.4, 0.5, 0.6)
GAIN, WANTED, TAU, LEVEL = 2.0, (0.01, 0.02, 0.03), 0.5, 42.0
INPUTS = {
    "mass": 2.0, "inertia": np.diag((1.0, 2.0, 3.0)), "ground_frame": np.eye(4),
    "body_frame": np.eye(4), "pose": np.eye(4),
    "2.tau": TAU, "2.initial.wheel": (11.0, 12.0, 13.0), "2.initial.filtered": 14.0,
    "3.every": 0.2, "3.level": LEVEL,
    "4.every": 0.1, "4.gain": GAIN, "4.wanted": WANTED, "4.initial.integral": (21.0, 22.0, 23.0),
}  # fmt: skip


def wheels(omega, states, controls, params):
    filtered = (omega[2] - states.filtered) / params.tau
    return {"filtered": filtered, "wheel": -controls.torque}


def attitude(t, omega, params, memory, states, controls):
    error = omega - params.wanted + 1e-3 * normal("gyro", 3)
    integral = memory.integral + error
    torque = -params.gain * error - 0.1 * integral - 0.01 * states.wheel
    return {"torque": torque, "lamp": t + controls.lamp}, {"integral": integral}


def lit(params):
    return {"brightness": params.level}


def landing(r, v, controls):
    return r[2] + v[0] - controls.lamp


def push(t, R, r, omega, v, controls, states):
    return controls.torque, states.wheel


def made(python, form, shapes=(), results=(), **more) -> Function:
    fields = python.__name__, fingerprint(python), form, tuple(ARGUMENTS.items()), shapes, results
    return Function(*fields, True, traceable(python), **more)


ATTITUDE = made(
    attitude, ("t", "omega", "params", "memory", "states", "controls"),
    (("gain", ()), ("wanted", (3,))), **SEEN, memory=MEMORY, outputs=(TORQUE, MEMORY), draws=True,
)  # fmt: skip
WHEELS = made(
    wheels, ("omega", "states", "controls", "params"), (("tau", ()),), **SEEN, outputs=(STATES,)
)
PUSH = ("t", "R", "r", "omega", "v", "controls", "states")
ELEMENTS = (
    kinds.UserWrench(made(push, PUSH, results=((3,), (3,)), **SEEN)),
    kinds.UserEvent(made(landing, ("r", "v", "controls"), results=((),), **SEEN)),
    kinds.UserStates(WHEELS, STATES),
    kinds.UserController(made(lit, ("params",), (("level", ()),), outputs=(LAMP,)), (), LAMP),
    kinds.UserController(ATTITUDE, MEMORY, TORQUE),
)
PLAN = Plan(1, (), "SE3", "local", ((),), (1.0,), False, elements=ELEMENTS)
SYSTEM = OneBody(PLAN)


@pytest.fixture
def body():
    numbers = []
    for field, _ in SYSTEM.inputs:
        given = np.broadcast_to(np.asarray(INPUTS.get(field.name, 0.0)), field.shape).ravel()
        numbers += map(float, given if field.entries is None else given[list(field.entries)])
    return SYSTEM.body(numbers)._replace(signals=SIGNALS)


@pytest.fixture
def seen():
    return Seen((tuple(np.eye(3).ravel()), PLACE), (*OMEGA, *V))


def test_shapes_of_plan_are_in_the_order_of_elements():
    assert sides.states_of(PLAN) == STATES
    assert sides.outputs_of(PLAN) == (*LAMP, *TORQUE)
    assert sides.memory_of(PLAN) == MEMORY
    assert sides.memory_slices(PLAN) == (slice(0, 0), slice(0, 3))
    assert sides.output_slices(PLAN) == (slice(0, 1), slice(1, 5))


def test_initial_values_and_periods_are_the_parameters(body):
    assert SYSTEM.initial_states(body) == (11.0, 12.0, 13.0, 14.0)
    assert SYSTEM.initial_memory(body) == (21.0, 22.0, 23.0)
    assert SYSTEM.periods(body) == (0.2, 0.1)


def test_state_rates_are_in_declared_order(body, seen):
    expected = (*(-x for x in HELD), (OMEGA[2] - FILTERED) / TAU)
    np.testing.assert_allclose(SYSTEM.state_rates(body, seen, TIME), expected, rtol=1e-15)


def test_events_see_held_outputs(body, seen):
    np.testing.assert_allclose(SYSTEM.events(body, seen, TIME), [PLACE[2] + V[0] - HELD_LAMP])


def test_controlled_gives_outputs_and_memory_of_one_controller(body, seen):
    outputs, memory = SYSTEM.controlled(body, seen, TIME, 1, NOISE)
    error = OMEGA - WANTED + 1e-3 * np.array(normals(NOISE, "gyro", 3))
    integral = np.array(INTEGRAL) + error
    torque = -GAIN * error - 0.1 * integral - 0.01 * np.array(WHEEL)
    np.testing.assert_allclose(outputs, (*torque, TIME + HELD_LAMP), rtol=1e-14)
    np.testing.assert_allclose(memory, integral, rtol=1e-14)
    assert SYSTEM.controlled(body, seen, TIME, 0, NOISE) == ((LEVEL,), ())


def test_wrench_sees_states_and_controls(body, seen):
    chart = (1.0, 0.0, 0.0, 0.0), PLACE
    found = accelerate(PLAN, body, chart, (0.0,) * 6)
    expected = (*(np.array(HELD) / (1.0, 2.0, 3.0)), *(np.array(WHEEL) / 2.0))
    np.testing.assert_allclose(found.rate, expected, rtol=1e-14)
    other = body._replace(signals=SIGNALS._replace(states=(0.0,) * 4))
    assert tuple(accelerate(PLAN, other, chart, (0.0,) * 6).rate[3:]) == (0.0, 0.0, 0.0)


def test_passive_elements_do_nothing():
    passive = [e for e in ELEMENTS if e.is_passive]
    assert len(passive) == 4
    assert not any(e.does_work or e.rows for e in passive)


def test_outputs_of_are_found_by_tracing():
    assert outputs_of(ATTITUDE) == TORQUE
    assert trial(ATTITUDE) == 7


def test_function_without_its_signals_says_so(body, seen):
    with pytest.raises(ValueError, match="sees 5 numbers of controls, got 0"):
        SYSTEM.events(body._replace(signals=Signals()), seen, TIME)


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
    plan = MechanismPlan(1, (), (), 0, "local", ((),), (1.0,), False, elements=ELEMENTS)
    assert sides.states_of(plan) == STATES

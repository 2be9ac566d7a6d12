"""A free body with a wheel, a filter, two controllers and an event, asked on floats."""

from __future__ import annotations

import numpy as np

from lierb.kernels.functions.copies import traceable
from lierb.kernels.functions.fingerprint import fingerprint
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.noise import normal
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.mechanics.passive_elements import UserController, UserEvent, UserStates
from lierb.kernels.mechanics.user_wrench import UserWrench
from lierb.kernels.systems.one_body import BodyMotion
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.system_of import system_of
from lierb.methods import TABLEAUS
from lierb.model.functions.tracing import ARGUMENTS

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
    UserWrench(made(push, PUSH, results=((3,), (3,)), **SEEN)),
    UserEvent(made(landing, ("r", "v", "controls"), results=((),), **SEEN)),
    UserStates(WHEELS, STATES),
    UserController(made(lit, ("params",), (("level", ()),), outputs=(LAMP,)), (), LAMP),
    UserController(ATTITUDE, MEMORY, TORQUE),
)
EULER = TABLEAUS["Euler"].scheme(is_adaptive=False, interpolates=False)
STEPS = {"lanes": 1, "update": "local", "method": EULER, "multipliers": False}
PLAN = Plan(rows=(), cspace="SE3", elements=ELEMENTS, **STEPS)
SYSTEM = system_of(PLAN)


def body():
    """The body of SYSTEM, with SIGNALS."""
    numbers = []
    for field, _ in SYSTEM.inputs:
        given = np.broadcast_to(np.asarray(INPUTS.get(field.name, 0.0)), field.shape).ravel()
        numbers += map(float, given if field.entries is None else given[list(field.entries)])
    return SYSTEM.body(numbers)._replace(signals=SIGNALS)


def seen():
    """How it moves."""
    return BodyMotion((tuple(np.eye(3).ravel()), PLACE), (*map(float, OMEGA), *V))


def go_through():
    """Ask it everything, but for noise."""
    found = body(), seen(), TIME
    SYSTEM.observed(*found), SYSTEM.events(*found), SYSTEM.state_rates(*found)
    SYSTEM.controlled(*found, 0, NOISE)
    SYSTEM.initial_states(body(), None), SYSTEM.initial_memory(body()), SYSTEM.periods(body())

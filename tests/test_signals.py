"""Events, extra states and controllers of problems, and the errors of wrong ones."""

from __future__ import annotations

import numpy as np
import pytest
from cases import box

import lierb
from lierb.errors import ArgumentError, ForceError, ScalarFunctionWarning, UnknownNameError
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.numbers.vec import IDENTITY
from lierb.kernels.systems.plan import UNSTABILISED, Plan
from lierb.kernels.systems.system_of import system_of
from lierb.methods import TABLEAUS
from lierb.model.functions.binding import Column
from lierb.model.functions.column_names import TAKEN
from lierb.model.mechanism.plan import mechanism_plan_of

FREE = lierb.joints.free()


@lierb.states(wheel=(0.0, 0.0, 0.0), filtered=0.0, unit={"wheel": "N m s"})
def wheel_and_filter(t, omega, states, controls, params):
    return {"wheel": -controls.torque, "filtered": (omega[2] - states.filtered) / params.tau}


@lierb.controller(
    every=0.1, memory={"integral": (0.0, 0.0, 0.0)}, unit={"torque": "N m"}, gain=0.5, dt=0.1
)
def attitude(t, R, omega, params, memory, states, controls):
    error = omega + 1e-3 * lierb.noise.normal("gyro", 3)
    torque = -params.gain * error - states.wheel + 0.1 * controls.lamp
    return {"torque": torque}, {"integral": memory.integral + params.dt * error}


@lierb.controller(every=0.25)
def blinking(t):
    return {"lamp": np.sin(t)}


@lierb.wrench
def wheels(t, R, r, omega, v, controls, states):
    return controls.torque - np.cross(omega, states.wheel), np.zeros(3)


@lierb.event(direction=-1, terminal=True, height=0.0)
def landing(r, states, params):
    return r[2] - params.height + states.filtered


@lierb.observable(unit="N m s")
def stored(states):
    return np.sqrt(states.wheel @ states.wheel)


def elements() -> dict:
    return {
        "forces": wheels(),
        "observables": stored(),
        "events": [landing(), landing(height=1.0).named("roof")],
        "states": wheel_and_filter(tau=0.5),
        "controllers": [attitude(), blinking()],
    }


def problem(**more) -> lierb.Problem:
    return lierb.Problem(box(), FREE, **(elements() | more))


@pytest.fixture(scope="module")
def made() -> lierb.Problem:
    return problem()


# ---- what is made ------------------------------------------------------------------------------


def test_problem_has_its_elements_in_order(made):
    names = [e.name for e in made.elements]
    expected = ["wheels", "stored", "landing", "roof", "wheel_and_filter", "attitude", "blinking"]
    assert names == expected


def test_signals_are_states_then_outputs_with_shapes_and_units(made):
    assert made.signals == (
        Column("wheel", (3,), "N m s"),
        Column("filtered", (), "1"),
        Column("torque", (3,), "N m"),
        Column("lamp", (), "1"),
    )


def test_functions_see_what_they_name_and_no_more(made):
    states, controls = (("wheel", (3,)), ("filtered", ())), (("torque", (3,)), ("lamp", ()))
    for element in (*made.forces, *made.states):
        assert (element.kind.function.states, element.kind.function.controls) == (states, controls)
    seen = made.events[0].kind.function
    assert (seen.states, seen.controls) == (states, ())
    seen = made.controllers[1].kind.function
    assert (seen.states, seen.controls) == ((), ())


def test_events_keep_direction_and_terminal_out_of_the_kernel(made):
    first, second = made.events
    assert (first.direction, first.terminal, second.name) == (-1, True, "roof")
    assert first.kind == second.kind


@lierb.event
def plain_event(r):
    return r[0]


def test_event_without_arguments_has_both_directions():
    assert (plain_event().direction, plain_event().terminal) == (0, False)


def test_controller_computes_what_its_function_does(made):
    kind = made.controllers[0].kind
    given = {"every": 0.1, "gain": 0.5, "dt": 0.1, "initial.integral": (7.0, 8.0, 9.0)}
    frames = lierb.kernels.mechanics.newton_euler.Frames(
        (IDENTITY, (0.0,) * 3), IDENTITY, (0.0,) * 3
    )
    placed = kind.placed(given, frames)
    omega, wheel, integral = (np.array(x) for x in ((1.0, 2, 3), (0.1, 0.2, 0.3), (4.0, 5, 6)))
    signals = Signals((*wheel, 9.0), (0.0, 0.0, 0.0, 2.0), tuple(integral))
    x = Motion(0.0, IDENTITY, (0.0,) * 3, tuple(omega), (0.0,) * 3, signals)
    torque, memory = kind.called(placed, x, Noise(3.0, 4.0, 5.0))
    error = omega + 1e-3 * lierb.noise.sample(3, 4, "gyro", 5, 3)
    np.testing.assert_allclose(torque, -0.5 * error - wheel + 0.2, rtol=1e-14)
    np.testing.assert_allclose(memory, integral + 0.1 * error, rtol=1e-14)
    assert (kind.every(placed), kind.initial(placed)) == (0.1, (7.0, 8.0, 9.0))


# ---- batches -----------------------------------------------------------------------------------


def test_initial_values_periods_and_parameters_may_be_batched():
    wheel = np.arange(12.0).reshape(4, 3)
    states = wheel_and_filter(tau=[0.1, 0.2, 0.3, 0.4], wheel=wheel)
    given = attitude(gain=[1.0, 2.0, 3.0, 4.0], every=[0.1, 0.2, 0.3, 0.4], integral=-wheel)
    whole = problem(states=states, controllers=[given, blinking()])
    assert whole.batch_size() == 4
    one = whole.of_body(2)
    assert one.batch_size() is None
    assert one.states[0].parameters["initial.wheel"].tolist() == [6.0, 7.0, 8.0]
    assert one.controllers[0].parameters["initial.integral"].tolist() == [-6.0, -7.0, -8.0]
    assert one.controllers[0].parameters["every"] == 0.3
    assert one.states[0].parameters["tau"] == 0.3
    assert one.kinds == whole.kinds  # or it would be compiled anew


def test_batches_that_do_not_fit_are_told():
    with pytest.raises(ArgumentError, match=r"initial\.wheel"):
        problem(
            states=wheel_and_filter(tau=0.5, wheel=np.zeros((2, 3))),
            controllers=[attitude(gain=[1.0, 2.0, 3.0]), blinking()],
        )


def test_parameters_of_two_elements_of_one_name_are_one_batch():
    drags = [lierb.forces.drag([1.0, 2.0, 3.0]), lierb.forces.drag([1.0, 2.0])]
    with pytest.raises(ArgumentError, match=r"drag\.linear"):
        lierb.Problem(box(), FREE, forces=drags)


def test_with_events_adds_to_those_there_are(made):
    more = made.with_(events=plain_event())
    assert [e.name for e in more.events] == ["landing", "roof", "plain_event"]
    assert more.signals == made.signals
    with pytest.raises(ArgumentError, match="two events are named landing"):
        made.with_(events=landing())


# ---- mechanisms --------------------------------------------------------------------------------


def test_mechanism_has_all_of_it_on_its_links():
    links = [lierb.Link(name, box(), FREE) for name in ("bus", "tip")]
    whole = lierb.Mechanism(
        links,
        forces=wheels().on("bus"),
        observables=stored().on("bus"),
        events=landing(height=[0.0, 0.5]).on("tip", "bus"),
        states=wheel_and_filter(tau=0.5).on("bus"),
        controllers=[attitude().on("bus"), blinking().on("tip")],
    )
    assert whole.signals == problem().signals
    assert [e.at for e in whole.elements[2:]] == [("tip", "bus"), ("bus",), ("bus",), ("tip",)]
    assert whole.batch_size() == 2
    assert whole.of_body(1).events[0].parameters["height"] == 0.5
    more = whole.with_(events=plain_event().on("tip"))
    assert [e.name for e in more.events] == ["landing", "plain_event"]
    with pytest.raises(ArgumentError, match=r"controllers\[0\], blinking, is on no link"):
        lierb.Mechanism(links, controllers=blinking())


def of_plan(plan, numbers):
    """The plan's system, and its constants, in plain Python.   numbers : by the names of inputs."""
    system = system_of(plan)
    flat: list[float] = []
    for field, _ in system.inputs:
        given = np.broadcast_to(np.asarray(numbers.get(field.name, 0.0)), field.shape).ravel()
        flat += map(float, given if field.entries is None else given[list(field.entries)])
    return system, system.body(flat), flat


def of_problem(problem, pose, twist):
    plan = Plan(
        lanes=1, rows=problem.joint.rows, cspace="SE3", update="local",
        method=TABLEAUS["Euler"].scheme(False, False), multipliers=False, elements=problem.kinds,
    )  # fmt: skip
    numbers = problem.quantities | {"pose": pose, "twist": twist}
    for i, element in enumerate(problem.elements):
        numbers |= {f"{i}.{name}": x for name, x in element.parameters.items()}
    return of_plan(plan, numbers)


def of_mechanism(mechanism, cspace, pose, twist):
    described = {
        "update": "local",
        "method": TABLEAUS["Euler"].scheme(False, False),
        "multipliers": False,
    }
    cspaces = (cspace,) * len(mechanism.links)
    plan = mechanism_plan_of(
        mechanism, cspaces, UNSTABILISED, elements=mechanism.kinds, **described
    )
    numbers = dict(mechanism.inputs)
    for i, name in enumerate(mechanism.names):
        numbers |= {f"{i}.pose": pose[name], f"{i}.twist": twist[name]}
    return of_plan(plan, numbers)


def evaluate(system, body, numbers):
    """All that its elements give, and the accelerations that they make, flat."""
    signals = Signals((0.1, 0.2, 0.3, 0.4), (0.5, 0.6, 0.7, 0.8), (0.9, 1.0, 1.1))
    body, time = body._replace(signals=signals), 0.25
    state = system.start(body, system.placed(body, numbers), numbers)
    seen = system.motion(body, state, time)
    found = [system.observed(body, seen, time), system.events(body, seen, time)]
    found += [system.state_rates(body, seen, time), system.initial_states(body, state)]
    found += [system.initial_memory(body), system.periods(body)]
    found += [
        x for i in (0, 1) for x in system.controlled(body, seen, time, i, Noise(1.0, 2.0, 3.0))
    ]
    _, (reaction, *_) = system.forces(body, state, time)
    return np.concatenate([*found, reaction])


def somewhere():
    pose = lierb.lie.se3.exp((0.3, -0.2, 0.5, 1.0, 2.0, 3.0))
    return pose, np.array((0.4, 0.5, -0.6, 1.0, -2.0, 0.5))


@pytest.mark.parametrize("cspace", ["reduced", "SE3"])
def test_mechanism_of_one_link_asks_its_elements_the_same(cspace):
    weld = lierb.joints.fixed()  # its reaction tells what forces do
    alone = lierb.Problem(box(), weld, **elements())
    linked = lierb.Mechanism(lierb.Link("bus", box(), weld), **elements())
    twist = np.zeros(6)
    one = evaluate(*of_problem(alone, np.eye(4), twist))
    other = evaluate(*of_mechanism(linked, cspace, {"bus": np.eye(4)}, {"bus": twist}))
    np.testing.assert_allclose(other, one, rtol=1e-13, atol=1e-13)
    assert np.linalg.norm(one[-6:]) > 0.5  # controls.torque


@pytest.mark.parametrize("cspace", ["reduced", "SE3"])
def test_elements_between_links_see_the_one_from_the_other(cspace):
    links = [lierb.Link(name, box(), FREE) for name in ("bus", "tip")]
    linked = lierb.Mechanism(
        links, events=[plain_event().on("tip", "bus"), plain_event().named("own").on("tip")]
    )
    pose, twist = somewhere()
    poses = {"bus": pose, "tip": pose @ lierb.lie.se3.exp((0.1, 0.0, 0.2, 7.0, 8.0, 9.0))}
    system, body, numbers = of_mechanism(linked, cspace, poses, {"bus": twist, "tip": -twist})
    seen = system.motion(body, system.start(body, (), numbers), 0.0)
    expected = (np.linalg.inv(pose) @ poses["tip"])[0, 3], poses["tip"][0, 3]
    np.testing.assert_allclose(system.events(body, seen, 0.0), expected, rtol=1e-13)


# ---- outputs that depend on each other -----------------------------------------------------------


@lierb.controller(every=1.0)
def late(controls):
    return {"doubled": 2.0 * controls.single}


@lierb.controller(every=1.0)
def early(omega):
    return {"single": omega}


@lierb.controller(every=1.0)
def smooth(controls, omega):
    return {"rate": 0.9 * controls.rate + 0.1 * omega}


@lierb.controller(every=1.0)
def picky(controls, omega):
    return {"turn": controls.turn[0] + omega}


@lierb.controller(every=1.0)
def growing(controls):
    return {"long": np.append(controls.long, 1.0)}


def outputs(*controllers):
    return [c[:2] for c in lierb.Problem(box(), FREE, controllers=controllers).signals]


def test_outputs_are_found_whatever_the_order():
    assert outputs(late(), early()) == [("doubled", (3,)), ("single", (3,))]


def test_outputs_that_a_controller_sees_of_itself_are_found():
    assert outputs(smooth()) == [("rate", (3,))]


@pytest.mark.parametrize(
    ("controllers", "message"),
    [
        ([picky()], "reads turn, which depends on it.*in memory"),
        ([growing()], "depend on each other without end"),
        ([late()], "no controller has the output single, which late reads; there is doubled"),
        ([late(), blinking()], "single, which late reads; there is lamp, doubled"),
    ],
)
def test_outputs_that_are_not_to_be_found_are_told(controllers, message):
    with pytest.raises(ForceError, match=message):
        lierb.Problem(box(), FREE, controllers=controllers)


# ---- what is wrong -----------------------------------------------------------------------------


@lierb.wrench
def misspelt(t, R, r, omega, v, states):
    return states.whel, np.zeros(3)


@lierb.states(wheel=0.0)
def other_wheel(t):
    return {"wheel": t}


@lierb.states(TORQUE=0.0)
def shouting(t):
    return {"TORQUE": t}


@lierb.states(STORED=0.0)
def observed_too(t):
    return {"STORED": t}


@lierb.states(energy=0.0)
def taken(t):
    return {"energy": t}


@lierb.states(steps=0.0)
def pedometer():
    return {"steps": 3.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"forces": misspelt()}, "states has no whel; it has wheel, filtered"),
        ({"states": [wheel_and_filter(tau=1.0), other_wheel()]}, "are named wheel, of wheel_"),
        ({"states": [wheel_and_filter(tau=1.0), shouting()]}, "are named torque, of shouting"),
        ({"states": [wheel_and_filter(tau=1.0), taken()]}, "energy, which is lierb's own"),
        ({"states": [wheel_and_filter(tau=1.0), pedometer()]}, "steps, which is lierb's own"),
        ({"states": [wheel_and_filter(tau=1.0), observed_too()]}, "STORED, which is that of the"),
        ({"events": [landing(), landing()]}, 'two events are named landing.*named\\("…"\\)'),
        ({"states": ()}, "states has no wheel; it has nothing"),
        ({"events": landing}, r"events\[0\] is the function landing; call it"),
        ({"events": stored()}, r"events\[0\] must be an event made by lierb"),
        ({"states": "wheel"}, r"states\[0\] must be states made by lierb"),
        ({"controllers": [wheel_and_filter(tau=1.0)]}, "must be a controller made by lierb"),
        ({"controllers": attitude().on("bus")}, "a Problem has one body and no names"),
    ],
)
def test_problem_tells_what_is_wrong(given, message):
    with pytest.raises((ArgumentError, ForceError), match=message):
        problem(**given)


def test_function_that_sees_states_is_tried_with_the_problem():
    assert misspelt().name == "misspelt"
    with pytest.raises(ForceError, match="states has no whel; it has nothing"):
        lierb.Problem(box(), FREE, forces=misspelt())


@lierb.constraint
def steered(R, r, controls):
    return r[0] - controls.place


@lierb.wrench
def pushed(t, R, r, omega, v):
    return np.zeros(3), omega


@pushed.potential
def well(R, r, states):
    return r @ r * states.depth


@pytest.mark.parametrize("function", [steered, pushed])
def test_constraints_and_potentials_see_neither(function):
    with pytest.raises(ForceError, match=r"sees no (states|controls): wrenches"):
        function()


def decorate(decorator, function=lambda t: {"x": t}, **given):
    """The function, made by a decorator with these arguments."""
    return decorator(**given)(function)


@pytest.mark.parametrize(
    ("decorator", "given", "error", "message"),
    [
        (lierb.event, {"direction": 2}, ArgumentError, "direction=2; expected -1"),
        (lierb.event, {"direction": True}, ArgumentError, "direction=True"),
        (lierb.event, {"terminal": 1}, ArgumentError, "terminal=1; expected True or False"),
        (lierb.states, {}, ArgumentError, "has no states; name them"),
        (lierb.states, {"x": np.zeros((2, 2))}, ArgumentError, r"x has shape \(2, 2\)"),
        (lierb.states, {"x": ()}, ArgumentError, r"x has shape \(0,\)"),
        (lierb.states, {"x": "a"}, ArgumentError, "x"),
        (lierb.states, {"_x": 0.0}, ArgumentError, "named _x"),
        (lierb.states, {"class": 0.0}, ArgumentError, "named class"),
        (lierb.states, {"x": 0.0, "unit": "m"}, ArgumentError, "unit='m'; expected units by name"),
        (lierb.states, {"x": 0.0, "unit": {"y": "m"}}, UnknownNameError, "unit of='y'"),
        (lierb.states, {"x": 0.0, "unit": {"x": 3}}, ArgumentError, r"unit\['x'\]=3"),
        (lierb.states, {"x": 0.0, "params": {"x": 0.0}}, ArgumentError, "are named x"),
        (lierb.states, {"x": 0.0, "params": 3}, ArgumentError, "params=3"),
        (lierb.controller, {"every": 0.0}, ArgumentError, "every is 0.0 s; expected positive"),
        (lierb.controller, {"memory": 3}, ArgumentError, "memory=3; expected initial values"),
        (lierb.controller, {"memory": {"m": 0.0}, "m": 1.0}, ArgumentError, "are named m"),
    ],
)
def test_decorators_tell_what_is_wrong(decorator, given, error, message):
    with pytest.raises(error, match=message):
        decorate(decorator, **given)


def branching(t):
    return {"x": 1.0 if t > 0.0 else 0.0}


def drawing(t):
    return {"x": lierb.noise.normal("gyro")}


@pytest.mark.parametrize(
    ("decorator", "given", "function", "call", "message"),
    [
        (lierb.states, {"x": 0.0}, branching, {}, "because it is integrated.*lierb.where"),
        (lierb.controller, {"every": 1.0}, branching, {}, "because it is called for.*lierb.where"),
        (lierb.states, {"x": 0.0}, drawing, {}, "drawn outside of a controller"),
        (lierb.states, {"x": 0.0}, lambda t: {"x": (t, t)}, {}, "x must return numbers"),
        (lierb.states, {"x": 0.0}, lambda t: t, {}, "must return a dictionary, not a number"),
        (lierb.states, {"x": 0.0}, lambda memory: {"x": 0}, {}, "takes .memory.; expected any of"),
        (lierb.controller, {"every": 1.0}, lambda t: {}, {}, "puts nothing out"),
        (lierb.controller, {"every": 1.0}, lambda t: (t, t), {}, "must return a dictionary"),
        (lierb.controller, {"every": 1.0}, lambda t: ({"x": t}, {}), {}, "must return a dictiona"),
        (lierb.controller, {"every": 1.0}, lambda t: {"x": "a"}, {}, "x must return numbers"),
        (lierb.controller, {"every": 1.0}, lambda t: {"_x": t}, {}, "named _x"),
        (lierb.controller, {"every": 1.0}, lambda t: {3: t}, {}, "name is 3"),
        (lierb.controller, {"every": 1.0}, lambda R: {"x": R}, {}, r"x has shape \(3, 3\)"),
        (lierb.controller, {"every": 1.0, "memory": {"m": 0.0}}, lambda t: {"x": t}, {},
         "two dictionaries, of outputs and of its memory, not one alone"),
        (lierb.controller, {"every": 1.0, "memory": {"m": 0.0}}, lambda t: ({"x": t}, {"n": t}), {},
         "a dictionary of m, not a dictionary of n"),
        (lierb.controller, {"every": 1.0, "unit": {"y": "m"}}, lambda t: {"x": t}, {}, "unit of"),
        (lierb.controller, {}, lambda t: {"x": t}, {}, "has no period; give every="),
        (lierb.controller, {}, lambda t: {"x": t}, {"every": [1.0, -1.0]}, r"every\[1\]|body 1"),
        (lierb.controller, {"every": 1.0, "a": 1.0}, lambda t, params: {"x": t}, {"b": 1.0}, "'b'"),
        (lierb.event, {}, lambda t: (t, t), {}, "must return numbers"),
        (lierb.event, {}, drawing, {}, "drawn outside of a controller"),
    ],
)  # fmt: skip
def test_elements_tell_what_is_wrong(decorator, given, function, call, message):
    with pytest.raises((ArgumentError, ForceError, UnknownNameError), match=message):
        decorate(decorator, function, **given)(**call)


@pytest.mark.parametrize("decorator", [lierb.event, lierb.states, lierb.controller])
def test_decorators_refuse_what_is_no_function(decorator):
    with pytest.raises(ForceError, match="expected a function to decorate"):
        decorator(x=1.0)(3)


# ---- body by body --------------------------------------------------------------------------------


@lierb.wrench
def stepwise(t, R, r, omega, v, states, controls):
    torque = np.zeros(3)
    if states.filtered > 0.0:
        torque[0] = controls.torque[0] + states.wheel[1]
    return torque, np.zeros(3)


def test_wrench_that_branches_sees_states_body_by_body():
    with pytest.warns(ScalarFunctionWarning, match="stepwise runs body by body") as told:
        found = problem(forces=stepwise())
    assert told[0].filename == __file__
    function = found.forces[0].kind.function
    assert not function.is_traced
    arguments = 0.0, IDENTITY, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3
    for filtered, expected in ((1.0, 7.0), (-1.0, 0.0)):
        signals = Signals((1.0, 2.0, 3.0, filtered), (5.0, 0.0, 0.0, 0.0))
        torque, _ = function((), *arguments, signals=signals)
        assert torque == (expected, 0.0, 0.0)
    again = found.with_(events=plain_event())
    assert again.forces[0].kind is found.forces[0].kind  # and no second warning


# ---- what stays as it was ------------------------------------------------------------------------


def test_plans_without_such_elements_are_what_they_were():
    """Nothing is bound, so that kernels keep their names from problem to problem."""

    @lierb.wrench(gain=1.0)
    def drag(t, R, r, omega, v, params):
        return -params.gain * omega, -params.gain * v

    alone = lierb.Problem(box(), FREE, forces=drag())
    beside = problem(forces=[drag(), wheels()])
    assert alone.kinds[0] == beside.kinds[0]
    assert hash(alone.kinds[0]) == hash(beside.kinds[0])


def test_names_of_columns_are_all_taken():
    assert {"energy", "lambda_1", "omega_x", "t"} <= TAKEN

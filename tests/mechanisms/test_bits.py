"""A mechanism's bits depend on its own inputs and on nothing else; a run goes on without a break.

One mechanism with what can tell neighbours apart: fast and slow links, so that angles lie on both
sides of every cut-over, a loop with redundant rows, which is put back on its rows, and a spring.
"""

import numpy as np
import pytest
from cases import tiered

import lierb
from lierb.model.mechanism import plan as mechanism_plan
from lierb.runs import engine
from mechanisms.shared import bits

DT, STEPS, COUNT = 5e-3, 20, 100


def four_bars(count: int) -> tuple[lierb.Mechanism, dict]:
    rng = np.random.default_rng(3)
    rod = lierb.bodies.rod(0.5, 0.02, mass=1.0 + rng.random(COUNT)[:count])
    turning = {"axis": (0.0, 1.0, 0.0)}
    revolute, tip = lierb.joints.revolute, (0.0, 0.0, -0.25)
    links = [
        lierb.Link("left", rod, revolute((0.0, 0.0, 0.25), **turning)),
        lierb.Link("right", rod, revolute((0.0, 0.0, 0.25), (0.5, 0.0, 0.0), **turning)),
        lierb.Link("top", rod, revolute((0.0, 0.0, 0.25), parent_point=tip, **turning), "left"),
    ]
    pin = lierb.Loop("pin", revolute(tip, parent_point=tip, **turning), "top", "right")
    spring = lierb.forces.spring_damper(stiffness=20.0, damping=0.1, length=0.2)
    made = lierb.Mechanism(links, pin, (0.0, 0.0, -9.81), forces=spring.on("left", "right"))
    pose0 = made.close(made.pose({"left": 0.3, "right": 0.3, "top": -np.pi / 2 - 0.3}))
    speed = (10.0 ** rng.uniform(-1.5, 2.0, COUNT))[:count]
    twist0 = made.project(made.twist({"left": speed}, pose0), pose0)
    return made, {"pose0": pose0, "twist0": twist0}


MECHANISM, START = four_bars(COUNT)
pytestmark = pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")


def part(which) -> tuple[lierb.Mechanism, dict]:
    """Some members of the batch."""
    body = MECHANISM.links[0].body
    some = lierb.Body(body.mass[which], body.inertia[which], np.zeros(3))
    links = [lierb.Link(x.name, some, x.joint, x.parent) for x in MECHANISM.links]
    made = lierb.Mechanism(links, MECHANISM.loops, MECHANISM.gravity, MECHANISM.forces)
    return made, {
        "pose0": START["pose0"],  # the same for all
        "twist0": {name: twists[which] for name, twists in START["twist0"].items()},
    }


def run(made=MECHANISM, start=START, **options):
    options = {"dt": DT, "t_end": STEPS * DT, "method": "Heun", "stabilise": "project"} | options
    return lierb.integrate(made, **start, **options)


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    result = run()
    assert len(result.failed) < COUNT // 2
    return bits(result)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3, 17])
def test_bits_of_mechanisms_do_not_depend_on_batch_size(count, expected):
    np.testing.assert_array_equal(bits(run(*part(slice(0, count)))), expected[:count])


def test_bits_of_mechanisms_do_not_depend_on_place_in_batch(expected):
    order = np.random.default_rng(2).permutation(COUNT)
    np.testing.assert_array_equal(bits(run(*part(order))), expected[order])


@pytest.mark.long
@pytest.mark.parametrize("lanes", tiered([1, 2, 4], [], [2]))
def test_bits_of_mechanisms_do_not_depend_on_lanes(lanes, expected, monkeypatch):
    monkeypatch.setattr(mechanism_plan, "DEFAULT_LANES", lanes)
    np.testing.assert_array_equal(bits(run()), expected)


def test_bits_of_mechanisms_do_not_depend_on_threads(expected):
    np.testing.assert_array_equal(bits(run(threads=1)), expected)


def test_bits_of_mechanisms_do_not_depend_on_history(expected):
    result = run(save_every=7, record=["state", "energy"])
    np.testing.assert_array_equal(bits(result), expected)


def test_bits_of_mechanisms_do_not_depend_on_calls(expected, monkeypatch):
    monkeypatch.setattr(engine, "CHUNK_BODIES", 24)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 1)
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(bits(run()), expected)


def test_mechanism_goes_on_to_the_bits_of_one_run():
    which = slice(0, 16)
    made, start = part(which)
    whole = run(made, start)
    first = run(made, start, t_end=STEPS // 2 * DT)
    second = run(made, first.end, t_end=STEPS * DT)
    for name in made.names:
        np.testing.assert_array_equal(
            second[name].position.view(np.int64), whole[name].position.view(np.int64)
        )
        np.testing.assert_array_equal(
            second[name].omega.view(np.int64), whole[name].omega.view(np.int64)
        )

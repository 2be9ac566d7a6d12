"""Users' observables, events, states and controllers, stops and jumps on trees in memory.

Unrolled code, whose elements have tests of their own, has the same.
"""

from functools import lru_cache

import numpy as np
import pytest

import lierb
from lierb.runs import lane_engine
from mechanisms.shared import bits
from mechanisms.test_tree_loop import looped, start_of, tree_of

ADAPTIVE = {"dt": None, "rtol": 1e-10, "atol": 1e-10, "t_end": 0.6, "method": "Tsit5"}
# Steps of both codes differ by the rounding of their errors; their motions by the tolerance.
NEAR = 1e-7


@lierb.observable(unit="m")
def height(r):
    return r[2]


@lierb.event(level=0.1)
def passes(r, params):
    return r[2] - params.level


@lierb.event(terminal=True, direction=1, end=0.5)
def late(t, r, params):
    return t + 0.1 * r[0] - params.end


@lierb.states(spent=0.1, where=(0.0, 0.0, 0.0), params={"rate": 1.0})
def grows(omega, v, states, params):
    return {"spent": params.rate * (omega @ omega) - states.spent, "where": v}


@lierb.controller(every=0.04, memory={"last": 0.0})
def holds(r, memory):
    return {"pull": r[2] + 0.5 * memory.last}, {"last": r[2]}


@lierb.wrench(at=0.21, discontinuities="at")
def pushed(t, R, r, omega, v, states, controls, params):
    on = lierb.where(t < params.at, 0.0, 1.0)
    push = np.array((on, 0.0, -controls.pull))
    return -0.02 * states.spent * omega, R.T @ push


def made(**more):
    """A small tree with an element of each kind, two of some kinds, on one or two links."""
    base = tree_of(("revolute", "spherical", "revolute"), seed=2)
    stop = lierb.forces.joint_limit(lower=-0.4, upper=0.5, stiffness=200.0, damping=0.5)
    given = {
        "forces": [
            pushed().on("link1"), pushed(at=[0.1, 0.2, 0.3, 0.4]).on("link2"), stop.on("link0"),
            stop.on("link2"),
        ],
        "observables": [height().on("link2"), height().named("apart").on("link2", "link0")],
        "events": [passes().on("link1"), late(end=[0.3, 0.4, 0.5, 9.0]).on("link2")],
        "states": [grows(rate=0.5).on("link1")],
        "controllers": [holds().on("link2", "link1")],
    } | more  # fmt: skip
    return lierb.Mechanism(base.links, gravity=base.gravity, **given)


@lru_cache
def by(solver, rows=13):
    mechanism = made()
    times = np.linspace(0.0, 0.6, rows)
    saved = {"save_at": times, "record": ("state", "energy", "reaction")}
    return looped(mechanism, start_of(mechanism), **ADAPTIVE, **saved, solver=solver)


def both():
    return [by("looped"), by("unrolled")]


@pytest.mark.long
def test_elements_do_what_they_do_in_unrolled_code():
    ours, theirs = both()
    for found, expected in ((ours.summary, theirs.summary), (ours.history, theirs.history)):
        assert found.schema.equals(expected.schema, check_metadata=False)
        for name in found.column_names:
            pair = (np.array(table[name].to_pylist()) for table in (found, expected))
            if name in ("steps", "rejected", "dt_last") or "error" in name:
                continue  # numbers of steps may differ by their rounding
            near = 1e-4 if name.endswith(("_min", "_max", "_mean")) else NEAR  # at ends of steps
            first, second = pair
            if first.dtype.kind not in "f":
                np.testing.assert_array_equal(first, second, err_msg=name)
            else:
                np.testing.assert_allclose(first, second, rtol=near, atol=near, err_msg=name)
    statuses = ours.summary["status"].to_pylist()
    assert statuses == ["event", "event", "event", "ok"]


@pytest.mark.long
def test_events_are_found_at_the_times_of_unrolled_code():
    ours, theirs = (result.events for result in both())
    assert ours.column_names == theirs.column_names
    assert len(ours) > 4
    for name in ours.column_names:
        first, second = (np.array(table[name].to_pylist()) for table in (ours, theirs))
        if first.dtype.kind == "f":
            np.testing.assert_allclose(first, second, rtol=NEAR, atol=NEAR, err_msg=name)
        else:
            np.testing.assert_array_equal(first, second, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["looped", "unrolled"])
def test_steps_end_at_stops(solver):
    """A step that passed over a stop would lose its energy."""
    result = by(solver)
    drift = np.array(result.history["energy_drift"].to_pylist())
    assert np.nanmax(np.abs(drift)) < 1e-6  # J, of about 40 J
    assert result.summary["status"].to_pylist() == ["event", "event", "event", "ok"]


@pytest.mark.long
def test_rows_between_steps_change_no_bit():
    """Most of 40 rows are within steps; of 2 one is the start, and one beyond some ends."""
    few, many = by("looped", rows=2), by("looped", rows=40)
    ends = [r.summary for r in (few, many)]
    assert ends[0]["steps"].to_pylist() == ends[1]["steps"].to_pylist()
    for name in ends[0].column_names:
        if name.endswith(("rotation", "position", "omega", ".v")) or name in ("spent", "where"):
            pair = (np.array(table[name].to_pylist()).view(np.int64) for table in ends)
            np.testing.assert_array_equal(*pair, err_msg=name)
    drift = np.array(many.history["energy_drift"].to_pylist())
    assert np.nanmax(np.abs(drift)) < 1e-6  # J, of about 40 J, between steps as well


@pytest.mark.long
def test_steps_are_as_many_as_in_unrolled_code():
    """Rejections at stops that are passed over would be many more."""
    ours, theirs = both()
    counts = [
        [np.array(result.summary[name].to_pylist()) for name in ("steps", "rejected")]
        for result in (ours, theirs)
    ]
    assert np.abs(counts[0][0] - counts[1][0]).max() <= 0.1 * counts[1][0].max()
    assert np.abs(counts[0][1] - counts[1][1]).max() <= 0.2 * counts[1][1].max() + 3


@pytest.mark.long
def test_bits_of_elements_depend_on_nothing_else(monkeypatch):
    mechanism = made()
    start = start_of(mechanism)
    expected = bits(looped(mechanism, start, **ADAPTIVE))
    monkeypatch.setattr(lane_engine, "FIRST_ITERATIONS", 1)
    monkeypatch.setattr(lane_engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(bits(looped(mechanism, start, **ADAPTIVE)), expected)


@pytest.mark.long
def test_a_run_goes_on_with_states_and_outputs():
    mechanism, options = made(events=[]), ADAPTIVE
    start = start_of(mechanism)
    whole = looped(mechanism, start, **options)
    first = looped(mechanism, start, **options | {"t_end": 0.32})
    rest = looped(mechanism, {}, **options, **first.end)
    names = [n for n in whole.summary.column_names if n.startswith(("spent", "where", "pull"))]
    assert len(names) == 3
    for name in names:
        pair = (np.array(r.summary[name].to_pylist()) for r in (rest, whole))
        np.testing.assert_allclose(*pair, rtol=NEAR, atol=NEAR, err_msg=name)


@pytest.mark.long
def test_fixed_steps_have_the_same_elements():
    """A chain of a hundred links under RK4 has the observables and events of its links."""
    chain = tree_of(("revolute",) * 100, seed=4)
    start = start_of(chain, speed=0.5)
    below = start["pose0"]["link50"][:, 2, 3] - 0.01
    mechanism = lierb.Mechanism(
        chain.links, gravity=chain.gravity, observables=[height().on("link99")],
        events=[passes(level=below).on("link50")],
    )  # fmt: skip
    result = looped(mechanism, start, dt=1e-3, t_end=0.2, save_every=1, record="state")
    places = result["link99"].position[..., 2]
    seen = np.array(result.history["height"].to_pylist()).reshape(places.shape)
    np.testing.assert_allclose(seen, places, rtol=0, atol=1e-13)
    passing = result["link50"].position[..., 2] - below
    crossings = np.count_nonzero(np.diff(np.sign(passing), axis=0), axis=0)
    found = np.bincount(np.array(result.events["trajectory"].to_pylist(), int), minlength=4)
    assert np.all(found >= crossings)
    assert crossings.sum() > 0

"""Observables: columns of the user's own, that change nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import column, tilted

import lierb
from lierb.errors import ArgumentError, FailedTrajectoryWarning, ForceError, ScalarFunctionWarning
from lierb.kernels.systems.observables import Kept, columns_of, with_value
from lierb.model.functions.column_names import TAKEN
from lierb.runs import engine

COUNT = 19  # some blocks, the last one not full
SAVED = {"dt": 1e-3, "t_end": 0.05, "save_every": 3, "measure_every": 7, "record": "state"}
OFFSETS = np.linspace(-1.0, 1.0, COUNT)


@lierb.observable(unit="rad", axis=(0.0, 0.0, 1.0))
def tilt(R, params):
    return np.arccos(lierb.clip(R[2] @ params.axis, -1.0, 1.0))


@lierb.observable(unit="J", offset=0.0)
def lively(params, v, t, body, omega, r):
    spin = omega @ body.inertia @ omega / 2
    return spin + body.mass * (v @ v) * r[0] + t * params.offset


@lierb.observable
def constant(t):
    return 0.1


def own(problem: lierb.Problem, *observables) -> lierb.Problem:
    return lierb.Problem(
        problem.body, problem.joint, problem.gravity, observables=observables or watching()
    )


def watching() -> list:
    return [tilt(axis=(0.6, 0.0, 0.8)), lively(offset=OFFSETS), constant()]


def starts(twist) -> np.ndarray:
    return np.linspace(0.1, 1.0, COUNT)[:, None] * twist


@pytest.fixture(scope="module")
def watched():
    problem, twist = tilted("spherical")
    return lierb.integrate(own(problem), twist0=starts(twist), **SAVED)


def expected(result, problem) -> dict[str, np.ndarray]:
    """Value from the state of the history; the centre of mass is the origin."""
    R, r, omega, v, t = result.rotation, result.position, result.omega, result.v, result.t
    spin = np.einsum("...i,ij,...j", omega, problem.body.inertia, omega) / 2
    energy = problem.body.mass * np.sum(v * v, axis=-1) * r[..., 0]
    return {
        "tilt": np.arccos(R[..., 2, :] @ (0.6, 0.0, 0.8)),
        "lively": spin + energy + t[:, None] * OFFSETS,
        "constant": np.full(r.shape[:2], 0.1),
    }


def history(result, name) -> np.ndarray:
    return column(result.history, name).reshape(-1, result.summary.num_rows)


# ---- values ------------------------------------------------------------------------------------


def test_observables_are_those_of_the_state_saved(watched):
    problem, _ = tilted("spherical")
    for name, values in expected(watched, problem).items():
        # The state that is saved was rounded once more on its way to the user's frames.
        np.testing.assert_allclose(history(watched, name), values, rtol=0, atol=1e-13)


def test_observables_fields_have_their_units(watched):
    for name, unit in (("tilt", b"rad"), ("lively", b"J"), ("constant", b"1")):
        assert watched.history.schema.field(name).metadata[b"unit"] == unit
        for how in ("min", "max", "mean", "final"):
            assert watched.summary.schema.field(f"{name}_{how}").metadata[b"unit"] == unit


WAYS = [
    pytest.param("spherical", {}, id="subgroup"),
    pytest.param("spherical", {"solver": "saddle"}, id="saddle", marks=pytest.mark.long),
    pytest.param(
        "universal", {"cspace": "SO3xR3", "update": "global"}, id="global", marks=pytest.mark.long
    ),
]


@pytest.mark.parametrize(("joint", "options"), WAYS)
def test_observables_change_no_bit_of_other_columns(joint, options):
    problem, twist = tilted(joint)
    given = {"twist0": starts(twist), **SAVED, **options}
    without, result = (lierb.integrate(p, **given) for p in (problem, own(problem)))
    for table in ("summary", "history"):
        found, wanted = getattr(result, table), getattr(without, table)
        assert found.column_names[: len(wanted.column_names)] == wanted.column_names
        assert found.select(wanted.column_names) == wanted


def test_observables_summary_is_over_measured_times():
    problem, twist = tilted("spherical")
    given = {"twist0": starts(twist), **SAVED, "measure_every": 1, "save_every": 1}
    every = lierb.integrate(own(problem), **given)
    some = lierb.integrate(own(problem), **given | {"measure_every": 7})
    for result, step in ((every, 1), (some, 7)):
        at = np.unique([*range(0, 51, step), 50])
        for name in ("tilt", "lively", "constant"):
            seen = history(result, name)[at]
            kept = {how: column(result.summary, f"{name}_{how}") for how in ("min", "max", "final")}
            np.testing.assert_array_equal(kept["min"], seen.min(axis=0))
            np.testing.assert_array_equal(kept["max"], seen.max(axis=0))
            np.testing.assert_array_equal(kept["final"], seen[-1])
            mean = np.trapezoid(seen, every.t[at], axis=0) / every.t[-1]
            found = column(result.summary, f"{name}_mean")
            # NumPy's sum and its times are rounded; ours is compensated.
            np.testing.assert_allclose(found, mean, rtol=1e-14, atol=1e-15)


@lierb.observable
def sine(R):
    return R[1, 0]


@lierb.observable
def ripple(R):
    return R[0, 0] * R[0, 0] * R[1, 0]


@pytest.mark.slow
def test_adaptive_steps_are_sampled_within():
    """A ball that spins freely makes steps of many turns, which are exact."""
    rates = np.array((0.05, 1.0, 7.3, -60.0))
    ball = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    start = {"twist0": np.outer(rates, (0, 0, 1, 0, 0, 0)), "rtol": 1e-9, "t_end": 20.0}
    plain = lierb.integrate(ball, **start).summary
    seen = lierb.integrate(own(ball, sine(), ripple()), **start).summary
    assert column(plain, "steps").max() < 30
    for name in set(plain.column_names):  # no bit of other columns
        assert plain[name].equals(seen[name])
    angles = np.abs(rates) * 20.0
    means = {"sine": (1.0 - np.cos(angles)) / angles * np.sign(rates)}
    means["ripple"] = (1.0 - np.cos(angles) ** 3) / (3.0 * angles) * np.sign(rates)
    highest = {"sine": np.sin(np.minimum(angles, np.pi / 2)), "ripple": np.full(4, 2 / 27**0.5)}
    for name in ("sine", "ripple"):
        # five points in a quarter turn: quadrature of cubes of sines, and quartics
        np.testing.assert_allclose(column(seen, f"{name}_mean"), means[name], atol=1e-8)
        largest, least = column(seen, f"{name}_max"), column(seen, f"{name}_min")
        extreme = np.where(rates > 0.0, largest, -least)
        np.testing.assert_allclose(extreme, highest[name], atol=1e-8)
        assert (np.abs((largest, least)) <= highest[name] + 1e-12).all()  # rounding of rotations
    for i, twist in enumerate(start.pop("twist0")):  # others are sampled where this one is not
        alone = lierb.integrate(own(ball, sine(), ripple()), twist0=twist, **start).summary
        assert alone.drop_columns("trajectory").equals(seen.slice(i, 1).drop_columns("trajectory"))


def test_observables_mean_keeps_what_rounding_takes():
    problem, twist = tilted("spherical")
    given = {"twist0": twist, **SAVED, "measure_every": 1, "t_end": 20.0, "save_every": 20_000}
    same = own(problem, tilt(), lively(), constant())
    (mean,) = column(lierb.integrate(same, **given).summary, "constant_mean")
    # A plain sum of so many is 5e-15 off; the shares of time are rounded alike, by ½ ulp.
    assert abs(mean - 0.1) < 3e-17


def test_mean_of_infinite_values_is_infinite():
    kept = Kept(math.inf, -math.inf, 0.0, 0.0, math.nan)
    for value in (1.0, math.inf, 1.0, 1.0):
        kept = with_value(kept, value, 0.25, alive=True)
    assert columns_of(kept) == (1.0, math.inf, math.inf, 1.0)


def test_bits_of_observables_do_not_depend_on_calls(watched, monkeypatch):
    problem, twist = tilted("spherical")
    monkeypatch.setattr(engine, "CHUNK_BODIES", 8)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 1)
    monkeypatch.setattr(engine, "CALL_SECONDS", 1e-12)
    engine._pace.cache_clear()
    again = lierb.integrate(own(problem), twist0=starts(twist), **SAVED, threads=1)
    engine._pace.cache_clear()
    assert again.summary == watched.summary
    assert again.history == watched.history


def test_observables_go_on_with_the_run(watched):
    problem, twist = tilted("spherical")
    half = SAVED | {"t_end": 0.021}
    first = lierb.integrate(own(problem), twist0=starts(twist), **half)
    second = lierb.integrate(own(problem), **first.end, **SAVED | {"t_end": 0.051})
    whole = lierb.integrate(own(problem), twist0=starts(twist), **SAVED | {"t_end": 0.051})
    for name in ("tilt", "lively", "constant"):
        joined = np.concatenate([history(first, name)[:-1], history(second, name)])
        np.testing.assert_array_equal(joined, history(whole, name))
        final = f"{name}_final"
        assert second.summary[final] == whole.summary[final]


def test_observables_of_one_body_are_its_own(watched):
    problem, twist = tilted("spherical")
    one = lierb.integrate(own(problem).of_body(13), twist0=starts(twist)[13], **SAVED)
    for name in ("tilt_mean", "lively_max", "lively_final"):
        assert column(one.summary, name) == column(watched.summary, name)[13]


# ---- names -------------------------------------------------------------------------------------


def test_observables_may_not_have_the_names_of_columns(watched):
    problem, twist = tilted("spherical")
    more = ("energy", "multipliers", "reaction", "state")
    whole = lierb.integrate(problem, twist0=twist, **SAVED | {"record": more})
    columns = {*whole.summary.column_names, *whole.history.column_names}
    columns |= {*whole.to_pandas("summary").columns, *whole.to_pandas("history").columns}
    assert columns <= TAKEN


@pytest.mark.parametrize(
    ("names", "clash"),
    [
        (["energy"], "column energy, which is lierb's own"),
        (["Position"], "column Position, which is lierb's own"),
        (["position_error"], "column position_error, "),
        (["cspace"], "column cspace, "),
        (["v_x"], "column v_x, "),
        (["lambda_1"], "column lambda_1, "),
        (["pointing", "Pointing"], "column Pointing, which is that of the observable pointing"),
        (["pointing", "pointing_mean"], "pointing_mean, which is that of the observable pointing"),
    ],
)
def test_observable_refuses_names_that_clash(names, clash):
    problem, _ = tilted("spherical")
    with pytest.raises(ArgumentError, match=clash):
        own(problem, *(constant().named(name) for name in names))


@pytest.mark.parametrize("name", ["", "a b", "1st", "sample.x", "x" * 101, None, "é\n"])
def test_observable_refuses_names_that_are_none(name):
    with pytest.raises(ArgumentError, match="column's name"):
        constant().named(name)


@pytest.mark.slow
def test_one_function_may_be_two_observables(watched):
    problem, twist = tilted("spherical")
    several = own(problem, tilt(axis=(0.6, 0.0, 0.8)), lively(), tilt().named("upright"))
    result = lierb.integrate(several, twist0=starts(twist), **SAVED)
    np.testing.assert_array_equal(history(result, "tilt"), history(watched, "tilt"))
    cosine = np.cos(history(result, "upright"))
    np.testing.assert_allclose(cosine, result.rotation[..., 2, 2], rtol=0, atol=1e-13)


# ---- what is refused ---------------------------------------------------------------------------


def _vector(r):
    return r


def _unknown(t, speed):
    return t * speed


def _lacks_params(t):
    return t


def _after_other(t, scale=1.0, r=0.0):
    return t


@pytest.mark.parametrize(
    ("function", "defaults", "told"),
    [
        (_vector, {}, "_vector must return numbers"),
        (_unknown, {}, r"_unknown takes \(t, speed\); expected any of \(t, R, r, omega, v, params"),
        (_lacks_params, {"size": 1.0}, "expected params as well"),
        (_after_other, {}, r"expected any of \(t, "),
    ],
)
def test_observable_refuses_functions_of_another_form(function, defaults, told):
    with pytest.raises(ForceError, match=told):
        lierb.observable(**defaults)(function)()


@pytest.mark.parametrize("unit", [None, "", 3, "m\n", "x" * 41])
def test_observable_refuses_units_that_are_none(unit):
    with pytest.raises(ArgumentError, match="unit="):
        lierb.observable(unit=unit)(_lacks_params)


def test_observable_is_to_be_called_first():
    problem, _ = tilted("spherical")
    with pytest.raises(ArgumentError, match=r"call it, .*: tilt\(…\)"):
        own(problem, tilt)


def test_observables_are_neither_forces_nor_the_other_way_round():
    problem, _ = tilted("spherical")
    with pytest.raises(ArgumentError, match=r"forces\[0\] must be a force"):
        lierb.Problem(problem.body, problem.joint, forces=tilt())
    with pytest.raises(ArgumentError, match=r"observables\[0\] must be an observable"):
        own(problem, lierb.forces.drag(linear=1.0))


# ---- body by body ------------------------------------------------------------------------------

FALL = {"dt": 0.125, "t_end": 1.0, "method": "Euler", "record": "state"}


@lierb.observable(unit="s", start=9.0, end=9.0)
def touchy(t, r, params):
    if params.start <= t < params.end:
        raise ValueError("too late")
    if r[0] < 0.0:
        return np.log(r[0])
    return t


@pytest.fixture(scope="module")
def free() -> lierb.Problem:
    return lierb.Problem(lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.free())


TWISTS = np.outer((1.0, 1.0, -1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def fallen(free):
    """Trajectory 1 raises at 0.25 s, 3 at the start, 4 at the end; 2 is asked what has no value."""
    start = [9.0, 0.25, 9.0, 0.0, 1.0]
    with pytest.warns(ScalarFunctionWarning, match="touchy runs body by body"):
        watching = touchy(start=start, end=2.0)
    problem = lierb.Problem(free.body, free.joint, observables=watching)
    with pytest.warns(FailedTrajectoryWarning, match="touchy raised ValueError: too late") as told:
        result = lierb.integrate(problem, twist0=TWISTS, save_every=1, measure_every=3, **FALL)
    assert "the first is trajectory 1, raised at t = 0.25 s" in str(told[0].message)
    return result


SMALL = np.float32(0.1)


@lierb.observable
def narrow(t, r):
    return np.float32(t) * SMALL


@lierb.observable
def narrow_or_wide(t, r):
    if t > 0.5:
        return SMALL
    return np.float32(0.25)


@lierb.event
def narrow_event(t, r):
    return np.float32(0.3) if t < 0.3 else np.float32(-0.5)


@pytest.mark.long
def test_numbers_of_half_the_bits_are_numbers(free):
    """Values as NumPy has them; where a function branches, or calls np.float32, body by body."""
    with pytest.warns(ScalarFunctionWarning):
        watching, event = (narrow(), narrow_or_wide()), narrow_event()
    problem = lierb.Problem(free.body, free.joint, observables=watching, events=event)
    result = lierb.integrate(problem, twist0=TWISTS[0], save_every=1, **FALL)
    times = column(result.history, "t")
    np.testing.assert_array_equal(column(result.history, "narrow"), np.float32(times) * SMALL)
    wanted = np.where(times > 0.5, SMALL, np.float32(0.25))
    np.testing.assert_array_equal(column(result.history, "narrow_or_wide"), wanted)
    assert result.events.column("event").to_pylist() == ["narrow_event"]
    # where the sign changes, to the tolerance that an event is found to
    assert result.events.column("t").to_pylist() == pytest.approx([0.3], abs=1e-9)


def quadrupled(n):
    return n * 4


@lierb.observable(most=1.0)
def counting(t, r, params):
    steps = 2**61
    if t > 0.25:
        steps = quadrupled(steps) if params.most > 1.0 else int(params.most * 1e300)
    return steps


@pytest.mark.slow
def test_whole_numbers_beyond_their_bits_end_the_trajectory(free):
    """Values that are 2**63 and 5e299 in Python: no integer of 64 bits, and no zero."""
    with pytest.warns(ScalarFunctionWarning):
        watching = counting(most=[2.0, 0.5, 0.0])
    problem = lierb.Problem(free.body, free.joint, observables=watching)
    message = "counting raised OverflowError: a whole number beyond 64 bits; make it a float"
    with pytest.warns(FailedTrajectoryWarning, match=message):
        result = lierb.integrate(problem, twist0=TWISTS[:3], save_every=1, **FALL)
    assert result.summary["status"].to_pylist() == ["raised", "raised", "ok"]
    assert result.summary["t"].to_pylist() == [0.375, 0.375, 1.0]


@pytest.mark.slow
def test_observable_that_raises_ends_its_trajectory_where_it_does(fallen):
    assert fallen.summary["status"].to_pylist() == ["ok", "raised", "ok", "raised", "raised"]
    assert fallen.summary["t"].to_pylist() == [1.0, 0.25, 1.0, 0.0, 1.0]
    assert np.isnan(fallen.position[2:, 1]).all()
    assert np.isnan(fallen.position[:, 3]).all()
    assert np.isnan(fallen.position[-1, 4]).all()
    extremes = {how: column(fallen.summary, f"touchy_{how}") for how in ("min", "max")}
    np.testing.assert_array_equal(extremes["min"], [0.0, 0.0, np.nan, np.nan, 0.0])
    np.testing.assert_array_equal(extremes["max"], [1.0, 0.0, np.nan, np.nan, 0.75])
    for how in ("mean", "final"):
        assert np.isnan(column(fallen.summary, f"touchy_{how}")[[1, 3, 4]]).all()


@pytest.mark.slow
def test_observable_that_is_no_number_is_no_failure(fallen):
    assert fallen.summary["status"][2].as_py() == "ok"
    np.testing.assert_array_equal(history(fallen, "touchy")[:, 2] == 0.0, np.arange(9) == 0)
    assert np.isnan(history(fallen, "touchy")[1:, 2]).all()
    assert np.isnan(column(fallen.summary, "touchy_mean")[2])


@pytest.mark.slow
def test_observable_that_raises_leaves_others_alone(fallen, free):
    calm = lierb.integrate(free, twist0=TWISTS, save_every=1, measure_every=3, **FALL)
    np.testing.assert_array_equal(fallen.position[:, [0, 2]], calm.position[:, [0, 2]])
    np.testing.assert_array_equal(fallen.position[:2, 1], calm.position[:2, 1])
    np.testing.assert_array_equal(fallen.position[:8, 4], calm.position[:8, 4])


@pytest.mark.slow
def test_observables_body_by_body_have_the_same_values(fallen):
    np.testing.assert_array_equal(history(fallen, "touchy")[:, 0], np.arange(9) * 0.125)
    assert column(fallen.summary, "touchy_mean")[0] == 0.5


@pytest.mark.slow
def test_observable_of_time_alone_may_be_called_body_by_body(free):
    @lierb.observable
    def quarters(t):
        if t > 0.8:
            raise ValueError("too late")
        counted = 0.0
        while counted < t:
            counted += 0.25
        return counted

    with pytest.warns(ScalarFunctionWarning):
        problem = lierb.Problem(free.body, free.joint, observables=quarters())
    with pytest.warns(FailedTrajectoryWarning, match="trajectory 0, raised at t = 0.875 s"):
        result = lierb.integrate(problem, twist0=TWISTS, save_every=1, **FALL)
    expected = np.ceil(np.arange(9) / 2) / 4
    expected[7:] = np.nan
    np.testing.assert_array_equal(history(result, "quarters"), np.tile(expected, (5, 1)).T)
    assert column(result.summary, "quarters_max").tolist() == [0.75] * 5

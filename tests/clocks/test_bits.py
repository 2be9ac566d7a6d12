"""The bits of an adaptive trajectory depend on its own inputs, and on nothing else.

Tops whose velocities, and so whose steps, are of all sizes: lanes end at all times and take the
next trajectory while their neighbours go on.
"""

import numpy as np
import pytest
from cases import tiered

import lierb
from clocks.shared import bits, spread_tops, table_bits, top_problem
from lierb.model import problem as problem_module
from lierb.runs import engine
from lierb.runs import lane_engine as lanes

TWISTS = spread_tops()
TIMES = (0.0, 0.05, 0.1234567, 0.25)
T_END = 0.25


def run(twist0=TWISTS, problem=None, **options) -> lierb.Result:
    options = {"rtol": 1e-6, "t_end": T_END, "method": "DP54"} | options
    return lierb.integrate(problem or top_problem(), twist0=twist0, **options)


@lierb.event
def far_away(r):
    return r[0] - 1e3


@lierb.event
def crossing(omega):
    return omega[2]


WATCHED = {"save_at": TIMES, "record": ("state", "energy"), "events": [crossing()]}


@pytest.fixture(scope="module")
def whole() -> lierb.Result:
    return run()


@pytest.fixture(scope="module")
def expected(whole) -> np.ndarray:
    return bits(whole)


def test_steps_are_of_all_sizes(whole):
    """Else the other tests would say little."""
    tried = whole.summary["steps"].to_numpy() + whole.summary["rejected"].to_numpy()
    assert tried.max() > 20 * tried.min()
    assert whole.summary["rejected"].to_numpy().max() > 0


@pytest.mark.parametrize(
    "count", [1, 2, 3, 17, pytest.param(999, marks=pytest.mark.slow)]
)  # fmt: skip
def test_bits_of_adaptive_steps_do_not_depend_on_batch_size(count, expected):
    np.testing.assert_array_equal(bits(run(TWISTS[:count])), expected[:count])


def test_bits_of_adaptive_steps_do_not_depend_on_place_in_batch(expected):
    order = np.random.default_rng(2).permutation(len(TWISTS))
    np.testing.assert_array_equal(bits(run(TWISTS[order])), expected[order])


@pytest.mark.parametrize("by", ["slowest first", "fastest first"])
def test_bits_of_adaptive_steps_do_not_depend_on_refilling(by, whole, expected):
    """All lanes end together, or one runs on while the others are filled again and again."""
    order = np.argsort(whole.summary["steps"].to_numpy(), kind="stable")
    order = order[::-1] if by == "slowest first" else order
    np.testing.assert_array_equal(bits(run(TWISTS[order])), expected[order])
    mixed = np.ravel(np.column_stack([order[: len(order) // 2], order[: len(order) // 2 - 1 : -1]]))
    np.testing.assert_array_equal(bits(run(TWISTS[mixed])), expected[mixed])


@pytest.mark.parametrize("lanes", tiered([1, 2, 4, 8], [], [1, 8]))
def test_bits_of_adaptive_steps_do_not_depend_on_lanes(lanes, expected, monkeypatch):
    monkeypatch.setattr(problem_module, "DEFAULT_LANES", lanes)
    np.testing.assert_array_equal(bits(run()), expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_bits_of_adaptive_steps_do_not_depend_on_threads(threads, expected):
    import numba

    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one core only")
    np.testing.assert_array_equal(bits(run(threads=threads)), expected)


@pytest.mark.parametrize("iterations", [1, 8, 10_000])
def test_bits_of_adaptive_steps_do_not_depend_on_calls(iterations, expected, monkeypatch):
    """Lanes stop after so many iterations, and continue in the next call."""
    monkeypatch.setattr(lanes, "FIRST_ITERATIONS", iterations)
    monkeypatch.setattr(lanes, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(bits(run(TWISTS[:100])), expected[:100])


@pytest.mark.slow
def test_bits_of_adaptive_steps_do_not_depend_on_output_or_events(expected):
    """Output is taken between steps, and makes none shorter; an event that ends nothing leaves the
    motion alone.
    """
    result = run(**WATCHED)
    assert result.history.num_rows > 0
    assert result.events.num_rows > 0
    np.testing.assert_array_equal(bits(result), expected)


def test_bits_of_adaptive_steps_do_not_depend_on_sharing_of_parameters(expected):
    np.testing.assert_array_equal(bits(run(problem=top_problem(len(TWISTS)))), expected)


@pytest.mark.long
def test_bits_of_adaptive_steps_do_not_depend_on_events_that_do_not_fire(expected):
    result = run(events=[far_away()])
    np.testing.assert_array_equal(bits(result), expected)
    assert result.events.num_rows == 0


@pytest.mark.long
def test_bits_of_adaptive_steps_do_not_depend_on_events_alone(expected):
    result = run(events=[crossing()])
    assert result.events.num_rows > 0
    np.testing.assert_array_equal(bits(result), expected)


@pytest.mark.slow
def test_bits_of_output_and_events_do_not_depend_on_neighbours():
    whole = run(**WATCHED)
    count = len(TWISTS)
    for some in ([5], [3, 900, 17], list(range(100, 117))):
        alone = run(TWISTS[some], **WATCHED)
        rows = np.ravel([np.array(some) + k * count for k in range(len(TIMES))])
        np.testing.assert_array_equal(
            table_bits(alone.history, "trajectory"), table_bits(whole.history, "trajectory")[rows]
        )
        for place, number in enumerate(some):
            here, there = (
                table_bits(
                    table.filter(np.array(table["trajectory"].to_pylist()) == which),
                    "trajectory", "event",
                )
                for table, which in ((alone.events, place), (whole.events, number))
            )  # fmt: skip
            np.testing.assert_array_equal(here, there)


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_a_lane_that_fails_leaves_its_neighbours_alone(whole, expected):
    """Trajectories that exceed max_steps end; the others end as they would."""
    steps = whole.summary["steps"].to_numpy()
    tried = steps + whole.summary["rejected"].to_numpy()
    most = int(np.median(tried))
    result = run(max_steps=most)
    statuses = np.array(result.summary["status"].to_pylist())
    assert set(statuses) == {"ok", "max_steps"}
    assert (statuses[tried < most] == "ok").all()
    assert (statuses[steps > most] == "max_steps").all()
    fine = statuses == "ok"
    np.testing.assert_array_equal(bits(result)[fine], expected[fine])


@pytest.mark.long
@pytest.mark.parametrize(
    "form",
    [
        {"cspace": "SO3xR3", "update": "global"},
        {"update": "ambient"},
        *(
            pytest.param(form, marks=pytest.mark.long)
            for form in (
                {"method": "DOP853"}, {"cspace": "reduced"}, {"solver": "saddle"},
                {"cspace": "SO3xR3"}, {"update": "global"}, {"method": "BS32", "rtol": 1e-4},
                {"cspace": "SO3xR3", "update": "ambient"},
            )
        ),
    ],
    ids=str,
)  # fmt: skip
def test_bits_of_adaptive_steps_in_other_forms(form, monkeypatch):
    """Re-charting, too, goes lane by lane."""
    whole = bits(run(TWISTS[:64], **form))
    for some in ([7], [40, 3, 22], list(range(17))):
        np.testing.assert_array_equal(bits(run(TWISTS[some], **form)), whole[some])
    monkeypatch.setattr(problem_module, "DEFAULT_LANES", 1)
    np.testing.assert_array_equal(bits(run(TWISTS[:64], **form)), whole)


@pytest.mark.slow
def test_bits_of_adaptive_mechanisms_do_not_depend_on_neighbours():
    rod = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    hinge = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}
    revolute = lierb.joints.revolute
    pendulum = lierb.Mechanism(
        [
            lierb.Link("upper", rod, revolute(**hinge)),
            lierb.Link("lower", rod, revolute(**hinge, parent_point=(0, 0, -0.25)), "upper"),
        ],
        gravity=(0.0, 0.0, -9.81),
    )
    speeds = 10.0 ** np.random.default_rng(3).uniform(-1, 2, 40)

    def of(which):
        return lierb.integrate(
            pendulum, twist0=pendulum.twist({"lower": speeds[which]}), rtol=1e-6, t_end=0.3,
            method="DP54",
        )  # fmt: skip

    whole = bits(of(slice(None)))
    for some in ([0], [39, 4], list(range(17))):
        np.testing.assert_array_equal(bits(of(some)), whole[some])


# ---- fixed steps by the same driver ------------------------------------------------------------


@pytest.mark.long
def test_fixed_steps_with_output_between_them_end_at_the_bits_of_those_without():
    options = {"rtol": None, "dt": 1e-3, "t_end": 0.1}
    plain = run(TWISTS[:33], **options)
    saved = run(TWISTS[:33], save_at=(0.0123, 0.05, 0.1), record=("state",), **options)
    names = ("rotation", "position", "omega", "v", "t")
    seen = [table_bits(x.summary.select(names)) for x in (plain, saved)]
    np.testing.assert_array_equal(*seen)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning")
def test_marks_of_functions_that_raise_are_of_ends_alone(monkeypatch):
    """Stale memory is no exception: calls end while trajectories still run."""

    @lierb.wrench
    def damping(t, R, r, omega, v, params):
        return (np.zeros(3) if v[0] > 0 else 1e-3 * omega), np.zeros(3)

    empty = engine.Output.empty

    def used(*args, **options):
        output = empty(*args, **options)
        output.summary.fill(1e300)
        return output

    monkeypatch.setattr(engine.Output, "empty", staticmethod(used))
    monkeypatch.setattr(lanes, "FIRST_ITERATIONS", 3)
    body = lierb.Body(1.0, (0.1, 0.2, 0.25))
    problem = lierb.Problem(body, lierb.joints.free(), (0, 0, 0), forces=[damping()])
    result = run(np.tile([1.0, 20.0, 3.0, 0, 0, 0], (8, 1)), problem, rtol=1e-4)
    assert result.summary["status"].to_pylist() == ["ok"] * 8


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning")
@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_a_lane_after_one_that_has_raised_starts_anew():
    """And what raises in a lane is not lost when a neighbour ends."""

    @lierb.wrench(end=9.0)
    def damping(t, R, r, omega, v, params):
        if t > params.end:
            raise ValueError("over")
        return -0.1 * omega, np.zeros(3)

    @lierb.event(terminal=True, end=9.0)
    def stop(t, params):
        return t - params.end

    body = lierb.Body(1.0, (0.1, 0.2, 0.25))

    def summary(raises, ends):
        problem = lierb.Problem(
            body, lierb.joints.free(), (0, 0, 0), forces=[damping(end=raises)],
            events=[stop(end=ends)],
        )  # fmt: skip
        return run(np.tile([1.0, 2.0, 3.0, 0, 0, 0], (len(raises), 1)), problem, t_end=1.0)

    never = np.full(24, 9.0)
    alone = bits(summary(never, never), "end")
    early = np.r_[np.full(8, 0.1), never[8:]]
    mixed = summary(early, np.r_[never[:8], np.linspace(0.09, 0.12, 8), never[16:]])
    expected = ["raised"] * 8 + ["event"] * 8 + ["ok"] * 8
    assert mixed.summary["status"].to_pylist() == expected
    np.testing.assert_array_equal(bits(mixed, "end")[16:], alone[16:])

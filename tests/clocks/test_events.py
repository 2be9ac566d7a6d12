"""Times of crossings against closed forms, and what an event says of them."""

import mpmath
import numpy as np
import pytest
from cases import long_but, slow_but, tiered

import lierb
from clocks.shared import G, rows_of, spinning, table_bits, thrown

EXACT = 1e-12  # s


def above(r, params):
    return r[2] - params.level


def height(level=0.0, name="height", **how):
    """All runs with two events of these functions share a kernel: level, name and what is done
    with it are none of the kernel's business.
    """
    return lierb.event(level=0.0, **how)(above)(level=level).named(name)


def landing():
    return height(0.0, "landing", direction=-1, terminal=True)


def turned_by(R, params):
    return R[1, 0] - params.sine


turned = lierb.event(sine=0.0)(turned_by)


@lierb.event(value=0.0)
def rate(omega, params):
    return omega[1] - params.value


NEVER = height(-1e9, "never")
NEVER_TURNED, NEVER_SO_FAST = turned(sine=2.0), rate(value=1e9)


def seen(result, trajectory=0, event=None) -> np.ndarray:
    """Times of one trajectory's events."""
    table = result.events
    which = np.array(table["trajectory"].to_pylist()) == trajectory
    names = table["event"].to_pylist()
    if event is not None:
        which &= np.array([name == event for name in names], bool)
    return rows_of(table, "t")[which]


def crossings(h, v, level):
    """Both times at which a body thrown from h at speed v is at `level`, s."""
    root = np.sqrt(v * v + 2.0 * G * (h - level))
    return (v - root) / G, (v + root) / G


# ---- free fall ---------------------------------------------------------------------------------


CLOCKS = [{"rtol": 1e-6}, pytest.param({"dt": 0.05}, marks=pytest.mark.long)]


@pytest.mark.slow
@pytest.mark.parametrize("clock", CLOCKS, ids=str)
@pytest.mark.parametrize("cspace", ["SO3xR3", pytest.param("SE3", marks=pytest.mark.long)])
def test_free_fall_crosses_when_it_should(clock, cspace):
    """A parabola is integrated without error by any method of order 2: what is left is the root.

    Turning adds an error of its own on SE(3), where v is in body axes: there it does not turn.
    """
    h, v = np.array([1.0, 2.0, 5.0, 0.3]), np.array([0.0, 3.0, 7.0, 4.0])
    problem, start = thrown(h, v, events=[height(0.0), height(1.5, "half")])
    result = lierb.integrate(problem, **start, t_end=2.0, method="DP54", cspace=cspace, **clock)
    for i in range(4):
        for event, level in (("height", 0.0), ("half", 1.5)):
            if v[i] ** 2 + 2 * G * (h[i] - level) < 0:  # never that high
                assert seen(result, i, event).size == 0
                continue
            true = [t for t in crossings(h[i], v[i], level) if 0.0 < t < 2.0]
            np.testing.assert_allclose(seen(result, i, event), true, rtol=0, atol=EXACT)


@pytest.mark.slow
def test_direction_selects_crossings():
    problem, start = thrown(
        0.5, 5.0,
        events=[height(1.0, "rising", direction=+1), height(1.0)],
    )  # fmt: skip
    result = lierb.integrate(problem, **start, t_end=1.5, rtol=1e-6, cspace="SO3xR3", method="DP54")
    up, down = crossings(0.5, 5.0, 1.0)
    np.testing.assert_allclose(seen(result, event="rising"), [up], atol=EXACT)
    np.testing.assert_allclose(seen(result, event="height"), [up, down], atol=EXACT)


def test_falling_direction_leaves_the_rise_out():
    problem, start = thrown(0.5, 5.0, events=[height(1.0, direction=-1), NEVER])
    result = lierb.integrate(problem, **start, t_end=1.5, rtol=1e-6, cspace="SO3xR3", method="DP54")
    np.testing.assert_allclose(seen(result), [crossings(0.5, 5.0, 1.0)[1]], atol=EXACT)


def test_terminal_event_ends_its_trajectory_alone():
    h, v = np.array([1.0, 50.0, 3.0]), np.zeros(3)
    problem, start = thrown(h, v, events=[landing(), height(0.5)])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, cspace="SO3xR3", method="DP54")
    statuses = result.summary["status"].to_pylist()
    assert statuses == ["event", "ok", "event"]
    ended = rows_of(result.summary, "t")
    np.testing.assert_allclose(ended[[0, 2]], np.sqrt(2 * h[[0, 2]] / G), atol=EXACT)
    assert ended[1] == 1.0
    np.testing.assert_array_equal(result.event_times("landing", 2), seen(result, 2, "landing"))
    assert result.event_times("height").size == 1
    assert result.event_times("height", 1).size == 0
    for wrong, message in (("heigth", "Did you mean 'height'"), ("landing", "trajectory=3")):
        with pytest.raises(lierb.errors.LierbError, match=message):
            result.event_times(wrong, 3)
    # it has its row as well; nothing comes after it
    assert seen(result, 0, "landing") == pytest.approx(ended[0], abs=0)
    assert seen(result, 0).max() == ended[0]
    # where it ended is where it crossed
    at_end = rows_of(result.summary, "position")[[0, 2], 2]
    np.testing.assert_allclose(at_end, 0.0, atol=1e-11)
    speed = rows_of(result.summary, "v")[[0, 2], 2]
    np.testing.assert_allclose(speed, -G * ended[[0, 2]], rtol=1e-12)


def test_an_event_is_no_failure(recwarn):
    problem, start = thrown(1.0, 0.0, events=[landing(), NEVER])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, cspace="SO3xR3", method="DP54")
    assert len(result.failed) == 0
    assert not [w for w in recwarn if w.category is lierb.errors.FailedTrajectoryWarning]


def test_events_of_the_call_are_added_to_those_of_the_problem():
    problem, start = thrown(1.0, 0.0, events=[height(0.5)])
    result = lierb.integrate(
        problem, **start, t_end=1.0, rtol=1e-6, cspace="SO3xR3", method="DP54", events=[landing()]
    )
    assert result.events["event"].to_pylist() == ["height", "landing"]


def test_no_events_no_table():
    problem, start = thrown(1.0, 0.0)
    result = lierb.integrate(problem, **start, t_end=0.1, dt=0.1)
    assert result.events is None
    with pytest.raises(lierb.errors.ArgumentError, match="there is no table of events; give"):
        result.event_times("landing")


def test_events_table_is_sorted_and_says_where_the_body_was():
    h = np.array([2.0, 1.0])
    problem, start = thrown(h, np.zeros(2), events=[height(0.0), height(0.7, "b")])
    result = lierb.integrate(problem, **start, t_end=0.8, rtol=1e-6, cspace="SO3xR3", method="DP54")
    table = result.events
    assert table["trajectory"].to_pylist() == [0, 0, 1, 1]
    assert table["event"].to_pylist() == ["b", "height", "b", "height"]
    assert {"trajectory", "event", "t", "rotation", "position", "omega", "v"} <= set(
        table.column_names
    )
    np.testing.assert_allclose(
        rows_of(table, "position")[:, 2], [0.7, 0.0, 0.7, 0.0], rtol=0, atol=1e-11
    )
    t = rows_of(table, "t")
    np.testing.assert_allclose(rows_of(table, "v")[:, 2], -G * t, rtol=1e-12)


# ---- rotation ----------------------------------------------------------------------------------


@pytest.mark.long
def test_a_turning_ball_crosses_again_and_again():
    """R₂₁ = sin ωt: exact on the group, whatever the step; dt_max keeps crossings apart."""
    rates, sine = np.array([1.0, 7.0, 30.0]), 0.3
    problem, start = spinning(rates, events=[turned(sine=sine), NEVER_SO_FAST])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, dt_max=0.02, method="DP54")
    first = np.arcsin(sine)
    for i, w in enumerate(rates):
        k = np.arange(40)
        true = np.sort(np.concatenate([first + 2 * np.pi * k, np.pi - first + 2 * np.pi * k])) / w
        np.testing.assert_allclose(seen(result, i), true[true < 1.0], rtol=0, atol=EXACT)


@pytest.mark.slow
def test_an_event_that_starts_at_zero_waits_for_the_next_crossing():
    """R₂₁ = sin ωt is zero at t = 0, and there is no crossing: half a turn later there is."""
    problem, start = spinning([np.pi], events=[turned(sine=0.0), NEVER_SO_FAST])
    result = lierb.integrate(problem, **start, t_end=2.5, rtol=1e-6, dt_max=0.1, method="DP54")
    np.testing.assert_allclose(seen(result), [1.0, 2.0], atol=EXACT)


def test_a_terminal_event_that_starts_at_zero_lets_it_go():
    """Thrown up from the ground: it lands when it comes back."""
    problem, start = thrown(0.0, 3.0, events=[landing(), NEVER])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, cspace="SO3xR3", method="DP54")
    np.testing.assert_allclose(seen(result), [2 * 3.0 / G], atol=EXACT)


def test_an_event_that_stays_at_zero_does_not_fire():
    problem, start = spinning([2.0], events=[NEVER_TURNED, rate(value=0.0)])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, method="DP54")
    assert result.events.num_rows == 0


def test_an_event_at_the_very_end_is_seen():
    """A crossing at t_end, less a rounding."""
    problem, start = spinning([np.pi], events=[turned(sine=0.0), NEVER_SO_FAST])
    result = lierb.integrate(
        problem, **start, t_end=float(np.nextafter(1.0, 2.0)) + 1e-9, rtol=1e-6, dt_max=0.1,
        method="DP54",
    )  # fmt: skip
    np.testing.assert_allclose(seen(result), [1.0], atol=EXACT)


WITHOUT_EXTENSION = long_but(["RK4", "Heun", "CF4"], "RK4")


@pytest.mark.long
@pytest.mark.parametrize("below", [1e-3, 1e-6])
@pytest.mark.parametrize("method", ["DP54", *WITHOUT_EXTENSION])
def test_two_crossings_in_a_step_are_found(below, method):
    """A level `below` m under the top of a parabola has two crossings closer than any step."""
    v = 4.0
    top = v * v / (2 * G)
    problem, start = thrown(0.0, v, events=[height(top - below), NEVER])
    clock = {"rtol": 1e-6} if method == "DP54" else {"dt": 0.2}
    result = lierb.integrate(problem, **start, t_end=0.8, cspace="SO3xR3", method=method, **clock)
    true = crossings(0.0, v, top - below)
    # what the height is uncertain by, 1e-15 m, is √ of that in time where it does not cross fast
    speed = G * (true[1] - true[0]) / 2
    np.testing.assert_allclose(seen(result), true, rtol=0, atol=max(EXACT, 1e-14 / speed))


def test_a_level_that_is_just_missed_is_not_crossed():
    """A parabola that misses the level by 1e-9 m has no crossing."""
    v = 4.0
    top = v * v / (2 * G)
    problem, start = thrown(0.0, v, events=[height(top + 1e-9), NEVER])
    result = lierb.integrate(problem, **start, t_end=0.8, rtol=1e-6, cspace="SO3xR3", method="DP54")
    assert result.events.num_rows == 0


# ---- pendulum ----------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("clock", [{"rtol": 1e-13}, {"dt": 2e-3}], ids=str)
def test_pendulum_swings_through_when_jacobi_says(clock):
    """Released from rest at 90°: at the bottom after K/w, 3K/w, …; at rest again after 2K/w."""
    m, length, inertia = 1.2, 0.7, 0.05
    body = lierb.Body(m, (inertia, inertia, 0.02))
    joint = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, length))

    @lierb.event
    def bottom(r):
        return r[0]

    @lierb.event
    def still(omega):
        return omega[1]

    problem = lierb.Problem(body, joint, (0.0, 0.0, -G), events=[bottom(), still()])
    pose0 = np.eye(4)
    pose0[:3, :3] = lierb.lie.so3.exp((0.0, np.pi / 2, 0.0))
    pose0[:3, 3] = pose0[:3, :3] @ (0.0, 0.0, -length)
    result = lierb.integrate(
        problem, twist0=np.zeros(6), pose0=pose0, t_end=4.0, method="DOP853", cspace="reduced",
        **clock,
    )  # fmt: skip
    w = mpmath.sqrt(mpmath.mpf(m) * G * length / (inertia + m * mpmath.mpf(length) ** 2))
    quarter = float(mpmath.ellipk(mpmath.mpf(1) / 2) / w)
    through = np.arange(1, 20, 2) * quarter
    np.testing.assert_allclose(
        seen(result, event="bottom"), through[through < 4.0], rtol=0, atol=EXACT
    )
    rest = np.arange(2, 20, 2) * quarter
    np.testing.assert_allclose(seen(result, event="still"), rest[rest < 4.0], rtol=0, atol=EXACT)


# ---- parameters, mechanisms, errors ------------------------------------------------------------


def test_an_events_parameters_may_be_each_trajectorys_own():
    levels = np.array([0.2, 0.5, 0.9])
    problem, start = thrown(np.ones(3), np.zeros(3), events=[height(levels), NEVER])
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, cspace="SO3xR3", method="DP54")
    true = np.sqrt(2 * (1.0 - levels) / G)
    np.testing.assert_allclose([seen(result, i)[0] for i in range(3)], true, atol=EXACT)


@pytest.mark.slow
def test_an_event_on_a_link_of_a_mechanism():
    rod = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    hinge = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}

    @lierb.event
    def below(r):
        return r[0]

    made = lierb.Mechanism(
        [lierb.Link("rod", rod, lierb.joints.revolute(**hinge))],
        gravity=(0.0, 0.0, -G), events=[below().on("rod")],
    )  # fmt: skip
    pose0 = made.pose({"rod": np.pi / 2})
    result = lierb.integrate(made, pose0=pose0, twist0=made.twist({}, pose0), t_end=4.0, rtol=1e-13)
    inertia = rod.inertia[1, 1] + 0.25**2
    w = mpmath.sqrt(mpmath.mpf(G) * 0.25 / inertia)
    quarter = float(mpmath.ellipk(mpmath.mpf(1) / 2) / w)
    through = np.arange(1, 20, 2) * quarter  # released from rest at 90°
    np.testing.assert_allclose(seen(result), through[through < 4.0], rtol=0, atol=EXACT)
    assert "rod.position" in result.events.column_names


def test_the_same_times_whatever_the_neighbours():
    h = np.linspace(0.5, 3.0, 21)
    problem, start = thrown(h, np.zeros(21), events=[landing(), NEVER])
    options = {"t_end": 1.0, "rtol": 1e-6, "cspace": "SO3xR3", "method": "DP54"}
    whole = lierb.integrate(problem, **start, **options).events
    one, alone = thrown(h[13], 0.0, events=[landing(), NEVER])
    found = lierb.integrate(one, **alone, **options).events
    np.testing.assert_array_equal(
        table_bits(found, "trajectory", "event"),
        table_bits(whole, "trajectory", "event")[[13]],
    )


def test_wrong_events_are_told():
    problem, start = thrown(1.0, 0.0)
    for wrong in (3, [lambda r: r[2]], [turned]):
        with pytest.raises(lierb.errors.LierbError, match="event"):
            lierb.integrate(problem, **start, t_end=1.0, rtol=1e-6, events=wrong)
    with pytest.raises(lierb.errors.LierbError, match="direction"):
        lierb.event(direction=2)(lambda r: r[2])


# ---- short visits, and what has no value -------------------------------------------------------


@lierb.event(angle=0.0, within=1.0)
def aimed(R, params):
    """Positive while the body's e₁ is within an angle of a direction in the plane."""
    cos, sin, least = (f(a) for f, a in (
        (np.cos, params.angle), (np.sin, params.angle), (np.cos, params.within),
    ))  # fmt: skip
    return R[0, 0] * cos + R[1, 0] * sin - least


@lierb.event(zero=0.3, first=1.0, last=1.0)
def undefined(t, params):
    is_lost = (params.first < t) & (t < params.last)
    return lierb.where(is_lost, np.nan, t - params.zero)


RATE = 6.0  # rad/s, of a ball
COUNT = 300


def visits(within=1.0, zero=-1.0, first=1.0, last=1.0, **clock):
    angles = np.linspace(1.0, 5.0, COUNT)
    events = [aimed(angle=angles, within=within), undefined(zero=zero, first=first, last=last)]
    problem, start = spinning(np.full(COUNT, RATE), events=events)
    clock = {"rtol": 1e-6} | clock
    return angles, lierb.integrate(problem, **start, t_end=1.0, method="DP54", **clock)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [1.0, 0.1, 0.01])
@pytest.mark.parametrize(
    "clock",
    [
        {"rtol": 1e-6},
        pytest.param({"rtol": 1e-9}, marks=pytest.mark.long),
        pytest.param({"rtol": None, "dt": 0.25}, marks=pytest.mark.long),
    ],
    ids=str,
)
def test_a_visit_is_seen_however_short(degrees, clock):
    """Steps turn the ball by up to a radian, ten thousand times as far as it is within the angle.

    The event is that flat there that rounding of 1e-16 moves a crossing by 1e-16 / (angle · rate).
    """
    within = np.radians(degrees)
    angles, result = visits(within=within, **clock)
    times = rows_of(result.events, "t").reshape(COUNT, 2)
    true = (angles[:, None] + within * np.array([-1.0, 1.0])) / RATE
    # of fixed steps those of the solution, which turns by 6.0 rad to 1e-12
    np.testing.assert_allclose(times, true, rtol=0, atol=1e-14 / within + 1e-12)


@pytest.mark.long
@pytest.mark.parametrize("clock", [{"rtol": 1e-6}, {"rtol": None, "dt": 0.1}], ids=str)
def test_nothing_is_crossed_where_an_event_is_nan(clock):
    """Neither into it, nor out of it, nor from one side of it to the other."""
    for first, last, expected in ((0.29, 0.31, 0), (0.25, 0.6, 0), (0.5, 0.6, 1), (0.4, 2.0, 1)):
        _, result = visits(within=0.0, zero=0.3, first=first, last=last, **clock)
        assert result.summary["status"].to_pylist() == ["ok"] * COUNT
        names = result.events["event"].to_pylist()
        assert names.count("undefined") == expected * COUNT, (first, last)


def test_a_condition_is_refused():
    @lierb.event
    def late(t):
        return t > 0.3

    with pytest.raises(lierb.errors.ForceError, match=r"late returns a condition.* t - 0\.3"):
        thrown(1.0, 0.0, events=late())


@pytest.mark.parametrize(
    "clock", slow_but([{"rtol": 1e-6}, {"rtol": None, "dt": 0.5, "method": "RK4"}], {"rtol": 1e-6}),
    ids=str,
)  # fmt: skip
def test_what_starts_at_zero_to_rounding_lands_when_it_comes_back(clock):
    """Within the first quarter of the first step."""
    heights = np.array([0.0, 1e-13, -1e-13, 1e-12])
    event = height(0.0, terminal=True, direction=-1)
    problem, start = thrown(heights, np.full(4, 0.1), events=[event, NEVER])
    options = {"method": "DP54", "cspace": "SO3xR3", "rtol": 1e-6} | clock
    result = lierb.integrate(problem, **start, t_end=4.0, **options)
    np.testing.assert_allclose(result.t, 0.2 / G, rtol=0, atol=1e-10)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
def test_what_has_crossed_may_bounce(rtol):
    """It is beyond the ground by a rounding, and starts on it: in either direction."""
    event = height(0.0, terminal=True)
    problem, start = thrown(0.7, 1.3, events=[event, NEVER])
    options = {"rtol": rtol, "method": "DP54", "cspace": "SO3xR3"}
    first = lierb.integrate(problem, **start, t_end=3.0, **options)
    (landed,) = first.t.tolist()
    up = first.end | {"twist0": first.end["twist0"] * [1, 1, 1, 1, 1, -1]}
    again = lierb.integrate(problem, **up, t_end=9.0, **options)
    speed = np.sqrt(1.3**2 + 2.0 * G * 0.7)
    assert again.t[0] - landed == pytest.approx(2.0 * speed / G, abs=1e-11)
    through = lierb.integrate(problem, **first.end, t_end=9.0, **options)
    assert through.summary["status"].to_pylist() == ["ok"]


# ---- balls that bounce -------------------------------------------------------------------------


def bounced(result, restitution) -> dict:
    """The start after a bounce."""
    velocity = np.einsum("nij,nj->ni", result.rotation, result.v)
    velocity[:, 2] *= -restitution
    pose0 = np.tile(np.eye(4), (len(velocity), 1, 1))
    pose0[:, :3, :3], pose0[:, :3, 3] = result.rotation, result.position
    back = np.einsum("nji,nj->ni", result.rotation, velocity)
    return {"pose0": pose0, "twist0": np.concatenate([result.omega, back], axis=1)}


@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize(
    "clock",
    tiered(
        [
            {"method": "DP54", "rtol": 1e-6},
            {"method": "RK4", "dt": 1e-3},
            {"method": "RK4", "dt": 0.1},
            {"method": "Heun", "dt": 0.01},
            {"method": "CF4", "dt": 0.01},
        ],
        [{"method": "DP54", "rtol": 1e-6}],
        [{"method": "RK4", "dt": 1e-3}, {"method": "RK4", "dt": 0.1}],
    ),
    ids=str,
)  # fmt: skip
def test_a_ball_bounces_however_short_its_flights(clock, direction):
    """The k-th flight takes 2 eᵏ v₀/g. The last ones are shorter than rounding lets be seen."""
    restitution = np.array([0.5, 0.5, 0.65, 0.8, 0.8, 0.95, 0.95])
    floor = np.array([0.0, 100.0, -7.3, 0.0, 3.0, 20.0, -0.1])
    drop = np.array([10.0, 10.0, 2.0, 10.0, 0.37, 10.0, 0.05])
    events = [height(floor, terminal=True, direction=direction), NEVER]
    problem, start = thrown(floor + drop, np.zeros(7), (0.3, -0.2, 0.1), events=events)
    expected, speed, t = np.sqrt(2.0 * drop / G), np.sqrt(2.0 * G * drop), np.zeros(7)
    for _ in range(60):
        result = lierb.integrate(problem, **start, t_end=3.0, cspace="SO3xR3", **clock)
        assert set(result.summary["status"].to_pylist()) == {"event"}
        t += result.t
        # A flight that stays below rounding of the height, δ ≤ 1.5e-14 m, takes up to √(8 δ/g) =
        # 1e-7 s and counts as none; all that follow take 1/(1 − e) as long.
        off = np.abs(t - expected) * (1.0 - restitution)
        assert np.all(off <= np.where(floor == 0.0, EXACT, 1.5e-7))
        np.testing.assert_allclose(result.position[:, 2], floor, rtol=0, atol=1e-13)
        speed *= restitution
        expected += 2.0 * speed / G
        start = bounced(result, restitution)


@pytest.mark.parametrize("clock", CLOCKS, ids=str)
def test_what_rests_on_zero_and_falls_ends_at_once(clock):
    """A ball that lies on the floor: it has just bounced for the last time."""
    floor = np.array([0.0, 100.0, -7.3])
    options = {"t_end": 1.0, "method": "DP54", "cspace": "SO3xR3", **clock}
    for direction in (-1, 0):
        events = [height(floor, terminal=True, direction=direction), NEVER]
        problem, start = thrown(floor, np.zeros(3), events=events)
        result = lierb.integrate(problem, **start, **options)
        assert result.summary["status"].to_pylist() == ["event"] * 3
        np.testing.assert_allclose(result.t, 0.0, rtol=0, atol=EXACT)
    for event in (height(floor), height(floor, terminal=True, direction=1)):
        problem, start = thrown(floor, np.zeros(3), events=[event, NEVER])
        result = lierb.integrate(problem, **start, **options)
        assert result.summary["status"].to_pylist() == ["ok"] * 3
        assert result.events.num_rows == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "clock", [{"rtol": 1e-6, "dt_max": 0.1}, pytest.param({"dt": 0.05}, marks=pytest.mark.long)],
    ids=str,
)  # fmt: skip
def test_what_passes_zero_at_its_start_goes_on(clock):
    """sin ωt passes zero at t = 0; a turn later it does so again, in the same direction."""
    ends = lierb.event(sine=0.0, terminal=True, direction=-1)(turned_by)
    problem, start = spinning([-np.pi, -7.0], events=[ends(), NEVER_SO_FAST])
    result = lierb.integrate(problem, **start, t_end=2.5, method="DP54", **clock)
    np.testing.assert_allclose(result.t, [2.0, 2.0 * np.pi / 7.0], rtol=0, atol=EXACT)

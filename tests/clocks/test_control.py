"""Sampled control against a loop written by hand, and noise that can be played again."""

import numpy as np
import pytest
from cases import column, tiered
from scipy import stats

import lierb
from clocks.shared import rows_of, spinning, table_bits

EVERY, DT, TICKS = 0.1, 0.02, 20
MOMENTS = np.array((12.0, 15.0, 18.0))
KP, KD, KI = 0.4, 4.0, 0.02


def fleet(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and ω."""
    rng = np.random.default_rng(7)
    return lierb.lie.so3.exp(0.5 * rng.standard_normal((count, 3))), 0.1 * rng.standard_normal(
        (count, 3)
    )


def off_axis(R):
    """(3,): works inside a controller, and on a batch (…, 3, 3) by its last axes."""
    return 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )


@lierb.controller(every=EVERY, memory={"integral": (0.0, 0.0, 0.0)}, kp=KP, kd=KD, ki=KI)
def pid(R, omega, params, memory):
    error = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    torque = -(params.kp * error + params.kd * omega + params.ki * memory.integral)
    return {"torque": torque}, {"integral": memory.integral + EVERY * error}


@lierb.controller(every=EVERY, kp=KP, kd=KD)
def noisy_pd(R, omega, params):
    error = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    gyro = 1e-3 * lierb.noise.normal("gyro", 3)
    torque = -(params.kp * error + params.kd * (omega + gyro))
    return {"torque": torque, "gyro": gyro, "idle": lierb.noise.normal("idle")}


@lierb.wrench
def thrusters(t, R, r, omega, v, params, controls):
    return controls.torque, (0.0, 0.0, 0.0)


def satellites(rotation, omega, *controllers, **more):
    problem = lierb.Problem(
        lierb.Body(100.0, MOMENTS), lierb.joints.spherical(), forces=[thrusters()],
        controllers=list(controllers), **more,
    )  # fmt: skip
    pose0 = np.tile(np.eye(4), (len(omega), 1, 1))
    pose0[:, :3, :3] = rotation
    return problem, {"pose0": pose0, "twist0": np.pad(omega, ((0, 0), (0, 3)))}


def by_hand(rotation, omega, torque_of, ticks=TICKS, cspace="reduced"):
    """R and ω after so many ticks, by `integrate` from tick to tick."""
    body, held = lierb.Body(100.0, MOMENTS), lierb.joints.spherical()
    for tick in range(ticks):
        force = lierb.forces.constant_wrench(torque_of(tick, rotation, omega), frame="body")
        pose0 = np.tile(np.eye(4), (len(omega), 1, 1))
        pose0[:, :3, :3] = rotation
        summary = lierb.integrate(
            lierb.Problem(body, held, forces=force), pose0=pose0,
            twist0=held.twist(omega=omega), dt=DT, t_end=EVERY, cspace=cspace, check="off",
        ).summary  # fmt: skip
        rotation, omega = column(summary, "rotation").reshape(-1, 3, 3), column(summary, "omega")
    return rotation, omega


def run(count=5, controller=None, cspace="reduced", ticks=TICKS, **options):
    """Record a history in every run, so that all share a kernel."""
    problem, start = satellites(*fleet(count), controller or pid())
    options = {
        "dt": DT, "t_end": ticks * EVERY, "method": "RK4", "save_at": [ticks * EVERY],
        "record": ("state",),
    } | options  # fmt: skip
    return lierb.integrate(problem, **start, cspace=cspace, **options)


@pytest.mark.long
@pytest.mark.parametrize("cspace", tiered(["reduced", "SE3"], [], ["reduced"]))
def test_pid_is_the_loop_written_by_hand(cspace):
    """Equal steps differ by the rounding of 100 steps, which the controller damps."""
    rotation, omega = fleet(5)
    integral = np.zeros((5, 3))

    def torque_of(tick, R, w):
        nonlocal integral
        torque = -(KP * off_axis(R) + KD * w + KI * integral)
        integral = integral + EVERY * off_axis(R)
        return torque

    R, w = by_hand(rotation, omega, torque_of, cspace=cspace)
    result = run(cspace=cspace)
    np.testing.assert_allclose(column(result.summary, "rotation").reshape(-1, 3, 3), R, atol=1e-13)
    np.testing.assert_allclose(column(result.summary, "omega"), w, atol=1e-14)


@pytest.mark.slow
def test_adaptive_steps_end_at_the_ticks():
    """Against the loop by hand at short steps, to 30 rtol of it."""
    rotation, omega = fleet(3)
    R, w = by_hand(rotation, omega, lambda tick, R, w: -(KP * off_axis(R) + KD * w), ticks=10)
    result = run(3, pid(ki=0.0), ticks=10, rtol=1e-9, dt=None, method="DP54")
    np.testing.assert_allclose(column(result.summary, "rotation").reshape(-1, 3, 3), R, atol=3e-8)
    np.testing.assert_allclose(column(result.summary, "omega"), w, atol=3e-8)
    assert (result.summary["steps"].to_numpy() >= 10).all()


@pytest.mark.slow
def test_fixed_steps_are_shortened_where_a_controller_ticks():
    """dt = 0.03 s and ticks each 0.1 s: steps of 30, 30, 30 and 10 ms."""
    rotation, omega = fleet(2)

    def in_four_steps(R, w):
        body, held = lierb.Body(100.0, MOMENTS), lierb.joints.spherical()
        for _ in range(3):
            torque = -(KP * off_axis(R) + KD * w)
            for dt, steps in ((0.03, 3), (0.01, 1)):
                force = lierb.forces.constant_wrench(torque, frame="body")
                pose0 = np.tile(np.eye(4), (len(w), 1, 1))
                pose0[:, :3, :3] = R
                summary = lierb.integrate(
                    lierb.Problem(body, held, forces=force), pose0=pose0,
                    twist0=held.twist(omega=w), dt=dt, t_end=steps * dt, cspace="reduced",
                    check="off",
                ).summary  # fmt: skip
                R, w = column(summary, "rotation").reshape(-1, 3, 3), column(summary, "omega")
        return R, w

    R, w = in_four_steps(rotation, omega)
    result = run(2, pid(ki=0.0), ticks=3, dt=0.03)
    np.testing.assert_allclose(column(result.summary, "rotation").reshape(-1, 3, 3), R, atol=1e-12)
    np.testing.assert_allclose(column(result.summary, "omega"), w, atol=1e-13)


@pytest.mark.slow
def test_outputs_are_held_between_ticks_and_zero_before_the_first():
    """t0 is no multiple of the period: nothing acts until the first one."""
    times = (0.05, 0.07, 0.09, 0.1, 0.15, 0.19, 0.2, 0.25)
    result = run(1, pid(ki=0.0), t0=0.05, t_end=0.25, dt=0.01, save_at=times)
    torque, omega = rows_of(result.history, "torque"), rows_of(result.history, "omega")
    R = rows_of(result.history, "rotation").reshape(-1, 3, 3)
    np.testing.assert_array_equal(torque[:3], 0.0)
    at = {0.1: 3, 0.2: 6}
    for first, rows in ((at[0.1], (4, 5)), (at[0.2], (7,))):
        true = -(KP * off_axis(R[first]) + KD * omega[first])
        for row in rows:
            np.testing.assert_allclose(torque[row], true, rtol=1e-12)


@lierb.controller(every=0.1, memory={"count": 0.0})
def counter(t, memory):
    """Count the ticks, and record the time of the last."""
    return {"ticks": memory.count + 1.0, "stamped": t}, {"count": memory.count + 1.0}


@lierb.event(terminal=True, at=1e9)
def alarm(t, params):
    return t - params.at


@lierb.event(value=0.9)
def passes(R, params):
    return R[1, 0] - params.value


def counted(controller, count, t_end):
    """Events in every run, so that all share a kernel."""
    problem, start = spinning([1.0] * count, controllers=[controller], events=[passes(), alarm()])
    return lierb.integrate(problem, **start, t_end=t_end, dt=0.05).summary


@pytest.mark.slow
def test_memory_starts_where_it_is_told():
    summary = counted(counter(count=np.array([0.0, 10.0])), 2, 0.55)
    np.testing.assert_array_equal(column(summary, "ticks"), [6.0, 16.0])  # at 0, 0.1, … 0.5


@pytest.mark.slow
def test_the_period_may_be_each_trajectorys_own():
    summary = counted(counter(every=np.array([0.1, 0.25, 0.3])), 3, 0.95)
    np.testing.assert_array_equal(column(summary, "ticks"), [10.0, 4.0, 4.0])


@pytest.mark.slow
def test_ticks_do_not_drift():
    """A thousand ticks of 0.1 s: the last one is at 99.9 s, not a rounding later."""
    summary = counted(counter(), 1, 99.95)
    assert column(summary, "ticks").tolist() == [1000.0]
    assert column(summary, "stamped").tolist() == pytest.approx([999 * 0.1], rel=4e-16)


# ---- ticks, rows, events and ends at one time --------------------------------------------------


def ball(start=None, every=0.3, at=1e9, **options):
    """One that turns by 1 rad/s, a counter of ticks, an alarm, and an event at arcsin 0.9."""
    problem, first = spinning([1.0], controllers=[counter(every=every)], events=passes())
    given = first if start is None else start.end
    options = {"dt": 0.1, "t_end": 1.5} | options
    return lierb.integrate(problem, **given, events=alarm(at=at), **options)


def turned_by(result) -> float:
    R = column(result.summary, "rotation")[0]
    return float(np.arctan2(R[3], R[0]))


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.05, 0.3, 0.432, 0.6, 0.9999999999])
def test_a_run_goes_on_from_a_terminal_event_where_it_was(at):
    """Fixed steps are counted from there: no time is lost, and no tick."""
    first = ball(at=at)
    assert column(first.summary, "t")[0] == pytest.approx(at, abs=1e-14)
    end = at + 1.5
    second = ball(first, t_end=end)
    assert turned_by(second) == pytest.approx(end, abs=1e-13)
    times = [t for part in (first, second) for t in rows_of(part.events, "t")]
    rising = float(np.arcsin(0.9))
    expected = sorted(t for t in (at, rising, np.pi - rising) if t < end)
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-12)
    ticks = np.floor(end / 0.3 + 1e-9) + 1.0  # at 0, 0.3, …
    assert column(second.summary, "ticks").tolist() == [ticks]


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.3, 0.6])
def test_a_terminal_event_at_a_tick_leaves_it_to_what_goes_on(at):
    """The summary has the value at the event."""
    result = ball(at=at)
    (row,) = result.events.to_pylist()
    assert row["ticks"] == column(result.summary, "ticks")[0] == round(at / 0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "clock",
    [{"dt": 0.1}, {"dt": 0.05}, pytest.param({"dt": None, "rtol": 1e-6}, marks=pytest.mark.long)],
    ids=str,
)
def test_a_row_at_a_tick_shows_what_it_has_set(clock):
    """Whatever the last bit of the time that was asked for: 0.3 is not 3 · 0.1."""
    times = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    result = ball(every=0.1, t_end=1.0, save_at=times, **clock)
    np.testing.assert_array_equal(rows_of(result.history, "ticks"), np.arange(2.0, 12.0))
    assert column(result.summary, "ticks").tolist() == [11.0]


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0.3, 0.6, 0.9, 1.0, 1.2])
def test_a_run_broken_at_a_tick_has_the_bits_of_one_run(cut):
    """3 · 0.1 is a rounding beyond the tick at 0.3: no step of that length is made."""
    whole, again = ball(), ball(ball(t_end=cut))
    names = ["t", "rotation", "omega", "ticks", "stamped"]
    for result in (whole, again):
        assert result.summary["status"].to_pylist() == ["ok"]
    np.testing.assert_array_equal(
        *(table_bits(each.summary.select(names)) for each in (again, whole))
    )


@pytest.mark.slow
def test_steps_reach_a_tick_that_is_nearly_a_whole_number_of_them_away():
    """Periods are compared relative to their length: 0.1 ns in 50 ms is no rounding."""
    result = ball(every=0.05 * (1 + 1e-10), dt=0.05, t_end=50.0)
    assert turned_by(result) == pytest.approx(50.0 - 16.0 * np.pi, abs=1e-11)  # at 1 rad/s


@lierb.observable
def level(controls):
    return controls.ticks


PERIODS = np.array([0.3, 0.25, 0.7])


def levels(periods, **clock):
    problem, start = spinning(
        [1.0] * len(periods), controllers=[counter(every=periods)], observables=level()
    )
    summary = lierb.integrate(problem, **start, t_end=1.5, **clock).summary
    return np.array([summary[f"level_{how}"].to_numpy() for how in ("min", "max", "mean", "final")])


@pytest.mark.long
@pytest.mark.parametrize("clock", [
    {"rtol": 1e-6}, {"dt": 0.1}, {"dt": 0.05, "measure_every": 7},
], ids=str)  # fmt: skip
def test_means_of_what_is_held_change_at_ticks(clock):
    """n from its nth tick to the next one, and bits that do not depend on whose ticks these are."""
    clock = {"method": "DP54"} | clock
    found = levels(PERIODS, **clock)
    for column_of, period in zip(found.T, PERIODS, strict=True):
        ticks = period * np.arange(round(1.5 / period) + 1)
        ticks = ticks[ticks <= 1.5 + 1e-12]
        held = np.diff([*ticks, 1.5])
        mean = np.arange(1.0, len(ticks) + 1.0) @ held / 1.5
        np.testing.assert_allclose(column_of, [1.0, len(ticks), mean, len(ticks)], rtol=1e-13)
    alone = np.concatenate([levels(PERIODS[[i]], **clock) for i in range(3)], axis=1)
    np.testing.assert_array_equal(alone, found)


# ---- noise -------------------------------------------------------------------------------------


def noisy(which=None, count=17, **options):
    rotation, omega = fleet(count)
    which = np.arange(count) if which is None else np.asarray(which)
    problem, start = satellites(rotation[which], omega[which], noisy_pd())
    options = {
        "dt": DT, "t_end": TICKS * EVERY, "seed": 42, "trajectories": which,
        "save_at": [TICKS * EVERY],
    } | options  # fmt: skip
    return lierb.integrate(problem, **start, cspace="reduced", **options)


@pytest.fixture(scope="module")
def whole():
    return noisy()


@pytest.mark.slow
@pytest.mark.parametrize("which", [[0], [16], [5, 3], list(range(3, 12))], ids=str)
def test_noise_is_the_same_when_replayed_alone(which, whole):
    alone = noisy(which)
    np.testing.assert_array_equal(
        table_bits(alone.summary, "trajectory", "status"),
        table_bits(whole.summary, "trajectory", "status")[which],
    )


@pytest.mark.slow
def test_noise_is_that_of_its_number_not_of_its_place(whole):
    """Left out, numbers are 0 … n − 1: trajectory 5 alone is another one's noise."""
    rotation, omega = fleet(17)
    problem, start = satellites(rotation[5:6], omega[5:6], noisy_pd())
    times = {"dt": DT, "t_end": TICKS * EVERY, "save_at": [TICKS * EVERY]}
    other = lierb.integrate(problem, **start, cspace="reduced", seed=42, **times)
    assert column(other.summary, "gyro")[0].tolist() != column(whole.summary, "gyro")[5].tolist()
    assert column(other.summary, "gyro")[0].tolist() == column(whole.summary, "gyro")[0].tolist()


@pytest.mark.slow
def test_noise_depends_on_the_seed(whole):
    other = noisy(seed=43)
    assert (column(other.summary, "gyro") != column(whole.summary, "gyro")).all()


@pytest.mark.slow
def test_noisy_run_is_the_loop_by_hand_with_its_noise():
    """The noise is an output too: the loop takes it from there."""
    count, ticks = 3, 8
    times = (np.arange(ticks) + 0.5) * EVERY
    result = noisy(np.arange(count), count, t_end=ticks * EVERY, save_at=times)
    gyro = rows_of(result.history, "gyro").reshape(ticks, count, 3)
    assert len(np.unique(gyro)) == gyro.size
    rotation, omega = fleet(count)
    R, w = by_hand(rotation, omega, lambda k, R, w: -(KP * off_axis(R) + KD * (w + gyro[k])), ticks)
    np.testing.assert_allclose(column(result.summary, "rotation").reshape(-1, 3, 3), R, atol=1e-13)
    np.testing.assert_allclose(column(result.summary, "omega"), w, atol=1e-14)


@pytest.fixture(scope="module")
def drawn():
    """(ticks, trajectories, 4) draws: one, three of another name."""
    times = (np.arange(100) + 0.5) * EVERY
    found = noisy(count=200, t_end=100 * EVERY, save_at=times, seed=5).history
    parts = [rows_of(found, "idle")[:, None], 1e3 * rows_of(found, "gyro")]
    return np.concatenate(parts, axis=1).reshape(100, 200, 4)


@pytest.mark.long
def test_no_draw_comes_twice(drawn):
    """Noise depends on trajectory, name, tick and component: 80 000 doubles are all different."""
    assert len(np.unique(drawn)) == drawn.size


def test_a_name_that_is_drawn_twice_is_told():
    @lierb.controller(every=0.1)
    def twice():
        return {"a": lierb.noise.normal("one"), "b": lierb.noise.normal("one")}

    with pytest.raises(lierb.errors.LierbError, match="one"):
        twice()


@pytest.mark.slow
def test_draws_are_standard_normal(drawn):
    """80 000 draws; the bounds are five standard errors, and a p of 1e-4 for Kolmogorov's test."""
    x = drawn.ravel()
    n = len(x)
    assert abs(x.mean()) < 5 / np.sqrt(n)
    assert abs(x.var() - 1.0) < 5 * np.sqrt(2 / n)
    assert abs(stats.skew(x)) < 5 * np.sqrt(6 / n)
    assert abs(stats.kurtosis(x)) < 5 * np.sqrt(24 / n)
    assert stats.kstest(x, "norm").pvalue > 1e-4


@pytest.mark.slow
def test_draws_do_not_know_of_each_other(drawn):
    """Neighbours in time, in the batch, and among components: correlations within five σ."""
    x = drawn
    pairs = {
        "ticks": (x[1:], x[:-1]), "trajectories": (x[:, 1:], x[:, :-1]),
        "components": (x[..., 1:], x[..., :-1]), "squares": (x[1:] ** 2 - 1, x[:-1] ** 2 - 1),
    }  # fmt: skip
    for name, (a, b) in pairs.items():
        scale = 2.0 if name == "squares" else 1.0
        assert abs((a * b).mean()) < 5 * scale / np.sqrt(a.size), name


# ---- what is told ------------------------------------------------------------------------------


@pytest.mark.parametrize(("made", "match"), [
    (lambda: [pid(every=0.0)], "every"), (lambda: [pid(every=-1.0)], "every"),
    (lambda: [pid(kq=1.0)], "kp"), (lambda: [pid(everi=1.0)], "Did you mean 'every'"),
    (lambda: [pid(integrall=(0.0,) * 3)], "Did you mean 'integral'"),
    (lambda: [pid(), pid()], "torque"),
    (lambda: [pid(integral=(1.0, 2.0))], "integral"),
])  # fmt: skip
def test_wrong_controllers_are_told(made, match):
    with pytest.raises(lierb.errors.LierbError, match=match):
        satellites(*fleet(3), *made())


def test_an_unknown_control_is_told_with_those_there_are():
    @lierb.wrench
    def wrong(t, R, r, omega, v, params, controls):
        return controls.torqe, (0.0, 0.0, 0.0)

    with pytest.raises(lierb.errors.LierbError, match="torque"):
        lierb.Problem(
            lierb.Body(100.0, MOMENTS), lierb.joints.spherical(), forces=[wrong()],
            controllers=[pid()],
        )  # fmt: skip


def test_ticks_beyond_the_rounding_of_time_are_told():
    @lierb.controller(every=1e-7)
    def nothing(t):
        return {"torque": 0.0 * t}

    body = lierb.Body(1.0, (0.1, 0.2, 0.25))
    problem = lierb.Problem(body, lierb.joints.free(), controllers=[nothing()])
    with pytest.raises(lierb.errors.TimeGridError, match="nothing ticks every 1e-07 s"):
        lierb.integrate(problem, twist0=np.zeros(6), t0=1e9, t_end=1e9 + 1, dt=0.25)

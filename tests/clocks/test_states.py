"""States beside the body, integrated with it, against closed forms."""

import numpy as np
import pytest
from cases import column, final, long_but, tiered

import lierb
from clocks.shared import rows_of, spinning, thrown

CLOCKS = [{"rtol": 1e-9, "method": "DP54"}, {"dt": 5e-3, "method": "RK4"}]


@lierb.states(filtered=0.0)
def low_pass(omega, states, params):
    return {"filtered": (omega[2] - states.filtered) / params.tau}


@lierb.event
def half(states):
    return states.filtered - 0.5


@lierb.observable(unit="rad/s")
def lag(t, R, r, omega, v, params, states):
    return omega[2] - states.filtered


def filtering(rates, **given) -> tuple:
    """Balls with a filter, an event and an observable in every run, so that all share a kernel."""
    return spinning(rates, states=[low_pass(**given)], events=[half()], observables=[lag()])


@pytest.mark.parametrize("clock", long_but(CLOCKS, CLOCKS[0]), ids=str)
def test_a_first_order_filter_settles_as_an_exponential(clock):
    """ω₃ is constant: filtered = ω₃ + (f₀ − ω₃) exp(−t/τ). Errors below 100 rtol, or dt⁴."""
    rates, tau = np.array([1.0, -2.0, 5.0]), np.array([0.5, 0.2, 1.0])
    first = np.array([0.0, 3.0, 5.0])
    problem, start = filtering(rates, tau=tau, filtered=first)
    result = lierb.integrate(problem, **start, t_end=1.0, save_at=(0.25, 0.5, 1.0), **clock)
    for row, t in enumerate((0.25, 0.5, 1.0)):
        true = rates + (first - rates) * np.exp(-t / tau)
        found = rows_of(result.history, "filtered").reshape(3, 3)[row]
        np.testing.assert_allclose(found, true, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(
        column(result.summary, "filtered"), rows_of(result.history, "filtered")[-3:]
    )


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-4, 1e-7, 1e-10])
def test_a_states_error_is_within_thirty_times_rtol(rtol):
    """The body asks for no steps at all: the filter does."""
    problem, start = filtering([4.0], tau=0.05)
    result = lierb.integrate(problem, **start, t_end=0.2, rtol=rtol, method="DP54", save_at=(0.2,))
    true = 4.0 * (1 - np.exp(-4.0))
    assert abs(final(result, "filtered") - true) < 30 * rtol * 4.0


@pytest.mark.slow
def test_initial_values_are_those_of_the_decorator_unless_given():
    problem, start = filtering([4.0], tau=0.5)
    result = lierb.integrate(problem, **start, t_end=0.1, rtol=1e-6, save_at=(0.0,), method="DP54")
    assert column(result.history, "filtered").tolist() == [0.0]


# ---- a wheel: what the body gets, the wheel gives ----------------------------------------------


TORQUE = (0.02, -0.01, 0.03)  # N m


@lierb.states(wheel=(0.0, 0.0, 0.1), unit={"wheel": "N m s"})
def reaction_wheels(t):
    return {"wheel": -np.array(TORQUE) * np.cos(3.0 * t)}


@lierb.wrench
def from_wheels(t, R, r, omega, v, params, states):
    torque = np.array(TORQUE) * np.cos(3.0 * t)
    return torque - np.cross(omega, states.wheel), (0.0, 0.0, 0.0)


MOMENTS, OMEGA0 = np.array((0.3, 0.5, 0.7)), np.array((0.4, -0.2, 0.9))


def with_wheels(cspace="SE3", **options) -> lierb.Result:
    problem = lierb.Problem(
        lierb.Body(2.0, MOMENTS), lierb.joints.free(), forces=[from_wheels()],
        states=[reaction_wheels()],
    )  # fmt: skip
    return lierb.integrate(
        problem, twist0=[*OMEGA0, 0.0, 0.0, 0.0], rtol=1e-9, cspace=cspace, method="DP54",
        record=("state",),
        **options,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cspace", tiered(["SE3", "SO3xR3"], ["SE3"], []))
def test_wheels_and_body_keep_their_momentum(cspace):
    """R (J ω + h) stays, though each changes: the largest change within 100 rtol."""
    result = with_wheels(cspace, t_end=5.0, save_at=np.linspace(0.0, 5.0, 11))
    R = rows_of(result.history, "rotation").reshape(-1, 3, 3)
    omega, wheel = rows_of(result.history, "omega"), rows_of(result.history, "wheel")
    momentum = np.einsum("nij,nj->ni", R, MOMENTS * omega + wheel)
    before = MOMENTS * OMEGA0 + (0.0, 0.0, 0.1)
    np.testing.assert_allclose(momentum, np.tile(before, (11, 1)), atol=1e-7)
    given = np.array(TORQUE) * np.sin(15.0) / 3.0  # ∫ of the torque
    np.testing.assert_allclose(wheel[0] - wheel[-1], given, atol=1e-8)
    assert np.abs(omega[-1] - omega[0]).max() > 0.01


@pytest.mark.slow
def test_columns_carry_names_and_units():
    result = with_wheels(t_end=0.1, save_at=(0.1,))
    for table in (result.summary, result.history):
        field = table.schema.field("wheel")
        assert field.metadata[b"unit"].decode() == "N m s"
        assert np.shape(table["wheel"].to_pylist()) == (1, 3)


@pytest.mark.slow
def test_observables_and_events_see_states():
    problem, start = filtering([1.0], tau=0.5)
    result = lierb.integrate(problem, **start, t_end=1.0, rtol=1e-13, save_at=(0.3,), method="DP54")
    # f = 1 − exp(−t/τ) is a half at τ ln 2
    np.testing.assert_allclose(rows_of(result.events, "t"), [0.5 * np.log(2.0)], atol=1e-12)
    np.testing.assert_allclose(rows_of(result.history, "lag"), [np.exp(-0.6)], atol=1e-12)
    np.testing.assert_allclose(rows_of(result.events, "filtered"), [0.5], atol=1e-12)


@pytest.mark.long
def test_a_state_ends_with_its_trajectory():
    @lierb.states(age=0.0)
    def clock():
        return {"age": 1.0}

    @lierb.event(terminal=True)
    def landing(r):
        return r[2]

    problem, start = thrown([1.0, 2.0], [0.0, 0.0], states=[clock()], events=[landing()])
    result = lierb.integrate(problem, **start, t_end=2.0, rtol=1e-6, cspace="SO3xR3", method="DP54")
    # between steps the weights add up to θ within 1e-14
    np.testing.assert_allclose(
        column(result.summary, "age"), rows_of(result.summary, "t"), rtol=5e-14
    )


@pytest.mark.parametrize(("made", "match"), [
    (lambda: [low_pass(tau=0.5), low_pass(tau=0.5)], "filtered"),
    (lambda: [low_pass(tua=1.0)], "tau"),
    (lambda: [low_pass(tau=0.5, filtered=((1.0, 2.0),))], "filtered"),
])  # fmt: skip
def test_wrong_states_are_told(made, match):
    with pytest.raises(lierb.errors.LierbError, match=match):
        spinning([1.0, 2.0, 3.0], states=made())


def test_derivatives_of_other_names_are_told():
    @lierb.states(a=0.0)
    def wrong():
        return {"b": 1.0}

    def run():
        problem, start = spinning([1.0], states=[wrong()])
        lierb.integrate(problem, **start, t_end=0.1, rtol=1e-6)

    with pytest.raises(lierb.errors.LierbError, match=r"\ba\b"):
        run()

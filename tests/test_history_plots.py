"""Figures of a history: what is drawn, not how it looks."""

from __future__ import annotations

import pickle
from io import BytesIO

import numpy as np
import pyarrow as pa
import pytest
from cases import integrate, slow_but, top

import lierb
from lierb.errors import ArgumentError, UnknownNameError

pytest.importorskip("matplotlib")
from lierb.results.failures import STATUS_NAMES
from lierb.results.history_plots import MOST_LINES, NO_NUMBER
from lierb.results.motion_panels import State

SAVED = {"dt": 1e-3, "t_end": 0.5, "save_every": 10}


@pytest.fixture(scope="module")
def problem():
    return top()[0]


@pytest.fixture(scope="module")
def spun(problem) -> lierb.Result:
    """Ten tops, recorded with RECORD of the cases."""
    rates = np.random.default_rng(2).normal((3.0, 40.0, 0.6), size=(10, 3))
    twists = problem.joint.twist(omega=rates)
    return integrate(problem, twist0=twists, cspace="SO3xR3", **SAVED)


def titles(figure) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]


def lines(axes) -> list[np.ndarray]:
    """Drawn lines, without the legend's empty ones."""
    return [np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_ydata())]


def test_panels_follow_from_what_is_recorded(problem, spun):
    errors = ["position error [m]", "energy drift [J]", "orthogonality error"]
    motion = [
        "direction of the axis [rad]", "the centre of mass, seen from above", "centre of mass [m]",
        "angular velocity [rad/s]",
    ]  # fmt: skip
    more = ["multipliers [N]", "torque of the joint [N m]", "force of the joint [N]"]
    assert titles(spun.plot(trajectories=0)) == [*motion, *errors, *more]
    start = {"twist0": problem.joint.twist(omega=(3.0, 40.0, 0.6))}
    bare = lierb.integrate(problem, **start, dt=1e-3, t_end=0.01, save_every=5)
    assert titles(bare.plot()) == errors


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("most_lines", [1, MOST_LINES])
def test_a_lone_number_is_seen(problem, monkeypatch, most_lines):
    """One row, or one above zero on a logarithmic axis, whose line would have no length."""
    monkeypatch.setattr("lierb.results.history_plots.MOST_LINES", most_lines)
    start = {"twist0": problem.joint.twist(omega=[(3.0, 40.0, 0.6), (3.0, 30.0, 0.6)])}
    for times in ([2e-3], [0.0, 2e-3]):
        run = lierb.integrate(problem, **start, dt=1e-3, t_end=2e-3, save_at=times, record="energy")
        drift, kinetic = run.plot(["energy_drift", "energy"]).axes
        assert all(line.get_marker() == "o" for line in drift.lines if len(line.get_ydata()))
        marks = {line.get_marker() for line in kinetic.lines if len(line.get_ydata())}
        assert marks == {"o" if len(times) == 1 else "None"}
        low, high = drift.get_xlim()
        assert low < high
        assert low <= times[0] <= times[-1] <= high


def test_columns_of_any_name_have_panels_with_their_units(spun):
    """Panels of columns of any name, such as observables."""
    rows = spun.history.num_rows
    fields = [
        pa.field("height", pa.float64(), metadata={"unit": "m"}),
        pa.field("pull", pa.list_(pa.float64(), 3), metadata={"unit": "N, N, J"}),
        pa.field("mode", pa.string()),
    ]
    given = [np.arange(rows) / 7.0, pa.FixedSizeListArray.from_arrays(np.arange(3.0 * rows), 3),
             pa.array(["on"] * rows)]  # fmt: skip
    history = spun.history
    for field, values in zip(fields, given, strict=True):
        history = history.append_column(field, pa.chunked_array([values]))
    result = lierb.Result(spun.summary, history)
    figure = result.plot(["height", "pull [N]", "pull [J]"], trajectories=3)
    assert titles(figure) == ["height [m]", "pull [N]", "pull [J]"]
    np.testing.assert_array_equal(lines(figure.axes[0])[0], given[0].reshape(-1, 10)[:, 3])
    assert len(lines(figure.axes[1])) == 2
    with pytest.raises(UnknownNameError, match="Did you mean 'height'"):
        result.plot("heigth")
    with pytest.raises(UnknownNameError, match="mode"):
        result.plot("mode")


def test_many_trajectories_are_drawn_as_quantiles_with_zeros_counted(spun):
    figure = spun.plot(["position_error", "position"])
    errors = spun.history["position_error"].to_numpy().reshape(-1, 10)
    median, most = lines(figure.axes[1])
    np.testing.assert_allclose(median[1:], np.median(errors, axis=1)[1:])
    np.testing.assert_allclose(most[1:], errors.max(axis=1)[1:])
    assert np.isnan(median[0])  # the start has no error: zero
    assert figure.axes[1].get_yscale() == "log"
    few = spun.plot("position", trajectories=range(MOST_LINES))
    assert len(lines(few.axes[0])) == 3 * MOST_LINES
    np.testing.assert_array_equal(lines(few.axes[0])[1], spun.position[:, 1, 0])


def with_failed(result, failed):
    """The result as if trajectories had failed, with errors of 1e20 before."""
    summary, history = result.summary, result.history
    names = [STATUS_NAMES[1 if i in failed else 0] for i in range(summary.num_rows)]
    index = summary.schema.get_field_index("status")
    status = pa.array(names).dictionary_encode()
    summary = summary.set_column(index, "status", status)
    errors = history["position_error"].to_numpy().copy()
    errors[np.isin(history["trajectory"].to_numpy(), failed)] = 1e20
    index = history.schema.get_field_index("position_error")
    history = history.set_column(index, history.schema.field(index), pa.array(errors))
    return lierb.Result(summary, history)


def test_quantiles_leave_out_trajectories_that_failed(spun):
    errors = spun.history["position_error"].to_numpy().reshape(-1, 10)[:, :8]
    figure = with_failed(spun, [8, 9]).plot("position_error")
    median, most = lines(figure.axes[0])
    np.testing.assert_allclose(median[1:], np.median(errors, axis=1)[1:])
    np.testing.assert_allclose(most[1:], errors.max(axis=1)[1:])
    assert figure.get_supxlabel().startswith("8 trajectories")
    assert figure.get_supxlabel().endswith("without the 2 that failed")
    every = with_failed(spun, list(range(10))).plot("position_error")
    assert every.get_supxlabel().endswith("all failed")


def test_what_is_zero_throughout_is_said_to_be(problem):
    start = {"twist0": problem.joint.twist(omega=(3.0, 40.0, 0.6))}
    result = integrate(problem, **start, **SAVED)
    (axes,) = result.plot("position_error").axes
    assert [text.get_text() for text in axes.texts] == ["exactly 0"]
    assert axes.get_yscale() == "linear"


def test_what_is_no_number_is_not_said_to_be_zero(spun):
    none = pa.field("height", pa.float64(), metadata={"unit": "m"})
    history = spun.history.append_column(none, pa.array(np.full(spun.history.num_rows, np.nan)))
    for trajectories in (0, None):  # lines, and quantiles
        figure = lierb.Result(spun.summary, history).plot("height", trajectories=trajectories)
        assert [text.get_text() for text in figure.axes[0].texts] == [NO_NUMBER]


def test_observables_named_as_panels_of_the_motion_leave_these(problem, spun):
    history = spun.history
    for name in ("angles", "trace"):
        history = history.append_column(name, pa.array(np.ones(history.num_rows)))
    result = lierb.Result(spun.summary, history)
    assert titles(result.plot(["angles", "trace"], trajectories=0)) == ["angles", "trace"]
    motion = ["angles of the motion", "trace of the motion"]
    expected = titles(spun.plot(["angles", "trace"], trajectories=0))
    assert titles(result.plot(motion, trajectories=0, problem=problem)) == expected


@pytest.mark.parametrize("save_every", [10, 50])  # 0.14 turns and 0.7 turns from row to row
@pytest.mark.parametrize("kind", slow_but(["revolute", "screw"], "revolute"))
def test_angle_of_a_joint_counts_its_turns(kind, save_every):
    pitch = {"pitch": 0.1} if kind == "screw" else {}
    make = getattr(lierb.joints, kind)
    hinge = make(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.3), **pitch)
    body = lierb.bodies.box((0.1, 0.2, 0.6), mass=1.0)
    wheel = lierb.Problem(body, hinge)  # no gravity: at a constant rate
    result = integrate(wheel, twist0=hinge.twist(velocities=9.0), dt=1e-2, t_end=2.0,
                       save_every=save_every)  # fmt: skip
    figure = result.plot(["angles", "trace"])
    assert titles(figure)[0] == "angle of the joint [rad]"
    np.testing.assert_allclose(lines(figure.axes[0])[0], 9.0 * result.t, atol=1e-9)


def test_trace_is_a_map_of_equal_areas(problem, spun):
    """Its radius is 2 sin(θ/2), θ from the middle, and its side that from which one looks."""
    found = State(spun, problem).trace()
    axis = spun.rotation @ np.array(problem.body.com - problem.joint.body_frame[:3, 3])
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    radius = np.linalg.norm(found.points, axis=-1)
    np.testing.assert_allclose(radius, 2.0 * np.sin(0.5 * np.arccos(axis[..., 2])), atol=1e-7)
    np.testing.assert_allclose(found.points[..., 0] * axis[..., 1],
                               found.points[..., 1] * axis[..., 0], atol=1e-12)  # fmt: skip
    tilt, _ = State(spun, problem).angles().series
    np.testing.assert_allclose(np.cos(tilt.values), axis[..., 2], atol=1e-12)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.StiffStepWarning")
def test_failed_trajectories_end():
    """Result as in the tests of the animation, on the same kernel."""
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    spring = lierb.forces.spring_damper(body_point=(0.05, 0.0, 0.0), stiffness=1e9)
    stiff = lierb.Problem(body, lierb.joints.free(), forces=[spring])
    with pytest.warns(lierb.errors.FailedTrajectoryWarning):
        result = integrate(stiff, twist0=(0.0, 0.0, 1.0, 1.0, 0.0, 0.0), dt=0.1, t_end=5.0,
                           save_every=1)  # fmt: skip
    figure = result.plot("omega")
    drawn = lines(figure.axes[0])[0]
    assert np.isfinite(drawn[0])
    assert np.isnan(drawn[-1])
    result.plot().savefig(BytesIO(), format="png")  # no warning


def test_plot_says_what_is_missing(problem, spun):
    start = {"twist0": problem.joint.twist(omega=(3.0, 40.0, 0.6))}
    with pytest.raises(ArgumentError, match="no history to plot: integrate with save_every"):
        lierb.integrate(problem, **start, dt=1e-3, t_end=0.01).plot()
    with pytest.raises(ArgumentError, match="expected 0 … 9"):
        spun.plot(trajectories=10)
    with pytest.raises(ArgumentError, match="empty"):
        spun.plot(trajectories=())
    again = pickle.loads(pickle.dumps(spun))
    assert "position [m]" in titles(again.plot(trajectories=0))
    assert titles(again.plot(trajectories=0, problem=problem)) == titles(spun.plot(trajectories=0))

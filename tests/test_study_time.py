"""Studies with a clock for each trajectory: tolerances, save_at, events, states, controllers."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command import invoke
from studies import TEXT as TOPS
from studies import bits, errors_when_stopped, hashes, start, study

import lierb
from lierb.api import integrate_model
from lierb.errors import ArgumentError, StudyError
from lierb.results import tables as run_tables
from lierb.results.columns import as_array
from lierb.studies.dataset import Dataset
from lierb.studies.description.stopping import rule_of
from lierb.studies.description.study import Study
from lierb.studies.description.times import saved_times
from lierb.studies.description.units import unit_of
from lierb.studies.execution import cluster
from lierb.studies.execution.replaying import compile_for, replay
from lierb.studies.findings.findings import findings
from lierb.studies.findings.occurrences import crossings
from lierb.studies.findings.statistics import quantiles_over_time
from lierb.studies.storage.parts import LABEL_BYTES, bytes_of_body, part_size, saved_rows
from lierb.studies.storage.store import Store

EXAMPLES = Path(__file__).parent.parent / "examples"
CODE = (EXAMPLES / "attitude.py").read_text(encoding="utf-8")
TEXT = (EXAMPLES / "attitude.toml").read_text(encoding="utf-8")
TABLES = ("summary", "history", "events")
N = 40
# The example, so that all files of tests share its kernel. Within 1 rad, and with wheels of
# 0.6 N m s, both events happen to some within ten seconds and to some they do not.
SMALL = {
    "sample.n": N, "output.part": 16, "integrate.t_end": 10.0, "integrate.save_at.every": 0.5,
    "problem.events.pointed.within": 1.0, "problem.events.saturated.capacity": 0.6,
}  # fmt: skip


def written(folder: Path, code: str = CODE, text: str = TEXT) -> Path:
    """The study's file, beside its functions."""
    folder.mkdir()
    (folder / "attitude.py").write_text(code, encoding="utf-8")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder / "study.toml"


def loaded(tmp_path, changes=None, **more) -> Study:
    return Study.load(written(tmp_path / "study", **more), SMALL | (changes or {}))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The small study, run without a break in one process."""
    place = tmp_path_factory.mktemp("whole")
    lierb.run(written(place / "study"), place / "out", changes=SMALL)
    return place / "out"


@pytest.fixture(scope="module")
def ending(tmp_path_factory) -> Path:
    """Study whose first event ends a trajectory."""
    place = tmp_path_factory.mktemp("ending")
    code = CODE.replace("direction=-1,", "direction=-1, terminal=True,")
    lierb.run(written(place / "study", code), place / "out", changes=SMALL)
    return place / "out"


def table(folder: Path, name: str = "summary") -> pa.Table:
    return Dataset(folder).table(name).to_table()


def numbers(folder: Path, column: str, name: str = "summary") -> np.ndarray:
    return as_array(table(folder, name)[column])


def ran(study: Study) -> lierb.Result:
    """All of its bodies at once, by `lierb.integrate`."""
    batch, (setting,) = study.batch(0, N), study.settings
    options = study.options(setting, batch.problem, seed=study.sample.seed)
    return integrate_model(batch.problem, options, batch.pose0, batch.twist0)


# ---- tables ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_tables_are_those_of_integrate(whole):
    """Numbers of trajectories too, although parts are of 16."""
    result = ran(Study.load(whole / "study.toml"))
    for name in ("summary", "events"):
        alone, found = getattr(result, name), table(whole, name)
        for column in alone.column_names:
            if column not in ("event", "status"):
                assert as_array(found[column]).tobytes() == as_array(alone[column]).tobytes()
    assert found["event"].to_pylist() == result.events["event"].to_pylist()
    assert {*found["event"].to_pylist()} == {"pointed", "saturated"}
    assert as_array(found["trajectory"]).max() > 16


@pytest.mark.slow
def test_settings_and_steps_are_columns(whole):
    found = table(whole)
    assert found.column_names[:4] == ["cspace", "method", "rtol", "trajectory"]
    assert {*found["rtol"].to_pylist()} == {1e-6}
    steps, last = numbers(whole, "steps"), numbers(whole, "dt_last")
    assert steps.dtype == np.int64
    assert (steps >= 100).all()  # a tick of the controller ends one
    assert (last > 0.0).all()
    for name in TABLES:
        assert table(whole, name).schema.field("t").metadata[b"unit"] == b"s"
    assert table(whole).schema.field("wheels").metadata[b"unit"] == b"N m s"


def test_body_and_wheels_keep_their_momentum(whole):
    """Sampled inertias, rotations and rates: no external torque acts."""
    rows = table(whole)
    moments = as_array(rows["sample.body.second_moments"])
    inertia = moments.sum(axis=1, keepdims=True) - moments
    turned = [
        as_array(rows[name]).reshape(-1, 3, 3) for name in ("sample.initial.rotation", "rotation")
    ]
    before = inertia * as_array(rows["sample.initial.omega"])
    after = inertia * as_array(rows["omega"]) + as_array(rows["wheels"])
    start, end = (np.einsum("nij,nj->ni", *pair) for pair in zip(turned, (before, after)))
    # 1 N m s, by Tsit5 with steps of 0.1 s and torques that jump between them: rounding
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-12)


def test_history_is_at_the_times_asked_for(whole):
    t = numbers(whole, "t", "history").reshape(-1)
    np.testing.assert_array_equal(np.unique(t), 0.5 * np.arange(21))
    assert len(t) == 21 * N


def test_events_are_where_they_say(whole):
    """Events have the states of their table: the angle, and the wheels' momentum."""
    events = table(whole, "events")
    which = np.array(events["event"].to_pylist())
    R = as_array(events["rotation"]).reshape(-1, 3, 3)
    wheels = as_array(events["wheels"])
    turned = np.arccos(R[which == "pointed", 2, 2])
    # times are found to 1e-12 s, at 0.1 rad/s and 0.05 N m
    np.testing.assert_allclose(turned, 1.0, rtol=0, atol=1e-11)
    taken = np.linalg.norm(wheels[which == "saturated"], axis=1)
    np.testing.assert_allclose(taken, 0.6, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", TABLES)
def test_stream_has_the_same_rows(name, whole):
    found = lierb.integrate_batches(Study.load(whole / "study.toml"), name).read_all()
    assert found.num_rows == table(whole, name).num_rows
    assert as_array(found["t"]).tobytes() == numbers(whole, "t", name).tobytes()


def test_stream_of_a_table_that_is_none_is_refused():
    with pytest.raises(ArgumentError, match='"events" of a problem with events'):
        lierb.integrate_batches(study(), "events")


def test_several_tolerances_are_settings(tmp_path):
    given = loaded(tmp_path, {"integrate.rtol": [1e-3, 1e-6], "sample.n": 4})
    dataset = lierb.run(given, tmp_path / "out")
    assert sorted({*table(tmp_path / "out")["rtol"].to_pylist()}) == [1e-6, 1e-3]
    assert [f.setting.label for f in findings(dataset)] == [
        "SE3, Tsit5, rtol = 0.001", "SE3, Tsit5, rtol = 1e-06",
    ]  # fmt: skip
    assert "SE3 × Tsit5 × rtol = 0.001, 1e-06" in str(dataset)
    assert '.table("events")' in str(dataset)


def test_kernels_are_compiled_ahead(tmp_path):
    ((setting, _),) = compile_for(loaded(tmp_path))
    assert setting.rtol == 1e-6


# ---- bits --------------------------------------------------------------------------------------


def test_bits_do_not_depend_on_parts(whole, tmp_path):
    lierb.run(loaded(tmp_path, {"output.part": 7}), tmp_path / "out")
    for name in TABLES:
        assert bits(tmp_path / "out", name) == bits(whole, name)


def test_resume_does_what_is_missing(whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "events" / "part-00-0000000016.parquet").unlink()
    (out / "history" / "part-00-0000000032.parquet").write_bytes(b"")
    lierb.run(written(tmp_path / "study"), out, changes=SMALL, resume=True)
    assert hashes(out) == hashes(whole)


@pytest.mark.slow
def test_replay_has_the_studys_row_and_events(whole):
    """Another history, and noise by the trajectory's own number."""
    events = table(whole, "events").to_pylist()
    number = next(row["trajectory"] for row in reversed(events) if row["trajectory"] > 20)
    ((_, tables),) = replay(whole / "study.toml", number)
    own = [row for row in table(whole).to_pylist() if row["trajectory"] == number]
    assert tables["summary"].to_pylist() == own
    assert tables["events"].to_pylist() == [r for r in events if r["trajectory"] == number]
    assert tables["history"].num_rows == 1001  # times of the study are among the thousand
    assert "torque" in tables["history"].column_names
    assert "rotation" in tables["history"].column_names


@pytest.mark.long
def test_options_of_a_replay_repeat_its_run(whole, tmp_path):
    """With its noise, first time, breaks and rows: the study's numbers, by `lierb.integrate`."""
    more = {"sample.n": 6, "integrate.t0": 1.0, "integrate.discontinuities": [2.3]}
    dataset = lierb.run(loaded(tmp_path, more), tmp_path / "out")
    kept = dataset.replay(5)
    again = lierb.integrate(kept.problem, **kept.options)
    assert again.history.equals(kept.result.history)
    assert again.events.equals(kept.result.events)
    stored = table(tmp_path / "out").to_pylist()[5]
    assert {name: again.summary[name][0].as_py() for name in ("omega", "torque", "t")} == {
        name: stored[name] for name in ("omega", "torque", "t")
    }
    assert (kept.trajectory, kept.seed) == (5, dataset.study.sample.seed)
    assert {"seed", "trajectories", "discontinuities", "t0"} <= kept.start.keys()
    # Without the trajectory's number the noise is another one.
    other = lierb.integrate(kept.problem, **kept.options | {"trajectories": [0]})
    assert other.summary["omega"] != again.summary["omega"]
    assert len(repr(kept).splitlines()) < 8


@pytest.mark.slow
def test_start_of_a_batch_repeats_its_bodies(whole):
    """Bodies of a study are integrated with the study's noise, without its folder."""
    made = Study.load(whole / "study.toml")
    batch, (setting,) = made.batch(8, 3), made.settings
    alone = lierb.integrate(batch.problem, **batch.start, **made.keywords(setting))
    stored = [row for row in table(whole).to_pylist() if row["trajectory"] in (8, 9, 10)]
    assert as_array(alone.summary["omega"]).tolist() == [row["omega"] for row in stored]


@pytest.mark.slow
def test_only_prints_the_events(whole, tmp_path):
    number = int(numbers(whole, "trajectory", "events")[0])
    printed = invoke("run", whole / "study.toml", "--out", tmp_path, "--only", number).output
    rows = [r for r in table(whole, "events").to_pylist() if r["trajectory"] == number]
    for row in rows:
        assert f"  {row['event']} at t = {row['t']!r} s\n" in printed


def test_noise_is_drawn_by_seed_and_number(tmp_path):
    """Equal bodies differ by the numbers of `lierb.noise.sample`."""
    more = {"body.inertia": [19.0, 17.0, 14.0], "initial.omega": [0.01, 0.0, 0.0],
            "output.part": 3, "sample.n": 8, "integrate.t_end": 0.5}  # fmt: skip
    text = f"{TEXT.partition('[sample.body')[0]}[integrate]{TEXT.partition('[integrate]')[2]}"
    given = loaded(tmp_path, more, text=text)
    torque = as_array(lierb.integrate_batches(given).read_all()["torque"])
    assert len({row.tobytes() for row in torque}) == 8
    other = as_array(
        lierb.integrate_batches(given.changed({"sample.seed": 5})).read_all()["torque"]
    )
    assert not (torque == other).any()
    noise = lierb.noise.sample(4, np.arange(8), "gyro", tick=5, size=3)
    damping, gyro = 4.0, 2e-4
    spread = torque - torque.mean(axis=0)
    # what noise of earlier ticks has changed of the motion is 1e-4 of it: 0.5 s × damping / inertia
    expected = -damping * gyro * (noise - noise.mean(axis=0))
    np.testing.assert_allclose(spread, expected, rtol=0, atol=0.2 * np.abs(expected).max())


@pytest.mark.long
@pytest.mark.parametrize(
    "gather", [pytest.param(False, marks=pytest.mark.long), True], ids=["shared", "gather"]
)
def test_workers_give_the_same_bytes(gather, whole, tmp_path):
    pytest.importorskip("distributed")
    with cluster.local_client(2) as client:
        lierb.run(
            written(tmp_path / "study"), tmp_path / "out", changes=SMALL, client=client,
            gather=gather,
        )  # fmt: skip
    assert hashes(tmp_path / "out") == hashes(whole)


LONG = {"sample.n": 640, "output.part": 64}
LONG_PARTS = 10


@pytest.fixture(scope="module")
def long_whole(tmp_path_factory) -> dict[str, str]:
    """Hashes of the long study, run without a break."""
    place = tmp_path_factory.mktemp("long")
    lierb.run(written(place / "study"), place / "out", changes=LONG)
    return hashes(place / "out")


def started(tmp_path: Path):
    """A run of seconds, two of its parts in place."""
    (tmp_path / "attitude.py").write_text(CODE, encoding="utf-8")
    options = [word for key, x in LONG.items() for word in ("--set", f"{key}={x}")]
    process = start(tmp_path, *options, text=TEXT)
    while len(list(tmp_path.glob("out/events/part*"))) < 2 and process.poll() is None:
        time.sleep(0.005)
    return process


def require_going_on(tmp_path: Path, whole: dict[str, str]) -> None:
    """Some whole parts are left; the rest follows, to the same bytes."""
    left = Store(tmp_path / "out")
    left.read()
    assert left.drop_damaged() == []
    assert 0 < len(left.parts) < LONG_PARTS
    lierb.run(tmp_path / "study.toml", tmp_path / "out", changes=LONG, resume=True)
    assert hashes(tmp_path / "out") == whole


@pytest.mark.long
def test_ctrl_c_leaves_a_folder_that_goes_on(long_whole, tmp_path, interruptible):
    process = started(tmp_path)
    process.send_signal(signal.SIGINT)
    assert "go on with:  lierb run" in errors_when_stopped(process, tmp_path / "out")
    require_going_on(tmp_path, long_whole)


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize(
    "sent", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGKILL]
)
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(sent, long_whole, tmp_path):
    process = started(tmp_path)
    process.send_signal(sent)
    process.communicate(timeout=60)
    assert process.returncode == -sent
    require_going_on(tmp_path, long_whole)


# ---- output ------------------------------------------------------------------------------------


def test_percentiles_are_those_of_the_rows(whole):
    dataset = Dataset(whole)
    dataset.read()
    (setting,) = Study.load(whole / "study.toml").settings
    times, found = quantiles_over_time(dataset, "pointing_error", setting, (0.05, 0.5, 0.95))
    rows = table(whole, "history")
    t, error = as_array(rows["t"]), as_array(rows["pointing_error"])
    for k, time_ in enumerate(0.5 * np.arange(21)):
        assert len(error[t == time_]) == N
        wanted = np.quantile(error[t == time_], (0.05, 0.5, 0.95), method="inverted_cdf")
        assert times[k] == time_
        np.testing.assert_array_equal(found[:, k], wanted)


def test_percentiles_leave_out_who_has_ended(ending):
    dataset = Dataset(ending)
    dataset.read()
    (setting,) = Study.load(ending / "study.toml").settings
    times, found = quantiles_over_time(dataset, "pointing_error", setting, (0.05, 0.5, 0.95))
    ends, rows = numbers(ending, "t"), table(ending, "history")
    step, error = as_array(rows["step"]), as_array(rows["pointing_error"])
    for k, t in enumerate(times):
        own = error[(step == np.unique(step)[k]) & ~np.isnan(error)]
        assert len(own) == (ends >= t).sum()
        wanted = np.quantile(own, (0.05, 0.5, 0.95), method="inverted_cdf")
        np.testing.assert_array_equal(found[:, k], wanted)
    assert N > len(own) > 0


def test_a_trajectory_that_an_event_ends_is_no_failure(ending):
    dataset = Dataset(ending)
    dataset.read()
    statuses = table(ending)["status"].to_pylist()
    assert {*statuses} == {"ok", "event"}
    assert dataset.failures() is None
    (found,) = findings(dataset)
    assert (found.bodies, found.failed) == (N, 0)
    assert np.isfinite(found.quantiles["energy"]).all()
    row = next(r for r in table(ending).to_pylist() if r["status"] == "event")
    last = [r for r in table(ending, "events").to_pylist() if r["trajectory"] == row["trajectory"]]
    assert (last[-1]["event"], last[-1]["t"]) == ("pointed", row["t"])
    assert last[-1]["wheels"] == row["wheels"]


def test_steps_that_run_out_are_failures(tmp_path):
    given = loaded(tmp_path, {"integrate.max_steps": 50, "sample.n": 3})
    with pytest.warns(lierb.errors.FailedTrajectoryWarning, match=r"3 of 3 .* max_steps"):
        dataset = lierb.run(given, tmp_path / "out")
    assert dataset.failures().counts == {"max_steps": 3}
    assert "rtol = 1e-06" in str(dataset.failures())
    assert [each.of for each in crossings(dataset)] == [0, 0]


def test_events_are_counted_and_their_first_times_ranked(whole):
    dataset = Dataset(whole)
    dataset.read()
    rows = table(whole, "events").to_pylist()
    for each in crossings(dataset):
        own = [row for row in rows if row["event"] == each.name]
        first = {}
        for row in own:
            first[row["trajectory"]] = min(row["t"], first.get(row["trajectory"], np.inf))
        times = sorted([*first.values(), *[np.inf] * (N - len(first))])
        assert (each.crossings, each.bodies, each.of) == (len(own), len(first), N)
        assert 0 < each.bodies < N
        assert [q.value for q in each.first] == [times[1], times[N // 2 - 1], times[37]]
    shown = invoke("show", whole).output
    assert "> 10" in shown  # what has not happened within the run
    assert f"{each.bodies} of {N}" in shown


def test_first_times_have_no_interval_where_bodies_are_not_drawn(whole, monkeypatch):
    dataset = Dataset(whole)
    dataset.read()
    drawn = crossings(dataset)
    monkeypatch.setattr(
        lierb.sampling.Design, "independent", lambda _, bodies: np.zeros(len(bodies), dtype=bool)
    )
    for each, before in zip(crossings(dataset), drawn, strict=True):
        assert [q.value for q in each.first] == [q.value for q in before.first]
        assert np.isnan([q[2:] for q in each.first]).all()


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_report_tells_the_events(ending, tmp_path):
    pytest.importorskip("plotly")
    from lierb.studies.pages.report import write_report

    dataset = Dataset(ending)
    dataset.read()
    page = write_report(dataset, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "What happened" in page
    assert 'id="events"' in page
    steps = numbers(ending, "steps").sum() + numbers(ending, "rejected").sum()
    assert f"{steps:,.0f} steps of a body".replace(",", " ") in page


def test_rules_may_be_of_times_and_steps(whole):
    problem = Study.load(whole / "study.toml").batch(0, 1).problem
    for column in ("t", "steps", "dt_last", "pointing_error_max"):
        assert rule_of(f"width of 95% of {column} < 2%", problem, True).column == column
    with pytest.raises(StudyError, match="steps"):
        rule_of("width of 95% of steps < 2%", problem)


def test_compare_takes_the_studys_tolerances(tmp_path):
    from lierb.cli.comparing import _control, _left_out

    given = loaded(tmp_path, {"integrate.rtol": [1e-3, 1e-6], "integrate.atol": 1e-8})
    assert _control(given, [], []) == {"dts": None, "rtols": [1e-3, 1e-6], "atol": 1e-8}
    assert _control(given, [0.1], []) == {"dts": [0.1], "rtols": None, "atol": None}
    assert _control(given, [], [1e-9])["rtols"] == [1e-9]
    assert _left_out(given) == ["save_at"]
    assert _control(study(), [], [])["dts"] == [1e-3, 2e-3]


@pytest.mark.slow
def test_the_example_is_what_it_names(tmp_path):
    """The example as printed, in a few seconds: all satellites point, and some wheels saturate."""
    for name in ("attitude.toml", "attitude.py"):
        given = name.removesuffix(".toml")
        (tmp_path / name).write_bytes(invoke("example", given).stdout_bytes)
    assert (tmp_path / "attitude.py").read_text(encoding="utf-8") == CODE
    assert "attitude " in invoke("example").output
    shown = invoke("run", tmp_path / "attitude.toml", "--out", tmp_path / "out")
    assert shown.exit_code == 0, shown.output
    assert "1000 of 1000" in shown.output
    dataset = Dataset(tmp_path / "out")
    dataset.read()
    pointed, saturated = crossings(dataset)
    assert (pointed.bodies, dataset.failures()) == (1000, None)
    assert 10 < saturated.bodies < 300


@pytest.mark.long
def test_compare_runs_an_adaptive_study(tmp_path):
    """Comparison with the study's tolerances and noise, without the settings that it lists."""
    file, out = written(tmp_path / "study"), tmp_path / "out"
    options = ("--set", "integrate.t_end=1", "--n", 2, "--repeats", 0, "--rtols", "1e-4,1e-6")
    told = invoke("compare", file, *options, "-o", out, "--markdown")
    assert told.exit_code == 0, told.output
    assert "Not taken from the study: save_at." in told.stderr
    found = pq.read_table(out / "comparison.parquet").to_pylist()
    assert [(row["method"], row["rtol"]) for row in found] == [("Tsit5", 1e-4), ("Tsit5", 1e-6)]
    # every step ends at a tick; of what noise does the reference's runs have the same
    assert all(row["steps"] < 15 and row["error.omega"] < 1e-12 for row in found)


MECHANISM = """
[[problem.links]]
name = "rod"
body = { solid = "box", size = [0.05, 0.05, 0.5], mass = 1.0 }
initial = { coordinates = 1.0 }

[problem.links.joint]
type = "revolute"
axis = [0.0, 1.0, 0.0]
body_point = [0.0, 0.0, 0.25]

[[problem.events]]
type = "python:attitude.py:lowest"
on = "rod"

[[problem.states]]
type = "python:attitude.py:counter"
on = "rod"

[[problem.controllers]]
type = "python:attitude.py:motor"
on = "rod"

[[problem.forces]]
type = "python:attitude.py:driven"
on = "rod"

[sample]
n = 6

[sample.rod.initial.coordinates]
distribution = "uniform"
low = 0.5
high = 1.5

[integrate]
method = "BS32"
rtol = 1e-6
t_end = 1.0
save_at = { every = 0.25 }
record = ["state", "energy", "multipliers", "reaction"]  # as a replay: they share a kernel

[output]
part = 4
"""
SWINGS = """
import lierb

@lierb.event
def lowest(R):
    return R[0, 2]

@lierb.states(turned=0.0, unit={"turned": "rad"})
def counter(omega):
    return {"turned": omega[1]}

@lierb.controller(every=0.05, gain=0.1)
def motor(omega, params):
    return {"push": -params.gain * omega[1] + 0.01 * lierb.noise.normal("tacho")}

@lierb.wrench
def driven(t, R, r, omega, v, params, controls):
    return (0.0, controls.push, 0.0), (0.0, 0.0, 0.0)
"""


@pytest.mark.long
def test_mechanisms_have_all_of_it(tmp_path):
    file = written(
        tmp_path / "study", SWINGS, "[problem]\ngravity = [0.0, 0.0, -9.81]\n" + MECHANISM
    )
    dataset = lierb.run(file, tmp_path / "out")
    rows = dataset.table("events").to_table().to_pylist()
    assert {row["event"] for row in rows} == {"lowest"}
    assert {row["trajectory"] for row in rows} == set(range(6))
    ((_, tables),) = replay(file, 5)
    (own,) = tables["summary"].to_pylist()
    assert own == dataset.table().to_table().slice(5, 1).to_pylist()[0]
    assert tables["events"].to_pylist() == [row for row in rows if row["trajectory"] == 5]
    # what the state has counted is the joint's angle, from where it was
    R = np.reshape(own["rod.rotation"], (3, 3))
    angle = np.arctan2(R[0, 2], R[2, 2])
    np.testing.assert_allclose(
        own["turned"], angle - own["sample.rod.initial.coordinates"], atol=1e-5
    )
    given = Study.load(file)
    history = lierb.integrate_batches(given, "history").read_next_batch()
    problem, recorded = given.batch(0, 1).problem, given.integrate.record
    each = LABEL_BYTES + run_tables.history_row_bytes(problem, recorded)
    assert abs(each * history.num_rows / history.nbytes - 1.0) < 0.05


# ---- drawn -------------------------------------------------------------------------------------


def test_initial_states_and_periods_are_drawn(tmp_path):
    changes = {
        "sample.states.reaction_wheels.wheels": {
            "distribution": "uniform", "low": [0.0, 0.0, 0.0], "high": [0.1, 0.1, 0.1],
        },
        "sample.controllers.computer.every": {"distribution": "values", "values": [0.1, 0.2]},
        "sample.n": 3, "output.part": 2,
    }  # fmt: skip
    given = loaded(tmp_path, changes)
    dataset = lierb.run(given, tmp_path / "out")
    first = dataset.table("history").to_table().to_pylist()
    starts = {row["trajectory"]: row["wheels"] for row in first if row["step"] == 0}
    rows = dataset.table().to_table().to_pylist()
    for row in rows:
        assert starts[row["trajectory"]] == row["sample.states.reaction_wheels.wheels"]
        ticks = 10.0 / row["sample.controllers.computer.every"]
        assert row["steps"] >= ticks
    problem = given.batch(0, 1).problem
    assert unit_of("states.reaction_wheels.wheels", given, problem) == "N m s"
    assert unit_of("controllers.computer.every", given, problem) == "s"


def test_three_bodies_may_draw_three_states(tmp_path):
    """Not taken for one vector of all."""
    wheels = {"distribution": "uniform", "low": [0.0, 0.0, 0.0], "high": [1.0, 1.0, 1.0]}
    given = loaded(tmp_path, {"sample.states.reaction_wheels.wheels": wheels, "sample.n": 3})
    drawn = given.batch(0, 3).problem.states[0].parameters["initial.wheels"]
    assert drawn.shape == (3, 3)
    np.testing.assert_array_equal(drawn[2], given.design.draw()["states.reaction_wheels.wheels"][2])


def test_problem_and_design_run_to_the_bytes_of_the_file(whole, tmp_path):
    """Study from Python, with the names of a file."""
    file = written(tmp_path / "study").with_name("attitude.py")
    spec = importlib.util.spec_from_file_location("attitude", file)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    given = Study.load(whole / "study.toml")
    problem = lierb.Problem(
        lierb.Body(120.0, (19.0, 17.0, 14.0)), lierb.joints.free(), forces=made.reaction(),
        observables=made.pointing_error(), states=made.reaction_wheels(),
        controllers=made.computer(),
        events=[made.pointed(within=1.0), made.saturated(capacity=0.6)],
    )  # fmt: skip
    drawn = given.design.quantities
    design = lierb.sampling.Design(drawn, n=N, seed=4)
    settings = {"rtol": 1e-6, "method": "Tsit5", "t_end": 10.0, "part": 16}
    dataset = lierb.run(
        problem, design, tmp_path / "out", save_at=0.5 * np.arange(21), **settings
    )  # fmt: skip
    assert dataset.trajectories == N
    for name in TABLES:
        assert bits(tmp_path / "out", name) == bits(whole, name)
    states = {"states.reaction_wheels.wheels": [0.1, 0.0, 0.0]}
    moved = lierb.study_of(problem, lierb.sampling.Design(drawn | states, n=2), **settings)
    assert moved.batch(0, 1).problem.states[0].parameters["initial.wheels"][0, 0] == 0.1


# ---- files -------------------------------------------------------------------------------------


def test_studies_without_any_of_it_keep_their_digest():
    """Digests of version 0.1, which identify folders."""
    assert study().digest().startswith("136cbbc7764c929d")
    assert study(integrate={"save_every": 10}).digest().startswith("bbd72fed2526b5b1")


def test_a_mechanism_keeps_the_cspace_that_one_body_has_by_default():
    given = Study.load(EXAMPLES / "four_bar.toml", {"integrate.cspace": "SE3"})
    assert given.integrate.cspace == ["SE3"]
    assert Study.of(given._tables()).integrate.cspace == ["SE3"]


def test_adaptive_steps_are_dop853s_by_default():
    given = study(integrate={"rtol": 1e-8, "dt": []})
    assert given.integrate.method == ["DOP853"]
    assert [each.step_label for each in given.settings] == ["rtol = 1e-08"] * 2
    assert Study.of(given._tables()).settings == given.settings
    only_atol = study(integrate={"atol": {"omega": 1e-9}, "dt": [1e-3]})
    assert [(s.dt, s.rtol) for s in only_atol.settings] == [(1e-3, 1e-6)] * 2


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([0.25, 1.0], [0.25, 1.0]),
        ({"every": 0.5}, [0.0, 0.5, 1.0, 1.5, 2.0]),
        ({"every": 0.75}, [0.0, 0.75, 1.5]),
        ({"every": 0.1, "from": 1.7}, [1.7, 1.7 + 0.1, 1.7 + 2 * 0.1, 2.0]),
        ({"every": 0.5, "to": 0.5}, [0.0, 0.5]),
        ({"every": 9.0}, [0.0]),
    ],
)
def test_saved_times_are_those_of_the_rule(given, expected):
    assert saved_times(given, 0.0, 2.0).tolist() == expected


TICKS, SAMPLE = "problem.controllers.computer.every", "sample.states.reaction_wheels"
WRONG = {
    "rtol": ({"integrate.rtol": 2.0}, "integrate.rtol: rtol=2.0; expected a number from 1e-15"),
    "block": ({"integrate.atol": {"speed": 1.0}}, r"integrate.atol: atol='speed'.*omega"),
    "atol": ({"integrate.atol": "small"}, "integrate.atol: input should be a valid number"),
    "method": ({"integrate.method": "RK4"}, "integrate.rtol: rtol= and atol= need a method"),
    "no_dt": ({"integrate.rtol": []}, "integrate.dt: is missing; without rtol it is the step, s"),
    "dts": ({"integrate.dt": [0.1, 0.2]}, "integrate.dt: has 2 values; with rtol"),
    "twice": ({"integrate.rtol": [1e-6, 1e-6]}, "integrate.rtol: 1e-06 is given twice"),
    "least": (
        {"integrate.dt_min": 1.0, "integrate.dt_max": 0.1},
        "integrate.dt_min: dt_min=1.0 s is longer than dt_max=0.1 s",
    ),
    "steps": ({"integrate.max_steps": 0}, "integrate.max_steps: input should be greater than 0"),
    "save_every": (
        {"integrate.save_every": 10, "integrate.save_at": None},
        r"integrate\.save_every: save_every=10 counts steps.*save_at",
    ),
    "both": (
        {"integrate.save_every": 10, "integrate.rtol": [], "integrate.dt": 0.1,
         "integrate.method": "RK4"},
        "integrate.save_every: save_every and save_at are both given",
    ),
    "late": ({"integrate.save_at": [1.0, 11.0]}, r"integrate.save_at: save_at has 11.0 s.*t_end"),
    "mixed": ({"integrate.save_at": [1.0, 0.5]}, r"integrate\.save_at: .* that do not ascend"),
    "text": ({"integrate.save_at": ["soon"]}, "integrate.save_at: input should be times in s"),
    "empty": ({"integrate.save_at": []}, "integrate.save_at: input should be times in s"),
    "key": (
        {"integrate.save_at": {"each": 1.0}},
        "integrate.save_at: has the unknown key each; known: every, from, to",
    ),
    "no_every": ({"integrate.save_at": {"to": 1.0}}, "integrate.save_at: needs every"),
    "every": ({"integrate.save_at": {"every": 0.0}}, "integrate.save_at: save_at: every=0.0"),
    "order": (
        {"integrate.save_at": {"every": 1.0, "from": 5.0, "to": 1.0}},
        "integrate.save_at: save_at: from=5.0 s is later than to=1.0 s",
    ),
    "many": ({"integrate.save_at": {"every": 1e-9}}, r"makes 1e\+10 times .* at most 1e\+07"),
    "seed": ({"sample.seed": 2**60}, r"sample.seed: is \d+; expected less than 2\*\*53"),
    "function": (
        {"problem.events.0.type": "python:attitude.py:computer"},
        "problem.events: computer in attitude.py is .*@lierb.event",
    ),
    "name": (
        {"problem.states.0.type": "python:attitude.py:wheels"},
        "problem.states: attitude.py defines no wheels",
    ),
    "parameter": ({"problem.events.0.withn": 1.0}, "problem.events: .*withn.*within"),
    "period": ({TICKS: -0.1}, "problem.controllers: every"),
    "periods": ({TICKS: [0.1] * 8}, r"problem.controllers.computer.every has shape \(.*one number"),
    "quantity": ({f"{SAMPLE}.wheel": [0.0, 0.0, 0.0]}, "problem.states: .*wheel"),
    "shape": ({f"{SAMPLE}.wheels": {"distribution": "uniform", "low": 0.0, "high": 1.0}}, "wheels"),
    "no_effect": ({"problem.controllers.computer.damping": 3.0}, "has no effect, since each body"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_error_names_the_key(name, tmp_path):
    changes, told = WRONG[name]
    with pytest.raises(StudyError, match=told):
        loaded(tmp_path, changes)


def test_error_names_the_line(tmp_path):
    text = TEXT.replace("rtol = 1e-6", "rtol = 1e-16")
    with pytest.raises(StudyError, match=r"study\.toml:\d+: integrate\.rtol: rtol=1e-16") as found:
        Study.load(written(tmp_path / "study", text=text))
    line = int(str(found.value).split(":")[1])
    assert text.split("\n")[line - 1].startswith("rtol")


# ---- memory ------------------------------------------------------------------------------------


@pytest.mark.parametrize("record", [[], ["state"], ["state", "energy"]], ids=" ".join)
def test_size_of_rows_is_what_tables_hold(record, tmp_path):
    """Equal to the byte, except for names that a column stores once."""
    given = loaded(tmp_path, {"integrate.record": record, "sample.n": 16})
    dataset = lierb.run(given, tmp_path / "out")
    problem = given.batch(0, 1).problem
    names = ("history", "events")
    tables = {name: lierb.integrate_batches(given, name).read_next_batch() for name in names}
    assert dataset.trajectories == 16
    each = LABEL_BYTES + run_tables.history_row_bytes(problem, record)
    held = tables["history"]
    assert abs(each * held.num_rows / held.nbytes - 1.0) < 0.02
    held = tables["events"]
    each = LABEL_BYTES + run_tables.event_row_bytes(problem)
    assert abs(each * held.num_rows / (held.nbytes - 16) - 1.0) < 0.03
    assert saved_rows(given) == 21


def test_parts_are_as_large_as_fits(tmp_path):
    given = loaded(tmp_path, {"integrate.save_at": {"every": 1e-3}, "output.part": 10_000})
    problem = given.batch(0, 1).problem
    row = LABEL_BYTES + run_tables.history_row_bytes(problem, ())
    foreseen = 2 * 10 * (LABEL_BYTES + run_tables.event_row_bytes(problem))
    assert bytes_of_body(given) == 10_001 * row + foreseen
    assert part_size(given) == int(64e6 / bytes_of_body(given)) < 100
    only_events = given.changed({"integrate.save_at": None, "output.part": 10**6})
    assert part_size(only_events) == 64_000_000 // foreseen


@pytest.mark.long
def test_fixed_steps_have_a_controller_too(tmp_path):
    """And save by steps; with the digest and the tables of their own."""
    changes = {"integrate.rtol": [], "integrate.save_at": None, "integrate.dt": 0.1,
               "integrate.save_every": 10, "integrate.method": "Tsit5", "sample.n": 5}  # fmt: skip
    given = loaded(tmp_path, changes)
    assert given.has_lane_clocks
    dataset = lierb.run(given, tmp_path / "out")
    assert dataset.table("history").to_table()["t"].to_pylist()[::5] == list(range(11))
    assert set(dataset.table().to_table()["steps"].to_pylist()) == {100}
    assert saved_rows(given) == 11
    by_time = given.changed({"integrate.save_every": None, "integrate.save_at": {"every": 1.0}})
    lierb.run(by_time, tmp_path / "by_time")
    for name in TABLES:  # rows have the numbers of steps there, and their own here
        one, other = (bits(tmp_path / out, name) for out in ("by_time", "out"))
        assert {k: one[k] for k in one if k != "step"} == {
            k: other[k] for k in other if k != "step"
        }


def test_tops_stay_on_the_grid():
    """Studies that need no lane clocks have none."""
    assert not study().has_lane_clocks
    assert "rtol" not in TOPS

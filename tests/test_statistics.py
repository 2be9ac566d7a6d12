"""Quantiles of studies, and the rules by which they stop."""

from __future__ import annotations

import json
import shutil
from io import StringIO
from math import comb

import numpy as np
import pyarrow as pa
import pytest
from command import invoke
from rich.console import Console
from scipy.stats import chi2
from studies import hashes, sorted_rows, tables

import lierb
from lierb.errors import (
    ArgumentError,
    FailedTrajectoryWarning,
    StiffStepWarning,
    StudyError,
)
from lierb.studies.dataset import Dataset
from lierb.studies.description.quantiles import Quantile, quantile_of, quantiles_of, share_width
from lierb.studies.description.settings import Setting
from lierb.studies.description.stopping import Bodies, Rule
from lierb.studies.description.study import Study
from lierb.studies.execution import cluster
from lierb.studies.findings.findings import SettingErrors, findings
from lierb.studies.findings.occurrences import Occurred
from lierb.studies.findings.sizes import ERRORS, errors_seen
from lierb.studies.findings.statistics import (
    Sensitivity,
    Spread,
    indices,
    quantiles_over_time,
    quantities,
)
from lierb.studies.findings.tables import (
    table_of,
    table_of_events,
    table_of_indices,
    table_of_quantities,
)

RULE = "width of 50% of energy_drift_max < 12%"


def study(n: int = 400, part: int = 20, **sample) -> Study:
    """Heavy tops in two settings, of which one is enough much sooner."""
    changed = tables()
    changed["sample"] |= {"n": n} | sample
    changed["integrate"] |= {"cspace": ["SE3"], "t_end": 0.05}
    changed["output"]["part"] = part
    return Study.of(changed)


# ---- intervals ---------------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95])
@pytest.mark.parametrize("n", [20, 100, 1000])
def test_quantile_interval_has_its_confidence(probability, n):
    """Exact binomial probability that so many of n are below the population's quantile."""
    found = quantile_of(np.arange(n, dtype=float), probability)
    terms = [comb(n, k) * probability**k * (1.0 - probability) ** (n - k) for k in range(n + 1)]
    first = -1.0 if np.isnan(found.low) else found.low
    last = float(n) if np.isnan(found.high) else found.high
    # x[i] ≤ q < x[j] means that i + 1 to j numbers are below q.
    inside = sum(terms[int(first) + 1 : int(last) + 1])
    assert inside >= 0.95
    # No end can be moved inwards: each tail would have more than 2.5 %.
    if first >= 0.0:
        assert sum(terms[: int(first) + 2]) > 0.025
    if last < n:
        assert sum(terms[int(last) :]) > 0.025


def test_quantile_of_too_few_has_no_interval():
    found = quantile_of(np.arange(10.0), 0.95)
    assert (found.value, np.isnan(found.high), np.isnan(found.width)) == (9.0, True, True)
    assert np.isnan(quantile_of(np.empty(0), 0.5).value)


@pytest.mark.parametrize("probability", [0.05, 0.95])
def test_quantile_intervals_of_a_saltelli_design_have_their_confidence(probability):
    """Lengths of 20 normal components follow χ²; 60 seeds leave 3 standard errors of 0.03 each.

    Rows share 19 of 20 components with A: by all bodies half of the intervals miss the truth.
    """
    truth = np.sqrt(chi2.ppf(probability, 20))
    hits = {"independent": 0, "all": 0}
    for seed in range(60):
        normal = {f"x{i}": lierb.sampling.Normal(0.0, 1.0) for i in range(20)}
        design = lierb.sampling.Design(normal, n=22 * 64, seed=seed, method="saltelli")
        lengths = np.linalg.norm(np.stack([*design.draw().values()], axis=-1), axis=-1)
        own = design.independent(np.arange(design.n))
        for name, chosen in (("independent", own), ("all", np.ones_like(own))):
            (found,) = quantiles_of(lengths, chosen, (probability,))
            hits[name] += found.low <= truth <= found.high
    assert hits["independent"] / 60 > 0.86
    assert hits["all"] / 60 < 0.7


def test_designs_mark_the_bodies_that_they_draw_independently():
    uniforms = {name: lierb.sampling.Uniform(0.0, 1.0) for name in "abc"}
    levels = {name: lierb.sampling.Values([1.0, 2.0]) for name in "abc"}
    bodies = np.arange(3, 13)
    for method, drawn, expected in (
        ("random", uniforms, range(3, 13)), ("sobol", uniforms, range(3, 13)),
        ("saltelli", uniforms, [5, 6, 10, 11]), ("grid", levels, []),
    ):  # fmt: skip
        n = None if method == "grid" else 5 * 64
        design = lierb.sampling.Design(drawn, n, method=method)
        assert [*bodies[design.independent(bodies)]] == [*expected]


def test_share_width_is_that_of_the_rule_of_three():
    """None of n: up to 1 − 0.025^(1/n)."""
    assert share_width(0, 100) == pytest.approx(1.0 - 0.025 ** (1.0 / 100.0), rel=1e-12)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("statistics") / "out"
    lierb.run(study(), place)
    dataset = Dataset(place)
    dataset.read()
    return dataset


def test_quantities_have_the_quantiles_asked_for(whole):
    rows = sorted_rows(whole.folder)
    for spread in quantities(whole, (0.25, 0.9973)):
        ordered = sorted(r[spread.name] for r in rows if r["dt"] == spread.setting.dt)
        assert len(ordered) == 400
        assert [q.value for q in spread.quantiles] == [ordered[99], ordered[398]]
        assert spread.quantiles == tuple(quantile_of(np.array(ordered), p) for p in (0.25, 0.9973))


@pytest.mark.parametrize("probability", [95.0, 1.0, 0.0, -0.5, np.nan])
def test_quantile_of_refuses_what_is_no_probability(probability):
    with pytest.raises(ArgumentError, match="expected more than 0 and less than 1"):
        quantile_of(np.arange(3.0), probability)


def test_show_prints_quantiles_with_intervals(whole):
    (first, *_) = quantities(whole)
    shown = invoke("show", whole.folder).stdout
    assert first.name in shown
    for quantile in first.quantiles:
        low, high = _interval_in(shown, f"{100.0 * quantile.probability:g}%")
        # Rounded to less than the distance between the numbers.
        least = min(quantile.value - quantile.low, quantile.high - quantile.value)
        assert abs(float(low) - quantile.low) <= least
        assert abs(float(high) - quantile.high) <= least
    (found, _) = findings(whole)
    median, _, largest = found.quantiles["energy"]
    assert f"  {median:.1e}   {largest:.1e}" in shown


def _interval_in(shown: str, percentage: str) -> list[str]:
    """Ends of the first interval of that quantile."""
    line = next(x for x in shown.splitlines() if f" {percentage} " in x and "…" in x)
    return line.split()[-1].split("…")


def test_tables_tell_different_quantiles_apart():
    """A stroke with a tolerance of 1e-4 of its length, or of 1e-9, or none."""
    setting = Setting("SE3", "RK4", 1e-3, None)
    for tolerance, is_apart in ((1e-4, True), (1e-9, True), (0.0, False), (1e-15, False)):
        ordered = 0.15 * (1.0 + tolerance * np.linspace(-1.0, 1.0, 1001))
        row = tuple(quantile_of(ordered, p) for p in (0.05, 0.5, 0.95))
        console = Console(width=120, file=StringIO())
        console.print(table_of_quantities([Spread(setting, "stroke_min", "m", 1001, 0, row)]))
        lines = [line for line in console.file.getvalue().splitlines() if "%" in line]
        shown = [text for line in lines for text in line.replace("…", " ").split()[-3:]]
        assert len({*shown[-9:]}) == (9 if is_apart else 1), shown


SIGMAS = "0.135,2.275,15.87,50,84.13,97.725,99.99993"  # −3 to 3 standard deviations, and five


def test_show_prints_the_quantiles_asked_for_in_80_columns(whole):
    shown = invoke("show", whole.folder, "--quantiles", SIGMAS).stdout
    for percentage in SIGMAS.split(","):
        assert shown.count(f" {percentage}% ") == 2 * len(errors_seen(whole))
    *tables, folder = shown.splitlines()
    assert max(map(len, tables)) <= 80
    assert str(whole.folder) in folder


@pytest.mark.parametrize("given", ["100", "0,50", "nan", "fifty", "50,", ""])
def test_commands_refuse_what_is_no_percentage(whole, given):
    refused = invoke("show", whole.folder, "--quantiles", given)
    assert refused.exit_code == 2
    assert "expected percentages above 0 and below 100, as 50,95,99.73" in " ".join(
        refused.stderr.split()
    )


def test_tables_fit_in_80_columns():
    """Long words of each kind: c-space, method, counts, an observable, an event, numbers."""
    setting = Setting("SO3xR3", "Rodas5P", None, 1.25e-06)
    quantiles = [Quantile(p, -1.23e-123, -1.23e-123, -1.23e-123) for p in (0.5, 0.9999)]
    late = [Quantile(0.5, np.inf, 123.0, np.inf)]
    error = np.full(3, 1.2e-12)
    kinds = dict.fromkeys(ERRORS, error), dict.fromkeys(ERRORS, 1.0)
    index = (0.1234, -0.123, 0.456)
    shares = Sensitivity(
        setting, "pointing_error_final", "forces.controller.damping", index, index, 8
    )
    made = [
        table_of([SettingErrors(setting, 10**6, 10**5, *kinds)]),
        table_of_quantities([Spread(setting, "pointing_error_final", "rad", 8, 3, quantiles)]),
        table_of_events([Occurred(setting, "saturated", 10**7, 10**6, 10**6, late)], 150.25),
        table_of_indices([shares, shares._replace(column="work_final")]),
    ]
    for table in made:
        assert max(map(len, _printed(table).splitlines())) <= 80
    assert "not a number: 3" in _printed(made[1])
    assert "> 150.25" in _printed(made[2])
    assert _printed(made[3]).count("forces.controller.damping") == 2


def _printed(table) -> str:
    text = StringIO()
    Console(file=text, width=200).print(table)
    return text.getvalue()


# ---- enough bodies -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    place = tmp_path_factory.mktemp("stopped") / "out"
    lierb.run(study(stop_when=RULE), place)
    return place


def last_needed(folder, whole, dt) -> int:
    """Bodies of a setting after which the rule holds for the first time, part by part."""
    rows = [r for r in sorted_rows(whole.folder) if r["dt"] == dt]
    for n in range(20, 401, 20):
        found = quantile_of(np.sort([r["energy_drift_max"] for r in rows[:n]]), 0.5)
        if found.width < 0.12 * found.value:
            return n
    return 400


def test_stop_when_ends_each_setting_where_the_rule_holds(stopped, whole):
    rows = sorted_rows(stopped)
    counts = {dt: sum(r["dt"] == dt for r in rows) for dt in (1e-3, 2e-3)}
    assert counts == {dt: last_needed(stopped, whole, dt) for dt in counts}
    assert all(20 < count < 400 for count in counts.values())
    wanted = [r for r in sorted_rows(whole.folder) if r["trajectory"] < counts[r["dt"]]]
    assert rows == wanted


def test_stop_when_is_told(stopped):
    done = len(list((stopped / "summary").iterdir()))
    shown = invoke("show", stopped).stdout
    assert f"{done} of 40 parts; enough, by {RULE}" in " ".join(shown.split())
    dataset = Dataset(stopped)
    dataset.read()
    assert "enough, by" in str(dataset)


def test_resume_of_a_study_that_stopped_does_nothing(stopped, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(stopped, out)
    lierb.run(study(stop_when=RULE), out, resume=True)
    assert hashes(out) == hashes(stopped)


def test_resume_with_more_bodies_stops_at_the_same_part(stopped, tmp_path):
    lierb.run(study(n=30, stop_when=RULE), tmp_path / "out")
    lierb.run(study(stop_when=RULE), tmp_path / "out", resume=True)
    assert hashes(tmp_path / "out") == hashes(stopped)


def test_resume_stops_at_the_same_part(stopped, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(stopped, out)
    files = sorted((out / "summary").iterdir())
    for file in (files[1], files[-1]):
        file.unlink()
    lierb.run(study(stop_when=RULE), out, resume=True)
    assert hashes(out) == hashes(stopped)


def test_a_rule_counts_the_independent_bodies_alone():
    """Of four bodies a row, A and B; one of A has failed. Parts do not end with a row."""
    design, rule = sensitive().design, Rule(0.5, "x", 0.1, is_relative=False)
    bodies, values = Bodies(rule, design), np.arange(100.0)[::-1]
    statuses = np.where(np.arange(100) == 40, "non_finite", "ok")
    for rows in (slice(0, 37), slice(37, 100)):
        columns = {"trajectory": np.arange(100)[rows], "x": values[rows]}
        bodies.add(pa.table(columns | {"status": statuses[rows]}))
    expected = [x for i, x in enumerate(values) if i % 4 < 2 and i != 40]
    assert (bodies.count, bodies.failed) == (50, 1)
    assert bodies.ordered.tolist() == sorted(expected)


def grid() -> Study:
    changed = study().model_dump(exclude_defaults=True, exclude_none=True)
    masses = {"distribution": "values", "values": np.linspace(5.0, 7.0, 40).tolist()}
    changed["sample"] = {"method": "grid", "body": {"mass": masses}}
    return Study.of(changed)


def test_a_grid_has_quantiles_without_intervals(tmp_path):
    dataset = lierb.run(grid(), tmp_path / "out")
    for spread in quantities(dataset):
        rows = [r for r in sorted_rows(dataset.folder) if r["dt"] == spread.setting.dt]
        ordered = sorted(r[spread.name] for r in rows)
        assert [q.value for q in spread.quantiles] == [ordered[1], ordered[19], ordered[37]]
        assert np.isnan([q[2:] for q in spread.quantiles]).all()
    assert "Quantiles of a grid have no intervals" in invoke("show", dataset.folder).stdout


@pytest.mark.parametrize("rule", [RULE, "width of failed < 0.1"])
def test_a_grid_refuses_a_rule(rule):
    with pytest.raises(
        StudyError, match=r"sample\.stop_when: a grid has no .* 40 bodies are chosen"
    ):
        grid().changed({"sample.stop_when": rule})


@pytest.mark.long
def test_workers_stop_at_the_same_part(stopped, tmp_path):
    pytest.importorskip("distributed")
    with cluster.local_client(2) as client:
        lierb.run(study(stop_when=RULE), tmp_path / "out", client=client)
    assert hashes(tmp_path / "out") == hashes(stopped)


def test_batches_stop_at_the_same_part(stopped):
    count = lierb.integrate_batches(study(stop_when=RULE)).read_all().num_rows
    assert count == len(sorted_rows(stopped))


def test_stop_when_that_never_holds_runs_all(whole, tmp_path):
    lierb.run(study(stop_when="width of 99.9% of energy_drift_max < 1e-30"), tmp_path / "out")
    for name, digest in hashes(whole.folder).items():
        if name.startswith("summary"):
            assert hashes(tmp_path / "out")[name] == digest
    assert "stopped" not in json.loads((tmp_path / "out" / "manifest.json").read_text())


def test_stop_when_of_failures(tmp_path):
    """No failure among 20 bodies gives a bound of 0.168; among 40, of 0.088."""
    lierb.run(study(stop_when="width of failed < 0.1"), tmp_path / "out")
    assert len(sorted_rows(tmp_path / "out")) == 2 * 40


@pytest.mark.parametrize(
    ("rule", "told"),
    [
        ("width of 95% of energy_drft_max < 1", "Did you mean 'energy_drift_max'"),
        ("width of 95% of status < 1", "column='status' is unknown"),
        ("width of 100% of work_final < 1", "expected more than 0 and less than 100"),
        ("width of 95% of work_final < 0", "expected a positive bound"),
        ("width of failed < 1%", "expected \"width of 95% of COLUMN"),
        ("width of 95% of failed < 1", "expected \"width of 95% of COLUMN"),
        ("width of work_final < 1", "expected \"width of 95% of COLUMN"),
        ("95% of work_final < 1", "expected \"width of 95% of COLUMN"),
        ("width of 95% of work_final > 1", "expected \"width of 95% of COLUMN"),
    ],
)  # fmt: skip
def test_stop_when_refuses_what_is_no_rule(rule, told):
    with pytest.raises(StudyError, match=f"sample.stop_when: .*{told}"):
        study(stop_when=rule)


def test_digest_of_a_study_without_a_rule_is_as_before():
    assert study(stop_when=RULE).digest() != study().digest()
    whole = study().model_dump(exclude={"name"})
    assert whole["sample"].pop("stop_when") is None
    for table in ("constraints", "observables", "events", "states", "controllers"):
        assert (whole["problem"].pop(table), whole["sample"].pop(table)) == ([], {})
    assert whole["integrate"].pop("sensitivities") == []
    for key in ("atol", "dt_min", "dt_max", "max_steps", "save_at", "discontinuities"):  # of time
        assert whole["integrate"].pop(key) is None
    assert whole["integrate"].pop("rtol") == []
    assert whole["problem"].pop("links") == whole["problem"].pop("loops") == []  # of mechanisms
    assert [force.pop("on") for force in whole["problem"]["forces"]] in ([], [None])
    assert whole["initial"].pop("close") is whole["integrate"].pop("stabilise") is None
    assert whole["initial"].pop("hold") is whole["body"].pop("about") is None
    assert whole["joint"].pop("parent_point") is whole["joint"].pop("parent_frame") is None
    import hashlib

    text = json.dumps(whole, sort_keys=True)
    assert study().digest() == hashlib.sha256(text.encode()).hexdigest()


# ---- over time ---------------------------------------------------------------------------------


def test_quantiles_over_time_are_those_of_the_history(tmp_path, monkeypatch):
    changed = study(n=30).changed({"integrate.save_every": 10, "integrate.dt": 1e-3})
    dataset = lierb.run(changed, tmp_path / "out")
    history = dataset.table("history").to_table().to_pandas()
    (setting,) = changed.settings
    of = dataset, "energy_drift", setting, (0.05, 0.5, 0.975)
    t, quantiles = quantiles_over_time(*of)
    monkeypatch.setattr(lierb.studies.findings.statistics, "MOST_NUMBERS", 60)  # two times at once
    assert np.array_equal(quantiles_over_time(*of)[1], quantiles)
    assert t.tolist() == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
    for step, found in zip(sorted({*history["step"]}), quantiles.T, strict=True):
        values = np.sort(history[history["step"] == step]["energy_drift"])
        assert found.tolist() == [values[1], values[14], values[29]]


def test_quantiles_over_time_leave_out_bodies_that_failed(tmp_path):
    """Some have drag by which fixed steps overflow, with huge drifts before."""
    drag = {"distribution": "values", "values": [0.1, 0.2, 0.3, 1e5]}
    changed = study(n=12, forces={"drag": {"linear": drag}})
    changed = changed.changed({"integrate.save_every": 1, "integrate.dt": 1e-3})
    with pytest.warns(FailedTrajectoryWarning), pytest.warns(StiffStepWarning):
        dataset = lierb.run(changed, tmp_path / "out")
    history, summary = (
        dataset.table(name).to_table().to_pandas() for name in ("history", "summary")
    )
    fine = summary[summary["status"] == "ok"]["trajectory"]
    assert 0 < len(fine) == 12 - dataset.failures().count < 12
    is_ok = history["trajectory"].isin(fine)
    assert history[~is_ok]["energy_drift"].abs().max() > 1e10
    (setting,) = changed.settings
    _, quantiles = quantiles_over_time(dataset, "energy_drift", setting, (0.05, 0.5, 1.0))
    for step, found in zip(sorted({*history["step"]}), quantiles.T, strict=True):
        own = np.sort(history[is_ok & (history["step"] == step)]["energy_drift"])
        assert len(own) == len(fine)
        assert (found[0], found[-1]) == (own[0], own[-1])


def test_fractions_are_no_percentages_and_percentages_no_fractions(whole):
    """A quantile asked for by the other unit is refused with what to write."""
    refused = invoke("show", whole.folder, "--quantiles", "0.5,0.95")
    assert refused.exit_code == 2
    assert "--quantiles=50,95" in " ".join(refused.output.split())
    with pytest.raises(ArgumentError, match=r"for 50 % give 0\.5$"):
        quantities(whole, (50,))
    assert invoke("show", whole.folder, "--quantiles", "0.5,50").exit_code == 0


# ---- sensitivity -------------------------------------------------------------------------------

ROWS = 256


def uniform(low, high) -> dict:
    return {"distribution": "uniform", "low": low, "high": high}


def sensitive(**sample) -> Study:
    """A free body that is thrown: where it is after 1 s is r = v t, so that r₁² is v₁²."""
    return Study.of(
        {
            "body": {"mass": 1.0, "inertia": [1.0, 1.0, 1.0]},
            "joint": {"type": "free"},
            "problem": {"observables": [{"type": "python:seen.py:reach"}]},
            "sample": {
                "n": 4 * ROWS, "method": "saltelli", "seed": 5,
                "initial": {
                    "point_velocity": uniform([1, 0, 0], [3, 0, 0]),
                    "place": uniform([0, 0, 0], [1, 0, 0]),
                },
            } | sample,
            "integrate": {"dt": 0.25, "t_end": 1.0, "method": "Euler", "measure_every": 4},
            "output": {"part": 100},
        },
        code={"seen.py": SEEN},
    )  # fmt: skip


SEEN = """\
import lierb

@lierb.observable(unit="m")
def reach(r):
    return r[0]
"""


@pytest.mark.slow
def test_indices_are_those_of_a_sum(tmp_path):
    """r = r₀ + v t, both uniform, of widths 1 and 2: variances 1/12 and 4/12, no interaction."""
    lierb.run(sensitive(), tmp_path / "out")
    dataset = Dataset(tmp_path / "out")
    dataset.read()
    found = {(i.column, i.quantity): i for i in indices(dataset)}
    for name, share in (("initial.place", 0.2), ("initial.point_velocity", 0.8)):
        index = found["reach_final", name]
        assert index.rows == ROWS
        for value, low, high in (index.first, index.total):
            assert value == pytest.approx(share, abs=0.05)  # 256 points of a Sobol sequence
            assert low <= value <= high
    shown = invoke("show", tmp_path / "out").stdout
    assert "share of the variance due to" in shown
    assert f"{found['reach_final', 'initial.place'].total.value:.3f}" in shown


@pytest.mark.slow
def test_indices_are_of_whole_rows_before_what_is_missing(tmp_path):
    lierb.run(sensitive(), tmp_path / "out")
    dataset = Dataset(tmp_path / "out")
    dataset.read()
    del dataset.manifest["parts"]["00-0000000700"]  # rows 175 to 199
    assert {i.rows for i in indices(dataset)} == {128}


@pytest.mark.slow
def test_quantiles_of_a_saltelli_study_are_of_its_independent_bodies(tmp_path):
    dataset = lierb.run(sensitive(), tmp_path / "out")
    reach = {r["trajectory"]: r["reach_final"] for r in dataset.table().to_table().to_pylist()}
    own = np.sort([x for body, x in reach.items() if body % 4 < 2])
    (spread,) = (each for each in quantities(dataset) if each.name == "reach_final")
    assert spread.quantiles == tuple(quantile_of(own, p) for p in (0.05, 0.5, 0.95))
    shown = " ".join(invoke("show", dataset.folder).stdout.split())
    assert "Quantiles are of the first two bodies of each row of the design, A and B" in shown


def test_saltelli_design_swaps_one_quantity_at_a_time():
    design = sensitive().design
    drawn = design.draw()
    rows = {name: values.reshape(ROWS, 4, -1) for name, values in drawn.items()}
    place, speed = rows["initial.place"], rows["initial.point_velocity"]
    for values, own, other in ((place, 2, 3), (speed, 3, 2)):
        np.testing.assert_array_equal(values[:, own], values[:, 1])  # B's
        np.testing.assert_array_equal(values[:, other], values[:, 0])  # A's
        assert (values[:, 0] != values[:, 1]).any(axis=1).all()
    part = design.draw(101, 57)
    for name, values in part.items():
        np.testing.assert_array_equal(values, drawn[name][101:158])


def test_saltelli_design_has_independent_halves():
    """Mean and correlation of a Sobol sequence's points: far below 1/√n."""
    rows = sensitive().design.draw()["initial.place"].reshape(ROWS, 4, 3)[..., 0]
    assert rows[:, :2].mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.01)
    assert abs(np.corrcoef(rows[:, 0], rows[:, 1])[0, 1]) < 0.05


@pytest.mark.parametrize("n", [1, 1000, 4 * 3, 5 * 256])
def test_saltelli_design_refuses_other_numbers_of_bodies(n):
    with pytest.raises(StudyError, match="takes 4 bodies times a power of two; the nearest are"):
        sensitive(n=n)


def test_saltelli_design_refuses_constants_alone():
    with pytest.raises(lierb.errors.ArgumentError, match="all are constants"):
        lierb.sampling.Design({"x": 1.0}, n=4, method="saltelli")

"""Studies with derivatives: what their parts hold, importance factors, linear percentiles.

The hinge of most tests is a linear oscillator: φ̈ = −ω²φ, ω² = k/I, φ = (u/ω) sin ωt from φ̇ = u.
"""

from __future__ import annotations

import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from command import invoke
from studies import bits, hashes, start

import lierb
from lierb.api import integrate_model
from lierb.errors import (
    DerivativeWarning,
    FailedTrajectoryWarning,
    StiffStepWarning,
    StudyError,
)
from lierb.results.columns import as_array
from lierb.studies.dataset import Dataset
from lierb.studies.description.batches import batch_at
from lierb.studies.description.differentiated import parameters_of
from lierb.studies.description.quantiles import quantile_of
from lierb.studies.description.sources import MANIFEST
from lierb.studies.description.study import Study
from lierb.studies.execution import cluster, running
from lierb.studies.execution.foreseen import foreseen
from lierb.studies.execution.replaying import compile_for, replay
from lierb.studies.findings.along_parameters import AlongParameters
from lierb.studies.findings.linear_theory import _shares, linear_theories, remarks
from lierb.studies.storage.files import parquet_files
from lierb.studies.storage.manifest import sealed
from lierb.studies.storage.parts import HISTORY_BYTES, Part, bytes_of_derivatives, part_size
from lierb.studies.storage.store import Store

RATE, STIFFNESS, INERTIA, T = "initial.velocities", "forces.wire.stiffness", "body.inertia", 1.0
BY = ["omega0", "body.inertia", STIFFNESS]


def normal(mean, std) -> dict:
    return {"distribution": "normal", "mean": mean, "std": std}


def tables(spread: float = 0.02, n: int = 256, **integrate) -> dict:
    """Torsion pendulums; `spread` is the relative deviation of rate and stiffness."""
    return {
        "body": {"mass": 2.0, "inertia": [0.1, 0.2, 0.15]},
        "joint": {"type": "revolute", "axis": [0.0, 1.0, 0.0]},
        "problem": {"forces": [{"type": "torsional_spring", "name": "wire", "stiffness": 5.0}]},
        "sample": {
            "n": n, "seed": 1, "method": "sobol",
            "initial": {"velocities": normal([0.5], [0.5 * spread])},
            "body": {"inertia": {
                "distribution": "uniform", "low": [0.1, 0.199, 0.15], "high": [0.11, 0.201, 0.16],
            }},
            "forces": {"wire": {"stiffness": normal(5.0, 5.0 * spread)}},
        },
        "integrate": {"dt": 1e-2, "t_end": T, "sensitivities": BY} | integrate,
        "output": {"part": 64},
    }  # fmt: skip


def closed_form(u, k, inertia, t=T) -> tuple[np.ndarray, list[np.ndarray]]:
    """φ̇ = u cos ωt at the end, and its derivatives by u, k and I."""
    omega = np.sqrt(k / inertia)
    by_omega = -u * t * np.sin(omega * t)
    by_k, by_inertia = omega / (2.0 * k), -omega / (2.0 * inertia)
    return u * np.cos(omega * t), [np.cos(omega * t), by_omega * by_k, by_omega * by_inertia]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return lierb.run(Study.of(tables()), tmp_path_factory.mktemp("hinge") / "out")


def drawn(dataset) -> tuple[np.ndarray, ...]:
    table = dataset.table().to_table()
    each = [as_array(table[f"sample.{name}"]) for name in (RATE, STIFFNESS, INERTIA)]
    return each[0][:, 0], each[1], each[2][:, 1]


# ---- importance factors and percentiles --------------------------------------------------------


def test_importance_factors_are_those_of_the_closed_form(dataset):
    """To 1e-5: RK4 turns ωt by (ω dt)⁴ ωt/120 = 3e-7, and the least slope is cos ωt = 0.28."""
    (theory,) = linear_theories(dataset)
    draws = drawn(dataset)
    rate, slopes = closed_form(*draws)
    deviations = 0.01, 0.1, 0.002 / np.sqrt(12.0)
    parts = np.array([(s.mean() * d) ** 2 for s, d in zip(slopes, deviations, strict=True)])
    expected = dict(zip((RATE, STIFFNESS, INERTIA), parts / parts.sum(), strict=True))
    assert theory.shares == pytest.approx(expected, rel=1e-5)
    assert min(expected.values()) > 0.01  # or the test would miss an input
    off = sum((x - x.mean()) * s.mean() for x, s in zip(draws, slopes, strict=True))
    percentiles = np.quantile(rate.mean() + off, (0.05, 0.5, 0.95), method="inverted_cdf")
    assert theory.linear == pytest.approx(tuple(percentiles), rel=1e-5)
    # The normal law of the linear output: two standard errors of the 5 % quantile of 256, 0.13 std.
    std = np.sqrt(parts.sum())
    law = rate.mean() + std * np.array([-1.6449, 0.0, 1.6449])
    assert np.abs(theory.linear - law).max() < 0.26 * std


def test_linear_theory_holds_for_small_deviations(dataset):
    (theory,) = linear_theories(dataset)
    assert theory.parts_at == ()
    assert remarks([theory]) == []
    assert theory.left_out == {}


def test_show_has_shares_and_both_percentiles(dataset):
    (theory,) = linear_theories(dataset)
    lines = invoke("show", str(dataset.folder)).stdout.splitlines()
    at = lines.index(next(line for line in lines if "linear theory: share of variance" in line))
    shown = "\n".join(lines[at:])
    for name, share in theory.shares.items():
        assert f"{share:.3f} {name}" in shown
    for x, quantile in zip(theory.linear, theory.sampled, strict=True):
        row = next(line for line in lines[at:] if f"{quantile.value:.3g}" in line.split())
        assert f"{x:.3g}" in row.split()
    assert "does not hold" not in shown
    assert all(len(line) <= 80 for line in lines)


@pytest.fixture(scope="module")
def far(tmp_path_factory):
    """Stiffness spread by 30 %: after 5 s the angles ωt span a quarter turn and more."""
    study = Study.of(tables(spread=0.3, t_end=5.0))
    return lierb.run(study, tmp_path_factory.mktemp("far") / "out")


def test_linear_percentiles_part_from_sampled_ones(far):
    (theory,) = linear_theories(far)
    assert 0.95 in theory.parts_at
    outside = [
        q.probability for x, q in zip(theory.linear, theory.sampled, strict=True)
        if not q.low <= x <= q.high
    ]  # fmt: skip
    assert list(theory.parts_at) == outside
    sampled = np.sort(as_array(far.table().to_table()["omega"])[:, 1])
    assert theory.sampled[2].value == sampled[int(np.ceil(0.95 * 256)) - 1]
    shown = " ".join(invoke("show", str(far.folder)).stdout.split())
    (remark,) = remarks([theory])
    assert remark in shown
    assert "linear theory does not hold for omega 2 at" in remark


def test_one_sentence_a_setting_names_where_linear_theory_fails(far):
    """And six outputs of it; the table has all."""
    (theory,) = linear_theories(far)
    rows = [theory._replace(name=f"x {i}", parts_at=(0.05, 0.95)) for i in range(8)]
    other = replace(theory.setting, cspace="reduced")
    first, second = remarks([*rows, theory._replace(setting=other, name="y", parts_at=(0.5,))])
    assert "for x 0 at 5%, 95%; x 1 at 5%, 95%; " in first
    assert "x 5 at 5%, 95%; and 2 more: there the linear percentile is outside" in first
    assert second.startswith(f"{other.label}: linear theory does not hold for y at 50%: there")


def test_equal_draws_of_a_linear_output_do_not_part(tmp_path):
    """φ̇ is proportional to u; with three values a percentile is an end of its interval."""
    changed = tables(n=64)
    rates = {"distribution": "values", "values": [[0.4], [0.5], [0.6]]}
    changed["sample"] = {"n": 64, "initial": {"velocities": rates}}
    (theory,) = linear_theories(lierb.run(Study.of(changed), tmp_path / "out"))
    assert theory.sampled[0].value == theory.sampled[0].high != theory.linear[0]
    assert theory.shares == {RATE: 1.0}
    assert theory.parts_at == ()


def test_quantiles_asked_for_are_those_of_linear_theory(far):
    (theory,) = linear_theories(far, (0.25, 0.75))
    assert [q.probability for q in theory.sampled] == [0.25, 0.75]
    assert len(theory.linear) == 2


@pytest.fixture(scope="module")
def failed(tmp_path_factory):
    """A stiffness of 1e300 N m overflows in the first step, in every body."""
    changed = tables(n=64)
    changed["sample"]["forces"]["wire"]["stiffness"] = normal(1e300, 1e298)
    with pytest.warns(StiffStepWarning), pytest.warns(FailedTrajectoryWarning):
        return lierb.run(Study.of(changed), tmp_path_factory.mktemp("failed") / "out")


def test_a_study_whose_bodies_all_failed_is_shown(failed):
    assert linear_theories(failed) == []
    result = invoke("show", str(failed.folder))
    assert result.exit_code == 0
    assert "64 of 64 trajectories failed (64 non_finite)" in " ".join(result.stdout.split())


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_page_of_failed_bodies_is_written(failed, tmp_path):
    pytest.importorskip("plotly")
    from lierb.studies.pages.report import write_report

    text = write_report(failed, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "non_finite" in text
    assert "Linear theory" not in text


def test_a_setting_that_is_not_begun_has_no_linear_theory(tmp_path):
    """As while a study of several settings runs, or after it was interrupted."""
    dataset = lierb.run(Study.of(tables(n=64, dt=[1e-2, 5e-3])), tmp_path / "out")
    whole = linear_theories(dataset)
    assert [each.setting.dt for each in whole] == [1e-2, 5e-3]
    store = Store(tmp_path / "out")
    store.read()
    for part in [name for name in store.parts if name.startswith("01-")]:
        store.drop([*store.parts.pop(part)])
    store.write(MANIFEST, sealed(store.manifest))
    dataset.read()
    assert linear_theories(dataset) == whole[:1]
    shown = invoke("show", str(tmp_path / "out"))
    assert shown.exit_code == 0
    assert "1 of 2 parts; the rest with" in " ".join(shown.stdout.split())


def test_linear_theory_of_a_saltelli_design_is_of_independent_bodies(tmp_path):
    """Of five bodies a row, A and B."""
    changed = tables(n=5 * 64)
    changed["sample"]["method"] = "saltelli"
    dataset = lierb.run(Study.of(changed), tmp_path / "out")
    (theory,) = linear_theories(dataset)
    rates = as_array(dataset.table().to_table()["omega"])[:, 1]
    own = np.sort(rates[np.arange(5 * 64) % 5 < 2])
    assert theory.sampled == tuple(quantile_of(own, p) for p in (0.05, 0.5, 0.95))
    assert theory.parts_at == ()


@pytest.mark.slow
def test_linear_theory_without_any_derivative_names_the_reasons(tmp_path):
    changed = tables(n=64, sensitivities=["body.inertia"])
    changed["sample"] = {"n": 64, "initial": {"velocities": normal([0.5], [0.1])}}
    (theory,) = linear_theories(lierb.run(Study.of(changed), tmp_path / "out"))
    assert theory.shares == {}
    assert theory.left_out == {RATE: "sensitivities lacks what it changes, twist0"}


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_page_has_linear_theory(far, tmp_path):
    pytest.importorskip("plotly")
    from lierb.studies.pages.report import write_report

    (theory,) = linear_theories(far)
    text = write_report(far, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h2>Linear theory beside the sample</h2>" in text
    assert remarks([theory])[0] in text
    for name, share in theory.shares.items():
        assert f"{share:.3f} {name}" in text


def test_correlated_components_share_one_variance():
    """sᵀ C s: equal slopes cancel at correlation −1, and add at 1."""
    slopes = {"a": np.array([1.0, 1.0]), "b": np.array([2.0])}
    for sign, share in ((-1.0, 0.0), (1.0, 0.5)):
        covariances = {"a": np.array([[1.0, sign], [sign, 1.0]]), "b": np.eye(1)}
        assert _shares(slopes, covariances) == {"a": share, "b": 1.0 - share}


LANDING = """
import lierb

@lierb.event(direction=-1, terminal=True)
def landing(r, params):
    return r[2]

@lierb.observable(unit="m")
def reach(r, params):
    return r[0]

@lierb.states(odometer=(0.0, 0.0), unit={"odometer": "m"})
def distances(r, params):
    return {"odometer": (2.0, 0.0)}
"""


TWO = """
import lierb
import numpy as np

@lierb.observable(unit="rad/s")
def whole(omega):
    return omega[1]

@lierb.observable(unit="rad/s")
def part(omega):
    return lierb.where(omega[1] > 0.0, omega[1], np.nan)
"""


@pytest.mark.slow
def test_an_output_without_a_number_leaves_the_bodies_of_others(tmp_path):
    """Half of the bodies have no `part`; `whole` is of all of them."""
    (tmp_path / "two.py").write_text(TWO)
    changed = tables(n=64, t_end=0.02)
    kinds = [{"type": f"python:two.py:{name}"} for name in ("whole", "part")]
    changed["problem"]["observables"] = kinds
    changed["sample"]["initial"]["velocities"] = normal([0.0], [0.5])
    dataset = lierb.run(Study.of(changed, folder=tmp_path), tmp_path / "out")
    theories = {each.name: each for each in linear_theories(dataset)}
    values = dataset.table().to_table(columns=["whole_final"])["whole_final"].to_numpy()
    (median,) = (q.value for q in theories["whole_final"].sampled if q.probability == 0.5)
    assert median == pytest.approx(np.median(values), abs=0.02)
    assert theories["part_final"].sampled[0].value > 0.0


@pytest.mark.long
def test_end_times_and_observables_have_linear_theory(tmp_path):
    """A throw: t = (w + √(w² + 2gh))/g and reach u t; RK4 is exact, 1e-9 for the event's time."""
    (tmp_path / "throw.py").write_text(LANDING)
    g, h = 9.81, 1.0
    throw = {
        "body": {"solid": "sphere", "radius": 0.1, "mass": 1.0},
        "joint": {"type": "free"},
        "initial": {"place": [0.0, 0.0, h]},
        "problem": {
            "gravity": [0.0, 0.0, -g],
            "events": [{"type": "python:throw.py:landing"}],
            "observables": [{"type": "python:throw.py:reach"}],
            "states": [{"type": "python:throw.py:distances"}],
        },
        "sample": {
            "n": 200, "method": "sobol",
            "initial": {"twist": normal([0.0, 0.0, 0.0, 2.0, 0.0, 3.0], [0, 0, 0, 0.1, 0, 0.2])},
            "problem": {"gravity": normal([0.0, 0.0, -g], [0.0, 0.0, 0.1])},
        },
        "integrate": {"dt": 0.05, "t_end": 3.0, "sensitivities": ["twist0", "gravity"]},
    }  # fmt: skip
    study = Study.of(throw, folder=tmp_path)
    dataset = lierb.run(study, tmp_path / "out")
    reach, largest, mean, odometer, time = linear_theories(dataset)
    named = [(each.name, each.unit) for each in (reach, largest, mean, odometer, time)]
    assert named == [  # the least reach and the other component are constant
        ("reach_final", "m"), ("reach_max", "m"), ("reach_mean", "m"), ("odometer 1", "m"),
        ("t", "s"),
    ]  # fmt: skip
    for each in (largest, mean):  # the reach is u t at the end, and u t/2 in the mean
        assert each.shares == pytest.approx(reach.shares, rel=1e-9)
    assert odometer.shares == pytest.approx(time.shares, rel=1e-12)  # it is 2 t
    table = dataset.table().to_table()
    u, w = as_array(table["sample.initial.twist"])[:, [3, 5]].T
    g = -as_array(table["sample.problem.gravity"])[:, 2]
    root = np.sqrt(w**2 + 2.0 * g * h)
    t, by_w = (w + root) / g, (w + root) / (g * root)
    by_g = h / (g * root) - (w + root) / g**2
    of_twist = ((u * by_w).mean() * 0.2) ** 2 + (t.mean() * 0.1) ** 2
    of_gravity = ((u * by_g).mean() * 0.1) ** 2
    share = of_gravity / (of_gravity + of_twist)
    assert reach.shares["problem.gravity"] == pytest.approx(share, rel=1e-9)
    share = 1.0 / (1.0 + (by_w.mean() * 0.2 / (by_g.mean() * 0.1)) ** 2)
    assert time.shares["problem.gravity"] == pytest.approx(share, rel=1e-9)


# ---- sampled numbers along parameters ----------------------------------------------------------


def test_what_has_no_derivatives_is_left_out(tmp_path):
    """And the shares are of the rest."""
    changed = tables(n=64)
    changed["sample"]["initial"]["coordinates"] = normal([0.1], [0.05])
    changed["sample"]["joint"] = {"axis": normal([0.0, 1.0, 0.0], [0.01, 0.0, 0.0])}
    theory, *_ = rows = linear_theories(lierb.run(Study.of(changed), tmp_path / "out"))
    assert set(theory.shares) == {RATE, STIFFNESS, INERTIA}
    assert sum(theory.shares.values()) == pytest.approx(1.0, rel=1e-12)
    assert {each.parts_at for each in rows} == {()}
    assert remarks(rows) == [
        "linear theory leaves out initial.coordinates: sensitivities lacks what it changes, pose0",
        "linear theory leaves out joint.axis: lierb has no derivative by what it changes",
        "linear percentiles lack what is left out, and are not compared with sampled ones",
    ]
    assert "leaves out initial.coordinates" in invoke("show", str(tmp_path / "out")).stdout


def test_what_is_lacking_has_the_name_of_the_sampled_quantity():
    """A joint's ground_point and parent_point are one point; `sensitivities` takes both names."""
    for link, point in (("upper", "ground_point"), ("lower", "parent_point")):
        changed = DOUBLE | {"sample": {"n": 3, link: {"joint": {point: normal([0.0] * 3, 0.1)}}}}
        study = Study.of(changed)
        draws = study.batch(0, 3).draws
        (name,) = draws
        chain = AlongParameters(study, draws, {name: np.full(3, 0.1)})
        assert chain.along(name) == f"sensitivities lacks what it changes, {name}"
        changed["integrate"] = changed["integrate"] | {"sensitivities": [name]}
        Study.of(changed)


PENDULUM = {
    "body": {"solid": "rod", "length": 0.6, "radius": 0.01, "density": 2700.0},
    "joint": {"type": "screw", "axis": [0.0, 1.0, 0.0], "body_point": [0, 0, 0.3], "pitch": 0.1},
    "problem": {"gravity": [0.0, 0.0, -9.81], "forces": tables()["problem"]["forces"]},
    "sample": {
        "n": 3,
        "initial": {"velocities": normal([0.1], [0.02]), "coordinates": normal([0.3], [0.1])},
        "body": {"radius": normal(0.01, 1e-3)},
        "joint": {
            "body_point": normal([0.0, 0.0, 0.3], [0.01, 0.0, 0.01]), "pitch": normal(0.1, 0.01),
        },
        "forces": {"wire": {"stiffness": normal(0.5, 0.05)}},
    },
    "integrate": {"dt": 1e-2, "t_end": 0.5, "sensitivities": [
        "body.mass", "body.inertia", "joint.body_point", "joint.pitch", "twist0", "pose0",
        STIFFNESS,
    ]},
}  # fmt: skip


def _link(name: str, parent: str, **initial) -> dict:
    joint = {"type": "revolute", "axis": [0.0, 1.0, 0.0], "body_point": [0.0, 0.0, 0.3]}
    joint |= {} if parent == "ground" else {"parent_point": [0.0, 0.0, -0.3]}
    body = {"solid": "rod", "length": 0.6, "radius": 0.01, "density": 2700.0}
    return {"name": name, "parent": parent, "body": body, "joint": joint, "initial": initial}


DOUBLE = {
    "problem": {
        "gravity": [0.0, 0.0, -9.81],
        "links": [_link("upper", "ground", coordinates=0.3), _link("lower", "upper", velocities=1)],
    },
    "sample": {
        "n": 3,
        "upper": {"initial": {"velocities": normal(0.1, 0.1)}},
        "lower": {
            "initial": {"coordinates": normal(0.1, 0.1)},
            "joint": {"body_point": normal([0.0, 0.0, 0.3], [0.01, 0.0, 0.01])},
        },
    },
    "integrate": {"dt": 1e-2, "t_end": 0.5, "sensitivities": [
        "upper.omega0", "lower.omega0", "upper.pose0", "lower.pose0", "lower.joint.body_point",
    ]},
}  # fmt: skip


QUAKE = """import lierb


@lierb.ground_motion(size=0.01)
def quake(t, params):
    return params.size * t * t, 0.0, 0.0
"""


def test_a_moving_ground_has_the_name_of_the_sampled_quantity():
    """Of one link or several, in which it is a force on each."""
    for links in (DOUBLE["problem"]["links"][:1], DOUBLE["problem"]["links"]):
        forces = [
            {"type": "python:quake.py:quake", "name": f"quake{i}", "on": [link["name"]]}
            for i, link in enumerate(links)
        ]
        for name in (*(f"forces.quake{i}.size" for i in range(len(links))), "quake.size"):
            made = {
                "problem": {"links": links, "forces": forces},
                "integrate": {"dt": 1e-2, "t_end": 0.5, "sensitivities": [name]},
            }
            study = Study.of(made, code={"quake.py": QUAKE})
            (parameter,) = parameters_of(study, study.batch(0, 1).problem).values()
            assert parameter.name == "quake.size"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tables", "link"),
    [
        pytest.param(PENDULUM, "", id="one"),
        pytest.param(DOUBLE, "lower.", id="two", marks=pytest.mark.long),
    ],
)
def test_derivatives_by_sampled_numbers_are_differences_of_runs(tables, link):
    """Central differences by 1e-3 std of 0.1: truncated at 1e-8 relative, 1e-7 with curvature."""
    study = Study.of(tables)
    design, (setting,) = study.design, study.settings
    batch, result = Part("", setting, 0, design.n).run(study, design)
    deviations = {n: np.sqrt(q.moments[1].diagonal()) for n, q in design.quantities.items()}
    chain = AlongParameters(study, batch.draws, deviations)
    by = [result.sensitivity(f"{link}twist", name) for name in chain.parameters]
    names = [parameter.name for parameter in parameters_of(study, batch.problem).values()]

    def twists(draws) -> np.ndarray:
        moved = batch_at(study, batch.draws | draws, 0, design.n)
        options = study.options(setting, moved.problem)
        run = integrate_model(  # with derivatives, whose kernel is there
            moved.problem, options, moved.pose0, moved.twist0, with_respect_to=names
        )
        return np.concatenate((run[f"{link}omega"], run[f"{link}v"]), axis=-1)

    for name, deviation in deviations.items():
        found = np.concatenate(by, axis=-1) @ chain.along(name)
        for c, step in enumerate(1e-3 * np.diag(deviation)):
            if step.any():
                own = batch.draws[name]
                up, down = (twists({name: own + s * step.reshape(own.shape[1:])}) for s in (1, -1))
                expected = (up - down) / (2.0 * step[c])
                assert np.abs(expected).max() > 0.01
                error = np.abs(found[..., c] - expected).max()
                assert error < 1e-7 * np.abs(expected).max(), (name, c)


def test_directions_that_joints_do_not_admit_explain_nothing():
    """Two components of a hinge's omega0 are rounding; the upper rate carries both links."""
    run = DOUBLE["integrate"] | {"sensitivities": "upper.omega0"}
    study = Study.of(DOUBLE | {"integrate": run})
    deviations = {n: np.sqrt(q.moments[1].diagonal()) for n, q in study.design.quantities.items()}
    chain = AlongParameters(study, study.batch(0, 3).draws, deviations)
    expected = "sensitivities lacks what it changes, upper.twist0, lower.twist0"
    assert chain.along("upper.initial.velocities") == expected


# ---- the same bytes ----------------------------------------------------------------------------


def derivatives_of(folder) -> dict[str, bytes]:
    return {name: column for name, column in bits(folder).items() if "/" in name}


def test_parts_hold_the_derivatives_of_result(dataset):
    """With their units, in the rows of the summary, as `lierb.integrate` gives them."""
    study = Study.of(tables())
    batch = study.batch(0, 256)
    names = ["omega0", "body.inertia", "torsional_spring.stiffness"]
    result = lierb.integrate(
        batch.problem, twist0=batch.twist0, pose0=batch.pose0, dt=1e-2, t_end=T,
        with_respect_to=names,
    )  # fmt: skip
    table, expected = dataset.table().to_table(), result.sensitivities.summary
    for of in ("pose", "twist", "energy"):
        for name, own in zip(BY, names, strict=True):
            column, field = f"{of}/{name}", expected.schema.field(f"{of}/{own}")
            assert table.schema.field(column).metadata == field.metadata
            assert np.array_equal(as_array(table[column]), as_array(expected[f"{of}/{own}"]))
    assert table.schema.field(f"twist/{STIFFNESS}").metadata[b"per"] == b"N m/rad"


@pytest.mark.slow
def test_values_are_those_without_derivatives(dataset, tmp_path):
    lierb.run(Study.of(tables(sensitivities=[])), tmp_path / "out")
    plain, own = bits(tmp_path / "out"), bits(dataset.folder)
    assert plain == {name: column for name, column in own.items() if "/" not in name}


def test_bits_do_not_depend_on_parts_or_threads(dataset, tmp_path):
    lierb.run(Study.of(tables()), tmp_path / "out", changes={"output.part": 100}, threads=2)
    assert len(derivatives_of(tmp_path / "out")) == 12
    assert bits(tmp_path / "out") == bits(dataset.folder)


def test_a_resumed_run_has_the_same_bytes(dataset, tmp_path, monkeypatch):
    whole, files = hashes(dataset.folder), []

    def dies(*arguments):
        files.append(arguments)
        if len(files) > 2:
            raise OSError("killed")
        return parquet_files(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(running, "parquet_files", dies)
        with pytest.raises(OSError, match="killed"):
            lierb.run(Study.of(tables()), tmp_path / "out")
    assert len(Dataset(tmp_path / "out").table().files) == 2
    lierb.run(Study.of(tables()), tmp_path / "out", resume=True)
    assert hashes(tmp_path / "out") == whole


@pytest.mark.slow
def test_a_killed_run_has_the_same_bytes(tmp_path):
    text = Study.of(tables(n=4_096)).to_toml().replace("part = 64", "part = 256")
    process, out = start(tmp_path, text=text), tmp_path / "out"
    while not (out / "summary").exists() and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL  # it was not done
    lierb.run(tmp_path / "study.toml", out, resume=True)
    lierb.run(tmp_path / "study.toml", tmp_path / "whole")
    assert hashes(out) == hashes(tmp_path / "whole")


@pytest.mark.long
def test_workers_leave_the_same_bytes(dataset, tmp_path):
    pytest.importorskip("distributed")
    with cluster.local_client(2) as client:
        lierb.run(Study.of(tables()), tmp_path / "out", client=client)
    assert hashes(tmp_path / "out") == hashes(dataset.folder)


@pytest.mark.slow
def test_a_replay_has_the_bits_of_the_study(dataset):
    """It records more, and so has another kernel."""
    ends = dataset.replay(17).result.sensitivities.summary
    stored = dataset.table().to_table().slice(17, 1)
    assert stored["trajectory"].to_pylist() == [17]
    names = [name for name in stored.column_names if "/" in name]
    assert len(names) == 12
    for name in names:
        assert ends[name].to_pylist() == stored[name].to_pylist(), name
    ((_, again),) = replay(Study.of(tables()), 17)
    for name in names:
        assert again["summary"][name].to_pylist() == stored[name].to_pylist(), name


def test_batches_have_derivatives(dataset):
    (first, *_) = lierb.integrate_batches(Study.of(tables()))
    stored = dataset.table().to_table()
    for name in stored.column_names:
        assert first[name].to_pylist() == stored[name].slice(0, 64).to_pylist()


def test_progress_ends_at_the_work_of_the_study(tmp_path):
    """Ten directions are four runs, which the work counts once."""
    seen: list[tuple[int, int]] = []
    study = Study.of(tables(n=64))
    lierb.run(study, tmp_path / "out", progress=lambda done, total: seen.append((done, total)))
    done, totals = zip(*seen, strict=True)
    assert set(totals) == {64 * 100}
    assert list(done) == sorted(done)
    assert done[-1] == 64 * 100


def test_a_study_made_in_python_names_its_inputs():
    wire = lierb.forces.torsional_spring(stiffness=5.0)
    body = lierb.Body(2.0, (0.1, 0.2, 0.15))
    hinge = lierb.Problem(body, lierb.joints.revolute(axis=(0.0, 1.0, 0.0)), forces=wire)
    design = lierb.sampling.Design({"body.mass": lierb.sampling.Uniform(1.0, 2.0)}, n=4)
    by = ["body.mass", "forces.torsional_spring.stiffness"]
    study = lierb.study_of(hinge, design, dt=1e-2, t_end=1.0, sensitivities=by)
    assert study.integrate.sensitivities == by
    assert Study.of(study.model_dump()) == study


def test_warmup_compiles_the_kernels_of_derivatives(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "lierb.studies.execution.replaying.integrate_model",
        lambda *_, with_respect_to, **__: asked.append(with_respect_to),
    )
    compile_for(Study.of(tables()))
    assert asked == [["omega0", "body.inertia", "torsional_spring.stiffness"]]


# ---- checks before a run -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("integrate", "told"),
    [
        ({"sensitivities": ["omega"]}, "sensitivities='omega' is unknown; choose from twist0"),
        ({"sensitivities": ["problem.gravity", "omega"]}, "sensitivities='omega' is unknown"),
        ({"sensitivities": ["forces.wire.stiff"]}, "Did you mean 'forces.wire.stiffness'?"),
        ({"sensitivities": ["initial.velocities"]}, "'initial.velocities' is unknown"),
        ({"sensitivities": ["omega0", "omega0"]}, "sensitivities names omega0 twice"),
        (
            {"sensitivities": "body.com", "cspace": "SO3xR3"},
            'body.com cannot change on cspace="SO3xR3"',
        ),
    ],
)  # fmt: skip
def test_study_refuses_inputs_without_derivatives(integrate, told):
    with pytest.raises(StudyError, match=r"^study: integrate\.sensitivities: ") as caught:
        Study.of(tables(**integrate))
    assert told in str(caught.value)


def test_error_names_the_line(tmp_path):
    text = Study.of(tables()).to_toml().replace('"omega0"', '"omega"')
    (tmp_path / "hinge.toml").write_text(text)
    line = next(i for i, each in enumerate(text.splitlines(), 1) if "sensitivities" in each)
    result = invoke("run", str(tmp_path / "hinge.toml"), "--out", str(tmp_path / "out"))
    assert result.exit_code == 1
    assert f"hinge.toml:{line}: integrate.sensitivities" in result.stderr
    assert not (tmp_path / "out").exists()


def test_times_of_jumps_are_refused(tmp_path):
    code = """
import lierb

@lierb.wrench(on=0.5, discontinuities="on")
def push(t, R, r, omega, v, params):
    return (0.0, lierb.where(t < params.on, 1.0, 0.0), 0.0), (0.0, 0.0, 0.0)
"""
    (tmp_path / "push.py").write_text(code)
    changed = tables(sensitivities=["forces.push.on"])
    changed["problem"]["forces"].append({"type": "python:push.py:push"})
    with pytest.raises(StudyError, match=r"push\.on.* determines times at which push jumps"):
        Study.of(changed, folder=tmp_path)


def test_forces_that_switch_are_foreseen():
    changed = tables()
    limit = {"type": "joint_limit", "lower": -1.0, "upper": 1.0, "stiffness": 10.0, "damping": 1.0}
    changed["problem"]["forces"].append(limit)
    ((category, messages),) = foreseen(Study.of(changed)).items()
    assert category is DerivativeWarning
    assert messages[0].startswith("joint_limit: switches")
    changed["integrate"]["sensitivities"] = []
    assert foreseen(Study.of(changed)) == {}


def test_parts_are_smaller_for_derivatives(monkeypatch):
    """Three copies in memory of 14 numbers by 10, at 101 saved times and the end, where a turn and
    its rate are 3 more.
    """
    many = tables(n=10**6) | {"output": {"part": 10**6}}
    study = Study.of(many)
    assert bytes_of_derivatives(study) == 3 * 8 * (14 + 3) * 10
    assert part_size(study) == int(HISTORY_BYTES / (3 * 8 * (14 + 3) * 10))
    many["integrate"]["save_every"] = 1
    saved = Study.of(many)
    assert bytes_of_derivatives(saved) == 3 * 8 * (102 * 14 + 3) * 10
    assert part_size(saved) < HISTORY_BYTES / bytes_of_derivatives(saved)
    many["integrate"]["sensitivities"] = []
    assert bytes_of_derivatives(Study.of(many)) == 0


def test_digest_changes_with_the_inputs():
    plain, one, two = (
        Study.of(tables(sensitivities=by)).digest() for by in ([], "omega0", ["body.mass"])
    )
    assert len({plain, one, two}) == 3
    without = tables()
    del without["integrate"]["sensitivities"]
    assert Study.of(without).digest() == plain

"""Section 5 of the paper, run as `lierb paper` runs it."""

import json
import os
import xml.etree.ElementTree as ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest
from cases import integrate

import lierb
from lierb.analysis.paper import DTS, run_paper
from lierb.analysis.paper_examples import AS_STATED, CSPACES, EXAMPLES, INERTIA, MASS, P, examples

imread = pytest.importorskip("matplotlib.image").imread

KEYS = [example.key for example in EXAMPLES]
pytestmark = pytest.mark.usefixtures("papers_kernels")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("paper") / "not" / "there" / "yet"


@pytest.fixture(scope="module")
def report(folder, papers_kernels):
    return run_paper(folder)


@pytest.fixture(scope="module")
def printed(papers_kernels):
    return run_paper(as_printed=True)


def finding(report, key, cspace, quantity):
    return next(
        f
        for f in report.findings
        if (f.example.key, f.cspace, f.quantity) == (key, cspace, quantity)
    )


# ---------------------------------------------------------------- what it finds


@pytest.mark.slow
def test_every_claim_of_the_paper_is_confirmed(report):
    differing = [f for f in report.findings if f.agrees is False]
    assert not differing
    assert sum(f.agrees is True for f in report.findings) == 27
    assert not report.warnings


@pytest.mark.long
def test_se3_keeps_the_lower_pairs_with_global_updates_and_gravity(monkeypatch):
    pairs = [e for e in EXAMPLES if e.key in ("spherical", "revolute", "cylindrical", "planar")]
    monkeypatch.setattr(lierb.analysis.paper_examples, "EXAMPLES", pairs)
    monkeypatch.setattr(lierb.analysis.paper, "CSPACES", ["SE3"])
    report = run_paper(update="global", gravity=9.81, dts=(1e-2,))
    kept = [f.verdict for f in report.findings]
    assert kept == ["exact"] * 7  # spherical has one error; the others two


# Largest errors over 10 s (RK4, no gravity, local update; dt = 1e-2, 1e-3, 1e-4) of an independent
# implementation, given to two digits. What is left out is at rounding and tested below.
REFERENCE = [
    ("spherical", "SO3xR3", "position", (3.5e-5, 3.5e-9)),
    ("revolute", "SO3xR3", "position", (5.1e-8, 5.1e-12)),
    ("cylindrical", "SO3xR3", "position", (5.1e-8, 5.1e-12)),
    ("hook_R32", "SO3xR3", "position", (2.9e-5, 2.9e-9)),
    ("hook_R32", "SO3xR3", "rotation", (1.1e-5, 1.3e-9)),
    ("hook_R32", "SE3", "rotation", (1.1e-5, 1.3e-9)),
    ("hook_R23", "SO3xR3", "position", (3.4e-9,)),
    ("hook_R23", "SO3xR3", "rotation", (9.9e-9,)),
    ("hook_R23", "SE3", "rotation", (9.9e-9,)),
    ("pin_in_slot", "SE3", "position", (4.0e-6, 4.1e-10)),
    ("pin_in_slot", "SO3xR3", "position", (4.3e-6, 4.3e-10)),
    ("pin_in_slot_p0", "SE3", "position", (1.3e-6, 1.3e-10)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("key", "cspace", "quantity", "expected"), REFERENCE)
def test_errors_are_those_of_an_independent_implementation(report, key, cspace, quantity, expected):
    errors = finding(report, key, cspace, quantity).errors[: len(expected)]
    assert errors == pytest.approx(expected, rel=0.05)  # two digits; 1.05 may be printed as 1.1


AT_ROUNDING = [
    ("spherical", "SE3", "position"),
    ("revolute", "SE3", "position"),
    ("cylindrical", "SE3", "position"),
    ("planar", "SE3", "position"),
    ("planar", "SO3xR3", "position"),
    ("hook_R32", "SE3", "position"),
    ("hook_R23", "SE3", "position"),
    ("pin_in_slot_p0", "SO3xR3", "position"),
    *(
        (key, cspace, "rotation")
        for key in ("revolute", "cylindrical", "planar", "pin_in_slot", "pin_in_slot_p0")
        for cspace in CSPACES
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("key", "cspace", "quantity"), AT_ROUNDING)
def test_exact_means_rounding(report, key, cspace, quantity):
    # Rounding adds up over 1e3, 1e4 and 1e5 steps; bodies stay within 10 m (cylindrical).
    bounds = (2e-13, 2e-13, 2e-12)
    assert np.all(np.less_equal(finding(report, key, cspace, quantity).errors, bounds))


@pytest.mark.slow
def test_as_printed_planar_joint_is_no_subgroup(printed):
    for cspace in CSPACES:
        found = finding(printed, "planar", cspace, "position")
        expected = {"SE3": (1.2e-4, 1.3e-8), "SO3xR3": (1.4e-4, 1.4e-8)}[cspace]
        assert found.errors[:2] == pytest.approx(expected, rel=0.05)  # known to two digits
        assert found.verdict == "order 4"
        assert found.agrees is False


@pytest.mark.slow
def test_as_printed_pin_in_slot_never_meets_its_constraints(printed):
    for cspace in CSPACES:
        found = finding(printed, "pin_in_slot", cspace, "rotation")
        assert found.verdict == "violated"
        assert found.errors == pytest.approx([0.45] * 3, abs=0.01)  # the axis tilts
    assert [warning.split(":")[0] for warning in printed.warnings] == [
        "pin-in-slot",
        "pin-in-slot, p = 0",
    ]


# ---------------------------------------------------------------- the examples as data


def test_examples_have_unique_keys():
    assert len(set(KEYS)) == len(KEYS)


def test_examples_say_how_they_were_read():
    for as_printed in (False, True):
        for example in examples(as_printed):
            assert (example.reading == AS_STATED) == (example.note == ""), example.key


def test_examples_are_read_twice_only_where_the_paper_errs():
    pairs = zip(examples(), examples(as_printed=True))
    differing = [default.key for default, printed in pairs if default.reading != printed.reading]
    assert differing == ["planar", "pin_in_slot", "pin_in_slot_p0"]


def test_inertia_is_that_of_the_box_to_seven_decimals():
    a, b, c = (0.3**2, 0.15**2, 0.05**2)
    box = 6.075 / 12 * np.array([b + c, a + c, a + b])
    assert pytest.approx(box, abs=5.001e-8) == INERTIA


@pytest.mark.slow
@pytest.mark.parametrize("as_printed", [False, True])
@pytest.mark.parametrize("number", range(len(KEYS)), ids=KEYS)
def test_example_starts_as_the_paper_says(number, as_printed):
    """C₀ = (I, −p), v₀ = p × ω₀ + the velocity of the joint's point."""
    example = examples(as_printed)[number]
    joint = example.joint()
    twist0 = joint.twist(omega=example.omega0, point_velocity=example.point_velocity)
    p = np.zeros(3) if example.key == "pin_in_slot_p0" else np.array(P)
    assert twist0[:3] == pytest.approx(example.omega0, abs=1e-15)
    v0 = np.cross(p, example.omega0) + example.point_velocity
    assert twist0[3:] == pytest.approx(v0, abs=1e-15)

    body = lierb.Body(mass=MASS, inertia=INERTIA)
    problem = lierb.Problem(body, joint)
    run = integrate(problem, twist0=twist0, dt=1e-2, t_end=1e-2, check="off")
    start = run.history.slice(0, 1)
    assert start["rotation"].to_pylist()[0] == pytest.approx(np.eye(3).ravel(), abs=1e-15)
    assert start["position"].to_pylist()[0] == pytest.approx(-p, abs=1e-15)


# ---------------------------------------------------------------- tables


@pytest.mark.slow
def test_summary_has_a_row_for_each_run(report):
    rows = report.summary.select(["example", "cspace", "dt"]).to_pylist()
    assert [tuple(row.values()) for row in rows] == [
        (key, cspace, dt) for key in KEYS for cspace in CSPACES for dt in DTS
    ]
    assert set(report.summary["status"].to_pylist()) == {"ok"}


@pytest.mark.slow
def test_errors_hold_about_a_thousand_rows_for_each_run(report):
    assert report.history.num_rows == len(KEYS) * len(CSPACES) * len(DTS) * 1001
    t = report.history["t"].to_numpy().reshape(-1, 1001)
    assert np.all(t[:, 0] == 0.0)
    assert t[:, -1] == pytest.approx(10.0, abs=1e-12)


@pytest.mark.slow
def test_tables_keep_units_and_provenance(report):
    for table in (report.summary, report.history):
        assert table.schema.field("dt").metadata == {b"unit": b"s"}
        assert table.schema.field("t").metadata[b"unit"] == b"s"
        provenance = json.loads(table.schema.metadata[b"lierb"])
        assert provenance["cpu"]
        runs = [(r["options"]["cspace"], r["options"]["dt"]) for r in provenance["runs"]]
        assert runs == [(cspace, dt) for _ in KEYS for cspace in CSPACES for dt in DTS]


@pytest.mark.slow
def test_label_columns_are_dictionaries(report):
    for table in (report.summary, report.history):
        for name in ("example", "reading", "cspace"):
            assert str(table.schema.field(name).type).startswith("dictionary")


# ---------------------------------------------------------------- files


@pytest.mark.slow
def test_parquet_files_hold_the_tables(report, folder):
    for name, table in (("summary", report.summary), ("history", report.history)):
        stored = pq.read_table(folder / f"{name}.parquet")
        # Not `equals`: pyarrow 18 reads a dictionary's indices back as another type.
        assert stored.to_pydict() == table.to_pydict()
        assert stored.schema.metadata == table.schema.metadata
        for field in table.schema:
            assert (stored.schema.field(field.name).metadata or {}).items() >= (
                field.metadata or {}
            ).items()


@pytest.mark.slow
def test_each_figure_of_the_paper_is_drawn(report, folder):
    stems = [
        f"figure_{figure.number}_{example.key}_{figure.quantity}"
        for example in EXAMPLES
        for figure in example.figures
    ]
    assert {stem.split("_")[1] for stem in stems} == set("23567")  # 1 and 4 show the joints
    for stem in stems:
        image = imread(folder / f"{stem}.png")
        assert np.mean(np.any(image[..., :3] < 0.9, axis=2)) > 0.02
        root = ElementTree.parse(folder / f"{stem}.svg").getroot()
        assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 6


@pytest.mark.slow
def test_files_are_exactly_those_reported(report, folder):
    assert sorted(folder.iterdir()) == sorted(report.files)


@pytest.mark.slow
def test_nothing_is_written_without_a_folder(printed):
    assert printed.files == ()


@pytest.mark.slow
def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    (tmp_path / "summary.parquet").write_text("old")

    def interrupted(file):
        assert os.fstat(file).st_size > 0
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)  # when the content is written
    with pytest.raises(KeyboardInterrupt):
        run_paper(tmp_path, dts=(1e-2,), t_end=0.1, figures=False)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.parquet"]
    assert (tmp_path / "summary.parquet").read_text() == "old"


@pytest.mark.slow
def test_progress_counts_up_to_the_total(tmp_path, monkeypatch):
    monkeypatch.setattr(lierb.analysis.paper, "_draw", lambda *args: [])  # drawing takes seconds
    calls = []

    def note(done, total, what):
        calls.append((done, total))

    run_paper(tmp_path, dts=(1e-2,), t_end=0.1, progress=note)
    total = len(KEYS) * len(CSPACES) + sum(len(example.figures) for example in EXAMPLES)
    assert calls == [(done, total) for done in range(total + 1)]

"""Section 5 of Müller's paper: its examples as data, and the run that reproduces its results.

A. Müller, "A note on the motion representation and configuration update in time stepping schemes
for the constrained rigid body", BIT Numerical Mathematics 56 (2016), 995-1015.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from lierb.analysis.convergence import Order, observed_order, verdict
from lierb.api import integrate
from lierb.kernels.mechanics.scale import length_of
from lierb.model.bodies.body import Body
from lierb.model.joints import catalogue as joints
from lierb.model.problem import Problem
from lierb.results.columns import numbers, repeated
from lierb.support import extras

if TYPE_CHECKING:
    from lierb.model.joints.joint import Joint

Vector = tuple[float, float, float]
Progress = Callable[[int, int, str], object]

MASS = 6.075  # kg: an aluminium box of 0.3 × 0.15 × 0.05 m
INERTIA = (0.0126563, 0.0468281, 0.0569531)  # kg m², about the centre of mass
P = (-0.15, 0.0375, 0.0)  # m: the joint's point on the body
E1, E2, E3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

METHOD = "RK4"
CSPACES = ("SO3xR3", "SE3")  # left and right in the paper's figures
DTS = (1e-2, 1e-3, 1e-4)  # s
T_END = 10.0  # s
ROWS_PER_HISTORY = 1000

AS_STATED = "as stated"  # the reading of an example that needs no interpretation


# ---------------------------------------------------------------- the examples, as data


@dataclass(frozen=True)
class Claim:
    """What the paper says of the errors in one c-space: "exact", "order 4", or None (nothing)."""

    position: str | None
    rotation: str | None = None


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper: its number there, and the error that it shows."""

    number: int
    quantity: str


@dataclass(frozen=True, eq=False)
class Example:
    """One example of section 5: a joint, how the body starts, and what the paper says of it."""

    key: str
    title: str
    joint: Callable[[], Joint]
    omega0: Vector  # rad/s, body frame
    claims: Mapping[str, Claim]  # by c-space
    point_velocity: Vector = (0.0, 0.0, 0.0)  # m/s, of the joint's point, ground frame
    figures: tuple[PaperFigure, ...] = ()
    reading: str = AS_STATED  # or "corrected", "as printed", "text", "formula"
    note: str = ""  # what was read differently, or is ours
    check: str = "raise"  # as `integrate` takes it

    @property
    def quantities(self) -> tuple[str, ...]:
        """The errors that this joint has."""
        return self.joint().error_kinds


def _hook_r23() -> Joint:
    """Universal joint with R23 = 0: first axis IFR 2, second axis RFR 3 (erratum E11)."""
    frame = np.eye(4)
    frame[:3, :3] = np.column_stack([(-1.0, 0.0, 0.0), E3, E2])  # e₂ = RFR 3, e₃ = IFR 2
    on_body = frame.copy()
    on_body[:3, 3] = P
    return joints.universal(ground_frame=frame, body_frame=on_body)


_SUBGROUP_OF_SE3 = {"SE3": Claim("exact", "exact"), "SO3xR3": Claim("order 4", "exact")}
_HOOK = {"SE3": Claim("exact", "order 4"), "SO3xR3": Claim("order 4", "order 4")}

# Erratum E9: revolute, cylindrical, planar and pin-in-slot print R12 = R23 = 0, which loses rank
# at 90°. The acceleration constraints printed with it, ω₁ = ω₃ = 0, are right and are what is
# integrated here; the rotation error is (R12, R32).
EXAMPLES = (
    Example(
        key="spherical",
        title="spherical",
        joint=partial(joints.spherical, body_point=P),
        omega0=(2 * pi, pi, 0.2 * pi),
        claims={"SE3": Claim("exact"), "SO3xR3": Claim("order 4")},
        figures=(PaperFigure(2, "position"),),
    ),
    Example(
        key="revolute",
        title="revolute",
        joint=partial(joints.revolute, body_point=P, axis=E2),
        omega0=(0.0, 2 * pi, 0.0),
        claims=_SUBGROUP_OF_SE3,
        figures=(PaperFigure(3, "position"),),
    ),
    Example(
        key="cylindrical",
        title="cylindrical",
        joint=partial(joints.cylindrical, body_point=P, axis=E2),
        omega0=(0.0, 2 * pi, 0.0),
        point_velocity=E2,
        claims=_SUBGROUP_OF_SE3,
        figures=(PaperFigure(3, "position"),),  # "the same as in figure 3"
    ),
    Example(
        key="planar",
        title="planar",
        joint=partial(joints.planar, body_point=P, axis=E2),
        omega0=(0.0, 2 * pi, 0.0),
        point_velocity=(1.0, 0.0, 0.5),
        claims=dict.fromkeys(CSPACES, Claim("exact", "exact")),
        reading="corrected",  # erratum E10
        note="the plane is normal to the axis of rotation, axis 2 (printed: the 1-2-plane); "
        "the paper gives no velocity, point_velocity = (1, 0, 0.5) m/s is ours",
    ),
    Example(
        key="hook_R32",
        title="hook R32",
        joint=partial(joints.universal, body_point=P, axis=E3, second_axis=E2),
        omega0=(0.0, pi, 0.2 * pi),
        claims=_HOOK,
        figures=(PaperFigure(5, "rotation"), PaperFigure(6, "position")),
        reading="text",
        note="as the paper's text has it, IFR axis 3 normal to RFR axis 2: R32 = 0",
    ),
    Example(
        key="hook_R23",
        title="hook R23",
        joint=_hook_r23,
        omega0=(0.0, pi, 0.2 * pi),
        claims=_HOOK,
        figures=(PaperFigure(5, "rotation"), PaperFigure(6, "position")),
        reading="formula",
        note="as the paper's formula has it, R23 = 0: IFR axis 2 normal to RFR axis 3",
    ),
    Example(
        key="pin_in_slot",
        title="pin-in-slot",
        joint=partial(joints.pin_in_slot, body_point=P, axis=E2, slot=E1),
        omega0=(0.0, pi, 0.0),
        point_velocity=E1,
        claims=dict.fromkeys(CSPACES, Claim("order 4")),
        figures=(PaperFigure(7, "position"),),
        reading="corrected",  # erratum E12
        note="omega0 = (0, pi, 0) rad/s; the printed (0, pi, 0.2 pi) violates the joint",
    ),
    Example(
        key="pin_in_slot_p0",
        title="pin-in-slot, p = 0",
        joint=partial(joints.pin_in_slot, axis=E2, slot=E1),
        omega0=(0.0, pi, 0.0),
        point_velocity=E1,
        claims={"SE3": Claim("order 4"), "SO3xR3": Claim("exact", "exact")},
        reading="corrected",  # erratum E12
        note="the joint at the centre of mass: described by the paper, without a figure; "
        "omega0 = (0, pi, 0) rad/s",
    ),
)

_PRINTED_PIN: dict[str, Any] = {
    "omega0": (0.0, pi, 0.2 * pi),
    "reading": "as printed",
    "note": "omega0 = (0, pi, 0.2 pi) rad/s violates the joint",
    "check": "warn",
}

# What --as-printed changes: example → other values of its fields.
_AS_PRINTED: Mapping[str, Mapping[str, Any]] = {
    "planar": {
        "joint": partial(joints.from_rows, ["d3", "Omega1", "Omega3"], body_point=P),
        "point_velocity": (1.0, 0.5, 0.0),
        "reading": "as printed",
        "note": "moves in the 1-2-plane and turns about axis 2: not a subgroup; "
        "the paper gives no velocity, point_velocity = (1, 0.5, 0) m/s is ours",
    },
    "pin_in_slot": _PRINTED_PIN,
    "pin_in_slot_p0": _PRINTED_PIN,
}


def examples(as_printed: bool = False) -> tuple[Example, ...]:
    """The examples of section 5, with its mistakes corrected or as they are printed."""
    if not as_printed:
        return EXAMPLES
    return tuple(replace(example, **_AS_PRINTED.get(example.key, {})) for example in EXAMPLES)


# ---------------------------------------------------------------- what a run gives


@dataclass(frozen=True)
class Finding:
    """How one error of one example behaves in one c-space, against the paper's claim."""

    example: Example
    cspace: str
    quantity: str
    dts: tuple[float, ...]
    errors: tuple[float, ...]  # maxima over the run, one for each step size
    order: Order | None

    @property
    def verdict(self) -> str:
        return verdict(self.errors, self.order)

    @property
    def claim(self) -> str | None:
        claim: str | None = getattr(self.example.claims[self.cspace], self.quantity)
        return claim

    @property
    def agrees(self) -> bool | None:
        """None where the paper claims nothing."""
        return None if self.claim is None else self.claim == self.verdict


@dataclass(frozen=True)
class PaperReport:
    """All that `run_paper` found.

    setting : method, update and gravity, in words.
    summary : one row per run (example × c-space × step size).   history : their histories.
    findings : one per example, c-space and error.   warnings : what `integrate` warned of.
    files : what was written.
    """

    setting: str
    summary: pa.Table
    history: pa.Table
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...]
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class _Run:
    example: Example
    cspace: str
    dt: float
    summary: pa.Table
    history: pa.Table
    sizes: Mapping[str, float]  # by quantity, what its errors are errors of


# ---------------------------------------------------------------- the run


def run_paper(
    out: str | os.PathLike[str] | None = None,
    *,
    gravity: float = 0.0,
    update: str = "local",
    as_printed: bool = False,
    dts: Sequence[float] = DTS,
    t_end: float = T_END,
    figures: bool = True,
    progress: Progress | None = None,
) -> PaperReport:
    """Run every example of section 5 in both c-spaces with every step size.

    out : folder for `summary.parquet`, `history.parquet` and the figures; None writes nothing.
    gravity : m/s², along −e₃ of the ground (the paper never mentions gravity: 0).
    update : "local" or "global".   as_printed : keep the paper's mistakes.
    dts : s, each a divisor of t_end.   t_end : s.   figures : draw them too.
    progress : called as progress(done, total, what comes next).

    Raises
    ------
    lierb.support.extras.MissingExtraError
        when figures are asked for and Matplotlib is not installed.

    Example
    -------
    >>> from lierb.analysis.paper import run_paper
    >>> report = run_paper(dts=(1e-2,), t_end=0.1)
    >>> report.summary.num_rows
    16
    """
    chosen = examples(as_printed)
    plan = list(product(chosen, CSPACES, dts))
    drawings: list[tuple[Example, PaperFigure]] = []
    if out is not None:
        # Both before the runs: what cannot work costs no waiting.
        Path(out).mkdir(parents=True, exist_ok=True)
        if figures:
            extras.require("plot")
            drawings = [(example, figure) for example in chosen for figure in example.figures]
    total = len(plan) + len(drawings)

    def announce(done: int, what: str) -> None:
        if progress is not None:
            progress(done, total, what)

    runs = []
    warned: dict[str, None] = {}  # an ordered set
    for done, (example, cspace, dt) in enumerate(plan):
        announce(done, f"{example.title}: {cspace}, dt = {dt:g} s")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            runs.append(_run(example, cspace, dt, t_end, gravity, update))
        for warning in caught:
            # What follows the semicolon is a remedy for those who call `integrate` themselves.
            warned.setdefault(f"{example.title}: {str(warning.message).partition(';')[0]}")
    gravity_text = f"gravity {gravity:g} m/s² along -e3" if gravity else "no gravity"
    report = PaperReport(
        setting=f"{METHOD}, {update} update, {gravity_text}",
        summary=_concatenate([_labelled(run.summary, run) for run in runs]),
        history=_concatenate([_labelled(run.history, run) for run in runs]),
        findings=tuple(_findings(runs, chosen)),
        warnings=tuple(warned),
    )
    files = []
    if out is not None:
        files += _write_tables(report, Path(out))
        for done, (example, figure) in enumerate(drawings, start=len(plan)):
            announce(done, f"figure {figure.number}: {example.title}")
            files += _draw(report, example, figure, Path(out))
    announce(total, "done")
    return replace(report, files=tuple(files))


def _run(
    example: Example, cspace: str, dt: float, t_end: float, gravity: float, update: str
) -> _Run:
    joint = example.joint()
    problem = Problem(Body(mass=MASS, inertia=INERTIA), joint, gravity=(0.0, 0.0, -gravity))
    result = integrate(
        problem,
        twist0=joint.twist(omega=example.omega0, point_velocity=example.point_velocity),
        dt=dt,
        t_end=t_end,
        method=METHOD,
        cspace=cspace,
        update=update,
        save_every=max(1, round(t_end / dt / ROWS_PER_HISTORY)),
        record=("state",),
        check=example.check,
        solver="saddle",  # what the paper does
    )
    assert result.history is not None  # save_every was given
    places = result.history["position"].combine_chunks().flatten().to_numpy()
    size = float(length_of(problem.parameters()) + np.abs(places).max())
    # The states serve for that size only; without them the files are small.
    history = result.history.drop_columns(["rotation", "position", "omega", "v"])
    return _Run(example, cspace, dt, result.summary, history, {"position": size, "rotation": 1.0})


def _findings(runs: Sequence[_Run], chosen: Sequence[Example]) -> Iterator[Finding]:
    for example, cspace in product(chosen, CSPACES):
        own = [run for run in runs if run.example is example and run.cspace == cspace]
        dts = tuple(run.dt for run in own)
        for quantity in example.quantities:
            errors = tuple(_largest_error(run.summary, quantity) for run in own)
            order = observed_order(dts, errors, [run.sizes[quantity] for run in own])
            yield Finding(example, cspace, quantity, dts, errors, order)


def _largest_error(summary: pa.Table, quantity: str) -> float:
    """Maximum over the run; NaN when the integration broke down, whatever it was before."""
    if summary["status"][0].as_py() != "ok":
        return float("nan")
    return float(summary[f"{quantity}_error_max"][0].as_py())


# ---------------------------------------------------------------- tables and files


def _labelled(table: pa.Table, run: _Run) -> pa.Table:
    """`table` with columns in front that say which run it is."""
    rows = table.num_rows
    labels = {"example": run.example.key, "reading": run.example.reading, "cspace": run.cspace}
    for place, (name, value) in enumerate(labels.items()):
        table = table.add_column(place, name, repeated(value, rows))
    dt_field = pa.field("dt", pa.float64(), metadata={"unit": "s"})
    return table.add_column(len(labels), dt_field, numbers(np.full(rows, run.dt)))


def _concatenate(tables: Sequence[pa.Table]) -> pa.Table:
    """The runs below each other; what differs in their provenance becomes the list "runs"."""
    provenance = [json.loads(table.schema.metadata[b"lierb"]) for table in tables]
    shared = {
        key: value
        for key, value in provenance[0].items()
        if all(entries[key] == value for entries in provenance)
    }
    own = [{k: v for k, v in entries.items() if k not in shared} for entries in provenance]
    joined = pa.concat_tables([table.replace_schema_metadata(None) for table in tables])
    joined = joined.unify_dictionaries().combine_chunks()
    return joined.replace_schema_metadata({"lierb": json.dumps({**shared, "runs": own})})


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A name to write to; `path` appears, whole, when the block ends well."""
    partial_path = path.with_name(f".{path.name}.partial")
    try:
        yield partial_path
        partial_path.replace(path)
    finally:
        partial_path.unlink(missing_ok=True)


def _write_tables(report: PaperReport, folder: Path) -> list[Path]:
    tables = {
        folder / "summary.parquet": report.summary,
        folder / "history.parquet": report.history,
    }
    for path, table in tables.items():
        with _replacing(path) as partial_path:
            pq.write_table(table, partial_path, compression="zstd")
    return list(tables)


def _draw(report: PaperReport, example: Example, figure: PaperFigure, folder: Path) -> list[Path]:
    from lierb.results import plots  # Matplotlib takes most of a second to import

    history, summary = (
        table.filter(pc.equal(table["example"], example.key))
        for table in (report.history, report.summary)
    )
    name = example.title[0].upper() + example.title[1:]
    drawing = plots.error_figure(
        history,
        summary,
        quantity=figure.quantity,
        title=f"{name} joint: {figure.quantity} error (figure {figure.number} of the paper)",
        subtitle=f"{report.setting}; reading: {example.reading}",
    )
    files = []
    for kind in ("png", "svg"):
        path = folder / f"figure_{figure.number}_{example.key}_{figure.quantity}.{kind}"
        with _replacing(path) as partial_path:
            plots.save(drawing, partial_path, kind)
        files.append(path)
    return files

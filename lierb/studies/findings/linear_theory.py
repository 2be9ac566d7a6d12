"""Linear theory of a study with derivatives: importance factors, percentiles beside sampled ones.

The slope ∂g/∂x of an output g by a sampled number x is its mean over the trajectories. For a normal
x this is the slope of the best linear fit (Stein's lemma), and it needs no run at the mean point.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from math import prod
from typing import NamedTuple

import numpy as np

from lierb.kernels.systems.observables import DIFFERENTIATED
from lierb.results.columns import unit_of
from lierb.results.sensitivities import SEPARATOR
from lierb.studies.description.quantiles import (
    CONFIDENCE,
    PROBABILITIES,
    Quantile,
    percent,
    quantiles_of,
)
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.description.study_tables import NOTHING
from lierb.studies.findings.along_parameters import AlongParameters
from lierb.studies.findings.columns import ok_columns, some_rows
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

MOST_BODIES = 500  # bodies, at random, over which slopes are means
ROUNDING = 1e-6  # standard deviations; intervals of equal draws have no width
MOST_NAMED = 6  # outputs of a setting that a sentence names
CONSTANT = 1e-12  # range of an output that counts as rounding, relative to its largest number


class LinearTheory(NamedTuple):
    """Linear theory of an output, beside the sample, in one setting.

    shares : importance factors, the share of the linear variance of each sampled quantity, of a
        vector with all its components; without those in `left_out`.
    linear : percentiles of the linear output over the draws of all bodies.
    sampled : percentiles of the output over the same bodies.
    parts_at : probabilities at which sampling error does not explain the difference of the two: the
        linear percentile is outside the confidence interval of the sampled one. Empty if quantities
        are left out, whose share in the sampled percentiles is unknown.
    left_out : reason for each sampled quantity without derivatives.
    """

    setting: Setting
    name: str
    unit: str
    shares: dict[str, float]
    linear: tuple[float, ...]
    sampled: tuple[Quantile, ...]
    parts_at: tuple[float, ...]
    left_out: dict[str, str]


class _Output(NamedTuple):
    """Output of a study with derivatives.

    column, item : column of the summary, and component.
    of, part, width : quantity of the derivatives, component, and number of components.
    """

    name: str
    column: str
    item: int
    of: str
    part: int = 0
    width: int = 1


def linear_theories(
    dataset: Results, probabilities: Sequence[float] = PROBABILITIES
) -> list[LinearTheory]:
    """Return the linear theory of all outputs, setting by setting; [] without `sensitivities`.

    Outputs are the final value, minimum, maximum and mean of observables, final extra states, and
    the end time if events end trajectories; of a study without any of these, the components of the
    twists at the end.
    """
    study = dataset.study
    if not (study.integrate.sensitivities and study.design.drawn):
        return []
    each = (_of_setting(dataset, setting, probabilities) for setting in study.settings)
    return [*chain.from_iterable(each)]


def remarks(rows: Sequence[LinearTheory]) -> list[str]:
    """Return a sentence for each quantity left out, and for each setting in which it fails."""
    reasons = {name: why for each in rows for name, why in each.left_out.items()}
    lines = [f"linear theory leaves out {name}: {why}" for name, why in reasons.items()]
    if lines:
        lines.append(
            "linear percentiles lack what is left out, and are not compared with sampled ones"
        )
    parting: dict[Setting, list[str]] = {}
    for each in rows:
        if each.parts_at:
            where = ", ".join(percent(p) for p in each.parts_at)
            parting.setdefault(each.setting, []).append(f"{each.name} at {where}")
    for setting, outputs in parting.items():
        more = len(outputs) - MOST_NAMED
        named = "; ".join(outputs[:MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
        lines.append(
            f"{setting.label}: linear theory does not hold for {named}: there the linear "
            f"percentile is outside the {CONFIDENCE:.0%} interval of the sampled one"
        )
    return lines


def _of_setting(
    dataset: Results, setting: Setting, probabilities: Sequence[float]
) -> Iterator[LinearTheory]:
    """Yield the linear theory of the outputs, each of the bodies in which it is a number."""
    study = dataset.study
    outputs = [*_outputs(study)]
    rows = _rows(dataset, setting, outputs)
    if not len(next(iter(rows.values()))):
        return
    groups: dict[bytes, list[_Output]] = {}
    for output in outputs:
        known = np.isfinite(_by_parameters(output, study, rows)).all(axis=(1, 2))
        known &= np.isfinite(rows[output.column][:, output.item])
        groups.setdefault(known.tobytes(), []).append(output)
    found: dict[str, LinearTheory] = {}
    for mask, group in groups.items():
        known = np.frombuffer(mask, dtype=bool)
        some = {name: values[known] for name, values in rows.items()}
        found |= {
            each.name: each for each in _of_bodies(dataset, setting, some, group, probabilities)
        }
    yield from (found[output.name] for output in outputs if output.name in found)


def _of_bodies(
    dataset: Results,
    setting: Setting,
    rows: dict[str, Array],
    outputs: Sequence[_Output],
    probabilities: Sequence[float],
) -> Iterator[LinearTheory]:
    """Yield the linear theory of outputs of the same bodies.   rows : of these bodies."""
    study = dataset.study
    count = len(next(iter(rows.values())))
    if count < 2:
        return
    chosen = some_rows(count, MOST_BODIES)
    some = {name: values[chosen] for name, values in rows.items()}
    covariances = {name: study.design.quantities[name].moments[1] for name in study.design.drawn}
    along, missing = _along_parameters(study, some, covariances)
    missing |= _noises(study)
    schema = dataset.table().schema
    independent = study.design.independent(rows["trajectory"][:, 0])
    for output in outputs:
        values = rows[output.column][:, output.item]
        if np.ptp(values) <= CONSTANT * np.abs(rows[output.column]).max():
            continue
        by = _by_parameters(output, study, some)
        slopes = {name: np.mean(by @ weights, axis=0)[0] for name, weights in along.items()}
        linear = np.full(len(values), values.mean())
        linear += sum(_off(rows, name) @ s for name, s in slopes.items())
        percentiles, sampled = (
            quantiles_of(x, independent, probabilities) for x in (linear, values)
        )
        yield LinearTheory(
            setting,
            output.name,
            unit_of(schema.field(output.column)),
            _shares(slopes, covariances),
            tuple(q.value for q in percentiles),
            sampled,
            () if missing else _parting(percentiles, sampled, ROUNDING * values.std()),
            missing,
        )


def _parting(
    linear: Sequence[Quantile], sampled: Sequence[Quantile], rounding: float
) -> tuple[float, ...]:
    """Return the probabilities of linear percentiles outside the intervals of the sampled ones."""
    return tuple(
        q.probability
        for x, q in zip(linear, sampled, strict=True)
        if x.value < q.low - rounding or x.value > q.high + rounding
    )


def _noises(study: Study) -> dict[str, str]:
    """Return the reason why noise of controllers has no share, by its name."""
    return {
        f"the noise of {each.name}": "it is drawn at ticks, and is no sampled quantity"
        for each in study.batch(0, 1).problem.controllers
        if each.kind.function.draws
    }


def _outputs(study: Study) -> Iterator[_Output]:
    model = study.batch(0, 1).problem
    ends = any(event.terminal for event in model.events)
    for each in model.observables:
        yield _Output(f"{each.name}_final", f"{each.name}_final", 0, each.name)
        for column in (f"{each.name}_{of}" for of in DIFFERENTIATED):
            yield _Output(column, column, 0, column)
    for name, shape, _ in model.signals:
        for i in range(prod(shape)):
            yield _Output(f"{name} {i + 1}" if shape else name, name, i, name, i, prod(shape))
    if ends:
        yield _Output("t", "t", 0, "t")
    if ends or model.observables or model.signals:
        return
    for link in model.link_names:
        prefix = f"{link}." if link else ""
        for first, column in ((0, f"{prefix}omega"), (3, f"{prefix}v")):
            for i in range(3):
                yield _Output(f"{column} {i + 1}", column, i, f"{prefix}twist", first + i, 6)


def _rows(dataset: Results, setting: Setting, outputs: Sequence[_Output]) -> dict[str, Array]:
    """Read numbers, outputs, draws and derivatives of the ok bodies, (n, numbers)."""
    study = dataset.study
    columns = ["trajectory", *(output.column for output in outputs)]
    columns += [f"sample.{name}" for name in study.design.quantities if name != NOTHING]
    columns += [
        f"{output.of}{SEPARATOR}{name}"
        for output in outputs
        for name in study.integrate.sensitivities
    ]
    return {
        name: values.reshape(len(values), prod(values.shape[1:]))
        for name, values in ok_columns(dataset, setting, [*dict.fromkeys(columns)]).items()
    }


def _off(rows: dict[str, Array], quantity: str) -> Array:
    """Return the differences of the draws from their mean, (n, components)."""
    draws = rows[f"sample.{quantity}"]
    return np.asarray(draws - draws.mean(axis=0))


def _along_parameters(
    study: Study, rows: dict[str, Array], covariances: dict[str, Array]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return ∂p/∂x by sampled quantity, and reasons for those without derivatives."""
    draws = {
        name: rows[f"sample.{name}"].reshape(-1, *quantity.shape)
        for name, quantity in study.design.quantities.items()
    }
    deviations = {name: np.sqrt(c.diagonal()) for name, c in covariances.items()}
    chain = AlongParameters(study, draws, deviations)
    along = {name: chain.along(name) for name in deviations}
    missing = {name: why for name, why in along.items() if isinstance(why, str)}
    return {name: w for name, w in along.items() if not isinstance(w, str)}, missing


def _by_parameters(output: _Output, study: Study, rows: dict[str, Array]) -> Array:
    """Return the derivatives of an output by all numbers of the parameters, (n, 1, numbers)."""
    parts = [rows[f"{output.of}{SEPARATOR}{name}"] for name in study.integrate.sensitivities]
    own = [part.reshape(len(part), output.width, -1)[:, output.part] for part in parts]
    return np.concatenate(own, axis=1)[:, None]


def _shares(slopes: dict[str, Array], covariances: dict[str, Array]) -> dict[str, float]:
    """Return (∂g/∂x)ᵀ C ∂g/∂x of each quantity, divided by their sum."""
    variances = {name: float(s @ covariances[name] @ s) for name, s in slopes.items()}
    total = sum(variances.values()) or np.nan
    return {name: variance / total for name, variance in variances.items()}

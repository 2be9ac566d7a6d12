"""Label sampled numbers on an axis: `v₂ [m/s]`, not `initial.twist, 5 [m/s]`."""

from __future__ import annotations

from collections.abc import Iterator
from unicodedata import normalize

import numpy as np

from lierb.studies.description.study import Study
from lierb.studies.description.study_file import ELEMENTS
from lierb.studies.description.units import each_unit, joint_of
from lierb.support.arrays import Array
from lierb.support.representations import with_unit

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
SYMBOLS = {  # symbols of a vector's components
    "initial.omega": ("ω₁", "ω₂", "ω₃"),
    "initial.twist": ("ω₁", "ω₂", "ω₃", "v₁", "v₂", "v₃"),
    "initial.point_velocity": ("ṗ₁", "ṗ₂", "ṗ₃"),
    "initial.place": ("d₁", "d₂", "d₃"),
    "body.inertia": ("I₁", "I₂", "I₃"),
    "body.second_moments": ("∫x₁² dm", "∫x₂² dm", "∫x₃² dm"),
    "body.com": ("c₁", "c₂", "c₃"),
    "problem.gravity": ("g₁", "g₂", "g₃"),
}
GREEK = {"phi": "φ", "xi": "ξ", "alpha": "α", "beta": "β"}
MOST_COMPONENTS = 6  # matrices are left out


def labelled(
    drawn: dict[str, str], rows: dict[str, Array], study: Study
) -> Iterator[tuple[str, Array]]:
    """Yield each sampled number by a label with its unit; matrices are left out.

    Of a vector in which bodies differ, components in which they do not are left out.

    drawn : columns and their units.   rows : their values, (n,) or (n, k).
    """
    for name, unit in drawn.items():
        values, quantity = rows[name], name.removeprefix("sample.")
        columns = values[:, None] if values.ndim == 1 else values
        width = columns.shape[1]
        if width > MOST_COMPONENTS:
            continue
        differs = columns != columns[:1]
        symbols = _symbols(quantity, width, values.ndim > 1, study)
        for symbol, own, column in zip(symbols, each_unit(unit, width), columns.T, strict=True):
            if differs.any() and np.all(column == column[:1]):
                continue
            yield with_unit(symbol, own), column


def _symbols(quantity: str, width: int, is_vector: bool, study: Study) -> list[str]:
    """Return a name for each component."""
    whole = quantity
    section, _, key = quantity.rpartition(".")
    first, _, of_link = section.partition(".")
    owner = ""
    if of_link and first not in ELEMENTS:  # a link's quantity, which begins with the link's name
        owner, quantity = f"{first}: ", f"{of_link}.{key}"
    elif first == "forces":
        owner = f"{of_link}: "
    if quantity in ("initial.coordinates", "initial.velocities"):
        return [owner + name for name in _of_coordinates(whole, width, study)]
    if is_vector and len(SYMBOLS.get(quantity, ())) == width:
        return [owner + symbol for symbol in SYMBOLS[quantity]]
    word = owner + key.replace("_", " ")
    if not is_vector:
        return [word]
    return [word + str(i + 1).translate(SUBSCRIPTS) for i in range(width)]


def _of_coordinates(quantity: str, width: int, study: Study) -> list[str]:
    names = joint_of(quantity, study.batch(0, 1).problem).coordinate_names
    if len(names) != width:
        return [f"{quantity} {i + 1}" for i in range(width)]
    rate = "\N{COMBINING DOT ABOVE}" if quantity.endswith("velocities") else ""
    symbols = []
    for name in names:
        letter, number = name.rstrip("0123456789"), name.lstrip("abcdefghijklmnopqrstuvwxyz")
        symbol = GREEK.get(letter, letter) + rate + number.translate(SUBSCRIPTS)
        symbols.append(normalize("NFC", symbol))  # fonts have ḋ, but few combine d with a dot
    return symbols

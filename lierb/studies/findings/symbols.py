"""Label sampled numbers on an axis: `v₂ [m/s]`, not `initial.twist, 5 [m/s]`."""

from __future__ import annotations

from collections.abc import Sequence
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
    drawn: dict[str, str], across: Sequence[dict[str, Array]], study: Study
) -> list[dict[str, Array]]:
    """Return the sampled numbers of each setting by labels with units; matrices are left out.

    Of a vector in which bodies differ, components in which they do not are left out. All settings
    have the same labels.

    drawn : columns and their units.   across : their values, (n,) or (n, k), in each setting.
    """
    found: list[dict[str, Array]] = [{} for _ in across]
    for name, unit in drawn.items():
        values, quantity = [rows[name] for rows in across], name.removeprefix("sample.")
        columns = [x[:, None] if x.ndim == 1 else x for x in values]
        width = columns[0].shape[1]
        if width > MOST_COMPONENTS:
            continue
        differs = np.any([np.any(x != x[:1], axis=0) for x in columns], axis=0)
        symbols = _symbols(quantity, width, values[0].ndim > 1, study)
        for i, (symbol, own) in enumerate(zip(symbols, each_unit(unit, width), strict=True)):
            if differs[i] or not differs.any():
                label = with_unit(symbol, own)
                label = with_unit(f"{quantity}: {symbol}", own) if label in found[0] else label
                for labels, x in zip(found, columns, strict=True):
                    labels[label] = x[:, i]
    return found


def _symbols(quantity: str, width: int, is_vector: bool, study: Study) -> list[str]:
    """Return a name for each component."""
    whole = quantity
    section, _, key = quantity.rpartition(".")
    first, _, of_link = section.partition(".")
    owner = ""
    if first in ELEMENTS:
        owner = f"{of_link}: "
    elif of_link:  # a link's quantity, which begins with the link's name
        owner, quantity = f"{first}: ", f"{of_link}.{key}"
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

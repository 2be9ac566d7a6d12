"""Describe objects: as text at a prompt, as a table in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from lierb.support.arrays import Array

Lines = Sequence[tuple[str, str]]  # (label, text)

DIGITS = (3, 12)  # fewest and most significant digits of numbers in tables
FAILED = "failed"  # label of a highlighted row
CELL = "text-align: left; vertical-align: top; white-space: pre-wrap"
LOUD = "color: #b00020; font-weight: bold"


class Represented:
    """A description has a title and labelled lines, returned by `_representation`."""

    def _representation(self) -> tuple[str, Lines]:
        raise NotImplementedError

    def __repr__(self) -> str:
        return as_text(*self._representation())

    def _repr_html_(self) -> str:
        return as_html(*self._representation())


def as_text(title: str, rows: Lines) -> str:
    """Format a description as text: `<title>`, or the title and a line for each row."""
    if not rows:
        return f"<{title}>"
    width = max(len(label) for label, _ in rows)
    indent = "\n" + " " * (width + 4)
    lines = [f"  {label:{width}}  {indent.join(text.splitlines())}" for label, text in rows]
    return "\n".join((title, *lines))


def as_html(title: str, rows: Lines) -> str:
    """Format a description as an HTML table, with all texts escaped."""
    lines = ""
    for label, text in rows:
        style = f"{CELL}; {LOUD}" if label == FAILED else CELL
        cells = (
            f'<{tag} style="{style}">{html.escape(x)}</{tag}>'
            for tag, x in (("th", label), ("td", text))
        )
        lines += f"<tr>{''.join(cells)}</tr>"
    return f"<div><b>{html.escape(title)}</b><table>{lines}</table></div>"


# ---- numbers -----------------------------------------------------------------------------------


def counted(count: int, what: str, several: str = "") -> str:
    """Format a count with its noun: `1 body`, `3 bodies`."""
    return f"{count} {what if count == 1 else several or f'{what}s'}"


def counted_links(links: int, loops: int) -> str:
    """Format the size of a mechanism: `2 links`, `3 links and 1 loop`."""
    return counted(links, "link") + (f" and {counted(loops, 'loop')}" if loops else "")


def with_unit(name: str, unit: str) -> str:
    """Format the label of an axis: `position [m]`, without a unit of 1."""
    return name if unit in ("", "1") else f"{name} [{unit}]"


def steps_text(options: Mapping[str, Any]) -> str:
    """Format the tolerance or the step size of a run, from the options in its metadata."""
    return f"rtol = {options['rtol']:g}" if options.get("rtol") else f"dt = {options['dt']:g} s"


def rounded(error: float) -> str:
    """Format an error with two digits, NaN as a dash."""
    if np.isnan(error):
        return "–"
    return f"{error:.1e}" if error else "0"


def digits_apart(number: float, others: Iterable[float]) -> int:
    """Return how many significant digits tell a number from others, within DIGITS.

    Numbers that are equal, NaN or infinite need none.
    """
    finite = [x for x in others if np.isfinite(x) and x != number]
    if not (finite and np.isfinite(number)):
        return DIGITS[0]
    gap = min(abs(number - x) for x in finite)
    size = max(abs(number), *(abs(x) for x in finite if abs(number - x) == gap))
    return int(np.clip(np.floor(np.log10(size)) - np.floor(np.log10(gap)) + 1, *DIGITS))


def apart(numbers: Sequence[float]) -> list[str]:
    """Format the numbers of a column with digits that tell different ones apart."""
    digits = max((digits_apart(x, numbers) for x in numbers), default=DIGITS[0])
    return [f"{x:.{digits}g}" for x in numbers]


def quantity(array: Array, unit: str = "", item_axes: int = 0) -> str:
    """Format an argument's value, or the range of values in a batch."""
    tail = f" {unit}" if unit else ""
    if array.ndim > item_axes and len(array) > 1:
        if item_axes:
            return f"one for each of {len(array)}{f', {unit}' if unit else ''}"
        return f"{array.min():.6g} … {array.max():.6g}{tail}"
    return _item(array[0] if array.ndim > item_axes else array) + tail


def _item(array: Array) -> str:
    if np.ndim(array) == 0:
        return f"{float(array) + 0.0:.6g}"  # + 0 turns −0 into 0
    return f"({', '.join(_item(each) for each in array)})"

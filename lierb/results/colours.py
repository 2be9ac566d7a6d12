"""Names and colours of c-spaces, common to all figures and animations."""

from __future__ import annotations

from collections.abc import Sequence

# Okabe and Ito's colours, distinguishable with any colour vision, and three of Tol's.
COLOURS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99",
    "#999933",
)  # fmt: skip
CSPACE_COLOURS = dict(zip(("SE3", "SO3xR3", "reduced"), COLOURS))
CSPACE_NAMES = {"SE3": "SE(3)", "SO3xR3": "SO(3)×ℝ³"}
STEP_COLOURS = ("#882255", "#E69F00", "#56B4E9", "#CC79A7", "#44AA99")
"""Colours of steps, coarsest first, in a panel of one c-space; none is a c-space's colour."""


def colours_of(cspaces: Sequence[str | None]) -> list[str]:
    """Return a colour for each curve by its c-space; the first eight differ.

    The first curve on a c-space has the c-space's colour; further curves have other colours.

    >>> colours_of(["SE3", "SE3", "SO3xR3"])
    ['#0072B2', '#009E73', '#D55E00']
    """
    own = {c: CSPACE_COLOURS[c] for c in cspaces if c in CSPACE_COLOURS}
    kept = {*own.values(), *(CSPACE_COLOURS[cspace] for cspace in CSPACE_NAMES)}
    left = [colour for colour in COLOURS if colour not in kept]
    colours, others = [], 0
    for cspace in cspaces:
        if cspace in own:
            colours.append(own.pop(cspace))
        else:
            colours.append(left[others % len(left)])
            others += 1
    return colours

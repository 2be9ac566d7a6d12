"""Warn of forces and functions that switch, by which derivatives of a run may be wrong."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from lierb.errors import DerivativeWarning
from lierb.kernels.functions.trials import switches
from lierb.model.base import Model
from lierb.model.functions.elements import Element
from lierb.support.collected_warnings import are_warnings_collected


def warn_of_switches(model: Model, **options: Any) -> None:
    """Issue one DerivativeWarning if a force, constraint, state or controller switches.

    options : keywords of `warnings.warn`.
    """
    if not are_warnings_collected() and (message := switches_of(model)):
        warnings.warn(message, DerivativeWarning, **options)


def switches_of(model: Model) -> str:
    """Return the message for a model of which an element with an effect switches, or ""."""
    acting = (*model.forces, *model.constraints, *model.states, *model.controllers)
    names = dict.fromkeys(element.name for element in acting if _switches(element))
    if not names:
        return ""
    return (
        f"{', '.join(names)}: switches by a comparison; derivatives are right only where it is "
        "continuous, for the jump that they have where it is not is left out"
    )


def _switches(element: Element) -> bool:
    kind = element.kind
    traced = (f for f in kind.functions if f.is_traced)
    if any(np.any(element.parameters[name] != 0.0) for name in kind.jumping):
        return True
    return any(switches(f, kind.discontinuities) for f in traced)

"""The examples of section 5 of Müller's paper are given as data.

A. Müller, "A note on the motion representation and configuration update in time stepping schemes
for the constrained rigid body", BIT Numerical Mathematics 56 (2016), 995-1015.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import pi
from typing import Any

import numpy as np

from lierb.model.joints import catalogue as joints
from lierb.model.joints.joint import Joint

Vector = tuple[float, float, float]

MASS = 6.075  # kg: an aluminium box of 0.3 × 0.15 × 0.05 m
INERTIA = (0.0126563, 0.0468281, 0.0569531)  # kg m², about the centre of mass
P = (-0.15, 0.0375, 0.0)  # m: the joint's point on the body
E1, E2, E3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
CSPACES = ("SO3xR3", "SE3")  # left and right in the paper's figures
AS_STATED = "as stated"  # reading of an example that needs no interpretation


@dataclass(frozen=True)
class Claim:
    """The paper's claim about the errors in one c-space is "exact", "order 4", or None."""

    position: str | None
    rotation: str | None = None


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper has a number and the error that it shows."""

    number: int
    quantity: str


@dataclass(frozen=True, eq=False)
class Example:
    """An example of section 5 has a joint, the start of the body, and the paper's claims."""

    key: str
    title: str
    joint: Callable[[], Joint]
    omega0: Vector  # rad/s, body frame
    claims: Mapping[str, Claim]  # by c-space
    point_velocity: Vector = (0.0, 0.0, 0.0)  # m/s, of the joint's point, ground frame
    figures: tuple[PaperFigure, ...] = ()
    reading: str = AS_STATED  # or "corrected", "as printed", "text", "formula"
    note: str = ""  # departures from the paper, and numbers missing in it
    check: str = "raise"  # as `integrate` takes it

    @property
    def quantities(self) -> tuple[str, ...]:
        """Return the kinds of error that the joint has."""
        return self.joint().error_kinds


def _hook_r23() -> Joint:
    """Return a universal joint with R23 = 0: first axis IFR 2, second axis RFR 3 (erratum E11)."""
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

# Changes by --as-printed: other values of an example's fields.
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
    """Return the examples of section 5, with its misprints corrected or as printed."""
    if not as_printed:
        return EXAMPLES
    return tuple(replace(example, **_AS_PRINTED.get(example.key, {})) for example in EXAMPLES)

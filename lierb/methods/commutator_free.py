"""Commutator-free methods update the pose by several exponentials in a step, without dexp⁻¹.

A stage multiplies the pose by its exponentials from the right, in the order of their rows, because
twists are body-fixed: Ċ = C V.
"""

from collections.abc import Sequence
from typing import Any

from lierb.methods.tableau import ButcherTableau


def _crouch_grossman(
    A: Sequence[Sequence[float]], b: Sequence[float], **more: Any
) -> ButcherTableau:
    """Return rows with one exponential for each weight, in the order of the stages."""
    exponentials = [
        [[0.0] * j + [weight] + [0.0] * (len(row) - j - 1) for j, weight in enumerate(row)]
        for row in (*A, b)
    ]
    return ButcherTableau(A, b, exponentials=exponentials, **more)


# fmt: off
METHODS = (
    ButcherTableau(
        A=((), (1 / 2,), (0, 1 / 2), (0, 0, 1)),
        b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
        name="CF4",
        order=4,
        exponentials=(
            (),
            ((1 / 2,),),
            ((0, 1 / 2),),
            ((1 / 2, 0, 0), (-1 / 2, 0, 1)),
            ((1 / 4, 1 / 6, 1 / 6, -1 / 12), (-1 / 12, 1 / 6, 1 / 6, 1 / 4)),
        ),
        source="Celledoni, Marthinsen, Owren, Future Gener. Comput. Syst. 19 (2003)",
    ),
    _crouch_grossman(
        A=((), (3 / 4,), (119 / 216, 17 / 108)),
        b=(13 / 51, -2 / 3, 24 / 17),
        name="CG3",
        order=3,
        source="Crouch and Grossman, J. Nonlinear Sci. 3 (1993); "
        "Hairer, Lubich, Wanner, Geometric Numerical Integration, IV.8.1",
    ),
    _crouch_grossman(
        A=(
            (),
            (0.8177227988124852,),
            (0.3199876375476427, 0.0659864263556022),
            (0.9214417194464946, 0.4997857776773573, -1.0969984448371582),
            (0.3552358559023322, 0.2390958372307326, 1.3918565724203246, -1.1092979392113465),
        ),
        b=(
            0.1370831520630755, -0.0183698531564020, 0.7397813985370780, -0.1907142565505889,
            0.3322195591068374,
        ),
        name="CG4",
        order=4,
        source="Jackiewicz, Marthinsen, Owren, Adv. Comput. Math. 13 (2000)",
    ),
)
# fmt: on

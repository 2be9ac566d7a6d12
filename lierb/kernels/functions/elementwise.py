"""Evaluate NumPy's elementwise functions, by their names, on users' numbers."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from lierb.kernels.functions import elementary, steps
from lierb.kernels.functions.user_number import as_condition

BY_NAME: dict[str, Callable[..., Any]] = {
    name: getattr(elementary, name)
    for name in (
        "sin", "cos", "tan", "exp", "expm1", "exp2", "log", "log1p", "log10", "log2", "sqrt",
        "cbrt", "square", "reciprocal", "sinh", "cosh", "tanh", "arcsin", "arccos", "arctan",
        "arcsinh", "arccosh", "arctanh", "arctan2", "hypot", "power",
    )
} | {
    name: getattr(steps, name)
    for name in (
        "maximum", "minimum", "fmax", "fmin", "sign", "copysign", "heaviside", "remainder", "fmod",
        "floor_divide", "logaddexp", "floor", "ceil", "trunc", "rint", "isnan", "isfinite",
        "isinf", "signbit", "divmod",
    )
} | {
    "float_power": elementary.power, "absolute": abs, "fabs": abs,
    "modf": lambda x: (steps.fraction(x), steps.trunc(x)),
    "radians": lambda x: x * (math.pi / 180.0), "deg2rad": lambda x: x * (math.pi / 180.0),
    "degrees": lambda x: x * (180.0 / math.pi), "rad2deg": lambda x: x * (180.0 / math.pi),
    "positive": lambda x: x, "conjugate": lambda x: x,
    "logical_and": lambda a, b: as_condition(a) & as_condition(b),
    "logical_or": lambda a, b: as_condition(a) | as_condition(b),
    "logical_xor": lambda a, b: as_condition(a) ^ as_condition(b),
    "logical_not": lambda a: as_condition(a) ^ True, "invert": lambda a: as_condition(a) ^ True,
    "less": operator.lt, "less_equal": operator.le, "greater": operator.gt,
    "greater_equal": operator.ge, "equal": operator.eq, "not_equal": operator.ne,
    # These ufuncs have no public names: of np.clip and, since NumPy 2.5, of x.real and x.imag.
    "clip": steps.clipped, "real": lambda x: x, "imag": lambda x: 0.0 * x,
}  # fmt: skip

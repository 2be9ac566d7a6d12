"""Each random number of a controller is a function of its position in a stream.

A draw is a function of (seed, trajectory, name, tick, component) by a counter-based generator,
Philox-4x32-10 (Salmon, Moraes, Dror, Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3"). It
depends neither on the order of draws nor on other draws. The conversion of integers to normal
numbers uses + − × ÷ √ only, none of them fused. Hence a draw has the same bits on every CPU, in
compiled code, in NumPy and in plain Python.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any

from lierb.kernels.functions.object_arrays import numbers
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.signals import Noise
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.numbers.arithmetic import any_lanes, branch, minimum, sqrt, where
from lierb.kernels.tracing.words import LOW, real_of, words_of

MOST = 4096  # most numbers of one draw; the counter limits it
BLOCK_BITS = 11  # bits of the index of a pair of numbers
MULTIPLIERS = 0xD2511F53, 0xCD9E8D57
WEYL = 0x9E3779B9, 0xBB67AE85
ROUNDS = 10


# ---- draws of users' functions -------------------------------------------------------------------


# Noise of one call of a controller, and the names that the call has drawn.
_drawing: ContextVar[tuple[Noise, set[str]] | None] = ContextVar("lierb_noise", default=None)


@contextmanager
def drawing(noise: Noise | None) -> Iterator[None]:
    """Let `normal` draw from `noise` within the context; None forbids draws."""
    token = _drawing.set(None if noise is None else (noise, set()))
    try:
        yield
    finally:
        _drawing.reset(token)


def normal(name: str, size: int | tuple[()] = ()) -> Any:
    """Draw standard normal numbers at a controller's tick: independent, mean 0, variance 1.

    The numbers depend on the run's `seed`, the trajectory's number, the name, the tick and the
    component only, and have the same bits on every machine. Only functions of `@lierb.controller`
    can draw: functions that are integrated between ticks must be smooth.

    Parameters
    ----------
    name : str
        Name of the noise. Each name has a stream of its own. Controllers that draw one name at the
        same tick number get the same numbers.
    size : int or (), optional
        Number of components; () for a single number.

    Returns
    -------
    float or ndarray, shape (size,)
        The numbers.

    Raises
    ------
    TypeError
        The call is not in a controller, or a controller draws one name twice.

    Examples
    --------
    >>> import lierb
    >>> @lierb.controller(every=0.1, gain=0.5, sigma=1e-3)
    ... def damping(omega, params):
    ...     rate = omega + params.sigma * lierb.noise.normal("gyro", 3)
    ...     return {"torque": -params.gain * rate}
    >>> damping()
    <damping: every, gain, sigma>
    """
    count = _checked(name, size)
    draws = _drawing.get()
    if draws is None:
        raise UnfitFunctionError(
            f"lierb.noise.normal({name!r}) is drawn outside of a controller; draw it in a function "
            "of @lierb.controller and return it as an output, or use lierb.noise.sample to look at "
            "its numbers"
        )
    noise, drawn = draws
    if name in drawn:
        raise UnfitFunctionError(
            f"it draws the noise {name!r} twice, which would give the same numbers twice; give "
            f"each a name of its own, or draw all at once: lierb.noise.normal({name!r}, count)"
        )
    drawn.add(name)
    components = [UserNumber(x) for x in normals(noise, name, count)]
    return components[0] if size == () else numbers(components)


def _checked(name: Any, size: Any) -> int:
    """Check the arguments of `normal`; return the number of numbers."""
    if not (isinstance(name, str) and name):
        raise UnfitFunctionError(
            f"the name of a noise is {type(name).__name__}, not text: write it out, such as "
            'lierb.noise.normal("gyro", 3)'
        )
    if size == ():
        return 1
    if isinstance(size, int) and not isinstance(size, bool) and 1 <= size <= MOST:
        return size
    raise UnfitFunctionError(
        f"lierb.noise.normal({name!r}, {size!r}): expected how many numbers, 1 to {MOST}, or ()"
    )


# ---- generator and normal distribution -----------------------------------------------------------


def normals(noise: Noise, name: str, count: int) -> list[Any]:
    """Draw `count` standard normal numbers."""
    seed, trajectory, tick = (words_of(x) for x in noise)
    first, second = digest(name)
    key = (seed & LOW) ^ first, (seed >> 32) ^ second
    late = ((tick >> 32) & (2 ** (32 - BLOCK_BITS) - 1)) * 2**BLOCK_BITS
    draws: list[Any] = []
    for block in range((count + 1) // 2):
        counter = tick & LOW, late + block, trajectory & LOW, trajectory >> 32
        words = philox(counter, key)
        draws += [normal_of(uniform(*words[:2])), normal_of(uniform(*words[2:]))]
    return draws[:count]


@cache
def digest(name: str) -> tuple[int, int]:
    """Return the digest of a noise's name, as two words of 32 bits."""
    words = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return words & LOW, words >> 32


def philox(counter: Sequence[Any], key: Sequence[Any]) -> tuple[Any, ...]:
    """Compute Philox-4x32-10, four random words of 32 bits.

    counter : four words.   key : two words.
    """
    a, b, c, d = counter
    first, second = key
    for _ in range(ROUNDS):
        left, right = a * MULTIPLIERS[0], c * MULTIPLIERS[1]
        a, b = (right >> 32) ^ b ^ first, right & LOW
        c, d = (left >> 32) ^ d ^ second, left & LOW
        first, second = (first + WEYL[0]) & LOW, (second + WEYL[1]) & LOW
    return a, b, c, d


def uniform(high: Any, low: Any) -> Any:
    """Return (k + ½)/2⁵², uniform in (0, 1) and exact, with k the upper 26 bits of two words."""
    return (real_of(high >> 6) * 2.0**26 + real_of(low >> 6) + 0.5) * 2.0**-52


CENTRE = (
    (3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3,
     1.3731693765509461125e4, 4.5921953931549871457e4, 6.7265770927008700853e4,
     3.3430575583588128105e4, 2.5090809287301226727e3),
    (1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
     2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4,
     5.2264952788528545610e3),
)  # fmt: skip
NEAR = (
    (1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0,
     3.64784832476320460504e0, 1.27045825245236838258e0, 2.41780725177450611770e-1,
     2.27238449892691845833e-2, 7.74545014278341407640e-4),
    (1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
     1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4,
     1.05075007164441684324e-9),
)  # fmt: skip
FAR = (
    (6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0,
     2.96560571828504891230e-1, 2.65321895265761230930e-2, 1.24266094738807843860e-3,
     2.71155556874348757815e-5, 2.01033439929228813265e-7),
    (1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
     7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7,
     2.04426310338993978564e-15),
)  # fmt: skip


def normal_of(p: Any) -> Any:
    """Return the quantile z with Φ(z) = p, 2⁻⁵³ ≤ p ≤ 1 − 2⁻⁵³.

    The source is Wichura 1988, algorithm AS 241, PPND16.

    Error ≤ 2e-15 of ‖z‖ (test_normal_of_is_the_inverse_of_the_distribution).
    """
    q = p - 0.5
    central = q * _ratio(CENTRE, 0.180625 - q * q)
    tail = minimum(p, 1.0 - p)
    root = sqrt(-logarithm(tail))
    near, is_far = _ratio(NEAR, root - 1.6), root > 5.0  # one of 3·10¹⁰ draws
    outer = branch(
        any_lanes(is_far),
        lambda: where(is_far, _ratio(FAR, root - 5.0), near),
        lambda: near,
        likely=False,
    )
    return where(q * q <= 0.425 * 0.425, central, where(q < 0.0, -outer, outer))


def _ratio(polynomials: tuple[Sequence[float], Sequence[float]], x: Any) -> Any:
    above, below = (_polynomial(terms, x) for terms in polynomials)
    return above / below


def _polynomial(terms: Sequence[float], x: Any) -> Any:
    """Evaluate Σ terms[k] xᵏ without fused operations; `horner` fuses on CPUs that can."""
    total: Any = terms[-1]
    for term in terms[-2::-1]:
        total = total * x + term
    return total


LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # high and low part
ODD = (6.666666666666735130e-01, 2.857142874366239149e-01, 1.818357216161805012e-01,
       1.479819860511658591e-01)  # fmt: skip
EVEN = 3.999999999940941908e-01, 2.222219843214978396e-01, 1.531383769920937332e-01


def logarithm(x: Any) -> Any:
    """Compute log x for 2⁻⁶³ < x < √2 by fdlibm's series; C libraries differ in the last bits."""
    mantissa, exponent = x, 0.0 * x
    for shift in (32, 16, 8, 4, 2, 1):
        small = mantissa < 2.0 ** (0.5 - shift)
        exponent = where(small, exponent - float(shift), exponent)
        mantissa = where(small, mantissa * 2.0**shift, mantissa)
    f = mantissa - 1.0  # between √½ − 1 and √2 − 1
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    series = z * _polynomial(ODD, w) + w * _polynomial(EVEN, w)
    half = 0.5 * f * f
    return exponent * LN2[0] - ((half - (s * (half + series) + exponent * LN2[1])) - f)

"""A number type on mpmath: formulas in 80 digits, with elementary functions of another make."""

import operator

from oracle import mp


def _exact(x):
    return x.value if isinstance(x, Exact) else mp.mpf(x)


def _operator(of, result):
    def method(a, b):
        if not isinstance(b, (Exact, float, int)):
            return NotImplemented
        return result(of(_exact(a), _exact(b)))

    return method


def _operation(of):
    return staticmethod(lambda *numbers: Exact(of(*map(_exact, numbers))))


class Exact:
    """All that a new number type takes: operators, and what `arithmetic.Plain` bears."""

    __slots__ = ("value",)
    __array_ufunc__ = None
    __hash__ = None
    rank = 8

    def __init__(self, value):
        self.value = mp.mpf(value)

    def __neg__(self):
        return Exact(-self.value)

    sqrt = _operation(lambda x: mp.sqrt(x) if x >= 0 else mp.nan)
    absolute, rint, floor = map(_operation, (abs, mp.nint, mp.floor))
    minimum, maximum, atan2 = map(_operation, (min, max, mp.atan2))
    fma = _operation(lambda a, b, c: a * b + c)

    def sincos(self):
        return Exact(mp.sin(self.value)), Exact(mp.cos(self.value))

    def trace_of(self):
        return None


for _name in ("add", "sub", "mul", "truediv"):
    _of = getattr(operator, _name)
    setattr(Exact, f"__{_name}__", _operator(_of, Exact))
    setattr(Exact, f"__r{_name}__", _operator(lambda a, b, of=_of: of(b, a), Exact))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Exact, f"__{_name}__", _operator(getattr(operator, _name), bool))

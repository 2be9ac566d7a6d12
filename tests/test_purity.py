"""Functions of the user's are functions of their arguments alone, or they are refused."""

from __future__ import annotations

import datetime
import linecache
import math
import os
import random
import re
import sys
import threading
import time
import types
import warnings
from random import gauss

import numba
import numpy as np
import pytest
from cases import column

import lierb
from lierb.errors import FailedTrajectoryWarning, ForceError
from lierb.kernels.functions.fingerprint import fingerprint
from lierb.kernels.functions.purity import require_repeatable
from lierb.kernels.functions.trials import trial

NOISE = np.random.default_rng(7)
HEAD = "def pushed(t, R, r, omega, v, params):\n"
BRANCH = "    if t < 0.5:\n        return r, r\n"  # no trace comes past it


def of_source(body: str, **names) -> types.FunctionType:
    """The function `pushed` of that body; its lines can be cited."""
    names = {
        "np": np, "random": random, "time": time, "math": math, "os": os, "datetime": datetime,
        "gauss": gauss, "rng": NOISE, "log": [], "seen": {"n": 0}, "gains": np.ones(3),
        "lierb": lierb, "numba": numba, "sys": sys,
    } | names  # fmt: skip
    lines = (HEAD + body).splitlines(keepends=True)
    file = f"<{hash(body)}>"
    linecache.cache[file] = (len(HEAD + body), None, lines, file)
    exec(compile("".join(lines), file, "exec"), names)
    return names["pushed"]


REFUSED = {
    "return np.random.normal(size=3), r": "draws random numbers, np.random.normal",
    "return r * random.gauss(0.0, 1.0), r": "draws random numbers, random.gauss",
    "return r * gauss(0.0, 1.0), r": "draws random numbers, gauss",
    "return rng.normal(size=3), r": "draws random numbers, rng.normal",
    "return r * time.time(), r": "reads a clock, time.time.*the argument t",
    "return r * datetime.datetime.now().second, r": "reads a clock, datetime.datetime.now",
    "return r * float(os.environ['HOME']), r": "uses os.environ.*a parameter",
    "return r * len(open('x').read()), r": "uses open.read|uses open",
    "print(t); return r, r": "uses print",
    "log.append(t); return r, r": "changes log",
    "seen['n'] += 1; return r * seen['n'], r": "changes seen",
    "gains[0] = 2.0; return gains, r": "changes an array",
    "global total; total = t; return r, r": "changes total",
    "pushed.calls = 1; return r, r": "changes pushed.calls",
    "np.pi = 3.0; return r, r": "changes np.pi",
    "return r * hash('a'), r": "uses hash",
    "return np.loadtxt('x'), r": "uses np.loadtxt",
    "return np.empty(3) + r, r": "uses np.empty, .*write np.zeros",
    "return np.empty_like(r) + r, r": "uses np.empty_like, .*write np.zeros_like",
    "return r * len(f'{r}'), r": "makes text of numbers",
    "return r * len(str(t)), r": "makes text of numbers",
    "return r * len(np.array2string(gains)), r": "makes text of numbers",
    "return r * (np.datetime64('now') > t), r": "reads a clock, np.datetime64",
    "params.k = 3.0; return r, r": "changes .k: parameters cannot be changed, .* of your own",
    "params.k += 3.0; return r, r": "changes .k: parameters cannot be changed, .* of your own",
    "return r * len([k for k in {'a', 'b'}]), r": "uses a set, .*for more than `in`: write a tuple",
    "return r * next(iter({'a', t})), r": "uses a set",
    "return r * len({k for k in 'ab'}), r": "uses a set",
    "return r * len(list(set('ab'))), r": "uses a set",
}


UNSEEN = "the JIT is off: nobody sees what comes past the branch"
COMPILED = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason=UNSEEN)


@pytest.mark.parametrize("way", ["traced", "body by body"])
@pytest.mark.parametrize("line", REFUSED)
def test_what_is_no_function_of_its_arguments_is_refused(line, way):
    if way != "traced" and numba.config.DISABLE_JIT:
        pytest.skip(UNSEEN)
    body = f"    {line}\n"
    function = of_source(body if way == "traced" else BRANCH + body)
    if way != "traced" and "gains[0]" in line:  # Numba knows no write to a constant
        message = "runs neither .* nor, compiled by Numba"
    else:
        number = 2 if way == "traced" else 4
        message = f'pushed cannot be compiled: line {number}, ".*": it ({REFUSED[line]})'
    if way != "traced" and line.startswith(("log", "seen")):  # nor changes of lists
        message = "runs neither|cannot be compiled"
    with pytest.raises(ForceError, match=message):
        lierb.wrench(function)()


SEEN_WHEN_TRACED = {
    "return table['make'](3) + r, r": "it uses np.empty, .*write np.zeros",
    "return r * len(repr(t)), r": "it makes text of numbers",
    "return r * len(str([t > 0.0])), r": "it makes text of numbers",
    "return r * len('{:.3f}'.format(t)), r": "it makes text of numbers",
    "return r * len(f'{gains}'), r": "it makes text of numbers",
    "return r * (np.array('now', dtype='M8[s]') > t), r": "it reads a clock",
    "params.shape = (1,); return r, r": "it changes .shape: parameters cannot be changed",
    "return r * len(sorted(words)), r": "it uses a set",
    "return r * len(table['words'] | words), r": "it uses a set",
    "return r * len(words.union('ab')), r": "it uses a set",
    "return r * (words == {}), r": "it uses a set",
}


@pytest.mark.parametrize("line", SEEN_WHEN_TRACED)
def test_what_no_name_tells_is_refused_where_it_is_done(line):
    words = {"a", "b"}
    table = {"words": frozenset(words), "make": np.empty}
    function = of_source(f"    {line}\n", words=words, table=table)
    message = f'pushed cannot be compiled: line 2, ".*": {SEEN_WHEN_TRACED[line]}'
    with pytest.raises(ForceError, match=message):
        lierb.wrench(function)()


def test_sets_tell_what_is_in_them():
    body = "    known = ('a' in words) + ('c' not in words) + (3 in {1, 2, 3}) + len(words)\n"
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it does not run body by body
        force = lierb.wrench(of_source(body + "    return r, r * known\n", words={"a", "b"}))()
    assert force.kind.function.python(0.0, 0, 2.0, 0, 0, ())[1] == 10.0


@COMPILED
def test_uninitialised_memory_is_found_under_another_name():
    line = "    m = np; return r, m.empty(3)\n"
    with pytest.raises(ForceError, match=r'line 4, ".*": it uses np\.empty'):
        lierb.wrench(of_source(BRANCH + line))()


@COMPILED
def test_branches_that_return_different_kinds_are_told():
    body = BRANCH + "    return (1.0, 2.0, 3.0), r\n"
    with pytest.raises(ForceError, match=r"returns different kinds .* np\.array or tuples") as told:
        lierb.wrench(of_source(body))()
    assert "unify" not in str(told.value)


def noisy_helper(x):
    return x * random.random()


@pytest.mark.parametrize("before", ["", pytest.param(BRANCH, marks=COMPILED)])
def test_helpers_and_other_names_do_not_hide_it(before):
    with pytest.raises(ForceError, match=r'"return x \* random\.random\(\)": it draws random'):
        lierb.wrench(of_source(before + "    return help(r[0]) * r, r\n", help=noisy_helper))()
    alias = before + "    m = np\n    g = m.random\n    return r * g.normal(), r\n"
    with pytest.raises(ForceError, match=r'line \d, "g = m\.random": it draws .* np\.random'):
        lierb.wrench(of_source(alias))()
    with pytest.raises(ForceError, match=r"torque cannot be compiled: line .*np\.random\.normal"):
        lierb.forces.motor(torque=torque)


torque = lambda t: np.random.normal()  # noqa: NPY002
torque.__name__ = "torque"


COUNTER = iter([1, 2, 3])


@pytest.mark.parametrize("function", [time.perf_counter_ns, random.random, COUNTER.__next__])
def test_two_traces_must_be_one(function):
    called = iter(function, object())  # C calls C: no profiler and no name tells of it
    with pytest.raises(TypeError, match=r"draws random numbers|does not do the same"):
        require_repeatable(lambda: str(next(called)))


def test_a_trace_leaves_random_generators_alone():
    def reseeded():
        random.seed(1)
        return "the same"

    state = random.getstate()
    try:
        with pytest.raises(TypeError, match="draws random numbers"):
            require_repeatable(reseeded)
    finally:
        random.setstate(state)
    require_repeatable(lambda: "the same")
    assert sys.getprofile() is None


def test_a_profiler_stays_at_work():
    calls = []

    def profiler(frame, event, argument):
        calls.append(event)

    sys.setprofile(profiler)
    try:
        require_repeatable(lambda: "the same")
        assert sys.getprofile() is profiler
    finally:
        sys.setprofile(None)
    assert "call" in calls


# ---- what it refers to, and when that changes --------------------------------------------------

FALL = {"dt": 0.125, "t_end": 1.0, "method": "Euler"}


def fallen(problem) -> np.ndarray:
    return column(lierb.integrate(problem, twist0=np.zeros(6), **FALL).summary, "v")[0]


def body_of(force) -> lierb.Problem:
    return lierb.Problem(lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.free(), forces=force)


def surroundings() -> types.FunctionType:
    """A function that refers to all kinds of things, each of them its own."""
    tools = types.ModuleType("tools")
    exec("k = 2.0\ndef twice(x): return 2.0 * x", vars(tools))
    return of_source(
        "    more = tools.twice(offset(tools.k)) * series[0]\n"
        "    return (0, 0, 0), k * table * setting['a'][0] + more\n",
        k=2.0, table=np.array([1.0, 0.0, 0.0]), setting={"a": [3.0]}, tools=tools,
        offset=eval("lambda x: x - 2.0", {}),
        series=(1.0, np.array([4.0])),
    )  # fmt: skip


CHANGES = {
    "k": lambda names: names.update(k=3.0),
    "table": lambda names: names["table"].__setitem__(1, 5.0),
    "setting": lambda names: names["setting"]["a"].append(1.0),
    "tools.k": lambda names: setattr(names["tools"], "k", 1.0),
    "tools.twice": lambda names: setattr(names["tools"], "twice", lambda x: x),
    "offset": lambda names: names.update(offset=lambda x: x),
    "series": lambda names: names["series"][1].__setitem__(0, 1.0),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_after_the_force_was_made_is_named(name):
    function = surroundings()
    force = lierb.wrench(function)()
    problem = body_of(force)
    before = fallen(problem)
    np.testing.assert_array_equal(before, (3.0, 0.0, 0.0))  # 2·3·1 N on 2 kg for 1 s
    CHANGES[name](function.__globals__)
    message = f"{name} has changed since pushed was made with it; make the force anew, or make"
    with pytest.raises(ForceError, match=message):
        fallen(problem)
    with pytest.raises(ForceError, match=message):
        body_of(force)
    assert lierb.wrench(function)().kind != force.kind


def test_an_equal_value_is_no_change():
    function = surroundings()
    problem = body_of(lierb.wrench(function)())
    names = surroundings().__globals__
    function.__globals__.update((n, names[n]) for n in ("k", "table", "setting", "offset", "tools"))
    np.testing.assert_array_equal(fallen(problem), (3.0, 0.0, 0.0))


def test_a_change_before_the_first_run_does_not_reach_the_cache():
    gains = np.array([1.0, 0.0, 0.0])
    function = of_source("    return (0, 0, 0), 4.5 * gains\n", gains=gains)
    force = lierb.wrench(function)()
    gains[0] = 2.0
    again = lierb.wrench(function)()
    assert again.kind != force.kind
    gains[0] = 1.0
    # the force has copies: it computes what its fingerprint says, whatever happens in between
    kept = force.kind.function.python.__globals__["gains"]
    gains[0] = 7.0
    np.testing.assert_array_equal(kept, (1.0, 0.0, 0.0))
    assert not kept.flags.writeable


def test_closures_are_watched_too():
    def made():
        gain = 1.0

        def push(t, R, r, omega, v, params):
            return (0, 0, 0), (gain, 0, 0)

        def changed(value):
            nonlocal gain
            gain = value

        return push, changed

    push, changed = made()
    problem = body_of(lierb.wrench(push)())
    changed(2.0)
    with pytest.raises(ForceError, match="gain has changed since push was made with it"):
        problem.require_unchanged()


# ---- body by body: what is raised while it runs ------------------------------------------------

LATE = """    size = 3 if t > 0.25 else 2
    if t > 0.75:
        raise ValueError("too late")
    return (0.0, 0.0, 0.0), r + r[PLACE]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "message"),
    [("size", "pushed raised IndexError: .*bounds"), ("0", "pushed raised ValueError: too late")],
)
def test_what_a_function_raises_is_told(place, message):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        force = lierb.wrench(of_source(LATE.replace("PLACE", place)))()
    with pytest.warns(FailedTrajectoryWarning, match=message):
        assert np.isnan(fallen(body_of(force))).all()
    # and nothing else is broken
    np.testing.assert_array_equal(fallen(body_of(lierb.wrench(surroundings())())), (3.0, 0.0, 0.0))


# ---- messages ----------------------------------------------------------------------------------

OFF_THE_PATH = {
    "return lierb.where(0.0 < t < 1.0, r, 0.0 * r), r": r"\(a < x\) & \(x < b\)",
    "return np.sort(r), r": "np.sort does not take numbers of many bodies; np.minimum and",
    "return r * math.gamma(t + 1.0), r": "math.gamma does not take numbers of many bodies",
    "return r * int(t), r": r"np\.trunc\(x\) for int\(x\)",
    "return r * gains[int(t)], r": r"lierb\.table",
    "return np.linalg.svd(R)[1], r": "np.linalg.svd does not take",
}


@pytest.mark.long
@pytest.mark.parametrize("line", OFF_THE_PATH)
def test_the_warning_names_line_and_remedy_and_how_much_slower(line):
    with pytest.warns(lierb.errors.ScalarFunctionWarning) as told:
        lierb.wrench(of_source(f"    {line}\n"))()
    (text,) = (str(warning.message) for warning in told)
    assert text.startswith("pushed runs body by body, 10 to 60 times slower than for many at once")
    assert f'line 2, "{line}"' in text
    assert re.search(OFF_THE_PATH[line], text)
    assert_plain(text)


@COMPILED
@pytest.mark.parametrize(
    "body",
    [
        "    total = sum(x * x for x in r)\n    if total > 1.0:\n        total = 1.0\n"
        "    return r * total, r\n",
        "    return r < 'a', r\n",
        "    return r[0], r\n",
        "    return (r, r, r), r\n",
        "    return {t}, r\n",
        "    return r @ np.ones(4), r\n",
        "    return r[t], len(t)\n",
        "    return r * (1.0 + t.imaginary), r[t > 0.0]\n",
    ],
)
def test_no_message_has_words_of_the_machinery(body):
    with pytest.raises(ForceError) as told:
        lierb.wrench(of_source(body))()
    assert_plain(str(told.value))


def assert_plain(text: str) -> None:
    for word in ("Dual", "UserNumber", "Lane", "yield in a closure", "Mask", "Condition"):
        assert word not in text


def test_trials_agree_with_fingerprints():
    """A function refused by name has no fingerprint; one that runs has."""
    with pytest.raises(TypeError, match="random"):
        fingerprint(noisy_helper)
    assert trial(lierb.wrench(surroundings())().kind.function) == 6


def test_other_threads_may_draw_while_a_function_is_traced():
    """Other threads, such as a Dask worker's, may draw meanwhile without a retrace each time."""
    traces = []

    def traced():
        traces.append(len(traces))
        if len(traces) <= 3:
            thread = threading.Thread(target=random.random)
            thread.start()
            thread.join()
        return "the same"

    state = random.getstate()
    require_repeatable(traced)
    assert len(traces) == 5  # the fourth finds nothing drawn, the fifth repeats it
    random.setstate(state)

"""Hostile arguments of the Python API: a result or lierb's own error, and nothing else.

    python -m faults.arguments 1000000       # in tests/, with a seed as a second argument if wanted

Each call has sane arguments but for one or two, which are taken from VALUES or made of the sane
ones: scaled to any power of ten, repeated, of another type or shape, with one number replaced.
"""

from __future__ import annotations

import array
import datetime
import decimal
import fractions
import itertools
import random
import sys
import time
import types
import warnings
from collections import Counter, UserList, deque
from collections.abc import Callable, Collection, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
from cases import RECORD
from scipy.spatial.transform import Rotation

import lierb
from lierb import errors, methods
from lierb.analysis import convergence
from lierb.kernels.mechanics.rows import JOINT_ROWS, Point
from lierb.model.mechanism.plan import cspaces_of

SECONDS = 5.0  # that a call may take
MESSAGE = 2000  # characters that an error's message may have
MOST_STEPS = 1e5  # of a run that is started
OWN_WARNINGS = (
    errors.FailedTrajectoryWarning,
    errors.InconsistentStateWarning,
    errors.ScalarFunctionWarning,
    errors.StiffStepWarning,
)

# ---- values ------------------------------------------------------------------------------------


class Raising:
    """Raises from whatever it is asked."""

    def _raise(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no")

    __array__ = __float__ = __int__ = __index__ = __len__ = __iter__ = __getitem__ = _raise
    __repr__ = __str__ = __bool__ = __getattr__ = as_matrix = _raise


class Given:
    """An object that NumPy asks for its array."""

    def __init__(self, found: Any) -> None:
        self.found = found

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return self.found

    def __repr__(self) -> str:
        return "Given(…)"


class Matrix:
    """An object with SciPy's way to say its matrix."""

    def __init__(self, found: Any) -> None:
        self.found = found

    def as_matrix(self) -> Any:
        return self.found


class Quantity:
    """A number with units, as pint has it."""

    units, magnitude = "mm", 1.0

    def __float__(self) -> float:
        return 1.0

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return np.ones(3)


class Text(str):
    __slots__ = ()


class Whole(int):
    pass


def _endless() -> list[Any]:
    endless: list[Any] = []
    endless.append(endless)
    return endless


def _deep() -> list[Any]:
    deep: list[Any] = []
    for _ in range(2000):
        deep = [deep]
    return deep


def _read_only() -> np.ndarray:
    values = np.ones(6)
    values.setflags(write=False)
    return values


def _one() -> int:
    return 1


def _one_of_any(*_: Any) -> float:
    return 1.0


SCALARS: list[Any] = [
    None, True, False, 0, 1, -1, 2, 3, 10**5, 2**31, 2**53, 2**63, 2**64, 10**30, 10**400,
    -(10**400), 10**5000, Whole(3), 0.0, -0.0, 1.0, -1.0, 0.1, 5e-324, -5e-324, 1e-310, 1e-300,
    1e-160, 1e10, 1e154, 1e160, 1e300, 1.7e308, -1.7e308, float("nan"), float("inf"),
    float("-inf"), 1j, 0j, complex("nan"), fractions.Fraction(1, 3),
    fractions.Fraction(10**400), decimal.Decimal("0.1"), decimal.Decimal("NaN"),
    decimal.Decimal("sNaN"), decimal.Decimal("1e400"), "", "x", "1.0", "x" * 100_000, "RK4",
    "SE3", "ground", "state", "a\0b", "\ud800", Text("RK4"), b"", b"1.0", bytearray(b"123456"),
    datetime.date(2024, 1, 1), datetime.datetime(2024, 1, 1), datetime.timedelta(1), object(),
    object, int, len, _one, _one_of_any, ..., NotImplemented, types, Raising(), Quantity(),
    Given(np.ones(6)), Given("x"), Given(np.ma.masked_all(3)), Given(np.ones((4, 4))),
    Matrix([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), Matrix("x"), Matrix(None), Matrix(np.eye(4)),
    Matrix(np.ones((2, 3, 3))), Matrix(Raising()), Rotation.identity(), Rotation.identity(2),
    Rotation, JOINT_ROWS["d1"], Point(9),
]  # fmt: skip
NUMPY: list[Any] = [
    np.float16(1.0), np.float32(1e30), np.float64("nan"), np.longdouble(1.0),
    np.longdouble("1e400"), np.int8(1), np.uint64(2**63), np.bool_(True), np.complex64(1),
    np.str_("RK4"), np.bytes_(b"x"), np.datetime64("2024-01-01"), np.timedelta64(1, "s"),
    np.datetime64("NaT", "s"), np.void(b"abc"), np.array(None), np.array("x"), np.array(5),
    np.array([]), np.array([None] * 3), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 6)),
    np.zeros((0, 4, 4)), np.zeros((3, 0)), np.ones(1), np.ones(2), np.ones(3), np.ones(4),
    np.ones(6), np.ones(7), np.ones((3, 3)), np.ones((6, 6)), np.eye(3), np.eye(4),
    np.eye(4)[None], np.ones((2, 4, 4)), np.ones((1,) * 62 + (3,)), np.ones((1,) * 20),
    np.ones(100_000), np.ones((1000, 6)), np.ones((3, 1000)).T, np.ones(6, ">f8"), np.ones(6,
    "f2"), np.ones(6, "c8"), np.ones(6, bool), np.ones(6, "U3"), np.ones(6, "S3"), np.ones(6,
    "i1"), np.ones(6, "g"), np.full(3, np.longdouble("1e4000")), np.ones(3, "m8[s]"), np.ones(3,
    "M8[s]"), np.zeros(3, [("x", "f8"), ("y", "f8")]), np.rec.array([(1.0,)], dtype=[("x",
    "f8")]), np.eye(3).view(np.matrix), np.ones((1, 3)).view(np.matrix), np.ma.masked,
    np.ma.ones(3), np.ma.ones(6), np.ma.masked_equal([1.0, 2.0, 3.0], 2.0), np.ma.masked_all((4,
    4)), np.array([1, "x", None], object), np.array([1, 2, 10**400], object), np.array([True,
    1.0, 2.0], object), np.array(["RK4", "SE3"]), np.array([decimal.Decimal(1)] * 3, object),
    np.array([fractions.Fraction(1, 3)] * 3, object), np.array([1j, 2, 3], object),
    np.array([np.ones(3), None], object), _read_only(), np.ones(12)[::2], np.ones(6)[::-1],
    np.broadcast_to(1.0, (3,)), np.broadcast_to(0.0, (10**13, 6)), np.broadcast_to(1.0,
    (10**13,)), np.broadcast_to(np.eye(4), (10**13, 4, 4)), np.broadcast_to(0.0, (10**13, 3)),
    np.frombuffer(b"12345678" * 3), np.full(3, 1e-320), np.full(6, np.nan), np.full(6, np.inf),
    np.full((4, 4), 1e200), np.full(3, 1.7e308), np.full(6, -0.0),
]  # fmt: skip
OTHERS: list[Any] = [
    (), [], {}, set(), frozenset({1.0}), {1.0, 2.0, 3.0}, {"x": 1.0}, {}.keys(), {"x":
    1.0}.values(), {1.0: 2, 2.0: 3, 3.0: 4}.keys(), [1, 2], (1, 2, 3), [1.0, 2.0, "3"], [1.0,
    None, 2.0], [1, 2, 3j], [True, False, True], [1.0, np.True_, 2.0], [b"1", 2, 3], [[1, 2, 3],
    [4, 5]], [[], []], [[[]]], [1.0, np.ma.masked, 2.0], [np.ma.masked_equal([1, 2, 3], 2)] * 3,
    [Quantity()] * 3, ["RK4"], [np.datetime64("2024-01-01")] * 3, [datetime.timedelta(1)] * 3,
    [Raising()], [object()] * 6, _endless(), _deep(), range(3), range(6), range(10**12),
    deque([1.0, 2.0, 3.0]), UserList([1.0] * 6), array.array("d", [1.0] * 6),
    memoryview(b"123456"), memoryview(array.array("d", [1.0] * 6)), array.array("b", b"abc"),
    pd.Series([1.0, 2.0, 3.0], index=[7, 8, 9]), pd.Series([1.0, None, 2.0]), pd.Series(["a",
    "b", "c"]), pd.DataFrame(np.ones((4, 6))), pd.NA, pd.NaT, pd.Timestamp("2024-01-01"),
    pd.Series([1, None, 2], dtype="Int64"), pd.Series([1.0] * 6, dtype="category"), pd.array([1,
    2, 3]), pa.array([1.0, 2.0, 3.0]), pa.array([1.0, None, 2.0]), pa.array(["a"] * 3),
    pa.scalar(1.0), pa.chunked_array([[1.0, 2.0], [3.0]]), pl.Series([1.0, 2.0, 3.0]),
    pl.Series([1.0, None, 2.0]), pl.Series(["a"] * 3), ("d1", "d2"), ("Omega1",), ["d1",
    10**400], ["screw", "Omega1", "Omega2"], ["rod"], ["d1"] * 1000,
]  # fmt: skip
FRESH: list[Callable[[], Any]] = [  # that a call uses up
    lambda: iter([1.0, 2.0, 3.0]),
    lambda: (x for x in (1.0, 2.0, 3.0)),
    lambda: map(float, range(6)),
    lambda: (1 / 0 for _ in range(3)),
    lambda: itertools.islice(itertools.count(), 1000),
]
TINY_AND_HUGE = (5e-324, 1e-310, 1e-160, 1e-30, 1e30, 1e154, 1e300, 1.7e308, -1.0, -0.0)
ENTRIES = (*TINY_AND_HUGE, float("nan"), float("inf"), float("-inf"), 0.0)
TYPES = ("f2", "f4", ">f8", "g", "i4", "i8", "u1", "c16", "O", "U8", "?")


def _nasty(rng: random.Random) -> Any:
    kind = rng.random()
    if kind < 0.03:
        return rng.choice(FRESH)()
    return rng.choice(SCALARS if kind < 0.4 else NUMPY if kind < 0.75 else OTHERS)


def _perturbed(rng: random.Random, sane: Any) -> Any:
    """Something like the sane value, which goes further before it is refused, or passes."""
    try:
        values = np.array(sane, dtype=np.float64)
    except (TypeError, ValueError):
        return _nasty(rng)
    with np.errstate(all="ignore"):
        for _ in range(rng.choice((1, 1, 2))):
            match rng.randrange(8):
                case 0 | 1:
                    values = values * 10.0 ** rng.uniform(-320.0, 308.0)
                case 2 | 3:
                    values = np.array(values)
                    if values.size:
                        values.flat[rng.randrange(values.size)] = rng.choice(ENTRIES)
                case 4:
                    values = np.repeat(values[None], rng.choice((0, 1, 2, 3, 5)), axis=0)
                case 5:
                    values = values * rng.choice(TINY_AND_HUGE)
                case 6:
                    values = np.asarray(values.tolist()[:-1] if values.ndim else values)
                case 7:
                    values = values + np.asarray(rng.gauss(0.0, 1.0) * 10.0 ** rng.uniform(-9, 3))
        match rng.randrange(6):
            case 0:
                return values.astype(rng.choice(TYPES))
            case 1:
                return values.tolist()
    return values


# ---- calls -------------------------------------------------------------------------------------


class Call(NamedTuple):
    """A function and sane arguments, without which it may be called where they are optional.

    weight : how often it is called, beside the others.
    """

    name: str
    function: Callable[..., Any]
    sane: dict[str, Any]
    weight: float = 1.0
    required: tuple[str, ...] = ()


BOX = (0.0126563, 0.0468281, 0.0569531)
POINT = (-0.15, 0.0375, 0.0)
TWIST = (0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


@cache
def _calls() -> tuple[Call, ...]:
    return tuple(_each_call())


def _each_call() -> Iterator[Call]:
    body = lierb.Body(6.075, BOX)
    ball, hinge = lierb.joints.spherical(POINT), lierb.joints.revolute(POINT)
    frames = {"body_frame": np.eye(4), "ground_frame": np.eye(4)}
    points = {"body_point": POINT, "ground_point": (0.0, 0.0, 0.0)}
    directions = {"slot": (1.0, 0.0, 0.0), "second_axis": (0.0, 1.0, 0.0)}

    moments = {"mass": 6.075, "inertia": BOX, "com": (0.1, 0, 0)}
    yield Call("Body", lierb.Body, moments, 8, ("mass", "inertia"))
    matrix = {"mass": 6.075, "inertia": np.diag(BOX) + 0.5 * np.eye(3), "com": (0.1, 0.0, 0.0)}
    yield Call("Body", lierb.Body, matrix, 4, ("mass", "inertia"))
    parts = {
        "body": body, "joint": hinge, "gravity": (0.0, 0.0, -9.81),
        "forces": [lierb.forces.drag(0.1)], "constraints": (),
    }  # fmt: skip
    yield Call("Problem", lierb.Problem, parts, 4, ("body", "joint"))
    yield from _of_joints(points, frames, directions)

    for name, taken in {
        "box": {"size": (0.1, 0.2, 0.3)}, "cylinder": {"radius": 0.1, "length": 0.2},
        "rod": {"length": 0.2, "radius": 0.01}, "sphere": {"radius": 0.1},
    }.items():  # fmt: skip
        solid = getattr(lierb.bodies, name)
        for given in ({"mass": 1.0}, {"density": 1000.0}):
            yield Call(f"bodies.{name}", solid, taken | given, 1, (*taken, *given))
    yield Call(
        "bodies.from_mesh", lierb.bodies.from_mesh, {"mesh": 5, "mass": 1.0}, 0.02, ("mesh",)
    )

    number, vector = 0.1, (0.1, 0.2, 0.3)
    wrench = {"torque": vector, "force": vector, "point": vector, "frame": "ground"}
    yield Call("forces.constant_wrench", lierb.forces.constant_wrench, wrench, 2)
    spring = {"stiffness": number, "damping": number, "length": number}
    yield Call("forces.spring_damper", lierb.forces.spring_damper, points | spring, 2)
    torsion = {"stiffness": number, "damping": number, "angle": number}
    yield Call("forces.torsional_spring", lierb.forces.torsional_spring, torsion, 2)
    drag = {"linear": number, "quadratic": number, "angular": number, "point": vector}
    yield Call("forces.drag", lierb.forces.drag, drag, 2)
    yield Call("forces.motor", lierb.forces.motor, {"torque": number}, 2, ("torque",))
    yield Call("forces.motor", lierb.forces.motor, {"speed": number}, 1, ("speed",))
    with_function = {"torque": _peak, "peak": 0.1}
    yield Call("forces.motor", lierb.forces.motor, with_function, 0.2, ("torque", "peak"))
    yield Call("wrench()()", _TETHER, {"stiffness": 5.0, "anchor": vector}, 0.2)
    yield Call("wrench", _decorated, {"function": _tether}, 0.2, ("function",))
    yield Call("constraint()()", _ROD, {"length": 0.5}, 0.2)
    yield Call("constraint", lierb.constraint, {"unit": "m", "length": 0.5}, 0.5)

    triangle = {"A": [[], [0.5], [0, 0.5], [0, 0, 1]], "b": [1 / 6, 1 / 3, 1 / 3, 1 / 6]}
    more = {"c": [0, 0.5, 0.5, 1], "name": "mine", "order": 4, "source": ""}
    dense = [[1, -1.5, 2 / 3], *[[0, 1, -2 / 3]] * 2, [0, -0.5, 2 / 3], [0]]
    pair = {"error": [[0.5, -0.5, 0, 0]], "error_order": 1}
    pair |= {"dense": dense, "dense_A": [[0.125] * 4], "dense_order": 3}
    pushed = [[], [[0.5]], [[0, 0.5]], [[0, 0, 1]], [[1 / 6, 0, 0, 0], [0, 1 / 3, 1 / 3, 1 / 6]]]
    free = triangle | {"exponentials": pushed}
    yield Call("ButcherTableau", lierb.ButcherTableau, triangle | more, 4, ("A", "b"))
    yield Call("ButcherTableau", lierb.ButcherTableau, triangle | pair, 2, ("A", "b"))
    yield Call("ButcherTableau", lierb.ButcherTableau, free, 1, ("A", "b"))
    yield Call("method_named", methods.method_named, {"method": "RK4"}, 0.5, ("method",))

    lierb.lie.so3.exp(vector)  # compiled before any call is timed
    yield Call("so3.exp", lierb.lie.so3.exp, {"X": vector}, 2, ("X",))
    refused = {"C1": np.eye(4), "C2": np.eye(3)}  # or it would be compiled, and others of its kind
    yield Call("se3.compose", lierb.lie.se3.compose, refused, 2, ("C1", "C2"))

    steps = {"dts": (1e-2, 1e-3, 1e-4), "errors": (1e-2, 1e-6, 1e-10), "size": 1.0}
    yield Call("observed_order", convergence.observed_order, steps, 2, ("dts", "errors"))
    yield Call("fitted_order", convergence.fitted_order, steps, 1, ("dts", "errors"))
    order = {"errors": (1e-2, 1e-6), "order": convergence.Order(4.0)}
    yield Call("verdict", convergence.verdict, order, 1, ("errors", "order"))
    yield Call("info", lierb.info, {}, 0.02)
    warm = {
        "joints": ["no such joint"],
        "methods": ["RK4"],
        "cspaces": ["SE3"],
        "updates": ["local"],
    }
    warm |= {"solver": "auto", "multipliers": False, "progress": None}
    yield Call("warmup", lierb.warmup, warm, 0.2, ("joints",))
    yield from _of_runs(body, ball, hinge)
    yield from _of_mechanisms(body, hinge)


def _of_joints(points: Any, frames: Any, directions: Any) -> Iterator[Call]:
    needed = {"pitch": 0.1, "length": 0.3}
    for name, entry in lierb.joints.JOINTS.items():
        own = {option: value for option, value in needed.items() if option in entry.options}
        given = points | {"axis": (0.0, 0.0, 1.0)} | own
        more = {option: value for option, value in directions.items() if option in entry.options}
        yield Call(f"joints.{name}", entry, given | more, 0.4, tuple(own))
        yield Call(f"joints.{name}", entry, frames | own, 0.2, tuple(own))
        closed = _then(entry, "closed_pose")
        yield Call(f"joints.{name}().closed_pose", closed, given | more, 0.1, tuple(own))
    rows = {"rows": ("d1", "d2", "Omega1", "Omega2"), "name": "mine"}
    yield Call("from_rows", lierb.joints.from_rows, rows | points, 2, ("rows",))
    for joint in (
        lierb.joints.spherical(POINT), lierb.joints.revolute(POINT), lierb.joints.free(),
        lierb.joints.screw(POINT, pitch=0.1), lierb.joints.universal(POINT),
        lierb.joints.planar(np.zeros((2, 3))), lierb.joints.prismatic((1e300, 1e300, 0.0)),
    ):  # fmt: skip
        count = len(joint.coordinate_names) if joint.subgroup else 2
        own, name, pose = tuple(np.full(count, 0.1)), f"{joint.name}()", joint.closed_pose
        moving = {"omega": (0.1, 0.2, 0.3), "point_velocity": (0.1, 0.0, 0.0), "pose": pose}
        yield Call(f"{name}.twist", joint.twist, moving, 0.6)
        rates = {"velocities": own, "coordinates": own}
        yield Call(f"{name}.twist", joint.twist, rates, 0.4, ("velocities",))
        twist = {"twist": TWIST, "pose": pose}
        yield Call(f"{name}.velocities", joint.velocities, twist, 0.5, ("twist",))
        yield Call(f"{name}.coordinates", joint.coordinates, {"pose": pose}, 0.5, ("pose",))
        yield Call(f"{name}.pose", joint.pose, {"coordinates": own}, 0.5, ("coordinates",))
        yield Call(f"{name}.pose", joint.pose, {"rotation": np.eye(3)}, 0.3, ("rotation",))
        yield Call(f"{name}.pose", _placed(joint), {"place": own}, 0.3, ("place",))


def _of_runs(body: Any, ball: Any, hinge: Any) -> Iterator[Call]:
    """Runs of plans that are compiled once, and what goes with a problem and a result."""
    gravity = (0.0, 0.0, -9.81)
    free = lierb.Problem(body, lierb.joints.free())
    held = lierb.Problem(body, hinge, gravity, constraints=[_ROD(length=0.5)])
    fast = lierb.forces.motor(speed=lambda t: 1.0 / t)
    driven = lierb.Problem(body, hinge, gravity, forces=[fast])
    top = lierb.Problem(body, ball, gravity)
    two = lierb.Problem(lierb.Body((6.0, 1e300), BOX), ball, gravity)
    for problem in (free, held, driven, top, two):
        pose = problem.joint.closed_pose
        yield Call("close", problem.close, {"pose": pose}, 0.1, ("pose",))
        given = {"twist": TWIST, "pose": pose, "t0": 0.0}
        yield Call("project", problem.project, given, 0.3, ("twist",))
        yield Call("of_body", problem.of_body, {"body": 0}, 0.1, ("body",))
        yield Call("repr", _shown, {"problem": problem}, 0.05)
    for problem in (free, top):
        given = {"problem": problem, "pose0": np.eye(4)}
        yield Call("predict", lierb.predict, given, 0.004, ("problem",))
    yield Call("predict", lierb.predict, {"problem": None}, 0.1, ("problem",))

    run = {"twist0": ball.twist(TWIST[:3]), "dt": 0.1, "t_end": 0.2}
    run |= {"save_every": 1, "record": RECORD}
    options = {
        "pose0": ball.closed_pose, "t0": 0.0, "method": "RK4", "cspace": "SE3", "update": "local",
        "measure_every": 1, "check": "raise", "solver": "auto", "threads": 1, "progress": False,
    }  # fmt: skip
    yield Call("integrate", _run_of(top), run | options, 8, tuple(run))
    yield Call("integrate", _integrate, {"problem": free} | run, 0.5, ("problem", *run))
    result = lierb.integrate(top, **run, progress=False)
    compared = {"methods": "RK4", "dts": (0.1, 0.05), "twist0": run["twist0"], "t_end": 0.2}
    compared |= {"reference": result.end}
    more = {
        "pose0": ball.closed_pose, "t0": 0.0, "rtols": None, "atol": None, "cspaces": ("SE3",),
        "measure_every": 1, "norm": "largest", "repeats": 1, "name": "tops", "progress": False,
    }  # fmt: skip
    yield Call("convergence", _compared(top), compared | more, 2, tuple(compared))
    going_on = run | result.end | {"t_end": 0.4, "progress": False}
    yield Call("integrate(**end)", _run_of(top), going_on, 2, ("pose0", *run))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # half a million turns in a step
        failed = lierb.integrate(top, **run | {"twist0": ball.twist((3e7, 0.0, 0.0))})
    for found in (result, failed):
        yield Call("to_pandas", found.to_pandas, {"table": "summary"}, 0.3)
        yield Call("to_polars", found.to_polars, {"table": "history"}, 0.1)
        for name in ("t", "quaternion", "failed", "end", "__repr__", "_repr_html_"):
            yield Call(f"result.{name}", _then(lambda found=found: found, name), {}, 0.05)


def _of_mechanisms(body: Any, hinge: Any) -> Iterator[Call]:
    """Two links and a loop, driven; every link's part of a dictionary is an argument of its own."""
    ball = lierb.joints.spherical(POINT, parent_point=POINT)
    one = {"name": "crank", "body": body, "joint": hinge, "parent": "ground"}
    yield Call("Link", lierb.Link, one, 1, ("name", "body", "joint"))
    pin = {"name": "pin", "joint": ball, "body": "rod", "parent": "crank"}
    yield Call("Loop", lierb.Loop, pin, 1, ("name", "joint", "body"))
    links = [lierb.Link("rod", body, ball, "crank"), lierb.Link(**one)]
    parts = {
        "links": links, "loops": [lierb.Loop(**pin)], "gravity": (0.0, 0.0, -9.81),
        "forces": [lierb.forces.drag(0.1).on("rod", "crank")], "constraints": (),
    }  # fmt: skip
    yield Call("Mechanism", lierb.Mechanism, parts, 3, ("links",))
    placed = {"link": "rod", "other": "crank"}
    yield Call("on", lierb.forces.drag(0.1).on, placed, 1, ("link",))
    driven = [lierb.forces.motor(speed=lambda t: 1.0 / t).on("crank")]
    heavy = lierb.Link("crank", lierb.Body((6.0, 1e300), BOX), hinge)
    for arm in (
        lierb.Mechanism(links), lierb.Mechanism(**parts), lierb.Mechanism(links, forces=driven),
        lierb.Mechanism([links[0], heavy]),
    ):  # fmt: skip
        yield from _of_an_arm(arm)
    arm = lierb.Mechanism(links)
    asked = {"cspace": "SE3"}
    yield Call("cspaces_of", lambda cspace: cspaces_of(arm, cspace), asked, 0.3, ("cspace",))
    yield Call("predict", lierb.predict, {"problem": arm}, 0.004, ("problem",))

    def run(crank: Any, rod: Any, crank_pose: Any, rod_pose: Any, **given: Any) -> Any:
        twist0 = {"crank": crank, "rod": rod}
        pose0 = {"crank": crank_pose, "rod": rod_pose}
        return _integrate(problem=arm, twist0=twist0, pose0=pose0, **given)

    pose0, twist0 = arm.pose(), arm.twist({"crank": 0.1})
    sane = {n: twist0[n] for n in arm.names} | {f"{n}_pose": pose0[n] for n in arm.names}
    sane |= {"dt": 0.1, "t_end": 0.2, "save_every": 1, "record": RECORD}
    options = {
        "t0": 0.0, "update": "local", "check": "raise", "solver": "auto", "stabilise": None,
        "threads": 1, "progress": False,
    }  # fmt: skip
    result = run(**sane, progress=False)  # compiled before any call is timed
    yield Call("integrate(mechanism)", run, sane | options, 4, tuple(sane))
    yield Call("result[name]", result.__getitem__, {"name": "rod"}, 0.3, ("name",))


def _of_an_arm(arm: lierb.Mechanism) -> Iterator[Call]:
    pose, twist = arm.pose(), arm.twist()
    turns = {"crank": 0.1, "rod": (0.1, 0.2, 0.3)}

    def of_both(function: Any) -> Any:
        return lambda crank, rod: function({"crank": crank, "rod": rod})

    def with_poses(function: Any) -> Any:
        return lambda crank, rod, crank_pose, rod_pose, **more: function(
            {"crank": crank, "rod": rod}, {"crank": crank_pose, "rod": rod_pose}, **more
        )

    poses = {f"{name}_pose": pose[name] for name in arm.names}
    names = tuple(arm.names)
    for name, sane in {"pose": turns, "coordinates": pose, "close": pose, "freedoms": pose}.items():
        function = getattr(arm, name)
        argument = "coordinates" if name == "pose" else "pose"
        yield Call(f"arm.{name}", of_both(function), sane, 0.4, names)
        yield Call(f"arm.{name}", function, {argument: sane}, 0.1, (argument,))
    for name, sane in {"twist": turns, "velocities": twist, "project": twist}.items():
        function = with_poses(getattr(arm, name))
        more = {"t0": 1.0} if name == "project" else {}
        yield Call(f"arm.{name}", function, sane | poses | more, 0.4, (*names, *poses))
    yield Call("arm.of_body", arm.of_body, {"body": 0}, 0.1, ("body",))
    yield Call("arm.link", arm.link, {"name": "rod"}, 0.1, ("name",))


def _peak(t: Any, params: Any) -> Any:
    return params.peak * t


def _tether(t: Any, R: Any, r: Any, omega: Any, v: Any, params: Any) -> Any:
    return (0.0, 0.0, 0.0), R.T @ (r - params.anchor)


def _rod(R: Any, r: Any, params: Any) -> Any:
    return (r @ r / params.length - params.length) / 2


_TETHER = lierb.wrench(stiffness=10.0, anchor=(0.0, 0.0, 1.0))(_tether)
_ROD = lierb.constraint(length=0.5)(_rod)


def _decorated(function: Any) -> Any:
    return lierb.wrench(function), lierb.wrench(anchor=1.0)(function)


def _placed(joint: Any) -> Any:
    return lambda place: joint.pose(place)


def _shown(problem: Any) -> Any:
    return (repr(problem), problem._repr_html_()) if isinstance(problem, lierb.Problem) else None


def _then(function: Any, name: str) -> Any:
    """The function, and an attribute of what it returns."""

    def call(**given: Any) -> Any:
        found = getattr(function(**given), name)
        return found() if callable(found) else found

    return call


def _run_of(problem: Any) -> Any:
    return lambda **given: _integrate(problem=problem, **given)


def _integrate(**given: Any) -> Any:
    if 1e17 > _steps(given) > MOST_STEPS or _is_of_another_plan(given):
        return None  # it would run for long, or be compiled
    return lierb.integrate(**given)


def _compared(problem: Any) -> Any:
    def compare(**given: Any) -> Any:
        times = {name: given.get(name, 0.0) for name in ("t_end", "t0")}
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                least = float(np.min(np.abs(np.asarray(given.get("dts"), dtype=float))))
            except Exception:
                least = np.inf
        repeats = given.get("repeats", 0)
        is_long = isinstance(repeats, (int, np.integer)) and repeats > 5
        if given.get("reference") is None or is_long or _steps(times | {"dt": least}) > 1e3:
            return None  # it would run for long, or be compiled
        return lierb.convergence(problem, **given)

    return compare


def _steps(given: dict[str, Any]) -> float:
    """0 if lierb refuses the times."""
    dt, t_end, t0 = (given.get(name, 0.0) for name in ("dt", "t_end", "t0"))
    if not all(isinstance(x, (int, float, np.integer, np.floating)) for x in (dt, t_end, t0)):
        return 0.0
    with np.errstate(all="ignore"):
        try:
            return float((np.float64(t_end) - np.float64(t0)) / np.float64(dt))
        except (OverflowError, TypeError):
            return 0.0


def _is_of_another_plan(given: dict[str, Any]) -> bool:
    """Return whether other columns are recorded, which needs a plan of its own."""
    record = given.get("record", ())
    if not isinstance(record, Collection):  # none of VALUES that runs over names
        return False
    try:
        names = {record} if isinstance(record, str) else set(itertools.islice(record, 9))
    except Exception:
        return False
    return names <= {*RECORD, "energy"} and not names >= set(RECORD[1:])


# ---- the campaign ------------------------------------------------------------------------------


def campaign(count: int, seed: int) -> Counter[str]:
    """So many calls; how each ended. Raises AssertionError for the first that ends otherwise."""
    rng = random.Random(seed)
    calls = _calls()
    weights = list(itertools.accumulate(call.weight for call in calls))
    outcomes: Counter[str] = Counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for number in range(count):
            (call,) = rng.choices(calls, cum_weights=weights)
            given, is_misnamed = _arguments(rng, call)
            began = time.process_time()  # not of a busy machine's other work
            outcome = _outcome(call, given, is_misnamed)
            seconds = time.process_time() - began
            leaked = [w for w in told if not issubclass(w.category, OWN_WARNINGS)]
            if leaked:
                outcome = f"warned {leaked[0].category.__name__}: {leaked[0].message}"
            if seconds > SECONDS:
                outcome = f"took {seconds:.1f} s"
            told.clear()
            outcomes[outcome] += 1
            if " " in outcome:
                shown = ", ".join(f"{name}={_told(value)}" for name, value in given.items())
                raise AssertionError(
                    f"{call.name}({shown}) {outcome}; call {number} of seed {seed}"
                )
    return outcomes


def _arguments(rng: random.Random, call: Call) -> tuple[dict[str, Any], bool]:
    """Arguments of a call, one or two of them hostile, and whether one is misnamed or missing."""
    given = {n: v for n, v in call.sane.items() if n in call.required or rng.random() < 0.5}
    chosen = rng.sample(list(call.sane), min(len(call.sane), rng.choice((1, 1, 1, 2))))
    for name in chosen:
        value = _nasty(rng) if rng.random() < 0.5 else _perturbed(rng, call.sane[name])
        if not (name == "progress" and callable(value)):  # what it raises is its own
            given[name] = value
    is_misnamed = rng.random() < 0.005
    if is_misnamed:
        given["no_such"] = 1.0
    return given, is_misnamed


def _outcome(call: Call, given: dict[str, Any], is_misnamed: bool) -> str:
    """One word; a sentence where it is not allowed."""
    try:
        call.function(**given)
    except errors.LierbError as error:
        if 0 < len(str(error)) < MESSAGE:
            return type(error).__name__
        return f"raised {type(error).__name__} with {len(str(error))} characters"
    except TypeError as error:
        if is_misnamed or set(call.required) - set(given):
            return "TypeError"
        return f"raised TypeError: {_told(error)}"
    except Exception as error:
        return f"raised {type(error).__name__}: {_told(error)}"
    return "result"


def _told(value: Any) -> str:
    try:
        if not isinstance(value, np.ndarray):
            return repr(value)[:300]
        first = list(itertools.islice(value.flat, 6))
        return f"<{type(value).__name__} {value.shape} {value.dtype}: {first}>"
    except Exception:
        return f"<{type(value).__name__}>"


if __name__ == "__main__":
    count = int(sys.argv[1])
    began = time.perf_counter()
    found = campaign(count, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    seconds = time.perf_counter() - began
    print(f"{count} calls in {seconds:.0f} s ({count / seconds:.0f} per s): {dict(found)}")

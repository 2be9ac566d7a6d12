"""Every public formula of the kernels, from groups to loops, on every number type.

What there is, is read off the modules; what a formula is given, is recorded while small runs in
plain Python go through all of them. There each one is differentiated by dual numbers, on floats and
on packs of lanes, and compared with central differences of itself in mpmath.
"""

import copy
import ctypes
import gc
import importlib
import inspect
import math
import os
import pkgutil
import subprocess
import sys
from collections import defaultdict
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest
from cases import integrate, tilted
from llvmlite import ir
from numba import config
from oracle import mp

import lierb
from kernels import controlled_body
from kernels.exact import Exact
from lierb import forces
from lierb.kernels import groups, loops, mechanics, stepping, systems
from lierb.kernels.groups import so3
from lierb.kernels.groups.lie_functions import GROUPS
from lierb.kernels.numbers.arithmetic import alike, plain
from lierb.kernels.numbers.dual import Dual, parts_of, value_of
from lierb.kernels.numbers.zero import Zero
from lierb.kernels.stepping.clock import TIDY_EVERY
from lierb.kernels.tracing.lanes import DOUBLE, Lane, Trace

ROOT = Path(__file__).parents[2]
# Packs of numbers, and numbers alone; more widths add no code.
LANES = (8, pytest.param(1, marks=pytest.mark.long))
MOST = 6  # samples of one formula
CALLS = 12  # of a formula in one run, that are looked at
STEP = mp.mpf(10) ** -20
POINT, ANCHOR = (0.05, 0.02, 0.01), (0.1, 0.2, 0.3)

LOOPS = {  # code of Numba's, and what it works on
    "groups.lie_functions.apply", "loops.blocks.integrate_blocks",
    "loops.job.job_of", "loops.job.jobs_of", "loops.sharing.integrate_on_threads",
    "loops.sharing.pack", "loops.tables.tables_at",
    "stepping.clock.StepClock.end", "stepping.clock.StepClock.saved_times",
    "stepping.clock.time_of",
}  # fmt: skip
NO_NUMBERS = {  # abstract, or of other things
    "loops.ends.resumed_lane",
    "mechanics.axis_rows.AxisRow.moved",
    "mechanics.constraints.smooth_residuals",  # for systems.descriptor
    "mechanics.rows.Row.prescribed_slope",  # likewise
    "mechanics.passive_elements.AddedStates.at_start",
    "mechanics.passive_elements.AddedStates.rates",
    "mechanics.elements.Element.depends_on_velocity", "mechanics.elements.Element.feels",
    "mechanics.elements.Element.is_listed",
    "mechanics.elements.Element.placed", "mechanics.elements.Element.row",
    "mechanics.elements.Element.tangents",
    "mechanics.rows.Cosine.holds_turn", "mechanics.rows.GroundPoint.holds_slide",
    "mechanics.rows.JointRow.objection",
    "mechanics.rows.Rod.objection", "mechanics.rows.Row.error_kind",
    "mechanics.rows.Row.holds_slide", "mechanics.rows.Row.jacobian",
    "mechanics.rows.Screw.objection", "mechanics.rows.Turning.objection", "mechanics.rows.slides",
    "mechanics.subgroup.is_commutative",
    "stepping.stages.StageMethod.end_factors", "stepping.stages.StageMethod.slope_units",
    "stepping.stages.StageMethod.started", "stepping.stages.StageMethod.with_stages",
    "systems.combine.StateArithmetic.silenced",  # after a failure
    "systems.formulations.SaddlePoint.is_light", "systems.formulations.Subgroup.is_homogeneous",
    "systems.formulations.Subgroup.free",
    "systems.one_body.OneBody.completed", "systems.one_body.OneBody.settled",
}  # fmt: skip

# Of mechanisms: methods of objects that hold the numbers. tests/mechanisms holds them against other
# formulations, and test_spatial.py what they are made of against matrices.
OF_MECHANISMS = (
    "mechanics.constraints.errors_squared",
    "mechanics.saddle.Elimination.",
    "groups.ambient.turned",
    "groups.increments.Ambient.pose",
    "groups.turns.",
    "loops.states_in_memory.",
    "mechanics.added_inertia.",
    "mechanics.spatial.",
    "mechanics.tree.",
    "mechanics.tree_connections.",
    "mechanics.tree_dynamics.",
    "mechanics.tree_nodes.",
    "mechanics.tree_rows.",
    "systems.connection_table.",
    "systems.plan.",
    "systems.relatives.",
    "systems.scheme.",
    "systems.stabilisation.",
    "systems.tree_",
    "systems.system_of.",
)

# What lanes with clocks of their own ask: what chooses steps and finds crossings decides, and is no
# function of a motion to differentiate; the rest sees such a lane alone. tests/clocks holds it
# against truths.
OF_CLOCKS = (
    "mechanics.elements.Element.jumps",
    "mechanics.elements.Element.travel",
    "mechanics.passive_elements.UserEvent.value_nearby",
    "mechanics.user_wrench.UserWrench.jumps",
    "mechanics.user_wrench.times_of_jumps",
    "mechanics.kinks.travel_to_kink",
    "systems.one_body.OneBody.places",
    "systems.one_body.OneBody.turning_and_moving",
    "systems.extra_states.",
    "systems.signals.PassiveElements.events_nearby",
    "systems.signals.PassiveElements.jumps",
    "systems.signals.PassiveElements.travel",
    "stepping.method.Interval.part",
    "stepping.stages.StageMethod.between",
    "stepping.stages.StageMethod.defects",
    "stepping.stages.StageMethod.extended",
    "stepping.stages.StageMethod.extrapolated",
    "stepping.stages.beside_the_step",
    "loops.event_dips.",
    "loops.event_search.",
    "loops.event_state.",
    "loops.workspace.",
    "stepping.lane_clock.",
    "loops.lanes.",
    "loops.lane_between.",
    "loops.lane_samples.",
    "loops.lane_state.",
    "loops.lane_steps.",
    "loops.ticks.",
    "stepping.step_size.",
    "stepping.travel.",
)

# Methods that solve equations: test_rosenbrock and test_structure_preserving hold them against
# their orders, other formulations and published runs.
OF_SOLVERS = (
    "stepping.bliedf.",
    "stepping.descriptor_method.",
    "stepping.generalised_alpha.",
    "stepping.rattle.",
    "stepping.shake.",
    "stepping.rosenbrock.",
    "stepping.unestimated.",
    "stepping.verlet.",
    "systems.descriptor.",
    "systems.unknowns.",
)

# What makes dual numbers, drops their derivatives or freezes axes. tests/derivatives holds it
# against complex steps and closed forms.
OF_DERIVATIVES = (
    "loops.adjoint.",
    "loops.gains.",
    "loops.remade_steps.",
    "loops.record.load_",
    "loops.record.observe",
    "loops.record.store_carried",
    "loops.tables.store_state",
    "loops.tables.store_summary",
    "loops.tables.user_state",
    "mechanics.user_frames.moving",
    "mechanics.user_frames.second",
    "mechanics.ground_motion.",
    "mechanics.newton_euler.principal_axes_at_point",
    "stepping.differentiable.",
    "stepping.taped.",
    "systems.derivatives.",
    "systems.one_body.OneBody.body",
)


if config.DISABLE_JIT:
    gc.set_threshold(20_000)  # formulas make millions of numbers and instructions

in_python = pytest.mark.skipif(not config.DISABLE_JIT, reason="run below, with the JIT off")


@pytest.mark.slow
@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="run directly")
@pytest.mark.parametrize("which", ["not long", pytest.param("long", marks=pytest.mark.long)])
def test_every_formula_with_the_jit_off(tmp_path, which):
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", which]
    command = [sys.executable, "-m", "pytest", *options, __file__]
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-1000:]


# ---------------------------------------------------------------- what there is


def public(package):
    """(name, function) of all public functions and methods in the modules of a package."""
    for info in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        module = importlib.import_module(info.name)
        for name, item in vars(module).items():
            if name.startswith("_") or getattr(item, "__module__", None) != module.__name__:
                continue
            prefix = f"{info.name.removeprefix('lierb.kernels.')}.{name}"
            if inspect.isfunction(item):
                yield prefix, inspect.unwrap(item)
            is_described = inspect.isclass(item) and not getattr(item, "_is_protocol", False)
            for method, of in vars(item).items() if is_described else ():
                of = getattr(of, "fget", None) or getattr(of, "func", None) or of
                of = getattr(of, "__func__", of)
                is_own = inspect.isfunction(of) and of.__module__ == module.__name__
                if is_own and not method.startswith("_"):  # a named tuple has others
                    yield f"{prefix}.{method}", of


FUNCTIONS = {
    name: f
    for package in (groups, mechanics, systems, stepping, loops)
    for name, f in public(package)
    if not name.startswith((*OF_MECHANISMS, *OF_CLOCKS, *OF_SOLVERS, *OF_DERIVATIVES))
}


@lierb.velocity_constraint
def without_slip(R, omega, v):
    return (R @ v)[1] - 0.3 * omega[2]


def nodding(t):
    return 0.1 * math.sin(3.0 * t)


@lierb.wrench(rate=3.0)
def swaying(t, R, r, omega, v, params):
    return -0.01 * omega, R.T @ np.array((np.sin(params.rate * t), 0.0, 1.0)) - 0.1 * v


@lierb.constraint
def level(R, r):
    return R[2, 0] * R[2, 1] - 0.05


@lierb.wrench
def pulling(t, R, r, omega, v):
    return 0.0 * omega, R.T @ (-2.0 * r)


@lierb.observable
def height(r, params, t):
    return r[2] * r[2] + t


@lierb.observable
def pull(specific_force):
    return specific_force @ specific_force


@pulling.potential
def well(R, r):
    return r @ r


def runs():
    """Small runs that go through all formulas."""
    for name in lierb.joints.JOINTS:
        problem, twist = tilted(name)
        yield problem, twist, {}
        if name in ("spherical", "free"):
            yield problem, twist, {"update": "ambient"}
        if name in ("spherical", "universal", "screw", "revolute"):
            yield problem, twist, {"solver": "saddle"}
            yield problem, 30.0 * twist, {"cspace": "SO3xR3", "update": "global"}
            for cspace in ("SE3", "SO3xR3"):
                for speed in (1.0, 60.0):  # both ways of a quaternion back to unit length
                    ambient = {"cspace": cspace, "update": "ambient", "solver": "saddle"}
                    yield problem, speed * twist, ambient
    for name, force in (
        ("free", forces.constant_wrench((0.01, 0.0, 0.02), (0.0, 1.0, 0.0), point=POINT)),
        ("revolute", forces.constant_wrench(force=(0.0, 0.0, 2.0), frame="body")),
        ("spherical", forces.spring_damper(POINT, ANCHOR, stiffness=9.0, damping=0.5, length=0.1)),
        ("revolute", forces.torsional_spring(stiffness=2.0, damping=0.1)),
        ("planar", forces.drag(0.1, 0.2, angular=0.01, point=POINT)),
        ("cylindrical", forces.motor(torque=0.1)),
        ("screw", forces.motor(speed=1.0)),
        ("revolute", forces.motor(position=nodding)),
        ("spherical", swaying()),
        ("spherical", level()),
        ("free", pulling()),
        ("free", without_slip()),
    ):
        problem, twist = tilted(name)
        is_force = isinstance(force, lierb.model.functions.wrenches.Force)
        added = "forces" if is_force else "constraints"
        problem = lierb.Problem(problem.body, problem.joint, problem.gravity, **{added: [force]})
        options = {"check": "off"} if added == "constraints" else {}
        yield problem, problem.project(twist), options
    problem, twist = tilted("revolute")
    problem = lierb.Problem(
        problem.body, problem.joint, observables=[height(), pull()], states=lierb.turns()
    )
    yield problem, twist, {"save_every": 1, "measure_every": 2}


def go_through_all(before_each):
    for problem, twist, options in runs():
        options = {"method": "Ralston"} | options
        before_each()
        first = integrate(problem, twist0=twist, dt=1e-3, t_end=2e-3, **options)
        if problem.joint.name == "spherical":
            end = TIDY_EVERY + 2
            integrate(problem, **first.end, dt=1e-3, t_end=end * 1e-3, save_every=end, **options)
    before_each()
    controlled_body.go_through()
    for name in ("planar", "fixed"):
        problem, _ = tilted(name)
        problem.close(problem.joint.closed_pose @ lierb.lie.se3.exp([1e-3] * 6))
    for group in GROUPS.values():
        of = getattr(lierb.lie, group.__name__.split(".")[-1])
        X = np.array([[0.3, -0.5, 0.7, 1.0, 2.0, 3.0]])[:, : 3 if group is so3 else 6]
        C = of.exp(X)
        of.log(C), of.inverse(C), of.compose(C, C), of.Ad(C, X), of.ad(X, X)
        of.dexp(X, X), of.dexpinv(X, X)
        group.angle_coefficients(tuple(X[0]))


# ---------------------------------------------------------------- what a formula is given


def mapped(x, leaf):
    """Replace each number, in tuples, lists, arrays that runs keep, and objects."""
    if isinstance(x, float):
        return leaf(x)
    if isinstance(x, tuple):
        return alike(x, [mapped(y, leaf) for y in x])
    if isinstance(x, list):
        return [mapped(y, leaf) for y in x]
    if isinstance(x, dict):
        return {key: mapped(y, leaf) for key, y in x.items()}
    if is_batch(x):
        return leaf(float(x.flat[0]))
    if isinstance(x, np.ndarray) and x.dtype in (float, object):
        made = np.empty(x.shape, dtype=object)
        for place in np.ndindex(x.shape):
            made[place] = leaf(x[place])
        return made
    if isinstance(x, Dual):
        return type(x)(mapped(x.value, leaf), mapped(x.parts, leaf))
    if is_own(x):
        made = copy.copy(x)
        made.__dict__ = mapped(vars(x), leaf)
        return made
    return x


def is_batch(x):
    """Return whether this is a number of many bodies, outside of runs: the first one is taken."""
    return isinstance(x, np.ndarray) and x.dtype == float and x.ndim < 2 and x.size > 0


def is_own(x):
    """An object with numbers in it."""
    is_lierbs = type(x).__module__.startswith("lierb.kernels")
    return is_lierbs and not is_dataclass(x) and bool(getattr(x, "__dict__", None))


def shape_of(x):
    """Structure of a formula's arguments without the numbers: kinds of rows, elements, zeros."""
    if isinstance(x, (tuple, list)):
        return type(x), tuple(map(shape_of, x))
    if isinstance(x, dict):
        return tuple(x)
    if is_dataclass(x) or isinstance(x, (str, Zero)):
        return x
    return float if isinstance(x, float) or is_batch(x) else type(x)


@cache
def recorded():
    """Arguments of every formula, of each kind that occurs: those of the first such call."""
    # By identity: equal code on the same line of two files is equal, too.
    names = {id(f.__code__): name for name, f in FUNCTIONS.items() if name not in LOOPS}
    samples, calls = defaultdict(dict), defaultdict(int)

    def look(frame, event, _):
        code = id(frame.f_code)
        if event != "call" or code not in names or calls[code] >= CALLS:
            return
        calls[code] += 1
        arguments = frame.f_code.co_varnames[: frame.f_code.co_argcount]
        given = tuple(frame.f_locals[name] for name in arguments)
        kind = shape_of(given)
        if kind not in samples[names[code]]:
            # uninitialised memory may hold anything
            samples[names[code]][kind] = mapped(given, lambda x: 1.0 if abs(x) > 1e9 else x)

    sys.setprofile(look)
    try:
        go_through_all(calls.clear)
    finally:
        sys.setprofile(None)
    return {name: few(list(kinds.values())) for name, kinds in samples.items()}


def few(kinds):
    return [kinds[i * len(kinds) // MOST] for i in range(MOST)] if len(kinds) > MOST else kinds


def beside(given, zeros):
    """Perturb arguments, away from branches decided by rounding; `zeros` in place of zeros."""
    rng = np.random.default_rng(1)
    return mapped(given, lambda x: float((x or zeros) * (1.0 + 1e-3 * rng.uniform(0.5, 1.0))))


def directions(given):
    """A direction for each number; zeros stay."""
    rng = np.random.default_rng(2)
    direction = []
    mapped(given, lambda x: direction.append(rng.uniform(-1.0, 1.0) * (x != 0.0)) or x)
    return direction


# ---------------------------------------------------------------- what it gives


def numbers_of(x):
    """All numbers in what a formula returns, or has written."""
    if isinstance(x, (tuple, list)):
        return [n for y in x for n in numbers_of(y)]
    if isinstance(x, np.ndarray):
        return numbers_of(x.ravel().tolist())
    return [plain(x)] if isinstance(x, (float, Zero, Dual, Exact, Lane)) else []


def evaluated(name, given, leaf=lambda x: x):
    made = mapped(given, leaf)
    with np.errstate(all="ignore"):
        result = FUNCTIONS[name](*made)
    return numbers_of((result, [x for x in made if has_arrays(x)]))


def has_arrays(x):
    return any(map(has_arrays, x)) if isinstance(x, tuple) else isinstance(x, np.ndarray)


def by_duals(name, given):
    along = iter(directions(given))
    duals = evaluated(name, given, lambda x: Dual(x, (next(along),)))
    return np.array([(float(value_of(x)), float(sum(parts_of(x), 0.0))) for x in duals]).T


def by_differences(name, given):
    """Values and derivatives, in mpmath; NaN where there is none, at a kink."""

    def moved(step):
        along = iter(directions(given))
        numbers = evaluated(name, given, lambda x: Exact(mp.mpf(x) + step * next(along)))
        return np.array([x.value if isinstance(x, Exact) else mp.mpf(x) for x in numbers])

    before, here, after = map(moved, (-STEP, 0, STEP))
    slopes = ((after - before) / (2 * STEP)).astype(float)
    bends = ((after - 2 * here + before) / STEP).astype(float)
    return here.astype(float), np.where(abs(bends) < 1e-6 * (1.0 + abs(slopes)), slopes, np.nan)


def errors(found, exact):
    """Relative to the largest of a formula's numbers, or to one."""
    known = np.isfinite(exact)
    scale = max(1.0, abs(exact[known]).max(initial=0.0))
    return np.nan_to_num(abs(found - exact)[known], nan=np.inf).max(initial=0.0) / scale


# ---------------------------------------------------------------- on packs of lanes


def on_lanes(width, points):
    """Value, derivative and value without derivatives of each formula at its point: lane by lane.

    One LLVM module for all, not optimised. Lane i has i + 1 times the directions.
    """
    module = ir.Module()
    pointer = DOUBLE.as_pointer()
    memory = []
    for n, (name, given) in enumerate(points):
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), [pointer] * 2), f"f{n}")
        trace = Trace(ir.IRBuilder(function.append_basic_block()))
        results = traced(trace, function.args[0], width, name, given)
        for i, number in enumerate(results):
            pack = (number if isinstance(number, Lane) else of_pack(number, width, trace)).widened(
                width
            )
            trace.builder.store(pack.value, place(trace, function.args[1], i, width), align=8)
        trace.builder.ret_void()
        memory.append((inputs(given, width), np.full((3, len(results) // 3, width), np.nan)))
    return run(module, memory)


def traced(trace, start, width, name, given):
    """Values, derivatives, and values without derivatives, as lanes."""
    builder, counter = trace.builder, iter(range(10**6))

    def load():
        return Lane(trace, builder.load(place(trace, start, next(counter), width), align=8))

    made = evaluated(name, given, lambda x: Dual(load(), (load(),)))
    counter = iter(range(0, 10**6, 2))
    alone = evaluated(name, given, lambda x: load())
    return [*map(value_of, made), *(sum(parts_of(x), 0.0) for x in made), *alone]


def place(trace, start, i, width):
    pointer = trace.builder.gep(start, [ir.Constant(ir.IntType(64), i * width)])
    pack = ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE
    return trace.builder.bitcast(pointer, pack.as_pointer())


def of_pack(number, width, trace):
    pack = ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE
    return Lane(trace, ir.Constant(pack, None)).constant(number)


def inputs(given, width):
    """Each number and its direction, lane by lane."""
    values = []
    mapped(given, lambda x: values.append(x) or x)
    rows = np.array([values, directions(given)]).T[:, :, None] * np.ones(width)
    rows[:, 1] *= np.arange(1, width + 1)
    return np.ascontiguousarray(rows)


def run(module, memory):
    """Fill what comes out of each function of the module."""
    text = str(module)
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=0
    )
    compiled = llvm.parse_assembly(text)
    engine = llvm.create_mcjit_compiler(compiled, target)
    engine.finalize_object()
    for n, (given, out) in enumerate(memory):
        call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
        call(engine.get_function_address(f"f{n}"))(given.ctypes.data, out.ctypes.data)
    return [out for _, out in memory]


# ---------------------------------------------------------------- tests

NAMES = [name for name in FUNCTIONS if name not in LOOPS] if config.DISABLE_JIT else []


@cache
def points(name):
    """Points of differentiation: near all samples of a formula, with and without its zeros."""
    samples = [given for given in recorded().get(name, ()) if directions(given)]
    return [beside(given, zeros) for given in samples for zeros in (0.0, 1e-3)]


@cache
def duals(name):
    return [by_duals(name, given) for given in points(name)]


@cache
def exact(name):
    return [by_differences(name, given) for given in points(name)]


def small_sample(name):
    """One that LLVM has done soon: of a whole step, the one with the fewest numbers."""
    sizes = [len(directions(given)) for given in points(name)]
    return 0 if sizes[0] < 80 else sizes.index(min(sizes))


@in_python
def test_every_formula_is_gone_through():
    assert {name for name in NAMES if name not in recorded()} <= NO_NUMBERS


@in_python
@pytest.mark.parametrize("name", NAMES)
def test_formula_on_duals_is_differentiated(name):
    for found, (values, slopes) in zip(duals(name), exact(name)):
        if found.size:
            # a few roundings, in the worst conditioned
            assert errors(found[0], values) <= 1e-12
            assert errors(found[1], slopes) <= 1e-12


@in_python
@pytest.mark.parametrize("name", NAMES)
def test_values_of_duals_have_the_bits_of_plain_numbers(name):
    samples = recorded().get(name, ())
    given_and_found = [*zip(samples, (by_duals(name, given) for given in samples))]
    for given, found in [*given_and_found, *zip(points(name), duals(name))]:
        if found.size:
            np.testing.assert_array_equal(found[0], [float(x) for x in evaluated(name, given)])


@in_python
@pytest.mark.parametrize("width", LANES)
def test_formulas_on_duals_of_lanes_are_differentiated(width):
    chosen = [(name, small_sample(name)) for name in NAMES if points(name)]
    found = on_lanes(width, [(name, points(name)[i]) for name, i in chosen])
    for (name, i), (values, slopes, alone) in zip(chosen, found):
        np.testing.assert_array_equal(values, alone, err_msg=name)
        for lane in range(width if values.size else 0):
            value, slope = exact(name)[i]
            assert errors(values[:, lane], value) <= 1e-12, name
            assert errors(slopes[:, lane] / (lane + 1), slope) <= 1e-12, name

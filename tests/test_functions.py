"""Functions of the user's: forces and constraints from Python, and when they are compiled anew."""

from __future__ import annotations

import functools
import math
import types
import warnings
from collections import namedtuple

import numba
import numpy as np
import oracle
import pytest
from cases import (
    BODY_FRAME,
    GRAVITY,
    GROUND_FRAME,
    box,
    column,
    final,
    integrate,
    long_but,
    tilted,
)

import lierb
from lierb.errors import (
    ArgumentError,
    ForceError,
    PoseError,
    ScalarFunctionWarning,
    UnknownNameError,
)
from lierb.kernels.functions.fingerprint import fingerprint
from lierb.kernels.functions.references import UnfitFunctionError

CSPACES = ("SE3", "SO3xR3")
FALL = {"dt": 0.125, "t_end": 1.0, "method": "Euler"}  # the least to compile, exact in binary


def fallen(force, bodies: int = 1, **parameters) -> np.ndarray:
    """v after 1 s of a free body of 2 kg on which only that force acts, by Euler's method."""
    problem = lierb.Problem(
        lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.free(), forces=force(**parameters)
    )
    return column(lierb.integrate(problem, twist0=np.zeros((bodies, 6)), **FALL).summary, "v")


# ---- what a function may do --------------------------------------------------------------------

OFFSET = 0.25


def doubled(x):
    return 2.0 * x


@numba.njit
def compiled_double(x):
    return 2.0 * x


def with_closure(factor):
    def push(t, R, r, omega, v, params):
        return np.zeros(3), (factor * params.size, 0.0, OFFSET)

    return push


def with_helpers(t, R, r, omega, v, params):
    return [0, 0, 0], np.array([doubled(params.size), compiled_double(params.size), 0])


def with_math(t, R, r, omega, v, params):
    size = math.sqrt(params.size**2) * math.cos(0.0 * t) * max(1.0, 0.5 * t)
    return (0, 0, 0), (size, abs(-params.size), min(params.size, 7.0))


def with_where(t, R, r, omega, v, params):
    late = (t >= 0.5) & (params.size > 0.0)
    return (0, 0, 0), lierb.where(late, (params.size, 0.0, 0.0), (0.0, params.size, 0.0))


def with_where_of_constants(t, R, r, omega, v, params):
    on = lierb.where(t >= 0.5, 1.0, 0.0)
    return (0, 0, 0), (params.size * on, 0, lierb.where(t < 0.5, 1, 0))


def with_signs(t, R, r, omega, v, params):
    sign = np.sign(t + 1.0)
    return (0, 0, 0), (params.size * sign, math.copysign(1.0, -1.0 - t), math.sqrt(sign))


def with_arrays(t, R, r, omega, v, params):
    along = R.T @ np.array([0.0, 0.0, 1.0])
    return np.cross(along, along), params.size * along / np.linalg.norm(along) + 0.0 * r


# v after 1 s, of 2 kg, if size is 1; and if it is 0, unless that is nothing.
ALLOWED = {
    with_closure(3.0): ((1.5, 0, 0.125), (0, 0, 0.125)),
    with_helpers: ((1, 1, 0),),
    with_math: ((0.5, 0.5, 0.5),),
    with_where: ((0.25, 0.25, 0),),
    with_where_of_constants: ((0.25, 0, 0.25), (0, 0, 0.25)),
    with_signs: ((0.5, -0.5, 0.5), (0, -0.5, 0.5)),
    with_arrays: ((0, 0, 0.5),),
}


@pytest.mark.slow
def test_function_may_use_what_is_allowed():
    """All of them act on every body, in one kernel; in body k function k has another size."""
    sizes = np.eye(len(ALLOWED))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # none of these runs body by body
        forces = [lierb.wrench(f)(size=size) for f, size in zip(ALLOWED, sizes, strict=True)]
    problem = lierb.Problem(lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.free(), forces=forces)
    found = column(lierb.integrate(problem, twist0=np.zeros(6), **FALL).summary, "v")
    with_size, *_ = zip(*(rates for rates in ALLOWED.values()))
    without = np.array([rates[1] if len(rates) > 1 else (0, 0, 0) for rates in ALLOWED.values()])
    names = [function.__name__ for function in ALLOWED]
    for name, v, rate, constant in zip(names, found, with_size, without, strict=True):
        expected = rate + without.sum(axis=0) - constant  # exact in binary
        np.testing.assert_array_equal(v, expected, err_msg=name)


@pytest.mark.slow
def test_parameters_have_the_shape_of_their_defaults():
    @lierb.wrench(pull=(0.0, 0.0, 1.0), size=2.0)
    def push(t, R, r, omega, v, params):
        return (0, 0, 0), params.size * params.pull

    np.testing.assert_array_equal(fallen(push)[0], (0, 0, 1))
    per_body = fallen(push, bodies=2, pull=np.eye(3)[:2], size=[2.0, 4.0])
    np.testing.assert_array_equal(per_body, [(1, 0, 0), (0, 2, 0)])
    with pytest.raises(UnknownNameError, match=r"'pulll' is unknown.*Did you mean 'pull'"):
        push(pulll=1.0)
    with pytest.raises(ArgumentError, match=r"pull has shape \(2,\); expected \(3,\) or \(n, 3\)"):
        push(pull=(1.0, 2.0))
    assert repr(push) == "<wrench push: pull, size>"


# ---- NumPy, as one writes it -------------------------------------------------------------------

KNOTS, VALUES = np.array([0.0, 0.25, 0.5, 2.0]), np.array([1.0, -1.0, 3.0, 4.0])
GAINS = {"outer": [0.5, 2.0], "inner": 0.25}


def common(t, R, r, omega, v, params, body):
    """Functions that both a trace and Numba accept."""
    x = np.array([t - 0.3, params.size, -0.2])
    bent = np.where(x > 0.0, np.clip(x, 0.1, 0.5), np.floor(x) % 0.3)
    bent = bent + np.sign(x) * np.maximum(x, 0.1) + np.minimum(x * x, 0.3)
    along = lierb.where(t > 0.5, body.inertia[0], body.com)
    out = np.zeros(3)
    out[2] = lierb.table(t, KNOTS, VALUES) + np.interp(t, KNOTS, VALUES)
    out[0] = lierb.clip(params.size, 0.0, 1.0) + abs(t - 0.4) + np.fmod(t, 0.3)
    turned = lierb.quaternion(body.inertia / 2.0)[1:] + lierb.log(R)
    pair = lierb.where(t > 0.5, (t, 1, 0.0), (0, t, 0.0))
    return np.zeros(3), body.mass * (out + turned + np.array(pair) + bent + along)


def further(t, R, r, omega, v, params, body):
    """Functions that Numba does not accept."""
    x = np.asarray([t - 0.3, params.size, -0.2], dtype=float)
    bent = np.heaviside(x, 0.5) + np.select([x > 0.3, x > 0.0], [x, 2.0 * x], 0.1)
    bent += np.linalg.solve(body.inertia, bent) + np.linalg.inv(body.inertia) @ x
    bent += np.concatenate((x[:2], x[2:])) + np.stack((x, body.com))[1]
    bent += np.piecewise(x, [x < 0.0, x >= 0.0], [lambda y: -y, lambda y: y * y])
    mixed = np.einsum("ij,j->i", body.inertia, x) + np.dot(body.inertia, x) + np.outer(x, x)[1]
    in_range = np.logical_and(x > 0.1, ~(x > 0.6)) * 1.0 + (x > 0.0).astype(float)
    sizes = np.array([np.linalg.norm(x), np.linalg.det(body.inertia), np.max(x) - x.min()])
    parts = np.hstack([np.hypot(x[0], x[1]), np.sum(x), np.mean(x)]) + np.full(3, x[0])
    rounded = np.round(x, 1) + np.mod(x, 0.25) + x // 0.25 + np.trunc(4.0 * x) + np.rint(3.0 * x)
    listed = sum(g * y for g, y in zip(GAINS["outer"], x)) * GAINS["inner"]
    ends = np.linalg.norm([x[0], 1.0]) + np.trace(body.inertia) + np.prod(x) + np.diff(x)[0]
    chosen = max(x) + min(x[0], 0.2) + np.all(x < 9.0) + np.any(x > 9.0) + float(t)
    angles = np.radians(np.degrees(x)) + np.cross(x, [1.0, 2.0, 3.0]) + np.zeros_like(x)
    flat = np.array([np.sum(body.inertia), np.max(body.inertia), body.inertia.mean()])
    flat += body.inertia.sum(axis=0) + body.inertia.max(axis=1) + np.any(body.inertia > 1.9)
    flat += np.mean(body.inertia, axis=1, keepdims=True)[:, 0] + np.max(R, keepdims=True)[0, 0]
    total = (
        flat + bent + mixed + in_range + sizes + parts + rounded + listed + ends + chosen + angles
    )
    return (0, 0, 0), body.mass * total


def branching_common(t, R, r, omega, v, params, body):
    if t < -1.0:
        return np.zeros(3), np.zeros(3)
    return common(t, R, r, omega, v, params, body)


SHAPED = lierb.Body(  # the inertia less Steiner's part: 2 × a rotation's diagonal
    [2.0, 3.0], np.array([np.diag((2.0, 1.5, 1.75))] * 2), com=[(0.0, 0.0, 0.0), (0.125, 0.0, 0.25)]
)


@pytest.mark.long
@pytest.mark.parametrize("function", [common, further, branching_common])
def test_numpy_is_numpys(function):
    sizes = np.array([0.25, 0.75])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if function is branching_common else "error")
        force = lierb.wrench(size=1.0)(function)(size=sizes)
    spinless = lierb.Problem(SHAPED, lierb.joints.free(), forces=force)
    found = column(lierb.integrate(spinless, twist0=np.zeros(6), record=(), **PUSHED).summary, "v")
    for body, size in enumerate(sizes):
        com = SHAPED.com[body]
        steiner = SHAPED.mass[body] * ((com @ com) * np.eye(3) - np.outer(com, com))
        seen = types.SimpleNamespace(
            mass=SHAPED.mass[body], inertia=SHAPED.inertia[body] - steiner, com=com
        )
        of = branching_common if function is branching_common else function
        given = types.SimpleNamespace(size=size)
        _, force = of(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), given, seen)
        alpha = np.linalg.solve(seen.inertia, np.cross(-com, force))  # about the centre of mass
        wanted = force / seen.mass - np.cross(alpha, com)
        # a step of 2⁻⁷ s from rest; rounding of some thirty operations
        np.testing.assert_allclose(found[body] * 128, wanted, rtol=1e-13, atol=1e-13)


PUSHED = {"dt": 2.0**-7, "t_end": 2.0**-7, "method": "Euler"}


# ---- body by body ------------------------------------------------------------------------------


def branching(t, R, r, omega, v, params):
    if t < 0.5 and params.size > 0.0:
        return np.zeros(3), np.array([params.size, 0.0, R[2, 2]])
    return np.zeros(3), params.pull


@pytest.mark.slow
def test_function_that_branches_runs_body_by_body_and_says_so_once():
    decorated = lierb.wrench(size=1.0, pull=(0.0, 1.0, 0.0))(branching)
    sizes = np.linspace(0.0, 4.0, 21)
    with pytest.warns(ScalarFunctionWarning, match="branching runs body by body.*lierb.where"):
        found = fallen(decorated, bodies=21, size=sizes)
    expected = [(s / 4, 0.25, 0.25) if s else (0, 0.5, 0) for s in sizes]
    np.testing.assert_array_equal(found, expected)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decorated(size=2.0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t, R: None, r"takes \(t, R\); expected the form \(t, R, r, omega, v, params\)"),
        (lambda t, R, r, omega, v, params: 3.0, "must return 2 vectors, torque and force, not 3.0"),
        (lambda t, R, r, omega, v, params: ((1, 2), (1, 2, 3)), r"3 components, not \(1, 2\)"),
        (lambda t, R, r, omega, v, params: (r, "pull"), "3 components, not 'pull'"),
        (lambda t, R, r, omega, v, params: (r, r / params.width), "'width'"),
        (lambda t, R, r, omega, v, params: (r, np.none(r)), "nor, compiled by Numba"),
    ],
)
def test_function_that_cannot_be_run_says_why(function, message):
    with pytest.raises(ForceError, match=message):
        lierb.wrench(function)()


def test_only_functions_are_decorated():
    with pytest.raises(ForceError, match="expected a function to decorate, got 3"):
        lierb.wrench(3)


# ---- constraints -------------------------------------------------------------------------------

END, ANCHOR = np.array((0.1, 0.0, 0.05)), np.array((0.3, -0.2, 0.5))


@lierb.constraint(length=0.5, point=tuple(END), anchor=tuple(ANCHOR))
def rod(R, r, params):
    s = r + R @ params.point - params.anchor
    return (s @ s / params.length - params.length) / 2


def rod_problem(lengths=0.5) -> tuple[lierb.Problem, np.ndarray, np.ndarray]:
    problem = lierb.Problem(
        box(turned=True), lierb.joints.free(), GRAVITY, constraints=rod(length=lengths)
    )
    poses = problem.close(np.eye(4))
    return problem, poses, problem.project(np.array((1.0, 2.0, 0.5, 0.1, 0.2, 0.3)), poses)


@pytest.mark.parametrize("cspace", long_but(CSPACES, "SE3"))
def test_constraint_moves_the_body_as_newton_and_euler_say(cspace):
    lengths = np.array((0.4, 0.5, 0.6))
    problem, poses, twists = rod_problem(lengths)
    result = integrate(
        problem, twist0=twists, pose0=poses, dt=1e-3, t_end=1.0, method="DOP853", cspace=cspace
    )
    assert max(result.summary["position_error_max"].to_pylist()) < 1e-13  # of order 8: rounding
    for body, length in enumerate(lengths):
        ref = oracle.reference_trajectory(
            "free", [1.0], mass=float(problem.body.mass), inertia=problem.body.inertia,
            twist0=twists[body], pose0=poses[body], gravity=GRAVITY,
            extra_rows=oracle.rod_rows(END, ANCHOR, length),
        )  # fmt: skip
        last = 3 + body
        for name, wanted in (
            ("position", ref.r), ("omega", ref.omega), ("lambda", ref.multipliers),
        ):  # fmt: skip
            np.testing.assert_allclose(column(result.history, name)[last], wanted[-1], atol=1e-9)


@lierb.constraint
def held_point(R, r, params):
    """The rows d1 d2 d3 of a spherical joint, in ground axes."""
    ground, body = np.array(GROUND_FRAME), np.array(BODY_FRAME)
    return r + R @ body[:3, 3] - ground[:3, 3]


@lierb.constraint(unit="1")
def crossed(R, r, params):
    """The row Q32 of a universal joint."""
    ground, body = np.array(GROUND_FRAME), np.array(BODY_FRAME)
    return ground[:3, 2] @ (R @ body[:3, 1])


@pytest.mark.parametrize("cspace", long_but(CSPACES, "SE3"))
def test_constraints_are_the_joint_that_they_spell_out(cspace):
    problem, twist0 = tilted("universal")
    spelled = lierb.Problem(
        problem.body, lierb.joints.free(), GRAVITY, constraints=[held_point(), crossed()]
    )
    pose = problem.joint.closed_pose
    options = {"twist0": twist0, "dt": 1e-3, "t_end": 0.25, "cspace": cspace}
    built_in = integrate(problem, **options)
    found = integrate(spelled, pose0=pose, **options)
    for name in ("position_error_max", "rotation_error_max"):
        # the same constraints by the same method: as large, to their own rounding
        np.testing.assert_allclose(
            column(found.summary, name), column(built_in.summary, name), rtol=1e-3, atol=1e-13
        )
    for name in ("rotation", "position", "omega", "v"):
        np.testing.assert_allclose(
            final(found, name), final(built_in, name), atol=1e-12, err_msg=name
        )
    turned = np.block([[GROUND_FRAME[:3, :3].T, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]])
    multipliers = [turned @ row for row in column(found.history, "lambda")]
    np.testing.assert_allclose(multipliers, column(built_in.history, "lambda"), atol=1e-9)
    units = found.history.schema.field("lambda").metadata[b"unit"]
    assert units == b"N, N, N, N m"


@pytest.mark.slow
def test_constraint_off_at_the_start_is_named():
    problem, _, twist0 = rod_problem()
    with pytest.raises(PoseError, match=r"free joint with rod: .* \(rod = .*problem\.close"):
        integrate(problem, twist0=twist0, dt=1e-3, t_end=0.1, method="DOP853")


def test_constraint_cannot_branch():
    @lierb.constraint
    def one_sided(R, r, params):
        return r[2] if r[2] > 0.0 else 0.0

    with pytest.raises(ForceError, match=r"one_sided must run for many .*r\[2\] > 0.*lierb\.where"):
        one_sided()


def test_constraints_beyond_twelve_rows_are_refused():
    with pytest.raises(ArgumentError, match="15 constraint rows; at most 12"):
        lierb.Problem(box(), lierb.joints.fixed(), constraints=[held_point()] * 3)


def test_constraint_has_a_unit():
    with pytest.raises(UnknownNameError, match="unit='mm' is unknown"):
        lierb.constraint(unit="mm")(lambda R, r, params: r[0])


def test_prediction_knows_constraints():
    problem, _ = tilted("universal")
    pose = problem.joint.closed_pose
    spelled = lierb.Problem(
        problem.body, lierb.joints.free(), constraints=[held_point(), crossed()]
    )
    found, built_in = lierb.predict(spelled, pose), lierb.predict(problem)
    for cspace in CSPACES:
        assert found[cspace].rows_exact == built_in[cspace].rows_exact
        assert found[cspace].group == built_in[cspace].group


# ---- fingerprints ------------------------------------------------------------------------------


def of_source(source: str, **names) -> types.FunctionType:
    """The function `f` that a source defines."""
    names = dict(names)
    exec(source, names)
    return names["f"]


SAME = "def f(x):\n    return k * g(x) + 1.5\n"


def test_fingerprint_of_equal_functions_is_equal():
    one, other = (of_source(SAME, k=2.0, g=of_source("def f(x): return x")) for _ in range(2))
    assert fingerprint(one) == fingerprint(other)
    moved = of_source("\n\n# a comment\n" + SAME, k=2.0, g=of_source("def f(x): return x"))
    assert fingerprint(one) == fingerprint(moved)


@pytest.mark.parametrize(
    "edited",
    [
        lambda: of_source(SAME.replace("1.5", "1.25"), k=2.0, g=of_source("def f(x): return x")),
        lambda: of_source(SAME.replace("* g", "- g"), k=2.0, g=of_source("def f(x): return x")),
        lambda: of_source(SAME, k=3.0, g=of_source("def f(x): return x")),
        lambda: of_source(SAME, k=np.float32(2.0), g=of_source("def f(x): return x")),
        lambda: of_source(SAME, k=2.0, g=of_source("def f(x): return -x")),
        lambda: of_source(SAME, k=2.0, g=of_source("def f(x, y=1.0): return x")),
        lambda: of_source(SAME, k=2.0, g=math.sin),
    ],
    ids=["constant", "operator", "global", "type", "helper", "default", "built-in"],
)
def test_fingerprint_knows_an_edit(edited):
    plain = of_source(SAME, k=2.0, g=of_source("def f(x): return x"))
    assert fingerprint(plain) != fingerprint(edited())


def test_fingerprint_knows_closures_and_members_of_modules():
    def closed(k):
        return lambda x: k * x

    assert fingerprint(closed(1.0)) == fingerprint(closed(1.0)) != fingerprint(closed(2.0))
    constants = types.ModuleType("constants")
    constants.k = 1.0
    function = of_source("def f(x): return constants.k * x", constants=constants)
    before = fingerprint(function)
    constants.k = 2.0
    assert fingerprint(function) != before


def test_fingerprint_refuses_what_it_cannot_know():
    class Setting:
        k = 1.0

    with pytest.raises(UnfitFunctionError, match="refers to setting, a Setting"):
        fingerprint(of_source("def f(x): return setting.k * x", setting=Setting()))
    with pytest.raises(ForceError, match="cannot be compiled: it refers to setting"):
        lierb.wrench(
            of_source(
                "def f(t, R, r, omega, v, params): return r, setting.k * r", setting=Setting()
            )
        )()


@pytest.mark.slow
def test_motors_are_told_apart():
    """They are wrapped by a function of lierb's, which must not hide them."""
    one, two = (lierb.forces.motor(lambda t, k=k: k * t) for k in (1.0, 2.0))
    assert one.kind != two.kind
    held = lierb.joints.revolute()
    forces = [lierb.forces.motor(torque) for torque in (lambda t: 1.0, lambda t: 2.0)]
    problem = lierb.Problem(lierb.Body(2.0, (1.0, 1.0, 1.0)), held, forces=forces)
    assert final(lierb.integrate(problem, twist0=np.zeros(6), **FALL), "omega")[2] == 3.0
    with pytest.raises(ForceError, match="expected a number or a function"):
        lierb.forces.motor(np.sin)


def package(name: str, **members) -> types.ModuleType:
    module = types.ModuleType(name)
    vars(module).update(members)
    return module


def test_fingerprint_sees_modules_in_packages():
    def described(k):
        consts = package("pkg.consts", k=k)
        return fingerprint(
            of_source("def f(x): return pkg.consts.k * x", pkg=package("pkg", consts=consts))
        )

    assert described(1.0) == described(1.0) != described(2.0)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("def f(x):\n    import math\n    return math.sin(x)", {}),
        ("def f(x): return getattr(m, 'k') * x", {"m": package("m", k=1.0)}),
        ("def f(x): return curve(x)", {"curve": np.polynomial.Polynomial([1.0, 2.0])}),
        ("def f(x): return curve(x)", {"curve": np.frompyfunc(abs, 1, 1)}),
        ("def f(x): return p.a * x", {"p": namedtuple("P", "a b")(1.0, 2.0)}),
    ],
)
def test_fingerprint_refuses_what_hides(source, names):
    with pytest.raises(UnfitFunctionError):
        fingerprint(of_source(source, **names))


def test_a_helper_in_a_known_function_s_clothes_is_looked_at():
    def helper(factor):
        @functools.wraps(np.cross)
        def cross(x):
            return factor * x

        return cross

    one, two = (fingerprint(of_source("def f(x): return g(x)", g=helper(k))) for k in (1.0, 2.0))
    assert one != two


@pytest.mark.slow
def test_a_difference_of_equal_products_is_zero():
    @lierb.wrench(size=0.1)
    def sideways(t, R, r, omega, v, params):
        speed = math.sqrt(v @ v - v[2] * v[2])
        return (0, 0, 0), (speed, 0.0, params.size + 0.1 * abs(v[2]))

    found = fallen(sideways, bodies=3, size=np.array([0.1, 0.7, 1.3]))
    assert np.isfinite(found).all()
    assert (found[:, 0] == 0.0).all()


def test_a_function_that_calls_itself_has_a_fingerprint():
    names = {}
    exec("def f(x): return f(x - 1) if x else 0", names)
    assert fingerprint(names["f"])

"""Protocols of systems and methods, and the arithmetic of states that steps are made of."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from cases import in_python, tilted
from mechanisms import shared
from mechanisms.shared import double_pendulum
from scipy.linalg import expm

from lierb.kernels.groups import quaternion, turns
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.stepping.method import Method
from lierb.kernels.stepping.method_of import FAMILIES
from lierb.kernels.systems.formulations import FORMULATIONS
from lierb.kernels.systems.state import Slopes, Units
from lierb.kernels.systems.system import System
from lierb.kernels.systems.tree_inputs import charts_of
from lierb.kernels.systems.tree_system import TreeFormulation
from lierb.methods import TABLEAUS

EULER = TABLEAUS["Euler"].scheme(is_adaptive=False, interpolates=False)
STEPS = {"lanes": 1, "update": "local", "method": EULER, "multipliers": False}
H = 0.25  # s, with rates of 1 rad/s and 1 m/s
ROUNDING = 1e-14  # of matrices with entries of about 1: some tens of operations


def members(protocol):
    return {name: x for name, x in vars(protocol).items() if not name.startswith("_")}


@pytest.mark.parametrize(
    ("kind", "protocol"),
    [
        *((formulation, System) for formulation in FORMULATIONS.values()),
        (TreeFormulation, System),
        *((family, Method) for family in FAMILIES.values()),
    ],
)
def test_protocol_is_fit(kind, protocol):
    """Members and names of parameters; mypy checks their types."""
    fields = kind.__dataclass_fields__
    for name, described in members(protocol).items():
        assert name in fields or hasattr(kind, name), name
        if inspect.isfunction(described):
            expected, own = (
                list(inspect.signature(f).parameters) for f in (described, getattr(kind, name))
            )
            assert own == expected, name


def one_body(solver):
    """System, constants and start of a body on a spherical joint, on floats."""
    problem, twist = tilted("spherical")
    return in_python(problem, twist, cspace="SE3", solver=solver, **STEPS)[:3]


def pendulum(cspace):
    at_rest = {name: np.eye(4) for name in ("upper", "lower")}
    at_rest["upper"][2, 3], at_rest["lower"][2, 3] = -0.25, -0.75
    return shared.in_python(
        double_pendulum(), cspace, at_rest, {name: np.zeros(6) for name in at_rest}
    )


SYSTEMS = {
    "saddle": lambda: one_body("saddle"),
    "subgroup": lambda: one_body("subgroup"),
    "tree, reduced": lambda: pendulum("reduced"),
    "tree, SE3": lambda: pendulum("SE3"),
}


def matrices(system, chart):
    """Poses as 4×4 matrices."""
    tree = getattr(system.plan, "tree", None)
    found = []
    for i, each in enumerate(chart if tree else [chart]):
        group = turns if tree and charts_of(tree[i]) is turns else quaternion
        q, d = group.pose(each)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.reshape(np.array(q, float), (3, 3)), np.array(d, float)
        found.append(pose)
    return found


def algebra(x):
    """X as 4×4 matrices, one for each six numbers."""
    found = []
    for a, b, c, *eta in np.reshape(np.array(x, float), (-1, 6)):
        xi = np.zeros((4, 4))
        xi[:3, :3] = (0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0)
        xi[:3, 3] = eta
        found.append(xi)
    return found


def slopes_of(system, body, state, count):
    """Random rates of some stages, those of poses in the algebras of the joints."""
    rng = np.random.default_rng(1)
    x, v = rng.uniform(-1.0, 1.0, (2, count, len(state.x)))
    inside = tuple(system.in_algebra(body, tuple(map(float, each))) for each in x)
    return Slopes(
        inside, tuple(tuple(map(float, each)) for each in v), ((0.0,),) * count, ((),) * count
    )


@pytest.mark.parametrize("sums_first", [False, True])
@pytest.mark.parametrize("name", SYSTEMS)
def test_combine_and_move_follow_the_exponential(name, sums_first):
    """Against SciPy's matrix exponential."""
    system, body, state = SYSTEMS[name]()
    slopes, weights = slopes_of(system, body, state, 3), (0.5, 0.0, -0.75)
    units = Units(0.5 * H, H, H, sums_first)
    ended = system.move(body, system.combine(body, state, weights, slopes, units))
    total = H * np.tensordot(weights, np.array(slopes.x, float), 1)
    for before, x, after in zip(
        matrices(system, state.chart), algebra(total), matrices(system, ended.chart), strict=True
    ):
        np.testing.assert_allclose(after, before @ expm(x), rtol=0, atol=ROUNDING)
    expected = np.array(state.v_or_mu, float) + H * np.tensordot(weights, slopes.v_or_mu, 1)
    np.testing.assert_allclose(np.array(ended.v_or_mu, float), expected, rtol=0, atol=ROUNDING * 10)


@pytest.mark.parametrize("name", SYSTEMS)
def test_combine_by_factors_is_a_product_of_exponentials(name):
    system, body, state = SYSTEMS[name]()
    slopes, factors = slopes_of(system, body, state, 2), ((0.5, 0.25), (0.0, 0.0), (-0.25, 1.0))
    ended = system.combine(body, state, (0.5, 0.5), slopes, Units(0.5 * H, H, H), factors)
    expected = matrices(system, state.chart)
    for weights in factors:
        parts = algebra(H * np.tensordot(weights, np.array(slopes.x, float), 1))
        expected = [pose @ expm(x) for pose, x in zip(expected, parts, strict=True)]
    np.testing.assert_allclose(matrices(system, ended.chart), expected, rtol=0, atol=ROUNDING)
    assert is_zero(*ended.x)

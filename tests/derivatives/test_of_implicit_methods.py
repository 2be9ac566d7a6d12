"""Derivatives of steps that solve equations, or differentiate formulas themselves.

The truth is a difference of sixth order of the same method's results: steps of low order have
derivatives of their own, which are not those of the motion.
"""

from __future__ import annotations

import numpy as np
import pytest
from cases import long_but
from mechanisms.shared import double_pendulum

import lierb

METHODS = [name for name in lierb.methods.METHODS if name not in lierb.methods.TABLEAUS]
SLOW = ("Rodas4",)
OFFSETS = np.array((-3.0, -2.0, -1.0, 1.0, 2.0, 3.0))
WEIGHTS = np.array((-1.0, 9.0, -45.0, 45.0, -9.0, 1.0)) / 60.0
WIDTH = 0.01  # relative: errors of the difference's order are 1e-12, those of rounding 1e-13
TOLERANCE = 2e-10  # of the largest derivative
NUMBERS = {"omega0": 6.28, "body.mass": 6.0, "spring_damper.stiffness": 40.0, "spin.torque": 0.3}


@lierb.wrench(torque=0.0)
def spin(t, R, r, omega, v, params):
    return (0.0, 0.0, params.torque - 0.05 * omega[2] ** 3), (0.0, 0.0, 0.0)


def top(numbers) -> tuple[lierb.Problem, np.ndarray]:
    """A top with a spring and a wrench.   numbers : as NUMBERS, or an array of each."""
    joint = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.02))
    spring = lierb.forces.spring_damper(
        ground_point=(0.3, 0.0, 0.2), stiffness=numbers["spring_damper.stiffness"], damping=0.5
    )
    mass = numbers["body.mass"]
    inertia = np.broadcast_to(np.diag((0.2, 0.3, 0.35)), (*np.shape(mass), 3, 3))
    forces = (spring, spin(torque=numbers["spin.torque"]))
    problem = lierb.Problem(lierb.Body(mass, inertia), joint, (0.0, 0.0, -9.81), forces=forces)
    rates = np.broadcast_to((0.0, 3.14, 0.63), (*np.shape(numbers["omega0"]), 3)).copy()
    rates[..., 0] = numbers["omega0"]
    return problem, joint.twist(omega=rates)


def varied() -> dict[str, np.ndarray]:
    """Numbers of a batch, in which one after the other takes the places of the difference."""
    numbers = {name: np.full((4, 6), value) for name, value in NUMBERS.items()}
    for i, (name, value) in enumerate(NUMBERS.items()):
        numbers[name][i] += WIDTH * value * OFFSETS
    return {name: values.ravel() for name, values in numbers.items()}


@pytest.mark.parametrize("method", long_but(METHODS, *SLOW))
def test_derivatives_of_implicit_steps_are_those_of_differences(method):
    options = {"dt": 4e-3, "t_end": 0.2, "method": method}
    problem, twist = top(NUMBERS)
    plain = lierb.integrate(problem, twist0=twist, **options)
    result = lierb.integrate(problem, twist0=twist, **options, with_respect_to=[*NUMBERS])
    assert result.summary.equals(plain.summary)  # values keep their bits
    batch, twists = top(varied())
    ends = lierb.integrate(batch, twist0=twists, **options).omega.reshape(4, 6, 3)
    for i, (name, value) in enumerate(NUMBERS.items()):
        difference = np.einsum("k,kj->j", WEIGHTS, ends[i]) / (WIDTH * value)
        exact = result.sensitivity("twist", name)[0, :3, 0]
        assert np.abs(exact - difference).max() < TOLERANCE * np.abs(exact).max(), name


@pytest.mark.long
@pytest.mark.parametrize("method", ["RATTLie", "SHAKELie", "alpha3", "alpha2", "BLieDF2"])
def test_derivatives_of_mechanisms_with_constraints_are_those_of_differences(method):
    pendulum = double_pendulum()
    pose0 = pendulum.pose({"upper": 0.9, "lower": 0.6})
    start = {"pose0": pose0, "twist0": pendulum.twist({"upper": 2.0, "lower": -5.0}, pose0)}
    options = {"dt": 2e-3, "t_end": 0.1, "method": method, "cspace": "SE3"}
    names = ["upper.body.mass", "lower.body.mass"]
    result = lierb.integrate(pendulum, **start, **options, with_respect_to=names)
    for name in names:
        link = next(each for each in pendulum.links if name.startswith(each.name))
        masses = float(link.body.mass) + WIDTH * OFFSETS
        ends = lierb.integrate(pendulum.with_({name: masses}), **start, **options)
        difference = WEIGHTS @ ends["lower"].omega / WIDTH
        exact = result.sensitivity("lower.twist", name)[0, :3, 0]
        assert np.abs(exact - difference).max() < TOLERANCE * np.abs(exact).max(), name

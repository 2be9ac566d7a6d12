"""The reference solutions of the tolerance tests are themselves accurate."""

import json

import numpy as np
import oracle
import pytest
import reference_numbers as ref
from cases import tiered

import lierb
from clocks.truths import DATA, PATH, distance, problem_of, reference, states_of

KEPT = json.loads(PATH.read_text(encoding="utf-8"))
CASES = [f"{name}-{cspace}" for name in DATA for cspace in ("SE3", "SO3xR3")]


@pytest.mark.parametrize("name", DATA)
def test_reference_agrees_with_another_way(name):
    """The other way has 19 digits; the tops multiply what it rounds off by up to 10⁵ in two s."""
    assert set(KEPT[name]["agreement"]) == set(DATA[name].times)
    assert max(KEPT[name]["agreement"].values()) < 5e-14


def test_reference_is_what_was_published():
    """Brüls and Cardona's top, by a third program; 17 digits are stored there."""
    for t, published in (("0.2", ref.TOP_R_02), ("1", ref.TOP_R_1)):
        np.testing.assert_allclose(reference("fast_top")[t].position, published, atol=4e-16)


@pytest.mark.parametrize("t", DATA["free_body"].times)
def test_free_body_turns_as_jacobi_says(t):
    data = DATA["free_body"]
    known = oracle.torque_free_triaxial(data.inertia, data.omega0, t)
    np.testing.assert_allclose(reference("free_body")[t].omega, known, rtol=4e-16)


@pytest.mark.parametrize("name", DATA)
def test_reference_keeps_energy_and_momentum(name):
    """Rounding of the stored numbers and of the sums: some 1e-16 of the largest term."""
    data, seen = DATA[name], []
    inertia = np.diag(data.inertia)
    for state in reference(name).values():
        kinetic = data.mass * state.v @ state.v + state.omega @ inertia @ state.omega
        energy = kinetic / 2 - data.mass * np.array(data.gravity) @ state.position
        spin = state.rotation @ (inertia @ state.omega)
        velocity = state.rotation @ state.v
        momentum = spin + data.mass * np.cross(state.position, velocity)
        kept = [energy, *momentum] if name == "free_body" else [energy]
        if data.centre is not None and data.ground_turn is None:
            kept.append(momentum[2])
        seen.append(kept)
        np.testing.assert_allclose(state.rotation @ state.rotation.T, np.eye(3), atol=4e-16)
    seen = np.array(seen)
    np.testing.assert_allclose(seen, np.broadcast_to(seen[0], seen.shape), rtol=2e-14, atol=2e-15)


@pytest.mark.parametrize("case", tiered(CASES, [], ["free_body-SE3", "heavy_top-SO3xR3"]))
def test_short_fixed_steps_meet_the_reference(case):
    """Rounding alone: 1e-16 for each of up to 800 steps, times what the motion makes of it."""
    name, cspace = case.split("-")
    problem, twist0 = problem_of(name)
    t = DATA[name].times[2]
    steps = 800
    found = lierb.integrate(
        problem, twist0=twist0, dt=float(t) / steps, t_end=float(t), method="DOP853", cspace=cspace
    )
    assert distance(states_of(found.summary, 0), reference(name)[t]) < 3e-13

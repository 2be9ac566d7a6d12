"""Friction that holds (LuGre): against SciPy on the same equations, in mechanisms and studies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ArgumentError, ForceError

RECORD = ("state", "energy", "multipliers", "reaction")  # as replays of studies

# Parameters of Canudas de Wit, Olsson, Åström and Lischinsky (1995), whose block of 1 kg is pulled
# by a spring of 2 N/m with an end that moves at 0.1 m/s.
BLOCK = {
    "coulomb": 1.0,
    "static": 1.5,
    "stribeck": 1e-3,
    "stiffness": 1e5,
    "damping": 1e5**0.5,
    "viscous": 0.4,
}
WHEEL = {"coulomb": 1.0, "static": 1.2, "stribeck": 0.05, "stiffness": 1e3, "damping": 1.0}
INERTIA = 0.01  # kg m² about the axis of the wheel
BODY = lierb.Body(1.0, (0.02, 0.02, INERTIA))


def deflection_rate(rate, z, *, coulomb, static, stribeck, stiffness, **_):
    limit = coulomb + (static - coulomb) * np.exp(-((rate / stribeck) ** 2))
    return rate - abs(rate) * stiffness * z / limit


@lierb.wrench(stiffness=2.0, speed=0.1)
def pull(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (0.0, 0.0, params.stiffness * (params.speed * t - r[2]))


@lierb.wrench(size=2.0, frequency=3.0)
def swinging(t, R, r, omega, v, params):
    return (0.0, 0.0, params.size * np.sin(params.frequency * t)), (0.0, 0.0, 0.0)


def wheel(**changed):
    brake = lierb.forces.joint_stiction(**(WHEEL | changed))
    return lierb.Problem(BODY, lierb.joints.revolute(), forces=[swinging(), brake])


def wheel_by_scipy(t_end, **changed):
    """Rate and deflection of the wheel."""
    p = WHEEL | changed

    def slopes(t, y):
        rate, z = y
        slip = deflection_rate(rate, z, **p)
        torque = 2.0 * np.sin(3.0 * t) - p["stiffness"] * z - p["damping"] * slip
        return torque / INERTIA, slip

    return solve_ivp(slopes, (0, t_end), [0, 0], method="Radau", rtol=1e-10, atol=1e-14).y[:, -1]


@pytest.mark.slow
def test_a_block_sticks_and_slips():
    times = np.linspace(0.0, 20.0, 201)
    problem = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.1, 0.1)),
        lierb.joints.prismatic(),
        forces=[pull(), lierb.forces.slide_stiction(**BLOCK, state="brake")],
    )
    result = lierb.integrate(
        problem, t_end=20.0, rtol=1e-9, method="Rodas4", save_at=times, record=RECORD
    )

    def slopes(t, y):
        x, v, z = y
        slip = deflection_rate(v, z, **BLOCK)
        held = BLOCK["stiffness"] * z + BLOCK["damping"] * slip + BLOCK["viscous"] * v
        return v, 2.0 * (0.1 * t - x) - held, slip

    exact = solve_ivp(
        slopes, (0, 20), [0, 0, 0], method="Radau", rtol=1e-10, atol=1e-14, t_eval=times
    ).y
    # Both have errors of 1e-9 at each of some thousand steps.
    assert np.abs(result.position[:, 0, 2] - exact[0]).max() < 1e-7
    assert np.abs(result.v[:, 0, 2] - exact[1]).max() < 1e-6
    assert np.abs(result.history["brake"].to_numpy() - exact[2]).max() < 1e-10
    # The first of two slips begins where the spring pulls with 1.5 N, at 7.5 s.
    slips = np.flatnonzero(np.diff((exact[1] > 0.01).astype(int)) == 1)
    assert len(slips) == 2
    assert 7.4 < times[slips[0] + 1] < 7.7
    assert result.history.schema.field("brake").metadata[b"unit"] == b"m"


@pytest.mark.slow
def test_a_joint_holds_up_to_its_static_friction():
    """c28: at rest under 1.19 N m of 1.2 for 1000 s; 1.21 N m turn it."""
    torques = np.array([0.5, 1.19, 1.21])
    load = lierb.forces.constant_wrench(torque=torques[:, None] * (0.0, 0.0, 1.0))
    brake = lierb.forces.joint_stiction(
        **WHEEL, start=np.minimum(torques, 1.19) / WHEEL["stiffness"]
    )
    held = lierb.Problem(BODY, lierb.joints.revolute(), forces=[brake, load])
    result = lierb.integrate(held, t_end=1000.0, rtol=1e-8, method="Rodas4")
    rate = result.summary["omega"].to_pylist()
    deflection = result.summary["bristle"].to_numpy() * WHEEL["stiffness"]
    assert max(abs(rate[0][2]), abs(rate[1][2])) < 1e-14  # at rest to rounding
    np.testing.assert_allclose(deflection[:2], torques[:2], rtol=1e-12)
    # Steadily accelerated by what is more than sliding friction: 0.21 N m/0.01 kg m².
    assert rate[2][2] == pytest.approx((1.21 - 1.0) / INERTIA * 1000.0, rel=1e-2)


@pytest.mark.long
@pytest.mark.parametrize(
    "where",
    ["problem", *(pytest.param(n, marks=pytest.mark.long) for n in ("mechanism", "looped"))],
)
def test_wheels_turn_to_and_fro_as_by_scipy(where):
    """Two wheels with bristles of their own, on one body, or in one mechanism."""
    exact = [wheel_by_scipy(1.0), wheel_by_scipy(1.0, coulomb=0.5)]
    method = "DOP853" if where == "looped" else "Rodas4"  # looped code has explicit methods only
    options = {"t_end": 1.0, "rtol": 1e-10, "method": method}
    if where == "problem":
        summary = lierb.integrate(wheel(coulomb=[1.0, 0.5]), **options).summary
        rates = [x[2] for x in summary["omega"].to_pylist()]
        deflections = summary["bristle"].to_pylist()
    else:
        brakes = [
            lierb.forces.joint_stiction(**WHEEL, state="first").on("a"),
            lierb.forces.joint_stiction(**(WHEEL | {"coulomb": 0.5}), state="second").on("b"),
        ]
        links = [lierb.Link(name, BODY, lierb.joints.revolute()) for name in "ab"]
        swings = [swinging().on(name) for name in "ab"]
        mechanism = lierb.Mechanism(links, forces=[*brakes, *swings])
        solver = "looped" if where == "looped" else "auto"
        summary = lierb.integrate(mechanism, solver=solver, **options).summary
        rates = [summary[f"{name}.omega"][0].as_py()[2] for name in "ab"]
        deflections = [summary[name][0].as_py() for name in ("first", "second")]
    # Both stop at rtol 1e-10 of rates of 10 rad/s, at kinks where the wheel turns back.
    np.testing.assert_allclose(rates, [rate for rate, _ in exact], atol=1e-7)
    np.testing.assert_allclose(deflections, [z for _, z in exact], atol=1e-10)


@pytest.mark.long
def test_derivatives_are_those_of_differences():
    names = ["joint_stiction.coulomb", "joint_stiction.stiffness", "joint_stiction.start"]
    options = {"t_end": 0.2, "dt": 1e-4}
    result = lierb.integrate(wheel(), **options, with_respect_to=names)
    for name, step in zip(names, (1e-5, 1e-2, 1e-8), strict=True):
        key = name.partition(".")[2]
        centre = WHEEL.get(key, 0.0)
        changed = wheel(**{key: [centre - step, centre + step]})
        ends = lierb.integrate(changed, **options, with_respect_to=names).summary  # one kernel
        rates = [x[2] for x in ends["omega"].to_pylist()]
        found = result.sensitivity("twist", name)
        expected = (rates[1] - rates[0]) / (2.0 * step)
        assert np.ravel(found)[2] == pytest.approx(expected, rel=1e-5), name  # of differences


@pytest.mark.slow
def test_friction_at_rest_is_that_of_sliding_where_none_is_given():
    """`static` stayed at the number that `coulomb` had when the force was made."""

    def braked(coulomb):
        brake = lierb.forces.joint_stiction(
            coulomb=coulomb, stiffness=2e3, damping=5.0, stribeck=1.0
        )
        body = lierb.Body(1.0, (0.02, 0.02, 0.02))
        return lierb.Problem(body, lierb.joints.revolute(), forces=brake)

    run, by, h = (
        {"twist0": (0.0, 0.0, 3.0, 0.0, 0.0, 0.0), "dt": 1e-4},
        "joint_stiction.coulomb",
        1e-4,
    )
    result = lierb.integrate(braked(0.3), **run, t_end=0.16, with_respect_to=by)
    ahead, behind = (lierb.integrate(braked(0.3 + x), **run, t_end=0.16).omega for x in (h, -h))
    slope = result.sensitivity("twist", by)[0, 2, 0]
    assert slope == pytest.approx((ahead - behind)[0, 2] / (2.0 * h), rel=1e-6)
    t = np.linspace(0.02, 0.16, 8)
    moved = lierb.integrate(braked(0.3), **run, t_end=0.16, save_at=t, record="state")
    for guess in (0.25, 0.35):
        fit = lierb.fit(braked(guess), {"t": t, "omega": moved.omega}, by, **run)
        assert fit.converged
        assert fit.estimate[by] == pytest.approx(0.3, rel=1e-9)
    lierb.propagate(braked(0.3), {by: 0.01}, by, [0.1], "omega", **run)  # was refused


def test_other_numbers_and_states_of_their_own():
    changed = wheel().with_({"joint_stiction.coulomb": [0.5, 1.0]})
    assert changed.batch_size() == 2
    brakes = [lierb.forces.joint_stiction(**WHEEL).on(name) for name in "ab"]
    links = [lierb.Link(name, BODY, lierb.joints.revolute()) for name in "ab"]
    with pytest.raises(ArgumentError, match="two states or outputs are named bristle"):
        lierb.Mechanism(links, forces=brakes)

    @lierb.observable
    def bristle(omega):
        return omega[2]

    with pytest.raises(ArgumentError, match="bristle"):
        wheel().with_(observables=bristle())


def test_what_no_friction_has_is_refused():
    for changed, words in [
        ({"static": [1.2, 0.9]}, r"static\[1\] is 0.9, less than coulomb, 1.0"),
        ({"coulomb": 0.0}, "coulomb"),
        ({"stribeck": 0.0}, "stribeck"),
        ({"damping": -1.0}, "damping"),
    ]:
        with pytest.raises(ArgumentError, match=words):
            lierb.forces.joint_stiction(**(WHEEL | changed))
    with pytest.raises(ForceError, match="does not turn"):
        lierb.Problem(BODY, lierb.joints.prismatic(), forces=lierb.forces.joint_stiction(**WHEEL))
    with pytest.raises(ArgumentError, match="states of joint_stiction"):
        lierb.integrate(wheel(), t_end=1.0, dt=1e-3, method="RATTLie")


@pytest.mark.slow
def test_a_study_samples_it(tmp_path):
    block = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.1, 0.1)),
        lierb.joints.prismatic(),
        forces=[pull(), lierb.forces.slide_stiction(**BLOCK | {"static": 1.0}, state="brake")],
    )
    design = lierb.sampling.Design(
        {"forces.slide_stiction.coulomb": lierb.sampling.Uniform(0.5, 0.9)}, n=3, seed=1
    )
    options = {
        "t_end": 0.5, "rtol": 1e-6, "method": "Rodas4", "save_at": [0.5], "record": RECORD
    }  # fmt: skip
    initial = {"velocities": [1.0]}
    dataset = lierb.run(block, design, tmp_path / "study", initial=initial, **options)
    table = dataset.table().to_table()
    replayed = dataset.replay(2)
    _, friction = replayed.problem.forces
    alone = lierb.integrate(
        block.with_({"slide_stiction.coulomb": friction.parameters["coulomb"]}),
        twist0=block.joint.twist(velocities=[1.0]), **options,
    )  # fmt: skip
    assert table["brake"][2] == alone.summary["brake"][0] == replayed.result.summary["brake"][0]
    assert table.schema.field("brake").metadata[b"unit"] == b"m"

"""Linkages: dead points, redundant rows, stiff couplers, four loops."""

from __future__ import annotations

import numpy as np
import pytest
from cases import column, integrate
from scipy.integrate import solve_ivp

import lierb
from public_cases.shared import (
    CRANK,
    CRANK_INERTIA,
    ROD,
    ROD_INERTIA,
    ROD_MASS,
    SLIDER_MASS,
    angles_of,
    assert_turns_by_cardan,
    cardan,
    slider_crank,
    summed,
)

# ---- c15: a slider-crank in line ---------------------------------------------------------------


def slider_at(angle) -> tuple:
    """Slider-crank by the crank's angle: x, dx/dφ, d²x/dφ², and M, dM/dφ of ½ M ω².

    sin ψ = −(r/l) sin φ for the rod's angle ψ; x = r cos φ + l cos ψ.
    """
    sin, cos, ratio = np.sin(angle), np.cos(angle), CRANK / ROD
    s, c = -ratio * sin, np.sqrt(1.0 - (ratio * sin) ** 2)
    d1 = -ratio * cos / c  # dψ/dφ, and its derivative
    d2 = (ratio * sin + s * d1 * d1) / c
    x = CRANK * cos + ROD * c
    x1 = -CRANK * sin - ROD * s * d1
    x2 = -CRANK * cos - ROD * (c * d1 * d1 + s * d2)
    # the rod's middle: (r cos φ + l/2 cos ψ, r sin φ + l/2 sin ψ)
    u = np.stack([-CRANK * sin - ROD / 2 * s * d1, CRANK * cos + ROD / 2 * c * d1])
    u1 = np.stack([
        -CRANK * cos - ROD / 2 * (c * d1 * d1 + s * d2),
        -CRANK * sin + ROD / 2 * (-s * d1 * d1 + c * d2),
    ])  # fmt: skip
    mass = CRANK_INERTIA + ROD_INERTIA * d1**2 + SLIDER_MASS * x1**2 + ROD_MASS * (u * u).sum(0)
    slope = 2 * (ROD_INERTIA * d1 * d2 + SLIDER_MASS * x1 * x2 + ROD_MASS * (u * u1).sum(0))
    return x, x1, x2, mass, slope


@pytest.mark.slow
def test_c15_slider_crank_runs_through_its_dead_points():
    """Pyslvs-UI#49. Right: place, speed and pin force in closed form, from the crank's angle alone.

    Nothing drives it, so that ½ M(φ) ω² stays; the pin pulls the slider with m ẍ along the slide.
    """
    machine, start = slider_crank(), np.array([0.3, 1.5, -2.0])
    pose0 = machine.pose({
        "crank": start, "rod": -np.arcsin(CRANK / ROD * np.sin(start)) - start,
        "slider": slider_at(start)[0] - CRANK - ROD,
    })  # fmt: skip
    twist0 = machine.project(machine.twist({"crank": np.array([40.0, -50.0, 60.0])}, pose0), pose0)
    omega0 = machine.velocities(twist0, pose0)["crank"][:, 0]
    result = integrate(
        machine, pose0=pose0, twist0=twist0, dt=2e-4, t_end=1.0, save_every=50,
        stabilise="project",
    )  # fmt: skip
    assert result.failed.size == 0
    omega = result["crank"].omega[..., 2]
    angle = angles_of(result["crank"])
    x, x1, x2, mass, slope = slider_at(angle)
    # rounding of some ten operations: the loop is projected
    np.testing.assert_allclose(result["slider"].position[..., 0], x, rtol=0, atol=1e-14)
    np.testing.assert_allclose(result["slider"].v[..., 0], x1 * omega, rtol=0, atol=1e-12)
    turned = omega.mean(axis=0) * 1.0
    assert np.all(np.abs(turned) > 4.0 * np.pi)  # through both dead points, twice and more
    # RK4 at 0.2 ms, of turns at 10 … 60 rad/s
    right = omega0 * np.sqrt(slider_at(start)[3] / mass)
    np.testing.assert_allclose(omega, right, rtol=1e-7)
    force = SLIDER_MASS * omega**2 * (x2 - 0.5 * x1 * slope / mass)
    # in axes of the slider, which does not turn
    pull = column(result.history, "pin.reaction").reshape(*omega.shape, 6)[..., 3]
    np.testing.assert_allclose(pull, force, rtol=0, atol=1e-11 * np.abs(force).max())


# ---- c15b: a start in a dead point -------------------------------------------------------------
# KmolYuan/Pyslvs-UI#49: a slider-crank that starts in line. Right: what `project` is defined to be.


@pytest.mark.slow
@pytest.mark.parametrize("dead_point", ["stretched", "folded"])
@pytest.mark.parametrize("speed", [1e-3, 30.0, 3e4])
def test_c15b_twist_of_project_is_taken_in_a_dead_point(dead_point, speed):
    """Pyslvs-UI#49. In line, the slider stands still at first whatever the crank does."""
    machine = slider_crank()
    folded = {"crank": np.pi, "rod": np.pi, "slider": -2.0 * CRANK}
    pose0 = machine.close(machine.pose(folded if dead_point == "folded" else {}))
    twist0 = machine.project(machine.twist({"crank": speed}, pose0), pose0)
    rates = machine.velocities(twist0, pose0)
    # rounding, of speeds at the pins of 0.1 … 0.35 m times the crank's
    assert abs(rates["slider"][0]) < 1e-15 * abs(rates["crank"][0])
    turn = np.pi / abs(rates["crank"][0])
    result = integrate(
        machine, pose0=pose0, twist0=twist0, dt=turn / 500, t_end=turn, stabilise="project"
    )
    assert result.summary["status"].to_pylist() == ["ok"]
    omega = result["crank"].omega[-1, 0, 2]
    x, _, _, mass, _ = slider_at(angles_of(result["crank"])[-1, 0])
    # ½ M(φ) ω² stays. RK4 of half a turn in 500 steps
    np.testing.assert_allclose(result["slider"].position[-1, 0, 0], x, rtol=0, atol=1e-9)
    start = slider_at(0.0 if dead_point == "stretched" else np.pi)[3]
    right = rates["crank"][0] * np.sqrt(start / mass)
    np.testing.assert_allclose(omega, right, rtol=1e-8)


# ---- c13: two Cardan shafts side by side -------------------------------------------------------


@pytest.mark.slow
def test_c13_a_double_cardan_turns_by_cardans_formula():
    """OpenModelica#8365, before its second branch: one of its rows is redundant."""
    machine = cardan(("first",), "bearing")
    assert tuple(machine.freedoms()) == (1, 1)
    assert_turns_by_cardan(machine, ("first",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("branches", "closed_by", "redundant"),
    [
        pytest.param(("first",), "cross", 1, marks=pytest.mark.long),
        pytest.param(("first", "second"), "bearing", 3, marks=pytest.mark.long),
        pytest.param(("first", "second"), "cross", 3, marks=pytest.mark.long),
    ],
)
def test_c13_cardan_shafts_turn_whatever_closes_the_loop(branches, closed_by, redundant):
    """OpenModelica#8365. Right: Cardan's formula. Rows are redundant in space, not in a plane."""
    machine = cardan(branches, closed_by)
    assert tuple(machine.freedoms()) == (1, redundant)
    assert_turns_by_cardan(machine, branches)


@pytest.mark.slow
def test_c13_a_cardan_shaft_goes_on_with_the_rank_of_its_start():
    """A run that goes on drops as many rows as its start did, though it starts open by 2e-7 m."""
    machine = cardan(("first",), "bearing")
    twist0 = machine.project(machine.twist({"input": np.array([15.0, -8.0])}))
    options = {"dt": 1e-3, "stabilise": "project"}
    whole = integrate(machine, twist0=twist0, t_end=0.1, **options)
    first = integrate(machine, twist0=twist0, t_end=0.05, **options)
    second = integrate(machine, **first.end, t_end=0.1, **options)
    assert second.failed.size == 0
    for name in machine.names:
        np.testing.assert_array_equal(second[name].omega[-1], whole[name].omega[-1])
        np.testing.assert_array_equal(second[name].rotation[-1], whole[name].rotation[-1])


# ---- c34: a stiff governor ---------------------------------------------------------------------

ROD_LENGTH, SQUARE, DENSITY = 1.0, 1e-4, 3000.0  # m, m², kg/m³
BALL, SLIDER = 5.0, 3.0  # kg; the slider is a cube of 0.1 m
STIFFNESS, DAMPING, SLACK = 8e5, 4e4, 0.5  # N/m, N s/m, m
AXLE = 1e-3  # kg m², of shaft and slider about the shaft


def governor() -> tuple[lierb.Mechanism, float, float]:
    """A05: two rods on a shaft, a ball at each end, and a slider on springs from their middles.

    Also a rod's inertia, with its ball, across and along itself, about its pivot.
    """
    own = DENSITY * ROD_LENGTH * SQUARE
    across = own * (ROD_LENGTH**2 / 3.0 + SQUARE / 12.0) + BALL * ROD_LENGTH**2
    along = own * SQUARE / 6.0
    # about its pivot, which its frame is at; the rod hangs along −e₃
    centre = (0.0, 0.0, -ROD_LENGTH * (0.5 * own + BALL) / (own + BALL))
    rod = lierb.Body(own + BALL, (across, across, along), centre)
    y = (0.0, 1.0, 0.0)
    springs = [
        lierb.forces.spring_damper(
            (0.0, 0.0, -0.5 * ROD_LENGTH), stiffness=STIFFNESS, damping=DAMPING, length=SLACK
        ).on(side, "slider")
        for side in ("left", "right")
    ]
    cube = SLIDER * 0.01 / 6.0
    machine = lierb.Mechanism(
        [
            lierb.Link("shaft", lierb.Body(0.3, (0.025, 0.025, AXLE)), lierb.joints.revolute()),
            lierb.Link("left", rod, lierb.joints.revolute(axis=y), "shaft"),
            lierb.Link("right", rod, lierb.joints.revolute(axis=y), "shaft"),
            lierb.Link(
                "slider", lierb.Body(SLIDER, (cube,) * 3), lierb.joints.prismatic(), "shaft"
            ),
        ],
        gravity=(0.0, 0.0, -9.81),
        forces=springs,
    )
    return machine, across, along


@pytest.mark.long
def test_c34_a_stiff_governor_moves_as_radau_says():
    """MBSbenchmarksInOpenSim, A05 of the IFToMM library: its numbers. Right: SciPy's Radau.

    In minimal coordinates: the rods' angle from the shaft, the slider's place s below their pivot,
    and the momentum about the shaft, which stays.
    """
    machine, across, along = governor()
    start, turning = np.pi / 3.0, 2.0 * np.pi
    weight = 9.81 * ROD_LENGTH * (0.5 * DENSITY * ROD_LENGTH * SQUARE + BALL)
    middle, still = 0.5 * ROD_LENGTH, AXLE + SLIDER * 0.01 / 6.0

    def inertia(a):
        return still + 2.0 * (across * np.sin(a) ** 2 + along * np.cos(a) ** 2)

    momentum = inertia(start) * turning

    def rate(_, y):
        a, s, u, w = y
        length = np.sqrt(middle**2 + s * s - 2.0 * middle * s * np.cos(a))
        by_a, by_s = middle * s * np.sin(a) / length, (s - middle * np.cos(a)) / length
        pull = STIFFNESS * (length - SLACK) + DAMPING * (by_a * u + by_s * w)
        spin = momentum / inertia(a)
        turn = np.sin(a) * np.cos(a) * (across - along) * spin**2 - weight * np.sin(a)
        return [u, w, (turn - pull * by_a) / across, 9.81 - 2.0 * pull * by_s / SLIDER]

    t = np.linspace(0.0, 2.0, 21)
    y0 = [start, SLACK, 0.0, 0.0]
    right = solve_ivp(rate, (0.0, 2.0), y0, "Radau", t_eval=t, rtol=1e-11, atol=1e-13).y
    pose0 = machine.pose({"left": start, "right": -start, "slider": -SLACK})
    twist0 = machine.twist({"shaft": turning}, pose0)
    # the coupler's rate is 4e4 · (2/3 + …)/s: 2.7e4/s, of which RK4 takes 0.1 ms at most
    result = integrate(machine, pose0=pose0, twist0=twist0, dt=5e-5, t_end=2.0, save_every=2000)
    assert result.failed.size == 0
    place = result["slider"].position[..., 2].ravel()
    R = result["left"].rotation.reshape(-1, 3, 3)
    # 1e-10 of Radau's, and RK4 in the first 2 ms, while the coupler takes up the load
    np.testing.assert_allclose(-place, right[1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(R[:, 2, 2], np.cos(right[0]), rtol=0, atol=1e-8)
    options = {"rtol": 1e-8, "method": "Rodas5P", "save_at": t, "record": "state"}
    stiff = lierb.integrate(machine, pose0=pose0, twist0=twist0, t_end=2.0, **options)
    np.testing.assert_allclose(-stiff["slider"].position[:, 0, 2], right[1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        stiff["left"].rotation[:, 0, 2, 2], np.cos(right[0]), rtol=0, atol=1e-8
    )
    assert stiff["steps"][0] < 4000  # RK4 takes 40 000


# ---- c40: four loops ---------------------------------------------------------------------------

# Of each loop: pivot of its rocker, lengths of coupler and rocker, side on which they meet
LOOPS = (
    (0.30 + 0.05j, 0.28, 0.22, 1.0),
    (-0.25 + 0.10j, 0.30, 0.20, -1.0),
    (0.05 - 0.32j, 0.27, 0.25, 1.0),
    (-0.10 + 0.35j, 0.33, 0.24, -1.0),
)
ARM = 0.09  # m, of the crank
DOWN = np.array((1.0, -9.0))  # m/s²


def bar(length) -> tuple[float, float]:
    """Mass and moment of inertia about the middle."""
    return 3.0 * length, 0.3 * length**3


def assembled(crank) -> np.ndarray:
    """(9, n) angles of crank, couplers and rockers in the plane: two circles meet."""
    tip, angles = ARM * np.exp(1j * crank), [crank]
    for pivot, coupler, rocker, side in LOOPS:
        line = pivot - tip
        apart = np.abs(line)
        inner = np.arccos((apart**2 + coupler**2 - rocker**2) / (2.0 * apart * coupler))
        angles.append(np.angle(line) + side * inner)
        knee = tip + coupler * np.exp(1j * angles[-1])
        angles.append(np.angle(knee - pivot))
    return np.array(angles)


def accelerations(angles, speed, torque) -> tuple[np.ndarray, np.ndarray]:
    """(9,) ω and (9,) ω̇ of one assembly, from the KKT system of its 27 coordinates.

    Each bar has the place of its middle and its angle; each of 13 pins has two rows.
    """
    lengths = [ARM, *(x for _, coupler, rocker, _ in LOOPS for x in (coupler, rocker))]
    e = np.stack([np.cos(angles), np.sin(angles)], 1)
    pins = [(0, -1.0, None, 0.0)]  # bar, end; bar, end, or the ground
    for k in range(4):
        coupler, rocker = 1 + 2 * k, 2 + 2 * k
        pins += [(coupler, -1.0, 0, 1.0), (rocker, -1.0, None, 0.0), (coupler, 1.0, rocker, 1.0)]
    J = np.zeros((26, 27))
    curved = []  # rows of −J̇v are sums of ω² times these
    for row, (first, end, second, other) in enumerate(pins):
        terms = []
        for i, side, sign in ((first, end, 1.0), (second, other, -1.0)):
            if i is None:
                continue
            arm = 0.5 * lengths[i] * side * e[i]
            at = slice(2 * row, 2 * row + 2)
            J[at, 3 * i : 3 * i + 2] = sign * np.eye(2)
            J[at, 3 * i + 2] = sign * np.array((-arm[1], arm[0]))
            terms.append((i, sign * arm))
        curved.append(terms)
    held = np.vstack([J, np.eye(27)[2]])
    v = np.linalg.solve(held, np.append(np.zeros(26), speed))
    omega = v[2::3]
    bias = [sum(omega[i] ** 2 * arm for i, arm in terms) for terms in curved]
    masses = np.array([bar(x) for x in lengths])
    M = np.diag(masses[:, [0, 0, 1]].ravel())
    load = np.concatenate([[m * DOWN[0], m * DOWN[1], 0.0] for m, _ in masses])
    load[2] += torque
    system = np.block([[M, J.T], [J, np.zeros((26, 26))]])
    solution = np.linalg.solve(system, np.concatenate([load, np.concatenate(bias)]))
    return omega, solution[:27][2::3]


@pytest.mark.long
def test_c40_four_loops_accelerate_as_the_kkt_system_says():
    """cassie-mujoco-sim, mujoco#2172, mujoco#1227: trees with four loops. Right: KKT, by NumPy.

    A crank with four couplers on its pin, each with a rocker. Euler's step shows accelerations as
    they are: rates of planar hinges are its coordinates.
    """
    crank = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    speed, torque, dt = np.linspace(-8.0, 12.0, 24), 0.4, 1e-3
    angles = assembled(crank)
    at = lambda z: (complex(z).real, complex(z).imag, 0.0)
    pin = lambda own, parent: lierb.joints.revolute(at(own), parent_point=at(parent))
    flat = lambda x: lierb.Body(bar(x)[0], bar(x)[1] * np.array((0.6, 0.7, 1.0)))
    places, loops = {"crank": crank}, []
    links = [lierb.Link("crank", flat(ARM), pin(-ARM / 2, 0.0))]
    for k, (pivot, coupler, rocker, _) in enumerate(LOOPS):
        links += [
            lierb.Link(f"coupler{k}", flat(coupler), pin(-coupler / 2, ARM / 2), "crank"),
            lierb.Link(f"rocker{k}", flat(rocker), pin(-rocker / 2, pivot)),
        ]
        loops.append(
            lierb.Loop(f"knee{k}", pin(coupler / 2, rocker / 2), f"coupler{k}", f"rocker{k}")
        )
        places[f"coupler{k}"] = angles[1 + 2 * k] - crank
        places[f"rocker{k}"] = angles[2 + 2 * k]
    machine = lierb.Mechanism(
        links, loops, gravity=(*DOWN, 0.0), forces=lierb.forces.motor(torque=torque).on("crank")
    )
    pose0 = machine.pose(places)
    right = [accelerations(angles[:, i], speed[i], torque) for i in range(24)]
    omega, turning = (np.array(x) for x in zip(*right))
    rates = {x.name: omega[:, i] for i, x in enumerate(links)}
    for k in range(4):
        rates[f"coupler{k}"] = rates[f"coupler{k}"] - rates["crank"]
    twist0 = machine.twist(rates, pose0)
    result = integrate(machine, pose0=pose0, twist0=twist0, dt=dt, t_end=dt, method="Euler")
    assert result.failed.size == 0
    for i, link in enumerate(links):
        found = (summed(result, f"{link.name}.omega")[:, 2] - omega[:, i]) / dt
        # rounding of 20 rad/s over 1 ms, and what 27 equations make of it
        np.testing.assert_allclose(found, turning[:, i], rtol=0, atol=1e-9, err_msg=link.name)

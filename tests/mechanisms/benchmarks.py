"""Published mechanisms, as lierb has them and in minimal coordinates.

A01 … A04 are of the library of the IFToMM Technical Committee for Multibody Dynamics
(https://www.iftomm-multibody.org/benchmark; M. González, D. Dopico, U. Lugrís, J. Cuadrado, A
benchmarking system for MBS simulation software, Multibody System Dynamics 16 (2006), 179–190). Each
function says where its numbers are from, and which were taken where sources contradict each other.

Every body frame is at the centre of mass: all c-spaces take it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import lierb
from mechanisms import minimal
from mechanisms.minimal import REAL, Arm, Chain, Jet, LinkState, Moved, OneWay, Planar, Pull

G0 = "9.81"  # m/s², of the IFToMM library


class Benchmark(NamedTuple):
    """A mechanism and its start, and the same in coordinates of its own.

    start : pose0 and twist0 by link, for `lierb.integrate`.
    links : of minimal coordinates y, the state of each link, in the order of the mechanism's.
    y0 : at the start.   solve : (y at the times, estimated error of a step), in extended precision.
    times : s, at which `reference.json` has y; dt : s, with which DOP853 reaches its accuracy.
    free_axis : links whose turn about their own e₃ nothing depends on.
    """

    mechanism: Any
    start: dict[str, Any]
    links: Callable[[np.ndarray], list[LinkState]]
    y0: np.ndarray
    solve: Callable[[list[str]], tuple[np.ndarray, float]]
    times: tuple[str, ...]
    dt: float
    free_axis: tuple[str, ...] = ()


def _start(names: list[str], states: list[LinkState]) -> dict[str, Any]:
    poses, twists = {}, {}
    for name, s in zip(names, states, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = s.R, s.x
        poses[name] = pose
        twists[name] = np.concatenate([s.R.T @ s.w, s.R.T @ s.v]).astype(float)
    return {"pose0": poses, "twist0": twists}


def _body(mass: float, moments) -> lierb.Body:
    return lierb.Body(mass, np.asarray(moments, float))


def _flat(mass: float, inertia: float) -> lierb.Body:
    """Inertia of a planar mechanism's body: moments about axes in the plane do not matter."""
    return _body(mass, (0.6 * inertia, 0.6 * inertia, inertia))


def _pin(on_body: complex, on_parent: complex) -> Any:
    """A revolute joint about e₃; places from the centres of mass, in axes of the bodies."""
    return lierb.joints.revolute(
        body_point=(on_body.real, on_body.imag, 0.0),
        ground_point=(on_parent.real, on_parent.imag, 0.0),
    )


def _between(joint: Any, frame: np.ndarray, body: np.ndarray, parent: np.ndarray, **options) -> Any:
    """A joint whose two frames coincide, at the start, with `frame` in the ground."""
    to = lambda pose: np.linalg.inv(pose) @ frame
    return joint(body_frame=to(body), ground_frame=to(parent), **options)


def _frame(point, e3, e2=None) -> np.ndarray:
    """4×4 in the ground, from a point, an axis and, perpendicular to it, e₂."""
    e3 = np.asarray(e3, float) / np.linalg.norm(np.asarray(e3, float))
    if e2 is None:
        e2 = np.cross(e3, np.eye(3)[np.argmin(np.abs(e3))])
    e2 = np.asarray(e2, float) / np.linalg.norm(np.asarray(e2, float))
    found = np.eye(4)
    found[:3, :3] = np.stack([np.cross(e2, e3), e2, e3], 1)
    found[:3, 3] = np.asarray(point, float)
    return found


# ---- A01: simple pendulum ----------------------------------------------------------------------


def a01() -> Benchmark:
    """A01, the simple pendulum: P₁ at 1 m from the pivot, from rest at (−1, 0), gravity along −y.

    The library has a point mass on a massless bar. A body has an inertia, so it is here one of the
    same reduced length: 1 kg, 0.5 m from the pivot, with 0.25 kg m² about its centre of mass, and
    P₁ 0.5 m further on. y is (θ, θ̇) of P₁ = (cos θ, sin θ).
    """
    model = Chain((Planar(1.0, 0.25, (Arm(0.5, (1.0,)),), (1.0,)),), (), (0.0,), float(G0))
    y0 = np.array([minimal.PI, 0], REAL)
    links = [lierb.Link("bar", _flat(1.0, 0.25), _pin(-0.5 + 0j, 0j))]
    mechanism = lierb.Mechanism(links=links, gravity=(0.0, -float(G0), 0.0))
    return Benchmark(
        mechanism, _start(["bar"], model.links(y0)), model.links, y0,
        lambda times: model.motion(y0[:1], y0[1:], times, REAL("0.05")),
        ("1", "2", "5", "10"), 1e-3,
    )  # fmt: skip


# ---- A02: N four-bars --------------------------------------------------------------------------


def a02(windows: int) -> Benchmark:
    """A02, N four-bar windows of 2N + 1 rods of 1 m and 1 kg, upright; B₀ starts at 1 m/s along x.

    The freedoms grow from 1 to N + 1 as it lies down, first after 0.708 s (N = 1) to 0.720 s
    (N = 8); the motion that goes on, with all cranks parallel, is that of one pendulum: y is
    (φ, φ̇), with B₀ = (sin φ, cos φ). The last time of the reference is after that, the others are
    before. Rods: slender, 1/12 kg m² about their centres, as ports of the library have them; about
    their own axes 1e-3 kg m², which does not matter in the plane.
    """
    rod, N = 1.0 / 12.0, windows
    crank = Planar(1.0, rod, (Arm(0.5j, (-1.0,)),), (-1.0,))
    # bars of the windows do not turn: they move as the ends of the cranks do
    bar = lambda: Planar(1.0, rod, (Arm(1j, (-1.0,)),), (0.0,))
    shape = (crank,) * (N + 1) + tuple(bar() for _ in range(N))
    model = Chain(shape, (), (0.0,), float(G0))

    def links(y: np.ndarray) -> list[LinkState]:
        found, across = [], np.array([1, 0, 0], REAL)
        for i, s in enumerate(model.links(y)):
            place = i if i <= N else i - N - 1 + REAL("0.5")
            found.append(s._replace(x=s.x + place * across))
        return found

    body = _body(1.0, (rod, 1e-3, rod))  # along e₂
    lying = _body(1.0, (1e-3, rod, rod))
    cranks = [f"crank{i}" for i in range(N + 1)]
    bars = [f"bar{i}" for i in range(1, N + 1)]
    made = [lierb.Link(c, body, _pin(-0.5j, i + 0j)) for i, c in enumerate(cranks)]
    made += [lierb.Link(b, lying, _pin(-0.5 + 0j, 0.5j), cranks[i]) for i, b in enumerate(bars)]
    loops = [
        lierb.Loop(f"pin{i + 1}", _pin(0.5 + 0j, 0.5j), b, cranks[i + 1])
        for i, b in enumerate(bars)
    ]
    mechanism = lierb.Mechanism(links=made, loops=loops, gravity=(0.0, -float(G0), 0.0))
    y0 = np.array([0, 1], REAL)
    return Benchmark(
        mechanism, _start([*cranks, *bars], links(y0)), links, y0,
        lambda times: model.motion(y0[:1], y0[1:], times, REAL("0.02")),
        ("0.25", "0.5", "10"), 1e-3,
    )  # fmt: skip


def a02_square(windows: int):
    """ω² of φ̈ = ω² sin φ, as a fraction times g: 3(3N + 1)/(2(4N + 1))."""
    import mpmath

    with mpmath.workdps(40):
        N = windows
        return mpmath.mpf(G0) * mpmath.mpf(3 * (3 * N + 1)) / (2 * (4 * N + 1))


# ---- A03: Andrews' squeezer --------------------------------------------------------------------

A03_ANGLES = ("beta", "theta", "gamma", "phi", "delta", "Omega", "epsilon")
A03_START = (
    "-0.0617138900142764496358948458001", "0", "0.455279819163070380255912382449",
    "0.222668390165885884674473185609", "0.487364979543842550225598953530",
    "-0.222668390165885884674473185609", "1.23054744454982119249735015568",
)  # fmt: skip
# q and q̇ at 0.03 s, by PSIDE at 1e-14 on a Cray C90: Test Set for IVP Solvers, "andrews"
A03_PUBLISHED = (
    0.1581077119629904e2, -0.1575637105984298e2, 0.4082224013073101e-1, -0.5347301163226948,
    0.5244099658805304, 0.5347301163226948, 0.1048080741042263e1,
    0.1139920302151208e4, -0.1424379294994111e4, 0.1103291221937134e2, 0.1929337464421385e2,
    0.5735699284790808, -0.1929337464421385e2, 0.3231791658026955,
)  # fmt: skip


def a03() -> Benchmark:
    """A03, Andrews' squeezing mechanism, from rest, driven by 0.033 N m; no gravity.

    Data of W. Schiehlen (ed.), Multibody Systems Handbook (1990), as in E. Hairer and G. Wanner,
    Solving Ordinary Differential Equations II, VII.7, and the Test Set for IVP Solvers ("andrews",
    archimede.uniba.it/~testset). Sources differ: a port of the IFToMM library prints x_B = +0.03635
    and m₃ = 0.02372 in its text, and −0.03635 and 0.02373 in its code; both of the latter are the
    test set's, and are taken. The library starts at β = −0.0620, the test set at the β of Θ = 0,
    which is taken, for it is to that start that q(0.03 s) is published. y is (q, q̇) of β, Θ, γ,
    Φ, δ, Ω, ε.
    """
    rr, d, da = 7e-3, 28e-3, 115e-4
    ss, sa, sb, sc, sd = 35e-3, 1874e-5, 1043e-5, 18e-3, 2e-2
    e, ea, zt, ta, tb = 2e-2, 1421e-5, 4e-2, 2308e-5, 916e-5
    zf, fa, u, ua, ub = 2e-2, 1421e-5, 4e-2, 1228e-5, 449e-5
    A, B, C = -0.06934 - 0.00227j, -0.03635 + 0.03273j, 0.014 + 0.072j
    unit = np.eye(7)
    b, bt, g, pd, dl, oe, ep = (
        tuple(x) for x in (unit[0], unit[0] + unit[1], unit[2], unit[3] + unit[4], unit[4],
                           unit[5] + unit[6], unit[6])
    )  # fmt: skip
    still = (0.0,) * 7
    # joints and centres of mass of each body, from its first joint, in its own axes
    F1, c1 = rr + 0j, 92e-5 + 0j
    E2, c2 = -d + 0j, -da + 0j
    E3, D3, c3 = -1j * ss, sd - 1j * sc, sb - 1j * sa
    G5, c5 = zt + 0j, ta + 1j * tb
    E4, c4 = -1j * e, -1j * (e - ea)
    H7, c7 = -1j * u, -ub - 1j * ua
    E6, c6 = zf + 0j, zf - fa + 0j
    at = lambda z: Arm(z, still)
    crank, to_a, to_b = (Arm(F1, b),), (at(A),), (at(B),)
    bodies = (
        Planar(0.04325, 2.194e-6, (Arm(c1, b),), b),
        Planar(0.00365, 4.410e-7, (*crank, Arm(c2, bt)), bt),
        Planar(0.02373, 5.255e-6, (*to_b, Arm(c3, g)), g),
        Planar(0.00706, 5.667e-7, (*to_a, Arm(G5, dl), Arm(c4, pd)), pd),
        Planar(0.07050, 1.169e-5, (*to_a, Arm(c5, dl)), dl),
        Planar(0.00706, 5.667e-7, (*to_a, Arm(H7, ep), Arm(c6, oe)), oe),
        Planar(0.05498, 1.912e-5, (*to_a, Arm(c7, ep)), ep),
    )
    tip = (*crank, Arm(E2, bt))
    back = lambda arms: tuple(Arm(-z, turns) for z, turns in arms)
    loops = (
        (tip + back((Arm(E3, g),)), B),
        (tip + back((Arm(G5, dl), Arm(E4, pd))), A),
        (tip + back((Arm(H7, ep), Arm(E6, oe))), A),
    )
    pull = Pull((*to_b, Arm(D3, g)), C, 4530.0, 0.07785)
    model = Chain(bodies, loops, (0.033, *(0.0,) * 6), 0.0, (pull,))
    point = lambda z: (z.real, z.imag, 0.0)
    part = [_flat(x.mass, x.inertia) for x in bodies]
    links = [
        lierb.Link("K1", part[0], _pin(-c1, 0j)),
        lierb.Link("K2", part[1], _pin(-c2, F1 - c1), "K1"),
        lierb.Link("K3", part[2], _pin(-c3, B)),
        lierb.Link("K4", part[3], _pin(-c4, G5 - c5), "K5"),
        lierb.Link("K5", part[4], _pin(-c5, A)),
        lierb.Link("K6", part[5], _pin(-c6, H7 - c7), "K7"),
        lierb.Link("K7", part[6], _pin(-c7, A)),
    ]
    closed = [("E3", E3 - c3, "K3"), ("E4", E4 - c4, "K4"), ("E6", E6 - c6, "K6")]
    pins = [lierb.Loop(n, _pin(z, E2 - c2), body, "K2") for n, z, body in closed]
    spring = lierb.forces.spring_damper(point(D3 - c3), point(C), stiffness=4530.0, length=0.07785)
    mechanism = lierb.Mechanism(
        links=links, loops=pins,
        forces=[lierb.forces.motor(torque=0.033).on("K1"), spring.on("K3")],
    )  # fmt: skip
    q0 = [REAL(x) for x in A03_START]
    y0 = model.settled(np.array([*q0, *(REAL(0),) * 7]))
    return Benchmark(
        mechanism, _start([x.name for x in links], model.links(y0)), model.links, y0,
        lambda times: model.motion(y0[:7], y0[7:], times, REAL("2e-4")),
        ("0.01", "0.02", "0.03"), 1e-5,
    )  # fmt: skip


# ---- A04: Bricard's mechanism ------------------------------------------------------------------

A04_CORNERS = ((0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1))
A04_AXES = (1, 2, 0, 1, 2, 0)  # the revolute axis at each corner, along a coordinate axis


def a04() -> Benchmark:
    """A04, Bricard's mechanism: five rods of 1 m and 1 kg and the ground, from rest, gravity −y.

    The rods have a square section of 0.1 m: so a port of the library (RehabEngGroup,
    MBSbenchmarksInOpenSim) says in its table and does in its code. Another one (simEngine3D) takes
    slender rods; which is another motion.

    Six rods that are at right angles to the axes at their ends close for
    (1 + cos θ)(1 + cos φ) = 1, where they turn by θ and φ in turns, which is
    cos a + cos b = 1 with a, b = (θ ± φ)/2: y is (a, b, σ), with ȧ = σ sin b, ḃ = −σ sin a.
    """

    def flow(p: np.ndarray) -> list[Jet]:
        a, b = p
        return [
            Jet(a, np.sin(b), -np.cos(b) * np.sin(a)),
            Jet(b, -np.sin(a), -np.cos(a) * np.sin(b)),
        ]

    corners = np.array(A04_CORNERS, REAL)
    rods = [(corners[i], corners[(i + 1) % 6]) for i in range(5)]
    section, moments = 0.01, []
    for tail, head in rods:
        square = np.where(np.asarray(head != tail), 1.0, section)
        moments.append((square.sum() - square) / 12.0)

    def bodies(jets: list[Jet]) -> list[Moved]:
        a, b = jets
        half = REAL(minimal.PI / 2)
        turn = [(t - half).by(REAL(-1)) for t in (a + b, a - b)]  # θ, φ from a right angle
        found, at = [], Jet.constant(corners[0])
        R = Jet.constant(np.eye(3))
        for i, (tail, head) in enumerate(rods):
            R = R @ minimal.turned(A04_AXES[i], turn[i % 2])
            along = R @ Jet.constant(head - tail)
            found.append(Moved(1.0, np.diag(moments[i]), at + along.by(REAL("0.5")), R))
            at = at + along
        return found

    model = OneWay(flow, bodies, (0.0, -float(G0), 0.0))
    y0 = np.array([minimal.PI / 2, 0, 0], REAL)
    start = _start([f"rod{i + 1}" for i in range(5)], model.links(y0))
    poses = [np.eye(4), *start["pose0"].values()]
    made, name = [], lambda i: f"rod{i}" if i else "ground"
    for i in range(6):
        frame = _frame(A04_CORNERS[i], np.eye(3)[A04_AXES[i]])
        body = poses[(i + 1) % 6]
        made.append(_between(lierb.joints.revolute, frame, body, poses[i]))
    links = [lierb.Link(name(i + 1), _body(1.0, moments[i]), made[i], name(i)) for i in range(5)]
    # the last one is of the last rod on the ground
    last = _between(lierb.joints.revolute, _frame(A04_CORNERS[5], np.eye(3)[A04_AXES[5]]),
                    poses[5], np.eye(4))  # fmt: skip
    mechanism = lierb.Mechanism(
        links=links, loops=[lierb.Loop("pin", last, "rod5")], gravity=(0.0, -float(G0), 0.0)
    )
    return Benchmark(
        mechanism, start, model.links, y0,
        lambda times: model.motion(y0[:2], y0[2], times, REAL("0.05")),
        ("0.5", "1", "2", "10"), 1e-3,
    )  # fmt: skip


# ---- a spatial slider-crank --------------------------------------------------------------------


def slider_crank() -> Benchmark:
    """The spatial slider-crank: crank of 0.08 m, rod of 0.3 m on a ball and a universal joint.

    Geometry, crank and slider as in E. J. Haug, Computer Aided Kinematics and Dynamics of
    Mechanical Systems (1989), and the IFToMM library's rigid slider-crank: the crank turns about x
    at (0, 0.1, 0.12) m and starts along z at 6 rad/s, the slider is on the x axis, at 0.2 m; crank
    0.12 kg, slider 2 kg, gravity −z. The rod: 0.5 kg, (4e-3, 4e-4, 4e-3) kg m². A port (Cosima.jl)
    has the same crank, slider and places, and a rod of its own material. That the crank turns
    about +x is our choice. y is (θ, θ̇).
    """
    A, r, l = np.array([0, REAL("0.1"), REAL("0.12")], REAL), REAL("0.08"), REAL("0.3")

    def bodies(jets: list[Jet]) -> list[Moved]:
        R = minimal.turned(0, jets[0])
        along = R @ Jet.constant([0, 0, 1])
        B = along.by(r) + A
        flat = B * Jet.constant([0, 1, 1])
        s = (Jet.constant(l * l) - flat.dot(flat)).sqrt()
        slide = (B * Jet.constant([1, 0, 0])) + minimal.vector(s, 0, 0)
        u = (B - slide).by(1 / l)
        across = Jet.constant([1, 0, 0]).cross(u).unit()
        turned = minimal.columns(across, u, across.cross(u))
        still = Jet.constant(np.eye(3))
        return [
            Moved(0.12, np.diag([1e-4, 1e-5, 1e-4]), along.by(r / 2) + A, R),
            Moved(0.5, np.diag([4e-3, 4e-4, 4e-3]), (B + slide).by(REAL("0.5")), turned),
            Moved(2.0, np.diag([1e-4, 1e-4, 1e-4]), slide, still),
        ]

    model = OneWay(lambda p: [Jet(p[0], REAL(1), REAL(0))], bodies, (0.0, 0.0, -float(G0)))
    y0 = np.array([0, 6], REAL)
    start = _start(["crank", "rod", "slider"], model.links(y0))
    crank, rod, slider = start["pose0"].values()
    B, ground = (0.0, 0.1, 0.2), np.eye(4)
    x, joints = (1.0, 0.0, 0.0), lierb.joints
    frame = _frame((0.2, 0.0, 0.0), x, rod[:3, 0])
    links = [
        lierb.Link("crank", _body(0.12, (1e-4, 1e-5, 1e-4)),
                   _between(joints.revolute, _frame((0.0, 0.1, 0.12), x), crank, ground)),
        lierb.Link("rod", _body(0.5, (4e-3, 4e-4, 4e-3)),
                   _between(joints.spherical, _frame(B, x), rod, crank), "crank"),
        lierb.Link("slider", _body(2.0, (1e-4, 1e-4, 1e-4)),
                   _between(joints.prismatic, frame, slider, ground)),
    ]  # fmt: skip
    knuckle = lierb.Loop("knuckle", _between(joints.universal, frame, rod, slider), "rod", "slider")
    mechanism = lierb.Mechanism(links=links, loops=[knuckle], gravity=(0.0, 0.0, -float(G0)))
    return Benchmark(
        mechanism, start, model.links, y0,
        lambda times: model.motion(y0[:1], y0[1], times, REAL("0.02")), ("0.25", "1"), 1e-3,
    )  # fmt: skip


# ---- RSSR --------------------------------------------------------------------------------------


def rssr() -> Benchmark:
    """A crank and a rocker about skew axes, joined by a rod with a ball at each end; our numbers.

    The crank turns about z at the origin, 0.1 m; the rocker about (0.6, 0, 0.8) at
    (0.35, 0.05, 0.1) m, 0.3 m; gravity (0, −9.81, 0). The rod is a body of revolution and its spin
    about its own axis, e₃, is 0 and stays so. y is (θ, θ̇).
    """
    P0, Q0 = REAL("0.1"), REAL("0.3")
    pivot = np.array([REAL("0.35"), REAL("0.05"), REAL("0.1")])
    axis = np.array([REAL("0.6"), 0, REAL("0.8")], REAL)
    e1, e2 = np.array([REAL("0.8"), 0, -REAL("0.6")], REAL), np.array([0, 1, 0], REAL)
    length = REAL("0.45")

    def bodies(jets: list[Jet]) -> list[Moved]:
        R = minimal.turned(2, jets[0])
        P = (R @ Jet.constant([1, 0, 0])).by(P0)
        w = P - pivot  # |w − Q0 (e1 c + e2 s)| = length
        a, b = w.dot(Jet.constant(e1)), w.dot(Jet.constant(e2))
        c = (w.dot(w) + (Q0 * Q0 - length * length)).by(1 / (2 * Q0))
        square = a * a + b * b
        root, over = (square - c * c).sqrt(), square.inverse()
        cosine, sine = (a * c - b * root) * over, (b * c + a * root) * over
        f1 = Jet.constant(e1) * cosine + Jet.constant(e2) * sine
        turned = minimal.columns(f1, Jet.constant(axis).cross(f1), Jet.constant(axis))
        Q = f1.by(Q0) + pivot
        u = (Q - P).by(1 / length)
        side = Jet.constant([0, 0, 1]).cross(u).unit()
        rod = minimal.columns(side, u.cross(side), u)
        return [
            Moved(0.4, np.diag([1e-4, 5e-4, 5e-4]), P.by(REAL("0.5")), R),
            Moved(0.3, np.diag([6e-3, 6e-3, 0.0]), (P + Q).by(REAL("0.5")), rod),
            Moved(0.6, np.diag([1e-3, 5e-3, 6e-3]), f1.by(Q0 / 2) + pivot, turned),
        ]

    gravity = (0.0, -float(G0), 0.0)
    model = OneWay(lambda p: [Jet(p[0], REAL(1), REAL(0))], bodies, gravity)
    y0 = np.array([REAL("0.3"), 5], REAL)
    states = model.links(y0)
    u = states[1].R[:, 2]
    states[1] = states[1]._replace(w=states[1].w - u * (u @ states[1].w))  # no spin
    start = _start(["crank", "rod", "rocker"], states)
    crank, rod, rocker = start["pose0"].values()
    half, joints, ground = 0.5 * float(length), lierb.joints, np.eye(4)
    P, Q = (rod[:3, 3] + side * half * rod[:3, 2] for side in (-1.0, 1.0))
    links = [
        lierb.Link("crank", _body(0.4, (1e-4, 5e-4, 5e-4)),
                   _between(joints.revolute, _frame((0, 0, 0), (0, 0, 1)), crank, ground)),
        lierb.Link("rod", _body(0.3, (6e-3, 6e-3, 2e-5)),
                   _between(joints.spherical, _frame(P, (0, 0, 1)), rod, crank), "crank"),
        lierb.Link("rocker", _body(0.6, (1e-3, 5e-3, 6e-3)),
                   _between(joints.revolute, _frame(pivot, axis), rocker, ground)),
    ]  # fmt: skip
    ball = lierb.Loop("ball", _between(joints.spherical, _frame(Q, axis), rod, rocker),
                      "rod", "rocker")  # fmt: skip
    mechanism = lierb.Mechanism(links=links, loops=[ball], gravity=gravity)
    return Benchmark(
        mechanism, start, model.links, y0,
        lambda times: model.motion(y0[:1], y0[1], times, REAL("0.02")), ("0.25", "1"), 1e-3,
        free_axis=("rod",),
    )  # fmt: skip


# ---- two tops on each other --------------------------------------------------------------------


def spherical_double_pendulum() -> Benchmark:
    """Two boxes on ball joints, as Müller and Terze have one; our numbers.

    A. Müller, Z. Terze, The significance of the configuration space Lie group for the constraint
    satisfaction in numerical time integration of multibody systems, Mechanism and Machine Theory
    82 (2014), 173–202, has such a mechanism; its numbers were not to be found in public, so both
    bodies are the box of Müller (2016), `lierb.analysis.paper`, hung at the corner that it hangs at
    there, with gravity. y is (R₁, R₂, ω₁, ω₂), rotations row by row and ω in axes of the bodies.
    """
    mass, moments = 6.075, (0.0126563, 0.0468281, 0.0569531)
    s = np.array([0.15, -0.0375, 0.0])  # from the upper joint to the centre of mass
    gravity = np.array([0.0, 0.0, -float(G0)])
    model = minimal.DoubleTop((mass,) * 2, (np.diag(moments),) * 2, (s, s), 2.0 * s, gravity)
    eye = np.eye(3).ravel()
    y0 = np.array([*eye, *eye, 3.0, 1.5, 0.5, -2.0, 1.0, 4.0], REAL)
    start = _start(["upper", "lower"], model.links(y0))
    ball, body = lierb.joints.spherical, _body(mass, moments)
    links = [
        lierb.Link("upper", body, ball(body_point=-s)),
        lierb.Link("lower", body, ball(body_point=-s, ground_point=s), "upper"),
    ]
    mechanism = lierb.Mechanism(links=links, gravity=gravity)
    return Benchmark(
        mechanism, start, model.links, y0,
        lambda times: model.motion(
            (y0[:9], y0[9:18]), (y0[18:21], y0[21:]), times, REAL("0.02")
        ),
        ("0.25", "1"), 1e-3,
    )  # fmt: skip


BENCHMARKS: dict[str, Callable[[], Benchmark]] = {
    "A01": a01,
    **{f"A02_{N}": lambda N=N: a02(N) for N in range(1, 9)},
    "A03": a03,
    "A04": a04,
    "slider_crank": slider_crank,
    "rssr": rssr,
    "spherical_double_pendulum": spherical_double_pendulum,
}

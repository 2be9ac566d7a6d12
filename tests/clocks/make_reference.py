"""Make `reference.json`: where the bodies of `clocks.truths` are, by two ways each.

    python -m clocks.make_reference          # in tests/; needs heyoka, half a minute

The first way is what is stored: heyoka's Taylor series in quadruple precision, on quaternions (of
the universal joint on its two angles, Lagrange's equations), and for the free body Jacobi's
elliptic functions and the elliptic integral of the third kind, in 50 digits. `agreement` says how
far another way is from that: Gragg's extrapolation in extended precision, on rotation matrices and
the angular momentum in ground axes, with the universal joint's torque as an unknown; of the free
body heyoka's. Nothing here comes from lierb.
"""

import json

import mpmath
import numpy as np
from mechanisms.extrapolation import integrated

from clocks.truths import DATA, PATH, Data

mp = mpmath.mp.clone()
mp.dps = 50
REAL = np.longdouble


def pivot_inertia(data: Data):
    """3×3 kg m², about the fixed point, body axes."""
    c = [mp.mpf(x) for x in data.centre or (0, 0, 0)]
    square = sum(x * x for x in c)
    J = [mp.mpf(x) for x in data.inertia]
    mass = mp.mpf(data.mass)
    diagonal = lambda i, j: J[i] + mass * square if i == j else mp.zero
    return mp.matrix([[diagonal(i, j) - mass * c[i] * c[j] for j in range(3)] for i in range(3)])


def rotation_of(xi):
    """R of a rotation vector, by Rodrigues."""
    xi = [mp.mpf(x) for x in xi]
    angle = mp.sqrt(dot(xi, xi))
    return matrix_of(mp.cos(angle / 2), *(mp.sin(angle / 2) / angle * x for x in xi))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), a[0] * b[0])


def times_matrix(m, a):
    return [dot(row, a) for row in m]


def transposed(m):
    return [list(row) for row in zip(*m, strict=True)]


def matrix_of(w, x, y, z):
    """R of a unit quaternion."""
    return [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]


# ---------------------------------------------------------------- heyoka, in quadruple precision


def by_taylor(data: Data) -> list[dict]:
    import heyoka as hy

    quad = lambda x: hy.real128(mp.nstr(x, 40))
    K = pivot_inertia(data)
    Q = lambda m: [[quad(m[i, j]) for j in range(3)] for i in range(3)]
    inertia, inverse = Q(K), Q(mp.inverse(K))
    centre = [quad(mp.mpf(x)) for x in data.centre or (0, 0, 0)]
    weight = [quad(mp.mpf(x) * mp.mpf(data.mass)) for x in data.gravity]
    is_universal = data.ground_turn is not None

    def torque(R):
        return cross(centre, times_matrix(transposed(R), weight))

    if is_universal:
        frames = [rotation_of(xi) for xi in (data.ground_turn, data.body_turn)]
        G, B = ([[quad(x) for x in row] for row in frame] for frame in frames)
        alpha, beta, p, q = hy.make_vars("alpha", "beta", "p", "q")

        def rotation(alpha, beta, cos, sin):
            a, b, s, t = cos(alpha), cos(beta), sin(alpha), sin(beta)
            turn = [[a * b, -s, a * t], [s * b, a, s * t], [-t, 0 * a, b]]  # Rz(α) Ry(β)
            middle = [[dot(row, col) for col in B] for row in turn]  # turn Bᵀ
            return [[dot(row, col) for col in transposed(middle)] for row in G]

        def columns(beta, cos, sin):
            """Coefficients of ω = a α̇ + e₂ β̇, body axes, and dᵃ/dβ."""
            b, t = cos(beta), sin(beta)
            return times_matrix(B, [-t, 0 * b, b]), times_matrix(B, [-b, 0 * b, -t])

        e2 = [row[1] for row in B]
        R = rotation(alpha, beta, hy.cos, hy.sin)
        a, da = columns(beta, hy.cos, hy.sin)
        omega = [a[i] * p + e2[i] * q for i in range(3)]
        bent = [da[i] * (q * p) for i in range(3)]
        load = [
            x - y - z
            for x, y, z in zip(
                torque(R), cross(omega, times_matrix(inertia, omega)),
                times_matrix(inertia, bent), strict=True,
            )
        ]  # fmt: skip
        Ka, Ke = times_matrix(inertia, a), times_matrix(inertia, e2)
        m11, m12, m22 = dot(a, Ka), dot(e2, Ka), dot(e2, Ke)
        f1, f2 = dot(a, load), dot(e2, load)
        determinant = m11 * m22 - m12 * m12
        system = [
            (alpha, p), (beta, q),
            (p, (m22 * f1 - m12 * f2) / determinant), (q, (m11 * f2 - m12 * f1) / determinant),
        ]  # fmt: skip
        start = [0.0, 0.0, *data.rates0]
    else:
        w, x, y, z, *omega = variables = hy.make_vars("w", "x", "y", "z", "p", "q", "r")
        half = hy.real128(0.5)
        p, q, r = omega
        R = matrix_of(w, x, y, z)
        momentum = times_matrix(inertia, omega)
        moment = cross(momentum, omega)
        if data.centre is not None:
            moment = [a + b for a, b in zip(moment, torque(R), strict=True)]
        rates = [
            half * (-x * p - y * q - z * r), half * (w * p + y * r - z * q),
            half * (w * q + z * p - x * r), half * (w * r + x * q - y * p),
            *times_matrix(inverse, moment),
        ]  # fmt: skip
        system = list(zip(variables, rates, strict=True))
        start = [1.0, 0.0, 0.0, 0.0, *data.omega0]
    taylor = hy.taylor_adaptive(
        system, [hy.real128(x) for x in start], fp_type=hy.real128, compact_mode=True
    )
    states = []
    for t in data.times:
        taylor.propagate_until(quad(mp.mpf(t)))
        now = [mp.mpf(str(x)) for x in taylor.state]
        if is_universal:
            G, B = frames
            R = rotation(now[0], now[1], mp.cos, mp.sin)
            a, _ = columns(now[1], mp.cos, mp.sin)
            omega = [a[i] * now[2] + B[i][1] * now[3] for i in range(3)]
        else:
            R, omega = matrix_of(*now[:4]), now[4:]
        states.append(state_of(data, mp.mpf(t), R, omega))
    return states


def state_of(data: Data, t, R, omega) -> dict:
    if data.centre is None:
        v0 = [mp.mpf(x) for x in data.v0]
        return {"rotation": R, "position": [x * t for x in v0], "omega": list(omega),
                "v": times_matrix(transposed(R), v0)}  # fmt: skip
    centre = [mp.mpf(x) for x in data.centre]
    return {"rotation": R, "position": times_matrix(R, centre), "omega": list(omega),
            "v": cross(omega, centre)}  # fmt: skip


# ---------------------------------------------------------------- the free body in closed form


def by_jacobi(data: Data) -> list[dict]:
    """ω = (a cn, b sn, c dn)(τ); R by the angle about the angular momentum.

    Landau and Lifshitz, Mechanics, §37, for J₁ < J₂ < J₃ and ω about e₃. In axes with e₃ along the
    angular momentum, of size M, the body's turn about it goes at
    M (2T − J₃ω₃²)/(M² − J₃²ω₃²) = M/J₃ + M (2T − M²/J₃)/(P (1 − n sn²)), P = M² − J₃²c²,
    so that its integral is an elliptic one of the third kind, Π(n; am τ | m).
    """
    J, w = [mp.mpf(x) for x in data.inertia], [mp.mpf(x) for x in data.omega0]
    twice_energy = sum(J[i] * w[i] ** 2 for i in range(3))
    momentum = [J[i] * w[i] for i in range(3)]
    M2 = sum(x**2 for x in momentum)
    M = mp.sqrt(M2)
    assert J[0] < J[1] < J[2]
    assert twice_energy * J[1] < M2
    assert w[2] > 0
    low, high = M2 - twice_energy * J[0], twice_energy * J[2] - M2
    a = mp.sqrt(high / (J[0] * (J[2] - J[0])))
    b = mp.sqrt(high / (J[1] * (J[2] - J[1])))
    c = mp.sqrt(low / (J[2] * (J[2] - J[0])))
    m = (J[1] - J[0]) * high / ((J[2] - J[1]) * low)
    rate = mp.sqrt((J[2] - J[1]) * low / (J[0] * J[1] * J[2]))
    phase = mp.atan2(w[1] / b, w[0] / a)
    tau0, K = mp.ellipf(phase, m), mp.ellipk(m)
    P = M2 - (J[2] * c) ** 2
    n = -((J[2] * c) ** 2) * m / P

    def amplitude(tau):
        turns = mp.floor((tau + K) / (2 * K))
        rest = tau - 2 * K * turns
        return mp.atan2(mp.ellipfun("sn", rest, m=m), mp.ellipfun("cn", rest, m=m)) + mp.pi * turns

    def angle(tau):
        third = mp.ellippi(n, amplitude(tau), m)
        return M / J[2] * (tau - tau0) / rate + M * (twice_energy - M2 / J[2]) / (P * rate) * third

    def body_turn(omega, psi):
        """R in axes with e₃ along the angular momentum, from its direction in the body and ψ."""
        g = [J[i] * omega[i] / M for i in range(3)]  # R's third row
        across = mp.sqrt(g[0] ** 2 + g[1] ** 2)
        first = [-g[0] * g[2] / across, -g[1] * g[2] / across, across]  # e₃ made ⊥ g
        second = cross(g, first)
        co, si = mp.cos(psi), mp.sin(psi)
        # the ground's axes turn backwards, seen from the body's
        return [[co * x - si * y for x, y in zip(first, second, strict=True)],
                [si * x + co * y for x, y in zip(first, second, strict=True)], g]  # fmt: skip

    start = transposed(body_turn(w, mp.zero))
    psi0 = angle(tau0)
    states = []
    for t in data.times:
        tau = tau0 + rate * mp.mpf(t)
        cn, sn, dn = (mp.ellipfun(f, tau, m=m) for f in ("cn", "sn", "dn"))
        omega = [a * cn, b * sn, c * dn]
        now = body_turn(omega, angle(tau) - psi0)
        R = [[dot(row, col) for col in transposed(now)] for row in start]
        states.append(state_of(data, mp.mpf(t), R, omega))
    return states


# ---------------------------------------------------------------- another way, in ground axes


def by_extrapolation(data: Data, longest: float = 0.02) -> list[dict]:
    K = pivot_inertia(data)
    to_real = lambda m: np.array([[REAL(mp.nstr(m[i, j], 25)) for j in range(3)] for i in range(3)])
    inverse = to_real(mp.inverse(K))
    centre = np.array(data.centre, REAL)
    weight = np.array(data.gravity, REAL) * REAL(data.mass)
    universal = data.ground_turn is not None
    R = np.eye(3, dtype=REAL)
    omega = np.array(data.omega0, REAL)
    if universal:
        G, B = (
            np.array([[REAL(mp.nstr(x, 25)) for x in row] for row in rotation_of(xi)])
            for xi in (data.ground_turn, data.body_turn)
        )
        R = G @ B.T
        omega = B @ np.array((0, data.rates0[1], data.rates0[0]), REAL)
    y0 = np.concatenate([R.ravel(), R @ (to_real(K) @ omega)])

    def rate(y):
        R, momentum = y[:9].reshape(3, 3), y[9:]
        in_space = R @ inverse @ R.T
        omega = in_space @ momentum
        turning = np.stack([np.cross(omega, R[:, i]) for i in range(3)], axis=1)
        load = np.cross(R @ centre, weight)
        if universal:  # torque along n = g₃ × b₂, so that n·ω stays 0
            g, b = G[:, 2], R @ B[:, 1]
            n, n_rate = np.cross(g, b), np.cross(g, np.cross(omega, b))
            # ω̇ = I⁻¹(load + n λ − ω × L), n·ω̇ = −ṅ·ω
            bare = in_space @ (load - np.cross(omega, momentum))
            size = -(n_rate @ omega + n @ bare) / (n @ in_space @ n)
            load = load + size * n
        return np.concatenate([turning.ravel(), load])

    times = [REAL(0), *(REAL(t) for t in data.times)]
    found, _ = integrated(rate, y0, times, longest, tolerance=1e-18, columns=10)
    states = []
    for y in found[1:]:
        R = y[:9].reshape(3, 3)
        omega = inverse @ R.T @ y[9:]
        states.append({"rotation": R, "position": R @ centre, "omega": omega,
                       "v": np.cross(omega, centre)})  # fmt: skip
    return states


# ---------------------------------------------------------------- both


def off(found: dict, other: dict) -> float:
    """The largest difference of any number, relative to 1 + the largest of its kind."""
    worst = 0.0
    for name in found:
        a = np.array([mp.mpf(str(x)) for x in np.ravel(np.array(found[name], dtype=object))])
        b = np.array([mp.mpf(str(x)) for x in np.ravel(np.array(other[name], dtype=object))])
        worst = max(worst, float(abs(a - b).max() / (1 + abs(a).max())))
    return worst


def written(numbers) -> list:
    if isinstance(numbers[0], (list, tuple)):
        return [written(row) for row in numbers]
    return [mp.nstr(mp.mpf(x), 25) for x in numbers]


def main() -> None:
    made = {}
    for name, data in DATA.items():
        free = data.centre is None
        states = by_jacobi(data) if free else by_taylor(data)
        others = by_taylor(data) if free else by_extrapolation(data)
        agreement = [off(a, b) for a, b in zip(states, others, strict=True)]
        made[name] = {
            "states": {t: {k: written(v) for k, v in s.items()}
                       for t, s in zip(data.times, states, strict=True)},
            "agreement": dict(zip(data.times, agreement, strict=True)),
        }  # fmt: skip
        print(name, made[name]["agreement"])
    PATH.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

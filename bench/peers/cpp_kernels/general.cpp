// The top as a free body on SE(3), held by its joint through a saddle point solved in every stage:
// C = (R, r), r of the centre of mass, twist (ω, v) in body axes, and
//     [[M, Jᵀ], [J, 0]] (V̇, λ) = (ad_Vᵀ M V + W, η).
// As in a general solver, J and η are made from pose and velocity and J M⁻¹ Jᵀ is formed and
// factored as L D Lᵀ every time. What is special to a joint is only which entries are zero.
#include "runge_kutta.hpp"

namespace {

struct Kinematics {
    Vec e1, e2, e3;  // the ground's axes in body axes, the rows of R
    Vec omega;
};

INLINE Kinematics kinematics(Quaternion q, Vec omega) {
    const Lanes x = q.x + q.x, y = q.y + q.y, z = q.z + q.z;
    return {{1.0 - q.y * y - q.z * z, q.x * y - q.w * z, q.x * z + q.w * y},
            {q.x * y + q.w * z, 1.0 - q.x * x - q.z * z, q.y * z - q.w * x},
            {q.x * z - q.w * y, q.y * z + q.w * x, 1.0 - q.x * x - q.y * y},
            omega};
}

// The rows that a joint has besides the three that hold the pivot, all of them purely angular:
// dot(k, a) is row k times a, response(k, s) is s times row k, minus takes away a multiple of that,
// and eta is minus the row's acceleration at V̇ = 0.
struct Spherical {
    static constexpr int ROWS = 0;
    INLINE Spherical(const Kinematics&) {}
    INLINE Lanes dot(int, Vec a) const { return a.x; }
    INLINE Lanes eta(int) const { return Lanes{}; }
    INLINE Vec response(int, Constant) const { return {}; }
    INLINE Vec minus(int, Lanes, Constant, Vec a) const { return a; }
};

struct Revolute {  // Ω₁ = Ω₃ = 0: about the body's e₂
    static constexpr int ROWS = 2;
    INLINE Revolute(const Kinematics&) {}
    INLINE Lanes dot(int k, Vec a) const { return k == 0 ? a.x : a.z; }
    INLINE Lanes eta(int) const { return Lanes{}; }
    INLINE Vec response(int k, Constant s) const {
        const Lanes zero{};
        return k == 0 ? Vec{zero + s.x, zero, zero} : Vec{zero, zero, zero + s.z};
    }
    INLINE Vec minus(int k, Lanes factor, Constant s, Vec a) const {
        return k == 0 ? Vec{a.x - factor * s.x, a.y, a.z} : Vec{a.x, a.y, a.z - factor * s.z};
    }
};

struct Universal {  // R₃₂ = 0: the body's e₂ stays perpendicular to the ground's e₃
    static constexpr int ROWS = 1;
    Lanes x, z, rest;  // the row is e₂ × e3 = (x, 0, z)
    INLINE Universal(const Kinematics& k)
        : x(k.e3.z), z(-k.e3.x),
          rest(::dot(k.omega, k.omega) * k.e3.y - ::dot(k.omega, k.e3) * k.omega.y) {}
    INLINE Lanes dot(int, Vec a) const { return x * a.x + z * a.z; }
    INLINE Lanes eta(int) const { return rest; }
    INLINE Vec response(int, Constant s) const { return {s.x * x, Lanes{}, s.z * z}; }
    INLINE Vec minus(int, Lanes factor, Constant s, Vec a) const {
        return {a.x - factor * (s.x * x), a.y, a.z - factor * (s.z * z)};
    }
};

// Solves S λ = rhs; both are overwritten, rhs by λ.
template <int N>
INLINE void solve(Lanes (&s)[N][N], Lanes (&rhs)[N]) {
    Lanes pivot_inverse[N];
#pragma GCC unroll 6
    for (int j = 0; j < N; j++) {
        if (WIDTH < 8 || (j % 2 == 0 && j + 1 == N)) {
            pivot_inverse[j] = 1.0 / s[j][j];
        } else if (j % 2 == 0) {  // and the next by the same division: they are slow on 512 bits
            const Lanes p = s[j][j], minor = p * s[j + 1][j + 1] - s[j + 1][j] * s[j + 1][j];
            const Lanes r = 1.0 / (p * minor);
            pivot_inverse[j] = minor * r;
            pivot_inverse[j + 1] = p * (p * r);
        }
#pragma GCC unroll 6
        for (int i = j + 1; i < N; i++) {
            const Lanes l = s[i][j] * pivot_inverse[j];
#pragma GCC unroll 6
            for (int k = j + 1; k <= i; k++) s[i][k] -= l * s[k][j];
            rhs[i] -= l * rhs[j];
        }
    }
#pragma GCC unroll 6
    for (int i = N - 1; i >= 0; i--) {
#pragma GCC unroll 6
        for (int k = i + 1; k < N; k++) rhs[i] -= s[k][i] * rhs[k];
        rhs[i] *= pivot_inverse[i];
    }
}

// A free body on SE(3), but for its accelerations.
template <int TERMS>
struct Free {
    struct Base {
        Quaternion q;
        Vec r, omega, v;
        Vec half_up;  // R₀ᵀe₃/2
    };
    struct Point {
        Vec xi, eta;  // X/2; but as a rate, that of X
        Vec omega, v;
        friend INLINE Point axpy(double s, Point a, Point b) {
            return {axpy(0.5 * s, a.xi, b.xi), axpy(0.5 * s, a.eta, b.eta),
                    axpy(s, a.omega, b.omega), axpy(s, a.v, b.v)};
        }
    };

    Constant centre, pivot;  // pivot: from the centre of mass, body axes
    Constant response;       // m Θ⁻¹; all of M⁻¹ is taken m-fold, and λ is 1/m of what it should be
    Constant gyroscopic;     // of Euler's equations: (Θ₂ − Θ₃)/Θ₁, …
    double gravity;

    explicit Free(const Top& top) : centre(top.centre), gravity(top.gravity) {
        const Constant j = top.inertia;
        pivot = {-centre.x, -centre.y, -centre.z};
        response = {top.mass / j.x, top.mass / j.y, top.mass / j.z};
        gyroscopic = {(j.y - j.z) / j.x, (j.z - j.x) / j.y, (j.x - j.y) / j.z};
    }

    INLINE Base start(Vec omega) const {
        const Lanes zero = 0.0 * omega.x;
        const Quaternion q{zero + 1.0, zero, zero, zero};
        const Vec r{zero + centre.x, zero + centre.y, zero + centre.z};
        return {q, r, omega, cross(pivot, omega), half_of_up(q)};
    }
    INLINE Final finish(const Base& base) const { return {base.r, base.omega}; }
    INLINE Point origin(const Base& base) const { return {{}, {}, base.omega, base.v}; }

    // M⁻¹(ad_Vᵀ M V + W)
    INLINE Vec free_turning(Vec w) const {
        return {gyroscopic.x * (w.y * w.z), gyroscopic.y * (w.z * w.x), gyroscopic.z * (w.x * w.y)};
    }
    INLINE Vec free_falling(Vec half_up, Point at) const {
        return cross_add(2 * gravity * half_up, at.v, at.omega);
    }

    // Rᵀd̈ at V̇ = 0: −η of the rows that hold the pivot, in body axes
    INLINE Vec bias(Point at) const {
        return cross(at.omega, cross_add(at.v, at.omega, pivot));
    }

    // Ẋ by dexp⁻¹ of −X
    INLINE void local_rates(Point at, Point& rates) const {
        const Vec x = at.xi, e = at.eta, w = at.omega, v = at.v;
        const Lanes y = dot(x, x), c0 = series<TERMS>(COT, y);
        const Lanes c1 = dot(x, e) * series<TERMS - 1>(COT_RATE, y);
        const Vec xw = cross(x, w), turning = axpy(c0, xw, w);
        const Vec moving = axpy(c1, xw, axpy(c0, cross_add(cross(e, w), x, v), v));
        rates.xi = cross_add(w, x, turning);
        rates.eta = cross_add(cross_add(v, x, moving), e, turning);
    }

    INLINE Base onward(const Base& base, Point at) const {
        const Vec x = at.xi;
        const Lanes y = dot(x, x), sinc = series<TERMS>(SINC, y);
        // dexp of X, half of it
        const Vec xe = cross(x, at.eta);
        const Vec moved = cross_add(axpy(sinc * sinc, xe, at.eta), series<TERMS>(TURN, y) * x, xe);
        const Quaternion q = turned<TERMS>(base.q, x);
        return {q, base.r + 2.0 * rotated(base.q, moved), at.omega, at.v, half_of_up(q)};
    }
};

// The saddle point as it stands: the pivot's rows in ground axes, everything made anew.
template <class Joint, int TERMS>
struct Saddle : Free<TERMS> {
    using typename Free<TERMS>::Base;
    using typename Free<TERMS>::Point;
    using Free<TERMS>::Free;

    INLINE void accelerate(Quaternion q, Point at, Point& rates) const {
        constexpr int ROWS = 3 + Joint::ROWS;
        const Kinematics k = kinematics(q, at.omega);
        const Joint joint(k);
        const Vec direction[3] = {k.e1, k.e2, k.e3};
        const Vec alpha = this->free_turning(at.omega);
        const Vec fall = this->free_falling(0.5 * k.e3, at);
        const Vec free = fall + this->bias(at);

        Vec arm[3], turn[ROWS];
        Lanes s[ROWS][ROWS], rhs[ROWS];
#pragma GCC unroll 6
        for (int i = 0; i < 3; i++) {
            arm[i] = cross(this->pivot, direction[i]);
            turn[i] = scaled(this->response, arm[i]);
            rhs[i] = dot_add(dot(direction[i], free), arm[i], alpha);
#pragma GCC unroll 6
            for (int j = 0; j <= i; j++)
                s[i][j] = dot_add(dot(direction[i], direction[j]), arm[i], turn[j]);
        }
#pragma GCC unroll 6
        for (int i = 3; i < ROWS; i++) {
            turn[i] = joint.response(i - 3, this->response);
            rhs[i] = joint.dot(i - 3, alpha) - joint.eta(i - 3);
#pragma GCC unroll 6
            for (int j = 0; j <= i; j++) s[i][j] = joint.dot(i - 3, turn[j]);
        }
        solve<ROWS>(s, rhs);

        rates.omega = alpha;
        rates.v = fall;
#pragma GCC unroll 6
        for (int i = 0; i < 3; i++) {
            rates.omega = axpy(-rhs[i], turn[i], rates.omega);
            rates.v = axpy(-rhs[i], direction[i], rates.v);
        }
#pragma GCC unroll 6
        for (int i = 3; i < ROWS; i++)
            rates.omega = joint.minus(i - 3, rhs[i], this->response, rates.omega);
    }

    INLINE Point first_rates(const Base& base) const {
        Point rates{base.omega, base.v, {}, {}};
        accelerate(base.q, this->origin(base), rates);
        return rates;
    }
    INLINE Point rates(const Base& base, Point at) const {
        Point rates;
        this->local_rates(at, rates);
        accelerate(turned<TERMS>(base.q, at.xi), at, rates);
        return rates;
    }
};

// The same constraint, knowing that in body axes the pivot's rows [−p̂ I] and their Schur complement
// are constant: their part of the solution is a constant matrix. K is what is left of M⁻¹ for
// torques.
template <class Joint, int TERMS>
struct FixedRows : Free<TERMS> {
    using typename Free<TERMS>::Base;
    using typename Free<TERMS>::Point;

    Symmetric holding;     // (J M⁻¹ Jᵀ)⁻¹
    Symmetric compliance;  // K
    double pair[3];        // inverse of K's first and third rows and columns: 11, 13, 33

    explicit FixedRows(const Top& top) : Free<TERMS>(top) {
        const Constant p = this->pivot, w = this->response;
        holding = Symmetric{1 + w.y * p.z * p.z + w.z * p.y * p.y,
                            1 + w.x * p.z * p.z + w.z * p.x * p.x,
                            1 + w.x * p.y * p.y + w.y * p.x * p.x,
                            -w.z * p.x * p.y, -w.y * p.x * p.z, -w.x * p.y * p.z}.inverse();
        const double pp = p.x * p.x + p.y * p.y + p.z * p.z;
        compliance = Symmetric{1 / w.x + pp - p.x * p.x, 1 / w.y + pp - p.y * p.y,
                               1 / w.z + pp - p.z * p.z, -p.x * p.y, -p.x * p.z,
                               -p.y * p.z}.inverse();
        const Symmetric& k = compliance;
        const double d = k.xx * k.zz - k.xz * k.xz;
        pair[0] = k.zz / d, pair[1] = -k.xz / d, pair[2] = k.xx / d;
    }

    INLINE void accelerate(Vec half_up, Point at, Point& rates) const {
        const Vec alpha = this->free_turning(at.omega), fall = this->free_falling(half_up, at);
        const Vec force = holding * cross_add(fall + this->bias(at), alpha, this->pivot);
        Vec turn = scaled(this->response, cross(this->pivot, force));
        rates.omega = axpy(-1.0, turn, alpha);
        rates.v = axpy(-1.0, force, fall);
        if constexpr (Joint::ROWS == 1) {
            const Joint joint({{}, {}, 2.0 * half_up, at.omega});
            const Vec a{joint.x, Lanes{}, joint.z};
            turn = compliance * a;
            turn = (joint.dot(0, rates.omega) - joint.eta(0)) / joint.dot(0, turn) * turn;
        } else if constexpr (Joint::ROWS == 2) {
            const Lanes x = rates.omega.x, z = rates.omega.z;
            turn = compliance * Vec{pair[0] * x + pair[1] * z, Lanes{}, pair[1] * x + pair[2] * z};
        }
        if constexpr (Joint::ROWS > 0) {
            rates.omega = axpy(-1.0, turn, rates.omega);
            rates.v = cross_add(rates.v, turn, this->pivot);
        }
    }

    INLINE Point first_rates(const Base& base) const {
        Point rates{base.omega, base.v, {}, {}};
        accelerate(base.half_up, this->origin(base), rates);
        return rates;
    }
    INLINE Point rates(const Base& base, Point at) const {
        Point rates;
        this->local_rates(at, rates);
        accelerate(carried_back<TERMS>(at.xi, base.half_up), at, rates);
        return rates;
    }
};

template <template <class, int> class Motion, class Joint>
void integrate(const Job& job) {
    by_angle(job, [&](auto terms) { Integrator<RK4, Motion<Joint, terms>>(job).run(job); });
}

}  // namespace

extern "C" {
void general(const Job* job) { integrate<Saddle, Spherical>(*job); }
void general_revolute(const Job* job) { integrate<Saddle, Revolute>(*job); }
void general_universal(const Job* job) { integrate<Saddle, Universal>(*job); }
void general_fixed(const Job* job) { integrate<FixedRows, Spherical>(*job); }
void general_fixed_revolute(const Job* job) { integrate<FixedRows, Revolute>(*job); }
void general_fixed_universal(const Job* job) { integrate<FixedRows, Universal>(*job); }
}

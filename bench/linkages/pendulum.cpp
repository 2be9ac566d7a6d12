// The double pendulum in general frames, WIDTH of them side by side, every number of each its own.
// GROUP blocks of lanes take each stage in turn, as in runge_kutta.hpp.
//
// Poses are (cos, sin) of the angles: a stage turns them by a small angle, so that no sine is asked
// of a large one. The step takes q as RK4 does, in the angle since its beginning.
#include <algorithm>

#include "../peers/cpp_kernels/lanes.hpp"

#ifndef GROUP
#define GROUP 4
#endif
#define EACH_BLOCK _Pragma("GCC unroll 1") for (Block* p = first; p < last; p++)

namespace {

struct Turn {
    Lanes c, s;
    INLINE Turn() : c{}, s{} {}
    INLINE Turn(Lanes c, Lanes s) : c(c), s(s) {}
    INLINE Turn(const Turn& a) : c(a.c), s(a.s) {}
    INLINE Turn& operator=(const Turn& a) {
        c = a.c, s = a.s;
        return *this;
    }
};

constexpr double FASTEST = 20;  // rad/s; none of the benchmark's links gets there
constexpr double SINES[] = {1, -1. / 6, 1. / 120, -1. / 5040, 1. / 362880};
constexpr double COSINES[] = {-1. / 2, 1. / 24, -1. / 720, 1. / 40320, -1. / 3628800};

// By x: three terms are exact to 3e-16 up to 0.02, five up to 0.2. What is left of rounding in the
// length is taken out once a step.
template <int TERMS>
INLINE Turn turned(Turn t, Lanes x) {
    const Lanes z = x * x, s = x * series<TERMS>(SINES, z), c = z * series<TERMS>(COSINES, z);
    return {t.c + t.c * c - t.s * s, t.s + t.s * c + t.c * s};  // c is cos − 1
}
INLINE Turn normalised(Turn t) {
    const Lanes k = 1.5 - 0.5 * (t.c * t.c + t.s * t.s);
    return {k * t.c, k * t.s};
}

// Rz(q)ᵀ a
INLINE Vec back(Turn t, Vec a) {
    return {t.c * a.x + t.s * a.y, t.c * a.y - t.s * a.x, a.z};
}

struct Rates {
    Lanes first, second;
    INLINE Rates(Lanes a, Lanes b) : first(a), second(b) {}
    INLINE Rates() : first{}, second{} {}
    INLINE Rates(const Rates& a) : first(a.first), second(a.second) {}
    INLINE Rates& operator=(const Rates& a) {
        first = a.first, second = a.second;
        return *this;
    }
};
INLINE Rates axpy(double s, Rates a, Rates b) {
    return {b.first + s * a.first, b.second + s * a.second};
}

INLINE Rates solved(Lanes m11, Lanes m12, Lanes m22, Lanes f1, Lanes f2) {
    const Lanes r = 1.0 / (m11 * m22 - m12 * m12);
    return {(m22 * f1 - m12 * f2) * r, (m11 * f2 - m12 * f1) * r};
}

// Newton and Euler body by body, in the axes of the joints, second link first: what articulated
// bodies come to for two links, with what does not move folded by hand. In the second joint's axes
// on the first link, that link's unit twist is (e, u) and its centripetal acceleration t.
struct Bodies {
    static constexpr int NUMBERS = 35;
    Vec gravity;          // in the first joint's axes on the ground
    Vec first_moment;     // m c of link 1
    Lanes first_inertia;  // about its axis
    Vec e, u, t;
    Vec axes[3];  // rows of Eᵀ: the second joint's axes in link 1
    Lanes mass;
    Vec moment;               // m c of link 2
    Lanes xx, yy, zz, xy, xz, yz;  // of link 2, about its joint

    INLINE Vec inertia(Vec a) const {
        return {xx * a.x + xy * a.y + xz * a.z, xy * a.x + yy * a.y + yz * a.z,
                xz * a.x + yz * a.y + zz * a.z};
    }

    INLINE Rates accelerations(Turn q1, Turn q2, Rates w) const {
        const Vec g = back(q1, gravity);
        const Lanes w1 = w.first, w2 = w.second, square = w1 * w1;
        auto pushed = [&](Lanes by, Vec row) { return square * by - row.x * g.x - row.y * g.y - row.z * g.z; };
        const Vec e = back(q2, this->e), u = back(q2, this->u);
        // Of the joint's point, as if weight were an acceleration.
        const Vec a = back(q2, {pushed(t.x, axes[0]), pushed(t.y, axes[1]), pushed(t.z, axes[2])});

        // Momenta of link 2 at its joint as the first joint turns at 1 rad/s. The forces on a body
        // that accelerates by (α, a) do the work α·angular + a·linear in that motion.
        const Vec je = inertia(e), angular = cross_add(je, moment, u);
        const Vec linear = cross_add(mass * u, e, moment);
        const Vec omega{w1 * e.x, w1 * e.y, w1 * e.z + w2};
        const Vec spin{w1 * je.x + w2 * xz, w1 * je.y + w2 * yz, w1 * je.z + w2 * zz};
        const Vec gyroscopic = cross(omega, spin), swing = cross(omega, cross(omega, moment));
        const Lanes bend = w1 * w2, ax = bend * e.y, ay = -bend * e.x;  // α: ω₁×ω₂
        const Lanes m11 = dot_add(dot_add(first_inertia, e, angular), u, linear);
        const Lanes weight = first_moment.x * g.y - first_moment.y * g.x;
        const Lanes load = dot_add(dot(e, gyroscopic), u, swing) + ax * angular.x + ay * angular.y;
        const Lanes f1 = weight - dot_add(load, a, linear);
        const Lanes f2 = moment.y * a.x - moment.x * a.y - ax * xz - ay * yz - gyroscopic.z;
        return solved(m11, angular.z, zz, f1, f2);
    }
};

// Lagrange's equations: mass matrix and potential are finite Fourier series in the angles.
struct Series {
    static constexpr int NUMBERS = 17;
    Lanes m11[5], m12[3], m22, v[8];

    INLINE Rates accelerations(Turn q1, Turn q2, Rates w) const {
        const Lanes c = q2.c, s = q2.s, cc = 2.0 * c * c - 1.0, ss = 2.0 * s * c;
        const Lanes a = m11[0] + m11[1] * c + m11[2] * s + m11[3] * cc + m11[4] * ss;
        const Lanes da = m11[2] * c - m11[1] * s + 2.0 * (m11[4] * cc - m11[3] * ss);
        const Lanes b = m12[0] + m12[1] * c + m12[2] * s, db = m12[2] * c - m12[1] * s;
        const Lanes x = v[0] + v[1] * c + v[2] * s, y = v[3] + v[4] * c + v[5] * s;
        const Lanes dx = v[2] * c - v[1] * s, dy = v[5] * c - v[4] * s;
        const Lanes v1 = q1.c * y - q1.s * x;
        const Lanes v2 = q1.c * dx + q1.s * dy + (v[7] * c - v[6] * s);
        const Lanes w1 = w.first, w2 = w.second;
        return solved(a, b, m22, -(da * w1 + db * w2) * w2 - v1, 0.5 * da * w1 * w1 - v2);
    }
};

template <class Motion, int TERMS>
void integrate_by(const double* numbers, const double* start, double* out, long count, long steps,
               double h) {
    struct Block {
        Motion motion;
        Turn q1, q2;
        Rates w, a[3], w_at[3];
    };
    alignas(64) static thread_local Block blocks[GROUP];
    for (long from = 0; from < count; from += GROUP * WIDTH) {
        Block* const first = blocks;
        Block* const last = blocks + std::min<long>(GROUP, (count - from) / WIDTH);
        auto at = [&](auto* data, Block* p, int row) {
            return data + row * count + from + (p - first) * WIDTH;
        };
        EACH_BLOCK {
            Lanes* to = (Lanes*)&p->motion;
            for (int i = 0; i < Motion::NUMBERS; i++) to[i] = *(const Unaligned*)at(numbers, p, i);
            auto in = [&](int row) { return Lanes(*(const Unaligned*)at(start, p, row)); };
            p->q1 = {in(0), in(1)}, p->q2 = {in(2), in(3)}, p->w = {in(4), in(5)};
        }
        // Of a stage: at which fraction of the step, and from which rates.
        auto stage = [&](Block* p, double by, Rates moved, Rates pushed, Rates& w) {
            w = axpy(by, pushed, p->w);
            return p->motion.accelerations(turned<TERMS>(p->q1, by * moved.first),
                                           turned<TERMS>(p->q2, by * moved.second), w);
        };
        for (long k = 0; k < steps; k++) {
            EACH_BLOCK p->a[0] = p->motion.accelerations(p->q1, p->q2, p->w);
            EACH_BLOCK p->a[1] = stage(p, h / 2, p->w, p->a[0], p->w_at[0]);
            EACH_BLOCK p->a[2] = stage(p, h / 2, p->w_at[0], p->a[1], p->w_at[1]);
            EACH_BLOCK {
                const Rates a4 = stage(p, h, p->w_at[1], p->a[2], p->w_at[2]);
                const Rates turns = axpy(2, axpy(1, p->w_at[0], p->w_at[1]), axpy(1, p->w, p->w_at[2]));
                p->q1 = normalised(turned<TERMS>(p->q1, h / 6 * turns.first));
                p->q2 = normalised(turned<TERMS>(p->q2, h / 6 * turns.second));
                p->w = axpy(h / 6, axpy(2, axpy(1, p->a[1], p->a[2]), axpy(1, p->a[0], a4)), p->w);
            }
        }
        EACH_BLOCK {
            const Lanes found[] = {p->q1.c, p->q1.s, p->q2.c, p->q2.s, p->w.first, p->w.second};
            for (int i = 0; i < 6; i++) *(Unaligned*)at(out, p, i) = found[i];
        }
    }
}

template <class Motion>
void integrate(const double* numbers, const double* start, double* out, long count, long steps,
               double h) {
    const auto run = FASTEST * h < 0.0201 ? integrate_by<Motion, 3> : integrate_by<Motion, 5>;
    run(numbers, start, out, count, steps, h);
}

}  // namespace

extern "C" {
void bodies(const double* numbers, const double* start, double* out, long n, long steps, double h) {
    static_assert(sizeof(Bodies) == Bodies::NUMBERS * sizeof(Lanes));
    integrate<Bodies>(numbers, start, out, n, steps, h);
}
void series(const double* numbers, const double* start, double* out, long n, long steps, double h) {
    integrate<Series>(numbers, start, out, n, steps, h);
}
}

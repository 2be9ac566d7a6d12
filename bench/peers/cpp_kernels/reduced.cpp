// The top by its rotation about the pivot alone.
#include "runge_kutta.hpp"

namespace {

// State: q, and l = J ω about the pivot in body axes. A Runge–Kutta method takes the same steps in
// l as in ω, and l̇ = l×ω + m c×Rᵀg needs J⁻¹ once only.
struct Reduced {
    struct Base {
        Quaternion q;
        Vec l;
    };

    Symmetric inertia, inverse;
    Constant centre, moment;  // moment: 2 m g c

    explicit Reduced(const Top& top) : centre(top.centre) {
        const double m = top.mass, x = centre.x, y = centre.y, z = centre.z;
        inertia = {top.inertia.x + m * (y * y + z * z), top.inertia.y + m * (x * x + z * z),
                   top.inertia.z + m * (x * x + y * y), -m * x * y, -m * x * z, -m * y * z};
        inverse = inertia.inverse();
        const double s = 2 * m * top.gravity;
        moment = {s * x, s * y, s * z};
    }

    INLINE Base start(Vec omega) const {
        const Lanes zero = 0.0 * omega.x;
        return {{zero + 1.0, zero, zero, zero}, inertia * omega};
    }

    INLINE Final finish(const Base& base) const {
        return {rotated(base.q, centre), inverse * base.l};
    }

    INLINE Vec momentum_rate(Vec l, Vec omega, Vec half_up) const {
        return cross_add(cross(l, omega), moment, half_up);
    }
};

// Munthe-Kaas: R = R₀ exp ξ.
template <int TERMS>
struct Rkmk : Reduced {
    struct Base : Reduced::Base {
        Vec half_up;  // R₀ᵀe₃/2
    };
    struct Point {
        Vec x, l;  // x = ξ/2; but as a rate, that of ξ
        friend INLINE Point axpy(double s, Point a, Point b) {
            return {axpy(0.5 * s, a.x, b.x), axpy(s, a.l, b.l)};
        }
    };

    using Reduced::Reduced;
    INLINE Base start(Vec omega) const { return based(Reduced::start(omega)); }
    INLINE Base based(Reduced::Base base) const { return {base, half_of_up(base.q)}; }
    INLINE Point origin(const Base& base) const { return {Vec{}, base.l}; }

    INLINE Point first_rates(const Base& base) const {
        const Vec omega = inverse * base.l;
        return {omega, momentum_rate(base.l, omega, base.half_up)};
    }

    INLINE Point rates(const Base& base, Point at) const {
        const Lanes y = dot(at.x, at.x);
        const Vec omega = inverse * at.l;
        const Vec half_up = carried_back<TERMS>(at.x, base.half_up);
        // dexp⁻¹ of −ξ: ω + ½ ξ×ω + c₀ ξ×(ξ×ω)
        const Vec u = axpy(series<TERMS>(COT, y), cross(at.x, omega), omega);
        return {cross_add(omega, at.x, u), momentum_rate(at.l, omega, half_up)};
    }

    INLINE Base onward(const Base& base, Point at) const {
        return based({turned<TERMS>(base.q, at.x), at.l});
    }
};

// The quaternion's own equation q̇ = ½ q ω, and q back to length 1 after every step.
struct Classical : Reduced {
    struct Point {
        Quaternion q;  // as a rate, twice that
        Vec l;
        friend INLINE Point axpy(double s, Point a, Point b) {
            return {axpy(0.5 * s, a.q, b.q), axpy(s, a.l, b.l)};
        }
    };

    using Reduced::Reduced;
    INLINE Point origin(const Base& base) const { return {base.q, base.l}; }
    INLINE Point first_rates(const Base& base) const { return rates(base, origin(base)); }
    INLINE Point rates(const Base&, Point at) const {
        const Vec omega = inverse * at.l;
        return {product(at.q, omega), momentum_rate(at.l, omega, half_of_up(at.q))};
    }
    INLINE Base onward(const Base&, Point at) const { return {normalised(at.q), at.l}; }
};

}  // namespace

extern "C" {
void reduced(const Job* job) {
    by_angle(*job, [=](auto terms) { Integrator<RK4, Rkmk<terms>>(*job).run(*job); });
}
void reduced_quaternion(const Job* job) { Integrator<RK4, Classical>(*job).run(*job); }
void reduced_dop853(const Job* job) { Integrator<DOP853, Classical>(*job).run(*job); }
}

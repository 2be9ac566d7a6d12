// Numbers of WIDTH bodies side by side, and vectors and quaternions of them.
#pragma once

typedef double Lanes __attribute__((vector_size(8 * WIDTH)));
typedef Lanes Unaligned __attribute__((aligned(8)));

#define INLINE inline __attribute__((always_inline))

// Sums are written from left to right as a + b·c, which the compiler contracts into FMAs.
// Structs are copied member by member: left to itself, GCC moves them in halves of a register, and
// the next load of a whole one has to wait for both stores.

template <class T>
struct Triple {
    T x, y, z;
    INLINE Triple() : x{}, y{}, z{} {}
    INLINE Triple(T x, T y, T z) : x(x), y(y), z(z) {}
    INLINE Triple(const Triple& a) : x(a.x), y(a.y), z(a.z) {}
    INLINE Triple& operator=(const Triple& a) {
        x = a.x, y = a.y, z = a.z;
        return *this;
    }
};
using Vec = Triple<Lanes>;
using Constant = Triple<double>;  // one for all bodies

INLINE Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }

template <class S>
INLINE Vec operator*(S s, Vec a) {
    return {s * a.x, s * a.y, s * a.z};
}

INLINE Vec scaled(Constant s, Vec a) { return {s.x * a.x, s.y * a.y, s.z * a.z}; }

INLINE Lanes dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// base + a·b
INLINE Lanes dot_add(Lanes base, Vec a, Vec b) {
    return base + a.x * b.x + a.y * b.y + a.z * b.z;
}

// s a + b
template <class S>
INLINE Vec axpy(S s, Vec a, Vec b) {
    return {b.x + s * a.x, b.y + s * a.y, b.z + s * a.z};
}

template <class A, class B>
INLINE Vec cross(A a, B b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// base + a×b
template <class A, class B>
INLINE Vec cross_add(Vec base, A a, B b) {
    return {base.x + a.y * b.z - a.z * b.y, base.y + a.z * b.x - a.x * b.z,
            base.z + a.x * b.y - a.y * b.x};
}

struct Symmetric {
    double xx, yy, zz, xy, xz, yz;

    Symmetric inverse() const {
        const double a = yy * zz - yz * yz, b = xz * yz - xy * zz, c = xy * yz - xz * yy;
        const double d = 1 / (xx * a + xy * b + xz * c);
        return {a * d, (xx * zz - xz * xz) * d, (xx * yy - xy * xy) * d,
                b * d, c * d, (xy * xz - xx * yz) * d};
    }
};

INLINE Vec operator*(const Symmetric& m, Vec a) {
    return {m.xx * a.x + m.xy * a.y + m.xz * a.z, m.xy * a.x + m.yy * a.y + m.yz * a.z,
            m.xz * a.x + m.yz * a.y + m.zz * a.z};
}

// Unit quaternion, body → ground.
struct Quaternion {
    Lanes w, x, y, z;
    INLINE Quaternion() : w{}, x{}, y{}, z{} {}
    INLINE Quaternion(Lanes w, Lanes x, Lanes y, Lanes z) : w(w), x(x), y(y), z(z) {}
    INLINE Quaternion(const Quaternion& a) : w(a.w), x(a.x), y(a.y), z(a.z) {}
    INLINE Quaternion& operator=(const Quaternion& a) {
        w = a.w, x = a.x, y = a.y, z = a.z;
        return *this;
    }
};

template <class S>
INLINE Quaternion axpy(S s, Quaternion a, Quaternion b) {
    return {b.w + s * a.w, b.x + s * a.x, b.y + s * a.y, b.z + s * a.z};
}

// q (0, p)
INLINE Quaternion product(Quaternion q, Vec p) {
    return {-q.x * p.x - q.y * p.y - q.z * p.z, q.w * p.x + q.y * p.z - q.z * p.y,
            q.w * p.y + q.z * p.x - q.x * p.z, q.w * p.z + q.x * p.y - q.y * p.x};
}

// Back to length 1, from nearby.
INLINE Quaternion normalised(Quaternion q) {
    const Lanes s = 1.5 - 0.5 * (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return {s * q.w, s * q.x, s * q.y, s * q.z};
}

template <class A>
INLINE Vec rotated(Quaternion q, A a) {
    const Vec u{q.x, q.y, q.z}, t = 2.0 * cross(u, a), b = cross(u, t);
    return {b.x + q.w * t.x + a.x, b.y + q.w * t.y + a.y, b.z + q.w * t.z + a.z};
}

// Half of the ground's e₃ in body axes.
INLINE Vec half_of_up(Quaternion q) {
    return {q.x * q.z - q.w * q.y, q.y * q.z + q.w * q.x, 0.5 - q.x * q.x - q.y * q.y};
}

// ---- functions of the half-angle vector x = ξ/2, at y = |x|² -----------------------------------
// Taylor series. How many terms are exact to rounding depends on the largest angle (`by_angle`).

// cos|x| and sinc|x|
constexpr double COS[] = {1, -1. / 2, 1. / 24, -1. / 720, 1. / 40320, -1. / 3628800};
constexpr double SINC[] = {1, -1. / 6, 1. / 120, -1. / 5040, 1. / 362880};
// of rotation by ξ: 2 sinc|2x| and 2 sinc²|x|
constexpr double SINE[] = {2, -4. / 3, 4. / 15, -8. / 315, 4. / 2835};
constexpr double SQUARE[] = {2, -2. / 3, 4. / 45, -2. / 315, 4. / 14175};
// of dexp: (1 − sinc|2x|)/y
constexpr double TURN[] = {2. / 3, -2. / 15, 4. / 315, -2. / 2835, 4. / 155925};
// of dexp⁻¹: (1 − |x| cot|x|)/y, and twice its derivative
constexpr double COT[] = {1. / 3, 1. / 45, 2. / 945, 1. / 4725, 2. / 93555};
constexpr double COT_RATE[] = {2 * COT[1], 4 * COT[2], 6 * COT[3], 8 * COT[4]};

template <int TERMS, int KNOWN>
INLINE Lanes series(const double (&c)[KNOWN], Lanes y) {
    static_assert(1 < TERMS && TERMS <= KNOWN);
    Lanes total = c[TERMS - 2] + y * c[TERMS - 1];
#pragma GCC unroll 6
    for (int k = TERMS - 3; k >= 0; k--) total = c[k] + y * total;
    return total;
}

// q exp ξ
template <int TERMS>
INLINE Quaternion turned(Quaternion q, Vec x) {
    const Lanes y = dot(x, x);
    return axpy(series<TERMS + 1>(COS, y), q, product(q, series<TERMS>(SINC, y) * x));
}

// exp(−ξ) a, by cross products that need not wait for the series
template <int TERMS>
INLINE Vec carried_back(Vec x, Vec a) {
    const Lanes y = dot(x, x);
    const Vec t = cross(a, x);
    return axpy(series<TERMS>(SQUARE, y), cross(t, x), axpy(series<TERMS>(SINE, y), t, a));
}

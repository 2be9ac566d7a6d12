// Explicit Runge–Kutta methods, over batches of bodies.
//
// A block is WIDTH bodies. The stages of one block hang together, each on the one before, so that
// one block alone leaves the FMA units waiting. GROUP of them therefore take each stage in turn,
// with their states in the L1 cache: a stage is short enough for the core to overlap it with the
// next block's. That beats one block kept in registers all the time by a third, two by an eighth.
#pragma once

#include <algorithm>
#include <thread>
#include <utility>
#include <vector>

#include "lanes.hpp"

#define EACH_BLOCK _Pragma("GCC unroll 1") for (Block* p = first; p < last; p++)

struct Top {
    double mass;       // kg
    Constant inertia;  // kg m², principal, about the centre of mass
    Constant centre;   // m, from the pivot
    double gravity;    // m/s², along e₃
};

struct Job {
    double* omega0;  // (3, bodies) rad/s, body axes; at R = I
    double* out;     // (6, bodies): centre of mass, ω
    long bodies;     // a multiple of WIDTH
    long steps;
    long threads;
    double h;  // s
    Top top;
};

struct Final {
    Vec centre, omega;
};

struct RK4 {
    static constexpr int STAGES = 4;
    static constexpr double A[4][4] = {{}, {1. / 2}, {0, 1. / 2}, {0, 0, 1}};
    static constexpr double B[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
};

struct DOP853 {  // Hairer, Nørsett, Wanner, Solving ODEs I, II.5
    static constexpr int STAGES = 12;
    static constexpr double A[12][12] = {
        {},
        {0.05260015195876773},
        {0.0197250569845379, 0.0591751709536137},
        {0.02958758547680685, 0, 0.08876275643042054},
        {0.2413651341592667, 0, -0.8845494793282861, 0.924834003261792},
        {0.037037037037037035, 0, 0, 0.17082860872947386, 0.12546768756682242},
        {0.037109375, 0, 0, 0.17025221101954405, 0.06021653898045596, -0.017578125},
        {0.03709200011850479, 0, 0, 0.17038392571223998, 0.10726203044637328,
         -0.015319437748624402, 0.008273789163814023},
        {0.6241109587160757, 0, 0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
         20.154067550477894, -43.48988418106996},
        {0.47766253643826434, 0, 0, -2.4881146199716677, -0.590290826836843, 21.230051448181193,
         15.279233632882423, -33.28821096898486, -0.020331201708508627},
        {-0.9371424300859873, 0, 0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
         -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196},
        {2.273310147516538, 0, 0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
         27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303,
         0.6433927460157636},
    };
    static constexpr double B[12] = {
        0.054293734116568765, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003,
        -5.801203960010585, 0.3111643669578199, -0.1521609496625161, 0.20136540080403034,
        0.04471061572777259,
    };
};

// Motion has types Base (the state at the beginning of a step) and Point (of the vector space in
// which a step is taken), and start, origin, rates, onward and finish.
template <class Tableau, class Motion>
class Integrator {
    using Base = typename Motion::Base;
    using Point = typename Motion::Point;
    static constexpr int STAGES = Tableau::STAGES;

    struct Block {
        Base base;
        Point rates[STAGES];
    };

    const Motion motion;
    double weights[STAGES + 1][STAGES];  // h a, and h b below

    static constexpr double weight(int stage, int j) {
        return stage == STAGES ? Tableau::B[j] : Tableau::A[stage][j];
    }

    template <int STAGE, size_t... J>
    INLINE Point reached(const Block& block, std::index_sequence<J...>) const {
        Point point = motion.origin(block.base);
        ((weight(STAGE, J) != 0 ? void(point = axpy(weights[STAGE][J], block.rates[J], point))
                                : void()), ...);
        return point;
    }

    template <int STAGE>
    INLINE Point reached(const Block& block) const {
        return reached<STAGE>(block, std::make_index_sequence<STAGE>());
    }

    // The first stage goes with the last one of the step before.
    INLINE void begin(Block& block, const Base& base) const {
        block.base = base;
        block.rates[0] = motion.first_rates(base);
    }

    template <int STAGE>
    INLINE void stage(Block* first, Block* last) const {
        EACH_BLOCK {
            p->rates[STAGE] = motion.rates(p->base, reached<STAGE>(*p));
            if constexpr (STAGE == STAGES - 1)
                begin(*p, motion.onward(p->base, reached<STAGES>(*p)));
        }
    }

    template <size_t... STAGE>
    INLINE void step(Block* first, Block* last, std::index_sequence<STAGE...>) const {
        (stage<STAGE + 1>(first, last), ...);
    }

    void range(const Job& job, long from, long to) const {
        Block blocks[GROUP];
        for (; from < to; from += GROUP * WIDTH) {
            Block* const first = blocks;
            Block* const last = blocks + std::min<long>(GROUP, (to - from) / WIDTH);
            auto at = [&](double* data, Block* p, int component) -> Unaligned* {
                return (Unaligned*)(data + component * job.bodies + from + (p - first) * WIDTH);
            };
            EACH_BLOCK {
                auto in = [&](int component) { return *at(job.omega0, p, component); };
                begin(*p, motion.start({in(0), in(1), in(2)}));
            }
            for (long k = 0; k < job.steps; k++)
                step(first, last, std::make_index_sequence<STAGES - 1>());
            EACH_BLOCK {
                const auto [r, omega] = motion.finish(p->base);
                const Lanes numbers[] = {r.x, r.y, r.z, omega.x, omega.y, omega.z};
                for (int i = 0; i < 6; i++) *at(job.out, p, i) = numbers[i];
            }
        }
    }

public:
    explicit Integrator(const Job& job) : motion(job.top) {
        for (int i = 0; i <= STAGES; i++)
            for (int j = 0; j < STAGES; j++) weights[i][j] = job.h * weight(i, j);
    }

    void run(const Job& job) const {
        auto part = [&](long t) { return job.bodies / WIDTH * t / job.threads * WIDTH; };
        std::vector<std::thread> pool;
        for (int t = 1; t < job.threads; t++)
            pool.emplace_back([&, t] { range(job, part(t), part(t + 1)); });
        range(job, 0, part(1));
        for (auto& thread : pool) thread.join();
    }
};

constexpr double FASTEST = 20;  // rad/s; none of the benchmark's tops gets there

// Gives `integrate` the number of series terms, a compile-time constant, that the step asks for:
// three up to 1 ms; five are exact up to 12 ms, and beyond that RK4 is not.
template <class F>
void by_angle(const Job& job, F integrate) {
    if (0.5 * FASTEST * job.h < 0.0101) integrate(std::integral_constant<int, 3>());
    else integrate(std::integral_constant<int, 5>());
}

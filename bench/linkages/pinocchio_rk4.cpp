// Chains and loops by Pinocchio: one model and its data for each trajectory, RK4 at a fixed step.
#include <memory>
#include <vector>

#include <pinocchio/algorithm/aba.hpp>
#ifdef LOOPS  // minutes to compile
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#endif
#include <pinocchio/multibody.hpp>

namespace pin = pinocchio;
using Eigen::VectorXd;
using Matrix = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>;
using Vector = Eigen::Map<const Eigen::Vector3d>;

namespace {

constexpr int NUMBERS = 27;  // of a link: frame (9, 3), mass, com (3), inertia (9), q, v

struct Trajectory {
    pin::Model model;
    std::unique_ptr<pin::Data> data;
    VectorXd q0, v0, tau;
#ifdef LOOPS
    std::vector<pin::RigidConstraintModel> constraints;
    std::vector<pin::RigidConstraintData> constraint_data;
    pin::ProximalSettings settings{1e-12, 1e-12, 1e-10, 20};

    void close(pin::JointIndex a, pin::JointIndex b, const double* points) {
        const pin::SE3 at_a(Eigen::Matrix3d::Identity(), Vector(points));
        const pin::SE3 at_b(Eigen::Matrix3d::Identity(), Vector(points + 3));
        constraints.emplace_back(pin::CONTACT_3D, model, a, at_a, b, at_b);
        constraint_data.emplace_back(constraints[0]);
        pin::initConstraintDynamics(model, *data, constraints, constraint_data);
    }
    const VectorXd& accelerations(const VectorXd& q, const VectorXd& v) {
        return pin::constraintDynamics(model, *data, q, v, tau, constraints, constraint_data,
                                       settings);
    }
#else
    void close(pin::JointIndex, pin::JointIndex, const double*) {}
    const VectorXd& accelerations(const VectorXd& q, const VectorXd& v) {
        return pin::aba(model, *data, q, v, tau);
    }
#endif
};

std::vector<Trajectory> all;

}  // namespace

extern "C" void create(int count, int links, const int* parents, const double* numbers,
                       const double* loop) {
    all.clear();
    all.resize(count);
    for (auto& t : all) {
        t.model.gravity.linear(Eigen::Vector3d(0, 0, -9.81));
        t.q0.resize(links), t.v0.resize(links), t.tau = VectorXd::Zero(links);
        std::vector<pin::JointIndex> joint(links);
        std::vector<int> index(links);
        for (int i = 0; i < links; i++, numbers += NUMBERS) {
            const pin::SE3 frame(Matrix(numbers), Vector(numbers + 9));
            joint[i] = t.model.addJoint(parents[i] < 0 ? 0 : joint[parents[i]],
                                        pin::JointModelRZ(), frame, "j" + std::to_string(i));
            t.model.appendBodyToJoint(
                joint[i], pin::Inertia(numbers[12], Vector(numbers + 13), Matrix(numbers + 16)));
            t.q0[i] = numbers[25], t.v0[i] = numbers[26];
        }
        t.data = std::make_unique<pin::Data>(t.model);
        if (loop) t.close(joint[1], joint[2], loop), loop += 6;
    }
}

extern "C" void advance(int steps, double h, double* out) {
    for (auto& t : all) {
        VectorXd q = t.q0, v = t.v0;
        const auto n = q.size();
        VectorXd a1(n), a2(n), a3(n), a4(n), v2(n), v3(n), v4(n), at(n);
        for (int k = 0; k < steps; k++) {
            a1 = t.accelerations(q, v);
            v2 = v + h / 2 * a1, at = q + h / 2 * v;
            a2 = t.accelerations(at, v2);
            v3 = v + h / 2 * a2, at = q + h / 2 * v2;
            a3 = t.accelerations(at, v3);
            v4 = v + h * a3, at = q + h * v3;
            a4 = t.accelerations(at, v4);
            q += h / 6 * (v + 2 * (v2 + v3) + v4);
            v += h / 6 * (a1 + 2 * (a2 + a3) + a4);
        }
        for (int i = 0; i < n; i++) *out++ = q[i];
    }
}

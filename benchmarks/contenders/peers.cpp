// SPDX-License-Identifier: MIT
// Pinocchio's calls next to ours in one process, in turn and in both orders: derivatives of the static torque and of
// gravity, Hessian of the Jacobian, and its time derivative. benchmarks/peers.py prints the robot's numbers and calls of
// our functions in C.
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics-derivatives.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/multibody.hpp>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <random>
#include <string>

extern "C" {
struct Joint {
    int parent, sliding;
    double axis[3], pose[12], body[10];
};
struct Tip {
    int joint;
    double pose[12];
};
extern const int joint_count, tip_count;
extern const Joint joints[];
extern const Tip tips_of_robot[];
void own_static_torque(const double *q, const double *wrenches, const double *gravity, double *result);
void own_gravity(const double *q, const double *gravity, double *result);
void own_hessian(const double *q, double *result);
}

namespace pin = pinocchio;
using Eigen::Map, Eigen::MatrixXd, Eigen::VectorXd;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

static pin::Model model;
static std::vector<pin::FrameIndex> frames;
enum { COUNT = 256 };

static pin::SE3 placement(const double *n)
{
    pin::SE3::Matrix3 rotation;
    rotation << n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8];
    return pin::SE3(rotation, pin::SE3::Vector3(n[9], n[10], n[11]));
}

// Mass, first moment and inertia about the joint's origin (xx, xy, xz, yy, yz, zz).
static pin::Inertia inertia(const double *n)
{
    Eigen::Vector3d com(n[1], n[2], n[3]);
    if (n[0] > 0) com /= n[0];
    Eigen::Matrix3d about;
    about << n[4], n[5], n[6], n[5], n[7], n[8], n[6], n[8], n[9];
    return pin::Inertia(n[0], com, about + n[0] * pin::skewSquare(com, com));
}

static pin::JointModel kind(const Joint &joint)
{
    const Eigen::Vector3d axis(joint.axis[0], joint.axis[1], joint.axis[2]);
    const pin::JointModel sliding[] = {pin::JointModel(pin::JointModelPX()), pin::JointModel(pin::JointModelPY()),
        pin::JointModel(pin::JointModelPZ())};
    const pin::JointModel turning[] = {pin::JointModel(pin::JointModelRX()), pin::JointModel(pin::JointModelRY()),
        pin::JointModel(pin::JointModelRZ())};
    for (int k = 0; k < 3; ++k)
        if (axis == Eigen::Vector3d::Unit(k)) return joint.sliding ? sliding[k] : turning[k];
    if (joint.sliding) return pin::JointModel(pin::JointModelPrismaticUnaligned(axis));
    return pin::JointModel(pin::JointModelRevoluteUnaligned(axis));
}

static void build()
{
    for (int k = 0; k < joint_count; ++k) {
        const Joint &each = joints[k];
        const pin::JointIndex own = model.addJoint(each.parent + 1, kind(each), placement(each.pose), std::to_string(k));
        model.appendBodyToJoint(own, inertia(each.body));
    }
    for (int k = 0; k < tip_count; ++k) {
        const Tip &each = tips_of_robot[k];
        frames.push_back(model.addFrame(pin::Frame("tip" + std::to_string(k), each.joint + 1, placement(each.pose), pin::OP_FRAME)));
    }
}

struct Contender {
    std::string name;
    std::function<void(int)> run;
    double least = 1e300;
};

static double difference(const MatrixXd &found, const MatrixXd &expected)
{
    return (found - expected).cwiseAbs().maxCoeff() / expected.cwiseAbs().maxCoeff();
}

static void check(const char *what, double error)
{
    if (!(error < 1e-10)) {
        std::printf("%s disagrees by %g\n", what, error);
        std::exit(1);
    }
}

int main(int, char **argv)
{
    build();
    const int n = model.nv, tips = (int)frames.size(), rounds = std::atoi(argv[1]);
    pin::Data data(model);
    std::mt19937 random(1);
    std::uniform_real_distribution<double> angle(-1.5, 1.5);
    std::normal_distribution<double> normal;
    const double g[3] = {0.3, -0.2, -9.81};
    model.gravity.linear() = Map<const Eigen::Vector3d>(g);
    Rows q(COUNT, n), v(COUNT, n), wrenches(COUNT, 6 * tips);
    for (double *each = q.data(); each < q.data() + q.size(); ++each) *each = angle(random);
    for (double *each = v.data(); each < v.data() + v.size(); ++each) *each = normal(random);
    for (double *each = wrenches.data(); each < wrenches.data() + wrenches.size(); ++each) *each = 20 * normal(random);

    // Pinocchio takes wrenches in the axes of the joints.
    std::vector<PINOCCHIO_ALIGNED_STD_VECTOR(pin::Force)> loads(COUNT);
    MatrixXd static_torque = MatrixXd::Zero(n, n), falling = MatrixXd::Zero(n, n), rate(6, n), J(6, n), rates(6, n);
    std::vector<double> own(n * n), hessian(6 * n * n);
    pin::Data::Tensor3x tensor(6, n, n);
    const auto jacobians = [&](int c) { pin::computeJointJacobians(model, data, q.row(c).transpose()); };
    const auto kinematic_hessian = [&](int c) {
        jacobians(c);
        pin::updateFramePlacement(model, data, frames[0]);
        pin::computeJointKinematicHessians(model, data);
        tensor.setZero();
        pin::getFrameKinematicHessian(model, data, frames[0], pin::LOCAL_WORLD_ALIGNED, tensor);
    };
    const auto time_variation = [&](int c) {
        pin::computeJointJacobiansTimeVariation(model, data, q.row(c).transpose(), v.row(c).transpose());
        pin::updateFramePlacement(model, data, frames[0]);
        rate.setZero();
        pin::getFrameJacobianTimeVariation(model, data, frames[0], pin::LOCAL_WORLD_ALIGNED, rate);
    };
    const auto own_variation = [&](int c) {
        own_hessian(&q(c, 0), hessian.data());
        rates.setZero();
        for (int i = 0; i < n; ++i) rates += v(c, i) * Map<const MatrixXd>(&hessian[6 * n * i], 6, n);
    };
    for (int c = 0; c < COUNT; ++c) {
        loads[c].assign(model.njoints, pin::Force::Zero());
        jacobians(c);
        pin::updateFramePlacements(model, data);
        MatrixXd held = MatrixXd::Zero(n, n);
        for (int t = 0; t < tips; ++t) {
            const Map<const Eigen::Vector3d> f(&wrenches(c, 6 * t)), m(&wrenches(c, 6 * t + 3));
            const Eigen::Matrix3d turn = data.oMf[frames[t]].rotation().transpose();
            const pin::Frame &frame = model.frames[frames[t]];
            loads[c][frame.parentJoint] += frame.placement.act(pin::Force(turn * f, turn * m));
            J.setZero();
            pin::getFrameJacobian(model, data, frames[t], pin::LOCAL_WORLD_ALIGNED, J);
            for (int i = 0; i < n; ++i) {
                const Eigen::Vector3d w = J.col(i).tail<3>();
                pin::Force turned(w.cross(f), w.cross(m));
                held.col(i) += J.transpose() * turned.toVector();
            }
        }
        static_torque.setZero();
        pin::computeStaticTorqueDerivatives(model, data, q.row(c).transpose(), loads[c], static_torque);
        own_static_torque(&q(c, 0), &wrenches(c, 0), g, own.data());
        check("static torque", difference(Map<Rows>(own.data(), n, n), static_torque + held));
        falling.setZero();
        pin::computeGeneralizedGravityDerivatives(model, data, q.row(c).transpose(), falling);
        own_gravity(&q(c, 0), g, own.data());
        check("gravity", difference(Map<Rows>(own.data(), n, n), falling));
        kinematic_hessian(c);
        own_hessian(&q(c, 0), hessian.data());
        check("Hessian", difference(Map<VectorXd>(hessian.data(), 6 * n * n), Map<VectorXd>(tensor.data(), 6 * n * n)));
        time_variation(c);
        own_variation(c);
        check("time derivative", difference(rates, rate));
    }

    std::vector<Contender> contenders = {
        {"computeStaticTorqueDerivatives",
            [&](int c) {
                static_torque.setZero();
                pin::computeStaticTorqueDerivatives(model, data, q.row(c).transpose(), loads[c], static_torque);
            }},
        {"static_torque_derivatives", [&](int c) { own_static_torque(&q(c, 0), &wrenches(c, 0), g, own.data()); }},
        {"computeGeneralizedGravityDerivatives",
            [&](int c) {
                falling.setZero();
                pin::computeGeneralizedGravityDerivatives(model, data, q.row(c).transpose(), falling);
            }},
        {"gravity.joint_stiffness", [&](int c) { own_gravity(&q(c, 0), g, own.data()); }},
        {"getFrameKinematicHessian", kinematic_hessian},
        {"hybrid.jacobian_transpose_derivative", [&](int c) { own_hessian(&q(c, 0), hessian.data()); }},
        {"getFrameJacobianTimeVariation", time_variation},
        {"hybrid.jacobian_transpose_derivative . dq", own_variation},
    };
    for (int round = 0; round < rounds; ++round)
        for (std::size_t turn = 0; turn < contenders.size(); ++turn) {
            // Every other round backwards, so that none always follows the same one.
            Contender &each = contenders[round % 2 ? contenders.size() - 1 - turn : turn];
            const auto start = std::chrono::steady_clock::now();
            for (int c = 0; c < COUNT; ++c) each.run(c);
            const std::chrono::duration<double, std::nano> taken = std::chrono::steady_clock::now() - start;
            each.least = std::min(each.least, taken.count() / COUNT);
        }
    for (const Contender &each : contenders) std::printf("%s\t%.1f\n", each.name.c_str(), each.least);
}

// SPDX-License-Identifier: MIT
// The joint stiffness with Pinocchio as an expert would write it: one forward pass, kinematic Hessian in the
// LOCAL_WORLD_ALIGNED frame, everything preallocated, fixed sizes where the sizes are known.
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics-derivatives.hpp>
#include <pinocchio/multibody.hpp>

namespace pin = pinocchio;
typedef Eigen::Matrix<double, 6, 6> Matrix6;
typedef Eigen::Matrix<double, 6, 7> Jacobian;
typedef Eigen::Matrix<double, 7, 7> Matrix7;

static pin::Model model;
static pin::Data *data;
static pin::FrameIndex frame;
static pin::Data::Tensor3x hessian(6, 7, 7);
static Jacobian J;

static pin::SE3 placement(const double *n)
{
    pin::SE3::Matrix3 rotation;
    rotation << n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8];
    return pin::SE3(rotation, pin::SE3::Vector3(n[9], n[10], n[11]));
}

extern "C" void setup()
{
    pin::JointIndex last = 0;
#define JOINT(kind, ...)                                                                    \
    {                                                                                       \
        const double numbers[] = {__VA_ARGS__};                                             \
        last = model.addJoint(last, kind, placement(numbers), std::to_string(last));      \
    }
#define TIP(...)                                                                            \
    {                                                                                       \
        const double numbers[] = {__VA_ARGS__};                                             \
        frame = model.addFrame(pin::Frame("tip", last, placement(numbers), pin::OP_FRAME)); \
    }
#include "chain.inc"
    data = new pin::Data(model);
}

extern "C" void run(const double *q, const double *wrench, const double *task_stiffness, double *joint_stiffness)
{
    const Eigen::Map<const Eigen::Matrix<double, 7, 1>> position(q);
    const Eigen::Map<const Eigen::Matrix<double, 6, 1>> F(wrench);
    Matrix6 A = Eigen::Map<const Matrix6>(task_stiffness); // symmetric: the order does not matter
    const Eigen::Vector3d half = 0.5 * F.tail<3>();
    A.bottomRightCorner<3, 3>() -= pin::skew(half);
    pin::computeJointJacobians(model, *data, position);
    pin::updateFramePlacement(model, *data, frame);
    J.setZero();
    pin::getFrameJacobian(model, *data, frame, pin::LOCAL_WORLD_ALIGNED, J);
    pin::computeJointKinematicHessians(model, *data);
    pin::getFrameKinematicHessian(model, *data, frame, pin::LOCAL_WORLD_ALIGNED, hessian);
    Eigen::Map<Matrix7> Kq(joint_stiffness);
    Kq.noalias() = J.transpose() * (A * J);
    for (int i = 0; i < 7; ++i) {
        const Eigen::Map<const Jacobian> derivative(hessian.data() + 42 * i); // dJ/dq_i
        Kq.col(i).noalias() += derivative.transpose() * F;
    }
}

// Many Hessians as they lie, dJ[k, b]/dq_i at [i][b][k]; threads may call it at the same time.
extern "C" void hessians(std::size_t count, const double *q, double *out)
{
    static thread_local pin::Data own(model);
    static thread_local pin::Data::Tensor3x result(6, 7, 7);
    for (std::size_t c = 0; c < count; ++c) {
        const Eigen::Map<const Eigen::Matrix<double, 7, 1>> position(q + 7 * c);
        pin::computeJointJacobians(model, own, position);
        pin::updateFramePlacement(model, own, frame);
        pin::computeJointKinematicHessians(model, own);
        result.setZero();
        pin::getFrameKinematicHessian(model, own, frame, pin::LOCAL_WORLD_ALIGNED, result);
        Eigen::Map<Eigen::Matrix<double, 294, 1>>(out + 294 * c) = Eigen::Map<const Eigen::Matrix<double, 294, 1>>(result.data());
    }
}

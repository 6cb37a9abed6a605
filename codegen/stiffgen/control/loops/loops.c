/* Closed loops: motors, and the joints that follow from them. */
#include "loops.h"

/* Find the joints of the tree from the motors' positions; NaN where the loops do not close. */
static void close_loops(const double *q, const memory_t *m, double *joints)
{
    CALL(close)(q, m->arm.joints, joints);
}

void stiffgen_poses(const double *q, const memory_t *m, double *pose)
{
    double joints[JOINTS];
    close_loops(q, m, joints);
    stiffgen_tree_poses(joints, m, pose);
}

/* Compute the Jacobians J G (6 TWISTS x N) of tips and pairs for the motors; G = d joints/dq (JOINTS x N). */
void stiffgen_jacobians(const double *q, const memory_t *m, double *jacobian)
{
    double joints[JOINTS], G[JOINTS * N], J[6 * TWISTS * JOINTS];
    close_loops(q, m, joints);
    CALL(motors_jacobian)(joints, G);
    stiffgen_tree_jacobians(joints, m, J);
    for (int row = 0; row < 6 * TWISTS; ++row) {
        for (int i = 0; i < N; ++i) {
            double sum = 0.0;
            for (int k = 0; k < JOINTS; ++k) {
                sum += J[row * JOINTS + k] * G[k * N + i];
            }
            jacobian[row * N + i] = sum;
        }
    }
}

double stiffgen_spring_energy(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness)
{
    double joints[JOINTS];
    close_loops(q, m, joints);
    return stiffgen_tree_spring_energy(joints, m, equilibrium, translation_stiffness, rotation_stiffness);
}

/*
 * Return the springs' energy U [J], with torque and stiffness of the motors: those of the open tree, carried over by
 * the loops. motors_from_joints takes and gives gradients; a torque is -dU/dq.
 */
double stiffgen_spring(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness, double *torque, double *joint_stiffness)
{
    double joints[JOINTS], tree_torque[JOINTS], tree_gradient[JOINTS], K[JOINTS * JOINTS], gradient[N];
    close_loops(q, m, joints);
    const double energy = stiffgen_tree_spring(joints, m, equilibrium, translation_stiffness, rotation_stiffness,
        tree_torque, K);
    for (int k = 0; k < JOINTS; ++k) {
        tree_gradient[k] = -tree_torque[k];
    }
    CALL(motors_from_joints)(joints, tree_gradient, K, gradient, joint_stiffness);
    for (int i = 0; i < N; ++i) {
        torque[i] = -gradient[i];
    }
    return energy;
}

void stiffgen_spring_wrench(const double *q, const memory_t *m, const double *equilibrium,
    const double *translation_stiffness, const double *rotation_stiffness, double *wrench)
{
    double joints[JOINTS];
    close_loops(q, m, joints);
    stiffgen_tree_spring_wrench(joints, m, equilibrium, translation_stiffness, rotation_stiffness, wrench);
}

void stiffgen_mass_matrix(const double *q, const memory_t *m, double *mass_matrix)
{
    double joints[JOINTS];
    close_loops(q, m, joints);
    CALL(motors_mass_matrix)(joints, mass_matrix);
}

/* Compute the bias forces without gravity. */
void stiffgen_coriolis(const double *q, const memory_t *m, const double *velocity, double *forces)
{
    static const double no_gravity[3] = {0.0, 0.0, 0.0};
    double joints[JOINTS];
    close_loops(q, m, joints);
    CALL(motors_bias_forces)(joints, velocity, no_gravity, forces);
}

/* Begin at joints near a closed configuration. */
void stiffgen_home(arm_t *arm)
{
    memcpy(arm->joints, loop_start, sizeof loop_start);
}

/* Return whether the loops close at the motors' positions q. */
int stiffgen_reaches(const double *q, const memory_t *m)
{
    double joints[JOINTS];
    int closed = 1;
    close_loops(q, m, joints);
    for (int k = 0; k < JOINTS; ++k) {
        closed = closed && fabs(joints[k]) <= DBL_MAX;
    }
    return closed;
}

/* Write the motors' positions among those of the joints. */
static void pick_motors(const double *joints, double *q)
{
    for (int i = 0; i < N; ++i) {
        q[i] = joints[loop_motors[i]];
    }
}

/*
 * Close the loops at the motors' positions q by Newton's method, from joints nearby. The way back to the motors of
 * those must lead to the same joints: close to a singularity the method may take another branch. Return whether it did.
 */
static int stays_on_branch(const double *q, const double *nearby, double *joints)
{
    double start[N], back[JOINTS];
    int same = 1;
    CALL(close)(q, nearby, joints);
    pick_motors(nearby, start);
    CALL(close)(start, joints, back);
    for (int k = 0; k < JOINTS; ++k) {
        same = same && fabs(back[k] - nearby[k]) <= SAME_BRANCH;
    }
    return same;
}

/*
 * Follow the arm to the motors' positions q of a sample, on the branch of the last one; the first sample is reached
 * from the start in FIRST_PARTS parts. Return whether the joints stay on the branch.
 */
int stiffgen_follow(const double *q, const memory_t *m, double *joints)
{
    const int parts = m->watch.known ? 1 : FIRST_PARTS;
    double from[N], at[N], before[JOINTS];
    int follows = 1;
    pick_motors(m->arm.joints, from);
    CALL(close)(from, m->arm.joints, joints);
    for (int part = 1; part <= parts && follows; ++part) {
        memcpy(before, joints, sizeof before);
        for (int i = 0; i < N; ++i) {
            at[i] = from[i] + part * (q[i] - from[i]) / parts;
        }
        follows = stays_on_branch(part < parts ? at : q, before, joints);
    }
    return follows;
}

/* Take the joints of a believed sample. */
void stiffgen_adopt(const double *joints, arm_t *arm)
{
    memcpy(arm->joints, joints, sizeof arm->joints);
}

/* Bring a posture into the reach of the closed loops: halve its distance from closed ones until the loops close. */
void stiffgen_retract(const memory_t *m, double *q)
{
    double from[N];
    pick_motors(m->arm.joints, from);
    for (int round = 0; round < RETRACTIONS && !stiffgen_reaches(q, m); ++round) {
        for (int i = 0; i < N; ++i) {
            q[i] = 0.5 * (q[i] + from[i]);
        }
    }
}

// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_ARM_H
#define FRI_ATTACK_ARM_H

/* Messages as the robot writes them, and the arm. */
#include "attack_schedule.h"

extern "C" void ROBOT_MASS_MATRIX(const double *q, double *mass_matrix);
extern "C" void ROBOT_JACOBIAN(const double *q, double *jacobian); /* of the tip, hybrid frame */

namespace {

/* ---- messages ---------------------------------------------------------------------------------------------------- */

typedef std::vector<std::uint8_t> Octets;

void put_varint(Octets *out, std::uint64_t value)
{
    for (; value > 127; value >>= 7) {
        out->push_back(static_cast<std::uint8_t>(value | 128));
    }
    out->push_back(static_cast<std::uint8_t>(value));
}

void put(Octets *out, unsigned number, std::uint64_t value)
{
    put_varint(out, number << 3);
    put_varint(out, value);
}

void put(Octets *out, unsigned number, const Octets &part)
{
    put_varint(out, number << 3 | 2);
    put_varint(out, part.size());
    out->insert(out->end(), part.begin(), part.end());
}

/* Append a field with doubles in the wire format, each with its own key. */
void put_reals(Octets *out, unsigned number, const double *values, int count)
{
    Octets part;
    for (int i = 0; i < count; ++i) {
        part.push_back(0x09);
        std::uint8_t bytes[8];
        std::memcpy(bytes, &values[i], 8); /* little-endian, as the wire is */
        part.insert(part.end(), bytes, bytes + 8);
    }
    put(out, number, part);
}

/* Return the body with length and checksum around it, as 2.7 has it. */
Octets framed(const Octets &body)
{
    if (FRI_VERSION < 207) {
        return body;
    }
    Octets out;
    const auto word = [&out](std::uint32_t value) {
        for (int i = 0; i < 4; ++i) {
            out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
        }
    };
    word(static_cast<std::uint32_t>(body.size()));
    out.insert(out.end(), body.begin(), body.end());
    word(checksum(body.data(), body.size()));
    return out;
}

/* A field of this number with length in a message; NULL and 0 if it is not there. */
struct Part {
    const std::uint8_t *bytes;
    std::size_t size;
};

/* Take a number of the wire format, seven bits per byte, lowest first. */
std::uint64_t take_varint(Part *part)
{
    std::uint64_t value = 0;
    for (unsigned shift = 0; part->size > 0; shift += 7) {
        const std::uint8_t byte = *part->bytes++;
        --part->size;
        value |= static_cast<std::uint64_t>(byte & 127) << shift;
        if (byte < 128) {
            break;
        }
    }
    return value;
}

/* Find a field of the client's message by its number: its bytes, or its value for a varint. Wire types: a varint (0),
 * eight bytes (1), or a length and as many bytes. */
Part field(Part in, unsigned number, std::uint64_t *value = NULL)
{
    while (in.size > 0) {
        const std::uint64_t key = take_varint(&in);
        const unsigned wire = static_cast<unsigned>(key & 7);
        std::uint64_t size = wire == 1 ? 8 : take_varint(&in);
        if (wire == 0) {
            if (key >> 3 == number && value != NULL) {
                *value = size;
            }
            continue;
        }
        if (size > in.size) {
            break;
        }
        if (key >> 3 == number) {
            return Part{in.bytes, static_cast<std::size_t>(size)};
        }
        in.bytes += size;
        in.size -= static_cast<std::size_t>(size);
    }
    return Part{NULL, 0};
}

typedef std::array<double, JOINTS> Vector;

/* Take seven doubles, each behind its key of one byte. */
bool take_joints(Part values, Vector *joints)
{
    if (values.size != 9 * JOINTS) {
        return false;
    }
    for (std::size_t i = 0; i < JOINTS; ++i) {
        std::memcpy(&(*joints)[i], values.bytes + 9 * i + 1, 8);
    }
    return true;
}

/* ---- the wall ---------------------------------------------------------------------------------------------------- */

/* A plane without friction in the tip's way, a spring and a damper. */
class Wall {
public:
    /* Across the z axis of the tip at the start. */
    explicit Wall(const Vector &start) { robot::pose(start.data(), pose_); }

    /* It stands so far [m] before the start; farther, where the tip is beyond that. */
    void stand(double distance, const Vector &q)
    {
        distance_ = stands_ ? distance_ : std::max(distance, way(q));
        stands_ = true;
    }
    void fall() { stands_ = false; }

    /* Add the joint torques of the contact; force: on the tip, base axes [N]. */
    void touch(const Vector &q, const Vector &dq, Vector *torque)
    {
        double J[6 * JOINTS];
        ROBOT_JACOBIAN(q.data(), J);
        const double deep = stands_ ? way(q) - distance_ : 0.0;
        double speed = 0.0;
        for (int k = 0; k < 3; ++k) {
            for (int i = 0; i < JOINTS; ++i) {
                speed += axis(k) * J[k * JOINTS + i] * dq[static_cast<std::size_t>(i)];
            }
        }
        size = deep > 0.0 ? std::max(STIFFNESS * deep + DAMPING * speed, 0.0) : 0.0;
        for (int k = 0; k < 3; ++k) {
            force[k] = -size * axis(k);
            for (int i = 0; i < JOINTS; ++i) {
                (*torque)[static_cast<std::size_t>(i)] += J[k * JOINTS + i] * force[k];
            }
        }
    }

    double size = 0.0, force[3] = {0.0, 0.0, 0.0}; /* [N] on the tip, base axes */

private:
    static constexpr double STIFFNESS = 1e4, DAMPING = 30.0;

    double axis(int k) const { return pose_[4 * k + 2]; }

    /* Return how far the tip is along the axis from the start. */
    double way(const Vector &q) const
    {
        double there[16], sum = 0.0;
        robot::pose(q.data(), there);
        for (int k = 0; k < 3; ++k) {
            sum += axis(k) * (there[4 * k + 3] - pose_[4 * k + 3]);
        }
        return sum;
    }

    double pose_[16], distance_ = 0.0;
    bool stands_ = false;
};

constexpr double Wall::STIFFNESS, Wall::DAMPING;

/* ---- the arm ----------------------------------------------------------------------------------------------------- */

/* Rigid, without gravity and Coriolis forces, that the robot compensates. What blocks a joint is a stiff spring. Motor
 * inertia and friction act before a joint's torque sensor, the links and the environment behind it. */
class Arm {
public:
    explicit Arm(const Vector &start) : q(start), wall(start), anchor_(start)
    {
        dq.fill(0.0), external.fill(0.0), sensed.fill(0.0), dry.fill(0.0), bristle_.fill(0.0), blocked_.fill(false);
    }

    /* Held by the robot's brakes or its position control. */
    void hold()
    {
        dq.fill(0.0);
        external.fill(0.0);
        sensed.fill(0.0);
    }

    void step(const Vector &torque, const Vector &push, const std::array<bool, JOINTS> &blocked, double time)
    {
        double M[JOINTS * JOINTS];
        ROBOT_MASS_MATRIX(q.data(), M);
        Vector force, friction, pressed;
        pressed.fill(0.0);
        wall.touch(q, dq, &pressed);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            anchor_[i] = blocked[i] && !blocked_[i] ? q[i] : anchor_[i];
            external[i] = push[i] + pressed[i] + (blocked[i] ? BLOCK * (anchor_[i] - q[i]) - DAMPING * dq[i] : 0.0);
            const int joint = static_cast<int>(i);
            const double beyond = q[i] - std::min(std::max(q[i], robot::lower(joint)), robot::upper(joint));
            external[i] -= beyond != 0.0 ? BLOCK * beyond + DAMPING * dq[i] : 0.0;
            friction[i] = FRICTION * dq[i] + rub(i, time);
            force[i] = torque[i] + external[i] - friction[i];
            M[i * JOINTS + i] += motor;
        }
        blocked_ = blocked;
        const Vector rate = solve(M, force);
        kinetic = 0.0;
        for (std::size_t i = 0; i < JOINTS; ++i) {
            sensed[i] = torque[i] - friction[i] - motor * rate[i];
            dq[i] += time * rate[i];
            work += time * torque[i] * dq[i];
            q[i] += time * dq[i];
        }
        for (std::size_t i = 0; i < JOINTS; ++i) {
            for (std::size_t j = 0; j < JOINTS; ++j) {
                kinetic += 0.5 * dq[i] * M[i * JOINTS + j] * dq[j];
            }
        }
    }

    Vector q, dq, external; /* [rad], [rad/s], [N m] of the environment */
    Vector sensed;          /* [N m] by the joints' torque sensors */
    Vector dry;             /* [N m] friction of a joint that slides */
    Wall wall;
    double motor = 0.2;     /* [kg m^2] motors' inertia */
    double kinetic = 0.0, work = 0.0; /* [J]; done by the torques given */

private:
    static constexpr double BLOCK = 2e4, DAMPING = 60.0, FRICTION = 0.5;

    /* Dry friction: a bristle that breaks loose (LuGre), half as strong again at rest. */
    double rub(std::size_t i, double time)
    {
        if (dry[i] <= 0.0) {
            return 0.0;
        }
        const double fast = dq[i] / 0.01, most = dry[i] * (1.0 + 0.5 * std::exp(-fast * fast)), stiffness = most / 2e-5;
        bristle_[i] = (bristle_[i] + time * dq[i]) / (1.0 + time * std::fabs(dq[i]) * stiffness / most);
        return stiffness * bristle_[i] + 0.02 * dry[i] * dq[i];
    }

    static Vector solve(const double *M, const Vector &right)
    {
        double L[JOINTS][JOINTS];
        Vector x = right;
        for (int i = 0; i < JOINTS; ++i) {
            for (int j = 0; j <= i; ++j) {
                double sum = M[i * JOINTS + j];
                for (int k = 0; k < j; ++k) {
                    sum -= L[i][k] * L[j][k];
                }
                L[i][j] = i == j ? std::sqrt(sum) : sum / L[j][j];
            }
        }
        for (int i = 0; i < JOINTS; ++i) {
            for (int k = 0; k < i; ++k) {
                x[static_cast<std::size_t>(i)] -= L[i][k] * x[static_cast<std::size_t>(k)];
            }
            x[static_cast<std::size_t>(i)] /= L[i][i];
        }
        for (int i = JOINTS - 1; i >= 0; --i) {
            for (int k = i + 1; k < JOINTS; ++k) {
                x[static_cast<std::size_t>(i)] -= L[k][i] * x[static_cast<std::size_t>(k)];
            }
            x[static_cast<std::size_t>(i)] /= L[i][i];
        }
        return x;
    }

    Vector anchor_, bristle_;
    std::array<bool, JOINTS> blocked_;
};

constexpr double Arm::BLOCK, Arm::DAMPING, Arm::FRICTION;

} // namespace

#endif

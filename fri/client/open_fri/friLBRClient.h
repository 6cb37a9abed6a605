// SPDX-License-Identifier: MIT
/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_LBR_CLIENT_H
#define OPEN_FRI_LBR_CLIENT_H

#include "friException.h"
#include "open_fri_messages.h"

namespace KUKA {
namespace FRI {

enum ESessionState { IDLE = 0, MONITORING_WAIT = 1, MONITORING_READY = 2, COMMANDING_WAIT = 3, COMMANDING_ACTIVE = 4 };
enum EConnectionQuality { POOR = 0, FAIR = 1, GOOD = 2, EXCELLENT = 3 };
enum ESafetyState { NORMAL_OPERATION = 0, SAFETY_STOP_LEVEL_0 = 1, SAFETY_STOP_LEVEL_1 = 2, SAFETY_STOP_LEVEL_2 = 3 };
enum EOperationMode { OPERATION_T1 = 0, OPERATION_T2 = 1, OPERATION_AUT = 2 };
enum EDriveState { OFF = 0, TRANSITIONING = 1, ACTIVE = 2 };
enum EControlMode {
    CONTROL_POSITION = 0,
    CONTROL_CARTESIAN_IMPEDANCE = 1,
    CONTROL_JOINT_IMPEDANCE = 2,
    CONTROL_NONE = 3
};
enum EClientCommandMode {
    NO_COMMAND_MODE = 0,
#if FRI_VERSION >= 200
    JOINT_POSITION = 1,
#else
    POSITION = 1,
#endif
    WRENCH = 2,
    TORQUE = 3
#if FRI_VERSION >= 200
    ,
    CARTESIAN_POSE = 4
#endif
};
enum EOverlayType { NO_OVERLAY = 0, JOINT = 1, CARTESIAN = 2 };
#if FRI_VERSION >= 200
enum ERedundancyStrategy { REDUNDANCY_E1 = 0, REDUNDANCY_NONE = 4 };
#endif

/*
 * Content of the last monitoring message: rad, N m, s.
 *
 * Values that it did not have are NaN (arrays) or 0. They are never those of an earlier message.
 */
class LBRState {
public:
    enum {
        NUMBER_OF_JOINTS = 7
#if FRI_VERSION >= 207
        ,
        CART_DOF = 6
#endif
    };

    double getSampleTime() const { return 0.001 * message_.period; }
    ESessionState getSessionState() const { return static_cast<ESessionState>(message_.state); }
    EConnectionQuality getConnectionQuality() const { return static_cast<EConnectionQuality>(message_.quality); }
    ESafetyState getSafetyState() const { return static_cast<ESafetyState>(message_.safety); }
    EOperationMode getOperationMode() const { return static_cast<EOperationMode>(message_.operation); }
    /* TRANSITIONING if the drives differ. */
    EDriveState getDriveState() const { return static_cast<EDriveState>(message_.drive); }
    EClientCommandMode getClientCommandMode() const { return static_cast<EClientCommandMode>(message_.command_mode); }
    EOverlayType getOverlayType() const { return static_cast<EOverlayType>(message_.overlay); }
    EControlMode getControlMode() const { return static_cast<EControlMode>(message_.control); }
    unsigned int getTimestampSec() const { return message_.seconds; }
    unsigned int getTimestampNanoSec() const { return message_.nanoseconds; }
    const double *getMeasuredJointPosition() const { return message_.position; }
    const double *getMeasuredTorque() const { return message_.torque; }
    const double *getCommandedTorque() const { return message_.commanded_torque; }
    const double *getExternalTorque() const { return message_.external_torque; }
    /* Throws FRIException when the message had none, as in the monitoring states. */
    const double *getIpoJointPosition() const;
    double getTrackingPerformance() const { return message_.tracking; }
    /* These throw FRIException when the robot has registered no such IO of that type. */
    bool getBooleanIOValue(const char *name) const;
    unsigned long long getDigitalIOValue(const char *name) const;
    double getAnalogIOValue(const char *name) const;
#if FRI_VERSION < 200
    const double *getCommandedJointPosition() const { return message_.commanded_position; }
#else
    /* mm, then a quaternion w x y z; as a matrix [R p]. */
    const double *getMeasuredCartesianPose() const { return message_.pose; }
    void getMeasuredCartesianPoseAsMatrix(double (&matrix)[3][4]) const;
    const double *getIpoCartesianPose() const { return message_.interpolator_pose; }
    void getIpoCartesianPoseAsMatrix(double (&matrix)[3][4]) const;
    double getMeasuredRedundancyValue() const { return message_.redundancy; }
    double getIpoRedundancyValue() const { return message_.interpolator_redundancy; }
    ERedundancyStrategy getRedundancyStrategy() const { return static_cast<ERedundancyStrategy>(message_.strategy); }
#endif
#if FRI_VERSION >= 207
    const double *getExternalForce() const { return message_.external_force; }
#endif

private:
    friend class ClientApplication;
    friend class LBRClient;
    friend class LBRCommand;
    LBRState() { open_fri::clear(&message_); }
    const open_fri::Io &io(const char *name, std::uint32_t type) const;

    open_fri::Monitoring message_;
};

/*
 * Content of the answer. It is empty at the start of every callback.
 *
 * A setter throws FRIException for values that are not finite, and from 2.7 on when the robot's command mode does not
 * take the quantity. Cartesian poses cannot be commanded with this library.
 */
class LBRCommand {
public:
    /* 7 values [rad] */
    void setJointPosition(const double *values);
    /* force and moment, 6 values [N, N m] */
    void setWrench(const double *values);
    /* 7 values [N m], added by the robot to the torque of its own controller */
    void setTorque(const double *values);
    /* These throw FRIException when the robot has registered no such output of that type. */
    void setBooleanIOValue(const char *name, const bool value);
    void setDigitalIOValue(const char *name, const unsigned long long value);
    void setAnalogIOValue(const char *name, const double value);

private:
    friend class ClientApplication;
    friend class LBRClient;
    explicit LBRCommand(const LBRState &state);
    void clear();
    void require(bool fits, const char *message) const;
    open_fri::Io &output(const char *name, std::uint32_t type);

    const LBRState &state_;
    open_fri::Command message_;
};

/* What a client application calls. Derive from LBRClient. */
class IClient {
public:
    virtual ~IClient() {}
    virtual void onStateChange(ESessionState oldState, ESessionState newState) = 0;
    virtual void monitor() = 0;
    virtual void waitForCommand() = 0;
    virtual void command() = 0;

private:
    friend class ClientApplication;
    virtual LBRState &receivedState() = 0;
    virtual LBRCommand &nextCommand() = 0;
};

/* The base of a robot's client: override the callbacks. */
class LBRClient : public IClient {
public:
    LBRClient() : command_(state_) {}

    /* Before the callback of the new state. The base does nothing. */
    virtual void onStateChange(ESessionState, ESessionState) {}
    /* In MONITORING_WAIT and MONITORING_READY. The base commands the commanded position (1.x) or nothing (2.x). */
    virtual void monitor();
    /* In COMMANDING_WAIT. The base mirrors the interpolator's position. */
    virtual void waitForCommand();
    /* In COMMANDING_ACTIVE. The base mirrors the interpolator's position. */
    virtual void command();

    const LBRState &robotState() const { return state_; }
    LBRCommand &robotCommand() { return command_; }

private:
    LBRClient(const LBRClient &);
    LBRClient &operator=(const LBRClient &);
    virtual LBRState &receivedState() { return state_; }
    virtual LBRCommand &nextCommand() { return command_; }

    LBRState state_;
    LBRCommand command_;
};

} // namespace FRI
} // namespace KUKA

#endif

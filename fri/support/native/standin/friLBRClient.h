/* SPDX-License-Identifier: MIT */
/* A library in the place of KUKA's, for tests: README.md. */
#ifndef FRI_STANDIN_LBR_CLIENT_H
#define FRI_STANDIN_LBR_CLIENT_H

#include "friClientIf.h"

namespace KUKA {
namespace FRI {

class LBRState {
public:
    enum {
        NUMBER_OF_JOINTS = 7
#if STANDIN_VERSION >= 207
        ,
        CART_DOF = 6
#endif
    };

    double getSampleTime() const;
    ESessionState getSessionState() const;
    EConnectionQuality getConnectionQuality() const;
    ESafetyState getSafetyState() const;
    EOperationMode getOperationMode() const;
    EDriveState getDriveState() const;
    EClientCommandMode getClientCommandMode() const;
    EOverlayType getOverlayType() const;
    EControlMode getControlMode() const;
    unsigned int getTimestampSec() const;
    unsigned int getTimestampNanoSec() const;
    const double *getMeasuredJointPosition() const;
    const double *getMeasuredTorque() const;
    const double *getCommandedTorque() const;
    const double *getExternalTorque() const;
    const double *getIpoJointPosition() const;
    double getTrackingPerformance() const;
    bool getBooleanIOValue(const char *name) const;
    unsigned long long getDigitalIOValue(const char *name) const;
    double getAnalogIOValue(const char *name) const;
#if STANDIN_VERSION < 200
    const double *getCommandedJointPosition() const;
#else
    const double *getMeasuredCartesianPose() const;
    void getMeasuredCartesianPoseAsMatrix(double (&matrix)[3][4]) const;
    double getMeasuredRedundancyValue() const;
    ERedundancyStrategy getRedundancyStrategy() const;
#endif
#if STANDIN_VERSION >= 207
    const double *getExternalForce() const;
#endif

    ClientData *data;
};

class LBRCommand {
public:
    void setJointPosition(const double *values);
    void setWrench(const double *values);
    void setTorque(const double *values);
    void setBooleanIOValue(const char *name, const bool value);
    void setDigitalIOValue(const char *name, const unsigned long long value);
    void setAnalogIOValue(const char *name, const double value);

    ClientData *data;
};

class LBRClient : public IClient {
public:
    LBRClient();
    ~LBRClient();
    virtual void onStateChange(ESessionState oldState, ESessionState newState);
    virtual void monitor();
    virtual void waitForCommand();
    virtual void command();
    const LBRState &robotState() const { return state_; }
    LBRCommand &robotCommand() { return command_; }

private:
    virtual ClientData *createData();

    LBRState state_;
    LBRCommand command_;
};

} // namespace FRI
} // namespace KUKA

#endif

#ifndef FRI_CLIENT_WIPING_CLIENT_H
#define FRI_CLIENT_WIPING_CLIENT_H

#include "filters.h"
#include "record.h"
#include "robot.h"
#include "timing.h"
#include "trajectory.h"
#include "wrench.h"

#include <cstdint>
#include <cstring> /* before KUKA's headers, which do not include it */

#include <friLBRClient.h>

/* What the client is told at the start. */
struct Settings {
    double task_stiffness[6];    /* [N/m, N m/rad] diagonal, hybrid frame */
    bool conventional;           /* the stiffness without the correction, for comparison */
    double damping_ratio;        /* [1] of every mode */
    double joint_damping;        /* [N m s/rad] */
    double nullspace_stiffness;  /* [N m/rad] */
    double effort_share;         /* of the robot's effort limits, and of their rate */
    double sample_time;          /* [s] that is expected; 0: whatever the robot says */
    double approach_time;        /* [s] least duration of the move to the trajectory */
    double velocity_filter;      /* [s] */
    double wrench_damping;       /* of the inverse that makes the wrench */
    double external_torque_sign; /* 1: the external torque is J^T times the wrench that the environment applies; -1 */
    bool dry_run;                /* send zero torque */

    Settings();
};

/* What happened, counted. */
struct Counters {
    unsigned long long cycles;                /* callbacks */
    unsigned long long commanding_cycles;     /* of them in COMMANDING_ACTIVE */
    unsigned long long lost_cycles;           /* by the robot's clock */
    unsigned long long lost_commanding;       /* of them in COMMANDING_ACTIVE */
    unsigned long long missing_fields;        /* messages without a value that is needed */
    unsigned long long implausible_positions; /* far beyond the joint limits */
    unsigned long long bad_timestamps;        /* left out, not ahead of the last one, or far off */
    unsigned long long quality_drops;
    unsigned long long state_drops; /* COMMANDING_ACTIVE was left before the trajectory's end */
    unsigned long long no_torque_mode;
    unsigned long long guarded; /* cycles whose torque the client had to cut */
    unsigned long long sensor_silent;
    unsigned long long exceptions;              /* the FRI library refused a call */
    unsigned long long fallbacks;               /* the controller went to pure damping, so often */
    unsigned long long saturated, rate_limited; /* cycles with these bits of the controller's status */
    double antisymmetric; /* [N m/rad] largest Frobenius norm of the applied stiffness' antisymmetric part */
};

/* Why the client does not take part in the session. */
enum Refusal { REFUSAL_NONE, REFUSAL_SAMPLE_TIME, REFUSAL_TORQUE_MODE, REFUSAL_CONTROLLER };

/*
 * Follows a zero-force trajectory in torque mode with the generated impedance controller.
 *
 * The callbacks neither allocate, lock nor print; what is to be seen goes through the ring. (An exception of the FRI
 * library allocates; one is only met where the robot leaves out what it must send.)
 */
class WipingClient : public KUKA::FRI::LBRClient {
public:
    /* The sensor may be NULL: wrench from the external joint torque. All arguments outlive the client. */
    WipingClient(const Settings &settings, const Trajectory &trajectory, WrenchSensor *sensor, Records &records);

    virtual void onStateChange(KUKA::FRI::ESessionState oldState, KUKA::FRI::ESessionState newState);
    virtual void monitor();
    virtual void waitForCommand();
    virtual void command();

    /* Say that a datagram came which was no message. */
    void bad_datagram() { events_ |= EVENT_BAD_DATAGRAM; }

    bool finished() const { return finished_; }
    Refusal refusal() const { return refusal_; }
    bool trajectory_done() const { return done_; }
    double progress() const { return progress_; } /* [s] in the trajectory */
    double time() const { return time_; }         /* [s] of the robot's clock since the first message */
    double sample_time() const { return sample_time_; }
    int controller_error() const { return controller_error_; }
    const Counters &counters() const { return counters_; }
    const Durations &callback_durations() const { return durations_; }
    const robot::Config &config() const { return config_; }

private:
    void configure();
    void observe();
    void clock();
    void missing_field();
    bool within_limits(const double *q) const;
    void watch_button();
    void begin_commanding(const double *q);
    void advance(double seconds);
    bool read_wrench(const double *q, double *wrench);
    void control();
    void step_controller(bool valid);
    void record_step(double time);
    void guard_torque();
    void send(const double *position, const double *torque);
    void refuse(Refusal reason);

    const Settings &settings_;
    const Trajectory &trajectory_;
    WrenchSensor *const sensor_;
    Records &records_;

    robot::Config config_;
    robot::State state_;
    robot::Input input_;
    robot::Output output_;
    Approach approach_;
    VelocityFilter velocity_;
    PositionFollower follower_;
    Durations durations_;
    Counters counters_;
    Record record_;

    double sample_time_; /* [s]; 0 until the robot has said it */
    bool clock_known_;
    std::int64_t clock_start_, clock_last_; /* [ns] of the robot */
    double time_;                           /* [s] of the robot since the first message */
    int lost_;                              /* cycles lost just before this one */
    bool stale_;                            /* the message is not newer than the last one */
    int periods_;                           /* of the robot's clock since the last message */
    int stale_messages_;                    /* since the last new one */
    int since_position_;                    /* periods since the last position */
    bool valid_;                            /* this cycle's positions and torques are there */
    double q_[JOINTS];                      /* [rad] last measured position */
    double dq0_[JOINTS];                    /* [rad/s] of the wanted motion, for the log */
    double sent_[JOINTS];                   /* [N m] last torque sent */
    bool controlling_;                      /* the controller runs since COMMANDING_ACTIVE began */
    int start_;                             /* the next step is the controller's first */
    bool fallen_back_;
    double approach_clock_, progress_; /* [s] in the approach and in the trajectory */
    double pace_;                      /* 1: the trajectory runs; 0: it stands still */
    bool done_;
    int quality_;
    int without_period_;      /* messages */
    int without_torque_mode_; /* cycles in COMMANDING_WAIT */
    bool button_registered_, button_;
    int sensor_age_; /* cycles since the sensor's last reading */
    double sensor_wrench_[6];
    std::uint32_t events_;
    double last_callback_; /* [s] */
    bool finished_;
    Refusal refusal_;
    int controller_error_;
};

#endif

// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_WIPING_CLIENT_H
#define FRI_CLIENT_WIPING_CLIENT_H

#include "clock.h"
#include "connection.h"
#include "copies.h"
#include "defects.h"
#include "events.h"
#include "filters.h"
#include "guard.h"
#include "pace.h"
#include "question.h"
#include "record.h"
#include "reference.h"
#include "paper.h"
#include "press.h"
#include "robot.h"
#include "settings.h"
#include "settle.h"
#include "standing.h"
#include "timing.h"
#include "wrench.h"

#include <cstdint>
#include <cstring> /* before KUKA's headers, which do not include it */

#include <friLBRClient.h>

/* Consecutive messages that contradict the session, after which the client acts. */
enum { PATIENCE = 10 };

/* Counters of a session. */
struct Counters {
    unsigned long long cycles;                /* callbacks */
    unsigned long long usable;                /* callbacks with a good sample */
    unsigned long long commanding_cycles;     /* in COMMANDING_ACTIVE */
    unsigned long long lost_cycles;           /* by the messages' counter and the robot's clock */
    unsigned long long lost_commanding;       /* lost cycles in COMMANDING_ACTIVE */
    unsigned long long missing_fields;        /* messages that lack a needed value */
    unsigned long long implausible_positions; /* far beyond the joint limits */
    unsigned long long bad_timestamps;        /* time stamps left out, or the clock was set */
    unsigned long long no_time;               /* the clock does not follow the counter */
    unsigned long long clock_standing;        /* messages whose time stamp has not changed for long */
    unsigned long long other_periods;         /* messages with another send period, or none */
    unsigned long long quality_drops;
    unsigned long long state_drops; /* COMMANDING_ACTIVE was left before the trajectory's end */
    unsigned long long no_torque_mode;
    unsigned long long guarded; /* cycles whose torque the guard changed */
    unsigned long long slowed;  /* cycles in which the trajectory ran slower for a limit */
    unsigned long long sensor_silent;
    unsigned long long contact_lost, sensor_doubted; /* ends of Press: at most one, once */
    unsigned long long exceptions;              /* the FRI library refused a call */
    unsigned long long controller_faults;       /* faults that the controller latched */
    unsigned long long saturated, rate_limited; /* cycles with these bits of the controller's status */
};

/* Reasons to refuse a session, and to let go. */
enum Refusal {
    REFUSAL_NONE,
    REFUSAL_SAMPLE_TIME,
    REFUSAL_TORQUE_MODE,
    REFUSAL_APPROACH,
    REFUSAL_CONTROLLER,
    REFUSAL_PRESS, /* more than Press may exert */
    REFUSAL_PRESS_PERIOD
};
enum LetGo {
    LET_GO_NONE,
    LET_GO_INTERRUPTED, /* by a person or a signal */
    LET_GO_DECLINED,    /* the person answered no */
    LET_GO_HELD,        /* the trajectory stood still for too long */
    LET_GO_SPEED,
    LET_GO_COPIES, /* measured positions repeat earlier ones */
    LET_GO_STANDING, /* a measured position stands still while the torque moves on */
    LET_GO_AWAY, /* the arm was moved far while messages were lost */
    LET_GO_SAFETY,
    LET_GO_DRIVES,
    LET_GO_ROBOT_STATES, /* the messages lack safety state, drives or operation mode */
    LET_GO_OPERATION_MODE,
    LET_GO_PERIOD,
    LET_GO_DEFECTS, /* too many messages are no good samples */
    LET_GO_CONTROLLER, /* the controller latched a fault other than of the communication */
    LET_GO_USELESS /* no message has been of use for long */
};

/*
 * FRI client that follows a zero-force trajectory in torque mode with the generated impedance controller.
 *
 * The callbacks neither allocate, lock nor print; records go through the ring. The connection tells which fields a
 * message has, so that the FRI library is never asked for a missing one.
 */
class WipingClient : public KUKA::FRI::LBRClient {
public:
    /* The sensor may be NULL: wrench from the external joint torque. All arguments outlive the client. */
    WipingClient(const Settings &settings, const Trajectory &trajectory, WrenchSensor *sensor,
                 const Connection &connection, Records &records, Question &question);

    virtual void onStateChange(KUKA::FRI::ESessionState oldState, KUKA::FRI::ESessionState newState);
    virtual void monitor();
    virtual void waitForCommand();
    virtual void command();

    /* Bring the torque to zero, still answering, then be finished. */
    void let_go(LetGo reason);

    bool finished() const { return ended_ || (let_go_ != LET_GO_NONE && (!controlling_ || zero_sent())); }
    bool ended_by_robot() const { return ended_; }
    bool released() const { return guard_.released(); } /* the client let go, and its torque is zero */
    Refusal refusal() const { return refusal_; }
    LetGo gone() const { return let_go_; }
    Pace::Reason held_by() const { return held_by_; }
    int fast_joint() const { return fast_joint_; }
    const Pressing &pressing() const { return pressing_; }
    const Copies &copies() const { return copies_; }
    int standing_joint() const { return std::max(standing_.joint(), settled_.joint()); }
    const Defects &defects() const { return defects_; }
    int wild_joint() const { return wild_joint_; }           /* last joint far beyond its limit */
    double wild_position() const { return wild_position_; } /* [rad] of that joint */
    const robot::Output &output() const { return output_; } /* of the controller's last step */
    const Question &question() const { return question_; }
    bool trajectory_done() const { return reference_.done(); }
    double progress() const { return reference_.progress(); } /* [s] in the trajectory */
    double time() const { return clock_.time(); }             /* [s] of the robot's clock since the first message */
    double sample_time() const { return sample_time_; }
    double reported_period() const { return reported_period_; } /* [s] last reported by the robot */
    int controller_error() const { return controller_error_; }
    const Counters &counters() const { return counters_; }
    const Durations &callback_durations() const { return durations_; }
    const robot::Config &config() const { return config_; }
    const Settings &settings() const { return settings_; }

private:
    void configure();
    void watch_period();
    void adopt(double period);
    void observe();
    void watch_samples();
    void watch_standing(const double *q);
    void take_position(const double *q, bool fresh);
    void take_fresh_position(const double *q);
    bool has_torques() const;
    void watch_robot();
    void watch_states();
    void watch_speed();
    void watch_clock(const Arrival &arrival);
    bool clock_was_set() const;
    void watch_button(const Message &message);
    Defect find_defect(bool positions, bool believed, bool torques) const;
    void count_defect(Defect defect);
    void event(Event bit, unsigned long long *counter);
    void note();
    bool may_begin();
    void begin_commanding();
    void control();
    bool takes_control(bool torque_mode);
    double take_time();
    void advance();
    double tip_error() const;
    double lag() const;
    void watch_pace();
    bool fill_input();
    bool presses() const;
    void press();
    double contact_force() const;
    void watch_controller();
    void step_controller(bool valid);
    void record_input();
    void count_output();
    void record_step();
    void send(const double *position, const double *torque);
    void send_torque();
    void refuse(Refusal reason);
    bool zero_sent() const { return zero_ && connection_.answers().count() > answers_before_zero_; }

    const Settings &settings_;
    const Connection &connection_;
    Records &records_;
    Question &question_;

    robot::Config config_;
    robot::State state_;
    robot::Input input_;
    robot::Output output_;
    PaperTorque paper_;
    Settling settling_;
    Pressing pressing_;
    RobotClock clock_;
    VelocityDifference velocity_;
    Copies copies_;
    Standing standing_, settled_; /* always; at rest, while Settle or Press moves the command */
    PositionFollower follower_;
    WrenchSource wrench_;
    Reference reference_;
    Pace pace_;
    TorqueGuard guard_;
    Durations durations_;
    Counters counters_;
    Record record_;

    double sample_time_, reported_period_; /* [s]; 0 until the robot has reported it */
    int other_period_;                     /* messages in a row with another period */
    double since_position_;                /* [s] since the last valid position */
    double since_followed_;                /* [s] since the last position that the command follows */
    bool valid_;                           /* this message is a sample */
    Defects defects_;
    int wild_joint_;
    double wild_position_;
    bool has_velocity_;                    /* this message gave a new difference quotient */
    double q_[JOINTS];                     /* [rad] last measured position */
    double wanted_[JOINTS];                /* [rad] of the trajectory, in the last sample */
    double tip_wrench_[6];                 /* [N, N m] of the environment, in the last sample */
    double since_wrench_;                  /* [s] since the last plausible one */
    bool button_, has_button_;             /* pressed; the robot's messages have it */
    int quality_, operation_mode_;
    int without_torque_mode_, without_drives_, without_states_; /* messages in a row */
    bool controlling_;                         /* the controller runs since COMMANDING_ACTIVE began */
    int start_;                                /* the next step is the controller's first */
    bool faulted_;
    double good_time_; /* [s] of good samples since the controller latched a fault */
    std::uint32_t events_;
    double last_command_, last_callback_; /* [s] monotonic time; duration */
    double allowance_;                    /* [s] that the trajectory may advance, by this machine's time */
    Pace::Reason held_by_;
    int fast_samples_, fast_joint_; /* samples in a row beyond the speed limit; the joint */
    LetGo let_go_;
    bool zero_;                              /* the client let go, and the last callback's torque is zero */
    unsigned long long answers_before_zero_; /* answers sent before that */
    bool ended_;
    Refusal refusal_;
    int controller_error_;
};

#endif

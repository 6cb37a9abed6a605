// SPDX-License-Identifier: MIT
#include "session.h"

#include <cmath>
#include <cstdio>

namespace {

/* [s] of this machine after which the client leaves even if its torque could not be brought to zero. */
const double LONGEST_RELEASE = 0.5;

const char *version()
{
    return FRI_VERSION == 115 ? "1.x" : FRI_VERSION == 205 ? "2.5" : "2.7";
}

std::string text(const char *format, double value)
{
    char line[40];
    std::snprintf(line, sizeof line, format, value);
    return line;
}

/* Counters at some moment. */
struct Seen {
    Traffic traffic;
    Counters counters;
};

/* Return the datagrams refused since `then`, as in "datagram_frame 512, datagram_empty 3". */
std::string refused_since(const Traffic &now, const Traffic &then)
{
    std::string list;
    for (int k = FAULT_NONE + 1; k < FAULT_COUNT; ++k) {
        if (now.faults[k] > then.faults[k]) {
            list += (list.empty() ? "datagram_" : ", datagram_") + std::string(fault_name(k)) + " " +
                    std::to_string(now.faults[k] - then.faults[k]);
        }
    }
    return list;
}

/* Return why none of the datagrams since `then` was a message. */
std::string refused_text(const Connection &connection, const Traffic &then)
{
    const Traffic &now = connection.traffic();
    /* More than half of the datagrams have this fault. */
    const auto most = [&](Fault fault) {
        return 2 * (now.faults[fault] - then.faults[fault]) > now.received - then.received;
    };
    const std::string refused = refused_since(now, then), fri = version();
    if (most(FAULT_DUPLICATE)) {
        return "the robot's messages all have the sequence counter " + std::to_string(connection.sequence()) + ": " +
               refused + "; restart the robot application";
    }
    if (most(FAULT_SENDER)) {
        return "the robot's messages come from another address or port than this session's: " + refused +
               "; the robot was restarted, or there are two: start again, with one robot or --host";
    }
    if (most(FAULT_OUT_OF_ORDER)) {
        return "the robot's sequence counter does not go on from where it was: " + refused +
               "; restart the robot application";
    }
    if (most(FAULT_INCOMPLETE)) {
        return "the robot's messages lack connection, measurement or interpolator: " + refused + "; does it run FRI " +
               fri + "?";
    }
    if (most(FAULT_JOINT_COUNT)) {
        return "the robot's messages do not have seven joints: " + refused + "; is it an LBR?";
    }
    const std::string text = "datagrams arrive but do not decode as FRI " + fri + ": " + refused;
    if (now.other_framing == then.other_framing) {
        return text + "; is it the robot that sends to this port?";
    }
    return text + "; the robot speaks " + (FRI_VERSION >= 207 ? "1.x or 2.5" : "2.7") + ": build the client for it";
}

/* Return the most frequent defect of the bad messages. */
std::string defect_text(const Options &options, const WipingClient &client)
{
    const Counters &counters = client.counters();
    const Defect worst = client.defects().worst();
    const int joint = client.wild_joint();
    const double place = client.wild_position();
    const bool above = place > robot::upper(joint);
    const double limit = above ? robot::upper(joint) : robot::lower(joint);
    switch (worst) {
    case DEFECT_LIMIT:
        return std::string("joint ") + robot::joint(joint) + " is measured at " + text("%.3f", place) + " rad, " +
               text("%.3f", std::fabs(place - limit)) + " rad beyond its limit of " + text("%.3f", limit) +
               " rad: implausible_positions " + std::to_string(counters.implausible_positions) +
               "; check its mastering, and that the client is built for this robot";
    case DEFECT_TIME:
        return "the robot's clock runs at about " + text("%.0f", 100.0 * (1.0 - client.defects().share(worst))) +
               " % of what its messages' counter says: no_time " + std::to_string(counters.no_time) +
               "; check the send period in the robot application";
    case DEFECT_STANDING:
        return "the robot's clock stands still: clock_standing " + std::to_string(counters.clock_standing) +
               "; restart the robot's controller";
    case DEFECT_CLOCK_SET:
        return "the robot's clock is set again and again: bad_timestamps " + std::to_string(counters.bad_timestamps) +
               "; stop what sets it";
    case DEFECT_SENSOR:
        return "the wrench sensor on port " + std::to_string(options.sensor_port) + " is silent: sensor_silent " +
               std::to_string(counters.sensor_silent) + "; check the sensor, or give --wrench external-torque";
    default:
        return std::string("the robot's messages lack ") +
               (worst == DEFECT_TORQUE ? "the external torque" : "the measured position") + ": missing_fields " +
               std::to_string(counters.missing_fields) + "; does it run FRI " + version() + "?";
    }
}

/* Return why nothing usable has come since `then`. */
std::string diagnosis(const Options &options, const WipingClient &client, const Connection &connection,
                      const Seen &then)
{
    const Traffic &now = connection.traffic();
    if (now.received == 0) {
        return "no robot has sent anything to port " + std::to_string(options.port) +
               "; check that the robot application runs, its client address, and the firewall";
    }
    if (now.received == then.traffic.received) {
        return "the robot has been silent for " + std::to_string(options.timeout) +
               " ms; see the robot application's messages, and the network";
    }
    if (now.messages == then.traffic.messages) {
        return refused_text(connection, then.traffic);
    }
    if (client.defects().share(client.defects().worst()) > 0.0) {
        return defect_text(options, client);
    }
    const std::string refused = refused_since(now, then.traffic);
    return "messages arrive, but none of use: " + (refused.empty() ? "the robot tells no usable send period" : refused);
}

/* Return which limit of the pace holds the arm, and its option. */
std::string held_text(const WipingClient &client)
{
    const PaceLimits &pace = client.settings().pace;
    const double limit[] = {0.0, pace.error, pace.lag, pace.energy, pace.force};
    static const char *const what[] = {"", "the tip's distance from where the trajectory wants it",
                                       "the reference's lag", "the energy stored in the spring", "the contact force"};
    static const char *const option[] = {"", "--error-limit", "--lag-limit", "--energy-limit", "--force-limit"};
    static const char *const unit[] = {"", " m", " rad", " J", " N"};
    const Pace::Reason held = client.held_by();
    return std::string("the arm is held: ") + what[held] + " stayed at its limit of " + text("%g", limit[held]) +
           unit[held] + " for " + text("%g", pace.patience) + " s; free it, or see " + option[held];
}

/* Return the fault that the controller latched, and where to look. */
std::string controller_text(const WipingClient &client)
{
    const robot::Output &output = client.output();
    char fault[256];
    robot::fault_text(&output, fault, sizeof fault);
    const bool of_sensor = output.fault == robot::FAULT_SENSOR;
    const char *const start =
        of_sensor ? "the measured positions are not believed: " : "the controller latched a fault: ";
    const std::string said = std::string(start) + fault;
    switch (output.reason) {
    case robot::REASON_FROZEN: return said + "; check the joint's encoder, and see --position-quantum";
    case robot::REASON_SHAKING: return said + "; see --delay-samples and --stiffness";
    default: return said;
    }
}

/* Return why the client let go, if the reason needs no number. */
std::string plain_text(LetGo reason)
{
    switch (reason) {
    case LET_GO_INTERRUPTED: return "interrupted";
    case LET_GO_DECLINED: return "the move to the trajectory was declined";
    case LET_GO_AWAY:
        return "the arm was moved by more than --approach-limit while messages were lost; see the network, and start "
               "again";
    case LET_GO_SAFETY: return "the robot reports a safety stop while commanding; see its messages";
    case LET_GO_ROBOT_STATES:
        return "the robot's messages no longer say safety state, drives and operation mode, while commanding";
    case LET_GO_DRIVES: return "the robot's drives are not active while commanding; see its messages";
    case LET_GO_OPERATION_MODE: return "the robot's operation mode changed while commanding";
    default: return "";
    }
}

/* Return why the client let go. */
std::string let_go_text(const Options &options, const WipingClient &client)
{
    switch (client.gone()) {
    case LET_GO_HELD: return held_text(client);
    case LET_GO_SPEED:
        return std::string("joint ") + robot::joint(client.fast_joint()) + " is faster than " +
               text("%.3g", client.settings().speed_share * robot::velocity(client.fast_joint())) +
               " rad/s; see --speed-share";
    case LET_GO_COPIES:
        return std::string("the measured positions of joint ") + robot::joint(client.copies().joint()) +
               " repeat those of " + std::to_string(client.copies().late()) +
               " messages before: late copies are not believed; check the joint's encoder and the robot's messages";
    case LET_GO_STANDING:
        return std::string("the measured positions of joint ") + robot::joint(client.standing_joint()) +
               " are not believed: they stand still while the torque moves on; check the joint's encoder, and see "
               "--position-quantum";
    case LET_GO_PERIOD:
        return "the robot's send period changed from " + text("%g", 1e3 * client.sample_time()) + " to " +
               text("%g", 1e3 * client.reported_period()) + " ms while commanding";
    case LET_GO_DEFECTS: return defect_text(options, client);
    case LET_GO_CONTROLLER: return controller_text(client);
    default: return plain_text(client.gone());
    }
}

/* Watch over a session: when a message was of use last, what had been counted by then, and when the client leaves. */
struct Watch {
    Seen seen;
    double last_usable, deadline; /* [s] of this machine; deadline 0: none */
};

/* Let go if nothing usable has come for too long. */
void watch_messages(const Options &options, WipingClient &client, const Connection &connection, double now,
                    Watch *watch)
{
    const double patience = watch->seen.counters.usable > 0 ? 1e-3 * options.timeout : options.wait;
    if (client.counters().usable > watch->seen.counters.usable && client.gone() == LET_GO_NONE) {
        watch->last_usable = now;
        watch->seen = Seen{connection.traffic(), client.counters()};
    } else if (now - watch->last_usable >= patience) {
        client.let_go(LET_GO_USELESS);
    }
}

/* Set when the client leaves at the latest, once it lets go. */
void watch_release(const Options &options, const WipingClient &client, Connection &connection, double now, Watch *watch)
{
    if (client.gone() != LET_GO_NONE && watch->deadline <= 0.0) {
        watch->deadline = now + (options.settings.simulated_time ? 1e-3 * options.timeout : LONGEST_RELEASE);
        connection.set_deadline(watch->deadline);
    }
}

/* Return whether the client leaves now: too late, or with nobody there to bring the torque down for. */
bool leaves(const WipingClient &client, const Connection &connection, double now, const Watch &watch)
{
    const bool silent = client.gone() == LET_GO_USELESS && !connection.handed_on();
    return watch.deadline > 0.0 && (now > watch.deadline || silent);
}

/* Return how the session ended. */
Ending find_ending(const Options &options, const WipingClient &client, const Connection &connection, const Seen &seen,
                   int interrupts)
{
    if (client.refusal() != REFUSAL_NONE) {
        return Ending{REFUSED, refusal_text(client)};
    }
    if (client.ended_by_robot() && client.gone() == LET_GO_NONE) {
        return client.trajectory_done()
                   ? Ending{DONE, "the trajectory was followed to its end, and the robot ended the session"}
                   : Ending{ENDED_EARLY, "the robot ended the session before the trajectory's end, at " +
                                             text("%.2f", client.progress()) + " s of it; see the robot's messages"};
    }
    if (client.gone() == LET_GO_USELESS) {
        return Ending{FAULT, diagnosis(options, client, connection, seen)};
    }
    if (!client.finished()) {
        return Ending{interrupts > 1 ? INTERRUPTED : FAULT,
                      let_go_text(options, client) + "; the client left at once, before the torque was down"};
    }
    const bool asked = client.gone() == LET_GO_INTERRUPTED || client.gone() == LET_GO_DECLINED;
    std::string end = "the robot stopped commanding before the torque was down, the client leaves";
    if (client.released()) {
        end = "torque brought to zero, the client leaves";
    } else if (client.ended_by_robot()) {
        end = "the robot ended the session before the torque was down";
    }
    return Ending{asked ? INTERRUPTED : FAULT, let_go_text(options, client) + "; " + end};
}

/* Return what became of the force of --press, if it was not held. */
std::string press_text(const WipingClient &client)
{
    switch (client.pressing().end()) {
    case Pressing::LOST: return "contact was lost";
    case Pressing::DOUBTED: return "the springs pressed much harder than the sensor said; check it and its calibration";
    case Pressing::FROZEN: return "the sensor's reading stood still while the arm moved; check the sensor";
    case Pressing::MISSED: return "nothing was touched";
    default: return client.trajectory_done() && !client.pressing().touched() ? "nothing was touched" : "";
    }
}

/* Add to an ending that the force of --press was not held: the trajectory alone is not what was asked for. */
Ending with_force(const WipingClient &client, Ending ending)
{
    const std::string lost = client.pressing().wants() && ending.code != REFUSED ? press_text(client) : "";
    if (!lost.empty()) {
        ending.sentence += "; the force of --press was not held: " + lost;
        ending.code = ending.code == DONE ? FAULT : ending.code;
    }
    return ending;
}

} // namespace

/* Return why the client did not begin, and what the user can do; "" if it did. */
std::string refusal_text(const WipingClient &client)
{
    const double period = 1e3 * client.reported_period(), expected = 1e3 * client.settings().sample_time;
    switch (client.refusal()) {
    case REFUSAL_SAMPLE_TIME:
        return "the robot's send period is " + text("%g", period) + " ms" +
               (expected > 0.0 ? ", " + text("%g", expected) +
                                     " ms is configured; set the same period in the robot application and with "
                                     "--sample-time"
                               : "; set one of 1 to 10 ms in the robot application (at most 5 ms for torque)");
    case REFUSAL_TORQUE_MODE:
        return "the robot is not in torque mode; give its joint overlay the client command mode TORQUE in the robot "
               "application";
    case REFUSAL_APPROACH:
        return std::string("joint ") + robot::joint(client.question().joint()) + " is " +
               text("%.2f", client.question().distance()) +
               " rad from " + client.question().where() +
               ", more than --approach-limit; move the arm nearer, or give --approach-anyway";
    case REFUSAL_PRESS:
        return "--press takes at most half of the heaviest wrench, " +
               text("%.1f", 0.5 * client.config().heaviest_wrench[0]) +
               " N, which --stiffness, --energy-limit and --force-limit set";
    case REFUSAL_PRESS_PERIOD:
        return "--press takes a send period of at most 5 ms, and the robot's is " + text("%g", period) +
               " ms; set it in the robot application";
    case REFUSAL_CONTROLLER: return std::string("controller: ") + robot::error_text(client.controller_error());
    default: return "";
    }
}

/* Step the application until the session is over, and return how it ended. */
Ending run_session(const Options &options, WipingClient &client, Connection &connection,
                   KUKA::FRI::ClientApplication &application, const volatile std::sig_atomic_t &interrupts)
{
    Watch watch = {Seen{connection.traffic(), client.counters()}, monotonic_time(), 0.0};
    while (!client.finished() && client.refusal() == REFUSAL_NONE && interrupts < 2) {
        application.step();
        if (client.finished()) {
            break;
        }
        const double now = monotonic_time();
        watch_messages(options, client, connection, now, &watch);
        if (interrupts > 0) {
            client.let_go(LET_GO_INTERRUPTED);
        }
        watch_release(options, client, connection, now, &watch);
        if (leaves(client, connection, now, watch)) {
            break;
        }
    }
    application.disconnect();
    return with_force(client, find_ending(options, client, connection, watch.seen, interrupts));
}

// SPDX-License-Identifier: MIT
#include "session.h"

#include <cmath>
#include <cstdio>

namespace {

/* [s] of this machine after which the client leaves even if the robot does not let it bring its torque down. */
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

/* What has been seen up to some moment. */
struct Seen {
    Traffic traffic;
    Counters counters;
};

/* "datagram_frame 512, datagram_empty 3": what was refused since then. */
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

/* Why nothing usable has come since `then`. */
std::string diagnosis(const Options &options, const WipingClient &client, const Connection &connection,
                      const Seen &then)
{
    const Traffic &now = connection.traffic();
    const Counters &counters = client.counters();
    if (now.received == 0) {
        return "no robot has sent anything to port " + std::to_string(options.port) +
               "; check that the robot application runs, its client address, and the firewall";
    }
    if (now.received == then.traffic.received) {
        return "the robot has been silent for " + std::to_string(options.timeout) +
               " ms; see the robot application's messages, and the network";
    }
    const std::string refused = refused_since(now, then.traffic);
    if (now.messages == then.traffic.messages) {
        const unsigned long long same = now.faults[FAULT_DUPLICATE] - then.traffic.faults[FAULT_DUPLICATE];
        if (2 * same > now.received - then.traffic.received) {
            return "the robot's messages all have the sequence counter " + std::to_string(connection.sequence()) +
                   ": " + refused + "; restart the robot application";
        }
        const bool other = now.other_framing > then.traffic.other_framing;
        return std::string("datagrams arrive but do not decode as FRI ") + version() + ": " + refused +
               (other ? (FRI_VERSION >= 207 ? "; the robot speaks 1.x or 2.5: build the client for it"
                                            : "; the robot speaks 2.7: build the client for it")
                      : "; is it the robot that sends to this port?");
    }
    const unsigned long long standing = counters.clock_standing - then.counters.clock_standing;
    const unsigned long long missing = counters.missing_fields - then.counters.missing_fields;
    const unsigned long long wild = counters.implausible_positions - then.counters.implausible_positions;
    if (standing > 0) {
        return "the robot's clock stands still: clock_standing " + std::to_string(standing) +
               "; restart the robot's controller";
    }
    if (missing > 0 || wild > 0) {
        return "the robot's messages have no usable measurement: missing_fields " + std::to_string(missing) +
               ", implausible_positions " + std::to_string(wild) + "; does it run FRI " + version() + "?";
    }
    return "messages arrive, but none of use: " + (refused.empty() ? "no time passes in them" : refused);
}

const char *fault_text(int fault)
{
    switch (fault) {
    case robot::FAULT_SENSOR: return "the measured positions are not believed";
    case robot::FAULT_LIMIT: return "the arm is beyond a limit";
    case robot::FAULT_ENERGY: return "the tank is almost empty and does not cover the springs' torque";
    default: return "configuration";
    }
}

std::string let_go_text(const WipingClient &client)
{
    const double limit[] = {0.0, client.settings().pace.error, client.settings().pace.lag,
                            client.settings().pace.energy, client.settings().pace.force};
    static const char *const what[] = {"", "the tip's distance from where the trajectory wants it",
                                       "the governor's lag", "the energy stored in the spring", "the contact force"};
    static const char *const option[] = {"", "--error-limit", "--lag-limit", "--energy-limit", "--force-limit"};
    static const char *const unit[] = {"", " m", " rad", " J", " N"};
    const Pace::Reason held = client.held_by();
    switch (client.gone()) {
    case LET_GO_INTERRUPTED: return "interrupted";
    case LET_GO_DECLINED: return "the move to the trajectory was declined";
    case LET_GO_HELD:
        return std::string("the arm is held: ") + what[held] + " stayed at its limit of " + text("%g", limit[held]) +
               unit[held] + " for " + text("%g", client.settings().pace.patience) + " s; free it, or see " +
               option[held];
    case LET_GO_SPEED:
        return std::string("joint ") + robot::joint(client.fast_joint()) + " is faster than " +
               text("%.3g", client.settings().speed_share * robot::velocity(client.fast_joint())) +
               " rad/s; see --speed-share";
    case LET_GO_AWAY:
        return "the arm was moved by more than --approach-limit while messages were lost; see the network, and start again";
    case LET_GO_SAFETY: return "the robot reports a safety stop while commanding; see its messages";
    case LET_GO_DRIVES: return "the robot's drives are not active while commanding; see its messages";
    case LET_GO_OPERATION_MODE: return "the robot's operation mode changed while commanding";
    case LET_GO_PERIOD:
        return "the robot's send period changed from " + text("%g", 1e3 * client.sample_time()) + " to " +
               text("%g", 1e3 * client.reported_period()) + " ms while commanding";
    case LET_GO_CONTROLLER:
        return std::string("the controller latched a fault: ") + fault_text(client.controller_fault()) + ", reason " +
               std::to_string(client.controller_reason()) + " of " + robot::name() + "_impedance.h";
    default: return "";
    }
}

} // namespace

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
    case REFUSAL_CONTROLLER: return std::string("controller: ") + robot::error_text(client.controller_error());
    default: return "";
    }
}

Ending run_session(const Options &options, WipingClient &client, Connection &connection,
                   KUKA::FRI::ClientApplication &application, const volatile std::sig_atomic_t &interrupts)
{
    const double patience = 1e-3 * options.timeout;
    double last_usable = monotonic_time(), deadline = 0.0;
    Seen seen = {connection.traffic(), client.counters()};
    while (!client.finished() && client.refusal() == REFUSAL_NONE && interrupts < 2) {
        application.step();
        if (client.finished()) {
            break;
        }
        const double now = monotonic_time();
        if (client.counters().usable > seen.counters.usable && client.gone() == LET_GO_NONE) {
            last_usable = now;
            seen = Seen{connection.traffic(), client.counters()};
        } else if (now - last_usable >= (seen.counters.usable > 0 ? patience : options.wait)) {
            client.let_go(LET_GO_USELESS);
        }
        if (interrupts > 0) {
            client.let_go(LET_GO_INTERRUPTED);
        }
        if (client.gone() != LET_GO_NONE && deadline <= 0.0) {
            deadline = now + (options.settings.simulated_time ? patience : LONGEST_RELEASE);
            connection.set_deadline(deadline);
        }
        const bool silent = client.gone() == LET_GO_USELESS && !connection.handed_on();
        if (deadline > 0.0 && (now > deadline || silent)) {
            break; /* nobody is there to bring the torque down for */
        }
    }
    application.disconnect();
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
                      let_go_text(client) + "; the client left at once, before the torque was down"};
    }
    const bool asked = client.gone() == LET_GO_INTERRUPTED || client.gone() == LET_GO_DECLINED;
    const char *const end = client.released()         ? "torque brought to zero, the client leaves"
                            : client.ended_by_robot() ? "the robot ended the session before the torque was down"
                                                      : "the robot stopped commanding before the torque was down, the "
                                                        "client leaves";
    return Ending{asked ? INTERRUPTED : FAULT, let_go_text(client) + "; " + end};
}

// SPDX-License-Identifier: MIT
#include "summary.h"

#include <cerrno>
#include <cstdio>
#include <cstdlib>

namespace {

/* The shortest of two forms that is read back as the same number. */
std::string number(double value)
{
    char text[40];
    std::snprintf(text, sizeof text, "%.15g", value);
    if (std::strtod(text, NULL) != value) {
        std::snprintf(text, sizeof text, "%.17g", value);
    }
    return text;
}

/* A time in microseconds, to its bins' tenths. */
std::string microseconds(double seconds)
{
    char text[40];
    std::snprintf(text, sizeof text, "%.1f", 1e6 * seconds);
    return text;
}

std::string count(unsigned long long value)
{
    return std::to_string(value);
}

/* Return numbers as a list of JSON. */
template <typename T> std::string list(const T *values, int size)
{
    std::string text = "[";
    for (int i = 0; i < size; ++i) {
        text += (i > 0 ? ", " : "") + number(values[i]);
    }
    return text + "]";
}

std::string quoted(const std::string &text)
{
    return "\"" + text + "\"";
}

} // namespace

/* Return the library and the FRI version that this client was built with. */
const char *fri_description()
{
#ifdef OPEN_FRI
    return FRI_VERSION == 115 ? "open_fri 1.15" : FRI_VERSION == 205 ? "open_fri 2.5" : "open_fri 2.7";
#else
    return FRI_VERSION == 115 ? "KUKA SDK 1.15" : FRI_VERSION == 205 ? "KUKA SDK 2.5" : "KUKA SDK 2.7";
#endif
}

Summary::Summary(const WipingClient &client, const Connection &connection, const Records &records, const Log &log,
                 const Options &options, int code)
{
    set_session(client, connection, records, log, code);
    set_faults(client.counters(), connection.traffic());
    set_controller(client.config(), options.settings);
}

/* Fill counts and times of the session. */
void Summary::set_session(const WipingClient &client, const Connection &connection, const Records &records,
                          const Log &log, int code)
{
    const Counters &c = client.counters();
    const Durations &callback = client.callback_durations(), &answer = connection.answers();
    session_ = Fields{
        {"robot", quoted(robot::name())},
        {"library", quoted(fri_description())},
        {"exit_code", std::to_string(code)},
        {"trajectory_done", client.trajectory_done() ? "true" : "false"},
        {"trajectory_time", number(client.progress())},
        {"session_time", number(client.time())},
        {"sample_time", number(client.sample_time())},
        {"cycles", count(c.cycles)},
        {"commanding_cycles", count(c.commanding_cycles)},
        {"answers", count(answer.count())},
        {"callback_median_us", microseconds(callback.quantile(0.5))},
        {"callback_9999_us", microseconds(callback.quantile(0.9999))},
        {"callback_worst_us", microseconds(callback.most())},
        {"answer_median_us", microseconds(answer.quantile(0.5))},
        {"answer_9999_us", microseconds(answer.quantile(0.9999))},
        {"answer_worst_us", microseconds(answer.most())},
        {"log_rows", count(log.rows())},
        {"log_overruns", count(records.refused())},
    };
}

/* Fill the counts of all faults, in the order in which they are printed. */
void Summary::set_faults(const Counters &c, const Traffic &traffic)
{
    faults_ = Fields{
        {"lost_cycles", count(c.lost_cycles)},
        {"lost_cycles_commanding", count(c.lost_commanding)},
        {"bad_datagrams", count(traffic.refused())},
        {"missing_fields", count(c.missing_fields)},
        {"implausible_positions", count(c.implausible_positions)},
        {"bad_timestamps", count(c.bad_timestamps)},
        {"no_time", count(c.no_time)},
        {"clock_standing", count(c.clock_standing)},
        {"other_periods", count(c.other_periods)},
        {"quality_drops", count(c.quality_drops)},
        {"state_drops", count(c.state_drops)},
        {"no_torque_mode", count(c.no_torque_mode)},
        {"sensor_silent", count(c.sensor_silent)},
        {"exceptions", count(c.exceptions)},
        {"controller_faults", count(c.controller_faults)},
        {"contact_lost", count(c.contact_lost)},
        {"sensor_doubted", count(c.sensor_doubted)},
        {"saturated", count(c.saturated)},
        {"rate_limited", count(c.rate_limited)},
        {"guarded", count(c.guarded)},
        {"slowed", count(c.slowed)},
        {"other_version", count(traffic.other_version)},
        {"timeouts", count(traffic.timeouts)},
        {"send_failures", count(traffic.send_failures)},
        {"lost_messages", count(traffic.lost_messages)},
        {"overtaken", count(traffic.overtaken)},
        {"lost_answers", count(traffic.lost_answers)},
        {"late_answers", count(traffic.unseen_answers)},
    };
    for (int k = FAULT_NONE + 1; k < FAULT_COUNT; ++k) {
        faults_.emplace_back(std::string("datagram_") + fault_name(k), count(traffic.faults[k]));
    }
}

/* Fill the controller's settings, from which a replay configures its own, in SI units. */
void Summary::set_controller(const robot::Config &config, const Settings &settings)
{
    controller_ = Fields{
        {"law", settings.paper ? quoted("paper") : quoted("potential")},
        {"task_stiffness", list(settings.task_stiffness, 6)},
        {"stiffness_formula", settings.conventional ? quoted("conventional") : quoted("corrected")},
        {"posture_stiffness", number(settings.posture_stiffness)},
        {"sample_time", number(config.sample_time)},
        {"delay_samples", number(config.delay_samples)},
        {"motor_inertia", number(config.motor_inertia[0])},
        {"coulomb_friction", list(config.coulomb_friction, JOINTS)},
        {"settle_force", list(settings.settle_force, 2)},
        {"press_force", number(settings.press_force)},
        {"heaviest_wrench", list(config.heaviest_wrench, 2)},
        {"position_quantum", number(config.position_quantum)},
        {"velocity_noise", number(config.velocity_noise)},
        {"tip_velocity_limit", list(config.tip_velocity_limit, 2)},
        {"damping_ratio", number(settings.damping_ratio)},
        {"effort_limit", list(config.effort_limit, JOINTS)},
        {"torque_rate_limit", list(config.torque_rate_limit, JOINTS)},
    };
}

/* Print the session, and the faults that occurred. */
void Summary::print() const
{
    for (const auto &field : session_) {
        const bool word = field.second[0] == '"';
        std::printf("%-24s %s\n", field.first.c_str(),
                    field.second.substr(word, field.second.size() - 2 * word).c_str());
    }
    std::printf("faults, where there were any:\n");
    bool any = false;
    for (const auto &field : faults_) {
        if (field.second != "0") {
            std::printf("  %-22s %s\n", field.first.c_str(), field.second.c_str());
            any = true;
        }
    }
    if (!any) {
        std::printf("  none\n");
    }
    std::fflush(stdout);
}

/* Write the summary as JSON; return the error, 0 for none. */
int Summary::write(const std::string &path) const
{
    std::FILE *const file = std::fopen(path.c_str(), "w");
    if (file == NULL) {
        return errno;
    }
    const auto fields = [file](const Fields &list, const char *indent) {
        for (size_t i = 0; i < list.size(); ++i) {
            std::fprintf(file, "%s\"%s\": %s%s\n", indent, list[i].first.c_str(), list[i].second.c_str(),
                         i + 1 < list.size() ? "," : "");
        }
    };
    std::fprintf(file, "{\n");
    for (const auto &field : session_) {
        std::fprintf(file, "  \"%s\": %s,\n", field.first.c_str(), field.second.c_str());
    }
    std::fprintf(file, "  \"faults\": {\n");
    fields(faults_, "    ");
    std::fprintf(file, "  },\n  \"controller\": {\n");
    fields(controller_, "    ");
    std::fprintf(file, "  }\n}\n");
    const int error = std::fflush(file) != 0 ? errno : 0;
    return std::fclose(file) != 0 && error == 0 ? errno : error;
}

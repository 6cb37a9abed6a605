/* fri_wiping: wipes along a zero-force trajectory with a KUKA LBR through the FRI, in torque mode. docs/fri.md. */
#include "log.h"
#include "options.h"
#include "summary.h"
#include "traffic.h"
#include "wiping_client.h"

#include <friClientApplication.h>

#include <sched.h>
#include <sys/mman.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <memory>
#include <stdexcept>

namespace {

enum { CLEAN = 0, FAULT = 1, REFUSED = 2 };

volatile std::sig_atomic_t interrupted = 0;

void interrupt(int)
{
    interrupted = 1;
}

/* Memory that is never paged out, and a real-time priority for this thread; the log's thread keeps an ordinary one. */
void be_real_time(int priority)
{
    struct sched_param parameter;
    std::memset(&parameter, 0, sizeof parameter);
    parameter.sched_priority = priority;
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0 || sched_setscheduler(0, SCHED_FIFO, &parameter) != 0) {
        throw std::runtime_error(std::string("--realtime: ") + std::strerror(errno) +
                                 "; grant rtprio and memlock in /etc/security/limits.conf, or leave the option out");
    }
}

std::string reason(const WipingClient &client, const Settings &settings)
{
    char line[300];
    switch (client.refusal()) {
    case REFUSAL_SAMPLE_TIME:
        if (settings.sample_time > 0.0) {
            std::snprintf(line, sizeof line,
                          "the robot's send period is %g ms, %g ms is configured; set the same period in the robot "
                          "application and with --sample-time",
                          1e3 * client.sample_time(), 1e3 * settings.sample_time);
        } else {
            std::snprintf(line, sizeof line,
                          "the robot's send period is %g ms; set one of 1 to 10 ms in the robot application (at most 5 "
                          "ms for torque)",
                          1e3 * client.sample_time());
        }
        return line;
    case REFUSAL_TORQUE_MODE:
        return "the robot is not in torque mode; give its joint overlay the client command mode TORQUE in the robot "
               "application";
    case REFUSAL_CONTROLLER: return std::string("controller: ") + robot::error_text(client.controller_error());
    default: return "";
    }
}

/* The session, from the first datagram to its end; `line` says what went wrong. */
int session(const Options &options, WipingClient &client, Traffic &traffic, KUKA::FRI::ClientApplication &application,
            std::string *line)
{
    const double begin = monotonic_time();
    unsigned long long bad = 0;
    while (!client.finished()) {
        const bool stepped = application.step();
        const unsigned long long bad_now = bad_datagrams(application, traffic);
        if (bad_now != bad) {
            bad = bad_now;
            client.bad_datagram();
        }
        if (client.refusal() != REFUSAL_NONE) {
            *line = reason(client, options.settings);
            return REFUSED;
        }
        if (interrupted) {
            *line = "interrupted; the robot application sees the client fall silent and stops";
            return FAULT;
        }
        traffic.note_step(stepped);
        if (stepped || traffic.last_size() >= 0) {
            continue;
        }
        if (traffic.received() > 0) {
            *line = "the robot has been silent for " + std::to_string(options.timeout) +
                    " ms; see the robot application's messages, and the network";
            return FAULT;
        }
        if (monotonic_time() - begin > options.wait) {
            *line = "no robot has sent anything to port " + std::to_string(options.port) +
                    "; check that the robot application runs, its client address, and the firewall";
            return FAULT;
        }
    }
    return CLEAN;
}

int run(const Options &options)
{
    const Trajectory trajectory(options.trajectory, options.trajectory_period);
    std::unique_ptr<Records> records(new Records);
    std::unique_ptr<UdpWrenchSensor> sensor(options.sensor ? new UdpWrenchSensor(options.sensor_port) : NULL);
    std::unique_ptr<WipingClient> client(new WipingClient(options.settings, trajectory, sensor.get(), *records));
    if (client->refusal() != REFUSAL_NONE) {
        throw std::runtime_error(reason(*client, options.settings) + "; see fri_wiping --help");
    }
    Log log(*records, options.log);
    Traffic traffic(options.timeout);
    KUKA::FRI::ClientApplication application(traffic, *client);
    if (!application.connect(options.port, options.host.empty() ? NULL : options.host.c_str())) {
        throw std::runtime_error("port " + std::to_string(options.port) +
                                 (options.host.empty() ? "" : " and host " + options.host) +
                                 ": cannot be opened; choose a free --port and a numeric IPv4 --host");
    }
    log.start();
    if (options.realtime > 0) {
        be_real_time(options.realtime);
    }
    std::printf("%s, %s; waiting for the robot on port %d\n", robot::name(), fri_description(), options.port);
    std::fflush(stdout);
    std::string line;
    const int code = session(options, *client, traffic, application, &line);
    application.disconnect();
    const bool logged = log.finish();
    const Summary summary(*client, traffic, application, *records, log, options, code);
    summary.print();
    if (!options.summary.empty() && !summary.write(options.summary)) {
        line += line.empty() ? "" : "; ";
        line += "summary " + options.summary + ": " + std::strerror(errno);
    }
    if (!logged) {
        std::fprintf(
            stderr,
            "fri_wiping: the log is not complete (%llu records dropped); a slower disk needs a shorter session\n",
            records->refused());
    }
    if (!line.empty()) {
        std::fprintf(stderr, "fri_wiping: %s\n", line.c_str());
    }
    return code;
}

} // namespace

int main(int argc, char **argv)
{
    std::signal(SIGINT, interrupt);
    std::signal(SIGTERM, interrupt);
    try {
        Options options;
        return options.parse(argc, argv) ? run(options) : CLEAN;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "fri_wiping: %s\n", error.what());
        return REFUSED;
    }
}

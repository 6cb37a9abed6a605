// SPDX-License-Identifier: MIT
/* fri_wiping: wipes along a zero-force trajectory with a KUKA LBR through the FRI, in torque mode. docs/fri.md. */
#include "log.h"
#include "options.h"
#include "session.h"
#include "socket.h"
#include "summary.h"

#include <sched.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <memory>
#include <stdexcept>

namespace {

volatile std::sig_atomic_t interrupts = 0;

void interrupt(int)
{
    interrupts = interrupts + 1;
}

/* Pages of the stack that the session may need are met before it. */
void prefault_stack()
{
    volatile char pages[256 * 1024];
    for (size_t i = 0; i < sizeof pages; i += 1024) {
        pages[i] = 0;
    }
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

int run(Options &options)
{
    options.settings.may_ask = isatty(STDIN_FILENO) != 0;
    const Trajectory trajectory(options.trajectory, options.trajectory_period);
    std::unique_ptr<Records> records(new Records);
    std::unique_ptr<UdpWrenchSensor> sensor(options.sensor ? new UdpWrenchSensor(options.sensor_port) : NULL);
    Question question;
    UdpSocket socket;
    std::unique_ptr<Connection> connection(new Connection(socket, 1e-3 * options.timeout));
    std::unique_ptr<WipingClient> client(
        new WipingClient(options.settings, trajectory, sensor.get(), *connection, *records, question));
    if (client->refusal() != REFUSAL_NONE) {
        throw std::runtime_error(refusal_text(*client) + "; see fri_wiping --help");
    }
    Log log(*records, options.log, question);
    log.start();
    if (options.realtime > 0) {
        be_real_time(options.realtime);
    }
    prefault_stack();
    KUKA::FRI::ClientApplication application(*connection, *client);
    if (!application.connect(options.port, options.host.empty() ? NULL : options.host.c_str())) {
        throw std::runtime_error("port " + std::to_string(options.port) +
                                 (options.host.empty() ? "" : " and host " + options.host) +
                                 ": cannot be opened; choose a free --port and a numeric IPv4 --host");
    }
    std::printf("%s, %s; waiting for the robot on port %d\n", robot::name(), fri_description(), options.port);
    std::fflush(stdout);
    Ending ending = run_session(options, *client, *connection, application, interrupts);
    const bool logged = log.finish();
    const Summary summary(*client, *connection, *records, log, options, ending.code);
    summary.print();
    if (!options.summary.empty() && !summary.write(options.summary)) {
        ending.sentence += "; summary " + options.summary + ": " + std::strerror(errno);
    }
    if (!logged) {
        std::fprintf(
            stderr,
            "fri_wiping: the log is not complete (%llu records dropped); a slower disk needs a shorter session\n",
            records->refused());
    }
    std::fflush(stdout);
    std::fprintf(ending.code == DONE ? stdout : stderr, "fri_wiping: %s\n", ending.sentence.c_str());
    return ending.code;
}

} // namespace

int main(int argc, char **argv)
{
    static char output[1 << 16]; /* standard output's, so that none is allocated for it */
    std::setvbuf(stdout, output, _IOLBF, sizeof output);
    struct sigaction action;
    std::memset(&action, 0, sizeof action);
    /* No SA_RESTART: a wait for the robot is to end. Nor may the program stop, or the terminal go, under torque. */
    action.sa_handler = interrupt;
    for (const int number : {SIGINT, SIGTERM, SIGTSTP, SIGHUP}) {
        struct sigaction before;
        sigaction(number, NULL, &before);
        if (number != SIGHUP || before.sa_handler != SIG_IGN) { /* nohup */
            sigaction(number, &action, NULL);
        }
    }
    action.sa_handler = SIG_IGN;
    for (const int number : {SIGPIPE, SIGTTIN, SIGTTOU}) {
        sigaction(number, &action, NULL);
    }
    try {
        Options options;
        return options.parse(argc, argv) ? run(options) : DONE;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "fri_wiping: %s\n", error.what());
        return REFUSED;
    }
}

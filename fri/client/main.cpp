// SPDX-License-Identifier: MIT
/* fri_wiping: wipes along a zero-force trajectory with a KUKA LBR through the FRI, in torque mode. docs/fri.md. */
#include "log.h"
#include "options.h"
#include "session.h"
#include "socket.h"
#include "summary.h"

#include <sched.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

namespace {

volatile std::sig_atomic_t interrupts = 0;

/* Ask for the end of the session. A second Ctrl-C leaves at once; other signals, which may come again by themselves, do
 * not. */
void interrupt(int number)
{
    interrupts = number == SIGINT || interrupts == 0 ? interrupts + 1 : interrupts;
}

/* Handle every signal whose default action stops or ends the program, except those of a programming error: under torque
 * the program must do neither. */
void handle_signals()
{
    struct sigaction action;
    std::memset(&action, 0, sizeof action);
    action.sa_handler = interrupt; /* no SA_RESTART: a wait for the robot is to end */
    std::vector<int> ends = {SIGHUP,  SIGINT,    SIGQUIT, SIGALRM, SIGTERM, SIGUSR1, SIGUSR2,
                             SIGPROF, SIGVTALRM, SIGXCPU, SIGPOLL, SIGTSTP};
#ifdef SIGPWR
    ends.push_back(SIGPWR);
#endif
#ifdef SIGSTKFLT
    ends.push_back(SIGSTKFLT);
#endif
    for (int number = SIGRTMIN; number <= SIGRTMAX; ++number) {
        ends.push_back(number);
    }
    for (const int number : ends) {
        struct sigaction before;
        sigaction(number, NULL, &before);
        if (number != SIGHUP || before.sa_handler != SIG_IGN) { /* nohup */
            sigaction(number, &action, NULL);
        }
    }
    action.sa_handler = SIG_IGN;
    for (const int number : {SIGPIPE, SIGXFSZ, SIGTTIN, SIGTTOU}) {
        sigaction(number, &action, NULL);
    }
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

/* Refuse a summary that would overwrite the trajectory or the log. */
void check_files(const Options &options, const Log &log)
{
    struct stat trajectory, summary;
    if (options.summary.empty() || ::stat(options.summary.c_str(), &summary) != 0) {
        return;
    }
    const bool same = ::stat(options.trajectory.c_str(), &trajectory) == 0 && trajectory.st_dev == summary.st_dev &&
                      trajectory.st_ino == summary.st_ino;
    if (S_ISREG(summary.st_mode) && (same || log.file().same(options.summary))) {
        throw std::runtime_error("summary " + options.summary + ": the same file as the " +
                                 (same ? "trajectory" : "log") + "; name another file with --summary");
    }
}

ExitCode fault_unless_refused(ExitCode code)
{
    return code == REFUSED ? REFUSED : FAULT;
}

/* Complete log and summary, and report missing rows. A session that loses either is a fault, however it ended. */
void finish(const Options &options, const WipingClient &client, const Connection &connection, const Records &records,
            Log &log, Ending &ending)
{
    log.finish();
    const std::string trouble = log.trouble();
    ending.sentence += (trouble.empty() ? "" : "; ") + trouble;
    ending.code = trouble.empty() ? ending.code : fault_unless_refused(ending.code);
    log.keep(ending.code != REFUSED || log.rows() > 0);
    const Summary summary(client, connection, records, log, options, ending.code);
    summary.print();
    const int error = options.summary.empty() ? 0 : summary.write(options.summary);
    if (error != 0) {
        ending.sentence += "; summary " + options.summary + ": " + std::strerror(error);
        ending.code = fault_unless_refused(ending.code);
    }
}

/* Prepare everything that may fail, wait for the robot, run the session, and return its exit code. */
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
    std::unique_ptr<Log> log(new Log(*records, options.log, options.settings.posture_stiffness, question));
    check_files(options, *log);
    log->start();
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
    log->keep(true);
    std::printf("%s, %s; waiting for the robot on port %d\n", robot::name(), fri_description(), options.port);
    std::fflush(stdout);
    Ending ending = run_session(options, *client, *connection, application, interrupts);
    finish(options, *client, *connection, *records, *log, ending);
    std::fflush(stdout);
    std::fprintf(ending.code == DONE ? stdout : stderr, "fri_wiping: %s\n", ending.sentence.c_str());
    return ending.code;
}

} // namespace

/* Run the client; errors become a sentence and exit code on stderr. */
int main(int argc, char **argv)
{
    static char output[1 << 16]; /* standard output's, so that none is allocated for it */
    std::setvbuf(stdout, output, _IOLBF, sizeof output);
    handle_signals();
    try {
        Options options;
        return options.parse(argc, argv) ? run(options) : DONE;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "fri_wiping: %s\n", error.what());
        return REFUSED;
    }
}

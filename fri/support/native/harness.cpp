// SPDX-License-Identifier: MIT
/*
 * Sessions without sockets. Reads datagrams from stdin, each after its length (uint32, little-endian; 0xffffffff stands
 * for a timeout), steps a client application through them, and prints one line of JSON per step.
 *
 *   harness version
 *   harness probe                     a client that calls every getter and commands position and torque
 *   harness wiping LOG SUMMARY [fri_wiping's options]
 */
#include "log.h"
#include "options.h"
#include "session.h"
#include "summary.h"

#include <friException.h>

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

using namespace KUKA::FRI;

namespace {

/* Output of the lines: KUKA's library prints to standard output, which is redirected to standard error. */
std::FILE *lines;

/* Print an array as a field of JSON. */
void print(const char *name, const double *values, int count)
{
    std::fprintf(lines, ", \"%s\": [", name);
    for (int i = 0; i < count; ++i) {
        /* null: not a number, as JSON has none */
        std::fprintf(lines, values[i] == values[i] ? "%s%.17g" : "%snull", i > 0 ? ", " : "", values[i]);
    }
    std::fprintf(lines, "]");
}

/* The robot's side: datagrams from stdin, a line of JSON for each, which ends when the next one is wanted. */
class Script : public Datagrams {
public:
    Script() : size_(0), sent_size_(0), at_end_(false), open_(false) { next(); }

    bool at_end() const { return at_end_; }
    bool open(int, const char *) override { return true; }
    void close() override {}
    bool is_open() const override { return true; }

    int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age) override
    {
        *age = 0.0;
        if (wait <= 0.0) {
            return -1; /* never more than one at a time */
        }
        end_line(true); /* the one before was refused */
        if (at_end_) {
            return -1;
        }
        std::fprintf(lines, "{\"begin\": 0");
        open_ = true;
        sent_size_ = 0;
        const int length = size_;
        std::copy(datagram_.begin(), datagram_.begin() + std::min(static_cast<long>(datagram_.size()),
                                                                  static_cast<long>(capacity)), bytes);
        next();
        return length;
    }

    bool send(const std::uint8_t *bytes, std::size_t size) override
    {
        sent_.assign(bytes, bytes + size);
        sent_size_ = size;
        return true;
    }

    void end_line(bool stepped)
    {
        if (!open_) {
            return;
        }
        std::fprintf(lines, ", \"sent\": \"");
        for (std::size_t i = 0; i < sent_size_; ++i) {
            std::fprintf(lines, "%02x", sent_[i]);
        }
        std::fprintf(lines, "\", \"step\": %s}\n", stepped ? "true" : "false");
        open_ = false;
    }

private:
    void next()
    {
        unsigned char head[4];
        datagram_.clear();
        at_end_ = std::fread(head, 1, 4, stdin) != 4;
        unsigned length = 0;
        for (int k = 3; k >= 0 && !at_end_; --k) {
            length = length << 8 | head[k];
        }
        size_ = length == 0xffffffffu ? -1 : static_cast<int>(length);
        datagram_.resize(size_ > 0 ? length : 0);
        if (size_ > 0 && std::fread(datagram_.data(), 1, length, stdin) != length) {
            at_end_ = true;
        }
    }

    std::vector<std::uint8_t> datagram_, sent_;
    int size_;
    std::size_t sent_size_;
    bool at_end_, open_;
};

class Probe : public LBRClient {
public:
    virtual void onStateChange(ESessionState from, ESessionState to)
    {
        std::fprintf(lines, ", \"change\": [%d, %d]", static_cast<int>(from), static_cast<int>(to));
    }

    virtual void monitor()
    {
        std::fprintf(lines, ", \"callback\": \"monitor\"");
        show();
        refusals();
    }

    virtual void waitForCommand()
    {
        std::fprintf(lines, ", \"callback\": \"waitForCommand\"");
        show();
        const double zero[7] = {0};
        robotCommand().setJointPosition(robotState().getIpoJointPosition());
        robotCommand().setTorque(zero);
    }

    virtual void command()
    {
        std::fprintf(lines, ", \"callback\": \"command\"");
        show();
        try {
            robotCommand().setJointPosition(robotState().getMeasuredJointPosition());
            robotCommand().setTorque(robotState().getExternalTorque());
            robotCommand().setBooleanIOValue("Group.Lamp", true);
            robotCommand().setDigitalIOValue("Group.Word", 0xfedcba9876543210ull);
            robotCommand().setAnalogIOValue("Group.Level", -0.25);
        } catch (const FRIException &error) {
            std::fprintf(lines, ", \"refused\": \"%s\"", error.getErrorMessage());
        }
    }

private:
    /* Commands that do not fit the monitoring states: refused from 2.7 on. */
    void refusals()
    {
        int refused = 0;
        const double zero[7] = {0};
        try {
            robotCommand().setTorque(zero);
        } catch (const FRIException &) {
            ++refused;
        }
        try {
            robotCommand().setJointPosition(zero);
        } catch (const FRIException &) {
            ++refused;
        }
        std::fprintf(lines, ", \"refusals\": %d", refused);
    }

    template <typename T> void value(const char *name, T value)
    {
        std::fprintf(lines, ", \"%s\": %.17g", name, static_cast<double>(value));
    }

    void show()
    {
        const LBRState &s = robotState();
        value("state", s.getSessionState());
        value("quality", s.getConnectionQuality());
        value("sample_time", s.getSampleTime());
        value("safety", s.getSafetyState());
        value("operation", s.getOperationMode());
        value("drive", s.getDriveState());
        value("mode", s.getClientCommandMode());
        value("overlay", s.getOverlayType());
        value("control", s.getControlMode());
        value("seconds", s.getTimestampSec());
        value("nanoseconds", s.getTimestampNanoSec());
        value("tracking", s.getTrackingPerformance());
        print("position", s.getMeasuredJointPosition(), 7);
        print("torque", s.getMeasuredTorque(), 7);
        print("commanded_torque", s.getCommandedTorque(), 7);
        print("external_torque", s.getExternalTorque(), 7);
#if FRI_VERSION < 200
        print("commanded_position", s.getCommandedJointPosition(), 7);
#else
        double matrix[3][4];
        print("pose", s.getMeasuredCartesianPose(), 7);
        s.getMeasuredCartesianPoseAsMatrix(matrix);
        print("matrix", &matrix[0][0], 12);
        const double redundancy = s.getMeasuredRedundancyValue();
        print("redundancy", &redundancy, 1);
        value("strategy", s.getRedundancyStrategy());
#endif
#if FRI_VERSION >= 207
        print("external_force", s.getExternalForce(), 6);
#endif
        try {
            print("ipo", s.getIpoJointPosition(), 7);
        } catch (const FRIException &) {
            std::fprintf(lines, ", \"ipo\": null");
        }
        try {
            value("lamp", s.getBooleanIOValue("Group.Lamp"));
            std::fprintf(lines, ", \"word\": \"%llu\"", s.getDigitalIOValue("Group.Word"));
            value("level", s.getAnalogIOValue("Group.Level"));
            value("lamp_as_analog", s.getAnalogIOValue("Group.Lamp"));
        } catch (const FRIException &) {
        }
    }
};

/* Print the counts of the connection as a line of JSON. */
void statistics(const Traffic &t)
{
    std::fprintf(lines, "{\"messages\": %llu, \"timeouts\": %llu, \"lost_messages\": %llu, \"lost_answers\": %llu, "
                "\"late_answers\": %llu",
                t.messages, t.timeouts, t.lost_messages, t.lost_answers, t.unseen_answers);
    for (int k = 0; k < FAULT_COUNT; ++k) {
        std::fprintf(lines, ", \"%s\": %llu", fault_name(k), t.faults[k]);
    }
    std::fprintf(lines, "}\n");
}

/* Print what each getter of the library returns, per message. */
int probe()
{
    Script script;
    Connection connection(script, 1e9);
    Probe client;
    ClientApplication application(connection, client);
    application.connect(30200);
    while (!script.at_end()) {
        const bool good = application.step();
        script.end_line(good);
    }
    statistics(connection.traffic());
    return 0;
}

/* Run the client on the messages of standard input, without a thread or a network. */
int wiping(int argc, char **argv)
{
    const std::string log_path = argv[2], summary_path = argv[3];
    Options options;
    options.parse(argc - 3, argv + 3);
    options.settings.simulated_time = true;
    const Trajectory trajectory(options.trajectory, options.trajectory_period);
    std::unique_ptr<Records> records(new Records);
    Script script;
    Connection connection(script, 1e9);
    Question question;
    std::unique_ptr<WipingClient> client(
        new WipingClient(options.settings, trajectory, NULL, connection, *records, question));
    std::remove(log_path.c_str()); /* of the session before */
    Log log(*records, log_path, options.settings.posture_stiffness, question);
    log.keep(true);
    ClientApplication application(connection, *client);
    application.connect(30200);
    while (!script.at_end() && client->refusal() == REFUSAL_NONE) {
        const bool good = application.step();
        script.end_line(good);
    }
    log.start(); /* only now: the ring must hold the session */
    log.finish();
    Summary(*client, connection, *records, log, options, client->refusal()).write(summary_path);
    return 0;
}

} // namespace

/* Print lines of JSON on standard output, and what the client prints on standard error. */
int main(int argc, char **argv)
{
    const std::string mode = argc > 1 ? argv[1] : "";
    lines = fdopen(dup(STDOUT_FILENO), "w");
    dup2(STDERR_FILENO, STDOUT_FILENO);
    if (mode == "version") {
        std::fprintf(lines, "%s\n", fri_description());
        return 0;
    }
    return mode == "probe" ? probe() : mode == "wiping" && argc > 3 ? wiping(argc, argv) : 2;
}

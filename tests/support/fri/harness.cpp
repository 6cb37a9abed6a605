/*
 * Sessions without sockets. Reads datagrams from stdin, each after its length (uint32, little-endian; 0xffffffff stands
 * for a timeout), steps a client application through them, and prints one line of JSON a step.
 *
 *   harness version
 *   harness probe                     a client that calls every getter and commands position and torque
 *   harness wiping LOG SUMMARY [fri_wiping's options]
 */
#include "log.h"
#include "options.h"
#include "summary.h"
#include "traffic.h"

#include <cstdio>
#include <memory>
#include <string>
#include <vector>

using namespace KUKA::FRI;

namespace {

void print(const char *name, const double *values, int count)
{
    std::printf(", \"%s\": [", name);
    for (int i = 0; i < count; ++i) {
        /* null: not a number, as JSON has none */
        std::printf(values[i] == values[i] ? "%s%.17g" : "%snull", i > 0 ? ", " : "", values[i]);
    }
    std::printf("]");
}

/* The robot's side: datagrams from stdin. */
class Script : public Traffic {
public:
    Script() : Traffic(1), size_(0), sent_size_(0), at_end_(false) { next(); }

    bool at_end() const { return at_end_; }
    bool open(int, const char *) override { return true; }
    void close() override {}
    bool isOpen() const override { return true; }

    int receive(Buffer buffer, Size size) override
    {
        const std::vector<char> now = datagram_;
        const int length = size_;
        sent_size_ = 0;
        next();
        std::copy(now.begin(), now.begin() + std::min(static_cast<long>(now.size()), static_cast<long>(size)), buffer);
        return length;
    }

    bool send(Bytes bytes, Size size) override
    {
        sent_.assign(bytes, bytes + size);
        sent_size_ = static_cast<int>(size);
        return true;
    }

    void print_sent() const
    {
        std::printf(", \"sent\": \"");
        for (int i = 0; i < sent_size_; ++i) {
            std::printf("%02x", static_cast<unsigned char>(sent_[static_cast<size_t>(i)]));
        }
        std::printf("\"");
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

    std::vector<char> datagram_, sent_;
    int size_, sent_size_;
    bool at_end_;
};

class Probe : public LBRClient {
public:
    virtual void onStateChange(ESessionState from, ESessionState to)
    {
        std::printf(", \"change\": [%d, %d]", static_cast<int>(from), static_cast<int>(to));
    }

    virtual void monitor()
    {
        std::printf(", \"callback\": \"monitor\"");
        show();
        refusals();
    }

    virtual void waitForCommand()
    {
        std::printf(", \"callback\": \"waitForCommand\"");
        show();
        const double zero[7] = {0};
        robotCommand().setJointPosition(robotState().getIpoJointPosition());
        robotCommand().setTorque(zero);
    }

    virtual void command()
    {
        std::printf(", \"callback\": \"command\"");
        show();
        try {
            robotCommand().setJointPosition(robotState().getMeasuredJointPosition());
            robotCommand().setTorque(robotState().getExternalTorque());
            robotCommand().setBooleanIOValue("Group.Lamp", true);
            robotCommand().setDigitalIOValue("Group.Word", 0xfedcba9876543210ull);
            robotCommand().setAnalogIOValue("Group.Level", -0.25);
        } catch (const FRIException &error) {
            std::printf(", \"refused\": \"%s\"", error.getErrorMessage());
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
        std::printf(", \"refusals\": %d", refused);
    }

    template <typename T> void value(const char *name, T value)
    {
        std::printf(", \"%s\": %.17g", name, static_cast<double>(value));
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
            std::printf(", \"ipo\": null");
        }
        try {
            value("lamp", s.getBooleanIOValue("Group.Lamp"));
            std::printf(", \"word\": \"%llu\"", s.getDigitalIOValue("Group.Word"));
            value("level", s.getAnalogIOValue("Group.Level"));
            value("lamp_as_analog", s.getAnalogIOValue("Group.Lamp"));
        } catch (const FRIException &) {
        }
    }
};

void statistics(const ClientApplication &application)
{
#ifdef OPEN_FRI
    const open_fri::Statistics &s = application.statistics();
    std::printf(
        "{\"messages\": %llu, \"answers\": %llu, \"timeouts\": %llu, \"lost_messages\": %llu, \"lost_answers\": %llu, "
        "\"late_answers\": %llu",
        static_cast<unsigned long long>(s.messages), static_cast<unsigned long long>(s.answers),
        static_cast<unsigned long long>(s.timeouts), static_cast<unsigned long long>(s.lost_messages),
        static_cast<unsigned long long>(s.lost_answers), static_cast<unsigned long long>(s.late_answers));
    for (int k = 0; k < open_fri::FAULT_COUNT; ++k) {
        std::printf(", \"%s\": %llu", open_fri::fault_name(k), static_cast<unsigned long long>(s.faults[k]));
    }
    std::printf("}\n");
#else
    (void)application;
    std::printf("{}\n");
#endif
}

int probe()
{
    Script script;
    Probe client;
    ClientApplication application(script, client);
    application.connect(30200);
    while (!script.at_end()) {
        std::printf("{\"begin\": 0");
        const bool good = application.step();
        script.print_sent();
        std::printf(", \"step\": %s}\n", good ? "true" : "false");
    }
    statistics(application);
    return 0;
}

int wiping(int argc, char **argv)
{
    const std::string log_path = argv[2], summary_path = argv[3];
    Options options;
    options.parse(argc - 3, argv + 3);
    const Trajectory trajectory(options.trajectory, options.trajectory_period);
    std::unique_ptr<Records> records(new Records);
    std::unique_ptr<WipingClient> client(new WipingClient(options.settings, trajectory, NULL, *records));
    Log log(*records, log_path);
    Script script;
    ClientApplication application(script, *client);
    application.connect(30200);
    while (!script.at_end() && client->refusal() == REFUSAL_NONE) {
        const bool good = application.step();
        script.note_step(good);
        std::printf("{\"begin\": 0");
        script.print_sent();
        std::printf(", \"step\": %s}\n", good ? "true" : "false");
    }
    std::fflush(stdout);
    log.start(); /* only now, so that its lines come after those above; the ring must hold the session */
    log.finish();
    Summary(*client, script, application, *records, log, options, client->refusal()).write(summary_path);
    return 0;
}

} // namespace

int main(int argc, char **argv)
{
    const std::string mode = argc > 1 ? argv[1] : "";
    if (mode == "version") {
        std::printf("%s\n", fri_description());
        return 0;
    }
    return mode == "probe" ? probe() : mode == "wiping" && argc > 3 ? wiping(argc, argv) : 2;
}

/*
 * libFuzzer target: a hostile datagram through the decoder, and in the middle of a session through the whole client.
 *
 * The file that FRI_FUZZ_SESSION names holds the session's sound datagrams, each after its length (uint32,
 * little-endian): up to the last but one before the hostile datagram, the last one after it. The first byte of an input
 * chooses whether a framed version gets the rest as it is or with the right length and checksum around it.
 */
#include "traffic.h"
#include "wiping_client.h"

#include <sys/mman.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

using namespace KUKA::FRI;

namespace {

typedef std::vector<std::uint8_t> Bytes_;

std::vector<Bytes_> session;
std::unique_ptr<Trajectory> trajectory;

void require(bool holds, const char *what)
{
    if (!holds) {
        std::fprintf(stderr, "broken: %s\n", what);
        std::abort();
    }
}

class Feed : public IConnection {
public:
    virtual bool open(int, const char *) { return true; }
    virtual void close() {}
    virtual bool isOpen() const { return true; }

    virtual int receive(ReceiveBuffer buffer, BufferSize size)
    {
        const size_t count = std::min(next.size(), static_cast<size_t>(size));
        std::copy(next.begin(), next.begin() + static_cast<std::ptrdiff_t>(count), buffer);
        return static_cast<int>(next.size());
    }

    virtual bool send(SendBuffer, BufferSize size)
    {
        require(size > 0 && size <= 1500, "size of an answer");
        return true;
    }

    Bytes_ next;
};

/* The client, with a look at what it sends. */
class Watched : public WipingClient {
public:
    Watched(const Settings &settings, Records &ring) : WipingClient(settings, *trajectory, NULL, ring), ring_(ring) {}

    void check()
    {
        Record record;
        while (ring_.pop(&record)) {
            for (int i = 0; record.kind == Record::STEP && i < JOINTS; ++i) {
                const double limit = config().effort_limit[i], torque = record.sent_torque[i];
                require(std::isfinite(torque) && std::fabs(torque) <= limit, "torque");
                require(std::isfinite(record.sent_position[i]), "position");
                require(record.start ||
                            std::fabs(torque - last_[i]) <= config().torque_rate_limit[i] * sample_time() * (1 + 1e-8),
                        "step of the torque");
                last_[i] = torque;
            }
        }
    }

    /* Every getter's memory, so that the sanitizer sees it read. */
    double sum() const
    {
        const LBRState &s = robotState();
        double total = s.getSampleTime() + s.getTrackingPerformance() + s.getDriveState();
        for (int i = 0; i < JOINTS; ++i) {
            total += s.getMeasuredJointPosition()[i] + s.getMeasuredTorque()[i] + s.getCommandedTorque()[i] +
                     s.getExternalTorque()[i];
        }
        try {
            total += s.getIpoJointPosition()[0] + s.getAnalogIOValue("Group.Level");
        } catch (const FRIException &) {
        }
        return total;
    }

private:
    Records &ring_;
    double last_[JOINTS] = {0};
};

/* The decoder on a datagram that ends where readable memory ends: nanopb's library is not seen by the sanitizer. */
bool decode_at_the_edge(const Bytes_ &datagram)
{
    static const size_t page = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    static std::uint8_t *const edge = [] {
        void *const memory = mmap(NULL, 2 * page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        require(memory != MAP_FAILED, "mmap");
        std::uint8_t *const end = static_cast<std::uint8_t *>(memory) + page;
        require(mprotect(end, page, PROT_NONE) == 0, "mprotect");
        return end;
    }();
    if (datagram.size() > page) {
        return false;
    }
    std::unique_ptr<open_fri::Monitoring> message(new open_fri::Monitoring);
    std::copy(datagram.begin(), datagram.end(), edge - datagram.size());
    return open_fri::decode(edge - datagram.size(), datagram.size(), message.get()) == open_fri::FAULT_NONE;
}

Bytes_ framed(const std::uint8_t *data, size_t size)
{
    if (size == 0 || FRI_VERSION < 207 || (data[0] & 1) == 0) {
        return Bytes_(data + (size > 0), data + size);
    }
    ++data;
    --size;
    std::uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < size; ++i) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ (0xedb88320u & (0u - (crc & 1u)));
        }
    }
    Bytes_ result;
    for (int i = 0; i < 4; ++i) {
        result.push_back(static_cast<std::uint8_t>(size >> (8 * i)));
    }
    result.insert(result.end(), data, data + size);
    for (int i = 0; i < 4; ++i) {
        result.push_back(static_cast<std::uint8_t>(~crc >> (8 * i)));
    }
    return result;
}

} // namespace

extern "C" int LLVMFuzzerInitialize(int *, char ***)
{
    std::FILE *const file = std::fopen(std::getenv("FRI_FUZZ_SESSION"), "rb");
    require(file != NULL, "FRI_FUZZ_SESSION");
    std::uint8_t head[4];
    while (std::fread(head, 1, 4, file) == 4) {
        Bytes_ datagram(static_cast<size_t>(head[0]) + 256u * head[1]);
        require(std::fread(datagram.data(), 1, datagram.size(), file) == datagram.size(), "FRI_FUZZ_SESSION");
        session.push_back(datagram);
    }
    std::fclose(file);
    require(session.size() >= 2, "FRI_FUZZ_SESSION");
    trajectory.reset(new Trajectory(std::getenv("FRI_FUZZ_TRAJECTORY"), 0.005));
    return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t *data, size_t size)
{
    static Records ring;
    static const Settings settings;
    const Bytes_ hostile = framed(data, size);
    /* What the decoder refuses reaches no client, so that a session is worth its time for one in a few only. */
    if (!decode_at_the_edge(hostile) && (size == 0 || data[size - 1] % 16 != 0)) {
        return 0;
    }
    std::unique_ptr<Watched> client(new Watched(settings, ring));
    Feed feed;
    std::unique_ptr<ClientApplication> application(new ClientApplication(feed, *client));
    for (size_t i = 0; i <= session.size(); ++i) {
        const size_t last = session.size() - 1;
        feed.next = i == last ? hostile : session[std::min(i, last)];
        require(application->step(), "one bad datagram ends no session");
        volatile double total = client->sum();
        (void)total;
        client->check();
    }
    return 0;
}

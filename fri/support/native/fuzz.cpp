// SPDX-License-Identifier: MIT
/*
 * libFuzzer target: a hostile datagram through the decoder, and in the middle of a session through the whole client.
 *
 * The file that FRI_FUZZ_SESSION names holds the session's sound datagrams, each after its length (uint32,
 * little-endian): up to the last but one before the hostile datagram, the last one after it. The first byte of an input
 * chooses whether a framed version gets the rest as it is or with the right length and checksum around it.
 */
#include "connection.h"
#include "wiping_client.h"

#include <friClientApplication.h>
#include <friException.h>

#include <open_fri_messages.h>

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

class Feed : public Datagrams {
public:
    virtual bool open(int, const char *) { return true; }
    virtual void close() {}
    virtual bool is_open() const { return true; }

    virtual int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age)
    {
        *age = 0.0;
        if (wait <= 0.0 || next == NULL) {
            return -1;
        }
        const size_t count = std::min(next->size(), capacity);
        std::copy(next->begin(), next->begin() + static_cast<std::ptrdiff_t>(count), bytes);
        const int size = static_cast<int>(next->size());
        next = NULL;
        return size;
    }

    virtual bool send(const std::uint8_t *, std::size_t size)
    {
        require(size > 0 && size <= 1500, "size of an answer");
        return true;
    }

    const Bytes_ *next = NULL;
};

/* The client, with a look at what it sends. */
class Watched : public WipingClient {
public:
    Watched(const Settings &settings, const Connection &connection, Records &ring, Question &question)
        : WipingClient(settings, *trajectory, NULL, connection, ring, question), ring_(ring)
    {
    }

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

/* The check and the decoder on a datagram that ends where readable memory ends: nanopb's library is not seen by the
 * sanitizer. What the check lets through the decoder must take. */
bool check_at_the_edge(const Bytes_ &datagram)
{
    static const size_t page = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    static std::uint8_t *const edge = [] {
        void *const memory = mmap(NULL, 2 * page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        require(memory != MAP_FAILED, "mmap");
        std::uint8_t *const end = static_cast<std::uint8_t *>(memory) + page;
        require(mprotect(end, page, PROT_NONE) == 0, "mprotect"); /* reading one byte beyond is a crash */
        return end;
    }();
    if (datagram.size() > page) {
        return false;
    }
    std::unique_ptr<open_fri::Monitoring> message(new open_fri::Monitoring);
    std::uint8_t *const begin = edge - datagram.size();
    std::copy(datagram.begin(), datagram.end(), begin);
    Message seen;
    const bool sound = check_datagram(begin, datagram.size(), &seen) == FAULT_NONE;
    const bool decoded = open_fri::decode(begin, datagram.size(), message.get());
    require(decoded || !sound, "what the check lets through the decoder takes");
    other_framing(begin, datagram.size());
    return sound;
}

/* Return the fuzzer's bytes; in a frame with a right checksum if the first bit asks for it. */
Bytes_ framed(const std::uint8_t *data, size_t size)
{
    if (size == 0 || FRI_VERSION < 207 || (data[0] & 1) == 0) {
        return Bytes_(data + (size > 0), data + size);
    }
    ++data;
    --size;
    std::uint32_t crc = 0xffffffffu; /* CRC-32 of zip and Ethernet, bit by bit */
    for (size_t i = 0; i < size; ++i) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ (0xedb88320u & (0u - (crc & 1u)));
        }
    }
    Bytes_ result; /* length, message, checksum, both little-endian */
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

/* Read the session into which hostile datagrams are put: each has two bytes of length, low first, and two of zero. */
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
    trajectory.reset(new Trajectory(std::getenv("FRI_FUZZ_TRAJECTORY"), 0.005)); /* [s] per sample */
    return 0;
}

/* Send the session with one hostile datagram before its last message, and check what the client then does. */
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t *data, size_t size)
{
    static Records ring;
    static Settings settings;
    settings.simulated_time = settings.approach_anyway = true;
    const Bytes_ hostile = framed(data, size);
    /* Datagrams that the check refuses reach no client: a session is worth its time only for one in a few. */
    if (!check_at_the_edge(hostile) && (size == 0 || data[size - 1] % 16 != 0)) {
        return 0;
    }
    Feed feed;
    Question question;
    std::unique_ptr<Connection> connection(new Connection(feed, 1e9));
    std::unique_ptr<Watched> client(new Watched(settings, *connection, ring, question));
    std::unique_ptr<ClientApplication> application(new ClientApplication(*connection, *client));
    for (size_t i = 0; i <= session.size(); ++i) {
        const size_t last = session.size() - 1;
        feed.next = i == last ? &hostile : &session[std::min(i, last)];
        const bool stepped = application->step();
        require(stepped || !connection->handed_on(), "the library takes what the check lets through");
        volatile double total = client->sum();
        (void)total;
        client->check();
    }
    return 0;
}

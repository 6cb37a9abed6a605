// SPDX-License-Identifier: MIT
/*
 * Sessions of the client with a hostile robot, in one process, with a virtual clock, network and
 * arm. Reads schedules from stdin, one per line, and prints the result of each as a line of JSON.
 *
 *   attack TRAJECTORY PERIOD_MS [SECONDS]
 *
 * A schedule is "SEED [KIND START LENGTH VALUE]...": what the robot, the network, this machine or the person does, from a
 * time [s] since the first message, for so long [s]. KIND is a name of KINDS. tests/campaigns/attack_fri.py makes and mutates
 * them.
 */
#include "attack_world.h"

/* In place of the C library's. */
extern "C" int clock_gettime(clockid_t, struct timespec *time) noexcept
{
    const std::int64_t told = EPOCH + now_ns;
    time->tv_sec = told / 1000000000;
    time->tv_nsec = told % 1000000000;
    return 0;
}

namespace {

/* ---- a session --------------------------------------------------------------------------------------------------- */

/* What only the client's records show. */
struct Seen {
    double elastic = 0.0, lead = 0.0, reference = 0.0, error = 0.0;
    bool let_go = false;
    double let_go_time = -1.0, zero_time = -1.0, apart = 0.0;
};

struct Place {
    double time;
    Vector q0;
};

const char *boolean(bool value)
{
    return value ? "true" : "false";
}

void session(const Schedule &schedule, const std::string &file, int period)
{
    now_ns = 0;
    interrupts = 0;
    Options options;
    options.timeout = 1000;
    options.wait = 3.0;
    options.settings.approach_time = 0.3;
    options.settings.pace.patience = 1.0;
    options.settings.may_ask = schedule.events.count("answer") > 0;
    const Trajectory trajectory(file, options.trajectory_period);
    Vector start, rate;
    trajectory.at(0.0, start.data(), rate.data());
    start[0] += 0.02;
    World world(schedule, start, period);
    std::unique_ptr<Records> records(new Records);
    Question question;
    std::unique_ptr<Connection> connection(new Connection(world, 1e-3 * options.timeout));
    std::unique_ptr<WipingClient> client(
        new WipingClient(options.settings, trajectory, NULL, *connection, *records, question));
    KUKA::FRI::ClientApplication application(*connection, *client);
    for (int i = 0; i < JOINTS; ++i) {
        world.effort[i] = client->config().effort_limit[i];
        world.torque_rate[i] = client->config().torque_rate_limit[i];
    }
    Seen seen;
    std::deque<Place> places; /* of the reference, in one motion */
    double slack = 1e300;     /* least of progress minus time so far */
    const double energy_limit = client->config().energy_limit;
    world.watch = [&] {
        world.sample_time = client->sample_time();
        const Event *const answer = world.schedule.due("answer", seconds());
        if (answer != NULL && question.state() == Question::ASKED) {
            question.answer(answer->value >= 0.5);
        }
        const double ahead = client->progress() - seconds();
        slack = std::min(slack, ahead);
        seen.lead = std::max(seen.lead, (ahead - slack) / client->sample_time() / 8.0);
        Record record;
        while (records->pop(&record)) {
            if ((record.events & EVENT_LET_GO) != 0 && !seen.let_go) {
                seen.let_go = true;
                seen.let_go_time = seconds();
                seen.apart = world.apart;
            }
            if (record.kind == Record::STATE || record.start || record.reset) {
                places.clear();
            }
            if (record.kind != Record::STEP || !record.sample_valid) {
                continue;
            }
            seen.elastic = std::max(seen.elastic, record.elastic_energy / energy_limit);
            double wanted[16], there[16], square = 0.0;
            robot::pose(record.q0, wanted);
            robot::pose(world.arm.q.data(), there);
            for (int i = 0; i < 3; ++i) {
                square += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
            }
            seen.error = std::max(seen.error, std::sqrt(square));
            Place place = {seconds(), Vector()};
            std::copy(record.q0, record.q0 + JOINTS, place.q0.begin());
            for (const Place &old : places) {
                for (int i = 0; i < JOINTS; ++i) {
                    const std::size_t k = static_cast<std::size_t>(i);
                    const double allowed = place.time - old.time + 8.0 * client->sample_time();
                    seen.reference = std::max(seen.reference, std::fabs(place.q0[k] - old.q0[k]) /
                                                                  (robot::velocity(i) * allowed));
                }
            }
            places.push_back(place);
            if (places.size() > 40) {
                places.pop_front();
            }
        }
        if (seen.let_go && seen.zero_time < 0.0 && world.last_torque == 0.0) {
            seen.zero_time = seconds();
        }
    };
    application.connect(30200);
    Ending ending = {FAULT, "the client does not end"};
    try {
        ending = run_session(options, *client, *connection, application, interrupts);
    } catch (const std::runtime_error &error) {
        ending.sentence = error.what();
    }
    Record record;
    while (records->pop(&record)) {
        seen.let_go = seen.let_go || (record.events & EVENT_LET_GO) != 0;
    }
    seen.let_go = seen.let_go || client->gone() != LET_GO_NONE;
    const double last = seconds();
    const long recent = std::count_if(world.deliveries.begin(), world.deliveries.end(),
                                      [last](double time) { return time > last - 0.5; });
    std::printf("{\"code\": %d, \"sentence\": \"%s\", \"over_limit\": %.17g, \"step\": %.17g, \"rate\": %.17g, "
                "\"lead\": %.17g, \"reference\": %.17g, \"elastic\": %.17g, \"error\": %.17g, \"kinetic\": %.17g, "
                "\"fast\": %.17g, \"work\": %.17g, \"axis_delta\": %.17g, \"unanswered\": %u, \"not_finite\": %u, "
                "\"sent\": %u, \"last_torque\": %.17g, \"recent\": %ld, \"time\": %.17g, ",
                static_cast<int>(ending.code), ending.sentence.c_str(), world.over_limit, world.step, world.rate,
                seen.lead, seen.reference, seen.elastic, seen.error, world.kinetic, world.fast, world.arm.work,
                world.axis_delta, world.unanswered, world.not_finite, world.sent, world.last_torque, recent, last);
    std::printf("\"release\": %.17g, \"let_go\": %s, \"done\": %s, \"idle\": %s, \"interrupted\": %s, \"interrupts\": %d, "
                "\"declined\": %s, \"moved\": %s, \"refused\": %s, \"state\": %d, \"progress\": %.17g, \"parted\": %.17g, "
                "\"let_go_time\": %.17g, \"beyond\": %.17g, \"apart\": %.17g, \"held\": %.17g}\n",
                seen.zero_time >= 0.0 ? seen.zero_time - seen.let_go_time : -1.0, boolean(seen.let_go),
                boolean(client->trajectory_done()), boolean(world.idle_seen), boolean(world.interrupted),
                static_cast<int>(interrupts), boolean(client->question().state() == Question::NO), boolean(world.moved),
                boolean(client->refusal() != REFUSAL_NONE), world.last_state, client->progress(), world.parted,
                seen.let_go_time, world.beyond, seen.let_go ? seen.apart : world.apart,
                world.parted_joint >= 0 ? world.held[static_cast<std::size_t>(world.parted_joint)] : 0.0);
    std::fflush(stdout);
}

} // namespace

int main(int argc, char **argv)
{
    if (argc < 3 || argc > 4) {
        std::fprintf(stderr, "attack TRAJECTORY PERIOD_MS [SECONDS]\n");
        return 2;
    }
    END = argc > 3 ? std::atof(argv[3]) : END;
    for (std::string line; std::getline(std::cin, line);) {
        session(Schedule(line), argv[1], std::atoi(argv[2]));
    }
    return 0;
}

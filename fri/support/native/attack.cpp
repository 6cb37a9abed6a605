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

/* Replace the C library's, so that the client's clock is the schedule's: now_ns after EPOCH. */
extern "C" int clock_gettime(clockid_t, struct timespec *time) noexcept
{
    const std::int64_t told = EPOCH + now_ns;
    time->tv_sec = told / 1000000000;
    time->tv_nsec = told % 1000000000;
    return 0;
}

namespace {

/* ---- a session --------------------------------------------------------------------------------------------------- */

const char *boolean(bool value)
{
    return value ? "true" : "false";
}

/* Watches over a session: what only the client and its records show. */
class Watcher {
public:
    Watcher(World &world, WipingClient &client, Records &records, Question &question)
        : world_(world), client_(client), records_(records), question_(question)
    {
    }

    /* After each answer. */
    void look()
    {
        world_.sample_time = client_.sample_time();
        const Event *const answer = world_.schedule.due("answer", seconds());
        if (answer != NULL && question_.state() == Question::ASKED) {
            question_.answer(answer->value >= 0.5);
        }
        const double ahead = client_.progress() - seconds();
        slack_ = std::min(slack_, ahead);
        lead = std::max(lead, (ahead - slack_) / client_.sample_time() / 8.0);
        Record record;
        while (records_.pop(&record)) {
            take(record);
        }
        if (let_go && zero_time < 0.0 && world_.last_torque == 0.0) {
            zero_time = seconds();
        }
    }

    /* After the session. */
    void finish()
    {
        Record record;
        while (records_.pop(&record)) {
            let_go = let_go || (record.events & EVENT_LET_GO) != 0;
        }
        let_go = let_go || client_.gone() != LET_GO_NONE;
    }

    double elastic = 0.0, lead = 0.0, reference = 0.0, error = 0.0;
    bool let_go = false;
    double let_go_time = -1.0, zero_time = -1.0, apart = 0.0;
    double end[JOINTS];             /* [rad] of the trajectory */
    double commanded = 0.0, most_commanded = 0.0; /* [N] wrench_command: of the last sample, at most */
    double rest = 0.0, force = 0.0; /* in the last sample: [m] of the tip from the end, [N] of the torque at the tip */

private:
    struct Place {
        double time;
        Vector q0;
    };

    void take(const Record &record)
    {
        if ((record.events & EVENT_LET_GO) != 0 && !let_go) {
            let_go = true;
            let_go_time = seconds();
            apart = world_.apart;
        }
        if (record.kind == Record::STATE || record.start || record.reset) {
            places_.clear();
        }
        if (record.kind == Record::STEP && record.sample_valid) {
            elastic = std::max(elastic, record.elastic_energy / client_.settings().pace.energy);
            error = std::max(error, distance(record.q0));
            measure_speed(record);
            measure_rest(record);
            commanded = size_of(record.wrench_command);
            most_commanded = std::max(most_commanded, commanded);
        }
    }

    /* Return the distance [m] of the arm's tip from where it is at joint positions. */
    double distance(const double *q) const
    {
        double wanted[16], there[16], square = 0.0;
        robot::pose(q, wanted);
        robot::pose(world_.arm.q.data(), there);
        for (int i = 0; i < 3; ++i) {
            square += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
        }
        return std::sqrt(square);
    }

    void measure_rest(const Record &record)
    {
        double wrench[6];
        robot::external_wrench(record.q, record.torque, 1e-3, wrench);
        rest = distance(end);
        force = size_of(wrench);
    }

    /* Speed of the reference, as a share of the velocity limits. */
    void measure_speed(const Record &record)
    {
        Place place = {seconds(), Vector()};
        std::copy(record.q0, record.q0 + JOINTS, place.q0.begin());
        for (const Place &old : places_) {
            const double allowed = place.time - old.time + 8.0 * client_.sample_time();
            for (int i = 0; i < JOINTS; ++i) {
                const std::size_t k = static_cast<std::size_t>(i);
                const double moved = std::fabs(place.q0[k] - old.q0[k]);
                reference = std::max(reference, moved / (robot::velocity(i) * allowed));
            }
        }
        places_.push_back(place);
        if (places_.size() > 40) {
            places_.pop_front();
        }
    }

    World &world_;
    WipingClient &client_;
    Records &records_;
    Question &question_;
    std::deque<Place> places_; /* of the reference, in one motion */
    double slack_ = 1e300;     /* least of progress minus time so far */
};

/* Print the result of a session as a line of JSON. */
void print(const Ending &ending, const World &world, const Watcher &seen, const WipingClient &client)
{
    const double last = seconds();
    const long recent = std::count_if(world.deliveries.begin(), world.deliveries.end(),
                                      [last](double time) { return time > last - 0.5; });
    const double count = std::max(world.counted, 1);
    std::printf("{\"code\": %d, \"sentence\": \"%s\", \"over_limit\": %.17g, \"step\": %.17g, \"rate\": %.17g, "
                "\"lead\": %.17g, \"reference\": %.17g, \"elastic\": %.17g, \"error\": %.17g, \"kinetic\": %.17g, "
                "\"fast\": %.17g, \"work\": %.17g, \"axis_delta\": %.17g, \"unanswered\": %u, \"not_finite\": %u, "
                "\"sent\": %u, \"last_torque\": %.17g, \"recent\": %ld, \"time\": %.17g, ",
                static_cast<int>(ending.code), ending.sentence.c_str(), world.over_limit, world.step, world.rate,
                seen.lead, seen.reference, seen.elastic, seen.error, world.kinetic, world.fast, world.arm.work,
                world.axis_delta, world.unanswered, world.not_finite, world.sent, world.last_torque, recent, last);
    std::printf("\"release\": %.17g, \"let_go\": %s, \"done\": %s, \"idle\": %s, \"interrupted\": %s, \"interrupts\": %d, "
                "\"declined\": %s, \"moved\": %s, \"refused\": %s, \"state\": %d, \"progress\": %.17g, \"parted\": %.17g, "
                "\"let_go_time\": %.17g, \"beyond\": %.17g, \"apart\": %.17g, \"held\": %.17g, \"rest\": %.17g, "
                "\"force\": %.17g, \"pressed\": %.17g, \"hardest\": %.17g, \"mean\": %.17g, \"rms\": %.17g, "
                "\"commanded\": %.17g, \"most_commanded\": %.17g}\n",
                seen.zero_time >= 0.0 ? seen.zero_time - seen.let_go_time : -1.0, boolean(seen.let_go),
                boolean(client.trajectory_done()), boolean(world.idle_seen), boolean(world.interrupted),
                static_cast<int>(interrupts), boolean(client.question().state() == Question::NO), boolean(world.moved),
                boolean(client.refusal() != REFUSAL_NONE), world.last_state, client.progress(), world.parted,
                seen.let_go_time, world.beyond, seen.let_go ? seen.apart : world.apart,
                world.parted_joint >= 0 ? world.held[static_cast<std::size_t>(world.parted_joint)] : 0.0,
                seen.rest, seen.force, world.pressed, world.hardest, world.mean / count,
                std::sqrt(std::max(world.square / count - std::pow(world.mean / count, 2), 0.0)), seen.commanded,
                seen.most_commanded);
    std::fflush(stdout);
}

/* Run a session of one schedule with the client, and print how it went. */
void session(const Schedule &schedule, const std::string &file, int period)
{
    now_ns = 0;
    interrupts = 0;
    Options options;
    options.timeout = 1000;
    options.wait = 3.0;
    options.settings.approach_time = 0.3;
    options.settings.delay_samples = 1; /* a torque acts from the next message on */
    options.settings.pace.patience = 1.0;
    const double quantum = schedule.value("quantum", 0.0, 0.0);
    options.settings.position_quantum = quantum > 1e-6 ? quantum : 0.0; /* as docs/fri.md asks for */
    const double settle = quantum > 1e-6 ? 0.0 : schedule.first("settle", 0.0); /* as the options ask for */
    options.settings.settle_force[0] = settle;
    options.settings.settle_force[1] = 0.1 * settle;
    const bool refused = quantum > 1e-6 || settle > 0.0 || !robot::has_sensor();
    const double press = refused ? 0.0 : schedule.first("press", 0.0);
    options.settings.press_force = press; /* as the options ask for, too */
    options.sensor = press > 0.0;
    options.settings.may_ask = schedule.events.count("answer") > 0;
    const Trajectory trajectory(file, options.trajectory_period);
    Vector start;
    trajectory.at(0.0, start.data());
    start[0] += 0.02;
    World world(schedule, start, period);
    std::unique_ptr<Records> records(new Records);
    Question question;
    std::unique_ptr<Connection> connection(new Connection(world, 1e-3 * options.timeout));
    WrenchSensor *const sensor = options.sensor ? &world.sensor : NULL;
    std::unique_ptr<WipingClient> client(
        new WipingClient(options.settings, trajectory, sensor, *connection, *records, question));
    KUKA::FRI::ClientApplication application(*connection, *client);
    for (int i = 0; i < JOINTS; ++i) {
        world.effort[i] = client->config().effort_limit[i];
        world.torque_rate[i] = client->config().torque_rate_limit[i];
    }
    Watcher watcher(world, *client, *records, question);
    trajectory.at(trajectory.duration(), watcher.end);
    world.watch = [&watcher] { watcher.look(); };
    application.connect(30200);
    Ending ending = {FAULT, "the client does not end"};
    try {
        ending = run_session(options, *client, *connection, application, interrupts);
    } catch (const std::runtime_error &error) {
        ending.sentence = error.what();
    }
    watcher.finish();
    print(ending, world, watcher, *client);
}

} // namespace

/* Run the schedules of standard input, one per line. */
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

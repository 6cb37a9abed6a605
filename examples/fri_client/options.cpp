// SPDX-License-Identifier: MIT
#include "options.h"

#include <getopt.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>

namespace {

const char HELP[] =
    "fri_wiping --trajectory FILE.csv [options]\n"
    "\n"
    "Follows a zero-force joint trajectory with a KUKA LBR in torque mode through the FRI.\n"
    "\n"
    "  --trajectory FILE        one row a joint or one column a joint [rad], comma-separated\n"
    "  --trajectory-period S    between its samples [s] (0.005)\n"
    "  --port N                 UDP port to listen on (30200)\n"
    "  --host ADDRESS           take datagrams from this IPv4 address alone, same port (anyone)\n"
    "  --timeout MS             silence of the robot that ends the session [ms] (1000)\n"
    "  --wait S                 for the robot's first usable message [s] (60)\n"
    "  --log FILE               controller steps, CSV\n"
    "  --summary FILE           closing figures, JSON\n"
    "  --sample-time S          refuse a robot with another send period [s] (take the robot's)\n"
    "  --stiffness SIX          task stiffness, diagonal [N/m, N m/rad] (700,700,800,30,30,30)\n"
    "  --law NAME               potential; or, for comparison, paper, or conventional (without the correction)\n"
    "  --damping-ratio X        of every mode (0.7)\n"
    "  --joint-damping X        added to every joint [N m s/rad] (0.1)\n"
    "  --posture-stiffness X    of every joint towards the reference [N m/rad] (10)\n"
    "  --motor-inertia X        of every joint's rotor, seen at the joint [kg m^2] (0.1)\n"
    "  --effort-share X         of the robot's effort limits, 0 to 1 (0.25; all of them: 1)\n"
    "  --torque-rise S          least time from zero to that limit [s] (0.25; the least: 0.1)\n"
    "  --speed-share X          of the robot's velocity limits: faster, and the client lets go (0.9)\n"
    "  --error-limit M          of the tip from where the trajectory wants it: there it stands still (0.2; 0: none)\n"
    "  --lag-limit RAD          of the governor's posture from the wanted one: likewise (0.3; 0: none)\n"
    "  --energy-limit J         stored in the spring: likewise, and the governor's limit (6; 0: none, the governor's 5)\n"
    "  --force-limit N          of contact: likewise (150; 0: none)\n"
    "  --hold-time S            that it may stand still, then the client lets go (3)\n"
    "  --approach S             least time of the move to the trajectory [s] (5)\n"
    "  --approach-limit RAD     longest way of a joint to the trajectory that is not asked about (0.8)\n"
    "  --approach-anyway        do not ask\n"
    "  --velocity-filter S      time constant [s] (0.004)\n"
    "  --wrench SOURCE          external-torque, or sensor (external-torque)\n"
    "  --external-torque-sign X 1: external torque = J^T (wrench of the environment on the robot); -1 (1)\n"
    "  --wrench-damping X       of the inverse that makes the wrench (0.01)\n"
    "  --sensor-port N          UDP port of the sensor (30300)\n"
    "  --dry-run                send zero torque; everything else as ever\n"
    "  --simulated-time         the robot's time is not this machine's (an emulator in lockstep)\n"
    "  --realtime PRIORITY      SCHED_FIFO, 1 to 99, and locked memory\n"
    "\n"
    "Ctrl-C brings the torque to zero within 0.3 s and leaves; a second one leaves at once. So do Ctrl-Z, SIGTERM, and a\n"
    "terminal that is closed.\n"
    "Exit code: 0 the trajectory was followed to its end, 1 fault in the session, 2 refused at the start, 3 the robot\n"
    "ended the session before that, 4 interrupted.\n";

enum Name {
    TRAJECTORY = 256,
    TRAJECTORY_PERIOD,
    PORT,
    HOST,
    TIMEOUT,
    WAIT,
    LOG,
    SUMMARY,
    SAMPLE_TIME,
    STIFFNESS,
    LAW,
    DAMPING_RATIO,
    JOINT_DAMPING,
    POSTURE_STIFFNESS,
    MOTOR_INERTIA,
    EFFORT_SHARE,
    TORQUE_RISE,
    SPEED_SHARE,
    ERROR_LIMIT,
    LAG_LIMIT,
    ENERGY_LIMIT,
    FORCE_LIMIT,
    HOLD_TIME,
    APPROACH,
    APPROACH_LIMIT,
    APPROACH_ANYWAY,
    VELOCITY_FILTER,
    WRENCH,
    EXTERNAL_TORQUE_SIGN,
    WRENCH_DAMPING,
    SENSOR_PORT,
    DRY_RUN,
    SIMULATED_TIME,
    REALTIME,
    HELP_WANTED
};

const struct option LONG[] = {{"trajectory", required_argument, NULL, TRAJECTORY},
                              {"trajectory-period", required_argument, NULL, TRAJECTORY_PERIOD},
                              {"port", required_argument, NULL, PORT},
                              {"host", required_argument, NULL, HOST},
                              {"timeout", required_argument, NULL, TIMEOUT},
                              {"wait", required_argument, NULL, WAIT},
                              {"log", required_argument, NULL, LOG},
                              {"summary", required_argument, NULL, SUMMARY},
                              {"sample-time", required_argument, NULL, SAMPLE_TIME},
                              {"stiffness", required_argument, NULL, STIFFNESS},
                              {"law", required_argument, NULL, LAW},
                              {"damping-ratio", required_argument, NULL, DAMPING_RATIO},
                              {"joint-damping", required_argument, NULL, JOINT_DAMPING},
                              {"posture-stiffness", required_argument, NULL, POSTURE_STIFFNESS},
                              {"motor-inertia", required_argument, NULL, MOTOR_INERTIA},
                              {"effort-share", required_argument, NULL, EFFORT_SHARE},
                              {"torque-rise", required_argument, NULL, TORQUE_RISE},
                              {"speed-share", required_argument, NULL, SPEED_SHARE},
                              {"error-limit", required_argument, NULL, ERROR_LIMIT},
                              {"lag-limit", required_argument, NULL, LAG_LIMIT},
                              {"energy-limit", required_argument, NULL, ENERGY_LIMIT},
                              {"force-limit", required_argument, NULL, FORCE_LIMIT},
                              {"hold-time", required_argument, NULL, HOLD_TIME},
                              {"approach", required_argument, NULL, APPROACH},
                              {"approach-limit", required_argument, NULL, APPROACH_LIMIT},
                              {"approach-anyway", no_argument, NULL, APPROACH_ANYWAY},
                              {"velocity-filter", required_argument, NULL, VELOCITY_FILTER},
                              {"wrench", required_argument, NULL, WRENCH},
                              {"external-torque-sign", required_argument, NULL, EXTERNAL_TORQUE_SIGN},
                              {"wrench-damping", required_argument, NULL, WRENCH_DAMPING},
                              {"sensor-port", required_argument, NULL, SENSOR_PORT},
                              {"dry-run", no_argument, NULL, DRY_RUN},
                              {"simulated-time", no_argument, NULL, SIMULATED_TIME},
                              {"realtime", required_argument, NULL, REALTIME},
                              {"help", no_argument, NULL, HELP_WANTED},
                              {NULL, 0, NULL, 0}};

std::string plain(double value)
{
    char text[40];
    std::snprintf(text, sizeof text, "%g", value);
    return text;
}

[[noreturn]] void refuse(int name, const std::string &given, const std::string &wanted)
{
    throw std::runtime_error(std::string("--") + LONG[name - TRAJECTORY].name + " " + given + ": it takes " + wanted);
}

double number(int name, const std::string &text, double least, double most)
{
    char *end = NULL;
    const double value = std::strtod(text.c_str(), &end);
    if (text.empty() || *end != '\0' || !(value >= least && value <= most)) {
        refuse(name, text, "a number from " + plain(least) + " to " + plain(most));
    }
    return value;
}

int integer(int name, const std::string &text, int least, int most)
{
    const double value = number(name, text, least, most);
    if (value != std::floor(value)) {
        refuse(name, text, "a whole number");
    }
    return static_cast<int>(value);
}

/* Six numbers, with commas between them in one argument, or as the next six arguments. */
void six(int argc, char **argv, double *values)
{
    std::string text = optarg;
    if (text.find(',') == std::string::npos) {
        for (int i = 0; i < 5 && optind < argc && argv[optind][0] != '-'; ++i) {
            text += std::string(",") + argv[optind++];
        }
    }
    const std::string given = text;
    for (int i = 0; i < 6; ++i) {
        const size_t comma = text.find(',');
        if ((comma == std::string::npos) != (i == 5)) {
            refuse(STIFFNESS, given, "six numbers");
        }
        values[i] = number(STIFFNESS, text.substr(0, comma), 0.0, i < 3 ? 5e3 : 500.0);
        text = i < 5 ? text.substr(comma + 1) : "";
    }
}

/* getopt_long takes any beginning of a name: a misspelt option must not set another one. */
void refuse_unknown(int argc, char **argv)
{
    for (int i = 1; i < argc; ++i) {
        const std::string given = argv[i], name = given.substr(0, given.find('='));
        bool known = name.compare(0, 2, "--") != 0;
        for (const option *each = LONG; !known && each->name != NULL; ++each) {
            known = name == std::string("--") + each->name;
        }
        if (!known) {
            throw std::runtime_error(name + ": no such option; see fri_wiping --help");
        }
    }
}

} // namespace

Options::Options()
    : trajectory_period(0.005), port(30200), sensor_port(30300), timeout(1000), wait(60.0), realtime(0), sensor(false)
{
}

bool Options::parse(int argc, char **argv)
{
    refuse_unknown(argc, argv);
    opterr = 0;
    for (int name; (name = getopt_long(argc, argv, ":", LONG, NULL)) != -1;) {
        const std::string text = optarg != NULL ? optarg : "";
        switch (name) {
        case TRAJECTORY: trajectory = text; break;
        case TRAJECTORY_PERIOD: trajectory_period = number(name, text, 1e-4, 10.0); break;
        case PORT: port = integer(name, text, 1, 65535); break;
        case HOST: host = text; break;
        case TIMEOUT: timeout = static_cast<unsigned int>(integer(name, text, 1, 3600000)); break;
        case WAIT: wait = number(name, text, 0.0, 1e6); break;
        case LOG: log = text; break;
        case SUMMARY: summary = text; break;
        case SAMPLE_TIME: settings.sample_time = number(name, text, 0.001, 0.010); break;
        case STIFFNESS: six(argc, argv, settings.task_stiffness); break;
        case LAW:
            if (text != "potential" && text != "paper" && text != "conventional") {
                refuse(name, text, "potential, paper or conventional");
            }
            settings.paper = text != "potential";
            settings.conventional = text == "conventional";
            break;
        case DAMPING_RATIO: settings.damping_ratio = number(name, text, 0.0, 100.0); break;
        case JOINT_DAMPING: settings.joint_damping = number(name, text, 0.0, 1000.0); break;
        case POSTURE_STIFFNESS: settings.posture_stiffness = number(name, text, 0.0, 1e4); break;
        case MOTOR_INERTIA: settings.motor_inertia = number(name, text, 0.0, 100.0); break;
        case EFFORT_SHARE: settings.effort_share = number(name, text, 0.001, 1.0); break;
        case TORQUE_RISE: settings.torque_rise = number(name, text, 0.1, 0.25); break;
        case SPEED_SHARE: settings.speed_share = number(name, text, 0.01, 1.0); break;
        case ERROR_LIMIT: settings.pace.error = number(name, text, 0.0, 10.0); break;
        case LAG_LIMIT: settings.pace.lag = number(name, text, 0.0, 10.0); break;
        case ENERGY_LIMIT: settings.pace.energy = number(name, text, 0.0, 1e3); break;
        case FORCE_LIMIT: settings.pace.force = number(name, text, 0.0, 1e3); break;
        case HOLD_TIME: settings.pace.patience = number(name, text, 0.1, 1e3); break;
        case APPROACH: settings.approach_time = number(name, text, 0.1, 1000.0); break;
        case APPROACH_LIMIT: settings.approach_limit = number(name, text, 0.0, 10.0); break;
        case APPROACH_ANYWAY: settings.approach_anyway = true; break;
        case VELOCITY_FILTER: settings.velocity_filter = number(name, text, 0.0, 1.0); break;
        case WRENCH:
            if (text != "sensor" && text != "external-torque") {
                refuse(name, text, "external-torque or sensor");
            }
            sensor = text == "sensor";
            break;
        case EXTERNAL_TORQUE_SIGN:
            settings.external_torque_sign = number(name, text, -1.0, 1.0);
            if (std::fabs(settings.external_torque_sign) != 1.0) {
                refuse(name, text, "1 or -1");
            }
            break;
        case WRENCH_DAMPING: settings.wrench_damping = number(name, text, 0.0, 10.0); break;
        case SENSOR_PORT: sensor_port = integer(name, text, 1, 65535); break;
        case DRY_RUN: settings.dry_run = true; break;
        case SIMULATED_TIME: settings.simulated_time = true; break;
        case REALTIME: realtime = integer(name, text, 1, 99); break;
        case HELP_WANTED: std::fputs(HELP, stdout); return false;
        case ':':
            throw std::runtime_error(std::string(argv[optind - 1]) + ": its value is missing; see fri_wiping --help");
        default: throw std::runtime_error(std::string(argv[optind - 1]) + ": no such option; see fri_wiping --help");
        }
    }
    if (optind < argc) {
        throw std::runtime_error(std::string(argv[optind]) + ": not an option; see fri_wiping --help");
    }
    if (trajectory.empty()) {
        throw std::runtime_error("no trajectory; name a file with --trajectory");
    }
    return true;
}

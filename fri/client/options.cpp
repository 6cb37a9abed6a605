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
    "  --trajectory FILE        joint positions, one row or column per joint, comma-separated [rad]\n"
    "  --trajectory-period S    time between samples of the trajectory [s] (0.005)\n"
    "  --port N                 UDP port to listen on (30200)\n"
    "  --host ADDRESS           robot to listen to, IPv4, sending from the same port (anyone)\n"
    "  --timeout MS             silence of the robot that ends the session [ms] (1000)\n"
    "  --wait S                 longest wait for the robot's first usable message [s] (60)\n"
    "  --log FILE               new file for controller steps, CSV\n"
    "  --summary FILE           file for closing figures, JSON\n"
    "  --sample-time S          required send period of the robot [s] (any)\n"
    "  --stiffness SIX          diagonal of the task stiffness [N/m, N m/rad] (700,700,800,30,30,30)\n"
    "  --law NAME               potential; for comparison: paper, conventional (potential)\n"
    "  --damping-ratio X        damping ratio of every mode [1] (0.7)\n"
    "  --joint-damping X        additional damping of every joint [N m s/rad] (0.1)\n"
    "  --posture-stiffness X    stiffness of every joint towards the reference [N m/rad] (10)\n"
    "  --motor-inertia X        inertia of every rotor, seen at the joint [kg m^2] (0.1)\n"
    "  --effort-share X         share of the robot's effort limits [1] (0.25)\n"
    "  --torque-rise S          least time from zero to that limit, 0.1 to 0.25 [s] (0.25)\n"
    "  --speed-share X          share of the velocity limits at which to let go [1] (0.9)\n"
    "  --error-limit M          tip's distance at which the trajectory stands still, 0: none [m] (0.2)\n"
    "  --lag-limit RAD          governor's lag at which it stands still, 0: none [rad] (0.3)\n"
    "  --energy-limit J         springs' energy, also the governor's limit, 0: none [J] (6)\n"
    "  --force-limit N          contact force at which it stands still, 0: none [N] (150)\n"
    "  --hold-time S            standstill after which to let go [s] (3)\n"
    "  --approach S             least duration of the move to the trajectory [s] (5)\n"
    "  --approach-limit RAD     longest way to the trajectory without a question [rad] (0.8)\n"
    "  --approach-anyway        move any way without a question\n"
    "  --velocity-filter S      time constant of the velocity filter [s] (0.004)\n"
    "  --wrench SOURCE          external-torque, or sensor (external-torque)\n"
    "  --external-torque-sign X 1: external torque = J^T (wrench of the environment on the robot); -1 (1)\n"
    "  --wrench-damping X       damping of the wrench's least squares (0.01)\n"
    "  --sensor-port N          UDP port of the sensor (30300)\n"
    "  --calibration FILE       bias and payload of the sensor, by 'stiffgen calibrate'\n"
    "  --dry-run                send zero torque; do everything else\n"
    "  --simulated-time         take the robot's time for this machine's (emulator in lockstep)\n"
    "  --realtime PRIORITY      lock the memory, run with SCHED_FIFO, 1 to 99\n"
    "\n"
    "Ctrl-C brings the torque to zero within 0.3 s and leaves; a second one leaves at once. Ctrl-Z, a closed terminal\n"
    "and every other signal that would stop or end the program do what the first one does.\n"
    "Exit code: 0 the trajectory was followed to its end, 1 fault in the session or incomplete log, 2 refused at the\n"
    "start, 3 the robot ended the session early, 4 interrupted.\n";

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
    CALIBRATION,
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
                              {"calibration", required_argument, NULL, CALIBRATION},
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

/* Set a number of the controller, the approach or the pace; false if the option is none of them. */
bool set_number(Settings &settings, int name, const std::string &text)
{
    switch (name) {
    case SAMPLE_TIME: settings.sample_time = number(name, text, 0.001, 0.010); break;
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
    case VELOCITY_FILTER: settings.velocity_filter = number(name, text, 0.0, 1.0); break;
    case WRENCH_DAMPING: settings.wrench_damping = number(name, text, 0.0, 10.0); break;
    default: return false;
    }
    return true;
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
        case STIFFNESS: six(argc, argv, settings.task_stiffness); break;
        case LAW:
            if (text != "potential" && text != "paper" && text != "conventional") {
                refuse(name, text, "potential, paper or conventional");
            }
            settings.paper = text != "potential";
            settings.conventional = text == "conventional";
            break;
        case APPROACH_ANYWAY: settings.approach_anyway = true; break;
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
        case SENSOR_PORT: sensor_port = integer(name, text, 1, 65535); break;
        case CALIBRATION: calibration = text; break;
        case DRY_RUN: settings.dry_run = true; break;
        case SIMULATED_TIME: settings.simulated_time = true; break;
        case REALTIME: realtime = integer(name, text, 1, 99); break;
        case HELP_WANTED: std::fputs(HELP, stdout); return false;
        case ':':
            throw std::runtime_error(std::string(argv[optind - 1]) + ": its value is missing; see fri_wiping --help");
        default:
            if (!set_number(settings, name, text)) {
                throw std::runtime_error(std::string(argv[optind - 1]) + ": no such option; see fri_wiping --help");
            }
        }
    }
    if (optind < argc) {
        throw std::runtime_error(std::string(argv[optind]) + ": not an option; see fri_wiping --help");
    }
    if (trajectory.empty()) {
        throw std::runtime_error("no trajectory; name a file with --trajectory");
    }
    read_calibration();
    return true;
}

/* Without a calibration a sensor's bias and the tool's weight would stand for a contact. */
void Options::read_calibration()
{
    if (sensor && !robot::has_sensor()) {
        throw std::runtime_error(std::string("--wrench sensor: ") + robot::name() +
                                 " has no force-torque sensor; generate it with --sensor LINK");
    }
    if (sensor && calibration.empty() && !settings.dry_run) {
        throw std::runtime_error("--wrench sensor: it takes --calibration FILE; with --dry-run it records without one");
    }
    if (!sensor && !calibration.empty()) {
        throw std::runtime_error("--calibration " + calibration + ": it belongs to --wrench sensor");
    }
    if (!calibration.empty()) {
        settings.calibration = Calibration(calibration);
    }
}

// SPDX-License-Identifier: MIT
#include "options.h"

#include "robot.h"

#include <getopt.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <vector>

namespace {

const char HEAD[] = "fri_wiping --trajectory FILE.csv [options]\n"
                    "\n"
                    "Follows a zero-force joint trajectory with a KUKA LBR in torque mode through the FRI.\n"
                    "\n";

const char TAIL[] =
    "\n"
    "Ctrl-C brings the torque to zero within 0.3 s and leaves; a second one leaves at once. Ctrl-Z, a closed terminal\n"
    "and every other signal that would stop or end the program do what the first one does.\n"
    "Exit code: 0 the trajectory was followed to its end, 1 fault in the session or incomplete log, 2 refused at the\n"
    "start, 3 the robot ended the session early, 4 interrupted.\n";

/* Shortest form of a number. */
std::string plain(double value)
{
    char text[40];
    std::snprintf(text, sizeof text, "%g", value);
    return text;
}

/* Value that was given for an option. */
struct Given {
    const char *name;
    std::string text;

    [[noreturn]] void refuse(const std::string &wanted) const
    {
        throw std::runtime_error(std::string("--") + name + " " + text + ": it takes " + wanted);
    }

    /* Return the number, from least to most. */
    double number(double least, double most) const
    {
        char *end = NULL;
        const double value = std::strtod(text.c_str(), &end);
        if (text.empty() || *end != '\0' || !(value >= least && value <= most)) {
            refuse("a number from " + plain(least) + " to " + plain(most));
        }
        return value;
    }

    int integer(int least, int most) const
    {
        const double value = number(least, most);
        if (value != std::floor(value)) {
            refuse("a whole number");
        }
        return static_cast<int>(value);
    }

    /* Return the parts between commas; there must be so many. */
    std::vector<Given> parts(std::size_t count, const char *wanted) const
    {
        std::vector<Given> found;
        for (std::size_t from = 0, comma = 0; comma != std::string::npos; from = comma + 1) {
            comma = text.find(',', from);
            found.push_back(Given{name, text.substr(from, comma - from)});
        }
        if (found.size() != count) {
            refuse(wanted);
        }
        return found;
    }
};

void take_stiffness(Options &options, const Given &given)
{
    const std::vector<Given> parts = given.parts(6, "six numbers");
    for (std::size_t i = 0; i < 6; ++i) {
        options.settings.task_stiffness[i] = parts[i].number(0.0, i < 3 ? 5e3 : 500.0);
    }
}

void take_friction(Options &options, const Given &given)
{
    const std::vector<Given> parts = given.parts(7, "seven numbers");
    for (std::size_t i = 0; i < 7; ++i) {
        options.settings.friction[i] = parts[i].number(0.0, 1e3);
    }
}

void take_settle(Options &options, const Given &given)
{
    const std::vector<Given> parts = given.parts(2, "two numbers");
    for (std::size_t i = 0; i < 2; ++i) {
        options.settings.settle_force[i] = parts[i].number(0.0, i == 0 ? 100.0 : 20.0);
    }
}

/* Take --law: potential (exact springs), paper, or paper with the conventional formula. */
void take_law(Options &options, const Given &given)
{
    if (given.text != "potential" && given.text != "paper" && given.text != "conventional") {
        given.refuse("potential, paper or conventional");
    }
    options.settings.paper = given.text != "potential";
    options.settings.conventional = given.text == "conventional";
}

void take_wrench(Options &options, const Given &given)
{
    if (given.text != "sensor" && given.text != "external-torque") {
        given.refuse("external-torque or sensor");
    }
    options.sensor = given.text == "sensor";
}

void take_sign(Options &options, const Given &given)
{
    options.settings.external_torque_sign = given.number(-1.0, 1.0);
    if (std::fabs(options.settings.external_torque_sign) != 1.0) {
        given.refuse("1 or -1");
    }
}

/* An option: its name; its value in the help, NULL for a flag; its help; and where a value goes. */
struct Row {
    const char *name, *value, *help;
    void (*take)(Options &options, const Given &given);
};

const Row ROWS[] = {
    {"trajectory", "FILE", "joint positions, one row or column per joint, comma-separated [rad]",
     [](Options &o, const Given &g) { o.trajectory = g.text; }},
    {"trajectory-period", "S", "time between samples of the trajectory [s] (0.005)",
     [](Options &o, const Given &g) { o.trajectory_period = g.number(1e-4, 10.0); }},
    {"port", "N", "UDP port to listen on (30200)", [](Options &o, const Given &g) { o.port = g.integer(1, 65535); }},
    {"host", "ADDRESS", "robot to listen to, IPv4, sending from the same port (anyone)",
     [](Options &o, const Given &g) { o.host = g.text; }},
    {"timeout", "MS", "silence of the robot that ends the session [ms] (1000)",
     [](Options &o, const Given &g) { o.timeout = static_cast<unsigned>(g.integer(1, 3600000)); }},
    {"wait", "S", "longest wait for the robot's first usable message [s] (60)",
     [](Options &o, const Given &g) { o.wait = g.number(0.0, 1e6); }},
    {"log", "FILE", "new file for controller steps, CSV", [](Options &o, const Given &g) { o.log = g.text; }},
    {"summary", "FILE", "file for closing figures, JSON", [](Options &o, const Given &g) { o.summary = g.text; }},
    {"sample-time", "S", "required send period of the robot [s] (any)",
     [](Options &o, const Given &g) { o.settings.sample_time = g.number(0.001, 0.010); }},
    {"stiffness", "SIX", "diagonal of the task stiffness [N/m, N m/rad] (700,700,800,30,30,30)", take_stiffness},
    {"law", "NAME", "potential; for comparison: paper, conventional (potential)", take_law},
    {"damping-ratio", "X", "damping ratio of every mode [1] (0.7)",
     [](Options &o, const Given &g) { o.settings.damping_ratio = g.number(0.0, 2.0); }},
    {"posture-stiffness", "X", "stiffness of every joint towards the reference [N m/rad] (10)",
     [](Options &o, const Given &g) { o.settings.posture_stiffness = g.number(0.0, 1e4); }},
    {"motor-inertia", "X", "inertia of every rotor, seen at the joint [kg m^2] (0.1)",
     [](Options &o, const Given &g) { o.settings.motor_inertia = g.number(0.0, 100.0); }},
    {"friction", "SEVEN", "coulomb_friction fed forward, as 'stiffgen measure --friction' prints it [N m] (0)",
     take_friction},
    {"settle", "TWO", "no error at rest: most force and moment that the springs may add [N, N m] (0,0)",
     take_settle},
    {"press", "N", "force to hold along the tool's z axis, with --wrench sensor [N] (0)",
     [](Options &o, const Given &g) { o.settings.press_force = g.number(0.0, 100.0); }},
    {"effort-share", "X", "share of the robot's effort limits [1] (0.25)",
     [](Options &o, const Given &g) { o.settings.effort_share = g.number(0.001, 1.0); }},
    {"torque-rise", "S", "least time from zero to that limit, 0.1 to 0.25 [s] (0.25)",
     [](Options &o, const Given &g) { o.settings.torque_rise = g.number(0.1, 0.25); }},
    {"speed-share", "X", "share of the velocity limits at which to let go [1] (0.9)",
     [](Options &o, const Given &g) { o.settings.speed_share = g.number(0.01, 1.0); }},
    {"error-limit", "M", "tip's distance at which the trajectory stands still, 0: none [m] (0.2)",
     [](Options &o, const Given &g) { o.settings.pace.error = g.number(0.0, 10.0); }},
    {"lag-limit", "RAD", "reference's lag at which it stands still, 0: none [rad] (0.3)",
     [](Options &o, const Given &g) { o.settings.pace.lag = g.number(0.0, 10.0); }},
    {"energy-limit", "J", "springs' energy, also the reference's limit, 0: none [J] (6)",
     [](Options &o, const Given &g) { o.settings.pace.energy = g.number(0.0, 1e3); }},
    {"force-limit", "N", "contact force at which it stands still, 0: none [N] (150)",
     [](Options &o, const Given &g) { o.settings.pace.force = g.number(0.0, 1e3); }},
    {"hold-time", "S", "standstill after which to let go [s] (3)",
     [](Options &o, const Given &g) { o.settings.pace.patience = g.number(0.1, 1e3); }},
    {"approach", "S", "least duration of the move to the trajectory [s] (5)",
     [](Options &o, const Given &g) { o.settings.approach_time = g.number(0.1, 1000.0); }},
    {"approach-limit", "RAD", "longest way to the trajectory without a question [rad] (0.8)",
     [](Options &o, const Given &g) { o.settings.approach_limit = g.number(0.0, 10.0); }},
    {"approach-anyway", NULL, "move any way without a question",
     [](Options &o, const Given &) { o.settings.approach_anyway = true; }},
    {"velocity-span", "S", "time over which positions are differenced [s] (0.008)",
     [](Options &o, const Given &g) { o.settings.velocity_span = g.number(0.0, 0.05); }},
    {"delay-samples", "N", "periods from a message until its torque acts (0)",
     [](Options &o, const Given &g) { o.settings.delay_samples = g.integer(0, 5); }},
    {"position-quantum", "RAD", "resolution of the measured positions if it is above 1e-6 [rad] (0)",
     [](Options &o, const Given &g) { o.settings.position_quantum = g.number(0.0, 0.01); }},
    {"wrench", "SOURCE", "external-torque, or sensor (external-torque)", take_wrench},
    {"external-torque-sign", "X", "1: external torque = J^T (wrench of the environment on the robot); -1 (1)",
     take_sign},
    {"wrench-damping", "X", "damping of the wrench's least squares (0.01)",
     [](Options &o, const Given &g) { o.settings.wrench_damping = g.number(0.0, 10.0); }},
    {"sensor-port", "N", "UDP port of the sensor (30300)",
     [](Options &o, const Given &g) { o.sensor_port = g.integer(1, 65535); }},
    {"calibration", "FILE", "bias and payload of the sensor, by 'stiffgen calibrate'",
     [](Options &o, const Given &g) { o.calibration = g.text; }},
    {"dry-run", NULL, "send zero torque; do everything else",
     [](Options &o, const Given &) { o.settings.dry_run = true; }},
    {"simulated-time", NULL, "take the robot's time for this machine's (emulator in lockstep)",
     [](Options &o, const Given &) { o.settings.simulated_time = true; }},
    {"realtime", "PRIORITY", "lock the memory, run with SCHED_FIFO, 1 to 99",
     [](Options &o, const Given &g) { o.realtime = g.integer(1, 99); }},
};

/* Options of older versions, and what to give now. */
const char *const GONE[][2] = {
    {"--joint-damping", "the controller damps by --damping-ratio, 0 to 2, alone"},
    {"--velocity-filter", "give --velocity-span S, twice the old time constant"},
};

enum { COUNT = sizeof ROWS / sizeof *ROWS, FIRST = 256, HELP_WANTED = FIRST + COUNT };

/* Print the options with their help. */
void print_help()
{
    std::fputs(HEAD, stdout);
    for (const Row &row : ROWS) {
        const std::string name = std::string(row.name) + (row.value != NULL ? std::string(" ") + row.value : "");
        std::printf("  --%-22s %s\n", name.c_str(), row.help);
    }
    std::fputs(TAIL, stdout);
}

/* Return the table in the form of getopt_long. */
std::vector<option> long_options()
{
    std::vector<option> found;
    for (const Row &row : ROWS) {
        const int has_value = row.value != NULL ? required_argument : no_argument;
        found.push_back(option{row.name, has_value, NULL, FIRST + static_cast<int>(found.size())});
    }
    found.push_back(option{"help", no_argument, NULL, HELP_WANTED});
    found.push_back(option{NULL, 0, NULL, 0});
    return found;
}

/* Return why a name is refused. */
const char *refusal_of(const std::string &name)
{
    for (const auto &gone : GONE) {
        if (name == gone[0]) {
            return gone[1];
        }
    }
    return "no such option; see fri_wiping --help";
}

/* Refuse names that are not written out: getopt_long takes any beginning, and a misspelt one must not set another. */
void refuse_unknown(int argc, char **argv, const std::vector<option> &known)
{
    for (int i = 1; i < argc; ++i) {
        const std::string given = argv[i], name = given.substr(0, given.find('='));
        bool found = name.compare(0, 2, "--") != 0;
        for (const option *each = known.data(); !found && each->name != NULL; ++each) {
            found = name == std::string("--") + each->name;
        }
        if (!found) {
            throw std::runtime_error(name + ": " + refusal_of(name));
        }
    }
}

/* Return the value of an option; six numbers may also come as six arguments. */
std::string find_value(const Row &row, int argc, char **argv)
{
    std::string text = optarg != NULL ? optarg : "";
    const bool separate = row.take == take_stiffness && text.find(',') == std::string::npos;
    for (int i = 0; separate && i < 5 && optind < argc && argv[optind][0] != '-'; ++i) {
        text += std::string(",") + argv[optind++];
    }
    return text;
}

} // namespace

Options::Options()
    : trajectory_period(0.005), port(30200), sensor_port(30300), timeout(1000), wait(60.0), realtime(0), sensor(false)
{
}

/* Parse the command line; false after --help; throw for what is refused. */
bool Options::parse(int argc, char **argv)
{
    const std::vector<option> known = long_options();
    refuse_unknown(argc, argv, known);
    opterr = 0;
    for (int found; (found = getopt_long(argc, argv, ":", known.data(), NULL)) != -1;) {
        if (found == HELP_WANTED) {
            print_help();
            return false;
        }
        if (found < FIRST) { /* ':' or '?' */
            const char *const wrong = found == ':' ? ": its value is missing" : ": no such option";
            throw std::runtime_error(std::string(argv[optind - 1]) + wrong + "; see fri_wiping --help");
        }
        const Row &row = ROWS[found - FIRST];
        row.take(*this, Given{row.name, find_value(row, argc, argv)});
    }
    if (optind < argc) {
        throw std::runtime_error(std::string(argv[optind]) + ": not an option; see fri_wiping --help");
    }
    if (trajectory.empty()) {
        throw std::runtime_error("no trajectory; name a file with --trajectory");
    }
    check_settle();
    check_press();
    read_calibration();
    return true;
}

/* Settle moves the exact springs' rest, and a frozen position that is coarse would show too late. */
void Options::check_settle() const
{
    if (settings.settle_force[0] <= 0.0 && settings.settle_force[1] <= 0.0) {
        return;
    }
    if (settings.paper) {
        throw std::runtime_error("--settle: it moves the springs of --law potential; leave --law out");
    }
    if (settings.position_quantum > 1e-6) {
        throw std::runtime_error("--settle: it takes positions that are finer than 1e-6 rad, not --position-quantum " +
                                 plain(settings.position_quantum));
    }
}

/* Press needs a force sensor, and the exact springs; Settle would work against it. */
void Options::check_press() const
{
    if (settings.press_force <= 0.0) {
        return;
    }
    const struct {
        bool wrong;
        const char *why;
    } cases[] = {
        {!sensor,
         "it takes --wrench sensor: external torques are no force sensor (friction hides 1.4 to 12.7 N on a UR5)"},
        {settings.paper, "it moves the springs of --law potential; leave --law out"},
        {settings.settle_force[0] > 0.0 || settings.settle_force[1] > 0.0,
         "the force moves the tip to where it presses, and --settle back; give one of them"},
        {settings.dry_run, "in a --dry-run nothing presses; leave one of them out"},
        {settings.position_quantum > 1e-6,
         "it takes positions that are finer than 1e-6 rad; leave --position-quantum out"},
    };
    for (const auto &each : cases) {
        if (each.wrong) {
            throw std::runtime_error(std::string("--press: ") + each.why);
        }
    }
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

// SPDX-License-Identifier: MIT
#include "trajectory.h"

#include "robot.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace {

/* Velocities come from a straight line fitted to this many samples on either side: a file with four decimals is a
 * staircase, and its plain differences would rattle. */
const int FIT = 10;

/* Share of a velocity limit at which a joint still counts as at rest. */
const double REST = 0.05;

/* Largest file that is read. */
const std::streamoff LARGEST = 256 << 20;

/* Share of its velocity limit that a joint has at most in the move to the trajectory. */
const double APPROACH_SHARE = 0.25;

/* Greatest velocity of the move over its mean one: the derivative 30 s^2 (1 - s)^2 of its polynomial at s = 1/2. */
const double PEAK = 15.0 / 8.0;

[[noreturn]] void refuse(const std::string &path, const std::string &what)
{
    throw std::runtime_error("trajectory " + path + ": " + what);
}

std::string text(double value)
{
    std::ostringstream stream;
    stream.precision(6);
    stream << value;
    return stream.str();
}

/* Return the numbers of a line; refuse, with row and column, what is no finite number. */
std::vector<double> numbers(const std::string &path, const std::string &line, size_t row)
{
    std::vector<double> values;
    const char *next = line.c_str();
    for (;;) {
        char *end = NULL;
        const double value = std::strtod(next, &end);
        const char *const tail = end + std::strspn(end, " \t\r");
        if (end == next || (*tail != ',' && *tail != '\0') || !std::isfinite(value)) {
            const std::string word(next, std::min(std::strcspn(next, ","), static_cast<size_t>(20)));
            refuse(path, "row " + std::to_string(row) + ", column " + std::to_string(values.size() + 1) + ": '" + word +
                             "' is not a finite number; it takes comma-separated numbers in rad, without a header");
        }
        values.push_back(value);
        if (*tail == '\0') {
            return values;
        }
        next = tail + 1;
    }
}

/* Return the rows of a CSV file, all of one length; blank lines are left out. */
std::vector<std::vector<double>> read(const std::string &path)
{
    std::ifstream file(path.c_str());
    if (!file) {
        refuse(path, std::string(std::strerror(errno)) + "; name an existing file with --trajectory");
    }
    file.seekg(0, std::ios::end);
    if (file.tellg() < 0 || file.tellg() > LARGEST) {
        refuse(path, "not a file of at most 256 MiB; name a CSV file with --trajectory");
    }
    file.seekg(0);
    std::vector<std::vector<double>> rows;
    std::string line;
    while (std::getline(file, line)) {
        if (line.find_first_not_of(" \t\r") == std::string::npos) {
            continue;
        }
        rows.push_back(numbers(path, line, rows.size() + 1));
        if (rows.back().size() != rows.front().size()) {
            refuse(path, "row " + std::to_string(rows.size()) + " has " + std::to_string(rows.back().size()) +
                             " columns, row 1 has " + std::to_string(rows.front().size()) +
                             "; every row must have the same number");
        }
    }
    return rows;
}

} // namespace

/* Read samples [rad], by rows or by columns, `period` [s] apart; refuse what the arm cannot follow. */
Trajectory::Trajectory(const std::string &path, double period) : period_(period)
{
    const std::vector<std::vector<double>> rows = read(path);
    const size_t columns = rows.empty() ? 0 : rows.front().size();
    const bool row_a_joint = rows.size() == JOINTS && columns != JOINTS;
    if (!row_a_joint && columns != JOINTS) {
        refuse(path, std::to_string(rows.size()) + " rows of " + std::to_string(columns) +
                         " columns; it takes one row a joint (7 rows) or one column a joint (7 columns)");
    }
    const size_t count = row_a_joint ? columns : rows.size();
    if (count < 3) {
        refuse(path, std::to_string(count) + " samples; it takes at least 3");
    }
    samples_.resize(count, Sample());
    for (size_t s = 0; s < count; ++s) {
        for (size_t j = 0; j < JOINTS; ++j) {
            samples_[s].q[j] = row_a_joint ? rows[j][s] : rows[s][j];
        }
    }
    check(path);
    differentiate();
}

/* Refuse positions beyond limits, steps beyond velocity limits, and a start or end that is not at rest. */
void Trajectory::check(const std::string &path) const
{
    for (int j = 0; j < JOINTS; ++j) {
        const std::string joint = std::string("joint ") + robot::joint(j);
        const double limit = robot::velocity(j);
        for (int s = 0; s < count(); ++s) {
            const double q = sample(s).q[j];
            if (q < robot::lower(j) || q > robot::upper(j)) {
                refuse(path, joint + " is at " + text(q) + " rad in sample " + std::to_string(s) +
                                 ", beyond its limits " + text(robot::lower(j)) + " .. " + text(robot::upper(j)));
            }
        }
        for (int s = 0; s + 1 < count(); ++s) {
            const double way = sample(s + 1).q[j] - sample(s).q[j], speed = std::fabs(way) / period_;
            if (speed > limit) {
                refuse(path, joint + " jumps by " + text(way) + " rad from sample " + std::to_string(s) + " to " +
                                 std::to_string(s + 1) + ": " + text(speed) + " rad/s, its limit is " + text(limit) +
                                 " rad/s; check the samples and --trajectory-period");
            }
            const bool first = s == 0, last = s + 2 == count();
            if ((first || last) && speed > REST * limit) {
                refuse(path, joint + (first ? " starts" : " ends") + " at " + text(speed) +
                                 " rad/s; the trajectory must " + (first ? "start" : "end") +
                                 " at rest, since it is approached and held at rest");
            }
        }
    }
}

/*
 * Set dq of each sample to the slope of a line fitted to the `width` samples on either side; 0 at both ends. Of least
 * squares it is the sum of k q_k over that of k^2, for k from -width to width, in rad per period.
 */
void Trajectory::differentiate()
{
    for (int s = 1; s + 1 < count(); ++s) {
        const int width = std::min(std::min(s, count() - 1 - s), FIT);
        for (int j = 0; j < JOINTS; ++j) {
            double sum = 0.0, weight = 0.0;
            for (int k = 1; k <= width; ++k) {
                sum += k * (sample(s + k).q[j] - sample(s - k).q[j]);
                weight += 2.0 * k * k;
            }
            samples_[static_cast<size_t>(s)].dq[j] = sum / (weight * period_);
        }
    }
}

/* Return the position (7) [rad] at a time [s], held at both ends. */
void Trajectory::at(double time, double *q) const
{
    const double place = std::min(std::max(time / period_, 0.0), static_cast<double>(count() - 1));
    const int s = std::min(static_cast<int>(place), count() - 2);
    const double u = place - s;
    for (int j = 0; j < JOINTS; ++j) {
        /* Cubic Hermite polynomial of u in [0, 1]: from p by the way, with the slopes a at 0 and b at 1 [rad]. */
        const double p = sample(s).q[j], way = sample(s + 1).q[j] - p;
        const double a = sample(s).dq[j] * period_, b = sample(s + 1).dq[j] * period_;
        q[j] = p + u * (a + u * (3.0 * way - 2.0 * a - b + u * (a + b - 2.0 * way)));
    }
}

/* Plan the move, at least `least` [s] long, at most at APPROACH_SHARE of each joint's velocity limit. */
void Approach::plan(const double *from, const double *to, double least)
{
    duration_ = least;
    for (int j = 0; j < JOINTS; ++j) {
        from_[j] = from[j];
        to_[j] = to[j];
        duration_ = std::max(duration_, PEAK * std::fabs(to[j] - from[j]) / (APPROACH_SHARE * robot::velocity(j)));
    }
}

/* Return the position (7) [rad] at a time [s], by a polynomial without velocity and acceleration at both ends. */
void Approach::at(double time, double *q) const
{
    const double s = duration_ > 0.0 ? std::min(std::max(time / duration_, 0.0), 1.0) : 1.0;
    const double place = s * s * s * (10.0 + s * (-15.0 + 6.0 * s)); /* share of the way */
    for (int j = 0; j < JOINTS; ++j) {
        q[j] = from_[j] + place * (to_[j] - from_[j]);
    }
}

// SPDX-License-Identifier: MIT
#include "log.h"

#include "robot.h"

#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <stdexcept>

namespace {

const unsigned long long HEADER_LINES = 2; /* the comment and the columns' names */
const char *const BEFORE[] = {"q", "dq", "q0"};
const char *const AFTER[] = {"sent_torque", "sent_position", "measured_torque", "external_torque"};

void names(LogFile &file, const char *name, int count)
{
    for (int i = 0; i < count; ++i) {
        file.append(",%s_%d", name, i);
    }
}

/* Append numbers with 17 digits: the number that is read back is the one that was written. */
void values(LogFile &file, const double *x, int count)
{
    for (int i = 0; i < count; ++i) {
        file.append(",%.17g", x[i]);
    }
}

} // namespace

const char *state_name(int state)
{
    static const char *const states[] = {"IDLE", "MONITORING_WAIT", "MONITORING_READY", "COMMANDING_WAIT",
                                         "COMMANDING_ACTIVE"};
    return state >= 0 && state < 5 ? states[state] : "unknown state";
}

/* Create the file, if there is a path, and write its header: the columns in the order of write(). */
Log::Log(Records &records, const std::string &path, double posture_stiffness, Question &question)
    : records_(records), question_(question), asked_(0), events_(0), stop_(false)
{
    std::fill(told_, told_ + EVENTS, -1e9);
    std::fill(untold_, untold_ + EVENTS, 0);
    if (path.empty()) {
        return;
    }
    file_.create(path);
    file_.append("# robot: %s, posture_stiffness: %g N m/rad", robot::name(), posture_stiffness);
    file_.end_row();
    file_.append("time");
    for (const char *name : BEFORE) {
        names(file_, name, JOINTS);
    }
    names(file_, "wrench", 6);
    names(file_, "wrench_command", 6);
    names(file_, "torque", JOINTS);
    file_.append(",status,mode,counter,sample_valid,start,reset,tank_energy,elastic_energy");
    for (const char *name : AFTER) {
        names(file_, name, JOINTS);
    }
    names(file_, "reading", 6);
    file_.append(",quality,tracking,pace,callback_time,events");
    file_.end_row();
    file_.flush();
    if (file_.error() != 0) {
        throw std::runtime_error("log " + path + ": " + std::strerror(file_.error()) +
                                 "; make room, or name another --log");
    }
}

Log::~Log()
{
    finish();
}

void Log::start()
{
    thread_ = std::thread(&Log::run, this);
}

/* Write what is left, and close the file. */
void Log::finish()
{
    if (thread_.joinable()) {
        stop_ = true;
        thread_.join();
    }
    file_.close();
}

unsigned long long Log::rows() const
{
    return file_.rows() > HEADER_LINES ? file_.rows() - HEADER_LINES : 0;
}

/* Return why rows are missing, "" if none is. */
std::string Log::trouble() const
{
    std::string text;
    if (file_.error() != 0) {
        text = std::string("the log is not complete: ") + std::strerror(file_.error()) + ", " + std::to_string(rows()) +
               " rows written; make room";
    }
    if (records_.refused() > 0) {
        text += (text.empty() ? "the log is not complete: " : "; ") + std::to_string(records_.refused()) +
                " records dropped, since the disk was too slow; use a faster one";
    }
    return text;
}

/* Write records until the session has ended, and ask the question; in a thread of its own. */
void Log::run()
{
    Record record;
    for (;;) {
        const bool last = stop_;
        while (records_.pop(&record)) {
            write(record);
        }
        if (last) {
            return;
        }
        ask();
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
}

/* Print the question once, and read the answer if there is one, without waiting. Text typed before is no answer. */
void Log::ask()
{
    if (question_.state() != Question::ASKED) {
        return;
    }
    if (asked_ != question_.asked()) {
        asked_ = question_.asked();
        ::tcflush(STDIN_FILENO, TCIFLUSH);
        std::printf("%s is %.2f rad from %s. The arm is held. Move there? [y/n] ", robot::joint(question_.joint()),
                    question_.distance(), question_.where());
        std::fflush(stdout);
    }
    struct pollfd terminal = {STDIN_FILENO, POLLIN, 0};
    char line[80];
    if (::poll(&terminal, 1, 0) == 1) {
        const ssize_t count = ::read(STDIN_FILENO, line, sizeof line);
        question_.answer(count > 0 && (line[0] == 'y' || line[0] == 'Y'));
    }
}

/* Print events that are new since the last record, each kind at most once per second. */
void Log::tell(double time, std::uint32_t events)
{
    const double pause = 1.0; /* [s] */
    for (int i = 0; i < EVENTS; ++i) {
        const EventText &text = EVENT_TEXTS[i];
        if ((events & ~events_ & text.bit) == 0) {
            continue;
        }
        if (time - told_[i] < pause && time >= told_[i]) {
            ++untold_[i];
            continue;
        }
        std::printf("%10.3f s  %s: %s; %s", time, text.name, text.what, text.done);
        if (untold_[i] > 0) {
            std::printf(" (and %llu times before)", untold_[i]);
        }
        std::printf("\n");
        std::fflush(stdout);
        told_[i] = time;
        untold_[i] = 0;
    }
    events_ = events;
}

/* Print a change of state, or write a step's row. */
void Log::write(const Record &record)
{
    if (record.kind == Record::STATE) {
        std::printf("%10.3f s  %s -> %s\n", record.time, state_name(record.from), state_name(record.to));
        std::fflush(stdout);
        return;
    }
    tell(record.time, record.events); /* a note has events alone */
    if (!file_.is_open() || record.kind == Record::NOTE || file_.error() != 0) {
        return;
    }
    /* The columns in the order of the header, see Log::Log. */
    file_.append("%.17g", record.time);
    values(file_, record.q, JOINTS);
    values(file_, record.dq, JOINTS);
    values(file_, record.q0, JOINTS);
    values(file_, record.wrench, 6);
    values(file_, record.wrench_command, 6);
    values(file_, record.torque, JOINTS);
    file_.append(",%lu,%d,%lu,%d,%d,%d", static_cast<unsigned long>(record.status), record.mode,
                 static_cast<unsigned long>(record.counter), record.sample_valid, record.start, record.reset);
    values(file_, &record.tank_energy, 1);
    values(file_, &record.elastic_energy, 1);
    values(file_, record.sent_torque, JOINTS);
    values(file_, record.sent_position, JOINTS);
    values(file_, record.measured_torque, JOINTS);
    values(file_, record.external_torque, JOINTS);
    values(file_, record.reading, 6);
    file_.append(",%d", record.quality);
    values(file_, &record.tracking, 1);
    values(file_, &record.pace, 1);
    values(file_, &record.callback_time, 1);
    file_.append(",%lu", static_cast<unsigned long>(record.events));
    file_.end_row();
    if (file_.error() != 0) {
        std::printf("%10.3f s  log: %s; the rows from now on are lost\n", record.time, std::strerror(file_.error()));
        std::fflush(stdout);
    }
}

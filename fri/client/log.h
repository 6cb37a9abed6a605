// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_LOG_H
#define FRI_CLIENT_LOG_H

#include "events.h"
#include "log_file.h"
#include "question.h"
#include "record.h"

#include <atomic>
#include <cstdio>
#include <string>
#include <thread>

/* Return the name of a session state. */
const char *state_name(int state);

/*
 * Writer of the records, in a thread of its own: a line on stdout for a change of state and for an event, a row of the
 * CSV file for a controller step. An event that continues or returns is printed once per second, with a count. The same
 * thread asks the person at the terminal.
 */
class Log {
public:
    /*
     * An empty path: no file. The file begins with a comment that names the robot and the stiffness of its posture
     * springs [N m/rad]. Throws std::runtime_error if the file exists or cannot be made.
     */
    Log(Records &records, const std::string &path, double posture_stiffness, Question &question);
    ~Log();

    void start();

    /* Write the remaining records and end the thread. */
    void finish();

    /* Whether to keep the file: a refused start leaves no file behind. */
    void keep(bool keep) { file_.keep(keep); }

    /* Return why the log is not complete; empty if it is. */
    std::string trouble() const;

    const LogFile &file() const { return file_; }
    unsigned long long rows() const; /* on the disk */

private:
    Log(const Log &);
    Log &operator=(const Log &);
    void run();
    void write(const Record &record);
    void tell(double time, std::uint32_t events);
    void ask();

    enum { EVENTS = sizeof EVENT_TEXTS / sizeof *EVENT_TEXTS };

    Records &records_;
    Question &question_;
    int asked_;                          /* questions asked so far */
    std::uint32_t events_;               /* of the record before */
    double told_[EVENTS];                /* [s] when an event was printed last */
    unsigned long long untold_[EVENTS]; /* events since then */
    LogFile file_;
    std::atomic<bool> stop_;
    std::thread thread_;
};

#endif

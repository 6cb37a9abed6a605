// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_LOG_H
#define FRI_CLIENT_LOG_H

#include "events.h"
#include "question.h"
#include "record.h"

#include <atomic>
#include <cstdio>
#include <string>
#include <thread>

/* Name of a session state. */
const char *state_name(int state);

/*
 * Writes what comes through the ring, in a thread of its own: a line on stdout for a change of state and for an event, a
 * row of the CSV file for a controller step. An event that goes on or comes back is told once a second, with a count.
 * The same thread has the question to the person at the terminal.
 */
class Log {
public:
    /* An empty path: no file. Throws std::runtime_error if the file cannot be made. */
    Log(Records &records, const std::string &path, Question &question);
    ~Log();

    void start();

    /* Writes what is left and ends the thread. False if not everything could be written. */
    bool finish();

    unsigned long long rows() const { return rows_; }

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
    int asked_;                          /* questions */
    std::uint32_t events_;               /* of the record before */
    double told_[EVENTS];                /* [s] when an event was told last */
    unsigned long long untold_[EVENTS]; /* since then */
    std::FILE *file_;
    unsigned long long rows_;
    std::atomic<bool> stop_;
    std::thread thread_;
};

#endif

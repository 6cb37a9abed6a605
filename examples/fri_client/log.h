#ifndef FRI_CLIENT_LOG_H
#define FRI_CLIENT_LOG_H

#include "record.h"

#include <atomic>
#include <cstdio>
#include <string>
#include <thread>

/* Name of a session state. */
const char *state_name(int state);

/* Writes what comes through the ring, in a thread of its own: a line on stdout for a change of state, a row of the CSV
 * file for a controller step. */
class Log {
public:
    /* An empty path: no file. Throws std::runtime_error if the file cannot be made. */
    Log(Records &records, const std::string &path);
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

    Records &records_;
    std::FILE *file_;
    unsigned long long rows_;
    std::atomic<bool> stop_;
    std::thread thread_;
};

#endif

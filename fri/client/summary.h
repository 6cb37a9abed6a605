// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SUMMARY_H
#define FRI_CLIENT_SUMMARY_H

#include "connection.h"
#include "log.h"
#include "options.h"
#include "wiping_client.h"

#include <string>
#include <utility>
#include <vector>

/* Return "open_fri 2.7" or "KUKA SDK 2.7". */
const char *fri_description();

/* Closing figures of a session. */
class Summary {
public:
    Summary(const WipingClient &client, const Connection &connection, const Records &records, const Log &log,
            const Options &options, int code);

    void print() const;

    /* Write as JSON; 0, or errno. */
    int write(const std::string &path) const;

private:
    typedef std::vector<std::pair<std::string, std::string>> Fields;

    void set_session(const WipingClient &client, const Connection &connection, const Records &records, const Log &log,
                     int code);
    void set_faults(const Counters &counters, const Traffic &traffic);
    void set_controller(const robot::Config &config, const Settings &settings);

    Fields session_, faults_, controller_;
};

#endif

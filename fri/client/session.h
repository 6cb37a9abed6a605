// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SESSION_H
#define FRI_CLIENT_SESSION_H

#include "connection.h"
#include "options.h"
#include "wiping_client.h"

#include <friClientApplication.h>

#include <csignal>
#include <string>

/* Exit codes. */
enum ExitCode { DONE = 0, FAULT = 1, REFUSED = 2, ENDED_EARLY = 3, INTERRUPTED = 4 };

/* End of a session: exit code, and a sentence for the person. */
struct Ending {
    ExitCode code;
    std::string sentence;
};

/* Return why the client refuses the session. */
std::string refusal_text(const WipingClient &client);

/*
 * Run the session from the first datagram to its end, and disconnect. interrupts: requests to end it; after the first
 * the torque goes to zero while the robot is still answered, after the second the client leaves at once.
 */
Ending run_session(const Options &options, WipingClient &client, Connection &connection,
                   KUKA::FRI::ClientApplication &application, const volatile std::sig_atomic_t &interrupts);

#endif

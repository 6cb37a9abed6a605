// SPDX-License-Identifier: MIT
// Stub of std_srvs for tests: README.md.
#pragma once

#include <string>

namespace std_srvs {
namespace srv {

struct Trigger {
    struct Request {};
    struct Response {
        bool success = false;
        std::string message;
    };
};

} // namespace srv
} // namespace std_srvs

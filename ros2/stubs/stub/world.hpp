// SPDX-License-Identifier: MIT
// What the stubs record for the tests: lines of the log, and whether the loop runs, in which nothing may block.
#pragma once

#include <cstdarg>
#include <cstdio>
#include <string>
#include <vector>

namespace stub {

struct Line {
    std::string level, text;
};

struct World {
    std::vector<Line> log;
    bool in_update = false;
    int logged_in_update = 0;

    bool said(const std::string &level, const std::string &text) const
    {
        for (const Line &line : log) {
            if (line.level == level && line.text.find(text) != std::string::npos) { return true; }
        }
        return false;
    }

    int times(const std::string &text) const
    {
        int count = 0;
        for (const Line &line : log) { count += line.text.find(text) != std::string::npos; }
        return count;
    }
};

inline World &world()
{
    static World only;
    return only;
}

[[gnu::format(printf, 2, 3)]] inline void log(const char *level, const char *format, ...)
{
    char text[2048];
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    world().logged_in_update += world().in_update;
    world().log.push_back({level, text});
}

} // namespace stub

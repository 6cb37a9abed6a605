// SPDX-License-Identifier: MIT
// Stub of pluginlib for tests: README.md. One class per base in a program; a class that is not one of them fails here.
#pragma once

#include <memory>

namespace stub {

template <class Base> std::unique_ptr<Base> (*&factory())()
{
    static std::unique_ptr<Base> (*make)() = nullptr;
    return make;
}

} // namespace stub

#define PLUGINLIB_EXPORT_CLASS(Class, Base) \
    namespace { \
    [[maybe_unused]] const bool stub_exported = ((::stub::factory<Base>() = [] { return std::unique_ptr<Base>(new Class); }), true); \
    }

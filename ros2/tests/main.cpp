// SPDX-License-Identifier: MIT
// Run one scenario by name, or list the names. Each allocation is counted.
#include "rig.hpp"

#include <cstdlib>
#include <cstring>
#include <new>

int failed = 0;
long allocations = 0;

void *operator new(std::size_t size)
{
    ++allocations;
    void *memory = std::malloc(size);
    if (memory == nullptr) { throw std::bad_alloc(); }
    return memory;
}
void operator delete(void *memory) noexcept { std::free(memory); }
void operator delete(void *memory, std::size_t) noexcept { std::free(memory); }

int main(int argc, char **argv)
{
    for (const auto *table : {&LIFECYCLE, &COMMANDS, &CHANGES, &FAULTS, &SENSOR}) {
        for (const Scenario &scenario : *table) {
            if (argc < 2) {
                std::printf("%s\n", scenario.name);
            } else if (std::strcmp(argv[1], scenario.name) == 0) {
                scenario.run();
                for (const auto &line : stub::world().log) {
                    if (failed > 0) { std::printf("%s: %s\n", line.level.c_str(), line.text.c_str()); }
                }
                return failed;
            }
        }
    }
    return argc < 2 ? 0 : 2;
}

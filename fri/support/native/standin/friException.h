/* SPDX-License-Identifier: MIT */
/* A library in the place of KUKA's, for tests: README.md. Uses strncpy without <cstring>, as that one. */
#ifndef FRI_STANDIN_EXCEPTION_H
#define FRI_STANDIN_EXCEPTION_H

namespace KUKA {
namespace FRI {

class FRIException {
public:
    explicit FRIException(const char *message)
    {
        strncpy(text(), message, 159);
        text()[159] = '\0';
    }

    const char *getErrorMessage() const { return text(); }

private:
    static char *text()
    {
        static char memory[160];
        return memory;
    }
};

} // namespace FRI
} // namespace KUKA

#endif

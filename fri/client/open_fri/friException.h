// SPDX-License-Identifier: MIT
/* Part of open_fri, the small open FRI client library of stiffgen's FRI example. */
#ifndef OPEN_FRI_EXCEPTION_H
#define OPEN_FRI_EXCEPTION_H

#include <cstring>

namespace KUKA {
namespace FRI {

/* Exception of a getter or setter that cannot do its task. As in KUKA's library, it is no std::exception. */
class FRIException {
public:
    explicit FRIException(const char *message)
    {
        std::strncpy(text_, message, sizeof text_ - 1);
        text_[sizeof text_ - 1] = '\0';
    }

    const char *getErrorMessage() const { return text_; }

private:
    char text_[160];
};

} // namespace FRI
} // namespace KUKA

#endif

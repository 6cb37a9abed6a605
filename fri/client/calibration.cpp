// SPDX-License-Identifier: MIT
#include "calibration.h"

#include "robot.h"

#include <algorithm>
#include <fstream>
#include <stdexcept>

Calibration::Calibration()
{
    std::fill(bias, bias + 6, 0.0);
    std::fill(payload, payload + 4, 0.0);
}

/* Read bias and payload from a file of 'stiffgen calibrate'; throw if it is none, or of another sensor. */
Calibration::Calibration(const std::string &path)
{
    std::ifstream file(path.c_str(), std::ios::binary);
    std::string text(1 << 16, '\0'); /* its last byte stays zero */
    file.read(&text[0], static_cast<std::streamsize>(text.size() - 1));
    if (file.gcount() == 0 || !robot::read_calibration(text.c_str(), bias, payload)) {
        throw std::runtime_error("calibration " + path + ": cannot be read, or is none by 'stiffgen calibrate'");
    }
    if (!robot::is_of_sensor(text.c_str())) {
        throw std::runtime_error("calibration " + path + ": is of another sensor than that of " + robot::name() +
                                 "; calibrate again with this robot");
    }
}

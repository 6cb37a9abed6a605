# SPDX-License-Identifier: MIT
"""Time of one C call from a sensor's reading to Kq, beside Kq alone and the two calls after one another (iiwa 14).

Generates the robot with a sensor into a temporary folder. Single calls and batches are timed in turns; the least time
counts.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import stiffgen

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmarks.tools import URDF, machine

PROGRAM = r"""
#define _POSIX_C_SOURCE 199309L
#include "felt.h"
#include <stdio.h>
#include <time.h>
enum { CALLS = 2000, ROUNDS = 400, COUNT = 256 };
static double many_q[7 * COUNT], many_readings[6 * COUNT], many_Kq[49 * COUNT];
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}
static double batches(const double *bias, const double *payload, const double *K)
{
    double best[2] = {1e30, 1e30}, sum = 0.0;
    for (int i = 0; i < 7 * COUNT; ++i) {
        many_q[i] = i * 37 % 101 / 50.0 - 1.0;
    }
    for (int i = 0; i < 6 * COUNT; ++i) {
        many_readings[i] = i * 53 % 97 / 5.0 - 9.0;
    }
    for (int round = 0; round < 2 * ROUNDS; ++round) {
        const double start = now();
        if (round % 2 == 0) {
            felt_hybrid_joint_stiffness_batch(COUNT, many_q, 7, many_readings, 6, K, 0, many_Kq);
        } else {
            felt_sensor_joint_stiffness_batch(
                COUNT, many_q, 7, many_readings, 6, bias, 0, payload, 0, K, 0, many_Kq);
        }
        const double each = (now() - start) / COUNT;
        best[round % 2] = each < best[round % 2] ? each : best[round % 2];
        sum += many_Kq[5];
    }
    printf("batch of Kq alone       %7.1f ns\n", best[0]);
    printf("batch from readings     %7.1f ns, %.2f of Kq alone\n", best[1], best[1] / best[0]);
    return sum;
}
int main(void)
{
    double q[7] = {0.3, 0.6, -0.2, -1.3, 0.4, 0.9, 0.1}, reading[6] = {5, -3, 20, 0.5, 0.2, -0.1}, F[6], Kq[49];
    const double bias[6] = {1, 2, 3, 0.1, 0.2, 0.3}, payload[4] = {1.3, 0.01, -0.02, 0.1};
    double K[36] = {0}, best[3] = {1e30, 1e30, 1e30}, sum = 0.0;
    for (int i = 0; i < 6; ++i) {
        K[7 * i] = i < 3 ? 700.0 : 30.0;
    }
    for (int round = 0; round < ROUNDS; ++round) {
        for (int which = 0; which < 3; ++which) {
            const double start = now();
            for (int call = 0; call < CALLS; ++call) {
                q[call % 7] += 1e-9;
                if (which == 0) {
                    felt_hybrid_joint_stiffness(q, reading, K, Kq);
                } else if (which == 1) {
                    felt_sensor_joint_stiffness(q, reading, bias, payload, K, Kq);
                } else {
                    felt_sensor_tip_wrench(q, reading, bias, payload, F);
                    felt_hybrid_joint_stiffness(q, F, K, Kq);
                }
                sum += Kq[5];
            }
            const double each = (now() - start) / CALLS;
            best[which] = each < best[which] ? each : best[which];
        }
    }
    printf("Kq alone                %7.1f ns\n", best[0]);
    printf("sensor.joint_stiffness  %7.1f ns, %.2f of Kq alone\n", best[1], best[1] / best[0]);
    printf("tip_wrench, then Kq     %7.1f ns, %.2f of Kq alone\n", best[2], best[2] / best[0]);
    sum += batches(bias, payload, K);
    return sum == 0.0;
}
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compiler", default="cc")
    parser.add_argument("--flags", default="-O3 -march=native")
    parser.add_argument("--rpy", type=float, nargs=3, default=(0.0, 0.0, 0.0), help="of the sensor [rad]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as output:
        sensor = stiffgen.Sensor("link_ee", (0.0, 0.0, 0.03), tuple(options.rpy))
        tool = stiffgen.Tool(xyz=(0.0, 0.0, 0.24))
        folder = stiffgen.generate(
            URDF, name="felt", output=output, tool=tool, sensor=sensor, build=False,
            controller=False, masses=False, kernels="hybrid,sensor",
        )  # fmt: skip
        source, program = Path(output) / "main.c", Path(output) / "main"
        source.write_text(PROGRAM)
        print(machine())
        command = [options.compiler, "-std=c99", *options.flags.split(), f"-I{folder}", source]
        command += [folder / "felt.c", folder / "felt_batch.c"]
        subprocess.run([*map(str, command), "-lm", "-o", str(program)], check=True)
        return subprocess.run([str(program)], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())

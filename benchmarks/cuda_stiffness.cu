/*
 * The hybrid joint stiffness of the iiwa 14 on a GPU, against a device-to-device copy that moves as many bytes: 41
 * doubles a configuration (7 of q, 6 of the wrench, 28 of the result). Values are checked against the C code first.
 *
 *     make bench-cuda            (nvcc, a GPU; CONFIGURATIONS=number, default 4194304)
 */
#include "iiwa14.h"
#include "iiwa14_cuda.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include <algorithm>
#include <vector>

enum { JOINTS = IIWA14_DOF, PACKED = JOINTS * (JOINTS + 1) / 2, MOVED = JOINTS + 6 + PACKED, ROUNDS = 31 };

static void check(int error, const char *what)
{
    if (error != 0) {
        fprintf(stderr, "%s: %s\n", what, cudaGetErrorString((cudaError_t)error));
        exit(1);
    }
}

/* Uniform in [low, high], the same numbers every time. */
static double draw(double low, double high)
{
    static unsigned long long state = 1;
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    return low + (high - low) * ((double)(state >> 11) * 0x1p-53);
}

/* Largest difference to the C code over the largest entry, over every step-th configuration; -1 for a wrong NaN. */
static double largest_error(const std::vector<double> &q, const std::vector<double> &wrench, const double K[36],
    const std::vector<double> &found, size_t count, size_t step)
{
    double worst = 0.0;
    for (size_t c = 0; c < count; c += step) {
        double one_q[JOINTS], one_wrench[6], Kq[JOINTS * JOINTS], difference = 0.0, scale = 0.0;
        for (size_t k = 0; k < JOINTS; ++k) {
            one_q[k] = q[k * count + c];
        }
        for (size_t k = 0; k < 6; ++k) {
            one_wrench[k] = wrench[k * count + c];
        }
        iiwa14_hybrid_joint_stiffness(one_q, one_wrench, K, Kq);
        size_t packed = 0;
        for (size_t i = 0; i < JOINTS; ++i) {
            for (size_t j = i; j < JOINTS; ++j) {
                const double value = found[packed++ * count + c], expected = Kq[JOINTS * i + j];
                if (isnan(value) != isnan(expected)) {
                    return -1.0;
                }
                if (!isnan(value)) {
                    difference = std::max(difference, fabs(value - expected));
                    scale = std::max(scale, fabs(expected));
                }
            }
        }
        worst = std::max(worst, scale > 0.0 ? difference / scale : 0.0);
    }
    return worst;
}

static double median(std::vector<float> times)
{
    std::sort(times.begin(), times.end());
    return 1e-3 * (double)times[times.size() / 2];
}

int main(int argc, char **argv)
{
    const size_t count = argc > 1 ? (size_t)strtoull(argv[1], NULL, 10) : (size_t)1 << 22;
    if (count == 0) {
        fprintf(stderr, "usage: %s [CONFIGURATIONS]\n", argv[0]);
        return 2;
    }
    cudaDeviceProp device;
    check(cudaGetDeviceProperties(&device, 0), "no usable GPU");

    std::vector<double> q(JOINTS * count), wrench(6 * count), found(PACKED * count);
    double K[36];
    for (size_t k = 0; k < q.size(); ++k) {
        q[k] = draw(iiwa14_lower[k / count], iiwa14_upper[k / count]);
    }
    for (size_t k = 0; k < wrench.size(); ++k) {
        wrench[k] = draw(-20.0, 20.0);
    }
    for (int k = 0; k < 36; ++k) {
        K[k] = draw(-100.0, 100.0) + (k % 7 == 0 ? 700.0 : 0.0);
    }
    q[0] = NAN; /* configuration 0 */

    double *q_there, *wrench_there, *K_there, *result_there, *from, *to;
    const size_t half = MOVED * count * sizeof(double) / 2; /* a copy of these reads and writes what the kernel moves */
    check(cudaMalloc((void **)&q_there, q.size() * sizeof(double)), "memory for q");
    check(cudaMalloc((void **)&wrench_there, wrench.size() * sizeof(double)), "memory for the wrenches");
    check(cudaMalloc((void **)&K_there, sizeof K), "memory for the task stiffness");
    check(cudaMalloc((void **)&result_there, found.size() * sizeof(double)), "memory for the result");
    check(cudaMalloc((void **)&from, half), "memory for the copy");
    check(cudaMalloc((void **)&to, half), "memory for the copy");
    check(cudaMemset(from, 0, half), "memory for the copy");
    check(cudaMemcpy(q_there, q.data(), q.size() * sizeof(double), cudaMemcpyHostToDevice), "copying q");
    check(cudaMemcpy(wrench_there, wrench.data(), wrench.size() * sizeof(double), cudaMemcpyHostToDevice),
        "copying the wrenches");
    check(cudaMemcpy(K_there, K, sizeof K, cudaMemcpyHostToDevice), "copying the task stiffness");

    const char *const launching = "iiwa14_hybrid_joint_stiffness_cuda";
    check(iiwa14_hybrid_joint_stiffness_cuda(count, count, q_there, wrench_there, K_there, result_there, NULL), launching);
    check(cudaMemcpy(found.data(), result_there, found.size() * sizeof(double), cudaMemcpyDeviceToHost), "copying back");
    const double error = largest_error(q, wrench, K, found, count, std::max<size_t>(1, count / 65536));
    if (!(error >= 0.0 && error <= 1e-12)) {
        fprintf(stderr, "the values are wrong: relative error %g\n", error);
        return 1;
    }

    cudaEvent_t start, stop;
    check(cudaEventCreate(&start), "event");
    check(cudaEventCreate(&stop), "event");
    std::vector<float> kernel_times, copy_times;
    for (int round = -3; round < ROUNDS; ++round) { /* the first ones warm up */
        float kernel_ms = 0.0f, copy_ms = 0.0f;
        check(cudaEventRecord(start), "event");
        check(iiwa14_hybrid_joint_stiffness_cuda(count, count, q_there, wrench_there, K_there, result_there, NULL),
            launching);
        check(cudaEventRecord(stop), "event");
        check(cudaEventSynchronize(stop), launching);
        check(cudaEventElapsedTime(&kernel_ms, start, stop), "event");
        check(cudaEventRecord(start), "event");
        check(cudaMemcpyAsync(to, from, half, cudaMemcpyDeviceToDevice), "copy");
        check(cudaEventRecord(stop), "event");
        check(cudaEventSynchronize(stop), "copy");
        check(cudaEventElapsedTime(&copy_ms, start, stop), "event");
        if (round >= 0) {
            kernel_times.push_back(kernel_ms);
            copy_times.push_back(copy_ms);
        }
    }
    const double bytes = (double)MOVED * (double)count * sizeof(double), t = median(kernel_times), copy = median(copy_times);
    printf("%s, %zu configurations of %d bytes, medians of %d rounds, largest relative error %.1e\n", device.name, count,
        MOVED * 8, ROUNDS, error);
    printf("hybrid joint stiffness  %8.3g configurations/s  %7.1f GB/s\n", (double)count / t, 1e-9 * bytes / t);
    printf("copy of as many bytes   %8.3g configurations/s  %7.1f GB/s\n", (double)count / copy, 1e-9 * bytes / copy);
    printf("part of the memory roofline: %.2f\n", copy / t);
    return 0;
}

// SPDX-License-Identifier: MIT
/*
 * The hybrid joint stiffness of the iiwa 14, with one task stiffness and with one per configuration, and its vector-Jacobian
 * product on a GPU, each against a device-to-device copy that moves as many bytes: 41 doubles a configuration (7 of q, 6 of
 * the wrench, 28 of the result), 62 (21 of the task stiffness's upper triangle), and 111 (49 of the cotangent, and 7, 6 and
 * 36 of the gradients). Values are checked against the C code first.
 *
 * The first configurations, their results and the task stiffness go to a file, for benchmarks/cuda_peers.py.
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

enum { JOINTS = IIWA14_DOF, PACKED = JOINTS * (JOINTS + 1) / 2, ROUNDS = 31, SOME = 65536 };

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

/*
 * Largest difference to the C code over the largest entry, over every step-th configuration; -1 for a wrong NaN. K holds one
 * task stiffness for all, or one per configuration in columns.
 */
static double largest_error(const std::vector<double> &q, const std::vector<double> &wrench, const std::vector<double> &K,
    const std::vector<double> &found, size_t count, size_t step)
{
    const bool shared = K.size() == 36;
    double worst = 0.0;
    for (size_t c = 0; c < count; c += step) {
        double one_q[JOINTS], one_wrench[6], one_K[36], Kq[JOINTS * JOINTS], difference = 0.0, scale = 0.0;
        for (size_t k = 0; k < JOINTS; ++k) {
            one_q[k] = q[k * count + c];
        }
        for (size_t k = 0; k < 6; ++k) {
            one_wrench[k] = wrench[k * count + c];
        }
        for (size_t k = 0; k < 36; ++k) {
            one_K[k] = shared ? K[k] : K[k * count + c];
        }
        iiwa14_hybrid_joint_stiffness(one_q, one_wrench, one_K, Kq);
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

/* The same of the product's results, one after the other: q_bar, wrench_bar, task_stiffness_bar. */
static double largest_error_of_product(const std::vector<double> &q, const std::vector<double> &wrench, const std::vector<double> &K,
    const std::vector<double> &cotangent, const std::vector<double> &found, size_t count, size_t step)
{
    enum { GRADIENTS = JOINTS + 6 + 36 };
    double worst = 0.0;
    for (size_t c = 0; c < count; c += step) {
        double one_q[JOINTS], one_wrench[6], one[JOINTS * JOINTS], bar[GRADIENTS];
        for (size_t k = 0; k < JOINTS; ++k) {
            one_q[k] = q[k * count + c];
        }
        for (size_t k = 0; k < 6; ++k) {
            one_wrench[k] = wrench[k * count + c];
        }
        for (size_t k = 0; k < JOINTS * JOINTS; ++k) {
            one[k] = cotangent[k * count + c];
        }
        iiwa14_hybrid_joint_stiffness_vjp(one_q, one_wrench, K.data(), one, bar, bar + JOINTS, bar + JOINTS + 6);
        const size_t ends[3] = {JOINTS, JOINTS + 6, GRADIENTS};
        size_t k = 0;
        for (int part = 0; part < 3; ++part) {
            double difference = 0.0, scale = 0.0;
            for (; k < ends[part]; ++k) {
                const double value = found[k * count + c];
                if (isnan(value) != isnan(bar[k])) {
                    return -1.0;
                }
                if (!isnan(value)) {
                    difference = std::max(difference, fabs(value - bar[k]));
                    scale = std::max(scale, fabs(bar[k]));
                }
            }
            worst = std::max(worst, scale > 0.0 ? difference / scale : 0.0);
        }
    }
    return worst;
}

static double median(std::vector<float> times)
{
    std::sort(times.begin(), times.end());
    return 1e-3 * (double)times[times.size() / 2];
}

/* Time a launch in turn with a copy that moves as many doubles a configuration, and print both. */
template <typename Launch>
static void compare(const char *name, size_t count, int moved, double error, Launch launch)
{
    double *from, *to;
    const size_t half = (size_t)moved * count * sizeof(double) / 2; /* a copy reads and writes */
    check(cudaMalloc((void **)&from, half), "memory for the copy");
    check(cudaMalloc((void **)&to, half), "memory for the copy");
    check(cudaMemset(from, 0, half), "memory for the copy");
    cudaEvent_t start, stop;
    check(cudaEventCreate(&start), "event");
    check(cudaEventCreate(&stop), "event");
    std::vector<float> kernel_times, copy_times;
    for (int round = -3; round < ROUNDS; ++round) { /* the first ones warm up */
        float kernel_ms = 0.0f, copy_ms = 0.0f;
        check(cudaEventRecord(start), "event");
        check(launch(), name);
        check(cudaEventRecord(stop), "event");
        check(cudaEventSynchronize(stop), name);
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
    const double bytes = (double)moved * (double)count * sizeof(double), t = median(kernel_times), copy = median(copy_times);
    printf("%s, %d bytes a configuration, medians of %d rounds, largest relative error %.1e\n", name, moved * 8, ROUNDS, error);
    printf("  kernel                  %8.3g configurations/s  %7.1f GB/s\n", (double)count / t, 1e-9 * bytes / t);
    printf("  copy of as many bytes   %8.3g configurations/s  %7.1f GB/s\n", (double)count / copy, 1e-9 * bytes / copy);
    printf("  part of the memory roofline: %.2f\n", copy / t);
    check(cudaEventDestroy(start), "event");
    check(cudaEventDestroy(stop), "event");
    check(cudaFree(from), "memory");
    check(cudaFree(to), "memory");
}

static double *moved_there(const std::vector<double> &numbers, const char *what)
{
    double *there;
    check(cudaMalloc((void **)&there, numbers.size() * sizeof(double)), what);
    check(cudaMemcpy(there, numbers.data(), numbers.size() * sizeof(double), cudaMemcpyHostToDevice), what);
    return there;
}

/* The columns of the first configurations: q, wrenches, the task stiffness, results. */
static void write_first(const char *name, size_t count, const std::vector<double> &q, const std::vector<double> &wrench,
    const std::vector<double> &K, const std::vector<double> &found)
{
    FILE *file = fopen(name, "wb");
    const size_t some = std::min<size_t>(count, SOME);
    bool written = file != NULL;
    for (const std::vector<double> *columns : {&q, &wrench, &K, &found}) {
        const size_t stride = columns == &K ? 36 : count, length = columns == &K ? 36 : some;
        for (size_t from = 0; written && from < columns->size(); from += stride) {
            written = fwrite(columns->data() + from, sizeof(double), length, file) == length;
        }
    }
    if (!written || fclose(file) != 0) {
        fprintf(stderr, "%s cannot be written\n", name);
        exit(1);
    }
}

int main(int argc, char **argv)
{
    const size_t count = argc > 1 ? (size_t)strtoull(argv[1], NULL, 10) : (size_t)1 << 22;
    if (count == 0) {
        fprintf(stderr, "usage: %s [CONFIGURATIONS [FILE]]\n", argv[0]);
        return 2;
    }
    cudaDeviceProp device;
    check(cudaGetDeviceProperties(&device, 0), "no usable GPU");

    std::vector<double> q(JOINTS * count), wrench(6 * count), found(PACKED * count), K(36), K_each(36 * count);
    for (size_t k = 0; k < q.size(); ++k) {
        q[k] = draw(iiwa14_lower[k / count], iiwa14_upper[k / count]);
    }
    for (size_t k = 0; k < wrench.size(); ++k) {
        wrench[k] = draw(-20.0, 20.0);
    }
    for (size_t k = 0; k < 36; ++k) {
        K[k] = draw(-100.0, 100.0) + (k % 7 == 0 ? 700.0 : 0.0);
        for (size_t c = 0; c < count; ++c) {
            K_each[k * count + c] = draw(0.5, 2.0) * K[k];
        }
    }
    q[0] = NAN; /* configuration 0 */

    std::vector<double> cotangent(JOINTS * JOINTS * count), gradients((JOINTS + 6 + 36) * count);
    for (size_t k = 0; k < cotangent.size(); ++k) {
        cotangent[k] = draw(-1.0, 1.0);
    }
    const double *const q_there = moved_there(q, "memory for q");
    const double *const wrench_there = moved_there(wrench, "memory for the wrenches");
    const double *const K_there = moved_there(K, "memory for the task stiffness");
    const double *const K_each_there = moved_there(K_each, "memory for a task stiffness per configuration");
    const double *const cotangent_there = moved_there(cotangent, "memory for the cotangents");
    double *const result_there = moved_there(found, "memory for the result");
    double *const gradients_there = moved_there(gradients, "memory for the gradients");

    const auto stiffness = [&] {
        return iiwa14_hybrid_joint_stiffness_cuda(count, count, q_there, wrench_there, K_there, result_there, NULL);
    };
    const auto stiffness_each = [&] {
        return iiwa14_hybrid_joint_stiffness_each_cuda(
            count, count, q_there, wrench_there, K_each_there, count, result_there, NULL);
    };
    const auto product = [&] {
        return iiwa14_hybrid_joint_stiffness_vjp_cuda(count, count, q_there, wrench_there, K_there, cotangent_there,
            gradients_there, gradients_there + JOINTS * count, gradients_there + (JOINTS + 6) * count, NULL);
    };
    const size_t step = std::max<size_t>(1, count / SOME);
    check(stiffness(), "iiwa14_hybrid_joint_stiffness_cuda");
    check(cudaMemcpy(found.data(), result_there, found.size() * sizeof(double), cudaMemcpyDeviceToHost), "copying back");
    if (argc > 2) {
        write_first(argv[2], count, q, wrench, K, found);
    }
    const double error = largest_error(q, wrench, K, found, count, step);
    check(stiffness_each(), "iiwa14_hybrid_joint_stiffness_each_cuda");
    check(cudaMemcpy(found.data(), result_there, found.size() * sizeof(double), cudaMemcpyDeviceToHost), "copying back");
    const double error_each = largest_error(q, wrench, K_each, found, count, step);
    check(product(), "iiwa14_hybrid_joint_stiffness_vjp_cuda");
    check(cudaMemcpy(gradients.data(), gradients_there, gradients.size() * sizeof(double), cudaMemcpyDeviceToHost),
        "copying back");
    const double product_error = largest_error_of_product(q, wrench, K, cotangent, gradients, count, step);
    const auto within = [](double found_error, double bound) { return found_error >= 0.0 && found_error <= bound; };
    if (!within(error, 1e-12) || !within(error_each, 1e-12) || !within(product_error, 1e-11)) {
        fprintf(stderr, "the values are wrong: relative error %g, with a task stiffness each %g, of the product %g\n", error,
            error_each, product_error);
        return 1;
    }
    printf("%s, %zu configurations\n", device.name, count);
    compare("hybrid joint stiffness", count, JOINTS + 6 + PACKED, error, stiffness);
    compare("with a task stiffness each", count, JOINTS + 6 + 21 + PACKED, error_each, stiffness_each);
    compare("its vector-Jacobian product", count, 2 * (JOINTS + 6) + JOINTS * JOINTS + 36, product_error, product);
    return 0;
}

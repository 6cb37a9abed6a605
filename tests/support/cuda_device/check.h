// SPDX-License-Identifier: MIT
/*
 * Runs every launch function of NAME_cuda.h against the single calls of NAME.h. A printed table (launches.cu, from
 * tests/support/cuda_device) names the functions and the records of their arguments, defines number and calls check_all.
 *
 * Compiled by nvcc the functions run on the GPU. Compiled by any other C++ compiler they run on the host.
 */
#ifndef CHECK_H
#define CHECK_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

enum Kind { OWN, VARYING, SHARED }; /* columns of the launch's stride; of a stride of its own; one for all */

struct Given {
    size_t argument; /* place in the pool */
    Kind kind;
};

struct Result {
    const char *name;
    size_t size;
    size_t rows; /* of a matrix whose upper triangle is written; else 0 */

    size_t stored() const { return rows ? rows * (rows + 1) / 2 : size; }
};

typedef int Launcher(
    size_t count, size_t stride, const number *const *x, const size_t *strides, number *const *y, void *stream);
typedef void Single(const number *const *x, number *const *y);

struct Launch {
    const char *name;
    std::vector<Given> given;
    std::vector<Result> results;
    Launcher *launch;
    Single *single;
};

typedef std::vector<number> Numbers;

/* Device */

#if defined(__CUDACC__)
static void need(int error, const char *what)
{
    if (error != 0) {
        fprintf(stderr, "%s: %s\n", what, cudaGetErrorString((cudaError_t)error));
        exit(2);
    }
}
#endif

/* An array on the device, or beside it on the host: exactly as long as the numbers, so that memcheck sees its end. */
class There
{
  public:
    explicit There(const Numbers &numbers) : at_(NULL), size_(numbers.size())
    {
#if defined(__CUDACC__)
        need(cudaMalloc((void **)&at_, size_ * sizeof(number)), "memory on the device");
        need(cudaMemcpy(at_, numbers.data(), size_ * sizeof(number), cudaMemcpyHostToDevice), "copy to the device");
#else
        at_ = new number[size_];
        std::copy(numbers.begin(), numbers.end(), at_);
#endif
    }
    There(const There &) = delete;
    There &operator=(const There &) = delete;
    ~There()
    {
#if defined(__CUDACC__)
        need(cudaFree(at_), "memory on the device");
#else
        delete[] at_;
#endif
    }

    number *at() const { return at_; }

    Numbers back() const
    {
        Numbers numbers(size_);
#if defined(__CUDACC__)
        need(cudaMemcpy(numbers.data(), at_, size_ * sizeof(number), cudaMemcpyDeviceToHost), "copy to the host");
#else
        std::copy(at_, at_ + size_, numbers.begin());
#endif
        return numbers;
    }

  private:
    number *at_;
    size_t size_;
};

/* Wait for a stream's kernels. An error there ends the program: the device accepts no further call. */
static void finish(const char *name, void *stream)
{
#if defined(__CUDACC__)
    need(cudaGetLastError(), name);
    need(cudaStreamSynchronize((cudaStream_t)stream), name);
#else
    (void)name, (void)stream;
#endif
}

static void *new_stream(void)
{
#if defined(__CUDACC__)
    cudaStream_t stream;
    need(cudaStreamCreate(&stream), "stream");
    return stream;
#else
    return NULL;
#endif
}

static std::string device_name(void)
{
#if defined(__CUDACC__)
    cudaDeviceProp device;
    need(cudaGetDeviceProperties(&device, 0), "no usable GPU");
    return device.name;
#else
    return "host";
#endif
}

/* Values */

/* Value of results before a launch: an entry that keeps these bits was not written. */
static number poison(void)
{
    number value;
    memset(&value, 0xA5, sizeof value);
    return value;
}

static bool is_poison(number value)
{
    const number untouched = poison();
    return memcmp(&value, &untouched, sizeof value) == 0;
}

/* One launch: which argument is shared (or none), whether an entry of it is NaN, and how many configurations. */
struct Pass {
    enum { NONE = -1 };
    int shared;
    bool spoiled;
    size_t count;
};

class Check
{
  public:
    size_t launches; /* so far */

    Check(const std::vector<size_t> &sizes, const std::vector<Numbers> &pool, size_t rows, double bound)
        : launches(0), sizes_(sizes), pool_(pool), rows_(rows), bound_(bound), stream_(new_stream())
    {
    }

    /* Largest relative error of a launch function. Faults, in words, are appended. */
    double error_of(const Launch &launch, std::vector<std::string> &faults)
    {
        double worst = one_pass(launch, Pass{Pass::NONE, false, rows_}, faults);
        for (size_t i = 0; i < launch.given.size(); ++i) {
            if (launch.given[i].kind == VARYING) {
                worst = std::max(worst, one_pass(launch, Pass{(int)i, false, rows_}, faults));
            }
            if (launch.given[i].kind != OWN) {
                worst = std::max(worst, one_pass(launch, Pass{(int)i, true, rows_}, faults));
            }
        }
        refusals(launch, faults);
        return worst;
    }

    /* The same with more configurations, the rows of the pool again and again. */
    double error_of_many(const Launch &launch, size_t count, std::vector<std::string> &faults)
    {
        return one_pass(launch, Pass{Pass::NONE, false, count}, faults);
    }

  private:
    const std::vector<size_t> &sizes_;
    const std::vector<Numbers> &pool_;
    const size_t rows_;
    const double bound_;
    void *stream_;

    /* An entry of an argument in a row that is not finite. */
    struct Spoiled {
        size_t row, argument, entry;
        number value;
    };

    static number not_finite(size_t turn)
    {
        const number infinity = std::numeric_limits<number>::infinity();
        const number values[3] = {std::numeric_limits<number>::quiet_NaN(), infinity, -infinity};
        return values[turn % 3];
    }

    /* Every fifth row has an entry that is not finite, another one each time; where a shared argument has it, all have. */
    std::vector<Spoiled> spoiled_entries(const Launch &launch, const Pass &pass) const
    {
        std::vector<Spoiled> spoiled;
        size_t entries = 0;
        for (size_t i = 0; i < launch.given.size(); ++i) {
            entries += is_shared(launch, pass, i) ? 0 : sizes_[launch.given[i].argument];
        }
        for (size_t c = 0, turn = 0; c < rows_; ++c) {
            if (pass.spoiled) {
                const size_t i = (size_t)pass.shared;
                spoiled.push_back(Spoiled{c, i, launches % sizes_[launch.given[i].argument], not_finite(launches)});
            } else if (c % 5 == 4) {
                size_t entry = (7 * turn + launches) % entries, i = 0;
                while (is_shared(launch, pass, i) || entry >= sizes_[launch.given[i].argument]) {
                    entry -= is_shared(launch, pass, i) ? 0 : sizes_[launch.given[i].argument];
                    ++i;
                }
                spoiled.push_back(Spoiled{c, i, entry, not_finite(turn++)});
            }
        }
        return spoiled;
    }

    /* Values of the arguments in every row, all finite: those of the pool, a shared argument's first row in all rows. */
    std::vector<Numbers> arguments(const Launch &launch, const Pass &pass) const
    {
        std::vector<Numbers> values;
        for (size_t i = 0; i < launch.given.size(); ++i) {
            const size_t size = sizes_[launch.given[i].argument];
            values.push_back(pool_[launch.given[i].argument]);
            for (size_t c = 1; c < rows_ && is_shared(launch, pass, i); ++c) {
                std::copy(values[i].begin(), values[i].begin() + (long)size, values[i].begin() + (long)(c * size));
            }
        }
        return values;
    }

    /* The values, each up or down by its last digit. */
    static std::vector<Numbers> nudged_values(std::vector<Numbers> values)
    {
        size_t n = 0;
        for (Numbers &each : values) {
            for (number &value : each) {
                value *= (number)1 + (n++ % 3 == 0 ? -1 : 1) * std::numeric_limits<number>::epsilon();
            }
        }
        return values;
    }

    static bool is_shared(const Launch &launch, const Pass &pass, size_t i)
    {
        return launch.given[i].kind == SHARED || (int)i == pass.shared;
    }

    /* Results of the single call, row by row. */
    std::vector<Numbers> expected(const Launch &launch, const std::vector<Numbers> &values) const
    {
        std::vector<Numbers> found;
        for (const Result &result : launch.results) {
            found.push_back(Numbers(rows_ * result.size));
        }
        std::vector<const number *> x(values.size());
        std::vector<number *> y(found.size());
        for (size_t c = 0; c < rows_; ++c) {
            for (size_t i = 0; i < x.size(); ++i) {
                x[i] = &values[i][c * sizes_[launch.given[i].argument]];
            }
            for (size_t i = 0; i < y.size(); ++i) {
                y[i] = &found[i][c * launch.results[i].size];
            }
            launch.single(x.data(), y.data());
        }
        return found;
    }

    /* Columns: entry k of configuration c at stride * k + c. No number beyond the last configuration may be read. */
    Numbers columns(const Numbers &rows, size_t size, size_t count, size_t stride) const
    {
        Numbers there(size * stride, std::numeric_limits<number>::quiet_NaN());
        for (size_t k = 0; k < size; ++k) {
            for (size_t c = 0; c < count; ++c) {
                there[k * stride + c] = rows[(c % rows_) * size + k];
            }
        }
        return there;
    }

    double one_pass(const Launch &launch, const Pass &pass, std::vector<std::string> &faults)
    {
        const size_t count = pass.count, stride = count + 37;
        const std::vector<Spoiled> spoiled = spoiled_entries(launch, pass);
        std::vector<Numbers> values = arguments(launch, pass), others = values;
        std::vector<bool> is_spoiled(rows_);
        const std::vector<Numbers> finite = expected(launch, values), nudged = expected(launch, nudged_values(values));
        for (const Spoiled &each : spoiled) {
            const size_t place = each.row * sizes_[launch.given[each.argument].argument] + each.entry;
            others[each.argument][place] = (number)1.5 * others[each.argument][place] + (number)0.25;
            values[each.argument][place] = each.value;
            is_spoiled[each.row] = true;
        }
        const std::vector<Numbers> other = expected(launch, others), right = expected(launch, values);
        std::vector<There *> in, out;
        std::vector<const number *> x;
        std::vector<number *> y;
        std::vector<size_t> strides;
        for (size_t i = 0; i < values.size(); ++i) {
            const size_t size = sizes_[launch.given[i].argument];
            const bool shared = is_shared(launch, pass, i);
            strides.push_back(shared ? 0 : stride + (launch.given[i].kind == VARYING ? 3 + i : 0));
            in.push_back(new There(shared ? Numbers(values[i].begin(), values[i].begin() + (long)size)
                                          : columns(values[i], size, count, strides[i])));
            x.push_back(in[i]->at());
        }
        for (const Result &result : launch.results) { /* one column more: nothing may be written there */
            out.push_back(new There(Numbers((result.stored() + 1) * stride, poison())));
            y.push_back(out.back()->at());
        }
        const int error = launch.launch(count, stride, x.data(), strides.data(), y.data(), stream_);
        ++launches;
        finish(launch.name, stream_);
        double worst = 0.0;
        if (error != 0) {
            faults.push_back("the launch fails with error " + std::to_string(error));
        } else {
            for (size_t i = 0; i < launch.results.size(); ++i) {
                const Wanted wanted = {right[i], finite[i], other[i], nudged[i], is_spoiled};
                worst = std::max(worst, difference(launch.results[i], out[i]->back(), wanted, pass, stride, faults));
            }
        }
        for (There *each : in) {
            delete each;
        }
        for (There *each : out) {
            delete each;
        }
        return worst;
    }

    /* Place of entry k of the stored ones in the dense result. */
    static size_t dense(const Result &result, size_t k)
    {
        if (result.rows == 0) {
            return k;
        }
        size_t i = 0;
        for (; k >= result.rows - i; ++i) {
            k -= result.rows - i;
        }
        return result.rows * i + i + k;
    }

    /*
     * Results of the single calls: as launched, with two finite values in place of what is not finite, with the last
     * digits of the arguments changed; and the rows with something not finite.
     */
    struct Wanted {
        const Numbers &right, &finite, &other, &nudged;
        const std::vector<bool> &is_spoiled;
    };

    /*
     * Where one of the two results is NaN: the contract wants NaN in entries that depend on the argument. An entry that
     * does not depend on it has the same value with finite ones, and may be that value or NaN.
     */
    bool may_differ(number value, const Wanted &wanted, size_t place, double largest) const
    {
        const double finite = (double)wanted.finite[place], other = (double)wanted.other[place];
        const bool independent = fabs(finite - other) <= bound_ * largest;
        return independent && (isnan(value) || fabs((double)value - finite) <= bound_ * largest);
    }

    /* Largest difference in a configuration over its largest entry; over the largest of all where some are NaN. */
    double difference(const Result &result, const Numbers &found, const Wanted &wanted, const Pass &pass, size_t stride,
        std::vector<std::string> &faults) const
    {
        std::vector<double> away(pass.count), scale(rows_);
        double largest = 0.0;
        for (size_t place = 0; place < wanted.finite.size(); ++place) {
            const double size = fabs((double)wanted.finite[place]);
            double &of_row = scale[place / result.size];
            of_row = size > of_row ? size : of_row; /* false for NaN */
            largest = std::max(largest, of_row);
        }
        for (size_t k = 0; k < result.stored() + 1; ++k) {
            const size_t entry = k < result.stored() ? dense(result, k) : 0;
            for (size_t c = 0; c < stride; ++c) {
                const number value = found[k * stride + c];
                const bool inside = k < result.stored() && c < pass.count;
                const char *fault = NULL;
                if (inside == is_poison(value)) {
                    fault = inside ? "is not written" : "is written, beyond the result";
                } else if (inside) {
                    const size_t place = (c % rows_) * result.size + entry;
                    const number right = wanted.right[place];
                    if (isinf(value)) {
                        fault = "is infinite";
                    } else if (isnan(value) != isnan(right)) {
                        if (!may_differ(value, wanted, place, largest)) {
                            fault = isnan(value) ? "is NaN, in C a number" : "is a number, in C NaN";
                        }
                    } else if (!isnan(value)) {
                        away[c] = std::max(away[c], fabs((double)value - (double)right));
                    }
                }
                if (fault != NULL) {
                    faults.push_back(std::string(result.name) + " " + std::to_string(k) + " of configuration " +
                        std::to_string(c) + " " + fault);
                    return 0.0;
                }
            }
        }
        double worst = 0.0;
        for (size_t c = 0; c < pass.count; ++c) {
            const double size = wanted.is_spoiled[c % rows_] ? largest : scale[c % rows_];
            const double error = away[c] > 0.0 ? away[c] / (size > 0.0 ? size : 1.0) : 0.0;
            worst = std::max(worst, error);
            if (error > bound_ && away[c] > SENSITIVE * change(wanted, c % rows_, result.size)) {
                faults.push_back(std::string(result.name) + " of configuration " + std::to_string(c) + " differs");
                return worst;
            }
        }
        return worst;
    }

    enum { SENSITIVE = 10 };

    /* Largest change of a row's result by the last digits of its arguments. */
    static double change(const Wanted &wanted, size_t row, size_t size)
    {
        double largest = 0.0;
        for (size_t place = row * size; place < (row + 1) * size; ++place) {
            const double by = fabs((double)wanted.nudged[place] - (double)wanted.finite[place]);
            largest = by > largest ? by : largest;
        }
        return largest;
    }

    /* No configuration and strides that are too short: nothing is written. */
    void refusals(const Launch &launch, std::vector<std::string> &faults) const
    {
        const size_t count = 4;
        for (int way = -2; way < (int)launch.given.size(); ++way) {
            if (way >= 0 && launch.given[(size_t)way].kind != VARYING) {
                continue;
            }
            std::vector<There *> out;
            std::vector<number *> y;
            for (const Result &result : launch.results) {
                out.push_back(new There(Numbers(result.stored() * count, poison())));
                y.push_back(out.back()->at());
            }
            std::vector<size_t> strides(launch.given.size(), count);
            if (way >= 0) {
                strides[(size_t)way] = count - 1;
            }
            const std::vector<const number *> x(launch.given.size(), y[0]);
            const int error = launch.launch(
                way == -2 ? 0 : count, way == -1 ? count - 1 : count, x.data(), strides.data(), y.data(), stream_);
            finish(launch.name, stream_);
            if (error != (way == -2 ? 0 : 1)) {
                faults.push_back("a stride below the count is accepted, or no configuration refused");
            }
            for (There *each : out) {
                for (number value : each->back()) {
                    if (!is_poison(value)) {
                        faults.push_back("a refused launch writes");
                        break;
                    }
                }
                delete each;
            }
        }
    }
};

/* Run all launch functions on the rows in the file argv[1]; that with the fewest numbers also on argv[2] configurations. */
static int check_all(const char *robot, double bound, const std::vector<size_t> &sizes,
    const std::vector<Launch> &launches, int argc, char **argv)
{
    if (argc < 2) {
        fprintf(stderr, "usage: %s SAMPLES [CONFIGURATIONS]\n", argv[0]);
        return 2;
    }
    FILE *file = fopen(argv[1], "rb");
    size_t numbers = 0;
    for (size_t size : sizes) {
        numbers += size;
    }
    Numbers all;
    number value;
    while (file != NULL && fread(&value, sizeof value, 1, file) == 1) {
        all.push_back(value);
    }
    if (file == NULL || all.empty() || all.size() % numbers != 0) {
        fprintf(stderr, "%s: cannot be read as samples of %s\n", argv[1], robot);
        return 2;
    }
    fclose(file);
    const size_t rows = all.size() / numbers, many = argc > 2 ? (size_t)strtoull(argv[2], NULL, 10) : 0;
    std::vector<Numbers> pool;
    for (size_t i = 0, from = 0; i < sizes.size(); from += rows * sizes[i++]) {
        pool.push_back(Numbers(all.begin() + (long)from, all.begin() + (long)(from + rows * sizes[i])));
    }

    Check check(sizes, pool, rows, bound);
    double worst = 0.0;
    size_t wrong = 0;
    const char *worst_name = "none";
    const std::string device = device_name();
    const auto numbers_of = [&](const Launch &launch) {
        size_t total = 0;
        for (const Given &given : launch.given) {
            total += sizes[given.argument];
        }
        for (const Result &result : launch.results) {
            total += result.stored();
        }
        return total;
    };
    const auto smallest = std::min_element(launches.begin(), launches.end(),
        [&](const Launch &a, const Launch &b) { return numbers_of(a) < numbers_of(b); });
    for (const Launch &launch : launches) {
        std::vector<std::string> faults;
        double error = check.error_of(launch, faults);
        if (many > 0 && &launch == &*smallest) {
            error = std::max(error, check.error_of_many(launch, many, faults));
        }
        const bool right = faults.empty();
        printf("  %-60s %.1e%s\n", launch.name, error, right ? "" : "  WRONG");
        for (const std::string &fault : faults) {
            printf("    %s\n", fault.c_str());
        }
        wrong += right ? 0 : 1;
        if (error > worst) {
            worst = error;
            worst_name = launch.name;
        }
    }
    printf("%s on %s: %zu launch functions, %zu launches of %zu configurations", robot, device.c_str(), launches.size(),
        check.launches, rows);
    if (many > 0) {
        printf(" (one of %zu)", many);
    }
    printf(", %zu wrong, largest relative error %.1e (%s)\n", wrong, worst, worst_name);
    return wrong > 0 ? 1 : 0;
}

#endif

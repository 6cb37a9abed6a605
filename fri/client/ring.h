// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_RING_H
#define FRI_CLIENT_RING_H

#include <atomic>
#include <cstddef>

/*
 * Lock-free queue of fixed size from one thread to one other. push and pop neither wait nor allocate; a push into a
 * full ring is refused and counted.
 */
template <typename T, std::size_t CAPACITY> class Ring {
    static_assert(CAPACITY > 0 && (CAPACITY & (CAPACITY - 1)) == 0, "the capacity is a power of two");

public:
    /* The items are written once, so that no page of theirs is met for the first time in the session. */
    Ring() : items_(), written_(0), read_(0), refused_(0) {}

    /* From the writing thread alone. */
    bool push(const T &item)
    {
        const std::size_t written = written_.load(std::memory_order_relaxed);
        if (written - read_.load(std::memory_order_acquire) == CAPACITY) {
            refused_.store(refused_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
            return false;
        }
        items_[written & (CAPACITY - 1)] = item;
        written_.store(written + 1, std::memory_order_release);
        return true;
    }

    /* From the reading thread alone. */
    bool pop(T *item)
    {
        const std::size_t read = read_.load(std::memory_order_relaxed);
        if (written_.load(std::memory_order_acquire) == read) {
            return false;
        }
        *item = items_[read & (CAPACITY - 1)];
        read_.store(read + 1, std::memory_order_release);
        return true;
    }

    unsigned long long refused() const { return refused_.load(std::memory_order_relaxed); }

private:
    T items_[CAPACITY];
    std::atomic<std::size_t> written_;
    char apart_[64]; /* the two threads' counters on different cache lines */
    std::atomic<std::size_t> read_;
    std::atomic<unsigned long long> refused_;
};

#endif

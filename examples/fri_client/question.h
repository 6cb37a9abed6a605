// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_QUESTION_H
#define FRI_CLIENT_QUESTION_H

#include <atomic>

/* A question that the FRI thread has for the person at the terminal. It never waits for the answer. */
class Question {
public:
    enum State { NONE, ASKED, YES, NO };

    Question() : state_(NONE), joint_(0), distance_(0.0), under_way_(false), asked_(0) {}

    /* From the FRI thread: the arm's way to where the trajectory begins, or stopped (under way), is long; then, whether
     * to go it. */
    void set(int joint, double distance, bool under_way)
    {
        joint_ = joint;
        distance_ = distance;
        under_way_ = under_way;
    }
    void ask()
    {
        ++asked_;
        state_ = ASKED;
    }

    /* From the FRI thread: a yes was for one way, not for the next one. */
    void forget()
    {
        int yes = YES;
        state_.compare_exchange_strong(yes, NONE);
    }

    /* From the terminal's thread. */
    void answer(bool yes) { state_ = yes ? YES : NO; }

    State state() const { return static_cast<State>(state_.load()); }
    int joint() const { return joint_; }          /* that is furthest from the trajectory */
    double distance() const { return distance_; } /* [rad] */
    const char *where() const { return under_way_ ? "where the trajectory stopped" : "where the trajectory begins"; }
    int asked() const { return asked_; } /* so often */

private:
    std::atomic<int> state_;
    std::atomic<int> joint_;
    std::atomic<double> distance_;
    std::atomic<bool> under_way_;
    std::atomic<int> asked_;
};

#endif

// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_QUESTION_H
#define FRI_CLIENT_QUESTION_H

#include <atomic>

/* Question of the FRI thread to the person at the terminal. The FRI thread never waits for the answer. */
class Question {
public:
    enum State { NONE, ASKED, YES, NO };

    Question() : state_(NONE), joint_(0), distance_(0.0), under_way_(false), asked_(0) {}

    /* Set the subject, from the FRI thread: the long way to where the trajectory begins, or stopped (under_way). */
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

    /* Forget a yes, from the FRI thread: the answer was for one way. */
    void forget()
    {
        int yes = YES;
        state_.compare_exchange_strong(yes, NONE);
    }

    /* Answer, from the terminal's thread. */
    void answer(bool yes) { state_ = yes ? YES : NO; }

    State state() const { return static_cast<State>(state_.load()); }
    int joint() const { return joint_; }          /* joint furthest from the trajectory */
    double distance() const { return distance_; } /* [rad] */
    const char *where() const { return under_way_ ? "where the trajectory stopped" : "where the trajectory begins"; }
    int asked() const { return asked_; } /* number of questions */

private:
    std::atomic<int> state_;
    std::atomic<int> joint_;
    std::atomic<double> distance_;
    std::atomic<bool> under_way_;
    std::atomic<int> asked_;
};

#endif

#ifndef FRI_CLIENT_QUESTION_H
#define FRI_CLIENT_QUESTION_H

#include <atomic>

/* A question that the FRI thread has for the person at the terminal. It never waits for the answer. */
class Question {
public:
    enum State { NONE, ASKED, YES, NO };

    Question() : state_(NONE), joint_(0), distance_(0.0) {}

    /* From the FRI thread: the arm's way to the trajectory is long; then, whether to go it. */
    void set(int joint, double distance)
    {
        joint_ = joint;
        distance_ = distance;
    }
    void ask() { state_ = ASKED; }

    /* From the terminal's thread. */
    void answer(bool yes) { state_ = yes ? YES : NO; }

    State state() const { return static_cast<State>(state_.load()); }
    int joint() const { return joint_; }          /* that is furthest from the trajectory */
    double distance() const { return distance_; } /* [rad] */

private:
    std::atomic<int> state_;
    int joint_;
    double distance_;
};

#endif

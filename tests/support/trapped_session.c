/* SPDX-License-Identifier: MIT */
/*
 * Sessions of the controller with floating-point traps on: division by zero, invalid and overflow end the program by
 * SIGFPE. Argument: name of the session. Compiled with -DROBOT(x)=NAME_##x and -DUPPER(x)=MACRO_##x, and NAME.h,
 * NAME_impedance.h, NAME_follow.h, NAME_policy.h and NAME_paper.h included before. The arm follows the reference.
 */
#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { N = UPPER(DOF), SAMPLES = 1500 };

static ROBOT(impedance_config) config;
static ROBOT(impedance_state) state;
static ROBOT(impedance_input) input;
static ROBOT(impedance_output) output;
static ROBOT(follow_state) follower;
static ROBOT(follow_input) target;
static double q[N], dq[N];
static int by_pose;

static void set_springs(double translation, double rotation)
{
    for (int k = 0; k < 9; ++k) {
        input.translation_stiffness[k] = k % 4 == 0 ? translation : 0.0;
        input.rotation_stiffness[k] = k % 4 == 0 ? rotation : 0.0;
    }
}

/* Prepare a configuration of defaults and an input at rest, near a fifth of every joint's range from its lower limit. */
static void prepare(void)
{
    ROBOT(follow_config) following;
    ROBOT(impedance_default_config)(&config);
    config.sample_time = 1e-3;
    config.delay_samples = 0;
    config.position_quantum = 2e-6; /* an arm that follows to the last bit is no frozen encoder */
    config.heaviest_wrench[0] = 50.0;
    config.heaviest_wrench[1] = 10.0;
    for (int i = 0; i < N; ++i) {
        config.motor_inertia[i] = 0.1;
        q[i] = config.lower_limit[i] + 0.2 * (1 + i % 3) * (config.upper_limit[i] - config.lower_limit[i]);
        input.q0[i] = q[i];
        input.posture_stiffness[i] = 1.0;
    }
    input.clock = UPPER(CLOCK_COUNTER);
    set_springs(400.0, 20.0);
    ROBOT(follow_default_config)(&following);
    following.sample_time = config.sample_time;
    ROBOT(follow_init)(&following, &follower, q);
    ROBOT(forward_kinematics)(q, target.pose);
    memcpy(target.posture, q, sizeof q);
}

/* Do steps; of every `lost` samples one is missing (0: none). */
static void run(int samples, int lost)
{
    for (int k = 0; k < samples; ++k) {
        input.counter += 1u;
        input.time += config.sample_time;
        input.sample_valid = lost == 0 || k % lost != lost - 1;
        for (int i = 0; i < N; ++i) {
            const double wanted = 20.0 * (output.reference[i] - q[i]);
            dq[i] = output.mode != 0 && state.memory.watch.known ? wanted : 0.0;
            q[i] += 1e-3 * dq[i];
        }
        if (by_pose) {
            ROBOT(follow_output) followed;
            ROBOT(follow_step)(&follower, &target, &followed);
            memcpy(input.q0, followed.q0, sizeof input.q0);
        }
        input.shaped = by_pose;
        memcpy(input.q, q, sizeof q);
        memcpy(input.dq, dq, sizeof dq);
        ROBOT(impedance_step)(&state, &input, &output);
    }
}

/* Command a pose that is `share` of the way through the joints' ranges. */
static void command_pose(double share)
{
    double posture[N];
    for (int i = 0; i < N; ++i) {
        posture[i] = config.lower_limit[i] + share * (config.upper_limit[i] - config.lower_limit[i]);
    }
    by_pose = 1;
    ROBOT(forward_kinematics)(posture, target.pose);
}

static void start(void)
{
    ROBOT(impedance_init)(&config, &state, NULL);
    run(SAMPLES, 0);
    input.q0[1] += 0.1 * (config.upper_limit[1] - config.lower_limit[1]);
    run(SAMPLES, 0);
}

static void go_by_poses(void)
{
    start();
    command_pose(0.45);
    run(SAMPLES, 0);
    target.pose[3] += 10.0; /* out of reach */
    run(SAMPLES, 0);
    command_pose(1.0); /* in the corner of the limits */
    run(2 * SAMPLES, 7);
    by_pose = 0;
    run(SAMPLES, 0);
}

static void take_springs_away(void)
{
    set_springs(0.0, 0.0); /* from the first step on */
    memset(input.posture_stiffness, 0, sizeof input.posture_stiffness);
    start();
    set_springs(400.0, 20.0);
    run(SAMPLES, 0);
    set_springs(0.0, 0.0);
    run(SAMPLES, 0);
    command_pose(0.45);
    run(SAMPLES, 0);
}

static void lose_samples(void)
{
    start();
    run(SAMPLES, 2);
    input.sample_valid = 0;
    for (int k = 0; k < SAMPLES; ++k) {
        ROBOT(impedance_step)(&state, &input, &output);
    }
    input.counter += SAMPLES;
    ROBOT(impedance_reset)(&state);
    run(SAMPLES, 0);
    q[0] = config.upper_limit[0] + 1.0; /* a jump */
    run(SAMPLES, 0);
    input.clock = 0; /* none */
    run(10, 0);
}

/* Take the time of a clock, and begin anew with another configuration and the torque in force. */
static void tell_the_time(void)
{
    input.clock = UPPER(CLOCK_TIME);
    config.position_quantum = 1e-5;
    config.velocity_noise = 1e-2;
    config.communication_reaction = UPPER(COMMUNICATION_REACTION_RESUME);
    start();
    config.delay_samples = 5;
    config.damping_ratio = 0.0;
    config.sample_time = 2e-3;
    ROBOT(impedance_init)(&config, &state, output.torque);
    run(SAMPLES, 5);
    config.sample_time = -1.0; /* refused: there is no state */
    ROBOT(impedance_init)(&config, &state, output.torque);
    run(10, 0);
}

static void press(void)
{
    config.coriolis = UPPER(CORIOLIS_ON);
    config.delay_samples = 2;
    input.wrench_command[0] = 20.0;
    input.torque_offset[0] = 3.0;
    input.acceleration[0] = 0.1;
    go_by_poses();
    memset(input.wrench_command, 0, sizeof input.wrench_command);
    run(SAMPLES, 0);
}

static void refuse_commands(void)
{
    start();
    input.translation_stiffness[1] = 1e300;
    run(10, 0);
    set_springs(-1.0, 1.0);
    run(10, 0);
    set_springs(1.0, 1e-300);
    run(SAMPLES, 0);
    input.q0[0] = 1e300;
    run(10, 0);
    input.acceleration[0] = 1e300;
    input.wrench_command[0] = 1e300;
    run(10, 0);
}

static void propose(void)
{
    ROBOT(policy_config) settings;
    ROBOT(policy_state) policy;
    ROBOT(policy_proposal) proposal;
    ROBOT(policy_output) command;
    double pose[16];
    ROBOT(forward_kinematics)(q, pose);
    ROBOT(policy_default_config)(&settings);
    ROBOT(policy_start)(&policy, &settings, pose, 0.0);
    memset(&proposal, 0, sizeof proposal);
    by_pose = 1;
    ROBOT(impedance_init)(&config, &state, NULL);
    for (int k = 0; k < 3 * SAMPLES; ++k) {
        const double now = 1e-3 * k;
        if (k % 100 == 0 && k < 2 * SAMPLES) {
            for (int part = 0; part < UPPER(POLICY_PART_GRIPPER) + 1; ++part) {
                proposal.valid[part] = 1;
                proposal.time[part] = now;
            }
            memcpy(proposal.pose, pose, sizeof pose);
            proposal.pose[3] += 0.01 * (k / 100 % 3);
            for (int i = 0; i < 9; i += 4) {
                proposal.translation_stiffness[i] = proposal.rotation_stiffness[i] = k % 200 == 0 ? 0.0 : 100.0;
            }
            ROBOT(policy_propose)(&policy, &proposal, now);
        }
        ROBOT(policy_command)(&policy, now, &command);
        memcpy(target.pose, command.pose, sizeof target.pose);
        memcpy(input.translation_stiffness, command.translation_stiffness, sizeof input.translation_stiffness);
        memcpy(input.rotation_stiffness, command.rotation_stiffness, sizeof input.rotation_stiffness);
        memcpy(input.wrench_command, command.wrench_command, sizeof input.wrench_command);
        run(1, 0);
    }
}

static void follow_the_paper(void)
{
    ROBOT(paper_config) paper;
    ROBOT(paper_state) last;
    ROBOT(paper_input) sample;
    ROBOT(paper_output) out;
    memset(&last, 0, sizeof last);
    memset(&sample, 0, sizeof sample);
    ROBOT(paper_default_config)(&paper);
    memcpy(sample.q, q, sizeof q);
    memcpy(sample.q0, input.q0, sizeof q);
    for (int k = 0; k < 4; ++k) {
        for (int i = 0; i < 6; ++i) {
            sample.task_stiffness[7 * i] = k % 2 == 0 ? 0.0 : 300.0;
        }
        sample.wrench[2] = -10.0 * (k / 2);
        paper.posture_stiffness = k < 2 ? 0.0 : 1.0;
        ROBOT(paper_step)(&paper, &last, &sample, &out);
    }
    memset(paper.motor_inertia, 0, sizeof paper.motor_inertia);
    ROBOT(paper_step)(&paper, &last, &sample, &out);
}

/* The self-check hands NaN over, and a comparison of NaN is invalid: the header says so. */
static void check_controller(void)
{
    feenableexcept(FE_DIVBYZERO | FE_OVERFLOW);
    fedisableexcept(FE_INVALID);
    printf("%d ", ROBOT(impedance_self_check)());
}

static const struct {
    const char *name;
    void (*session)(void);
} sessions[] = {
    {"start", start},           {"poses", go_by_poses},
    {"zero", take_springs_away}, {"lost", lose_samples},
    {"clock", tell_the_time},   {"press", press},
    {"refused", refuse_commands}, {"policy", propose},
    {"paper", follow_the_paper}, {"self-check", check_controller},
};

int main(int count, char **arguments)
{
    for (unsigned k = 0; count > 1 && k < sizeof sessions / sizeof *sessions; ++k) {
        if (strcmp(arguments[1], sessions[k].name) == 0) {
            prepare();
            feclearexcept(FE_ALL_EXCEPT);
            feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW);
            sessions[k].session();
            printf("done, fault %d\n", output.fault);
            return 0;
        }
    }
    return 1;
}

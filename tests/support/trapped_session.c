/* SPDX-License-Identifier: MIT */
/*
 * Sessions of the controller with floating-point traps on: division by zero, invalid and overflow end the program by
 * SIGFPE. Argument: name of the session. Compiled with -DROBOT(x)=NAME_##x and -DUPPER(x)=MACRO_##x, and NAME.h,
 * NAME_impedance.h and NAME_paper.h included before. The arm follows the reference.
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
static double q[N], dq[N];

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
    ROBOT(impedance_default_config)(&config);
    config.stiffness_cap = UPPER(STIFFNESS_CAP_ACCEPT);
    for (int i = 0; i < N; ++i) {
        q[i] = config.lower_limit[i] + 0.2 * (1 + i % 3) * (config.upper_limit[i] - config.lower_limit[i]);
        input.q0[i] = q[i];
    }
    input.command = UPPER(COMMAND_POSITION);
    set_springs(400.0, 20.0);
}

/* Do steps; of every `lost` samples one is missing (0: none). */
static void run(int samples, int lost)
{
    for (int k = 0; k < samples; ++k) {
        input.counter += 1u;
        input.sample_valid = lost == 0 || k % lost != lost - 1;
        for (int i = 0; i < N; ++i) {
            const double wanted = 20.0 * (output.reference[i] - q[i]);
            dq[i] = state.memory.known ? wanted : 0.0;
            q[i] += 1e-3 * dq[i];
        }
        memcpy(input.q, q, sizeof q);
        memcpy(input.dq, dq, sizeof dq);
        ROBOT(impedance_step)(&config, &state, &input, &output);
    }
}

/* Command a pose that is `share` of the way through the joints' ranges. */
static void command_pose(double share)
{
    double posture[N];
    for (int i = 0; i < N; ++i) {
        posture[i] = config.lower_limit[i] + share * (config.upper_limit[i] - config.lower_limit[i]);
    }
    input.command = UPPER(COMMAND_EQUILIBRIUM);
    ROBOT(forward_kinematics)(posture, input.equilibrium);
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
    input.equilibrium[3] += 10.0; /* out of reach: refused */
    run(SAMPLES, 0);
    command_pose(1.0); /* in the corner of the limits */
    run(2 * SAMPLES, 7);
    input.command = UPPER(COMMAND_POSITION);
    run(SAMPLES, 0);
}

static void take_springs_away(void)
{
    set_springs(0.0, 0.0); /* from the first step on */
    memset(config.posture_stiffness, 0, sizeof config.posture_stiffness);
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
        ROBOT(impedance_step)(&config, &state, &input, &output);
    }
    input.counter += SAMPLES;
    ROBOT(impedance_reset)(&state);
    run(SAMPLES, 0);
    q[0] = config.upper_limit[0] + 1.0; /* a jump */
    run(SAMPLES, 0);
    config.sample_time = -1.0; /* refused */
    run(10, 0);
}

static void drive_motors(void)
{
    config.actuation = UPPER(ACTUATION_GAINS);
    go_by_poses();
}

static void difference_velocities(void)
{
    config.velocity_source = UPPER(VELOCITY_SOURCE_DIFFERENCED);
    config.position_quantum = 1e-5;
    config.velocity_filter_time = 2e-3;
    input.external_valid = 1;
    go_by_poses();
}

static void press(void)
{
    config.coriolis = UPPER(CORIOLIS_ON);
    config.delay_samples = 2;
    input.wrench_command[0] = 20.0;
    input.wrench_valid = 1;
    input.torque_offset[0] = 3.0;
    input.velocity[0] = 0.1;
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
}

static void propose(void)
{
    ROBOT(impedance_policy) policy;
    ROBOT(impedance_proposal) proposal;
    double pose[16], posture[N];
    ROBOT(forward_kinematics)(q, pose);
    ROBOT(impedance_policy_start)(&policy, pose, 0.0);
    policy.smoothing = 0.5;
    memset(&proposal, 0, sizeof proposal);
    ROBOT(impedance_init)(&config, &state, NULL);
    for (int k = 0; k < 3 * SAMPLES; ++k) {
        const double now = 1e-3 * k;
        if (k % 100 == 0 && k < 2 * SAMPLES) {
            for (int part = 0; part < UPPER(PART_GRIPPER) + 1; ++part) {
                proposal.valid[part] = 1;
                proposal.time[part] = now;
            }
            memcpy(proposal.equilibrium, pose, sizeof pose);
            proposal.equilibrium[3] += 0.01 * (k / 100 % 3);
            for (int i = 0; i < 6; ++i) {
                proposal.stiffness[7 * i] = k % 200 == 0 ? 0.0 : 100.0;
            }
            ROBOT(impedance_policy_propose)(&config, &policy, &proposal, now);
        }
        ROBOT(impedance_policy_command)(&policy, now, &input);
        run(1, 0);
    }
    ROBOT(find_posture)(&config, pose, input.q0, posture);
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
    {"gains", drive_motors},    {"differenced", difference_velocities},
    {"press", press},           {"refused", refuse_commands},
    {"policy", propose},        {"paper", follow_the_paper},
    {"self-check", check_controller},
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

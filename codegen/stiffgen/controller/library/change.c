/* Changes from outside: another tool, and torques that the caller adds. */
#include "impedance.h"

/*
 * Adopt another tool while engaged. The equilibrium goes with the tip, so that the springs keep their deflection; what
 * this costs is a move of the equilibrium. If the engagement cannot pay it, a smaller deflection stays.
 */
void adopt_tool(step_t *s)
{
    memory_t *const m = s->m;
    const double *const tool = stiffgen_tool(s->input);
    if (tool == NULL || memcmp(tool, m->tool_pose, sizeof m->tool_pose) == 0) {
        return;
    }
    const double left = larger(m->engagement - worst_feed_work(m, m->feed, m->call_gap), 0.0);
    double before[16 * TIPS], after[16 * TIPS], equilibrium[16 * TIPS], share = 1.0, rise = HUGE_VAL;
    memcpy(equilibrium, m->equilibrium, sizeof equilibrium);
    stiffgen_poses(m->q, m, before);
    memcpy(m->tool_pose, tool, sizeof m->tool_pose);
    s->has_jacobians = 0;
    stiffgen_poses(m->q, m, after);
    for (int attempt = 0; attempt < 4 && rise > left; ++attempt) {
        for (int t = 0; t < TIPS; ++t) {
            double away[6], twist[6] = {0.0};
            pose_difference(before + 16 * t, m->equilibrium + 16 * t, away);
            add_scaled(6, share, away, twist);
            move_pose(after + 16 * t, twist, equilibrium + 16 * t);
        }
        s->tip_energy = compute_tip_energy(m, m->q, equilibrium);
        rise = m->scale * add_posture_energy(m, m->q, m->posture, s->tip_energy) - m->elastic_energy;
        share = attempt < 2 ? 0.5 * share : 0.0;
    }
    memcpy(m->equilibrium, equilibrium, sizeof equilibrium);
    memset(m->equilibrium_velocity, 0, sizeof m->equilibrium_velocity);
    m->joined = 0;
    m->elastic_energy += rise;
    book_reference(s, rise);
}

/*
 * Take the caller's torque out of the last one: the energy account is about the controller's own. A torque in force at
 * the start is the caller's as far as it has the sign of `torque_offset` and is no larger, so that gravity counts once.
 */
void separate_torque_offset(step_t *s, double *last, int refused)
{
    memory_t *const m = s->m;
    const int starts = !refused && !m->known && m->fault == ID(FAULT_NONE) && s->input->sample_valid;
    for (int i = 0; i < N; ++i) {
        if (starts && fabs(s->input->torque_offset[i]) <= DBL_MAX) {
            m->offset[i] = clamp(s->input->torque_offset[i], smaller(last[i], 0.0), larger(last[i], 0.0));
        }
        last[i] -= m->offset[i];
    }
}

/*
 * Add the caller's torque to the controller's own. The own torque goes first in the rate limit, since the reserve
 * counts on its fall; the caller's goes first in the effort limit (limit_torque). Without a position the caller's
 * stays, and it goes to zero with a configuration that is refused.
 */
void add_torque_offset(step_t *s, const double *last, int refused)
{
    memory_t *const m = s->m;
    for (int i = 0; i < N; ++i) {
        const double own = s->out->torque[i], change = own - last[i], before = last[i] + m->offset[i];
        double wanted = refused ? 0.0 : m->offset[i];
        if (!refused && (s->believed || s->located) && fabs(s->input->torque_offset[i]) <= DBL_MAX) {
            wanted = s->input->torque_offset[i];
        }
        const double moved = clamp(wanted - m->offset[i], -m->rate[i] - change, m->rate[i] - change);
        const double most = refused ? s->effort[i] : larger(s->c->effort_limit[i], fabs(before) - m->rate[i]);
        const double total = clamp(own + m->offset[i] + moved, -most, most);
        m->offset[i] = total - own;
        const int reached = fabs(m->offset[i] - wanted) <= ROUNDED * larger(1.0, fabs(wanted));
        s->out->offset_torque[i] = m->offset[i];
        s->out->torque[i] = total;
        s->status |= reached ? 0u : (uint32_t)ID(STATUS_OFFSET_LIMITED);
    }
}

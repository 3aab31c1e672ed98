/* u = u0 - gain z within limits. z has the errors of the states, the commands before as differences
   from those of the goal, the latest first, and the integrals of errors. While a plan lasts, goal,
   u0 and gain are its own, without integrals; so they are while the motion settles about the start
   of the plan after a fall. Where inverse dynamics follow a plan, its inputs are those that its
   accelerations require, corrected by errors and their integrals. Tables of what is not used hold
   a 0. */
#include "controller.h"

@helpers@
enum {
    X = MODEL_STATES,
    U = CONTROLLER_INPUTS,
    P = CONTROLLER_PREVIOUS,
    I = CONTROLLER_INTEGRALS,
    A = CONTROLLER_PERIODIC,
    SETTLING = -1
};

@tables@
@required@
void controller_reset(controller *c)
{
    c->step = 0;
#if CONTROLLER_AHEAD
    c->has_motion = 0;
#endif
    for (int i = 0; i < P * U; i++)
        c->previous[i] = before[i % U];
    for (int i = 0; i < I; i++)
        c->integral[i] = R(0.0);
}

static void errors(const model_real x[], const model_real goal[], model_real z[])
{
    for (int i = 0; i < X; i++)
        z[i] = x[i] - goal[i];
    for (int i = 0; i < A; i++)
        z[periodic[i]] = wrapped(z[periodic[i]]);
}

@predict@/* Whether an error is beyond its bound; a bound of 0 is none. */
static int beyond(const model_real z[], const model_real bounds[])
{
    int found = 0;
    for (int i = 0; i < X; i++)
        found = found || (bounds[i] > R(0.0) && (z[i] < -bounds[i] || z[i] > bounds[i]));
    return found;
}

/* Goes on from the hold to settling, after a fall, and from there to the plan. */
static void choose_phase(controller *c, const model_real x[])
{
    model_real z[X];
    if (c->step == CONTROLLER_STEPS) {
        errors(x, x0, z);
        if (beyond(z, fallen_beyond)) {
            c->step = SETTLING;
            for (int i = 0; i < I; i++)
                c->integral[i] = R(0.0);
        }
    }
    if (c->step == SETTLING) {
        errors(x, plan_x, z);
        if (!beyond(z, settled_within))
            c->step = 0;
    }
}

#if CONTROLLER_ACCELERATES
/* The inputs that a period of the plan requires, with the accelerations that correct errors. */
static void follow(const model_real from[], const model_real z[], model_real u[])
{
    const model_real *to = from + X, *k = acceleration_gain;
    model_real x[X], a[U];
    for (int i = 0; i < X; i++)
        x[i] = (from[i] + to[i]) / R(2.0);
    for (int i = 0; i < U; i++)
        a[i] = (to[U + i] - from[U + i]) / MODEL_PERIOD - k[0] * z[i] - k[1] * z[U + i]
               - k[2] * z[X + i];
    required(x, a, u);
}
#endif

void controller_inputs(controller *c, const model_real x[], model_real u[])
{
    int known = 1, limited = 0;
    for (int i = 0; i < X; i++)
        known = known && isfinite(x[i]);
    if (CONTROLLER_RECOVERS && known)
        choose_phase(c, x);
    else if (CONTROLLER_RECOVERS && c->step < CONTROLLER_STEPS)
        c->step = SETTLING;
    const int k = c->step, settling = k == SETTLING;
    const int planned = !settling && k < CONTROLLER_STEPS, held = k == CONTROLLER_STEPS;
    const int integrates = held || (planned && CONTROLLER_ACCELERATES);
    const int size = integrates ? X + P * U + I : X + P * U;
    const model_real *goal = settling ? settle_x0 : planned ? plan_x + k * X : x0;
    const int tabled = planned && !CONTROLLER_ACCELERATES;
    const model_real *feed = settling ? settle_u0 : tabled ? plan_u + k * U : u0;
    const model_real *row = settling ? settle_gain : tabled ? plan_gain + k * U * size : gain;
    model_real z[X + P * U + I];
    int finite = known;
    errors(x, goal, z);
    for (int j = 0; j < P; j++) {
        const int then = k - 1 - j; /* the step of the plan at which it was commanded */
        const model_real *reference = !planned ? feed : then < 0 ? before : plan_u + then * U;
        for (int i = 0; i < U; i++)
            z[X + j * U + i] = c->previous[j * U + i] - reference[i];
    }
    for (int i = 0; i < I; i++)
        z[X + P * U + i] = c->integral[i];
#if CONTROLLER_ACCELERATES
    if (planned)
        follow(goal, z, u);
    else
#endif
        for (int i = 0; i < U; i++, row += size) {
            u[i] = feed[i];
            for (int j = 0; j < size; j++)
                u[i] -= row[j] * z[j];
        }
    for (int i = 0; i < U; i++) {
        finite = finite && isfinite(u[i]);
        limited = limited || u[i] < lower[i] || u[i] > upper[i];
        u[i] = u[i] < lower[i] ? lower[i] : u[i] > upper[i] ? upper[i] : u[i];
    }
    for (int i = 0; i < U && !finite; i++)
        u[i] = safe[i];
#if CONTROLLER_AHEAD
    if (finite && !settling)
        plan_ahead(c, x, k, u);
    else
        c->has_motion = 0;
#endif
    if (integrates && finite && !limited)
        for (int i = 0; i < I; i++)
            c->integral[i] += MODEL_PERIOD * z[integrated[i]];
    for (int i = P * U - 1; i >= U; i--)
        c->previous[i] = c->previous[i - U];
    for (int i = 0; i < U && P > 0; i++)
        c->previous[i] = u[i];
    c->step = planned && known ? k + 1 : k;
}

/* u = u0 - gain z within limits. z has the errors of the states, the integrals of errors, and the
   inputs before, as differences from u0, the latest first. x0, u0 and the gain are those of the
   plan while it lasts, then those of the goal. Tables of a part that is not used hold a 0. */
#include "controller.h"

@helpers@
enum {
    X = MODEL_STATES,
    U = CONTROLLER_INPUTS,
    I = CONTROLLER_INTEGRALS,
    P = CONTROLLER_PREVIOUS,
    A = CONTROLLER_PERIODIC,
    Z = X + I + P * U
};

@tables@
void controller_reset(controller *c)
{
    c->step = 0;
    for (int i = 0; i < I; i++)
        c->integral[i] = R(0.0);
    for (int i = 0; i < P * U; i++)
        c->previous[i] = u0[i % U];
}

void controller_inputs(controller *c, const model_real x[], model_real u[])
{
    const int k = c->step;
    const int planned = k < CONTROLLER_STEPS;
    const model_real *goal = planned ? plan_x + k * X : x0;
    const model_real *feed = planned ? plan_u + k * U : u0;
    const model_real *row = planned ? plan_gain + k * U * Z : gain;
    model_real z[Z];
    for (int i = 0; i < X; i++)
        z[i] = x[i] - goal[i];
    for (int i = 0; i < A; i++)
        z[periodic[i]] = wrapped(z[periodic[i]]);
    for (int i = 0; i < I; i++)
        z[X + i] = c->integral[i];
    for (int i = 0; i < P * U; i++)
        z[X + I + i] = c->previous[i] - u0[i % U];
    for (int i = 0; i < U; i++) {
        model_real sum = feed[i];
        for (int j = 0; j < Z; j++)
            sum -= row[i * Z + j] * z[j];
        u[i] = sum < lower[i] ? lower[i] : sum > upper[i] ? upper[i] : sum;
    }
    for (int i = 0; i < I; i++)
        c->integral[i] += MODEL_PERIOD * z[integrated[i]];
    for (int i = P * U - 1; i >= U; i--)
        c->previous[i] = c->previous[i - U];
    for (int i = 0; i < U && P > 0; i++)
        c->previous[i] = u[i];
    c->step = planned ? k + 1 : k;
}

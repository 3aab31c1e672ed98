#include "fmu.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const int offsets[FMU_SAMPLES] = {@offsets@};
static const double parameters[FMU_PARAMETERS + 1] = {@values@};

void fmu_reset(fmu_memory *m)
{
    memset(m, 0, sizeof *m);
}

const double *fmu_variable(const fmu_memory *m, unsigned int reference)
{
    const unsigned int time = MODEL_STATES + FMU_INPUTS;
    if (reference < MODEL_STATES)
        return &m->state.x[reference];
    if (reference < time)
        return &m->input[reference - MODEL_STATES];
    if (reference == time)
        return &m->time;
    return reference <= time + FMU_PARAMETERS ? &parameters[reference - time - 1] : NULL;
}

const char *fmu_set(fmu_memory *m, unsigned int reference, double value)
{
    if (reference >= MODEL_STATES + FMU_INPUTS)
        return fmu_variable(m, reference) ? "time and parameters are not set: parameters are constants "
                                            "of the model"
                                          : "there is no such variable to set";
    if (reference < MODEL_STATES && m->running)
        return "states are set before the end of the initialisation";
    if (reference < MODEL_STATES) {
        m->state.x[reference] = value;
    } else {
        m->input[reference - MODEL_STATES] = value;
        m->slope[reference - MODEL_STATES] = 0.0;
    }
    return NULL;
}

const char *fmu_set_slope(fmu_memory *m, unsigned int reference, double value)
{
    if (reference < MODEL_STATES || reference >= MODEL_STATES + FMU_INPUTS)
        return "there is no such input";
    m->slope[reference - MODEL_STATES] = value;
    return NULL;
}

const char *fmu_keep(const void *memory, void **state)
{
    if (*state == NULL)
        *state = malloc(sizeof(fmu_memory));
    if (*state == NULL)
        return "no memory for a state";
    memcpy(*state, memory, sizeof(fmu_memory));
    return NULL;
}

/* An input some periods after the communication point. */
static double input_at(const fmu_memory *m, int i, double periods)
{
    return m->input[i] + m->slope[i] * (periods * MODEL_PERIOD);
}

/* What a step is given that began with the period, `now` periods after the communication point.
   Equations see the inputs as they are; a step of a whole period sees the mean over it, as if the
   inputs stayed as they are. */
static void gather(const fmu_memory *m, double now, double u[])
{
    for (int s = 0; s < FMU_SAMPLES; s++)
        for (int i = 0; i < FMU_INPUTS; i++) {
            double *to = &u[s * FMU_INPUTS + i];
            if (offsets[s] < 0)
                *to = m->past[(-offsets[s] - 1) * FMU_INPUTS + i];
            else if (FMU_INTEGRATES || offsets[s] > 0)
                *to = input_at(m, i, now + offsets[s] - m->share);
            else
                *to = m->given[i] + (1.0 - m->share) * input_at(m, i, now);
        }
}

/* Puts inputs before those that are known already. */
static void remember(fmu_memory *m, const double inputs[])
{
    for (int k = FMU_PAST * FMU_INPUTS - 1; k >= FMU_INPUTS; k--)
        m->past[k] = m->past[k - FMU_INPUTS];
    for (int i = 0; i < FMU_INPUTS && FMU_PAST > 0; i++)
        m->past[i] = inputs[i];
}

#if FMU_INTEGRATES
static void move(fmu_memory *m, const double u[], double end)
{
    const double length = end - m->share;
    if (length >= 1.0)
        model_step(&m->state, u);
    else
        model_advance(&m->state, u, m->share, length);
}
#else
/* To the state at a part of the period: positions are cubic in time, with the velocities at both
   ends, all others are straight lines. */
static void move(fmu_memory *m, const double u[], double end)
{
    const double *from = m->begin.x;
    model_state to = m->begin;
    model_step(&to, u);
    for (int i = 0; i < MODEL_STATES && end < 1.0; i++) {
        const double rise = to.x[i] - from[i], rest = 1.0 - end;
        double bend = 0.0;
        if (i < MODEL_POSITIONS)
            bend = rest * (MODEL_PERIOD * from[MODEL_POSITIONS + i] - rise)
                   + end * (rise - MODEL_PERIOD * to.x[MODEL_POSITIONS + i]);
        m->state.x[i] = from[i] + end * (rise + rest * bend);
    }
    if (end >= 1.0)
        m->state = to;
}
#endif

/* Goes on within a period, to a part of it. */
static void go_on(fmu_memory *m, double now, double end)
{
    double u[MODEL_INPUTS + 1];
    gather(m, now, u);
    move(m, u, end);
    for (int i = 0; i < FMU_INPUTS; i++)
        m->given[i] += (end - m->share) * input_at(m, i, now);
    m->share = end;
    if (end < 1.0)
        return;
    remember(m, m->given);
    memset(m->given, 0, sizeof m->given);
    m->share = 0.0;
    m->begin = m->state;
}

const char *fmu_step(fmu_memory *m, double time, double size)
{
    double periods = size / MODEL_PERIOD;
    const double whole = floor(periods + 0.5);
    if (!m->running)
        return "a step before the end of the initialisation";
    if (!(periods > 0.0 && isfinite(periods)))
        return "the communication step is no positive number";
    if (whole >= 1.0 && fabs(periods - whole) <= 1e-6)
        periods = whole;
    if (!m->stepped) {
        /* before the first step inputs were as they are then */
        for (int k = 0; k < FMU_PAST; k++)
            remember(m, m->input);
        m->begin = m->state;
        m->stepped = 1;
    }
    for (double now = 0.0; periods - now > FMU_INSTANT;) {
        const double left = periods - now, rest = 1.0 - m->share;
        const int is_whole = left > rest - FMU_INSTANT;
        go_on(m, now, is_whole ? 1.0 : m->share + left);
        now += is_whole ? rest : left;
    }
    m->time = time + size;
    return NULL;
}

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

/* An input at a sample that is `ahead` periods later than the communication point. */
static double sample(const fmu_memory *m, int i, double ahead)
{
    return m->input[i] + m->slope[i] * (ahead * MODEL_PERIOD);
}

/* What a step is given that begins `turn` periods after the communication point. */
static void gather(const fmu_memory *m, double turn, double u[])
{
    for (int s = 0; s < FMU_SAMPLES; s++)
        for (int i = 0; i < FMU_INPUTS; i++) {
            const int offset = offsets[s];
            u[s * FMU_INPUTS + i] = offset < 0 ? m->past[(-offset - 1) * FMU_INPUTS + i]
                                               : sample(m, i, turn + offset);
        }
}

/* Puts the inputs of a sample before those that are known already. */
static void remember(fmu_memory *m, double turn)
{
    for (int k = FMU_PAST * FMU_INPUTS - 1; k >= FMU_INPUTS; k--)
        m->past[k] = m->past[k - FMU_INPUTS];
    for (int i = 0; i < FMU_INPUTS && FMU_PAST > 0; i++)
        m->past[i] = sample(m, i, turn);
}

const char *fmu_step(fmu_memory *m, double time, double size)
{
    double u[MODEL_INPUTS + 1];
    const double periods = size / MODEL_PERIOD, whole = floor(periods + 0.5);
    if (!m->running)
        return "a step before the end of the initialisation";
    if (!(fabs(periods - whole) <= 1e-6 && whole >= 1.0))
        return "the communication step is no whole multiple of the model's period, @period@ s";
    /* before the first step inputs were as they are then */
    for (int k = 0; k < FMU_PAST && !m->stepped; k++)
        remember(m, 0.0);
    m->stepped = 1;
    for (double turn = 0.0; turn < whole; turn += 1.0) {
        gather(m, turn, u);
        remember(m, turn);
        model_step(&m->state, u);
    }
    m->time = time + size;
    return NULL;
}

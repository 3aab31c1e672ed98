/* What both versions of FMI have in common: one instance and its variables. */
#ifndef FMU_H
#define FMU_H

#include "model.h"

#ifdef MODEL_FLOAT
#error "an FMU computes in double precision"
#endif

#ifdef _WIN32
#define FMU_EXPORT __declspec(dllexport)
#else
#define FMU_EXPORT
#endif

#define FMU_TOKEN "@token@"
#define FMU_INPUTS @inputs@
#define FMU_SAMPLES @samples@ /* that a step sees of the inputs */
#define FMU_PARAMETERS @parameters@ /* constants of the model */
#define FMU_PAST @past@ /* of them at most so many before its beginning */
#define FMU_INTEGRATES @integrates@ /* whether equations are integrated over any time */
#define FMU_INSTANT 1e-9 /* periods; rounding of times, no more */

/* Everything that changes; copied as a whole where a state of the FMU is taken or put back. */
typedef struct fmu_memory {
    model_state state;
    double input[FMU_INPUTS + 1];
    double slope[FMU_INPUTS + 1]; /* of the inputs in time; 0 where nobody tells */
    double past[FMU_PAST * FMU_INPUTS + 1]; /* means over the periods before, the last one first */
    double given[FMU_INPUTS + 1]; /* the inputs' part in the mean over the period that goes on */
    double share;                 /* of that period that is over */
    model_state begin;            /* the state in which it began */
    double time;
    int stepped; /* whether there was a step */
    int running; /* whether initialisation is over */
} fmu_memory;

/* All at 0. */
void fmu_reset(fmu_memory *m);

/* States come first, then the inputs, time, parameters; NULL for what there is not. */
const double *fmu_variable(const fmu_memory *m, unsigned int reference);

/* Sets one; NULL, or why it cannot be set. States are set before the simulation only. */
const char *fmu_set(fmu_memory *m, unsigned int reference, double value);

/* How fast an input changes from now on; NULL, or why that cannot be told. */
const char *fmu_set_slope(fmu_memory *m, unsigned int reference, double value);

/* Copies a memory to a state, which is allocated where it is NULL; NULL, or why it cannot be. */
const char *fmu_keep(const void *memory, void **state);

/* Steps on by any time; NULL, or why there is no such step. Nothing has changed then. */
const char *fmu_step(fmu_memory *m, double time, double size);

#endif

/* A controller: inputs from the estimated state, at every sample. README.md has what x and u are. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "model.h"

#define CONTROLLER_INPUTS @inputs@
#define CONTROLLER_INTEGRALS @integrals@ /* of errors of positions */
#define CONTROLLER_PREVIOUS @previous@ /* samples of commands before, on which it depends */
#define CONTROLLER_PERIODIC @periodic@ /* angles whose errors are wrapped */
#define CONTROLLER_STEPS @steps@ /* of the plan that is followed first; 0 without a plan */
#define CONTROLLER_RECOVERS @recovers@ /* 1 where the plan begins again after a fall */
#define CONTROLLER_ACCELERATES @accelerates@ /* 1 where inverse dynamics follow the plan */
#define CONTROLLER_AHEAD @ahead@ /* steps that predictive control looks ahead; 0 without it */

#ifdef __cplusplus
extern "C" {
#endif

#if CONTROLLER_AHEAD
#define CONTROLLER_ALL (MODEL_STATES + CONTROLLER_PREVIOUS * CONTROLLER_INPUTS)

typedef struct predicted {
    model_real z[(CONTROLLER_AHEAD + 1) * CONTROLLER_ALL]; /* states, and commands before them */
    model_real u[CONTROLLER_AHEAD * CONTROLLER_INPUTS];
    model_real cost;
} predicted;
#endif

typedef struct controller {
    int step; /* of the plan; at its end the goal is held; -1: settling after a fall */
    model_real integral[CONTROLLER_INTEGRALS + 1];
    model_real previous[CONTROLLER_PREVIOUS * CONTROLLER_INPUTS + 1];
#if CONTROLLER_AHEAD
    predicted motion; /* planned at the last sample, with feedback about it */
    model_real gains[CONTROLLER_AHEAD * CONTROLLER_INPUTS * CONTROLLER_ALL];
    int has_motion;
#endif
} controller;

/* Begins anew: with the plan, where there is one. */
void controller_reset(controller *c);

/* The inputs u that are commanded at this sample, from the estimated state x; the safe ones where x
   is not finite. Then integrals stay as they are and a plan waits; one that begins again after a
   fall does so. */
void controller_inputs(controller *c, const model_real x[], model_real u[]);

#ifdef __cplusplus
}
#endif

#endif

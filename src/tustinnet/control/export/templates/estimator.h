/* An estimator of the state: an extended Kalman filter of measured positions, with its noise. */
#ifndef ESTIMATOR_H
#define ESTIMATOR_H

#include "model.h"

#define ESTIMATOR_INPUTS @inputs@ /* of a sample; MODEL_INPUTS are those of all samples of a step */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct estimator {
    model_real x[MODEL_STATES]; /* the estimated state; NaN while it is lost */
    model_estimate filter;
    model_real inputs[MODEL_INPUTS]; /* commanded now, a sample before, and so on */
} estimator;

/* Begins at the first measurement y, at rest. */
void estimator_reset(estimator *e, const model_real y[]);

/* Takes a new measurement y, whatever it is, and the inputs u that were commanded at the last one. The model knows
   when they act. */
void estimator_update(estimator *e, const model_real y[], const model_real u[]);

/* Puts the inputs u of this sample before those of the samples before, for `model_step`. */
void estimator_remember(model_real inputs[], const model_real u[]);

#ifdef __cplusplus
}
#endif

#endif

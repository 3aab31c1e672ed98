/* u = u0 - gain z within limits, z: errors of the states, integrals, inputs before. */
#include "controller.h"

@helpers@
enum { X = MODEL_STATES, U = CONTROLLER_INPUTS, I = CONTROLLER_INTEGRALS, P = CONTROLLER_PREVIOUS };
enum { Z = X + I + P * U };

@tables@

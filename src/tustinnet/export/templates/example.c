/* The model runs free, and a filter follows it that is told its positions only. */
#include <stdio.h>

#include "model.h"

enum { STEPS = 100 };

static void print(const char *name, const model_real x[])
{
    printf("%s", name);
    for (int i = 0; i < MODEL_STATES; i++)
        printf(" % .6f", (double)x[i]);
    printf("\n");
}

int main(void)
{
    model_state model;
    model_estimate estimate;
    model_real x0[MODEL_STATES] = {0}, zero[MODEL_STATES] = {0}, u[MODEL_INPUTS + 1] = {0};
    model_real start[MODEL_STATES], process[MODEL_STATES], noise[MODEL_POSITIONS];
    for (int i = 0; i < MODEL_STATES; i++) {
        x0[i] = i < MODEL_POSITIONS ? MODEL_NUMBER(0.1) : MODEL_NUMBER(0.0);
        start[i] = MODEL_NUMBER(1.0);
        process[i] = MODEL_NUMBER(1e-3);
    }
    for (int i = 0; i < MODEL_POSITIONS; i++)
        noise[i] = MODEL_NUMBER(1e-3);
    model_init(&model, x0);
    model_estimate_init(&estimate, zero, start, process, noise);
    for (int k = 0; k < STEPS; k++) {
        model_estimate_correct(&estimate, model.x);
        if (k % 10 == 0) {
            printf("%g s\n", (double)(MODEL_PERIOD * (model_real)k));
            print("  model   ", model.x);
            print("  estimate", estimate.state.x);
        }
        model_step(&model, u); /* u: what acts now */
        model_estimate_predict(&estimate, u);
    }
    return 0;
}

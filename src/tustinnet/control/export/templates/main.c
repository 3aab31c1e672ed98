/* The loop closed in software: the model is the device, encoders read its positions.

   Prints CSV: time, the states of the device, the estimated states, the inputs. On a bench the
   two functions read the encoders and drive the motors. */
#include <math.h>
#include <stdio.h>

#include "controller.h"
#include "estimator.h"

@precision@
enum { STEPS = @steps@ };

@tables@
static struct {
    model_state state;
    model_real inputs[MODEL_INPUTS];
} device;

/* The positions, as the encoders read them. */
static void measure(model_real y[])
{
    for (int i = 0; i < MODEL_POSITIONS; i++) {
        y[i] = device.state.x[i];
        if (resolution[i] > R(0.0))
            y[i] = resolution[i] * M(rint)(y[i] / resolution[i]);
    }
}

/* The inputs act until the next sample. */
static void apply(const model_real u[])
{
    estimator_remember(device.inputs, u);
    model_step(&device.state, device.inputs);
}

static void print(const model_real values[], int count)
{
    for (int i = 0; i < count; i++)
        printf(",%.17g", (double)values[i]);
}

int main(void)
{
    estimator e;
    controller c;
    model_real y[MODEL_POSITIONS], u[CONTROLLER_INPUTS];
    model_init(&device.state, start);
    measure(y);
    estimator_reset(&e, y);
    controller_reset(&c);
    puts(@header@);
    for (int k = 0; k < STEPS; k++) {
        controller_inputs(&c, e.x, u);
        printf("%.17g", (double)MODEL_PERIOD * k);
        print(device.state.x, MODEL_STATES);
        print(e.x, MODEL_STATES);
        print(u, CONTROLLER_INPUTS);
        printf("\n");
        apply(u);
        measure(y);
        estimator_update(&e, y, u);
    }
    return 0;
}

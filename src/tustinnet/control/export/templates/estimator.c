
/* Standard deviations: of the state at the start, of what a step misses, of the positions. */
@noise@
/* The state at a measurement, at rest. */
@start@
void estimator_reset(estimator *e, const model_real y[])
{
    model_real x[MODEL_STATES];
    start_state(y, x);
    model_estimate_init(&e->filter, x, start_noise, process_noise, measurement_noise);
    for (int i = 0; i < MODEL_INPUTS; i++)
        e->inputs[i] = MODEL_NUMBER(0.0);
    model_estimate_correct(&e->filter, y);
}

void estimator_update(estimator *e, const model_real y[], const model_real u[])
{
    estimator_remember(e->inputs, u);
    model_estimate_predict(&e->filter, e->inputs);
    model_estimate_correct(&e->filter, y);
}

void estimator_remember(model_real inputs[], const model_real u[])
{
    for (int i = MODEL_INPUTS - 1; i >= ESTIMATOR_INPUTS; i--)
        inputs[i] = inputs[i - ESTIMATOR_INPUTS];
    for (int i = 0; i < ESTIMATOR_INPUTS; i++)
        inputs[i] = u[i];
}

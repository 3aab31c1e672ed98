
/* Standard deviations: of the state at the start, of what a step misses, of the positions. */
@noise@
static void correct(estimator *e, const model_real y[])
{
    model_estimate_correct(&e->filter, y);
    for (int i = 0; i < MODEL_STATES; i++)
        e->x[i] = e->filter.missed < 0 ? (model_real)NAN : e->filter.state.x[i];
}

/* The state at the first measurement, at rest. */
void estimator_reset(estimator *e, const model_real y[])
{
    model_state s;
    model_rest(&s, y);
    model_estimate_init(&e->filter, s.x, start_noise, process_noise, measurement_noise);
    for (int i = 0; i < MODEL_INPUTS; i++)
        e->inputs[i] = R(0.0);
    correct(e, y);
}

void estimator_update(estimator *e, const model_real y[], const model_real u[])
{
    estimator_remember(e->inputs, u);
    model_estimate_predict(&e->filter, e->inputs);
    correct(e, y);
}

void estimator_remember(model_real inputs[], const model_real u[])
{
    for (int i = MODEL_INPUTS - 1; i >= ESTIMATOR_INPUTS; i--)
        inputs[i] = inputs[i - ESTIMATOR_INPUTS];
    for (int i = 0; i < ESTIMATOR_INPUTS; i++)
        inputs[i] = u[i];
}

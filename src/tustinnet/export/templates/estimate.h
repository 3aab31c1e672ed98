/* The same, into `next`, with its derivatives by rows: a (MODEL_STATES, MODEL_STATES) by the state,
   b (MODEL_STATES, MODEL_INPUTS) by the inputs. */
void model_linearise(const model_state *s, const model_real u[], model_state *next,
                     model_real a[], model_real b[]);

/* An extended Kalman filter (estimate.c), of measured positions. Variances are kept in it: of the
   estimate, of what the model misses in a step, of the measurement. */
typedef struct model_estimate {
    model_state state;
    model_real covariance[MODEL_STATES * MODEL_STATES];
    model_real process[MODEL_STATES];
    model_real noise[MODEL_POSITIONS];
} model_estimate;

/* Standard deviations: of x0, of what a step misses, of the measured positions. */
void model_estimate_init(model_estimate *e, const model_real x0[], const model_real start[],
                         const model_real process[], const model_real noise[]);

/* At every sample: what was measured, then the step to the next one. */
void model_estimate_correct(model_estimate *e, const model_real q[]);
void model_estimate_predict(model_estimate *e, const model_real u[]);


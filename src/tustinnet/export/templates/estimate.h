/* The same, into `next`, with its derivatives by rows: a (MODEL_STATES, MODEL_STATES) by the state,
   b (MODEL_STATES, MODEL_INPUTS) by the inputs. */
void model_linearise(const model_state *s, const model_real u[], model_state *next,
                     model_real a[], model_real b[]);

/* The state at rest at some positions, with the internal states that the model expects. */
void model_rest(model_state *s, const model_real q[]);

#ifndef MODEL_LOST_AFTER
#define MODEL_LOST_AFTER @lost_after@ /* samples in a row without use after which an estimate is lost */
#endif

/* An extended Kalman filter (estimate.c), of measured positions. Variances are kept in it: of the
   estimate, at the start, of what the model misses in a step, of the measurement. */
typedef struct model_estimate {
    model_state state;
    model_real covariance[MODEL_STATES * MODEL_STATES];
    model_real start[MODEL_STATES];
    model_real process[MODEL_STATES];
    model_real noise[MODEL_POSITIONS];
    int missed;      /* samples in a row that were not used; below 0 the estimate is lost */
    unsigned unused; /* all samples that were not used */
} model_estimate;

/* Standard deviations: of x0, of what a step misses, of the measured positions. */
void model_estimate_init(model_estimate *e, const model_real x0[], const model_real start[],
                         const model_real process[], const model_real noise[]);

/* At every sample: what was measured, then the step to the next one. A position that is not finite,
   or farther from what is expected than `gate` of its standard deviations, is not used. After
   MODEL_LOST_AFTER such samples in a row the filter begins anew, at rest at what is measured;
   `missed` is below 0 until as many samples in a row were used. */
void model_estimate_correct(model_estimate *e, const model_real q[]);
void model_estimate_predict(model_estimate *e, const model_real u[]);


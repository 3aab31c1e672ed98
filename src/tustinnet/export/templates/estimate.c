/* An extended Kalman filter: the states that the model has, from measured positions.

   @angles@ */
#include "@header@"
@helpers@
enum { N = MODEL_STATES };

void model_estimate_init(model_estimate *e, const model_real x0[], const model_real start[],
                         const model_real process[], const model_real noise[])
{
    model_init(&e->state, x0);
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++)
            e->covariance[i * N + j] = MODEL_NUMBER(0.0);
        e->covariance[i * N + i] = start[i] * start[i];
        e->process[i] = process[i] * process[i];
    }
    for (int i = 0; i < MODEL_POSITIONS; i++)
        e->noise[i] = noise[i] * noise[i];
}

/* P = A P A' + Q; one half is computed, the other is the same. */
void model_estimate_predict(model_estimate *e, const model_real u[])
{
    model_state next;
    model_real a[N * N], b[N * MODEL_INPUTS + 1], ap[N * N];
    model_linearise(&e->state, u, &next, a, b);
    e->state = next;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            model_real sum = MODEL_NUMBER(0.0);
            for (int k = 0; k < N; k++)
                sum += a[i * N + k] * e->covariance[k * N + j];
            ap[i * N + j] = sum;
        }
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            model_real sum = i == j ? e->process[i] : MODEL_NUMBER(0.0);
            for (int k = 0; k < N; k++)
                sum += ap[i * N + k] * a[j * N + k];
            e->covariance[i * N + j] = sum;
            e->covariance[j * N + i] = sum;
        }
}

/* One position after the other. P = (1 - k h) P (1 - k h)' + k r k', which stays symmetric and
   positive in single precision too. */
void model_estimate_correct(model_estimate *e, const model_real q[])
{
    model_real *p = e->covariance;
    for (int m = 0; m < MODEL_POSITIONS; m++) {
        const model_real spread = p[m * N + m] + e->noise[m];
        const model_real missed = @missed@;
        model_real row[N], gain[N];
        for (int i = 0; i < N; i++) {
            row[i] = p[m * N + i];
            gain[i] = row[i] / spread;
        }
        for (int i = 0; i < N; i++) {
            e->state.x[i] += gain[i] * missed;
            for (int j = 0; j <= i; j++) {
                const model_real after = p[i * N + j] - gain[i] * row[j] - gain[j] * row[i]
                                         + gain[i] * gain[j] * spread;
                p[i * N + j] = after;
                p[j * N + i] = after;
            }
        }
    }
}

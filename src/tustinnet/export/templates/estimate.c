/* An extended Kalman filter: the states that the model has, from measured positions.

   @angles@ */
#include "@header@"
@helpers@
enum { N = MODEL_STATES, Q = MODEL_POSITIONS };

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "samples that are not finite have to be found: compile without -ffast-math"
#endif

static const model_real gate = R(@gate@); /* standard deviations; beyond them nothing is possible */

/* The covariance at the start, of a device that got its speed so long ago. */
static void forget(model_estimate *e, model_real ago)
{
    model_real *p = e->covariance;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
            p[i * N + j] = i == j ? e->start[i] : R(0.0);
    for (int m = 0; m < Q; m++) {
        p[m * N + m] += ago * ago * e->start[Q + m];
        p[m * N + Q + m] = p[(Q + m) * N + m] = ago * e->start[Q + m];
    }
}

/* Whether it is a number that can tell differences as small as the gate. */
static int is_readable(model_real q, model_real variance)
{
    return isfinite(q) && q + gate * M(sqrt)(variance) != q;
}

void model_estimate_init(model_estimate *e, const model_real x0[], const model_real start[],
                         const model_real process[], const model_real noise[])
{
    model_init(&e->state, x0);
    for (int i = 0; i < N; i++) {
        e->start[i] = start[i] * start[i];
        e->process[i] = process[i] * process[i];
    }
    for (int m = 0; m < Q; m++)
        e->noise[m] = noise[m] * noise[m];
    forget(e, R(0.0));
    e->missed = -1; /* the first sample finds it */
    e->unused = 0;
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

/* Counts a sample, and begins anew where the estimate is lost. */
static void count(model_estimate *e, const model_real q[], int used)
{
    model_real known[Q];
    int finite = 1;
    for (int i = 0; i < N; i++)
        finite = finite && isfinite(e->state.x[i]);
    for (int i = 0; i < N * N; i++)
        finite = finite && isfinite(e->covariance[i]);
    if (used && finite) {
        e->missed = e->missed < 0 ? e->missed + 1 : 0;
        return;
    }
    e->unused++;
    if (finite && e->missed >= 0 && e->missed + 1 < MODEL_LOST_AFTER) {
        e->missed++;
        return;
    }
    e->missed = -MODEL_LOST_AFTER;
    for (int m = 0; m < Q; m++)
        known[m] = is_readable(q[m], e->noise[m]) ? q[m] : R(0.0);
    model_rest(&e->state, known);
    forget(e, R(0.0));
}

/* One position after the other. P = (1 - k h) P (1 - k h)' + k r k', which stays symmetric and
   positive in single precision too. After what is impossible either the encoder errs or something
   pushed the device in the last period: the next sample decides. */
void model_estimate_correct(model_estimate *e, const model_real q[])
{
    model_real *p = e->covariance;
    int used = 1;
    for (int m = 0; m < Q; m++) {
        if (!is_readable(q[m], e->noise[m])) {
            used = 0;
            continue;
        }
        const model_real spread = p[m * N + m] + e->noise[m], bound = gate * M(sqrt)(spread);
        const model_real innovation = @innovation@;
        if (!(innovation >= -bound && innovation <= bound)) {
            used = 0;
            forget(e, MODEL_PERIOD);
            continue;
        }
        model_real row[N], gain[N];
        for (int i = 0; i < N; i++) {
            row[i] = p[m * N + i];
            gain[i] = row[i] / spread;
        }
        for (int i = 0; i < N; i++) {
            e->state.x[i] += gain[i] * innovation;
            for (int j = 0; j <= i; j++) {
                const model_real after = p[i * N + j] - gain[i] * row[j] - gain[j] * row[i]
                                         + gain[i] * gain[j] * spread;
                p[i * N + j] = after;
                p[j * N + i] = after;
            }
        }
    }
    count(e, q, used);
}

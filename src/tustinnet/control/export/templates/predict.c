/* Predictive control, the same as `tustinnet.control.Mpc`: a motion some steps ahead that follows the
   goal or the plan, improved by iterative LQR with limits of the inputs. z has the states, then the
   commands before, the latest first. */
enum {
    N = CONTROLLER_AHEAD,
    Z = CONTROLLER_ALL,
    V = Z + U,
    ITERATIONS = @iterations@, /* at every sample */
    SWEEPS = U > 1 ? @sweeps@ : 1
};

@tables@
/* What is followed at a step: states, inputs, and the inputs some samples before. */
static const model_real *followed_x(int step)
{
    return step < CONTROLLER_STEPS ? plan_x + step * X : goal_x;
}

static const model_real *followed_u(int step)
{
    return step < 0 ? before : step < CONTROLLER_STEPS ? plan_u + step * U : u0;
}

/* What a state is beyond its limits, with its sign. */
static model_real excess(int i, model_real x)
{
    return x > most[i] ? x - most[i] : x < least[i] ? x - least[i] : R(0.0);
}

static void samples_of(const model_real z[], const model_real u[], model_real samples[])
{
    for (int i = 0; i < U; i++)
        samples[i] = u[i];
    for (int i = 0; i < P * U; i++)
        samples[U + i] = z[X + i];
}

/* The state z one period after a command. */
static void go_on(const model_real z[], const model_real u[], model_real after[])
{
    model_state s;
    model_real samples[MODEL_INPUTS];
    samples_of(z, u, samples);
    model_init(&s, z);
    model_step(&s, samples);
    for (int i = 0; i < X; i++)
        after[i] = s.x[i];
    for (int i = 0; i < P * U; i++)
        after[X + i] = samples[i];
}

/* Derivatives of the state one period later by [z, u], (Z, V). */
static void derive(const model_real z[], const model_real u[], model_real d[])
{
    model_state s, next;
    model_real samples[MODEL_INPUTS], a[X * X], b[X * MODEL_INPUTS];
    samples_of(z, u, samples);
    model_init(&s, z);
    model_linearise(&s, samples, &next, a, b);
    for (int i = 0; i < Z * V; i++)
        d[i] = R(0.0);
    for (int i = 0; i < X; i++) {
        for (int j = 0; j < X; j++)
            d[i * V + j] = a[i * X + j];
        for (int j = 0; j < MODEL_INPUTS; j++)
            d[i * V + (j < U ? Z + j : X + j - U)] = b[i * MODEL_INPUTS + j];
    }
    for (int i = 0; i < P * U; i++)
        d[(X + i) * V + (i < U ? Z + i : X + i - U)] = R(1.0);
}

/* The error of the last state, the matrix of its cost, and their product. */
static const model_real *end_of(const predicted *m, int step, model_real error[], model_real slope[])
{
    const int last = step + N < CONTROLLER_STEPS ? step + N : CONTROLLER_STEPS;
    const model_real *matrix = ends + last * Z * Z, *z = m->z + N * Z;
    for (int i = 0; i < Z; i++)
        error[i] = z[i] - (i < X ? followed_x(last)[i] : followed_u(step + N - 1)[(i - X) % U]);
    for (int i = 0; i < Z; i++) {
        slope[i] = R(0.0);
        for (int j = 0; j < Z; j++)
            slope[i] += matrix[i * Z + j] * error[j];
    }
    return matrix;
}

/* The cost of a motion: half of the sum of weighted squares; infinite where it is no number. */
static model_real cost_of(const predicted *m, int step)
{
    model_real error[Z], slope[Z], sum = R(0.0);
    for (int k = 0; k <= N; k++) {
        const model_real *x = m->z + k * Z, *u = m->u + k * U;
        for (int i = 0; i < X; i++) {
            const model_real e = x[i] - followed_x(step + k)[i], beyond_limit = excess(i, x[i]);
            sum += penalty[i] * beyond_limit * beyond_limit;
            sum += k < N ? state_weight[i] * e * e : R(0.0);
        }
        for (int i = 0; i < U && k < N; i++) {
            const model_real e = u[i] - followed_u(step + k)[i];
            sum += input_weight[i] * e * e;
        }
    }
    end_of(m, step, error, slope);
    for (int i = 0; i < Z; i++)
        sum += error[i] * slope[i];
    return isfinite(sum) ? sum / R(2.0) : (model_real)INFINITY;
}

/* The motion from m->z by feedback about another one, with a share of a change of its inputs. */
static void roll_out(const predicted *about, const model_real gains[], const model_real change[],
                     model_real share, int step, predicted *m)
{
    for (int k = 0; k < N; k++) {
        const model_real *z = m->z + k * Z, *row = gains + k * U * Z;
        model_real *u = m->u + k * U;
        for (int i = 0; i < U; i++, row += Z) {
            u[i] = about->u[k * U + i] + share * change[k * U + i];
            for (int j = 0; j < Z; j++)
                u[i] += row[j] * (z[j] - about->z[k * Z + j]);
            u[i] = u[i] < lower[i] ? lower[i] : u[i] > upper[i] ? upper[i] : u[i];
        }
        go_on(z, u, m->z + (k + 1) * Z);
    }
    m->cost = cost_of(m, step);
}

/* Solves m x = right for some right sides; m, which is lost, is symmetric and positive definite. */
static void solve(model_real m[U * U], model_real right[U * (Z + 1)])
{
    for (int i = 0; i < U; i++)
        for (int k = i + 1; k < U; k++) {
            const model_real factor = m[k * U + i] / m[i * U + i];
            for (int j = i; j < U; j++)
                m[k * U + j] -= factor * m[i * U + j];
            for (int j = 0; j <= Z; j++)
                right[k * (Z + 1) + j] -= factor * right[i * (Z + 1) + j];
        }
    for (int i = U - 1; i >= 0; i--)
        for (int j = 0; j <= Z; j++) {
            for (int k = i + 1; k < U; k++)
                right[i * (Z + 1) + j] -= m[i * U + k] * right[k * (Z + 1) + j];
            right[i * (Z + 1) + j] /= m[i * U + i];
        }
}

/* The change of the inputs that costs least within their limits, and its gain: the inputs that end
   at a limit are found one after the other, the others follow from a system of equations. */
static void improve(const model_real q[], const model_real slope[], const model_real u[],
                    model_real change[], model_real gains[])
{
    model_real near[U], m[U * U], right[U * (Z + 1)];
    int is_free[U];
    for (int i = 0; i < U; i++)
        near[i] = lower[i] - u[i] > R(0.0)   ? lower[i] - u[i]
                  : upper[i] - u[i] < R(0.0) ? upper[i] - u[i]
                                             : R(0.0);
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int i = 0; i < U; i++) {
            model_real rest = slope[Z + i];
            for (int j = 0; j < U; j++)
                rest += i == j ? R(0.0) : q[(Z + i) * V + Z + j] * near[j];
            near[i] = -rest / q[(Z + i) * V + Z + i];
            near[i] = near[i] < lower[i] - u[i] ? lower[i] - u[i] : near[i];
            near[i] = near[i] > upper[i] - u[i] ? upper[i] - u[i] : near[i];
        }
    for (int i = 0; i < U; i++)
        is_free[i] = near[i] > lower[i] - u[i] && near[i] < upper[i] - u[i];
    for (int i = 0; i < U; i++) {
        model_real rest = slope[Z + i];
        for (int j = 0; j < U; j++) {
            const int both = is_free[i] && is_free[j];
            rest += is_free[j] ? R(0.0) : q[(Z + i) * V + Z + j] * near[j];
            m[i * U + j] = both ? q[(Z + i) * V + Z + j] : i == j ? R(1.0) : R(0.0);
        }
        for (int j = 0; j < Z; j++)
            right[i * (Z + 1) + j] = is_free[i] ? -q[(Z + i) * V + j] : R(0.0);
        right[i * (Z + 1) + Z] = is_free[i] ? -rest : R(0.0);
    }
    solve(m, right);
    for (int i = 0; i < U; i++) {
        for (int j = 0; j < Z; j++)
            gains[i * Z + j] = right[i * (Z + 1) + j];
        if (is_free[i])
            near[i] = right[i * (Z + 1) + Z];
        near[i] = near[i] < lower[i] - u[i] ? lower[i] - u[i] : near[i];
        change[i] = near[i] > upper[i] - u[i] ? upper[i] - u[i] : near[i];
    }
}

/* From the last step to the first: the cost to go, z' v z / 2 + g' z, and by it feedback and changes
   of the inputs that make the motion cost less. */
static void look_back(const predicted *motion, int step, model_real change[], model_real gains[])
{
    model_real v[Z * Z], g[Z], d[Z * V], vd[Z * V], q[V * V], slope[V], error[Z], ku[U * Z];
    const model_real *end = end_of(motion, step, error, g);
    for (int i = 0; i < Z * Z; i++)
        v[i] = end[i];
    for (int i = 0; i < X; i++) {
        const model_real over = excess(i, motion->z[N * Z + i]);
        g[i] += penalty[i] * over;
        v[i * Z + i] += over < R(0.0) || over > R(0.0) ? penalty[i] : R(0.0);
    }
    for (int k = N - 1; k >= 0; k--) {
        const model_real *z = motion->z + k * Z, *u = motion->u + k * U;
        model_real *gain = gains + k * U * Z, *du = change + k * U;
        derive(z, u, d);
        for (int i = 0; i < Z; i++)
            for (int j = 0; j < V; j++) {
                vd[i * V + j] = R(0.0);
                for (int l = 0; l < Z; l++)
                    vd[i * V + j] += v[i * Z + l] * d[l * V + j];
            }
        for (int i = 0; i < V; i++) {
            slope[i] = R(0.0);
            for (int l = 0; l < Z; l++)
                slope[i] += d[l * V + i] * g[l];
            for (int j = 0; j < V; j++) {
                q[i * V + j] = R(0.0);
                for (int l = 0; l < Z; l++)
                    q[i * V + j] += d[l * V + i] * vd[l * V + j];
            }
        }
        for (int i = 0; i < X; i++) {
            const model_real over = excess(i, z[i]);
            slope[i] += state_weight[i] * (z[i] - followed_x(step + k)[i]) + penalty[i] * over;
            q[i * V + i] += state_weight[i];
            q[i * V + i] += over < R(0.0) || over > R(0.0) ? penalty[i] : R(0.0);
        }
        for (int i = 0; i < U; i++) {
            slope[Z + i] += input_weight[i] * (u[i] - followed_u(step + k)[i]);
            q[(Z + i) * V + Z + i] += input_weight[i];
        }
        improve(q, slope, u, du, gain);
        for (int i = 0; i < U; i++) {
            model_real sum = slope[Z + i];
            for (int j = 0; j < Z; j++) {
                ku[i * Z + j] = q[(Z + i) * V + j];
                for (int l = 0; l < U; l++)
                    ku[i * Z + j] += q[(Z + i) * V + Z + l] * gain[l * Z + j];
            }
            for (int l = 0; l < U; l++)
                sum += q[(Z + i) * V + Z + l] * du[l];
            slope[Z + i] = sum;
        }
        for (int i = 0; i < Z; i++) {
            g[i] = slope[i];
            for (int l = 0; l < U; l++)
                g[i] += gain[l * Z + i] * slope[Z + l] + q[(Z + l) * V + i] * du[l];
            for (int j = 0; j <= i; j++) {
                model_real sum = (q[i * V + j] + q[j * V + i]) / R(2.0);
                for (int l = 0; l < U; l++)
                    sum += (gain[l * Z + i] * ku[l * Z + j] + q[(Z + l) * V + i] * gain[l * Z + j]
                            + gain[l * Z + j] * ku[l * Z + i] + q[(Z + l) * V + j] * gain[l * Z + i])
                           / R(2.0);
                v[i * Z + j] = v[j * Z + i] = sum;
            }
        }
    }
}

/* The motion of the last sample, a sample on; its angles turned to those of z. */
static void shift(controller *c, const model_real z[])
{
    for (int i = 0; i < N * Z; i++)
        c->motion.z[i] = c->motion.z[i + Z];
    for (int i = 0; i < (N - 1) * U; i++)
        c->motion.u[i] = c->motion.u[i + U];
    for (int i = 0; i < (N - 1) * U * Z; i++)
        c->gains[i] = c->gains[i + U * Z];
    for (int i = 0; i < A; i++) {
        const model_real error = z[periodic[i]] - c->motion.z[periodic[i]];
        const model_real turns = error - wrapped(error);
        for (int k = 0; k <= N; k++)
            c->motion.z[k * Z + periodic[i]] += turns;
    }
}

/* The first inputs of a new plan; where all motions diverge u stays as it is. */
static void plan_ahead(controller *c, const model_real x[], int step, model_real u[])
{
    model_real gains[N * U * Z], change[N * U];
    predicted about, best, other;
    errors(x, followed_x(step), best.z);
    for (int i = 0; i < X; i++)
        best.z[i] += followed_x(step)[i];
    for (int i = 0; i < P * U; i++)
        best.z[X + i] = c->previous[i];
    for (int i = 0; i < Z; i++)
        other.z[i] = best.z[i];
    for (int k = 0; k < N; k++) {
        const int now = step + k, planned = now < CONTROLLER_STEPS;
        const model_real *row = planned ? plan_gain + now * U * Z : gain;
        for (int i = 0; i < X; i++)
            about.z[k * Z + i] = followed_x(now)[i];
        for (int i = 0; i < P * U; i++)
            about.z[k * Z + X + i] = (planned ? followed_u(now - 1 - i / U) : u0)[i % U];
        for (int i = 0; i < U; i++) {
            about.u[k * U + i] = followed_u(now)[i];
            change[k * U + i] = R(0.0);
        }
        for (int i = 0; i < U * Z; i++)
            gains[k * U * Z + i] = -row[i];
    }
    roll_out(&about, gains, change, R(0.0), step, &best);
    if (c->has_motion) {
        shift(c, best.z);
        roll_out(&c->motion, c->gains, change, R(0.0), step, &other);
        if (other.cost < best.cost)
            best = other;
    }
    c->has_motion = isfinite(best.cost);
    if (!c->has_motion)
        return;
    for (int n = 0; n < ITERATIONS; n++) {
        const model_real bound = best.cost * (R(1.0) + rounding[0]);
        look_back(&best, step, change, c->gains);
        for (int s = 0, found = 0; s < (int)(sizeof shares / sizeof *shares) && !found; s++) {
            roll_out(&best, c->gains, change, shares[s], step, &other);
            found = other.cost <= bound;
            if (found)
                best = other;
        }
    }
    c->motion = best;
    for (int i = 0; i < U; i++)
        u[i] = best.u[i];
}


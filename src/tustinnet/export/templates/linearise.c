
void model_linearise(const model_state *s, const model_real u[], model_state *next,
                     model_real a[], model_real b[])
{
    linearised(s->x, u, a, b, next->x);
}

void model_rest(model_state *s, const model_real q[])
{
    rest(q, s->x);
}

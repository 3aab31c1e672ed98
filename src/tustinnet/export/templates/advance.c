
void model_advance(model_state *s, const model_real u[], model_real begin, model_real length)
{
    model_state next;
    advance(s->x, u, &begin, &length, next.x);
    *s = next;
}

/* The same, of a part of the period alone: its beginning and its length [periods]. */
void model_advance(model_state *s, const model_real u[], model_real begin, model_real length);


/* Made by tustinnet. Constants first, then helpers, then the step, piece by piece. */
#include "model.h"

#include <math.h>

@precision@
@code@
void model_init(model_state *s, const model_real x0[])
{
    for (int i = 0; i < MODEL_STATES; i++)
        s->x[i] = x0[i];
}

void model_step(model_state *s, const model_real u[])
{
    model_state next;
    step(s->x, u, next.x);
    *s = next;
}

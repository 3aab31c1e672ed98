/* Made by tustinnet. Constants first, then helpers, then the step, piece by piece. */
#include "model.h"

#include <math.h>

#ifdef MODEL_FLOAT
#define M(name) name##f
#define EITHER(in_double, in_float) in_float
#else
#define M(name) name
#define EITHER(in_double, in_float) in_double
#endif
#define R(x) MODEL_NUMBER(x)

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

/* A model that steps from sample to sample; README.md has the layout of x and u. */
#ifndef MODEL_H
#define MODEL_H

#ifdef MODEL_FLOAT
typedef float model_real;
#define MODEL_NUMBER(x) x##f
#else
typedef double model_real;
#define MODEL_NUMBER(x) x
#endif

#define MODEL_STATES @states@
#define MODEL_POSITIONS @positions@ /* the first of the states */
#define MODEL_INPUTS @inputs@
#define MODEL_PERIOD MODEL_NUMBER(@period@) /* s */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct model_state {
    model_real x[MODEL_STATES];
} model_state;

void model_init(model_state *s, const model_real x0[]);

/* The state one period later. */
void model_step(model_state *s, const model_real u[]);

@more@#ifdef __cplusplus
}
#endif

#endif

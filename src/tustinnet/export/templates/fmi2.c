/* The functions of FMI 2.0 for co-simulation. */
#include <stdlib.h>
#include <string.h>

#include "fmu.h"

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef unsigned int Reference;
typedef void (*Logger)(void *environment, const char *instance, Status status,
                       const char *category, const char *message, ...);
typedef struct {
    Logger log;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, Status status);
    void *environment;
} Callbacks;
typedef struct {
    fmu_memory memory;
    Logger log;
    void *environment;
    char name[256];
} Instance;

static Status told(const Instance *c, const char *why)
{
    if (why == NULL)
        return OK;
    if (c->log != NULL)
        c->log(c->environment, c->name, ERROR, "logStatusError", why); /* nothing to format */
    return ERROR;
}

FMU_EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

FMU_EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

FMU_EXPORT Status fmi2SetDebugLogging(void *c, int on, size_t count, const char *const kinds[])
{
    (void)c, (void)on, (void)count, (void)kinds;
    return OK;
}

FMU_EXPORT void *fmi2Instantiate(const char *name, int type, const char *token,
                                 const char *resources, const Callbacks *callbacks, int visible,
                                 int logging)
{
    Instance *c = calloc(1, sizeof *c);
    (void)resources, (void)visible, (void)logging;
    if (c == NULL)
        return NULL;
    strncat(c->name, name == NULL ? "" : name, sizeof c->name - 1);
    if (callbacks != NULL) {
        c->log = callbacks->log;
        c->environment = callbacks->environment;
    }
    fmu_reset(&c->memory);
    if (type != 1)
        told(c, "this FMU is for co-simulation");
    else if (token == NULL || strcmp(token, FMU_TOKEN) != 0)
        told(c, "the GUID is not that of this FMU");
    else
        return c;
    free(c);
    return NULL;
}

FMU_EXPORT void fmi2FreeInstance(void *c)
{
    free(c);
}

FMU_EXPORT Status fmi2SetupExperiment(void *c, int tolerance_given, double tolerance, double start,
                                      int stop_given, double stop)
{
    (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
    ((Instance *)c)->memory.time = start;
    return OK;
}

FMU_EXPORT Status fmi2EnterInitializationMode(void *c)
{
    (void)c;
    return OK;
}

FMU_EXPORT Status fmi2ExitInitializationMode(void *c)
{
    ((Instance *)c)->memory.running = 1;
    return OK;
}

FMU_EXPORT Status fmi2Terminate(void *c)
{
    (void)c;
    return OK;
}

FMU_EXPORT Status fmi2Reset(void *c)
{
    fmu_reset(&((Instance *)c)->memory);
    return OK;
}

FMU_EXPORT Status fmi2GetReal(void *c, const Reference refs[], size_t count, double values[])
{
    for (size_t k = 0; k < count; k++) {
        const double *variable = fmu_variable(&((Instance *)c)->memory, refs[k]);
        if (variable == NULL)
            return told(c, "there is no such variable");
        values[k] = *variable;
    }
    return OK;
}

FMU_EXPORT Status fmi2SetReal(void *c, const Reference refs[], size_t count, const double values[])
{
    const char *why = NULL;
    for (size_t k = 0; k < count && why == NULL; k++)
        why = fmu_set(&((Instance *)c)->memory, refs[k], values[k]);
    return told(c, why);
}

FMU_EXPORT Status fmi2SetRealInputDerivatives(void *c, const Reference refs[], size_t count,
                                              const int orders[], const double values[])
{
    const char *why = NULL;
    for (size_t k = 0; k < count && why == NULL; k++)
        why = orders[k] == 1 ? fmu_set_slope(&((Instance *)c)->memory, refs[k], values[k])
                             : "inputs are straight lines: only first derivatives are taken";
    return told(c, why);
}

FMU_EXPORT Status fmi2DoStep(void *c, double time, double size, int kept)
{
    (void)kept;
    return told(c, fmu_step(&((Instance *)c)->memory, time, size));
}

FMU_EXPORT Status fmi2GetFMUstate(void *c, void **state)
{
    return told(c, fmu_keep(&((Instance *)c)->memory, state));
}

FMU_EXPORT Status fmi2SetFMUstate(void *c, void *state)
{
    memcpy(&((Instance *)c)->memory, state, sizeof(fmu_memory));
    return OK;
}

FMU_EXPORT Status fmi2FreeFMUstate(void *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

FMU_EXPORT Status fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(fmu_memory);
    return OK;
}

FMU_EXPORT Status fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    if (size < sizeof(fmu_memory))
        return told(c, "too little room for a state");
    memcpy(bytes, state, sizeof(fmu_memory));
    return OK;
}

FMU_EXPORT Status fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    if (size != sizeof(fmu_memory))
        return told(c, "these bytes are no state of this FMU");
    return told(c, fmu_keep(bytes, state));
}

/* What this FMU does not have. */

static Status none(const Instance *c, size_t count)
{
    return told(c, count ? "this FMU has real variables only" : NULL);
}

FMU_EXPORT Status fmi2GetInteger(void *c, const Reference refs[], size_t count, int values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2GetBoolean(void *c, const Reference refs[], size_t count, int values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2GetString(void *c, const Reference refs[], size_t count,
                                const char *values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2SetInteger(void *c, const Reference refs[], size_t count, const int values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2SetBoolean(void *c, const Reference refs[], size_t count, const int values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2SetString(void *c, const Reference refs[], size_t count,
                                const char *const values[])
{
    (void)refs, (void)values;
    return none(c, count);
}

FMU_EXPORT Status fmi2GetDirectionalDerivative(void *c, const Reference unknown[], size_t unknowns,
                                               const Reference known[], size_t knowns,
                                               const double seed[], double values[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)values;
    return told(c, "this FMU tells no derivatives");
}

FMU_EXPORT Status fmi2GetRealOutputDerivatives(void *c, const Reference refs[], size_t count,
                                               const int orders[], double values[])
{
    (void)refs, (void)count, (void)orders, (void)values;
    return told(c, "this FMU tells no derivatives");
}

FMU_EXPORT Status fmi2CancelStep(void *c)
{
    return told(c, "steps are done when they return");
}

FMU_EXPORT Status fmi2GetStatus(void *c, int kind, Status *value)
{
    (void)c, (void)kind, (void)value;
    return DISCARD;
}

FMU_EXPORT Status fmi2GetRealStatus(void *c, int kind, double *value)
{
    (void)kind; /* the only one that is a number: until when it stepped */
    *value = ((Instance *)c)->memory.time;
    return OK;
}

FMU_EXPORT Status fmi2GetIntegerStatus(void *c, int kind, int *value)
{
    (void)c, (void)kind, (void)value;
    return DISCARD;
}

FMU_EXPORT Status fmi2GetBooleanStatus(void *c, int kind, int *value)
{
    (void)c, (void)kind;
    *value = 0; /* it never asks for the end */
    return OK;
}

FMU_EXPORT Status fmi2GetStringStatus(void *c, int kind, const char **value)
{
    (void)c, (void)kind, (void)value;
    return DISCARD;
}

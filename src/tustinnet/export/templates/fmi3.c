/* The functions of FMI 3.0 for co-simulation. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmu.h"

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef uint32_t Reference;
typedef void (*Logger)(void *environment, Status status, const char *category,
                       const char *message);
typedef void (*Update)(void *environment, double time, bool set, bool get, bool finished,
                       bool can_return, bool *returned, double *until);
typedef struct {
    fmu_memory memory;
    Logger log;
    void *environment;
} Instance;

static Status told(const Instance *c, const char *why)
{
    if (why == NULL)
        return OK;
    if (c->log != NULL)
        c->log(c->environment, ERROR, "logStatusError", why);
    return ERROR;
}

FMU_EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMU_EXPORT Status fmi3SetDebugLogging(void *c, bool on, size_t count, const char *const kinds[])
{
    (void)c, (void)on, (void)count, (void)kinds;
    return OK;
}

FMU_EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token,
                                             const char *resources, bool visible, bool logging,
                                             bool events, bool early,
                                             const Reference intermediate[], size_t count,
                                             void *environment, Logger log, Update update)
{
    Instance *c = calloc(1, sizeof *c);
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)count, (void)update;
    if (c == NULL)
        return NULL;
    c->log = log;
    c->environment = environment;
    fmu_reset(&c->memory);
    if (token != NULL && strcmp(token, FMU_TOKEN) == 0)
        return c;
    told(c, "the token is not that of this FMU");
    free(c);
    return NULL;
}

FMU_EXPORT void fmi3FreeInstance(void *c)
{
    free(c);
}

FMU_EXPORT Status fmi3EnterInitializationMode(void *c, bool tolerance_given, double tolerance,
                                              double start, bool stop_given, double stop)
{
    (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
    ((Instance *)c)->memory.time = start;
    return OK;
}

FMU_EXPORT Status fmi3ExitInitializationMode(void *c)
{
    ((Instance *)c)->memory.running = 1;
    return OK;
}

FMU_EXPORT Status fmi3Terminate(void *c)
{
    (void)c;
    return OK;
}

FMU_EXPORT Status fmi3Reset(void *c)
{
    fmu_reset(&((Instance *)c)->memory);
    return OK;
}

FMU_EXPORT Status fmi3GetFloat64(void *c, const Reference refs[], size_t count, double values[],
                                 size_t size)
{
    for (size_t k = 0; k < count; k++) {
        const double *variable = fmu_variable(&((Instance *)c)->memory, refs[k]);
        if (variable == NULL || k >= size)
            return told(c, "there is no such variable");
        values[k] = *variable;
    }
    return OK;
}

FMU_EXPORT Status fmi3SetFloat64(void *c, const Reference refs[], size_t count,
                                 const double values[], size_t size)
{
    const char *why = size < count ? "more variables than values" : NULL;
    for (size_t k = 0; k < count && why == NULL; k++)
        why = fmu_set(&((Instance *)c)->memory, refs[k], values[k]);
    return told(c, why);
}

FMU_EXPORT Status fmi3DoStep(void *c, double time, double size, bool kept, bool *event, bool *end,
                             bool *early, double *until)
{
    const char *why = fmu_step(&((Instance *)c)->memory, time, size);
    (void)kept;
    *event = *end = *early = false;
    *until = ((Instance *)c)->memory.time;
    return told(c, why);
}

FMU_EXPORT Status fmi3GetFMUState(void *c, void **state)
{
    return told(c, fmu_keep(&((Instance *)c)->memory, state));
}

FMU_EXPORT Status fmi3SetFMUState(void *c, void *state)
{
    memcpy(&((Instance *)c)->memory, state, sizeof(fmu_memory));
    return OK;
}

FMU_EXPORT Status fmi3FreeFMUState(void *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

FMU_EXPORT Status fmi3SerializedFMUStateSize(void *c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(fmu_memory);
    return OK;
}

FMU_EXPORT Status fmi3SerializeFMUState(void *c, void *state, uint8_t bytes[], size_t size)
{
    if (size < sizeof(fmu_memory))
        return told(c, "too little room for a state");
    memcpy(bytes, state, sizeof(fmu_memory));
    return OK;
}

FMU_EXPORT Status fmi3DeserializeFMUState(void *c, const uint8_t bytes[], size_t size,
                                          void **state)
{
    if (size != sizeof(fmu_memory))
        return told(c, "these bytes are no state of this FMU");
    return told(c, fmu_keep(bytes, state));
}

/* What this FMU does not have. */

FMU_EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token,
                                              const char *resources, bool visible, bool logging,
                                              void *environment, Logger log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (log != NULL)
        log(environment, ERROR, "logStatusError", "this FMU is for co-simulation");
    return NULL;
}

FMU_EXPORT void *fmi3InstantiateScheduledExecution(const char *name, const char *token,
                                                   const char *resources, bool visible,
                                                   bool logging, void *environment, Logger log,
                                                   void (*clock)(void *), void (*lock)(void),
                                                   void (*unlock)(void))
{
    (void)clock, (void)lock, (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment,
                                        log);
}

#define WITHOUT(type, number)                                                                     \
    FMU_EXPORT Status fmi3Get##type(void *c, const Reference refs[], size_t count,                \
                                    number values[], size_t size)                                 \
    {                                                                                             \
        (void)refs, (void)values, (void)size;                                                     \
        return told(c, count ? "this FMU has no variables of type " #type : NULL);                \
    }                                                                                             \
    FMU_EXPORT Status fmi3Set##type(void *c, const Reference refs[], size_t count,                \
                                    const number values[], size_t size)                           \
    {                                                                                             \
        (void)refs, (void)values, (void)size;                                                     \
        return told(c, count ? "this FMU has no variables of type " #type : NULL);                \
    }

typedef const char *Text;
WITHOUT(Float32, float)
WITHOUT(Int8, int8_t)
WITHOUT(UInt8, uint8_t)
WITHOUT(Int16, int16_t)
WITHOUT(UInt16, uint16_t)
WITHOUT(Int32, int32_t)
WITHOUT(UInt32, uint32_t)
WITHOUT(Int64, int64_t)
WITHOUT(UInt64, uint64_t)
WITHOUT(Boolean, bool)
WITHOUT(String, Text)

FMU_EXPORT Status fmi3GetBinary(void *c, const Reference refs[], size_t count, size_t sizes[],
                                const uint8_t *values[], size_t size)
{
    (void)refs, (void)sizes, (void)values, (void)size;
    return told(c, count ? "this FMU has no binary variables" : NULL);
}

FMU_EXPORT Status fmi3SetBinary(void *c, const Reference refs[], size_t count,
                                const size_t sizes[], const uint8_t *const values[], size_t size)
{
    (void)refs, (void)sizes, (void)values, (void)size;
    return told(c, count ? "this FMU has no binary variables" : NULL);
}

FMU_EXPORT Status fmi3GetClock(void *c, const Reference refs[], size_t count, bool values[])
{
    (void)refs, (void)values;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

FMU_EXPORT Status fmi3SetClock(void *c, const Reference refs[], size_t count, const bool values[])
{
    (void)refs, (void)values;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

FMU_EXPORT Status fmi3GetNumberOfVariableDependencies(void *c, Reference of, size_t *count)
{
    (void)of, (void)count;
    return told(c, "dependencies stand in the model description");
}

FMU_EXPORT Status fmi3GetVariableDependencies(void *c, Reference of, size_t dependent_at[],
                                              Reference independent[], size_t independent_at[],
                                              int kinds[], size_t count)
{
    (void)of, (void)dependent_at, (void)independent, (void)independent_at, (void)kinds, (void)count;
    return told(c, "dependencies stand in the model description");
}

FMU_EXPORT Status fmi3GetDirectionalDerivative(void *c, const Reference unknown[], size_t unknowns,
                                               const Reference known[], size_t knowns,
                                               const double seed[], size_t seeds, double values[],
                                               size_t size)
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)seeds;
    (void)values, (void)size;
    return told(c, "this FMU tells no derivatives");
}

FMU_EXPORT Status fmi3GetAdjointDerivative(void *c, const Reference unknown[], size_t unknowns,
                                           const Reference known[], size_t knowns,
                                           const double seed[], size_t seeds, double values[],
                                           size_t size)
{
    return fmi3GetDirectionalDerivative(c, unknown, unknowns, known, knowns, seed, seeds, values,
                                        size);
}

FMU_EXPORT Status fmi3GetOutputDerivatives(void *c, const Reference refs[], size_t count,
                                           const int32_t orders[], double values[], size_t size)
{
    (void)refs, (void)count, (void)orders, (void)values, (void)size;
    return told(c, "this FMU tells no derivatives");
}

#define NO_MODE(name)                                                                             \
    FMU_EXPORT Status fmi3##name(void *c)                                                         \
    {                                                                                             \
        return told(c, "this FMU has no such mode: " #name);                                      \
    }

NO_MODE(EnterConfigurationMode)
NO_MODE(ExitConfigurationMode)
NO_MODE(EnterEventMode)
NO_MODE(EnterStepMode)
NO_MODE(EvaluateDiscreteStates)
NO_MODE(EnterContinuousTimeMode)

FMU_EXPORT Status fmi3UpdateDiscreteStates(void *c, bool *again, bool *end, bool *nominals,
                                           bool *values, bool *next_defined, double *next)
{
    (void)again, (void)end, (void)nominals, (void)values, (void)next_defined, (void)next;
    return told(c, "this FMU has no such mode: UpdateDiscreteStates");
}

#define NO_CLOCK(name, kind, first, second)                                                       \
    FMU_EXPORT Status fmi3##name(void *c, const Reference refs[], size_t count, first, second)    \
    {                                                                                             \
        (void)refs, (void)kind, (void)other;                                                      \
        return told(c, count ? "this FMU has no clocks" : NULL);                                  \
    }

NO_CLOCK(GetIntervalDecimal, values, double values[], int other[])
NO_CLOCK(GetShiftFraction, values, uint64_t values[], uint64_t other[])
NO_CLOCK(SetIntervalFraction, values, const uint64_t values[], const uint64_t other[])
NO_CLOCK(SetShiftFraction, values, const uint64_t values[], const uint64_t other[])

FMU_EXPORT Status fmi3GetIntervalFraction(void *c, const Reference refs[], size_t count,
                                          uint64_t counters[], uint64_t resolutions[], int kinds[])
{
    (void)refs, (void)counters, (void)resolutions, (void)kinds;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

FMU_EXPORT Status fmi3GetShiftDecimal(void *c, const Reference refs[], size_t count,
                                      double values[])
{
    (void)refs, (void)values;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

FMU_EXPORT Status fmi3SetIntervalDecimal(void *c, const Reference refs[], size_t count,
                                         const double values[])
{
    (void)refs, (void)values;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

FMU_EXPORT Status fmi3SetShiftDecimal(void *c, const Reference refs[], size_t count,
                                      const double values[])
{
    (void)refs, (void)values;
    return told(c, count ? "this FMU has no clocks" : NULL);
}

/* Of the other kinds of FMUs; importers want to find them all the same. */

#define OTHER_KIND "this FMU is for co-simulation"

FMU_EXPORT Status fmi3ActivateModelPartition(void *c, Reference clock, double time)
{
    (void)clock, (void)time;
    return told(c, OTHER_KIND);
}

FMU_EXPORT Status fmi3CompletedIntegratorStep(void *c, bool kept, bool *event, bool *end)
{
    (void)kept, (void)event, (void)end;
    return told(c, OTHER_KIND);
}

FMU_EXPORT Status fmi3SetTime(void *c, double time)
{
    (void)time;
    return told(c, OTHER_KIND);
}

FMU_EXPORT Status fmi3SetContinuousStates(void *c, const double values[], size_t size)
{
    (void)values, (void)size;
    return told(c, OTHER_KIND);
}

#define NO_NUMBERS(name)                                                                          \
    FMU_EXPORT Status fmi3Get##name(void *c, double values[], size_t size)                        \
    {                                                                                             \
        (void)values, (void)size;                                                                 \
        return told(c, OTHER_KIND);                                                               \
    }

NO_NUMBERS(ContinuousStates)
NO_NUMBERS(ContinuousStateDerivatives)
NO_NUMBERS(NominalsOfContinuousStates)
NO_NUMBERS(EventIndicators)

FMU_EXPORT Status fmi3GetNumberOfContinuousStates(void *c, size_t *count)
{
    (void)count;
    return told(c, OTHER_KIND);
}

FMU_EXPORT Status fmi3GetNumberOfEventIndicators(void *c, size_t *count)
{
    (void)count;
    return told(c, OTHER_KIND);
}

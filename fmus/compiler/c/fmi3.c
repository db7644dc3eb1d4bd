/* FMI 3.0 for co-simulation and model exchange around an instance of the model. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "instance.h"
#include "model_data.h"

/* The instance first, so that a pointer to one is a pointer to the other. */
typedef struct {
    Instance model;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Component;

#define MODEL(instance) (&((Component *)(instance))->model)
#define NOW(instance) (&MODEL(instance)->now)
#define STATUS(failed) ((failed) ? fmi3Error : fmi3OK)
#define REFUSE(instance, function) STATUS(instance_refuse(MODEL(instance), function))

static void report(const Instance *model, const char *message)
{
    const Component *component = (const Component *)model;
    if (component->log != NULL) {
        component->log(component->environment, fmi3Error, "logStatusError", message);
    }
}

/* ---- life of an instance ---- */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    /* Errors are always logged, and there is nothing else to log. */
    (void)instance;
    (void)on;
    (void)n;
    (void)categories;
    return fmi3OK;
}

static fmi3Instance instantiate(fmi3String name, fmi3String token, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log, int steps)
{
    Component *component = calloc(1, sizeof(Component));
    if (component == NULL) {
        return NULL;
    }
    component->environment = environment;
    component->log = log;
    component->model.report = report;
    component->model.steps = steps;
    snprintf(component->model.name, sizeof(component->model.name), "%s", name != NULL ? name : "");
    if (token == NULL || strcmp(token, MODEL_GUID) != 0) {
        instance_complain(&component->model, "instantiation token %s does not belong to this binary, which has %s",
                          token != NULL ? token : "(none)", MODEL_GUID);
        free(component);
        return NULL;
    }
    instance_reset(&component->model);
    return component;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)resources;
    (void)visible;
    (void)logging;
    return instantiate(name, token, environment, log, 0);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)resources;
    (void)visible;
    (void)logging;
    (void)early_return;
    (void)intermediate;
    (void)n_intermediate;
    (void)update;
    /* Events are handled within a step. */
    if (!MODEL_CO_SIMULATION || event_mode) {
        if (log != NULL) {
            log(environment, fmi3Error, "logStatusError",
                event_mode ? "this FMU has no event mode in co-simulation" : "this FMU does model exchange only");
        }
        return NULL;
    }
    return instantiate(name, token, environment, log, 1);
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    return REFUSE(instance, "fmi3EnterStepMode");
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_return,
                      fmi3Boolean *event_handling_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                      fmi3Float64 *last_time)
{
    (void)no_return;
    *event_handling_needed = fmi3False;
    *terminate = fmi3False;
    *early_return = fmi3False;
    if (NOW(instance)->phase != STEPPING) {
        return REFUSE(instance, "fmi3DoStep");
    }
    const int failed = instance_step(MODEL(instance), t, h);
    *last_time = NOW(instance)->t;
    return STATUS(failed);
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    (void)n_values;
    return REFUSE(instance, "fmi3GetOutputDerivatives");
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined;
    (void)tolerance;
    State *now = NOW(instance);
    if (now->phase != INSTANTIATED) {
        return REFUSE(instance, "fmi3EnterInitializationMode");
    }
    now->t = start;
    now->stop = stop_defined ? stop : HUGE_VAL;
    now->phase = INITIALIZATION;
    instance_touch(MODEL(instance));
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    if (NOW(instance)->phase != INITIALIZATION) {
        return REFUSE(instance, "fmi3ExitInitializationMode");
    }
    return STATUS(instance_initialize(MODEL(instance)));
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    State *now = NOW(instance);
    if (now->phase < STEPPING || now->phase > CONTINUOUS) {
        return REFUSE(instance, "fmi3Terminate");
    }
    now->phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    instance_reset(MODEL(instance));
    return fmi3OK;
}

/* ---- values ---- */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    if (n_values != n) {
        return STATUS(instance_complain(MODEL(instance), "fmi3GetFloat64: %zu values for %zu scalars", n_values, n));
    }
    for (size_t i = 0; i < n; i++) {
        if (instance_get(MODEL(instance), references[i], &values[i])) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t n_values)
{
    if (n_values != n) {
        return STATUS(instance_complain(MODEL(instance), "fmi3SetFloat64: %zu values for %zu scalars", n_values, n));
    }
    for (size_t i = 0; i < n; i++) {
        if (instance_set(MODEL(instance), references[i], values[i])) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

/* There are no variables of other types. */
#define NO_VARIABLES(Type)                                                                                             \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference references[], size_t n,                   \
                             fmi3##Type values[], size_t n_values)                                                     \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        (void)n_values;                                                                                                \
        return STATUS(n != 0 && instance_complain(MODEL(instance), "there are no variables of type " #Type));          \
    }                                                                                                                  \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference references[], size_t n,                   \
                             const fmi3##Type values[], size_t n_values)                                               \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        (void)n_values;                                                                                                \
        return STATUS(n != 0 && instance_complain(MODEL(instance), "there are no variables of type " #Type));          \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                        const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seeds[],
                                        size_t n_seeds, fmi3Float64 results[], size_t n_results)
{
    Instance *model = MODEL(instance);
    Direction direction = {.dx = {0.0}};
    if (n_seeds != n_knowns || n_results != n_unknowns) {
        return STATUS(instance_complain(model, "fmi3GetDirectionalDerivative: one seed and result per variable"));
    }
    for (size_t i = 0; i < n_knowns; i++) {
        if (instance_seed(model, &direction, knowns[i], seeds[i])) {
            return fmi3Error;
        }
    }
    instance_derive(model, &direction);
    for (size_t i = 0; i < n_unknowns; i++) {
        if (instance_result(model, &direction, unknowns[i], &results[i])) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

/* ---- saved states ---- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved)
{
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return STATUS(instance_complain(MODEL(instance), "no memory for an FMU state"));
    }
    memcpy(*saved, NOW(instance), sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved)
{
    memcpy(NOW(instance), saved, sizeof(State));
    instance_touch(MODEL(instance));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved)
{
    (void)instance;
    free(*saved);
    *saved = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved, size_t *size)
{
    (void)instance;
    (void)saved;
    *size = sizeof(State);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(State)) {
        return STATUS(instance_complain(MODEL(instance), "fmi3SerializeFMUState: the buffer is too small"));
    }
    memcpy(bytes, saved, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved)
{
    if (size != sizeof(State)) {
        return STATUS(instance_complain(MODEL(instance), "fmi3DeserializeFMUState: these bytes are no state of this FMU"));
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return STATUS(instance_complain(MODEL(instance), "no memory for an FMU state"));
    }
    memcpy(*saved, bytes, sizeof(State));
    return fmi3OK;
}

/* ---- model exchange ---- */

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    State *now = NOW(instance);
    if (now->phase != CONTINUOUS && now->phase != EVENTS) {
        return REFUSE(instance, "fmi3EnterEventMode");
    }
    now->phase = EVENTS;
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                    fmi3Boolean *next_event_defined, fmi3Float64 *next_event)
{
    *again = fmi3False;
    *terminate = fmi3False;
    *nominals_changed = fmi3False;
    *states_changed = fmi3False;
    *next_event_defined = fmi3False;
    *next_event = 0.0;
    if (NOW(instance)->phase != EVENTS) {
        return REFUSE(instance, "fmi3UpdateDiscreteStates");
    }
    int changed;
    const int failed = instance_settle(MODEL(instance), &changed);
    *states_changed = changed != 0;
    return STATUS(failed);
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    State *now = NOW(instance);
    if (now->phase != EVENTS) {
        return REFUSE(instance, "fmi3EnterContinuousTimeMode");
    }
    now->phase = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_set_state, fmi3Boolean *enter_event_mode,
                                       fmi3Boolean *terminate)
{
    (void)instance;
    (void)no_set_state;
    *enter_event_mode = fmi3False;
    *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 t)
{
    NOW(instance)->t = t;
    instance_touch(MODEL(instance));
    return fmi3OK;
}

#define CHECK_SIZE(instance, n, size, function)                                                                        \
    if ((n) != (size)) {                                                                                               \
        return STATUS(instance_complain(MODEL(instance), function ": there are %d", (size)));                          \
    }

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n)
{
    CHECK_SIZE(instance, n, MODEL_N_STATES, "fmi3SetContinuousStates")
    memcpy(NOW(instance)->x, x, sizeof(double) * MODEL_N_STATES);
    instance_touch(MODEL(instance));
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n)
{
    CHECK_SIZE(instance, n, MODEL_N_STATES, "fmi3GetContinuousStates")
    return STATUS(instance_get_states(MODEL(instance), x));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t n)
{
    CHECK_SIZE(instance, n, MODEL_N_STATES, "fmi3GetContinuousStateDerivatives")
    return STATUS(instance_get_derivatives(MODEL(instance), derivatives));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n)
{
    CHECK_SIZE(instance, n, MODEL_N_RELATIONS, "fmi3GetEventIndicators")
    instance_indicators(MODEL(instance), indicators);
    return fmi3OK;
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t n)
{
    CHECK_SIZE(instance, n, MODEL_N_STATES, "fmi3GetNominalsOfContinuousStates")
    for (size_t i = 0; i < n; i++) {
        nominals[i] = 1.0;
    }
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n)
{
    (void)instance;
    *n = MODEL_N_RELATIONS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n)
{
    (void)instance;
    *n = MODEL_N_STATES;
    return fmi3OK;
}

/* ---- not offered: the description says so, and every name must be there ---- */

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)log;
    (void)update;
    (void)lock;
    (void)unlock;
    return NULL;
}

#define NOT_OFFERED(function, ...)                                                                                     \
    fmi3Status function(fmi3Instance instance, __VA_ARGS__)                                                            \
    {                                                                                                                  \
        return REFUSE(instance, #function);                                                                            \
    }

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

typedef const fmi3ValueReference *References;

NOT_OFFERED(fmi3GetBinary, References r, size_t n, size_t sizes[], fmi3Binary values[], size_t n_values)
NOT_OFFERED(fmi3SetBinary, References r, size_t n, const size_t sizes[], const fmi3Binary values[], size_t n_values)
NOT_OFFERED(fmi3GetClock, References r, size_t n, fmi3Clock values[])
NOT_OFFERED(fmi3SetClock, References r, size_t n, const fmi3Clock values[])
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference r, size_t *n)
NOT_OFFERED(fmi3GetVariableDependencies, fmi3ValueReference r, size_t elements[], fmi3ValueReference independents[],
            size_t independent_elements[], fmi3DependencyKind kinds[], size_t n)
NOT_OFFERED(fmi3GetAdjointDerivative, References unknowns, size_t n_unknowns, References knowns, size_t n_knowns,
            const fmi3Float64 seeds[], size_t n_seeds, fmi3Float64 results[], size_t n_results)
NOT_OFFERED(fmi3GetIntervalDecimal, References r, size_t n, fmi3Float64 values[], fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetIntervalFraction, References r, size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
            fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetShiftDecimal, References r, size_t n, fmi3Float64 shifts[])
NOT_OFFERED(fmi3GetShiftFraction, References r, size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetIntervalDecimal, References r, size_t n, const fmi3Float64 values[])
NOT_OFFERED(fmi3SetIntervalFraction, References r, size_t n, const fmi3UInt64 counters[],
            const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetShiftDecimal, References r, size_t n, const fmi3Float64 shifts[])
NOT_OFFERED(fmi3SetShiftFraction, References r, size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 t)

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return REFUSE(instance, "fmi3EnterConfigurationMode");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return REFUSE(instance, "fmi3ExitConfigurationMode");
}

/* FMI 2.0 for co-simulation and model exchange around an instance of a model with events. A model without them has
 * the wrapper in fmi2.c. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "instance.h"
#include "model_data.h"

/* The instance first, so that a pointer to one is a pointer to the other. */
typedef struct {
    Instance model;
    const fmi2CallbackFunctions *callbacks;
} Component;

#define MODEL(c) (&((Component *)(c))->model)
#define NOW(c) (&MODEL(c)->now)
#define STATUS(failed) ((failed) ? fmi2Error : fmi2OK)
#define REFUSE(c, function) STATUS(instance_refuse(MODEL(c), function))

static void report(const Instance *model, const char *message)
{
    const Component *component = (const Component *)model;
    const fmi2CallbackFunctions *callbacks = component->callbacks;
    if (callbacks != NULL && callbacks->logger != NULL) {
        callbacks->logger(callbacks->componentEnvironment, model->name, fmi2Error, "logStatusError", message);
    }
}

/* ---- life of an instance ---- */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    /* Errors are always logged, and there is nothing else to log. */
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources;
    (void)visible;
    (void)logging;
    Component *component = calloc(1, sizeof(Component));
    if (component == NULL) {
        return NULL;
    }
    component->callbacks = callbacks;
    component->model.report = report;
    component->model.steps = type == fmi2CoSimulation;
    snprintf(component->model.name, sizeof(component->model.name), "%s", name != NULL ? name : "");
    int failed = guid == NULL || strcmp(guid, MODEL_GUID) != 0;
    if (failed) {
        instance_complain(&component->model, "GUID %s does not belong to this binary, which has %s",
                          guid != NULL ? guid : "(none)", MODEL_GUID);
    } else if (type == fmi2CoSimulation && !MODEL_CO_SIMULATION) {
        failed = instance_complain(&component->model, "this FMU does model exchange only");
    }
    if (failed) {
        free(component);
        return NULL;
    }
    instance_reset(&component->model);
    return component;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined;
    (void)tolerance;
    State *now = NOW(c);
    if (now->phase != INSTANTIATED) {
        return REFUSE(c, "fmi2SetupExperiment");
    }
    now->t = start;
    now->stop = stop_defined ? stop : HUGE_VAL;
    instance_touch(MODEL(c));
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    if (NOW(c)->phase != INSTANTIATED) {
        return REFUSE(c, "fmi2EnterInitializationMode");
    }
    NOW(c)->phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    if (NOW(c)->phase != INITIALIZATION) {
        return REFUSE(c, "fmi2ExitInitializationMode");
    }
    return STATUS(instance_initialize(MODEL(c)));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    State *now = NOW(c);
    if (now->phase < STEPPING || now->phase > CONTINUOUS) {
        return REFUSE(c, "fmi2Terminate");
    }
    now->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    instance_reset(MODEL(c));
    return fmi2OK;
}

/* ---- values ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Real values[])
{
    for (size_t i = 0; i < n; i++) {
        if (instance_get(MODEL(c), references[i], &values[i])) {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Real values[])
{
    for (size_t i = 0; i < n; i++) {
        if (instance_set(MODEL(c), references[i], values[i])) {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

/* There are no variables of other types. */
#define NO_VARIABLES(Type)                                                                                             \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2##Type values[])    \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        return STATUS(n != 0 && instance_complain(MODEL(c), "there are no variables of type " #Type));                 \
    }                                                                                                                  \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference references[], size_t n,                         \
                             const fmi2##Type values[])                                                                \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        return STATUS(n != 0 && instance_complain(MODEL(c), "there are no variables of type " #Type));                 \
    }

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seeds[],
                                        fmi2Real results[])
{
    Direction direction = {.dx = {0.0}};
    for (size_t i = 0; i < n_knowns; i++) {
        if (instance_seed(MODEL(c), &direction, knowns[i], seeds[i])) {
            return fmi2Error;
        }
    }
    instance_derive(MODEL(c), &direction);
    for (size_t i = 0; i < n_unknowns; i++) {
        if (instance_result(MODEL(c), &direction, unknowns[i], &results[i])) {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

/* ---- saved states ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return STATUS(instance_complain(MODEL(c), "no memory for an FMU state"));
    }
    memcpy(*saved, NOW(c), sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    memcpy(NOW(c), saved, sizeof(State));
    instance_touch(MODEL(c));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    (void)c;
    (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(State)) {
        return STATUS(instance_complain(MODEL(c), "fmi2SerializeFMUstate: the buffer is too small"));
    }
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (size != sizeof(State)) {
        return STATUS(instance_complain(MODEL(c), "fmi2DeSerializeFMUstate: these bytes are not a state of this FMU"));
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return STATUS(instance_complain(MODEL(c), "no memory for an FMU state"));
    }
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}

/* ---- co-simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_return)
{
    (void)no_return;
    if (NOW(c)->phase != STEPPING) {
        return REFUSE(c, "fmi2DoStep");
    }
    return STATUS(instance_step(MODEL(c), t, h));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return REFUSE(c, "fmi2CancelStep");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return REFUSE(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                        const fmi2Integer orders[], fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return REFUSE(c, "fmi2GetRealOutputDerivatives");
}

/* No step is ever pending. */
#define NO_STATUS(Name, Type)                                                                                          \
    fmi2Status Name(fmi2Component c, const fmi2StatusKind kind, Type *value)                                           \
    {                                                                                                                  \
        (void)c;                                                                                                       \
        (void)kind;                                                                                                    \
        (void)value;                                                                                                   \
        return fmi2Discard;                                                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = NOW(c)->t;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False;
    return fmi2OK;
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    State *now = NOW(c);
    if (now->phase != CONTINUOUS && now->phase != EVENTS) {
        return REFUSE(c, "fmi2EnterEventMode");
    }
    now->phase = EVENTS;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    info->nextEventTime = 0.0;
    if (NOW(c)->phase != EVENTS) {
        return REFUSE(c, "fmi2NewDiscreteStates");
    }
    int changed;
    const int failed = instance_settle(MODEL(c), &changed);
    info->valuesOfContinuousStatesChanged = changed ? fmi2True : fmi2False;
    return STATUS(failed);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    State *now = NOW(c);
    if (now->phase != EVENTS) {
        return REFUSE(c, "fmi2EnterContinuousTimeMode");
    }
    now->phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate)
{
    (void)c;
    (void)no_set_state;
    *enter_event_mode = fmi2False;
    *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t)
{
    NOW(c)->t = t;
    instance_touch(MODEL(c));
    return fmi2OK;
}

#define CHECK_SIZE(c, n, size, function)                                                                               \
    if ((n) != (size)) {                                                                                               \
        return STATUS(instance_complain(MODEL(c), function ": there are %d", (size)));                                 \
    }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    CHECK_SIZE(c, n, MODEL_N_STATES, "fmi2SetContinuousStates")
    memcpy(NOW(c)->x, x, sizeof(double) * MODEL_N_STATES);
    instance_touch(MODEL(c));
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    CHECK_SIZE(c, n, MODEL_N_STATES, "fmi2GetContinuousStates")
    return STATUS(instance_get_states(MODEL(c), x));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n)
{
    CHECK_SIZE(c, n, MODEL_N_STATES, "fmi2GetDerivatives")
    return STATUS(instance_get_derivatives(MODEL(c), derivatives));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    CHECK_SIZE(c, n, MODEL_N_RELATIONS, "fmi2GetEventIndicators")
    instance_indicators(MODEL(c), indicators);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    CHECK_SIZE(c, n, MODEL_N_STATES, "fmi2GetNominalsOfContinuousStates")
    for (size_t i = 0; i < n; i++) {
        nominals[i] = 1.0;
    }
    return fmi2OK;
}

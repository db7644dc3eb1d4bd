/* FMI 2.0 for co-simulation and model exchange around a model's generated functions.
 *
 * Value references follow the order of modelDescription.xml: states, their derivatives, inputs, parameters, outputs.
 * A state is set by its start expression (a function of parameters) during initialization. Derivatives and outputs
 * are calculated when they are asked for. After fmi2Error an instance goes on only after fmi2Reset or fmi2SetFMUstate.
 */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "integrate.h"
#include "model_data.h"

#define FIRST_DERIVATIVE MODEL_N_STATES
#define FIRST_INPUT (2 * MODEL_N_STATES)
#define FIRST_PARAMETER (FIRST_INPUT + MODEL_N_INPUTS)
#define FIRST_OUTPUT (FIRST_PARAMETER + MODEL_N_PARAMETERS)
#define N_REFERENCES (FIRST_OUTPUT + MODEL_N_OUTPUTS)
#define LONGEST_MESSAGE 512

typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, EVENTS, CONTINUOUS, TERMINATED, FAILED } Phase;

/* All that an instance remembers between two calls, and so all that an FMU state contains. */
typedef struct {
    double t;
    double stop;
    double x[ROOM(MODEL_N_STATES)];
    double u[ROOM(MODEL_N_INPUTS)];
    double p[ROOM(MODEL_N_PARAMETERS)];
    Phase phase;
} State;

typedef struct {
    State now;
    double derivatives[ROOM(MODEL_N_STATES)];
    double outputs[ROOM(MODEL_N_OUTPUTS)];
    int current; /* derivatives and outputs belong to now */
    Propagators propagators;
    fmi2Type type;
    const fmi2CallbackFunctions *callbacks;
    char name[64];
} Instance;

/* ---- messages ---- */

static fmi2Status complain(const Instance *instance, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list values;
    va_start(values, format);
    vsnprintf(message, sizeof(message), format, values);
    va_end(values);
    if (instance->callbacks != NULL && instance->callbacks->logger != NULL) {
        instance->callbacks->logger(instance->callbacks->componentEnvironment, instance->name, fmi2Error,
                                    "logStatusError", message);
    }
    return fmi2Error;
}

/* An error that leaves nothing to go on with. */
#define FAIL(instance, ...) ((instance)->now.phase = FAILED, complain((instance), __VA_ARGS__))

static fmi2Status refuse(const Instance *instance, const char *function)
{
    return complain(instance, "%s is not allowed now", function);
}

/* ---- evaluation ---- */

static void set_start_states(Instance *instance)
{
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {instance->now.p};
    double *results[] = {instance->now.x};
    model_start(arguments, results, iw, w, 0);
}

static void evaluate(Instance *instance)
{
    if (instance->current) {
        return;
    }
    State *now = &instance->now;
    if (now->phase == INSTANTIATED || now->phase == INITIALIZATION) {
        set_start_states(instance);
    }
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {&now->t, now->x, now->u, now->p};
    double *derivatives[] = {instance->derivatives};
    double *outputs[] = {instance->outputs};
    model_derivatives(arguments, derivatives, iw, w, 0);
    model_outputs(arguments, outputs, iw, w, 0);
    instance->current = 1;
}

static int first_not_finite(const double *values, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(values[i])) {
            return i;
        }
    }
    return -1;
}

/* What a component cannot be built with (a capacity below zero) must not become a trajectory. */
static fmi2Status check_start(Instance *instance)
{
    State *now = &instance->now;
    double values[ROOM(MODEL_N_CHECKS)];
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {now->p};
    double *results[] = {values};
    int i = first_not_finite(now->p, MODEL_N_PARAMETERS);
    if (i >= 0) {
        return FAIL(instance, "parameter %s = %g is not finite", MODEL_PARAMETER_NAMES[i], now->p[i]);
    }
    i = first_not_finite(now->u, MODEL_N_INPUTS);
    if (i >= 0) {
        return FAIL(instance, "input %s = %g is not finite", MODEL_INPUT_NAMES[i], now->u[i]);
    }
    model_checks(arguments, results, iw, w, 0);
    for (i = 0; i < MODEL_N_CHECKS; i++) {
        if (!(isfinite(values[i]) && values[i] >= MODEL_CHECK_MINIMUM[i] && values[i] <= MODEL_CHECK_MAXIMUM[i])) {
            return FAIL(instance, "%s = %g is not a number between %g and %g: check the parameters",
                        MODEL_CHECK_NAMES[i], values[i], MODEL_CHECK_MINIMUM[i], MODEL_CHECK_MAXIMUM[i]);
        }
    }
    evaluate(instance);
    i = first_not_finite(now->x, MODEL_N_STATES);
    if (i >= 0) {
        return FAIL(instance, "start of %s = %g is not finite: check the parameters", MODEL_STATE_NAMES[i], now->x[i]);
    }
    i = first_not_finite(instance->derivatives, MODEL_N_STATES);
    if (i >= 0) {
        return FAIL(instance, "der(%s) = %g at the start is not finite: check the parameters", MODEL_STATE_NAMES[i],
                    instance->derivatives[i]);
    }
    i = first_not_finite(instance->outputs, MODEL_N_OUTPUTS);
    if (i >= 0) {
        return FAIL(instance, "output %s = %g at the start is not finite: check the parameters", MODEL_OUTPUT_NAMES[i],
                    instance->outputs[i]);
    }
    return fmi2OK;
}

static void set_defaults(Instance *instance)
{
    State *now = &instance->now;
    memset(now, 0, sizeof(*now));
    now->stop = HUGE_VAL;
    now->phase = INSTANTIATED;
    memcpy(now->u, MODEL_INPUT_START, sizeof(double) * MODEL_N_INPUTS);
    memcpy(now->p, MODEL_PARAMETER_START, sizeof(double) * MODEL_N_PARAMETERS);
    set_start_states(instance);
    instance->current = 0;
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
    Instance *instance = calloc(1, sizeof(Instance));
    if (instance == NULL) {
        return NULL;
    }
    instance->type = type;
    instance->callbacks = callbacks;
    snprintf(instance->name, sizeof(instance->name), "%s", name != NULL ? name : "");
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        complain(instance, "GUID %s does not belong to this binary, which has %s", guid != NULL ? guid : "(none)",
                 MODEL_GUID);
        free(instance);
        return NULL;
    }
    set_defaults(instance);
    return instance;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    Instance *instance = c;
    (void)tolerance_defined;
    (void)tolerance;
    if (instance->now.phase != INSTANTIATED) {
        return refuse(instance, "fmi2SetupExperiment");
    }
    instance->now.t = start;
    instance->now.stop = stop_defined ? stop : HUGE_VAL;
    instance->current = 0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (instance->now.phase != INSTANTIATED) {
        return refuse(instance, "fmi2EnterInitializationMode");
    }
    instance->now.phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (instance->now.phase != INITIALIZATION) {
        return refuse(instance, "fmi2ExitInitializationMode");
    }
    const fmi2Status status = check_start(instance);
    if (status == fmi2OK) {
        instance->now.phase = instance->type == fmi2CoSimulation ? STEPPING : EVENTS;
    }
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *instance = c;
    if (instance->now.phase < STEPPING || instance->now.phase > CONTINUOUS) {
        return refuse(instance, "fmi2Terminate");
    }
    instance->now.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    set_defaults(c);
    return fmi2OK;
}

/* ---- values ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Real values[])
{
    Instance *instance = c;
    evaluate(instance);
    for (size_t i = 0; i < n; i++) {
        const fmi2ValueReference r = references[i];
        if (r >= N_REFERENCES) {
            return complain(instance, "fmi2GetReal: there is no value reference %u", r);
        } else if (r >= FIRST_OUTPUT) {
            values[i] = instance->outputs[r - FIRST_OUTPUT];
        } else if (r >= FIRST_PARAMETER) {
            values[i] = instance->now.p[r - FIRST_PARAMETER];
        } else if (r >= FIRST_INPUT) {
            values[i] = instance->now.u[r - FIRST_INPUT];
        } else if (r >= FIRST_DERIVATIVE) {
            values[i] = instance->derivatives[r - FIRST_DERIVATIVE];
        } else {
            values[i] = instance->now.x[r];
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Real values[])
{
    Instance *instance = c;
    State *now = &instance->now;
    for (size_t i = 0; i < n; i++) {
        const fmi2ValueReference r = references[i];
        if (r >= FIRST_INPUT && r < FIRST_PARAMETER) {
            now->u[r - FIRST_INPUT] = values[i];
        } else if (r >= FIRST_PARAMETER && r < FIRST_OUTPUT) {
            if (now->phase > INITIALIZATION) {
                return complain(instance, "parameter %s is fixed: set it before the initialization ends",
                                MODEL_PARAMETER_NAMES[r - FIRST_PARAMETER]);
            }
            now->p[r - FIRST_PARAMETER] = values[i];
        } else {
            return complain(instance, "fmi2SetReal: value reference %u is neither input nor parameter", r);
        }
    }
    instance->current = 0;
    return fmi2OK;
}

/* There are no variables of other types. */
#define NO_VARIABLES(Type)                                                                                             \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2##Type values[])    \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        return n == 0 ? fmi2OK : complain(c, "there are no variables of type " #Type);                                 \
    }                                                                                                                  \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference references[], size_t n,                         \
                             const fmi2##Type values[])                                                                \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        return n == 0 ? fmi2OK : complain(c, "there are no variables of type " #Type);                                 \
    }

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

/* Derivatives of (states at the start, der, outputs) along a direction in (states, inputs, parameters). During the
 * initialization the states follow the parameters; afterwards they are independent. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seeds[],
                                        fmi2Real results[])
{
    Instance *instance = c;
    const State *now = &instance->now;
    double dx[ROOM(MODEL_N_STATES)] = {0.0}, du[ROOM(MODEL_N_INPUTS)] = {0.0}, dp[ROOM(MODEL_N_PARAMETERS)] = {0.0};
    double derivatives[ROOM(MODEL_N_STATES)], outputs[ROOM(MODEL_N_OUTPUTS)], w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const int at_start = now->phase <= INITIALIZATION;
    evaluate(instance);
    for (size_t i = 0; i < n_knowns; i++) {
        const fmi2ValueReference r = knowns[i];
        if (r >= FIRST_INPUT && r < FIRST_PARAMETER) {
            du[r - FIRST_INPUT] = seeds[i];
        } else if (r >= FIRST_PARAMETER && r < FIRST_OUTPUT) {
            dp[r - FIRST_PARAMETER] = seeds[i];
        } else if (r < FIRST_DERIVATIVE && !at_start) {
            dx[r] = seeds[i];
        } else {
            return complain(instance, "fmi2GetDirectionalDerivative: value reference %u is not known now", r);
        }
    }
    if (at_start) {
        const double *arguments[] = {now->p, dp};
        double *targets[] = {dx};
        model_start_forward(arguments, targets, iw, w, 0);
    }
    const double *arguments[] = {&now->t, now->x, now->u, now->p, dx, du, dp};
    double *targets[] = {derivatives, outputs};
    model_forward(arguments, targets, iw, w, 0);
    for (size_t i = 0; i < n_unknowns; i++) {
        const fmi2ValueReference r = unknowns[i];
        if (r >= FIRST_OUTPUT && r < N_REFERENCES) {
            results[i] = outputs[r - FIRST_OUTPUT];
        } else if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT) {
            results[i] = derivatives[r - FIRST_DERIVATIVE];
        } else if (r < FIRST_DERIVATIVE && at_start) {
            results[i] = dx[r];
        } else {
            return complain(instance, "fmi2GetDirectionalDerivative: value reference %u is not unknown now", r);
        }
    }
    return fmi2OK;
}

/* ---- saved states ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    Instance *instance = c;
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return complain(instance, "no memory for an FMU state");
    }
    memcpy(*saved, &instance->now, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    Instance *instance = c;
    memcpy(&instance->now, saved, sizeof(State));
    instance->current = 0;
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
        return complain(c, "fmi2SerializeFMUstate: the buffer is too small");
    }
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (size != sizeof(State)) {
        return complain(c, "fmi2DeSerializeFMUstate: these bytes are not a state of this FMU");
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return complain(c, "no memory for an FMU state");
    }
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}

/* ---- co-simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_return)
{
    Instance *instance = c;
    State *now = &instance->now;
    (void)no_return;
    if (now->phase != STEPPING) {
        return refuse(instance, "fmi2DoStep");
    }
    if (!(isfinite(h) && h >= 0.0)) {
        return FAIL(instance, "fmi2DoStep: the step size %g is not a duration", h);
    }
    /* Masters add up their time in different ways; a thousandth of a step is no rounding any more. */
    if (!(fabs(t - now->t) <= 1e-3 * h)) {
        return FAIL(instance, "fmi2DoStep: asked to step from %.10g, but the time is %.10g", t, now->t);
    }
    if (t + h > now->stop + 1e-3 * h) {
        return FAIL(instance, "fmi2DoStep: a step to %.10g passes the stop time %.10g", t + h, now->stop);
    }
    if (model_advance(t, h, now->x, now->u, now->p, &instance->propagators) != 0) {
        const int i = first_not_finite(now->u, MODEL_N_INPUTS);
        if (i >= 0) {
            return FAIL(instance, "input %s = %g at %.10g s is not finite", MODEL_INPUT_NAMES[i], now->u[i], t);
        }
        return FAIL(instance, "the states diverge in the step from %.10g s: check the parameters", t);
    }
    now->t = t + h;
    instance->current = 0;
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "fmi2CancelStep");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return refuse(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                        const fmi2Integer orders[], fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return refuse(c, "fmi2GetRealOutputDerivatives");
}

/* No step is ever pending. */
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    const Instance *instance = c;
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = instance->now.t;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
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

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *instance = c;
    if (instance->now.phase != CONTINUOUS && instance->now.phase != EVENTS) {
        return refuse(instance, "fmi2EnterEventMode");
    }
    instance->now.phase = EVENTS;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)c;
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    info->nextEventTime = 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *instance = c;
    if (instance->now.phase != EVENTS) {
        return refuse(instance, "fmi2EnterContinuousTimeMode");
    }
    instance->now.phase = CONTINUOUS;
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
    Instance *instance = c;
    instance->now.t = t;
    instance->current = 0;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    Instance *instance = c;
    if (n != MODEL_N_STATES) {
        return complain(instance, "fmi2SetContinuousStates: there are %d states", MODEL_N_STATES);
    }
    memcpy(instance->now.x, x, sizeof(double) * MODEL_N_STATES);
    instance->current = 0;
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n)
{
    Instance *instance = c;
    if (n != MODEL_N_STATES) {
        return complain(instance, "fmi2GetDerivatives: there are %d states", MODEL_N_STATES);
    }
    evaluate(instance);
    memcpy(derivatives, instance->derivatives, sizeof(double) * MODEL_N_STATES);
    const int i = first_not_finite(derivatives, MODEL_N_STATES);
    return i < 0 ? fmi2OK : complain(instance, "der(%s) = %g is not finite", MODEL_STATE_NAMES[i], derivatives[i]);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    (void)indicators;
    return n == 0 ? fmi2OK : complain(c, "fmi2GetEventIndicators: there are none");
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Instance *instance = c;
    if (n != MODEL_N_STATES) {
        return complain(instance, "fmi2GetContinuousStates: there are %d states", MODEL_N_STATES);
    }
    evaluate(instance);
    memcpy(x, instance->now.x, sizeof(double) * MODEL_N_STATES);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    if (n != MODEL_N_STATES) {
        return complain(c, "fmi2GetNominalsOfContinuousStates: there are %d states", MODEL_N_STATES);
    }
    for (size_t i = 0; i < n; i++) {
        nominals[i] = 1.0;
    }
    return fmi2OK;
}

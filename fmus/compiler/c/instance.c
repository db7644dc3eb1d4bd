/* An instance of the model, whatever the version of FMI: values, phases, initialization and steps. */
#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model_data.h"

#define LONGEST_MESSAGE 512

/* An error that leaves nothing to go on with. */
#define FAIL(instance, ...) ((instance)->now.phase = FAILED, instance_complain((instance), __VA_ARGS__))

int instance_complain(const Instance *instance, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list values;
    va_start(values, format);
    vsnprintf(message, sizeof(message), format, values);
    va_end(values);
    instance->report(instance, message);
    return 1;
}

int instance_refuse(const Instance *instance, const char *function)
{
    return instance_complain(instance, "%s is not allowed now", function);
}

void instance_touch(Instance *instance)
{
    instance->current = 0;
}

static void set_start_values(Instance *instance)
{
    double start[ROOM(MODEL_N_STATES + MODEL_N_DISCRETE)], w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    State *now = &instance->now;
    const double *arguments[] = {now->p};
    double *results[] = {start};
    model_start(arguments, results, iw, w, 0);
    memcpy(now->x, start, sizeof(double) * MODEL_N_STATES);
    memcpy(now->held + MODEL_N_INPUTS, start + MODEL_N_STATES, sizeof(double) * MODEL_N_DISCRETE);
}

static void evaluate(Instance *instance)
{
    if (instance->current) {
        return;
    }
    State *now = &instance->now;
    if (now->phase <= INITIALIZATION) {
        int ignored;
        set_start_values(instance);
        instance_settle(instance, &ignored);
    }
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {&now->t, now->x, now->held, now->p};
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

void instance_reset(Instance *instance)
{
    State *now = &instance->now;
    memset(now, 0, sizeof(*now));
    now->stop = HUGE_VAL;
    now->phase = INSTANTIATED;
    memcpy(now->held, MODEL_INPUT_START, sizeof(double) * MODEL_N_INPUTS);
    memcpy(now->p, MODEL_PARAMETER_START, sizeof(double) * MODEL_N_PARAMETERS);
    set_start_values(instance);
    instance->current = 0;
}

/* What a component cannot be built with (a capacity below zero) must not become a trajectory. */
static int check_start(Instance *instance)
{
    State *now = &instance->now;
    double values[ROOM(MODEL_N_CHECKS)], w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {now->p};
    double *results[] = {values};
    int i = first_not_finite(now->p, MODEL_N_PARAMETERS);
    if (i >= 0) {
        return FAIL(instance, "parameter %s = %g is not finite", MODEL_PARAMETER_NAMES[i], now->p[i]);
    }
    i = first_not_finite(now->held, MODEL_N_INPUTS);
    if (i >= 0) {
        return FAIL(instance, "input %s = %g is not finite", MODEL_INPUT_NAMES[i], now->held[i]);
    }
    model_checks(arguments, results, iw, w, 0);
    for (i = 0; i < MODEL_N_CHECKS; i++) {
        if (!(isfinite(values[i]) && values[i] >= MODEL_CHECK_MINIMUM[i] && values[i] <= MODEL_CHECK_MAXIMUM[i])) {
            return FAIL(instance, "%s = %g is not a number between %g and %g: check the parameters",
                        MODEL_CHECK_NAMES[i], values[i], MODEL_CHECK_MINIMUM[i], MODEL_CHECK_MAXIMUM[i]);
        }
    }
    instance->current = 0;
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
    return 0;
}

int instance_initialize(Instance *instance)
{
    if (instance->now.phase == FAILED || check_start(instance)) {
        return 1;
    }
    instance->now.phase = instance->steps ? STEPPING : EVENTS;
    return 0;
}

/* ---- values ---- */

int instance_get(Instance *instance, unsigned int r, double *value)
{
    evaluate(instance);
    if (r > TIME_REFERENCE) {
        return instance_complain(instance, "there is no value reference %u", r);
    } else if (r == TIME_REFERENCE) {
        *value = instance->now.t;
    } else if (r >= FIRST_INDICATOR) {
        double indicators[ROOM(MODEL_N_RELATIONS)];
        instance_indicators(instance, indicators);
        *value = indicators[r - FIRST_INDICATOR];
    } else if (r >= FIRST_DISCRETE) {
        *value = instance->now.held[MODEL_N_INPUTS + r - FIRST_DISCRETE];
    } else if (r >= FIRST_OUTPUT) {
        *value = instance->outputs[r - FIRST_OUTPUT];
    } else if (r >= FIRST_PARAMETER) {
        *value = instance->now.p[r - FIRST_PARAMETER];
    } else if (r >= FIRST_INPUT) {
        *value = instance->now.held[r - FIRST_INPUT];
    } else if (r >= FIRST_DERIVATIVE) {
        *value = instance->derivatives[r - FIRST_DERIVATIVE];
    } else {
        *value = instance->now.x[r];
    }
    return 0;
}

int instance_set(Instance *instance, unsigned int r, double value)
{
    State *now = &instance->now;
    if (r >= FIRST_INPUT && r < FIRST_PARAMETER) {
        now->held[r - FIRST_INPUT] = value;
    } else if (r >= FIRST_PARAMETER && r < FIRST_OUTPUT) {
        if (now->phase > INITIALIZATION) {
            return instance_complain(instance, "parameter %s is fixed: set it before the initialization ends",
                                     MODEL_PARAMETER_NAMES[r - FIRST_PARAMETER]);
        }
        now->p[r - FIRST_PARAMETER] = value;
    } else {
        return instance_complain(instance, "value reference %u is neither input nor parameter", r);
    }
    instance->current = 0;
    return 0;
}

int instance_get_states(Instance *instance, double *x)
{
    evaluate(instance);
    memcpy(x, instance->now.x, sizeof(double) * MODEL_N_STATES);
    return 0;
}

int instance_get_derivatives(Instance *instance, double *derivatives)
{
    evaluate(instance);
    memcpy(derivatives, instance->derivatives, sizeof(double) * MODEL_N_STATES);
    const int i = first_not_finite(derivatives, MODEL_N_STATES);
    return i < 0 ? 0 : instance_complain(instance, "der(%s) = %g is not finite", MODEL_STATE_NAMES[i], derivatives[i]);
}

/* ---- directional derivatives: during the initialization the states follow the parameters ---- */

int instance_seed(const Instance *instance, Direction *direction, unsigned int r, double seed)
{
    if (r >= FIRST_INPUT && r < FIRST_PARAMETER) {
        direction->dheld[r - FIRST_INPUT] = seed;
    } else if (r >= FIRST_PARAMETER && r < FIRST_OUTPUT) {
        direction->dp[r - FIRST_PARAMETER] = seed;
    } else if (r < FIRST_DERIVATIVE && instance->now.phase > INITIALIZATION) {
        direction->dx[r] = seed;
    } else {
        return instance_complain(instance, "directional derivative: value reference %u is not known now", r);
    }
    return 0;
}

void instance_derive(Instance *instance, Direction *direction)
{
    const State *now = &instance->now;
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    evaluate(instance);
    if (now->phase <= INITIALIZATION) {
        double start[ROOM(MODEL_N_STATES + MODEL_N_DISCRETE)];
        const double *arguments[] = {now->p, direction->dp};
        double *targets[] = {start};
        model_start_forward(arguments, targets, iw, w, 0);
        memcpy(direction->dx, start, sizeof(double) * MODEL_N_STATES);
        memcpy(direction->dheld + MODEL_N_INPUTS, start + MODEL_N_STATES, sizeof(double) * MODEL_N_DISCRETE);
    }
    const double *arguments[] = {&now->t, now->x, now->held, now->p, direction->dx, direction->dheld, direction->dp};
    double *targets[] = {direction->derivatives, direction->outputs};
    model_forward(arguments, targets, iw, w, 0);
}

int instance_result(const Instance *instance, const Direction *direction, unsigned int r, double *result)
{
    if (r >= FIRST_OUTPUT && r < FIRST_DISCRETE) {
        *result = direction->outputs[r - FIRST_OUTPUT];
    } else if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT) {
        *result = direction->derivatives[r - FIRST_DERIVATIVE];
    } else if (r < FIRST_DERIVATIVE && instance->now.phase <= INITIALIZATION) {
        *result = direction->dx[r];
    } else {
        return instance_complain(instance, "directional derivative: value reference %u is not unknown now", r);
    }
    return 0;
}

/* ---- steps ---- */

#if MODEL_HAS_EVENTS
int advance_to_event(Instance *instance, double t, double h, double *done);
#endif

/* Advance to t + h; lost is where the solution was lost, if it was. */
static int advance(Instance *instance, double t, double h)
{
#if MODEL_HAS_EVENTS
    enum { MOST_EVENTS = 10000 };
    double done = 0.0;
    int ignored;
    if (instance_settle(instance, &ignored)) {
        return -1;
    }
    for (int n = 0; done < h; n++) {
        if (n > MOST_EVENTS + (int)(h / MODEL_MAX_SUBSTEP)) {
            return FAIL(instance, "more than %d events between %.10g s and %.10g s", MOST_EVENTS, t, t + h), -1;
        }
        const int status = advance_to_event(instance, t, h, &done);
        if (status != 0) {
            return status;
        }
    }
    return 0;
#else
    State *now = &instance->now;
    return model_advance(t, h, now->x, now->held, now->p, &instance->propagators);
#endif
}

int instance_step(Instance *instance, double t, double h)
{
    State *now = &instance->now;
    if (!(isfinite(h) && h >= 0.0)) {
        return FAIL(instance, "the step size %g is not a duration", h);
    }
    /* Masters add up their time in different ways; a thousandth of a step is no rounding any more. */
    if (!(fabs(t - now->t) <= 1e-3 * h)) {
        return FAIL(instance, "asked to step from %.10g, but the time is %.10g", t, now->t);
    }
    if (t + h > now->stop + 1e-3 * h) {
        return FAIL(instance, "a step to %.10g passes the stop time %.10g", t + h, now->stop);
    }
    instance->current = 0;
    const int status = advance(instance, t, h);
    if (status > 0) {
        const int i = first_not_finite(now->held, MODEL_N_INPUTS);
        if (i >= 0) {
            return FAIL(instance, "input %s = %g at %.10g s is not finite", MODEL_INPUT_NAMES[i], now->held[i], t);
        }
        return FAIL(instance, "the states diverge in the step from %.10g s: check the parameters", t);
    }
    if (status < 0) {
        return 1;
    }
    now->t = t + h;
    return 0;
}

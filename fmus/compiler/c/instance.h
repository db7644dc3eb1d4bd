/* An instance of the model, whatever the version of FMI: values, phases, initialization, steps and events.
 *
 * Value references are in this order: states, their derivatives, inputs, parameters, outputs, discrete variables, event
 * indicators, time. What is constant between two events is one array, `held`: inputs, discrete variables, and the truth
 * values of the relations, which change at events alone. A function returns 0, or 1 after it has reported an error; an
 * instance that has failed goes on only after a reset or with a saved state. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>

#include "integrate.h"

#define FIRST_DERIVATIVE MODEL_N_STATES
#define FIRST_INPUT (2 * MODEL_N_STATES)
#define FIRST_PARAMETER (FIRST_INPUT + MODEL_N_INPUTS)
#define FIRST_OUTPUT (FIRST_PARAMETER + MODEL_N_PARAMETERS)
#define FIRST_DISCRETE (FIRST_OUTPUT + MODEL_N_OUTPUTS)
#define FIRST_INDICATOR (FIRST_DISCRETE + MODEL_N_DISCRETE)
#define TIME_REFERENCE (FIRST_INDICATOR + MODEL_N_RELATIONS)
#define N_HELD (MODEL_N_INPUTS + MODEL_N_DISCRETE + MODEL_N_RELATIONS)

typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, EVENTS, CONTINUOUS, TERMINATED, FAILED } Phase;

/* All that an instance remembers between two calls, and so all that an FMU state contains. */
typedef struct {
    double t;
    double stop;
    double x[ROOM(MODEL_N_STATES)];
    double held[ROOM(N_HELD)];
    double p[ROOM(MODEL_N_PARAMETERS)];
    double conditions[ROOM(MODEL_N_BRANCHES)]; /* of the branches of when, at the last event */
    Phase phase;
} State;

typedef struct Instance {
    State now;
    double derivatives[ROOM(MODEL_N_STATES)];
    double outputs[ROOM(MODEL_N_OUTPUTS)];
    int current; /* derivatives and outputs belong to now */
    Propagators propagators;
    int steps; /* it makes its own steps: co-simulation */
    void (*report)(const struct Instance *, const char *message);
    char name[64];
} Instance;

HIDDEN_BEGIN

int instance_complain(const Instance *instance, const char *format, ...);
int instance_refuse(const Instance *instance, const char *function);
void instance_reset(Instance *instance);
void instance_touch(Instance *instance);
int instance_initialize(Instance *instance);
int instance_get(Instance *instance, unsigned int reference, double *value);
int instance_set(Instance *instance, unsigned int reference, double value);
int instance_get_states(Instance *instance, double *x);
int instance_get_derivatives(Instance *instance, double *derivatives);
int instance_step(Instance *instance, double t, double h);

/* Derivatives of (states at the start, der, outputs) along a direction in (states, inputs, parameters); reference by
 * reference, the caller gives seeds and takes results. */
typedef struct {
    double dx[ROOM(MODEL_N_STATES)];
    double dheld[ROOM(N_HELD)];
    double dp[ROOM(MODEL_N_PARAMETERS)];
    double derivatives[ROOM(MODEL_N_STATES)];
    double outputs[ROOM(MODEL_N_OUTPUTS)];
} Direction;

int instance_seed(const Instance *instance, Direction *direction, unsigned int known, double seed);
void instance_derive(Instance *instance, Direction *direction);
int instance_result(const Instance *instance, const Direction *direction, unsigned int unknown, double *result);

/* Bring relations, discrete variables and reinitialized states to a standstill. */
int instance_settle(Instance *instance, int *states_changed);
void instance_indicators(Instance *instance, double *indicators);

HIDDEN_END

#endif

/* Advance the states of the model over a communication step, inputs held. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "model.h"

/* C has no arrays of length zero. */
#define ROOM(n) ((n) > 0 ? (n) : 1)
#define N_PROPAGATORS 8

/* Solution of an affine model over one step: x(t + h) = transition * x(t) + forcing * rest. */
typedef struct {
    double matrix[ROOM(MODEL_N_STATES * MODEL_N_STATES)];
    double transition[ROOM(MODEL_N_STATES * MODEL_N_STATES)];
    double forcing[ROOM(MODEL_N_STATES * MODEL_N_STATES)];
    double step;
    int valid;
} Propagator;

/* The propagators that were used last. A circuit switches between few states, so few matrices recur. */
typedef struct {
    Propagator entries[N_PROPAGATORS];
    int latest;
} Propagators;

HIDDEN_BEGIN

/* Advance x from t to t + h. Returns 0, or 1 when the solution is lost (x is then undefined). */
int model_advance(double t, double h, double *x, const double *u, const double *p, Propagators *propagators);

HIDDEN_END

#endif

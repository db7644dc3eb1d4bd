/* State events: relations that hold still between events, and the branches of when that act at them. */
#include "instance.h"

#include <math.h>
#include <string.h>

#include "model_data.h"

#define RELATIONS(now) ((now)->held + MODEL_N_INPUTS + MODEL_N_DISCRETE)

#if MODEL_HAS_EVENTS

/* Distance by which an indicator lies beyond its zero, so that a solver that stops at the crossing has crossed. */
#define BEYOND 1e-10
#define MOST_ROUNDS 100
#define MOST_TRIALS 300
/* The time of an event is known to this part of the time. */
#define CLOCK 4e-16

HIDDEN_BEGIN
int advance_to_event(Instance *instance, double t, double h, double *done);
HIDDEN_END

/* Margins of the relations (left side minus right side, positive where true) and their truth values. */
static void look(const State *now, double *margins, double *truth)
{
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {&now->t, now->x, now->held, now->p};
    double *results[] = {margins, truth};
    model_relations(arguments, results, iw, w, 0);
}

static void look_at_conditions(const State *now, double *conditions)
{
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {&now->t, now->x, now->held, now->p};
    double *results[] = {conditions};
    model_conditions(arguments, results, iw, w, 0);
}

/* Do what the first branch of each when that has become true says. All see the values from before. */
static int act(State *now, int *states_changed)
{
    enum { N_TARGETS = MODEL_N_STATES + MODEL_N_DISCRETE };
    double conditions[ROOM(MODEL_N_BRANCHES)], actions[ROOM(MODEL_N_BRANCHES * N_TARGETS)], w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK], acted = 0, evaluated = 0, decided = -1;
    look_at_conditions(now, conditions);
    const State before = *now;
    for (int k = 0; k < MODEL_N_BRANCHES; k++) {
        const int rises = conditions[k] != 0.0 && before.conditions[k] == 0.0;
        now->conditions[k] = conditions[k];
        if (!rises || MODEL_WHEN_OF_BRANCH[k] == decided) {
            continue;
        }
        decided = MODEL_WHEN_OF_BRANCH[k];
        if (!evaluated) {
            const double *arguments[] = {&before.t, before.x, before.held, before.p};
            double *results[] = {actions};
            model_actions(arguments, results, iw, w, 0);
            evaluated = 1;
        }
        for (int i = 0; i < N_TARGETS; i++) {
            if (!MODEL_BRANCH_SETS[k * N_TARGETS + i]) {
                continue;
            }
            double *target = i < MODEL_N_STATES ? &now->x[i] : &now->held[MODEL_N_INPUTS + i - MODEL_N_STATES];
            *target = actions[k * N_TARGETS + i];
            *states_changed |= i < MODEL_N_STATES;
            acted = 1;
        }
    }
    return acted;
}

int instance_settle(Instance *instance, int *states_changed)
{
    State *now = &instance->now;
    double margins[ROOM(MODEL_N_RELATIONS)], truth[ROOM(MODEL_N_RELATIONS)];
    const size_t size = sizeof(double) * MODEL_N_RELATIONS;
    *states_changed = 0;
    for (int n = 0; n < MOST_ROUNDS; n++) {
        look(now, margins, truth);
        int changed = memcmp(truth, RELATIONS(now), size) != 0;
        memcpy(RELATIONS(now), truth, size);
        if (now->phase <= INITIALIZATION) {
            /* No branch acts because it is true from the beginning. */
            look_at_conditions(now, now->conditions);
        } else {
            changed |= act(now, states_changed);
        }
        if (!changed) {
            instance->current = 0;
            return 0;
        }
    }
    now->phase = FAILED;
    return instance_complain(instance, "the event at %.10g s does not end: its conditions contradict each other", now->t);
}

void instance_indicators(Instance *instance, double *indicators)
{
    const State *now = &instance->now;
    double truth[ROOM(MODEL_N_RELATIONS)];
    look(now, indicators, truth);
    for (int i = 0; i < MODEL_N_RELATIONS; i++) {
        indicators[i] += RELATIONS(now)[i] != 0.0 ? BEYOND : -BEYOND;
    }
}

/* Where, between two times, the first of the relations that change crosses its zero, if margins were straight lines. */
static double guess(const State *now, const double *left, const double *right, const double *truth)
{
    double earliest = 1.0;
    for (int i = 0; i < MODEL_N_RELATIONS; i++) {
        if (truth[i] != RELATIONS(now)[i] && left[i] != right[i]) {
            earliest = fmin(earliest, left[i] / (left[i] - right[i]));
        }
    }
    return fmax(earliest, 0.0);
}

/* Advance from t + *done to the next event, at most a substep and at most to t + h, and settle it. */
int advance_to_event(Instance *instance, double t, double h, double *done)
{
    State *now = &instance->now;
    State left = *now, right = *now;
    double low_margins[ROOM(MODEL_N_RELATIONS)], high_margins[ROOM(MODEL_N_RELATIONS)];
    double margins[ROOM(MODEL_N_RELATIONS)], truth[ROOM(MODEL_N_RELATIONS)], high_truth[ROOM(MODEL_N_RELATIONS)];
    const size_t size = sizeof(double) * MODEL_N_RELATIONS;
    const double from = *done, rest = h - from;
    const double whole = rest > MODEL_MAX_SUBSTEP * (1.0 + 1e-9) ? MODEL_MAX_SUBSTEP : rest;
    double low = 0.0, high = whole, step = whole, last = 0.0;
    left.t = t + from;
    look(&left, low_margins, truth);
    for (int n = 0; n < MOST_TRIALS; n++) {
        State here = left;
        if (model_advance(left.t, step, here.x, here.held, here.p, &instance->propagators) != 0) {
            return 1;
        }
        here.t = left.t + step;
        look(&here, margins, truth);
        const int crossed = memcmp(truth, RELATIONS(now), size) != 0;
        if (crossed) {
            right = here;
            high = step;
            memcpy(high_margins, margins, size);
            memcpy(high_truth, truth, size);
        } else if (step == whole) {
            *now = here;
            *done = whole == rest ? h : from + whole;
            return 0;
        } else {
            low = step;
            memcpy(low_margins, margins, size);
        }
        if (high - low <= CLOCK * fmax(fabs(right.t), whole)) {
            break;
        }
        /* A straight line to the crossing, and past it by as much as the line was wrong before, so that the crossing
         * gets between two near points; every third trial halves, in case there are no straight lines. */
        const double straight = low + (high - low) * guess(now, low_margins, high_margins, high_truth);
        const double margin = fmax(fabs(straight - last), 0.5 * CLOCK * fmax(fabs(right.t), whole));
        last = straight;
        step = crossed ? straight - margin : straight + margin;
        if (n % 3 == 2 || !(step > low && step < high)) {
            step = 0.5 * (low + high);
        }
    }
    int ignored;
    *now = right;
    *done = high == rest ? h : from + high;
    return instance_settle(instance, &ignored) ? -1 : 0;
}

#else

int instance_settle(Instance *instance, int *states_changed)
{
    (void)instance;
    *states_changed = 0;
    return 0;
}

void instance_indicators(Instance *instance, double *indicators)
{
    (void)instance;
    (void)indicators;
}

#endif

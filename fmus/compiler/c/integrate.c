/* Advance the states of the model over a communication step, inputs held. */
#include "integrate.h"

#include <math.h>
#include <string.h>

#define N MODEL_N_STATES

static int all_finite(const double *values)
{
    for (int i = 0; i < N; i++) {
        if (!isfinite(values[i])) {
            return 0;
        }
    }
    return 1;
}

#if MODEL_EXACT

static void multiply(const double *a, const double *b, double *product)
{
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++) {
            double sum = 0.0;
            for (int k = 0; k < N; k++) {
                sum += a[i * N + k] * b[k * N + j];
            }
            product[i * N + j] = sum;
        }
    }
}

/* transition = exp(A h) and forcing = integral of exp(A s) over s from 0 to h: the Taylor series over a step short
 * enough (norm at most 1/2: 15 terms leave less than one rounding), doubled back to h. */
static int make_propagator(Propagator *result)
{
    const double *a = result->matrix;
    double norm = 0.0;
    for (int i = 0; i < N; i++) {
        double row = 0.0;
        for (int j = 0; j < N; j++) {
            row += fabs(a[i * N + j]);
        }
        norm = row > norm ? row : norm;
        if (!isfinite(row)) {
            return 1;
        }
    }
    int n_doublings = 0;
    double h = result->step;
    while (norm * h > 0.5) {
        h *= 0.5;
        n_doublings++;
    }
    double term[N * N], product[N * N];
    for (int i = 0; i < N * N; i++) {
        term[i] = i % (N + 1) == 0 ? 1.0 : 0.0;
        result->transition[i] = 0.0;
        result->forcing[i] = 0.0;
    }
    for (int order = 1; order <= 15; order++) {
        for (int i = 0; i < N * N; i++) {
            result->transition[i] += term[i];
            result->forcing[i] += term[i] * h / order;
        }
        multiply(a, term, product);
        for (int i = 0; i < N * N; i++) {
            term[i] = product[i] * h / order;
        }
    }
    for (int k = 0; k < n_doublings; k++) {
        multiply(result->transition, result->forcing, product);
        for (int i = 0; i < N * N; i++) {
            result->forcing[i] += product[i];
        }
        multiply(result->transition, result->transition, product);
        memcpy(result->transition, product, sizeof(product));
    }
    return 0;
}

static const Propagator *find_propagator(Propagators *cache, const double *matrix, double h)
{
    const size_t size = sizeof(double) * N * N;
    for (int i = 0; i < N_PROPAGATORS; i++) {
        const int index = (cache->latest + N_PROPAGATORS - i) % N_PROPAGATORS;
        const Propagator *entry = &cache->entries[index];
        if (entry->valid && entry->step == h && memcmp(entry->matrix, matrix, size) == 0) {
            return entry;
        }
    }
    cache->latest = (cache->latest + 1) % N_PROPAGATORS;
    Propagator *entry = &cache->entries[cache->latest];
    memcpy(entry->matrix, matrix, size);
    entry->step = h;
    entry->valid = make_propagator(entry) == 0;
    return entry->valid ? entry : NULL;
}

int model_advance(double t, double h, double *x, const double *u, const double *p, Propagators *propagators)
{
    (void)t;
    double matrix[N * N], rest[N], next[N], w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {u, p};
    double *results[] = {matrix, rest};
    if (model_affine(arguments, results, iw, w, 0) != 0) {
        return 1;
    }
    const Propagator *propagator = find_propagator(propagators, matrix, h);
    if (propagator == NULL) {
        return 1;
    }
    for (int i = 0; i < N; i++) {
        double sum = 0.0;
        for (int j = 0; j < N; j++) {
            sum += propagator->transition[i * N + j] * x[j] + propagator->forcing[i * N + j] * rest[j];
        }
        next[i] = sum;
    }
    memcpy(x, next, sizeof(next));
    return !all_finite(x);
}

#else

static int derivatives(double t, const double *x, const double *u, const double *p, double *result)
{
    double w[MODEL_WORK];
    int iw[MODEL_INTEGER_WORK];
    const double *arguments[] = {&t, x, u, p};
    double *results[] = {result};
    return model_derivatives(arguments, results, iw, w, 0);
}

/* One step of the classical fourth-order Runge-Kutta method. */
static int runge_kutta(double t, double h, const double *x, const double *u, const double *p, double *result)
{
    static const double where[] = {0.0, 0.5, 0.5, 1.0};
    static const double weight[] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    double stage[N], slope[N], sum[N];
    memset(slope, 0, sizeof(slope));
    memset(sum, 0, sizeof(sum));
    for (int k = 0; k < 4; k++) {
        for (int i = 0; i < N; i++) {
            stage[i] = x[i] + where[k] * h * slope[i];
        }
        if (derivatives(t + where[k] * h, stage, u, p, slope) != 0) {
            return 1;
        }
        for (int i = 0; i < N; i++) {
            sum[i] += weight[k] * slope[i];
        }
    }
    for (int i = 0; i < N; i++) {
        result[i] = x[i] + h * sum[i];
    }
    return !all_finite(result);
}

/* Error of the two half steps, from their difference to the whole one (order 4: a fifteenth of it). */
static double error_of(const double *whole, const double *halves)
{
    double worst = 0.0;
    for (int i = 0; i < N; i++) {
        const double error = fabs(halves[i] - whole[i]) / (15.0 * (1.0 + fabs(halves[i])));
        worst = error > worst ? error : worst;
    }
    return worst;
}

/* Every substep is also done as two halves, whose result is kept; a substep that is too inaccurate (or unstable, which
 * shows as inaccuracy long before it hurts) is halved. The control starts anew at each communication point, so that
 * a step depends on nothing but its own start. */
int model_advance(double t, double h, double *x, const double *u, const double *p, Propagators *propagators)
{
    (void)propagators;
    const double longest = h / fmax(1.0, ceil(h / MODEL_MAX_SUBSTEP));
    const double shortest = longest * 0x1p-30;
    double remaining = h, step = longest;
    double whole[N], half[N], halves[N];
    while (remaining > 0.0) {
        if (step > remaining * (1.0 - 1e-9)) {
            step = remaining;
        }
        const int lost = runge_kutta(t, step, x, u, p, whole) || runge_kutta(t, 0.5 * step, x, u, p, half)
                         || runge_kutta(t + 0.5 * step, 0.5 * step, half, u, p, halves);
        const double error = lost ? HUGE_VAL : error_of(whole, halves);
        if (error <= MODEL_TOLERANCE) {
            memcpy(x, halves, sizeof(halves));
            t += step;
            remaining -= step;
            /* Doubling costs a factor of 32 in the error. */
            if (error < MODEL_TOLERANCE / 64.0) {
                step = fmin(2.0 * step, longest);
            }
        } else {
            step *= 0.5;
            if (step < shortest) {
                return 1;
            }
        }
    }
    return 0;
}

#endif

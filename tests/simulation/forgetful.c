/* An FMI 2.0 co-simulation FMU whose reset forgets to forget; FAULT, chosen when compiling, says what.
 *
 * x' = -k (x - u - q) from x0, stepped exactly; q is 20 while a switch is on, which closes below 285 and opens above
 * 300. Outputs: y = x and z = 2 x. References: 0 k, 1 x0, 2 u (input), 3 y, 4 z. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NONE 0
#define DISCRETE_STATE 1  /* the switch stays as it was */
#define CLOCK 2           /* a drift counts from the first simulation of the instance on */
#define RANDOM_STREAM 3   /* noise of a stream that goes on */
#define FILE_HANDLE 4     /* offsets are read from a file that is opened once */
#define STATIC_MEMORY 5   /* the switch of the process, not of the instance */
#define COUNTER 6         /* right until the 25th simulation of the process, and from then on ever more wrong */
#define ONE_OUTPUT 7      /* z lags behind by what it was before */
#define FIRST_INPUT 8     /* the input of the first step is that of the first simulation, scaled by its k */
#define PARAMETER_CACHED 9 /* exp(-k h) is reckoned once */
#define STEP_KEPT 10      /* the solver goes on with the step that it had found */
#ifndef FAULT
#define FAULT NONE
#endif

typedef struct { double k, x0, u, x, z, clock, first_u, decay, step; int on, n_steps; FILE *file; } Room;
static int process_on = 0, n_simulations = 0;
static unsigned long stream = 1;

static void defaults(Room *m)
{
    const Room old = *m;
    memset(m, 0, sizeof(*m));
    m->k = 1e-4;
    m->x0 = 300.0;
    m->step = 600.0;
    if (FAULT == DISCRETE_STATE) m->on = old.on;
    if (FAULT == CLOCK) m->clock = old.clock;
    if (FAULT == FILE_HANDLE) m->file = old.file;
    if (FAULT == ONE_OUTPUT) m->z = old.z;
    if (FAULT == FIRST_INPUT) m->first_u = old.first_u;
    if (FAULT == PARAMETER_CACHED) m->decay = old.decay;
    if (FAULT == STEP_KEPT && old.step > 0.0) m->step = old.step;
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int k, const char *g, const char *r, const void *c, int v, int l)
{
    Room *m = calloc(1, sizeof(*m));
    defaults(m);
    return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2SetupExperiment(Room *m, int td, double tol, double t0, int sd, double t1) { return 0; }
int fmi2EnterInitializationMode(Room *m) { return 0; }
int fmi2ExitInitializationMode(Room *m)
{
    m->x = m->x0;
    if (FAULT != ONE_OUTPUT) m->z = 2.0 * m->x;
    n_simulations++;
    return 0;
}
int fmi2Terminate(Room *m) { return 0; }
int fmi2Reset(Room *m) { defaults(m); return 0; }
int fmi2DoStep(Room *m, double t, double h, int keep)
{
    int *on = FAULT == STATIC_MEMORY ? &process_on : &m->on;
    double u = m->u, rate = m->k, end;
    if (m->x > 300.0) *on = 0;
    if (m->x < 285.0) *on = 1;
    if (FAULT == FIRST_INPUT) {
        if (m->first_u == 0.0) m->first_u = m->u + 1e4 * m->k;
        if (t == 0.0) u = m->first_u;
    }
    if (FAULT == PARAMETER_CACHED) {
        if (m->decay == 0.0) m->decay = exp(-m->k * h);
    } else {
        m->decay = exp(-rate * h);
    }
    end = u + (*on ? 20.0 : 0.0);
    if (FAULT == STEP_KEPT) {
        /* Euler, with steps that shrink where x is steep and stay so. */
        double left = h;
        while (left > 1e-9) {
            double slope = -rate * (m->x - end), now;
            while (fabs(slope) * m->step > 0.5) m->step /= 2.0;
            now = m->step < left ? m->step : left;
            m->x += slope * now;
            left -= now;
        }
    } else {
        m->x = end + (m->x - end) * m->decay;
    }
    m->clock += h;
    if (FAULT == CLOCK) m->x += 1e-7 * (m->clock - h - t);
    if (FAULT == RANDOM_STREAM) {
        stream = stream * 6364136223846793005UL + 1442695040888963407UL;
        m->x += 1e-12 * (double)(stream >> 40);
    }
    if (FAULT == FILE_HANDLE) {
        if (m->file == NULL) m->file = tmpfile();
        if (m->n_steps == 0) m->x += 1e-3 * (double)ftell(m->file);
        fputc('x', m->file);
    }
    if (FAULT == COUNTER && n_simulations > 25) m->x += 1e-4 * (n_simulations - 25);
    m->z = FAULT == ONE_OUTPUT ? 0.5 * m->z + m->x : 2.0 * m->x;
    m->n_steps++;
    return 0;
}
int fmi2SetReal(Room *m, const unsigned *r, size_t n, const double *x)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] == 0) m->k = x[i];
        if (r[i] == 1) m->x0 = x[i];
        if (r[i] == 2) m->u = x[i];
    }
    return 0;
}
int fmi2GetReal(Room *m, const unsigned *r, size_t n, double *x)
{
    for (size_t i = 0; i < n; i++) x[i] = r[i] == 0 ? m->k : r[i] == 1 ? m->x0 : r[i] == 2 ? m->u : r[i] == 3 ? m->x : m->z;
    return 0;
}

/* Small models behind the model-exchange functions of FMI 2.0 or, with -DFMI3, FMI 3.0; `mode` chooses one.
 *
 * References: 0 mode, 1 a, 2 b, 3 u (input), 4 x0, 5 x1, 6 der(x0), 7 der(x1), 8 y (output), 9 n (output: events),
 * 10 nominal of the states, 11 off (Boolean input), 12 level (whole-number input).
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifdef FMI3
#include "fmi3Functions.h"
#define OK fmi3OK
#define DISCARD fmi3Discard
#define ERROR fmi3Error
typedef fmi3Status Status;
#else
#include "fmi2Functions.h"
#define OK fmi2OK
#define DISCARD fmi2Discard
#define ERROR fmi2Error
typedef fmi2Status Status;
#endif

enum { MODE, A, B, U, X0, X1, D0, D1, Y, N, NOMINAL, OFF, LEVEL, SIZE };
enum {
    BALL,        /* falls from 1 m, bounces with a restitution of a, rests when slower than b */
    THERMOSTAT,  /* der(x0) = u - a x0 while on; on below 1, off above 2 */
    TRIANGLE,    /* der(x0) = 1 or -1, turns every a seconds by a time event */
    SAW,         /* der(x0) = 1; completed steps with x0 > 1 ask for an event that sets x0 to 0 */
    NOT_A_NUMBER,
    BROKEN,      /* derivatives are an error after 100 s */
    FUSSY,       /* every 97th call for derivatives is discarded; der(x0) = -a x0 */
    ESCAPE,      /* der(x0) = x0^2 */
    ENDS,        /* asks to end at 100 s */
    RESTLESS,    /* its discrete states never settle */
    CHATTERS,    /* its next event is always now */
    OSCILLATOR,  /* van der Pol's, mu = a */
    NOISY,       /* der(x0) = 1e9 cos(1e9 t) */
    SAMPLED,     /* y is u, sampled every a seconds */
    LATE,        /* no states: an indicator crosses zero at a */
    LINEAR,      /* der(x0) = (off ? 0 : u) + level - a x0, der(x1) = x0 - b x1, y = x1 + u, x0 starts at b */
    PULSED,      /* der(x0) = -a x0, in each event x0 doubles; events are inputs' */
};

typedef struct {
    double v[SIZE];
    double t;
    double next;
    int on;
    int calls;
} Model;

static void start(Model *m)
{
    const int mode = (int)m->v[MODE];
    m->v[X0] = mode == BALL || mode == THERMOSTAT || mode == FUSSY || mode == ESCAPE || mode == PULSED ? 1.0 : 0.0;
    m->v[X0] = mode == OSCILLATOR ? 2.0 : mode == LINEAR ? m->v[B] : m->v[X0];
    m->v[X1] = 0.0;
    m->on = 1;
    m->next = mode == TRIANGLE || mode == SAMPLED ? m->t + m->v[A] : mode == ENDS ? 100.0 : INFINITY;
}

static Status derivatives(Model *m)
{
    double *v = m->v;
    v[D0] = v[D1] = 0.0;
    switch ((int)v[MODE]) {
    case BALL:
        v[D0] = v[X1];
        v[D1] = m->on ? -9.81 : 0.0;
        break;
    case THERMOSTAT:
        v[D0] = (m->on ? v[U] : 0.0) - v[A] * v[X0];
        break;
    case TRIANGLE:
        v[D0] = m->on ? 1.0 : -1.0;
        break;
    case SAW:
        v[D0] = 1.0;
        break;
    case NOT_A_NUMBER:
        v[D1] = m->t > 100.0 ? NAN : 0.0;
        break;
    case BROKEN:
        return m->t > 100.0 ? ERROR : OK;
    case FUSSY:
        v[D0] = -v[A] * v[X0];
        return ++m->calls % 97 == 0 ? DISCARD : OK;
    case ESCAPE:
        v[D0] = v[X0] * v[X0];
        break;
    case OSCILLATOR:
        v[D0] = v[X1];
        v[D1] = v[A] * (1.0 - v[X0] * v[X0]) * v[X1] - v[X0];
        break;
    case NOISY:
        v[D0] = 1e9 * cos(1e9 * m->t);
        break;
    case LINEAR:
        v[D0] = (v[OFF] != 0.0 ? 0.0 : v[U]) + v[LEVEL] - v[A] * v[X0];
        v[D1] = v[X0] - v[B] * v[X1];
        break;
    case PULSED:
        v[D0] = -v[A] * v[X0];
        break;
    default:
        break;
    }
    return OK;
}

static double indicator(const Model *m)
{
    switch ((int)m->v[MODE]) {
    case BALL:
        return m->on ? m->v[X0] : 1.0;
    case THERMOSTAT:
        return m->on ? 2.0 - m->v[X0] : m->v[X0] - 1.0;
    case LATE:
        return m->t - m->v[A];
    default:
        return 1.0;
    }
}

static void event(Model *m, int *again, int *end)
{
    double *v = m->v;
    const int mode = (int)v[MODE];
    *again = mode == RESTLESS && m->t > 100.0;
    *end = mode == ENDS && m->t >= 100.0;
    if (mode == BALL && v[X0] <= 0.0 && v[X1] < 0.0) {
        v[X0] = 0.0;
        v[X1] *= -v[A];
        m->on = v[X1] > v[B];
        v[X1] *= m->on;
        v[N] += 1.0;
    }
    if (mode == THERMOSTAT && (m->on ? v[X0] >= 2.0 : v[X0] <= 1.0)) {
        m->on = !m->on;
        v[N] += 1.0;
    }
    if (mode == LATE && m->t >= v[A]) {
        v[N] = 1.0;
    }
    if (mode == SAW && v[X0] > 1.0) {
        v[X0] = 0.0;
        v[N] += 1.0;
    }
    if (mode == PULSED) {
        v[X0] *= 2.0;
        v[N] += 1.0;
    }
    if ((mode == TRIANGLE || mode == SAMPLED) && m->t >= m->next) {
        m->on = !m->on;
        v[N] += 1.0;
        v[Y] = v[U];
        m->next += v[A];
    }
    if (mode == CHATTERS && m->t > 100.0) {
        m->next = m->t;
    }
}

static Status get(Model *m, const unsigned *references, size_t n, double *values)
{
    if ((int)m->v[MODE] != SAMPLED) {
        m->v[Y] = (int)m->v[MODE] == LINEAR ? m->v[X1] + m->v[U] : m->v[X0];
    }
    derivatives(m);
    for (size_t i = 0; i < n; i++) {
        values[i] = m->v[references[i]];
    }
    return OK;
}

/* Derivatives of der(x0), der(x1) and y of the linear model with respect to u, a, b and the states. */
static Status directional(const Model *m, const unsigned *unknowns, size_t n, const unsigned *knowns, size_t k,
                          const double *seed, double *sensitivity)
{
    double s[SIZE] = {0.0};
    const double *v = m->v;
    for (size_t i = 0; i < k; i++) {
        if (knowns[i] == MODE || knowns[i] > X1) {
            return ERROR;
        }
        s[knowns[i]] = seed[i];
    }
    for (size_t i = 0; i < n; i++) {
        switch (unknowns[i]) {
        case D0:
            sensitivity[i] = s[U] - s[A] * v[X0] - v[A] * s[X0];
            break;
        case D1:
            sensitivity[i] = s[X0] - s[B] * v[X1] - v[B] * s[X1];
            break;
        case Y:
            sensitivity[i] = s[X1] + s[U];
            break;
        default:
            return ERROR;
        }
    }
    return OK;
}

static Model *fresh(void)
{
    Model *m = calloc(1, sizeof(Model));
    m->v[NOMINAL] = 1.0;
    return m;
}

static Status reset(Model *m)
{
    memset(m, 0, sizeof(Model));
    m->v[NOMINAL] = 1.0;
    return OK;
}

static Status set(Model *m, const unsigned *references, size_t n, const double *values)
{
    for (size_t i = 0; i < n; i++) {
        m->v[references[i]] = values[i];
    }
    return OK;
}

static Status indicate(const Model *m, double *z, size_t n)
{
    if (n > 0) {
        z[0] = indicator(m);
    }
    return OK;
}

static Status slopes(Model *m, double *d, size_t n)
{
    const Status status = derivatives(m);
    memcpy(d, m->v + D0, n * sizeof(double));
    return status;
}

#ifdef FMI3
#define F(name) fmi3##name
typedef fmi3Instance Instance;
#define REFERENCES const fmi3ValueReference r[], size_t n
#else
#define F(name) fmi2##name
typedef fmi2Component Instance;
#define REFERENCES const fmi2ValueReference r[], size_t n
#endif

Status F(Reset)(Instance c) { return reset(c); }
Status F(Terminate)(Instance c) { (void)c; return OK; }
void F(FreeInstance)(Instance c) { free(c); }
Status F(ExitInitializationMode)(Instance c) { start(c); return OK; }
Status F(EnterContinuousTimeMode)(Instance c) { (void)c; return OK; }
Status F(EnterEventMode)(Instance c) { (void)c; return OK; }
Status F(SetTime)(Instance c, double t) { ((Model *)c)->t = t; return OK; }
Status F(SetContinuousStates)(Instance c, const double x[], size_t n)
{
    memcpy(((Model *)c)->v + X0, x, n * sizeof(double));
    return OK;
}
Status F(GetContinuousStates)(Instance c, double x[], size_t n)
{
    memcpy(x, ((Model *)c)->v + X0, n * sizeof(double));
    return OK;
}
Status F(GetNominalsOfContinuousStates)(Instance c, double x[], size_t n)
{
    for (size_t i = 0; i < n; i++) {
        x[i] = ((Model *)c)->v[NOMINAL];
    }
    return OK;
}
Status F(GetEventIndicators)(Instance c, double z[], size_t n) { return indicate(c, z, n); }

#ifdef FMI3
fmi3Instance fmi3InstantiateModelExchange(fmi3String a, fmi3String b, fmi3String d, fmi3Boolean e, fmi3Boolean f,
                                          fmi3InstanceEnvironment g, fmi3LogMessageCallback h)
{
    (void)a, (void)b, (void)d, (void)e, (void)f, (void)g, (void)h;
    return fresh();
}
Status fmi3EnterInitializationMode(Instance c, fmi3Boolean a, double b, double t, fmi3Boolean d, double e)
{
    (void)a, (void)b, (void)d, (void)e;
    ((Model *)c)->t = t;
    return OK;
}
Status fmi3SetFloat64(Instance c, REFERENCES, const double values[], size_t k) { return k == n ? set(c, r, n, values) : ERROR; }
#define SETS(NAME, TYPE) \
    Status fmi3Set##NAME(Instance c, REFERENCES, const TYPE values[], size_t k) \
    { for (size_t i = 0; i < n; i++) ((Model *)c)->v[r[i]] = values[i]; return k == n ? OK : ERROR; }
SETS(Boolean, fmi3Boolean)
SETS(Int32, fmi3Int32)
Status fmi3GetFloat64(Instance c, REFERENCES, double values[], size_t k) { return k == n ? get(c, r, n, values) : ERROR; }
Status fmi3GetContinuousStateDerivatives(Instance c, double d[], size_t n) { return slopes(c, d, n); }
Status fmi3UpdateDiscreteStates(Instance c, fmi3Boolean *needed, fmi3Boolean *end, fmi3Boolean *nominals,
                                fmi3Boolean *values, fmi3Boolean *defined, double *next)
{
    int again, ends;
    event(c, &again, &ends);
    *needed = again;
    *end = ends;
    *nominals = 0;
    *values = 1;
    *defined = isfinite(((Model *)c)->next);
    *next = ((Model *)c)->next;
    return OK;
}
Status fmi3CompletedIntegratorStep(Instance c, fmi3Boolean a, fmi3Boolean *asks, fmi3Boolean *end)
{
    const Model *m = c;
    (void)a;
    *asks = m->v[MODE] == SAW && m->v[X0] > 1.0;
    *end = 0;
    return OK;
}
Status fmi3GetDirectionalDerivative(Instance c, const fmi3ValueReference unknowns[], size_t n,
                                    const fmi3ValueReference knowns[], size_t k, const double seed[], size_t n_seed,
                                    double sensitivity[], size_t n_sensitivity)
{
    return n_seed == k && n_sensitivity == n ? directional(c, unknowns, n, knowns, k, seed, sensitivity) : ERROR;
}
#else
fmi2Component fmi2Instantiate(fmi2String a, fmi2Type b, fmi2String d, fmi2String e, const fmi2CallbackFunctions *f,
                              fmi2Boolean g, fmi2Boolean h)
{
    (void)a, (void)b, (void)d, (void)e, (void)f, (void)g, (void)h;
    return fresh();
}
Status fmi2SetupExperiment(Instance c, fmi2Boolean a, double b, double t, fmi2Boolean d, double e)
{
    (void)a, (void)b, (void)d, (void)e;
    ((Model *)c)->t = t;
    return OK;
}
Status fmi2EnterInitializationMode(Instance c) { (void)c; return OK; }
Status fmi2SetReal(Instance c, REFERENCES, const double values[]) { return set(c, r, n, values); }
#define SETS(NAME, TYPE) \
    Status fmi2Set##NAME(Instance c, REFERENCES, const TYPE values[]) \
    { for (size_t i = 0; i < n; i++) ((Model *)c)->v[r[i]] = values[i]; return OK; }
SETS(Boolean, fmi2Boolean)
SETS(Integer, fmi2Integer)
Status fmi2GetReal(Instance c, REFERENCES, double values[]) { return get(c, r, n, values); }
Status fmi2GetDerivatives(Instance c, double d[], size_t n) { return slopes(c, d, n); }
Status fmi2NewDiscreteStates(Instance c, fmi2EventInfo *info)
{
    event(c, &info->newDiscreteStatesNeeded, &info->terminateSimulation);
    info->nominalsOfContinuousStatesChanged = 0;
    info->valuesOfContinuousStatesChanged = 1;
    info->nextEventTimeDefined = isfinite(((Model *)c)->next);
    info->nextEventTime = ((Model *)c)->next;
    return OK;
}
Status fmi2CompletedIntegratorStep(Instance c, fmi2Boolean a, fmi2Boolean *asks, fmi2Boolean *end)
{
    const Model *m = c;
    (void)a;
    *asks = m->v[MODE] == SAW && m->v[X0] > 1.0;
    *end = 0;
    return OK;
}
Status fmi2GetDirectionalDerivative(Instance c, const fmi2ValueReference unknowns[], size_t n,
                                    const fmi2ValueReference knowns[], size_t k, const double seed[],
                                    double sensitivity[])
{
    return directional(c, unknowns, n, knowns, k, seed, sensitivity);
}
#endif

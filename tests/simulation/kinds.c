/* An FMU with parameters of every type, a closed form, and ways to go wrong between two rows; FMI 2.0 or 3.0 by -DFMI.
 *
 * x' = -k x + u from x0, stepped exactly; y = x * f + n + c + strlen(s) + size + level, plus 1000 when b is
 * true and 10 when on is.
 * AGAIN, chosen when compiling, says what a row finds that is not the first. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* Of a file URI what stands before the path; and what separates folders. */
#ifdef _WIN32
#include <io.h>
/* windows.h has names of this file. */
__declspec(dllimport) int __stdcall MultiByteToWideChar(unsigned, unsigned long, const char *, int, wchar_t *, int);
enum { UTF_8 = 65001 };
enum { BEFORE_PATH = 8, SEPARATOR = '\\' };
#else
enum { BEFORE_PATH = 7, SEPARATOR = '/' };
#endif

#define HONEST 0
#define KEEPS_STATE 1   /* reset says OK and x goes on from where it was */
#define KEEPS_FIRST 2   /* reset says OK and k stays what it was at the first initialization */
#define REFUSES 3       /* reset is an error */
#define STATIC 4        /* x goes on from where the last row of the process ended, also in a new instance */
#define ONE_INSTANCE 5  /* reset is an error, and so is a second instance */
#define DIES_AT_RESET 6 /* reset is fatal */
#define DIES_AT_END 7   /* reset is an error, terminating fatal */
#ifndef AGAIN
#define AGAIN HONEST
#endif

enum { K, X0, U, Y, F, N, B, C, S, SIZE, MANY, ON, LEVEL, WORD, INNER, N_VARIABLES };
/* What the parameter n makes a step do from 30000 s on. */
enum { END = -1, EARLY = -2, DISCARDED = -3 };
/* Values of x0 that make it complain at 30000 s, in words and with a good status or the other way round. */
#define GRUMBLES 399.0
#define SILENT 398.0

typedef struct {
    double v[N_VARIABLES];
    char text[64];
    double x;
    double first_k;
    int configuring;
    int ended;
    const void *logger;
    void *environment;
} Instance;

static double process_x = 0.0;
static int is_dead = 0;
int n_calls_after_fatal = 0;
static void grumble(void *instance);
static int n_instances = 0;

static void defaults(Instance *m)
{
    const double x = m->x, first_k = m->first_k;
    const void *logger = m->logger;
    void *environment = m->environment;
    memset(m, 0, sizeof(*m));
    m->logger = logger;
    m->environment = environment;
    m->v[K] = 1e-4;
    m->v[X0] = 300.0;
    m->v[F] = 1.0;
    m->v[SIZE] = 2.0;
    if (AGAIN == KEEPS_STATE) m->x = x;
    if (AGAIN == KEEPS_FIRST) m->first_k = first_k;
}
static int is_wrong_folder(const char *resources)
{
    char path[4096];
    size_t n = 0;
    if (FMI == 2 && strncmp(resources, "file:///", 8)) return 1;
    for (const char *c = resources + (FMI == 2 ? BEFORE_PATH : 0); *c && n < sizeof(path) - 1; c++) {
        unsigned byte = (unsigned char)*c;
        if (FMI == 2 && (byte <= ' ' || byte > '~')) return 1;
        if (FMI == 2 && byte == '%' && sscanf(c + 1, "%2x", &byte) == 1) c += 2;
        path[n++] = (char)byte;
    }
    path[n] = '\0';
    if (n && path[n - 1] == SEPARATOR) path[n - 1] = '\0';
#ifdef _WIN32
    wchar_t wide[4096]; /* the standard's texts are UTF-8, those of Windows' C library are not */
    return !MultiByteToWideChar(UTF_8, 0, path, -1, wide, 4096) || _waccess(wide, R_OK);
#else
    return access(path, R_OK);
#endif
}
static int finish(int status)
{
    is_dead = is_dead || status == 4;
    return status;
}
static void release(void *instance)
{
    n_calls_after_fatal += is_dead;
    free(instance);
}
static Instance *make(void)
{
    n_calls_after_fatal += is_dead;
    if (AGAIN == ONE_INSTANCE && n_instances) return NULL;
    n_instances++;
    Instance *m = calloc(1, sizeof(Instance));
    defaults(m);
    return m;
}
static int reset(Instance *m)
{
    if (AGAIN == DIES_AT_RESET) return finish(4);
    if (AGAIN == REFUSES || AGAIN == ONE_INSTANCE || AGAIN == DIES_AT_END) return 3;
    defaults(m);
    return 0;
}
static int initialize(Instance *m)
{
    if (m->first_k == 0.0) m->first_k = m->v[K];
    if (AGAIN == KEEPS_FIRST) m->v[K] = m->first_k;
    m->x = AGAIN == KEEPS_STATE && m->x != 0.0 ? m->x : m->v[X0];
    if (AGAIN == STATIC && process_x != 0.0) m->x = process_x;
    return 0;
}
static double get(const Instance *m, unsigned r)
{
    if (r != Y && r != INNER) return m->v[r];
    const double whole = m->v[N] + m->v[C] + (double)strlen(m->text) + m->v[SIZE] + m->v[LEVEL];
    return m->x * m->v[F] + whole + (m->v[B] != 0.0 ? 1000.0 : 0.0) + (m->v[ON] != 0.0 ? 10.0 : 0.0);
}
static int step(Instance *m, double t, double h)
{
    const double k = m->v[K], a = exp(-k * h);
    if (t >= 30000.0 && m->v[X0] == GRUMBLES) grumble(m);
    if (t >= 30000.0 && (m->v[N] == DISCARDED || m->v[X0] == SILENT)) return 2;
    m->x = m->x * a + m->v[U] * (1.0 - a) / k;
    process_x = m->x;
    m->ended = t >= 30000.0 && m->v[N] == END;
    return t >= 30000.0 && m->v[N] == EARLY ? -1 : 0;
}

#if FMI == 2
#include "fmi2Functions.h"
#define SETS(NAME, TYPE) \
    fmi2Status fmi2Set##NAME(fmi2Component c, const fmi2ValueReference r[], size_t n, const TYPE v[]) \
    { for (size_t i = 0; i < n; i++) ((Instance *)c)->v[r[i]] = v[i]; return fmi2OK; }
SETS(Real, fmi2Real)
SETS(Integer, fmi2Integer)
SETS(Boolean, fmi2Boolean)
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{ (void)r; (void)n; strncpy(((Instance *)c)->text, v[0], 63); return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name; (void)type; (void)guid; (void)visible; (void)logging;
    Instance *m = is_wrong_folder(resources) ? NULL : make();
    if (m) m->logger = callbacks;
    else callbacks->logger(callbacks->componentEnvironment, "kinds", fmi2Error, "error", "no instance");
    return m;
}
static void grumble(void *instance)
{
    const fmi2CallbackFunctions *callbacks = ((Instance *)instance)->logger;
    callbacks->logger(callbacks->componentEnvironment, "kinds", fmi2Error, "error", "%s grumbles %d%%", "it", 99);
}
void fmi2FreeInstance(fmi2Component c) { release(c); }
fmi2Status fmi2Reset(fmi2Component c) { return reset(c); }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return finish(AGAIN == DIES_AT_END ? 4 : 0); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real t0, fmi2Boolean s, fmi2Real t1)
{ (void)c; (void)d; (void)e; (void)t0; (void)s; (void)t1; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return initialize(c); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{ for (size_t i = 0; i < n; i++) v[i] = get(c, r[i]); return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{ (void)keep; return step(c, t, h) == 2 || ((Instance *)c)->ended ? fmi2Discard : fmi2OK; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *v)
{ *v = kind == fmi2Terminated && ((Instance *)c)->ended; return fmi2OK; }
#else
#include "fmi3Functions.h"
#define SETS(NAME, TYPE) \
    fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference r[], size_t n, const TYPE v[], size_t m) \
    { \
        if (n != m) return fmi3Error; \
        for (size_t i = 0; i < n; i++) { \
            if ((r[i] == SIZE) != ((Instance *)c)->configuring) return fmi3Error; \
            ((Instance *)c)->v[r[i]] = (double)v[i]; \
        } \
        return fmi3OK; \
    }
SETS(Float64, fmi3Float64)
SETS(Float32, fmi3Float32)
SETS(Int8, fmi3Int8)
SETS(UInt64, fmi3UInt64)
SETS(Int64, fmi3Int64)
SETS(Boolean, fmi3Boolean)
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t m)
{ (void)r; (void)n; (void)m; strncpy(((Instance *)c)->text, v[0], 63); return fmi3OK; }
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference r[], size_t n, fmi3InstanceEnvironment e, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    (void)name; (void)visible; (void)logging; (void)r; (void)update;
    const size_t length = strlen(resources);
    if (strcmp(token, "kinds-1") || events || early || n || length == 0 || resources[length - 1] != SEPARATOR
        || is_wrong_folder(resources)) {
        log(e, fmi3Error, "logStatusError", "instantiated in a wrong way");
        return NULL;
    }
    Instance *m = make();
    if (m) {
        m->logger = (const void *)log;
        m->environment = e;
    }
    return m;
}
static void grumble(void *instance)
{
    const Instance *m = instance;
    ((fmi3LogMessageCallback)m->logger)(m->environment, fmi3Error, "error", "it grumbles 99%");
}
void fmi3FreeInstance(fmi3Instance c) { release(c); }
fmi3Status fmi3Reset(fmi3Instance c) { return reset(c); }
fmi3Status fmi3Terminate(fmi3Instance c) { (void)c; return finish(AGAIN == DIES_AT_END ? 4 : 0); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { ((Instance *)c)->configuring = 1; return fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { ((Instance *)c)->configuring = 0; return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 tolerance, fmi3Float64 t0,
                                       fmi3Boolean s, fmi3Float64 t1)
{ (void)c; return d && tolerance == 1e-7 && s && t1 > t0 ? fmi3OK : fmi3Error; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return initialize(c); }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{ if (n != m) return fmi3Error; for (size_t i = 0; i < n; i++) v[i] = get(c, r[i]); return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)keep;
    const int how = step(c, t, h);
    if (how == 2) return fmi3Discard;
    *event = false;
    *terminate = ((Instance *)c)->ended;
    *early = how == -1;
    *last = *early ? t + h / 2 : t + h;
    return fmi3OK;
}
#endif

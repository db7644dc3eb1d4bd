/* FMUs that misbehave: x' = -k (x - 290 K), stepped exactly; y = x. BEHAVIOUR, chosen when compiling, says how they go
 * wrong: those of the first group where the parameter `trouble` exceeds BAD_ABOVE and from half of the run on, those of
 * the second group always. Each simulation adds a line with its parameters to the file that BAD_FMU_COUNT names. */
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"

/* Where the parameter `trouble` decides: */
#define GOOD 0
#define CRASH 1   /* SIGSEGV */
#define HANG 2    /* for ever, deaf to SIGTERM and SIGINT */
#define EXIT 3    /* exit() */
#define NANS 4    /* fmi2OK with NaN */
#define ERROR 5   /* fmi2Error with a message */
#define DISCARD 6 /* fmi2Discard with a message */
#define FATAL 7   /* fmi2Fatal with a message; nothing works in this process afterwards */
#define ONCE 8    /* fmi2Error; no reset after it, and a process gives only one instance, even after it is freed */
#define ASSERTS 9 /* fmi2Error after a message whose status is fmi2Warning */
/* Always: */
#define LEAK 20     /* a simulation keeps 1 MiB */
#define STICKY 21   /* fmi2Reset says fmi2OK and keeps the state */
#define NO_RESET 22 /* fmi2Reset is fmi2Error */
#define UNITS 23    /* says K, gives degC */
#define LICENCE 24  /* no instance: a licence is missing, which it says where logging is on */
#define PRINTS 25   /* prints at every step */
#define WRITES 26   /* writes files into the working directory */
#define FROZEN 27   /* the parameters of the process's first simulation hold for all of its others */
#define ICED 28     /* as FROZEN, but k only */
#define RANDOM 29   /* no two simulations are alike */
#define LOADS 30    /* hangs while it is loaded */
#define STUCK 31    /* hangs while it is instantiated */
#define DAEMON 32   /* starts a process that leaves its session, its group and its parent, and sleeps */

#define BAD_ABOVE 0.995
#define LEAK_BYTES (1 << 20)
#define BASE_K 290.0

enum { K, X0, TROUBLE, Y, N_VARIABLES };

typedef struct {
    double v[N_VARIABLES];
    double x;
    double half; /* time from which a bad row goes wrong */
    int broken;
    int used; /* STICKY: has been simulated, and remembers x */
    const fmi2CallbackFunctions *callbacks;
} Instance;

static int n_instances = 0;
static int is_dead = 0;
static double first_v[N_VARIABLES]; /* FROZEN, ICED: parameters of the process's first simulation */

static void defaults(Instance *m)
{
    m->v[K] = 1e-4;
    m->v[X0] = 300.0;
    m->v[TROUBLE] = 0.0;
    m->broken = 0;
}

static fmi2Status say(Instance *m, fmi2Status status, const char *message)
{
    m->callbacks->logger(m->callbacks->componentEnvironment, "bad", status, "logStatusError", message);
    return status;
}

static void count(const Instance *m)
{
    const char *path = getenv("BAD_FMU_COUNT");
    if (path == NULL) {
        return;
    }
    char line[96];
    const int n = snprintf(line, sizeof(line), "%.17g,%.17g,%.17g\n", m->v[K], m->v[X0], m->v[TROUBLE]);
    const int file = open(path, O_WRONLY | O_CREAT | O_APPEND, 0644);
    /* One write to a file opened to append: lines of several processes do not mix. */
    if (file < 0 || write(file, line, (size_t)n) != n || close(file) != 0) {
        abort();
    }
}

static void for_ever(void)
{
    for (;;) {
        pause();
    }
}

static void start_daemon(void)
{
    if (fork() == 0) {
        setsid();
        if (fork() == 0) {
            setsid();
            execlp("sleep", "a-daemon", "987", (char *)NULL);
        }
        _exit(0);
    }
}

__attribute__((constructor)) static void loaded(void)
{
    if (BEHAVIOUR == LOADS) {
        for_ever();
    }
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name;
    (void)type;
    (void)resources;
    (void)visible;
    Instance *m = calloc(1, sizeof(Instance));
    if (m == NULL) {
        return NULL;
    }
    if (BEHAVIOUR == STUCK) {
        for_ever();
    } else if (BEHAVIOUR == DAEMON) {
        start_daemon();
    }
    m->callbacks = callbacks;
    m->x = 300.0;
    defaults(m);
    n_instances++;
    if (strcmp(guid, "bad-1") != 0) {
        say(m, fmi2Error, "the GUID is not of this FMU");
    } else if (BEHAVIOUR == LICENCE) {
        if (logging) say(m, fmi2Error, "no licence for feature ROOM_RUNTIME on server 27000@nowhere");
    } else if (BEHAVIOUR == ONCE && n_instances > 1) {
        say(m, fmi2Error, "only one instance per process");
    } else if (is_dead) {
        say(m, fmi2Error, "dead since a fatal error");
    } else {
        if (BEHAVIOUR == WRITES) {
            FILE *file = fopen("bad_debug.log", "a");
            if (file != NULL) {
                fprintf(file, "instance %d\n", n_instances);
                fclose(file);
            }
        }
        return m;
    }
    free(m);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *m = c;
    if (BEHAVIOUR == NO_RESET) {
        return say(m, fmi2Error, "fmi2Reset is not supported");
    }
    if (m->broken && (BEHAVIOUR == ONCE || BEHAVIOUR == FATAL)) {
        return say(m, fmi2Error, "no way back from an error");
    }
    defaults(m);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop)
{
    Instance *m = c;
    (void)has_tolerance;
    (void)tolerance;
    m->half = has_stop ? 0.5 * (start + stop) : start + 20000.0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *m = c;
    count(m);
    if (first_v[K] == 0.0) {
        memcpy(first_v, m->v, sizeof(first_v));
    }
    if (BEHAVIOUR == FROZEN || BEHAVIOUR == ICED) {
        memcpy(m->v, first_v, (BEHAVIOUR == ICED ? 1 : N_VARIABLES) * sizeof(double));
    }
    if (!(BEHAVIOUR == STICKY && m->used)) {
        m->x = m->v[X0];
    }
    if (BEHAVIOUR == RANDOM) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        m->x += 1e-3 * (double)(1 + now.tv_nsec % 999);
    }
    m->used = 1;
    if (BEHAVIOUR == LEAK) {
        char *lost = malloc(LEAK_BYTES);
        if (lost == NULL) {
            return say(m, fmi2Error, "no memory left");
        }
        memset(lost, 1, LEAK_BYTES);
        /* Seen from outside, so that no compiler leaves the allocation out. */
        __asm__ volatile("" : : "r"(lost) : "memory");
    }
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    Instance *m = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= Y) {
            return say(m, fmi2Error, "not a parameter");
        }
        m->v[r[i]] = v[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    const Instance *m = c;
    for (size_t i = 0; i < n; i++) {
        v[i] = r[i] == Y ? m->x - (BEHAVIOUR == UNITS ? 273.15 : 0.0) : m->v[r[i]];
    }
    return fmi2OK;
}

static fmi2Status go_wrong(Instance *m)
{
    m->broken = 1;
    switch (BEHAVIOUR) {
        case CRASH:
            raise(SIGSEGV);
            return fmi2OK;
        case HANG:
            signal(SIGTERM, SIG_IGN);
            signal(SIGINT, SIG_IGN);
            for (;;) {
                usleep(10000);
            }
        case EXIT:
            exit(3);
        case NANS:
            m->x = NAN;
            return fmi2OK;
        case ERROR:
        case ONCE:
            return say(m, fmi2Error, "the valve is stuck");
        case ASSERTS:
            say(m, fmi2Warning, "assertion: the flow reverses");
            return fmi2Error;
        case DISCARD:
            return say(m, fmi2Discard, "the step does not converge");
        case FATAL:
            is_dead = 1;
            return say(m, fmi2Fatal, "the heap is broken");
        default:
            return fmi2OK;
    }
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    Instance *m = c;
    (void)keep;
    if (m->v[TROUBLE] > BAD_ABOVE && t + 0.5 * h > m->half && BEHAVIOUR != GOOD && BEHAVIOUR < LEAK) {
        const fmi2Status status = go_wrong(m);
        if (status != fmi2OK) {
            return status;
        }
    }
    if (BEHAVIOUR == PRINTS) {
        printf("step from %g s\n", t);
        fflush(stdout);
        fprintf(stderr, "warning at %g s\n", t);
    }
    m->x = BASE_K + (m->x - BASE_K) * exp(-m->v[K] * h);
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

/* Never called, but FMPy loads no library without them. */
#define UNUSED(name)                                                                                                   \
    int name(void)                                                                                                     \
    {                                                                                                                  \
        return fmi2Error;                                                                                              \
    }
UNUSED(fmi2CancelStep)
UNUSED(fmi2DeSerializeFMUstate)
UNUSED(fmi2FreeFMUstate)
UNUSED(fmi2GetBoolean)
UNUSED(fmi2GetBooleanStatus)
UNUSED(fmi2GetDirectionalDerivative)
UNUSED(fmi2GetFMUstate)
UNUSED(fmi2GetInteger)
UNUSED(fmi2GetIntegerStatus)
UNUSED(fmi2GetRealOutputDerivatives)
UNUSED(fmi2GetRealStatus)
UNUSED(fmi2GetStatus)
UNUSED(fmi2GetString)
UNUSED(fmi2GetStringStatus)
UNUSED(fmi2SerializeFMUstate)
UNUSED(fmi2SerializedFMUstateSize)
UNUSED(fmi2SetBoolean)
UNUSED(fmi2SetDebugLogging)
UNUSED(fmi2SetFMUstate)
UNUSED(fmi2SetInteger)
UNUSED(fmi2SetRealInputDerivatives)
UNUSED(fmi2SetString)

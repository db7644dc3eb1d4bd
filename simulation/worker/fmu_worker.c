/* Runs the co-simulation of one FMU (2.0 or 3.0) for whoever starts it, by messages over standard input and output.
 *
 * A message is a length (uint32) and so many bytes; all numbers are little-endian, and a text is a length (uint32)
 * and its UTF-8. To the worker:
 *   'L'  load: see load(). Once, first.
 *   'S'  simulate a row: the values of its parameters, as load() was told to expect them.
 *   'R'  reset the instance.
 *   'N'  make a new instance in place of the one there is.
 *   'P'  say that you are there.
 *   'Q'  free the instance and end.
 * 'N' and 'Q' say in a byte whether the instance is damaged. Each but 'Q' is answered by an Answer, the FMU's last complaint, and after a good row by its outputs (doubles).
 * Where the input ends, the worker ends at once, also in the middle of a step. */
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#include <io.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Statuses of the standard, then what the worker itself answers; simulation/fmi/loop.py has ENDED and EARLY, too. */
enum { OK, WARNING, DISCARD, ERROR_STATUS, FATAL, ENDED = 100, EARLY = 101, NOT_LOADED = 200, NO_FUNCTION, NO_INSTANCE };
enum { PLAIN, EXPERIMENT, CONSTANT, PARAMETER };
enum { COMPLAINT = 1000, TERMINATED = 3 };

#pragma pack(push, 1)
typedef struct {
    int32_t status, stage, step; /* of the call that failed; a stage is the place of a function in the order of load() */
    double reached;              /* the time of an early return */
} Answer;
#pragma pack(pop)

typedef struct {
    const char *name;
    int kind, is_asked;
    double tolerance, start, stop;
    uint32_t n, size;       /* variables, and bytes of a value; 0 for texts */
    size_t n_steps;
    const uint32_t *references;
    unsigned char *values;  /* of texts their addresses */
    int (*call)(void *, ...);
} Call;

typedef void (*Logger)(void);
typedef struct { Logger logger; void *(*allocate)(size_t, size_t); void (*release)(void *); void *finished, *environment; } Callbacks;

/* By it a test knows whether the program was built of this source. */
__attribute__((used)) static const char source[] = "source " SOURCE;

static HANDLE input, output;
static SRWLOCK lock = SRWLOCK_INIT;
static CONDITION_VARIABLE changed = CONDITION_VARIABLE_INIT;
static int is_waiting; /* a message has been read and not been answered */
static unsigned char *message;
static uint32_t message_size;

static int version, is_initialized, is_lost;
static const char *identifier, *guid, *resources;
static HMODULE library;
static void *component;
static uint32_t n_calls, n_inputs, n_outputs, n_edges, output_every;
static Call *calls, *inputs;
static const uint32_t *output_references;
static const double *edges;
static double *y;
static int (*step_call)(void *, double, double, int, unsigned char *, unsigned char *, unsigned char *, double *);
static int (*get_call)(void *, const uint32_t *, size_t, double *, size_t);
static char complaint[2][COMPLAINT]; /* the last error, the last warning */

/* Messages */

static int read_all(void *to, uint32_t n)
{
    unsigned char *place = to;
    DWORD got;
    for (; n; place += got, n -= got)
        if (!ReadFile(input, place, n, &got, NULL) || !got) return 0;
    return 1;
}

static void write_all(const void *from, size_t n)
{
    const unsigned char *place = from;
    DWORD done;
    for (; n; place += done, n -= done)
        if (!WriteFile(output, place, n > 1 << 20 ? 1 << 20 : (DWORD)n, &done, NULL)) TerminateProcess(GetCurrentProcess(), 0);
}

/* Not events, each of which asks Wine's server. */
static void hand_over(int to)
{
    AcquireSRWLockExclusive(&lock);
    is_waiting = to;
    ReleaseSRWLockExclusive(&lock);
    WakeAllConditionVariable(&changed);
}

static void wait_for(int value)
{
    AcquireSRWLockExclusive(&lock);
    while (is_waiting != value) SleepConditionVariableSRW(&changed, &lock, INFINITE, 0);
    ReleaseSRWLockExclusive(&lock);
}

/* A thread of its own, so that a worker whose FMU hangs ends with whoever started it. */
static DWORD WINAPI listen(void *nothing)
{
    (void)nothing;
    while (read_all(&message_size, sizeof message_size) && (message = malloc((size_t)message_size + 1)) &&
           read_all(message, message_size)) {
        hand_over(1);
        wait_for(0);
    }
    TerminateProcess(GetCurrentProcess(), 0);
    return 0;
}

/* In one piece: each costs a turn of the server. */
static void answer_with(int status, int stage, int step, double reached, const char *said, const void *more, size_t n_more)
{
    static unsigned char *piece;
    const Answer head = {status, stage, step, reached};
    const uint32_t n = (uint32_t)strlen(said);
    piece = realloc(piece, sizeof head + sizeof n + n + n_more);
    memcpy(piece, &head, sizeof head);
    memcpy(piece + sizeof head, &n, sizeof n);
    memcpy(piece + sizeof head + sizeof n, said, n);
    if (n_more) memcpy(piece + sizeof head + sizeof n + n, more, n_more);
    write_all(piece, sizeof head + sizeof n + n + n_more);
}

static void answer(int status, int stage, int step, double reached, const char *said)
{
    answer_with(status, stage, step, reached, said, NULL, 0);
}

static const char *last_complaint(void) { return complaint[0][0] ? complaint[0] : complaint[1]; }

/* Reading what load() is given; a message stays in memory, and what it holds is pointed to. */

static unsigned char *at;
static const void *next_bytes(size_t n) { const void *here = at; at += n; return here; }
static uint32_t next_number(void) { uint32_t n; memcpy(&n, next_bytes(4), 4); return n; }
static double next_double(void) { double v; memcpy(&v, next_bytes(8), 8); return v; }
static void *next_copy(size_t n) { void *copy = malloc(n + 1); memcpy(copy, next_bytes(n), n); return copy; }

static char *next_text(void)
{
    const uint32_t n = next_number();
    char *text = next_copy(n);
    text[n] = '\0';
    return text;
}

static void next_values(Call *call)
{
    call->n = next_number();
    call->size = next_number();
    call->n_steps = next_number();
    call->references = next_copy(4 * (size_t)call->n);
    if (call->size) {
        call->values = next_copy(call->n_steps * call->n * call->size);
        return;
    }
    char **texts = malloc(sizeof(char *) * call->n);
    for (uint32_t i = 0; i < call->n; i++) texts[i] = next_text();
    call->values = (unsigned char *)texts;
}

/* The FMU */

static void note(int status, const char *text)
{
    if (status >= WARNING && text && *text) snprintf(complaint[status == WARNING], COMPLAINT, "%s", text);
}

static void log_2(void *environment, const char *name, int status, const char *category, const char *form, ...)
{
    (void)environment, (void)name, (void)category;
    char text[COMPLAINT] = "";
    va_list more;
    va_start(more, form);
    if (form) vsnprintf(text, sizeof text, form, more);
    va_end(more);
    note(status, text);
}

static void log_3(void *environment, int status, const char *category, const char *text)
{
    (void)environment, (void)category;
    note(status, text);
}

static FARPROC function(const char *name) { return GetProcAddress(library, name); }

static FARPROC either(const char *in_2, const char *in_3) { return function(version == 2 ? in_2 : in_3); }

static int called(FARPROC plain)
{
    const int status = ((int (*)(void *))plain)(component);
    is_lost = is_lost || status == FATAL;
    return status;
}

static void instantiate(int is_logging)
{
    static const Callbacks callbacks = {(Logger)log_2, calloc, free, NULL, NULL};
    is_initialized = 0;
    complaint[0][0] = complaint[1][0] = '\0';
    if (version == 2) {
        typedef void *(*Make)(const char *, int, const char *, const char *, const Callbacks *, int, int);
        component = ((Make)function("fmi2Instantiate"))(identifier, 1, guid, resources, &callbacks, 0, is_logging);
    } else {
        /* No event mode, no early return, no intermediate variables. */
        typedef void *(*Make)(const char *, const char *, const char *, int, int, int, int, void *, size_t, void *, Logger, void *);
        component = ((Make)function("fmi3InstantiateCoSimulation"))(
            identifier, guid, resources, 0, is_logging, 0, 0, NULL, 0, NULL, (Logger)log_3, NULL);
    }
}

/* After a fatal error the standard allows no call at all; after an error it allows to free, not to terminate. */
static void free_instance(int is_damaged)
{
    const FARPROC terminate = either("fmi2Terminate", "fmi3Terminate");
    if (component && !is_lost && is_initialized && !is_damaged && terminate) called(terminate);
    if (component && !is_lost) ((void (*)(void *))either("fmi2FreeInstance", "fmi3FreeInstance"))(component);
    component = NULL;
}

static const char *find_functions(void)
{
    static const char *needed[2][4] = {
        {"fmi2Instantiate", "fmi2FreeInstance", "fmi2DoStep", "fmi2GetReal"},
        {"fmi3InstantiateCoSimulation", "fmi3FreeInstance", "fmi3DoStep", "fmi3GetFloat64"},
    };
    for (int i = 0; i < 4; i++)
        if (!function(needed[version - 2][i])) return needed[version - 2][i];
    step_call = (void *)either("fmi2DoStep", "fmi3DoStep");
    get_call = (void *)either("fmi2GetReal", "fmi3GetFloat64");
    for (uint32_t i = 0; i < n_calls + n_inputs; i++) {
        Call *call = i < n_calls ? &calls[i] : &inputs[i - n_calls];
        if (!(call->call = (void *)function(call->name))) return call->name;
    }
    return NULL;
}

/* Version, library, identifier, GUID, resources; the calls that start a row: name, kind, and what the kind needs;
 * the inputs, set in each step: name and values; outputs' references, steps between two outputs, edges of the steps. */
static void load(void)
{
    wchar_t path[32768];
    version = (int)next_number();
    const char *file = next_text();
    identifier = next_text(), guid = next_text(), resources = next_text();
    n_calls = next_number();
    calls = calloc(n_calls + 1, sizeof(Call));
    for (Call *call = calls; call < calls + n_calls; call++) {
        call->name = next_text();
        call->kind = (int)next_number();
        if (call->kind == EXPERIMENT) {
            call->is_asked = (int)next_number();
            call->tolerance = next_double(), call->start = next_double(), call->stop = next_double();
        }
        if (call->kind == CONSTANT || call->kind == PARAMETER) next_values(call);
    }
    n_inputs = next_number();
    inputs = calloc(n_inputs + 1, sizeof(Call));
    for (Call *call = inputs; call < inputs + n_inputs; call++) {
        call->name = next_text();
        next_values(call);
    }
    n_outputs = next_number();
    output_references = next_copy(4 * (size_t)n_outputs);
    output_every = next_number();
    n_edges = next_number();
    edges = next_copy(8 * (size_t)n_edges);
    y = malloc(8 * ((size_t)(n_edges - 1) / output_every + 1) * n_outputs + 8);

    MultiByteToWideChar(CP_UTF8, 0, file, -1, path, 32768);
    if (!(library = LoadLibraryExW(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH))) {
        char text[64];
        const DWORD error = GetLastError();
        snprintf(text, sizeof text, "error %lu of Windows%s", error, error == 126 ? ": a library that it needs is missing" : "");
        answer(NOT_LOADED, 0, 0, 0.0, text);
        return;
    }
    const char *missing = find_functions();
    if (missing) {
        answer(NO_FUNCTION, 0, 0, 0.0, missing);
        return;
    }
    instantiate(0);
    if (!component) instantiate(1); /* some FMUs say why only where logging is on */
    answer(component ? OK : NO_INSTANCE, 0, 0, 0.0, last_complaint());
}

static int set(const Call *call, size_t step)
{
    const size_t row = call->size ? (size_t)call->n * call->size : 0;
    return call->call(component, call->references, (size_t)call->n, call->values + step * row, (size_t)call->n);
}

static int begin(const Call *call)
{
    switch (call->kind) {
    case PLAIN: return call->call(component);
    case EXPERIMENT: return ((int (*)(void *, int, double, double, int, double))call->call)(
        component, call->is_asked, call->tolerance, call->start, 1, call->stop);
    case PARAMETER: memcpy(call->values, next_bytes((size_t)call->n * call->size), (size_t)call->n * call->size); /* fall through */
    default: return set(call, 0);
    }
}

static int wants_to_end(void)
{
    int is_terminated = 0;
    const FARPROC ask = version == 2 ? function("fmi2GetBooleanStatus") : NULL;
    return ask && ((int (*)(void *, int, int *))ask)(component, TERMINATED, &is_terminated) <= WARNING && is_terminated;
}

static void answer_row(int status, uint32_t stage, uint32_t step, double reached)
{
    is_lost = is_lost || status == FATAL;
    const size_t n = status <= WARNING ? 8 * ((size_t)(n_edges - 1) / output_every + 1) * n_outputs : 0;
    answer_with(status, (int)stage, (int)step, reached, last_complaint(), y, n);
}

static void simulate(void)
{
    int status = 0;
    double reached = 0.0, *place = y;
    complaint[0][0] = complaint[1][0] = '\0';
    is_initialized = 0;
    for (uint32_t i = 0; i < n_calls; i++)
        if ((status = begin(&calls[i])) > WARNING) {
            answer_row(status, i, 0, 0.0);
            return;
        }
    is_initialized = 1;
    const uint32_t stepping = n_calls, getting = n_calls + 1, first_input = n_calls + 2;
    /* One turn more than steps: the first output lies at the first edge, before any step. */
    for (uint32_t step = 0; step < n_edges; step++) {
        if (step % output_every == 0) {
            if ((status = get_call(component, output_references, n_outputs, place, n_outputs)) > WARNING) {
                answer_row(status, getting, step ? step - 1 : 0, 0.0);
                return;
            }
            place += n_outputs;
        }
        if (step == n_edges - 1) break;
        for (uint32_t i = 0; i < n_inputs; i++)
            if ((status = set(&inputs[i], step)) > WARNING) {
                answer_row(status, first_input + i, step, 0.0);
                return;
            }
        /* Event handling needed, simulation to be terminated, returned early; FMI 2.0 sees none of them. */
        unsigned char flags[3] = {0, 0, 0};
        status = step_call(component, edges[step], edges[step + 1] - edges[step], 1, flags, flags + 1, flags + 2, &reached);
        if (status == DISCARD && wants_to_end()) status = ENDED;
        if (status <= WARNING && flags[2]) status = EARLY;
        /* An FMU that ends with the last step has answered the whole row. */
        if (status <= WARNING && flags[1] && step + 2 < n_edges) status = ENDED;
        if (status > WARNING) {
            answer_row(status, stepping, step, reached);
            return;
        }
    }
    answer_row(OK, 0, 0, 0.0);
}

static LONG WINAPI crashed(EXCEPTION_POINTERS *what)
{
    fprintf(stderr, "exception 0x%08lX of Windows\n", what->ExceptionRecord->ExceptionCode);
    fflush(stderr);
    TerminateProcess(GetCurrentProcess(), 70);
    return EXCEPTION_EXECUTE_HANDLER;
}

/* The FMU may write to its standard streams, or close them: it has others than the messages. */
static void set_streams_apart(void)
{
    const HANDLE self = GetCurrentProcess(), nothing = CreateFileA("NUL", GENERIC_READ, 0, NULL, OPEN_EXISTING, 0, NULL);
    DuplicateHandle(self, GetStdHandle(STD_INPUT_HANDLE), self, &input, 0, FALSE, DUPLICATE_SAME_ACCESS);
    DuplicateHandle(self, GetStdHandle(STD_OUTPUT_HANDLE), self, &output, 0, FALSE, DUPLICATE_SAME_ACCESS);
    SetStdHandle(STD_INPUT_HANDLE, nothing);
    SetStdHandle(STD_OUTPUT_HANDLE, GetStdHandle(STD_ERROR_HANDLE));
    _dup2(2, 1);
    _close(0);
}

int main(void)
{
    SetErrorMode(SEM_FAILCRITICALERRORS | SEM_NOGPFAULTERRORBOX | SEM_NOOPENFILEERRORBOX);
    SetUnhandledExceptionFilter(crashed);
    set_streams_apart();
    CreateThread(NULL, 0, listen, NULL, 0, NULL);
    for (;;) {
        wait_for(1);
        const int is_damaged = message_size > 1 && message[1];
        at = message + 1;
        switch (*message) {
        case 'L': load(); break;
        case 'S': simulate(); break;
        case 'R': {
            const FARPROC reset = either("fmi2Reset", "fmi3Reset");
            is_initialized = 0;
            answer(reset ? called(reset) : ERROR_STATUS, 0, 0, 0.0, last_complaint());
            break;
        }
        case 'N':
            free_instance(is_damaged);
            if (!is_lost) instantiate(0);
            answer(component ? OK : is_lost ? FATAL : NO_INSTANCE, 0, 0, 0.0, last_complaint());
            break;
        case 'P': answer(OK, 0, 0, 0.0, ""); break;
        default:
            free_instance(is_damaged);
            TerminateProcess(GetCurrentProcess(), 0);
        }
        free(message);
        hand_over(0);
    }
}

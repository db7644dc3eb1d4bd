/* A one-state FMU with a closed form and every way to fail: x' = -k x + u, stepped exactly; y = x. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2FunctionTypes.h"

enum { K, X0, MODE, U, Y, N_VARIABLES };
enum { GOOD, STEP_ERROR, STEP_DISCARD, STEP_FATAL, NAN_OUTPUT, REFUSE_INIT, CRASH, BAD_ADDRESS };
typedef struct { double v[N_VARIABLES]; double x; int broken; const fmi2CallbackFunctions *callbacks; } Instance;

static void defaults(Instance *m) {
  m->v[K] = 1e-4; m->v[X0] = 300.0; m->v[MODE] = GOOD; m->v[U] = 0.0; m->x = 300.0; m->broken = 0;
}
static fmi2Status say(Instance *m, fmi2Status status, double t) {
  m->broken = 1;
  m->callbacks->logger(m->callbacks->componentEnvironment, "decay", status, "log", "gave up at %g s", t);
  return status;
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name; (void)type; (void)resources; (void)visible; (void)logging;
  if (strcmp(guid, "decay-1")) return NULL;
  Instance *m = calloc(1, sizeof(Instance));
  m->callbacks = callbacks;
  defaults(m);
  return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) {
  Instance *m = c;
  if (m->broken) return fmi2Error; /* like tools that cannot be reset out of an error */
  defaults(m);
  return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real t0, fmi2Boolean s, fmi2Real t1) {
  (void)c; (void)d; (void)e; (void)t0; (void)s; (void)t1;
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  Instance *m = c;
  return m->v[MODE] == REFUSE_INIT ? say(m, fmi2Error, 0.0) : fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { Instance *m = c; m->x = m->v[X0]; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
  for (size_t i = 0; i < n; i++) ((Instance *)c)->v[r[i]] = v[i];
  return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
  Instance *m = c;
  for (size_t i = 0; i < n; i++) v[i] = r[i] == Y ? m->x : m->v[r[i]];
  return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep) {
  Instance *m = c;
  double k = m->v[K], a = exp(-k * h);
  (void)keep;
  m->x = m->x * a + m->v[U] * (k == 0.0 ? h : (1.0 - a) / k);
  if (t < 30000.0) return fmi2OK;
  switch ((int)m->v[MODE]) {
    case STEP_ERROR: return say(m, fmi2Error, t);
    case STEP_DISCARD: return say(m, fmi2Discard, t);
    case STEP_FATAL: return say(m, fmi2Fatal, t);
    case NAN_OUTPUT: m->x = NAN; return fmi2OK;
    case CRASH: abort();
    case BAD_ADDRESS: *(volatile int *)8 = 1; return fmi2OK;
    default: return fmi2OK;
  }
}

/* Never called, but fmpy loads no library without them. */
#define UNUSED(name) int name(void) { return fmi2Error; }
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
UNUSED(fmi2GetTypesPlatform)
UNUSED(fmi2GetVersion)
UNUSED(fmi2SerializeFMUstate)
UNUSED(fmi2SerializedFMUstateSize)
UNUSED(fmi2SetBoolean)
UNUSED(fmi2SetDebugLogging)
UNUSED(fmi2SetFMUstate)
UNUSED(fmi2SetInteger)
UNUSED(fmi2SetRealInputDerivatives)
UNUSED(fmi2SetString)

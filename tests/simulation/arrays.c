/* Two rooms whose variables are arrays, in FMI 3.0: x_i' = (u_i - x_i) / RC_i from x0_i, y_i = gain_i1 x_1 + gain_i2 x_2. */
#include <math.h>
#include <stdlib.h>
#include "fmi3Functions.h"

enum { TIME, RC, X0, U, Y, GAIN, X, DER };
enum { N = 2 };
typedef struct { double rc[N], x0[N], u[N], gain[N * N], x[N]; } Rooms;

static double *place(Rooms *m, fmi3ValueReference r, size_t *n) {
  *n = N;
  switch (r) {
    case RC: return m->rc;
    case X0: return m->x0;
    case U: return m->u;
    case X: return m->x;
    case GAIN: *n = N * N; return m->gain;
    default: return NULL;
  }
}
static void defaults(Rooms *m) {
  *m = (Rooms){{3600.0, 7200.0}, {290.0, 291.0}, {280.0, 280.0}, {1.0, 0.0, 0.0, 1.0}, {290.0, 291.0}};
}
static Rooms *make(void) { Rooms *m = malloc(sizeof(Rooms)); defaults(m); return m; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d, fmi3Boolean e,
  fmi3Boolean f, fmi3Boolean g, const fmi3ValueReference h[], size_t i, fmi3InstanceEnvironment j,
  fmi3LogMessageCallback k, fmi3IntermediateUpdateCallback l) {
  (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g; (void)h; (void)i; (void)j; (void)k; (void)l;
  return make();
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d, fmi3Boolean e,
  fmi3InstanceEnvironment f, fmi3LogMessageCallback g) {
  (void)a; (void)b; (void)c; (void)d; (void)e; (void)f; (void)g;
  return make();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3Reset(fmi3Instance c) { defaults(c); return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { (void)c; return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, double b, double t, fmi3Boolean d, double e) {
  (void)c; (void)a; (void)b; (void)t; (void)d; (void)e;
  return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
  for (int i = 0; i < N; i++) ((Rooms *)c)->x[i] = ((Rooms *)c)->x0[i];
  return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const double v[], size_t k) {
  size_t at = 0, length;
  for (size_t i = 0; i < n; i++, at += length) {
    double *to = place(c, r[i], &length);
    if (!to || at + length > k) return fmi3Error;
    for (size_t j = 0; j < length; j++) to[j] = v[at + j];
  }
  return at == k ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, double v[], size_t k) {
  Rooms *m = c;
  size_t at = 0, length;
  for (size_t i = 0; i < n; i++, at += length) {
    double *from = place(m, r[i], &length);
    if (at + length > k) return fmi3Error;
    for (size_t j = 0; j < length; j++)
      v[at + j] = from ? from[j] : r[i] == Y ? m->gain[j * N] * m->x[0] + m->gain[j * N + 1] * m->x[1]
                                             : (m->u[j] - m->x[j]) / m->rc[j];
  }
  return at == k ? fmi3OK : fmi3Error;
}
fmi3Status fmi3DoStep(fmi3Instance c, double t, double h, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *d, fmi3Boolean *e,
                      double *last) {
  Rooms *m = c;
  (void)a;
  for (int i = 0; i < N; i++) m->x[i] = m->u[i] + (m->x[i] - m->u[i]) * exp(-h / m->rc[i]);
  *b = *d = *e = false;
  *last = t + h;
  return fmi3OK;
}
/* Model exchange. */
fmi3Status fmi3EnterEventMode(fmi3Instance c) { (void)c; return fmi3OK; }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { (void)c; return fmi3OK; }
fmi3Status fmi3SetTime(fmi3Instance c, double t) { (void)c; (void)t; return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d, fmi3Boolean *e,
                                    fmi3Boolean *f, double *g) {
  (void)c; (void)g;
  *a = *b = *d = *e = *f = false;
  return fmi3OK;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const double x[], size_t n) {
  for (size_t i = 0; i < n; i++) ((Rooms *)c)->x[i] = x[i];
  return n == N ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, double x[], size_t n) {
  for (size_t i = 0; i < n; i++) x[i] = ((Rooms *)c)->x[i];
  return n == N ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, double x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 300.0;
  return fmi3OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, double d[], size_t n) {
  Rooms *m = c;
  for (size_t i = 0; i < n; i++) d[i] = (m->u[i] - m->x[i]) / m->rc[i];
  return n == N ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, double z[], size_t n) { (void)c; (void)z; (void)n; return fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *d) {
  (void)c; (void)a;
  *b = *d = false;
  return fmi3OK;
}

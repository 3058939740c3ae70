/*
 * FMI 2.0 around a right-hand side, for Model Exchange and Co-Simulation: model.c computes it, model.h says how large
 * it is, step.c goes from one communication point to the next.
 *
 * Value references: states, their derivatives, inputs, outputs, coefficients, in this order.
 */
/* First, so that no other header has names that columns may have. */
#include "model.c"

#include "model.h"

#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define RATES N_STATE
#define INPUTS (2 * N_STATE)
#define OUTPUTS (INPUTS + N_INPUT)
#define FACTORS (OUTPUTS + N_OUTPUT)
#define N_VALUE (FACTORS + N_FACTOR)

typedef struct {
    double time;
    double value[N_VALUE + 1];
    double largest[N_STATE + 1]; /* So far, of each state. */
    double step, tolerance;
    int initial; /* Whether what follows another state at the start still does. */
} Model;

#include "step.c"

static void rest(Model *m)
{
    memset(m, 0, sizeof *m);
    memcpy(m->value, START, N_STATE * sizeof(double));
    memcpy(m->value + FACTORS, FACTOR, N_FACTOR * sizeof(double));
    m->tolerance = TOLERANCE;
    m->initial = 1;
}

static void follow(Model *m)
{
    size_t k;
    for (k = 0; m->initial && k < N_STATE; k++)
        if (FOLLOWS[k] >= 0) m->value[k] = m->value[FOLLOWS[k]];
}

static void compute(Model *m)
{
    follow(m);
    RHS(m->time, m->value, m->value + INPUTS, m->value + FACTORS, m->value + RATES);
    GIVEN(m->time, m->value, m->value + INPUTS, m->value + FACTORS, m->value + OUTPUTS);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Model *m;
    (void)name; (void)resources; (void)functions; (void)visible; (void)logging;
    if (type != fmi2ModelExchange && type != fmi2CoSimulation) return NULL;
    if (guid == NULL || strcmp(guid, GUID) != 0) return NULL;
    m = malloc(sizeof *m);
    if (m != NULL) rest(m);
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_given, fmi2Real stop)
{
    (void)stop_given; (void)stop;
    if (tolerance_given && tolerance > 0.0) ((Model *)c)->tolerance = fmax(tolerance, TIGHTEST);
    ((Model *)c)->time = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    follow(c);
    ((Model *)c)->initial = 0;
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { rest(c); return fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[])
{
    size_t i;
    compute(c);
    for (i = 0; i < n; i++) {
        if (r[i] >= N_VALUE) return fmi2Error;
        value[i] = ((Model *)c)->value[r[i]];
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[])
{
    size_t i;
    for (i = 0; i < n; i++) {
        /* Rates and outputs follow from the others. */
        if (r[i] >= N_VALUE || (r[i] >= RATES && r[i] < INPUTS) || (r[i] >= OUTPUTS && r[i] < FACTORS)) return fmi2Error;
        ((Model *)c)->value[r[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *event)
{
    (void)c;
    memset(event, 0, sizeof *event);
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean kept, fmi2Boolean *event, fmi2Boolean *end)
{
    (void)c; (void)kept;
    *event = *end = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { ((Model *)c)->time = time; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    if (n != N_STATE) return fmi2Error;
    memcpy(((Model *)c)->value, x, n * sizeof(double));
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    if (n != N_STATE) return fmi2Error;
    follow(c);
    memcpy(x, ((Model *)c)->value, n * sizeof(double));
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real rates[], size_t n)
{
    if (n != N_STATE) return fmi2Error;
    compute(c);
    memcpy(rates, ((Model *)c)->value + RATES, n * sizeof(double));
    return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n)
{
    size_t k;
    (void)c;
    for (k = 0; k < n; k++) nominal[k] = 1.0;
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    (void)c; (void)z;
    return n == 0 ? fmi2OK : fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real length, fmi2Boolean kept)
{
    fmi2Status status;
    (void)kept;
    if (!isfinite(time) || !isfinite(length) || length < 0.0) return fmi2Error;
    ((Model *)c)->time = time;
    status = advance(c, length);
    if (status != fmi2Error) ((Model *)c)->time = time + length;
    return status;
}
fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Model *)c)->time;
    return fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{ (void)c; (void)kind; (void)value; return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{ (void)c; (void)kind; (void)value; return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{ (void)c; (void)kind; (void)value; return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{ (void)c; (void)kind; (void)value; return fmi2Discard; }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{ (void)c; (void)r; (void)order; (void)value; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{ (void)c; (void)r; (void)order; (void)value; return n == 0 ? fmi2OK : fmi2Error; }

/* There are numbers alone, and no states to keep: what modelDescription.xml does not offer is refused. */
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{ (void)c; (void)r; (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return fmi2Error; }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { (void)c; (void)s; return fmi2Error; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return fmi2Error; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n)
{ (void)c; (void)s; (void)n; return fmi2Error; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
{ (void)c; (void)s; (void)b; (void)n; return fmi2Error; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
{ (void)c; (void)b; (void)n; (void)s; return fmi2Error; }
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
                                        const fmi2ValueReference k[], size_t nk, const fmi2Real d[], fmi2Real o[])
{ (void)c; (void)u; (void)nu; (void)k; (void)nk; (void)d; (void)o; return fmi2Error; }

/*
 * The simulation: a mass on a spring that is fixed at 0.1 m, without friction. FMI 2.0 for Model Exchange.
 *
 * Value references: 0 spring stiffness, 1 its length at rest, 2 the wall, 3 mass, 4 position, 5 speed, 6 acceleration.
 */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define NONE(name, ...) \
    fmi2Status name(__VA_ARGS__) { return fmi2Error; }

typedef struct {
    double value[7];
} Plant;

static void rest(Plant *m)
{
    static const double start[7] = {10.0, 1.0, 0.1, 1.0, 0.5, 0.0, 0.0};
    memcpy(m->value, start, sizeof start);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Plant *m = malloc(sizeof *m);
    if (m != NULL) rest(m);
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_given, fmi2Real stop) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c)
{
    rest(c);
    return fmi2OK;
}

static fmi2Status get(Plant *m, const fmi2ValueReference r[], size_t n, fmi2Real x[])
{
    double *z = m->value;
    size_t k;
    z[6] = z[0] * (z[1] - (z[4] - z[2])) / z[3];
    for (k = 0; k < n; k++) {
        if (r[k] > 6) return fmi2Error;
        x[k] = z[r[k]];
    }
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[]) { return get(c, r, n, x); }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real x[])
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (r[k] > 5) return fmi2Error;
        ((Plant *)c)->value[r[k]] = x[k];
    }
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    memset(info, 0, sizeof *info);
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean keeps, fmi2Boolean *event, fmi2Boolean *end)
{
    *event = *end = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    memcpy(((Plant *)c)->value + 4, x, n * sizeof *x);
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    memcpy(x, ((Plant *)c)->value + 4, n * sizeof *x);
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n)
{
    static const fmi2ValueReference rates[2] = {5, 6};
    return get(c, rates, n, x);
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    size_t k;
    for (k = 0; k < n; k++) x[k] = 1.0;
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real x[], size_t n) { return fmi2OK; }

/* What it has not. */
NONE(fmi2GetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer x[])
NONE(fmi2GetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean x[])
NONE(fmi2GetString, fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String x[])
NONE(fmi2SetInteger, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer x[])
NONE(fmi2SetBoolean, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean x[])
NONE(fmi2SetString, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String x[])
NONE(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *s)
NONE(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate s)
NONE(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *s)
NONE(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
NONE(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
NONE(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
NONE(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference z[], size_t nz,
     const fmi2ValueReference v[], size_t nv, const fmi2Real dv[], fmi2Real dz[])

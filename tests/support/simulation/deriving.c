/* y = k u + b of FMI 2.0, at once, with k and b parameters of the initialisation alone; double = 2 k is calculated,
   and local = 3 u. Parameters that come later, and calculated values that come too early, are errors. */
#include "fmi2Functions.h"
#include <stdlib.h>

typedef struct {
    double u, k, b;
    int phase; /* 0 instantiated, 1 initialisation, 2 running */
} Instance;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Instance *made = calloc(1, sizeof(Instance));
    made->u = made->k = 1;
    return made;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) {
    Instance fresh = {1, 1, 0, 0};
    *(Instance *)c = fresh;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tol, fmi2Real s, fmi2Boolean h, fmi2Real e) {
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { ((Instance *)c)->phase = 1; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { ((Instance *)c)->phase = 2; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Real *v) {
    Instance *m = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == 0) m->u = v[i];
        else if (r[i] > 2 || m->phase == 2) return fmi2Error;
        else *(r[i] == 1 ? &m->k : &m->b) = v[i];
    }
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2Real *v) {
    Instance *m = c;
    for (size_t i = 0; i < n; i++) {
        double own[] = {m->u, m->k, m->b, 2 * m->k, 3 * m->u, m->k * m->u + m->b};
        if (r[i] == 3 && !m->phase) return fmi2Error;
        v[i] = own[r[i]];
    }
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Integer *v) { return fmi2Error; }
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2Integer *v) { return fmi2Error; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Boolean *v) { return fmi2Error; }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2Boolean *v) { return fmi2Error; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2String *v) { return fmi2Error; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2String *v) { return fmi2Error; }

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean p) { return fmi2OK; }
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(Instance));
    *(Instance *)*s = *(Instance *)c;
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { *(Instance *)c = *(Instance *)s; return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { free(*s); *s = 0; return fmi2OK; }

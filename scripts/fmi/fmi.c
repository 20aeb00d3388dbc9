/* FMI 2.0 and 3.0 for co-simulation (-DFMI=2 or 3), over a block of memory whose variables block.h
   lists. law.c and plant.c compute it. Functions that are not here are in stubs.c and fail. */
#include <stdint.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
#define F(name) fmi2##name
#define REAL(access) fmi2##access##Real
#define INTEGER(access) fmi2##access##Integer
#define NUMBER_OF_VALUES
typedef fmi2Component instance;
#else
#include "fmi3Functions.h"
#define F(name) fmi3##name
#define REAL(access) fmi3##access##Float64
#define INTEGER(access) fmi3##access##Int32
#define NUMBER_OF_VALUES , size_t values_size
typedef fmi3Instance instance;
#endif

#include "block.h"

typedef F(Status) status;
typedef F(ValueReference) reference;

int block_start(unsigned char *block, const char *resources);
int block_step(unsigned char *block, double time, double period);
void block_end(void);

static union { unsigned char bytes[sizeof START]; double time; } block;  /* begins with the time */
static char resources[4096];

static status result(int is_good) { return is_good ? F(OK) : F(Error); }

#define ACCESS(get, set, type, stored)                                                          \
    status get(instance c, const reference vr[], size_t n, type values[] NUMBER_OF_VALUES) {    \
        for (size_t i = 0; i < n; i++) {                                                        \
            if (vr[i] >= VARIABLE_COUNT) return F(Error);                                       \
            const stored *from = (const stored *)(block.bytes + VARIABLES[vr[i]].offset);       \
            for (unsigned k = 0; k < VARIABLES[vr[i]].size; k++) *values++ = from[k]; \
        }                                                                                       \
        return F(OK);                                                                           \
    }                                                                                           \
    status set(instance c, const reference vr[], size_t n, const type values[] NUMBER_OF_VALUES) { \
        for (size_t i = 0; i < n; i++) {                                                        \
            if (vr[i] >= VARIABLE_COUNT) return F(Error);                                       \
            stored *to = (stored *)(block.bytes + VARIABLES[vr[i]].offset);                     \
            for (unsigned k = 0; k < VARIABLES[vr[i]].size; k++) to[k] = *values++;             \
        }                                                                                       \
        return F(OK);                                                                           \
    }

ACCESS(REAL(Get), REAL(Set), double, double)
ACCESS(INTEGER(Get), INTEGER(Set), int32_t, int32_t)
ACCESS(F(GetBoolean), F(SetBoolean), F(Boolean), int32_t)

static instance start(F(String) token, F(String) place) {
    if (strcmp(token, TOKEN) || !place) return NULL;
    strncpy(resources, strncmp(place, "file://", 7) ? place : place + 7, sizeof resources - 1);
    memcpy(block.bytes, START, sizeof START);
    return &block;
}

status F(Terminate)(instance c) { block_end(); return F(OK); }
status F(Reset)(instance c) { block_end(); memcpy(block.bytes, START, sizeof START); return F(OK); }
void F(FreeInstance)(instance c) { if (c) block_end(); }
status F(ExitInitializationMode)(instance c) { return result(block_start(block.bytes, resources)); }
status F(SetDebugLogging)(instance c, F(Boolean) on, size_t n, const F(String) categories[]) {
    return F(OK);
}

static status step(double time, double period) {
    int is_good = block_step(block.bytes, time, period);
    block.time = time + period;
    return result(is_good);
}

#if FMI == 2
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
    return type == fmi2CoSimulation ? start(guid, place) : NULL;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real begin, fmi2Boolean has_end, fmi2Real end) {
    block.time = begin;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real period, fmi2Boolean is_final) {
    return step(time, period);
}
#else
const char *fmi3GetVersion(void) { return fmi3Version; }
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String place, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early_return, const fmi3ValueReference required[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
    return events ? NULL : start(token, place);
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance,
                                       fmi3Float64 tolerance, fmi3Float64 begin,
                                       fmi3Boolean has_end, fmi3Float64 end) {
    block.time = begin;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 period, fmi3Boolean is_final,
                      fmi3Boolean *needs_event, fmi3Boolean *ends, fmi3Boolean *returned_early,
                      fmi3Float64 *last_time) {
    *needs_event = *ends = *returned_early = fmi3False;
    *last_time = time + period;
    return step(time, period);
}
#endif

/* One running instance of a model, whatever version of FMI it is seen through.
 *
 * Inputs are held over a step; those that act late (late.h) show in outputs as they acted over it, and once an input is
 * set, as they will over another step as long. Sampled states change at start + k sample_time, at the beginning of the step that
 * reaches that instant, with the inputs of that instant; continuous states are integrated by the classical Runge-Kutta
 * method with equal inner steps no longer than the model's solver step. The specification is fmus/instance.py.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "model.h"

/* As in both versions of FMI. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL } Status;

/* Modes of the state machines of FMI, one bit each, so that a set of modes is a mask. */
enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    EVENT = 4,
    CONTINUOUS_TIME = 8,
    STEP = 16,
    TERMINATED = 32,
    FAILED = 64
};

enum { LONGEST_HISTORY = N_DELAYS ? 1024 : 1 }; /* steps within a delay */

/* What an input was, oldest first; see late.h. */
typedef struct {
    int count;
    double time[LONGEST_HISTORY + 2], value[LONGEST_HISTORY + 2]; /* one more while it is seen whether it is too long */
    double acts;                                                  /* over the latest step */
} History;

/* Everything that changes while running; plain data, so that a copy of it is a state to go back to. */
typedef struct {
    double values[N_VARIABLES]; /* by value reference; outputs and rates where `valid` says so */
    double time, start;
    double samples; /* taken so far */
    double longest; /* inner step of the solver */
    int mode, valid, stepped;
    History late[N_DELAYS + 1];
    double duration; /* of the latest step */
    int over;        /* whether a part has asked to be stepped no more */
    int touched;     /* whether an input was set since */
} Snapshot;

/* Derivatives along directions, rows of `width` numbers by value reference; see derivatives.h. */
typedef struct {
    size_t directions, width;
    double *known;   /* of inputs, parameters and states */
    double *results; /* of rates, outputs and new sampled states, where they were evaluated */
    double *work;
    double *late; /* of the histories of inputs; see late.c */
    size_t first[N_VARIABLES], end[N_VARIABLES]; /* of each row of `known`, what may be other than 0 */
} Tangents;

typedef struct Instance Instance;
typedef void Report(Instance *it, Status status, const char *category, const char *message);

struct Instance {
    Snapshot now;
    double defaults[N_VARIABLES];
    Tangents tangents;
    Table tables[N_TABLES + 1];
    /* Set by the adapter, before anything else is called: */
    Report *report;
    int logging;        /* whether to report events; errors always are */
    int model_exchange; /* whether the importer integrates; then it may set states */
    double tolerance;   /* of the run, relative; 0 where the importer tells none */
    int ends;           /* whether the importer tells when the run ends */
    double stop;        /* and when [s] */
    void *parts;        /* of a system, see part.h */
};

/* Read defaults and tables and put the instance at its start; close it whatever comes back. */
Status instance_open(Instance *it, const char *token, const char *resources);
void instance_close(Instance *it);
void instance_reset(Instance *it);

/* Whether the token and the resources are those of this FMU; if not, an error is reported. */
int instance_belongs(Instance *it, const char *token, const char *resources);

/* Whether the mode is among `modes`; if not, an error is reported. */
int instance_allows(Instance *it, int modes, const char *function);

/* Report an error, or an event when logging is on. */
Status instance_error(Instance *it, const char *format, ...);
void instance_event(Instance *it, const char *format, ...);

/* Report something that is not as it should be, with which the instance goes on. */
void instance_warn(Instance *it, const char *format, ...);

/* Report an error after which the instance cannot go on. */
Status instance_fail(Instance *it, const char *format, ...);

/* Switch the report of events; `categories` restrict it, none means all. Unknown ones are an error. */
Status instance_log(Instance *it, int on, size_t count, const char *const categories[]);

/* Report parameters that do not fit together, in a category of its own, after which the instance cannot go on. */
Status instance_refuse(Instance *it, const char *format, ...);

/* Put the states at their start values. */
Status instance_begin(Instance *it, double time);

/* Leave the initialisation; see that the parameters fit together. */
Status instance_run(Instance *it);

/* The variable of this reference where its type is one of the `types` (a mask); NULL, and an error, where not. */
const Variable *instance_find(Instance *it, unsigned reference, int types);

/* Why a variable cannot be set now, NULL when it can. */
const char *instance_obstacle(const Instance *it, const Variable *variable);

/* A variable of one of the `types` (a mask). */
Status instance_get(Instance *it, unsigned reference, int types, double *value);
Status instance_set(Instance *it, unsigned reference, int types, double value);

/* Advance from `time` by `duration` [s]. */
Status instance_step(Instance *it, double time, double duration);

/* Take the sample that is due now. */
Status instance_sample(Instance *it);

/* Model exchange: check the requirements, give or take time and states, evaluate, check that states are finite. */
Status instance_start_continuous(Instance *it);
Status instance_set_time(Instance *it, double time);
Status instance_set_states(Instance *it, const double states[], size_t count);
Status instance_get_states(Instance *it, double states[], size_t count);
Status instance_get_rates(Instance *it, double rates[], size_t count);
Status instance_get_nominals(Instance *it, double nominals[], size_t count);
Status instance_check_states(Instance *it);

/* States to go back to; `*state` is made when it is NULL. */
Status instance_save(Instance *it, void **state);
Status instance_restore(Instance *it, const void *state);
void instance_drop(Instance *it, void *state);
size_t instance_serialized_size(void);
uint64_t instance_checksum(const void *bytes, size_t size); /* FNV-1a */
Status instance_serialize(Instance *it, const void *state, void *bytes, size_t size);
Status instance_deserialize(Instance *it, const void *bytes, size_t size, void **state);

#endif

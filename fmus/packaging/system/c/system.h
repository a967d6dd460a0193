/* A system: parts in the order in which they are stepped, and how values pass between them.
 *
 * All values of the system lie in one array `v`, by value reference: for each part its inputs, parameters and outputs,
 * one after the other as the part's model has them. What an output holds there is what others see of it; the
 * specification is orchestrator/engine/loop.py.
 */
#ifndef SYSTEM_H
#define SYSTEM_H

#include "part.h"

/* A real input of a part, by the part's own value reference, and what moves it: factor times a value of the system. */
typedef struct {
    int input, source;
    double factor;
} Feed;

typedef struct NestedFmu NestedFmu;

typedef struct {
    const char *name;
    const char *folder; /* in the resources */
    const PartModel *model;
    const NestedFmu *fmu; /* where it is no model; see nested.h */
    int first, count; /* its value references */
    int every;        /* its communication step [base steps] */
    double duration;  /* the same [s] */
    int instant;      /* whether its outputs hold at once, and not from the end of its step on */
    int evaluated;    /* whether anybody looks at outputs that are no states */
    void (*take)(const double *v, double *values);   /* its inputs from the system */
    double (*give)(const double *values, double *v); /* its outputs to the system; their sum comes back */
    const Feed *feeds;                               /* as `take`, the last with input -1 */
    const int *outputs;                              /* real ones that `give` gives, in the system; -1 after them */
} Part;

/* The time of base step k is (first + k step) / denominator [s]; all are whole numbers. */
typedef struct {
    double first, step, denominator;
} Clock;

extern const Part system_parts[N_PARTS];
extern const Clock system_clock;
extern const double system_tolerance; /* which FMUs inside are told where the importer tells none; 0 is none */

#endif

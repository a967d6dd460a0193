/* A part of a system: an instance of its own, behind functions that know its sizes.
 *
 * Each model of a system is one translation unit: its equations and the runtime of instance.h, under names of its own.
 * An FMU within a system is a part of the same kind, see nested.h.
 */
#ifndef PART_H
#define PART_H

#include "instance.h"

/* What a part has to say; `owner` is the system's instance, `number` the part's place in it. */
typedef void PartReport(void *owner, int number, Status status, const char *category, const char *message);

typedef struct {
    size_t size; /* of a saved state [bytes] */
    void *(*open)(void *owner, int number, PartReport *report, const char *folder);
    void (*close)(void *part);
    void (*reset)(void *part);
    Status (*begin)(void *part, double time);
    Status (*set)(void *part, unsigned reference, double value);
    Status (*step)(void *part, double time, double duration);
    Status (*evaluate)(void *part); /* the outputs that are no states, at its present time */
    Status (*run)(void *part);      /* leave the initialisation, see that parameters fit */
    double *(*values)(void *part);  /* by the part's value references */
    Status (*save)(void *part, void *to); /* its state; all bytes there are 0, or a state saved before */
    Status (*restore)(void *part, const void *from);
    void (*drop)(void *part, void *at); /* what belongs to a saved state */
    Status (*carry)(void *part, size_t directions); /* tangents, see derivatives.h */
    Status (*set_tangents)(void *part, unsigned reference, const double *tangents);
    Status (*get_tangents)(void *part, unsigned reference, double *tangents);
} PartModel;

#endif

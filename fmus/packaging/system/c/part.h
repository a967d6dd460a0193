/* A model as a part of a fused system: an instance of its own, behind functions that know its sizes.
 *
 * Each model of a system is one translation unit: its equations and the runtime of instance.h, under names of its own.
 */
#ifndef PART_H
#define PART_H

#include "instance.h"

/* What a part has to say; `owner` is the system's instance, `number` the part's place in it. */
typedef void PartReport(void *owner, int number, Status status, const char *category, const char *message);

typedef struct {
    size_t size; /* of what changes while running [bytes] */
    void *(*open)(void *owner, int number, PartReport *report, const char *tables);
    void (*close)(void *part);
    void (*reset)(void *part);
    Status (*begin)(void *part, double time);
    Status (*set)(void *part, unsigned reference, double value);
    Status (*check_parameters)(void *part);
    Status (*step)(void *part, double time, double duration);
    void (*evaluate)(void *part);  /* the outputs that are no states, at its present time */
    double *(*values)(void *part); /* by the model's value references */
    void *(*snapshot)(void *part); /* of `size` bytes */
    Status (*carry)(void *part, size_t directions); /* tangents, see derivatives.h */
    Status (*set_tangents)(void *part, unsigned reference, const double *tangents);
    Status (*get_tangents)(void *part, unsigned reference, double *tangents);
} PartModel;

#endif

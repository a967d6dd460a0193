/* Inputs that act later than they are set: their histories, and what of them acts over a step.
 *
 * What acts is a sum of the values that were set, each with a weight, and its tangents are the same sum of theirs. While
 * the model is evaluated it stands in the place of the input. The specification is fmus/modelling/late.py.
 */
#ifndef LATE_H
#define LATE_H

#include "instance.h"

/* Room for the tangents of all histories along directions whose rows have `width` numbers. */
size_t late_room(size_t width);

/* Forget everything. */
void late_begin(Instance *it);

/* Note that a step begins, and see what acts over it; NULL, or the name of the input whose delay holds too many steps. */
const char *late_arrive(Instance *it, double time, double duration);

/* See what would act over another step as long as the latest, if an input was set since then. */
void late_foresee(Instance *it);

/* Have what acts stand in the place of the inputs, and the inputs in theirs again. */
void late_enter(Instance *it);
void late_leave(Instance *it);

#endif

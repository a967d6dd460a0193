/* Derivatives of an instance's values: at an instant (directional and adjoint), and carried along a run (tangents).
 *
 * A tangent of a variable is its derivative along one direction in the space of parameters, start values and inputs.
 * An instance carries as many directions as its importer asks for, and from then on its steps carry them by the
 * equations that they take themselves: the classical Runge-Kutta method's own derivative, and that of each sampling
 * instant. At a kink or jump it is the derivative of the side that the values are on.
 */
#ifndef DERIVATIVES_H
#define DERIVATIVES_H

#include "instance.h"

/* result = J seed (forward), or its transpose: J has a row for each unknown and a column for each known. */
Status instance_derivative(Instance *it, const unsigned unknowns[], size_t rows, const unsigned knowns[], size_t columns,
                           const double seed[], double result[], int transposed);

/* Carry so many directions from now on, all tangents 0; none frees them, and so does a reset. */
Status instance_carry(Instance *it, size_t directions);

/* Tangents of variables, `directions` numbers each, one variable after the other. Real inputs, parameters and states
 * can be given some; a sample period cannot, since instants have no derivative. */
Status instance_set_tangents(Instance *it, const unsigned references[], size_t count, const double tangents[]);
Status instance_get_tangents(Instance *it, const unsigned references[], size_t count, double tangents[]);

/* What the instance calls where it carries directions: at its beginning, for an inner step, before a sampling. */
void tangents_begin(Instance *it);
void tangents_integrate(Instance *it, const double *constants, double t, double h);
void tangents_update(Instance *it, double t);

#endif

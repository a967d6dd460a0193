/* What a generated model gives to the runtime: its sizes (layout.h), its variables, its equations (model.c).
 *
 * All values of an instance lie in one array `v`, by value reference.
 */
#ifndef MODEL_H
#define MODEL_H

#include "layout.h"
#include "ops.h"

typedef enum { REAL = 1, INTEGER = 2, BOOLEAN = 4, ENUMERATION = 8 } Type;
/* TUNABLE: a parameter, at any time; RECEIVED: an input of the model that frames of a bus set */
typedef enum { INPUT, PARAMETER, TUNABLE, RECEIVED, STATE, OUTPUT, RATE, TIME } Role;

typedef struct {
    const char *name;
    Type type;
    Role role;
    double start; /* of inputs, parameters and what is received */
    int size;     /* how many values FMI 3.0 has behind it: all of an array behind its first element, none behind others */
} Variable;

typedef struct {
    int value;     /* value reference */
    int parameter; /* value reference of the parameter that it starts at, -1: it starts at `start` */
    double start;
    int sampled;
} State;

/* An input that acts later than it is set; value references. */
typedef struct {
    int input, seconds, before, shape;
} Delay;

/* Arrays have one element more than they need: C has no empty arrays. */
extern const Variable model_variables[N_VARIABLES];
extern const State model_states[N_STATES + 1];
extern const int model_continuous[N_CONTINUOUS + 1];   /* value references of the continuous states */
extern const double model_nominals[N_CONTINUOUS + 1];
extern const char *const model_tables[N_TABLES + 1];
extern const Delay model_delays[N_DELAYS + 1];

/* What the rates need of parameters alone; it is the same until one of them is set. */
void model_constants(const double *v, double *c);

/* Rates of the continuous states, in the order of `model_continuous`; `c` are their constants. */
void model_derivatives(double t, const double *v, const Table *tables, const double *c, double *rates);

/* New values of the sampled states, written into v. */
void model_update(double t, double *v, const Table *tables);

/* Outputs that are no states, written into v. */
void model_outputs(double t, double *v, const Table *tables);

/* The longest inner step of the solver [s]. */
double model_solver_step(const double *v, const Table *tables);

/* Why the parameters do not fit together, NULL when they do; `about` then are the value references of those concerned,
 * -1 behind the last. */
const char *model_conflict(const double *v, const Table *tables, const int **about);

/* Why the model cannot start from here, with parameters that fit together; NULL when it can. */
const char *model_refusal(double t, const double *v, const Table *tables);

/* Partial derivatives that are not zero everywhere, of rates, outputs or new sampled states by states, real inputs and
 * real parameters: where each belongs, by value reference; those of one result lie side by side. */
typedef struct {
    int result, known;
} Place;

extern const Place model_rate_places[N_RATE_PARTIALS + 1];
extern const Place model_output_places[N_OUTPUT_PARTIALS + 1];
extern const Place model_update_places[N_UPDATE_PARTIALS + 1];
void model_output_partials(double t, const double *v, const Table *tables, double *partials);
void model_update_partials(double t, const double *v, const Table *tables, double *partials);

/* The rates, and their partial derivatives. */
void model_linearised(double t, const double *v, const Table *tables, const double *c, double *rates, double *partials);

#endif

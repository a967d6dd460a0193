#include "derivatives.h"

#include <stdlib.h>
#include <string.h>

#include "late.h"

#ifdef __cplusplus
#define restrict /* which C++ does not know */
#endif

/* At an instant */

static Status check_places(Instance *it, const unsigned unknowns[], size_t rows, const unsigned knowns[], size_t columns)
{
    for (size_t i = 0; i < rows; i++) {
        const Role role = unknowns[i] < N_VARIABLES ? model_variables[unknowns[i]].role : TIME;
        if (role != RATE && role != OUTPUT && role != STATE)
            return instance_error(it, "value reference %u is no unknown to take the derivative of", unknowns[i]);
    }
    for (size_t j = 0; j < columns; j++) {
        const Variable *known = knowns[j] < N_VARIABLES ? &model_variables[knowns[j]] : NULL;
        if (!known || known->type != REAL || known->role > STATE)
            return instance_error(it, "value reference %u is no known to take the derivative by", knowns[j]);
    }
    return STATUS_OK;
}

/* J times `seeds` (by value reference) added to `results`, or J transposed times `results` added to `seeds`. */
static void multiply(const Place places[], size_t count, const double partials[], double seeds[], double results[],
                     int transposed)
{
    for (size_t k = 0; k < count; k++) {
        if (transposed)
            seeds[places[k].known] += partials[k] * results[places[k].result];
        else
            results[places[k].result] += partials[k] * seeds[places[k].known];
    }
}

/* The same for rates and outputs of the present. */
static void differentiate(Instance *it, double seeds[], double results[], int transposed)
{
    double constants[N_CONSTANTS + 1], rates[N_CONTINUOUS + 1], partials[N_RATE_PARTIALS + N_OUTPUT_PARTIALS + 1];
    const double *v = it->now.values;
    model_constants(v, constants);
    model_linearised(it->now.time, v, it->tables, constants, rates, partials);
    multiply(model_rate_places, N_RATE_PARTIALS, partials, seeds, results, transposed);
    model_output_partials(it->now.time, v, it->tables, partials);
    multiply(model_output_places, N_OUTPUT_PARTIALS, partials, seeds, results, transposed);
}

/* Until the initialisation is over, states move with the parameters they start at. */
static void start_with_parameters(const Instance *it, double seeds[], int transposed)
{
    if (!(it->now.mode & (INSTANTIATED | INITIALIZATION)))
        return;
    for (int i = 0; i < N_STATES; i++) {
        const State *state = &model_states[i];
        if (state->parameter >= 0)
            seeds[transposed ? state->parameter : state->value] += seeds[transposed ? state->value : state->parameter];
    }
}

static int is_state(unsigned reference)
{
    return model_variables[reference].role == STATE;
}

Status instance_derivative(Instance *it, const unsigned unknowns[], size_t rows, const unsigned knowns[], size_t columns,
                           const double seed[], double result[], int transposed)
{
    double seeds[N_VARIABLES] = {0.0}, results[N_VARIABLES] = {0.0};
    if (!MODEL_EXCHANGE)
        return instance_error(it, "provides no derivatives");
    if (check_places(it, unknowns, rows, knowns, columns))
        return STATUS_ERROR;
    if (transposed) {
        for (size_t i = 0; i < rows; i++)
            *(is_state(unknowns[i]) ? &seeds[unknowns[i]] : &results[unknowns[i]]) += seed[i];
        differentiate(it, seeds, results, 1);
        start_with_parameters(it, seeds, 1);
        for (size_t j = 0; j < columns; j++)
            result[j] = seeds[knowns[j]];
        return STATUS_OK;
    }
    for (size_t j = 0; j < columns; j++)
        seeds[knowns[j]] += seed[j];
    start_with_parameters(it, seeds, 0);
    differentiate(it, seeds, results, 0);
    for (size_t i = 0; i < rows; i++)
        result[i] = is_state(unknowns[i]) ? seeds[unknowns[i]] : results[unknowns[i]];
    return STATUS_OK;
}

/* Along a run */

enum { LANES = 4 }; /* rows have a multiple of so many numbers, for compilers to do them side by side */

static double *row(double *matrix, const Tangents *of, int reference)
{
    return matrix + (size_t)reference * of->width;
}

/* to = from + factor * added, for `count` numbers, a multiple of LANES. */
static inline void add(double *restrict to, const double *restrict from, double factor, const double *restrict added,
                       size_t count)
{
    for (size_t d = 0; d < count; d += LANES) {
        to[d] = from[d] + factor * added[d];
        to[d + 1] = from[d + 1] + factor * added[d + 1];
        to[d + 2] = from[d + 2] + factor * added[d + 2];
        to[d + 3] = from[d + 3] + factor * added[d + 3];
    }
}

/* to += factor * added, likewise. */
static inline void accumulate(double *restrict to, double factor, const double *restrict added, size_t count)
{
    for (size_t d = 0; d < count; d += LANES) {
        to[d] += factor * added[d];
        to[d + 1] += factor * added[d + 1];
        to[d + 2] += factor * added[d + 2];
        to[d + 3] += factor * added[d + 3];
    }
}

Status instance_carry(Instance *it, size_t directions)
{
    Tangents *of = &it->tangents;
    const size_t width = (directions + LANES - 1) / LANES * LANES, rows = 2 * (N_VARIABLES + N_CONTINUOUS);
    free(of->known);
    memset(of, 0, sizeof *of);
    if (!directions)
        return STATUS_OK;
    if (it->model_exchange)
        return instance_error(it, "carries tangents in co-simulation only");
    if (!(of->known = (double *)calloc(width * rows + late_room(width), sizeof *of->known)))
        return instance_error(it, "no memory for the tangents along %lu directions", (unsigned long)directions);
    of->directions = directions;
    of->width = width;
    of->results = row(of->known, of, N_VARIABLES);
    of->work = row(of->results, of, N_VARIABLES);
    of->late = of->known + width * rows;
    for (int i = 0; i < N_STATES; i++)
        of->end[model_states[i].value] = width;
    return STATUS_OK;
}

void tangents_begin(Instance *it)
{
    const Tangents *of = &it->tangents;
    for (int i = 0; i < N_STATES; i++) {
        const State *state = &model_states[i];
        double *tangents = row(of->known, of, state->value);
        if (state->parameter < 0)
            memset(tangents, 0, of->width * sizeof *tangents);
        else
            memcpy(tangents, row(of->known, of, state->parameter), of->width * sizeof *tangents);
    }
}

/* Why a variable can have no tangent, NULL when it can. */
static const char *obstacle(const Instance *it, unsigned reference)
{
    if (!it->tangents.directions)
        return "no directions are carried";
    if (reference >= N_VARIABLES || model_variables[reference].type != REAL || model_variables[reference].role > STATE)
        return "it is no real input, parameter or state";
    for (int i = 0; i < N_DELAYS; i++)
        if ((int)reference == model_delays[i].seconds || (int)reference == model_delays[i].before)
            return "it decides what of an input acts, and when";
    return N_SAMPLED > 0 && (int)reference == SAMPLE_TIME ? "it decides when samples are taken" : NULL;
}

/* Note which lanes of an input's or parameter's row are other than 0: most parameters move along one direction. */
static void enclose(Tangents *of, int reference)
{
    const double *known = row(of->known, of, reference);
    size_t first = 0, end = of->width;
    if (model_variables[reference].role == PARAMETER) {
        while (end > 0 && known[end - 1] == 0.0)
            end--;
        while (first < end && known[first] == 0.0)
            first++;
    }
    of->first[reference] = first / LANES * LANES;
    of->end[reference] = (end + LANES - 1) / LANES * LANES;
}

Status instance_set_tangents(Instance *it, const unsigned references[], size_t count, const double tangents[])
{
    Tangents *of = &it->tangents;
    for (size_t i = 0; i < count; i++) {
        const char *problem = obstacle(it, references[i]);
        if (problem)
            return instance_error(it, "'%s' cannot be given tangents: %s",
                                  references[i] < N_VARIABLES ? model_variables[references[i]].name : "", problem);
        const int reference = (int)references[i];
        const Role role = model_variables[reference].role;
        memcpy(row(of->known, of, reference), tangents + i * of->directions, of->directions * sizeof *tangents);
        if (role != STATE)
            enclose(of, reference);
        if (role == PARAMETER && it->now.mode & (INSTANTIATED | INITIALIZATION))
            tangents_begin(it);
    }
    return STATUS_OK;
}

/* Rows of results from the rows of what they depend on; places of one result lie side by side. */
static void propagate(const Tangents *of, const Place places[], size_t count, const double partials[])
{
    for (size_t k = 0; k < count; k++) {
        const int known = places[k].known;
        const size_t first = of->first[known];
        double *result = row(of->results, of, places[k].result);
        if (k == 0 || places[k].result != places[k - 1].result)
            memset(result, 0, of->width * sizeof *result);
        accumulate(result + first, partials[k], row(of->known, of, known) + first, of->end[known] - first);
    }
}

Status instance_get_tangents(Instance *it, const unsigned references[], size_t count, double tangents[])
{
    const Tangents *of = &it->tangents;
    double partials[N_OUTPUT_PARTIALS + 1];
    int evaluated = 0;
    partials[N_OUTPUT_PARTIALS] = 0.0; /* compilers warn where it is the only one */
    for (size_t i = 0; i < count; i++) {
        const Role role = references[i] < N_VARIABLES ? model_variables[references[i]].role : TIME;
        if (!of->directions || role > OUTPUT)
            return instance_error(it, "value reference %u has no tangents", references[i]);
        if (role == OUTPUT && !evaluated) {
            late_foresee(it);
            late_enter(it);
            model_output_partials(it->now.time, it->now.values, it->tables, partials);
            propagate(of, model_output_places, N_OUTPUT_PARTIALS, partials);
            late_leave(it);
            evaluated = 1;
        }
        const double *from = row(role == OUTPUT ? of->results : of->known, of, (int)references[i]);
        memcpy(tangents + i * of->directions, from, of->directions * sizeof *tangents);
    }
    return STATUS_OK;
}

void tangents_update(Instance *it, double t)
{
    const Tangents *of = &it->tangents;
    double partials[N_UPDATE_PARTIALS + 1];
    partials[N_UPDATE_PARTIALS] = 0.0;
    model_update_partials(t, it->now.values, it->tables, partials);
    propagate(of, model_update_places, N_UPDATE_PARTIALS, partials);
    for (int i = 0; i < N_STATES; i++)
        if (model_states[i].sampled)
            memcpy(row(of->known, of, model_states[i].value), row(of->results, of, model_states[i].value),
                   of->width * sizeof *of->known);
}

/* The rows of the states = start + factor * slopes. */
static void advance(const Tangents *of, double factor, const double *slopes)
{
    for (int i = 0; i < N_CONTINUOUS; i++)
        add(row(of->known, of, model_continuous[i]), row(of->work, of, i), factor, slopes + i * of->width, of->width);
}

void tangents_integrate(Instance *it, const double *constants, double t, double h)
{
    static const double reach[] = {0.0, 0.5, 0.5, 1.0}, weight[] = {1.0, 2.0, 2.0, 1.0};
    const Tangents *of = &it->tangents;
    const size_t size = N_CONTINUOUS * of->width;
    const double *slopes = row(of->results, of, FIRST_RATE);
    double *v = it->now.values, *sum = of->work + size;
    double from[N_CONTINUOUS + 1], k[4][N_CONTINUOUS + 1], partials[N_RATE_PARTIALS + 1];
    partials[N_RATE_PARTIALS] = 0.0;
    for (int i = 0; i < N_CONTINUOUS; i++) {
        from[i] = v[model_continuous[i]];
        memcpy(row(of->work, of, i), row(of->known, of, model_continuous[i]), of->width * sizeof *sum);
    }
    memset(sum, 0, size * sizeof *sum);
    for (int s = 0; s < 4; s++) {
        const double ahead = reach[s] * h;
        for (int i = 0; s > 0 && i < N_CONTINUOUS; i++)
            v[model_continuous[i]] = from[i] + ahead * k[s - 1][i];
        if (s > 0)
            advance(of, ahead, slopes);
        model_linearised(t + ahead, v, it->tables, constants, k[s], partials);
        propagate(of, model_rate_places, N_RATE_PARTIALS, partials);
        accumulate(sum, weight[s], slopes, size);
    }
    for (int i = 0; i < N_CONTINUOUS; i++)
        v[model_continuous[i]] = from[i] + h / 6.0 * (k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i]);
    advance(of, h / 6.0, sum);
}

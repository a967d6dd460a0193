
/* The model as a part of a system, see part.h. */

typedef struct {
    Instance instance; /* first, so that a pointer to it is one to the part */
    void *owner;
    int number;
    PartReport *listener;
} Part;

enum { ANY_TYPE = REAL | INTEGER | BOOLEAN | ENUMERATION };

/* The system names the part; the model's name, with which the message begins, is left out. */
static void pass_on(Instance *it, Status status, const char *category, const char *message)
{
    const Part *part = (const Part *)it;
    part->listener(part->owner, part->number, status, category, message + sizeof MODEL_NAME + 1);
}

static void part_close(void *part)
{
    if (part)
        instance_close((Instance *)part);
    free(part);
}

static void *part_open(void *owner, int number, PartReport *listener, const char *tables)
{
    Problem problem;
    Part *part = (Part *)calloc(1, sizeof *part);
    if (!part)
        return NULL;
    Instance *it = &part->instance;
    it->report = pass_on;
    it->logging = 1; /* the system knows whether anybody listens */
    part->owner = owner;
    part->number = number;
    part->listener = listener;
    for (int i = 0; i < N_VARIABLES; i++)
        it->defaults[i] = model_variables[i].start;
    if (read_tables(tables, it->tables, &problem)) {
        instance_error(it, "%s", problem.text);
        part_close(part);
        return NULL;
    }
    instance_reset(it);
    return part;
}

static void part_reset(void *part)
{
    instance_reset((Instance *)part);
}

static Status part_begin(void *part, double time)
{
    return instance_begin((Instance *)part, time);
}

static Status part_set(void *part, unsigned reference, double value)
{
    return instance_set((Instance *)part, reference, ANY_TYPE, value);
}

static Status part_evaluate(void *part)
{
    Instance *it = (Instance *)part;
    it->now.valid = 0;
    evaluate_outputs(it);
    return STATUS_OK;
}

static Status part_run(void *part)
{
    return instance_run((Instance *)part);
}

static double *part_values(void *part)
{
    return ((Instance *)part)->now.values;
}

static Status part_save(void *part, void *to)
{
    memcpy(to, &((Instance *)part)->now, sizeof(Snapshot));
    return STATUS_OK;
}

static Status part_restore(void *part, const void *from)
{
    memcpy(&((Instance *)part)->now, from, sizeof(Snapshot));
    return STATUS_OK;
}

static void part_drop(void *part, void *at)
{
    (void)part, (void)at;
}

static Status part_step(void *part, double time, double duration)
{
    return instance_step((Instance *)part, time, duration);
}

static Status part_carry(void *part, size_t directions)
{
    return instance_carry((Instance *)part, directions);
}

static Status part_set_tangents(void *part, unsigned reference, const double *tangents)
{
    return instance_set_tangents((Instance *)part, &reference, 1, tangents);
}

static Status part_get_tangents(void *part, unsigned reference, double *tangents)
{
    return instance_get_tangents((Instance *)part, &reference, 1, tangents);
}

const PartModel PART_MODEL = {
    sizeof(Snapshot), part_open,    part_close, part_reset, part_begin,        part_set,          part_step, part_evaluate,
    part_run,         part_values,  part_save,  part_restore, part_drop, part_carry, part_set_tangents, part_get_tangents,
};

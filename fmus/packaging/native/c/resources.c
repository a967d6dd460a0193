#include "resources.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "files.h"

enum { LONGEST_LINE = 400, MOST_DEFAULTS = 100000, MOST_SAMPLES = 1 << 26 };

static int trouble(Problem *problem, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(problem->text, sizeof problem->text, format, arguments);
    va_end(arguments);
    return 1;
}

/* Next line without its end and surrounding blanks; NULL at the end, or (with `problem` filled) when it is too long. */
static char *next_line(FILE *file, char line[LONGEST_LINE], Problem *problem)
{
    if (!fgets(line, LONGEST_LINE, file))
        return NULL;
    size_t length = strlen(line);
    if (length + 1 == LONGEST_LINE && line[length - 1] != '\n') {
        trouble(problem, "a line is longer than %d characters", LONGEST_LINE - 2);
        return NULL;
    }
    while (length && strchr(" \t\r\n", line[length - 1]))
        line[--length] = '\0';
    return line + strspn(line, " \t");
}

/* The number that the text is, whatever decimal point the process's locale has; 0 when it is none. */
static int parse_number(const char *text, double *number)
{
    char sample[16], local[LONGEST_LINE + 16], *end;
    snprintf(sample, sizeof sample, "%.1f", 0.5);
    const char *point = strchr(text, '.');
    const int before = (int)(point ? point - text : (ptrdiff_t)strlen(text));
    const int width = (int)strlen(sample) - 2;
    if (!*text || strspn(text, "+-.0123456789eE") != strlen(text))
        return 0;
    snprintf(local, sizeof local, "%.*s%.*s%s", before, text, point ? width : 0, sample + 1, point ? point + 1 : "");
    *number = strtod(local, &end);
    return end != local && !*end && isfinite(*number);
}

/* Value reference of the input or parameter of that name, -1 for none. */
static int find_default(const char *name)
{
    for (int i = 0; i < N_VARIABLES; i++)
        if (model_variables[i].role <= RECEIVED && strcmp(model_variables[i].name, name) == 0)
            return i;
    return -1;
}

static int parse_value(const char *text, Type type, double *value)
{
    if (type == BOOLEAN) {
        *value = strcmp(text, "True") == 0;
        return *value == 1.0 || strcmp(text, "False") == 0;
    }
    return parse_number(text, value) && (type == REAL || (*value == floor(*value) && fabs(*value) < 0x1p31));
}

static int take_default(char *line, double values[N_VARIABLES], Problem *problem)
{
    char *separator = strchr(line, '=');
    if (!separator)
        return *line ? trouble(problem, "'%.60s' is no assignment", line) : 0;
    char *name_end = separator;
    while (name_end > line && strchr(" \t", name_end[-1]))
        name_end--;
    *name_end = '\0';
    const char *number = separator + 1 + strspn(separator + 1, " \t");
    const int reference = find_default(line);
    if (reference < 0)
        return trouble(problem, "'%.60s' is no input or parameter", line);
    if (!parse_value(number, model_variables[reference].type, &values[reference]))
        return trouble(problem, "'%.60s' is no value for %s", number, line);
    return 0;
}

int read_defaults(const char *folder, double values[N_VARIABLES], Problem *problem)
{
    char buffer[LONGEST_LINE], *line;
    Problem inner = {""};
    int count = 0;
    FILE *file = open_file(folder, "defaults", ".txt");
    if (!file)
        return trouble(problem, "resources/defaults.txt cannot be read in %.250s", folder);
    while (!*inner.text && (line = next_line(file, buffer, &inner)) != NULL) {
        if (++count > MOST_DEFAULTS)
            trouble(&inner, "has more than %d lines", MOST_DEFAULTS);
        else
            take_default(line, values, &inner);
    }
    fclose(file);
    return *inner.text ? trouble(problem, "defaults.txt: %.350s", inner.text) : 0;
}

/* Make room for one more sample, in powers of two. */
static int grow(Table *table)
{
    const size_t count = table->count;
    if (count & (count - 1))
        return 1;
    const size_t room = count ? 2 * count : 1;
    double *time = room <= MOST_SAMPLES ? (double *)realloc(table->time, room * sizeof *time) : NULL;
    if (!time)
        return 0;
    table->time = time;
    double *value = (double *)realloc(table->value, room * sizeof *value);
    if (!value)
        return 0;
    table->value = value;
    return 1;
}

static int take_sample(char *line, Table *table, Problem *problem)
{
    double time, value;
    char *comma = strchr(line, ',');
    if (comma)
        *comma = '\0';
    if (!comma || !parse_number(line, &time) || !parse_number(comma + 1, &value))
        return trouble(problem, "sample %lu is no pair of numbers", (unsigned long)table->count + 1);
    if (table->count && !(time > table->time[table->count - 1]))
        return trouble(problem, "its instants do not increase strictly (sample %lu)", (unsigned long)table->count + 1);
    if (!grow(table))
        return trouble(problem, "has more samples than fit");
    table->time[table->count] = time;
    table->value[table->count++] = value;
    return 0;
}

static int read_table(FILE *file, Table *table, Problem *problem)
{
    char buffer[LONGEST_LINE];
    char *line = next_line(file, buffer, problem); /* the header */
    while (line && (line = next_line(file, buffer, problem)) != NULL)
        if (*line && take_sample(line, table, problem))
            return 1;
    if (*problem->text)
        return 1;
    return table->count ? 0 : trouble(problem, "has no samples");
}

/* The table of a file that is not there: 0 at all times. */
static int zero_table(Table *table)
{
    if (!grow(table))
        return 1;
    table->time[0] = table->value[0] = 0.0;
    table->count = 1;
    return 0;
}

int read_tables(const char *folder, Table tables[N_TABLES + 1], Problem *problem)
{
    for (int i = 0; i < N_TABLES; i++) {
        Problem inner = {""};
        FILE *file = open_file(folder, model_tables[i], ".csv");
        if (file) {
            read_table(file, &tables[i], &inner);
            fclose(file);
        } else if (zero_table(&tables[i])) {
            trouble(&inner, "no memory");
        }
        if (*inner.text)
            return trouble(problem, "%.60s.csv: %.300s", model_tables[i], inner.text);
    }
    return 0;
}

void free_tables(Table tables[N_TABLES + 1])
{
    for (int i = 0; i < N_TABLES; i++) {
        free(tables[i].time);
        free(tables[i].value);
    }
}

/* Defaults and tables from the files in an FMU's resources. These come from outside: sizes and numbers are checked. */
#ifndef RESOURCES_H
#define RESOURCES_H

#include "model.h"

/* Read `name = value` lines into values (by value reference), or rows of `time,value` into tables.
 * They return 0, or another number and say in `problem` what is wrong. Memory of tables is freed by `free_tables`,
 * whatever was returned. */
typedef struct {
    char text[400];
} Problem;

int read_defaults(const char *folder, double values[N_VARIABLES], Problem *problem);
int read_tables(const char *folder, Table tables[N_TABLES + 1], Problem *problem);
void free_tables(Table tables[N_TABLES + 1]);

#endif
